"""How likely chance alone makes residuals as large, and which of many tests stand out.

The sum of the squares of residuals along whitened directions S, what the unknowns leave of them being P, is Σ λ χ²₁
with the eigenvalues λ of Sᵀ P S. With X = S Sᵀ, blocks of single rests and turns, Σ λ = tr P X, and Σ λ² ≤ tr P X²: as
large where the directions are of one length, else the test is the more cautious. So the blocks of P do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tumble.scipy_compiled import special
from tumble.units import Array

FALSE_ALARMS = 5e-3
"""Of sessions in which there is nothing, those of which something is said: by all tests together."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SumOfSquares:
    """A sum of squares, its mean where chance alone is at work, and half its variance."""

    square: float
    mean: float
    half_variance: float

    @staticmethod
    def along(directions: Array, residual: Array, covariance: Array) -> SumOfSquares:
        """Of residuals (M, r) with these covariances (M, r, r) along whitened directions (M, r, q)."""
        outer = directions @ np.swapaxes(directions, 1, 2)
        once = covariance @ outer
        return SumOfSquares(
            square=float((np.einsum("kr,krq->kq", residual, directions) ** 2).sum()),
            mean=float(np.trace(once, axis1=1, axis2=2).sum()),
            half_variance=float((once * np.swapaxes(outer, 1, 2)).sum()),
        )

    @property
    def degrees(self) -> float:
        """Of the chi-square with the same mean and variance, in its own unit."""
        return self.mean**2 / self.half_variance if self.half_variance > 0.0 else 0.0

    @property
    def chance(self) -> float:
        """Probability that chance alone makes it as large."""
        if self.degrees <= 0.0:
            return 1.0
        return float(special.chdtrc(self.degrees, self.degrees * self.square / self.mean))

    @property
    def excess(self) -> float:
        """The variance along the directions that is there beside what is expected, by the score."""
        return max(0.0, self.square - self.mean) / self.half_variance if self.half_variance > 0.0 else 0.0

    def chance_beside(self, other: SumOfSquares) -> float:
        """Probability that chance alone makes it as large as it is beside another, whatever the scale of both."""
        if min(self.degrees, other.degrees, other.square) <= 0.0:
            return 1.0
        ratio = self.square / self.mean / (other.square / other.mean)
        return float(special.fdtrc(self.degrees, other.degrees, ratio))


def standing_out(probabilities: Sequence[float]) -> float:
    """The largest of the probabilities of many tests that stands out, by Holm's rule: the i-th smallest of m does where
    it and all before it are below FALSE_ALARMS/(m − i + 1). 0 where none does."""
    limit, m = 0.0, len(probabilities)
    for i, probability in enumerate(sorted(probabilities)):
        if probability * (m - i) > FALSE_ALARMS:
            break
        limit = probability
    return limit
