"""Weighted least squares, and the scatter that makes residuals agree with their noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from tumble.inference.estimate import DETERMINED, chance_of
from tumble.units import Array

RELATIVE_RANK = 1e-11  # relative to the largest singular value; smaller ones are rounding
SCATTER_PROBABILITY = 0.5
"""Scatter is estimated if the p-value of χ² is smaller, that is, if χ² is above its median. With a stricter limit,
scatter that is present but not significant would be missing from u."""
MAX_ITERATIONS = 30
CONVERGED = 1e-3  # of the standard uncertainty
SCATTER_ROUNDS = 3
NORMAL = 1e8  # degrees of freedom from which Student's t distribution is taken as normal


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Solution:
    """Solution of a weighted least-squares problem."""

    step: Array  # (m,), of the parameters
    gain: Array  # (m, r): derivative of the step with respect to the whitened residuals
    null: Array  # (q, m): combinations that the data do not determine, in units of the spreads
    covariance: Array  # (m, m), with the spreads of the null space

    def is_negligible(self, rounding: Array | float) -> bool:
        """Return True if the step is negligible against the uncertainty, or no more than `rounding`."""
        u = np.sqrt(np.diag(self.covariance))
        return bool(np.all(np.abs(self.step) <= CONVERGED * u + rounding))


def least_squares(jacobian: Array, residual: Array, spread: Array) -> Solution:
    """Return the smallest step that minimises |residual − jacobian · step|², both whitened.

    Combinations that the data determine no better than to DETERMINED times their spread (m,) are not changed."""
    Q, R = np.linalg.qr(jacobian * spread)
    U, s, Vt = np.linalg.svd(R)
    rank = int(np.sum(s > max(DETERMINED, RELATIVE_RANK * s[0])))
    determined, null = Vt[:rank], Vt[rank:]
    gain = spread[:, None] * (determined.T / s[:rank]) @ (Q @ U[:, :rank]).T
    covariance = gain @ gain.T + (spread[:, None] * null.T) @ (null * spread)
    return Solution(step=gain @ residual, gain=gain, null=null, covariance=covariance)


def solve_least_squares(rows: Array, right: Array) -> Array:
    """Return the least-squares solutions (..., m) for rows (..., r, m) of full rank and right-hand sides (..., r)."""
    Q, R = np.linalg.qr(rows)
    return np.asarray(np.linalg.solve(R, np.swapaxes(Q, -1, -2) @ right[..., None])[..., 0])


def needs_scatter(chi_square: float, degrees: float) -> bool:
    """Return True if residuals need a scatter beside their noise."""
    return degrees >= 0.5 and chance_of(chi_square, degrees) < SCATTER_PROBABILITY


def fit_scatter(excess: Callable[[float], float], start: float) -> float:
    """Return the scatter at which χ² equals its expectation, zero if χ² is smaller without scatter.

    Parameters
    ----------
    excess
        χ² less its expectation, a falling function of the scatter.
    start
        First guess of the size of the scatter.
    """
    if excess(0.0) <= 0.0:
        return 0.0
    from scipy.optimize import brentq  # slow to import

    high = start
    while excess(high) > 0.0:
        high *= 4.0
    return float(brentq(excess, 0.0, high, rtol=1e-3))


def gaussian_sigmas(normalised: Array, degrees: float, scaled: bool) -> Array:
    """Return the number of Gaussian sigmas with the probability of each normalised residual.

    If the scale was estimated from the same residuals, they are externally studentised."""
    z = np.abs(normalised)
    if not scaled or degrees < 2:
        return z
    z2 = np.minimum(z**2, degrees * (1.0 - 1e-9))
    studentised = np.sqrt(z2 * (degrees - 1.0) / (degrees - z2))
    return np.asarray(0.0 - scipy.special.ndtri(scipy.special.stdtr(degrees - 1.0, -studentised)))


def normal_score(t: Array, degrees: Array | float) -> Array:
    """Return standard normal numbers with the probabilities of Student's t of these degrees of freedom."""
    below = scipy.special.stdtr(degrees, -np.abs(t))
    normal = np.where(np.asarray(degrees) > NORMAL, np.abs(t), -scipy.special.ndtri(np.maximum(below, 1e-300)))
    return np.asarray(np.sign(t) * normal)
