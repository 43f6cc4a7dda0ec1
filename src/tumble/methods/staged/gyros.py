"""Stage 2 of the staged method: gyros from rests and turns, by least squares over the rows of `staged_gyro_rows`.

The whole covariance of the rows is the weight. Turns are integrated again about the parameters after every step.
Scatter between rests and of turns is estimated where the residuals need it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tumble.inference.estimate import Fit, Solution, least_squares
from tumble.methods.agreement import Residuals, explaining
from tumble.methods.gauss_newton import gauss_newton
from tumble.methods.staged.accelerometers import Accelerometers
from tumble.methods.staged.gyro_rows import GyroRows, GyroScatter, gyro_rows
from tumble.reduction.observations import Observations
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


_GROUPS = {"rests": ("rest", "rad/s", 3), "turns": ("turn", "rad", 2)}
"""Groups of rows: the scatter they judge, its unit, and how many rows a rest or a turn has."""


def estimate_gyros(observations: Observations, accel: Accelerometers) -> Gyros:
    """The gyros from rests and turns, with scatter of both where the residuals need it."""
    block = observations.gyro_block
    assert block is not None
    values, scatter = observations.start_values(block), GyroScatter()
    values[: block.size] = np.median(observations.rests.gyro, axis=0)
    start, spread = values, limits_of(block.names)
    increments: tuple[Array, ...] = (start,)
    for again in range(3):
        if again:
            scatter = _found_scatter(observations, accel, values, scatter)

        def solution_at(at: Array, scatter: GyroScatter = scatter) -> Solution:
            rows = gyro_rows(observations, accel, observations.turns_about(block.model(at)), at, scatter)
            return _solved(rows, rows.covariance(scatter), spread)[0]

        values, steps = gauss_newton(solution_at, values, spread)
        increments += steps
    rows = gyro_rows(observations, accel, observations.turns_about(block.model(values)), values, scatter)
    covariance = rows.covariance(scatter)
    solution, _ = _solved(rows, covariance, spread)
    fits, outliers = {}, {}
    for name, (of, unit, size) in _GROUPS.items():
        residuals, size_of_scatter = _residuals(observations, rows, scatter, name), getattr(scatter, of)
        fits[f"gyro {name}"] = residuals.fit(size_of_scatter, unit)
        outliers[name] = residuals.sigmas(size, scaled=size_of_scatter > 0.0)
    return Gyros(
        values=values,
        model=block.model(values),
        solution=solution,
        covariance=solution.covariance,
        by_accel=solution.gain @ np.linalg.solve(np.linalg.cholesky(covariance), rows.with_accel),
        fits=fits,
        rest_sigmas=outliers["rests"],
        turn_sigmas=outliers["turns"],
        increments=increments,
    )


def _solved(rows: GyroRows, covariance: Array, spread: Array) -> tuple[Solution, Array]:
    """The step, and the covariance (r, r) of the residuals left after it."""
    lower = np.linalg.cholesky(covariance)
    whitened = np.asarray(np.linalg.solve(lower, np.column_stack([rows.jacobian, rows.residual])), dtype=float)
    jacobian = whitened[:, :-1]
    solution = least_squares(jacobian, whitened[:, -1], spread)
    left = lower @ (np.eye(len(lower)) - jacobian @ solution.gain)
    return solution, left @ left.T


def _residuals(observations: Observations, rows: GyroRows, scatter: GyroScatter, name: str) -> Residuals:
    """What a step leaves of the rows of a group at a scatter."""
    assert observations.gyro_block is not None
    covariance = rows.covariance(scatter)
    solution, left = _solved(rows, covariance, limits_of(observations.gyro_block.names))
    n, k = 3 * len(observations.rests), 0 if observations.turns is None else 2 * len(observations.turns)
    group = slice(0, n) if name == "rests" else slice(n, n + k)
    residual = rows.residual - rows.jacobian @ solution.step
    return Residuals(residual=residual[group], variance=np.diag(covariance)[group], left=left[group, group])


def _found_scatter(
    observations: Observations, accel: Accelerometers, values: Array, scatter: GyroScatter
) -> GyroScatter:
    """The scatter that explains the residuals of the rests, then that of the turns, where they need one."""
    assert observations.gyro_block is not None
    turns = observations.turns_about(observations.gyro_block.model(values))
    rows = gyro_rows(observations, accel, turns, values, scatter)
    for name, noise in (("rests", observations.rests.gyro_covariance), ("turns", turns.covariance)):
        of = _GROUPS[name][0]

        def residuals_at(trial: float, name: str = name, of: str = of, others: GyroScatter = scatter) -> Residuals:
            return _residuals(observations, rows, replace(others, **{of: trial}), name)

        start = float(np.sqrt(np.trace(noise, axis1=1, axis2=2).mean())) if len(noise) else 0.0
        scatter = replace(scatter, **{of: explaining(residuals_at, start, needed=getattr(scatter, of) > 0.0)})
    return scatter
