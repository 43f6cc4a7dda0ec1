"""Logs of gyros alone, and folders with a file a sensor, in every command."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from tumble import read_calibration
from tumble.cli import main
from tumble.units import Array

BIAS = np.radians([0.5, -0.3, 0.2])
EARTH = 7.292115e-5


def tumble(*words: object) -> Result:
    """A command."""
    return CliRunner().invoke(main, list(map(str, words)))


@pytest.fixture(scope="module")
def read() -> Array:
    """Times and gyros (N, 4), s and rad/s: two rests, and a quarter of a turn about z between them."""
    rng, time = np.random.default_rng(0), np.arange(1, 6001) / 100.0
    rates = BIAS + np.radians(0.01) * np.sqrt(100.0) * rng.standard_normal((len(time), 3))
    rates[(time > 20.0) & (time <= 24.0), 2] += 0.125 * np.pi
    return np.column_stack([time, rates])


def written(file: Path, read: Array, header: str) -> Path:
    """A text of these rows."""
    file.parent.mkdir(exist_ok=True)
    np.savetxt(file, read, delimiter=",", header=header, comments="", fmt="%.8g")
    return file


def test_a_log_of_gyros_has_rests_and_biases_and_says_what_would_give_more(read: Array, tmp_path: Path) -> None:
    log = written(tmp_path / "gyro.csv", read, "t,gx (rad/s),gy (rad/s),gz (rad/s)")
    shown = tumble("inspect", log)
    assert shown.exit_code == 0, shown.output
    rows = [line.split() for line in shown.stdout.splitlines() if line.strip().startswith(("1 ", "2 "))]
    assert len(rows) == 2
    assert [float(word) for word in rows[0][3:]] == pytest.approx(np.degrees(BIAS).tolist(), abs=0.02)
    assert "record the accelerometers beside them" in shown.stdout
    done = tumble("calibrate", log)
    assert done.exit_code == 0, done.output
    assert "accepted" in done.stdout
    assert "`tumble programme`" in " ".join(done.stdout.split())
    made = read_calibration(tmp_path / "gyro.calibration.json")
    for i, x in enumerate("xyz"):
        p = made[f"gyro.bias.{x}"]
        assert abs(p.value - BIAS[i]) < 4.0 * (p.u or 0.0)
        assert (p.u or 0.0) > EARTH / np.sqrt(3.0)
    assert made.accel is None
    assert "gyro.scale.x" in made.outcome.unobservable
    lines = {line.name for line in made.uncertainty_budget("gyro.bias.x")}
    assert {"gyro.noise", "earth", "prior.gyro.g_sensitivity"} <= lines
    _, rate = made.apply(np.zeros((1, 3)), BIAS[None])
    assert rate is not None
    assert np.abs(rate).max() < 1e-3
    parameters = tumble("export", tmp_path / "gyro.calibration.json", "--to", "ardupilot", "-o", tmp_path / "a.parm")
    assert parameters.exit_code == 0
    assert "INS_GYROFFS_X" in (tmp_path / "a.parm").read_text()


def test_a_folder_with_a_file_of_gyros_is_a_log_in_every_command(read: Array, tmp_path: Path) -> None:
    folder = tmp_path / "phone"
    written(folder / "Gyroscope.csv", read, "time,x,y,z")
    for command in ("inspect", "noise", "calibrate"):
        done = tumble(command, folder)
        assert done.exit_code == 0, done.output
    assert (tmp_path / "phone.calibration.json").exists()


def test_a_folder_with_a_file_a_sensor_is_one_recording_in_every_command(read: Array, tmp_path: Path) -> None:
    folder, rng = tmp_path / "phone", np.random.default_rng(1)
    force = np.array([0.0, 0.0, 9.81]) + 0.02 * rng.standard_normal((len(read), 3))
    written(folder / "Gyroscope.csv", read, "time,x,y,z")
    written(folder / "Accelerometer.csv", np.column_stack([read[:, 0], force]), "time,x,y,z")
    shown = tumble("inspect", folder)
    assert shown.exit_code == 0, shown.output
    assert "vertical in the body" in shown.stdout
    assert "one attitude" in tumble("calibrate", folder).stderr
    assert "gyro_x" in tumble("noise", folder).stdout


def test_gyros_that_never_rest_are_refused_in_a_line(read: Array, tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    waved = read.copy()
    waved[:, 1:] += np.cumsum(rng.standard_normal((len(read), 3)), axis=0) * 0.1
    log = written(tmp_path / "gyro.csv", waved, "t,gx (rad/s),gy (rad/s),gz (rad/s)")
    done = tumble("calibrate", log)
    assert done.exit_code == 2
    assert "expected gyros that lie still" in done.stderr
    assert len(done.stderr.splitlines()) == 1
