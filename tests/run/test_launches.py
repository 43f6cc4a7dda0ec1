"""Several launches of one device: the mean, its uncertainty, and what is common to all launches."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from tests.support.calibrated import with_fields
from tests.support.linear_instrument import stated_linear
from tumble.cli import main
from tumble.errors import InputError
from tumble.planning.setup import Setup
from tumble.recording.session_file import read_session
from tumble.result.calibration import read_calibration
from tumble.result.parts import CalibratedTemperature, Parameter
from tumble.run.calibrate import calibrate
from tumble.run.launches import LaunchRun, mean_of_launches
from tumble.sensors.parameters import group_name
from tumble.simulation.session import simulate_session
from tumble.use.check import check_calibration
from tumble.use.positions import fits_of

REQUEST = Setup.of(rest=10.0, sample_rate=50.0)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    base = tmp_path_factory.mktemp("launches")
    return [simulate_session(base / f"launch{i}", REQUEST, seed=11, launch=i) for i in (1, 2, 3)]


@pytest.fixture(scope="module")
def runs(folders: list[Path]) -> list[LaunchRun]:
    return [LaunchRun(session=(s := read_session(f)), calibration=calibrate(s, terms="linear")) for f in folders]


def test_the_mean_and_the_run_to_run_deviation_are_those_of_the_launches(runs: list[LaunchRun]) -> None:
    mean = mean_of_launches(runs)
    for parameter in mean.parameters:
        values = [run.calibration[parameter.name].value for run in runs]
        assert parameter.value == pytest.approx(np.mean(values), rel=1e-12, abs=1e-18)
        assert parameter.run_to_run == pytest.approx(np.std(values, ddof=1), rel=1e-9, abs=1e-18)
    assert [launch.session for launch in mean.evidence.launches] == ["launch1", "launch2", "launch3"]


def test_the_mean_agrees_with_the_truth_within_its_uncertainty(folders: list[Path]) -> None:
    sessions = [stated_linear(folder) for folder in folders]
    mean = mean_of_launches([LaunchRun(session=s, calibration=calibrate(s, terms="linear")) for s in sessions])
    truth = json.loads((folders[0] / "truth.json").read_text())
    z = np.array([(p.value - truth[p.name]) / p.u for p in mean.parameters if p.u])
    assert len(z) == 21
    assert np.abs(z).max() < 5.5
    assert 0.3 < np.sqrt(np.mean(z**2)) < 1.7


def test_the_uncertainty_of_gravity_does_not_average_out(runs: list[LaunchRun]) -> None:
    doubtful = [
        LaunchRun(
            session=replace(run.session, site=replace(run.session.site, gravity_u=1e-3)),
            calibration=calibrate(replace(run.session, site=replace(run.session.site, gravity_u=1e-3)), terms="linear"),
        )
        for run in runs
    ]
    mean = mean_of_launches(doubtful)
    for axis in "xyz":
        u = mean[f"accel.scale.{axis}"].u
        assert u is not None
        assert u == pytest.approx(1e-3 / runs[0].session.site.gravity, rel=0.02)


def test_another_device_under_the_same_serial_number_is_remarked_first(runs: list[LaunchRun], tmp_path: Path) -> None:
    other = read_session(simulate_session(tmp_path / "other", REQUEST, seed=12))
    other = replace(other, device=replace(other.device, serial=runs[0].session.device.serial))
    found = mean_of_launches([runs[0], LaunchRun(session=other, calibration=calibrate(other, terms="linear"))])
    assert found.outcome.accepted
    first = found.outcome.remarks[0]
    assert first.startswith("the launches differ by more than power-ons and noise of one device: ")
    assert "they are of different devices, or the device was changed" in first
    assert found.outcome.unsteady == (first,)
    assert found.outcome.is_unsteady("gyro.bias")
    assert not any("the launches differ" in remark for remark in mean_of_launches(runs).outcome.remarks)


def test_launches_of_two_types_under_one_serial_number_are_refused(runs: list[LaunchRun]) -> None:
    types: list[dict[str, Any]] = [{"model": "FOG-1", "grade": "tactical"}, {"model": "MEMS-T"}, {"grade": "mems"}]
    first, *others = (
        replace(runs[i], session=replace(runs[i].session, device=replace(runs[i].session.device, **stated)))
        for i, stated in zip((0, 1, 1), types, strict=True)
    )
    for other, said in zip(others, ("model: expected 'FOG-1' like", "grade: expected 'tactical' like"), strict=True):
        with pytest.raises(InputError, match=said):
            mean_of_launches([first, other])


def test_a_table_of_positions_is_checked_with_the_rests_and_scatter_of_all_launches(
    runs: list[LaunchRun], tmp_path: Path
) -> None:
    mean, fits = mean_of_launches(runs), [run.calibration.evidence.fits["accelerometers"] for run in runs]
    pooled = fits_of(mean)["accelerometers"]
    assert pooled.degrees == pytest.approx(sum(fit.degrees for fit in fits))
    assert pooled.scatter == pytest.approx(np.sqrt(np.mean([fit.scatter**2 for fit in fits])))
    rests = runs[0].calibration.evidence.rests[:5]
    rows = [",".join(map(repr, rest.accel.mean)) for rest in rests if rest.accel is not None]
    table = tmp_path / "positions.csv"
    table.write_text("\n".join(["ax,ay,az", *rows, ""]))
    assert len(check_calibration(mean, table).rests) == 5


def test_launches_of_another_device_or_the_same_log_twice_are_refused(runs: list[LaunchRun], tmp_path: Path) -> None:
    other = read_session(simulate_session(tmp_path / "other", REQUEST, seed=12))
    with pytest.raises(InputError, match="expected a launch of device"):
        mean_of_launches([runs[0], LaunchRun(session=other, calibration=calibrate(other, terms="linear"))])
    with pytest.raises(InputError, match="same recording"):
        mean_of_launches([runs[0], runs[0]])


def test_the_command_writes_every_launch_and_needs_out(folders: list[Path], tmp_path: Path) -> None:
    sessions = [str(f) for f in folders]
    refused = CliRunner().invoke(main, ["calibrate", *sessions])
    assert refused.exit_code == 2
    assert "--out" in refused.stderr
    out = tmp_path / "mean.json"
    done = CliRunner().invoke(main, ["calibrate", *sessions, "--out", str(out)])
    assert done.exit_code == 0, done.stderr
    back = read_calibration(out)
    assert len(back.evidence.launches) == 3
    assert back.accel is not None
    assert back.gyro is not None
    assert back.parameters[0].run_to_run is not None
    assert "from launch to launch: accel.bias " in done.stdout


def test_a_prior_does_not_average_and_a_group_that_one_launch_lacks_is_left_out(folders: list[Path]) -> None:
    runs = [LaunchRun(session=(s := read_session(f)), calibration=calibrate(s)) for f in folders]
    mean = mean_of_launches(runs)
    fixed = [p for p in mean.parameters if p.prior is not None and "drift" not in p.name]
    for p in fixed:
        assert p.u is not None
        assert p.prior is not None
        least = min(run.calibration[p.name].u or 0.0 for run in runs)
        assert least / np.sqrt(len(runs)) * 0.999 < p.u
        assert p.learned == pytest.approx(max(0.0, 1.0 - (p.u / p.prior) ** 2))
    group = group_name(fixed[0].name)
    kept = [i for i, p in enumerate(runs[0].calibration.parameters) if group_name(p.name) != group]
    whole = runs[0].calibration
    assert whole.covariance is not None
    without = replace(
        whole,
        parameters=tuple(whole.parameters[i] for i in kept),
        covariance=whole.covariance[np.ix_(kept, kept)],
    )
    lacking = mean_of_launches([replace(runs[0], calibration=without), *runs[1:]])
    assert group not in {group_name(p.name) for p in lacking.parameters}
    assert [finding.kept for finding in lacking.groups if finding.name == group] == [False]
    assert any("left out of the mean" in note and group in note for note in lacking.provenance.notes)
    assert lacking.prediction is not None
    assert whole.prediction is not None
    assert lacking.prediction.force_u < 3.0 * whole.prediction.force_u


def test_a_note_stands_once_with_the_launches_it_is_about(runs: list[LaunchRun]) -> None:
    said = [("cold", "rates"), ("rates",), ("cold", "rates")]
    noted = [
        replace(run, calibration=with_fields(run.calibration, notes=notes))
        for run, notes in zip(runs, said, strict=True)
    ]
    assert mean_of_launches(noted).provenance.notes[:2] == ("launch1, launch3: cold", "every launch: rates")


def test_launches_at_other_temperatures_meet_at_their_mean(runs: list[LaunchRun]) -> None:
    def at(run: LaunchRun, celsius: float) -> LaunchRun:
        more = Parameter(name="accel.bias.x.t1", value=1e-3, u=1e-5, unit="m/s^2/K", prior=1e-2, learned=0.99)
        linear = run.calibration.parameters[:21]
        assert run.calibration.covariance is not None
        covariance = np.zeros((22, 22))
        covariance[:21, :21], covariance[21, 21] = run.calibration.covariance[:21, :21], 1e-10
        made = replace(
            run.calibration,
            parameters=(*linear, more),
            covariance=covariance,
            temperature=CalibratedTemperature(reference=celsius),
        )
        return replace(run, calibration=made)

    warm = mean_of_launches([at(runs[0], 10.0), at(runs[1], 30.0)])
    assert warm.reference_temperature == 20.0
    biases = [run.calibration["accel.bias.x"].value for run in runs[:2]]
    assert warm["accel.bias.x"].value == pytest.approx(np.mean(biases))
    spread = np.std([biases[0] + 1e-2, biases[1] - 1e-2], ddof=1)
    assert warm["accel.bias.x"].run_to_run == pytest.approx(spread)


def test_a_registry_is_for_one_session(folders: list[Path]) -> None:
    words = [folders[0], folders[1], "-o", "out.json", "--registry", "r.sqlite"]
    result = CliRunner().invoke(main, ["calibrate", *map(str, words)])
    assert result.exit_code == 2
    assert "--registry: expected one session" in result.stderr


def test_what_launches_do_not_share_is_not_that_of_the_first(runs: list[LaunchRun]) -> None:
    first, second = runs[0], runs[1]
    other = with_fields(
        second.calibration,
        readings={
            kind: replace(each, columns=("a", "b", "c"))
            for kind, each in second.calibration.provenance.readings.items()
        },
        programme="nine",
        temperature=CalibratedTemperature(range=(1.0, 2.0)),
        sample_rate=2.0 * (first.calibration.provenance.sample_rate or 0.0),
    )
    mean = mean_of_launches([replace(first), replace(second, calibration=other)])
    assert (mean.provenance.readings, mean.provenance.programme, mean.temperature.range) == ({}, None, None)
    assert mean.provenance.sample_rate == pytest.approx(1.5 * (first.calibration.provenance.sample_rate or 0.0))
    assert mean_of_launches(runs).provenance.readings == first.calibration.provenance.readings
