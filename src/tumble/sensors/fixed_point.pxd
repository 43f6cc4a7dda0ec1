# What of fixed_point.py is compiled as functions of C, and the types of their arguments; and the constants.
cimport cython

cpdef enum:
    LANES = 16
    _OTHER = 3
    _VALUE = 6
    _NEXT = 7
    _KNOWN = 10
    _RATE = 1
    _FORCE = 4
    _PRODUCTS = 7
    _OWN_SIZE = 13
    _OWN_CUBE = 14

cdef void _solve(
    const double[:, :] readings, const double[:, :] gain, const double[:, :] other,
    const double[:, :] inverse, const double[:, :] axes, const double[:, :] K, Py_ssize_t steps, bint of_force,
    double[:, ::1] tile, double[:, ::1] x,
)
@cython.locals(value=double, linear=Py_ssize_t)
cdef void _fill(
    const double[:, :] readings, const double[:, :] gain, const double[:, :] other, const double[:, :] K,
    bint of_force, Py_ssize_t first, Py_ssize_t count, double[:, ::1] tile,
) noexcept nogil
@cython.locals(part=double)
cdef void _step(
    const double[:, :] inverse, const double[:, :] axes, const double[:, :] K, bint of_force, double[:, ::1] tile,
) noexcept nogil
@cython.locals(a=double, b=double, c=double, size=double, cube=double, own=double)
cdef void _take_own(const double[:, :] axes, const double[:, :] K, Py_ssize_t p, double[:, ::1] tile) noexcept nogil
@cython.locals(
    xx=double, xy=double, xz=double, yy=double, yz=double, zz=double, x=double, y=double, z=double,
)
cdef void _take_products(
    const double[:, :] K, Py_ssize_t p, Py_ssize_t force, Py_ssize_t row, double[:, ::1] tile,
) noexcept nogil
