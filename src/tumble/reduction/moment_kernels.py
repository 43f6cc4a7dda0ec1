"""Compiled loops over the samples of turns: the sums of which `tumble.reduction.moments` makes the moments of a turn.

Pieces of turns are cut into stretches of at most STRETCH samples, of which LANES are integrated side by side. Of each
lane TILE samples at a time go through a chain of short passes: `_fill` brings them into rows in which neighbouring
lanes are neighbours in memory, and every pass that follows is a loop over lanes that the compiler turns into vector
instructions. A pass that did everything at once would not be: beyond some fifty sums in one loop the compiler gives up.

    _fill  readings of nominal sensors and dt          → rows y_g (3), y_a (3), dt
    _compensate  sensor model, delay                   → rows ω (3), f (3), dt
    _regress  products with dt                         → `right`: dt, ω, f, f f, ω ω and |a·ω|, (a·ω)³, |a·f|, (a·f)³
    _turn  the step with the attitude C_m in its middle → `left`: C_m, and C_m × V by columns
    _turn_about  C_m [ω×] dt                           → `swept`
    _add_products  left ⊗ right                        → `sums`

All moments are outer products of nine numbers of the attitude with regressors of a sample, Ψ included: by summation in
parts, exact for the discrete sums too,

    Ψ_jb = Σ (Φ + ½ΔΦ)_jb × ΔV = Φ_jb(T) × V(T) − Σ ΔΦ_jb × (V + ½ΔV),      ΔΦ_jb = C_m e_j β_b dt.

A lane that ends before the others, or its tile, is filled up with zero readings over zero time, which change no sum.
A row is ROW numbers long: constants, without which the compiler could not know that rows do not overlap, and no power
of two, lest all rows fall on the same lines of the processor's cache. The steps of a loop over `i` do not depend on one
another, which hatch_build.py tells GCC. The rules of `tumble.reduction.kernels` hold.
"""

from __future__ import annotations

import numpy as np

from tumble.units import Array, IntArray

try:
    import cython
except ImportError:
    from tumble import uncompiled as cython

STRETCH = 500
SHORTEST = 64

if not cython.compiled:  # where it is, these are numbers of moment_kernels.pxd
    from numpy import sqrt

    LANES = 16
    TILE = 24
    GROUP = 8
    ROW = TILE * LANES
    COMMON = 19  # regressors that do not depend on the axes of the sensors: 1, ω (3), f (3), f f (6), ω ω (6)
    LINEAR = 7

    # Rows of `state`: attitude quaternion (4, scalar first), V (3), and of the sample before: Δθ (3), Δv (3), the rate
    # that moved the force (3), dt, f (3); then the sum of Δt² |f − f'|².
    _V, _BEFORE, _RATE, _FORCE, _JUMPS, _STATE_ROWS = 4, 7, 13, 17, 20, 21

Samples = tuple[Array, Array, Array]
"""Rates (S, 3) rad/s, forces (S, 3) m/s², intervals (S,) s."""
Stretches = tuple[IntArray, IntArray, IntArray]
"""Piece, first sample and end."""
Terms = tuple[Array, Array]
"""Matrix and offset (3, 4) of y, and a row (n, 9) for each sensor with nonlinear terms: axis, coefficients of u², u³
and |u|, and effect on the vector."""
Model = tuple[Terms, Terms, Array, float]
"""Gyros, accelerometers, what the body's rate reads of its force (3, 3), or (0, 3) where it reads none, delay (s)."""
Work = tuple[Array, Array, Array, Array, Array, Array]
"""Tile, left, right, swept, state and total: memory for one group of lanes."""
Sums = tuple[Array, Array, Array, Array, Array, Array, Array]
"""Attitude (K, 4), V (K, 3), Σ C_m ⊗ regressors (K, R, 9), Σ (C_m × V) ⊗ regressors (K, Q, 9), Σ C_m [ω×] dt ⊗ f (K,
3, 9), Σ regressors (K, R), Σ Δt² |f − f'|² (K,)."""


def stretches_of(starts: IntArray, stops: IntArray) -> Stretches:
    """Stretches of all pieces, those of a piece one after the other, pieces of like stretches side by side: each piece
    cut evenly into as few as possible of at most STRETCH samples, or of less where that fills the lanes."""
    length = stops - starts
    longest = min(STRETCH, max(SHORTEST, -(-int(length.sum()) // LANES)))
    count = -(-length // longest)
    order = np.argsort(-(-length // np.maximum(count, 1)), kind="stable")[::-1]
    piece = np.repeat(order, count[order])
    position = np.arange(len(piece)) - np.repeat(np.cumsum(count[order]) - count[order], count[order])
    first = starts[piece] + length[piece] * position // count[piece]
    stop = starts[piece] + length[piece] * (position + 1) // count[piece]
    return piece, first, stop


def new_work(rows: int, linear: int) -> Work:
    """Memory for so many regressors in all, and so many that go with C_m × V too. Each array begins on a line of the
    processor's cache: vectors that straddle two take twice the time."""
    sizes = (16 * ROW, 18 * ROW, rows * ROW, 9 * ROW, _STATE_ROWS * LANES, (rows * 10 + linear * 9 + 27) * LANES)
    memory = np.empty(sum(sizes) + 8 * len(sizes))
    begin, out = -memory.__array_interface__["data"][0] // 8 % 8, []
    for size in sizes:
        out.append(memory[begin : begin + size])
        begin += -(-size // 8) * 8
    tile, left, right, swept, state, total = out
    return tile, left, right, swept, state, total


def integrate_stretches(
    samples: Samples,
    stretches: Stretches,
    model: Model,
    own_axes: tuple[Array, Array],
    sums: Sums,
    work: Work,
    lanes: int,
) -> None:
    """Integrate stretches group by group and join them in order to `sums`, which begin at rest: attitude 1 and zeros;
    `own_axes` are those of the gyros (n, 3) and accelerometers (m, 3) whose own-axis regressors are wanted. `lanes` is
    LANES, which the compiler must not know: it would unroll the loops over lanes before it turned them into vectors."""
    rates, forces, intervals = samples
    piece, first, stop = stretches
    (gyro, gyro_terms), (accel, accel_terms), G, delay = model
    gyros, accels = own_axes
    attitude, V, products, moved, swept_sums, regressors, jumps = sums
    tile, left, right, swept, state, total = work
    _integrate(
        rates, forces, intervals,
        piece, first, stop,
        gyro, gyro_terms, accel, accel_terms, G, delay,
        gyros, accels,
        attitude, V, products, moved, swept_sums, regressors, jumps,
        tile, left, right, swept, state, total, np.empty((3, 3)), lanes,
    )  # fmt: skip


def _integrate(
    rates: Array,
    forces: Array,
    intervals: Array,
    piece: IntArray,
    first: IntArray,
    stop: IntArray,
    gyro: Array,
    gyro_terms: Array,
    accel: Array,
    accel_terms: Array,
    G: Array,
    delay: float,
    gyros: Array,
    accels: Array,
    attitude: Array,
    V: Array,
    products: Array,
    moved: Array,
    swept_sums: Array,
    regressors: Array,
    jumps: Array,
    tile: Array,
    left: Array,
    right: Array,
    swept: Array,
    state: Array,
    total: Array,
    C: Array,
    lanes: int,
) -> None:
    """The same without tuples."""
    rows, linear = products.shape[1], moved.shape[1]
    with cython.nogil:
        for number in range((piece.shape[0] + LANES - 1) // LANES):
            group = number * LANES
            state[:] = 0.0
            total[:] = 0.0
            _fill(rates, forces, intervals, first, stop, group, -2, 2, tile)
            _compensate(tile, 2, gyro, gyro_terms, accel, accel_terms, G, delay, lanes, state)
            _begin(tile, state)
            longest = 0
            for lane in range(group, min(group + LANES, piece.shape[0])):
                longest = max(longest, stop[lane] - first[lane])
            for part in range((longest + TILE - 1) // TILE):
                done = part * TILE
                steps = min(TILE, (longest - done + GROUP - 1) // GROUP * GROUP)
                _fill(rates, forces, intervals, first, stop, group, done, steps, tile)
                _compensate(tile, steps, gyro, gyro_terms, accel, accel_terms, G, delay, lanes, state)
                _regress(tile, steps, lanes, right, state)
                _regress_own(tile, steps, gyros, accels, right)
                _turn(right, steps, lanes, state, left)
                _turn_about(left, right, steps, swept)
                _add_all(left, right, swept, tile, steps, lanes, rows, linear, total)
            for lane in range(min(LANES, piece.shape[0] - group)):
                k = piece[group + lane]
                _join(k, lane, state, total, C, attitude, V, products, moved, swept_sums, regressors, jumps)


def _begin(tile: Array, state: Array) -> None:
    """State at the start of every lane: attitude 1, and of the second sample in the tile what is remembered of the
    sample before."""
    for lane in range(LANES):
        now = LANES + lane
        dt = tile[6 * ROW + now]
        state[lane] = 1.0
        for k in range(3):
            state[(_BEFORE + k) * LANES + lane] = tile[k * ROW + now] * dt
            state[(_BEFORE + 3 + k) * LANES + lane] = tile[(3 + k) * ROW + now] * dt
            state[(_FORCE + k) * LANES + lane] = tile[(3 + k) * ROW + now]


def _fill(
    rates: Array,
    forces: Array,
    intervals: Array,
    first: IntArray,
    stop: IntArray,
    group: int,
    done: int,
    steps: int,
    tile: Array,
) -> None:
    """Copy `steps` samples of each lane after the first `done` to `tile`, with zeros behind the end of a lane and in
    lanes that are not used. A sample before the first of all is the first, over no time."""
    for lane in range(LANES):
        length = 0
        if group + lane < first.shape[0]:
            begin = first[group + lane] + done
            length = max(0, min(steps, stop[group + lane] - begin))
            for step in range(length):
                sample, cell = max(begin + step, 0), LANES * step + lane
                for k in range(3):
                    tile[k * ROW + cell] = rates[sample, k]
                    tile[(3 + k) * ROW + cell] = forces[sample, k]
                tile[6 * ROW + cell] = intervals[sample] if begin + step >= 0 else 0.0
        for step in range(length, steps):
            for row in range(7):
                tile[row * ROW + LANES * step + lane] = 0.0


# Compensation ------------------------------------------------------------------------------------------------


def _compensate(
    tile: Array,
    steps: int,
    gyro: Array,
    gyro_terms: Array,
    accel: Array,
    accel_terms: Array,
    G: Array,
    delay: float,
    lanes: int,
    state: Array,
) -> None:
    """Rates and specific forces of the body in place of the readings, in the order of Part II, A1: force; rate with
    g-sensitivity to the late force; force moved by the delay with that rate; rate with g-sensitivity to the moved one.

    A1 moves the force with a rate from which no G f was taken: at 0.01 °/s/(m/s²) and 4 ms that left 2·10⁻⁴ m/s in the
    velocity of a turn of 6 s, this 10⁻⁵."""
    many, linear, scratch = steps * LANES, 7 * ROW, 10 * ROW
    _transform(tile, many, gyro, accel)
    _subtract_terms(tile, 3 * ROW, many, accel_terms, scratch)
    if delay != 0.0:
        _copy(tile, 0, linear, many)
        _subtract_force(tile, many, G)
        _subtract_terms(tile, 0, many, gyro_terms, scratch)
        _move(tile, steps, lanes, delay, state)
        _copy(tile, linear, 0, many)
    _subtract_force(tile, many, G)
    _subtract_terms(tile, 0, many, gyro_terms, scratch)


def _transform(tile: Array, many: int, A: Array, B: Array) -> None:
    """ω = A y_g + a and f = B y_a + b, in place; a and b are the fourth columns."""
    a00, a01, a02, a0 = A[0, 0], A[0, 1], A[0, 2], A[0, 3]
    a10, a11, a12, a1 = A[1, 0], A[1, 1], A[1, 2], A[1, 3]
    a20, a21, a22, a2 = A[2, 0], A[2, 1], A[2, 2], A[2, 3]
    b00, b01, b02, b0 = B[0, 0], B[0, 1], B[0, 2], B[0, 3]
    b10, b11, b12, b1 = B[1, 0], B[1, 1], B[1, 2], B[1, 3]
    b20, b21, b22, b2 = B[2, 0], B[2, 1], B[2, 2], B[2, 3]
    for i in range(many):
        x, y, z = tile[i], tile[ROW + i], tile[2 * ROW + i]
        u, v, w = tile[3 * ROW + i], tile[4 * ROW + i], tile[5 * ROW + i]
        tile[i] = a0 + a00 * x + a01 * y + a02 * z
        tile[ROW + i] = a1 + a10 * x + a11 * y + a12 * z
        tile[2 * ROW + i] = a2 + a20 * x + a21 * y + a22 * z
        tile[3 * ROW + i] = b0 + b00 * u + b01 * v + b02 * w
        tile[4 * ROW + i] = b1 + b10 * u + b11 * v + b12 * w
        tile[5 * ROW + i] = b2 + b20 * u + b21 * v + b22 * w


def _subtract_terms(tile: Array, vector: int, many: int, terms: Array, scratch: int) -> None:
    """Solve x + Σ_p effect_p (K₂ u² + K₃ u³ + κ |u|) = linear, u = a_p·x, by two fixed-point steps in place, for the
    vector that begins at `vector`; at once where no sensor has such a term."""
    if terms.shape[0] == 0:
        return
    before = scratch + 3 * ROW
    _copy(tile, vector, scratch, many)
    for _ in range(2):
        _copy(tile, vector, before, many)
        _copy(tile, scratch, vector, many)
        for p in range(terms.shape[0]):
            _subtract_term(tile, vector, before, many, terms, p)


def _copy(tile: Array, source: int, target: int, many: int) -> None:
    """Copy a vector."""
    for row in range(3):
        for i in range(many):
            tile[target + row * ROW + i] = tile[source + row * ROW + i]


def _subtract_term(tile: Array, vector: int, before: int, many: int, terms: Array, p: int) -> None:
    """Take off the nonlinear term of one sensor, at the vector that begins at `before`."""
    a0, a1, a2 = terms[p, 0], terms[p, 1], terms[p, 2]
    square, cube, asymmetry = terms[p, 3], terms[p, 4], terms[p, 5]
    e0, e1, e2 = terms[p, 6], terms[p, 7], terms[p, 8]
    for i in range(many):
        u = a0 * tile[before + i] + a1 * tile[before + ROW + i] + a2 * tile[before + 2 * ROW + i]
        term = u * u * (square + cube * u) + asymmetry * abs(u)
        tile[vector + i] -= e0 * term
        tile[vector + ROW + i] -= e1 * term
        tile[vector + 2 * ROW + i] -= e2 * term


def _move(tile: Array, steps: int, lanes: int, delay: float, state: Array) -> None:
    """f ← f − τ ω̄×f + ½τ² ω̄×(ω̄×f), with ω̄ = ω − ½τ ω̇ the rate in the middle of the delay and ω̇ from the sample
    before. The number added to the time keeps 0/0 out of samples that take no time."""
    for step in range(steps):
        sample = LANES * step
        for i in range(lanes):
            o = sample + i
            x, y, z, dt = tile[o], tile[ROW + o], tile[2 * ROW + o], tile[6 * ROW + o]
            u, v, w = tile[3 * ROW + o], tile[4 * ROW + o], tile[5 * ROW + o]
            part = delay / (dt + state[(_RATE + 3) * LANES + i] + 1e-300)
            ax = delay * (x - part * (x - state[_RATE * LANES + i]))
            ay = delay * (y - part * (y - state[(_RATE + 1) * LANES + i]))
            az = delay * (z - part * (z - state[(_RATE + 2) * LANES + i]))
            bx, by, bz = ay * w - az * v, az * u - ax * w, ax * v - ay * u
            tile[3 * ROW + o] = u - bx + 0.5 * (ay * bz - az * by)
            tile[4 * ROW + o] = v - by + 0.5 * (az * bx - ax * bz)
            tile[5 * ROW + o] = w - bz + 0.5 * (ax * by - ay * bx)
            state[_RATE * LANES + i], state[(_RATE + 1) * LANES + i] = x, y
            state[(_RATE + 2) * LANES + i], state[(_RATE + 3) * LANES + i] = z, dt


def _subtract_force(tile: Array, many: int, G: Array) -> None:
    """ω ← ω − G f; at once where there is no G."""
    if G.shape[0] == 0:
        return
    g00, g01, g02 = G[0, 0], G[0, 1], G[0, 2]
    g10, g11, g12 = G[1, 0], G[1, 1], G[1, 2]
    g20, g21, g22 = G[2, 0], G[2, 1], G[2, 2]
    for i in range(many):
        u, v, w = tile[3 * ROW + i], tile[4 * ROW + i], tile[5 * ROW + i]
        tile[i] -= g00 * u + g01 * v + g02 * w
        tile[ROW + i] -= g10 * u + g11 * v + g12 * w
        tile[2 * ROW + i] -= g20 * u + g21 * v + g22 * w


# Regressors --------------------------------------------------------------------------------------------------


def _regress(tile: Array, steps: int, lanes: int, right: Array, state: Array) -> None:
    """1, ω, f, f_k f_l, ω_k ω_l (k ≤ l) times dt; and dt² |f − f'|² with f' of the sample before."""
    for step in range(steps):
        sample = LANES * step
        for i in range(lanes):
            o = sample + i
            x, y, z, dt = tile[o], tile[ROW + o], tile[2 * ROW + o], tile[6 * ROW + o]
            u, v, w = tile[3 * ROW + o], tile[4 * ROW + o], tile[5 * ROW + o]
            du, dv, dw = u - state[_FORCE * LANES + i], v - state[18 * LANES + i], w - state[19 * LANES + i]
            state[_FORCE * LANES + i], state[18 * LANES + i], state[19 * LANES + i] = u, v, w
            state[_JUMPS * LANES + i] += dt * dt * (du * du + dv * dv + dw * dw)
            xt, yt, zt, ut, vt, wt = x * dt, y * dt, z * dt, u * dt, v * dt, w * dt
            right[o] = dt
            right[ROW + o] = xt
            right[2 * ROW + o] = yt
            right[3 * ROW + o] = zt
            right[4 * ROW + o] = ut
            right[5 * ROW + o] = vt
            right[6 * ROW + o] = wt
            right[7 * ROW + o] = u * ut
            right[8 * ROW + o] = u * vt
            right[9 * ROW + o] = u * wt
            right[10 * ROW + o] = v * vt
            right[11 * ROW + o] = v * wt
            right[12 * ROW + o] = w * wt
            right[13 * ROW + o] = x * xt
            right[14 * ROW + o] = x * yt
            right[15 * ROW + o] = x * zt
            right[16 * ROW + o] = y * yt
            right[17 * ROW + o] = y * zt
            right[18 * ROW + o] = z * zt


def _regress_own(tile: Array, steps: int, gyros: Array, accels: Array, right: Array) -> None:
    """|a_p·ω| and then (a_p·ω)³ of the gyros, then |a_p·f| and then (a_p·f)³ of the accelerometers, times dt."""
    n, m = gyros.shape[0], accels.shape[0]
    for p in range(n):
        _regress_axis(tile, 0, steps * LANES, gyros, p, right, (COMMON + p) * ROW, (COMMON + n + p) * ROW)
    for p in range(m):
        to = COMMON + 2 * n + p
        _regress_axis(tile, 3 * ROW, steps * LANES, accels, p, right, to * ROW, (to + m) * ROW)


def _regress_axis(
    tile: Array, vector: int, many: int, axes: Array, p: int, right: Array, magnitude: int, cube: int
) -> None:
    """|a·x| dt and (a·x)³ dt, of the vector that begins at `vector`."""
    a0, a1, a2 = axes[p, 0], axes[p, 1], axes[p, 2]
    for i in range(many):
        u = a0 * tile[vector + i] + a1 * tile[vector + ROW + i] + a2 * tile[vector + 2 * ROW + i]
        dt = tile[6 * ROW + i]
        right[magnitude + i] = abs(u) * dt
        right[cube + i] = u * u * u * dt


# The step ----------------------------------------------------------------------------------------------------


def _turn(right: Array, steps: int, lanes: int, state: Array, left: Array) -> None:
    """Carry attitude and velocity of the lanes through the tile, docs/mathematics.md (6), with primes for the sample
    before:

        φ = Δθ + Δθ'×Δθ/12,   C ← C exp([φ×]),   C_m = C exp([φ×]/2)
        V += C_m (Δv + φ×(φ×Δv)/24 + (Δθ'×Δv + Δv'×Δθ)/12)

    and write C_m, row by row, and C_m e_j × (V + ½ΔV), likewise. The quaternions are those of
    `tumble.reduction.kernels._advance`."""
    for step in range(steps):
        sample = LANES * step
        for i in range(lanes):
            o = sample + i
            x, y, z = right[ROW + o], right[2 * ROW + o], right[3 * ROW + o]
            u, v, w = right[4 * ROW + o], right[5 * ROW + o], right[6 * ROW + o]
            px, py, pz = state[7 * LANES + i], state[8 * LANES + i], state[9 * LANES + i]
            pu, pv, pw = state[10 * LANES + i], state[11 * LANES + i], state[12 * LANES + i]
            state[7 * LANES + i], state[8 * LANES + i], state[9 * LANES + i] = x, y, z
            state[10 * LANES + i], state[11 * LANES + i], state[12 * LANES + i] = u, v, w

            fx = x + (py * z - pz * y) * (1.0 / 12.0)
            fy = y + (pz * x - px * z) * (1.0 / 12.0)
            fz = z + (px * y - py * x) * (1.0 / 12.0)
            bx, by, bz = fy * w - fz * v, fz * u - fx * w, fx * v - fy * u
            du = u + (fy * bz - fz * by) * (1.0 / 24.0) + (py * w - pz * v + pv * z - pw * y) * (1.0 / 12.0)
            dv = v + (fz * bx - fx * bz) * (1.0 / 24.0) + (pz * u - px * w + pw * x - pu * z) * (1.0 / 12.0)
            dw = w + (fx * by - fy * bx) * (1.0 / 24.0) + (px * v - py * u + pu * y - pv * x) * (1.0 / 12.0)

            h = (fx * fx + fy * fy + fz * fz) * (1.0 / 16.0)
            e0 = 1.0 - h * (1.0 / 2.0 - h * (1.0 / 24.0 - h * (1.0 / 720.0 - h * (1.0 / 40320.0))))
            s = 0.25 - h * (1.0 / 24.0 - h * (1.0 / 480.0 - h * (1.0 / 20160.0 - h * (1.0 / 1451520.0))))
            e1, e2, e3 = s * fx, s * fy, s * fz
            q0, q1, q2, q3 = state[i], state[LANES + i], state[2 * LANES + i], state[3 * LANES + i]
            m0 = q0 * e0 - q1 * e1 - q2 * e2 - q3 * e3
            m1 = q0 * e1 + q1 * e0 + q2 * e3 - q3 * e2
            m2 = q0 * e2 - q1 * e3 + q2 * e0 + q3 * e1
            m3 = q0 * e3 + q1 * e2 - q2 * e1 + q3 * e0
            state[i] = 2.0 * e0 * m0 - q0
            state[LANES + i] = 2.0 * e0 * m1 - q1
            state[2 * LANES + i] = 2.0 * e0 * m2 - q2
            state[3 * LANES + i] = 2.0 * e0 * m3 - q3

            d1, d2, d3 = m1 + m1, m2 + m2, m3 + m3
            c00, c01, c02 = 1.0 - (d2 * m2 + d3 * m3), d1 * m2 - d3 * m0, d1 * m3 + d2 * m0
            c10, c11, c12 = d1 * m2 + d3 * m0, 1.0 - (d1 * m1 + d3 * m3), d2 * m3 - d1 * m0
            c20, c21, c22 = d1 * m3 - d2 * m0, d2 * m3 + d1 * m0, 1.0 - (d1 * m1 + d2 * m2)
            gx, gy, gz = state[4 * LANES + i], state[5 * LANES + i], state[6 * LANES + i]
            ax = c00 * du + c01 * dv + c02 * dw
            ay = c10 * du + c11 * dv + c12 * dw
            az = c20 * du + c21 * dv + c22 * dw
            state[4 * LANES + i], state[5 * LANES + i], state[6 * LANES + i] = gx + ax, gy + ay, gz + az
            gx, gy, gz = gx + 0.5 * ax, gy + 0.5 * ay, gz + 0.5 * az

            left[o] = c00
            left[ROW + o] = c01
            left[2 * ROW + o] = c02
            left[3 * ROW + o] = c10
            left[4 * ROW + o] = c11
            left[5 * ROW + o] = c12
            left[6 * ROW + o] = c20
            left[7 * ROW + o] = c21
            left[8 * ROW + o] = c22
            left[9 * ROW + o] = c10 * gz - c20 * gy
            left[10 * ROW + o] = c11 * gz - c21 * gy
            left[11 * ROW + o] = c12 * gz - c22 * gy
            left[12 * ROW + o] = c20 * gx - c00 * gz
            left[13 * ROW + o] = c21 * gx - c01 * gz
            left[14 * ROW + o] = c22 * gx - c02 * gz
            left[15 * ROW + o] = c00 * gy - c10 * gx
            left[16 * ROW + o] = c01 * gy - c11 * gx
            left[17 * ROW + o] = c02 * gy - c12 * gx


def _turn_about(left: Array, right: Array, steps: int, swept: Array) -> None:
    """C_m [ω×] dt, row by row."""
    for axis in range(3):
        row = 3 * axis * ROW
        for i in range(steps * LANES):
            x, y, z = right[ROW + i], right[2 * ROW + i], right[3 * ROW + i]
            a, b, c = left[row + i], left[row + ROW + i], left[row + 2 * ROW + i]
            swept[row + i] = b * z - c * y
            swept[row + ROW + i] = c * x - a * z
            swept[row + 2 * ROW + i] = a * y - b * x


# Sums --------------------------------------------------------------------------------------------------------


def _add_all(
    left: Array, right: Array, swept: Array, tile: Array, steps: int, lanes: int, rows: int, linear: int, total: Array
) -> None:
    """Add the products of a tile to `total`: per regressor nine with C_m, per linear and own-axis regressor of the
    rate nine with C_m × V, per component of f nine with C_m [ω×] dt, and the regressors themselves."""
    groups = steps // GROUP
    for r in range(rows):
        _add_products(left, 0, right, r * ROW, groups, lanes, total, 9 * r * LANES)
    for r in range(linear):
        row = r if r < LINEAR else COMMON + r - LINEAR
        _add_products(left, 9 * ROW, right, row * ROW, groups, lanes, total, 9 * (rows + r) * LANES)
    for k in range(3):
        _add_products(swept, 0, tile, (3 + k) * ROW, groups, lanes, total, 9 * (rows + linear + k) * LANES)
    for r in range(rows):
        _add_row(right, r * ROW, groups, lanes, total, (9 * (rows + linear + 3) + r) * LANES)


def _add_products(
    left: Array, first: int, right: Array, factor: int, groups: int, lanes: int, total: Array, to: int
) -> None:
    """Products of nine rows, which begin at `first`, with the one that begins at `factor`; three rows together, and
    GROUP samples of every lane before a sum is written back."""
    for group in range(groups):
        sample = GROUP * LANES * group
        for three in range(3):
            for i in range(lanes):
                o = factor + sample + i
                a, b, c, d = right[o], right[LANES + o], right[2 * LANES + o], right[3 * LANES + o]
                e, f, g, h = right[4 * LANES + o], right[5 * LANES + o], right[6 * LANES + o], right[7 * LANES + o]
                p, at = first + 3 * three * ROW + sample + i, to + 3 * three * LANES + i
                q, r = p + ROW, p + 2 * ROW
                s = total[at] + a * left[p]
                s = ((s + b * left[LANES + p]) + c * left[2 * LANES + p]) + d * left[3 * LANES + p]
                s = ((s + e * left[4 * LANES + p]) + f * left[5 * LANES + p]) + g * left[6 * LANES + p]
                t = total[LANES + at] + a * left[q]
                t = ((t + b * left[LANES + q]) + c * left[2 * LANES + q]) + d * left[3 * LANES + q]
                t = ((t + e * left[4 * LANES + q]) + f * left[5 * LANES + q]) + g * left[6 * LANES + q]
                u = total[2 * LANES + at] + a * left[r]
                u = ((u + b * left[LANES + r]) + c * left[2 * LANES + r]) + d * left[3 * LANES + r]
                u = ((u + e * left[4 * LANES + r]) + f * left[5 * LANES + r]) + g * left[6 * LANES + r]
                total[at] = s + h * left[7 * LANES + p]
                total[LANES + at] = t + h * left[7 * LANES + q]
                total[2 * LANES + at] = u + h * left[7 * LANES + r]


def _add_row(right: Array, row: int, groups: int, lanes: int, total: Array, to: int) -> None:
    """Sums of one row, GROUP samples of every lane before a sum is written back."""
    for group in range(groups):
        sample = row + GROUP * LANES * group
        for i in range(lanes):
            o = sample + i
            first = (right[o] + right[LANES + o]) + (right[2 * LANES + o] + right[3 * LANES + o])
            last = (right[4 * LANES + o] + right[5 * LANES + o]) + (right[6 * LANES + o] + right[7 * LANES + o])
            total[to + i] += first + last


def _join(
    k: int,
    lane: int,
    state: Array,
    total: Array,
    C: Array,
    attitude: Array,
    V: Array,
    products: Array,
    moved: Array,
    swept: Array,
    regressors: Array,
    jumps: Array,
) -> None:
    """Append the stretch of a lane to piece k. With C and V of the piece so far and the stretch marked 2:
    ΔΦ = C ΔΦ₂, ΔΦ × V = C ΔΦ₂ × V + C (ΔΦ₂ × V₂), V += C V₂, C ← C C₂ (as quaternions, of unit length again)."""
    rows, linear = products.shape[1], moved.shape[1]
    _matrix_of(attitude, k, C)
    for r in range(rows):
        if r < LINEAR or COMMON <= r < COMMON + linear - LINEAR:
            at = r if r < LINEAR else r - COMMON + LINEAR
            _add_crossed(C, total, 9 * r * LANES + lane, V, moved, k, at)
            _add_rotated(C, total, 9 * (rows + at) * LANES + lane, moved, k, at)
        _add_rotated(C, total, 9 * r * LANES + lane, products, k, r)
        regressors[k, r] += total[(9 * (rows + linear + 3) + r) * LANES + lane]
    for r in range(3):
        _add_rotated(C, total, 9 * (rows + linear + r) * LANES + lane, swept, k, r)
    for i in range(3):
        for j in range(3):
            V[k, i] += C[i, j] * state[(_V + j) * LANES + lane]
    jumps[k] += state[_JUMPS * LANES + lane]
    _append_attitude(attitude, k, state, lane)


def _add_rotated(C: Array, total: Array, at: int, out: Array, k: int, r: int) -> None:
    """Add C times a matrix that lies in every LANES-th number from `at`, row by row."""
    for j in range(3):
        a, b, c = total[at + j * LANES], total[at + (3 + j) * LANES], total[at + (6 + j) * LANES]
        for i in range(3):
            out[k, r, 3 * i + j] += C[i, 0] * a + C[i, 1] * b + C[i, 2] * c


def _add_crossed(C: Array, total: Array, at: int, V: Array, out: Array, k: int, r: int) -> None:
    """Add the cross products of the columns of C times a matrix, which lies in every LANES-th number from `at`, with
    V."""
    for j in range(3):
        a, b, c = total[at + j * LANES], total[at + (3 + j) * LANES], total[at + (6 + j) * LANES]
        x = C[0, 0] * a + C[0, 1] * b + C[0, 2] * c
        y = C[1, 0] * a + C[1, 1] * b + C[1, 2] * c
        z = C[2, 0] * a + C[2, 1] * b + C[2, 2] * c
        out[k, r, j] += y * V[k, 2] - z * V[k, 1]
        out[k, r, 3 + j] += z * V[k, 0] - x * V[k, 2]
        out[k, r, 6 + j] += x * V[k, 1] - y * V[k, 0]


def _append_attitude(attitude: Array, k: int, state: Array, lane: int) -> None:
    """a ← a b, with b the attitude of the lane."""
    a0, a1, a2, a3 = attitude[k, 0], attitude[k, 1], attitude[k, 2], attitude[k, 3]
    b0, b1, b2, b3 = state[lane], state[LANES + lane], state[2 * LANES + lane], state[3 * LANES + lane]
    q0 = a0 * b0 - a1 * b1 - a2 * b2 - a3 * b3
    q1 = a0 * b1 + a1 * b0 + a2 * b3 - a3 * b2
    q2 = a0 * b2 - a1 * b3 + a2 * b0 + a3 * b1
    q3 = a0 * b3 + a1 * b2 - a2 * b1 + a3 * b0
    length = sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
    attitude[k, 0], attitude[k, 1], attitude[k, 2], attitude[k, 3] = q0 / length, q1 / length, q2 / length, q3 / length


def finish(sums: Sums, C: Array) -> None:
    """Write the matrices of the attitudes to C (K, 3, 3), and Ψ = Φ × V − Σ ΔΦ × V over the latter."""
    attitude, V, products, moved, _, _, _ = sums
    _finish(attitude, V, products, moved, C)


def _finish(attitude: Array, V: Array, products: Array, moved: Array, C: Array) -> None:
    """The same without tuples."""
    for k in range(attitude.shape[0]):
        _matrix_of(attitude, k, C[k])
        for r in range(moved.shape[1]):
            of = r if r < LINEAR else COMMON + r - LINEAR
            for j in range(3):
                x, y, z = products[k, of, j], products[k, of, 3 + j], products[k, of, 6 + j]
                moved[k, r, j] = y * V[k, 2] - z * V[k, 1] - moved[k, r, j]
                moved[k, r, 3 + j] = z * V[k, 0] - x * V[k, 2] - moved[k, r, 3 + j]
                moved[k, r, 6 + j] = x * V[k, 1] - y * V[k, 0] - moved[k, r, 6 + j]


def _matrix_of(attitude: Array, k: int, C: Array) -> None:
    """Write the matrix of a unit quaternion, scalar first, to C (3, 3)."""
    q0, q1, q2, q3 = attitude[k, 0], attitude[k, 1], attitude[k, 2], attitude[k, 3]
    C[0, 0] = 1.0 - 2.0 * (q2 * q2 + q3 * q3)
    C[0, 1] = 2.0 * (q1 * q2 - q3 * q0)
    C[0, 2] = 2.0 * (q1 * q3 + q2 * q0)
    C[1, 0] = 2.0 * (q1 * q2 + q3 * q0)
    C[1, 1] = 1.0 - 2.0 * (q1 * q1 + q3 * q3)
    C[1, 2] = 2.0 * (q2 * q3 - q1 * q0)
    C[2, 0] = 2.0 * (q1 * q3 - q2 * q0)
    C[2, 1] = 2.0 * (q2 * q3 + q1 * q0)
    C[2, 2] = 1.0 - 2.0 * (q1 * q1 + q2 * q2)
