"""Compiled loops over samples. Each has a plain twin in tests/naive.py that says the same in NumPy.

Nothing is compiled when this module is imported: a loop is compiled when it is first called, and its machine
code is kept on disk. The key of that cache is the source of the function and the types of its arguments, not
the flags of the compiler: a function must have one set of flags only.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np
import numpy.typing as npt

from tumble.units import Array

IntArray = npt.NDArray[np.int64]
Function = TypeVar("Function", bound=Callable[..., Any])


def _compiled(**flags: Any) -> Callable[[Function], Function]:
    """numba.njit that keeps the machine code on disk, or in memory alone where no folder can be written."""
    flags = {"nogil": True, "no_cfunc_wrapper": True, **flags}

    def decorate(function: Function) -> Function:
        try:
            return numba.njit(cache=True, **flags)(function)  # type: ignore[no-any-return]
        except RuntimeError:
            return numba.njit(**flags)(function)  # type: ignore[no-any-return]

    return decorate


def _part_of_compiled(**flags: Any) -> Callable[[Function], Function]:
    """numba.njit for a loop that only compiled loops call: neither kept on disk nor made callable from Python, since it
    is in the machine code of those that call it."""
    flags = {"nogil": True, "no_cfunc_wrapper": True, "no_cpython_wrapper": True, **flags}
    return numba.njit(**flags)  # type: ignore[no-any-return]


# Allan variance ----------------------------------------------------------------------------------------------


@_compiled(error_model="numpy")
def allan_sums(phase: Array, sizes: IntArray) -> Array:
    """Sums (k,) of (x[j+2m] − 2 x[j+m] + x[j])² over all j, for the integral x (n,) of a signal and cluster sizes
    m (k,), in samples, all below n/2.

    All sizes are taken through one block of j before the next, so that x is read from memory about once."""
    sums = np.zeros(len(sizes))
    for begin in range(0, len(phase), 4096):
        for i, m in enumerate(sizes):
            end = min(begin + 4096, len(phase) - 2 * m)
            if end > begin:
                sums[i] += _squared_differences(
                    phase[begin:end], phase[begin + m : end + m], phase[begin + 2 * m : end + 2 * m]
                )
    return sums


@_part_of_compiled(error_model="numpy", fastmath={"contract", "reassoc"})
def _squared_differences(a: Array, b: Array, c: Array) -> float:
    """Sum of (c − 2 b + a)²."""
    total = 0.0
    for j in range(len(a)):
        difference = (c[j] - b[j]) - (b[j] - a[j])
        total += difference * difference
    return total


# Autoregressive noise ----------------------------------------------------------------------------------------


@_compiled(error_model="numpy")
def levinson(autocovariance: Array, filters: Array, powers: Array) -> int:
    """Prediction-error filters (P, P), a row an order from 0, and innovation variances (P,) of autocovariances (P,) by
    Levinson's recursion, both zero before; returns how many orders there are until the process would be no longer
    stationary."""
    filters[0, 0], powers[0] = 1.0, autocovariance[0]
    for order in range(1, len(autocovariance)):
        total = 0.0
        for k in range(order):
            total += filters[order - 1, k] * autocovariance[order - k]
        reflection = -total / powers[order - 1]
        if reflection * reflection > 1.0 - 1e-9:
            return order
        for k in range(order + 1):
            filters[order, k] = filters[order - 1, k] + reflection * filters[order - 1, order - k]
        powers[order] = powers[order - 1] * (1.0 - reflection * reflection)
    return len(autocovariance)


@_compiled(error_model="numpy")
def continue_autocovariance(autocovariance: Array, prediction_filter: Array, negligible: float) -> None:
    """Write the autocovariances of an autoregressive process of order p behind the first p + 1, until a filter's length
    of them is below `negligible` of the first."""
    order = len(prediction_filter) - 1
    for lag in range(order + 1, len(autocovariance)):
        total, largest = 0.0, 0.0
        for k in range(1, order + 1):
            total -= prediction_filter[k] * autocovariance[lag - k]
            largest = max(largest, abs(autocovariance[lag - k]))
        autocovariance[lag] = total
        if lag % 64 == 0 and max(largest, abs(total)) < negligible * autocovariance[0]:
            return


# Means of blocks and the state of channels --------------------------------------------------------------------

CHANNEL_STATE = 14
"""Per channel: 0 samples, 1 minimum, 2 maximum, 3 repeats, 4 last value, 5 length of the present row of equal
values, 6 longest row, 7 its end (s), 8 its value; 9 longest row at the minimum, 10 its end; 11 longest row at the
maximum, 12 its end; 13 smallest step from one value to another."""


def new_channel_state(sensors: int) -> Array:
    """State of `block_sums` before the first sample: one row of CHANNEL_STATE numbers a channel."""
    state = np.zeros((sensors, CHANNEL_STATE))
    state[:, 1], state[:, 2], state[:, 4], state[:, 13] = np.inf, -np.inf, np.nan, np.inf
    return state


@_compiled()
def block_sums(
    values: Array, time: Array, weight: Array, size: int, sums: Array, filled: IntArray, state: Array, out: Array
) -> int:
    """Weighted sums of blocks of `size` samples of values (m, n) at times (m,), s, continued from call to call:
    `sums` (n,) and `filled` (1,) hold the block under way, `state` the channels (CHANNEL_STATE). Returns how many
    rows of `out` were written."""
    blocks = 0
    for c in range(values.shape[1]):
        blocks, count, total = 0, filled[0], sums[c]
        last, row, repeats = state[c, 4], state[c, 5], 0
        for i in range(values.shape[0]):
            x = values[i, c]
            total += x * weight[i]
            if x == last:
                row += 1.0
                repeats += 1
            else:
                if row > 1.0:
                    _end_row(state[c], last, row, time[max(i - 1, 0)])
                step = abs(x - last)
                if step < state[c, 13]:
                    state[c, 13] = step
                last, row = x, 1.0
                if x < state[c, 1]:
                    state[c, 1], state[c, 9] = x, 0.0
                if x > state[c, 2]:
                    state[c, 2], state[c, 11] = x, 0.0
            count += 1
            if count == size:
                out[blocks, c] = total
                blocks, count, total = blocks + 1, 0, 0.0
        if row > 1.0:
            _end_row(state[c], last, row, time[-1])
        state[c, 0] += values.shape[0]
        state[c, 3] += repeats
        state[c, 4], state[c, 5], sums[c] = last, row, total
    filled[0] = (filled[0] + values.shape[0]) % size
    return blocks


@_part_of_compiled()
def _end_row(channel: Array, value: float, length: float, stop: float) -> None:
    """Take note of a row of equal values that ends, or goes on after this chunk."""
    if length > channel[6]:
        channel[6], channel[7], channel[8] = length, stop, value
    if value == channel[1] and length > channel[9]:
        channel[9], channel[10] = length, stop
    if value == channel[2] and length > channel[11]:
        channel[11], channel[12] = length, stop
