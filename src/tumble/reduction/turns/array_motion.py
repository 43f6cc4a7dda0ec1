"""What the accelerometers of an array read while it is moved: moments that know no parameters.

The readings y of n accelerometers contain the specific force and the angular acceleration of the body, six unknowns of
every sample. What the other n − 6 combinations say of lever arms (`tumble.inference.array_levers`) needs no more of
the samples than the sums of products of

    x = (1, y (n), ω_i ω_j (6), d(ω_i ω_j)/dt (6), d²(ω_i ω_j)/dt² (6), dω/dt (3), f_i f_j (6), df/dt (3))

with the rates ω and the force f that the nominal sensors read. Derivatives of rates and forces are differences between
the samples before and after, and those of products come from them by the product rule, as products vary twice as fast.
In a body that is shaken the noise of these combinations differs from sample to sample by orders of magnitude, since
forces change between the instants at which the sensors are read. So the sums are kept apart by how much is left of a
sample: of its n − 6 quietest directions, once what varies with the rates is taken out.

Had the angular acceleration been integrated by parts, n − 3 combinations would be left; as an unknown of every sample
it takes three of them, and no derivative of a noisy rate is needed: docs/explanation/mathematics.md (12).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tumble.reduction.blocks.motion_samples import MotionSamples
from tumble.sensors.model import Block, left_null_space
from tumble.sensors.parameters import PAIRS
from tumble.units import Array, BoolArray

FEWEST = 7
"""Accelerometers that know something beside the force and the angular acceleration."""
SLOWEST = 4.0
"""(rad/s)²: what moves more slowly says nothing of lever arms."""
MOVED = 10
"""Samples in motion for every part of x: with fewer there is nothing to be had."""
CLASSES, QUIETEST = 64, 1e-6
"""Of the mean square that is left, (m/s²)², each √2 times that before, from QUIETEST on."""
BATCH_SAMPLES = 2**14
UNEVEN = 0.1
"""Intervals that differ by more than this part from the usual one have no derivatives."""
DISAGREE = 0.1
"""Gyros that differ by more than this part of the rate from what they have in common: one is late, or broken."""
NEAR_EXTREME = 1e-9
"""Of the range of a sensor's readings: what rounding makes of an extreme."""
_FIRST, _SECOND = np.array(PAIRS).T


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ArrayMoments:
    """Sums (B, c, c) of the products of x (module docstring) over `counts` (B,) samples of each class of noise, SI."""

    sums: Array
    counts: Array
    columns: dict[str, slice]
    """Where the parts of x stand: one, readings, products, change, bend, turning, forces, jerk."""


def columns_of(sensors: int) -> dict[str, slice]:
    """Where the parts of x stand for so many accelerometers."""
    names = ("one", "readings", "products", "change", "bend", "turning", "forces", "jerk")
    edges = np.cumsum([0, 1, sensors, 6, 6, 6, 3, 6, 3]).tolist()
    return {name: slice(*edge) for name, edge in zip(names, pairwise(edges), strict=True)}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MovedArray:
    """The accelerometers and gyros of an array, the least and the most (2, n) that each of them reads in its log, SI,
    and what the gyros read in the body (3,), rad/s, when nothing moves."""

    accel: Block
    gyro: Block
    accel_extremes: Array
    gyro_extremes: Array
    at_rest: Array


def array_moments(samples: MotionSamples, parts: list[tuple[int, int]], array: MovedArray) -> ArrayMoments | None:
    """The moments of samples start … stop − 1 of every part. None where there are too few accelerometers, or where too
    little moves."""
    if array.accel.size < FEWEST:
        return None
    columns = columns_of(array.accel.size)
    width = columns["jerk"].stop
    whole, count = np.zeros((width, width)), 0
    for x in _in_motion(samples, parts, array):
        whole += x.T @ x
        count += len(x)
    if count < MOVED * width:
        return None
    judge, sums, counts = _quiet(whole, columns), np.zeros((CLASSES, width, width)), np.zeros(CLASSES)
    for x in _in_motion(samples, parts, array):
        left = np.maximum(((x @ judge.T) ** 2).mean(axis=1), QUIETEST)
        of = np.minimum(np.floor(2.0 * np.log2(left / QUIETEST)), CLASSES - 1)
        for c in np.unique(of).astype(int).tolist():
            chosen = x[of == c]
            sums[c] += chosen.T @ chosen
            counts[c] += len(chosen)
    return ArrayMoments(sums=sums, counts=counts, columns=columns)


def _quiet(whole: Array, columns: dict[str, slice]) -> Array:
    """Rows (n − 6, c): what of the readings neither goes with the rates nor belongs to the six directions in which they
    vary most, which are those of the force and the angular acceleration."""
    read = np.r_[columns["readings"]]
    given = np.r_[columns["one"], columns["products"], columns["change"]]
    by = np.linalg.lstsq(whole[np.ix_(given, given)], whole[np.ix_(given, read)], rcond=None)[0]
    spread = whole[np.ix_(read, read)] - whole[np.ix_(read, given)] @ by
    quiet = np.linalg.eigh(spread)[1][:, :-6].T
    out = np.zeros((len(quiet), len(whole)))
    out[:, read], out[:, given] = quiet, -quiet @ by.T
    return out


def _in_motion(samples: MotionSamples, parts: list[tuple[int, int]], array: MovedArray) -> Iterator[Array]:
    """x (m, c) of the samples that move, can be used, and have one before and after that can, batch by batch. Those at
    the usual interval can whose gyros agree, or, of three gyros, repeat nothing."""
    beyond = array.accel.size - 3
    batches = [(start, first, stop) for start, stop in parts for first in range(start, stop, BATCH_SAMPLES)]
    for start, first, stop in batches:
        around = max(first - 1, start), min(first + BATCH_SAMPLES + 1, stop)
        if around[1] - around[0] <= 2:
            continue
        rates, forces, intervals, spare = samples.read_with_spare(*around)
        readings = sensor_readings(array.accel, forces, spare[:, :beyond])
        of_gyros = sensor_readings(array.gyro, rates, spare[:, beyond:])
        usable = _within(readings, array.accel_extremes) & _within(of_gyros, array.gyro_extremes)
        usable &= np.abs(intervals / np.median(intervals) - 1.0) < UNEVEN
        if spare.shape[1] > beyond:
            usable &= np.abs(spare[:, beyond:]).max(axis=1) < DISAGREE * np.linalg.norm(rates, axis=1)
        else:
            repeated = np.any(np.diff(rates, axis=0, prepend=np.inf) == 0.0, axis=1)
            usable &= ~repeated & ~np.append(repeated[1:], False)
        rates = rates - array.at_rest
        span = (0.5 * intervals[:-2] + intervals[1:-1] + 0.5 * intervals[2:])[:, None]
        turning, jerk = ((v[2:] - v[:-2]) / span for v in (rates, forces))
        bent = (rates[2:] - 2.0 * rates[1:-1] + rates[:-2]) / (0.5 * span) ** 2
        inner, force, one = rates[1:-1], forces[1:-1], np.ones((len(span), 1))
        change = _products(inner, turning) + _products(turning, inner)
        bend = _products(inner, bent) + 2.0 * _products(turning, turning) + _products(bent, inner)
        x = one, readings[1:-1], _products(inner, inner), change, bend, turning, _products(force, force), jerk
        moves = (inner**2).sum(axis=1) + np.linalg.norm(turning, axis=1) > SLOWEST
        yield np.concatenate(x, axis=1)[moves & usable[:-2] & usable[1:-1] & usable[2:]]


def _products(u: Array, v: Array) -> Array:
    """u_i v_j (m, 6) of vectors (m, 3), in the order of PAIRS."""
    return np.asarray(u[:, _FIRST] * v[:, _SECOND])


def sensor_readings(block: Block, vectors: Array, spare: Array) -> Array:
    """What every sensor reads (m, n), of vectors in the body (m, 3) and what is spare (m, n − 3)."""
    return np.asarray(vectors @ block.axes.T + spare @ left_null_space(block.axes))


def _within(readings: Array, extremes: Array) -> BoolArray:
    """Samples (m,) in which no sensor reads the least or the most of its log: a clipped sensor does, and all that are
    along one axis may be clipped together."""
    least, most = extremes
    near = NEAR_EXTREME * (most - least)
    return np.asarray(((readings > least + near) & (readings < most - near)).all(axis=1))
