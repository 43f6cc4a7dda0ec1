"""Parameter-free moments of an accelerometer array in motion.

The readings y of n accelerometers contain the specific force and the angular acceleration of the body, six unknowns per
sample. What the other n − 6 combinations of readings imply about lever arms (`tumble.inference.array_levers`) depends
on the samples only through the sums of products of

    x = (1, y (n), ω_i ω_j (6), d(ω_i ω_j)/dt (6), d²(ω_i ω_j)/dt² (6), dω/dt (3), f_i f_j (6), df/dt (3))

with the rates ω and the force f from nominal sensors. Derivatives of rates and forces are differences between the
previous and the next sample; those of products follow by the product rule, since products vary twice as fast. In a body
that is shaken, the noise of these combinations differs from sample to sample by orders of magnitude, because forces
change between the instants at which the sensors are read. The sums are therefore kept apart by the mean square of the
residuals of a sample: those of its n − 6 quietest combinations, after regression on the rates.

Integrating the angular acceleration by parts would leave n − 3 combinations; as an unknown of every sample it takes
three of them, but no derivative of a noisy rate is needed: docs/explanation/mathematics.md (12).
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

FEWEST_OF_ARRAY = 7  # accelerometers that determine more than the force and the angular acceleration
SLOWEST = 4.0  # (rad/s)², of |ω|² + |dω/dt|: slower motion does not determine lever arms
SAMPLES_PER_COLUMN = 10  # fewest samples in motion per component of x
CLASSES, QUIETEST = 64, 1e-6  # classes of residual mean square, (m/s²)², each √2 times the one before, from QUIETEST
BATCH_SAMPLES = 2**14
UNEVEN = 0.1  # relative deviation from the usual interval beyond which no derivative is taken
DISAGREEMENT = 0.1  # residual of gyros relative to the rate beyond which one of them is late, or broken
NEAR_EXTREME = 1e-9  # of the range of a sensor: rounding of an extreme reading
_FIRST, _SECOND = np.array(PAIRS).T


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ArrayMoments:
    """Sums (B, c, c) of the products of x (module docstring) over `counts` (B,) samples of each class of noise, SI.

    `columns`: positions of the components of x: one, readings, products, change, bend, turning, forces, jerk."""

    sums: Array
    counts: Array
    columns: dict[str, slice]


def columns_of(sensors: int) -> dict[str, slice]:
    """Return the positions of the components of x for this number of accelerometers."""
    names = ("one", "readings", "products", "change", "bend", "turning", "forces", "jerk")
    edges = np.cumsum([0, 1, sensors, 6, 6, 6, 3, 6, 3]).tolist()
    return {name: slice(*edge) for name, edge in zip(names, pairwise(edges), strict=True)}


def array_moments(
    samples: MotionSamples,
    parts: list[tuple[int, int]],
    blocks: tuple[Block, Block],
    extremes: tuple[Array, Array],
    at_rest: Array,
) -> ArrayMoments | None:
    """Return the moments of an array in motion, None for too few accelerometers or too little motion.

    `parts`: stored samples start … stop − 1 that are used. `blocks`: accelerometers and gyros. `extremes`: smallest and
    largest readings (2, n) of each in the log, SI. `at_rest`: rate (3,) that the gyros read at rest, rad/s."""
    if blocks[0].size < FEWEST_OF_ARRAY:
        return None
    columns = columns_of(blocks[0].size)
    width = columns["jerk"].stop
    total, count = np.zeros((width, width)), 0
    for x in _in_motion(samples, parts, blocks, extremes, at_rest):
        total += x.T @ x
        count += len(x)
    if count < SAMPLES_PER_COLUMN * width:
        return None
    quiet, sums, counts = _quiet_rows(total, columns), np.zeros((CLASSES, width, width)), np.zeros(CLASSES)
    for x in _in_motion(samples, parts, blocks, extremes, at_rest):
        residual = np.maximum(((x @ quiet.T) ** 2).mean(axis=1), QUIETEST)
        noise_class = np.minimum(np.floor(2.0 * np.log2(residual / QUIETEST)), CLASSES - 1)
        for c in np.unique(noise_class).astype(int).tolist():
            members = x[noise_class == c]
            sums[c] += members.T @ members
            counts[c] += len(members)
    return ArrayMoments(sums=sums, counts=counts, columns=columns)


def _quiet_rows(total: Array, columns: dict[str, slice]) -> Array:
    """Return rows (n − 6, c) that give the quietest combinations of the readings after regression on the rates; the
    other six, which vary most, are those of the force and the angular acceleration."""
    read = np.r_[columns["readings"]]
    given = np.r_[columns["one"], columns["products"], columns["change"]]
    regression = np.linalg.lstsq(total[np.ix_(given, given)], total[np.ix_(given, read)], rcond=None)[0]
    spread = total[np.ix_(read, read)] - total[np.ix_(read, given)] @ regression
    quiet = np.linalg.eigh(spread)[1][:, :-6].T
    out = np.zeros((len(quiet), len(total)))
    out[:, read], out[:, given] = quiet, -quiet @ regression.T
    return out


def _in_motion(
    samples: MotionSamples,
    parts: list[tuple[int, int]],
    blocks: tuple[Block, Block],
    extremes: tuple[Array, Array],
    at_rest: Array,
) -> Iterator[Array]:
    """Yield x (m, c) of the moving samples, batch by batch, that are usable and have usable neighbours: those at the
    usual interval whose gyros agree, or, for three gyros, do not repeat a reading."""
    accel, gyro = blocks
    redundant = accel.size - 3
    batches = [(start, first, stop) for start, stop in parts for first in range(start, stop, BATCH_SAMPLES)]
    for start, first, stop in batches:
        around = max(first - 1, start), min(first + BATCH_SAMPLES + 1, stop)
        if around[1] - around[0] <= 2:
            continue
        rates, forces, intervals, spare = samples.read_with_spare(*around)
        readings = sensor_readings(accel, forces, spare[:, :redundant])
        gyro_readings = sensor_readings(gyro, rates, spare[:, redundant:])
        usable = _within(readings, extremes[0]) & _within(gyro_readings, extremes[1])
        usable &= np.abs(intervals / np.median(intervals) - 1.0) < UNEVEN
        if spare.shape[1] > redundant:
            usable &= np.abs(spare[:, redundant:]).max(axis=1) < DISAGREEMENT * np.linalg.norm(rates, axis=1)
        else:
            repeated = np.any(np.diff(rates, axis=0, prepend=np.inf) == 0.0, axis=1)
            usable &= ~repeated & ~np.append(repeated[1:], False)
        rates = rates - at_rest
        span = (0.5 * intervals[:-2] + intervals[1:-1] + 0.5 * intervals[2:])[:, None]
        turning, jerk = ((v[2:] - v[:-2]) / span for v in (rates, forces))
        second = (rates[2:] - 2.0 * rates[1:-1] + rates[:-2]) / (0.5 * span) ** 2
        rate, force = rates[1:-1], forces[1:-1]
        x = [
            np.ones((len(span), 1)),
            readings[1:-1],
            _products(rate, rate),
            _products(rate, turning) + _products(turning, rate),
            _products(rate, second) + 2.0 * _products(turning, turning) + _products(second, rate),
            turning,
            _products(force, force),
            jerk,
        ]
        moves = (rate**2).sum(axis=1) + np.linalg.norm(turning, axis=1) > SLOWEST
        yield np.concatenate(x, axis=1)[moves & usable[:-2] & usable[1:-1] & usable[2:]]


def _products(u: Array, v: Array) -> Array:
    """Return u_i v_j (m, 6) of vectors (m, 3), in the order of PAIRS."""
    return np.asarray(u[:, _FIRST] * v[:, _SECOND])


def sensor_readings(block: Block, vectors: Array, spare: Array) -> Array:
    """Return the readings (m, n) of all sensors from body vectors (m, 3) and spare numbers (m, n − 3)."""
    return np.asarray(vectors @ block.axes.T + spare @ left_null_space(block.axes))


def _within(readings: Array, extremes: Array) -> BoolArray:
    """Return the samples (m,) in which no sensor has its extreme reading, as a clipped sensor has; all sensors along
    one axis may be clipped together."""
    least, most = extremes
    near = NEAR_EXTREME * (most - least)
    return np.asarray(((readings > least + near) & (readings < most - near)).all(axis=1))
