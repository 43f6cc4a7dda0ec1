# What of kernels.py is compiled as functions of C, and the types of their arguments and sums; and the constants.
cimport cython
from libc.stdint cimport int64_t

cpdef enum:
    LANES = 16

cdef void _allan_sums(const double[::1] phase, const int64_t[:] sizes, double[:, ::1] sums)
cdef void _add_squares(
    const double[::1] phase, Py_ssize_t begin, Py_ssize_t end, Py_ssize_t m, double[:, ::1] sums, Py_ssize_t i
) noexcept nogil

@cython.locals(total=double)
cpdef Py_ssize_t levinson(const double[:] autocovariance, double[:, :] filters, double[:] powers)
@cython.locals(total=double, largest=double)
cpdef continue_autocovariance(double[::1] autocovariance, const double[::1] prediction_filter, double negligible)

cpdef follow(double[::1] values, double kept)

@cython.locals(
    total=double, row=double, last=double, lowest=double, highest=double, step=double, repeats=int64_t, count=int64_t,
    blocks=Py_ssize_t,
)
cpdef Py_ssize_t block_sums(
    const double[:, :] values, const double[:] time, const double[:] weight, int64_t size, double[:] sums,
    int64_t[:] filled, double[:, ::1] state, double[:, :] out,
)
cdef void _end_row(double[:, ::1] state, Py_ssize_t c, double value, double length, double stop) noexcept nogil
