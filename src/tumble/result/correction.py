"""True vectors of readings by the whole model: of samples, of increments, and of a stream in motion.

A linear model is solved at once; what is beyond it by `Compensator`. Increments are divided by their interval,
corrected and multiplied again: the mean over an interval is taken for what the sensor felt in all of it.
"""

from __future__ import annotations

import numpy as np

from tumble.sensors.compensation import Compensator
from tumble.sensors.fixed_point import central_differences
from tumble.sensors.model import SensorModel
from tumble.units import Array

LONGEST_STEP = 3.5
"""Of usual intervals: neighbours on either side that are further apart say nothing of the angular acceleration."""


def corrected(model: SensorModel, readings: Array, dt: Array | None = None) -> Array:
    """True vectors (..., 3) of readings (..., n), SI; with the intervals `dt` (...), s, both are increments. What is
    not finite stays so."""
    with np.errstate(invalid="ignore", over="ignore"):
        if dt is None:
            return model.apply(readings)
        offset = model.bias * np.asarray(dt)[..., None]
        return np.asarray((readings - offset) @ model.inverse().T)


def true_force(
    compensator: Compensator, readings: Array, *, dt: Array | None = None, temperature: Array | None = None
) -> Array:
    """Specific force (N, 3) of readings (N, n), SI, at temperatures (N, n) or (N, 1), °C; with `dt` (N,) both are
    increments."""
    if compensator.linear:
        return corrected(compensator.model("accel"), readings, dt)
    interval = _column(dt)
    return np.asarray(compensator.force(readings / interval, temperature) * interval)


def true_rate(
    compensator: Compensator,
    readings: Array,
    force: Array,
    *,
    dt: Array | None = None,
    temperature: Array | None = None,
) -> Array:
    """Angular rate (N, 3) of readings (N, n) in a specific force (N, 3), m/s², at temperatures (N, n) or (N, 1), °C,
    SI; with `dt` (N,) rate and readings are increments."""
    if compensator.linear:
        return corrected(compensator.model("gyro"), readings, dt)
    interval = _column(dt)
    return np.asarray(compensator.rate(readings / interval, force, temperature) * interval)


def _column(dt: Array | None) -> Array:
    return np.ones(1) if dt is None else dt[:, None]


def at_one_point(compensator: Compensator, readings: Array, rate: Array, time: Array, interval: float) -> Array:
    """Readings (N, n) of accelerometers, m/s², moved to the last one by the rate (N, 3), rad/s, at times (N,), s. Where
    the rate of a sample or of a neighbour is not known, they stay where they are."""
    return compensator.at_one_point(readings, rate, angular_acceleration(rate, time, interval))


def angular_acceleration(rate: Array, time: Array, interval: float) -> Array:
    """ω̇ (N, 3), rad/s², by central differences of the rate (N, 3), one-sided at both ends; not a number where the
    neighbours are too far apart."""
    return central_differences(rate, time, LONGEST_STEP * interval)
