"""Nine accelerometer parameters from rests alone, for very many triads at once: what a rest says without its attitude.

The mean reading y of a rest is y = S a + b, a the specific force, |a| = g in an unknown direction, S = diag(1 + k) A(γ)
the matrix of Eq. (1), lower triangular for accelerometers. What the three readings say beyond the two angles of the
attitude is how far y is from the ellipsoid |S⁻¹(y − b)| = g. With a = S⁻¹(y − b) and the normal n ∥ S⁻ᵀa, |n| = 1,

    distance r = (|a| − g) / |S⁻ᵀ a/|a||,      dr/dθ = −n · (dS/dθ a + db/dθ)

to first order, so that Gauss–Newton on r for all nine parameters is the maximum-likelihood estimate from rests with
free attitudes and equal noise in all readings. (Σ hᵀh)⁻¹ σ² is its covariance, at the true values the Cramér–Rao bound.

LANES triads go through every loop side by side, a loop that the compiler turns into vector instructions; the plain twin
is in tests/naive.py. Eqs. (12) and (13) of the turntable paper, converged, with the weights of
the readings' noise.
"""

from __future__ import annotations

import numpy as np

from tumble.units import Array

try:
    import cython
except ImportError:
    from tumble import uncompiled as cython

# C: from libc.math cimport cos, sin, sqrt
# C: cpdef enum:
# C:     PARAMETERS = 9
# C:     LANES = 16
# C:     _ROWS = 10
# C:     _MODEL = 14
# C:     _TOGETHER = 4
# C:     _SUMS = 55

STEPS = 5
"""Gauss–Newton steps: from zero, sensors that are off by 5 % are known to rounding after five."""

if not cython.compiled:  # where it is, these are numbers of C
    from numpy import cos, sin, sqrt

    PARAMETERS = 9
    LANES = 16
    _ROWS = 10
    _MODEL = 14
    _TOGETHER = 4
    _SUMS = _ROWS * (_ROWS + 1) // 2


def fit_statics(readings: Array, gravity: float, start: Array | None = None) -> tuple[Array, Array, Array]:
    """Values (n, 9) of n triads along the body axes, their variances (n, 9) for unit noise of every mean reading, and
    the last Gauss–Newton step (n, 9), from mean readings (n, N, 3) in N rests, m/s².

    Parameters in the order of the calibration file: biases, m/s², scale-factor errors, axis angles yx, zx, zy, rad.
    They start from `start` (n, 9) or zero. Rests that do not determine them leave what is not finite."""
    readings = np.ascontiguousarray(readings, dtype=np.float64)
    n = len(readings)
    values = np.zeros((n, PARAMETERS)) if start is None else np.array(start, dtype=np.float64)
    variance, step = np.empty((n, PARAMETERS)), np.empty((n, PARAMETERS))
    tile = np.empty((readings.shape[1] * 3, LANES))
    rows = (PARAMETERS, _MODEL, _SUMS, PARAMETERS, PARAMETERS, _TOGETHER * _ROWS)
    theta, model, sums, spread, column, h = (np.zeros((count, LANES)) for count in rows)
    _fit(readings, float(gravity), STEPS, values, variance, step, tile, theta, model, sums, spread, column, h)
    return values, variance, step


# C: cdef void _fit(const double[:, :, ::1] readings, double gravity, Py_ssize_t steps, double[:, ::1] values,
# C:     double[:, ::1] variance, double[:, ::1] step, double[:, ::1] tile, double[:, ::1] theta, double[:, ::1] model,
# C:     double[:, ::1] sums, double[:, ::1] spread, double[:, ::1] column, double[:, ::1] h)
def _fit(
    readings: Array,
    gravity: float,
    steps: int,
    values: Array,
    variance: Array,
    step: Array,
    tile: Array,
    theta: Array,
    model: Array,
    sums: Array,
    spread: Array,
    column: Array,
    h: Array,
) -> None:
    """LANES triads at a time; the last group is filled up with copies of the last triad."""
    n, rests = readings.shape[0], readings.shape[1]
    with cython.nogil:
        for group in range((n + LANES - 1) // LANES):
            first = group * LANES
            for lane in range(LANES):
                triad = min(first + lane, n - 1)
                for j in range(rests):
                    for p in range(3):
                        tile[3 * j + p, lane] = readings[triad, j, p]
                for m in range(PARAMETERS):
                    theta[m, lane] = values[triad, m]
            for _ in range(steps):
                _model(theta, model)
                _accumulate(tile, gravity, theta, model, h, sums)
                _factorise(sums)
                _solve(sums, theta)
            _variances(sums, column, spread)
            for lane in range(min(LANES, n - first)):
                for m in range(PARAMETERS):
                    values[first + lane, m] = theta[m, lane]
                    step[first + lane, m] = sums[_at(PARAMETERS, m), lane]
                    variance[first + lane, m] = spread[m, lane]


# C: cdef Py_ssize_t _at(Py_ssize_t row, Py_ssize_t column) noexcept nogil
def _at(row: int, column: int) -> int:
    """Where an element of a lower triangle is."""
    return row * (row + 1) // 2 + column


# C: cdef void _model(double[:, ::1] theta, double[:, ::1] model) noexcept nogil
def _model(theta: Array, model: Array) -> None:
    """What the parameters (9, lanes) mean: per lane sin and cos of γ_yx, γ_zx, γ_zy; 1 + k and its inverse; the
    inverses of the diagonal of A in rows y and z."""
    for lane in range(LANES):
        for i in range(3):
            model[2 * i, lane] = sin(theta[6 + i, lane])
            model[2 * i + 1, lane] = cos(theta[6 + i, lane])
            model[6 + i, lane] = 1.0 + theta[3 + i, lane]
            model[9 + i, lane] = 1.0 / model[6 + i, lane]
        model[12, lane] = 1.0 / model[1, lane]
        model[13, lane] = 1.0 / (model[3, lane] * model[5, lane])


# C: cdef void _accumulate(double[:, ::1] tile, double gravity, double[:, ::1] theta, double[:, ::1] model,
# C:     double[:, ::1] h, double[:, ::1] sums) noexcept nogil
def _accumulate(tile: Array, gravity: float, theta: Array, model: Array, h: Array, sums: Array) -> None:
    """Lower triangle of Σ (h, r)ᵀ(h, r) over the rests, h = −dr/dθ; _TOGETHER rests at a time, of which h has a row
    for each number."""
    rests = tile.shape[0] // 3
    sums[:, :] = 0.0
    for group in range((rests + _TOGETHER - 1) // _TOGETHER):
        first = group * _TOGETHER
        for j in range(_TOGETHER):
            if first + j < rests:
                _row(tile, 3 * (first + j), gravity, theta, model, h, j * _ROWS)
            else:
                for row in range(_ROWS):
                    for lane in range(LANES):
                        h[j * _ROWS + row, lane] = 0.0
        for row in range(_ROWS):
            for column in range(row + 1):
                at = row * (row + 1) // 2 + column
                for lane in range(LANES):
                    sums[at, lane] += (
                        h[row, lane] * h[column, lane]
                        + h[_ROWS + row, lane] * h[_ROWS + column, lane]
                        + h[2 * _ROWS + row, lane] * h[2 * _ROWS + column, lane]
                        + h[3 * _ROWS + row, lane] * h[3 * _ROWS + column, lane]
                    )


# C: @cython.locals(vx=double, vy=double, vz=double)
# C: cdef void _row(double[:, ::1] tile, Py_ssize_t at, double gravity, double[:, ::1] theta, double[:, ::1] model,
# C:     double[:, ::1] h, Py_ssize_t to) noexcept nogil
def _row(tile: Array, at: int, gravity: float, theta: Array, model: Array, h: Array, to: int) -> None:
    """h and r (10, lanes) of a rest whose readings are three rows of `tile`, to the rows of `h` from `to`."""
    for lane in range(LANES):
        s_yx, c_yx, s_zx, c_zx = model[0, lane], model[1, lane], model[2, lane], model[3, lane]
        s_zy, c_zy, fy, fz = model[4, lane], model[5, lane], model[7, lane], model[8, lane]
        along_y = (tile[at + 1, lane] - theta[1, lane]) * model[10, lane]
        along_z = (tile[at + 2, lane] - theta[2, lane]) * model[11, lane]
        ax = (tile[at, lane] - theta[0, lane]) * model[9, lane]
        ay = (along_y - s_yx * ax) * model[12, lane]
        az = (along_z - s_zx * ax - c_zx * s_zy * ay) * model[13, lane]
        size = sqrt(ax * ax + ay * ay + az * az)
        vz = az * model[13, lane]
        vy = (ay - c_zx * s_zy * vz) * model[12, lane]
        vx = (ax - s_yx * vy - s_zx * vz) * model[9, lane]
        vy, vz = vy * model[10, lane], vz * model[11, lane]
        shrink = 1.0 / sqrt(vx * vx + vy * vy + vz * vz)
        nx, ny, nz = vx * shrink, vy * shrink, vz * shrink
        h[to, lane], h[to + 1, lane], h[to + 2, lane] = nx, ny, nz
        h[to + 3, lane], h[to + 4, lane], h[to + 5, lane] = nx * ax, ny * along_y, nz * along_z
        h[to + 6, lane] = ny * fy * (c_yx * ax - s_yx * ay)
        h[to + 7, lane] = nz * fz * (c_zx * ax - s_zx * (s_zy * ay + c_zy * az))
        h[to + 8, lane] = nz * fz * c_zx * (c_zy * ay - s_zy * az)
        h[to + 9, lane] = (size - gravity) * size * shrink


# C: cdef void _factorise(double[:, ::1] sums) noexcept nogil
def _factorise(sums: Array) -> None:
    """Cholesky factor L of the first nine rows in place; the tenth becomes L⁻¹ Σ hᵀ r."""
    for row in range(_ROWS):
        for column in range(min(row + 1, PARAMETERS)):
            at = row * (row + 1) // 2 + column
            for i in range(column):
                left, right = row * (row + 1) // 2 + i, column * (column + 1) // 2 + i
                for lane in range(LANES):
                    sums[at, lane] -= sums[left, lane] * sums[right, lane]
            if row == column:
                for lane in range(LANES):
                    sums[at, lane] = sqrt(sums[at, lane])
            else:
                diagonal = column * (column + 1) // 2 + column
                for lane in range(LANES):
                    sums[at, lane] /= sums[diagonal, lane]


# C: cdef void _solve(double[:, ::1] sums, double[:, ::1] theta) noexcept nogil
def _solve(sums: Array, theta: Array) -> None:
    """The step L⁻ᵀ (L⁻¹ Σ hᵀ r), in the tenth row, added to the parameters."""
    for back in range(PARAMETERS):
        row = PARAMETERS - 1 - back
        at = _at(PARAMETERS, row)
        for i in range(row + 1, PARAMETERS):
            for lane in range(LANES):
                sums[at, lane] -= sums[_at(i, row), lane] * sums[_at(PARAMETERS, i), lane]
        for lane in range(LANES):
            sums[at, lane] /= sums[_at(row, row), lane]
            theta[row, lane] += sums[at, lane]


# C: cdef void _variances(double[:, ::1] sums, double[:, ::1] column, double[:, ::1] spread) noexcept nogil
def _variances(sums: Array, column: Array, spread: Array) -> None:
    """Diagonal (9, lanes) of (L Lᵀ)⁻¹: squares of the columns of L⁻¹."""
    for m in range(PARAMETERS):
        for row in range(m, PARAMETERS):
            for lane in range(LANES):
                column[row, lane] = 1.0 if row == m else 0.0
            for i in range(m, row):
                at = row * (row + 1) // 2 + i
                for lane in range(LANES):
                    column[row, lane] -= sums[at, lane] * column[i, lane]
            at = row * (row + 1) // 2 + row
            for lane in range(LANES):
                column[row, lane] /= sums[at, lane]
        for lane in range(LANES):
            spread[m, lane] = column[m, lane] * column[m, lane]
        for row in range(m + 1, PARAMETERS):
            for lane in range(LANES):
                spread[m, lane] += column[row, lane] * column[row, lane]
