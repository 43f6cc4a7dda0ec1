# cython: language_level=3, infer_types=True, boundscheck=False, wraparound=False, initializedcheck=False, cdivision=True
"""Compiled loops over samples. Each has a plain twin in tests/support/naive.py that says the same in NumPy.

Sums are taken in the order that is written.
"""

import numpy as np

from libc.stdint cimport int64_t

cdef enum:
    LANES = 16

# Allan variance ----------------------------------------------------------------------------------------------


def allan_sums(const double[::1] phase, const int64_t[:] sizes):
    """Sums (k,) of (x[j+2m] − 2 x[j+m] + x[j])² over all j, for the integral x (n,) of a signal and cluster sizes
    m (k,), in samples, all below n/2.

    All sizes are taken through one block of j before the next, so that x is read from memory about once."""
    parts = np.zeros((sizes.shape[0], LANES))
    cdef double[:, ::1] sums = parts
    n = phase.shape[0]
    with nogil:
        for block in range((n + 4095) // 4096):
            begin = 4096 * block
            for i in range(sizes.shape[0]):
                _add_squares(phase, begin, min(begin + 4096, n - 2 * sizes[i]), sizes[i], sums, i)
    return parts.sum(axis=1)


cdef void _add_squares(
    const double[::1] phase, Py_ssize_t begin, Py_ssize_t end, Py_ssize_t m, double[:, ::1] sums, Py_ssize_t i,
) noexcept nogil:
    """Add (x[j+2m] − 2 x[j+m] + x[j])² for j from begin to end, every LANES-th to one part."""
    for group in range((end - begin) // LANES):
        for lane in range(LANES):
            j = begin + group * LANES + lane
            difference = (phase[j + 2 * m] - phase[j + m]) - (phase[j + m] - phase[j])
            sums[i, lane] += difference * difference
    for j in range(end - (end - begin) % LANES if end > begin else end, end):
        difference = (phase[j + 2 * m] - phase[j + m]) - (phase[j + m] - phase[j])
        sums[i, 0] += difference * difference


# Autoregressive noise ----------------------------------------------------------------------------------------


cpdef Py_ssize_t levinson(const double[:] autocovariance, double[:, :] filters, double[:] powers):
    """Prediction-error filters (P, P), a row an order from 0, and innovation variances (P,) of autocovariances (P,) by
    Levinson's recursion, both zero before; returns how many orders there are until the process would be no longer
    stationary."""
    cdef double total
    filters[0, 0], powers[0] = 1.0, autocovariance[0]
    for order in range(1, autocovariance.shape[0]):
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


cpdef continue_autocovariance(double[::1] autocovariance, const double[::1] prediction_filter, double negligible):
    """Write the autocovariances of an autoregressive process of order p behind the first p + 1, until a filter's length
    of them is below `negligible` of the first."""
    cdef double total, largest
    order = prediction_filter.shape[0] - 1
    with nogil:
        for lag in range(order + 1, autocovariance.shape[0]):
            total, largest = 0.0, 0.0
            for k in range(1, order + 1):
                total -= prediction_filter[k] * autocovariance[lag - k]
                largest = max(largest, abs(autocovariance[lag - k]))
            autocovariance[lag] = total
            if lag % 64 == 0 and max(largest, abs(total)) < negligible * autocovariance[0]:
                break


cpdef mean_variances(
    const double[:, :] autocovariance, const double[:] batches, double least, double[:, ::1] sums, double[:, ::1] out,
):
    """Variances (c, n), into `out`, of means over K (n,) samples, by the autocovariances (c, L) from lag 0,

        v(K) = (2 (Σ r_j − Σ j r_j / K) − r_0) / K,    j < K,

    and not less than `least` r_0/K. `sums` (2, L): room for the partial sums of one channel."""
    cdef double K, white, total, moment
    cdef Py_ssize_t last, longest = 0
    with nogil:
        for k in range(batches.shape[0]):
            last = min(max(<Py_ssize_t> batches[k], 1), autocovariance.shape[1]) - 1
            longest = max(longest, last)
        for c in range(autocovariance.shape[0]):
            total, moment = 0.0, 0.0
            for j in range(longest + 1):
                total += autocovariance[c, j]
                moment += j * autocovariance[c, j]
                sums[0, j], sums[1, j] = total, moment
            white = autocovariance[c, 0]
            for k in range(batches.shape[0]):
                K = batches[k]
                last = min(max(<Py_ssize_t> K, 1), autocovariance.shape[1]) - 1
                out[c, k] = max((2.0 * (sums[0, last] - sums[1, last] / K) - white) / K, least * white / K)


# A lag of first order ----------------------------------------------------------------------------------------


cpdef follow(double[::1] values, double kept):
    """Add to each of the values (n,) what is kept of the one before it, in place: y[k] = x[k] + a y[k−1]."""
    for k in range(1, values.shape[0]):
        values[k] += kept * values[k - 1]


# Means of blocks and the state of channels --------------------------------------------------------------------

CHANNEL_STATE = 14
"""Per channel: 0 samples, 1 minimum, 2 maximum, 3 repeats, 4 last value, 5 length of the present row of equal
values, 6 longest row, 7 its end (s), 8 its value; 9 longest row at the minimum, 10 its end; 11 longest row at the
maximum, 12 its end; 13 smallest step from one value to another."""


def new_channel_state(sensors):
    """State of `block_sums` before the first sample: one row of CHANNEL_STATE numbers a channel."""
    state = np.zeros((sensors, CHANNEL_STATE))
    state[:, 1], state[:, 2], state[:, 4], state[:, 13] = np.inf, -np.inf, np.nan, np.inf
    return state


cpdef Py_ssize_t block_sums(
    const double[:, :] values, const double[:] time, const double[:] weight, int64_t size, double[:] sums,
    int64_t[:] filled, double[:, ::1] state, double[:, :] out,
):
    """Weighted sums of blocks of `size` samples of values (m, n) at times (m,), s, continued from call to call:
    `sums` (n,) and `filled` (1,) hold the block under way, `state` the channels (CHANNEL_STATE). Returns how many
    rows of `out` were written."""
    cdef double total, row, last, lowest, highest, step
    cdef int64_t repeats, count
    cdef Py_ssize_t blocks
    blocks, samples = 0, values.shape[0]
    with nogil:
        for c in range(values.shape[1]):
            blocks, count, total = 0, filled[0], sums[c]
            lowest, highest, step = state[c, 1], state[c, 2], state[c, 13]
            last, row, repeats = state[c, 4], state[c, 5], 0
            for i in range(samples):
                x = values[i, c]
                total += x * weight[i]
                if x == last:
                    row += 1.0
                    repeats += 1
                else:
                    if row > 1.0:
                        _end_row(state, c, last, row, time[max(i - 1, 0)])
                    step = min(step, abs(x - last))
                    last, row = x, 1.0
                    if x < lowest:
                        lowest, state[c, 1], state[c, 9] = x, x, 0.0
                    if x > highest:
                        highest, state[c, 2], state[c, 11] = x, x, 0.0
                count += 1
                if count == size:
                    out[blocks, c] = total
                    blocks, count, total = blocks + 1, 0, 0.0
            if row > 1.0:
                _end_row(state, c, last, row, time[samples - 1])
            state[c, 0] += samples
            state[c, 3] += repeats
            state[c, 4], state[c, 5], state[c, 13], sums[c] = last, row, step, total
        filled[0] = (filled[0] + samples) % size
    return blocks


cdef void _end_row(double[:, ::1] state, Py_ssize_t c, double value, double length, double stop) noexcept nogil:
    """Take note of a row of equal values that ends, or goes on after this chunk."""
    if length > state[c, 6]:
        state[c, 6], state[c, 7], state[c, 8] = length, stop, value
    if value == state[c, 1] and length > state[c, 9]:
        state[c, 9], state[c, 10] = length, stop
    if value == state[c, 2] and length > state[c, 11]:
        state[c, 11], state[c, 12] = length, stop
