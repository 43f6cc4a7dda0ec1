"""A trend and `tumble compare` say the same of the last two calibrations of a device, what they share left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tests.support.calibrated import calibration, with_fields
from tests.use.test_compare import of_common_gravity, of_common_time_base
from tumble.cli import main
from tumble.inference.estimate import Outcome
from tumble.lab.registry.records import State
from tumble.lab.registry.registry import open_registry
from tumble.lab.registry.trend import Trend
from tumble.lab.registry.views import change_lines
from tumble.result.calibration import Calibration
from tumble.use.compare import compare_calibrations


def trend_of(folder: Path, *calibrations: Calibration) -> Trend:
    """Of one device, calibrated once a year, each time with another log."""
    with open_registry(folder / "r.sqlite", create=True) as registry:
        for i, made in enumerate(calibrations):
            other = with_fields(made, log_sha256=f"{i:064x}")
            registry.add_calibration(other, performed=datetime(2020 + i, 3, 1, tzinfo=UTC))
        return registry.trend("A-0007")


def test_a_trend_judges_the_latest_calibration_as_its_record(tmp_path: Path) -> None:
    jump = "biases of the gyros jump"
    changed = Outcome(remarks=(jump,), concerns={jump: ("gyro.bias",)}, unsteady=(jump,))
    first, second = calibration(), replace(calibration(), outcome=changed)
    text = 'format = 1\n[periodic]\n"gyro.bias" = "90 deg/h"\n"accel.scale" = "5000 ppm"\n'
    (tmp_path / "limits.toml").write_text(text, "utf-8")
    with open_registry(tmp_path / "r.sqlite", create=True) as registry:
        registry.set_limits(first.model or "", tmp_path / "limits.toml")
        for i, made in enumerate((first, second)):
            record = registry.add_calibration(with_fields(made, log_sha256=f"{i:064x}"), occasion="periodic")
        verdict, found = registry.verdict(record), registry.trend(record.serial)
    assert verdict is not None
    assert found.acceptance == verdict
    results = {j.name: j.result for j in verdict.judgements}
    assert (results["gyro.bias.x"], results["accel.scale.x"]) == ("undecided", "pass")


@pytest.mark.parametrize("sigmas", [0.0, 2.5, 3.6, -3.6])
def test_a_change_has_one_sign_one_number_and_one_verdict(sigmas: float, tmp_path: Path) -> None:
    first = calibration()
    name, u = "accel.bias.x", first["accel.bias.x"].u or 0.0
    moved = replace(first["accel.bias.x"], value=first["accel.bias.x"].value + sigmas * np.sqrt(2.0) * u)
    second = replace(first, parameters=tuple(moved if p.name == name else p for p in first.parameters))
    found, comparison = trend_of(tmp_path, first, second), compare_calibrations(first, second)
    assert found.comparison is not None
    assert found.comparison.differences == comparison.differences
    assert [trend.name for trend in found.parameters] == [difference.name for difference in comparison.differences]
    assert comparison.differences[0].e_n == pytest.approx(sigmas / 2.0)
    assert comparison.agree == (not found.changed)
    line, beyond = change_lines(found)[0], int(abs(sigmas) > 2)
    assert line.startswith(f"the latest against the one before: {beyond} of 21 |E_n| exceed 1, the largest")


@pytest.mark.parametrize("pair", [of_common_gravity, of_common_time_base])
def test_a_step_of_40_ppm_under_a_common_error_of_20_ppm_ends_a_trend_with_1(
    pair: Callable[[float], tuple[Calibration, Calibration]], tmp_path: Path
) -> None:
    """The scale factor is known to 1.2 ppm but for what both share. Without the step it ends with 0."""
    for moved, status in ((40e-6, 1), (0.0, 0)):
        (tmp_path / str(status)).mkdir()
        trend_of(tmp_path / str(status), *pair(moved))
        words = ["registry", "trend", "A-0007", "--registry", str(tmp_path / str(status) / "r.sqlite")]
        ran = CliRunner().invoke(main, words)
        name = "accel.scale.x" if pair is of_common_gravity else "gyro.scale.y"
        assert (ran.exit_code, ran.stderr) == (status, f"changed: {name}\n" if status else "")


def test_a_trend_says_which_records_it_compares_and_not_across_an_adjustment(tmp_path: Path) -> None:
    with open_registry(tmp_path / "r.sqlite", create=True) as registry:
        states: list[State] = ["unchanged", "as-found", "as-left"]
        for i, state in enumerate(states):
            made = calibration()
            name = made.parameters[0].name
            moved = (replace(made[name], value=made[name].value + i * (made[name].u or 0.0)), *made.parameters[1:])
            other = with_fields(replace(made, parameters=moved), log_sha256=f"{i:064x}")
            registry.add_calibration(other, performed=datetime(2020 + i, 3, 1, tzinfo=UTC), state=state)
        found = registry.trend("A-0007")
    assert found.compared == (1, 2)
    assert found.latest.number == 3
    assert change_lines(found)[0].startswith(
        "record 2 against record 1, before the adjustment (record 3 is after it, and is not compared): 0 of 21"
    )


def test_a_trend_finds_what_only_all_parameters_together_show(tmp_path: Path) -> None:
    first = calibration()
    apart = tuple(replace(p, value=p.value + 0.9 * 2.0 * np.sqrt(2.0) * (p.u or 0.0)) for p in first.parameters)
    found = trend_of(tmp_path, first, replace(first, parameters=apart))
    assert found.changed == ["all parameters together"]
    assert found.comparison is not None
    assert found.comparison.contradicts
