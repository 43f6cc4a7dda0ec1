# What of triad_axes.py is compiled as a function of C, and the types of its arguments.
cimport cython
from libc.math cimport cos, sin
from libc.stdint cimport int64_t

@cython.locals(
    a=Py_ssize_t, p=Py_ssize_t, after=Py_ssize_t, before=Py_ssize_t, first=Py_ssize_t, second=Py_ssize_t, sign=double,
    gain=double, onward=double, back=double, x=double, y=double, z=double,
)
cpdef linearise(
    const double[:, :] axes, const int64_t[:] channels, const int64_t[:, :] angles, const double[:] values,
    double[:, ::1] model, double[:, :, ::1] jacobian,
)
