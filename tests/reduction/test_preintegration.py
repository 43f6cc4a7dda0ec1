"""Rotations of turns and their sensitivities to the gyros against closed forms and long double; against the plain twin
and finite differences they are in test_moments.py."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from tests.support.preintegrated import preintegrate
from tumble.rotation import rotation_matrix, skew
from tumble.units import Array

Result = tuple[Array, Array, Array]
IntArray = npt.NDArray[np.int64]


def motion(rng: np.random.Generator, samples: int, largest: float = 0.02) -> tuple[Array, Array, Array, Array]:
    """Increments up to `largest` rad that wander smoothly, uneven intervals, a compensation."""
    steps = np.cumsum(rng.standard_normal((samples, 3)), axis=0) / np.sqrt(samples + 1.0)
    increment = largest * np.tanh(steps + 0.3 * rng.standard_normal((samples, 3))) / np.sqrt(3.0)
    dt = 0.01 * (1.0 + 0.1 * rng.random(samples))
    transform = np.eye(3) + 0.01 * rng.standard_normal((3, 3))
    return increment, dt, transform, 1e-3 * rng.standard_normal(3)


def ranges(*lengths: int) -> tuple[IntArray, IntArray]:
    """Starts and stops of turns of these lengths, one after the other."""
    stops = np.cumsum(np.array(lengths, dtype=np.int64))
    return stops - np.array(lengths, dtype=np.int64), stops


def whole(samples: int) -> tuple[IntArray, IntArray]:
    return ranges(samples)


def assert_equal(found: Result, expected: Result, tolerance: float) -> None:
    """C to `tolerance` rad; M and B to `tolerance` of the path and the time in the turn (at least 1)."""
    for ours, theirs in zip(found, expected, strict=True):
        assert ours.shape == theirs.shape
        assert np.abs(ours - theirs).max(initial=0.0) <= tolerance * max(1.0, np.abs(theirs).max(initial=0.0))


def test_the_sample_before_a_turn_gives_its_first_coning_term() -> None:
    before, now = np.array([0.03, -0.02, 0.01]), np.array([0.01, 0.02, -0.03])
    increment, dt = np.array([before, now]), np.full(2, 0.01)
    alone, after = np.array([0]), np.array([1])
    C, _, _ = preintegrate(increment[1:], dt[1:], alone, after, np.eye(3), np.zeros(3))
    np.testing.assert_allclose(C[0], rotation_matrix(now), atol=1e-15)
    C, _, _ = preintegrate(increment, dt, after, after + 1, np.eye(3), np.zeros(3))
    np.testing.assert_allclose(C[0], rotation_matrix(now + np.cross(before, now) / 12), atol=1e-15)


def test_a_turn_at_constant_rate_has_the_closed_form() -> None:
    """Eq. (6.2) of the turntable method: with K = Θ n nᵀ + sin Θ (1 − n nᵀ) + (1 − cos Θ) [n×],
    M = K ⊗ n and B = K T/Θ. The rule of the middle multiplies the part across n by (φ/2)/sin(φ/2), φ the
    angle of a sample."""
    n = np.array([2.0, -1.0, 2.0]) / 3.0
    for samples, turned in ((1000, np.pi), (777, -2.5), (20_000, 30.0), (10, 4.0)):
        C, M, B = preintegrate(
            np.tile(turned / samples * n, (samples, 1)),
            np.full(samples, 0.01),
            *whole(samples),
            np.eye(3),
            np.zeros(3),
        )
        half = 0.5 * turned / samples
        along, middle = np.outer(n, n), half / np.sin(half)
        across = np.sin(turned) * (np.eye(3) - along) + (1.0 - np.cos(turned)) * skew(n)
        K = turned * along + middle * across
        expected = rotation_matrix(turned * n), np.multiply.outer(K, n), K * 0.01 * samples / turned
        assert_equal((C[0], M[0], B[0]), expected, 1e-12)


def test_rounding_stays_below_1e_12_over_100_000_samples() -> None:
    increment, dt, transform, offset = motion(np.random.default_rng(6), 100_000)
    found = preintegrate(increment, dt, *whole(100_000), transform, offset)
    assert_equal(found, in_long_double(increment, dt, transform, offset), 1e-12)
    C = found[0][0]
    assert np.abs(C @ C.T - np.eye(3)).max() < 1e-15


def in_long_double(increment: Array, dt: Array, transform: Array, offset: Array) -> Result:
    """The recursion from sample 0 in long double: all attitudes at once, by a scan of quaternion products."""
    wide = np.longdouble
    angle = increment.astype(wide) @ transform.T.astype(wide) + dt[:, None].astype(wide) * offset.astype(wide)
    phi = angle.copy()
    phi[1:] += np.cross(angle[:-1], angle[1:]) / wide(12)
    attitude = _quaternion(phi)
    reach = 1
    while reach < len(attitude):
        attitude[reach:] = _product(attitude[:-reach].copy(), attitude[reach:])
        reach *= 2
    before = np.concatenate([_quaternion(np.zeros((1, 3), dtype=wide)), attitude[:-1]])
    middle = _matrix(_product(before, _quaternion(phi / 2)))
    M = (middle[:, :, :, None] * angle[:, None, None, :]).sum(axis=0)
    B = (middle * dt[:, None, None]).sum(axis=0)
    C, M, B = (x.astype(float)[None] for x in (_matrix(attitude[-1:])[0], M, B))
    return C, M, B


def _quaternion(phi: npt.NDArray[Any]) -> npt.NDArray[Any]:
    half = np.sqrt((phi**2).sum(axis=1, keepdims=True)) / 2
    ratio = np.where(half > 0, np.sin(half) / np.where(half > 0, half, 1), 1)
    return np.concatenate([np.cos(half), ratio * phi / 2], axis=1)


def _product(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> npt.NDArray[Any]:
    scalar = a[:, 0] * b[:, 0] - (a[:, 1:] * b[:, 1:]).sum(axis=1)
    vector = a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:] + np.cross(a[:, 1:], b[:, 1:])
    return np.concatenate([scalar[:, None], vector], axis=1)


def _matrix(q: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """(s² − v·v) 1 + 2 v vᵀ + 2 s [v×]."""
    s, v = q[:, 0, None, None], q[:, 1:]
    K = np.zeros((len(q), 3, 3), dtype=q.dtype)
    K[:, 2, 1], K[:, 0, 2], K[:, 1, 0] = v[:, 0], v[:, 1], v[:, 2]
    K = K - np.swapaxes(K, 1, 2)
    square = (v**2).sum(axis=1)[:, None, None]
    return np.asarray((s**2 - square) * np.eye(3) + 2 * v[:, :, None] * v[:, None, :] + 2 * s * K)


def test_error_on_a_coning_motion_is_of_third_order_or_better() -> None:
    """Classical coning at 3 Hz, half angle 5°, over 2 s: attitude exp(a (cos Ωt, sin Ωt, 0)), whose rate is
    Ω (−sin a sin Ωt, sin a cos Ωt, −2 sin²(a/2))."""
    a, Omega, seconds = np.radians(5.0), 2.0 * np.pi * 3.0, 2.1
    errors, uncorrected = [], []
    for rate in (100, 200, 400, 800):
        t = np.arange(-1, round(seconds * rate) + 1) / rate
        integral = np.column_stack(
            [
                np.sin(a) * np.cos(Omega * t),
                np.sin(a) * np.sin(Omega * t),
                -2.0 * np.sin(a / 2) ** 2 * Omega * t,
            ]
        )
        increment, dt = np.diff(integral, axis=0), np.full(len(t) - 1, 1.0 / rate)
        C, _, _ = preintegrate(increment, dt, np.array([1]), np.array([len(dt)]), np.eye(3), np.zeros(3))
        direction = np.column_stack([np.cos(Omega * t), np.sin(Omega * t), 0.0 * t])
        attitude = Rotation.from_rotvec(a * direction)
        truth = attitude[1].inv() * attitude[-1]
        errors.append((Rotation.from_matrix(C[0]) * truth.inv()).magnitude())
        simple = Rotation.concatenate([Rotation.from_rotvec(x) for x in increment[1:]])
        product = simple[0]
        for k in range(1, len(simple)):
            product = product * simple[k]
        uncorrected.append((product * truth.inv()).magnitude())
    for coarse, fine in pairwise(errors):
        assert coarse / fine > 0.9 * 2**3
    for coarse, fine in pairwise(uncorrected):
        assert 0.9 * 2**2 < coarse / fine < 1.1 * 2**2
    assert errors[0] < 0.05 * uncorrected[0]
