"""Compiled loops that eliminate what belongs to single rests from the rows of a chain of rests linked by turns, and put
it back.

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

Sums are taken in the order that is written: a compiler that may choose another one chooses differently from one
compilation to the next, and rows of a campaign would differ in the last digit from process to process.

The rules of `tumble.reduction.kernels` hold.
"""

from __future__ import annotations

import numpy as np

from tumble.scipy_compiled import lapack
from tumble.units import Array, IntArray

try:
    import cython
except ImportError:
    from tumble import uncompiled as cython

# C: from libc.math cimport sqrt
# C: from libc.stdint cimport int64_t

if not cython.compiled:
    from numpy import sqrt

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
    work, kept = np.zeros((d + r + t, columns)), np.empty((N * (d + r + t), len(triangle)), order="F")
    length, product = np.zeros(2 * d), np.zeros(columns)
    count = _eliminate(rest, turn, link, factor, ROUNDING * ROUNDING, work, begins.copy(), kept, length, product)
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
    """`_reflect` of all rows, in arrays."""
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
        triangle[:] = lapack.dtpqrt(len(rows) if triangular else 0, block, triangle, rows, overwrite_a=1)[0]


# C: cdef Py_ssize_t _eliminate(const double[:, :, :] rest, const double[:, :, :] turn, const int64_t[:] link,
# C:     double[:, :, :] factor, double rounding, double[:, ::1] work, double[:, ::1] carried, double[::1, :] kept,
# C:     double[::1] length, double[::1] product)
def _eliminate(
    rest: Array,
    turn: Array,
    link: IntArray,
    factor: Array,
    rounding: float,
    work: Array,
    carried: Array,
    kept: Array,
    length: Array,
    product: Array,
) -> int:
    """One rest after the other; how many rows on the parameters are left, in `kept`. `length`: squares of the columns
    before anything was taken off them."""
    d, columns, count = factor.shape[1], work.shape[1], 0
    with cython.nogil:
        for i in range(rest.shape[0]):
            rows = _gather(work, carried, rest, i, turn, link[i])
            for c in range(2 * d):
                length[c] = length[c + d] if c < d else 0.0
                for row in range(d, rows):
                    length[c] += work[row, c] * work[row, c]
            top = 0
            for c in range(d):
                seen = _reflect(work, product, top, c, rows, rounding * length[c])
                for column in range(columns):
                    factor[i, c, column] = work[top, column] if seen else 0.0
                top += seen
            carried[:, :] = 0.0
            for c in range(d, 2 * d):
                if _reflect(work, product, top, c, rows, rounding * length[c]):
                    for column in range(d, columns):
                        carried[c - d, column - d if column < 2 * d else column] = work[top, column]
                    top += 1
            for column in range(2 * d, columns):
                for row in range(top, rows):
                    kept[count + row - top, column - 2 * d] = work[row, column]
            count += rows - top
    return count


# C: cdef Py_ssize_t _gather(double[:, ::1] work, double[:, ::1] carried, const double[:, :, :] rest, Py_ssize_t i,
# C:     const double[:, :, :] turn, int64_t k) noexcept nogil
def _gather(work: Array, carried: Array, rest: Array, i: int, turn: Array, k: int) -> int:
    """Put what involves the unknowns of rest i together: carried rows, its own, and those of turn k; how many."""
    d, columns = carried.shape[0], carried.shape[1]
    rows = d
    for row in range(d):
        for column in range(columns):
            work[row, column] = carried[row, column]
    for row in range(rest.shape[1]):
        for column in range(d):
            work[rows, column], work[rows, d + column] = rest[i, row, column], 0.0
        for column in range(2 * d, columns):
            work[rows, column] = rest[i, row, column - d]
        rows += 1
    if k >= 0:
        for row in range(turn.shape[1]):
            for column in range(columns):
                work[rows, column] = turn[k, row, column]
            rows += 1
    return rows  # type: ignore[no-any-return]


# C: @cython.locals(square=double)
# C: cdef bint _reflect(double[:, ::1] work, double[::1] product, Py_ssize_t top, Py_ssize_t column, Py_ssize_t rows,
# C:     double least ) noexcept nogil
def _reflect(work: Array, product: Array, top: int, column: int, rows: int, least: float) -> bool:
    """Reflect rows top … rows − 1 so that below row `top` the column is zero. False, and the column cleared, where it
    has nothing in it."""
    columns, square = work.shape[1], 0.0
    for row in range(top, rows):
        square += work[row, column] * work[row, column]
    if square <= least:
        for row in range(top, rows):
            work[row, column] = 0.0
        return False
    head = work[top, column]
    diagonal = -sqrt(square) if head > 0.0 else sqrt(square)
    work[top, column] = head - diagonal
    scale = 1.0 / (diagonal * (diagonal - head))
    for other in range(column + 1, columns):
        product[other] = 0.0
    for row in range(top, rows):
        part = work[row, column]
        if part != 0.0:
            for other in range(column + 1, columns):
                product[other] += part * work[row, other]
    for other in range(column + 1, columns):
        product[other] *= scale
    for row in range(top, rows):
        part = work[row, column]
        if part != 0.0:
            for other in range(column + 1, columns):
                work[row, other] -= product[other] * part
    work[top, column] = diagonal
    for row in range(top + 1, rows):
        work[row, column] = 0.0
    return True


def put_back(factor: Array) -> tuple[Array, Array, Array]:
    """The rows of all rests solved for their unknowns: what these are known to given all others, R⁻¹ (N, d, d), how
    they go with those of the next rest, A (N, d, d), and along the chain with the parameters, [∂δ/∂x | −δ at x = 0]
    (N, d, p + 1). An unknown that nothing shows is zero, and without variance."""
    N, d = factor.shape[:2]
    inverse = np.empty((N, d, d))
    _inverses(factor, inverse)
    by_next, by = -(inverse @ factor[:, :, d : 2 * d]), -(inverse @ factor[:, :, 2 * d :])
    along_chain(by_next, by)
    return inverse, by_next, by


def given_parameters(inverse: Array, by_next: Array) -> Array:
    """Covariances of the unknowns of the rests for given parameters, with themselves and with those of the next rest
    (2, N, d, d)."""
    covariance = np.zeros((2, *inverse.shape))
    np.matmul(inverse, np.swapaxes(inverse, 1, 2), out=covariance[0])
    _carry_back(by_next, covariance)
    return covariance


# C: cdef void _inverses(const double[:, :, ::1] factor, double[:, :, ::1] inverse)
def _inverses(factor: Array, inverse: Array) -> None:
    """Inverses of the triangles in the first columns; rows and columns of unknowns that nothing shows are zero."""
    d = factor.shape[1]
    with cython.nogil:
        for i in range(factor.shape[0]):
            for a in range(d - 1, -1, -1):
                for c in range(d):
                    inverse[i, a, c] = 0.0
                if factor[i, a, a] != 0.0:
                    inverse[i, a, a] = 1.0 / factor[i, a, a]
                    for b in range(a + 1, d):
                        for c in range(b, d):
                            inverse[i, a, c] -= factor[i, a, b] * inverse[i, b, c]
                    for c in range(a + 1, d):
                        inverse[i, a, c] /= factor[i, a, a]


# C: cpdef void along_chain(const double[:, :, ::1] by_next, double[:, :, ::1] values)
def along_chain(by_next: Array, values: Array) -> None:
    """Add to the values (N, d, k) of every rest, from the last to the first, what `by_next` (N, d, d) makes of those of
    the next one."""
    for i in range(by_next.shape[0] - 2, -1, -1):
        for a in range(by_next.shape[1]):
            for b in range(by_next.shape[1]):
                for q in range(values.shape[2]):
                    values[i, a, q] += by_next[i, a, b] * values[i + 1, b, q]


# C: @cython.locals(total=double)
# C: cdef void _carry_back(const double[:, :, ::1] by_next, double[:, :, :, ::1] covariance)
def _carry_back(by_next: Array, covariance: Array) -> None:
    """The same of the covariances, with themselves (0) and those of the next rest (1)."""
    d = by_next.shape[1]
    with cython.nogil:
        for i in range(by_next.shape[0] - 2, -1, -1):
            for a in range(d):
                for b in range(d):
                    for c in range(d):
                        covariance[1, i, a, c] += by_next[i, a, b] * covariance[0, i + 1, b, c]
            for a in range(d):
                for b in range(a + 1):
                    total = covariance[0, i, a, b]
                    for c in range(d):
                        total += covariance[1, i, a, c] * by_next[i, b, c]
                    covariance[0, i, a, b] = total
                    covariance[0, i, b, a] = total


def whitening(noise: Array, directions: Array, component: IntArray, variance: Array) -> Array:
    """Inverse Cholesky factors (N, n, n) of N + Σ v Z Zᵀ, `directions` Z (N, n, q) being each of the component whose
    `variance` it has. Raises LinAlgError where a covariance is none."""
    factors = np.zeros(noise.shape)
    if not _whiten(noise, directions, component, variance, np.zeros(noise.shape[1:]), factors):
        raise np.linalg.LinAlgError("Matrix is not positive definite")
    return factors


# C: @cython.locals(v=double, part=double, total=double, scale=double, a=Py_ssize_t, b=Py_ssize_t, c=Py_ssize_t,
# C:     k=Py_ssize_t)
# C: cdef bint _whiten(const double[:, :, :] noise, const double[:, :, :] directions, const int64_t[:] component,
# C:     const double[:] variance, double[:, ::1] work, double[:, :, ::1] factors)
def _whiten(noise: Array, directions: Array, component: IntArray, variance: Array, work: Array, factors: Array) -> bool:
    """One covariance after the other; false where one is none."""
    N, n, q = noise.shape[0], noise.shape[1], directions.shape[2]
    with cython.nogil:
        for k in range(N):
            for a in range(n):
                for b in range(a + 1):
                    work[a, b] = noise[k, a, b]
            for c in range(q):
                v = variance[component[c]]
                if v > 0.0:
                    for a in range(n):
                        part = v * directions[k, a, c]
                        if part != 0.0:
                            for b in range(a + 1):
                                work[a, b] += part * directions[k, b, c]
            for a in range(n):
                for b in range(a + 1):
                    total = work[a, b]
                    for c in range(b):
                        total -= work[a, c] * work[b, c]
                    if b < a:
                        work[a, b] = total / work[b, b]
                    elif total > 0.0:
                        work[a, a] = sqrt(total)
                    else:
                        return False
            for a in range(n):
                scale = 1.0 / work[a, a]
                for c in range(a):
                    part = work[a, c] * scale
                    for b in range(c + 1):
                        factors[k, a, b] -= part * factors[k, c, b]
                factors[k, a, a] = scale
    return True
