"""Settings in counts, and RealSense's table, by what their consumers do with them, read anew from their sources:

iNav, applyAccelerationZero; Betaflight, alignBoard, applyRotationMatrix, applyAccelerationTrims; M5Unified, getImuData;
SlimeVR, scaleAccelSample and scaleGyroSample; Linux, the meaning of calibbias and calibscale; Intel, check_X."""

from __future__ import annotations

import json
import re
import subprocess
from dataclasses import replace
from math import cos, radians, sin
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from tumble.export.counts import FIRMWARE, board_angles, board_matrix

from tests.support.calibrated import calibration
from tumble.cli import main
from tumble.errors import InputError
from tumble.export import export_calibration
from tumble.result.calibration import Calibration
from tumble.rotation import rotation_matrix
from tumble.sensors.model import SensorModel
from tumble.units import DEGREE, G_STANDARD, Array

NUMBER = r"(-?\d+(?:\.\d+)?)"


def text_of(made: Calibration, to: str, **given: object) -> str:
    return export_calibration(made, to, **given).content.decode()  # type: ignore[arg-type]


def counts_of_true(model: SensorModel, true: Array, per_si: float) -> Array:
    """What the converter gives, not rounded: rounding of the samples is not the settings'."""
    return np.asarray(model.predict(true) * per_si)


def settings(text: str) -> dict[str, str]:
    """`set name = value` of a command line."""
    return dict(re.findall(r"^set (\w+) = (\S+)$", text, re.M))


@pytest.fixture
def made() -> Calibration:
    return calibration(2)


def test_inav_applies_zero_and_gain(made: Calibration) -> None:
    found, per_g = settings(text_of(made, "inav")), 2048.0
    assert made.accel is not None
    true = G_STANDARD * np.random.default_rng(0).standard_normal((50, 3))
    raw = counts_of_true(made.accel, true, per_g / G_STANDARD)
    corrected = np.empty_like(raw)
    for i, axis in enumerate("xyz"):
        zero, gain = int(found[f"acczero_{axis}"]), int(found[f"accgain_{axis}"])
        assert 1 <= gain <= 8192
        corrected[:, i] = (raw[:, i] - zero) * gain / 4096
    off = corrected / per_g * G_STANDARD - true
    diagonal = np.diag(made.accel.matrix)
    angles = np.abs(made.accel.matrix / diagonal[:, None] - np.eye(3)).sum(axis=1).max()
    assert np.abs(off).max() < angles * np.abs(true).max() + 0.5 / per_g * G_STANDARD + np.abs(true).max() / 8192


@pytest.mark.parametrize("angle", [np.zeros(3), np.array([3.0, -7.0, 21.0])])
def test_betaflight_turns_the_board_and_takes_whole_counts_off(made: Calibration, angle: Array) -> None:
    """applyRotationMatrix multiplies by the transposed matrix of buildRotationMatrix; then accZero is taken off."""
    assert made.accel is not None
    turned: Array = np.asarray(made.accel.matrix @ rotation_matrix(angle * DEGREE), dtype=np.float64)
    model = SensorModel(matrix=turned, bias=made.accel.bias)
    text = text_of(replace(made, accel=model), "betaflight", counts=(1024.0, 16.4))
    found = settings(text)
    x, y, z = (radians(int(found[f"align_board_{name}"])) for name in ("roll", "pitch", "yaw"))
    m = [
        [cos(z) * cos(y), -cos(y) * sin(z), sin(y)],
        [sin(z) * cos(x) + sin(x) * cos(z) * sin(y), cos(z) * cos(x) - sin(x) * sin(z) * sin(y), -sin(x) * cos(y)],
        [sin(x) * sin(z) - cos(z) * cos(x) * sin(y), sin(x) * cos(z) + sin(z) * cos(x) * sin(y), cos(y) * cos(x)],
    ]
    *zero, done = (int(number) for number in found["acc_calibration"].split(","))
    assert done == 1
    true = G_STANDARD * np.random.default_rng(1).standard_normal((50, 3))
    raw = counts_of_true(model, true, 1024.0 / G_STANDARD)
    corrected = np.array([[sum(m[k][i] * v[k] for k in range(3)) - zero[i] for i in range(3)] for v in raw])
    off = corrected / 1024.0 * G_STANDARD - true
    left = np.linalg.norm(np.array(m).T @ model.matrix - np.eye(3), ord=2)
    assert left < 0.02 + 3 * 0.5 * DEGREE
    assert np.abs(off).max() < left * np.linalg.norm(true, axis=1).max() + 0.51 / 1024.0 * G_STANDARD


def test_the_angles_of_the_board_are_those_of_the_matrix() -> None:
    for angles in ([0.0, 0.0, 0.0], [10.0, -20.0, 135.0], [-170.0, 45.0, 3.0]):
        turned = board_matrix(np.array(angles) * DEGREE).T
        found = board_angles(SensorModel(matrix=turned.T.copy(), bias=np.zeros(3)))
        np.testing.assert_allclose(board_matrix(found * DEGREE), board_matrix(np.array(angles) * DEGREE), atol=1e-12)


def test_m5unified_takes_offsets_off_in_parts_of_a_count(made: Calibration) -> None:
    offsets = {int(i): int(v) for i, v in re.findall(r"setOffsetData\((\d), (-?\d+)\)", text_of(made, "m5unified"))}
    assert sorted(offsets) == [*range(6)]
    for first, model, per_si in ((0, made.accel, 4096.0 / G_STANDARD), (3, made.gyro, 16.384 / DEGREE)):
        assert model is not None
        raw = model.bias * per_si  # of a sensor whose true value is zero
        left = [(raw[i] * 65536 - offsets[first + i]) / 65536 for i in range(3)]
        assert np.abs(left).max() <= 0.5 / 65536
    assert "setCalibration(0, 0, 0)" in text_of(made, "m5unified")


def test_slimevr_gets_the_true_specific_force(made: Calibration) -> None:
    text = text_of(made, "slimevr")
    rows = {
        name: [float(v) for v in re.findall(NUMBER, rest)] for name, rest in re.findall(r"^\.(\w+) = (.*)$", text, re.M)
    }
    assert made.accel is not None
    assert made.gyro is not None
    true = G_STANDARD * np.random.default_rng(2).standard_normal(3)
    raw = counts_of_true(made.accel, true[None], 2048.0 / G_STANDARD)[0]
    left = [raw[i] - rows["A_B"][i] for i in range(3)]
    found = [sum(rows["A_Ainv"][3 * i + j] * left[j] for j in range(3)) / 2048.0 * G_STANDARD for i in range(3)]
    np.testing.assert_allclose(found, true, atol=1e-5)
    zero = counts_of_true(made.gyro, np.zeros((1, 3)), 16.4 / DEGREE)[0] - rows["G_off"]
    assert np.abs(zero).max() < 1e-4


def test_iio_adds_a_bias_and_multiplies_by_a_scale(made: Calibration) -> None:
    found = {name: float(v) for v, name in re.findall(rf"^echo {NUMBER} > (\w+)$", text_of(made, "iio"), re.M)}
    for name, model, per_si, size in (
        ("accel", made.accel, 2048.0 / G_STANDARD, G_STANDARD),
        ("anglvel", made.gyro, 16.4 / DEGREE, 2.0),
    ):
        assert model is not None
        for i, axis in enumerate("xyz"):
            true = np.zeros(3)
            true[i] = size
            raw = float(counts_of_true(model, true[None], per_si)[0, i])
            shown = (raw + found[f"in_{name}_{axis}_calibbias"]) * found[f"in_{name}_{axis}_calibscale"]
            assert abs(shown / per_si - size) < 0.51 / per_si + 1e-6
    checked = subprocess.run(["sh", "-n"], input=text_of(made, "iio"), text=True, capture_output=True, check=False)
    assert checked.returncode == 0, checked.stderr


def test_realsense_is_a_row_times_a_matrix_less_a_bias(made: Calibration) -> None:
    """check_X: numpy.dot(reading, X[:3]) − X[3], X being scale_and_alignment row by row, then bias."""
    (imu,) = json.loads(text_of(made, "realsense"))["imus"]
    for name, model in (("accelerometer", made.accel), ("gyroscope", made.gyro)):
        assert model is not None
        X = np.array([*imu[name]["scale_and_alignment"], *imu[name]["bias"]]).reshape(4, 3)
        true = np.random.default_rng(3).standard_normal((20, 3))
        corrected = np.array([np.dot(reading, X[:3]) - X[3] for reading in model.predict(true)])
        np.testing.assert_allclose(corrected, true, atol=1e-12)


@pytest.mark.parametrize("to", FIRMWARE)
def test_the_example_in_the_file_is_what_its_numbers_make(made: Calibration, to: str) -> None:
    text = text_of(made, to)
    examples = re.findall(r"example (\w+): reading (.*) becomes (.*); it is (.*) (?:m/s\^2|rad/s)", text)
    assert [kind for kind, *_ in examples] == list(FIRMWARE[to].offset)
    for _, reading, becomes, true in examples:
        near, exact = (np.array([float(v) for v in numbers.split()]) for numbers in (becomes, true))
        assert len(reading.split()) == 3
        assert np.abs(near - exact).max() < 0.2


def test_counts_that_are_none_are_refused(made: Calibration, tmp_path: Path) -> None:
    made.write(tmp_path / "c.json")
    asked = ["export", str(tmp_path / "c.json"), "--to", "inav", "-o", str(tmp_path / "out"), "--counts", "2048"]
    assert "--counts: expected counts a g and a deg/s" in CliRunner().invoke(main, asked).stderr
    with pytest.raises(InputError, match="found it with px4"):
        export_calibration(made, "px4", counts=(2048.0, 16.4))
    with pytest.raises(InputError, match="within 16 bits"):
        export_calibration(made, "inav", counts=(1e9, 16.4))
