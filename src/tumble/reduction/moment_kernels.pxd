# What of moment_kernels.py is compiled as functions of C, and the types of their arguments; and the constants.
cimport cython
from libc.stdint cimport int64_t

cpdef enum:
    LINEAR = 7
    GROUP = 8
    BLOCK = 8

@cython.locals(
    at=Py_ssize_t, first=Py_ssize_t, k=Py_ssize_t, to=Py_ssize_t, t=Py_ssize_t, dt=double, part=double, own=double, one=double,
    two=double, ax=double, ay=double, az=double, bx=double, by=double, bz=double, x=double, y=double, z=double,
    u=double, v=double, s=double, du=double, dv=double, ds=double, fx=double, fy=double, fz=double, h=double,
    e=double, e0=double, e1=double, e2=double, e3=double, m0=double, m1=double, m2=double, m3=double, q0=double,
    q1=double, q2=double, q3=double, unit=double, d1=double, d2=double, d3=double, V0=double, V1=double, V2=double, px=double,
    py=double, pz=double, pu=double, pv=double, pw=double, r0=double, r1=double, r2=double, before=double,
    u0=double, u1=double, u2=double, w0=double, w1=double, w2=double, f0=double, f1=double, f2=double, c00=double,
    c01=double, c02=double, c10=double, c11=double, c12=double, c20=double, c21=double, c22=double,
)
cdef void _integrate(
    const double[:, ::1] rates, const double[:, ::1] forces, const double[:] intervals,
    const int64_t[:] piece, const int64_t[:] start, const int64_t[:] stop,
    const double[:, ::1] gyro, const double[:, ::1] gyro_terms, const double[:, ::1] accel, const double[:, ::1] accel_terms,
    const double[:, ::1] G, double delay, const double[:, ::1] gyros, const double[:, ::1] accels,
    double[:, ::1] attitude, double[:, ::1] V, double[:, :, ::1] products, double[:, :, ::1] moved, double[:, :, ::1] swept, double[::1] jumps,
    double[:, ::1] right, double[:, ::1] left, double[::1] w, double[::1] f,
)
@cython.locals(
    u=double, term=double, b0=double, b1=double, b2=double, l0=double, l1=double, l2=double, x0=double, x1=double,
    x2=double,
)
cdef void _subtract_terms(double[::1] x, const double[:, ::1] terms) noexcept nogil
@cython.locals(at=Py_ssize_t, c=Py_ssize_t, one=double)
cdef void _add_products(
    double[:, ::1] left, Py_ssize_t column, double[:, ::1] right, Py_ssize_t first, double[:, :, ::1] sums,
    Py_ssize_t k, Py_ssize_t many,
) noexcept nogil
