"""The correction of a calibration, Eq. (1) of `tumble.result.applied_correction`, as `Compensator` computes it.

Increments are divided by their interval, corrected and multiplied again: the mean over an interval is taken for what
the sensor felt in all of it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from tumble.errors import CalibrationError, InputError
from tumble.recording.arrays import Temperatures, celsius_of, check_kinds, numbers_of
from tumble.result.record import CalibrationData
from tumble.sensors.compensation import Compensator
from tumble.sensors.model import Block
from tumble.units import Array


def corrected_readings(
    calibration: CalibrationData,
    accel: npt.ArrayLike,
    gyro: npt.ArrayLike | None,
    *,
    dt: npt.ArrayLike | None,
    temperature: Temperatures | None,
) -> tuple[Array, Array | None]:
    """Specific force and angular rate (..., 3) of readings (..., n), see `Calibration.apply`."""
    judged = (calibration.outcome.accel,) if gyro is None else (calibration.outcome.accel, calibration.outcome.gyro)
    if not any(judged):
        reasons = "; ".join(calibration.outcome.reasons)
        raise CalibrationError(f"calibration: expected accepted accelerometers or gyros, found: {reasons}")
    compensator = calibration.compensator

    def checked(block: Block | None, kind: str, given: npt.ArrayLike) -> Array:
        """One number for each sensor and sample."""
        readings = numbers_of(kind, given, increments=dt is not None)
        if block is None:
            raise InputError(f"{kind} readings: expected none, for the calibration has no {kind}, found some")
        if readings.shape[-1:] != (block.size,):
            raise InputError(
                f"{kind} readings: expected {block.size} numbers a sample, one for each sensor of the calibration, "
                f"found an array of shape {readings.shape}"
            )
        return readings

    force_readings = checked(compensator.accel, "accel", accel)
    shape, interval = force_readings.shape[:-1], np.ones(1)
    if dt is not None:  # an interval for each sample; one for all of them is repeated
        intervals = numbers_of("dt", dt)
        if intervals.shape not in ((), shape):
            raise InputError(f"dt: expected a number for each sample, {shape}, found the shape {intervals.shape}")
        if not (intervals > 0.0).all():
            raise InputError(f"dt: expected intervals above 0 s, found {intervals.min():g}")
        interval = np.ravel(np.broadcast_to(intervals, shape))[:, None]
    celsius = given_temperatures(temperature, compensator, shape)
    force = compensator.force(force_readings.reshape(-1, compensator.accel.size) / interval, celsius["accel"])
    felt = np.full((*shape, 3), np.nan) if calibration.accel is None else (force * interval).reshape(*shape, 3)
    if gyro is None:
        return felt, None
    rate_readings = checked(compensator.gyro, "gyro", gyro)
    assert compensator.gyro is not None
    if rate_readings.shape[:-1] != shape and not (compensator.linear and dt is None):
        raise InputError(
            f"gyro readings: expected as many samples as of the accelerometers, {shape}, found the shape "
            f"{rate_readings.shape}"
        )
    turned = rate_readings.reshape(-1, compensator.gyro.size) / interval
    rate = compensator.rate(turned, force, celsius["gyro"]) * interval
    return felt, rate.reshape(*rate_readings.shape[:-1], 3)


def given_temperatures(
    given: Temperatures | None, compensator: Compensator, shape: tuple[int, ...]
) -> dict[str, Array | None]:
    """Temperatures (N, n) or (N, 1), °C, of the "accel" and "gyro" of samples of a shape (...), N together: of all
    sensors (...), or by kind, (...) or (..., n), K. Raises InputError for others, and for one thermometer where the
    calibration has several."""

    def by_sample(what: str, kelvin: npt.ArrayLike, sensors: int) -> Array:
        numbers = numbers_of(what, kelvin)
        if numbers.shape in ((), shape):
            numbers = np.broadcast_to(numbers, shape)[..., None]
        elif numbers.shape != (*shape, sensors):
            raise InputError(f"{what}: expected a number for each sample, {shape}, found the shape {numbers.shape}")
        return celsius_of(numbers.reshape(-1, numbers.shape[-1]))

    sizes = {block.kind: block.size for block in (compensator.accel, compensator.gyro) if block is not None}
    if given is None:
        return dict.fromkeys(sizes)
    if isinstance(given, Mapping):
        check_kinds(given, sizes)
        return {kind: by_sample(f"temperature of {kind}", given[kind], n) for kind, n in sizes.items()}
    if compensator.several_thermometers:
        raise InputError(
            "temperature: expected those of the thermometers of the calibration by kind of sensors, "
            f"{{{', '.join(f'{kind!r}: …' for kind in sizes)}}}, found one array"
        )
    return dict.fromkeys(sizes, by_sample("temperature", given, 1))
