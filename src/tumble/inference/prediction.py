"""Uncertainty of corrected specific force and rate.

Single parameters may be undetermined while their combined effect is not, such as bias, K₂ and asymmetry of an
accelerometer that stood only on faces. The uncertainty of the corrected specific force, averaged over attitudes, is

    u_f² = ⅓ Σ_p mean over directions u of J_p(u) Σ J_p(u)ᵀ                                                     (27)

docs/explanation/mathematics.md (27), with J_p the derivative of the reading of accelerometer p at g u. That of the
corrected rate is defined in the same way, at the rate of the turns of the session.
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
    `at_rate`, rad/s, both of one sensor, averaged over attitudes; None for the rate without gyros."""

    force_u: float
    rate_u: float | None
    at_rate: float | None


def prediction(
    instrument: Instrument, values: Array, covariance: Array, *, gravity: float, rate: float | None
) -> Prediction:
    """Return the uncertainty of corrected readings at specific force `gravity` and a `rate`, rad/s, of an estimate
    (m,), (m, m)."""
    force = _rms(instrument, instrument.accel, values, covariance, (gravity, 0.0))
    if instrument.gyro is None or rate is None:
        return Prediction(force_u=force, rate_u=None, at_rate=None)
    turned = _rms(instrument, instrument.gyro, values, covariance, (gravity, rate))
    return Prediction(force_u=force, rate_u=turned, at_rate=rate)


def _rms(instrument: Instrument, block: Block, values: Array, covariance: Array, at: tuple[float, float]) -> float:
    """Return the root mean square of J Σ Jᵀ over directions, as the trace of Σ times the mean of JᵀJ."""
    (force, rate), size = at, np.ones(FUNCTIONS)
    measured = force if block.kind == "accel" else rate
    size[RATE], size[FORCE], size[PRODUCTS] = rate, force, force**2
    size[OWN_SIZE], size[OWN_CUBE] = measured, measured**3
    D = instrument.derivative(block, values) * size[:, None]
    mean = _mean_square(block.kind, np.ascontiguousarray(block.axes, dtype=float).tobytes())
    return float(np.sqrt(np.mean(np.sum((D @ covariance) * (mean @ D), axis=(1, 2)))))


@lru_cache(maxsize=16)
def _mean_square(kind: SensorKind, axes: bytes) -> Array:
    """Return the mean of β βᵀ (n, 15, 15) over directions of a unit specific force and a unit rate across it."""
    up, block = directions(), Block(kind=kind, axes=np.frombuffer(axes).reshape(-1, 3))
    beta = np.swapaxes(functions(block, up, up[:, [1, 2, 0]]), 0, 1)
    return np.asarray(np.swapaxes(beta, 1, 2) @ beta / len(up))


def directions(count: int = DIRECTIONS) -> Array:
    """Return unit vectors (count, 3) spread evenly over the sphere: a Fibonacci lattice."""
    k = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    across = np.sqrt(1.0 - z**2)
    return np.column_stack([across * np.cos(angle), across * np.sin(angle), z])
