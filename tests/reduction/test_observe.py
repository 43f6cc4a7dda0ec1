"""Observations: are the rotations, their sensitivities and all covariances what they are said to be?

Statistical limits are more than five standard errors wide, so that a false alarm is rarer than 1e-6.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from tumble.earth import earth_rate
from tumble.planning.setup import Setup
from tumble.recording.log import Chunk
from tumble.recording.session import Site
from tumble.reduction.blocks import motion_samples as reduction
from tumble.reduction.blocks.reducer import Reducer, Reduction
from tumble.reduction.observations import Observations, observe
from tumble.reduction.rests.segmentation import Stretch, find_rests
from tumble.reduction.turns import turns
from tumble.reduction.turns.turns import TurnSamples, independent_sample_variances
from tumble.rotation import rotation_matrix, tangent_basis
from tumble.sensors.model import Block, SensorModel
from tumble.simulation.recording import Recording, record
from tumble.simulation.scenario import Scenario, scenario_of
from tumble.units import DEGREE, Array

LATITUDE = 56.84 * DEGREE
SITE = Site(latitude=LATITUDE, height=0.0, gravity=9.81, gravity_u=0.0)
TRIAD = Block(kind="accel", axes=np.eye(3)), Block(kind="gyro", axes=np.eye(3))
TETRAD_AXES = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [3**-0.5] * 3])
TETRAD = Block(kind="accel", axes=TETRAD_AXES), Block(kind="gyro", axes=TETRAD_AXES)


def reduced(
    accel: Array, gyro: Array | None, rate: float, blocks: tuple[Block, Block] = TRIAD, files: int = 1
) -> Reduction:
    """A log, or the same one several times as several files."""
    reducer = Reducer(rate=rate, accel=blocks[0], gyro=None if gyro is None else blocks[1])
    time = np.arange(1, len(accel) + 1) / rate
    for file in range(files):
        reducer.feed(
            Chunk(file=file, time=time, dt=np.full(len(time), 1 / rate), accel=accel, gyro=gyro, temperature=None)
        )
    return reducer.now()


def observed(reduction: Reduction, blocks: tuple[Block, Block] = TRIAD, *, gyros: bool = True) -> Observations:
    gyro = blocks[1] if gyros else None
    rests = find_rests(reduction, blocks[0], gyro).rests
    return observe(reduction, rests, blocks[0], gyro, SITE)


def between(
    reduction: Reduction, times: Iterable[tuple[float, float]], blocks: tuple[Block, Block] = TRIAD
) -> Observations:
    """Observations of rests stated by their times."""
    rests = tuple(Stretch.between(reduction.files[0], start, stop) for start, stop in times)
    return observe(reduction, rests, *blocks, SITE)


def noiseless(sample_rate: float, seed: int = 51) -> tuple[Scenario, Recording]:
    """Nine positions of a MEMS unit, rests of 5 s."""
    request = Setup.of(
        grade="mems", programme="nine", rest=5.0, rate_deg_s=30.0, sample_rate=sample_rate, noise_factor=0.0
    )
    scenario = scenario_of(request, np.random.default_rng(seed), serial="S")
    return scenario, record(scenario, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def session() -> tuple[Scenario, Recording, Observations]:
    scenario, recording = noiseless(100.0)
    return scenario, recording, observed(reduced(recording.accel, recording.gyro, 100.0))


def true_gyros(scenario: Scenario) -> SensorModel:
    return scenario.gyro.model(np.array([scenario.truth[name] for name in scenario.gyro.names]))


# -------------------- rotations --------------------


@pytest.mark.parametrize(("sample_rate", "tolerance"), [(50.0, 5e-11), (100.0, 1e-11), (400.0, 1e-12)])
def test_a_noiseless_move_is_the_true_rotation(sample_rate: float, tolerance: float) -> None:
    """Between two rests the body turns from one true attitude to the other, and the Earth turns both."""
    scenario, recording = noiseless(sample_rate)
    observations = observed(reduced(recording.accel, recording.gyro, sample_rate))
    turns = observations.turns_about(true_gyros(scenario))
    assert len(turns) == 8
    np.testing.assert_array_equal(np.column_stack([turns.first, turns.last]), [[i, i + 1] for i in range(8)])
    earth = np.array(earth_rate(scenario.setup.latitude))
    for k, T in enumerate(turns.duration):
        expected = recording.attitudes[k].T @ rotation_matrix(earth * T) @ recording.attitudes[k + 1]
        np.testing.assert_allclose(turns.C[k], expected, atol=tolerance)


def test_the_sensitivities_are_the_derivatives_of_the_rotation(
    session: tuple[Scenario, Recording, Observations],
) -> None:
    """Eq. C(E, δ) = exp([−(M : E + B δ)×]) C: what is left falls with the square of the change."""
    scenario, _, observations = session
    base = true_gyros(scenario)
    turns = observations.turns_about(base)
    rng = np.random.default_rng(52)
    E, delta = rng.standard_normal((3, 3)), 0.1 * rng.standard_normal(3)
    left = []
    for size in (1e-3, 1e-4):
        changed = SensorModel(
            matrix=(np.eye(3) + size * E) @ base.matrix,
            bias=base.bias + size * delta,
        )
        # ω̂ = (I + E) ω + δ about the base: reading = base.matrix ω̂ + base.bias
        changed = replace(changed, matrix=base.matrix @ (np.eye(3) + size * E))
        changed = replace(changed, bias=base.bias + base.matrix @ (size * delta))
        about = observations.turns_about(changed)
        angle = size * (np.einsum("kipq,pq->ki", turns.M, E) + turns.B @ delta)
        predicted = rotation_matrix(-angle) @ turns.C
        left.append(np.abs(about.C - predicted).max())
        assert np.abs(angle).max() > 0.5 * size  # something to predict
    assert left[0] < 3e-4
    assert left[1] < 0.015 * left[0]


def test_turns_about_a_model_are_those_of_the_compensated_log() -> None:
    """Also the sensitivities: as if the log had been compensated and integrated from scratch."""
    scenario, recording = noiseless(100.0)
    model = true_gyros(scenario)
    reduction = reduced(recording.accel, recording.gyro, 100.0)
    rests = find_rests(reduction, *TRIAD).rests
    match = rests
    about = observe(reduction, match, *TRIAD, SITE).turns_about(model)
    compensated = reduced(recording.accel, model.apply(recording.gyro), 100.0)
    scratch = observe(compensated, match, *TRIAD, SITE).turns
    assert scratch is not None
    np.testing.assert_allclose(about.C, scratch.C, atol=1e-12)
    np.testing.assert_allclose(about.M, scratch.M, atol=1e-11)
    np.testing.assert_allclose(about.B, scratch.B, atol=1e-11)


@pytest.mark.parametrize("batch", [1, 7, 100, 701])
def test_turns_cut_into_pieces_are_the_same(
    session: tuple[Scenario, Recording, Observations], batch: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario, _, observations = session
    whole = observations.turns_about(true_gyros(scenario))
    kept = observations.turn_samples
    assert kept is not None
    monkeypatch.setattr(turns, "BATCH_SAMPLES", batch)
    again = TurnSamples(samples=kept.samples, start=kept.start, stop=kept.stop)
    assert len(list(again.pieces())) > 1
    cut = replace(observations, turn_samples=again).turns_about(true_gyros(scenario))
    for name in ("C", "M", "B"):
        np.testing.assert_allclose(getattr(cut, name), getattr(whole, name), atol=5e-13)


@pytest.mark.parametrize("sizes", [(10_000,), (37,), (1,)])
def test_samples_on_disk_are_those_in_memory(sizes: tuple[int, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(53)
    rates, forces, dt = *rng.standard_normal((2, 2000, 3)), rng.uniform(0.009, 0.011, 2000)
    in_memory, on_disk = reduction.MotionSamples(), reduction.MotionSamples()
    edges = np.minimum(np.arange(0, 2000 + sizes[0], sizes[0]), 2000)
    for samples, limit in ((in_memory, 10**9), (on_disk, 10_000)):
        monkeypatch.setattr(reduction, "IN_MEMORY_BYTES", limit)
        for a, b in pairwise(edges.tolist()):
            samples.append(rates[a:b], forces[a:b], dt[a:b])
    for start, stop in ((0, 2000), (1, 2), (300, 1700), (1999, 2000)):
        for one, other in zip(in_memory.read(start, stop), on_disk.read(start, stop), strict=True):
            np.testing.assert_array_equal(one, other)
        for one, other in zip(in_memory.read(start, stop), (rates, forces, dt), strict=True):
            np.testing.assert_array_equal(one, other[start:stop])


def test_observations_do_not_depend_on_where_the_samples_are(monkeypatch: pytest.MonkeyPatch) -> None:
    _, recording = noiseless(100.0)
    one = observed(reduced(recording.accel, recording.gyro, 100.0))
    monkeypatch.setattr(reduction, "IN_MEMORY_BYTES", 50_000)
    other = observed(reduced(recording.accel, recording.gyro, 100.0))
    assert one.turns is not None
    assert other.turns is not None
    np.testing.assert_array_equal(one.turns.C, other.turns.C)
    np.testing.assert_array_equal(one.rests.accel, other.rests.accel)


def test_four_gyros_carry_the_body_as_three_do() -> None:
    scenario, recording = noiseless(100.0)
    true = true_gyros(scenario).apply(recording.gyro)
    three = observed(reduced(recording.accel, true, 100.0))
    four = observed(reduced(recording.accel @ TETRAD_AXES.T, true @ TETRAD_AXES.T, 100.0, TETRAD), TETRAD)
    assert three.turns is not None
    assert four.turns is not None
    np.testing.assert_allclose(four.turns.C, three.turns.C, atol=1e-12)
    assert three.turn_readings is None
    assert four.turn_readings is not None
    for k, rest in enumerate(four.rests.stop[:-1]):
        between = slice(round(rest * 100.0), round(four.rests.start[k + 1] * 100.0))
        expected = true[between].sum(axis=0) @ TETRAD_AXES.T / 100.0
        np.testing.assert_allclose(four.turn_readings.integral[k], expected, atol=1e-11)


def test_no_turn_goes_from_one_file_to_the_next() -> None:
    _, recording = noiseless(50.0)
    observations = observed(reduced(recording.accel, recording.gyro, 50.0, files=2))
    assert len(observations.rests) == 18
    turns = observations.turns
    assert turns is not None
    assert len(turns) == 16
    np.testing.assert_array_equal(turns.first, [*range(8), *range(9, 17)])
    np.testing.assert_array_equal(turns.last, turns.first + 1)
    np.testing.assert_allclose(turns.C[8:], turns.C[:8], atol=1e-13)


def test_without_gyros_there_are_no_turns() -> None:
    _, recording = noiseless(50.0)
    observations = observed(reduced(recording.accel, None, 50.0), gyros=False)
    assert observations.turns is None
    assert observations.rests.gyro.shape == (9, 0)
    with pytest.raises(ValueError, match="turns_about"):
        observations.turns_about(TRIAD[1].nominal())


# -------------------- means, drift and noise of rests --------------------


def test_the_mean_of_a_rest_is_the_mean_of_its_samples() -> None:
    rng = np.random.default_rng(54)
    accel, gyro = np.array([0.0, 9.8, 0.0]) + rng.standard_normal((1000, 3)), rng.standard_normal((1000, 3))
    rests = between(reduced(accel, gyro, 50.0), [(1.0, 7.0), (12.0, 20.0)]).rests
    np.testing.assert_allclose(rests.accel, [accel[50:350].mean(axis=0), accel[600:].mean(axis=0)], atol=1e-12)
    np.testing.assert_allclose(rests.gyro, [gyro[50:350].mean(axis=0), gyro[600:].mean(axis=0)], atol=1e-12)


def test_the_drift_of_a_rest_is_its_slope_times_its_duration() -> None:
    slope_a, slope_g = np.array([1e-3, -2e-3, 5e-4]), np.array([1e-4, 0.0, -3e-4])  # per second
    time = np.arange(1, 2001)[:, None] / 50.0
    accel, gyro = np.array([0.0, 9.8, 0.0]) + slope_a * time, slope_g * time
    rests = between(reduced(accel, gyro, 50.0), [(2.0, 12.0), (15.0, 35.0)]).rests
    np.testing.assert_allclose(rests.accel_drift, np.outer([10.0, 20.0], slope_a), atol=1e-12)
    np.testing.assert_allclose(rests.gyro_drift, np.outer([10.0, 20.0], slope_g), atol=1e-14)


def test_the_noise_density_is_that_of_the_samples() -> None:
    """Nine rests of 60 s and three channels; the standard error of a fitted density is below 4 %."""
    rng = np.random.default_rng(55)
    accel = np.array([0.0, 9.8, 0.0]) + 2e-3 * np.sqrt(20.0) * rng.standard_normal((12_000, 3))
    gyro = 1e-4 * np.sqrt(20.0) * rng.standard_normal((12_000, 3))
    rests = between(reduced(accel, gyro, 20.0), [(66.0 * i, 66.0 * i + 60.0) for i in range(9)]).rests
    np.testing.assert_allclose(rests.accel_noise, 2e-3, rtol=0.25)
    np.testing.assert_allclose(rests.gyro_noise, 1e-4, rtol=0.25)


def chi_square_of_means(observations: Observations, truth: Array, directions: Array) -> Array:
    """(means − truth)² over their variance, along given unit directions (N, d, n) of the accelerometers."""
    rests = observations.rests
    off = np.einsum("ndp,np->nd", directions, rests.accel - truth)
    return np.asarray(off**2 / np.einsum("ndp,npq,ndq->nd", directions, rests.accel_covariance, directions))


VERTICALS = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.6, 0.0, 0.8], [3**-0.5] * 3] * 3)


@pytest.mark.parametrize("blocks", [TRIAD, TETRAD])
def test_the_covariance_of_a_mean_is_that_of_repeated_rests(blocks: tuple[Block, Block]) -> None:
    """Rests of 20 s, white noise of different size in every channel: five sessions of 120, 600 rests."""
    rng = np.random.default_rng(56)
    axes = blocks[0].axes
    density = np.array([1e-3, 3e-3, 5e-4, 2e-3])[: len(axes)]
    squares = []
    truth = 9.81 * np.tile(VERTICALS, (8, 1)) @ axes.T
    for _ in range(5):
        accel = np.repeat(truth, 400, axis=0) + density * np.sqrt(20.0) * rng.standard_normal((48_000, len(axes)))
        reduction = reduced(accel, 1e-4 * rng.standard_normal(accel.shape), 20.0, blocks)
        observations = between(reduction, [(20.0 * i, 20.0 * i + 20.0) for i in range(120)], blocks)
        every = np.broadcast_to(np.eye(len(axes)), (120, len(axes), len(axes)))
        squares.append(chi_square_of_means(observations, truth, every))
    found = np.mean(squares, axis=(0, 1))
    np.testing.assert_allclose(found, 1.02, atol=5.5 * np.sqrt(2 / 600))


def test_a_rest_that_slowly_tilts_keeps_the_certainty_of_its_vertical() -> None:
    """Feet that sink by 0.05° as a random walk: the horizontal readings move by ten times their noise, the vertical
    one does not. Five sessions of 90 rests, 450."""
    rng = np.random.default_rng(57)
    vertical_squares, horizontal_squares, share = [], [], []
    verticals = np.tile(VERTICALS, (6, 1))
    truth, horizontal = 9.81 * verticals, tangent_basis(verticals)
    for _ in range(5):
        tilt = np.cumsum(rng.standard_normal((90, 400, 2)), axis=1) * 0.05 * DEGREE / 20.0
        tilt -= tilt.mean(axis=1, keepdims=True)  # what the rest was on average is the truth
        force = truth[:, None, :] + 9.81 * np.einsum("rkd,rdp->rkp", tilt, horizontal)
        accel = force.reshape(-1, 3) + 1e-3 * np.sqrt(20.0) * rng.standard_normal((36_000, 3))
        reduction = reduced(accel, 1e-4 * rng.standard_normal((36_000, 3)), 20.0)
        observations = between(reduction, [(20.0 * i, 20.0 * i + 20.0) for i in range(90)])
        vertical_squares.append(chi_square_of_means(observations, truth, verticals[:, None, :]))
        horizontal_squares.append(chi_square_of_means(observations, truth, horizontal))
        share.append(np.einsum("np,npq,nq->n", verticals, observations.rests.accel_covariance, verticals) * 20.0 / 1e-6)
    assert np.mean(vertical_squares) == pytest.approx(1.02, abs=5.5 * np.sqrt(2 / 450))
    assert np.mean(share) == pytest.approx(1.0, abs=0.1)  # nothing of the tilt
    assert np.mean(horizontal_squares) < 0.1  # it passes for noise that a mean does not get rid of


def test_a_resolution_coarser_than_the_noise_stays_in_the_covariance() -> None:
    """Readings in steps of 0.02 m/s² without noise: the error of a mean is up to half a step however long it is."""
    step = 0.02
    accel = np.round(np.repeat(9.81 * VERTICALS[:5], 400, axis=0) / step) * step
    reduction = reduced(accel, np.zeros((2000, 3)), 20.0)
    rests = between(reduction, [(20.0 * i, 20.0 * i + 20.0) for i in range(5)]).rests
    u = np.sqrt(np.diagonal(rests.accel_covariance, axis1=1, axis2=2))
    assert np.all(u > 0.2 * step)


# -------------------- noise of turns --------------------


@pytest.mark.parametrize("correlation_time", [0.0, 0.5])
def test_the_covariance_of_a_turn_is_that_of_repeated_turns(correlation_time: float) -> None:
    """Two turns of 180° in 12 s between rests of 30 s, gyros of different noise, each ten times in a log, in 20 logs:
    χ² of a rotation has three degrees of freedom. The noise comes from the 21 rests."""
    rng = np.random.default_rng(58)
    rate, rest, turn, pairs = 20.0, 600, 240, 10
    profile = np.pi * np.sin(np.pi * np.arange(turn) / turn) ** 2
    profile *= np.pi * rate / profile.sum()
    still, axes = np.zeros((rest, 3)), ([1.0, 0.0, 0.0], [0.0, -0.6, -0.8])
    omega = np.concatenate([still, *(part for axis in axes * pairs for part in (profile[:, None] * axis, still))])
    force = np.tile([0.0, 9.81, 0.0], (len(omega), 1))
    density = np.array([1e-4, 2e-4, 5e-5])
    times = [(42.0 * i, 42.0 * i + 30.0) for i in range(2 * pairs + 1)]
    true = between(reduced(force, omega, rate), times).turns
    assert true is not None
    memory = np.exp(-1.0 / (rate * correlation_time)) if correlation_time else 0.0
    errors, squares, said = [], [], []
    for _ in range(20):
        white = density * np.sqrt(rate) * rng.standard_normal((len(omega) + 200, 3))
        noise = lfilter([1.0 - memory], [1.0, -memory], white, axis=0)[200:]
        turns = between(reduced(force, omega + noise, rate), times).turns
        assert turns is not None
        error = Rotation.from_matrix(turns.C @ np.swapaxes(true.C, 1, 2)).as_rotvec()
        errors += [*error.reshape(pairs, 2, 3)]
        said += [*turns.covariance.reshape(pairs, 2, 3, 3)]
        squares.append(np.einsum("ki,kij,kj->k", error, np.linalg.inv(turns.covariance), error))
    seen = np.einsum("nki,nkj->kij", errors, errors) / 200
    scale = np.sqrt(np.einsum("kii,kjj->kij", *2 * [np.mean(said, axis=0)]))
    np.testing.assert_allclose(seen / scale, np.mean(said, axis=0) / scale, atol=0.15 + 5.5 * np.sqrt(2 / 200))
    assert np.mean(squares) / 3 == pytest.approx(1.05, abs=0.1 + 5.5 * np.sqrt(2 / 3 / 400))


def test_what_changes_from_sample_to_sample_is_the_error_of_a_rotation() -> None:
    """Of white rates the variance of their integral; of a motion by hand that its samples follow next to nothing."""
    count, dt, size = 20_000, 0.016, 0.05
    time = dt * np.arange(count)
    white = size * np.random.default_rng(5).standard_normal((count, 3))
    swinging = np.outer(3.0 * np.sin(2.0 * np.pi * 2.0 * time), [1.0, 0.0, 0.0])
    kept = reduction.MotionSamples()
    for rates in (white, swinging):
        kept.append(rates, np.zeros((count, 3)), np.full(count, dt))
    samples = TurnSamples(samples=kept, start=np.array([0, count]), stop=np.array([count, 2 * count]))
    of_white, of_swinging = independent_sample_variances(samples)
    assert of_white == pytest.approx(count * (size * dt) ** 2, rel=0.1)
    assert np.sqrt(of_swinging) < 2e-3 * 3.0 * dt * np.sqrt(count)
