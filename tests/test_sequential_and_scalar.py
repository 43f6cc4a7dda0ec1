"""The two pipelines on observations: recovery, increments, covariance, and what they refuse."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rough_launches import (
    GRAVITY,
    LATITUDE,
    PROGRAMME,
    SIZES,
    STEPS,
    TURN_SECONDS,
    drawn_values,
    launches,
    rough_attitudes,
)

from tumble.estimate import Estimate
from tumble.methods.compensation import compensated, composed, triad_model, triad_parameters
from tumble.methods.scalar import scalar
from tumble.methods.sequential import sequential
from tumble.model import Block
from tumble.observe import Observations, Rests, TurnSamples
from tumble.rotation import axes_matrix
from tumble.segment import GyroSamples
from tumble.session import Site
from tumble.units import DEGREE, Array

Pipeline = Callable[..., Estimate]
PIPELINES = pytest.mark.parametrize("pipeline", [sequential, scalar])

ACCEL_NOISE = 1e-4 / np.sqrt(120)  # of a rest of 120 s, §8
GYRO_NOISE = 0.003 * DEGREE / 60 / np.sqrt(120)
TURN_NOISE = 0.003 * DEGREE / 60 * np.sqrt(TURN_SECONDS)


def observations(
    values: Array,
    rng: np.random.Generator,
    *,
    degrees: float = 1.0,
    noise: float = 0.0,
    stated: float = 1.0,
) -> Observations:
    """What is left of a log of one launch with these parameters (21,). The noise of §8 is in the readings times `noise`,
    in the covariances times `stated`."""
    found = launches(values[None], rough_attitudes(1, rng, mounting_deg=degrees, position_deg=degrees))
    n, dt = len(PROGRAMME.positions), TURN_SECONDS / STEPS
    samples = GyroSamples()
    increments = found.increments[0]
    for k in range(len(increments)):
        white = noise * TURN_NOISE / np.sqrt(STEPS) * rng.standard_normal((STEPS, 3))
        measured = np.vstack([increments[k, :1], increments[k] + white])
        samples.append(measured / dt, np.full(STEPS + 1, dt))
    start = np.arange(len(increments)) * (STEPS + 1) + 1
    turns = found.turns(triad_model(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 6))))
    no = np.zeros((n, 3))
    return Observations(
        accel_block=Block(kind="accel", axes=np.eye(3)),
        gyro_block=Block(kind="gyro", axes=np.eye(3)),
        site=Site(latitude=LATITUDE, height=250.0, gravity=GRAVITY, gravity_u=1e-12),
        rests=Rests(
            file=np.zeros(n, dtype=np.int64),
            start=140.0 * np.arange(n),
            stop=140.0 * np.arange(n) + 120.0,
            accel=found.force[0] + noise * ACCEL_NOISE * rng.standard_normal((n, 3)),
            accel_covariance=np.tile((stated * ACCEL_NOISE) ** 2 * np.eye(3), (n, 1, 1)),
            accel_drift=no,
            accel_noise=no,
            gyro=found.rate[0] + noise * GYRO_NOISE * rng.standard_normal((n, 3)),
            gyro_covariance=np.tile((stated * GYRO_NOISE) ** 2 * np.eye(3), (n, 1, 1)),
            gyro_drift=no,
            gyro_noise=no,
            temperature=None,
        ),
        turns=replace(
            turns,
            C=turns.C[0],
            M=turns.M[0],
            B=turns.B[0],
            covariance=np.tile((stated * TURN_NOISE) ** 2 * np.eye(3), (len(start), 1, 1)),
        ),
        turn_samples=TurnSamples(samples=samples, start=start, stop=start + STEPS),
        programme=PROGRAMME,
        position=np.arange(n),
    )


# Compensation composes


@settings(deadline=None)
@given(st.integers(0, 2**31))
def test_models_compose_exactly_and_stay_in_the_frame_of_the_accelerometers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = (
        triad_model(rng.normal(size=(2, 3)), 1e-2 * rng.normal(size=(2, 3)), 1e-2 * rng.normal(size=(2, 3)))
        for _ in range(2)
    )
    readings = 10.0 * rng.normal(size=(2, 5, 3))
    both = composed(first, second)
    np.testing.assert_allclose(
        compensated(both, readings), compensated(second, compensated(first, readings)), atol=1e-12
    )
    np.testing.assert_allclose(both.matrix, np.tril(both.matrix), atol=1e-17)


@settings(deadline=None)
@given(st.lists(st.floats(-0.1, 0.1), min_size=12, max_size=12))
def test_models_of_many_launches_are_those_of_equation_1(values: list[float]) -> None:
    bias, scale, angles = np.split(np.array(values), [3, 6])
    model = triad_model(np.tile(bias, (4, 1)), np.tile(scale, (4, 1)), np.tile(angles, (4, 1)))
    expected = (1.0 + scale)[:, None] * axes_matrix(*angles)
    np.testing.assert_allclose(model.matrix, np.broadcast_to(expected, (4, 3, 3)), atol=1e-16)
    for found, true in zip(triad_parameters(model), (bias, scale, angles), strict=True):
        np.testing.assert_allclose(found, np.tile(true, (4, 1)), atol=1e-14)


# Recovery


@PIPELINES
def test_noiseless_parameters_are_recovered(pipeline: Pipeline) -> None:
    rng = np.random.default_rng(1)
    values = drawn_values(1, rng)[0]
    estimate = pipeline(observations(values, rng, degrees=1.5), iterations=7)
    assert np.abs((estimate.values - values) / SIZES).max() < 5e-6  # preintegration at 0.9° a sample
    assert estimate.converged
    assert max(estimate.rest_sigmas.max(), estimate.turn_sigmas.max()) < 0.01


@PIPELINES
def test_each_iteration_takes_most_of_the_error_that_was_left(pipeline: Pipeline) -> None:
    rng = np.random.default_rng(2)
    values = drawn_values(1, rng)[0]
    seen = observations(values, rng)
    errors = [float(np.abs((pipeline(seen, iterations=i).values - values) / SIZES).max()) for i in (1, 2, 3)]
    assert errors[0] < 0.5
    assert errors[1] < 0.1 * errors[0]
    assert errors[2] < 0.1 * errors[1]


@PIPELINES
def test_increments_add_up_to_the_values_and_measure_the_error_of_the_pass_before(pipeline: Pipeline) -> None:
    rng = np.random.default_rng(3)
    values = drawn_values(1, rng)[0]
    seen = observations(values, rng)
    one, two = pipeline(seen, iterations=1), pipeline(seen, iterations=2)
    np.testing.assert_allclose(sum(two.increments), two.values, rtol=1e-13)
    np.testing.assert_array_equal(two.increments[0], one.values)
    error = np.abs(values - one.values) / SIZES
    assert np.abs(two.increments[1] / SIZES - (values - one.values) / SIZES).max() < 0.15 * error.max()


@PIPELINES
def test_permuted_and_reversed_sensors_give_the_same_parameters(pipeline: Pipeline) -> None:
    axes = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
    values = drawn_values(1, np.random.default_rng(4))[0]
    straight = pipeline(observations(values, np.random.default_rng(5)))
    turned_round = pipeline(_rewired(observations(values, np.random.default_rng(5)), axes))
    signs = np.concatenate([axes.sum(axis=0), np.ones(6), axes.sum(axis=0), np.ones(9)])
    np.testing.assert_allclose(turned_round.values / SIZES, signs * straight.values / SIZES, atol=1e-9)
    np.testing.assert_allclose(turned_round.u, straight.u, rtol=1e-6)
    np.testing.assert_allclose(turned_round.accel.matrix, axes @ straight.accel.matrix, atol=1e-13)


def _rewired(seen: Observations, axes: Array) -> Observations:
    """The same launch recorded by sensors along other axes."""
    return replace(
        seen,
        accel_block=Block(kind="accel", axes=axes),
        gyro_block=Block(kind="gyro", axes=axes),
        rests=replace(seen.rests, accel=seen.rests.accel @ axes.T, gyro=seen.rests.gyro @ axes.T),
    )


@PIPELINES
def test_a_recording_without_gyros_gives_the_accelerometers(pipeline: Pipeline) -> None:
    values = drawn_values(1, np.random.default_rng(4))[0]
    seen = observations(values, np.random.default_rng(5))
    both = pipeline(seen)
    alone = pipeline(replace(seen, gyro_block=None, turns=None, turn_samples=None))
    assert alone.gyro is None
    assert alone.names == both.names[:9]
    np.testing.assert_array_equal(alone.values, both.values[:9])
    np.testing.assert_allclose(alone.covariance, both.covariance[:9, :9], rtol=1e-6)


# Covariance


def only(seen: Observations, what: str, index: int, σ: float) -> Observations:
    """The same observations with noise in one quantity: rest or turn `index`, second axis, or gravity."""
    if what == "gravity":
        return replace(seen, site=replace(seen.site, gravity_u=σ))
    part = seen.turns if what == "turns" else seen.rests
    name = {"accel": "accel_covariance", "gyro": "gyro_covariance", "turns": "covariance"}[what]
    covariance = getattr(part, name).copy()
    covariance[index, 1, 1] = σ**2
    changed = replace(part, **{name: covariance})
    return replace(seen, **{"turns" if what == "turns" else "rests": changed})


def shifted(seen: Observations, what: str, index: int, σ: float) -> Observations:
    """The same observations with that quantity changed by σ; a turn by a rotation after its first sample."""
    if what == "gravity":
        return replace(seen, site=replace(seen.site, gravity=seen.site.gravity + σ))
    if what == "turns":
        assert seen.turn_samples is not None
        old, new = seen.turn_samples.samples, GyroSamples()
        increments, dt = old.read(0, old.count)
        increments = increments.copy()
        first = int(seen.turn_samples.start[index])
        increments[[first - 1, first], 1] += σ
        new.append(increments / dt[:, None], dt)
        return replace(seen, turn_samples=replace(seen.turn_samples, samples=new))
    values = getattr(seen.rests, what).copy()
    values[index, 1] += σ
    return replace(seen, rests=replace(seen.rests, **{what: values}))


@PIPELINES
@pytest.mark.parametrize(
    ("what", "index", "σ"),
    [
        ("accel", 1, 1e-5),
        ("accel", 12, 1e-5),
        ("gyro", 4, 1e-9),
        ("gyro", 9, 1e-9),
        ("turns", 1, 1e-6),
        ("turns", 8, 1e-6),
        ("gravity", 0, 1e-5),
    ],
)
def test_covariance_is_what_a_change_of_the_data_does(pipeline: Pipeline, what: str, index: int, σ: float) -> None:
    """With noise in one quantity, the uncertainty is the change of the values when it changes by one sigma, through
    all passes."""
    rng = np.random.default_rng(6)
    values = drawn_values(1, rng)[0]
    seen = observations(values, rng, stated=1e-4)
    found = pipeline(only(seen, what, index, σ), iterations=6)
    high, low = (pipeline(shifted(seen, what, index, s * σ), iterations=6).values for s in (1, -1))
    change = (high - low) / 2
    expected = np.outer(change, change)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)).max())
    assert np.abs(change / SIZES).max() > 1e-6
    np.testing.assert_allclose(
        found.u / SIZES, np.abs(change) / SIZES, rtol=2e-3, atol=1e-3 * np.abs(change / SIZES).max()
    )
    assert scale > 0
