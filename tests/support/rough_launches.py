"""Noise-free launches of many IMUs on rough tables at once, for tests: a closed form for everything but the turns.

The programme is rough-table. Mounting (one rotation a launch, body axes) and position errors (one a rest, geographic
axes) are rotation vectors, uniform within ± per axis; a turn is one rotation about a geographic axis at constant rate
in 20 s. Rates of a turn are exact means over its samples. Sensor errors are Gaussian.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.support.preintegrated import preintegrate
from tumble.earth import earth_rate, normal_gravity
from tumble.methods.paper.four_stages import (
    PaperMethod,
    course_of_programme,
    one_pass,
)
from tumble.programme.positions import programme
from tumble.reduction.noise.coloured_noise import WHITE
from tumble.reduction.turns.turns import Turns
from tumble.rotation import rotation_matrix, skew
from tumble.sensors.model import ACCEL_ANGLES, PERFECT_TRIAD, SensorModel, triad_model, triad_parameters
from tumble.units import ARCSEC, DEGREE, DEGREE_PER_HOUR, Array

PROGRAMME = programme("rough-table")
LATITUDE = 56.8 * DEGREE
EARTH = np.array(earth_rate(LATITUDE))
GRAVITY = normal_gravity(LATITUDE, 250.0)
TURN_SECONDS = 20.0
STEPS = 200

SIZES = np.concatenate(
    [
        np.repeat([2e-3, 1e-4, 25 * ARCSEC], 3),
        np.repeat([0.3 * DEGREE_PER_HOUR, 1e-4, 10 * ARCSEC], [3, 3, 6]),
    ]
)
"""Standard deviations of the parameters in §6.5, accelerometers and gyros."""


COURSE = course_of_programme(PROGRAMME, turn_rate=np.pi / TURN_SECONDS, latitude=LATITUDE)
"""The course of a recording of the nine known turns only."""


@dataclass(frozen=True, kw_only=True)
class Launches:
    """n launches: true parameters (n, 21) and models, true attitudes (n, 15, 3, 3), readings (n, 15, 3) and the
    increments (n, 9, STEPS, 3) that the gyros read in the turns."""

    values: Array
    accel: SensorModel
    gyro: SensorModel
    attitudes: Array
    force: Array
    rate: Array
    increments: Array

    def turns(self, model: SensorModel) -> Turns:
        """The turns integrated about a gyro model, as `Observations.turns_about` does it."""
        dt = TURN_SECONDS / STEPS
        n, k = self.increments.shape[:2]
        angle = SensorModel(matrix=model.matrix, bias=model.bias * dt).apply(self.increments.reshape(n, -1, 3))
        angle = angle.reshape(n, k, STEPS, 3)
        angle = np.concatenate([angle[:, :, :1], angle], axis=2)  # the sample before the first
        start = np.arange(n * k) * (STEPS + 1) + 1
        C, M, B = preintegrate(
            angle.reshape(-1, 3),
            np.full(n * k * (STEPS + 1), dt),
            start,
            start + STEPS,
            np.eye(3),
            np.zeros(3),
        )
        return Turns(
            first=np.array([t.first for s in COURSE.series for t in s]),
            last=np.array([t.last for s in COURSE.series for t in s]),
            duration=COURSE.duration,
            C=C.reshape(n, k, 3, 3),
            M=M.reshape(n, k, 3, 3, 3),
            B=B.reshape(n, k, 3, 3),
            covariance=np.zeros((k, 3, 3)),
            moment_ratio=np.full(k, WHITE),
            velocity_covariance=np.zeros((k, 3, 3)),
            jumps=np.zeros(k),
            aliased=np.zeros(k),
        )


def drawn_values(n: int, rng: np.random.Generator) -> Array:
    """Parameters (n, 21) of n IMUs, accelerometers first, of the sizes of §6.5."""
    return np.asarray(SIZES * rng.standard_normal((n, 21)))


def rough_attitudes(n: int, rng: np.random.Generator, *, mounting_deg: float, position_deg: float) -> Array:
    """Attitudes (n, 15, 3, 3) of n launches with deviations drawn anew."""
    mounting = rotation_matrix(mounting_deg * DEGREE * rng.uniform(-1.0, 1.0, (n, 1, 3)))
    position = rotation_matrix(position_deg * DEGREE * rng.uniform(-1.0, 1.0, (n, len(PROGRAMME.positions), 3)))
    return np.asarray(position @ np.array([p.matrix for p in PROGRAMME.positions]) @ mounting)


def launches(values: Array, attitudes: Array) -> Launches:
    """The launches of IMUs with these parameters (n, 21) in these attitudes (n, 15, 3, 3)."""
    accel = triad_model(values[:, :3], values[:, 3:6], values[:, 6:9])
    gyro = triad_model(values[:, 9:12], values[:, 12:15], values[:, 15:])
    return Launches(
        values=values,
        accel=accel,
        gyro=gyro,
        attitudes=attitudes,
        force=reading(accel, GRAVITY * attitudes[..., 1, :]),
        rate=reading(gyro, np.einsum("...ij,i->...j", attitudes, EARTH)),
        increments=_increments(gyro, attitudes),
    )


def rough_launches(n: int, seed: int, *, mounting_deg: float, position_deg: float) -> Launches:
    """n launches of IMUs drawn at random."""
    rng = np.random.default_rng(seed)
    values = drawn_values(n, rng)
    return launches(values, rough_attitudes(n, rng, mounting_deg=mounting_deg, position_deg=position_deg))


def reading(model: SensorModel, true: Array) -> Array:
    """Readings (n, N, 3) of true vectors (n, N, 3)."""
    return np.asarray(true @ np.swapaxes(model.matrix, -1, -2) + model.bias[:, None])


def _increments(gyro: SensorModel, attitudes: Array) -> Array:
    """Increments that the gyros read in the known turns: means over samples of Lᵀ(n θ̇ + Ω)."""
    first = [t.first for s in COURSE.series for t in s]
    L0, L1 = attitudes[:, first], attitudes[:, [i + 1 for i in first]]
    vector = Rotation.from_matrix((L1 @ np.swapaxes(L0, -1, -2)).reshape(-1, 3, 3)).as_rotvec().reshape(-1, 9, 3)
    nominal = np.array([m.axis * m.angle for m in PROGRAMME.moves if m.axis is not None and m.angle is not None])
    total = np.linalg.norm(vector, axis=-1, keepdims=True)
    back = (vector * nominal).sum(axis=-1, keepdims=True) < 0.0
    n = np.where(back, -1.0, 1.0) * vector / total
    total = np.where(back, 2.0 * np.pi - total, total)[..., 0]
    θ = total[..., None] * np.arange(STEPS + 1) / STEPS
    step = total[..., None] / STEPS
    cosine, sine = np.diff(np.sin(θ)) / step, -np.diff(np.cos(θ)) / step
    along = n * (n @ EARTH)[..., None]
    across = -(skew(n) @ EARTH)
    dt = TURN_SECONDS / STEPS
    geographic = n[..., None, :] * step[..., None] + dt * (
        along[..., None, :] + cosine[..., None] * (EARTH - along)[..., None, :] + sine[..., None] * across[..., None, :]
    )
    body = geographic @ L0
    matrix, bias = gyro.matrix[:, None], gyro.bias[:, None, None]
    return np.asarray(body @ np.swapaxes(matrix, -1, -2) + bias * dt)


def passes(
    found: Launches, method: PaperMethod, iterations: int, *, accel: SensorModel | None = None
) -> list[tuple[SensorModel, SensorModel]]:
    """Models after each pass of the four stages; with `accel` given the accelerometers are known."""
    models = PERFECT_TRIAD if accel is None else accel, PERFECT_TRIAD
    if accel is not None:
        method = replace(method, accelerometers=lambda *_: PERFECT_TRIAD)
    rests, out = (found.force, found.rate), []
    for _ in range(iterations):
        models = one_pass(method, COURSE, rests, lambda gyro: found.turns(gyro).C, np.array(GRAVITY), models)
        out.append(models)
    return out


def values_of(accel: SensorModel, gyro: SensorModel) -> Array:
    """Parameters (n, 21) of models."""
    bias, scale, angles = triad_parameters(accel)
    return np.concatenate([bias, scale, angles[..., ACCEL_ANGLES], *triad_parameters(gyro)], axis=-1)
