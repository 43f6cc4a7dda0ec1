"""Stage 1 of the staged method: accelerometers by the scalar method on all rests.

Eqs. (12), (13) in norm form and with covariance. At rest y = S g u + b with the vertical u unknown, so a rest of n
accelerometers says n − 2 things: the residual y − b − S g u with the two directions in which u may turn projected out.
For a triad that is |S⁻¹(y − b)| = g. Iterated to convergence, so that the coefficients are those of the estimated
orientation and the second-order errors of (15) do not remain.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tumble.inference.estimate import Fit, Solution, least_squares, sigmas
from tumble.methods.gauss_newton import with_scatter
from tumble.reduction.observations import Observations
from tumble.rotation import tangent_basis, unit_vector
from tumble.sensors.model import SensorModel
from tumble.sensors.parameters import limits_of
from tumble.units import Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Accelerometers:
    """Stage 1: values and their solution, the verticals found, and what the residuals say."""

    values: Array
    model: SensorModel
    solution: Solution
    null: Array
    """(q, m): combinations the data do not determine, each as long as its spread."""
    gain: Array
    """(m, N, n): change of the values with the mean reading of each rest."""
    by_gravity: Array
    """(m,): change of the values with g, per m/s²."""
    vertical: Array
    covariance: Array
    fit: Fit
    sigmas: Array
    increments: tuple[Array, ...]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _RestRows:
    """Whitened residuals (N, n − 2) and their derivatives with respect to the parameters (N, n − 2, m), to minus
    the readings (N, n − 2, n) and to g (N, n − 2)."""

    residual: Array
    jacobian: Array
    reading: Array
    gravity: Array
    spread: Array

    def solution(self) -> Solution:
        m = self.jacobian.shape[-1]
        return least_squares(self.jacobian.reshape(-1, m), self.residual.ravel(), self.spread)

    def chi_square(self) -> float:
        """Of the residuals after a step."""
        m = self.jacobian.shape[-1]
        after = self.residual.ravel() - self.jacobian.reshape(-1, m) @ self.solution().step
        return float(after @ after)


def _rest_rows(observations: Observations, values: Array, scatter: float) -> _RestRows:
    block, g = observations.accel_block, observations.site.gravity
    model, derivative = block.model(values), block.jacobian(values)
    readings = observations.rests.accel
    force = model.apply(readings)
    vertical = unit_vector(force)
    covariance = observations.rests.accel_covariance + scatter**2 * np.eye(block.size)
    lower = np.linalg.cholesky(covariance)
    turning = np.einsum("pk,ijk->ipj", model.matrix, tangent_basis(vertical)) * g
    basis, _ = np.linalg.qr(np.linalg.solve(lower, turning), mode="complete")
    free = np.swapaxes(basis[:, :, 2:], 1, 2)  # the n − 2 directions that no turn of the vertical reaches
    whiten = np.swapaxes(np.linalg.solve(np.swapaxes(lower, 1, 2), np.swapaxes(free, 1, 2)), 1, 2)
    homogeneous = np.concatenate([g * vertical, np.ones((len(vertical), 1))], axis=1)
    return _RestRows(
        residual=np.einsum("irp,ip->ir", whiten, readings - model.predict(g * vertical)),
        jacobian=np.einsum("irp,pqm,iq->irm", whiten, derivative, homogeneous),
        reading=whiten,
        gravity=np.einsum("irp,pk,ik->ir", whiten, model.matrix, vertical),
        spread=limits_of(block.names),
    )


def estimate_accelerometers(observations: Observations) -> Accelerometers:
    """The accelerometers from all rests, with scatter between rests where the residuals need it."""
    block, site, rests = observations.accel_block, observations.site, observations.rests
    size = float(np.sqrt(np.median(np.trace(rests.accel_covariance, axis1=1, axis2=2))))

    def agreement_at(values: Array) -> tuple[Callable[[float], float], float, float]:
        rows = _rest_rows(observations, values, 0.0)
        degrees = rows.residual.size - (len(values) - len(rows.solution().null))
        return lambda scatter: _rest_rows(observations, values, scatter).chi_square(), degrees, size

    values, scatter, increments = with_scatter(
        lambda at, scatter: _rest_rows(observations, at, scatter).solution(),
        agreement_at,
        observations.start_values(block),
        limits_of(block.names),
    )
    rows = _rest_rows(observations, values, scatter)
    solution, m = rows.solution(), len(values)
    degrees = float(rows.residual.size - (m - len(solution.null)))
    by_rest = solution.gain.reshape(m, *rows.residual.shape)
    by_gravity = -np.einsum("mir,ir->m", by_rest, rows.gravity)
    model = block.model(values)
    left = np.eye(rows.residual.size) - rows.jacobian.reshape(-1, m) @ solution.gain
    expected = np.maximum(np.diag(left @ left.T), 1e-12)
    normalised = (rows.residual.ravel() / np.sqrt(expected)).reshape(rows.residual.shape)
    normalised[(expected < 1e-6).reshape(normalised.shape)] = 0.0  # a residual the fit has no freedom to show
    worst = np.sqrt((normalised**2).mean(axis=1))
    return Accelerometers(
        values=values,
        model=model,
        solution=solution,
        null=solution.null * rows.spread,
        gain=np.einsum("mir,irp->mip", by_rest, rows.reading),
        by_gravity=by_gravity,
        vertical=unit_vector(model.apply(rests.accel)),
        covariance=solution.covariance + site.gravity_u**2 * np.outer(by_gravity, by_gravity),
        fit=Fit(chi_square=rows.chi_square(), degrees=degrees, scatter=scatter, scatter_unit="m/s^2"),
        sigmas=sigmas(worst, degrees, scatter > 0.0),
        increments=increments,
    )
