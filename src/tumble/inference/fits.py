"""How well an estimate fits: chi-square by group of residuals, and how far each rest and turn is from the others.

A rest or turn is judged by how much chi-square falls without it, in as many directions as it has residuals. One that is
spoilt must not decide a parameter, and must not hide behind the scatter it makes. So where one stands out the maximum
is taken with Student-t rows of NU degrees of freedom, as a mixture of scales: the rows of a rest's accelerometers, of
its gyros and of a turn have the weight

    w = (ν + q)/(ν + χ²)

each for itself, taken again at every linearisation: docs/explanation/mathematics.md (30). Those whose weight falls
below LEAST_WEIGHT are left out, by number; the estimate is that of all others, which have their whole weight.
"""

from __future__ import annotations

import numpy as np
import scipy

from tumble.inference.estimate import Fit
from tumble.inference.noise import NoiseModel
from tumble.inference.normal_equations import Solution
from tumble.inference.problem import MAGNETIC_ROWS, Problem
from tumble.units import Array, BoolArray

GROUPS = ("accelerometers", "gyro rests", "gyro turns", "velocities of turns")
SCATTER_NAMES = ("accel", "gyro", "turn", "velocity")
SCATTER_UNITS = ("m/s^2", "rad/s", "rad", "m/s")
MAGNETOMETER = "magnetometer"
"""The group of a magnetometer's readings."""
TOTAL = "noise within rests"
"""The name of the fit of everything before any scatter."""
NU = 4.0
"""Degrees of freedom of the rows of a robust fit."""
LEAST_WEIGHT = 0.1
"""A row of less weight is left out."""
STANDS_OUT = 0.1
"""Probability that of all rests and turns, by the scale of the others, one is so far out: where none is, the maximum is
as good as a robust one. One of fourteen turns that spoils that scale is never beyond 3.9 sigmas."""
LEFT_OUT = (1e-6, 1e-6, 1e-6, 1e-12, 1e-12)
"""The weights of what is left out, by group: near steel a magnetometer is thousands of sigmas off."""
FREE = 0.01
"""Of the variance of the noise: directions in which residuals have less say nothing."""
ROUNDED = 1e-9
"""Of the largest: directions of a projector below it are rounding."""
LEAST_CHANCE = 1e-300


Falls = tuple[list[Array], list[Array]]
"""By group of a rest's accelerometers, its gyros (N,), of the turns (K,), and of the magnetometer at rests (N,) and at
the nodes before links (J,): falls of chi-square without each, and the
directions in which it has residuals; of what is left out, the chi-square of its readings about what all others
predict."""


def chi_square_falls(solution: Solution) -> Falls:
    """How far rests and turns are from a fit by what it leaves of its rows."""
    equations, noise = solution.equations, solution.linearisation.noise
    rest = equations.rest_whitening, solution.rest_residuals, noise.rest_weights
    turn = equations.turn_whitening, solution.turn_residuals, noise.turn_weights
    link = equations.link_whitening, solution.link_residuals, noise.link_weights
    accel, gyro, mag = _rows_of_sensors(solution.problem)
    groups = (*rest, accel), (*rest, gyro), (*turn, slice(None)), (*rest, mag), (*link, MAGNETIC_ROWS)
    falls, counts = zip(*(_falls(*group) for group in groups), strict=True)
    return list(falls), list(counts)


def _rows_of_sensors(problem: Problem) -> tuple[slice, slice, slice]:
    """The rows of a rest that are the accelerometers', the gyros' and the magnetometer's."""
    n = problem.observations.accel_block.size
    last = n + problem.observations.rests.gyro.shape[1] + 3 * (problem.prior.attitude is not None)
    return slice(n), slice(n, n + problem.observations.rests.gyro.shape[1]), slice(last, None)


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
    fall, count, weight = (square / np.where(seen, variance, np.inf)).sum(axis=1), seen.sum(axis=1), kept[:, rows]
    if len(out := np.flatnonzero(weight.min(axis=1) < 1.0)):
        some = variance[out] > ROUNDED * variance[out].max(axis=1, keepdims=True)
        spread, along = 1.0 / np.where(some, variance[out], 1.0), directions[out] * some[:, None]
        less = whole[out] / size[out][:, :, None] / size[out][:, None, :]
        less *= 1.0 - weight[out][:, :, None] * weight[out][:, None, :]
        difference = spread * ((pull[out] * size[out])[:, None] @ along)[:, 0]
        of_all = spread[:, :, None] * np.eye(spread.shape[1]) - np.swapaxes(along, 1, 2) @ less @ along
        fall[out] = (difference * np.linalg.solve(of_all, difference[:, :, None])[:, :, 0]).sum(axis=1)
        count[out] = some.sum(axis=1)
    return fall, count


def student_weights(shown: Falls) -> list[Array]:
    """The weights of Student-t rows: of the accelerometers and of the gyros at rest, by rest, of the turns, and of the
    magnetometer at rests and at nodes."""
    return [np.minimum((NU + count) / (NU + fall), 1.0) for fall, count in zip(*shown, strict=True)]


def weighted(problem: Problem, noise: NoiseModel, weights: list[Array]) -> NoiseModel:
    """The noise with weights of the accelerometers and of the gyros at rest, by rest, of the turns, and of the
    magnetometer at rests and at nodes."""
    rest, turn = np.ones(noise.rest.shape[:2]), np.broadcast_to(np.sqrt(weights[2])[:, None], noise.turn.shape[:2])
    for rows, weight in zip(_rows_of_sensors(problem), (*weights[:2], weights[3]), strict=True):
        rest[:, rows] = np.sqrt(weight)[:, None]
    link = np.ones(noise.link_weights.shape)
    link[:, MAGNETIC_ROWS] = np.sqrt(weights[4])[:, None]
    return noise.weighted(rest, turn, link)


def left_out(problem: Problem, noise: NoiseModel) -> tuple[BoolArray, BoolArray, BoolArray, BoolArray, BoolArray]:
    """The rests whose accelerometers, and whose gyros, and the turns that are left out, and the rests and nodes where
    the magnetometer is."""
    accel, gyro, mag = (noise.rest_weights[:, rows] for rows in _rows_of_sensors(problem))
    parts = accel, gyro, noise.turn_weights, mag, noise.link_weights[:, MAGNETIC_ROWS]
    a, g, t, m, n = (np.any(part < LEAST_WEIGHT**0.5, axis=1) for part in parts)
    return a, g, t, m, n


def sigmas(solution: Solution) -> tuple[Array, Array, Array, Array, Array]:
    """How far each rest is from the fit by its accelerometers and by its gyros (N,), each turn (K,), and the
    magnetometer at each rest (N,) and node (J,), as Gaussian sigmas of the same probability: by Fisher's distribution,
    for the scale is that of the others."""
    shown, fits, every = chi_square_falls(solution), chi_squares(solution), list[Array]()
    omitted_parts = left_out(solution.problem, solution.linearisation.noise)
    names = *GROUPS[:3], MAGNETOMETER, MAGNETOMETER
    for fall, count, omitted, name in zip(*shown, omitted_parts, names, strict=True):
        degrees = fits[name].degrees if name in fits else 0.0
        k = np.maximum(count, 1)
        others = np.maximum(degrees - k * max(1, omitted.sum()), 1.0)
        chance = scipy.special.fdtrc(k, others, fall / k)
        every.append(0.0 - scipy.special.ndtri(0.5 * np.maximum(chance, LEAST_CHANCE)))
    accel, gyro, turn, mag, mag_at_nodes = every
    return accel, gyro, turn, mag, mag_at_nodes


def chi_squares(solution: Solution) -> dict[str, Fit]:
    """Chi-square of every group of residuals there is, with the scatter beside the noise."""
    problem = solution.problem
    v, turn = 6 if problem.instrument.in_velocities else 3, np.arange(solution.turn_residuals[0].shape[1])
    accel, gyro, mag = (np.arange(solution.rest_residuals[0].shape[1])[rows] for rows in _rows_of_sensors(problem))
    rest, turns = solution.rest_residuals, solution.turn_residuals
    rows = (rest, accel), (rest, gyro), (turns, np.r_[turn[:3], turn[v:]]), (turns, turn[3:v])
    there = 1 if problem.observations.gyro_block is None else 4 if problem.instrument.in_velocities else 3
    out = dict[str, Fit]()
    for name, component, unit, ((residual, covariance), some) in zip(
        GROUPS[:there], SCATTER_NAMES, SCATTER_UNITS, rows, strict=False
    ):
        out[name] = Fit(
            chi_square=float((residual[:, some] ** 2).sum()),
            degrees=float(np.diagonal(covariance, axis1=1, axis2=2)[:, some].sum()),
            scatter=float(getattr(solution.components, component)),
            unit=unit,
        )
    if problem.magnetometer is not None:
        parts = (rest, mag), (solution.link_residuals, np.arange(solution.link_residuals[0].shape[1])[MAGNETIC_ROWS])
        out[MAGNETOMETER] = Fit(
            chi_square=sum(float((residual[:, some] ** 2).sum()) for (residual, _), some in parts),
            degrees=sum(float(np.diagonal(C, axis1=1, axis2=2)[:, some].sum()) for (_, C), some in parts),
            scatter=float(solution.components.mag),
            unit="",
        )
    return out
