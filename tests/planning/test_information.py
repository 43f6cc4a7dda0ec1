"""The bound of a programme against a Fisher information computed by other means.

Nothing of the likelihood, its moments or its elimination is used: readings of perfect sensors are integrated sample by
sample with a chain of matrix products, derivatives are differences of that, the in-run biases of every rest are
unknowns of their own, which their covariance joins, and the information matrix is dense."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.support.formula_setup import bound_of
from tumble.earth import earth_rate
from tumble.inference.noise import CORRELATION_TIME
from tumble.planning.itinerary import Itinerary, itinerary_of
from tumble.planning.setup import Setup
from tumble.rotation import axes_matrix, rotation_matrix, rotation_vector
from tumble.sensors.parameters import usual_sizes
from tumble.units import Array

SAMPLES = 240
STEP = 1e-5
LEVERS, DELAY = slice(21, 27), 27
"""Where lever arms of the X and Y accelerometers and the delay stand after the 21."""


def matrices(theta: Array) -> tuple[Array, Array, Array, Array]:
    """Sensitivity and bias of accelerometers and gyros of 21 parameters in the order of the calibration file."""
    accel = (1.0 + theta[3:6])[:, None] * axes_matrix(0.0, 0.0, theta[6], 0.0, theta[7], theta[8])
    gyro = (1.0 + theta[12:15])[:, None] * axes_matrix(*theta[15:21])
    return accel, theta[:3], gyro, theta[9:12]


def rest(theta: Array, turned: Array, L: Array, setup: Setup) -> Array:
    """Readings (6,) of a rest at an attitude that is off by a rotation in the body."""
    A, a, G, g = matrices(theta)
    off = L @ rotation_matrix(turned)
    return np.concatenate([A @ (setup.gravity * off[1]) + a, G @ (np.array(earth_rate(setup.latitude)) @ off) + g])


def integrated(theta: Array, rates: Array, forces: Array, dt: float, velocity: bool) -> tuple[Array, Array, Array]:
    """Rotation, velocity and path (n, 3, 3) of readings with the sensors taken to have these parameters."""
    A, a, G, g = matrices(theta)
    late = theta[DELAY] if velocity else 0.0
    omega = (rates - g) @ np.linalg.inv(G).T
    force = (forces - a) @ np.linalg.inv(A).T
    force = force - late * np.cross(omega, force)
    if velocity:  # what the accelerometers feel for being elsewhere, at a constant rate
        around = np.cross(omega[:, None], np.cross(omega[:, None], theta[LEVERS].reshape(2, 3)))
        force[:, 0] -= around[:, 0, 0]
        force[:, 1] -= around[:, 1, 1]
    path = np.empty((len(rates) + 1, 3, 3))
    path[0] = np.eye(3)
    steps, halves = rotation_matrix(omega * dt), rotation_matrix(0.5 * omega * dt)
    for k in range(len(rates)):
        path[k + 1] = path[k] @ steps[k]
    middle = path[:-1] @ halves
    V = dt * np.einsum("kij,kj->i", middle, force)
    if velocity:  # and the jumps where the turn begins and ends
        for C, rate, sign in ((path[0], omega[0], 1.0), (path[-1], omega[-1], -1.0)):
            jump = sign * np.cross(rate, theta[LEVERS].reshape(2, 3))
            V -= C[:, 0] * jump[0, 0] + C[:, 1] * jump[1, 1]
    return path[-1], V, middle


def information(course: Itinerary, setup: Setup, velocity: bool) -> Array:
    """Least covariance (p, p) of 21 parameters, or with velocities 28."""
    noise, p = setup.noise, 28 if velocity else 21
    unknowns = p + 9 * len(course.attitudes)  # three angles and six biases a rest
    total = np.zeros((unknowns, unknowns))

    def angles(i: int) -> slice:
        return slice(p + 9 * i, p + 9 * i + 3)

    def biases(i: int) -> slice:
        return slice(p + 9 * i + 3, p + 9 * i + 9)

    def with_bias(x: Array, i: int) -> Array:
        theta = np.zeros(28)
        theta[:p] = x[:p]
        theta[:3] += x[biases(i)][:3]
        theta[9:12] += x[biases(i)][3:]
        return theta

    for i, L in enumerate(course.attitudes):
        jacobian = np.zeros((6, unknowns))
        own = [*range(min(p, 21)), *range(*angles(i).indices(unknowns)), *range(*biases(i).indices(unknowns))]
        for c in own:
            x = np.zeros(unknowns)
            x[c] = STEP
            both = [rest(with_bias(s * x, i), s * x[angles(i)], L, setup) for s in (1.0, -1.0)]
            jacobian[:, c] = (both[0] - both[1]) / (2.0 * STEP)
        sigma = np.repeat([noise.accel_white, noise.gyro_white], 3) / np.sqrt(setup.rest)
        total += (jacobian / sigma[:, None]).T @ (jacobian / sigma[:, None])
    add_process(total, course, setup, biases)
    for first, move, T in zip(course.first, course.moves[course.first], course.seconds, strict=True):
        add_turn(total, course, setup, (int(first), move, float(T)), with_bias, angles, biases, p, velocity)
    if velocity:
        usual = usual_sizes(setup.instrument)
        total[LEVERS, LEVERS] += np.eye(6) / usual["accel.lever"] ** 2
        total[DELAY, DELAY] += usual["accel.delay"] ** -2.0
    asked = np.eye(p, unknowns)  # of biases the mean over the rests
    for i in range(len(course.attitudes)):
        asked[[0, 1, 2, 9, 10, 11], biases(i)] += np.eye(6) / len(course.attitudes)
    return np.asarray(asked @ np.linalg.pinv(total, rcond=1e-20) @ asked.T, dtype=float)


def add_process(total: Array, course: Itinerary, setup: Setup, biases: Callable[[int], slice]) -> None:
    """Add that in-run biases are Gauss–Markov processes between the middles of the rests."""
    N, noise = len(course.attitudes), setup.noise
    moved = np.zeros(N)
    moved[course.first + 1] = course.seconds
    middle = setup.rest * np.arange(N) + np.cumsum(moved)
    alike = np.linalg.inv(np.exp(-np.abs(middle[:, None] - middle) / CORRELATION_TIME))
    u = np.repeat([noise.accel_instability, noise.gyro_instability], 3)
    for i in range(N):
        for j in range(N):
            total[biases(i), biases(j)] += alike[i, j] * np.diag(u**-2.0)


def add_turn(
    total: Array,
    course: Itinerary,
    setup: Setup,
    turn: tuple[int, Array, float],
    with_bias: Callable[[Array, int], Array],
    angles: Callable[[int], slice],
    biases: Callable[[int], slice],
    p: int,
    velocity: bool,
) -> None:
    """Add what the rotation and the velocity of a turn say."""
    first, move, T = turn
    noise, earth, unknowns, dt = setup.noise, np.array(earth_rate(setup.latitude)), len(total), T / SAMPLES
    start, end = course.attitudes[first], course.attitudes[first + 1]
    vector = rotation_vector(start.T @ rotation_matrix(T * earth) @ end)
    if vector @ (start.T @ move) < 0.0:
        vector = vector * (1.0 - 2.0 * np.pi / np.linalg.norm(vector))
    when = (np.arange(SAMPLES) + 0.5) * dt
    seen = rotation_matrix(when[:, None] * earth)[:, :, 1] @ start  # e_U in the body that does not turn
    up = np.einsum("kij,ki->kj", rotation_matrix(when[:, None] * vector / T), seen)
    rates, forces = np.repeat(vector[None] / T, SAMPLES, axis=0), setup.gravity * up
    _, V0, middle = integrated(np.zeros(28), rates, forces, dt, velocity)

    def residual(x: Array) -> Array:
        between = 0.5 * (with_bias(x, first) + with_bias(x, first + 1))
        C, V, _ = integrated(between, rates, forces, dt, velocity)
        L, M = start @ rotation_matrix(x[angles(first)]), end @ rotation_matrix(x[angles(first + 1)])
        r = rotation_vector(C @ M.T @ rotation_matrix(-T * earth) @ L)
        away = T * earth
        turning = np.eye(3) + 0.5 * cross(away) + cross(away) @ cross(away) / 6.0
        predicted = L.T @ turning @ np.array([0.0, setup.gravity * T, 0.0])
        return np.concatenate([r, V - predicted]) if velocity else r

    of_rests = (angles(first), biases(first), angles(first + 1), biases(first + 1))
    own = [*range(p)] + [c for s in of_rests for c in range(*s.indices(unknowns))]
    jacobian = np.zeros((6 if velocity else 3, unknowns))
    for c in own:
        x = np.zeros(unknowns)
        x[c] = STEP
        jacobian[:, c] = (residual(x) - residual(-x)) / (2.0 * STEP)
    after = V0 - np.cumsum(dt * np.einsum("kij,kj->ki", middle, forces), axis=0)
    covariance = np.zeros((6, 6))
    for C, D in zip(middle, after, strict=True):
        of_gyro = np.concatenate([C, -cross(D) @ C])
        of_accel = np.concatenate([np.zeros((3, 3)), C])
        covariance += dt * (noise.gyro_white**2 * of_gyro @ of_gyro.T + noise.accel_white**2 * of_accel @ of_accel.T)
    rows = len(jacobian)
    total += jacobian.T @ np.linalg.solve(covariance[:rows, :rows], jacobian)


def cross(v: Array) -> Array:
    """[v×]."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


@pytest.mark.parametrize(("grade", "velocity"), [("navigation", False), ("mems", True)])
def test_the_bound_is_the_inverse_of_the_dense_information(grade: str, velocity: bool) -> None:
    """To 2 % of every u, with in-run instability as documented."""
    setup = Setup.of(grade=grade, programme="rough-table", gravity_u=0.0)
    names = {"accel.lever", "accel.delay"} if velocity else set()
    setup = replace(setup, further={name: value for name, value in usual_sizes(grade).items() if name in names})
    course = itinerary_of(setup)
    found = bound_of(course, setup)
    u = np.sqrt(np.diag(information(course, setup, velocity)))
    np.testing.assert_allclose(found.u, u, rtol=0.02)
