"""imu-calib: A. Mikov, S. Reginya and A. Moschevikin, In-situ Gyroscope Calibration Based on Accelerometer Data, ICINS
2020; github.com/mikoff/imu-calib.

Accelerometers, Eq. (10) to (13): over every sample at rest the three components of g n − C (a − b), n the direction of
C (a − b), C the inverse of an upper triangular M, with the soft-L1 loss. Gyros, Eq. (16): over the turns the roll and
pitch of the rotation between the attitude from the accelerometers after the turn and that of before carried on by
C R⁻¹ ω − C b, R = I + [ε×], both without heading, with the soft-L1 loss. Rest is where the gyros read less than
0.13 rad/s for 60 samples and more; a turn reaches five samples into the rests about it. Bounds, scales and numbers of
evaluations are those of the program; it takes 9.81 m/s² for g, here it is given the gravity of the case. The Earth's
rate is neglected. No uncertainties.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from evidence.case import Array, Case, Estimate, GaveUpError, Program
from evidence.peers.rests import chained, padded, product, runs

STILL = 0.13  # rad/s
SETTLED = 60
INTO_REST = 5
ACCEL_BOUNDS = np.array([0.11] * 6 + [1.1] * 3)
ACCEL_SCALES = np.array([10.0] * 6 + [1.0] * 3)
GYRO_BOUNDS, GYRO_SCALES = np.full(12, 0.11), np.full(12, 10.0)


def error_model(p: Array) -> tuple[Array, Array]:
    """M (3, 3) and b (3,) of nine parameters: scales, then yz, xy, xz, then biases."""
    yz, xy, xz = p[3:6]
    return np.array([[1.0 + p[0], xy, xz], [0.0, 1.0 + p[1], yz], [0.0, 0.0, 1.0 + p[2]]]), p[6:9]


def skew(v: Array) -> Array:
    """[v×]."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def standing(gyro: Array) -> Array:
    """Which samples are at rest (N,), True from SETTLED after a movement to SETTLED before the next."""
    still = np.linalg.norm(gyro, axis=1) < STILL
    out = np.zeros(len(gyro), dtype=bool)
    for a, b in runs(still):
        first = a if a == 0 else a + SETTLED
        last = b if b == len(gyro) else b - SETTLED
        out[first : max(first, last)] = True
    return out


def level(up: Array) -> Array:
    """The quaternion (…, 4) of roll and pitch, heading nothing, of directions of the vertical (…, 3)."""
    roll, pitch = np.arctan2(up[..., 1], up[..., 2]), np.arctan2(-up[..., 0], np.hypot(up[..., 1], up[..., 2]))
    cr, sr, cp, sp = np.cos(0.5 * roll), np.sin(0.5 * roll), np.cos(0.5 * pitch), np.sin(0.5 * pitch)
    return np.stack([cr * cp, sr * cp, cr * sp, -sr * sp], axis=-1)


def roll_and_pitch(q: Array) -> Array:
    """(…, 2)."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return np.stack([roll, np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))], axis=-1)


def accelerometers(accel: Array, gravity: float, components: int = 3) -> Array:
    """The nine parameters from the samples at rest (N, 3). Of the three components of a sample's residual the version
    of the paper used the first two: each third was overwritten by the next sample's first."""

    def residual(p: Array) -> Array:
        matrix, b = error_model(p)
        true = np.linalg.solve(matrix, (accel - b).T).T
        length = np.linalg.norm(true, axis=1, keepdims=True)
        return np.asarray((gravity / length - 1.0) * true, dtype=float)[:, :components].ravel()

    fit = least_squares(
        residual, np.zeros(9), method="trf", loss="soft_l1", max_nfev=25, x_scale=ACCEL_SCALES,
        bounds=(-ACCEL_BOUNDS, ACCEL_BOUNDS),
    )  # fmt: skip
    return np.asarray(fit.x)


def gyros(case: Case, corrected: Array, still: Array) -> Array:
    """Twelve parameters, nine and ε, given corrected accelerometers (N, 3)."""
    assert case.gyro is not None
    change = np.diff(still.astype(int), prepend=int(still[0]))
    starts, ends = np.flatnonzero(change == -1), np.flatnonzero(change == 1)
    ends = ends[ends > starts[0]] if len(starts) else ends
    turns = [(int(a) - INTO_REST, int(b) + INTO_REST) for a, b in zip(starts, ends, strict=False)]
    if len(turns) < 6:
        raise GaveUpError(f"{len(turns)} turns for twelve unknowns")
    edges = [0, *(b for _, b in turns)], [*(a for a, _ in turns), len(corrected) - 1]
    mean = np.array([corrected[a:b].mean(axis=0) for a, b in zip(*edges, strict=True)])
    rates = padded([case.gyro[a:b] for a, b in turns])
    real = padded([np.ones((b - a, 1)) for a, b in turns])
    before, after, dt = level(mean[:-1]), level(mean[1:]), 1.0 / case.rate

    def residual(p: Array) -> Array:
        matrix, b = error_model(p)
        to_body = np.linalg.inv(matrix)
        angle = (rates @ (to_body @ np.linalg.inv(np.eye(3) + skew(p[9:]))).T - to_body @ b) * dt * real
        half = 0.5 * np.linalg.norm(angle, axis=-1, keepdims=True)
        steps = np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * angle], axis=-1)
        carried = product(before, chained(steps))
        tilt = roll_and_pitch(carried)
        roll, pitch = 0.5 * tilt[:, 0], 0.5 * tilt[:, 1]
        level_one = np.stack(
            [np.cos(roll) * np.cos(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.sin(pitch),
             -np.sin(roll) * np.sin(pitch)], axis=-1,
        )  # fmt: skip
        return roll_and_pitch(product(after, level_one * np.array([1.0, -1.0, -1.0, -1.0]))).ravel()

    start = np.zeros(12)
    start[6:9] = np.clip(case.gyro[:100].mean(axis=0), -0.1, 0.1)
    fit = least_squares(
        residual, start, method="trf", loss="soft_l1", max_nfev=50, x_scale=GYRO_SCALES,
        bounds=(-GYRO_BOUNDS, GYRO_BOUNDS),
    )  # fmt: skip
    return np.asarray(fit.x)


def estimate(case: Case) -> Estimate:
    """Both; rests are found by the gyros."""
    assert case.gyro is not None
    still = standing(case.gyro)
    if still.sum() < 1000:
        raise GaveUpError("the gyros read more than 0.13 rad/s almost throughout")
    p = accelerometers(case.accel[still], case.gravity)
    accel, bias = error_model(p)
    q = gyros(case, np.linalg.solve(accel, (case.accel - bias).T).T, still)
    gyro, gyro_bias = error_model(q[:9])
    mounted = np.eye(3) + skew(q[9:])
    return Estimate(accel=accel, accel_bias=bias, gyro=mounted @ gyro, gyro_bias=mounted @ gyro_bias)


PROGRAM = Program(
    name="imu-calib",
    needs=frozenset({"gyro"}),
    estimate=estimate,
    source="Mikov, Reginya and Moschevikin, ICINS 2020; github.com/mikoff/imu-calib",
)
