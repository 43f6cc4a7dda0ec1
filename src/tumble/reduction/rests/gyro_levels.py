"""The gyro level at rest as a function of attitude and time.

A gyro with g-sensitivity, 0.1 °/s/g in a MEMS unit, has another rate at rest in every attitude, and one that warms up
quickly another one in every rest:

    level = b + G f + d t + s (t > t₀)

with the specific force f and time t from −1 to 1 over the log; s is a jump at a time t₀ between two stretches, made by
a driver that measures the bias anew, or by a second device in the log. A stretch with quiet accelerometers and steady
gyros is either a rest or a turn about the vertical (a turn about another axis moves the vertical, which the
accelerometers show), and only the other stretches distinguish the two. G, and d or s where needed, are fitted to all
stretches by the least sum of distances, which is robust against a minority, and a stretch off the level is accepted if
the fit to the others predicts its level.
"""

from __future__ import annotations

import math

import numpy as np

from tumble.reduction.blocks.tuning import Tuning
from tumble.units import Array, BoolArray

Span = tuple[int, int]
OffLevel = dict[Span, Array]
"""Differences (3,), rad/s, of the gyros from their level at rest in quiet, steady stretches, by first block and end."""
_G, _G_AND_DRIFT, _STEP, _G_AND_STEP = [0, 1, 2, 3], [0, 1, 2, 3, 4], [0, 5], [0, 1, 2, 3, 5]
"""Columns of b, G, d, s that are fitted together."""


def _regressors(force: Array, time: Array, step_at: float) -> Array:
    """Return 1, f, t, and 1 after the jump (N, 6), of which the level is a linear function."""
    return np.column_stack([np.ones(len(time)), force, time, time > step_at])


def level_function(
    rate: Array,
    force: Array,
    time: Array,
    rests: list[Span],
    off: OffLevel,
    limit: float,
    window: int,
    tuning: Tuning,
) -> tuple[Array, list[Span], float, Array] | None:
    """Fit G, d and s to the gyro levels of rests of at least a window and of stretches off the level.

    `rate`, `force`, `time`: block means (K, 3) of the rate, rad/s, and of the specific force, m/s², and times (K,),
    −1 … 1. `limit`: largest distance, rad/s, of a level that follows the function. `window`: in blocks. Return the rate
    less the part of the level that changes, the stretches whose level follows the function, t₀, infinite without a
    jump, and s (3,); None if no function explains the levels of most stretches, or if a constant explains them all."""
    at_level = [(i, j) for i, j in rests if j - i >= window]
    stretches = at_level + list(off)
    if len(stretches) < tuning.level_attitudes:
        return None
    cores = [slice(*core(i, j, window)) for i, j in stretches]
    level, f, t = (np.array([x[span].mean(axis=0) for span in cores]) for x in (rate, force, time))
    usual = np.array([limit, *3 * [tuning.g_sensitivity], tuning.level_drift, tuning.level_drift]) / limit
    in_order = np.sort(t)[tuning.beside_jump - 1 : len(t) + 1 - tuning.beside_jump]
    steps = 0.5 * (in_order[1:] + in_order[:-1]) if len(off) >= tuning.beside_jump else ()  # one may be a turn
    columns, step_at, rows = [0], np.inf, np.ones((len(t), 1))
    stepless = fits = _fits(rows, level, limit)
    if fits.all():
        return None
    with_step = ((trial, float(step)) for step in steps for trial in (_STEP, _G_AND_STEP))
    for trial, step in [(_G, np.inf), (_G_AND_DRIFT, np.inf), *with_step]:
        trial_rows = (usual * _regressors(f, t, step))[:, trial]
        trial_fits = _fits(trial_rows, level, limit)
        fewest = tuning.level_attitudes if trial == _G else tuning.level_stretches
        share, gain = tuning.level_share * len(level), stepless.sum() + tuning.level_gain * len(level)
        if trial_fits.sum() >= max(fewest, share, gain) and trial_fits.sum() > fits.sum():
            columns, step_at, rows, fits = trial, step, trial_rows, trial_fits
            stepless = fits if step == np.inf else stepless
    if columns == [0]:
        return None
    accepted = list[Span]()
    is_sparse = len(stretches) < tuning.level_stretches  # each stretch then has a large influence on the fit
    for n, stretch in enumerate(stretches):
        accept = bool(fits[n])
        if accept and (is_sparse or n >= len(at_level)):  # do the others determine its level, and is it there?
            others = fits & (np.arange(len(fits)) != n)
            predicted, normal = _least_squares(rows[others], level[others])
            leverage = float(rows[n] @ np.linalg.solve(normal, rows[n]))
            distance = float(np.linalg.norm(level[n] - rows[n] @ predicted))
            accept = leverage < tuning.level_uncertainty**2 and distance < limit * math.sqrt(1.0 + leverage)
        if accept:
            accepted.append(stretch)
        elif is_sparse:
            return None
    coefficients = np.zeros((6, 3))
    coefficients[columns] = usual[columns, None] * _least_squares(rows[fits], level[fits])[0]
    coefficients[0] = 0.0
    return rate - _regressors(force, time, step_at) @ coefficients, accepted, step_at, coefficients[5]


def core(first: int, last: int, window: int) -> Span:
    """Return the middle of a stretch, without half a window at each end, which the turns beside it blur, and without at
    least a quarter of the stretch, in which a turn may begin slowly."""
    cut = max(min(window, last - first - 1) // 2, (last - first) // 4)
    return first + cut, last - cut


def _fits(rows: Array, level: Array, limit: float) -> BoolArray:
    """Return which levels (N, 3) are within `limit` of the function with the smallest sum of distances, by iteratively
    reweighted least squares; distances below a tenth of `limit` count quadratically."""
    weight = np.ones(len(rows))
    for _ in range(50):
        distance = np.linalg.norm(level - rows @ _least_squares(rows, level, weight)[0], axis=1)
        previous, weight = weight, 0.1 * limit / np.maximum(distance, 0.1 * limit)
        if np.array_equal(weight, previous):
            break
    return np.asarray(distance < limit)


def _least_squares(rows: Array, level: Array, weight: Array | float = 1.0) -> tuple[Array, Array]:
    """Return weighted least-squares coefficients (p, 3) of rows (N, p), and the normal matrix (p, p).

    The rows are scaled so that all coefficients but the bias, whose prior is flat, have prior standard deviation 1."""
    weighted = np.broadcast_to(weight, len(rows))[:, None] * rows
    normal = weighted.T @ rows + np.diag([0.0, *(rows.shape[1] - 1) * [1.0]])
    return np.asarray(np.linalg.solve(normal, weighted.T @ level)), normal
