"""The compiled loops that correct readings sample by sample: that solves those of a block for what it measures, and
those that move accelerometers to one point.

They are Python and run as they stand; see `tumble.reduction.kernels`.
"""

from __future__ import annotations

import numpy as np

from tumble.units import Array

try:
    import cython
except ImportError:
    from tumble import uncompiled as cython

# C: cpdef enum:
# C:     _RATE = 1
# C:     _FORCE = 4
# C:     _PRODUCTS = 7
# C:     _OWN_SIZE = 13
# C:     _OWN_CUBE = 14

if not cython.compiled:  # where it is, these are numbers of C: places of functions in K
    _RATE, _FORCE, _PRODUCTS, _OWN_SIZE, _OWN_CUBE = 1, 4, 7, 13, 14


def fixed_point(
    readings: Array,
    change: tuple[Array, Array],
    other: Array,
    sensors: tuple[Array, Array, Array],
    steps: int,
    *,
    of_force: bool,
) -> Array:
    """Measured vectors x (N, 3) by so many steps x ← S⁻¹ ((ŷ − b − K β(x)) / s) from zero, with readings ŷ (N, n), the
    `change` of what they are at rest b (N, n) and in gain s (N, n), and the `other` vectors (N, 3) of β. Of the
    `sensors`: S⁻¹ (3, n), axes (n, 3) and the coefficients K (n, 15) of what is not linear in x. `of_force`: whether x
    is the specific force."""
    inverse, axes, K = sensors
    out, known = np.empty((len(readings), 3)), np.empty((2, len(K)))
    _solve(readings, change[0], change[1], other, inverse, axes, K, steps, of_force, known, out)
    return out


# C: @cython.locals(p=Py_ssize_t, x=double, y=double, z=double, u=double, v=double, w=double, own=double, value=double)
# C: cdef void _solve(const double[:, :] readings, const double[:, :] offset, const double[:, :] gain,
# C:     const double[:, :] other, const double[:, :] inverse, const double[:, :] axes, const double[:, :] K,
# C:     Py_ssize_t steps, bint of_force, double[:, ::1] known, double[:, ::1] out)
def _solve(
    readings: Array, offset: Array, gain: Array, other: Array, inverse: Array, axes: Array, K: Array, steps: int,
    of_force: bool, known: Array, out: Array,
) -> None:  # fmt: skip
    """The same into `out`; `known` has of each sensor the reading less all that is known before the first step, and the
    inverse of its gain."""
    linear = _RATE if of_force else _FORCE
    with cython.nogil:
        for i in range(out.shape[0]):
            x, y, z = other[i, 0], other[i, 1], other[i, 2]
            for p in range(K.shape[0]):
                value = readings[i, p] - offset[i, p] - K[p, linear] * x - K[p, linear + 1] * y - K[p, linear + 2] * z
                known[0, p] = value if of_force else value - _products(K, p, x, y, z)
                known[1, p] = 1.0 / gain[i, p]
            x, y, z = 0.0, 0.0, 0.0
            for _ in range(steps):
                u, v, w = 0.0, 0.0, 0.0
                for p in range(K.shape[0]):
                    own = axes[p, 0] * x + axes[p, 1] * y + axes[p, 2] * z
                    value = known[0, p] - own * (K[p, _OWN_CUBE] * own * own) - K[p, _OWN_SIZE] * abs(own)
                    if of_force:
                        value -= _products(K, p, x, y, z)
                    value *= known[1, p]
                    u, v, w = u + inverse[0, p] * value, v + inverse[1, p] * value, w + inverse[2, p] * value
                x, y, z = u, v, w
            out[i, 0], out[i, 1], out[i, 2] = x, y, z


# C: cdef double _products(const double[:, :] K, Py_ssize_t p, double x, double y, double z) noexcept nogil
def _products(K: Array, p: int, x: float, y: float, z: float) -> float:
    """What a sensor reads of the products of the components of the force."""
    by_x = K[p, _PRODUCTS] * x + K[p, _PRODUCTS + 1] * y + K[p, _PRODUCTS + 2] * z
    by_y = K[p, _PRODUCTS + 3] * y + K[p, _PRODUCTS + 4] * z
    return x * by_x + y * by_y + K[p, _PRODUCTS + 5] * z * z  # type: ignore[no-any-return]


# Accelerometers at one point ---------------------------------------------------------------------------------


def central_differences(values: Array, time: Array, longest: float) -> Array:
    """Changes (N, 3) of values (N, 3) a second from the sample before to the one after, at both ends from the sample
    itself; not a number where these are not more than 0 and at most `longest` s apart."""
    out = np.empty((len(values), 3))
    _differ(values, time, longest, np.nan, out)
    return out


# C: @cython.locals(step=double, before=Py_ssize_t, after=Py_ssize_t)
# C: cdef void _differ(const double[:, :] values, const double[:] time, double longest, double unknown,
# C:     double[:, ::1] out)
def _differ(values: Array, time: Array, longest: float, unknown: float, out: Array) -> None:
    """The same into `out`."""
    samples = values.shape[0]
    with cython.nogil:
        for j in range(samples):
            before, after = max(j - 1, 0), min(j + 1, samples - 1)
            step = time[after] - time[before]
            if not 0.0 < step <= longest:
                step = unknown
            for k in range(3):
                out[j, k] = (values[after, k] - values[before, k]) / step


def moved(readings: Array, rate: Array, acceleration: Array, levers: Array, sensitivity: Array) -> Array:
    """Readings (N, n) of accelerometers with lever arms r and a sensitivity k, both (n, 3), as without such arms, at a
    rate ω and an angular acceleration ω̇ (N, 3): less what f_p − f = ω̇ × r + ω × (ω × r) adds. Where that is not
    finite they stay as they are."""
    out = np.empty((len(readings), readings.shape[1]))
    across, along = np.cross(levers, sensitivity), np.sum(levers * sensitivity, axis=1)
    _move(readings, rate, acceleration, levers, sensitivity, across, along, out)
    return out


# C: @cython.locals(rx=double, ry=double, rz=double, size=double, kx=double, ky=double, kz=double, cx=double,
# C:     cy=double, cz=double, x=double, y=double, z=double, turning=double, spinning=double, there=double)
# C: cdef void _move(const double[:, :] readings, const double[:, :] rate, const double[:, :] acceleration,
# C:     const double[:, :] levers, const double[:, :] sensitivity, const double[:, :] across, const double[:] along,
# C:     double[:, ::1] out)
def _move(
    readings: Array, rate: Array, acceleration: Array, levers: Array, sensitivity: Array, across: Array,
    along: Array, out: Array,
) -> None:  # fmt: skip
    """The same into `out`: k · (ω̇ × r + ω × (ω × r)) = ω̇ · (r × k) + (ω · r) (ω · k) − ω² (r · k)."""
    with cython.nogil:
        for p in range(out.shape[1]):
            rx, ry, rz, size = levers[p, 0], levers[p, 1], levers[p, 2], along[p]
            kx, ky, kz = sensitivity[p, 0], sensitivity[p, 1], sensitivity[p, 2]
            cx, cy, cz = across[p, 0], across[p, 1], across[p, 2]
            for i in range(out.shape[0]):
                x, y, z = rate[i, 0], rate[i, 1], rate[i, 2]
                turning = acceleration[i, 0] * cx + acceleration[i, 1] * cy + acceleration[i, 2] * cz
                spinning = (x * rx + y * ry + z * rz) * (x * kx + y * ky + z * kz) - (x * x + y * y + z * z) * size
                there = readings[i, p] - turning - spinning
                out[i, p] = there if there - there == 0.0 else readings[i, p]
