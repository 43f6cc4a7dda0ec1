"""A release, step by step: what a machine can do of it.

    python packaging/release.py check
        version, changelog, addresses, pins and licences agree; the tree is clean
    python packaging/release.py build [FOLDER]
        sdist and wheel into FOLDER (dist), what the usual checkers say of them, and the wheel in a clean environment of
        each Python there is, without compiler
    python packaging/release.py conda URL
        dist/recipe.yaml, with the address and the hash of the sdist in dist

Each says what it found in a line; the exit status is 1 where something is not as it must be. `check` needs nothing but
Python, `build` makes an environment of its own for the tools.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
METADATA = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
VERSION = METADATA["version"]
TOOLS = ("abi3audit", "build", "check-wheel-contents", "pyroma", "twine")
PLACEHOLDER = "example.org"
"""Of addresses that are not known before there is a place for the project."""
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
LEAST_RATING = 8
"""Of pyroma's ten: two are for the address of an author, which the project has none of."""


def faults() -> list[str]:
    """What stands in the way of a release, in sentences."""
    out = []
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    if not re.search(rf"^## {re.escape(VERSION)} \(\d{{4}}-\d{{2}}-\d{{2}}\)$", changelog, re.MULTILINE):
        out.append(f"CHANGELOG.md: expected '## {VERSION} (YYYY-MM-DD)', found no date of that version")
    for file, line in (
        ("src/tumble/__init__.py", f'__version__ = "{VERSION}"'),
        ("CITATION.cff", f"version: {VERSION}"),
        ("conda/recipe.yaml", f'  version: "{VERSION}"'),
    ):
        if line not in (ROOT / file).read_text(encoding="utf-8").splitlines():
            out.append(f"{file}: expected the line {line!r}")
    for name, address in METADATA["urls"].items():
        if PLACEHOLDER in address:
            out.append(f"pyproject.toml: project.urls.{name}: expected the address of the project, found {address}")
    for workflow in sorted((ROOT / ".github/workflows").glob("*.yml")):
        for used in re.findall(r"uses: (\S+)", workflow.read_text(encoding="utf-8")):
            if not re.fullmatch(r"[\w./-]+@[0-9a-f]{40}", used):
                out.append(f"{workflow.relative_to(ROOT)}: expected an action pinned to a commit, found {used}")
    for file in METADATA["license-files"]:
        if not (ROOT / file).is_file():
            out.append(f"pyproject.toml: license-files: {file} is missing")
    changed = subprocess.run(["git", "status", "--porcelain"], cwd=ROOT, capture_output=True, text=True, check=False)
    if changed.stdout.strip():
        out.append(f"expected a clean tree, found {len(changed.stdout.splitlines())} changed files; commit them")
    return out


def run(*command: object, **more: object) -> subprocess.CompletedProcess[str]:
    """A command that must succeed; where it does not, its words are the reason."""
    words = [str(word) for word in command]
    done = subprocess.run(words, capture_output=True, text=True, check=False, **more)  # type: ignore[call-overload]
    if done.returncode:
        sys.exit(f"{' '.join(words)}: exit status {done.returncode}\n{done.stdout}{done.stderr}")
    return done  # type: ignore[no-any-return]


def python_of(version: str) -> Path | None:
    """The interpreter of a version of Python, on the path or among those of pyenv, if there is one."""
    found = shutil.which(f"python{version}")
    if found and subprocess.run([found, "--version"], capture_output=True, check=False).returncode == 0:
        return Path(found)
    roots = [Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))]
    each = sorted(path for root in roots for path in root.glob(f"versions/{version}.*/bin/python3"))
    return each[-1] if each else None


def build(folder: Path) -> None:
    """Sdist and wheel, checked, and the wheel tried in clean environments."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        tools = Path(scratch) / "tools"
        run(sys.executable, "-m", "venv", tools)
        run(tools / "bin/python", "-m", "pip", "install", "-q", *TOOLS)
        run(tools / "bin/python", "-m", "build", "--outdir", folder, ROOT)
        files = [*folder.glob(f"tumble-{VERSION}*.whl"), folder / f"tumble-{VERSION}.tar.gz"]
        wheel = files[0]
        print(f"built {', '.join(f'{file.name} ({file.stat().st_size / 1e6:.1f} MB)' for file in files)}")
        run(tools / "bin/twine", "check", "--strict", *files)
        print("twine check --strict: passed")
        run(tools / "bin/check-wheel-contents", "--ignore", "W002", wheel)  # uPlot's licence lies beside it, too
        print("check-wheel-contents: passed")
        run(tools / "bin/abi3audit", "--strict", wheel)
        print("abi3audit --strict: passed")
        rating = re.search(r"(\d+)/10", run(tools / "bin/pyroma", "-n", LEAST_RATING, files[1]).stdout)
        print(f"pyroma: {rating[0] if rating else 'passed'}")
        for version in PYTHONS:
            python = python_of(version)
            if python is None:
                print(f"Python {version}: not here")
                continue
            place = Path(scratch) / version
            run(python, "-m", "venv", place)
            own = place / "bin/python"
            run(own, "-m", "pip", "install", "-q", "--only-binary=:all:", wheel)
            without = {"PATH": "/nonexistent", "HOME": scratch}  # no compiler, nothing of this machine
            session = place / "launch"
            run(place / "bin/tumble", "simulate", session, "--programme", "rough-table", "--seed", 1, env=without)
            run(place / "bin/tumble", "calibrate", session, env=without)
            packages = list(place.glob("lib/python*/site-packages/*.dist-info"))
            size = sum(file.stat().st_size for file in place.rglob("*") if file.is_file() and not file.is_symlink())
            there = f"{len(packages) - 1} packages, {size / 1e6:.0f} MB"
            print(f"Python {version}: calibrates; {there}")


def conda(address: str) -> None:
    """The conda recipe of the sdist in dist, at an address."""
    sdist = ROOT / f"dist/tumble-{VERSION}.tar.gz"
    if not sdist.is_file():
        sys.exit(f"{sdist}: expected the sdist; run `python packaging/release.py build` first")
    text = (ROOT / "conda/recipe.yaml").read_text(encoding="utf-8")
    source = f"source:\n  url: {address}\n  sha256: {hashlib.sha256(sdist.read_bytes()).hexdigest()}\n"
    filled, count = re.subn(r"^source:\n(?:  .*\n)+", source, text, flags=re.MULTILINE)
    assert count == 1
    target = sdist.with_name("recipe.yaml")
    target.write_text(filled, encoding="utf-8")
    print(f"written: {target.relative_to(ROOT)}")


def main(arguments: list[str]) -> None:
    """One of the steps."""
    match arguments:
        case ["check"]:
            found = faults()
            print("\n".join(found) or f"tumble {VERSION} may be released")
            sys.exit(bool(found))
        case ["build", *where]:
            build(Path(where[0]) if where else ROOT / "dist")
        case ["conda", address]:
            conda(address)
        case _:
            sys.exit(__doc__)


if __name__ == "__main__":
    main(sys.argv[1:])
