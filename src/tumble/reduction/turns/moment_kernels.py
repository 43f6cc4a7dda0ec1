"""The compiled loops over the samples of turns: sums of which `tumble.reduction.turns.moments` makes their moments.

All moments are outer products of nine numbers of the attitude with regressors of a sample, Ψ included: by summation in
parts, exact for the discrete sums too,

    Ψ_jb = Σ (Φ + ½ΔΦ)_jb × ΔV = Φ_jb(T) × V(T) − Σ ΔΦ_jb × (V + ½ΔV),      ΔΦ_jb = C_m e_j β_b dt.

GROUP samples of a turn at a time go through loops of which each does one thing to all of them: only attitude and
velocity follow from sample to sample, and every other loop the compiler turns into vector instructions. The samples
stand side by side in `rows`, a row for each quantity, from column HEAD on, after the two samples before them; which is
where vectors are aligned. The steps of a loop over `i`
do not depend on one another, which hatch_build.py tells GCC. The rules of `tumble.reduction.kernels` hold.
"""

from __future__ import annotations

import numpy as np

from tumble.units import Array, IntArray

try:
    import cython
except ImportError:
    from tumble import uncompiled as cython

# C: from libc.stdint cimport int64_t
# C: cpdef enum:
# C:     LINEAR = 7
# C:     GROUP = 200
# C:     HEAD = 8
# C:     BLOCK = 4
# C:     _RATE = 0
# C:     _FORCE = 3
# C:     _DT = 7
# C:     _LATE = 8
# C:     _STEP = 11
# C:     _BEFORE = 15
# C:     _MOVE = 19
# C:     _LEFT = 22
# C:     _MOVED = 31
# C:     _SWEPT = 40
# C:     _RIGHT = 49

if not cython.compiled:  # where it is, these are numbers of C
    LINEAR = 7  # regressors 1, ω (3), f (3)
    GROUP, HEAD = 200, 8
    BLOCK = 4  # numbers of regressors are multiples of it
    # rows: ω (3), f (3) and one that is no matter, dt, ω with which the force is moved (3), quaternions of half a step
    # and then of the attitude in its middle (4), of the attitude before it (4), what the velocity moves by and then the
    # velocity in the middle (3), C_m by rows (9), C_m × (V + ½ΔV) by columns (9), C_m [ω×] dt by rows (9), regressors
    _RATE, _FORCE, _DT, _LATE, _STEP, _BEFORE, _MOVE, _LEFT, _MOVED = 0, 3, 7, 8, 11, 15, 19, 22, 31
    _SWEPT, _RIGHT = 40, 49

Terms = tuple[Array, Array]
"""Matrix and offset (3, 4) of y, and a row (n, 9) for each sensor with nonlinear terms: axis, coefficients of u², u³
and |u|, and effect on the vector."""
Model = tuple[Terms, Terms, Array, float]
"""Gyros, accelerometers, what the body's rate reads of its force (3, 3), delay (s)."""
Sums = tuple[Array, Array, Array, Array, Array, Array]
"""Attitude (K, 4), scalar first, V (K, 3), Σ C_m ⊗ regressors and as the tenth row Σ regressors (K, 10, R), Σ (C_m × (V
+ ½ΔV)) ⊗ those before f f (K, 9, Q), Σ C_m [ω×] dt ⊗ f (K, 9, BLOCK), Σ Δt² |f − f'|² (K,). R and Q are multiples of
BLOCK. Regressors are 1, ω, f (LINEAR), those of the gyros' own axes, f f, ω ω, and of the accelerometers' own axes, all
times dt."""


def integrate_pieces(
    samples: tuple[Array, Array, Array],
    pieces: tuple[IntArray, IntArray, IntArray],
    model: Model,
    own_axes: tuple[Array, Array],
    sums: Sums,
) -> None:
    """Carry the sums of turns on over pieces of them, by the turns' numbers, first samples and ends among rates (S, 3)
    rad/s, forces (S, 3) m/s² and intervals (S,) s. Before the first piece attitudes are 1 and all else zero. `own_axes`
    are those of the gyros (n, 3) and accelerometers (m, 3) whose own-axis regressors |a·x|, and then (a·x)³, are
    wanted."""
    (gyro, gyro_terms), (accel, accel_terms), G, delay = model
    height, width = _RIGHT + sums[2].shape[2], HEAD + GROUP
    flat = np.zeros(height * width + 8)
    aligned = -flat.ctypes.data // 8 % 8
    rows = flat[aligned : aligned + height * width].reshape(height, width)
    _integrate(
        *samples, *pieces, gyro, gyro_terms, accel, accel_terms, G, delay, *own_axes, *sums, rows, np.zeros((6, width))
    )


# C: @cython.locals(k=Py_ssize_t, groups=Py_ssize_t, first=Py_ssize_t, count=Py_ssize_t, total=double)
# C: cpdef _integrate(const double[:, ::1] rates, const double[:, ::1] forces, const double[:] intervals,
# C:     const int64_t[:] piece, const int64_t[:] start, const int64_t[:] stop, const double[:, ::1] gyro,
# C:     const double[:, ::1] gyro_terms, const double[:, ::1] accel, const double[:, ::1] accel_terms,
# C:     const double[:, ::1] G, double delay, const double[:, ::1] gyros, const double[:, ::1] accels,
# C:     double[:, ::1] attitude, double[:, ::1] V, double[:, :, ::1] products, double[:, :, ::1] moved,
# C:     double[:, :, ::1] swept, double[::1] jumps, double[:, ::1] rows, double[:, ::1] work)
def _integrate(
    rates: Array, forces: Array, intervals: Array, piece: IntArray, start: IntArray, stop: IntArray, gyro: Array,
    gyro_terms: Array, accel: Array, accel_terms: Array, G: Array, delay: float, gyros: Array, accels: Array,
    attitude: Array, V: Array, products: Array, moved: Array, swept: Array, jumps: Array, rows: Array, work: Array,
) -> None:  # fmt: skip
    """The same without tuples."""
    with cython.nogil:
        for place in range(piece.shape[0]):
            k, groups = piece[place], (stop[place] - start[place] + GROUP - 1) // GROUP
            for group in range(groups):
                first = start[place] + (stop[place] - start[place]) * group // groups
                count = start[place] + (stop[place] - start[place]) * (group + 1) // groups - first
                _gather(rates, forces, intervals, gyro, accel, first - 2, count + 2, rows)
                _subtract_terms(accel_terms, _FORCE, count + 2, rows, work)
                if delay != 0.0:
                    _subtract_force(G, count + 2, rows)
                    _subtract_terms(gyro_terms, _RATE, count + 2, rows, work)
                    _move_force(delay, count + 1, rows)
                _subtract_force(G, count + 2, rows)
                _subtract_terms(gyro_terms, _RATE, count + 2, rows, work)
                jumps[k] += _regress(gyros, accels, count, rows)
                _step(count, rows)
                _follow(attitude, V, k, count, rows)
                _multiply(count, rows)
                _add_products(_LEFT, _RIGHT, products.shape[2], count, rows, products, k)
                _add_products(_MOVED, _RIGHT, moved.shape[2], count, rows, moved, k)
                _add_products(_SWEPT, _FORCE, BLOCK, count, rows, swept, k)
                for b in range(products.shape[2]):
                    total = 0.0
                    for i in range(count):
                        total += rows[_RIGHT + b, HEAD + i]
                    products[k, 9, b] += total


# Compensation: force; with a delay the rate by it, and the force moved with that rate; rate -----------------------


# C: @cython.locals(skipped=Py_ssize_t)
# C: cdef void _gather(const double[:, ::1] rates, const double[:, ::1] forces, const double[:] intervals,
# C:     const double[:, ::1] gyro, const double[:, ::1] accel, Py_ssize_t first, Py_ssize_t count,
# C:     double[:, ::1] rows) noexcept nogil
def _gather(
    rates: Array, forces: Array, intervals: Array, gyro: Array, accel: Array, first: int, count: int, rows: Array
) -> None:
    """Put so many samples side by side, by the linear models; those before the first of all are the first, over no
    time."""
    skipped = max(-first, 0)
    for cell in range(HEAD - 2, HEAD - 2 + skipped):
        _put(rates, gyro, 0, cell, _LATE, rows)
        _put(forces, accel, 0, cell, _FORCE, rows)
        rows[_DT, cell] = 0.0
    first, count = first + skipped, count - skipped
    skipped += HEAD - 2
    for i in range(count):
        _put(rates, gyro, first + i, skipped + i, _LATE, rows)
        _put(forces, accel, first + i, skipped + i, _FORCE, rows)
        rows[_DT, skipped + i] = intervals[first + i]


# C: @cython.locals(x=double, y=double, z=double)
# C: cdef inline void _put(const double[:, ::1] vectors, const double[:, ::1] A, Py_ssize_t place, Py_ssize_t cell,
# C:     Py_ssize_t to, double[:, ::1] rows) noexcept nogil
def _put(vectors: Array, A: Array, place: int, cell: int, to: int, rows: Array) -> None:
    """A (3, 4) times a vector and 1."""
    x, y, z = vectors[place, 0], vectors[place, 1], vectors[place, 2]
    rows[to, cell] = A[0, 3] + A[0, 0] * x + A[0, 1] * y + A[0, 2] * z
    rows[to + 1, cell] = A[1, 3] + A[1, 0] * x + A[1, 1] * y + A[1, 2] * z
    rows[to + 2, cell] = A[2, 3] + A[2, 0] * x + A[2, 1] * y + A[2, 2] * z


# C: @cython.locals(x=double, y=double, z=double)
# C: cdef void _subtract_force(const double[:, ::1] G, Py_ssize_t count, double[:, ::1] rows) noexcept nogil
def _subtract_force(G: Array, count: int, rows: Array) -> None:
    """The rate less what it reads of the force, G f."""
    for i in range(count):
        x, y, z = rows[_FORCE, HEAD - 2 + i], rows[_FORCE + 1, HEAD - 2 + i], rows[_FORCE + 2, HEAD - 2 + i]
        rows[_RATE, HEAD - 2 + i] = rows[_LATE, HEAD - 2 + i] - (G[0, 0] * x + G[0, 1] * y + G[0, 2] * z)
        rows[_RATE + 1, HEAD - 2 + i] = rows[_LATE + 1, HEAD - 2 + i] - (G[1, 0] * x + G[1, 1] * y + G[1, 2] * z)
        rows[_RATE + 2, HEAD - 2 + i] = rows[_LATE + 2, HEAD - 2 + i] - (G[2, 0] * x + G[2, 1] * y + G[2, 2] * z)


# C: @cython.locals(u=double, term=double)
# C: cdef void _subtract_terms(const double[:, ::1] terms, Py_ssize_t of, Py_ssize_t count, double[:, ::1] rows,
# C:     double[:, ::1] work) noexcept nogil
def _subtract_terms(terms: Array, of: int, count: int, rows: Array, work: Array) -> None:
    """Solve x + Σ_p effect_p (K₂ u² + K₃ u³ + κ |u|) = linear, u = a_p·x, by two fixed-point steps in place."""
    if terms.shape[0] == 0:
        return
    for c in range(3):
        for i in range(count):
            work[c, i] = rows[of + c, HEAD - 2 + i]
    for _ in range(2):
        for c in range(3):
            for i in range(count):
                work[3 + c, i], rows[of + c, HEAD - 2 + i] = rows[of + c, HEAD - 2 + i], work[c, i]
        for p in range(terms.shape[0]):
            for i in range(count):
                u = terms[p, 0] * work[3, i] + terms[p, 1] * work[4, i] + terms[p, 2] * work[5, i]
                term = u * u * (terms[p, 3] + terms[p, 4] * u) + terms[p, 5] * abs(u)
                rows[of, HEAD - 2 + i] -= terms[p, 6] * term
                rows[of + 1, HEAD - 2 + i] -= terms[p, 7] * term
                rows[of + 2, HEAD - 2 + i] -= terms[p, 8] * term


# C: @cython.locals(x=double, y=double, z=double, u=double, v=double, w=double, part=double, ax=double, ay=double,
# C:     az=double, bx=double, by=double, bz=double)
# C: cdef void _move_force(double delay, Py_ssize_t count, double[:, ::1] rows) noexcept nogil
def _move_force(delay: float, count: int, rows: Array) -> None:
    """f − τ ω̄×f + ½τ² ω̄×(ω̄×f), with ω̄ = ω − ½τ ω̇ the rate in the middle of the delay and ω̇ from the sample before, of
    all samples but the first; the number added keeps 0/0 out of samples that take no time."""
    for i in range(count):
        x, y, z = rows[_RATE, HEAD - 1 + i], rows[_RATE + 1, HEAD - 1 + i], rows[_RATE + 2, HEAD - 1 + i]
        u, v, w = rows[_FORCE, HEAD - 1 + i], rows[_FORCE + 1, HEAD - 1 + i], rows[_FORCE + 2, HEAD - 1 + i]
        part = delay / (rows[_DT, HEAD - 1 + i] + rows[_DT, HEAD - 2 + i] + 1e-300)
        ax = delay * (x - part * (x - rows[_RATE, HEAD - 2 + i]))
        ay = delay * (y - part * (y - rows[_RATE + 1, HEAD - 2 + i]))
        az = delay * (z - part * (z - rows[_RATE + 2, HEAD - 2 + i]))
        bx, by, bz = ay * w - az * v, az * u - ax * w, ax * v - ay * u
        rows[_FORCE, HEAD - 1 + i] = u + 0.5 * (ay * bz - az * by) - bx
        rows[_FORCE + 1, HEAD - 1 + i] = v + 0.5 * (az * bx - ax * bz) - by
        rows[_FORCE + 2, HEAD - 1 + i] = w + 0.5 * (ax * by - ay * bx) - bz


# Regressors, attitude and velocity --------------------------------------------------------------------------------


# C: @cython.locals(x=double, y=double, z=double, u=double, v=double, w=double, dt=double, a=double, b=double, c=double,
# C:     along=double, jumps=double, p=Py_ssize_t)
# C: cdef double _regress(const double[:, ::1] gyros, const double[:, ::1] accels, Py_ssize_t count,
# C:     double[:, ::1] rows) noexcept nogil
def _regress(gyros: Array, accels: Array, count: int, rows: Array) -> float:
    """Write the regressors, and return Σ Δt² |f − f'|²."""
    jumps, n, m = 0.0, gyros.shape[0], accels.shape[0]
    squares = _RIGHT + LINEAR + 2 * n
    for i in range(count):
        x, y, z, dt = rows[_RATE, HEAD + i], rows[_RATE + 1, HEAD + i], rows[_RATE + 2, HEAD + i], rows[_DT, HEAD + i]
        u, v, w = rows[_FORCE, HEAD + i], rows[_FORCE + 1, HEAD + i], rows[_FORCE + 2, HEAD + i]
        a, b, c = u - rows[_FORCE, HEAD + i - 1], v - rows[_FORCE + 1, HEAD + i - 1], w - rows[_FORCE + 2, HEAD + i - 1]
        jumps += dt * dt * (a * a + b * b + c * c)
        rows[_RIGHT, HEAD + i] = dt
        a, b, c = x * dt, y * dt, z * dt
        rows[_RIGHT + 1, HEAD + i], rows[_RIGHT + 2, HEAD + i], rows[_RIGHT + 3, HEAD + i] = a, b, c
        rows[squares + 6, HEAD + i], rows[squares + 7, HEAD + i], rows[squares + 8, HEAD + i] = a * x, a * y, a * z
        rows[squares + 9, HEAD + i], rows[squares + 10, HEAD + i], rows[squares + 11, HEAD + i] = b * y, b * z, c * z
        a, b, c = u * dt, v * dt, w * dt
        rows[_RIGHT + 4, HEAD + i], rows[_RIGHT + 5, HEAD + i], rows[_RIGHT + 6, HEAD + i] = a, b, c
        rows[squares, HEAD + i], rows[squares + 1, HEAD + i], rows[squares + 2, HEAD + i] = a * u, a * v, a * w
        rows[squares + 3, HEAD + i], rows[squares + 4, HEAD + i], rows[squares + 5, HEAD + i] = b * v, b * w, c * w
    for p in range(n):
        for i in range(count):
            along = gyros[p, 0] * rows[_RATE, HEAD + i] + gyros[p, 1] * rows[_RATE + 1, HEAD + i]
            along += gyros[p, 2] * rows[_RATE + 2, HEAD + i]
            rows[_RIGHT + LINEAR + p, HEAD + i] = abs(along) * rows[_DT, HEAD + i]
            rows[_RIGHT + LINEAR + n + p, HEAD + i] = along * along * along * rows[_DT, HEAD + i]
    for p in range(m):
        for i in range(count):
            along = accels[p, 0] * rows[_FORCE, HEAD + i] + accels[p, 1] * rows[_FORCE + 1, HEAD + i]
            along += accels[p, 2] * rows[_FORCE + 2, HEAD + i]
            rows[squares + 12 + p, HEAD + i] = abs(along) * rows[_DT, HEAD + i]
            rows[squares + 12 + m + p, HEAD + i] = along * along * along * rows[_DT, HEAD + i]
    return jumps


# C: @cython.locals(x=double, y=double, z=double, u=double, v=double, w=double, px=double, py=double, pz=double,
# C:     pu=double, pv=double, pw=double, fx=double, fy=double, fz=double, bx=double, by=double, bz=double, h=double,
# C:     e=double, dt=double, before=double)
# C: cdef void _step(Py_ssize_t count, double[:, ::1] rows) noexcept nogil
def _step(count: int, rows: Array) -> None:
    """With primes for the sample before, docs/explanation/mathematics.md (6), the quaternions exp([φ×]/4) and the moves

    φ = Δθ + Δθ'×Δθ/12,   Δv + φ×(φ×Δv)/24 + (Δθ'×Δv + Δv'×Δθ)/12"""
    for i in range(count):
        dt, before = rows[_DT, HEAD + i], rows[_DT, HEAD + i - 1]
        x, y, z = rows[_RIGHT + 1, HEAD + i], rows[_RIGHT + 2, HEAD + i], rows[_RIGHT + 3, HEAD + i]
        u, v, w = rows[_FORCE, HEAD + i] * dt, rows[_FORCE + 1, HEAD + i] * dt, rows[_FORCE + 2, HEAD + i] * dt
        px, py, pz = (
            rows[_RATE, HEAD + i - 1] * before,
            rows[_RATE + 1, HEAD + i - 1] * before,
            rows[_RATE + 2, HEAD + i - 1] * before,
        )
        pu, pv, pw = (
            rows[_FORCE, HEAD + i - 1] * before,
            rows[_FORCE + 1, HEAD + i - 1] * before,
            rows[_FORCE + 2, HEAD + i - 1] * before,
        )
        fx = x + (py * z - pz * y) * (1.0 / 12.0)
        fy = y + (pz * x - px * z) * (1.0 / 12.0)
        fz = z + (px * y - py * x) * (1.0 / 12.0)
        bx, by, bz = fy * w - fz * v, fz * u - fx * w, fx * v - fy * u
        rows[_MOVE, HEAD + i] = (
            u + (fy * bz - fz * by) * (1.0 / 24.0) + (py * w - pz * v + pv * z - pw * y) * (1.0 / 12.0)
        )
        rows[_MOVE + 1, HEAD + i] = (
            v + (fz * bx - fx * bz) * (1.0 / 24.0) + (pz * u - px * w + pw * x - pu * z) * (1.0 / 12.0)
        )
        rows[_MOVE + 2, HEAD + i] = (
            w + (fx * by - fy * bx) * (1.0 / 24.0) + (px * v - py * u + pu * y - pv * x) * (1.0 / 12.0)
        )
        h = (fx * fx + fy * fy + fz * fz) * (1.0 / 16.0)
        e = 0.25 - h * (1.0 / 24.0 - h * (1.0 / 480.0 - h * (1.0 / 20160.0 - h * (1.0 / 1451520.0))))
        rows[_STEP, HEAD + i] = 1.0 - h * (1.0 / 2.0 - h * (1.0 / 24.0 - h * (1.0 / 720.0 - h * (1.0 / 40320.0))))
        rows[_STEP + 1, HEAD + i], rows[_STEP + 2, HEAD + i], rows[_STEP + 3, HEAD + i] = e * fx, e * fy, e * fz


# C: @cython.locals(q0=double, q1=double, q2=double, q3=double, m0=double, m1=double, m2=double, m3=double, d1=double,
# C:     d2=double, d3=double, e0=double, e1=double, e2=double, e3=double, u=double, v=double, w=double, unit=double)
# C: cdef void _follow(double[:, ::1] attitude, double[:, ::1] V, Py_ssize_t k, Py_ssize_t count, double[:, ::1] rows
# C:     ) noexcept nogil
def _follow(attitude: Array, V: Array, k: int, count: int, rows: Array) -> None:
    """From sample to sample C ← C exp([φ×]) with C_m = C exp([φ×]/2), by quaternions, and V += C_m times the move, of
    which the middle V + ½ΔV is kept."""
    q0, q1, q2, q3 = attitude[k, 0], attitude[k, 1], attitude[k, 2], attitude[k, 3]
    for cell in range(HEAD, HEAD + count):
        e0, e1, e2, e3 = rows[_STEP, cell], rows[_STEP + 1, cell], rows[_STEP + 2, cell], rows[_STEP + 3, cell]
        rows[_BEFORE, cell], rows[_BEFORE + 1, cell] = q0, q1
        rows[_BEFORE + 2, cell], rows[_BEFORE + 3, cell] = q2, q3
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
        e0, e1 = rows[_STEP, HEAD + i], rows[_STEP + 1, HEAD + i]
        e2, e3 = rows[_STEP + 2, HEAD + i], rows[_STEP + 3, HEAD + i]
        q0, q1 = rows[_BEFORE, HEAD + i], rows[_BEFORE + 1, HEAD + i]
        q2, q3 = rows[_BEFORE + 2, HEAD + i], rows[_BEFORE + 3, HEAD + i]
        m0 = q0 * e0 - q1 * e1 - q2 * e2 - q3 * e3
        m1 = q0 * e1 + q1 * e0 + q2 * e3 - q3 * e2
        m2 = q0 * e2 - q1 * e3 + q2 * e0 + q3 * e1
        m3 = q0 * e3 + q1 * e2 - q2 * e1 + q3 * e0
        u, v, w = rows[_MOVE, HEAD + i], rows[_MOVE + 1, HEAD + i], rows[_MOVE + 2, HEAD + i]
        d1, d2, d3 = m1 + m1, m2 + m2, m3 + m3
        rows[_LEFT, HEAD + i] = 1.0 - (d2 * m2 + d3 * m3)
        rows[_LEFT + 1, HEAD + i], rows[_LEFT + 2, HEAD + i] = d1 * m2 - d3 * m0, d1 * m3 + d2 * m0
        rows[_LEFT + 3, HEAD + i], rows[_LEFT + 4, HEAD + i] = d1 * m2 + d3 * m0, 1.0 - (d1 * m1 + d3 * m3)
        rows[_LEFT + 5, HEAD + i], rows[_LEFT + 6, HEAD + i] = d2 * m3 - d1 * m0, d1 * m3 - d2 * m0
        rows[_LEFT + 7, HEAD + i], rows[_LEFT + 8, HEAD + i] = d2 * m3 + d1 * m0, 1.0 - (d1 * m1 + d2 * m2)
        rows[_MOVE, HEAD + i] = (
            rows[_LEFT, HEAD + i] * u + rows[_LEFT + 1, HEAD + i] * v + rows[_LEFT + 2, HEAD + i] * w
        )
        rows[_MOVE + 1, HEAD + i] = (
            rows[_LEFT + 3, HEAD + i] * u + rows[_LEFT + 4, HEAD + i] * v + rows[_LEFT + 5, HEAD + i] * w
        )
        rows[_MOVE + 2, HEAD + i] = (
            rows[_LEFT + 6, HEAD + i] * u + rows[_LEFT + 7, HEAD + i] * v + rows[_LEFT + 8, HEAD + i] * w
        )
    u, v, w = V[k, 0], V[k, 1], V[k, 2]
    for cell in range(HEAD, HEAD + count):
        q1, q2, q3 = rows[_MOVE, cell], rows[_MOVE + 1, cell], rows[_MOVE + 2, cell]
        rows[_MOVE, cell], rows[_MOVE + 1, cell], rows[_MOVE + 2, cell] = u + 0.5 * q1, v + 0.5 * q2, w + 0.5 * q3
        u, v, w = u + q1, v + q2, w + q3
    V[k, 0], V[k, 1], V[k, 2] = u, v, w


# Products ---------------------------------------------------------------------------------------------------------


# C: @cython.locals(a=double, b=double, c=double, x=double, y=double, z=double, bx=double, by=double, bz=double)
# C: cdef void _multiply(Py_ssize_t count, double[:, ::1] rows) noexcept nogil
def _multiply(count: int, rows: Array) -> None:
    """Columns of C_m × (V + ½ΔV), and rows of C_m [ω×] dt."""
    for j in range(3):
        for i in range(count):
            a, b, c = rows[_LEFT + j, HEAD + i], rows[_LEFT + 3 + j, HEAD + i], rows[_LEFT + 6 + j, HEAD + i]
            bx, by, bz = rows[_MOVE, HEAD + i], rows[_MOVE + 1, HEAD + i], rows[_MOVE + 2, HEAD + i]
            rows[_MOVED + j, HEAD + i], rows[_MOVED + 3 + j, HEAD + i] = b * bz - c * by, c * bx - a * bz
            rows[_MOVED + 6 + j, HEAD + i] = a * by - b * bx
        for i in range(count):
            a, b, c = (
                rows[_LEFT + 3 * j, HEAD + i],
                rows[_LEFT + 3 * j + 1, HEAD + i],
                rows[_LEFT + 3 * j + 2, HEAD + i],
            )
            x, y, z = rows[_RIGHT + 1, HEAD + i], rows[_RIGHT + 2, HEAD + i], rows[_RIGHT + 3, HEAD + i]
            rows[_SWEPT + 3 * j, HEAD + i], rows[_SWEPT + 3 * j + 1, HEAD + i] = b * z - c * y, c * x - a * z
            rows[_SWEPT + 3 * j + 2, HEAD + i] = a * y - b * x


# C: @cython.locals(a=double, b=double, c=double, u=double, v=double, w=double, x=double, a0=double, a1=double,
# C:     a2=double, a3=double, b0=double, b1=double, b2=double, b3=double, c0=double, c1=double, c2=double, c3=double,
# C:     left=Py_ssize_t, right=Py_ssize_t)
# C: cdef void _add_products(Py_ssize_t of, Py_ssize_t by, Py_ssize_t many, Py_ssize_t count, double[:, ::1] rows,
# C:     double[:, :, ::1] sums, Py_ssize_t k) noexcept nogil
def _add_products(of: int, by: int, many: int, count: int, rows: Array, sums: Array, k: int) -> None:
    """Add to nine rows of sums the products of nine rows with so many others, three with BLOCK at a time: so many sums
    are at hand in a processor."""
    for row in range(3):
        for block in range(many // BLOCK):
            left, right = of + 3 * row, by + BLOCK * block
            a0, a1, a2, a3, b0, b1, b2, b3, c0, c1, c2, c3 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(count):
                a, b, c = rows[left, HEAD + i], rows[left + 1, HEAD + i], rows[left + 2, HEAD + i]
                u, v, w, x = (
                    rows[right, HEAD + i],
                    rows[right + 1, HEAD + i],
                    rows[right + 2, HEAD + i],
                    rows[right + 3, HEAD + i],
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
