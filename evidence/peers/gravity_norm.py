"""irurueta-navigation-inertial, KnownGravityNormAccelerometerCalibrator (github.com/albertoirurueta): Levenberg and
Marquardt's least sum over the rests of (g² − ‖M⁻¹ a − b‖²)², M upper triangular, bias M b.

It states a covariance: (JᵀJ)⁻¹ times the mean square of the residuals. That is carried over to the names of the truth
by the numerical Jacobian. The expanded half widths are 2 u. It has a gyro calibrator too, which needs sequences
between known attitudes and is not rewritten here.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from evidence.case import Array, Case, Estimate, GaveUpError, Program, parameters_of
from evidence.peers.rests import found

UPPER = np.triu_indices(3)


def model(p: Array) -> tuple[Array, Array]:
    """M (3, 3) and b (3,) of nine unknowns."""
    matrix = np.zeros((3, 3))
    matrix[UPPER] = p[3:]
    return matrix, p[:3]


def estimate(case: Case) -> Estimate:
    """Accelerometers from the mean readings of the rests."""
    readings = found(case).accel
    if len(readings) < 10:
        raise GaveUpError(f"{len(readings)} rests for nine unknowns and a mean square")

    def residual(p: Array) -> Array:
        matrix, b = model(p)
        true = np.linalg.solve(matrix, readings.T).T - b
        return np.asarray(case.gravity**2 - (true**2).sum(axis=1), dtype=float)

    start = np.concatenate([np.zeros(3), np.eye(3)[UPPER]])
    fit = least_squares(residual, start, method="lm", xtol=1e-13, ftol=1e-13)
    p = np.asarray(fit.x)

    def values(p: Array) -> Array:
        matrix, b = model(p)
        named = parameters_of(Estimate(accel=matrix, accel_bias=matrix @ b))
        return np.array(list(named.values()))

    jacobian = np.asarray(fit.jac, dtype=float)
    square = 2.0 * fit.cost / (len(readings) - 9)
    carried = np.column_stack([(values(p + 1e-6 * e) - values(p - 1e-6 * e)) / 2e-6 for e in np.eye(9)])
    covariance = square * carried @ np.linalg.solve(jacobian.T @ jacobian, carried.T)
    matrix, b = model(p)
    found_one = Estimate(accel=matrix, accel_bias=matrix @ b)
    u = dict(zip(parameters_of(found_one), np.sqrt(np.diag(covariance)).tolist(), strict=True))
    expanded = {name: 2.0 * size for name, size in u.items()}
    return Estimate(accel=matrix, accel_bias=matrix @ b, u=u, expanded=expanded)


PROGRAM = Program(
    name="irurueta",
    needs=frozenset(),
    estimate=estimate,
    source="github.com/albertoirurueta/irurueta-navigation-inertial, KnownGravityNormAccelerometerCalibrator",
)
