"""Nine accelerometer parameters from rests alone, for very many triads at once: what a rest says without its attitude.

The mean reading y of a rest is y = S a + b, a the specific force, |a| = g in an unknown direction, S = diag(1 + k) A(γ)
the matrix of Eq. (1), lower triangular for accelerometers. What the three readings say beyond the two angles of the
attitude is how far y is from the ellipsoid |S⁻¹(y − b)| = g. With a = S⁻¹(y − b) and the normal n ∥ S⁻ᵀa, |n| = 1,

    distance r = (|a| − g) / |S⁻ᵀ a/|a||,      dr/dθ = −n · (dS/dθ a + db/dθ)

to first order, so that Gauss–Newton on r for all nine parameters is the maximum-likelihood estimate from rests with
free attitudes and equal noise in all readings. (Σ hᵀh)⁻¹ σ² is its covariance, at the true values the Cramér–Rao bound.
Eqs. (12) and (13) of the turntable paper, converged, with the weights of the readings' noise.
"""

from __future__ import annotations

import numpy as np

from tumble.units import Array

STEPS = 5
"""Gauss–Newton steps: from zero, sensors that are off by 5 % are known to rounding after five."""
TOGETHER = 256
"""Triads that go through a step side by side: what they need of memory stays in the cache."""
PARAMETERS = 9


def fit_statics(readings: Array, gravity: float, start: Array | None = None) -> tuple[Array, Array, Array]:
    """Values (n, 9) of n triads along the body axes, their variances (n, 9) for unit noise of every mean reading, and
    the last Gauss–Newton step (n, 9), from mean readings (n, N, 3) in N rests, m/s².

    Parameters in the order of the calibration file: biases, m/s², scale-factor errors, axis angles yx, zx, zy, rad.
    They start from `start` (n, 9) or zero. Rests that do not determine them leave what is not finite."""
    n = len(readings)
    values = np.zeros((n, PARAMETERS)) if start is None else np.array(start, dtype=float)
    variance, step = np.empty((n, PARAMETERS)), np.empty((n, PARAMETERS))
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        for first in range(0, n, TOGETHER):
            part = slice(first, first + TOGETHER)
            theta = values[part]
            for _ in range(STEPS):
                h, r = _distances(readings[part], gravity, theta)
                rows = np.swapaxes(h, 1, 2)
                factor = _inverse_cholesky(rows @ h)
                step[part] = (np.swapaxes(factor, 1, 2) @ (factor @ (rows @ r[..., None])))[..., 0]
                theta = theta + step[part]
            values[part], variance[part] = theta, (factor**2).sum(axis=1)
    return values, variance, step


def _distances(readings: Array, gravity: float, theta: Array) -> tuple[Array, Array]:
    """h = −dr/dθ (n, N, 9) and r (n, N), m/s², of rests at parameters (n, 9): S⁻¹ and S⁻ᵀ by substitution."""
    y = readings - theta[:, None, :3]
    fx, fy, fz = (1.0 + theta[:, i, None] for i in (3, 4, 5))
    (s_yx, c_yx), (s_zx, c_zx), (s_zy, c_zy) = ((np.sin(g), np.cos(g)) for g in theta[:, 6:, None].swapaxes(0, 1))
    ax, along_y, along_z = y[..., 0] / fx, y[..., 1] / fy, y[..., 2] / fz
    ay = (along_y - s_yx * ax) / c_yx
    az = (along_z - s_zx * ax - c_zx * s_zy * ay) / (c_zx * c_zy)
    size = np.sqrt(ax**2 + ay**2 + az**2)
    vz = az / (c_zx * c_zy)
    vy = (ay - c_zx * s_zy * vz) / c_yx
    v = np.stack([(ax - s_yx * vy - s_zx * vz) / fx, vy / fy, vz / fz])
    length = np.sqrt((v**2).sum(axis=0))
    nx, ny, nz = v / length
    h = np.stack(
        [
            nx,
            ny,
            nz,
            nx * ax,
            ny * along_y,
            nz * along_z,
            ny * fy * (c_yx * ax - s_yx * ay),
            nz * fz * (c_zx * ax - s_zx * (s_zy * ay + c_zy * az)),
            nz * fz * c_zx * (c_zy * ay - s_zy * az),
        ],
        axis=-1,
    )
    return h, (size - gravity) * size / length


def _inverse_cholesky(matrix: Array) -> Array:
    """L⁻¹ (n, m, m) of symmetric matrices L Lᵀ (n, m, m), row by row; not finite where one is not positive."""
    inverse = np.zeros_like(matrix)
    for i in range(matrix.shape[-1]):
        projected = np.einsum("nab,nb->na", inverse[:, :i, :i], matrix[:, :i, i])  # row i of L, left of its diagonal
        diagonal = np.sqrt(matrix[:, i, i] - (projected**2).sum(axis=1))
        inverse[:, i, :i] = -np.einsum("na,nab->nb", projected, inverse[:, :i, :i]) / diagonal[:, None]
        inverse[:, i, i] = 1.0 / diagonal
    return inverse
