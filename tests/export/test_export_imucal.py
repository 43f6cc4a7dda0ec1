"""The JSON of imucal, applied as the documentation of FerrarisCalibrationInfo has it."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from tests.support.calibrated import calibration
from tumble.export import export_calibration
from tumble.units import DEGREE, Array

KEYS = {"K_a", "R_a", "b_a", "K_g", "R_g", "K_ga", "b_g", "acc_unit", "gyr_unit", "from_acc_unit", "from_gyr_unit"}


def applied(content: dict[str, object], acc: Array, gyr: Array) -> tuple[Array, Array]:
    """acc = R_a⁻¹ K_a⁻¹ (acc − b_a); gyr = R_g⁻¹ K_g⁻¹ (gyr − K_ga acc − b_g)."""
    K_a, R_a, b_a, K_g, R_g, K_ga, b_g = (
        np.array(content[name]) for name in ("K_a", "R_a", "b_a", "K_g", "R_g", "K_ga", "b_g")
    )
    true_acc = (np.linalg.inv(R_a) @ np.linalg.inv(K_a) @ (acc - b_a).T).T
    true_gyr = (np.linalg.inv(R_g) @ np.linalg.inv(K_g) @ (gyr - true_acc @ K_ga.T - b_g).T).T
    return true_acc, true_gyr


@pytest.mark.parametrize("seed", range(5))
def test_imucal_gets_the_true_vectors(seed: int) -> None:
    made, rng = calibration(seed), np.random.default_rng(seed)
    assert made.accel is not None
    assert made.gyro is not None
    content = json.loads(export_calibration(made, "imucal").content)
    assert set(content) == KEYS | {"comment", "cal_type", "_format_version"}
    assert (content["cal_type"], content["_format_version"]) == ("Ferraris", "2.0.0")
    assert (content["from_gyr_unit"], content["gyr_unit"]) == ("deg/s", "deg/s")
    true_acc, true_gyr = 9.8 * rng.standard_normal((50, 3)), rng.standard_normal((50, 3))
    acc, gyr = applied(content, made.accel.predict(true_acc), made.gyro.predict(true_gyr) / DEGREE)
    np.testing.assert_allclose(acc, true_acc, atol=1e-12)
    np.testing.assert_allclose(gyr * DEGREE, true_gyr, atol=1e-13)


def test_scale_is_diagonal_and_the_axes_are_unit_vectors() -> None:
    content = json.loads(export_calibration(calibration(), "imucal").content)
    for K, R in (("K_a", "R_a"), ("K_g", "R_g")):
        np.testing.assert_array_equal(content[K], np.diag(np.diag(content[K])))
        np.testing.assert_allclose(np.linalg.norm(content[R], axis=1), 1.0, atol=1e-15)


def test_the_examples_in_the_comment_are_right() -> None:
    content = json.loads(export_calibration(calibration(), "imucal").content)
    found = re.findall(r"example \w+: ([-\d. e]+) is ([-\d. e]+) ", content["comment"])
    (acc, true_acc), (gyr, true_gyr) = (tuple(np.array(part.split(), dtype=float) for part in pair) for pair in found)
    result = applied(content, acc[None], gyr[None])
    np.testing.assert_allclose(result[0][0], true_acc, atol=1e-9)
    np.testing.assert_allclose(result[1][0], true_gyr, atol=1e-8)
