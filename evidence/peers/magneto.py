"""Magneto: the ellipsoid that fits the readings best, in the algebraic sense of Q. Li and J. G. Griffiths, Least
squares ellipsoid specific fitting, Geometric Modeling and Processing 2004, 335, and the correction A⁻¹ (h − b) that
makes it a sphere, A⁻¹ symmetric, as S. Merayo and others, Meas. Sci. Technol. 11 (2000) 120, and the program have it
(sailboatinstruments.blogspot.com).

A quadric vᵀ d = 0, d = (x², y², z², 2yz, 2xz, 2xy, 2x, 2y, 2z, 1), is an ellipsoid where 4J − I² > 0; the least sum of
(vᵀ d)² under the constraint 4J − I² = 1 is the eigenvector of C⁻¹ (S₁₁ − S₁₂ S₂₂⁻¹ S₂₁) with the only positive
eigenvalue, Eq. (8), (11), (15) with k = 4. No uncertainties, no gyros.
"""

from __future__ import annotations

import numpy as np

from evidence.case import Array, Case, Estimate, GaveUpError, Program
from evidence.peers.rests import found

CONSTRAINT = np.zeros((6, 6))
CONSTRAINT[:3, :3] = 1.0 - 2.0 * np.eye(3)
CONSTRAINT[3:, 3:] = -4.0 * np.eye(3)
"""C, Eq. (8), k = 4."""


def fitted(readings: Array, norm: float) -> tuple[Array, Array]:
    """A⁻¹ (3, 3) and b (3,) of readings (N, 3) whose true length is `norm`."""
    x, y, z = readings.T / norm
    design = np.array([x * x, y * y, z * z, 2 * y * z, 2 * x * z, 2 * x * y, 2 * x, 2 * y, 2 * z, np.ones_like(x)])
    scatter = design @ design.T
    s11, s12, s22 = scatter[:6, :6], scatter[:6, 6:], scatter[6:, 6:]
    reduced = s11 - s12 @ np.linalg.solve(s22, s12.T)
    values, vectors = np.linalg.eig(np.linalg.solve(CONSTRAINT, reduced))
    v1 = vectors[:, int(np.argmax(values.real))].real
    v1 = v1 * np.sign(v1[0])
    v2 = -np.linalg.solve(s22, s12.T @ v1)
    quadric = np.array([[v1[0], v1[5], v1[4]], [v1[5], v1[1], v1[3]], [v1[4], v1[3], v1[2]]])
    centre = -np.linalg.solve(quadric, v2[:3])
    size = centre @ quadric @ centre - v2[3]
    eigenvalues, axes = np.linalg.eigh(quadric / size)
    if eigenvalues.min() <= 0.0:
        raise GaveUpError("the quadric is no ellipsoid")
    return axes @ np.diag(np.sqrt(eigenvalues)) @ axes.T, norm * centre


def estimate(case: Case) -> Estimate:
    """The mean readings of the rests."""
    readings = found(case).accel
    if len(readings) < 9:
        raise GaveUpError(f"{len(readings)} rests for nine unknowns")
    matrix, bias = fitted(readings, case.gravity)
    return Estimate(accel=np.linalg.inv(matrix), accel_bias=bias)


PROGRAM = Program(
    name="Magneto",
    needs=frozenset(),
    estimate=estimate,
    source="Li and Griffiths 2004; sailboatinstruments.blogspot.com",
)
