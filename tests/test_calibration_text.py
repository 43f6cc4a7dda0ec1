"""The printed report of launches, iterations and methods: the form of the paper's Tables 1 to 3."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from rich.console import Console, RenderableType

from tumble.calibration.calibrate import calibrate
from tumble.calibration.calibration_file import Calibration
from tumble.calibration.launches import Run, difference_percent, mean_of_launches
from tumble.cli import main
from tumble.planning.setup import Setup
from tumble.recording.session import read_session
from tumble.simulation.session import simulate_session
from tumble.terminal.calibration import (
    WHAT_AN_INCREMENT_SAYS,
    calibration_report,
    iteration_table,
    launch_table,
    method_table,
)
from tumble.terminal.text import shown_units

REQUEST = Setup.of(rest=10.0, sample_rate=50.0)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    base = tmp_path_factory.mktemp("launches")
    return [simulate_session(base / f"launch{i}", REQUEST, seed=21, launch=i) for i in (1, 2)]


@pytest.fixture(scope="module")
def by_method(folders: list[Path]) -> dict[str, Calibration]:
    sessions = [read_session(folder) for folder in folders]
    return {
        method: mean_of_launches([Run(session=s, calibration=calibrate(s, method=method)) for s in sessions])
        for method in ("scalar", "sequential")
    }


def printed(report: RenderableType) -> str:
    out = io.StringIO()
    Console(file=out, width=160).print(report)
    return out.getvalue()


def numbers(report: RenderableType) -> dict[str, list[float]]:
    """The numbers of each row of a table, by its first word; the last word is the unit."""
    rows = [line.split() for line in printed(report).splitlines()[1:]]
    return {row[0]: [float(word) for word in row[1:-1]] for row in rows if row}


def test_each_launch_its_mean_and_the_deviation_from_run_to_run_are_in_a_row(by_method: dict[str, Calibration]) -> None:
    found = by_method["scalar"]
    units = shown_units(found.parameters)
    rows = numbers(launch_table(found))
    assert list(rows) == [p.name for p in found.parameters]
    for i, p in enumerate(found.parameters):
        size = units[p.name][0]
        values = [launch.parameters[i].value / size for launch in found.launches]
        last = 0.06 * max((launch.parameters[i].u or 0.0) for launch in found.launches) / size
        expected = [*values, float(np.mean(values)), float(np.std(values, ddof=1))]
        np.testing.assert_allclose(np.array(rows[p.name]), np.array(expected), atol=last)


def test_the_increments_add_up_to_the_result(by_method: dict[str, Calibration]) -> None:
    for found in by_method.values():
        units = shown_units(found.parameters)
        for name, row in numbers(iteration_table(found)).items():
            first, second, _ = row
            assert first + second == pytest.approx(found[name].value / units[name][0], abs=0.006 * abs(first))


def test_the_statement_on_increments_is_beside_them_and_only_there(by_method: dict[str, Calibration]) -> None:
    said = " ".join(printed(calibration_report(by_method["sequential"])).split())
    assert WHAT_AN_INCREMENT_SAYS in said
    assert said.index("mean increment of") < said.index(WHAT_AN_INCREMENT_SAYS)
    staged = printed(calibration_report(replace(by_method["scalar"], method="staged")))
    assert "increment" not in staged


def test_the_methods_differ_by_what_is_printed(by_method: dict[str, Calibration]) -> None:
    """In the parameter's unit, and in % of the first method's value."""
    scalar, sequential = by_method["scalar"], by_method["sequential"]
    rows = numbers(method_table(scalar, sequential))
    assert len(rows) == 21
    for name, (_, _, difference, percent) in rows.items():
        a, b = scalar[name].value, sequential[name].value
        last = 0.006 * (scalar[name].u or 0.0)
        assert difference * shown_units(scalar.parameters)[name][0] == pytest.approx(b - a, rel=1e-12, abs=last)
        assert percent == pytest.approx(100.0 * (b - a) / a, abs=0.006)


def test_the_difference_in_percent_is_that_of_table_1() -> None:
    """Sequential less scalar method, both iterations, of k_y, k_z and γ_zx: published 11.46, −10.47 and 5.28 % (from
    values with more digits than those of the table)."""
    sequential = np.array([-21.3 + 0.085, -11.7 - 0.19, 14.71 - 0.18])
    scalar = np.array([-19.0 - 0.0038, -13.4 + 0.0537, 13.80 + 0.008])
    np.testing.assert_allclose(difference_percent(sequential, scalar), [11.46, -10.47, 5.28], atol=0.6)


def test_deviations_from_the_systematic_values_stand_beside_the_totals(
    by_method: dict[str, Calibration], folders: list[Path], tmp_path: Path
) -> None:
    passport = tmp_path / "passport.json"
    by_method["scalar"].write(passport)
    sessions = [read_session(folder) for folder in folders]
    sessions = [replace(s, device=replace(s.device, systematic=passport)) for s in sessions]
    mean = mean_of_launches([Run(session=s, calibration=calibrate(s, method="scalar")) for s in sessions])
    rows = numbers(launch_table(mean, deviations=True))
    for p in mean.parameters:
        size = shown_units(mean.parameters)[p.name][0]
        deviations = [next(q for q in launch.parameters if q.name == p.name).deviation for launch in mean.launches]
        expected = [d / size for d in deviations if d is not None]
        assert len(expected) == 2
        np.testing.assert_allclose(rows[p.name][:2], expected, atol=0.1 * (p.u or 0.0) / size)
    assert printed(calibration_report(mean)).count("launch1") == 2
    assert "deviation of" in printed(calibration_report(mean))


def test_several_methods_are_compared_and_the_first_is_written(folders: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "both.json"
    arguments = ["calibrate", str(folders[0]), "--method", "scalar", "--method", "sequential", "--out", str(out)]
    done = CliRunner().invoke(main, arguments)
    assert done.exit_code == 0, done.stderr
    assert '"method": "scalar"' in out.read_text(encoding="utf-8")
    assert "scalar  sequential  difference" in done.stdout
    once = CliRunner().invoke(main, [*arguments[:-4], "--out", str(tmp_path / "one.json")])
    assert "difference" not in once.stdout
