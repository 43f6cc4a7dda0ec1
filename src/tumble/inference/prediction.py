"""How well corrected readings are known: the uncertainty of specific force and rate that an estimate gives.

Single parameters may be open while what they predict together is not: bias, K₂ and asymmetry of an accelerometer that
stood on faces alone. What a user has of a calibration is the corrected specific force in any attitude,

    u_f² = ⅓ Σ_p mean over directions u of J_p(u) Σ J_p(u)ᵀ                                                     (27)

docs/explanation/mathematics.md (27), with J_p the derivative of the reading of accelerometer p at g u; and likewise the
corrected rate, at the rates of the session's turns about any axis, in any attitude.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tumble.sensors.instrument import Instrument, functions
from tumble.sensors.model import Block, SensorKind
from tumble.sensors.parameters import FORCE, FUNCTIONS, OWN_CUBE, OWN_SIZE, PRODUCTS, RATE
from tumble.units import Array

DIRECTIONS = 200


@dataclass(frozen=True, kw_only=True, slots=True)
class Prediction:
    """Standard uncertainties of the corrected specific force at 1 g, m/s², and of the corrected rate, rad/s, at
    `at_rate`, rad/s, both of one sensor, averaged over attitudes; of the rate None without gyros."""

    force_u: float
    rate_u: float | None
    at_rate: float | None


def prediction(
    instrument: Instrument, values: Array, covariance: Array, *, gravity: float, rate: float | None
) -> Prediction:
    """What corrected readings are known to by an estimate (m,), (m, m), at specific force `gravity` and a `rate`."""
    force = _rms(instrument, instrument.accel, values, covariance, (gravity, 0.0))
    if instrument.gyro is None or rate is None:
        return Prediction(force_u=force, rate_u=None, at_rate=None)
    turned = _rms(instrument, instrument.gyro, values, covariance, (gravity, rate))
    return Prediction(force_u=force, rate_u=turned, at_rate=rate)


def _rms(instrument: Instrument, block: Block, values: Array, covariance: Array, at: tuple[float, float]) -> float:
    """The mean of J Σ Jᵀ, at a specific force and a rate, is the trace of Σ and the mean of JᵀJ, of which only the
    functions differ by direction."""
    (force, rate), size = at, np.ones(FUNCTIONS)
    measured = force if block.kind == "accel" else rate
    size[RATE], size[FORCE], size[PRODUCTS] = rate, force, force**2
    size[OWN_SIZE], size[OWN_CUBE] = measured, measured**3
    D = instrument.derivative(block, values) * size[:, None]
    mean = _mean_square(block.kind, np.ascontiguousarray(block.axes, dtype=float).tobytes())
    return float(np.sqrt(np.mean(np.sum((D @ covariance) * (mean @ D), axis=(1, 2)))))


@lru_cache(maxsize=16)
def _mean_square(kind: SensorKind, axes: bytes) -> Array:
    """The mean of β βᵀ (n, 15, 15) over the directions of a specific force of 1 and a rate of 1 across it."""
    up, block = directions(), Block(kind=kind, axes=np.frombuffer(axes).reshape(-1, 3))
    beta = np.swapaxes(functions(block, up, up[:, [1, 2, 0]]), 0, 1)
    return np.asarray(np.swapaxes(beta, 1, 2) @ beta / len(up))


def directions(count: int = DIRECTIONS) -> Array:
    """Unit vectors (count, 3) spread evenly over the sphere: a Fibonacci lattice."""
    k = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    across = np.sqrt(1.0 - z**2)
    return np.column_stack([across * np.cos(angle), across * np.sin(angle), z])
