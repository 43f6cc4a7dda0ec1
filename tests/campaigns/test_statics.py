"""Nine parameters from rests alone, many triads at once: against a plain twin and the joint likelihood."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support import naive
from tumble.campaigns.triads import STEPS, TOGETHER, fit_statics
from tumble.inference.hyperparameters import Components
from tumble.inference.likelihood import Point, Problem, weights
from tumble.inference.linearisation import linearise
from tumble.inference.step import solve
from tumble.recording.session import Site
from tumble.reduction.observations import Observations
from tumble.reduction.rests.rests import Rests
from tumble.sensors.model import Block
from tumble.units import Array

GRAVITY = 9.81
ACCEL = Block(kind="accel", axes=np.eye(3))
SPREAD = np.repeat([0.3, 0.03, 0.03], 3)


def attitudes(n: int, rng: np.random.Generator) -> Array:
    """Rotation matrices (n, 3, 3) of all orientations."""
    q, r = np.linalg.qr(rng.standard_normal((n, 3, 3)))
    q = q * np.sign(np.diagonal(r, axis1=1, axis2=2))[:, None, :]
    return np.asarray(q * np.linalg.det(q)[:, None, None])


def triads(n: int, rests: int, noise: float) -> tuple[Array, Array, Array]:
    """True parameters (n, 9), attitudes (n, rests, 3, 3) and mean readings (n, rests, 3)."""
    rng = np.random.default_rng(7)
    truth = SPREAD * rng.standard_normal((n, 9))
    L = attitudes(n * rests, rng).reshape(n, rests, 3, 3)
    models = [ACCEL.model(t) for t in truth]
    readings = np.array([model.predict(GRAVITY * up) for model, up in zip(models, L[:, :, 1], strict=True)])
    return truth, L, readings + noise * rng.standard_normal(readings.shape)


@pytest.mark.parametrize("n", [1, TOGETHER, TOGETHER + 3])
def test_noiseless_parameters_are_recovered(n: int) -> None:
    truth, _, readings = triads(n, 24, 0.0)
    values, _, step = fit_statics(readings, GRAVITY)
    assert np.abs(values - truth).max() < 1e-13
    assert np.abs(step).max() < 1e-8


@pytest.mark.parametrize("rests", [10, 24, 25])
def test_the_fit_of_many_is_that_of_the_plain_twin(rests: int) -> None:
    _, _, readings = triads(20, rests, 1e-3)
    values, variance, _ = fit_statics(readings, GRAVITY)
    plain = [naive.fit_statics(y, GRAVITY, STEPS) for y in readings]
    np.testing.assert_allclose(values, [v for v, _ in plain], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(variance, [v for _, v in plain], rtol=1e-9)


def test_a_start_changes_the_steps_and_not_the_values() -> None:
    truth, _, readings = triads(5, 24, 1e-3)
    values, _, step = fit_statics(readings, GRAVITY)
    again, _, smaller = fit_statics(readings, GRAVITY, start=values)
    np.testing.assert_allclose(again, values, rtol=0.0, atol=1e-13)
    assert np.abs(smaller).max() <= np.abs(step).max() + 1e-15
    assert np.abs(values - truth).max() > 1e-5


def test_rests_that_do_not_determine_the_parameters_leave_no_small_variance() -> None:
    _, _, readings = triads(20, 8, 0.0)
    _, variance, _ = fit_statics(readings, GRAVITY)
    with np.errstate(invalid="ignore"):
        assert not (variance < 1e6).all(axis=1).any()


def test_the_variance_is_the_bound_of_the_joint_likelihood_with_free_attitudes() -> None:
    sigma = 1e-3
    truth, L, readings = triads(5, 24, 0.0)
    _, variance, _ = fit_statics(readings, GRAVITY, start=truth)
    for i in range(5):
        problem = Problem.of(of_rests(readings[i], sigma))
        point = Point(values=truth[i], gravity=GRAVITY, attitudes=L[i])
        rows = linearise(problem, point, None)
        step = solve(problem, rows, weights(problem, rows, Components()))
        information = np.linalg.inv(step.covariance[1:, 1:]) - np.diag(1.0 / problem.spread**2)  # without the prior
        np.testing.assert_allclose(sigma**2 * variance[i], np.diag(np.linalg.inv(information)), rtol=1e-9)


def of_rests(readings: Array, sigma: float) -> Observations:
    """Observations of accelerometers at rest and of nothing else."""
    n, none = len(readings), np.empty((len(readings), 0))
    rests = Rests(
        file=np.zeros(n, dtype=np.int64),
        start=np.arange(n, dtype=float),
        stop=np.arange(1, n + 1, dtype=float),
        accel=readings,
        accel_covariance=np.broadcast_to(sigma**2 * np.eye(3), (n, 3, 3)),
        accel_drift=np.zeros((n, 3)),
        accel_noise=np.full((n, 3), sigma),
        gyro=none,
        gyro_covariance=np.empty((n, 0, 0)),
        gyro_drift=none,
        gyro_noise=none,
        temperatures=None,
    )
    return Observations(
        accel_block=ACCEL,
        gyro_block=None,
        site=Site(latitude=None, height=0.0, gravity=GRAVITY, gravity_u=0.0),
        rests=rests,
        turns=None,
        turn_samples=None,
        programme=None,
        position=None,
    )
