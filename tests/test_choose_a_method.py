"""The page that compares the methods shows what the study measured."""

from __future__ import annotations

import importlib.util
import json
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "choose-a-method.md"


@pytest.fixture(scope="module")
def study() -> ModuleType:
    """The study, as a module."""
    path = ROOT / "studies" / "which_method_when.py"
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_the_tables_of_the_page_are_those_of_the_stored_result(study: ModuleType) -> None:
    result = json.loads(study.STORED.read_text(encoding="utf-8"))
    page = PAGE.read_text(encoding="utf-8")
    assert study.needs_table(result) in page
    assert study.errors_table(result) in page
    assert f"{result['sessions']} sessions" in " ".join(page.split())


def test_the_stored_result_is_that_of_the_methods(study: ModuleType) -> None:
    stored = json.loads(study.STORED.read_text(encoding="utf-8"))
    assert result_is_complete(study, stored)
    few = {(line.method, line.group): line for line in study.lines_on_table(1.0, 12)}
    for line in stored["errors"]["±1°"]:
        # rms errors of 12 sessions and 3 or 6 parameters: 5 sigma of a ratio, with correlated parameters
        assert few[line["method"], line["group"]].rms == pytest.approx(line["rms"], rel=0.6), line


def result_is_complete(study: ModuleType, result: dict[str, dict[str, list[dict[str, object]]]]) -> bool:
    """Whether every method is there at every place, with all groups that it gives."""
    counts = {"±1°": 4 * 6 + 3, "by hand": 2 * 6 + 3}
    places = [f"±{degrees:g}°" for degrees in study.TABLES] + ["by hand"]
    found = {place: len(lines) for place, lines in result["errors"].items()}
    return found == {place: counts["by hand" if place == "by hand" else "±1°"] for place in places}


def test_every_method_is_on_the_page(study: ModuleType) -> None:
    from tumble.calibration.calibrate import ITERATED_METHODS, METHODS

    listed = set(re.findall(r"^\| `(\w+)` \|", PAGE.read_text(encoding="utf-8"), re.M))
    assert listed == set(study.NEEDS) == {*METHODS, *ITERATED_METHODS}
