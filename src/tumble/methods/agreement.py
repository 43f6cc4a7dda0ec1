"""How well residuals agree with their noise where they share parameters, and the scatter that makes them.

Residuals r of covariance V that a fit takes up in part, so that W is left of it: Σ r_i²/V_ii has the mean t = tr w and
the variance 2 tr w², w_ij = W_ij/√(V_ii V_jj). Times t/tr w² it has those of a chi-square of t²/tr w² degrees of
freedom (Satterthwaite 1946).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tumble.inference.estimate import SCATTER_PROBABILITY, Fit, chance_of, scatter_of, sigmas
from tumble.units import Array

TAKEN_UP = 1e-3
"""Of the variance: residuals of which no more is left show nothing."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Residuals:
    """Residuals (r,) after a fit, the `variance` (r,) of the rows, and the covariance (r, r) of what is `left`."""

    residual: Array
    variance: Array
    left: Array

    def chi_square(self) -> tuple[float, float]:
        """Chi-square and its degrees of freedom, matched in mean and variance; zeros where nothing is left."""
        scale = np.sqrt(self.variance)
        share = self.left / np.outer(scale, scale)
        trace, squares = float(np.trace(share)), float((share**2).sum())
        if trace < 1e-6:
            return 0.0, 0.0
        return float(((self.residual / scale) ** 2).sum()) * trace / squares, trace**2 / squares

    def excess(self) -> float:
        """Chi-square less its expectation."""
        statistic, degrees = self.chi_square()
        return statistic - degrees

    def fit(self, scatter: float, unit: str) -> Fit:
        """The same as a calibration keeps it."""
        statistic, degrees = self.chi_square()
        return Fit(chi_square=statistic, degrees=degrees, scatter=scatter, scatter_unit=unit)

    def sigmas(self, size: int, *, scaled: bool) -> Array:
        """How far residuals, `size` at a time, are out, in sigmas; `scaled` where their scatter is from themselves."""
        squares = (self.residual**2 / self.variance).reshape(-1, size).sum(axis=1)
        free = (np.diag(self.left) / self.variance).reshape(-1, size).sum(axis=1)
        z = np.sqrt(squares / np.where(free > TAKEN_UP, free, np.inf))
        return sigmas(z, self.chi_square()[1], scaled)


def unexplained(chi_square: float, degrees: float) -> bool:
    """Whether residuals need a scatter beside their noise."""
    return degrees >= 0.5 and chance_of(chi_square, degrees) < SCATTER_PROBABILITY


def explaining(residuals_at: Callable[[float], Residuals], start: float, *, needed: bool = False) -> float:
    """The scatter at which residuals agree with their noise, from a first guess of its size; zero where they do without
    one, unless it is known to be `needed`."""
    if not needed and not unexplained(*residuals_at(0.0).chi_square()):
        return 0.0
    return scatter_of(lambda scatter: residuals_at(scatter).excess(), start)
