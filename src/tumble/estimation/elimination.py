"""Compiled loops that eliminate what belongs to single rests from the rows of a chain of rests linked by turns, and put
it back.

Rows are whitened and in the form [coefficients | right-hand side]; unknowns are d numbers of every rest (the three
angles of its attitude first, then the states of its sensors) and p parameters common to all. With δᵢ the unknowns of
rest i, the rows of rest i and of the turn that follows it are

    [ δᵢ (d) | parameters (p) | right-hand side ]             rest, (N, r, d + p + 1)
    [ δᵢ (d) | δᵢ₊₁ (d) | parameters (p) | right-hand side ]   turn, (K, t, 2d + p + 1)

and `link[i]` is the turn from rest i to rest i + 1, −1 where nothing links them. Rows of a turn may contain those of
the rest before it, with which they may be correlated: `counts` (N,) says whether a rest's own rows count. The
elimination is orthogonal (a square-root information filter): Householder reflections of what involves δᵢ leave d
rows that give δᵢ once the rest is known, rows on δᵢ₊₁, carried on, and rows on the parameters alone, folded into one
triangle. Nothing is squared, and the cost is linear in the number of rests. A column of which nothing but rounding
is left is no information: its unknown, a heading that nothing shows, stays where it is. Rows stand in memory column
by column, so that the loops over them are vector instructions.

Sums are taken in the order that is written: a compiler that may choose another one chooses differently from one
compilation to the next, and rows of a campaign would differ in the last digit from process to process.

Nothing is compiled when this module is imported; see `tumble.reduction.kernels`, whose rules hold here.
"""

from __future__ import annotations

import numpy as np

from tumble.reduction.kernels import IntArray, _compiled
from tumble.units import Array, BoolArray

ROUNDING = 1e-10
"""A column that an elimination leaves with less than this part of its length has nothing left in it."""

BUFFER = 96
"""Rows on the parameters that are folded into the triangle together."""


@_compiled(error_model="numpy")
def eliminate(rest: Array, turn: Array, link: IntArray, counts: BoolArray, factor: Array, triangle: Array) -> None:
    """Eliminate the unknowns of all rests: `factor` (N, d, 2d + p + 1) gets the rows that give them, and the rows on
    the parameters are folded into `triangle` (p + 1, p + 1), which may hold others before."""
    N, r = rest.shape[:2]
    t, d, p = turn.shape[1], factor.shape[1], len(triangle) - 1
    rows_most, columns = d + r + t, 2 * d + p + 1
    work = np.zeros((columns, rows_most))
    carried = np.zeros((columns, d))
    kept = np.zeros((p + 1, BUFFER + rows_most))
    count = 0
    length = np.zeros(2 * d)  # squares of the columns before anything was taken off them
    for i in range(N):
        k = link[i]
        rows = _gather(work, carried, rest[i, : r if counts[i] else 0], turn, k)
        for c in range(2 * d):
            length[c] = length[c + d] if c < d else 0.0
            for row in range(d, rows):
                length[c] += work[c, row] ** 2
        top = 0
        for c in range(d):
            if _reflect(work, top, c, rows, ROUNDING**2 * length[c]):
                factor[i, c] = work[:, top]
                top += 1
            else:
                factor[i, c] = 0.0
        carried[:] = 0.0
        for c in range(d, 2 * d):
            if _reflect(work, top, c, rows, ROUNDING**2 * length[c]):
                carried[:d, c - d] = work[d : 2 * d, top]
                carried[2 * d :, c - d] = work[2 * d :, top]
                top += 1
        kept[:, count : count + rows - top] = work[2 * d :, top:rows]
        count += rows - top
        if count > BUFFER:
            _fold(kept, count, triangle)
            count = 0
    _fold(kept, count, triangle)


@_compiled(error_model="numpy")
def _gather(work: Array, carried: Array, rest: Array, turn: Array, k: int) -> int:
    """Put what involves the unknowns of a rest together: carried rows, its own, and those of turn k; how many."""
    d, r = carried.shape[1], len(rest)
    work[:, :d] = carried
    work[:d, d : d + r] = rest[:, :d].T
    work[d : 2 * d, d : d + r] = 0.0
    work[2 * d :, d : d + r] = rest[:, d:].T
    if k < 0:
        return int(d + r)
    t = turn.shape[1]
    work[:, d + r : d + r + t] = turn[k].T
    return int(d + r + t)


@_compiled(error_model="numpy")
def _reflect(work: Array, top: int, column: int, rows: int, least: float) -> bool:
    """Reflect rows top … rows − 1 so that below row `top` the column is zero. False, and the column cleared, where it
    has nothing in it."""
    square = 0.0
    for row in range(top, rows):
        square += work[column, row] ** 2
    if square <= least:
        for row in range(top, rows):
            work[column, row] = 0.0
        return False
    head = work[column, top]
    diagonal = -np.sqrt(square) if head > 0.0 else np.sqrt(square)
    work[column, top] = head - diagonal
    scale = 1.0 / (diagonal * (diagonal - head))
    for other in range(column + 1, work.shape[0]):
        product = 0.0
        for row in range(top, rows):
            product += work[column, row] * work[other, row]
        if product == 0.0:
            continue
        product *= scale
        for row in range(top, rows):
            work[other, row] -= product * work[column, row]
    work[column, top] = diagonal
    for row in range(top + 1, rows):
        work[column, row] = 0.0
    return True


@_compiled(error_model="numpy")
def _fold(kept: Array, count: int, triangle: Array) -> None:
    """Fold rows (p + 1, count), column by column in memory and overwritten, into an upper triangle (p + 1, p + 1):
    Householder reflections of the rows together with one row of the triangle at a time."""
    size = len(triangle)
    for c in range(size):
        square = 0.0
        for row in range(count):
            square += kept[c, row] ** 2
        if square == 0.0:
            continue
        head = triangle[c, c]
        root = np.sqrt(square + head * head)
        diagonal = -root if head > 0.0 else root
        top = head - diagonal
        scale = 1.0 / (diagonal * (diagonal - head))
        triangle[c, c] = diagonal
        for other in range(c + 1, size):
            product = top * triangle[c, other]
            for row in range(count):
                product += kept[c, row] * kept[other, row]
            product *= scale
            triangle[c, other] -= product * top
            for row in range(count):
                kept[other, row] -= product * kept[c, row]


@_compiled(error_model="numpy")
def put_back(
    factor: Array, link: IntArray, parameters: Array, covariance: Array, unknowns: Array
) -> tuple[Array, Array]:
    """The unknowns (N, d) of the rests for parameters (p,), written to `unknowns`, and their covariances from the
    covariance (p, p) of the parameters: with themselves and those of the next rest (N, d, 2d), and with the parameters
    (N, d, p). An unknown that nothing shows is zero, and without variance."""
    N, d, p = factor.shape[0], factor.shape[1], len(parameters)
    own, shared = np.zeros((N, d, 2 * d)), np.zeros((N, d, p))
    inverse = np.zeros((d, d))
    for i in range(N - 1, -1, -1):
        linked = link[i] >= 0
        _inverse(factor[i], inverse)
        by_parameter = -np.dot(inverse, np.ascontiguousarray(factor[i, :, 2 * d : 2 * d + p]))
        value = np.dot(inverse, np.ascontiguousarray(factor[i, :, 2 * d + p])) + np.dot(by_parameter, parameters)
        shared[i] = np.dot(by_parameter, covariance)
        covariance_i = np.dot(inverse, inverse.T.copy())
        if linked:
            by_next = -np.dot(inverse, np.ascontiguousarray(factor[i, :, d : 2 * d]))
            value += np.dot(by_next, unknowns[i + 1])
            shared[i] += np.dot(by_next, shared[i + 1])
            with_next = np.dot(by_parameter, shared[i + 1].T.copy())
            with_next += np.dot(by_next, np.ascontiguousarray(own[i + 1, :, :d]))
            own[i, :, d:] = with_next
            covariance_i += np.dot(with_next, by_next.T.copy())
        covariance_i += np.dot(shared[i], by_parameter.T.copy())
        own[i, :, :d] = covariance_i
        unknowns[i] = value
    return own, shared


@_compiled(error_model="numpy")
def _inverse(factor: Array, inverse: Array) -> None:
    """Inverse of the triangle in the first columns of a rest's factor; rows and columns of unknowns that nothing shows
    are zero."""
    d = len(factor)
    inverse[:] = 0.0
    for a in range(d - 1, -1, -1):
        if factor[a, a] == 0.0:
            continue
        inverse[a, a] = 1.0 / factor[a, a]
        for b in range(a + 1, d):
            total = 0.0
            for c in range(a + 1, b + 1):
                total -= factor[a, c] * inverse[c, b]
            inverse[a, b] = total / factor[a, a]


@_compiled(error_model="numpy")
def left_over(
    rest: Array,
    turn: Array,
    link: IntArray,
    counts: BoolArray,
    unknowns: Array,
    parameters: Array,
    covariances: tuple[Array, Array, Array],
) -> tuple[Array, Array, Array, Array]:
    """Residuals that the rows leave, and their covariances where the noise of the rows is 1: (N, r) and (N, r, r) of
    the rests, zero where they do not count, (K, t) and (K, t, t) of the turns. `covariances`: of the parameters, and
    what `put_back` returns."""
    N, r = rest.shape[:2]
    K, t = turn.shape[:2]
    covariance, own, shared = covariances
    p, d = len(covariance), unknowns.shape[1]
    rest_left, rest_covariance = np.zeros((N, r)), np.zeros((N, r, r))
    turn_left, turn_covariance = np.empty((K, t)), np.empty((K, t, t))
    joint = np.zeros((2 * d + p, 2 * d + p))
    joint[2 * d :, 2 * d :] = covariance
    unknown = np.empty(2 * d + p)
    unknown[2 * d :] = parameters
    wide = np.zeros((r, 2 * d + p))
    for i in range(N):
        unknown[:d] = unknowns[i]
        joint[:d, :d], joint[:d, 2 * d :], joint[2 * d :, :d] = own[i, :, :d], shared[i], shared[i].T
        k = link[i]
        if counts[i]:
            wide[:, :d], wide[:, 2 * d :] = rest[i, :, :d], rest[i, :, d : d + p]
            unknown[d : 2 * d] = 0.0
            rest_left[i] = rest[i, :, d + p] - np.dot(wide, unknown)
            rest_covariance[i] = np.eye(r) - np.dot(np.dot(wide, joint), wide.T.copy())
        if k >= 0:
            unknown[d : 2 * d] = unknowns[i + 1]
            joint[d : 2 * d, d : 2 * d] = own[i + 1, :, :d]
            joint[d : 2 * d, 2 * d :], joint[2 * d :, d : 2 * d] = shared[i + 1], shared[i + 1].T
            joint[:d, d : 2 * d], joint[d : 2 * d, :d] = own[i, :, d:], own[i, :, d:].T
            rows = np.ascontiguousarray(turn[k, :, : 2 * d + p])
            turn_left[k] = turn[k, :, 2 * d + p] - np.dot(rows, unknown)
            turn_covariance[k] = np.eye(t) - np.dot(np.dot(rows, joint), rows.T.copy())
    return rest_left, rest_covariance, turn_left, turn_covariance


@_compiled(error_model="numpy")
def carry(vertical: Array, C: Array, link: IntArray, turned: Array, attitudes: Array) -> None:
    """Attitudes (N, 3, 3) with the verticals (N, 3), and with the heading that the turns C (K, 3, 3) carry along each
    chain, whose first heading is any; in turn k the Earth turns by `turned[k]` about the vertical."""
    for i in range(len(vertical)):
        u, L = vertical[i], attitudes[i]
        L[0] = 0.0
        if i > 0 and link[i - 1] >= 0:
            before, k = attitudes[i - 1], link[i - 1]
            cosine, sine = np.cos(turned[k]), np.sin(turned[k])
            for a in range(3):
                for b in range(3):
                    L[0, a] += (cosine * before[0, b] - sine * before[2, b]) * C[k, b, a]
        if np.abs(_dot(L[0], L[0]) - _dot(L[0], u) ** 2) < 1e-2:  # nothing before, or north has become the vertical
            L[0] = 0.0
            L[0, np.argmin(np.abs(u))] = 1.0
        along = _dot(L[0], u)
        for a in range(3):
            L[0, a] -= along * u[a]
        size = np.sqrt(_dot(L[0], L[0]))
        for a in range(3):
            L[0, a] /= size
            L[1, a] = u[a]
        L[2, 0] = L[0, 1] * u[2] - L[0, 2] * u[1]
        L[2, 1] = L[0, 2] * u[0] - L[0, 0] * u[2]
        L[2, 2] = L[0, 0] * u[1] - L[0, 1] * u[0]


@_compiled(error_model="numpy")
def _dot(a: Array, b: Array) -> float:
    """Scalar product of vectors of three."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]  # type: ignore[no-any-return]
