"""What is released: the wheel holds the whole package and nothing else, the sdist what its tests need."""

from __future__ import annotations

import importlib.util
import re
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

from tests.support import ROOT

METADATA = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def sources() -> set[str]:
    """The files of the package, compiled ones with them, as they lie in the wheel."""
    files = (path.relative_to(ROOT / "src") for path in (ROOT / "src/tumble").rglob("*") if path.is_file())
    return {path.as_posix() for path in files if "__pycache__" not in path.parts}


def test_the_wheel_holds_the_package_its_pages_its_types_and_its_command(tmp_path: Path) -> None:
    builder = pytest.importorskip("hatchling.builders.wheel").WheelBuilder(str(ROOT))
    wheel = zipfile.ZipFile(next(builder.build(directory=str(tmp_path), versions=["standard"])))
    names = {name for name in wheel.namelist() if ".dist-info/" not in name}
    assert names == sources()
    assert {
        "tumble/py.typed",
        "tumble/bench/web/page/index.html",
        "tumble/bench/web/page/vendor/uPlot.LICENSE",
    } <= names
    metadata = (name for name in wheel.namelist() if ".dist-info/" in name)
    described = {name.partition(".dist-info/")[2]: wheel.read(name).decode() for name in metadata}
    assert "tumble = tumble.__main__:run" in described["entry_points.txt"]
    compiled = any(name.endswith((".so", ".pyd")) for name in names)
    assert f"Root-Is-Purelib: {str(not compiled).lower()}" in described["WHEEL"]
    assert ("Tag: cp311-abi3-" if compiled else "Tag: py3-none-any") in described["WHEEL"]  # any Python from 3.11
    assert described["licenses/LICENSE"] == (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert f"Requires-Python: {METADATA['requires-python']}" in described["METADATA"]


def test_the_sdist_holds_what_its_tests_need(tmp_path: Path) -> None:
    builder = pytest.importorskip("hatchling.builders.sdist").SdistBuilder(str(ROOT))
    with tarfile.open(next(builder.build(directory=str(tmp_path), versions=["standard"]))) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    for folder in ("src", "tests", "docs", "studies", "benchmarks"):
        here = {path.relative_to(ROOT).as_posix() for path in (ROOT / folder).rglob("*.py")}
        assert here <= names, f"{folder}: {sorted(here - names)}"
    assert {"pyproject.toml", "README.md", "CHANGELOG.md", "LICENSE", "CITATION.cff", "Makefile"} <= names
    assert "hatch_build.py" in names
    assert not [name for name in names if "__pycache__" in name or name.startswith("dist/") or name.endswith(".so")]


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
        package = requirement.partition(";")[0].replace(">=", " >=").strip()
        assert f"    - {package}\n" in recipe, package


def test_actions_of_workflows_are_pinned_and_addresses_are_known_before_a_release() -> None:
    spec = importlib.util.spec_from_file_location("release", ROOT / "packaging/release.py")
    assert spec is not None
    assert spec.loader is not None
    release = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(release)
    before = ("project.urls", "CHANGELOG.md", "clean tree")  # what is not there before the day of a release
    assert [fault for fault in release.faults() if not any(word in fault for word in before)] == []
