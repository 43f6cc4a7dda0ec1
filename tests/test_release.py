"""What is released: the wheel holds the whole package and nothing else, the sdist what its tests need."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

from tests.support import ROOT

METADATA = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def built(what: str, folder: Path) -> Path:
    """An archive of the project; for a wheel everything is compiled anew."""
    pytest.importorskip("setuptools", minversion="77")
    pytest.importorskip("Cython")
    out = folder / "out"
    build = ["build", "--build-lib", str(folder / "lib")] if what == "bdist_wheel" else []
    command = [sys.executable, "setup.py", "-q", *build, what, "-d", str(out)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (file,) = out.iterdir()
    return file


@pytest.mark.weekly
def test_the_wheel_holds_the_package_its_pages_its_types_and_its_command(tmp_path: Path) -> None:
    wheel = zipfile.ZipFile(built("bdist_wheel", tmp_path))
    names = {name for name in wheel.namelist() if ".dist-info/" not in name}
    here = {path.relative_to(ROOT / "src") for path in (ROOT / "src/tumble").rglob("*") if path.is_file()}
    built_of = (".pyx", ".pxd", ".pyc")
    assert names == {path.as_posix() for path in here if path.suffix not in built_of}
    assert {"tumble/py.typed", "tumble/bench/web/page/index.html", "tumble/reduction/kernels.abi3.so"} <= names
    metadata = (name for name in wheel.namelist() if ".dist-info/" in name)
    described = {name.partition(".dist-info/")[2]: wheel.read(name).decode() for name in metadata}
    assert "tumble = tumble.__main__:run" in described["entry_points.txt"]
    assert "Tag: cp311-abi3-" in described["WHEEL"]  # any Python from 3.11
    assert described["licenses/LICENSE"] == (ROOT / "LICENSE").read_text(encoding="utf-8")


def test_the_sdist_holds_what_its_tests_need(tmp_path: Path) -> None:
    with tarfile.open(built("sdist", tmp_path)) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    for folder in ("src", "tests", "docs", "studies", "benchmarks"):
        here = {path.relative_to(ROOT).as_posix() for path in (ROOT / folder).rglob("*.py*") if path.suffix != ".pyc"}
        assert here <= names, f"{folder}: {sorted(here - names)}"
    assert {"pyproject.toml", "setup.py", "README.md", "CHANGELOG.md", "LICENSE", "CITATION.cff", "Makefile"} <= names
    assert not [name for name in names if "__pycache__" in name or name.endswith(".so")]


def test_the_version_is_the_same_wherever_it_stands() -> None:
    version = re.escape(METADATA["version"])
    for file, line in (
        ("src/tumble/__init__.py", rf'^__version__ = "{version}"$'),
        ("CHANGELOG.md", rf"^## {version}\b"),
        ("CITATION.cff", rf"^version: {version}$"),
        ("conda/recipe.yaml", rf'^  version: "{version}"$'),
    ):
        assert re.search(line, (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE), file


def test_the_conda_recipe_wants_what_the_package_wants() -> None:
    recipe = (ROOT / "conda/recipe.yaml").read_text(encoding="utf-8")
    for requirement in METADATA["dependencies"]:
        assert f"    - {requirement.replace('>=', ' >=')}\n" in recipe, requirement


def test_versions_agree_and_actions_of_workflows_are_pinned() -> None:
    spec = importlib.util.spec_from_file_location("release", ROOT / "packaging/release.py")
    assert spec is not None
    assert spec.loader is not None
    release = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(release)
    before = ("project.urls", "CHANGELOG.md", "clean tree")  # what is not there before the day of a release
    assert [fault for fault in release.faults() if not any(word in fault for word in before)] == []
