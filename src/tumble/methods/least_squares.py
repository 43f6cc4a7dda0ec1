"""Weighted least squares by Gauss–Newton, and the scatter that makes residuals agree with their noise.

Residuals r of covariance V that a fit takes up in part, so that W is left of it: Σ r_i²/V_ii has the mean t = tr w and
the variance 2 tr w², w_ij = W_ij/√(V_ii V_jj). Times t/tr w² it has those of a chi-square of t²/tr w² degrees of
freedom (Satterthwaite 1946).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from tumble.inference.estimate import DETERMINED, SEEN, Fit, chance_of
from tumble.units import Array, BoolArray

RELATIVE_RANK = 1e-11
"""Singular values below this part of the largest are rounding."""
SCATTER_PROBABILITY = 0.5
"""Scatter is estimated where chance alone would exceed chi-square less often than this: where it is above its median.
With a stricter limit a scatter that is there, but not beyond doubt, would be missing from u."""
TAKEN_UP = 1e-3
"""Of the variance: residuals of which no more is left show nothing."""
MAX_ITERATIONS = 30
CONVERGED = 1e-3  # of the standard uncertainty
SCATTER_ROUNDS = 3
NORMAL = 1e8
"""Degrees of freedom, from which Student's t is normal."""
ROUNDING = 1e-15
"""SI: steps that are no more than rounding."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Solution:
    """A weighted least-squares step: `step` (m,), `gain` (m, r) of the whitened residuals, `null` (q, m) the
    combinations the data do not determine, in units of the spreads, and the covariance (m, m), to which the
    spreads of the null space have been added."""

    step: Array
    gain: Array
    null: Array
    covariance: Array

    @property
    def observable(self) -> BoolArray:
        """Which parameters the data determine."""
        return np.asarray(np.sqrt((self.null**2).sum(axis=0)) < SEEN)

    def negligible(self, rounding: Array | float = ROUNDING) -> bool:
        """Whether the step is negligible against the uncertainty."""
        u = np.sqrt(np.diag(self.covariance))
        return bool(np.all(np.abs(self.step) <= CONVERGED * u + rounding))


def least_squares(jacobian: Array, residual: Array, spread: Array) -> Solution:
    """Smallest step that minimises |residual − jacobian · step|², both whitened; singular combinations, which the
    data determine no better than DETERMINED times their spread, are left alone."""
    Q, R = np.linalg.qr(jacobian * spread)
    U, s, Vt = np.linalg.svd(R)
    rank = int(np.sum(s > max(DETERMINED, RELATIVE_RANK * s[0])))
    seen, null = Vt[:rank], Vt[rank:]
    gain = spread[:, None] * (seen.T / s[:rank]) @ (Q @ U[:, :rank]).T
    covariance = gain @ gain.T + (spread[:, None] * null.T) @ (null * spread)
    return Solution(step=gain @ residual, gain=gain, null=null, covariance=covariance)


def solved(rows: Array, right: Array) -> Array:
    """Least squares (..., m) of many problems with rows (..., r, m) of full rank, right-hand sides (..., r)."""
    Q, R = np.linalg.qr(rows)
    return np.asarray(np.linalg.solve(R, np.swapaxes(Q, -1, -2) @ right[..., None])[..., 0])


def gauss_newton(
    solution_at: Callable[[Array], Solution], values: Array, spread: Array, rounding: Array | float = ROUNDING
) -> tuple[Array, tuple[Array, ...]]:
    """Values (m,) after the last step, and all steps, from `values` on, until one is negligible against u;
    `solution_at` linearises about values. No parameter moves by more than its spread (m,) in a step: far from any
    solution the linearisation says nothing."""
    steps: list[Array] = []
    for _ in range(MAX_ITERATIONS):
        solution = solution_at(values)
        steps.append(np.asarray(solution.step / max(1.0, float(np.max(np.abs(solution.step) / spread)))))
        values = values + steps[-1]
        if solution.negligible(rounding):
            break
    return values, tuple(steps)


def with_scatter(
    solution_at: Callable[[Array, float], Solution],
    agreement_at: Callable[[Array], tuple[Callable[[float], float], float, float]],
    values: Array,
    spread: Array,
    rounding: Array | float = ROUNDING,
) -> tuple[Array, float, tuple[Array, ...]]:
    """Values (m,), the scatter that explains the residuals, zero where they need none, and all steps. `agreement_at`
    values has the chi-square of the residuals by their scatter, its degrees of freedom, and a first guess of it."""
    scatter = 0.0
    values, steps = gauss_newton(lambda at: solution_at(at, 0.0), values, spread, rounding)
    for again in range(SCATTER_ROUNDS):
        chi_square, degrees, size = agreement_at(values)
        if not again and not unexplained(chi_square(0.0), degrees):
            break
        scatter = scatter_of(lambda trial, of=chi_square, expected=degrees: of(trial) - expected, size)  # type: ignore[misc]
        values, more = gauss_newton(lambda at, size=scatter: solution_at(at, size), values, spread, rounding)  # type: ignore[misc]
        steps += more
    return values, scatter, steps


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
        return Fit(chi_square=statistic, degrees=degrees, scatter=scatter, unit=unit)

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


def scatter_of(excess: Callable[[float], float], start: float) -> float:
    """The scatter at which `excess(scatter)` (chi-square less its expectation, falling) vanishes; `start` is a
    first guess of its size. Zero where there is none."""
    if excess(0.0) <= 0.0:
        return 0.0
    from scipy.optimize import brentq  # which takes a fifth of a second to import

    high = start
    while excess(high) > 0.0:
        high *= 4.0
    return float(brentq(excess, 0.0, high, rtol=1e-3))


def sigmas(normalised: Array, degrees: float, scaled: bool) -> Array:
    """How many Gaussian sigmas each normalised residual is out; where the scale came from the same residuals, the
    residual is judged by the scale of all others (externally studentised)."""
    z = np.abs(normalised)
    if not scaled or degrees < 2:
        return z
    z2 = np.minimum(z**2, degrees * (1.0 - 1e-9))
    studentised = np.sqrt(z2 * (degrees - 1.0) / (degrees - z2))
    return np.asarray(0.0 - scipy.special.ndtri(scipy.special.stdtr(degrees - 1.0, -studentised)))


def as_normal(t: Array, degrees: Array | float) -> Array:
    """The standard normal numbers that are as improbable as these of Student's t, of so many degrees of freedom."""
    below = scipy.special.stdtr(degrees, -np.abs(t))
    normal = np.where(np.asarray(degrees) > NORMAL, np.abs(t), -scipy.special.ndtri(np.maximum(below, 1e-300)))
    return np.asarray(np.sign(t) * normal)
