"""How likely chance alone makes residuals as large along given directions, or chi-square fall by as much.

A cause that is random, another variance with directions Z, is judged by eᵀ Z Zᵀ e: a sum of squares, each with a
weight, an eigenvalue of Zᵀ (1 − Q Qᵀ) Z. Its probability is that of Pearson's distribution of the same first three
moments.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from tumble.estimation.causes.projection import Projection
from tumble.inference.hyperparameters import Scatter
from tumble.units import Array


def weighted_chance(square: float, weights: Array) -> float:
    """Probability that Σ λ χ²₁ exceeds a value: Pearson's distribution of the same mean, variance and skewness."""
    first, second, third = (float((weights**k).sum()) for k in (1, 2, 3))
    if first <= 0.0 or third <= 0.0:
        return 1.0
    degrees = second**3 / third**2
    shifted = degrees + (square - first) * np.sqrt(degrees / second)
    return float(special.chdtrc(degrees, max(shifted, 0.0)))


def variance_chance(projection: Projection, rest: Array, turn: Array) -> float:
    """Probability that chance alone makes a score as large of a variance whose directions are columns of the rests
    (N, r, q) and turns (K, t, q), each of a number of its own."""
    if max(rest.shape[2], turn.shape[2]) == 0:
        return 1.0
    return weighted_chance(*sum_of_squares(projection, projection.apart(rest, turn)))


def sum_of_squares(projection: Projection, directions: Array) -> tuple[float, Array]:
    """The square of the residuals along whitened directions, and its weights: Σ λ χ²₁ where chance alone is at work."""
    left = projection.left_of(directions[:, np.any(directions != 0.0, axis=0)])
    along = left.T @ projection.residual
    return float(along @ along), np.maximum(np.linalg.eigvalsh(left.T @ left), 0.0)


def fall_chance(projection: Projection, scatter: Scatter, fall: float, q: int) -> float:
    """Probability of a fall of chi-square with q parameters; 1 where nothing is left beside them to tell the scatter
    by."""
    if not np.any(scatter.variances > 0.0):
        return noise_chance(fall, q)
    others = projection.degrees - q
    if others < 1.0:
        return 1.0
    rest = max(projection.chi_square - fall, 1e-9)
    overstated = min(1.0, projection.chi_square / projection.degrees)  # noise that is less than said proves nothing
    return float(special.fdtrc(q, others, overstated * fall / q / (rest / others)))


def noise_chance(fall: float, q: int) -> float:
    """Probability of a fall of chi-square with q parameters where the noise is known."""
    return float(special.chdtrc(q, fall))


def ratio_chance(one: tuple[float, Array], other: tuple[float, Array]) -> float:
    """Probability that chance alone makes the first of two sums Σ λ χ²₁ as large as it is beside the second, by F with
    the degrees of freedom (Σ λ)²/Σ λ² of each."""
    (above, first), (below, second) = one, other
    if min(first.sum(), second.sum(), below) <= 0.0:
        return 1.0
    m, n = (float(w.sum() ** 2 / (w**2).sum()) for w in (first, second))
    return float(special.fdtrc(m, n, above / first.sum() * second.sum() / below))
