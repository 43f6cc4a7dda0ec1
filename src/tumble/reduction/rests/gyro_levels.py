"""The level of the gyros at rest as a function of the attitude and of time.

A gyro that feels specific force, 0.1 °/s/g in a MEMS unit, reads another rate at rest in every attitude, and one that
warms quickly another one in every rest. Then

    level = b + G f + d t + s (t > t₀)

with the specific force f and time t, −1 … 1 over the log; s is the jump of a driver that measures the bias anew during
a log, or of a second device in it, at a time t₀ between two stretches. A stretch in which the accelerometers are quiet
and the gyros steady is a rest, or a turn about the vertical: a turn about any other axis moves the vertical, which the
accelerometers see. Only the other stretches tell the two apart. G, and d or s where they are needed, are fitted to all
stretches by the least sum of distances, which a minority cannot bend, and a stretch off the level is accepted if the
fit to the others predicts its level.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tumble.reduction.blocks.tuning import Tuning
from tumble.units import Array, BoolArray

Span = tuple[int, int]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class OffLevel:
    """A quiet and steady stretch in which the gyros are off their level at rest by a `rate` (3,), rad/s: blocks
    first … last − 1 of the file at `place` in the log."""

    place: int
    first: int
    last: int
    rate: Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LevelFunction:
    """The level of the gyros as a function of force and time.

    `g_sensitivity`: G (3, 3), rad/s per m/s². `drift`, `step`, `step_at`: d and s (3,), rad/s, and the time t₀ of
    the step, −1 … 1. `accepted`: by file the stretches whose level follows the function."""

    g_sensitivity: Array
    drift: Array
    step: Array
    step_at: float
    accepted: list[list[Span]]

    def without(self, rates: list[Array], force: list[Array], time: list[Array]) -> list[Array]:
        """The rates of blocks without the part of the level that changes."""
        return [
            w - f @ self.g_sensitivity.T - t[:, None] * self.drift - (t > self.step_at)[:, None] * self.step
            for w, f, t in zip(rates, force, time, strict=True)
        ]


_G, _G_AND_DRIFT, _STEP, _G_AND_STEP = [0, 1, 2, 3], [0, 1, 2, 3, 4], [0, 5], [0, 1, 2, 3, 5]
"""The columns of b, G, d, s that are tried together."""


def level_function(
    rates: list[Array],
    force_and_time: tuple[list[Array], list[Array]],
    rests: list[list[Span]],
    off: list[OffLevel],
    limit: float,
    least: int,
    tuning: Tuning,
) -> LevelFunction | None:
    """Fit G, d and s to the levels of rests of at least `least` blocks and of stretches off the level.

    `rates`, `force_and_time`: by file the block means (K, 3) of the rate, rad/s, and those of the specific force,
    m/s², with their times (K,), −1 … 1. `limit`: largest distance, rad/s, from a level that follows the function. None
    where no function explains the levels of most stretches, or where one level does as well."""
    of_rests = [(k, i, j) for k, spans in enumerate(rests) for i, j in spans if j - i >= least]
    stretches = of_rests + [(s.place, s.first, s.last) for s in off]
    if len(stretches) < tuning.level_attitudes:
        return None
    (force, time), sizes = force_and_time, [*(3 * [tuning.g_sensitivity]), tuning.level_drift, tuning.level_drift]
    usual = np.array(sizes) / limit
    cores = [(k, *core(i, j, least)) for k, i, j in stretches]
    level = np.array([rates[k][i:j].mean(axis=0) for k, i, j in cores])
    at = np.array([time[k][i:j].mean() for k, i, j in cores])
    rows = np.array(
        [[1.0, *(usual * [*force[k][i:j].mean(axis=0), t, 0.0])] for (k, i, j), t in zip(cores, at, strict=True)]
    )

    def explains_more(columns: list[int], follow: BoolArray, near: BoolArray) -> bool:
        """Whether enough more stretches follow a function of these columns than follow the one before it."""
        least = tuning.level_attitudes if columns == _G else tuning.level_stretches
        share, gain = tuning.level_share * len(near), near.sum() + tuning.level_gain * len(near)
        return bool(follow.sum() >= max(least, share, gain))

    used, near, step_at = [0], _near(rows[:, :1], level, limit), np.inf
    if near.all():
        return None
    in_order = np.sort(at)[tuning.beside_jump - 1 : len(at) + 1 - tuning.beside_jump]
    steps = 0.5 * (in_order[1:] + in_order[:-1]) if len(off) >= tuning.beside_jump else ()  # else a level of every rest
    stepless, candidates = near, [(_G, np.inf), (_G_AND_DRIFT, np.inf)]
    for columns, step in [*candidates, *((columns, step) for step in steps for columns in (_STEP, _G_AND_STEP))]:
        rows[:, 5] = usual[4] * (at > step)
        follow = _near(rows[:, columns], level, limit)
        if explains_more(columns, follow, stepless) and follow.sum() > near.sum():
            used, near, step_at = columns, follow, step
            stepless = follow if step == np.inf else stepless
    rows[:, 5] = usual[4] * (at > step_at)
    if used == [0]:
        return None
    some, fitted = rows[:, used], np.zeros((6, 3))
    fitted[used] = _least_squares(some[near], level[near])[0]
    fitted[1:] *= usual[:, None]
    accepted: list[list[Span]] = [[] for _ in rates]
    few = len(stretches) < tuning.level_stretches  # of which each bends the function to itself
    for n, (k, i, j) in enumerate(stretches):
        follows = bool(near[n])
        if follows and (few or n >= len(of_rests)):  # whether the others determine its level, and it is there
            others = near & (np.arange(len(near)) != n)
            predicted, normal = _least_squares(some[others], level[others])
            uncertain = float(some[n] @ np.linalg.solve(normal, some[n]))
            distance = float(np.linalg.norm(level[n] - some[n] @ predicted))
            follows = uncertain < tuning.level_uncertainty**2 and distance < limit * math.sqrt(1.0 + uncertain)
        if follows:
            accepted[k].append((i, j))
        elif few:
            return None
    return LevelFunction(
        g_sensitivity=fitted[1:4].T, drift=fitted[4], step=fitted[5], step_at=float(step_at), accepted=accepted
    )


def times_of(edges: list[Array]) -> list[Array]:
    """The times of the blocks between these edges, −1 … 1 over the log, by file."""
    middle = [0.5 * (each[1:] + each[:-1]) for each in edges]
    first, last = min(float(t[0]) for t in middle), max(float(t[-1]) for t in middle)
    return [(2.0 * t - first - last) / max(last - first, 1e-9) for t in middle]


def core(first: int, last: int, window: int) -> Span:
    """The middle of a stretch, without half a window at each end, into which the moving mean blurs the turns beside it,
    and at least without the first and last quarter, in which a turn may begin slowly."""
    off = max(min(window, last - first - 1) // 2, (last - first) // 4)
    return first + off, last - off


def _near(rows: Array, level: Array, limit: float) -> BoolArray:
    """The levels (N, 3) within `limit` of the function with the smallest sum of distances, distances below a tenth of
    `limit` squared, by iterated weights."""
    weight = np.ones(len(rows))
    for _ in range(50):
        distance = np.linalg.norm(level - rows @ _least_squares(rows, level, weight)[0], axis=1)
        before, weight = weight, 0.1 * limit / np.maximum(distance, 0.1 * limit)
        if np.array_equal(weight, before):
            break
    return np.asarray(distance < limit)


def _least_squares(rows: Array, level: Array, weight: Array | float = 1.0) -> tuple[Array, Array]:
    """Coefficients (p, 3) of rows (N, p) by weighted least squares, and the normal matrix (p, p). Rows are scaled so
    that all coefficients but the bias, whose prior is flat, have prior standard deviations of 1, in limits."""
    weighted = np.broadcast_to(weight, len(rows))[:, None] * rows
    normal = weighted.T @ rows + np.diag([0.0, *(rows.shape[1] - 1) * [1.0]])
    return np.asarray(np.linalg.solve(normal, weighted.T @ level)), normal
