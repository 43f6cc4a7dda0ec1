"""DepthAI and MATLAB's imuSensor, read and applied as their sources have it."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from tumble.export.json_files import part_name

from tests.support.calibrated import calibration
from tumble.export import export_calibration
from tumble.units import Array

TRUE = {"accel": np.array([[0.5, -1.0, 9.7], [9.8, 0.1, 0.0]]), "gyro": np.array([[0.1, -0.2, 0.3], [3.0, 0.0, 1.0]])}


@pytest.mark.parametrize("seed", range(3))
def test_depthais_affine_calibration_takes_readings_to_true_values(seed: int) -> None:
    """ImuCalibrationParams: `noise`, `accelerometer` and `gyroscope`, [A | b] in single precision."""
    made = calibration(seed)
    content = json.loads(export_calibration(made, "depthai").content)
    assert content.keys() == {"comment", "noise", "accelerometer", "gyroscope"}
    assert content["noise"].keys() == {"name", "accelerometer", "gyroscope"}
    assert content["noise"]["gyroscope"]["z"].keys() == {"noiseDensity", "randomWalk", "biasStability"}
    for kind, key in (("accel", "accelerometer"), ("gyro", "gyroscope")):
        model, affine = getattr(made, kind), np.array(content[key], dtype=np.float32).astype(float)
        assert affine.shape == (3, 4)
        raw = model.predict(TRUE[kind])
        np.testing.assert_allclose(raw @ affine[:, :3].T + affine[:, 3], TRUE[kind], atol=3e-6)


def imu_sensor(parameters: dict[str, list[float]], true: Array) -> Array:
    """v = 1/100 M v_true + ConstantBias, of an accelparams or gyroparams."""
    matrix = np.array(parameters["AxesMisalignment"]) / 100.0
    return np.asarray(true @ matrix.T + np.array(parameters["ConstantBias"]))


@pytest.mark.parametrize("seed", range(3))
def test_matlabs_sensor_reads_what_the_device_reads(seed: int) -> None:
    """Accelerometers read gravity less acceleration there, −f, so that the readings have the other sign."""
    made = calibration(seed)
    assert made.accel is not None
    assert made.gyro is not None
    part = json.loads(export_calibration(made, "matlab-imu").content)["A_0007"]
    force, rate = TRUE["accel"], TRUE["gyro"]
    np.testing.assert_allclose(-imu_sensor(part["Accelerometer"], -force), made.accel.predict(force), atol=1e-12)
    np.testing.assert_allclose(imu_sensor(part["Gyroscope"], rate), made.gyro.predict(rate), atol=1e-12)


def test_parts_have_names_that_matlab_takes() -> None:
    for serial in ("A-0007", "7", "№ 5", "", "_x", "a.b c"):
        assert re.fullmatch(r"[A-Za-z]\w*", part_name(serial), flags=re.ASCII)


def test_without_gyros_the_accelerometers_are_written() -> None:
    made = replace(calibration(), gyro=None)
    depthai, matlab = (export_calibration(made, to) for to in ("depthai", "matlab-imu"))
    assert depthai.losses[0] == "gyros: not known, [1 | 0] in this file"
    assert json.loads(depthai.content)["gyroscope"] == np.eye(3, 4).tolist()
    assert json.loads(matlab.content)["A_0007"].keys() == {"Accelerometer"}
