"""Weighted least squares, and the scatter that makes residuals agree with their noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from tumble.inference.estimate import DETERMINED, chance_of
from tumble.units import Array

RELATIVE_RANK = 1e-11
"""Relative to the largest singular value: smaller ones are rounding."""
SCATTER_PROBABILITY = 0.5
"""Scatter is estimated if chance exceeds χ² with a smaller probability: if χ² is above its median. With a stricter
limit, scatter that is present but not beyond doubt would be missing from u."""
MAX_ITERATIONS = 30
CONVERGED = 1e-3  # of the standard uncertainty
SCATTER_ROUNDS = 3
NORMAL = 1e8
"""Degrees of freedom from which Student's t distribution is taken as normal."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Solution:
    """Solution of a weighted least-squares problem: the `step` (m,) of the parameters, its derivative `gain` (m, r)
    with respect to the whitened residuals, the combinations `null` (q, m) that the data do not determine, in units of
    the spreads, and the `covariance` (m, m), which includes the spreads of the null space."""

    step: Array
    gain: Array
    null: Array
    covariance: Array

    def negligible(self, rounding: Array | float) -> bool:
        """Whether the step is negligible against the uncertainty, or no more than `rounding`."""
        u = np.sqrt(np.diag(self.covariance))
        return bool(np.all(np.abs(self.step) <= CONVERGED * u + rounding))


def least_squares(jacobian: Array, residual: Array, spread: Array) -> Solution:
    """Smallest step that minimises |residual − jacobian · step|², both whitened.

    Combinations that the data determine no better than to DETERMINED times their spread (m,) are not changed.
    """
    Q, R = np.linalg.qr(jacobian * spread)
    U, s, Vt = np.linalg.svd(R)
    rank = int(np.sum(s > max(DETERMINED, RELATIVE_RANK * s[0])))
    seen, null = Vt[:rank], Vt[rank:]
    gain = spread[:, None] * (seen.T / s[:rank]) @ (Q @ U[:, :rank]).T
    covariance = gain @ gain.T + (spread[:, None] * null.T) @ (null * spread)
    return Solution(step=gain @ residual, gain=gain, null=null, covariance=covariance)


def solved(rows: Array, right: Array) -> Array:
    """Least-squares solutions (..., m) of problems with rows (..., r, m) of full rank and right-hand sides (..., r)."""
    Q, R = np.linalg.qr(rows)
    return np.asarray(np.linalg.solve(R, np.swapaxes(Q, -1, -2) @ right[..., None])[..., 0])


def unexplained(chi_square: float, degrees: float) -> bool:
    """Whether residuals need a scatter beside their noise."""
    return degrees >= 0.5 and chance_of(chi_square, degrees) < SCATTER_PROBABILITY


def scatter_of(excess: Callable[[float], float], start: float) -> float:
    """Scatter at which χ² equals its expectation, zero if there is none.

    Parameters
    ----------
    excess
        χ² less its expectation, a falling function of the scatter.
    start
        First guess of the size of the scatter.
    """
    if excess(0.0) <= 0.0:
        return 0.0
    from scipy.optimize import brentq  # which takes a fifth of a second to import

    high = start
    while excess(high) > 0.0:
        high *= 4.0
    return float(brentq(excess, 0.0, high, rtol=1e-3))


def sigmas(normalised: Array, degrees: float, scaled: bool) -> Array:
    """Number of Gaussian sigmas that is as improbable as each normalised residual.

    If the scale comes from the same residuals, each is judged by the scale of all others (externally studentised)."""
    z = np.abs(normalised)
    if not scaled or degrees < 2:
        return z
    z2 = np.minimum(z**2, degrees * (1.0 - 1e-9))
    studentised = np.sqrt(z2 * (degrees - 1.0) / (degrees - z2))
    return np.asarray(0.0 - scipy.special.ndtri(scipy.special.stdtr(degrees - 1.0, -studentised)))


def as_normal(t: Array, degrees: Array | float) -> Array:
    """Standard normal numbers that are as improbable as Student's t with these degrees of freedom."""
    below = scipy.special.stdtr(degrees, -np.abs(t))
    normal = np.where(np.asarray(degrees) > NORMAL, np.abs(t), -scipy.special.ndtri(np.maximum(below, 1e-300)))
    return np.asarray(np.sign(t) * normal)
