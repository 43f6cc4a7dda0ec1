"""The compiled loops that correct readings sample by sample: that solves those of a block for what it measures, and
those that move accelerometers to one point.

They are Python and run as they stand; see `tumble.reduction.kernels`. LANES samples are solved side by side. A `tile`
holds of them, LANES numbers in a row: the measured vector, the other one, the next vector; and of each sensor the
reading less all that is known before the first step, and the inverse of its gain. It begins on a line of the cache.
"""

from __future__ import annotations

import numpy as np

from tumble.units import Array

try:
    import cython
except ImportError:
    from tumble import uncompiled as cython

# C: cpdef enum:
# C:     LANES = 64
# C:     _OTHER = 192
# C:     _NEXT = 384
# C:     _KNOWN = 576
# C:     _RATE = 1
# C:     _FORCE = 4
# C:     _PRODUCTS = 7
# C:     _OWN_SIZE = 13
# C:     _OWN_CUBE = 14

if not cython.compiled:  # where it is, these are numbers of C
    LANES = 64
    _OTHER = 3 * LANES
    _NEXT = 6 * LANES
    _KNOWN = 9 * LANES
    _RATE = 1
    _FORCE = 4
    _PRODUCTS = 7
    _OWN_SIZE = 13
    _OWN_CUBE = 14


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
    x, tile = np.empty((len(readings), 3)), _on_a_line(_KNOWN + 2 * LANES * len(K))
    _solve(readings, change[0], change[1], other, inverse, axes, K, steps, of_force, tile, x)
    return x


def _on_a_line(size: int) -> Array:
    """So many zeros that begin on a line of the cache, of 64 bytes."""
    zeros = np.zeros(size + 7)
    first = -(zeros.ctypes.data // zeros.itemsize) % 8
    return zeros[first : first + size]


# C: cdef void _solve(const double[:, :] readings, const double[:, :] offset, const double[:, :] gain,
# C:     const double[:, :] other, const double[:, :] inverse, const double[:, :] axes, const double[:, :] K,
# C:     Py_ssize_t steps, bint of_force, double[::1] tile, double[:, ::1] x)
def _solve(
    readings: Array,
    offset: Array,
    gain: Array,
    other: Array,
    inverse: Array,
    axes: Array,
    K: Array,
    steps: int,
    of_force: bool,
    tile: Array,
    x: Array,
) -> None:
    """The same, LANES samples at a time."""
    with cython.nogil:
        for group in range((x.shape[0] + LANES - 1) // LANES):
            first = group * LANES
            count = min(LANES, x.shape[0] - first)
            _fill(readings, offset, gain, other, K, of_force, first, count, tile)
            for _ in range(steps):
                _step(inverse, axes, K, of_force, tile)
            for i in range(count):
                x[first + i, 0], x[first + i, 1], x[first + i, 2] = tile[i], tile[LANES + i], tile[2 * LANES + i]


# C: @cython.locals(value=double, x=double, y=double, z=double, a=double, b=double, c=double, linear=Py_ssize_t,
# C:     known=Py_ssize_t, inverse_gain=Py_ssize_t)
# C: cdef void _fill(const double[:, :] readings, const double[:, :] offset, const double[:, :] gain,
# C:     const double[:, :] other, const double[:, :] K, bint of_force, Py_ssize_t first, Py_ssize_t count,
# C:     double[::1] tile) noexcept nogil
def _fill(
    readings: Array,
    offset: Array,
    gain: Array,
    other: Array,
    K: Array,
    of_force: bool,
    first: int,
    count: int,
    tile: Array,
) -> None:
    """Put samples into the tile, and take off their readings what is constant and what the other vector alone makes."""
    sensors, linear = K.shape[0], _RATE if of_force else _FORCE
    for k in range(3):
        for i in range(count):
            tile[k * LANES + i], tile[_OTHER + k * LANES + i] = 0.0, other[first + i, k]
    for p in range(sensors):
        known, inverse_gain = _KNOWN + p * LANES, _KNOWN + (sensors + p) * LANES
        a, b, c = K[p, linear], K[p, linear + 1], K[p, linear + 2]
        for i in range(count):
            value = readings[first + i, p] - offset[first + i, p]
            x, y, z = tile[_OTHER + i], tile[_OTHER + LANES + i], tile[_OTHER + 2 * LANES + i]
            tile[known + i], tile[inverse_gain + i] = value - a * x - b * y - c * z, 1.0 / gain[first + i, p]
        if not of_force:
            _take_products(K, p, known, tile)


# C: cdef void _step(const double[:, :] inverse, const double[:, :] axes, const double[:, :] K, bint of_force,
# C:     double[::1] tile) noexcept nogil
def _step(inverse: Array, axes: Array, K: Array, of_force: bool, tile: Array) -> None:
    """A step of all samples in the tile."""
    for i in range(3 * LANES):
        tile[_NEXT + i] = 0.0
    for p in range(K.shape[0]):
        if of_force:
            _add_force_sensor(inverse, axes, K, p, tile)
        else:
            _add_rate_sensor(inverse, axes, K, p, tile)
    for i in range(3 * LANES):
        tile[i] = tile[_NEXT + i]


# C: @cython.locals(a=double, b=double, c=double, size=double, cube=double, own=double, value=double, to_x=double,
# C:     to_y=double, to_z=double, known=Py_ssize_t, inverse_gain=Py_ssize_t)
# C: cdef void _add_rate_sensor(const double[:, :] inverse, const double[:, :] axes, const double[:, :] K,
# C:     Py_ssize_t p, double[::1] tile) noexcept nogil
def _add_rate_sensor(inverse: Array, axes: Array, K: Array, p: int, tile: Array) -> None:
    """Add to the next vector what sensor p makes of it: its known reading less what size and cube of the vector along
    its axis make."""
    known, inverse_gain = _KNOWN + p * LANES, _KNOWN + (K.shape[0] + p) * LANES
    a, b, c, size, cube = axes[p, 0], axes[p, 1], axes[p, 2], K[p, _OWN_SIZE], K[p, _OWN_CUBE]
    to_x, to_y, to_z = inverse[0, p], inverse[1, p], inverse[2, p]
    for i in range(LANES):
        own = a * tile[i] + b * tile[LANES + i] + c * tile[2 * LANES + i]
        value = (tile[known + i] - size * abs(own) - cube * own * own * own) * tile[inverse_gain + i]
        tile[_NEXT + i] += to_x * value
        tile[_NEXT + LANES + i] += to_y * value
        tile[_NEXT + 2 * LANES + i] += to_z * value


# C: @cython.locals(a=double, b=double, c=double, size=double, cube=double, own=double, value=double, to_x=double,
# C:     to_y=double, to_z=double, known=Py_ssize_t, inverse_gain=Py_ssize_t, x=double, y=double, z=double,
# C:     products=double, xx=double, xy=double, xz=double, yy=double, yz=double, zz=double)
# C: cdef void _add_force_sensor(const double[:, :] inverse, const double[:, :] axes, const double[:, :] K,
# C:     Py_ssize_t p, double[::1] tile) noexcept nogil
def _add_force_sensor(inverse: Array, axes: Array, K: Array, p: int, tile: Array) -> None:
    """The same of an accelerometer, less what products of the components of the vector make, too."""
    known, inverse_gain = _KNOWN + p * LANES, _KNOWN + (K.shape[0] + p) * LANES
    a, b, c, size, cube = axes[p, 0], axes[p, 1], axes[p, 2], K[p, _OWN_SIZE], K[p, _OWN_CUBE]
    to_x, to_y, to_z = inverse[0, p], inverse[1, p], inverse[2, p]
    xx, xy, xz = K[p, _PRODUCTS], K[p, _PRODUCTS + 1], K[p, _PRODUCTS + 2]
    yy, yz, zz = K[p, _PRODUCTS + 3], K[p, _PRODUCTS + 4], K[p, _PRODUCTS + 5]
    for i in range(LANES):
        x, y, z = tile[i], tile[LANES + i], tile[2 * LANES + i]
        own = a * x + b * y + c * z
        products = x * (xx * x + xy * y + xz * z) + y * (yy * y + yz * z) + zz * z * z
        value = (tile[known + i] - size * abs(own) - cube * own * own * own - products) * tile[inverse_gain + i]
        tile[_NEXT + i] += to_x * value
        tile[_NEXT + LANES + i] += to_y * value
        tile[_NEXT + 2 * LANES + i] += to_z * value


# C: @cython.locals(xx=double, xy=double, xz=double, yy=double, yz=double, zz=double, x=double, y=double, z=double)
# C: cdef void _take_products(const double[:, :] K, Py_ssize_t p, Py_ssize_t known, double[::1] tile) noexcept nogil
def _take_products(K: Array, p: int, known: int, tile: Array) -> None:
    """Take off the known reading of a gyro p, from `known` on, what products of the components of the force make."""
    xx, xy, xz = K[p, _PRODUCTS], K[p, _PRODUCTS + 1], K[p, _PRODUCTS + 2]
    yy, yz, zz = K[p, _PRODUCTS + 3], K[p, _PRODUCTS + 4], K[p, _PRODUCTS + 5]
    for i in range(LANES):
        x, y, z = tile[_OTHER + i], tile[_OTHER + LANES + i], tile[_OTHER + 2 * LANES + i]
        tile[known + i] -= x * (xx * x + xy * y + xz * z) + y * (yy * y + yz * z) + zz * z * z


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
    readings: Array,
    rate: Array,
    acceleration: Array,
    levers: Array,
    sensitivity: Array,
    across: Array,
    along: Array,
    out: Array,
) -> None:
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
