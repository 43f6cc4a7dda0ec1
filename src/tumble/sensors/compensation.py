"""The inverse of the model: true specific force and rate of the body from the readings of an instrument."""

from __future__ import annotations

import numpy as np

from tumble.sensors.instrument import Instrument, functions
from tumble.sensors.model import Block
from tumble.sensors.parameters import CONSTANT, FORCE, RATE
from tumble.units import Array

FIXED_POINT_STEPS = 3
"""Steps for what is not linear: each leaves the part of 1e-3 or less that the nonlinear terms are of the reading."""


def specific_force(instrument: Instrument, values: Array, readings: Array) -> Array:
    """Specific force (N, 3), m/s², in the body from readings (N, n) of the accelerometers, SI."""
    K = instrument.coefficients(instrument.accel, values)
    return _solved(instrument.accel, K, FORCE, readings, np.zeros((len(readings), 3)))


def angular_rate(instrument: Instrument, values: Array, readings: Array, force: Array) -> Array:
    """Angular rate (N, 3), rad/s, in the body from readings (N, n) of the gyros, SI, and the specific force (N, 3)."""
    assert instrument.gyro is not None
    K = instrument.coefficients(instrument.gyro, values)
    return _solved(instrument.gyro, K, RATE, readings, force)


def _solved(block: Block, K: Array, measured: slice, readings: Array, force: Array) -> Array:
    """The measured vector (N, 3), by fixed-point steps: x ← S⁻¹ (ŷ − b − what is not linear in x)."""
    inverse = np.linalg.pinv(K[:, measured])
    rest = K.copy()
    rest[:, measured], rest[:, CONSTANT] = 0.0, 0.0
    reading = readings - K[:, CONSTANT]
    x = reading @ inverse.T
    if not np.any(rest):
        return np.asarray(x)
    for _ in range(FIXED_POINT_STEPS):
        beta = functions(block, x, np.zeros_like(x)) if measured == FORCE else functions(block, force, x)
        x = (reading - np.einsum("npb,pb->np", beta, rest)) @ inverse.T
    return np.asarray(x)
