"""The file of the ROS package imu_calib, read with PyYAML and applied as its class AccelCalib does."""

from __future__ import annotations

import re

import numpy as np
import pytest
import yaml

from tests.support.calibrated import calibration
from tumble.export import export_calibration


@pytest.mark.parametrize("seed", range(5))
def test_the_node_gets_the_true_acceleration(seed: int) -> None:
    """corrected = SM · raw − bias, SM row by row."""
    made, rng = calibration(seed), np.random.default_rng(seed)
    assert made.accel is not None
    content = yaml.safe_load(export_calibration(made, "ros-imu-calib").content)
    assert set(content) == {"SM", "bias"}
    SM, bias = np.array(content["SM"]).reshape(3, 3), np.array(content["bias"])
    true = 9.8 * rng.standard_normal((50, 3))
    np.testing.assert_allclose(made.accel.predict(true) @ SM.T - bias, true, atol=1e-12)


def test_what_is_lost_of_the_gyros_is_its_worst_case() -> None:
    """In the direction where it is largest: |M ω − ω| in 100 deg/s."""
    made = calibration()
    assert made.gyro is not None
    found = re.search(r"([\d.]+) deg/s in 100 deg/s", export_calibration(made, "ros-imu-calib").losses[0])
    assert found is not None
    directions = np.random.default_rng(0).standard_normal((100_000, 3))
    directions *= 100.0 / np.linalg.norm(directions, axis=1)[:, None]
    errors = np.linalg.norm(directions @ (made.gyro.matrix - np.eye(3)).T, axis=1)
    assert float(found[1]) == pytest.approx(errors.max(), rel=0.01)


def test_accelerometers_alone_are_enough() -> None:
    losses = export_calibration(calibration(with_gyro=False), "ros-imu-calib").losses
    assert len(losses) == 1
