"""Elimination of the unknowns of a chain of rests by orthogonal transformations, and their back-substitution.

The loops over rests are compiled (`tumble.inference.elimination_kernels`). Rows are whitened, [coefficients |
right-hand side]. Each rest i has d unknowns δ_i, the three angles of its attitude and then the states of its sensors,
and p parameters are common to all. The rows of a rest and those of the turn after it are

    [ δ_i (d) | parameters (p) | right-hand side ]              rest, (N, r, d + p + 1)
    [ δ_i (d) | δ_{i+1} (d) | parameters (p) | right-hand side ]   turn, (K, t, 2d + p + 1)

and `link[i]` is the turn from rest i to rest i + 1, −1 if there is none. Steps of Gauss–Markov biases are rows of
turns. Householder reflections of all rows with δ_i (a square-root information filter) leave d rows that determine δ_i
given δ_{i+1} and the parameters, rows in δ_{i+1}, which join those of rest i + 1, and rows in the parameters alone,
which are folded into one triangle. No normal matrix is formed, and the cost is linear in the number of rests. A column
that is reduced to rounding errors carries no information: its unknown, such as an unobserved heading, does not move.
"""

from __future__ import annotations

import numpy as np
import scipy

from tumble.inference import elimination_kernels as kernels
from tumble.units import Array, IntArray

ROUNDING = 1e-10  # remainder of a column after an elimination, relative to its length, that is rounding
BLOCK, WIDE_BLOCK, WIDE = 8, 32, 200  # columns that LAPACK folds together: WIDE_BLOCK from WIDE parameters on


def eliminate(
    rest: Array, turn: Array, link: IntArray, factor: Array, triangle: Array, initial: Array | None = None
) -> None:
    """Eliminate the unknowns of all rests.

    Parameters
    ----------
    rest, turn, link
        Rows as in the module's docstring.
    factor : (N, d, 2d + p + 1)
        Output: the rows that determine the unknowns of each rest.
    triangle : (p + 1, p + 1)
        Triangle into which the rows in the parameters are folded.
    initial : (d, 2d + p + 1)
        Prior rows of the first rest; none if None.
    """
    d, columns = factor.shape[1:]
    initial = np.zeros((d, columns)) if initial is None else initial.copy()
    (N, r, _), t = rest.shape, turn.shape[1]
    work = np.zeros((d + r + t, columns + -columns % kernels.LANES))  # whole vector registers
    kept, length, parts = np.empty((N * (d + r + t), len(triangle)), order="F"), np.zeros(2 * d), np.zeros(len(work))
    count = kernels.eliminate_rests(rest, turn, link, factor, ROUNDING * ROUNDING, work, initial, kept, length, parts)
    fold(kept[:count], triangle)


def fold(rows: Array, triangle: Array, triangular: bool = False) -> None:
    """Fold rows (n, p + 1) into an upper triangle (p + 1, p + 1); `triangular` rows cost a third."""
    if len(rows):
        block = min(WIDE_BLOCK if len(triangle) > WIDE else BLOCK, len(triangle))
        folded = scipy.linalg.lapack.dtpqrt(len(rows) if triangular else 0, block, triangle, rows, overwrite_a=1)
        triangle[:] = folded[0]


def invert_factors(factor: Array) -> tuple[Array, Array]:
    """Return R⁻¹ (…, N, d, d) and A (…, N, d, d) of δ_i = A_i δ_{i+1} + B_i x + a_i + R_i⁻¹ e_i, with unit noise e.

    An unknown without information is zero and has no variance."""
    *stack, d, width = factor.shape
    inverse, by_next = np.empty((*stack, d, d)), np.empty((*stack, d, d))
    kernels.put_back(factor.reshape(-1, d, width), inverse.reshape(-1, d, d), by_next.reshape(-1, d, d))
    return inverse, by_next


def recur_backwards(by_next: Array, values: Array) -> None:
    """Add A_i v_{i+1} to the values v_i (…, N, d, k) in place, from the last to the first; A is zero at chain ends."""
    kernels.follow(by_next.reshape(-1, *by_next.shape[-2:]), values.reshape(-1, *values.shape[-2:]))


def conditional_covariances(inverse: Array, by_next: Array) -> Array:
    """Return covariances of each rest's unknowns, and with the next rest's, for given parameters (2, N, d, d)."""
    out = np.empty((2, *inverse.shape))
    kernels.carry_back(inverse, by_next, *out)
    return out


def whitening(noise: Array, directions: Array, component: IntArray, variance: Array, weight: Array) -> Array:
    """Return inverse Cholesky factors (N, n, n) of N + Σ v Z Zᵀ, times the `weight` (N, n) of rows.

    Direction Z_a of `directions` (N, n, q) has the variance `variance[component[a]]`. Variances and directions may be
    stacks. Raises LinAlgError if a covariance is not positive definite."""
    if variance.ndim > 1:
        pairs = zip(np.broadcast_to(directions, (len(variance), *directions.shape[-3:])), variance, strict=True)
        return np.array([whitening(noise, Z, component, v, weight) for Z, v in pairs])
    factors = np.zeros(noise.shape)
    if not kernels.whiten(noise, directions, component, variance, weight, np.zeros(noise.shape[1:]), factors):
        raise np.linalg.LinAlgError("Matrix is not positive definite")
    return factors
