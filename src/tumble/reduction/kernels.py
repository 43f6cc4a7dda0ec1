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

    def decorate(function: Function) -> Function:
        try:
            return numba.njit(cache=True, nogil=True, **flags)(function)  # type: ignore[no-any-return]
        except RuntimeError:
            return numba.njit(nogil=True, **flags)(function)  # type: ignore[no-any-return]

    return decorate


# Preintegration of turns ------------------------------------------------------------------------------------
#
# Turns are cut into stretches of at most STRETCH samples, of which LANES are integrated side by side. TILE
# samples of each lane at a time are copied to `tile`, where neighbouring lanes are neighbours in memory; then
# every step takes one sample of every lane, a loop that the compiler turns into vector instructions. Rows of
# `tile` and `state` are PITCH numbers long: a constant, without which the compiler could not know that rows
# do not overlap, and more than LANES, lest all rows fall on the same lines of the processor's cache. A lane
# that ends before the others is filled up with zero increments over zero time, which change nothing.
#
# Rows of `state`: attitude quaternion (4, scalar first), increment of the sample before (3), then for every
# element of C_m, row by row, the sums of its products with Δθ (3) and with dt.

STRETCH = 512
LANES = 16
PITCH = LANES + 8
TILE = 16
_PREVIOUS = 4
_SUMS = 7
_STATE_ROWS = _SUMS + 9 * 4


def preintegrate(
    increment: Array, dt: Array, starts: IntArray, stops: IntArray, transform: Array, offset: Array
) -> tuple[Array, Array, Array]:
    """Rotations of k turns and their sensitivities to the gyro model: C (k, 3, 3), body at the end of a turn
    → body at its start; M (k, 3, 3, 3) = ∫ C ⊗ ω dt, rad; B (k, 3, 3) = ∫ C dt, s.

    `increment` (m, 3), rad, and `dt` (m,), s, are samples of nominal sensors, all turns one after the other;
    turn j is samples starts[j] … stops[j] − 1, and may be empty. A sample is compensated to
    Δθ = transform @ increment + offset · dt, with `transform` (3, 3) and `offset` (3,) in rad/s. Then, with
    Δθ' of the sample before and C_m the attitude in the middle of the step,

        φ = Δθ + Δθ' × Δθ / 12,   C ← C exp([φ×]),   M[i,p,q] += C_m[i,p] Δθ_q,   B[i,p] += C_m[i,p] dt

    so that small E and δ in ω̂ = (I + E) ω + δ, where ω is the compensated rate, turn C into
    exp([−(M : E + B δ)×]) C, with (M : E)_i = Σ_pq M[i,p,q] E[p,q].

    The sample before the first of turn j is sample starts[j] − 1, in whatever range it lies: it has to be the
    one before it in time, over an interval as long. Only if starts[j] is 0 is there none, and the first step
    has no coning term. Errors of arithmetic are below 1e-12 while a sample turns by less than 0.5 rad.

    Source: preintegration on the manifold (Forster et al. 2017) for increments of rate-integrating sensors,
    with the coning term from the sample before (Savage 1998)."""
    turn, first, stop = _stretches(np.asarray(starts, dtype=np.int64), np.asarray(stops, dtype=np.int64))
    attitude = np.zeros((len(starts), 4))
    attitude[:, 0] = 1.0
    C, M, B = np.empty((len(starts), 3, 3)), np.zeros((len(starts), 3, 3, 3)), np.zeros((len(starts), 3, 3))
    _preintegrate_stretches(
        np.ascontiguousarray(increment, dtype=np.float64),
        np.ascontiguousarray(dt, dtype=np.float64),
        (turn, first, stop),
        np.ascontiguousarray(transform, dtype=np.float64),
        np.ascontiguousarray(offset, dtype=np.float64),
        (attitude, C, M, B),
    )
    return C, M, B


def _stretches(starts: IntArray, stops: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Turn, first sample and end of each stretch: turns cut evenly into as few stretches as possible."""
    length = stops - starts
    count = -(-length // STRETCH)
    turn = np.repeat(np.arange(len(starts)), count)
    position = np.arange(len(turn)) - np.repeat(np.cumsum(count) - count, count)
    first = starts[turn] + length[turn] * position // count[turn]
    stop = starts[turn] + length[turn] * (position + 1) // count[turn]
    return turn, first, stop


@_compiled(error_model="numpy")
def _preintegrate_stretches(
    increment: Array,
    dt: Array,
    stretches: tuple[IntArray, IntArray, IntArray],
    transform: Array,
    offset: Array,
    result: tuple[Array, Array, Array, Array],
) -> None:
    """Preintegrate stretches group by group and join them in order to `result`: attitude (k, 4), C, M, B."""
    turn, first, stop = stretches
    attitude, C, M, B = result
    tile = np.empty(TILE * 4 * PITCH)
    state = np.empty(_STATE_ROWS * PITCH)
    for group in range(0, len(turn), LANES):
        lanes = slice(group, min(group + LANES, len(turn)))
        _begin(increment, dt, first[lanes], transform, offset, state)
        longest = np.max(stop[lanes] - first[lanes])
        for done in range(0, longest, TILE):
            steps = min(TILE, longest - done)
            _fill(increment, dt, first[lanes] + done, stop[lanes], steps, tile)
            _advance(tile, steps, len(first[lanes]), transform, offset, state)
        _join(state, turn[lanes], attitude, C, M, B)
    for k in range(len(C)):
        _matrix_of(attitude[k], C[k])


@_compiled(error_model="numpy")
def _begin(increment: Array, dt: Array, first: IntArray, transform: Array, offset: Array, state: Array) -> None:
    """Zero `state`, with attitude 1 and the compensated increment of the sample before each lane."""
    state[:] = 0.0
    for lane, sample in enumerate(first):
        state[lane] = 1.0
        if sample > 0:
            for p in range(3):
                angle = offset[p] * dt[sample - 1]
                for q in range(3):
                    angle += transform[p, q] * increment[sample - 1, q]
                state[(_PREVIOUS + p) * PITCH + lane] = angle


@_compiled(error_model="numpy")
def _fill(increment: Array, dt: Array, first: IntArray, stop: IntArray, steps: int, tile: Array) -> None:
    """Copy `steps` samples of each lane to `tile`: rows increment x, y, z and dt of the first step, then of
    the second, …, with zeros behind the end of a lane."""
    for lane in range(len(first)):
        length = max(0, min(steps, stop[lane] - first[lane]))
        for step in range(length):
            sample, cell = first[lane] + step, 4 * PITCH * step + lane
            tile[cell] = increment[sample, 0]
            tile[cell + PITCH] = increment[sample, 1]
            tile[cell + 2 * PITCH] = increment[sample, 2]
            tile[cell + 3 * PITCH] = dt[sample]
        for row in range(4 * length, 4 * steps):
            tile[row * PITCH + lane] = 0.0


@_compiled(error_model="numpy", fastmath={"contract"})
def _advance(tile: Array, steps: int, lanes: int, transform: Array, offset: Array, state: Array) -> None:
    """Carry the attitudes and sums of the lanes through the samples in `tile`.

    As quaternions, with e = exp(φ/2): q_m = q e in the middle of a step, and q e² at its end, where
    e² = 2 e₀ e − 1, that is 2 e₀ q_m − q. cos and sin of the half angle |φ|/4 of e are Taylor series in its
    square h; the terms left out are below 3e-16 at |φ| = 0.5 rad."""
    a00, a01, a02 = transform[0]
    a10, a11, a12 = transform[1]
    a20, a21, a22 = transform[2]
    b0, b1, b2 = offset
    for step in range(steps):
        sample = 4 * PITCH * step
        for i in range(lanes):
            u, v = tile[sample + i], tile[sample + PITCH + i]
            w, dt = tile[sample + 2 * PITCH + i], tile[sample + 3 * PITCH + i]
            x = a00 * u + a01 * v + a02 * w + b0 * dt
            y = a10 * u + a11 * v + a12 * w + b1 * dt
            z = a20 * u + a21 * v + a22 * w + b2 * dt

            px, py, pz = state[4 * PITCH + i], state[5 * PITCH + i], state[6 * PITCH + i]
            state[4 * PITCH + i], state[5 * PITCH + i], state[6 * PITCH + i] = x, y, z
            fx = x + (py * z - pz * y) * (1.0 / 12.0)
            fy = y + (pz * x - px * z) * (1.0 / 12.0)
            fz = z + (px * y - py * x) * (1.0 / 12.0)

            h = (fx * fx + fy * fy + fz * fz) * (1.0 / 16.0)
            e0 = 1.0 - h * (1 / 2 - h * (1 / 24 - h * (1 / 720 - h * (1 / 40320))))
            s = 0.25 - h * (1 / 24 - h * (1 / 480 - h * (1 / 20160 - h * (1 / 1451520))))
            e1, e2, e3 = s * fx, s * fy, s * fz

            q0, q1, q2, q3 = state[i], state[PITCH + i], state[2 * PITCH + i], state[3 * PITCH + i]
            m0 = q0 * e0 - q1 * e1 - q2 * e2 - q3 * e3
            m1 = q0 * e1 + q1 * e0 + q2 * e3 - q3 * e2
            m2 = q0 * e2 - q1 * e3 + q2 * e0 + q3 * e1
            m3 = q0 * e3 + q1 * e2 - q2 * e1 + q3 * e0
            state[i] = 2.0 * e0 * m0 - q0
            state[PITCH + i] = 2.0 * e0 * m1 - q1
            state[2 * PITCH + i] = 2.0 * e0 * m2 - q2
            state[3 * PITCH + i] = 2.0 * e0 * m3 - q3

            d1, d2, d3 = m1 + m1, m2 + m2, m3 + m3
            c00, c01, c02 = 1.0 - (d2 * m2 + d3 * m3), d1 * m2 - d3 * m0, d1 * m3 + d2 * m0
            c10, c11, c12 = d1 * m2 + d3 * m0, 1.0 - (d1 * m1 + d3 * m3), d2 * m3 - d1 * m0
            c20, c21, c22 = d1 * m3 - d2 * m0, d2 * m3 + d1 * m0, 1.0 - (d1 * m1 + d2 * m2)

            state[7 * PITCH + i] += c00 * x
            state[8 * PITCH + i] += c00 * y
            state[9 * PITCH + i] += c00 * z
            state[10 * PITCH + i] += c00 * dt
            state[11 * PITCH + i] += c01 * x
            state[12 * PITCH + i] += c01 * y
            state[13 * PITCH + i] += c01 * z
            state[14 * PITCH + i] += c01 * dt
            state[15 * PITCH + i] += c02 * x
            state[16 * PITCH + i] += c02 * y
            state[17 * PITCH + i] += c02 * z
            state[18 * PITCH + i] += c02 * dt
            state[19 * PITCH + i] += c10 * x
            state[20 * PITCH + i] += c10 * y
            state[21 * PITCH + i] += c10 * z
            state[22 * PITCH + i] += c10 * dt
            state[23 * PITCH + i] += c11 * x
            state[24 * PITCH + i] += c11 * y
            state[25 * PITCH + i] += c11 * z
            state[26 * PITCH + i] += c11 * dt
            state[27 * PITCH + i] += c12 * x
            state[28 * PITCH + i] += c12 * y
            state[29 * PITCH + i] += c12 * z
            state[30 * PITCH + i] += c12 * dt
            state[31 * PITCH + i] += c20 * x
            state[32 * PITCH + i] += c20 * y
            state[33 * PITCH + i] += c20 * z
            state[34 * PITCH + i] += c20 * dt
            state[35 * PITCH + i] += c21 * x
            state[36 * PITCH + i] += c21 * y
            state[37 * PITCH + i] += c21 * z
            state[38 * PITCH + i] += c21 * dt
            state[39 * PITCH + i] += c22 * x
            state[40 * PITCH + i] += c22 * y
            state[41 * PITCH + i] += c22 * z
            state[42 * PITCH + i] += c22 * dt


@_compiled(error_model="numpy")
def _join(state: Array, turn: IntArray, attitude: Array, C: Array, M: Array, B: Array) -> None:
    """Append the stretches in `state` to their turns: M += C M₂, B += C B₂, C ← C C₂ (as quaternions, of unit
    length again after every stretch)."""
    for lane, k in enumerate(turn):
        _matrix_of(attitude[k], C[k])
        for j in range(3):
            for p in range(3):
                row = _SUMS + 4 * (3 * j + p)
                for i in range(3):
                    for q in range(3):
                        M[k, i, p, q] += C[k, i, j] * state[(row + q) * PITCH + lane]
                    B[k, i, p] += C[k, i, j] * state[(row + 3) * PITCH + lane]
        a0, a1, a2, a3 = attitude[k]
        b0, b1, b2, b3 = state[lane], state[PITCH + lane], state[2 * PITCH + lane], state[3 * PITCH + lane]
        q0 = a0 * b0 - a1 * b1 - a2 * b2 - a3 * b3
        q1 = a0 * b1 + a1 * b0 + a2 * b3 - a3 * b2
        q2 = a0 * b2 - a1 * b3 + a2 * b0 + a3 * b1
        q3 = a0 * b3 + a1 * b2 - a2 * b1 + a3 * b0
        length = np.sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
        attitude[k, 0], attitude[k, 1] = q0 / length, q1 / length
        attitude[k, 2], attitude[k, 3] = q2 / length, q3 / length


@_compiled(error_model="numpy")
def _matrix_of(q: Array, C: Array) -> None:
    """Write the matrix of a unit quaternion, scalar first, to C (3, 3)."""
    C[0, 0] = 1.0 - 2.0 * (q[2] * q[2] + q[3] * q[3])
    C[0, 1] = 2.0 * (q[1] * q[2] - q[3] * q[0])
    C[0, 2] = 2.0 * (q[1] * q[3] + q[2] * q[0])
    C[1, 0] = 2.0 * (q[1] * q[2] + q[3] * q[0])
    C[1, 1] = 1.0 - 2.0 * (q[1] * q[1] + q[3] * q[3])
    C[1, 2] = 2.0 * (q[2] * q[3] - q[1] * q[0])
    C[2, 0] = 2.0 * (q[1] * q[3] - q[2] * q[0])
    C[2, 1] = 2.0 * (q[2] * q[3] + q[1] * q[0])
    C[2, 2] = 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2])


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


@_compiled(error_model="numpy", fastmath={"contract", "reassoc"})
def _squared_differences(a: Array, b: Array, c: Array) -> float:
    """Sum of (c − 2 b + a)²."""
    total = 0.0
    for j in range(len(a)):
        difference = (c[j] - b[j]) - (b[j] - a[j])
        total += difference * difference
    return total


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


@_compiled()
def _end_row(channel: Array, value: float, length: float, stop: float) -> None:
    """Take note of a row of equal values that ends, or goes on after this chunk."""
    if length > channel[6]:
        channel[6], channel[7], channel[8] = length, stop, value
    if value == channel[1] and length > channel[9]:
        channel[9], channel[10] = length, stop
    if value == channel[2] and length > channel[11]:
        channel[11], channel[12] = length, stop
