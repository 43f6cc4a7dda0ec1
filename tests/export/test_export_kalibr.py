"""The Kalibr / OpenVINS file, read with PyYAML and applied as OpenVINS documents it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from tests.support.calibrated import FRAMES, calibration
from tests.support.exports import NOISE
from tests.support.shared import calibrated
from tumble.errors import InputError
from tumble.export import export_calibration
from tumble.export.kalibr import noise_densities
from tumble.planning.setup import Setup
from tumble.recording.session_file import read_session
from tumble.reduction.noise.allan_deviation import allan_deviation
from tumble.result.calibration import Calibration
from tumble.result.parts import Launch
from tumble.run.quiet_samples import longest_rest
from tumble.sensors.frames import Frame
from tumble.simulation.session import simulate_session
from tumble.units import Array


def read(made: Calibration) -> dict[str, Any]:
    """imu0 of the file. The first line is OpenCV's, not YAML's."""
    first, _, rest = export_calibration(made, "kalibr", noise=NOISE).content.decode().partition("\n")
    assert first == "%YAML:1.0"
    content: dict[str, Any] = yaml.safe_load(rest)["imu0"]
    return content


def openvins(imu: dict[str, Any], a_m: Array, w_m: Array, b_a: Array, b_g: Array) -> tuple[Array, Array]:
    """Accelerations and rates as OpenVINS corrects them: D = T⁻¹, a = R_ACCtoIMU D_a (a_m − b_a),
    w = R_GYROtoIMU D_w (w_m − b_g − T_g a)."""
    Ta, Tw, Tg = (np.array(imu[name]) for name in ("Ta", "Tw", "Tg"))
    to_imu_a, to_imu_w = np.array(imu["R_IMUtoACC"]).T, np.array(imu["R_IMUtoGYRO"]).T
    a = (to_imu_a @ np.linalg.inv(Ta) @ (a_m - b_a).T).T
    w = (to_imu_w @ np.linalg.inv(Tw) @ (w_m - b_g - a @ Tg.T).T).T
    return a, w


@pytest.mark.parametrize("seed", range(5))
def test_openvins_gets_the_true_vectors(seed: int) -> None:
    made, rng = calibration(seed), np.random.default_rng(seed)
    assert made.accel is not None
    assert made.gyro is not None
    imu = read(made)
    true_a, true_w = 9.8 * rng.standard_normal((50, 3)), rng.standard_normal((50, 3))
    readings = made.accel.predict(true_a), made.gyro.predict(true_w)
    a, w = openvins(imu, *readings, made.accel.bias, made.gyro.bias)
    np.testing.assert_allclose(a, true_a, atol=1e-12)
    np.testing.assert_allclose(w, true_w, atol=1e-13)


@pytest.mark.parametrize("seed", range(3))
def test_both_matrices_are_lower_triangular_and_rotations_are_rotations(seed: int) -> None:
    """What OpenVINS' model "kalibr" takes: it reads the lower triangle only, and fixes R_IMUtoACC at one."""
    imu = read(calibration(seed))
    assert imu["model"] == "kalibr"
    for name in ("Ta", "Tw"):
        matrix = np.array(imu[name])
        np.testing.assert_array_equal(matrix, np.tril(matrix))
        assert (np.diag(matrix) > 0.9).all()
    R = np.array(imu["R_IMUtoGYRO"])
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_array_equal(imu["R_IMUtoACC"], np.eye(3))
    np.testing.assert_array_equal(imu["T_i_b"], np.eye(4))
    np.testing.assert_array_equal(imu["Tg"], np.zeros((3, 3)))


@pytest.mark.parametrize("frame", FRAMES)
def test_the_frame_of_the_calibration_does_not_matter(frame: Frame) -> None:
    one, other = read(calibration()), read(calibration().in_frame(frame))
    for name in ("Ta", "Tw", "R_IMUtoGYRO"):
        np.testing.assert_allclose(one[name], other[name], atol=1e-14)


def test_channels_in_another_order_turn_the_imu_frame() -> None:
    """Channels along Y, Z, X: the IMU's X is the body's Y."""
    axes = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
    made, rng = calibration(accel=axes, gyro=axes), np.random.default_rng(1)
    assert made.accel is not None
    assert made.gyro is not None
    true = rng.standard_normal((20, 3))
    imu = read(made)
    a, w = openvins(imu, made.accel.predict(true), made.gyro.predict(true), made.accel.bias, made.gyro.bias)
    np.testing.assert_allclose(a, w, atol=1e-13)  # one frame for both
    np.testing.assert_allclose(a @ a.T, true @ true.T, atol=1e-12)  # turned, nothing else
    np.testing.assert_allclose(a, true[:, [1, 2, 0]], atol=0.05)


def test_a_left_handed_triad_is_refused() -> None:
    axes = np.diag([1.0, 1.0, -1.0])
    with pytest.raises(InputError, match="expected right-handed accelerometers"):
        export_calibration(calibration(accel=axes, gyro=axes), "kalibr", noise=NOISE)


def test_noise_is_what_the_longest_rest_shows(tmp_path: Path) -> None:
    """White noise: its density times √rate is the standard deviation of the samples, within 10 %. What the record does
    not show is bounded: K as large would still lie below the Allan deviation at every averaging time."""
    request = Setup.of(grade="mems", positions=3, rest=60.0, rate_deg_s=120.0, sample_rate=100.0)
    session = read_session(simulate_session(tmp_path / "session", request, seed=1))
    found, record = noise_densities(session), longest_rest(session)
    assert found.rate == pytest.approx(100.0)
    for densities, samples in ((found.accel, record.accel), (found.gyro, record.gyro)):
        spread = np.std(np.diff(samples, axis=0), axis=0).max() / np.sqrt(2.0)
        assert densities.white * np.sqrt(100.0) == pytest.approx(spread, rel=0.1)
        adev = allan_deviation(samples, 100.0)
        assert densities.walk <= (adev.high * np.sqrt(3.0 / adev.tau)[:, None]).min(axis=0).max() * 1.5


def test_a_calibration_without_gyros_is_refused() -> None:
    with pytest.raises(InputError, match="export to kalibr: expected gyro parameters, found none"):
        export_calibration(replace(calibration(), gyro=None), "kalibr", noise=NOISE)


def test_without_a_session_the_noise_is_that_of_the_calibrations_rests() -> None:
    """The simulated densities, within the scatter of their estimate, and a random walk that bounds the true one, 0."""
    exported = export_calibration(calibrated(Setup.of(grade="mems", positions=12), seed=4), "kalibr")
    content = yaml.safe_load(exported.content.decode().partition("\n")[2])["imu0"]
    assert content["accelerometer_noise_density"] == pytest.approx(1.5e-3, rel=0.25)
    assert content["gyroscope_noise_density"] == pytest.approx(np.deg2rad(0.01), rel=0.25)
    assert 0.0 < content["accelerometer_random_walk"] < 1e-2
    assert content["update_rate"] == 100.0
    assert "largest that the drifts within the rests allow" in exported.losses[-1]


def test_a_mean_of_launches_has_the_noise_of_their_rests() -> None:
    found = calibrated(Setup.of(grade="mems", positions=12), seed=4)
    launch = Launch(parameters=found.parameters, covariance=found.covariance, rests=found.evidence.rests, session="one")
    mean = replace(found, evidence=replace(found.evidence, rests=(), launches=(launch, launch)))
    assert "noise from 24 rests of the calibration" in export_calibration(mean, "kalibr").content.decode()
