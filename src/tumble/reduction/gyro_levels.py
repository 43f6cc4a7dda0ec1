"""The level of the gyros at rest as a function of the attitude and of time.

A gyro that feels specific force, 0.1 °/s/g in a MEMS unit, reads in every attitude another rate at rest, and one that
warms quickly another one in every rest. Then

    level = b + G f + d t

with the specific force f and time t, −1 … 1 over the log. A stretch in which the accelerometers are quiet and the
gyros steady is a rest, or a turn about the vertical so slow that it is not seen to be one: a turn about any other axis
moves the vertical, and the accelerometers see it. Which it is only the other stretches say. G, and where it takes it d,
are fitted to all of them with the sum of the distances as the measure, which a minority cannot bend, and a stretch off
the level is accepted if the fit to the others predicts its level.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tumble.units import DEGREE, G_STANDARD, Array, BoolArray

USUAL_SENSITIVITY = 1.0 * DEGREE / G_STANDARD
"""rad/s per m/s²: what keeps G small where the attitudes do not show it."""

USUAL_DRIFT = 1.0 * DEGREE
"""rad/s from the middle of a log to its end: what keeps d small."""

LEAST_STRETCHES = 8
LEAST_SHARE = 2.0 / 3.0
LEAST_GAIN = 0.2
"""So many stretches, and this share of them, must follow the function; this share more than follow one level, and
with a drift than without."""

MOST_UNCERTAIN = 2.0
"""Times what a level is: how uncertain a prediction from the other stretches may be."""

Span = tuple[int, int]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class OffLevel:
    """A quiet and steady stretch, blocks first … last − 1 of the file at `place` in the log, in which the gyros read a
    `rate` (3,), rad/s, off their level at rest."""

    place: int
    first: int
    last: int
    rate: Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LevelFunction:
    """G (3, 3), rad/s per m/s², and d (3,), rad/s, and by file the stretches whose level follows them."""

    g_sensitivity: Array
    drift: Array
    accepted: list[list[Span]]

    def without(self, rates: list[Array], force: list[Array], time: list[Array]) -> list[Array]:
        """The rates of blocks with the part of the level taken off that changes."""
        return [
            w - f @ self.g_sensitivity.T - t[:, None] * self.drift for w, f, t in zip(rates, force, time, strict=True)
        ]


def level_function(
    rates: list[Array],
    goes_with: tuple[list[Array], list[Array]],
    rests: list[list[Span]],
    off: list[OffLevel],
    limit: float,
    least: int,
) -> LevelFunction | None:
    """G and d from the mean rates of rests of at least `least` blocks and of stretches off the level, by file, and from
    the forces and times that they go with. None where no function of these explains to `limit` (rad/s) the levels of
    most, or one level does as well."""
    found = [(k, i, j) for k, spans in enumerate(rests) for i, j in spans if j - i >= least]
    stretches = found + [(s.place, s.first, s.last) for s in off]
    if len(stretches) < LEAST_STRETCHES:
        return None
    (force, time), usual = goes_with, np.array([*(3 * [USUAL_SENSITIVITY]), USUAL_DRIFT]) / limit
    cores = [(k, *core(i, j, least)) for k, i, j in stretches]
    level = np.array([rates[k][i:j].mean(axis=0) for k, i, j in cores])
    rows = np.array([[1.0, *(usual * [*force[k][i:j].mean(axis=0), time[k][i:j].mean()])] for k, i, j in cores])
    some, near = rows[:, :1], _near(rows[:, :1], level, limit)
    for more in (rows[:, :4], rows):  # each where it explains more
        follow = _near(more, level, limit)
        if follow.sum() >= max(LEAST_STRETCHES, LEAST_SHARE * len(near), near.sum() + LEAST_GAIN * len(near)):
            some, near = more, follow
    if some.shape[1] == 1:
        return None
    fitted = np.zeros((4, 3))
    fitted[: some.shape[1] - 1] = _least_squares(some[near], level[near], np.ones(int(near.sum())))[1:]
    fitted *= usual[:, None]
    accepted: list[list[Span]] = [[] for _ in rates]
    for n, (k, i, j) in enumerate(stretches):
        if near[n] and (n < len(found) or _predicted(some, level, near, n, limit)):
            accepted[k].append((i, j))
    return LevelFunction(g_sensitivity=fitted[:3].T, drift=fitted[3], accepted=accepted)


def times_of(edges: list[Array]) -> list[Array]:
    """When blocks between these edges are, −1 … 1 over the log, by file."""
    middle = [0.5 * (each[1:] + each[:-1]) for each in edges]
    first, last = min(float(t[0]) for t in middle), max(float(t[-1]) for t in middle)
    return [(2.0 * t - first - last) / max(last - first, 1e-9) for t in middle]


def core(first: int, last: int, window: int) -> Span:
    """The middle of a stretch: without half a window at each end, by which the moving mean that found it blurs the
    turns beside it, and at least without the first and the last quarter, in which a turn may begin slowly."""
    off = max(min(window, last - first - 1) // 2, (last - first) // 4)
    return first + off, last - off


def _near(rows: Array, level: Array, limit: float) -> BoolArray:
    """Which levels (N, 3) are within `limit` of the function with the smallest sum of distances."""
    fitted = _least_distances(rows, level, limit)
    return np.asarray(np.linalg.norm(level - rows @ fitted, axis=1) < limit)


def _least_squares(rows: Array, level: Array, weight: Array) -> Array:
    """Bias, G and d (5, 3), or the first of them, by weighted least squares; rows are scaled so that G and d are 1
    where they are usual, in limits."""
    normal = (rows * weight[:, None]).T @ rows + _usual(rows)
    return np.asarray(np.linalg.solve(normal, (rows * weight[:, None]).T @ level))


def _usual(rows: Array) -> Array:
    """The weight of G and d being of the usual size, and of nothing known of the bias."""
    return np.diag([0.0, 1.0, 1.0, 1.0, 1.0][: rows.shape[1]])


def _least_distances(rows: Array, level: Array, limit: float) -> Array:
    """Bias, G and d (5, 3), or the first of them, with the smallest sum of distances from the levels, distances below
    the tenth part of `limit` squared (weights iterated)."""
    weight = np.ones(len(rows))
    for _ in range(50):
        fitted = _least_squares(rows, level, weight)
        distance = np.linalg.norm(level - rows @ fitted, axis=1)
        before, weight = weight, 0.1 * limit / np.maximum(distance, 0.1 * limit)
        if np.array_equal(weight, before):
            break
    return fitted


def _predicted(rows: Array, level: Array, near: BoolArray, k: int, limit: float) -> bool:
    """Whether the other stretches near the function determine the level of stretch k, and it is there."""
    others = near & (np.arange(len(rows)) != k)
    fitted = _least_squares(rows[others], level[others], np.ones(int(others.sum())))
    normal = rows[others].T @ rows[others] + _usual(rows)
    uncertain = float(rows[k] @ np.linalg.solve(normal, rows[k]))
    distance = float(np.linalg.norm(level[k] - rows[k] @ fitted))
    return uncertain < MOST_UNCERTAIN**2 and distance < limit * math.sqrt(1.0 + uncertain)
