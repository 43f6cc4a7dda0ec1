"""Limits over temperature: a parameter is judged where it is worst, and nothing passes where nothing was measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.calibrated import calibration, warmed, with_fields
from tumble.errors import InputError
from tumble.lab.conformity import verdicts
from tumble.lab.limits import Limits, parse_limits
from tumble.lab.registry.registry import open_registry
from tumble.lab.report import limits_section
from tumble.result.calibration import Calibration
from tumble.result.temperature_curves import curve
from tumble.units import G_STANDARD

MADE = warmed(calibration())
"""Rests from −18.5 to 57.25 °C."""
NAMES = [f"accel.bias.{x}" for x in "xyz"]


def limits(size: str, temperatures: str = "[-18, 57]") -> Limits:
    text = f'format = 1\ntemperature_degC = {temperatures}\n[periodic]\n"accel.bias" = "{size}"\n'
    return parse_limits(text, None, "limits.toml")


def extremes(made: Calibration) -> dict[str, float]:
    """The largest |value| + U, mg, of each bias between −18 and 57 °C, from the polynomial itself."""
    at, out = np.linspace(-18.0, 57.0, 3001), {}
    for name in NAMES:
        found = curve(made, name, at)
        assert found.expanded is not None
        out[name] = float(np.max(np.abs(found.value) + found.expanded)) / (1e-3 * G_STANDARD)
    return out


def test_a_parameter_passes_where_it_is_within_limits_at_its_worst_temperature() -> None:
    most = max(extremes(MADE).values())
    wide, narrow = (verdicts(MADE, limits(f"{factor * most} mg"))[0] for factor in (1.001, 0.999))
    assert (wide.result, narrow.result) == ("pass", "conditional pass")
    assert wide.over == "within limits from −18 to 57 °C"
    assert narrow.over == "not shown to be within limits from −18 to 57 °C"
    for judgement in wide.judgements:
        assert judgement.value is not None
        assert judgement.expanded is not None
        found = (abs(judgement.value) + judgement.expanded) / (1e-3 * G_STANDARD)
        assert found == pytest.approx(extremes(MADE)[judgement.name], rel=1e-4)
    assert "conditional pass: accel.bias." in narrow.reasons[0]
    assert " °C" in narrow.reasons[0]


def test_one_that_fails_at_some_temperature_fails() -> None:
    verdict = verdicts(MADE, limits("0.5 mg"))[0]
    assert verdict.result == "fail"
    value = {j.name: j.value for j in verdict.judgements}
    at_reference = {name: abs(MADE[name].value) for name in NAMES}
    assert all(abs(value[name] or 0.0) >= at_reference[name] for name in NAMES)


def test_nothing_passes_beyond_what_was_measured() -> None:
    beyond = verdicts(MADE, limits("1 g", "[-40, 57]"))[0]
    assert beyond.result == "undecided"
    assert beyond.reasons == [f"not measured from −40.0 to −18.5 °C: {', '.join(j.named for j in beyond.judgements)}"]
    apart = verdicts(MADE, limits("1 g", "[70, 85]"))[0]
    assert apart.unmeasured == "from 70.0 to 85.0 °C"
    flat = replace(MADE, parameters=calibration().parameters, covariance=calibration().covariance)
    assert verdicts(flat, limits("1 g"))[0].reasons == [f"not known over temperature: {', '.join(NAMES)}"]
    cold = verdicts(calibration(), limits("1 g"))[0]
    assert cold.result == "undecided"
    assert cold.judgements[0].result == "undecided"
    assert verdicts(MADE, limits("1 g", "[-19, 58]"))[0].result == "pass"  # to SLACK


def test_what_does_not_change_with_temperature_is_judged_as_it_is() -> None:
    text = 'format = 1\ntemperature_degC = [-18, 57]\n[periodic]\n"accel.axis" = "1 rad"\n'
    verdict = verdicts(MADE, parse_limits(text, None, "limits.toml"))[0]
    assert verdict.result == "pass"
    assert {j.at for j in verdict.judgements} == {None}


@pytest.mark.parametrize("given", ["20", "[20]", "[60, -20]", '["cold", "hot"]', "[-300, 20]", "[true, 20]"])
def test_temperatures_that_are_none_are_refused(given: str) -> None:
    with pytest.raises(InputError, match=r"temperature_degC: expected the lowest and the highest, as \[-20, 60\]"):
        limits("1 mg", given)


def test_the_report_says_between_which_temperatures_limits_hold() -> None:
    cold, given = with_fields(MADE, rests=()), limits("1 g")
    shown, unknown = (repr(limits_section(given, verdicts(made, given))) for made in (MADE, cold))
    assert "Periodic check: pass, within limits from −18 to 57 °C." in shown
    assert "at °C" in shown
    assert "not measured" in unknown


def test_the_registry_judges_a_record_over_temperature(tmp_path: Path) -> None:
    text = 'format = 1\ntemperature_degC = [-18, 57]\n[incoming]\n"accel.bias" = "1 g"\n'
    (tmp_path / "limits.toml").write_text(text, encoding="utf-8")
    with open_registry(tmp_path / "r.sqlite", create=True) as registry:
        registry.set_limits("test", tmp_path / "limits.toml")
        verdict = registry.verdict(registry.add_calibration(MADE))
        assert verdict is not None
        assert verdict.over == "within limits from −18 to 57 °C"
