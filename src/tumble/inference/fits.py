"""How well an estimate fits: chi-square by group of residuals, and how far each rest and turn is from what the others say.

A rest or turn is judged by how much chi-square falls without it, in as many directions as it has residuals. One that is
spoilt must not decide a parameter, and must not hide behind the scatter it makes. So where one stands out the maximum
is taken with Student-t rows of NU degrees of freedom, as a mixture of scales: the rows of a rest's accelerometers, of
its gyros and of a turn have the weight

    w = (ν + q)/(ν + χ²)

each for itself, taken again at every linearisation. Those whose weight falls below LEAST_WEIGHT are left out, by number;
the estimate is that of all others, which have their whole weight.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from tumble.estimation.estimate import Fit
from tumble.inference.hyperparameters import Components
from tumble.inference.likelihood import Problem
from tumble.inference.maximum import At, Maximum, Status, maximum
from tumble.inference.step import Left, left
from tumble.units import Array, BoolArray

GROUPS = ("accelerometers", "gyro rests", "gyro turns", "velocities of turns")
SCATTER_OF = ("accel", "gyro", "turn", "velocity")
SCATTER_UNITS = ("m/s^2", "rad/s", "rad", "m/s")
TOTAL = "noise within rests"
"""The name of the fit of everything before any scatter."""
NU = 4.0
"""Degrees of freedom of the rows of a robust fit."""
LEAST_WEIGHT = 0.1
"""A row of less weight is left out."""
STANDS_OUT = 4.0
"""Sigmas by the scale of the others: where no rest or turn is further out the maximum is as good as a robust one."""
ROBUST_ROUNDS = 12
"""Maxima with weights at most until these settle."""
SETTLED = 0.02
"""A change of weights that is none."""
LEFT_OUT = 1e-6
"""The weight of what is left out."""
FREE = 0.01
"""Of the variance of the noise: directions in which residuals have less say nothing."""
ROUNDED = 1e-9
"""Of the largest: directions of a projector below it are rounding."""
LEAST_CHANCE = 1e-300


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Residuals:
    """By group of a rest's accelerometers, its gyros (N,) and of the turns (K,): falls of chi-square without each, and
    the directions in which it has residuals; of what is left out, the chi-square of its readings about what all others
    predict."""

    falls: tuple[Array, Array, Array]
    counts: tuple[Array, Array, Array]


def residuals(fitted: Maximum, after: Left | None = None, components: Components | None = None) -> Residuals:
    """How far rests and turns are from the fit, or from that with other components of variance."""
    problem, noise, step = fitted.problem, fitted.at.noise, fitted.best.step
    weights = step.told.weights if components is None else noise.weights(components)
    after = fitted.best.left if after is None else after
    n = problem.observations.accel_block.size
    sensors = n + problem.observations.rests.gyro.shape[1]
    rest_kept, turn_kept = _kept(problem, fitted.at)
    groups = (
        (weights.rest, after.rest, rest_kept, slice(n)),
        (weights.rest, after.rest, rest_kept, slice(n, sensors)),
        (weights.turn, after.turn, turn_kept, slice(None)),
    )
    every = [_falls(*group) for group in groups]
    falls, counts = zip(*every, strict=True)
    return Residuals(falls=falls, counts=counts)


def _kept(problem: Problem, at: At) -> tuple[Array, Array]:
    """Square roots of the weights of single rows."""
    if at.noise.kept is not None:
        return at.noise.kept
    return np.ones(at.noise.rest.shape[:2]), np.ones(at.noise.turn.shape[:2])


def _falls(W: Array, after: tuple[Array, Array], kept: Array, rows: slice) -> tuple[Array, Array]:
    """Of weighted rows (N, r), W being the weights and `after` the whitened residuals with their covariances: falls of
    chi-square, and directions, of some of the rows."""
    if not W[:, rows].size:
        return np.zeros(len(W)), np.zeros(len(W), dtype=np.int64)
    back = np.swapaxes(W, 1, 2)
    pull, Q = (back @ after[0][:, :, None])[:, rows, 0], (back @ after[1] @ W)[:, rows, rows]
    whole = np.linalg.inv(back @ W)[:, rows, rows]  # the covariance of the noise, weights included
    size = np.sqrt(np.diagonal(whole, axis1=1, axis2=2))
    variance, directions = np.linalg.eigh(Q * size[:, :, None] * size[:, None, :])
    seen = variance > FREE
    square = ((pull * size)[:, None] @ directions)[:, 0] ** 2
    fall = (square / np.where(seen, variance, np.inf)).sum(axis=1)
    count = seen.sum(axis=1)
    weight = kept[:, rows]
    for i in np.flatnonzero(weight.min(axis=1) < 1.0):
        some = variance[i] > ROUNDED * variance[i].max()
        along = directions[i][:, some]
        spread = np.diag(1.0 / variance[i][some])
        less = whole[i] * (1.0 - np.outer(weight[i], weight[i])) / np.outer(size[i], size[i])
        own = spread - along.T @ less @ along
        difference = spread @ along.T @ (pull[i] * size[i])
        fall[i], count[i] = difference @ np.linalg.solve(own, difference), len(difference)
    return fall, count


def robust(problem: Problem, first: Maximum) -> Maximum:
    """The maximum without the rests and turns that do not fit; `first` where all do."""
    if not any((sigma > STANDS_OUT).any() for sigma in sigmas(first)):
        return first
    fitted, n = first, problem.observations.accel_block.size
    weights = [np.ones(len(fall)) for fall in residuals(first).falls]
    for _ in range(ROBUST_ROUNDS):
        shown = residuals(fitted)
        new = [(NU + q) / (NU + fall) for fall, q in zip(shown.falls, shown.counts, strict=True)]
        new = [np.minimum(w, 1.0) for w in new]
        change = max((float(np.abs(a - b).max()) for a, b in zip(new, weights, strict=True) if len(a)), default=0.0)
        weights = new
        if change < SETTLED:
            break
        fitted = _weighted(problem, fitted, weights, n)
    out = [w < LEAST_WEIGHT for w in weights]
    if not any(each.any() for each in out):
        return first
    return _weighted(problem, fitted, [np.where(each, LEFT_OUT, 1.0) for each in out], n)


def _weighted(problem: Problem, fitted: Maximum, weights: list[Array], n: int) -> Maximum:
    """The maximum with weights of the accelerometers and gyros at rest, by rest, and of the turns."""
    at = fitted.at
    kept = np.ones(at.noise.rest.shape[:2]), np.ones(at.noise.turn.shape[:2])
    sensors = n + problem.observations.rests.gyro.shape[1]
    kept[0][:, :n], kept[0][:, n:sensors] = np.sqrt(weights[0])[:, None], np.sqrt(weights[1])[:, None]
    kept[1][:] = np.sqrt(weights[2])[:, None]
    return maximum(problem, replace(at, noise=replace(at.noise, kept=kept)), fitted.best.phi)


def left_out(fitted: Maximum) -> tuple[BoolArray, BoolArray, BoolArray]:
    """The rests whose accelerometers, and whose gyros, and the turns that are left out."""
    rest, turn = _kept(fitted.problem, fitted.at)
    n = fitted.problem.observations.accel_block.size
    sensors = n + fitted.problem.observations.rests.gyro.shape[1]
    least = LEAST_WEIGHT**0.5
    by = [np.any(part < least, axis=1) for part in (rest[:, :n], rest[:, n:sensors], turn)]
    return by[0], by[1], by[2]


def sigmas(fitted: Maximum) -> tuple[Array, Array, Array]:
    """How far each rest is from the fit by its accelerometers and by its gyros (N,), and each turn (K,), as Gaussian
    sigmas of the same probability: by Fisher's distribution, for the scale is that of the others."""
    shown, fits, out = residuals(fitted), chi_squares(fitted.problem, fitted.best.left), left_out(fitted)
    every = list[Array]()
    for fall, count, omitted, name in zip(shown.falls, shown.counts, out, GROUPS[:3], strict=True):
        degrees = fits[name].degrees if name in fits else 0.0
        k = np.maximum(count, 1)
        others = np.maximum(degrees - k * max(1, omitted.sum()), 1.0)
        chance = special.fdtrc(k, others, fall / k)
        every.append(0.0 - special.ndtri(0.5 * np.maximum(chance, LEAST_CHANCE)))
    accel, gyro, turn = every
    return accel, gyro, turn


def chi_squares(problem: Problem, after: Left, components: Components | None = None) -> dict[str, Fit]:
    """Chi-square of every group of residuals there is, with the scatter beside the noise."""
    n = problem.observations.accel_block.size
    sensors, v = n + problem.observations.rests.gyro.shape[1], 6 if problem.instrument.in_velocities else 3
    turn = np.arange(after.turn[0].shape[1])
    rows = ((after.rest, np.arange(n)), (after.rest, np.arange(n, sensors)))
    rows += ((after.turn, np.r_[turn[:3], turn[v:]]), (after.turn, turn[3:v]))
    there = 1 if problem.observations.gyro_block is None else 4 if problem.instrument.in_velocities else 3
    out = dict[str, Fit]()
    for name, component, unit, ((residual, covariance), own) in zip(
        GROUPS[:there], SCATTER_OF, SCATTER_UNITS, rows, strict=False
    ):
        out[name] = Fit(
            chi_square=float((residual[:, own] ** 2).sum()),
            degrees=float(np.diagonal(covariance, axis1=1, axis2=2)[:, own].sum()),
            scatter=0.0 if components is None else float(getattr(components, component)),
            scatter_unit=unit,
        )
    return out


def fits(fitted: Maximum) -> Mapping[str, Fit]:
    """The same, and that of everything with the noise within rests alone."""
    alone = fitted.at.solved(fitted.problem, Components())
    every = chi_squares(fitted.problem, left(fitted.problem, alone)).values()
    total = Fit(
        chi_square=sum(each.chi_square for each in every),
        degrees=sum(each.degrees for each in every),
        scatter=0.0,
        scatter_unit="",
    )
    return chi_squares(fitted.problem, fitted.best.left, fitted.components) | {TOTAL: total}


def settled(fitted: Maximum) -> bool:
    """Whether the maximum is one."""
    return fitted.status is Status.converged
