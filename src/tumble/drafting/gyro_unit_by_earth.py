"""The unit of gyros that nothing has turned, by the rate of the Earth.

Gyros whose biases are small beside it read the Earth's rate at rest, 15.04 °/h whatever their attitude, and of it about
the vertical as much as the latitude says, or, where the latitude is not known, as much in one attitude as in another.
The biases of others would have to have that length, and follow the attitude as the Earth does.
"""

from __future__ import annotations

import math

import numpy as np

from tumble.earth import EARTH_RATE
from tumble.reduction.observations import Observations
from tumble.units import DEGREE, DEGREE_PER_HOUR

RATES = ("rad/s", "deg/s", "deg/h")
"""Units that are tried. Increments are not: in one of them the usual biases of small gyros are the Earth's rate."""
_NEAR = 0.15
"""Of the Earth's rate: what a reading of it may be off, and how well it must be known."""
_APART = math.cos(20.0 * DEGREE)
"""Cosine between verticals in the body: attitudes that differ."""


def reads_the_earth(observations: Observations, latitude_deg: float | None) -> str | None:
    """How gyros at rest show the rate of the Earth, in words; None where they do not."""
    rests = observations.rests
    if rests.gyro.shape[1] != 3 or rests.accel.shape[1] != 3:
        return None
    up = rests.accel / np.linalg.norm(rests.accel, axis=1, keepdims=True)
    length, about = np.linalg.norm(rests.gyro, axis=1), (rests.gyro * up).sum(axis=1)
    u = np.sqrt(np.trace(rests.gyro_covariance, axis1=1, axis2=2) / 3.0)
    if latitude_deg is not None:
        expected = EARTH_RATE * math.sin(latitude_deg * DEGREE)
        likewise = f"the Earth: {expected / DEGREE_PER_HOUR:.1f} at this latitude"
    elif (up @ up.T).min() < _APART:
        expected, likewise = float(about.mean()), "alike in attitudes that differ"
    else:
        return None
    off = np.max([np.abs(length - EARTH_RATE), np.abs(about - expected), u])
    if off > _NEAR * EARTH_RATE:
        return None
    read, vertical = float(length.mean()) / DEGREE_PER_HOUR, float(about.mean()) / DEGREE_PER_HOUR
    return (
        f"at rest they read {read:.1f} °/h (the Earth: {EARTH_RATE / DEGREE_PER_HOUR:.1f}), {vertical:.1f} about the "
        f"vertical ({likewise}); a guess, right where their biases are below 2 °/h"
    )
