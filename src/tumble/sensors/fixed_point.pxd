# What of fixed_point.py is compiled as functions of C, and the types of their arguments; and the constants.
cimport cython

cpdef enum:
    LANES = 64
    _OTHER = 192
    _NEXT = 384
    _KNOWN = 576
    _RATE = 1
    _FORCE = 4
    _PRODUCTS = 7
    _OWN_SIZE = 13
    _OWN_CUBE = 14

cdef void _solve(
    const double[:, :] readings, const double[:, :] offset, const double[:, :] gain, const double[:, :] other,
    const double[:, :] inverse, const double[:, :] axes, const double[:, :] K, Py_ssize_t steps, bint of_force,
    double[::1] tile, double[:, ::1] x,
)
@cython.locals(
    value=double, x=double, y=double, z=double, a=double, b=double, c=double, linear=Py_ssize_t, known=Py_ssize_t,
    inverse_gain=Py_ssize_t,
)
cdef void _fill(
    const double[:, :] readings, const double[:, :] offset, const double[:, :] gain, const double[:, :] other,
    const double[:, :] K, bint of_force, Py_ssize_t first, Py_ssize_t count, double[::1] tile,
) noexcept nogil
cdef void _step(
    const double[:, :] inverse, const double[:, :] axes, const double[:, :] K, bint of_force, double[::1] tile,
) noexcept nogil
@cython.locals(
    a=double, b=double, c=double, size=double, cube=double, own=double, value=double, to_x=double, to_y=double,
    to_z=double, known=Py_ssize_t, inverse_gain=Py_ssize_t,
)
cdef void _add_rate_sensor(
    const double[:, :] inverse, const double[:, :] axes, const double[:, :] K, Py_ssize_t p, double[::1] tile,
) noexcept nogil
@cython.locals(
    a=double, b=double, c=double, size=double, cube=double, own=double, value=double, to_x=double, to_y=double,
    to_z=double, known=Py_ssize_t, inverse_gain=Py_ssize_t, x=double, y=double, z=double, products=double,
    xx=double, xy=double, xz=double, yy=double, yz=double, zz=double,
)
cdef void _add_force_sensor(
    const double[:, :] inverse, const double[:, :] axes, const double[:, :] K, Py_ssize_t p, double[::1] tile,
) noexcept nogil
@cython.locals(
    xx=double, xy=double, xz=double, yy=double, yz=double, zz=double, x=double, y=double, z=double,
)
cdef void _take_products(const double[:, :] K, Py_ssize_t p, Py_ssize_t known, double[::1] tile) noexcept nogil

@cython.locals(step=double, before=Py_ssize_t, after=Py_ssize_t)
cdef void _differ(
    const double[:, :] values, const double[:] time, double longest, double unknown, double[:, ::1] out,
)
@cython.locals(
    rx=double, ry=double, rz=double, size=double, kx=double, ky=double, kz=double, cx=double, cy=double, cz=double,
    x=double, y=double, z=double, turning=double, spinning=double, there=double,
)
cdef void _move(
    const double[:, :] readings, const double[:, :] rate, const double[:, :] acceleration, const double[:, :] levers,
    const double[:, :] sensitivity, const double[:, :] across, const double[:] along, double[:, ::1] out,
)
