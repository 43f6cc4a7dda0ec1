"""The page that compares the methods shows what the study measured."""

from __future__ import annotations

import json
import re

import pytest

from tests.support import ROOT, study

PAGE = ROOT / "docs/howto/choose-a-method.md"
MEASURED = ROOT / "docs/evidence/methods.md"
STUDY = study("which_method_when")


def test_the_tables_of_the_page_are_those_of_the_stored_result() -> None:
    result = json.loads(STUDY.STORED.read_text(encoding="utf-8"))
    measured = MEASURED.read_text(encoding="utf-8")
    assert STUDY.needs_table(result) in PAGE.read_text(encoding="utf-8")
    assert STUDY.errors_table(result) in measured
    assert f"{result['sessions']} sessions" in " ".join(measured.split())


def test_the_stored_result_is_that_of_the_methods() -> None:
    stored = json.loads(STUDY.STORED.read_text(encoding="utf-8"))
    assert result_is_complete(stored)
    few = {(line.method, line.group): line for line in STUDY.lines_on_table(1.0, 12)}
    for line in stored["errors"]["±1°"]:
        # rms errors of 12 sessions and 3 or 6 parameters: 5 sigma of a ratio, with correlated parameters
        assert few[line["method"], line["group"]].rms == pytest.approx(line["rms"], rel=0.6), line


def result_is_complete(result: dict[str, dict[str, list[dict[str, object]]]]) -> bool:
    """Whether every method is there at every place, with all groups that it gives."""
    counts = {"±1°": 4 * 6 + 3, "by hand": 2 * 6 + 3}
    places = [f"±{degrees:g}°" for degrees in STUDY.TABLES] + ["by hand"]
    found = {place: len(lines) for place, lines in result["errors"].items()}
    return found == {place: counts["by hand" if place == "by hand" else "±1°"] for place in places}


def test_every_method_is_on_the_page() -> None:
    from tumble.run.calibrate import ITERATED_METHODS, METHODS

    listed = set(re.findall(r"^\| `(\w+)` \|", PAGE.read_text(encoding="utf-8"), re.M))
    assert listed == set(STUDY.NEEDS) == {*METHODS, *ITERATED_METHODS}
