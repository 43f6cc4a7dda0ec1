# What of residual_loops.py is compiled as functions of C, and the types of their arguments and sums.
cimport cython
from libc.stdint cimport int64_t

@cython.locals(
    total=double, half=double, across=double, i=Py_ssize_t, k=Py_ssize_t, a=Py_ssize_t, b=Py_ssize_t, c=Py_ssize_t,
    r=Py_ssize_t, p=Py_ssize_t, d=Py_ssize_t, row=Py_ssize_t, other=Py_ssize_t,
)
cdef void _leave(
    const double[:, :, ::1] rows, const int64_t[:] first, const double[:, :] angles, const double[:, :, :, ::1] own,
    const double[:, :, ::1] shared, const double[::1] step, double[:, :, ::1] covariance, double[:, ::1] residual,
    double[:, ::1] work,
)
cdef double _of_unknowns(
    const double[:, :, :, ::1] own, Py_ssize_t i, Py_ssize_t d, Py_ssize_t a, Py_ssize_t b
) noexcept nogil

@cython.locals(part=double, along=double, a=Py_ssize_t, b=Py_ssize_t, c=Py_ssize_t, d=Py_ssize_t, k=Py_ssize_t)
cdef void _score(
    const double[:, :, ::1] directions, const int64_t[:] component, const double[:, :] residual,
    const double[:, :, ::1] covariance, double[:, ::1] work, double[::1] product, double[::1] slope,
    double[:, ::1] information,
)
