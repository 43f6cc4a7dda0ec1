# What of triads.py is compiled as functions of C, and the types of their arguments; and the constants.
cimport cython
from libc.math cimport cos, sin, sqrt

cpdef enum:
    PARAMETERS = 9
    LANES = 16
    _ROWS = 10
    _MODEL = 14
    _TOGETHER = 4
    _SUMS = 55

cdef void _fit(
    const double[:, :, ::1] readings, double gravity, Py_ssize_t steps,
    double[:, ::1] values, double[:, ::1] variance, double[:, ::1] step,
    double[:, ::1] tile, double[:, ::1] theta, double[:, ::1] model, double[:, ::1] sums, double[:, ::1] spread,
    double[:, ::1] column, double[:, ::1] h,
)
cdef Py_ssize_t _at(Py_ssize_t row, Py_ssize_t column) noexcept nogil
cdef void _model(double[:, ::1] theta, double[:, ::1] model) noexcept nogil
cdef void _accumulate(
    double[:, ::1] tile, double gravity, double[:, ::1] theta, double[:, ::1] model, double[:, ::1] h,
    double[:, ::1] sums,
) noexcept nogil
@cython.locals(vx=double, vy=double, vz=double)
cdef void _row(
    double[:, ::1] tile, Py_ssize_t at, double gravity, double[:, ::1] theta, double[:, ::1] model, double[:, ::1] h,
    Py_ssize_t to,
) noexcept nogil
cdef void _factorise(double[:, ::1] sums) noexcept nogil
cdef void _solve(double[:, ::1] sums, double[:, ::1] theta) noexcept nogil
cdef void _variances(double[:, ::1] sums, double[:, ::1] column, double[:, ::1] spread) noexcept nogil
