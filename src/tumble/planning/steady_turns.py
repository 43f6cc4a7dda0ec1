"""Readings of perfect sensors in turns at a constant rate about an axis fixed in inertial space.

With the rotation vector v of a turn of T s in the body at its start, the attitude L₀ there and the Earth's rate Ω,

    ω = v/T,   C(t) = exp([ω×]t),   f(t) = g C(t)ᵀ L₀ᵀ exp([Ω×]t) e_U
"""

from __future__ import annotations

import numpy as np

from tumble.earth import earth_rate
from tumble.planning.setup import Setup
from tumble.reduction.blocks.motion_samples import MotionSamples
from tumble.reduction.noise.coloured_noise import WHITE
from tumble.reduction.turns.turns import AHEAD, Turns, TurnSamples
from tumble.rotation import rotation_matrix, rotation_vector_near
from tumble.units import Array, IntArray

SAMPLES = 256  # of a turn, which give its moments to 1e-5
STILL = 8  # samples of the time without motion before and after a turn, each


def inertial_turns(start: Array, end: Array, moves: Array, seconds: Array, latitude: float) -> Array:
    """Return the rotation vectors (K, 3), rad, of the body in inertial space, in the body at the start.

    Turns are from attitudes `start` to `end` (K, 3, 3), body → geographic, in `seconds` (K,), the way round that is
    closer to the moves (K, 3), geographic rotation vectors."""
    back = np.swapaxes(start, 1, 2)
    earth = rotation_matrix(seconds[:, None] * np.array(earth_rate(latitude)))
    return rotation_vector_near(back @ earth @ end, np.einsum("kij,kj->ki", back, moves))


def white_turns(first: IntArray, T: Array, covariance: Array, velocity_variance: Array) -> Turns:
    """Return turns, not yet integrated, after the rests `first` (K,) in T (K,) s, with the covariance of the rotations
    (K, 3, 3), rad², and the variance of the velocities (K,), (m/s)², by white noise."""
    K = len(T)
    return Turns(
        first=first,
        last=first + 1,
        duration=T,
        C=np.broadcast_to(np.eye(3), (K, 3, 3)),
        M=np.zeros((K, 3, 3, 3)),
        B=np.zeros((K, 3, 3)),
        covariance=covariance,
        arising=np.full(K, WHITE),
        velocity_covariance=velocity_variance[:, None, None] * np.eye(3),
        jumps=np.zeros(K),
        aliased=np.zeros(K),
    )


def steady_samples(vector: Array, T: Array, start: Array, setup: Setup, still: Array) -> TurnSamples:
    """Return samples of turns at a constant rate by perfect sensors.

    Parameters
    ----------
    vector : (K, 3)
        Rotation vectors in inertial space, in the body at the start, rad.
    T : (K,)
        Durations of the motion, s.
    start : (K, 3, 3)
        Attitudes at the start, body → geographic.
    setup
        Set-up with latitude and gravity.
    still : (K,)
        Time without motion before and after each turn, s.
    """
    K, at_ends = len(T), STILL if still.any() else 0
    ends = np.repeat(still[:, None] / max(at_ends, 1), at_ends, axis=1)
    dt = np.concatenate([ends, np.repeat(T[:, None] / SAMPLES, SAMPLES, axis=1), ends], axis=1)
    when = np.cumsum(dt, axis=1) - 0.5 * dt
    part = (when - still[:, None]) / T[:, None]
    moving = (part > 0.0) & (part < 1.0)
    rate = moving[:, :, None] * (vector / T[:, None])[:, None]
    C = rotation_matrix(np.clip(part, 0.0, 1.0)[:, :, None] * vector[:, None])
    up = rotation_matrix(when[:, :, None] * np.array(earth_rate(setup.latitude)))[..., 1] @ start
    force = setup.gravity * np.einsum("knij,kni->knj", C, up)
    samples, before = MotionSamples(), ((0, 0), (AHEAD, 0))  # the first step of a turn needs samples before it
    rate, force = (np.pad(each, (*before, (0, 0)), mode="edge") for each in (rate, force))
    samples.append(rate.reshape(-1, 3), force.reshape(-1, 3), np.pad(dt, before, mode="edge").ravel())
    first = AHEAD + rate.shape[1] * np.arange(K)
    return TurnSamples(samples=samples, start=first, stop=first + rate.shape[1] - AHEAD)
