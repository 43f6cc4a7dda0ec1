"""Fit of an estimate: chi-square by group of residuals, and outlying rests and turns.

The distance of a rest or turn from the fit is the fall of chi-square without it, with as many degrees of freedom as it
has residuals. A spoilt one must neither determine a parameter nor hide in the scatter that it causes. Therefore, if one
stands out, the maximum is found with residuals of a Student-t distribution of ν degrees of freedom, as a scale mixture:
the accelerometers of each rest, its gyros, and each turn have the weight

    w = (ν + q)/(ν + χ²)

with q residuals, updated at every linearisation, docs/explanation/mathematics.md (30). Those with a weight below
LEAST_WEIGHT are left out, and the estimate is that of all others with full weight.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy

from tumble.inference.estimate import Fit
from tumble.inference.noise import SCATTER_WORDS, NoiseModel
from tumble.inference.normal_equations import Solution
from tumble.inference.problem import MAGNETIC_ROWS, Problem
from tumble.units import Array, BoolArray

# groups of residuals, with the component of variance of each
GROUPS = {"accelerometers": "accel", "gyro rests": "gyro", "gyro turns": "turn", "velocities of turns": "velocity"}
MAGNETOMETER = "magnetometer"  # group of the readings of a magnetometer
TOTAL = "noise within rests"  # fit of all residuals without scatter
NU = 4.0  # ν: degrees of freedom of a robust fit
LEAST_WEIGHT = 0.1  # weight below which rows are left out
# Probability of the farthest of all rests and turns by chance, below which a robust fit is made. If one turn of
# fourteen spoils the scale of all, it is never beyond 3.9 sigmas.
OUTLIER_PROBABILITY = 0.1
OUTLIER_WEIGHTS = (1e-6, 1e-6, 1e-6, 1e-12, 1e-12)  # by group; a magnetometer near steel errs by 1000 σ
INFORMATIVE_VARIANCE = 0.01  # variance of a residual, relative to its noise, below which a direction has no information
ROUNDING_VARIANCE = 1e-9  # variance, relative to the largest, below which a direction is rounding
LEAST_CHANCE = 1e-300

# For accelerometers at rest (N,), gyros at rest (N,), turns (K,), and the magnetometer at rests (N,) and at nodes
# before links (J,): falls of chi-square, and degrees of freedom. For rows left out, the fall is the chi-square of their
# readings relative to the prediction by all others.
Falls = tuple[list[Array], list[Array]]


def chi_square_falls(solution: Solution) -> Falls:
    """Return by how much chi-square falls without each rest and turn."""
    equations, noise = solution.equations, solution.linearisation.noise
    rest = equations.rest_whitening, solution.rest_residuals, noise.rest_weights
    turn = equations.turn_whitening, solution.turn_residuals, noise.turn_weights
    link = equations.link_whitening, solution.link_residuals, noise.link_weights
    accel, gyro, mag = _rows_of_sensors(solution.problem)
    groups = (*rest, accel), (*rest, gyro), (*turn, slice(None)), (*rest, mag), (*link, MAGNETIC_ROWS)
    falls, counts = list[Array](), list[Array]()
    for W, (residual, covariance), root_weight, rows in groups:
        falls.append(np.zeros(len(W)))
        counts.append(np.zeros(len(W), dtype=np.int64))
        if not W[:, rows].size:
            continue
        back = np.swapaxes(W, 1, 2)
        pull, Q = (back @ residual[:, :, None])[:, rows, 0], (back @ covariance @ W)[:, rows, rows]
        N = np.linalg.inv(back @ W)[:, rows, rows]  # covariance, weights included
        size = np.sqrt(np.diagonal(N, axis1=1, axis2=2))
        variance, directions = np.linalg.eigh(Q * size[:, :, None] * size[:, None, :])
        free = variance > INFORMATIVE_VARIANCE
        square = ((pull * size)[:, None] @ directions)[:, 0] ** 2
        falls[-1], counts[-1] = (square / np.where(free, variance, np.inf)).sum(axis=1), free.sum(axis=1)
        weight = root_weight[:, rows]
        if len(out := np.flatnonzero(weight.min(axis=1) < 1.0)):
            valid = variance[out] > ROUNDING_VARIANCE * variance[out].max(axis=1, keepdims=True)
            spread, along = 1.0 / np.where(valid, variance[out], 1.0), directions[out] * valid[:, None]
            added = N[out] / size[out][:, :, None] / size[out][:, None, :]
            added *= 1.0 - weight[out][:, :, None] * weight[out][:, None, :]
            difference = spread * ((pull[out] * size[out])[:, None] @ along)[:, 0]
            by_others = spread[:, :, None] * np.eye(spread.shape[1]) - np.swapaxes(along, 1, 2) @ added @ along
            falls[-1][out] = (difference * np.linalg.solve(by_others, difference[:, :, None])[:, :, 0]).sum(axis=1)
            counts[-1][out] = valid.sum(axis=1)
    return falls, counts


def _rows_of_sensors(problem: Problem) -> tuple[slice, slice, slice]:
    """Return the rows of accelerometers, gyros and magnetometer at a rest."""
    n = problem.observations.accel_block.size
    last = n + problem.observations.rests.gyro.shape[1] + 3 * (problem.prior.attitude is not None)
    return slice(n), slice(n, n + problem.observations.rests.gyro.shape[1]), slice(last, None)


def student_weights(falls: Falls) -> list[Array]:
    """Return the weights of a Student-t distribution, by group of `Falls`."""
    return [np.minimum((NU + count) / (NU + fall), 1.0) for fall, count in zip(*falls, strict=True)]


def weighted(problem: Problem, noise: NoiseModel, weights: list[Array]) -> NoiseModel:
    """Return the noise with weights by group of `Falls`."""
    rest, turn = np.ones(noise.rest.shape[:2]), np.broadcast_to(np.sqrt(weights[2])[:, None], noise.turn.shape[:2])
    for rows, weight in zip(_rows_of_sensors(problem), (*weights[:2], weights[3]), strict=True):
        rest[:, rows] = np.sqrt(weight)[:, None]
    link = np.ones(noise.link_weights.shape)
    link[:, MAGNETIC_ROWS] = np.sqrt(weights[4])[:, None]
    return noise.weighted(rest, turn, link)


def left_out(problem: Problem, noise: NoiseModel) -> tuple[BoolArray, BoolArray, BoolArray, BoolArray, BoolArray]:
    """Return True, by group of `Falls`, for rows that are left out."""
    accel, gyro, mag = (noise.rest_weights[:, rows] for rows in _rows_of_sensors(problem))
    parts = accel, gyro, noise.turn_weights, mag, noise.link_weights[:, MAGNETIC_ROWS]
    a, g, t, m, n = (np.any(part < LEAST_WEIGHT**0.5, axis=1) for part in parts)
    return a, g, t, m, n


def sigmas(solution: Solution) -> tuple[Array, Array, Array, Array, Array]:
    """Return distances from the fit, by group of `Falls`, as Gaussian sigmas of the same probability.

    The probability is that of Fisher's F, because the scale is estimated from all others."""
    falls, fits, distances = chi_square_falls(solution), chi_squares(solution), list[Array]()
    omitted_parts = left_out(solution.problem, solution.linearisation.noise)
    names = *list(GROUPS)[:3], MAGNETOMETER, MAGNETOMETER
    for fall, count, omitted, name in zip(*falls, omitted_parts, names, strict=True):
        degrees = fits[name].degrees if name in fits else 0.0
        k = np.maximum(count, 1)
        others = np.maximum(degrees - k * max(1, omitted.sum()), 1.0)
        chance = scipy.special.fdtrc(k, others, fall / k)
        distances.append(0.0 - scipy.special.ndtri(0.5 * np.maximum(chance, LEAST_CHANCE)))
    accel, gyro, turn, mag, mag_at_nodes = distances
    return accel, gyro, turn, mag, mag_at_nodes


def chi_squares(solution: Solution) -> dict[str, Fit]:
    """Return the fit of every group of residuals, by name."""
    problem, rest, turn, link = (
        solution.problem, solution.rest_residuals, solution.turn_residuals, solution.link_residuals
    )  # fmt: skip
    v, columns = 6 if problem.instrument.in_velocities else 3, np.arange(turn[0].shape[1])
    accel, gyro, mag = (np.arange(rest[0].shape[1])[rows] for rows in _rows_of_sensors(problem))

    def fit(component: str, *parts: tuple[tuple[Array, Array], Any]) -> Fit:
        return Fit(
            chi_square=sum(float((residual[:, rows] ** 2).sum()) for (residual, _), rows in parts),
            degrees=sum(float(np.diagonal(C, axis1=1, axis2=2)[:, rows].sum()) for (_, C), rows in parts),
            scatter=float(getattr(solution.components, component)),
            unit=SCATTER_WORDS[component][0],
        )

    rows = (rest, accel), (rest, gyro), (turn, np.r_[columns[:3], columns[v:]]), (turn, columns[3:v])
    count = 1 if problem.observations.gyro_block is None else 4 if problem.instrument.in_velocities else 3
    groups = list(zip(GROUPS.items(), rows, strict=True))[:count]
    out = {name: fit(component, part) for (name, component), part in groups}
    if problem.magnetometer is not None:
        out[MAGNETOMETER] = fit("mag", (rest, mag), (link, np.arange(link[0].shape[1])[MAGNETIC_ROWS]))
    return out
