"""Links from node to node: increments of place, and what parameters and noise do to them."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from tumble.reduction.turns.links import PARTS, joined_parts, noise_of_links
from tumble.units import Array

RATE, SAMPLES = 200.0, 100


def samples(seed: int) -> tuple[Array, Array]:
    """Smooth rates, rad/s, and forces, m/s², of half a second."""
    rng = np.random.default_rng(seed)
    t = np.arange(SAMPLES)[:, None] / RATE
    w = rng.normal(size=3) + rng.normal(size=3) * np.sin(3.0 * t + rng.normal(size=3))
    f = 9.81 * np.array([0.0, 1.0, 0.0]) + 3.0 * rng.normal(size=3) * np.cos(4.0 * t + rng.normal(size=3))
    return w, f


def integrated(w: Array, f: Array) -> tuple[Array, Array, Array]:
    """Rotation, velocity and place by the plainest rule, a sample at a time, in steps of a tenth."""
    C, V, P, h = np.eye(3), np.zeros(3), np.zeros(3), 0.1 / RATE
    for rate, force in zip(np.repeat(w, 10, axis=0), np.repeat(f, 10, axis=0), strict=True):
        half = C @ Rotation.from_rotvec(0.5 * h * rate).as_matrix()
        P = P + V * h + 0.5 * h * h * half @ force
        V = V + h * half @ force
        C = C @ Rotation.from_rotvec(h * rate).as_matrix()
    return C, V, P


def parts_of(w: Array, f: Array, gyro: Array, accel: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Parts of one link with the columns of the biases of gyros and accelerometers by differences, about biases."""
    pieces = np.array_split(np.arange(SAMPLES), PARTS)
    rows, C, V, P = (
        np.zeros((1, PARTS, 6, 7)),
        np.zeros((1, PARTS, 3, 3)),
        np.zeros((1, PARTS, 3)),
        np.zeros((1, PARTS, 3)),
    )
    for p, piece in enumerate(pieces):
        C[0, p], V[0, p], P[0, p] = integrated(w[piece], f[piece])
        at, _, _ = integrated(w[piece] - gyro, f[piece] - accel)
        moved = integrated(w[piece] - gyro, f[piece] - accel)[1]
        rows[0, p, :3, -1] = Rotation.from_matrix(at @ C[0, p].T).as_rotvec()
        rows[0, p, 3:, -1] = moved
        for k in range(6):
            step = np.zeros(6)
            step[k] = 1e-6
            C1, V1, _ = integrated(w[piece] - gyro - step[:3], f[piece] - accel - step[3:])
            rows[0, p, :3, k] = Rotation.from_matrix(C1 @ at.T).as_rotvec() / 1e-6
            rows[0, p, 3:, k] = (V1 - moved) / 1e-6
    return rows, C, V, P, np.full((1, PARTS), SAMPLES / PARTS / RATE)


def test_increments_of_a_link_are_those_of_its_samples() -> None:
    """Rotation, velocity and place of four parts, moved by biases to first order, against the whole, and the columns
    of the biases against differences of the whole."""
    w, f = samples(1)
    gyro, accel = np.array([2e-3, -1e-3, 3e-3]), np.array([0.02, 0.03, -0.01])
    link = joined_parts(*parts_of(w, f, gyro, accel))
    C, V, P = integrated(w - gyro, f - accel)
    np.testing.assert_allclose(link.C[0], C, atol=1e-6)
    np.testing.assert_allclose(link.V[0], V, atol=1e-6)
    _, _, without = integrated(w, f)
    assert np.abs(link.P[0] - P).max() < 0.01 * np.abs(without - P).max()
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-5
        C1, V1, P1 = integrated(w - gyro - step[:3], f - accel - step[3:])
        expected = np.concatenate([Rotation.from_matrix(C1 @ C.T).as_rotvec(), V1 - V, P1 - P]) / 1e-5
        size = np.abs(expected).reshape(3, 3).max(axis=1).repeat(3)
        np.testing.assert_allclose(
            link.columns[0, :, k] / np.maximum(size, 1e-12), expected / np.maximum(size, 1e-12), atol=0.02
        )


def test_noise_of_a_link_is_that_of_its_samples() -> None:
    """Covariance of rotation, velocity and place against that of N = 4000 links with noise in their samples: each
    standard deviation within 6 %, five standard errors, and correlations within 0.09."""
    w, f = samples(2)
    rng, count, g, a = np.random.default_rng(3), 4000, 1e-3, 0.02
    pieces = np.array_split(np.arange(SAMPLES), PARTS)
    each = [integrated(w[piece], f[piece]) for piece in pieces]
    C, V, P = (np.array([part[i] for part in each])[None] for i in range(3))
    roots = noise_of_links(C, V, P, np.full((1, PARTS), SAMPLES / PARTS / RATE), (g**2, a**2))
    of_gyros, of_accels = (Z @ np.swapaxes(Z, 1, 2) for Z in roots)
    # by sums over samples, to first order, independent of the recursion
    h, R, forces = 1.0 / RATE, [], []
    at = np.eye(3)
    for rate, force in zip(w, f, strict=True):
        R.append(at @ Rotation.from_rotvec(0.5 * h * rate).as_matrix())
        forces.append(R[-1] @ force)
        at = at @ Rotation.from_rotvec(h * rate).as_matrix()
    turned, force = np.array(R), np.array(forces)
    noise_w, noise_f = (
        rng.normal(0, g * np.sqrt(h), (count, SAMPLES, 3)),
        rng.normal(0, a * np.sqrt(h), (count, SAMPLES, 3)),
    )
    phi = np.cumsum(np.einsum("kij,nkj->nki", turned, noise_w), axis=1)
    before = phi - 0.5 * np.einsum("kij,nkj->nki", turned, noise_w)
    for expected, moved in (
        (of_gyros[0], np.cross(before, force * h)),
        (of_accels[0], np.einsum("kij,nkj->nki", turned, noise_f)),
    ):
        velocity = np.cumsum(moved, axis=1)
        place = (velocity - 0.5 * moved).sum(axis=1) * h
        rotation = phi[:, -1] if expected is of_gyros[0] else np.zeros((count, 3))
        sample = np.cov(np.concatenate([rotation, velocity[:, -1], place], axis=1).T)
        used = np.flatnonzero(np.diag(sample) > 0.0)
        sigma, size = np.sqrt(np.diag(sample)[used]), np.sqrt(np.diag(expected)[used])
        np.testing.assert_allclose(size / sigma, 1.0, atol=0.06)
        correlation = expected[np.ix_(used, used)] / np.outer(size, size)
        np.testing.assert_allclose(correlation, sample[np.ix_(used, used)] / np.outer(sigma, sigma), atol=0.09)
