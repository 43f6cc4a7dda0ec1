"""Compiled loops over what a least-squares step leaves of whitened residuals, and what that says of components of
variance.

The rules of `tumble.reduction.kernels` hold.
"""

from __future__ import annotations

import numpy as np

from tumble.units import Array, IntArray

try:
    import cython
except ImportError:
    from tumble import uncompiled as cython

# C: from libc.stdint cimport int64_t


def leave(rows: Array, first: IntArray, known: tuple[Array, Array, Array], step: Array, predicted: Array) -> Array:
    """Residuals (M, r) that rows (M, r, ·) of one rest or two each, from the `first` (M,) on, have after the step of
    the unknowns of these rests and that of all others (p,). Of the former their step (N, d), their covariances with
    themselves and those of the next rest (2, N, d, d), and those with the others (N, d, p) are `known`. The covariances
    `predicted` (M, r, r) of what the rows predict by the others alone become those of the residuals, 1 − A C Aᵀ."""
    angles, own, shared = known
    residual, work = np.empty(rows.shape[:2]), np.empty((rows.shape[1], rows.shape[2] - len(step) - 1))
    _leave(rows, first, angles, own, shared, step, predicted, residual, work)
    return residual


# C: @cython.locals(total=double, half=double, across=double, i=Py_ssize_t, k=Py_ssize_t, a=Py_ssize_t, b=Py_ssize_t,
# C:     c=Py_ssize_t, r=Py_ssize_t, p=Py_ssize_t, d=Py_ssize_t, row=Py_ssize_t, other=Py_ssize_t)
# C: cdef void _leave(const double[:, :, ::1] rows, const int64_t[:] first, const double[:, :] angles,
# C:     const double[:, :, :, ::1] own, const double[:, :, ::1] shared, const double[::1] step,
# C:     double[:, :, ::1] covariance, double[:, ::1] residual, double[:, ::1] work)
def _leave(
    rows: Array,
    first: IntArray,
    angles: Array,
    own: Array,
    shared: Array,
    step: Array,
    covariance: Array,
    residual: Array,
    work: Array,
) -> None:
    """One set of rows after the other, A the columns of the unknowns of rests and B the others: with S the covariance
    of the former and T that of the former with the others, 1 − G Aᵀ − A Gᵀ − B C Bᵀ, G = ½ A S + B Tᵀ."""
    r, a, p = rows.shape[1], work.shape[1], step.shape[0]
    with cython.nogil:
        for k in range(rows.shape[0]):
            i = first[k]
            d = angles.shape[1]
            for row in range(r):
                total = rows[k, row, a + p]
                for c in range(p):
                    total -= rows[k, row, a + c] * step[c]
                for b in range(a):
                    total -= rows[k, row, b] * angles[i + b // d, b % d]
                    half = 0.0
                    for c in range(a):
                        half += rows[k, row, c] * _of_unknowns(own, i, d, b, c)
                    across = 0.0
                    for c in range(p):
                        across += rows[k, row, a + c] * shared[i + b // d, b % d, c]
                    work[row, b] = 0.5 * half + across
                residual[k, row] = total
            for row in range(r):
                for other in range(row + 1):
                    total = 1.0 if row == other else 0.0
                    total -= covariance[k, row, other]
                    for b in range(a):
                        total -= work[row, b] * rows[k, other, b] + rows[k, row, b] * work[other, b]
                    covariance[k, row, other] = total
                    covariance[k, other, row] = total


# C: cdef double _of_unknowns(const double[:, :, :, ::1] own, Py_ssize_t i, Py_ssize_t d, Py_ssize_t a, Py_ssize_t b
# C:     ) noexcept nogil
def _of_unknowns(own: Array, i: int, d: int, a: int, b: int) -> float:
    """The covariance of two of the unknowns of rest i and the next, of those with themselves and with the next."""
    if a < d:
        return own[0, i, a, b] if b < d else own[1, i, a, b - d]  # type: ignore[no-any-return]
    return own[0, i + 1, a - d, b - d] if b >= d else own[1, i, b, a - d]  # type: ignore[no-any-return]


def score(directions: Array, component: IntArray, left: tuple[Array, Array], slope: Array, information: Array) -> None:
    """Add to the `slope` (5,) and `information` (5, 5) of a restricted likelihood by the variances of its components
    what residuals r (N, n) of covariance C (N, n, n) say, whitened `directions` Z (N, n, q) being each of a component:

    ½ (|Zᵀ r|² − tr Zᵀ C Z),    ½ Σ (Zᵀ C Z)²
    """
    residual, covariance = left
    work, product = np.zeros(directions.shape[1:]), np.zeros(len(component))
    _score(directions, component, residual, covariance, work, product, slope, information)


# C: @cython.locals(part=double, along=double, a=Py_ssize_t, b=Py_ssize_t, c=Py_ssize_t, d=Py_ssize_t, k=Py_ssize_t)
# C: cdef void _score(const double[:, :, ::1] directions, const int64_t[:] component, const double[:, :] residual,
# C:     const double[:, :, ::1] covariance, double[:, ::1] work, double[::1] product, double[::1] slope,
# C:     double[:, ::1] information)
def _score(
    directions: Array,
    component: IntArray,
    residual: Array,
    covariance: Array,
    work: Array,
    product: Array,
    slope: Array,
    information: Array,
) -> None:
    """One residual after the other."""
    N, n, q = directions.shape[0], directions.shape[1], directions.shape[2]
    with cython.nogil:
        for k in range(N):
            work[:, :] = 0.0
            for a in range(n):
                for b in range(n):
                    part = covariance[k, a, b]
                    for c in range(q):
                        work[a, c] += part * directions[k, b, c]
            for c in range(q):
                product[:] = 0.0
                along = 0.0
                for a in range(n):
                    part = directions[k, a, c]
                    along += part * residual[k, a]
                    for d in range(q):
                        product[d] += part * work[a, d]
                slope[component[c]] += 0.5 * (along * along - product[c])
                for d in range(q):
                    information[component[c], component[d]] += 0.5 * product[d] * product[d]
