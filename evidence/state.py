"""Of which state of the sources a result is, and the files of what was computed, which are not computed again."""

from __future__ import annotations

import ast
import hashlib
import os
import platform
import subprocess
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent
CACHE = FOLDER / "cache"
LIBRARIES = ("numpy", "scipy", "polars")


def digest_of(*parts: Path | str) -> str:
    """The hash of files and texts."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part.read_bytes() if isinstance(part, Path) else part.encode())
    return digest.hexdigest()


@cache
def source_of(program: str) -> str:
    """The hash of all that a program's answers depend on beside the case: its own file and those of this folder that it
    imports, of tumble's methods all of tumble, versions of libraries."""
    from evidence.programs import named

    one = named(program)
    files = files_of(getattr(one.estimate, "func", one.estimate).__module__)
    if one.ours:
        files |= set(FOLDER.parent.joinpath("src/tumble").rglob("*.py"))
    libraries = " ".join(f"{name} {version(name)}" for name in LIBRARIES)
    return digest_of(*sorted(files), libraries)


def files_of(module: str) -> set[Path]:
    """The file of a module of this folder, and those that it imports, directly or not."""
    files: set[Path] = set()
    todo = [module]
    while todo:
        path = FOLDER.parent.joinpath(*todo.pop().split(".")).with_suffix(".py")
        if path in files or not path.exists() or FOLDER not in path.parents:
            continue
        files.add(path)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                todo += [name.name for name in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                todo += [node.module, *(f"{node.module}.{name.name}" for name in node.names)]
    return files


def file_of(folder: Path, *parts: str) -> Path:
    """The file of what depends on these."""
    name = digest_of(" ".join(parts))
    return folder / name[:2] / f"{name}.json"


def keep(path: Path, text: str) -> None:
    """Write a file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_suffix(".part").write_text(text, encoding="utf-8")
    path.with_suffix(".part").replace(path)


def made_now(*decides: str) -> dict[str, Any]:
    """Of which state of the sources, when and where something is made; these paths of the repository decide."""

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=FOLDER.parent, capture_output=True, text=True, check=False)
        return done.stdout.strip()

    changed = git("status", "--porcelain", "--", *decides)
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
    return {
        "commit": git("rev-parse", "HEAD") + (", changed" if changed else ""),
        "date": datetime.now(UTC).date().isoformat(),
        "machine": f"{model or platform.machine()}, {os.cpu_count()} cores",
        "system": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "libraries": {library: version(library) for library in LIBRARIES},
    }
