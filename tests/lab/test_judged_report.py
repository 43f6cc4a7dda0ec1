"""A report with the verdict by acceptance limits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from tests.support.calibrated import calibration
from tests.support.pages import Page
from tumble.inference.estimate import Outcome
from tumble.lab.conformity import judge_calibration
from tumble.lab.limits import read_limits
from tumble.lab.report import write_judged_report


def test_parameters_are_judged_by_limits(tmp_path: Path) -> None:
    """One passes, one fails and one is in the guard band."""
    made = calibration()
    x, y, z = (made[f"accel.bias.{axis}"] for axis in "xyz")
    lines = [
        f'"accel.bias.x" = {{ min = "{x.value - 10.0 * (x.u or 0.0)!r} m/s^2" }}',
        f'"accel.bias.y" = {{ max = "{y.value - 10.0 * (y.u or 0.0)!r} m/s^2" }}',
        f'"accel.bias.z" = {{ max = "{z.value + (z.u or 0.0)!r} m/s^2" }}',
    ]
    limits = tmp_path / "limits.toml"
    limits.write_text("\n".join(["format = 1", "[incoming]", *lines, "[periodic]", lines[0], ""]), encoding="utf-8")
    made.write(tmp_path / "c.json")
    reasons = write_judged_report(tmp_path / "c.json", tmp_path / "report.html", limits)
    assert reasons == ["c.json: incoming check: fail: accel.bias.y; conditional pass: accel.bias.z"]
    page = Page.of(tmp_path / "report.html")
    rows = page.table("parameter", "low", "value", "U", "high", "verdict")
    assert [(row["parameter"], row["verdict"]) for row in rows] == [
        ("accel.bias.x", "pass"),
        ("accel.bias.y", "fail"),
        ("accel.bias.z", "conditional pass"),
    ]
    assert "calibration accepted, incoming check: fail, periodic check: pass" in page.whole
    assert "Decision rule: pass where the value is inside its limits by at least U (95.45 %)" in page.whole
    assert ("p", {"class": "verdict bad"}) in page.elements


def test_a_refused_calibration_has_no_conformity(tmp_path: Path) -> None:
    """None of its values may be used, so that none is inside a limit."""
    made = replace(calibration(), outcome=Outcome(reasons=("no",)))
    made.write(tmp_path / "c.json")
    limits = tmp_path / "limits.toml"
    limits.write_text('format = 1\n[incoming]\n"accel.bias" = "1 g"\n', encoding="utf-8")
    (verdict,) = judge_calibration(made, read_limits(limits))
    assert verdict.result == "undecided"
    assert verdict.risk is None
    assert {each.value for each in verdict.judgements} == {None}
    reasons = write_judged_report(tmp_path / "c.json", tmp_path / "report.html", limits)
    assert reasons[0] == "not accepted: c.json: no"
    assert "calibration not accepted, incoming check: undecided" in Page.of(tmp_path / "report.html").whole


def test_limits_that_are_met_are_accepted(tmp_path: Path) -> None:
    calibration().write(tmp_path / "c.json")
    (tmp_path / "limits.toml").write_text('format = 1\n[periodic]\n"accel.bias" = "1 g"\n', encoding="utf-8")
    assert write_judged_report(tmp_path / "c.json", tmp_path / "report.html", tmp_path / "limits.toml") == []
    assert "calibration accepted, periodic check: pass" in Page.of(tmp_path / "report.html").whole
