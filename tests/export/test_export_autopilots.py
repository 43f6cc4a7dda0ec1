"""PX4 and ArduPilot parameter files, parsed by their column layouts and applied as their documentation has it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from tests.support.calibrated import calibration
from tumble.export import export_calibration
from tumble.result.calibration import Calibration
from tumble.result.parts import Parameter
from tumble.rotation import unit_vector
from tumble.sensors.model import SensorModel
from tumble.units import G_STANDARD, Array

NAMES = {
    "px4": ("CAL_ACC0_{}OFF", "CAL_ACC0_{}SCALE", "CAL_GYRO0_{}OFF"),
    "ardupilot": ("INS_ACCOFFS_{}", "INS_ACCSCAL_{}", "INS_GYROFFS_{}"),
}


def parameters(made: Calibration, to: str) -> dict[str, float]:
    """Name and value of every line that is not a comment."""
    out = {}
    for line in export_calibration(made, to).content.decode().splitlines():
        if line.startswith("#"):
            continue
        if to == "px4":
            vehicle, component, name, value, kind = line.split("\t")
            assert (vehicle, component, kind) == ("1", "1", "9")  # MAV_PARAM_TYPE_REAL32
        else:
            name, value = line.split(",")
        assert len(name) <= 16  # what MAVLink has room for
        out[name] = float(np.float32(value))  # as the autopilot keeps it
    return out


def three(values: Mapping[str, float], name: str) -> Array:
    return np.array([values[name.format(axis)] for axis in "XYZ"])


@pytest.mark.parametrize("to", NAMES)
@pytest.mark.parametrize("seed", range(5))
def test_what_the_autopilot_gets_wrong_is_what_is_said_to_be_lost(to: str, seed: int) -> None:
    """(reading − offset) · scale and reading − offset, in every direction of 1 g and of 100 deg/s."""
    made, rng = calibration(seed), np.random.default_rng(seed)
    assert made.accel is not None
    assert made.gyro is not None
    values = parameters(made, to)
    offset, scale, gyro_offset = (three(values, name) for name in NAMES[to])
    assert len(values) == 9
    directions = rng.standard_normal((100_000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    force, rate = G_STANDARD * directions, 100.0 * directions
    force_error = np.linalg.norm((made.accel.predict(force) - offset) * scale - force, axis=1).max()
    rate_error = np.linalg.norm(rate @ made.gyro.matrix.T - rate, axis=1).max()
    text = " ".join(export_calibration(made, to).losses)
    said = re.search(r"error of up to ([\d.]+) m/s\^2", text), re.search(r"([\d.]+) deg/s in 100 deg/s", text)
    assert said[0] is not None
    assert said[1] is not None
    assert float(said[0][1]) == pytest.approx(force_error, rel=0.01)
    assert float(said[1][1]) == pytest.approx(rate_error, rel=0.01)
    np.testing.assert_allclose(made.gyro.predict(np.zeros(3)) - gyro_offset, 0.0, atol=1e-8)


@pytest.mark.parametrize("to", NAMES)
def test_without_cross_terms_nothing_but_single_precision_is_lost(to: str) -> None:
    from dataclasses import replace

    accel = SensorModel(matrix=np.diag([1.01, 0.99, 1.002]), bias=np.array([0.2, -0.1, 0.05]))
    gyro = SensorModel(matrix=np.eye(3), bias=np.array([0.01, 0.02, -0.01]))
    made = replace(calibration(), accel=accel, gyro=gyro)
    values = parameters(made, to)
    offset, scale, gyro_offset = (three(values, name) for name in NAMES[to])
    true = np.array([[0.3, -9.7, 1.0]])
    np.testing.assert_allclose((accel.predict(true) - offset) * scale, true, atol=2e-6)
    np.testing.assert_allclose(gyro.predict(true) - gyro_offset, true, atol=1e-8)
    assert "up to 0 mrad" in " ".join(export_calibration(made, to).losses)


@pytest.mark.parametrize("to", NAMES)
def test_the_example_in_the_file_is_what_the_autopilot_computes(to: str) -> None:
    made = calibration()
    text, values = export_calibration(made, to).content.decode(), parameters(made, to)
    offset, scale, _ = (three(values, name) for name in NAMES[to])
    example = re.search(r"example accel: reading (.*) becomes (.*); it is (.*)", text)
    assert example is not None
    reading, target, true = (np.array(part.split(), dtype=float) for part in example.groups())
    np.testing.assert_allclose((reading - offset) * scale, target, atol=1e-6)
    np.testing.assert_allclose(made.apply(reading)[0], true, atol=1e-6)


def test_px4_is_told_of_corrections_too_small_for_some_releases() -> None:
    made = calibration()
    small = [loss for loss in export_calibration(made, "px4").losses if "releases" in loss]
    assert made.gyro is not None
    assert made.accel is not None
    assert len(small) == 1
    for name, change in (("gyro offsets", made.gyro.bias), ("accelerometer offsets", made.accel.bias)):
        assert (name in small[0]) == (np.linalg.norm(change) <= 0.01)


@pytest.mark.parametrize("to", NAMES)
def test_accelerometers_alone_leave_the_gyros_as_they_are(to: str) -> None:
    assert len(parameters(calibration(with_gyro=False), to)) == 6


# -------------------- magnetometers --------------------


def with_magnetometer(matrix: Array, bias: Array, unit: str) -> Calibration:
    """A calibration with a magnetometer: reading = matrix true + bias, in a unit."""
    made = calibration(1)
    field = Parameter(name="mag.bias.x", value=float(bias[0]), u=0.5, unit=unit)
    assert made.covariance is not None
    covariance = np.pad(made.covariance, (0, 1))
    covariance[-1, -1] = 0.25
    mag = SensorModel(matrix=matrix, bias=bias)
    return replace(made, parameters=(*made.parameters, field), covariance=covariance, mag=mag)


SOFT_IRON = np.array([[1.05, 0.0, 0.0], [0.04, 0.93, 0.0], [-0.06, 0.03, 1.02]])


@pytest.mark.parametrize(("unit", "size"), [("uT", 1.0), ("mgauss", 10.0), ("gauss", 0.01), ("nT", 1e3)])
def test_px4_corrects_the_field_as_its_library_does(unit: str, size: float) -> None:
    """Magnetometer.hpp: scale · (data − offset), scale symmetric, in Gauss."""
    bias = np.array([12.0, -30.0, 7.0]) * size  # in the unit
    values = parameters(with_magnetometer(SOFT_IRON, bias, unit), "px4")
    off, scale, odiag = (three(values, f"CAL_MAG0_{{}}{what}") for what in ("OFF", "SCALE", "ODIAG"))
    S = np.diag(scale) + np.array([[0, odiag[0], odiag[1]], [odiag[0], 0, odiag[2]], [odiag[1], odiag[2], 0]])
    field = 0.48 * unit_vector(np.random.default_rng(0).standard_normal((50, 3)))  # Gauss
    raw = field @ SOFT_IRON.T + bias / size * 0.01
    corrected = (raw - off) @ S
    np.testing.assert_allclose(np.linalg.norm(corrected, axis=1), 0.48, rtol=1e-6)
    turned = np.linalg.lstsq(corrected, field, rcond=None)[0]  # what is left is one rotation
    np.testing.assert_allclose(corrected @ turned, field, atol=1e-6)
    np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-5)


def test_ardupilot_corrects_the_field_as_its_library_does() -> None:
    """AP_Compass_Backend::correct_field: mag += offsets, then COMPASS_SCALE, then a symmetric matrix, in mGauss."""
    bias = np.array([12.0, -30.0, 7.0])  # µT
    values = parameters(with_magnetometer(SOFT_IRON, bias, "uT"), "ardupilot")
    off, diagonal, odi = (three(values, f"COMPASS_{what}_{{}}") for what in ("OFS", "DIA", "ODI"))
    S = np.diag(diagonal) + np.array([[0, odi[0], odi[1]], [odi[0], 0, odi[2]], [odi[1], odi[2], 0]])
    field = 480.0 * unit_vector(np.random.default_rng(0).standard_normal((50, 3)))
    corrected = values["COMPASS_SCALE"] * ((field @ SOFT_IRON.T + 10.0 * bias) + off) @ S
    np.testing.assert_allclose(np.linalg.norm(corrected, axis=1), 480.0, rtol=1e-6)


@pytest.mark.parametrize(
    ("to", "matrix", "bias", "why"),
    [
        ("px4", np.eye(3), np.array([140.0, 0.0, 0.0]), "offsets are 1.4 gauss long, more than 1.3"),
        ("ardupilot", np.eye(3), np.array([190.0, 0.0, 0.0]), "offsets are 1900 mgauss long, more than 1800"),
        ("ardupilot", np.diag([1.0, 1.0, 6.0]), np.zeros(3), "beyond 0.2 to 5"),
        ("px4", np.diag([1.0, 0.3, 1.0]), np.zeros(3), "beyond 0.1 to 3"),
        ("px4", np.diag([1.0, -1.0, 1.0]), np.zeros(3), "left-handed"),
    ],
)
def test_a_magnetometer_beyond_the_limits_of_the_autopilot_is_left_out_and_said(
    to: str, matrix: Array, bias: Array, why: str
) -> None:
    exported = export_calibration(with_magnetometer(matrix, bias, "uT"), to)
    assert not any(p.magnetometer for p in exported.parameters)
    assert "MAG0_XOFF\t" not in exported.content.decode()
    assert "\nCOMPASS_" not in exported.content.decode()
    assert any(why in loss for loss in exported.losses)


def test_the_rows_of_an_export_are_those_of_its_file() -> None:
    for to in ("px4", "ardupilot"):
        made = with_magnetometer(SOFT_IRON, np.ones(3), "uT")
        rows = export_calibration(made, to).parameters
        assert {p.name: float(np.float32(p.value)) for p in rows} == parameters(made, to)
