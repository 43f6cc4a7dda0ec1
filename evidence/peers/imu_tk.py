"""imu_tk: D. Tedaldi, A. Pretto, E. Menegatti, A Robust and Easy to Implement Method for IMU Calibration without
External Equipments, ICRA 2014, 3042; and the defaults of its C++ program (github.com/Kyle-ak/imu_tk, calibration.cpp).

Accelerometers, Eq. (10): over the first 100 samples of every rest, the sum of (‖g‖ − ‖T K (a − b)‖)², T upper
triangular with ones on its diagonal, K diagonal; once for each of nine thresholds of the detector, 2 to 10 times the
variance of the initial rest, and the one with the least sum is kept. Gyros, Eq. (14): over the turns, the sum of
‖Rᵀ u₀ − u₁‖², u the directions of the mean corrected accelerometer readings of the rests before and after, R the turn
integrated by Runge and Kutta's fourth order from T K (ω − b), T full, b the mean of the initial rest. The Earth's rate
is neglected. No uncertainties.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.optimize import least_squares

from evidence.case import Array, Case, Estimate, GaveUpError, Program
from evidence.peers.rests import chained, padded, product, rotation_of, static_spans, variance_norm, window_of

SAMPLES = 100
"""Samples of a rest that are used, and the fewest that a rest has."""
FEWEST = 12
"""Rests."""
LONGEST_INITIAL = 50.0
"""s: what is used of the initial rest, as in its example; its default is 30 s."""
SHORTEST_INITIAL = 3.0


def correction(p: Array) -> Array:
    """T K of nine parameters (yz, zy, zx, xz, xy, yx; scales), as imu_tk orders them."""
    yz, zy, zx, xz, xy, yx = p[:6]
    return np.asarray(np.array([[1.0, -yz, zy], [xz, 1.0, -zx], [-xy, yx, 1.0]]) * p[6:9], dtype=float)


def initial_rest(case: Case) -> float:
    """How long the device rests at the beginning, s, at most LONGEST_INITIAL."""
    norm = variance_norm(case.accel, window_of(case))
    moving = np.flatnonzero(norm > 20.0 * np.quantile(norm, 0.2))
    length = float(case.time[moving[0] if len(moving) else -1] - case.time[0])
    if length < SHORTEST_INITIAL:
        raise GaveUpError(f"needs a rest at the beginning of {SHORTEST_INITIAL:g} s or more, {length:.1f} s are there")
    return min(length, LONGEST_INITIAL)


def accelerometers(
    case: Case, initial: float, scale: float = 1.0, bias: float = 0.0
) -> tuple[Array, Array, list[tuple[int, int]]]:
    """T K (3, 3), b (3,), and the rests of the best threshold, first and last sample."""
    first = case.accel[case.time <= case.time[0] + initial]
    unit = float(np.linalg.norm(first.var(axis=0, ddof=1)))
    best: tuple[float, Array, list[tuple[int, int]]] | None = None
    for times in range(2, 11):
        spans = static_spans(case.accel, times * unit)
        long = [(int(a), int(b)) for a, b in spans if b - a >= SAMPLES]
        if len(long) < FEWEST:
            continue
        used = np.concatenate([case.accel[a : a + SAMPLES] for a, _ in long])

        def residual(p: Array, used: Array = used) -> Array:
            full = np.concatenate([p[:3], np.zeros(3), p[3:6]])
            corrected = (used - p[6:9]) @ correction(full).T
            return np.asarray(case.gravity - np.linalg.norm(corrected, axis=1), dtype=float)

        start = np.array([0.0] * 3 + [scale] * 3 + [bias] * 3)
        fit = least_squares(residual, start, method="lm", x_scale="jac", xtol=1e-12, ftol=1e-12)
        if best is None or fit.cost < best[0]:
            best = float(fit.cost), np.asarray(fit.x), long
    if best is None:
        raise GaveUpError(f"fewer than {FEWEST} rests of {SAMPLES} samples with any threshold")
    _, p, spans_kept = best
    return correction(np.concatenate([p[:3], np.zeros(3), p[3:6]])), p[6:9], spans_kept


def gyros(
    case: Case, matrix: Array, bias: Array, spans: list[tuple[int, int]], initial: float, scale: float = 1.0
) -> tuple[Array, Array]:
    """T K (3, 3) and b (3,) of the gyros, given T K and b of the accelerometers and the rests."""
    assert case.gyro is not None
    means = (np.array([case.accel[a:b].mean(axis=0) for a, b in spans]) - bias) @ matrix.T
    up = means / np.linalg.norm(means, axis=1)[:, None]
    still = case.gyro[case.time <= case.time[0] + initial].mean(axis=0)
    turns = [slice(end - 1, start) for (_, end), (start, _) in pairwise(spans)]
    rates = padded([case.gyro[turn] - still for turn in turns])
    steps = padded([np.diff(case.time[turn]) for turn in turns])[..., None]

    def residual(p: Array) -> Array:
        w = rates @ correction(p).T
        turned = chained(runge_kutta(w[:, :-1], w[:, 1:], steps))
        return np.asarray(np.einsum("nji,nj->ni", rotation_of(turned), up[:-1]) - up[1:], dtype=float).ravel()

    start = np.array([0.0] * 6 + [scale] * 3)
    fit = least_squares(residual, start, method="lm", x_scale="jac", xtol=1e-10, ftol=1e-10)
    return correction(np.asarray(fit.x)), still


def runge_kutta(before: Array, after: Array, dt: Array) -> Array:
    """The quaternion (…, 4) of a step of dq/dt = ½ q ⊗ ω, from the rates at its ends, normalised."""
    zero = np.zeros((*before.shape[:-1], 1))
    w0, w1 = np.concatenate([zero, before], axis=-1), np.concatenate([zero, after], axis=-1)
    middle = 0.5 * (w0 + w1)
    one = np.zeros_like(w0)
    one[..., 0] = 1.0
    k1 = 0.5 * w0
    k2 = 0.5 * product(one + 0.5 * dt * k1, middle)
    k3 = 0.5 * product(one + 0.5 * dt * k2, middle)
    k4 = 0.5 * product(one + dt * k3, w1)
    step = one + dt * (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0
    return np.asarray(step / np.linalg.norm(step, axis=-1, keepdims=True), dtype=float)


def estimate(case: Case) -> Estimate:
    """Accelerometers, and gyros where there are any."""
    initial = initial_rest(case)
    matrix, bias, spans = accelerometers(case, initial)
    found = Estimate(accel=np.linalg.inv(matrix), accel_bias=bias)
    if case.gyro is None:
        return found
    gyro, gyro_bias = gyros(case, matrix, bias, spans, initial)
    return Estimate(accel=found.accel, accel_bias=bias, gyro=np.linalg.inv(gyro), gyro_bias=gyro_bias)


PROGRAM = Program(
    name="imu_tk",
    needs=frozenset({"long rest", "accel"}),
    estimate=estimate,
    source="Tedaldi, Pretto and Menegatti, ICRA 2014; github.com/Kyle-ak/imu_tk",
)
