"""Compiled loops that eliminate the attitudes from the rows of a chain of rests linked by turns, and put them back.

Rows are whitened and in the form [coefficients | right-hand side]; unknowns are the three angles of every rest and p
parameters common to all. With δᵢ the angles of rest i, the rows of rest i and of the turn that follows it are

    [ δᵢ (3) | parameters (p) | right-hand side ]             rest, (N, r, 3 + p + 1)
    [ δᵢ (3) | δᵢ₊₁ (3) | parameters (p) | right-hand side ]   turn, (K, t, 6 + p + 1)

and `link[i]` is the turn from rest i to rest i + 1, −1 where nothing links them. The elimination is orthogonal (a
square-root information filter): Householder reflections of what involves δᵢ leave three rows that give δᵢ once the
rest is known, three rows on δᵢ₊₁, carried on, and rows on the parameters alone, folded into one triangle. Nothing is
squared, and the cost is linear in the number of rests. A column of which nothing but rounding is left is no
information: its angle, a heading that nothing shows, stays where it is.

Nothing is compiled when this module is imported; see `tumble.reduction.kernels`, whose rules hold here.
"""

from __future__ import annotations

import numpy as np

from tumble.reduction.kernels import IntArray, _compiled
from tumble.units import Array

ROUNDING = 1e-10
"""A column that an elimination leaves with less than this part of its length has nothing left in it."""


@_compiled(error_model="numpy")
def eliminate(rest: Array, turn: Array, link: IntArray, factor: Array, triangle: Array) -> None:
    """Eliminate the angles of all rests: `factor` (N, 3, 6 + p + 1) gets the rows that give them, and the rows on the
    parameters are folded into `triangle` (p + 1, p + 1), which may hold others before."""
    N, r, width = rest.shape
    t, p = turn.shape[1], width - 4
    work = np.empty((3 + r + t, 7 + p))
    carried = np.zeros((3, 7 + p))
    length = np.zeros(6)  # squares of the columns before anything was taken off them
    for i in range(N):
        k = link[i]
        rows = 3 + r + (t if k >= 0 else 0)
        _gather(work, carried, rest[i], turn, k)
        for c in range(6):
            length[c] = length[c + 3] if c < 3 else 0.0
            for row in range(3, rows):
                length[c] += work[row, c] ** 2
        top = 0
        for c in range(3):
            if _reflect(work, top, c, rows, ROUNDING**2 * length[c]):
                factor[i, c] = work[top]
                top += 1
            else:
                factor[i, c] = 0.0
        carried[:] = 0.0
        for c in range(3, 6):
            if _reflect(work, top, c, rows, ROUNDING**2 * length[c]):
                carried[c - 3, :3] = work[top, 3:6]
                carried[c - 3, 6:] = work[top, 6:]
                top += 1
        _fold(work[top:rows, 6:], triangle)


@_compiled(error_model="numpy")
def _gather(work: Array, carried: Array, rest: Array, turn: Array, k: int) -> None:
    """Put what involves the angles of a rest together: carried rows, its own, and those of turn k."""
    r = len(rest)
    work[:3] = carried
    work[3 : 3 + r, :3] = rest[:, :3]
    work[3 : 3 + r, 3:6] = 0.0
    work[3 : 3 + r, 6:] = rest[:, 3:]
    if k >= 0:
        work[3 + r :] = turn[k]


@_compiled(error_model="numpy")
def _reflect(work: Array, top: int, column: int, rows: int, least: float) -> bool:
    """Reflect rows top … rows − 1 so that below row `top` the column is zero. False, and the column cleared, where it
    has nothing in it."""
    square = 0.0
    for row in range(top, rows):
        square += work[row, column] ** 2
    if square <= least:
        for row in range(top, rows):
            work[row, column] = 0.0
        return False
    head = work[top, column]
    diagonal = -np.sqrt(square) if head > 0.0 else np.sqrt(square)
    work[top, column] = head - diagonal
    scale = 1.0 / (diagonal * (diagonal - head))
    for other in range(column + 1, work.shape[1]):
        product = 0.0
        for row in range(top, rows):
            product += work[row, column] * work[row, other]
        product *= scale
        for row in range(top, rows):
            work[row, other] -= product * work[row, column]
    work[top, column] = diagonal
    for row in range(top + 1, rows):
        work[row, column] = 0.0
    return True


@_compiled(error_model="numpy")
def _fold(rows: Array, triangle: Array) -> None:
    """Fold rows (r, p + 1), which are overwritten, into an upper triangle (p + 1, p + 1): Householder reflections of
    the rows together with one row of the triangle at a time."""
    r, size = rows.shape
    for c in range(size):
        square = 0.0
        for row in range(r):
            square += rows[row, c] ** 2
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
            for row in range(r):
                product += rows[row, c] * rows[row, other]
            product *= scale
            triangle[c, other] -= product * top
            for row in range(r):
                rows[row, other] -= product * rows[row, c]


@_compiled(error_model="numpy")
def put_back(factor: Array, link: IntArray, parameters: Array, covariance: Array, angles: Array) -> tuple[Array, Array]:
    """The angles (N, 3) of the rests for parameters (p,), written to `angles`, and their covariances from the
    covariance (p, p) of the parameters: with themselves and those of the next rest (N, 3, 6), and with the parameters
    (N, 3, p). An angle that nothing shows is zero, and without variance."""
    N, p = len(factor), len(parameters)
    own, shared = np.zeros((N, 3, 6)), np.zeros((N, 3, p))
    for i in range(N - 1, -1, -1):
        linked = link[i] >= 0
        for a in range(2, -1, -1):
            pivot = factor[i, a, a]
            angles[i, a] = 0.0
            if pivot == 0.0:
                continue
            value = factor[i, a, 6 + p]
            for c in range(p):
                value -= factor[i, a, 6 + c] * parameters[c]
            for b in range(a + 1, 3):
                value -= factor[i, a, b] * angles[i, b]
            if linked:
                for b in range(3):
                    value -= factor[i, a, 3 + b] * angles[i + 1, b]
            angles[i, a] = value / pivot
        _covariances(factor[i], linked, covariance, own, shared, i)
    return own, shared


@_compiled(error_model="numpy")
def _covariances(factor: Array, linked: bool, covariance: Array, own: Array, shared: Array, i: int) -> None:
    """Covariances of the angles of rest i, those of rest i + 1 being known: δᵢ = R⁻¹ (ε − R' δᵢ₊₁ − R'' parameters)."""
    p = len(covariance)
    inverse = np.zeros((3, 3))
    for a in range(2, -1, -1):
        if factor[a, a] == 0.0:
            continue
        inverse[a, a] = 1.0 / factor[a, a]
        for b in range(a + 1, 3):
            for c in range(a + 1, b + 1):
                inverse[a, b] -= factor[a, c] * inverse[c, b]
            inverse[a, b] /= factor[a, a]
    by_next, by_parameter = np.zeros((3, 3)), np.zeros((3, p))
    for a in range(3):
        for b in range(a, 3):
            for c in range(p):
                by_parameter[a, c] -= inverse[a, b] * factor[b, 6 + c]
            if linked:
                for c in range(3):
                    by_next[a, c] -= inverse[a, b] * factor[b, 3 + c]
    for a in range(3):
        for d in range(p):
            total = 0.0
            for c in range(p):
                total += by_parameter[a, c] * covariance[c, d]
            if linked:
                for c in range(3):
                    total += by_next[a, c] * shared[i + 1, c, d]
            shared[i, a, d] = total
        if linked:
            for b in range(3):
                total = 0.0
                for c in range(p):
                    total += by_parameter[a, c] * shared[i + 1, b, c]
                for c in range(3):
                    total += by_next[a, c] * own[i + 1, c, b]
                own[i, a, 3 + b] = total
    for a in range(3):
        for b in range(3):
            total = 0.0
            for c in range(3):
                total += inverse[a, c] * inverse[b, c]
            for c in range(p):
                total += by_parameter[b, c] * shared[i, a, c]
            if linked:
                for c in range(3):
                    total += by_next[b, c] * own[i, a, 3 + c]
            own[i, a, b] = total


@_compiled(error_model="numpy")
def left_over(
    rest: Array,
    turn: Array,
    link: IntArray,
    angles: Array,
    parameters: Array,
    covariances: tuple[Array, Array, Array],
) -> tuple[Array, Array, Array, Array]:
    """Residuals that the rows leave, and their covariances where the noise of the rows is 1: (N, r) and (N, r, r) of
    the rests, (K, t) and (K, t, t) of the turns. `covariances`: of the parameters, and what `put_back` returns."""
    N, r = rest.shape[:2]
    K, t = turn.shape[:2]
    covariance, own, shared = covariances
    p = len(parameters)
    rest_left, rest_covariance = np.empty((N, r)), np.empty((N, r, r))
    turn_left, turn_covariance = np.empty((K, t)), np.empty((K, t, t))
    unknown, joint = np.empty(6 + p), np.zeros((6 + p, 6 + p))
    unknown[6:], joint[6:, 6:] = parameters, covariance
    for i in range(N):
        unknown[:3] = angles[i]
        joint[:3, :3], joint[:3, 6:], joint[6:, :3] = own[i, :, :3], shared[i], shared[i].T
        _left(rest[i], 3, unknown, joint, rest_left[i], rest_covariance[i])
        k = link[i]
        if k >= 0:
            unknown[3:6] = angles[i + 1]
            joint[3:6, 3:6], joint[3:6, 6:], joint[6:, 3:6] = own[i + 1, :, :3], shared[i + 1], shared[i + 1].T
            joint[:3, 3:6], joint[3:6, :3] = own[i, :, 3:], own[i, :, 3:].T
            _left(turn[k], 6, unknown, joint, turn_left[k], turn_covariance[k])
    return rest_left, rest_covariance, turn_left, turn_covariance


@_compiled(error_model="numpy")
def _left(rows: Array, first: int, unknown: Array, joint: Array, residual: Array, covariance: Array) -> None:
    """What rows on `first` angles and the parameters leave: with `unknown` and its covariance `joint`, six angles and
    the parameters; of three angles the others are passed over."""
    count, columns = len(rows), rows.shape[1] - 1
    skipped = 6 - first
    by = np.empty(columns)
    for a in range(count):
        residual[a] = rows[a, columns]
        for c in range(columns):
            place = c if c < first else c + skipped
            residual[a] -= rows[a, c] * unknown[place]
            total = 0.0
            for d in range(columns):
                total += joint[place, d if d < first else d + skipped] * rows[a, d]
            by[c] = total
        for b in range(count):
            total = 1.0 if a == b else 0.0
            for c in range(columns):
                total -= rows[b, c] * by[c]
            covariance[a, b] = total


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
