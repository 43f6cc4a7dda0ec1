"""The compiled loop over the samples of turns: sums of which `tumble.reduction.moments` makes the moments of a turn.

All moments are outer products of nine numbers of the attitude with regressors of a sample, Ψ included: by summation in
parts, exact for the discrete sums too,

    Ψ_jb = Σ (Φ + ½ΔΦ)_jb × ΔV = Φ_jb(T) × V(T) − Σ ΔΦ_jb × (V + ½ΔV),      ΔΦ_jb = C_m e_j β_b dt.

So each sample is compensated, turned with, and multiplied out, one after the other. The steps of a loop over `i` do not
depend on one another, which hatch_build.py tells GCC. The rules of `tumble.reduction.kernels` hold.
"""

from __future__ import annotations

import numpy as np

from tumble.units import Array, IntArray

try:
    import cython
except ImportError:
    from tumble import uncompiled as cython

if not cython.compiled:  # where it is, these are numbers of moment_kernels.pxd
    LINEAR = 7  # regressors 1, ω (3), f (3)
    GROUP = 8  # samples that are multiplied out together
    BLOCK = 8  # numbers of sums are multiples of it, which leaves nothing over in loops over vectors

Terms = tuple[Array, Array]
"""Matrix and offset (3, 4) of y, and a row (n, 9) for each sensor with nonlinear terms: axis, coefficients of u², u³
and |u|, and effect on the vector."""
Model = tuple[Terms, Terms, Array, float]
"""Gyros, accelerometers, what the body's rate reads of its force (3, 3), delay (s)."""
Sums = tuple[Array, Array, Array, Array, Array, Array]
"""Attitude (K, 4), scalar first, V (K, 3), Σ C_m ⊗ regressors and as the tenth row Σ regressors (K, 10, R), Σ (C_m × (V
+ ½ΔV)) ⊗ those before f f (K, 9, Q), Σ C_m [ω×] dt ⊗ f (K, 9, 3), Σ Δt² |f − f'|² (K,). R and Q are multiples of BLOCK.
Regressors are 1, ω, f (LINEAR), those of the gyros' own axes, f f, ω ω, and of the accelerometers' own axes, all times
dt."""


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
    rates, forces, intervals = samples
    piece, start, stop = pieces
    (gyro, gyro_terms), (accel, accel_terms), G, delay = model
    gyros, accels = own_axes
    attitude, V, products, moved, swept, jumps = sums
    _integrate(
        rates, forces, intervals, piece, start, stop,
        gyro, gyro_terms, accel, accel_terms, G, delay, gyros, accels,
        attitude, V, products, moved, swept, jumps,
        np.zeros((GROUP, products.shape[2] + 3)), np.zeros((GROUP, 28)), np.zeros(3), np.zeros(3),
    )  # fmt: skip


def _integrate(
    rates: Array,
    forces: Array,
    intervals: Array,
    piece: IntArray,
    start: IntArray,
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
    swept: Array,
    jumps: Array,
    right: Array,
    left: Array,
    w: Array,
    f: Array,
) -> None:
    """The same without tuples. With primes for the sample before (A1):

        φ = Δθ + Δθ'×Δθ/12,   C ← C exp([φ×]),   C_m = C exp([φ×]/2)
        V += C_m (Δv + φ×(φ×Δv)/24 + (Δθ'×Δv + Δv'×Δθ)/12)

    The two samples before the first are compensated for what is remembered of them: where there are none, they are the
    first of all over no time."""
    rows, linear, n, m = products.shape[2], moved.shape[2], gyros.shape[0], accels.shape[0]
    with cython.nogil:
        for place in range(piece.shape[0]):
            k, first = piece[place], start[place]
            q0, q1, q2, q3 = attitude[k, 0], attitude[k, 1], attitude[k, 2], attitude[k, 3]
            V0, V1, V2 = V[k, 0], V[k, 1], V[k, 2]
            px, py, pz, pu, pv, pw = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0  # Δθ' and Δv'
            r0, r1, r2, before = 0.0, 0.0, 0.0, 0.0  # the rate that moved the force before, and its dt
            u0, u1, u2, t = 0.0, 0.0, 0.0, 0  # the force before, and the place in the group
            for number in range(stop[place] - first + 2):
                at = max(first - 2 + number, 0)
                dt = intervals[at] if first - 2 + number >= 0 else 0.0

                # compensation: force; with a delay the rate by it, and the force moved with that rate; rate
                for c in range(3):
                    f[c] = accel[c, 3] + accel[c, 0] * forces[at, 0] + accel[c, 1] * forces[at, 1]
                    f[c] += accel[c, 2] * forces[at, 2]
                if accel_terms.shape[0] > 0:
                    _subtract_terms(f, accel_terms)
                for moved_yet in range(0 if delay != 0.0 else 1, 2):
                    for c in range(3):
                        w[c] = gyro[c, 3] + gyro[c, 0] * rates[at, 0] + gyro[c, 1] * rates[at, 1]
                        w[c] += gyro[c, 2] * rates[at, 2] - (G[c, 0] * f[0] + G[c, 1] * f[1] + G[c, 2] * f[2])
                    if gyro_terms.shape[0] > 0:
                        _subtract_terms(w, gyro_terms)
                    if moved_yet == 0:
                        # f − τ ω̄×f + ½τ² ω̄×(ω̄×f), with ω̄ = ω − ½τ ω̇ the rate in the middle of the delay and ω̇ from
                        # the sample before; the number added keeps 0/0 out of samples that take no time
                        x, y, z = w[0], w[1], w[2]
                        if number == 0:
                            r0, r1, r2 = x, y, z
                        part = delay / (dt + before + 1e-300)
                        ax, ay, az = x - part * (x - r0), y - part * (y - r1), z - part * (z - r2)
                        ax, ay, az = delay * ax, delay * ay, delay * az
                        bx, by, bz = ay * f[2] - az * f[1], az * f[0] - ax * f[2], ax * f[1] - ay * f[0]
                        r0, r1, r2, before = x, y, z, dt
                        f[0] += 0.5 * (ay * bz - az * by) - bx
                        f[1] += 0.5 * (az * bx - ax * bz) - by
                        f[2] += 0.5 * (ax * by - ay * bx) - bz

                # regressors with dt
                w0, w1, w2, f0, f1, f2 = w[0], w[1], w[2], f[0], f[1], f[2]
                x, y, z, u, v, s = w0 * dt, w1 * dt, w2 * dt, f0 * dt, f1 * dt, f2 * dt
                if number < 2:
                    px, py, pz, pu, pv, pw, u0, u1, u2 = x, y, z, u, v, s, f0, f1, f2
                    continue
                right[t, 0], right[t, 1], right[t, 2], right[t, 3], right[t, 4], right[t, 5], right[t, 6] = (
                    dt,
                    x,
                    y,
                    z,
                    u,
                    v,
                    s,
                )
                for p in range(n):
                    own = gyros[p, 0] * w0 + gyros[p, 1] * w1 + gyros[p, 2] * w2
                    right[t, LINEAR + p], right[t, LINEAR + n + p] = abs(own) * dt, own * own * own * dt
                to = LINEAR + 2 * n
                right[t, to], right[t, to + 1], right[t, to + 2] = f0 * u, f0 * v, f0 * s
                right[t, to + 3], right[t, to + 4], right[t, to + 5] = f1 * v, f1 * s, f2 * s
                right[t, to + 6], right[t, to + 7], right[t, to + 8] = w0 * x, w0 * y, w0 * z
                right[t, to + 9], right[t, to + 10], right[t, to + 11] = w1 * y, w1 * z, w2 * z
                to += 12
                for p in range(m):
                    own = accels[p, 0] * f0 + accels[p, 1] * f1 + accels[p, 2] * f2
                    right[t, to + p], right[t, to + m + p] = abs(own) * dt, own * own * own * dt
                du, dv, ds = f0 - u0, f1 - u1, f2 - u2
                jumps[k] += dt * dt * (du * du + dv * dv + ds * ds)
                u0, u1, u2 = f0, f1, f2

                # the step: e = exp([φ×]/4) and the attitudes in the middle, C_m, and at the end as quaternions
                fx = x + (py * z - pz * y) * (1.0 / 12.0)
                fy = y + (pz * x - px * z) * (1.0 / 12.0)
                fz = z + (px * y - py * x) * (1.0 / 12.0)
                bx, by, bz = fy * s - fz * v, fz * u - fx * s, fx * v - fy * u
                du = u + (fy * bz - fz * by) * (1.0 / 24.0) + (py * s - pz * v + pv * z - pw * y) * (1.0 / 12.0)
                dv = v + (fz * bx - fx * bz) * (1.0 / 24.0) + (pz * u - px * s + pw * x - pu * z) * (1.0 / 12.0)
                ds = s + (fx * by - fy * bx) * (1.0 / 24.0) + (px * v - py * u + pu * y - pv * x) * (1.0 / 12.0)
                px, py, pz, pu, pv, pw = x, y, z, u, v, s
                h = (fx * fx + fy * fy + fz * fz) * (1.0 / 16.0)
                e0 = 1.0 - h * (1.0 / 2.0 - h * (1.0 / 24.0 - h * (1.0 / 720.0 - h * (1.0 / 40320.0))))
                e = 0.25 - h * (1.0 / 24.0 - h * (1.0 / 480.0 - h * (1.0 / 20160.0 - h * (1.0 / 1451520.0))))
                e1, e2, e3 = e * fx, e * fy, e * fz
                m0 = q0 * e0 - q1 * e1 - q2 * e2 - q3 * e3
                m1 = q0 * e1 + q1 * e0 + q2 * e3 - q3 * e2
                m2 = q0 * e2 - q1 * e3 + q2 * e0 + q3 * e1
                m3 = q0 * e3 + q1 * e2 - q2 * e1 + q3 * e0
                q0, q1, q2, q3 = 2.0 * e0 * m0 - q0, 2.0 * e0 * m1 - q1, 2.0 * e0 * m2 - q2, 2.0 * e0 * m3 - q3
                d1, d2, d3 = m1 + m1, m2 + m2, m3 + m3
                c00, c01, c02 = 1.0 - (d2 * m2 + d3 * m3), d1 * m2 - d3 * m0, d1 * m3 + d2 * m0
                c10, c11, c12 = d1 * m2 + d3 * m0, 1.0 - (d1 * m1 + d3 * m3), d2 * m3 - d1 * m0
                c20, c21, c22 = d1 * m3 - d2 * m0, d2 * m3 + d1 * m0, 1.0 - (d1 * m1 + d2 * m2)
                ax = c00 * du + c01 * dv + c02 * ds
                ay = c10 * du + c11 * dv + c12 * ds
                az = c20 * du + c21 * dv + c22 * ds
                bx, by, bz = V0 + 0.5 * ax, V1 + 0.5 * ay, V2 + 0.5 * az
                V0, V1, V2 = V0 + ax, V1 + ay, V2 + az

                # C_m by rows, 1, C_m × (V + ½ΔV) by columns, and C_m [ω×] dt by rows
                left[t, 0], left[t, 1], left[t, 2] = c00, c01, c02
                left[t, 3], left[t, 4], left[t, 5] = c10, c11, c12
                left[t, 6], left[t, 7], left[t, 8], left[t, 9] = c20, c21, c22, 1.0
                left[t, 10], left[t, 11], left[t, 12] = c10 * bz - c20 * by, c11 * bz - c21 * by, c12 * bz - c22 * by
                left[t, 13], left[t, 14], left[t, 15] = c20 * bx - c00 * bz, c21 * bx - c01 * bz, c22 * bx - c02 * bz
                left[t, 16], left[t, 17], left[t, 18] = c00 * by - c10 * bx, c01 * by - c11 * bx, c02 * by - c12 * bx
                left[t, 19], left[t, 20], left[t, 21] = c01 * z - c02 * y, c02 * x - c00 * z, c00 * y - c01 * x
                left[t, 22], left[t, 23], left[t, 24] = c11 * z - c12 * y, c12 * x - c10 * z, c10 * y - c11 * x
                left[t, 25], left[t, 26], left[t, 27] = c21 * z - c22 * y, c22 * x - c20 * z, c20 * y - c21 * x
                right[t, rows], right[t, rows + 1], right[t, rows + 2] = f0, f1, f2

                # products, of a group of samples at a time
                t += 1
                if t == GROUP or number == stop[place] - first + 1:
                    for rest in range(t, GROUP):
                        for i in range(28):
                            left[rest, i] = 0.0
                        for i in range(rows + 3):
                            right[rest, i] = 0.0
                    _add_products(left, 0, right, 0, products, k, rows)
                    _add_products(left, 10, right, 0, moved, k, linear)
                    _add_products(left, 19, right, rows, swept, k, 3)
                    unit = 1.5 - 0.5 * (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)  # of length 1 again
                    q0, q1, q2, q3, t = q0 * unit, q1 * unit, q2 * unit, q3 * unit, 0
            V[k, 0], V[k, 1], V[k, 2] = V0, V1, V2
            attitude[k, 0], attitude[k, 1], attitude[k, 2], attitude[k, 3] = q0, q1, q2, q3


def _add_products(left: Array, column: int, right: Array, first: int, sums: Array, k: int, many: int) -> None:
    """Add to the rows of sums what `many` columns of `right`, from the first, are times columns of `left`, of a group
    of samples."""
    for row in range(sums.shape[1]):
        c = column + row
        a, b, d, e = left[0, c], left[1, c], left[2, c], left[3, c]
        f, g, h, o = left[4, c], left[5, c], left[6, c], left[7, c]
        for i in range(many):
            at = first + i
            one = sums[k, row, i] + a * right[0, at] + b * right[1, at] + d * right[2, at] + e * right[3, at]
            sums[k, row, i] = one + f * right[4, at] + g * right[5, at] + h * right[6, at] + o * right[7, at]


def _subtract_terms(x: Array, terms: Array) -> None:
    """Solve x + Σ_p effect_p (K₂ u² + K₃ u³ + κ |u|) = linear, u = a_p·x, by two fixed-point steps in place."""
    l0, l1, l2 = x[0], x[1], x[2]
    x0, x1, x2 = l0, l1, l2
    for _ in range(2):
        b0, b1, b2, x0, x1, x2 = x0, x1, x2, l0, l1, l2
        for p in range(terms.shape[0]):
            u = terms[p, 0] * b0 + terms[p, 1] * b1 + terms[p, 2] * b2
            term = u * u * (terms[p, 3] + terms[p, 4] * u) + terms[p, 5] * abs(u)
            x0, x1, x2 = x0 - terms[p, 6] * term, x1 - terms[p, 7] * term, x2 - terms[p, 8] * term
    x[0], x[1], x[2] = x0, x1, x2
