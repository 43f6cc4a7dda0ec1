# What of row_loops.py is compiled as functions of C, and the types of their arguments and sums.
cimport cython
from libc.math cimport atan2, fabs, sin, sqrt, tan
from libc.stdint cimport int64_t

@cython.locals(
    i=Py_ssize_t, k=Py_ssize_t, p=Py_ssize_t, b=Py_ssize_t, m=Py_ssize_t, last=Py_ssize_t, column=Py_ssize_t,
    residual=double, value=double,
)
cdef void _add_rests(
    const double[:, :, :] attitudes, const double[:] force, const double[:] rate, const double[:, :] axes, int kind,
    const double[:, :] K, const double[:, :, ::1] D, const int64_t[:] used, const double[:, :] observed,
    double[:, :, ::1] rows, Py_ssize_t top, double[:, ::1] work,
)
@cython.locals(k=Py_ssize_t, own=double)
cdef void _functions(
    const double[:] axis, int kind, const double[:] f, const double[:] w, double[:] beta
) noexcept nogil
@cython.locals(k=Py_ssize_t, own=double, sign=double, slope=double)
cdef void _slopes(
    const double[:] axis, int kind, const double[:] f, const double[:] beta, const double[:] K, double[:] by_force,
    double[:] by_rate,
) noexcept nogil

@cython.locals(k=Py_ssize_t, a=Py_ssize_t, b=Py_ssize_t, m=Py_ssize_t, column=Py_ssize_t)
cdef void _add_turns(
    const double[:, :, :] attitudes, const int64_t[:] first, const int64_t[:] last, const double[:, :, :] rotations,
    const double[:] seconds, const double[:, :, :] turned, const double[:] earth, double gravity,
    bint moved, const double[:, :, ::1] by, const double[:, :, :] by_bias, double[:, :, ::1] rows, double[:, :, ::1] bias,
    double[:, :, ::1] work,
)
cdef void _attitudes_of_turn(
    const double[:, :] left, const double[:, :] carried, const double[:, :] start, const double[:, :] end,
    double[:, ::1] rows,
) noexcept nogil
@cython.locals(
    m=Py_ssize_t, column=Py_ssize_t, a=Py_ssize_t, b=Py_ssize_t, c=Py_ssize_t, x=double, y=double, z=double,
    whole_b=double, whole_c=double, predicted=double,
)
cdef void _add_velocity(
    const double[:, :] start, const double[:] earth, double gravity, double T, const double[:, ::1] by,
    double[:, ::1] rows, double[:, ::1] work,
) noexcept nogil

@cython.locals(i=Py_ssize_t, a=Py_ssize_t)
cdef void _turn(
    const double[:, :, :] attitudes, const double[:, :] angles, double[:, :, ::1] out, double[:, :, ::1] work
)
cdef void _exponential(const double[:] r, double[:, ::1] C) noexcept nogil
@cython.locals(second=double)
cdef void _left_jacobian(const double[:] r, double[:, ::1] J) noexcept nogil
@cython.locals(second=double)
cdef void _inverse_left_jacobian(const double[:] r, double[:, ::1] J) noexcept nogil
cdef double _sine_ratio(double angle) noexcept nogil
cdef void _polynomial(const double[:] r, double first, double second, double[:, ::1] out) noexcept nogil
@cython.locals(most=double, largest=Py_ssize_t, a=Py_ssize_t, b=Py_ssize_t, scalar=double, ratio=double)
cdef void _logarithm(const double[:, :] C, double[::1] r) noexcept nogil
cdef void _product(const double[:, :] a, const double[:, :] b, double[:, ::1] out) noexcept nogil
cdef double _dot(const double[:] a, const double[:] b) noexcept nogil
cdef double _triple(const double[:] a, const double[:] b, const double[:] c) noexcept nogil
