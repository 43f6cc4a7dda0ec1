"""Several launches of one device: the mean, its uncertainty, and what is common to all launches."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tumble.calibration.calibrate import calibrate
from tumble.calibration.calibration_file import read_calibration
from tumble.calibration.launches import Run, mean_of_launches
from tumble.cli import main
from tumble.errors import InputError
from tumble.planning.setup import Setup
from tumble.recording.session import read_session
from tumble.simulation.session import simulate_session

REQUEST = Setup.of(rest=10.0, sample_rate=50.0)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    base = tmp_path_factory.mktemp("launches")
    return [simulate_session(base / f"launch{i}", REQUEST, seed=11, launch=i) for i in (1, 2, 3)]


@pytest.fixture(scope="module")
def runs(folders: list[Path]) -> list[Run]:
    return [Run(session=(s := read_session(f)), calibration=calibrate(s, terms="linear")) for f in folders]


def test_the_mean_and_the_run_to_run_deviation_are_those_of_the_launches(runs: list[Run]) -> None:
    mean = mean_of_launches(runs)
    for parameter in mean.parameters:
        values = [run.calibration[parameter.name].value for run in runs]
        assert parameter.value == pytest.approx(np.mean(values), rel=1e-12, abs=1e-18)
        assert parameter.run_to_run == pytest.approx(np.std(values, ddof=1), rel=1e-9, abs=1e-18)
    assert [launch.session for launch in mean.launches] == ["launch1", "launch2", "launch3"]


def test_the_mean_agrees_with_the_truth_within_its_uncertainty(runs: list[Run], folders: list[Path]) -> None:
    mean = mean_of_launches(runs)
    truth = json.loads((folders[0] / "truth.json").read_text())
    z = np.array([(p.value - truth[p.name]) / p.u for p in mean.parameters if p.u])
    assert len(z) == 21
    assert np.abs(z).max() < 5.5
    assert 0.3 < np.sqrt(np.mean(z**2)) < 1.7


def test_the_uncertainty_of_gravity_does_not_average_out(runs: list[Run]) -> None:
    doubtful = [
        Run(
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


def test_launches_of_another_device_or_the_same_log_twice_are_refused(runs: list[Run], tmp_path: Path) -> None:
    other = read_session(simulate_session(tmp_path / "other", REQUEST, seed=12))
    with pytest.raises(InputError, match="expected a launch of device"):
        mean_of_launches([runs[0], Run(session=other, calibration=calibrate(other, terms="linear"))])
    with pytest.raises(InputError, match="same log"):
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
    assert len(back.launches) == 3
    assert back.accel is not None
    assert back.gyro is not None
    assert back.parameters[0].run_to_run is not None
    assert "run to run" in done.stdout
