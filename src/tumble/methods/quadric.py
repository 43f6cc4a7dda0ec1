"""Algebraic fit of ellipsoids to points by the method of Li & Griffiths, for many units at once.

    a x² + b y² + c z² + d xy + e yz + f xz + h x + i y + j z + l = 0                                   (9), (11)
    |D ξ|² → min subject to 4J − I² = ξ1ᵀ C* ξ1 = 1,  I = a + b + c,  J = ab + bc + ac − (d² + e² + f²)/4   (16), (17)
    C*⁻¹ (S11 − S12 S22⁻¹ S21) ξ1 = λ ξ1, the only positive λ;  ξ2 = −S22⁻¹ S21 ξ1;  S = DᵀD              (20)

for centred and scaled readings. A row of D has the ten monomials of a reading; ξ1 are the first six coefficients.
The centre of the ellipsoid is the bias, Eq. (13). Its shape H gives scale factors and angles, Eq. (12): H⁻¹ = m² M Mᵀ,
where m is the length of the true vector and m M the Cholesky factor of H⁻¹, in the frame of the accelerometers.
4J − I² > 0 is sufficient for an ellipsoid but not necessary. It holds if the shortest semi-axis is at least half the
longest, so each channel is scaled. With the Cholesky factor L of the matrix in brackets, (20) becomes the symmetric
problem L⁻¹ C* L⁻ᵀ z = z/λ, ξ1 = L⁻ᵀ z. C* as printed, with −4, belongs to the unknowns d/2, e/2, f/2, with the products
taken twice.

Source: Li & Griffiths, Least squares ellipsoid specific fitting (GMP 2004); equation numbers are those of the ellipsoid
paper (calibration of a triaxial block of navigation accelerometers by ellipsoid fitting), which uses it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tumble.sensors.model import SensorModel
from tumble.units import Array, BoolArray

_PENCIL = np.zeros((6, 6))  # C*, Eq. (17)
_PENCIL[:3, :3] = 1.0 - 2.0 * np.eye(3)
_PENCIL[3:, 3:] = -4.0 * np.eye(3)

_LEAST_EIGENVALUE = 1e-14
"""Added to the diagonals of S of scaled readings: below the squared resolution of any reading, but large enough to
separate the other λ of (20) from rounding if there is no noise."""
_LEAST_SECOND = 1e-3
"""Second smallest |λ| of (20) of scaled readings below which they do not determine the ellipsoid; estimated from the
norm of all other 1/λ. Good programmes have 0.01 to 0.06."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Ellipsoids:
    """U ellipsoids (y − centre)ᵀ shape (y − centre) = 1; NaN where readings lie on no ellipsoid."""

    centre: Array  # (U, 3)
    shape: Array  # (U, 3, 3)
    found: BoolArray  # (U,): whether the readings lie on an ellipsoid
    determined: BoolArray  # (U,): False if other ellipsoids fit as well, as positions are too few or too similar

    def models(self, modulus: float = 1.0) -> SensorModel:
        """Return matrices (U, 3, 3) and biases (U, 3) in the accelerometer frame, with positive polarity."""
        shape = np.where(self.found[:, None, None], self.shape, np.eye(3))
        lower = np.linalg.cholesky(np.linalg.inv(shape)) / modulus
        return SensorModel(matrix=np.where(self.found[:, None, None], lower, np.nan), bias=self.centre)


def fit_many(readings: Array) -> Ellipsoids:
    """Fit ellipsoids to readings (U, N, 3) of U units in N ≥ 9 positions, in any unit."""
    scaled = np.swapaxes(readings, 1, 2).astype(float)
    mean = scaled.mean(axis=2)
    scaled -= mean[:, :, None]
    size = np.sqrt(3.0 * np.einsum("uin,uin->ui", scaled, scaled) / scaled.shape[2])
    size = np.where(size > 0.0, size, 1.0)
    scaled /= size[:, :, None]
    units, _, positions = scaled.shape
    D = np.ones((units, 10, positions))
    D[:, :3] = scaled**2
    D[:, 3:6] = 2.0 * scaled * scaled[:, [1, 2, 0]]  # as the unknowns are d/2, e/2, f/2
    D[:, 6:9] = scaled
    S = D @ np.swapaxes(D, 1, 2) / positions
    to_xi2 = -np.linalg.solve(S[:, 6:, 6:] + _LEAST_EIGENVALUE * np.eye(4), S[:, 6:, :6])
    L = np.linalg.cholesky(S[:, :6, :6] + S[:, :6, 6:] @ to_xi2 + _LEAST_EIGENVALUE * np.eye(6))
    inverse = np.linalg.inv(L)
    values, vectors = np.linalg.eigh(inverse @ _PENCIL @ np.swapaxes(inverse, 1, 2))
    xi1 = np.swapaxes(inverse, 1, 2) @ vectors[:, :, -1:]
    xi = np.concatenate([xi1, to_xi2 @ xi1], axis=1)[:, :, 0]
    xi *= (np.sign(xi[:, :3].sum(axis=1)) / np.abs(xi[:, :6]).max(axis=1))[:, None]  # a + b + c > 0
    H = xi[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2]]]
    definite = (xi[:, 0] > 0.0) & (H[:, 0, 0] * H[:, 1, 1] > H[:, 0, 1] ** 2) & (np.linalg.det(H) > 0.0)
    H = np.where(definite[:, None, None], H, np.eye(3))
    offset = -0.5 * np.linalg.solve(H, xi[:, 6:9, None])[:, :, 0]
    level = np.einsum("ui,uij,uj->u", offset, H, offset) - xi[:, 9]
    found = definite & (level > 0.0)
    shape = H / (np.where(found, level, 1.0)[:, None, None] * size[:, :, None] * size[:, None, :])
    return Ellipsoids(
        centre=np.where(found[:, None], mean + size * offset, np.nan),
        shape=np.where(found[:, None, None], shape, np.nan),
        found=found,
        determined=np.linalg.norm(values[:, :-1], axis=1) < 1.0 / _LEAST_SECOND,
    )
