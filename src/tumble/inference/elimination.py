"""Elimination of the unknowns of single rests from the rows of a chain of rests linked by turns, and their
back-substitution. The loops are compiled (`tumble.inference.elimination_kernels`).

Rows are whitened and in the form [coefficients | right-hand side]; unknowns are d numbers of every rest (the three
angles of its attitude first, then the states of its sensors) and p parameters common to all. With δᵢ the unknowns of
rest i, the rows of rest i and of the turn that follows it are

    [ δᵢ (d) | parameters (p) | right-hand side ]             rest, (N, r, d + p + 1)
    [ δᵢ (d) | δᵢ₊₁ (d) | parameters (p) | right-hand side ]   turn, (K, t, 2d + p + 1)

and `link[i]` is the turn from rest i to rest i + 1, −1 where nothing links them. A bias that is a Gauss–Markov process
has its states among the unknowns, and its steps among the rows of the turns. The elimination is orthogonal (a square-
root information filter): Householder reflections of what involves δᵢ leave d rows that give δᵢ once the rest is known,
rows on δᵢ₊₁, carried on, and rows on the parameters alone, folded into one triangle. Nothing is squared, and the cost
is linear in the number of rests. A column of which nothing but rounding is left is no information: its unknown, a
heading that nothing shows, stays where it is. Sums over rows are taken for all columns side by side, so that the loops
over columns are vector instructions.
"""

from __future__ import annotations

import numpy as np
import scipy

from tumble.inference import elimination_kernels as kernels
from tumble.units import Array, IntArray

ROUNDING = 1e-10
"""A column that an elimination leaves with less than this part of its length has nothing left in it."""

BLOCK, WIDE_BLOCK, WIDE = 8, 32, 200
"""Columns that LAPACK folds together, and how many from so many parameters on."""

LARGE = 20
"""Unknowns of a rest from which on its elimination is one by LAPACK, too."""


def eliminate(
    rest: Array, turn: Array, link: IntArray, factor: Array, triangle: Array, begins: Array | None = None
) -> None:
    """Eliminate the unknowns of all rests: `factor` (N, d, 2d + p + 1) gets the rows that give them, and the rows on
    the parameters are folded into `triangle` (p + 1, p + 1), which may hold others before. What is known of the first
    rest before any reading are the rows `begins` (d, 2d + p + 1), nothing where None."""
    if begins is None:
        begins = np.zeros((factor.shape[1], factor.shape[2]))
    if factor.shape[1] > LARGE:
        _eliminate_large(rest, turn, link, factor, triangle, begins)
        return
    (N, r, _), t, d, columns = rest.shape, turn.shape[1], factor.shape[1], factor.shape[2]
    work = np.zeros((d + r + t, columns + -columns % kernels.LANES))  # whole lanes
    kept, length, parts = np.empty((N * (d + r + t), len(triangle)), order="F"), np.zeros(2 * d), np.zeros(len(work))
    count = kernels.eliminate_rests(
        rest, turn, link, factor, ROUNDING * ROUNDING, work, begins.copy(), kept, length, parts
    )
    fold(kept[:count], triangle)


def _eliminate_large(rest: Array, turn: Array, link: IntArray, factor: Array, triangle: Array, begins: Array) -> None:
    """The same by LAPACK, a rest at a time, for arrays, whose many states make its blocks worth their call."""
    d, kept, carried = factor.shape[1], list[Array](), begins
    square = np.zeros(2 * d)
    for i, k in enumerate(link.tolist()):
        own = np.zeros((rest.shape[1], carried.shape[1]))
        own[:, :d], own[:, 2 * d :] = rest[i, :, :d], rest[i, :, d:]
        rows = np.concatenate([carried, own, *([turn[k]] if k >= 0 else [])])
        width = 2 * d if k >= 0 else d
        square = np.append(square[d:], np.zeros(d)) + (rows[d:, : 2 * d] ** 2).sum(axis=0)
        length = np.sqrt(square[:width])  # of the columns before anything was taken off them
        reduced = np.asarray(np.linalg.qr(rows, mode="r"))
        factor[i] = 0.0
        carried = np.zeros_like(carried)
        pivot = np.abs(reduced.diagonal()[:width])
        if np.all(pivot > ROUNDING * np.maximum(length, 1e-300)):
            factor[i] = reduced[:d]
            top = width
        else:  # a heading that nothing shows: reflections one by one
            reduced, top = np.ascontiguousarray(rows), 0
            for c in range(width):
                seen = _reflected(reduced, top, c, ROUNDING * ROUNDING * length[c] ** 2)
                if c < d and seen:
                    factor[i, c] = reduced[top]
                top += seen
        if k >= 0:
            following = reduced[d:top] if top == width else reduced[:top]
            first = (following != 0.0).argmax(axis=1)
            on_next = (first >= d) & (first < width)
            place, following = first[on_next] - d, following[on_next]
            carried[place, :d], carried[place, 2 * d :] = following[:, d : 2 * d], following[:, 2 * d :]
        kept.append(reduced[top:, 2 * d :])
    fold(np.concatenate(kept), triangle)


def _reflected(work: Array, top: int, column: int, least: float) -> bool:
    """A reflection of all rows as in `eliminate_rests`, in arrays."""
    below = work[top:, column]
    square = float(below @ below)
    if square <= least:
        work[top:, column] = 0.0
        return False
    head = float(below[0])
    diagonal = -np.sqrt(square) if head > 0.0 else np.sqrt(square)
    v = below.copy()
    v[0] = head - diagonal
    work[top:] -= np.outer(v / (diagonal * (diagonal - head)), v @ work[top:])
    work[top, column], work[top + 1 :, column] = diagonal, 0.0
    return True


def fold(rows: Array, triangle: Array, triangular: bool = False) -> None:
    """Fold rows (n, p + 1) into an upper triangle (p + 1, p + 1), by LAPACK; `triangular` ones cost a third."""
    if len(rows):
        block = min(WIDE_BLOCK if len(triangle) > WIDE else BLOCK, len(triangle))
        folded = scipy.linalg.lapack.dtpqrt(len(rows) if triangular else 0, block, triangle, rows, overwrite_a=1)
        triangle[:] = folded[0]


def invert_factors(factor: Array) -> tuple[Array, Array]:
    """The rows of all rests solved for their unknowns: what these are known to given all others, R⁻¹ (…, N, d, d), and
    how they go with those of the next rest, A (…, N, d, d). An unknown that nothing shows is zero, and without
    variance."""
    *stack, d, width = factor.shape
    inverse, by_next = np.empty((*stack, d, d)), np.empty((*stack, d, d))
    kernels.put_back(factor.reshape(-1, d, width), inverse.reshape(-1, d, d), by_next.reshape(-1, d, d))
    return inverse, by_next


def recur_backwards(by_next: Array, values: Array) -> None:
    """Add to the values (…, N, d, k) of every rest, from the last to the first, what `by_next` (…, N, d, d), zero at
    the last of a chain, makes of those of the next one."""
    kernels.follow(by_next.reshape(-1, *by_next.shape[-2:]), values.reshape(-1, *values.shape[-2:]))


def conditional_covariances(inverse: Array, by_next: Array) -> Array:
    """Covariances of the unknowns of the rests for given parameters, with themselves and with those of the next rest
    (2, N, d, d)."""
    out = np.empty((2, *inverse.shape))
    kernels.carry_back(inverse, by_next, *out)
    return out


def whitening(noise: Array, directions: Array, component: IntArray, variance: Array, weight: Array) -> Array:
    """Inverse Cholesky factors (N, n, n) of N + Σ v Z Zᵀ, `directions` Z (N, n, q) being each of the component whose
    `variance` it has, times the `weight` (N, n) of rows; of a stack of variances and, perhaps, of directions a stack.
    Raises LinAlgError where a covariance is none."""
    if variance.ndim > 1:
        every = zip(np.broadcast_to(directions, (len(variance), *directions.shape[-3:])), variance, strict=True)
        return np.array([whitening(noise, own, component, v, weight) for own, v in every])
    factors = np.zeros(noise.shape)
    if not kernels.whiten(noise, directions, component, variance, weight, np.zeros(noise.shape[1:]), factors):
        raise np.linalg.LinAlgError("Matrix is not positive definite")
    return factors
