"""Stage 2 of the staged method: gyros from rests and turns, by least squares over the rows of `staged_gyro_rows`.

The whole covariance of the rows is the weight. Turns are integrated again about the parameters after every step.
Scatter between rests and of turns is estimated where the residuals need it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tumble.estimation.estimate import (
    SCATTER_PROBABILITY,
    Fit,
    Solution,
    chance_of,
    least_squares,
    scatter_of,
    sigmas,
)
from tumble.estimation.gauss_newton import gauss_newton
from tumble.estimation.methods.staged.accelerometers import Accelerometers
from tumble.estimation.methods.staged.gyro_rows import GyroRows, GyroScatter, gyro_rows
from tumble.reduction.observations import Observations
from tumble.reduction.turns import Turns
from tumble.sensors.model import SensorModel
from tumble.sensors.parameters import limits_of
from tumble.units import Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Gyros:
    """Stage 2: values and their solution, and what the residuals say of rests and turns."""

    values: Array
    model: SensorModel
    solution: Solution
    covariance: Array
    by_accel: Array
    """(m_gyro, m_accel): covariance of the gyro values with the accelerometer values."""
    fits: dict[str, Fit]
    rest_sigmas: Array
    turn_sigmas: Array
    increments: tuple[Array, ...]


def estimate_gyros(observations: Observations, accel: Accelerometers) -> Gyros:
    """The gyros from rests and turns, with scatter of both where the residuals need it."""
    block = observations.gyro_block
    assert block is not None
    values, scatter = observations.start_values(block), GyroScatter()
    values[: block.size] = np.median(observations.rests.gyro, axis=0)
    start = values
    values, turns, increments = _gyros_at(observations, accel, values, scatter)
    for _ in range(2):
        scatter = _found_scatter(observations, accel, turns, values, scatter)
        values, turns, more = _gyros_at(observations, accel, values, scatter)
        increments += more
    rows = gyro_rows(observations, accel, turns, values, scatter)
    covariance = rows.covariance(scatter)
    solution, residual, after = _solved(rows, covariance, limits_of(block.names))
    left = _GyroResiduals(residual=residual, covariance=covariance, after=after)
    return Gyros(
        values=values,
        model=block.model(values),
        solution=solution,
        covariance=solution.covariance,
        by_accel=solution.gain @ np.linalg.solve(np.linalg.cholesky(covariance), rows.with_accel),
        fits=_fits(observations, left, scatter),
        rest_sigmas=_group_sigmas(observations, left, "rests", scatter.rest > 0),
        turn_sigmas=_group_sigmas(observations, left, "turns", scatter.turn > 0),
        increments=(start, *increments),
    )


def _gyros_at(
    observations: Observations, accel: Accelerometers, values: Array, scatter: GyroScatter
) -> tuple[Array, Turns, tuple[Array, ...]]:
    """Gauss–Newton at a given scatter; the turns are integrated again about every new estimate."""
    block = observations.gyro_block
    assert block is not None
    spread = limits_of(block.names)

    def solution_at(at: Array) -> Solution:
        rows = gyro_rows(observations, accel, observations.turns_about(block.model(at)), at, scatter)
        return _solved(rows, rows.covariance(scatter), spread)[0]

    values, increments = gauss_newton(solution_at, values, spread)
    return values, observations.turns_about(block.model(values)), increments


def _solved(rows: GyroRows, covariance: Array, spread: Array) -> tuple[Solution, Array, Array]:
    """The step, the residuals left after it (r,) and their covariance (r, r)."""
    lower = np.linalg.cholesky(covariance)
    whitened = np.asarray(np.linalg.solve(lower, np.column_stack([rows.jacobian, rows.residual])), dtype=float)
    jacobian = whitened[:, :-1]
    solution = least_squares(jacobian, whitened[:, -1], spread)
    left = lower @ (np.eye(len(lower)) - jacobian @ solution.gain)
    return solution, rows.residual - rows.jacobian @ solution.step, left @ left.T


# How well it fits


def _groups(observations: Observations) -> dict[str, tuple[slice, int]]:
    """Rows of the rests and of the turns, and how many belong to one of them."""
    n, k = 3 * len(observations.rests), 0 if observations.turns is None else len(observations.turns)
    return {"rests": (slice(0, n), 3), "turns": (slice(n, n + 2 * k), 2)}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _GyroResiduals:
    """Residuals (r,) after the fit, the covariance (r, r) of the rows, and that of what is left of them."""

    residual: Array
    covariance: Array
    after: Array


def _agreement(left: _GyroResiduals, group: slice) -> tuple[float, float]:
    """Sum of the squared residuals of a group of rows in units of their variances, scaled so that it has the mean
    of a chi-square with the degrees of freedom that are also returned (matched in mean and variance)."""
    scale = np.sqrt(np.diag(left.covariance)[group])
    share = left.after[group, group] / np.outer(scale, scale)
    trace, squares = float(np.trace(share)), float((share**2).sum())
    if trace < 1e-6 or squares == 0.0:
        return 0.0, 0.0
    return float(np.sum((left.residual[group] / scale) ** 2)) * trace / squares, trace**2 / squares


def _found_scatter(
    observations: Observations, accel: Accelerometers, turns: Turns, values: Array, scatter: GyroScatter
) -> GyroScatter:
    """The scatter that explains the residuals of the rests, then that of the turns, where they need one."""
    assert observations.gyro_block is not None
    spread = limits_of(observations.gyro_block.names)
    groups = _groups(observations)
    rows = gyro_rows(observations, accel, turns, values, scatter)

    def agreement(trial: GyroScatter, group: slice) -> tuple[float, float]:
        covariance = rows.covariance(trial)
        _, residual, after = _solved(rows, covariance, spread)
        return _agreement(_GyroResiduals(residual=residual, covariance=covariance, after=after), group)

    def needed(name: str, trial: GyroScatter) -> bool:
        statistic, degrees = agreement(trial, groups[name][0])
        return degrees > 0.5 and chance_of(statistic, degrees) < SCATTER_PROBABILITY

    def excess(name: str, trial: GyroScatter) -> float:
        statistic, degrees = agreement(trial, groups[name][0])
        return statistic - degrees

    rest, turn = scatter.rest, scatter.turn
    noise = float(np.sqrt(np.trace(observations.rests.gyro_covariance, axis1=1, axis2=2).mean()))
    if rest > 0.0 or needed("rests", GyroScatter(rest=0.0, turn=turn)):
        rest = scatter_of(lambda s: excess("rests", GyroScatter(rest=s, turn=turn)), noise)
    if turn > 0.0 or needed("turns", GyroScatter(rest=rest, turn=0.0)):
        angle = float(np.sqrt(np.trace(turns.covariance, axis1=1, axis2=2).mean()))
        turn = scatter_of(lambda s: excess("turns", GyroScatter(rest=rest, turn=s)), angle)
    return GyroScatter(rest=rest, turn=turn)


def _fits(observations: Observations, left: _GyroResiduals, scatter: GyroScatter) -> dict[str, Fit]:
    out = {}
    for name, (group, _) in _groups(observations).items():
        statistic, degrees = _agreement(left, group)
        value, unit = (scatter.rest, "rad/s") if name == "rests" else (scatter.turn, "rad")
        out[f"gyro {name}"] = Fit(chi_square=statistic, degrees=degrees, scatter=value, scatter_unit=unit)
    return out


def _group_sigmas(observations: Observations, left: _GyroResiduals, name: str, scaled: bool) -> Array:
    """How far each rest or turn is from the fit, in sigmas."""
    group, size = _groups(observations)[name]
    scale = np.diag(left.covariance)[group].reshape(-1, size)
    expected = np.diag(left.after)[group].reshape(-1, size) / scale
    squares = left.residual[group].reshape(-1, size) ** 2 / scale
    free = expected.sum(axis=1)
    z = np.sqrt(squares.sum(axis=1) / np.where(free > 1e-3, free, np.inf))
    return sigmas(z, _agreement(left, group)[1], scaled)
