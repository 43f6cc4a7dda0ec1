"""Compiled loops that write the rows of the likelihood: residuals and analytic Jacobians of all rests or turns at once.
They are derived in `tumble.inference.likelihood`; functions β are in the order of `tumble.sensors.parameters`: 1, ω,
f, the six products of f, |u| and u³ along the sensor's own axis.

The rules of `tumble.reduction.kernels` hold.
"""

from __future__ import annotations

import numpy as np

from tumble.units import Array, IntArray

try:
    import cython
except ImportError:
    from tumble import uncompiled as cython

# C: from libc.math cimport atan2, fabs, sin, sqrt, tan
# C: from libc.stdint cimport int64_t

if not cython.compiled:
    from numpy import arctan2 as atan2
    from numpy import fabs, sin, sqrt, tan


# Rests ---------------------------------------------------------------------------------------------------------


def add_rests(
    about: tuple[Array, Array, Array],
    sensors: tuple[Array, int],
    model: tuple[Array, Array, IntArray],
    observed: Array,
    rows: Array,
    top: int,
) -> None:
    """Fill in rows (N, ·, 5 + m …) of rests, from row `top` on: of readings `observed` (N, n) of sensors with axes
    (n, 3), of accelerometers (0) or gyros (1), `about` attitudes (N, 3, 3), specific force (3,) and rate (3,) in
    geographic axes, with coefficients K (n, 15) and ∂K/∂θ (n, 15, m), of which some functions are used."""
    (attitudes, force, rate), (axes, kind), (K, D, used) = about, sensors, model
    _add_rests(attitudes, force, rate, axes, kind, K, D, used, observed, rows, top, np.zeros((3, 15)))


# C: @cython.locals(i=Py_ssize_t, k=Py_ssize_t, p=Py_ssize_t, b=Py_ssize_t, m=Py_ssize_t, last=Py_ssize_t,
# C:     column=Py_ssize_t, residual=double, value=double)
# C: cdef void _add_rests(const double[:, :, :] attitudes, const double[:] force, const double[:] rate,
# C:     const double[:, :] axes, int kind, const double[:, :] K, const double[:, :, ::1] D, const int64_t[:] used,
# C:     const double[:, :] observed, double[:, :, ::1] rows, Py_ssize_t top, double[:, ::1] work)
def _add_rests(
    attitudes: Array,
    force: Array,
    rate: Array,
    axes: Array,
    kind: int,
    K: Array,
    D: Array,
    used: IntArray,
    observed: Array,
    rows: Array,
    top: int,
    work: Array,
) -> None:
    """One sensor of a rest after the other."""
    m, last = D.shape[2], rows.shape[2] - 1
    with cython.nogil:
        beta, f, w = work[0], work[1, :3], work[1, 3:6]
        by_force, by_rate = work[2, :3], work[2, 3:6]
        for i in range(rows.shape[0]):
            L = attitudes[i]
            for k in range(3):
                f[k] = force[0] * L[0, k] + force[1] * L[1, k] + force[2] * L[2, k]
                w[k] = rate[0] * L[0, k] + rate[1] * L[1, k] + rate[2] * L[2, k]
            for p in range(axes.shape[0]):
                row = rows[i, top + p]
                _functions(axes[p], kind, f, w, beta)
                _slopes(axes[p], kind, f, beta, K[p], by_force, by_rate)
                row[0] = _triple(by_force, f, L[0]) + _triple(by_rate, w, L[0])
                row[1] = -_triple(by_force, f, L[2]) - _triple(by_rate, w, L[2])
                row[2] = _triple(by_rate, w, L[1])
                row[3] = by_force[0] * L[1, 0] + by_force[1] * L[1, 1] + by_force[2] * L[1, 2]
                residual = observed[i, p]
                for b in range(15):
                    residual -= beta[b] * K[p, b]
                row[last] = residual
                for column in range(m):
                    row[4 + column] = 0.0
                for b in range(used.shape[0]):
                    value = beta[used[b]]
                    for column in range(m):
                        row[4 + column] += value * D[p, used[b], column]


# C: @cython.locals(k=Py_ssize_t, own=double)
# C: cdef void _functions(const double[:] axis, int kind, const double[:] f, const double[:] w, double[:] beta
# C:     ) noexcept nogil
def _functions(axis: Array, kind: int, f: Array, w: Array, beta: Array) -> None:
    """β (15,) of a sensor."""
    beta[0] = 1.0
    for k in range(3):
        beta[1 + k], beta[4 + k] = w[k], f[k]
        beta[7 + k] = f[0] * f[k]
    beta[10], beta[11], beta[12] = f[1] * f[1], f[1] * f[2], f[2] * f[2]
    own = _dot(axis, f) if kind == 0 else _dot(axis, w)
    beta[13], beta[14] = fabs(own), own * own * own


# C: @cython.locals(k=Py_ssize_t, own=double, sign=double, slope=double)
# C: cdef void _slopes(const double[:] axis, int kind, const double[:] f, const double[:] beta, const double[:] K,
# C:     double[:] by_force, double[:] by_rate) noexcept nogil
def _slopes(axis: Array, kind: int, f: Array, beta: Array, K: Array, by_force: Array, by_rate: Array) -> None:
    """Derivatives (3,) of a reading with respect to specific force and rate."""
    for k in range(3):
        by_rate[k], by_force[k] = K[1 + k], K[4 + k] + K[7 + k] * f[0]
    by_force[0] += K[7] * f[0] + K[8] * f[1] + K[9] * f[2]
    by_force[1] += 2.0 * K[10] * f[1] + K[11] * f[2]
    by_force[2] += K[11] * f[1] + 2.0 * K[12] * f[2]
    own = beta[4] * axis[0] + beta[5] * axis[1] + beta[6] * axis[2]
    if kind == 1:
        own = beta[1] * axis[0] + beta[2] * axis[1] + beta[3] * axis[2]
    sign = 1.0 if own > 0.0 else -1.0 if own < 0.0 else 0.0
    slope = K[13] * sign + 3.0 * K[14] * own * own
    for k in range(3):
        if kind == 0:
            by_force[k] += slope * axis[k]
        else:
            by_rate[k] += slope * axis[k]


# Turns ---------------------------------------------------------------------------------------------------------


def add_turns(
    at: tuple[Array, IntArray, IntArray],
    turned: tuple[Array, Array, Array],
    place: tuple[Array, float, bool],
    by: tuple[Array, Array],
    rows: Array,
    bias: Array,
) -> None:
    """Fill in the first 3 rows (K, ·, 8 + m) of turns, and 3 more with the velocities: attitudes (N, 3, 3) `at` their
    first and last rests, rotations C (K, 3, 3) that take so many seconds (K,) while the Earth `turned` (K, 3, 3), the
    Earth's rate (3,) and gravity of the `place`, and whether velocities are known. `by` are [−∂φ/∂θ | φ] and
    [−∂V/∂θ | V] (K, 6, m + 1), and those (K, 6, n) of the biases, for which `bias` gets the coefficients of the
    rows."""
    (attitudes, first, last), (rotations, seconds, earth_turned), (earth, gravity, moved) = at, turned, place
    work = np.zeros((8, 3, 3))
    _add_turns(
        attitudes, first, last, rotations, seconds, earth_turned, earth, gravity, moved, by[0], by[1], rows, bias, work
    )


# C: @cython.locals(k=Py_ssize_t, a=Py_ssize_t, b=Py_ssize_t, m=Py_ssize_t, column=Py_ssize_t)
# C: cdef void _add_turns(const double[:, :, :] attitudes, const int64_t[:] first, const int64_t[:] last,
# C:     const double[:, :, :] rotations, const double[:] seconds, const double[:, :, :] turned, const double[:] earth,
# C:     double gravity, bint moved, const double[:, :, ::1] by, const double[:, :, :] by_bias, double[:, :, ::1] rows,
# C:     double[:, :, ::1] bias, double[:, :, ::1] work)
def _add_turns(
    attitudes: Array,
    first: IntArray,
    last: IntArray,
    rotations: Array,
    seconds: Array,
    turned: Array,
    earth: Array,
    gravity: float,
    moved: bool,
    by: Array,
    by_bias: Array,
    rows: Array,
    bias: Array,
    work: Array,
) -> None:
    """One turn after the other."""
    m = by.shape[2] - 1
    with cython.nogil:
        C, left, by_turned, M, r = work[0], work[1], work[2], work[3], work[4, 0]
        phi, E, F = work[4, 1], work[5], work[6]
        for k in range(rows.shape[0]):
            start, end = attitudes[first[k]], attitudes[last[k]]
            for a in range(3):
                phi[a] = by[k, a, m]
            _exponential(phi, E)
            _product(E, rotations[k], C)
            for a in range(3):
                for b in range(3):
                    E[a, b] = end[b, a]
            _product(C, E, F)
            _product(F, turned[k], E)
            _product(E, start, M)
            _logarithm(M, r)
            _inverse_left_jacobian(r, left)
            _left_jacobian(phi, E)
            _product(left, E, by_turned)
            _product(left, C, F)
            _attitudes_of_turn(left, F, start, end, rows[k])
            for a in range(3):
                rows[k, a, rows.shape[2] - 1] = r[a]
                for column in range(m):
                    rows[k, a, 7 + column] = (
                        by_turned[a, 0] * by[k, 0, column]
                        + by_turned[a, 1] * by[k, 1, column]
                        + by_turned[a, 2] * by[k, 2, column]
                    )
                for column in range(by_bias.shape[2]):
                    bias[k, a, column] = (
                        by_turned[a, 0] * by_bias[k, 0, column]
                        + by_turned[a, 1] * by_bias[k, 1, column]
                        + by_turned[a, 2] * by_bias[k, 2, column]
                    )
            if moved:
                _add_velocity(start, earth, gravity, seconds[k], by[k], rows[k], work[7])
                for a in range(3, 6):
                    for column in range(by_bias.shape[2]):
                        bias[k, a, column] = by_bias[k, a, column]


# C: cdef void _attitudes_of_turn(const double[:, :] left, const double[:, :] carried, const double[:, :] start,
# C:     const double[:, :] end, double[:, ::1] rows) noexcept nogil
def _attitudes_of_turn(left: Array, carried: Array, start: Array, end: Array, rows: Array) -> None:
    """−J_l⁻ᵀ and J_l⁻¹ C of the attitudes before and after a turn, in their bases."""
    for a in range(3):
        for c in range(6):
            rows[a, c] = 0.0
        for b in range(3):
            rows[a, 0] -= left[b, a] * start[0, b]
            rows[a, 1] += left[b, a] * start[2, b]
            rows[a, 2] -= left[b, a] * start[1, b]
            rows[a, 3] += carried[a, b] * end[0, b]
            rows[a, 4] -= carried[a, b] * end[2, b]
            rows[a, 5] += carried[a, b] * end[1, b]


# C: @cython.locals(m=Py_ssize_t, column=Py_ssize_t, a=Py_ssize_t, b=Py_ssize_t, c=Py_ssize_t, x=double, y=double,
# C:     z=double, whole_b=double, whole_c=double, predicted=double)
# C: cdef void _add_velocity(const double[:, :] start, const double[:] earth, double gravity, double T,
# C:     const double[:, ::1] by, double[:, ::1] rows, double[:, ::1] work) noexcept nogil
def _add_velocity(start: Array, earth: Array, gravity: float, T: float, by: Array, rows: Array, work: Array) -> None:
    """L_iᵀ ∫ e^{[Ω×]s} g e_U ds, with ∫ = T (I + [x×]/2 + [x×]²/6) and x = Ω T, and its derivative with the attitude
    before the turn; the heading has a part in it through the Earth's rate alone."""
    m, up, turned = by.shape[1] - 1, work[0], work[1]
    x, y, z = T * earth[0], T * earth[1], T * earth[2]
    up[0] = -z / 2.0 + x * y / 6.0
    up[1] = -(x * x + z * z) / 6.0
    up[2] = x / 2.0 + y * z / 6.0
    for a in range(3):
        turned[a] = gravity * T * (start[0, a] * up[0] + start[1, a] * up[1] + start[2, a] * up[2])
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        whole_b, whole_c = turned[b] + gravity * T * start[1, b], turned[c] + gravity * T * start[1, c]
        rows[3 + a, 0] = whole_b * start[0, c] - whole_c * start[0, b]
        rows[3 + a, 1] = whole_c * start[2, b] - whole_b * start[2, c]
        rows[3 + a, 2] = turned[b] * start[1, c] - turned[c] * start[1, b]
        predicted = turned[a] + gravity * T * start[1, a]
        rows[3 + a, 6] = predicted / gravity
        rows[3 + a, rows.shape[1] - 1] = by[3 + a, m] - predicted
        for column in range(m):
            rows[3 + a, 7 + column] = by[3 + a, column]


# Rotations -----------------------------------------------------------------------------------------------------


def turned(attitudes: Array, angles: Array) -> Array:
    """Attitudes (N, 3, 3) after turns in the body by the first two angles (N, 3) about north and west, and about the
    vertical by the third, exactly."""
    out = np.zeros(attitudes.shape)
    _turn(attitudes, angles, out, np.zeros((4, 3, 3)))
    return out


# C: @cython.locals(i=Py_ssize_t, a=Py_ssize_t)
# C: cdef void _turn(const double[:, :, :] attitudes, const double[:, :] angles, double[:, :, ::1] out,
# C:     double[:, :, ::1] work )
def _turn(attitudes: Array, angles: Array, out: Array, work: Array) -> None:
    """One attitude after the other."""
    with cython.nogil:
        r, E, F = work[0, 0], work[1], work[2]
        for i in range(attitudes.shape[0]):
            L = attitudes[i]
            for a in range(3):
                r[a] = L[0, a] * angles[i, 0] - L[2, a] * angles[i, 1]
            _exponential(r, E)
            _product(L, E, F)
            r[0], r[1], r[2] = 0.0, angles[i, 2], 0.0
            _exponential(r, E)
            _product(E, F, out[i])


def inverse_left_jacobian(r: Array) -> Array:
    """J_l⁻¹(r) (…, 3, 3); its transpose is J_r⁻¹(r)."""
    out = np.zeros((*r.shape, 3))
    for each, J in zip(r.reshape(-1, 3), out.reshape(-1, 3, 3), strict=True):
        _inverse_left_jacobian(each, J)
    return out


# C: cdef void _exponential(const double[:] r, double[:, ::1] C) noexcept nogil
def _exponential(r: Array, C: Array) -> None:
    """exp([r×]): I + sin a/a [r×] + (1 − cos a)/a² [r×]²."""
    angle = sqrt(_dot(r, r))
    half = _sine_ratio(0.5 * angle)
    _polynomial(r, _sine_ratio(angle), 0.5 * half * half, C)


# C: @cython.locals(second=double)
# C: cdef void _left_jacobian(const double[:] r, double[:, ::1] J) noexcept nogil
def _left_jacobian(r: Array, J: Array) -> None:
    """J_l: I + (1 − cos a)/a² [r×] + (a − sin a)/a³ [r×]², of small angles by its series."""
    angle = sqrt(_dot(r, r))
    half = _sine_ratio(0.5 * angle)
    second = 1.0 / 6.0 - angle * angle / 120.0
    if angle >= 1e-2:
        second = (angle - sin(angle)) / (angle * angle * angle)
    _polynomial(r, 0.5 * half * half, second, J)


# C: @cython.locals(second=double)
# C: cdef void _inverse_left_jacobian(const double[:] r, double[:, ::1] J) noexcept nogil
def _inverse_left_jacobian(r: Array, J: Array) -> None:
    """J_l⁻¹: I − [r×]/2 + (1/a² − 1/(2 a tan(a/2))) [r×]², likewise."""
    angle = sqrt(_dot(r, r))
    second = 1.0 / 12.0 + angle * angle / 720.0
    if angle >= 1e-2:
        second = 1.0 / (angle * angle) - 0.5 / (angle * tan(0.5 * angle))
    _polynomial(r, -0.5, second, J)


# C: cdef double _sine_ratio(double angle) noexcept nogil
def _sine_ratio(angle: float) -> float:
    """sin a / a."""
    if angle < 1e-4:
        return 1.0 - angle * angle / 6.0
    return sin(angle) / angle  # type: ignore[no-any-return]


# C: cdef void _polynomial(const double[:] r, double first, double second, double[:, ::1] out) noexcept nogil
def _polynomial(r: Array, first: float, second: float, out: Array) -> None:
    """I + first [r×] + second [r×]², [r×]² = r rᵀ − r² I."""
    square = _dot(r, r)
    for a in range(3):
        for b in range(3):
            out[a, b] = second * r[a] * r[b]
        out[a, a] += 1.0 - second * square
    out[2, 1] += first * r[0]
    out[0, 2] += first * r[1]
    out[1, 0] += first * r[2]
    out[1, 2] -= first * r[0]
    out[2, 0] -= first * r[1]
    out[0, 1] -= first * r[2]


# C: @cython.locals(most=double, largest=Py_ssize_t, a=Py_ssize_t, b=Py_ssize_t, scalar=double, ratio=double)
# C: cdef void _logarithm(const double[:, :] C, double[::1] r) noexcept nogil
def _logarithm(C: Array, r: Array) -> None:
    """The rotation vector, up to π, of a rotation matrix: by the largest column of 4 q qᵀ, q a unit quaternion, scalar
    first."""
    trace = C[0, 0] + C[1, 1] + C[2, 2]
    most, largest = trace, 0
    for a in range(3):
        if C[a, a] > most:
            most, largest = C[a, a], a + 1
    r[0], r[1], r[2] = C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]
    scalar = 1.0 + trace
    if largest > 0:
        a = largest - 1
        scalar = r[a]
        for b in range(3):
            r[b] = C[a, b] + C[b, a]
        r[a] += 1.0 - trace
    sine = sqrt(_dot(r, r))
    angle = 2.0 * atan2(sine, fabs(scalar))
    ratio = angle / sine if sine > 0.0 else 0.0
    for a in range(3):
        r[a] *= ratio if scalar >= 0.0 else -ratio


# C: cdef void _product(const double[:, :] a, const double[:, :] b, double[:, ::1] out) noexcept nogil
def _product(a: Array, b: Array, out: Array) -> None:
    """a b of matrices (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


# C: cdef double _dot(const double[:] a, const double[:] b) noexcept nogil
def _dot(a: Array, b: Array) -> float:
    """Scalar product of vectors of three."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]  # type: ignore[no-any-return]


# C: cdef double _triple(const double[:] a, const double[:] b, const double[:] c) noexcept nogil
def _triple(a: Array, b: Array, c: Array) -> float:
    """a · (b × c)."""
    return (  # type: ignore[no-any-return]
        a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])
    )
