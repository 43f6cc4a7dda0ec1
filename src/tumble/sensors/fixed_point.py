"""The compiled loop that solves the readings of a block for what it measures, sample by sample.

It is Python and runs as it stands; see `tumble.reduction.kernels`. LANES samples go through every step side by side. A
`tile` (·, LANES) holds of them: the measured vector, the other one, the reading that is looked at, the next vector; and
of each sensor the reading less all that is known before the first step, and the inverse of its gain.
"""

from __future__ import annotations

import numpy as np

from tumble.units import Array

try:
    import cython
except ImportError:
    from tumble import uncompiled as cython

if not cython.compiled:  # where it is, these are numbers of fixed_point.pxd
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


def fixed_point(
    readings: Array, gain: Array, other: Array, sensors: tuple[Array, Array, Array], steps: int, *, of_force: bool
) -> Array:
    """Measured vectors x (N, 3) by so many steps x ← S⁻¹ ((ŷ − K β(x)) / s) from zero, with readings ŷ (N, n), gains
    s (N, n) and the `other` vectors (N, 3) of β. Of the `sensors`: S⁻¹ (3, n), axes (n, 3) and the coefficients
    K (n, 15) of what is not linear in x. `of_force`: whether x is the specific force."""
    inverse, axes, K = sensors
    x, tile = np.empty((len(readings), 3)), np.zeros((_KNOWN + 2 * len(K), LANES))
    _solve(readings, gain, other, inverse, axes, K, steps, of_force, tile, x)
    return x


def _solve(
    readings: Array,
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
            _fill(readings, gain, other, K, of_force, first, count, tile)
            for _ in range(steps):
                _step(inverse, axes, K, of_force, tile)
            for lane in range(count):
                for k in range(3):
                    x[first + lane, k] = tile[k, lane]


def _fill(
    readings: Array, gain: Array, other: Array, K: Array, of_force: bool, first: int, count: int, tile: Array
) -> None:
    """Put samples into the tile, and take off their readings what the other vector alone makes."""
    sensors, linear = K.shape[0], _RATE if of_force else _FORCE
    for lane in range(count):
        for k in range(3):
            tile[k, lane], tile[_OTHER + k, lane] = 0.0, other[first + lane, k]
        for p in range(sensors):
            value = readings[first + lane, p]
            for k in range(3):
                value -= K[p, linear + k] * other[first + lane, k]
            tile[_KNOWN + p, lane], tile[_KNOWN + sensors + p, lane] = value, 1.0 / gain[first + lane, p]
    if not of_force:
        for p in range(sensors):
            _take_products(K, p, _OTHER, _KNOWN + p, tile)


def _step(inverse: Array, axes: Array, K: Array, of_force: bool, tile: Array) -> None:
    """A step of all samples in the tile."""
    sensors = K.shape[0]
    for k in range(3):
        for lane in range(LANES):
            tile[_NEXT + k, lane] = 0.0
    for p in range(sensors):
        _take_own(axes, K, p, tile)
        if of_force:
            _take_products(K, p, 0, _VALUE, tile)
        for k in range(3):
            part = inverse[k, p]
            for lane in range(LANES):
                tile[_NEXT + k, lane] += part * (tile[_VALUE, lane] * tile[_KNOWN + sensors + p, lane])
    for k in range(3):
        for lane in range(LANES):
            tile[k, lane] = tile[_NEXT + k, lane]


def _take_own(axes: Array, K: Array, p: int, tile: Array) -> None:
    """The known reading of sensor p less what size and cube of the vector along its axis make."""
    a, b, c = axes[p, 0], axes[p, 1], axes[p, 2]
    size, cube = K[p, _OWN_SIZE], K[p, _OWN_CUBE]
    for lane in range(LANES):
        own = a * tile[0, lane] + b * tile[1, lane] + c * tile[2, lane]
        tile[_VALUE, lane] = tile[_KNOWN + p, lane] - size * abs(own) - cube * own * own * own


def _take_products(K: Array, p: int, force: int, row: int, tile: Array) -> None:
    """Take off a row of the tile what products of the components of the force, which begins in row `force`, make in
    sensor p."""
    xx, xy, xz = K[p, _PRODUCTS], K[p, _PRODUCTS + 1], K[p, _PRODUCTS + 2]
    yy, yz, zz = K[p, _PRODUCTS + 3], K[p, _PRODUCTS + 4], K[p, _PRODUCTS + 5]
    for lane in range(LANES):
        x, y, z = tile[force, lane], tile[force + 1, lane], tile[force + 2, lane]
        tile[row, lane] -= x * (xx * x + xy * y + xz * z) + y * (yy * y + yz * z) + zz * z * z
