# What of elimination.py is compiled as functions of C, and the types of their arguments and sums.
cimport cython
from libc.math cimport cos, fabs, sin, sqrt
from libc.stdint cimport int64_t

cdef Py_ssize_t _eliminate(
    const double[:, :, :] rest, const double[:, :, :] turn, const int64_t[:] link,
    double[:, :, :] factor, double[:, ::1] triangle, double rounding,
    double[:, ::1] work, double[:, ::1] carried, double[:, ::1] kept, double[::1] length, double[::1] product,
)
cdef Py_ssize_t _gather(
    double[:, ::1] work, double[:, ::1] carried, const double[:, :, :] rest, Py_ssize_t i,
    const double[:, :, :] turn, int64_t k,
) noexcept nogil
@cython.locals(square=double)
cdef bint _reflect(
    double[:, ::1] work, double[::1] product, Py_ssize_t top, Py_ssize_t column, Py_ssize_t rows, double least
) noexcept nogil
@cython.locals(square=double)
cdef void _fold(
    double[:, ::1] kept, double[::1] product, Py_ssize_t count, double[:, ::1] triangle
) noexcept nogil

cdef void _solve_all(
    const double[:, :, ::1] factor, double[:, :, ::1] inverse, double[:, :, ::1] by_next, double[:, :, ::1] by,
    double[:, :] unknowns,
)
cdef void _put_back(
    const int64_t[:] link, const double[::1] parameters, const double[:, :, ::1] inverse,
    const double[:, :, ::1] by_next, const double[:, :, ::1] by, double[:, :] unknowns, double[:, :, :, ::1] own,
    double[:, :, ::1] shared,
)
@cython.locals(v=double, part=double, total=double, scale=double, a=Py_ssize_t, b=Py_ssize_t, c=Py_ssize_t, k=Py_ssize_t)
cdef bint _whiten(
    const double[:, :, :] noise, const double[:, :, :] directions, const int64_t[:] component,
    const double[:] variance, double[:, ::1] work, double[:, :, ::1] factors,
)
cdef void _solve_for(
    double[:, ::1] inverse, const double[:, ::1] factor, double[:, ::1] by_next, double[:, ::1] by, double[:] value
) noexcept nogil
@cython.locals(total=double)
cdef void _add_product(const double[:, ::1] a, const double[:, ::1] b, double[:, ::1] out) noexcept nogil
@cython.locals(total=double)
cdef void _inverse(const double[:, ::1] factor, double[:, ::1] inverse) noexcept nogil

cpdef carry(
    const double[:, :] vertical, const double[:, :, :] C, const int64_t[:] link, const double[:] turned,
    double[:, :, ::1] attitudes,
)
cdef void _turn_north(
    const double[:, ::1] before, const double[:, :] C, double turned, double[::1] north
) noexcept nogil
cdef void _complete(const double[:] u, double[:, ::1] L, double[::1] north) noexcept nogil
cdef double _dot(const double[:] a, const double[:] b) noexcept nogil
