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
# C: cpdef enum:
# C:     LANES = 48

if not cython.compiled:
    from numpy import sqrt

    LANES = 48
    sums = [0.0] * LANES

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
    work = np.zeros((d + r + t, columns + -columns % LANES))  # whole lanes
    kept, length, parts = np.empty((N * (d + r + t), len(triangle)), order="F"), np.zeros(2 * d), np.zeros(len(work))
    count = _eliminate(rest, turn, link, factor, ROUNDING * ROUNDING, work, begins.copy(), kept, length, parts)
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
# C:     double[::1] length, double[::1] parts)
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
    parts: Array,
) -> int:
    """One rest after the other; how many rows on the parameters are left, in `kept`. `length`: squares of the columns
    before anything was taken off them."""
    d, columns, count = factor.shape[1], factor.shape[2], 0
    with cython.nogil:
        for i in range(rest.shape[0]):
            rows = _gather(work, carried, rest, i, turn, link[i])
            for c in range(2 * d):
                length[c] = length[c + d] if c < d else 0.0
                for row in range(d, rows):
                    length[c] += work[row, c] * work[row, c]
            top = 0
            for c in range(d):
                seen = _reflect(work, parts, top, c, rows, rounding * length[c])
                for column in range(columns):
                    factor[i, c, column] = work[top, column] if seen else 0.0
                top += seen
            carried[:, :] = 0.0
            for c in range(d, 2 * d):
                if _reflect(work, parts, top, c, rows, rounding * length[c]):
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


# C: @cython.locals(square=double, part=double, sums=double[LANES], lane=Py_ssize_t, block=Py_ssize_t)
# C: cdef bint _reflect(double[:, ::1] work, double[::1] parts, Py_ssize_t top, Py_ssize_t column, Py_ssize_t rows,
# C:     double least ) noexcept nogil
def _reflect(work: Array, parts: Array, top: int, column: int, rows: int, least: float) -> bool:
    """Reflect rows top … rows − 1 so that below row `top` the column is zero, LANES columns after the other, those
    before `column` being zero already. False, and the column cleared, where it has nothing in it."""
    square = 0.0
    for row in range(top, rows):
        parts[row] = work[row, column]
        square += parts[row] * parts[row]
        work[row, column] = 0.0
    if square <= least:
        return False
    head = parts[top]
    diagonal = -sqrt(square) if head > 0.0 else sqrt(square)
    parts[top] = head - diagonal
    scale = 1.0 / (diagonal * (diagonal - head))
    for group in range(column // LANES, work.shape[1] // LANES):
        block = group * LANES
        for lane in range(LANES):
            sums[lane] = 0.0
        for row in range(top, rows):
            part = parts[row]
            if part != 0.0:
                for lane in range(LANES):
                    sums[lane] += part * work[row, block + lane]
        for lane in range(LANES):
            sums[lane] *= scale
        for row in range(top, rows):
            part = parts[row]
            if part != 0.0:
                for lane in range(LANES):
                    work[row, block + lane] -= sums[lane] * part
    work[top, column] = diagonal
    return True


def given_unknowns(rows: Array, by: Array, first: IntArray) -> Array:
    """Rows (…, K, t, ·) with the unknowns of the rests, the `first` (K,) of each or that and the one after it, as they
    follow `by` all others (…, N, d, p + 1): [what these do | residual where they are zero] (…, K, t, p + 1)."""
    (*stack, N, d, width), t = by.shape, rows.shape[-2]
    out = np.ascontiguousarray(rows[..., -width:])
    every = (first + N * np.arange(np.prod(stack, dtype=np.int64))[:, None]).ravel()
    _add_given(rows.reshape(-1, t, rows.shape[-1]), by.reshape(-1, d, width), every, out.reshape(-1, t, width))
    return out


# C: @cython.locals(part=double)
# C: cdef void _add_given(const double[:, :, :] rows, const double[:, :, ::1] by, const int64_t[:] first,
# C:     double[:, :, ::1] out)
def _add_given(rows: Array, by: Array, first: IntArray, out: Array) -> None:
    """Row by row."""
    d, width = by.shape[1], by.shape[2]
    with cython.nogil:
        for k in range(rows.shape[0]):
            for a in range(rows.shape[1]):
                for b in range(rows.shape[2] - width):
                    part = rows[k, a, b]
                    if part != 0.0:
                        i = first[k] + b // d
                        for column in range(width):
                            out[k, a, column] += part * by[i, b % d, column]


def put_back(factor: Array) -> tuple[Array, Array, Array]:
    """The rows of all rests solved for their unknowns: what these are known to given all others, R⁻¹ (N, d, d), how
    they go with those of the next rest, A (N, d, d), and along the chain with the parameters, [∂δ/∂x | −δ at x = 0]
    (N, d, p + 1). An unknown that nothing shows is zero, and without variance."""
    d, inverse = factor.shape[-2], np.empty((*factor.shape[:-1], factor.shape[-2]))
    _inverses(factor.reshape(-1, *factor.shape[-2:]), inverse.reshape(-1, d, d))
    by_next, by = -(inverse @ factor[..., d : 2 * d]), -(inverse @ factor[..., 2 * d :])
    along_chains(by_next, by)
    return inverse, by_next, by


def along_chains(by_next: Array, values: Array) -> None:
    """Add to the values (…, N, d, k) of every rest, from the last to the first, what `by_next` (…, N, d, d), zero at
    the last of a chain, makes of those of the next one."""
    _follow(by_next.reshape(-1, *by_next.shape[-2:]), values.reshape(-1, *values.shape[-2:]))


def given_parameters(inverse: Array, by_next: Array) -> Array:
    """Covariances of the unknowns of the rests for given parameters, with themselves and with those of the next rest
    (2, N, d, d)."""
    d, own = inverse.shape[-1], inverse @ np.swapaxes(inverse, -1, -2)
    with_next = np.zeros_like(own)
    _carry_back(by_next.reshape(-1, d, d), own.reshape(-1, d, d), with_next.reshape(-1, d, d))
    return np.stack([own, with_next], axis=-4)


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


# C: cdef void _follow(const double[:, :, ::1] by_next, double[:, :, ::1] values)
def _follow(by_next: Array, values: Array) -> None:
    """All chains, one behind the other."""
    with cython.nogil:
        for i in range(by_next.shape[0] - 2, -1, -1):
            for a in range(by_next.shape[1]):
                for b in range(by_next.shape[1]):
                    for q in range(values.shape[2]):
                        values[i, a, q] += by_next[i, a, b] * values[i + 1, b, q]


# C: @cython.locals(total=double)
# C: cdef void _carry_back(const double[:, :, ::1] by_next, double[:, :, ::1] own, double[:, :, ::1] with_next)
def _carry_back(by_next: Array, own: Array, with_next: Array) -> None:
    """The same of the covariances of the unknowns with themselves and with the next one's."""
    d = by_next.shape[1]
    with cython.nogil:
        for i in range(by_next.shape[0] - 2, -1, -1):
            for a in range(d):
                for b in range(d):
                    for c in range(d):
                        with_next[i, a, c] += by_next[i, a, b] * own[i + 1, b, c]
            for a in range(d):
                for b in range(a + 1):
                    total = own[i, a, b]
                    for c in range(d):
                        total += with_next[i, a, c] * by_next[i, b, c]
                    own[i, a, b] = own[i, b, a] = total


def whitening(noise: Array, directions: Array, component: IntArray, variance: Array) -> Array:
    """Inverse Cholesky factors (N, n, n) of N + Σ v Z Zᵀ, `directions` Z (N, n, q) being each of the component whose
    `variance` it has; of a stack of variances and, perhaps, of directions a stack. Raises LinAlgError where a
    covariance is none."""
    if variance.ndim > 1:
        every = zip(np.broadcast_to(directions, (len(variance), *directions.shape[-3:])), variance, strict=True)
        return np.array([whitening(noise, own, component, v) for own, v in every])
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
