# cython: language_level=3, infer_types=True, boundscheck=False, wraparound=False, initializedcheck=False, cdivision=True
"""The compiled loops over the samples of turns: sums of which `tumble.reduction.turns.moments` makes their moments.

All moments are outer products of nine numbers of the attitude with regressors of a sample, Ψ included: by summation in
parts, exact for the discrete sums too,

    Ψ_jb = Σ (Φ + ½ΔΦ)_jb × ΔV = Φ_jb(T) × V(T) − Σ ΔΦ_jb × (V + ½ΔV),      ΔΦ_jb = C_m e_j β_b dt.

GROUP samples of a turn at a time go through loops of which each does one thing to all of them: only attitude and
velocity follow from sample to sample, and every other loop the compiler turns into vector instructions. The samples
stand side by side in `rows`, a row for each quantity, from column HEAD on, after the two samples before them; which is
where vectors are aligned. The length of a row is a constant, so that the compiler sees that the steps of a loop over
`i` do not depend on one another. Sums over samples may be taken in another order, and products and sums be rounded
once (setup.py).
"""

import numpy as np

from libc.stdint cimport int64_t

from tumble.processors cimport for_each_processor

cpdef enum:
    LINEAR = 7  # regressors 1, ω (3), f (3)
    GROUP = 200
    HEAD = 8
    BLOCK = 4  # numbers of regressors are multiples of it

cdef enum:  # first rows of the quantities
    _RATE = 0  # ω (3)
    _FORCE = 3  # f (3), and a row that pads it to BLOCK
    _DT = 7
    _LATE = 8  # ω with which the force is moved (3)
    _STEP = 11  # quaternions of half a step, and then of the attitude in its middle (4)
    _BEFORE = 15  # of the attitude before it (4)
    _MOVE = 19  # what the velocity moves by, and then the velocity in the middle (3)
    _LEFT = 22  # C_m by rows (9)
    _MOVED = 31  # C_m × (V + ½ΔV) by columns (9)
    _SWEPT = 40  # C_m [ω×] dt by rows (9)
    _WORK = 49  # of the fixed-point steps (6)
    _RIGHT = 55  # regressors
    _LENGTH = 208  # HEAD + GROUP

ctypedef double Row[_LENGTH]


def integrate_pieces(samples, pieces, model, own_axes, sums):
    """Carry the sums of turns on over pieces of them; the types are in moment_kernels.pyi.

    Parameters
    ----------
    samples : rates (S, 3) rad/s, forces (S, 3) m/s² and intervals (S,) s.
    pieces : number of the turn, first sample and end of each piece.
    model : compensation of the gyros and of the accelerometers, what the rate reads of the force, and the delay.
    own_axes : axes of the gyros (n, 3) and accelerometers (m, 3) whose regressors |a·x|, and then (a·x)³, are wanted.
    sums : arrays that the sums are added to; before the first piece attitudes are 1 and all else zero.
    """
    (gyro, gyro_terms), (accel, accel_terms), G, delay = model
    height = _RIGHT + sums[3].shape[2]
    flat = np.zeros(height * _LENGTH + 8)
    aligned = -(flat.ctypes.data // 8) % 8
    rows = flat[aligned : aligned + height * _LENGTH].reshape(height, _LENGTH)
    _integrate(*samples, *pieces, gyro, gyro_terms, accel, accel_terms, G, delay, *own_axes, *sums, rows)


def _integrate(
    const double[:, ::1] rates, const double[:, ::1] forces, const double[:] intervals, const int64_t[:] piece,
    const int64_t[:] start, const int64_t[:] stop, const double[:, ::1] gyro, const double[:, ::1] gyro_terms,
    const double[:, ::1] accel, const double[:, ::1] accel_terms, const double[:, ::1] G, double delay,
    const double[:, ::1] gyros, const double[:, ::1] accels, double[:, ::1] attitude, double[:, ::1] V,
    double[:, ::1] P, double[:, :, ::1] products, double[:, :, ::1] moved, double[:, :, ::1] swept, double[::1] jumps,
    double[:, ::1] memory,
):
    """The same without tuples; `memory` is that of the rows."""
    with nogil:
        _integrate_all(
            rates, forces, intervals, piece, start, stop, gyro, gyro_terms, accel, accel_terms, G, delay, gyros, accels,
            attitude, V, P, products, moved, swept, jumps, <Row*> &memory[0, 0],
        )


cdef for_each_processor _integrate_all(
    const double[:, ::1] rates, const double[:, ::1] forces, const double[:] intervals, const int64_t[:] piece,
    const int64_t[:] start, const int64_t[:] stop, const double[:, ::1] gyro, const double[:, ::1] gyro_terms,
    const double[:, ::1] accel, const double[:, ::1] accel_terms, const double[:, ::1] G, double delay,
    const double[:, ::1] gyros, const double[:, ::1] accels, double[:, ::1] attitude, double[:, ::1] V,
    double[:, ::1] P, double[:, :, ::1] products, double[:, :, ::1] moved, double[:, :, ::1] swept, double[::1] jumps,
    Row* rows,
) noexcept nogil:
    """Piece by piece, and within each GROUP by GROUP."""
    cdef Py_ssize_t k, groups, first, count
    cdef double total
    for place in range(piece.shape[0]):
        k, groups = piece[place], (stop[place] - start[place] + GROUP - 1) // GROUP
        for group in range(groups):
            first = start[place] + (stop[place] - start[place]) * group // groups
            count = start[place] + (stop[place] - start[place]) * (group + 1) // groups - first
            _gather(rates, forces, intervals, gyro, accel, first - 2, count + 2, rows)
            _subtract_terms(accel_terms, _FORCE, count + 2, rows)
            if delay != 0.0:
                _subtract_force(G, count + 2, rows)
                _subtract_terms(gyro_terms, _RATE, count + 2, rows)
                _move_force(delay, count + 1, rows)
            _subtract_force(G, count + 2, rows)
            _subtract_terms(gyro_terms, _RATE, count + 2, rows)
            jumps[k] += _regress(gyros, accels, count, rows)
            _step(count, rows)
            _follow(attitude, V, P, k, count, rows)
            _multiply(count, rows)
            _add_products(_LEFT, _RIGHT, products.shape[2], count, rows, products, k)
            _add_products(_MOVED, _RIGHT, moved.shape[2], count, rows, moved, k)
            _add_products(_SWEPT, _FORCE, BLOCK, count, rows, swept, k)
            for b in range(products.shape[2]):
                total = 0.0
                for i in range(count):
                    total += rows[_RIGHT + b][HEAD + i]
                products[k, 9, b] += total


# Compensation: force; with a delay the rate by it, and the force moved with that rate; rate -----------------------


cdef void _gather(
    const double[:, ::1] rates, const double[:, ::1] forces, const double[:] intervals, const double[:, ::1] gyro,
    const double[:, ::1] accel, Py_ssize_t first, Py_ssize_t count, Row* rows,
) noexcept nogil:
    """Put so many samples side by side, by the linear models; those before the first of all are the first, over no
    time."""
    cdef Py_ssize_t skipped = max(-first, 0)
    for cell in range(HEAD - 2, HEAD - 2 + skipped):
        _put(&rates[0, 0], gyro, cell, 1, _LATE, rows)
        _put(&forces[0, 0], accel, cell, 1, _FORCE, rows)
        rows[_DT][cell] = 0.0
    first, count = first + skipped, count - skipped
    skipped += HEAD - 2
    _put(&rates[first, 0], gyro, skipped, count, _LATE, rows)
    _put(&forces[first, 0], accel, skipped, count, _FORCE, rows)
    for i in range(count):
        rows[_DT][skipped + i] = intervals[first + i]


cdef void _put(
    const double* vectors, const double[:, ::1] A, Py_ssize_t cell, Py_ssize_t count, Py_ssize_t to, Row* rows,
) noexcept nogil:
    """A (3, 4) times so many vectors (count, 3) and 1."""
    cdef double x, y, z
    cdef double xx = A[0, 0], xy = A[0, 1], xz = A[0, 2], x1 = A[0, 3]
    cdef double yx = A[1, 0], yy = A[1, 1], yz = A[1, 2], y1 = A[1, 3]
    cdef double zx = A[2, 0], zy = A[2, 1], zz = A[2, 2], z1 = A[2, 3]
    for i in range(count):
        x, y, z = vectors[3 * i], vectors[3 * i + 1], vectors[3 * i + 2]
        rows[to][cell + i] = x1 + xx * x + xy * y + xz * z
        rows[to + 1][cell + i] = y1 + yx * x + yy * y + yz * z
        rows[to + 2][cell + i] = z1 + zx * x + zy * y + zz * z


cdef void _subtract_force(const double[:, ::1] G, Py_ssize_t count, Row* rows) noexcept nogil:
    """The rate less what it reads of the force, G f."""
    cdef double gx, gy, gz
    for c in range(3):
        gx, gy, gz = G[c, 0], G[c, 1], G[c, 2]
        for i in range(HEAD - 2, HEAD - 2 + count):
            rows[_RATE + c][i] = rows[_LATE + c][i] - (
                gx * rows[_FORCE][i] + gy * rows[_FORCE + 1][i] + gz * rows[_FORCE + 2][i]
            )


cdef void _subtract_terms(
    const double[:, ::1] terms, Py_ssize_t first, Py_ssize_t count, Row* rows,
) noexcept nogil:
    """Solve x + Σ_p effect_p (K₂ u² + K₃ u³ + κ |u|) = linear, u = a_p·x, by two fixed-point steps in place; x is in
    three rows from the `first` on."""
    cdef double x, y, z, square, cube, size, effect_x, effect_y, effect_z, u, term
    if terms.shape[0] == 0:
        return
    for c in range(3):
        for i in range(count):
            rows[_WORK + c][HEAD - 2 + i] = rows[first + c][HEAD - 2 + i]
    for _ in range(2):
        for c in range(3):
            for i in range(count):
                rows[_WORK + 3 + c][HEAD - 2 + i] = rows[first + c][HEAD - 2 + i]
            for i in range(count):
                rows[first + c][HEAD - 2 + i] = rows[_WORK + c][HEAD - 2 + i]
        for p in range(terms.shape[0]):
            x, y, z = terms[p, 0], terms[p, 1], terms[p, 2]
            square, cube, size = terms[p, 3], terms[p, 4], terms[p, 5]
            effect_x, effect_y, effect_z = terms[p, 6], terms[p, 7], terms[p, 8]
            for i in range(count):
                u = x * rows[_WORK + 3][HEAD - 2 + i] + y * rows[_WORK + 4][HEAD - 2 + i]
                u += z * rows[_WORK + 5][HEAD - 2 + i]
                term = u * u * (square + cube * u) + size * abs(u)
                rows[first][HEAD - 2 + i] -= effect_x * term
                rows[first + 1][HEAD - 2 + i] -= effect_y * term
                rows[first + 2][HEAD - 2 + i] -= effect_z * term


cdef void _move_force(double delay, Py_ssize_t count, Row* rows) noexcept nogil:
    """f − τ ω̄×f + ½τ² ω̄×(ω̄×f), with ω̄ = ω − ½τ ω̇ the rate in the middle of the delay and ω̇ from the sample before, of
    all samples but the first; the number added keeps 0/0 out of samples that take no time."""
    cdef double x, y, z, u, v, w, part, ax, ay, az, bx, by, bz
    for i in range(count):
        x, y, z = rows[_RATE][HEAD - 1 + i], rows[_RATE + 1][HEAD - 1 + i], rows[_RATE + 2][HEAD - 1 + i]
        u, v, w = rows[_FORCE][HEAD - 1 + i], rows[_FORCE + 1][HEAD - 1 + i], rows[_FORCE + 2][HEAD - 1 + i]
        part = delay / (rows[_DT][HEAD - 1 + i] + rows[_DT][HEAD - 2 + i] + 1e-300)
        ax = delay * (x - part * (x - rows[_RATE][HEAD - 2 + i]))
        ay = delay * (y - part * (y - rows[_RATE + 1][HEAD - 2 + i]))
        az = delay * (z - part * (z - rows[_RATE + 2][HEAD - 2 + i]))
        bx, by, bz = ay * w - az * v, az * u - ax * w, ax * v - ay * u
        rows[_FORCE][HEAD - 1 + i] = u + 0.5 * (ay * bz - az * by) - bx
        rows[_FORCE + 1][HEAD - 1 + i] = v + 0.5 * (az * bx - ax * bz) - by
        rows[_FORCE + 2][HEAD - 1 + i] = w + 0.5 * (ax * by - ay * bx) - bz


# Regressors, attitude and velocity --------------------------------------------------------------------------------


cdef double _regress(
    const double[:, ::1] gyros, const double[:, ::1] accels, Py_ssize_t count, Row* rows,
) noexcept nogil:
    """Write the regressors, and return Σ Δt² |f − f'|²."""
    cdef double x, y, z, u, v, w, dt, a, b, c, along, jumps
    cdef Py_ssize_t p
    jumps, n, m = 0.0, gyros.shape[0], accels.shape[0]
    squares = _RIGHT + LINEAR + 2 * n
    for i in range(count):
        x, y, z, dt = rows[_RATE][HEAD + i], rows[_RATE + 1][HEAD + i], rows[_RATE + 2][HEAD + i], rows[_DT][HEAD + i]
        u, v, w = rows[_FORCE][HEAD + i], rows[_FORCE + 1][HEAD + i], rows[_FORCE + 2][HEAD + i]
        a, b, c = u - rows[_FORCE][HEAD + i - 1], v - rows[_FORCE + 1][HEAD + i - 1], w - rows[_FORCE + 2][HEAD + i - 1]
        jumps += dt * dt * (a * a + b * b + c * c)
        rows[_RIGHT][HEAD + i] = dt
        a, b, c = x * dt, y * dt, z * dt
        rows[_RIGHT + 1][HEAD + i], rows[_RIGHT + 2][HEAD + i], rows[_RIGHT + 3][HEAD + i] = a, b, c
        rows[squares + 6][HEAD + i], rows[squares + 7][HEAD + i], rows[squares + 8][HEAD + i] = a * x, a * y, a * z
        rows[squares + 9][HEAD + i], rows[squares + 10][HEAD + i], rows[squares + 11][HEAD + i] = b * y, b * z, c * z
        a, b, c = u * dt, v * dt, w * dt
        rows[_RIGHT + 4][HEAD + i], rows[_RIGHT + 5][HEAD + i], rows[_RIGHT + 6][HEAD + i] = a, b, c
        rows[squares][HEAD + i], rows[squares + 1][HEAD + i], rows[squares + 2][HEAD + i] = a * u, a * v, a * w
        rows[squares + 3][HEAD + i], rows[squares + 4][HEAD + i], rows[squares + 5][HEAD + i] = b * v, b * w, c * w
    for p in range(n):
        x, y, z = gyros[p, 0], gyros[p, 1], gyros[p, 2]
        for i in range(count):
            along = x * rows[_RATE][HEAD + i] + y * rows[_RATE + 1][HEAD + i] + z * rows[_RATE + 2][HEAD + i]
            rows[_RIGHT + LINEAR + p][HEAD + i] = abs(along) * rows[_DT][HEAD + i]
            rows[_RIGHT + LINEAR + n + p][HEAD + i] = along * along * along * rows[_DT][HEAD + i]
    for p in range(m):
        x, y, z = accels[p, 0], accels[p, 1], accels[p, 2]
        for i in range(count):
            along = x * rows[_FORCE][HEAD + i] + y * rows[_FORCE + 1][HEAD + i] + z * rows[_FORCE + 2][HEAD + i]
            rows[squares + 12 + p][HEAD + i] = abs(along) * rows[_DT][HEAD + i]
            rows[squares + 12 + m + p][HEAD + i] = along * along * along * rows[_DT][HEAD + i]
    return jumps


cdef void _step(Py_ssize_t count, Row* rows) noexcept nogil:
    """With primes for the sample before, docs/explanation/mathematics.md (6), the quaternions exp([φ×]/4) and the moves

    φ = Δθ + Δθ'×Δθ/12,   Δv + φ×(φ×Δv)/24 + (Δθ'×Δv + Δv'×Δθ)/12"""
    cdef double x, y, z, u, v, w, px, py, pz, pu, pv, pw, fx, fy, fz, bx, by, bz, h, e, dt, before
    for i in range(count):
        dt, before = rows[_DT][HEAD + i], rows[_DT][HEAD + i - 1]
        x, y, z = rows[_RIGHT + 1][HEAD + i], rows[_RIGHT + 2][HEAD + i], rows[_RIGHT + 3][HEAD + i]
        u, v, w = rows[_FORCE][HEAD + i] * dt, rows[_FORCE + 1][HEAD + i] * dt, rows[_FORCE + 2][HEAD + i] * dt
        px, py, pz = (
            rows[_RATE][HEAD + i - 1] * before,
            rows[_RATE + 1][HEAD + i - 1] * before,
            rows[_RATE + 2][HEAD + i - 1] * before,
        )
        pu, pv, pw = (
            rows[_FORCE][HEAD + i - 1] * before,
            rows[_FORCE + 1][HEAD + i - 1] * before,
            rows[_FORCE + 2][HEAD + i - 1] * before,
        )
        fx = x + (py * z - pz * y) * (1.0 / 12.0)
        fy = y + (pz * x - px * z) * (1.0 / 12.0)
        fz = z + (px * y - py * x) * (1.0 / 12.0)
        bx, by, bz = fy * w - fz * v, fz * u - fx * w, fx * v - fy * u
        rows[_MOVE][HEAD + i] = (
            u + (fy * bz - fz * by) * (1.0 / 24.0) + (py * w - pz * v + pv * z - pw * y) * (1.0 / 12.0)
        )
        rows[_MOVE + 1][HEAD + i] = (
            v + (fz * bx - fx * bz) * (1.0 / 24.0) + (pz * u - px * w + pw * x - pu * z) * (1.0 / 12.0)
        )
        rows[_MOVE + 2][HEAD + i] = (
            w + (fx * by - fy * bx) * (1.0 / 24.0) + (px * v - py * u + pu * y - pv * x) * (1.0 / 12.0)
        )
        h = (fx * fx + fy * fy + fz * fz) * (1.0 / 16.0)
        e = 0.25 - h * (1.0 / 24.0 - h * (1.0 / 480.0 - h * (1.0 / 20160.0 - h * (1.0 / 1451520.0))))
        rows[_STEP][HEAD + i] = 1.0 - h * (1.0 / 2.0 - h * (1.0 / 24.0 - h * (1.0 / 720.0 - h * (1.0 / 40320.0))))
        rows[_STEP + 1][HEAD + i], rows[_STEP + 2][HEAD + i], rows[_STEP + 3][HEAD + i] = e * fx, e * fy, e * fz


cdef void _follow(
    double[:, ::1] attitude, double[:, ::1] V, double[:, ::1] P, Py_ssize_t k, Py_ssize_t count, Row* rows,
) noexcept nogil:
    """From sample to sample C ← C exp([φ×]) with C_m = C exp([φ×]/2), by quaternions, V += C_m times the move, of which
    the middle V + ½ΔV is kept, and P += (V + ½ΔV) dt."""
    cdef double q0, q1, q2, q3, m0, m1, m2, m3, d1, d2, d3, e0, e1, e2, e3, u, v, w, x, y, z, unit
    q0, q1, q2, q3 = attitude[k, 0], attitude[k, 1], attitude[k, 2], attitude[k, 3]
    for cell in range(HEAD, HEAD + count):
        e0, e1, e2, e3 = rows[_STEP][cell], rows[_STEP + 1][cell], rows[_STEP + 2][cell], rows[_STEP + 3][cell]
        rows[_BEFORE][cell], rows[_BEFORE + 1][cell] = q0, q1
        rows[_BEFORE + 2][cell], rows[_BEFORE + 3][cell] = q2, q3
        e0, e1, e2, e3 = 2.0 * e0 * e0 - 1.0, 2.0 * e0 * e1, 2.0 * e0 * e2, 2.0 * e0 * e3
        q0, q1, q2, q3 = (
            q0 * e0 - q1 * e1 - q2 * e2 - q3 * e3,
            q0 * e1 + q1 * e0 + q2 * e3 - q3 * e2,
            q0 * e2 - q1 * e3 + q2 * e0 + q3 * e1,
            q0 * e3 + q1 * e2 - q2 * e1 + q3 * e0,
        )
    unit = 1.5 - 0.5 * (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)  # of length 1 again
    attitude[k, 0], attitude[k, 1], attitude[k, 2], attitude[k, 3] = q0 * unit, q1 * unit, q2 * unit, q3 * unit
    for i in range(count):
        e0, e1 = rows[_STEP][HEAD + i], rows[_STEP + 1][HEAD + i]
        e2, e3 = rows[_STEP + 2][HEAD + i], rows[_STEP + 3][HEAD + i]
        q0, q1 = rows[_BEFORE][HEAD + i], rows[_BEFORE + 1][HEAD + i]
        q2, q3 = rows[_BEFORE + 2][HEAD + i], rows[_BEFORE + 3][HEAD + i]
        m0 = q0 * e0 - q1 * e1 - q2 * e2 - q3 * e3
        m1 = q0 * e1 + q1 * e0 + q2 * e3 - q3 * e2
        m2 = q0 * e2 - q1 * e3 + q2 * e0 + q3 * e1
        m3 = q0 * e3 + q1 * e2 - q2 * e1 + q3 * e0
        u, v, w = rows[_MOVE][HEAD + i], rows[_MOVE + 1][HEAD + i], rows[_MOVE + 2][HEAD + i]
        d1, d2, d3 = m1 + m1, m2 + m2, m3 + m3
        rows[_LEFT][HEAD + i] = 1.0 - (d2 * m2 + d3 * m3)
        rows[_LEFT + 1][HEAD + i], rows[_LEFT + 2][HEAD + i] = d1 * m2 - d3 * m0, d1 * m3 + d2 * m0
        rows[_LEFT + 3][HEAD + i], rows[_LEFT + 4][HEAD + i] = d1 * m2 + d3 * m0, 1.0 - (d1 * m1 + d3 * m3)
        rows[_LEFT + 5][HEAD + i], rows[_LEFT + 6][HEAD + i] = d2 * m3 - d1 * m0, d1 * m3 - d2 * m0
        rows[_LEFT + 7][HEAD + i], rows[_LEFT + 8][HEAD + i] = d2 * m3 + d1 * m0, 1.0 - (d1 * m1 + d2 * m2)
        rows[_MOVE][HEAD + i] = (
            rows[_LEFT][HEAD + i] * u + rows[_LEFT + 1][HEAD + i] * v + rows[_LEFT + 2][HEAD + i] * w
        )
        rows[_MOVE + 1][HEAD + i] = (
            rows[_LEFT + 3][HEAD + i] * u + rows[_LEFT + 4][HEAD + i] * v + rows[_LEFT + 5][HEAD + i] * w
        )
        rows[_MOVE + 2][HEAD + i] = (
            rows[_LEFT + 6][HEAD + i] * u + rows[_LEFT + 7][HEAD + i] * v + rows[_LEFT + 8][HEAD + i] * w
        )
    u, v, w = V[k, 0], V[k, 1], V[k, 2]
    for cell in range(HEAD, HEAD + count):
        q1, q2, q3 = rows[_MOVE][cell], rows[_MOVE + 1][cell], rows[_MOVE + 2][cell]
        rows[_MOVE][cell], rows[_MOVE + 1][cell], rows[_MOVE + 2][cell] = u + 0.5 * q1, v + 0.5 * q2, w + 0.5 * q3
        u, v, w = u + q1, v + q2, w + q3
    V[k, 0], V[k, 1], V[k, 2] = u, v, w
    x, y, z = 0.0, 0.0, 0.0
    for i in range(count):
        e0 = rows[_DT][HEAD + i]
        x += rows[_MOVE][HEAD + i] * e0
        y += rows[_MOVE + 1][HEAD + i] * e0
        z += rows[_MOVE + 2][HEAD + i] * e0
    P[k, 0], P[k, 1], P[k, 2] = P[k, 0] + x, P[k, 1] + y, P[k, 2] + z


# Products ---------------------------------------------------------------------------------------------------------


cdef void _multiply(Py_ssize_t count, Row* rows) noexcept nogil:
    """Columns of C_m × (V + ½ΔV), and rows of C_m [ω×] dt."""
    cdef double a, b, c, x, y, z, bx, by, bz
    for j in range(3):
        for i in range(count):
            a, b, c = rows[_LEFT + j][HEAD + i], rows[_LEFT + 3 + j][HEAD + i], rows[_LEFT + 6 + j][HEAD + i]
            bx, by, bz = rows[_MOVE][HEAD + i], rows[_MOVE + 1][HEAD + i], rows[_MOVE + 2][HEAD + i]
            rows[_MOVED + j][HEAD + i], rows[_MOVED + 3 + j][HEAD + i] = b * bz - c * by, c * bx - a * bz
            rows[_MOVED + 6 + j][HEAD + i] = a * by - b * bx
        for i in range(count):
            a, b, c = (
                rows[_LEFT + 3 * j][HEAD + i],
                rows[_LEFT + 3 * j + 1][HEAD + i],
                rows[_LEFT + 3 * j + 2][HEAD + i],
            )
            x, y, z = rows[_RIGHT + 1][HEAD + i], rows[_RIGHT + 2][HEAD + i], rows[_RIGHT + 3][HEAD + i]
            rows[_SWEPT + 3 * j][HEAD + i], rows[_SWEPT + 3 * j + 1][HEAD + i] = b * z - c * y, c * x - a * z
            rows[_SWEPT + 3 * j + 2][HEAD + i] = a * y - b * x


cdef void _add_products(
    Py_ssize_t of, Py_ssize_t by, Py_ssize_t many, Py_ssize_t count, Row* rows, double[:, :, ::1] sums, Py_ssize_t k,
) noexcept nogil:
    """Add to nine rows of sums the products of nine rows with so many others, three with BLOCK at a time: so many sums
    are at hand in a processor."""
    cdef double a, b, c, u, v, w, x, a0, a1, a2, a3, b0, b1, b2, b3, c0, c1, c2, c3
    cdef Py_ssize_t left, right
    for row in range(3):
        for block in range(many // BLOCK):
            left, right = of + 3 * row, by + BLOCK * block
            a0, a1, a2, a3, b0, b1, b2, b3, c0, c1, c2, c3 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(count):
                a, b, c = rows[left][HEAD + i], rows[left + 1][HEAD + i], rows[left + 2][HEAD + i]
                u, v, w, x = (
                    rows[right][HEAD + i],
                    rows[right + 1][HEAD + i],
                    rows[right + 2][HEAD + i],
                    rows[right + 3][HEAD + i],
                )
                a0 += a * u
                a1 += a * v
                a2 += a * w
                a3 += a * x
                b0 += b * u
                b1 += b * v
                b2 += b * w
                b3 += b * x
                c0 += c * u
                c1 += c * v
                c2 += c * w
                c3 += c * x
            left, right = 3 * row, BLOCK * block
            sums[k, left, right] += a0
            sums[k, left, right + 1] += a1
            sums[k, left, right + 2] += a2
            sums[k, left, right + 3] += a3
            sums[k, left + 1, right] += b0
            sums[k, left + 1, right + 1] += b1
            sums[k, left + 1, right + 2] += b2
            sums[k, left + 1, right + 3] += b3
            sums[k, left + 2, right] += c0
            sums[k, left + 2, right + 1] += c1
            sums[k, left + 2, right + 2] += c2
            sums[k, left + 2, right + 3] += c3
