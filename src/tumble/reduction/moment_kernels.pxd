# What of moment_kernels.py is compiled as functions of C, and the types of their arguments; and the constants.
from libc.math cimport sqrt
from libc.stdint cimport int64_t

cpdef enum:
    LANES = 16
    TILE = 24
    GROUP = 8
    ROW = 384
    COMMON = 19
    LINEAR = 7
    _V = 4
    _BEFORE = 7
    _RATE = 13
    _FORCE = 17
    _JUMPS = 20
    _STATE_ROWS = 21

cdef void _integrate(
    const double[:, :] rates, const double[:, :] forces, const double[:] intervals,
    const int64_t[:] piece, const int64_t[:] first, const int64_t[:] stop,
    const double[:, :] gyro, const double[:, :] gyro_terms,
    const double[:, :] accel, const double[:, :] accel_terms, const double[:, :] G, double delay,
    const double[:, :] gyros, const double[:, :] accels,
    double[:, ::1] attitude, double[:, ::1] V, double[:, :, ::1] products, double[:, :, ::1] moved,
    double[:, :, ::1] swept_sums, double[:, ::1] regressors, double[::1] jumps,
    double[::1] tile, double[::1] left, double[::1] right, double[::1] swept, double[::1] state, double[::1] total,
    double[:, ::1] C, Py_ssize_t lanes,
)
cdef void _begin(double[::1] tile, double[::1] state) noexcept nogil
cdef void _fill(
    const double[:, :] rates, const double[:, :] forces, const double[:] intervals,
    const int64_t[:] first, const int64_t[:] stop, Py_ssize_t group, Py_ssize_t done, Py_ssize_t steps,
    double[::1] tile,
) noexcept nogil

cdef void _compensate(
    double[::1] tile, Py_ssize_t steps, const double[:, :] gyro, const double[:, :] gyro_terms,
    const double[:, :] accel, const double[:, :] accel_terms, const double[:, :] G, double delay, Py_ssize_t lanes,
    double[::1] state,
) noexcept nogil
cdef void _transform(
    double[::1] tile, Py_ssize_t many, const double[:, :] A, const double[:, :] B
) noexcept nogil
cdef void _subtract_terms(
    double[::1] tile, Py_ssize_t vector, Py_ssize_t many, const double[:, :] terms, Py_ssize_t scratch
) noexcept nogil
cdef void _copy(double[::1] tile, Py_ssize_t source, Py_ssize_t target, Py_ssize_t many) noexcept nogil
cdef void _subtract_term(
    double[::1] tile, Py_ssize_t vector, Py_ssize_t before, Py_ssize_t many, const double[:, :] terms, Py_ssize_t p
) noexcept nogil
cdef void _move(
    double[::1] tile, Py_ssize_t steps, Py_ssize_t lanes, double delay, double[::1] state
) noexcept nogil
cdef void _subtract_force(double[::1] tile, Py_ssize_t many, const double[:, :] G) noexcept nogil

cdef void _regress(
    double[::1] tile, Py_ssize_t steps, Py_ssize_t lanes, double[::1] right, double[::1] state
) noexcept nogil
cdef void _regress_own(
    double[::1] tile, Py_ssize_t steps, const double[:, :] gyros, const double[:, :] accels, double[::1] right
) noexcept nogil
cdef void _regress_axis(
    double[::1] tile, Py_ssize_t vector, Py_ssize_t many, const double[:, :] axes, Py_ssize_t p, double[::1] right,
    Py_ssize_t magnitude, Py_ssize_t cube,
) noexcept nogil
cdef void _turn(
    double[::1] right, Py_ssize_t steps, Py_ssize_t lanes, double[::1] state, double[::1] left
) noexcept nogil
cdef void _turn_about(double[::1] left, double[::1] right, Py_ssize_t steps, double[::1] swept) noexcept nogil

cdef void _add_all(
    double[::1] left, double[::1] right, double[::1] swept, double[::1] tile, Py_ssize_t steps, Py_ssize_t lanes,
    Py_ssize_t rows, Py_ssize_t linear, double[::1] total,
) noexcept nogil
cdef void _add_products(
    double[::1] left, Py_ssize_t first, double[::1] right, Py_ssize_t factor, Py_ssize_t groups, Py_ssize_t lanes,
    double[::1] total, Py_ssize_t to,
) noexcept nogil
cdef void _add_row(
    double[::1] right, Py_ssize_t row, Py_ssize_t groups, Py_ssize_t lanes, double[::1] total, Py_ssize_t to
) noexcept nogil
cdef void _join(
    Py_ssize_t k, Py_ssize_t lane, double[::1] state, double[::1] total, double[:, ::1] C,
    double[:, ::1] attitude, double[:, ::1] V, double[:, :, ::1] products, double[:, :, ::1] moved,
    double[:, :, ::1] swept, double[:, ::1] regressors, double[::1] jumps,
) noexcept nogil
cdef void _add_rotated(
    double[:, ::1] C, double[::1] total, Py_ssize_t at, double[:, :, ::1] out, Py_ssize_t k, Py_ssize_t r
) noexcept nogil
cdef void _add_crossed(
    double[:, ::1] C, double[::1] total, Py_ssize_t at, double[:, ::1] V, double[:, :, ::1] out, Py_ssize_t k,
    Py_ssize_t r,
) noexcept nogil
cdef void _append_attitude(
    double[:, ::1] attitude, Py_ssize_t k, double[::1] state, Py_ssize_t lane
) noexcept nogil
cdef void _finish(
    double[:, ::1] attitude, double[:, ::1] V, double[:, :, ::1] products, double[:, :, ::1] moved,
    double[:, :, ::1] C,
) noexcept
cdef void _matrix_of(double[:, ::1] attitude, Py_ssize_t k, double[:, ::1] C) noexcept nogil
