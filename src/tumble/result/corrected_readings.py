"""Specific force and angular rate of readings that a user gives, checked before they are corrected."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tumble.errors import InputError
from tumble.recording.arrays import Temperatures, numbers_of
from tumble.result.correction import true_force, true_rate
from tumble.result.given_temperatures import given_temperatures
from tumble.sensors.compensation import Compensator
from tumble.sensors.model import Block
from tumble.units import Array


def corrected_readings(
    compensator: Compensator,
    accel: npt.ArrayLike,
    gyro: npt.ArrayLike | None,
    *,
    dt: npt.ArrayLike | None,
    temperature: Temperatures | None,
) -> tuple[Array, Array | None]:
    """Specific force and angular rate (..., 3) of readings (..., n), see `Calibration.apply`. Raises InputError."""
    force_readings = _checked(compensator.accel, "accel", accel, dt)
    shape = force_readings.shape[:-1]
    steps, celsius = _intervals(dt, shape), given_temperatures(temperature, compensator, shape)
    flat = force_readings.reshape(-1, compensator.accel.size)
    force = true_force(compensator, flat, dt=steps, temperature=celsius["accel"])
    felt = force.reshape(*shape, 3)
    if gyro is None:
        return felt, None
    rate_readings = _checked(compensator.gyro, "gyro", gyro, dt)
    assert compensator.gyro is not None
    if rate_readings.shape[:-1] != shape and not (compensator.linear and dt is None):
        raise InputError(
            f"gyro readings: expected as many samples as of the accelerometers, {shape}, found the shape "
            f"{rate_readings.shape}"
        )
    turned = rate_readings.reshape(-1, compensator.gyro.size)
    force = force if steps is None else force / steps[:, None]
    rate = true_rate(compensator, turned, force, dt=steps, temperature=celsius["gyro"])
    return felt, rate.reshape(*rate_readings.shape[:-1], 3)


def _checked(block: Block | None, kind: str, given: npt.ArrayLike, dt: npt.ArrayLike | None) -> Array:
    """Readings of a kind of sensors, one number for each sensor and sample."""
    readings = numbers_of(kind, given, increments=dt is not None)
    if block is None:
        raise InputError(f"{kind} readings: expected none, for the calibration has no {kind}, found some")
    sensors = block.size
    if readings.shape[-1:] != (sensors,):
        raise InputError(
            f"{kind} readings: expected {sensors} numbers a sample, one for each sensor of the calibration, found an "
            f"array of shape {readings.shape}"
        )
    return readings


def _intervals(given: npt.ArrayLike | None, shape: tuple[int, ...]) -> Array | None:
    """An interval for each sample, flat; one for all of them is repeated."""
    if given is None:
        return None
    numbers = numbers_of("dt", given)
    if numbers.shape not in ((), shape):
        raise InputError(f"dt: expected a number for each sample, {shape}, found the shape {numbers.shape}")
    if not (numbers > 0.0).all():
        raise InputError(f"dt: expected intervals above 0 s, found {numbers.min():g}")
    return np.ravel(np.broadcast_to(numbers, shape))
