"""The staged method: exact without noise, honest with it.

Observations are made directly: rests at true attitudes, turns as rotations at constant rate about an axis fixed
in the non-rotating frame, so that a few samples a turn are exact; noise on the mean readings and on the samples of
the turns. So a session takes milliseconds. Statistical limits are at least five standard errors wide, so that a
false alarm is rarer than 1e-6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support import staged as stages
from tests.support.staged import SphereRows, sphere_rows, staged
from tumble.diagnosis.verdict import verdict
from tumble.earth import EARTH_RATE, earth_rate
from tumble.inference.estimate import Estimate
from tumble.programme.positions import attitude, programme
from tumble.recording.session import Site
from tumble.reduction.blocks.motion_samples import MotionSamples
from tumble.reduction.noise.coloured_noise import WHITE
from tumble.reduction.observations import Observations
from tumble.reduction.rests.rests import ACCEL_FLOOR, GYRO_FLOOR, Rests
from tumble.reduction.turns.turns import TURN_FLOOR, TurnReadings, Turns, TurnSamples
from tumble.rotation import rotation_matrix
from tumble.sensors.model import Block
from tumble.units import ARCSEC, DEGREE, DEGREE_PER_HOUR, Array

SITE = Site(latitude=56.84 * DEGREE, height=0.0, gravity=9.8159, gravity_u=0.0)
TRIAD = np.eye(3)
PERMUTED = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
NEGATIVE = np.diag([1.0, -1.0, -1.0])
TETRAD = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [3**-0.5] * 3])
PYRAMID = np.array([[0.8 * np.cos(a), 0.8 * np.sin(a), 0.6] for a in np.arange(4) * np.pi / 2.0])
SAMPLES = 48
FACES = ("UEN", "DWN", "NUE", "NDW", "ENU", "WND")
OBLIQUE = ("UEN N+45", "UNW N-45", "NUE N+45")


# -------------------- sessions without a log --------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class Course:
    """True attitudes (N, 3, 3), body → geographic, and the moves between them as rotation vectors (N − 1, 3) of the
    body at the start, in the non-rotating frame, with their durations."""

    attitudes: Array
    moves: Array
    durations: Array


@dataclass(frozen=True, kw_only=True, slots=True)
class Noise:
    """Densities (m/s²/√Hz, rad/s/√Hz), seconds of a rest, and scatter between rests (m/s², rad/s) and of turns."""

    accel: float = 0.0
    gyro: float = 0.0
    seconds: float = 60.0
    accel_scatter: float = 0.0
    gyro_scatter: float = 0.0
    turn_scatter: float = 0.0


NAVIGATION = Noise(accel=1e-4, gyro=0.003 * DEGREE / 60.0)
MEMS = Noise(accel=1.5e-3, gyro=0.01 * DEGREE, seconds=5.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class Unit:
    """Two blocks and the true values of their parameters."""

    accel: Block
    gyro: Block
    truth: Array

    @property
    def accel_truth(self) -> Array:
        return self.truth[: len(self.accel.names)]

    @property
    def gyro_truth(self) -> Array:
        return self.truth[len(self.accel.names) :]


FINE = (2e-3, 1e-4, 25 * ARCSEC, 0.3 * DEGREE_PER_HOUR, 1e-4, 10 * ARCSEC)
COARSE = (5e-2, 6e-3, 4e-3, 1e-2, 6e-3, 4e-3)
"""Standard deviations of accelerometer biases, scale factors, angles, and of the gyros'."""


def unit(
    rng: np.random.Generator, sizes: Sequence[float] = FINE, accel_axes: Array = TRIAD, gyro_axes: Array = TRIAD
) -> Unit:
    accel, gyro = Block(kind="accel", axes=accel_axes), Block(kind="gyro", axes=gyro_axes)
    kinds = ["accel.bias", "accel.scale", "accel.axis", "gyro.bias", "gyro.scale", "gyro.axis"]
    size = dict(zip(kinds, sizes, strict=True))
    spread = np.array([size[".".join(name.split(".")[:2])] for name in accel.names + gyro.names])
    return Unit(accel=accel, gyro=gyro, truth=spread * rng.standard_normal(len(spread)))


def course(attitudes: Array, wanted: Sequence[Array | None], rate: float, latitude: float = 56.84 * DEGREE) -> Course:
    """Moves of the wanted rotation vectors (geographic), or the shorter way, at a rate and with a second more."""
    earth = np.array(earth_rate(latitude))
    moves, durations = [], []
    for start, end, want in zip(attitudes[:-1], attitudes[1:], wanted, strict=True):
        way = Rotation.from_matrix(end @ start.T).as_rotvec()
        other = way * (1.0 - 2.0 * np.pi / np.linalg.norm(way))
        if want is not None and np.linalg.norm(other - want) < np.linalg.norm(way - want):
            way = other
        T = float(np.linalg.norm(way)) / rate + 1.0
        inertial = Rotation.from_matrix(start.T @ rotation_matrix(earth * T) @ end).as_rotvec()
        if np.linalg.norm(inertial - start.T @ way) > np.pi:
            inertial *= 1.0 - 2.0 * np.pi / np.linalg.norm(inertial)
        moves.append(inertial)
        durations.append(T)
    return Course(attitudes=attitudes, moves=np.array(moves).reshape(-1, 3), durations=np.array(durations))


def rough_table(rng: np.random.Generator, error: float = 1.5 * DEGREE) -> Course:
    listed = programme("rough-table")
    nominal = np.array([p.matrix for p in listed.positions])
    table = rotation_matrix(error * rng.uniform(-1.0, 1.0, (15, 3)))
    mounting = rotation_matrix(error * rng.uniform(-1.0, 1.0, 3))
    wanted = [None if m.axis is None or m.angle is None else m.angle * m.axis for m in listed.moves]
    return course(table @ nominal @ mounting, wanted, 10.0 * DEGREE)


def in_the_hand(rng: np.random.Generator, positions: int = 30) -> Course:
    attitudes = Rotation.random(positions, random_state=rng).as_matrix()
    return course(attitudes, [None] * (positions - 1), 80.0 * DEGREE)


def at(codes: Sequence[str]) -> Course:
    return course(np.array([attitude(c) for c in codes]), [None] * (len(codes) - 1), 10.0 * DEGREE)


def observations(
    device: Unit,
    way: Course,
    rng: np.random.Generator,
    noise: Noise = Noise(),
    site: Site = SITE,
    samples: int = SAMPLES,
) -> Observations:
    """What is left of a session in which this happened."""
    N, na, ng = len(way.attitudes), device.accel.size, device.gyro.size
    accel, gyro = device.accel.model(device.accel_truth), device.gyro.model(device.gyro_truth)
    force = SITE.gravity * way.attitudes[:, 1]
    rate = np.einsum("nij,i->nj", way.attitudes, np.array(earth_rate(56.84 * DEGREE)))
    u_accel, u_gyro = noise.accel / np.sqrt(noise.seconds), noise.gyro / np.sqrt(noise.seconds)
    rests = Rests(
        file=np.zeros(N, dtype=np.int64),
        start=np.linspace(0.0, 100.0 * (N - 1), N),
        stop=np.linspace(0.0, 100.0 * (N - 1), N) + noise.seconds,
        accel=accel.predict(force) + np.hypot(u_accel, noise.accel_scatter) * rng.standard_normal((N, na)),
        accel_covariance=np.tile((u_accel**2 + ACCEL_FLOOR**2) * np.eye(na), (N, 1, 1)),
        accel_drift=np.zeros((N, na)),
        accel_noise=np.full((N, na), noise.accel),
        gyro=gyro.predict(rate) + np.hypot(u_gyro, noise.gyro_scatter) * rng.standard_normal((N, ng)),
        gyro_covariance=np.tile((u_gyro**2 + GYRO_FLOOR**2) * np.eye(ng), (N, 1, 1)),
        gyro_drift=np.zeros((N, ng)),
        gyro_noise=np.full((N, ng), noise.gyro),
        temperatures=None,
    )
    stored, integrals = MotionSamples(), []
    to_body = np.linalg.pinv(device.gyro.axes)
    for move, T in zip(way.moves, way.durations, strict=True):
        dt = T / samples
        knocked = rotation_matrix(noise.turn_scatter * rng.standard_normal(3))
        turned = Rotation.from_matrix(knocked @ rotation_matrix(move)).as_rotvec() if noise.turn_scatter else move
        if np.linalg.norm(turned - move) > np.pi:
            turned *= 1.0 - 2.0 * np.pi / np.linalg.norm(turned)
        readings = np.tile(gyro.predict(turned / T), (samples + 1, 1))
        readings[1:] += noise.gyro / np.sqrt(dt) * rng.standard_normal((samples, ng))
        stored.append(readings @ to_body.T, np.zeros((samples + 1, 3)), np.full(samples + 1, dt))
        integrals.append(readings[1:].sum(axis=0) * dt)
    start = 1 + (samples + 1) * np.arange(len(way.moves))
    kept = TurnSamples(samples=stored, start=start, stop=start + samples)
    floor = TURN_FLOOR**2 * np.eye(3)
    turns = Turns(
        first=np.arange(N - 1),
        last=np.arange(1, N),
        duration=way.durations,
        C=np.broadcast_to(
            np.eye(3), (N - 1, 3, 3)
        ),  # of no interest to the method: it asks for the turns about a model
        M=np.zeros((N - 1, 3, 3, 3)),
        B=np.zeros((N - 1, 3, 3)),
        covariance=noise.gyro**2 * way.durations[:, None, None] * (to_body @ to_body.T) + floor,
        arising=np.full(N - 1, WHITE),
        velocity_covariance=np.broadcast_to(np.eye(3), (N - 1, 3, 3)),
        jumps=np.zeros(N - 1),
        aliased=np.zeros(N - 1),
    )
    return Observations(
        accel_block=device.accel,
        gyro_block=device.gyro,
        site=site,
        rests=rests,
        turns=turns,
        turn_samples=kept,
        programme=None,
        position=None,
        turn_readings=_turn_readings(integrals, noise, way) if ng > 3 else None,
    )


def _turn_readings(integrals: list[Array], noise: Noise, way: Course) -> TurnReadings:
    count = len(integrals[0])
    variance = noise.gyro**2 * way.durations + TURN_FLOOR**2
    return TurnReadings(integral=np.array(integrals), covariance=variance[:, None, None] * np.eye(count))


def error_of(estimate: Estimate, device: Unit) -> Array:
    return estimate.values - device.truth


# -------------------- without noise --------------------


@pytest.mark.parametrize("axes", [TRIAD, PERMUTED, NEGATIVE], ids=["xyz", "permuted", "negative"])
@pytest.mark.parametrize("sizes", [FINE, COARSE], ids=["fine", "coarse"])
def test_noiseless_parameters_are_recovered(axes: Array, sizes: Sequence[float]) -> None:
    """All 21, on a rough table and in the hand."""
    rng = np.random.default_rng(71)
    for way in (rough_table(rng), in_the_hand(rng, 15)):
        for gyro_axes in (TRIAD, axes):
            device = unit(rng, sizes, axes, gyro_axes)
            estimate = staged(observations(device, way, rng))
            assert estimate.converged
            assert estimate.unobservable == ()
            np.testing.assert_allclose(estimate.values, device.truth, rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(estimate.rest_residual, 0.0, atol=1e-9)


def test_four_noiseless_accelerometers_are_recovered() -> None:
    """Eight more parameters than a triad has; each rest says two things."""
    rng = np.random.default_rng(72)
    for way in (rough_table(rng), in_the_hand(rng, 15)):
        device = unit(rng, COARSE, TETRAD)
        estimate = staged(observations(device, way, rng))
        assert len(estimate.values) == 4 + 4 + 5 + 12
        assert estimate.unobservable == ()
        np.testing.assert_allclose(estimate.values, device.truth, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("axes", [TETRAD, PYRAMID], ids=["diagonal", "pyramid"])
def test_four_noiseless_accelerometers_and_gyros_are_recovered(axes: Array) -> None:
    """The readings of four gyros also have to agree with each other, at rest and in the turns."""
    rng = np.random.default_rng(72)
    for way in (rough_table(rng), in_the_hand(rng, 15)):
        device = unit(rng, COARSE, axes, axes)
        estimate = staged(observations(device, way, rng))
        assert len(estimate.values) == 4 + 4 + 5 + 4 + 4 + 8
        assert estimate.converged
        assert estimate.unobservable == ()
        np.testing.assert_allclose(estimate.values, device.truth, rtol=0.0, atol=1e-9)


def test_without_gyros_the_accelerometer_parameters_are_recovered() -> None:
    rng = np.random.default_rng(73)
    device = unit(rng, COARSE)
    seen = replace(observations(device, in_the_hand(rng), rng), gyro_block=None, turns=None, turn_samples=None)
    estimate = staged(seen)
    assert estimate.names == device.accel.names
    assert estimate.gyro is None
    np.testing.assert_allclose(estimate.values, device.accel_truth, rtol=0.0, atol=1e-9)


# -------------------- Jacobians --------------------


@pytest.mark.parametrize("axes", [TRIAD, PERMUTED, TETRAD], ids=["triad", "permuted", "tetrad"])
def test_the_rest_rows_have_the_right_derivatives(axes: Array) -> None:
    rng = np.random.default_rng(74)
    device = unit(rng, COARSE, axes)
    seen = observations(device, in_the_hand(rng, 12), rng)

    def rows_at(values: Array, gravity: float = SITE.gravity) -> SphereRows:
        return sphere_rows(device.accel, seen.rests.accel, seen.rests.accel_covariance, gravity, values, 0.0)

    rows = rows_at(device.accel_truth)
    found = np.empty_like(rows.jacobian)
    for k, step in enumerate(1e-5 * np.eye(len(device.accel_truth))):
        ahead, behind = rows_at(device.accel_truth + step).residual, rows_at(device.accel_truth - step).residual
        found[..., k] = -(ahead - behind) / 2e-5
    np.testing.assert_allclose(rows.jacobian, found, atol=1e-6 * np.abs(found).max())
    heavier, lighter = (rows_at(device.accel_truth, SITE.gravity + sign * 1e-4).residual for sign in (1.0, -1.0))
    np.testing.assert_allclose(rows.modulus, -(heavier - lighter) / 2e-4, rtol=1e-6)


@pytest.mark.parametrize("axes", [TRIAD, PERMUTED], ids=["triad", "permuted"])
def test_the_gyro_rows_have_the_right_derivatives(axes: Array) -> None:
    """The turns integrated again about every changed value; samples fine enough for the midpoint rule of M and B."""
    rng = np.random.default_rng(75)
    device = unit(rng, COARSE, TRIAD, axes)
    way = rough_table(rng)
    way = Course(attitudes=way.attitudes[:6], moves=way.moves[:5], durations=way.durations[:5])
    seen = observations(device, way, rng, samples=3000)
    seen = replace(seen, rests=replace(seen.rests, gyro_covariance=1e-14 * seen.rests.gyro_covariance))
    rng_full = np.random.default_rng(75)
    accel = stages.estimate_accelerometers(observations(device, in_the_hand(rng_full), rng_full))
    accel = replace(accel, vertical=way.attitudes[:, 1], gain=accel.gain[:, :6])

    def rows(values: Array) -> stages.GyroRows:
        turns = seen.turns_about(device.gyro.model(values))
        return stages.gyro_rows(seen, accel, turns, values, dict.fromkeys(stages.GROUPS, 0.0))

    found = np.empty((18 + 10, 12))
    for k, step in enumerate(1e-6 * np.eye(12)):
        found[:, k] = -(rows(device.gyro_truth + step).residual - rows(device.gyro_truth - step).residual) / 2e-6
    jacobian = rows(device.gyro_truth).jacobian
    scale = np.abs(found).max(axis=0)
    np.testing.assert_allclose(jacobian[:18] / scale, found[:18] / scale, atol=1e-6)
    np.testing.assert_allclose(jacobian[18:] / scale, found[18:] / scale, atol=1e-6)
    assert np.linalg.matrix_rank(found) == 12


# -------------------- with noise --------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class Trials:
    """Normalised errors (n, m) of many sessions, Mahalanobis distances (n,), and chi-squares, degrees and scatters
    by what they judge, (n, 3, 3)."""

    normalised: Array
    distance: Array
    fits: Array


def trials(count: int, seed: int, noise: Noise, *, hand: int = 0) -> Trials:
    """Sessions on a rough table, or in the hand with so many positions."""
    rng = np.random.default_rng(seed)
    normalised, distance, fits = [], [], []
    for _ in range(count):
        device = unit(rng, COARSE if hand else FINE)
        way = in_the_hand(rng, hand) if hand else rough_table(rng)
        estimate = staged(observations(device, way, rng, noise))
        error = error_of(estimate, device)
        normalised.append(error / estimate.u)
        distance.append(error @ np.linalg.solve(estimate.covariance, error))
        fits.append([(f.chi_square, f.degrees, f.scatter) for f in estimate.fits.values()])
    return Trials(normalised=np.array(normalised), distance=np.array(distance), fits=np.array(fits))


@pytest.fixture(scope="module")
def table_trials() -> Trials:
    """300 sessions on a rough table, noise of navigation grade, no scatter looked for."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tumble.methods.least_squares.SCATTER_PROBABILITY", 0.0)
        return trials(300, 76, NAVIGATION)


def test_normalised_errors_have_unit_rms(table_trials: Trials) -> None:
    """Each of the 21 parameters: rms 1 with a standard error of 0.041; all of them 1.000 with one of about 0.01."""
    rms = np.sqrt((table_trials.normalised**2).mean(axis=0))
    np.testing.assert_allclose(rms, 1.0, atol=5.5 / np.sqrt(2 * 300))
    assert np.sqrt((rms**2).mean()) == pytest.approx(1.0, abs=0.06)
    np.testing.assert_allclose(table_trials.normalised.mean(axis=0), 0.0, atol=5.5 / np.sqrt(300))


def test_95_percent_intervals_cover_95_percent(table_trials: Trials) -> None:
    """6300 intervals, not independent within a session: standard error at most 0.2/√300 = 0.0126 · 0.5."""
    covered = np.abs(table_trials.normalised) < 1.96
    assert covered.mean() == pytest.approx(0.95, abs=0.03)
    assert np.all(covered.mean(axis=0) > 0.95 - 5.5 * np.sqrt(0.95 * 0.05 / 300))


def test_the_covariance_is_that_of_the_errors(table_trials: Trials) -> None:
    """The Mahalanobis distance of 21 errors has a mean of 21, standard error √(42/300) = 0.37: correlations, also those
    between accelerometers and gyros, are right."""
    assert table_trials.distance.mean() == pytest.approx(21.0, abs=2.1)


def test_chi_squares_have_the_mean_of_their_degrees(table_trials: Trials) -> None:
    """Accelerometers, gyros at rest, turns. The Earth's rate over the horizon counts as random, which on a table it is
    not: the rests' chi-square scatters less than it should."""
    chi_square, degrees, _ = table_trials.fits.mean(axis=0).T
    assert degrees[0] == pytest.approx(6.0)
    assert np.all(np.abs(chi_square - degrees) < 5.5 * np.sqrt(2.0 * degrees / 300))


def test_noise_in_the_hand_is_honest_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """MEMS, 50 sessions of 12 positions; the standard error of an rms is 0.1."""
    monkeypatch.setattr("tumble.methods.least_squares.SCATTER_PROBABILITY", 0.0)
    found = trials(50, 77, MEMS, hand=12)
    rms = np.sqrt((found.normalised**2).mean(axis=0))
    np.testing.assert_allclose(rms, 1.0, atol=5.5 / np.sqrt(2 * 50))
    assert found.distance.mean() == pytest.approx(21.0, abs=5.5 * np.sqrt(42 / 50))


def test_noise_in_four_accelerometers_and_gyros_is_honest_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """20 sessions of 29 parameters; the standard error of the rms of all is below 0.06."""
    monkeypatch.setattr("tumble.methods.least_squares.SCATTER_PROBABILITY", 0.0)
    rng = np.random.default_rng(88)
    distance, normalised = [], []
    for _ in range(20):
        device = unit(rng, FINE, TETRAD, TETRAD)
        estimate = staged(observations(device, rough_table(rng), rng, NAVIGATION))
        error = error_of(estimate, device)
        normalised.append(error / estimate.u)
        distance.append(error @ np.linalg.solve(estimate.covariance, error))
    assert np.sqrt(np.mean(np.square(normalised))) == pytest.approx(1.0, abs=0.3)
    assert np.mean(distance) == pytest.approx(29.0, abs=5.5 * np.sqrt(58 / 20))


def test_looking_for_scatter_where_there_is_none_costs_little() -> None:
    """30 sessions as the method comes."""
    found = trials(30, 78, NAVIGATION)
    assert 0.8 < np.sqrt((found.normalised**2).mean()) < 1.1


@pytest.mark.parametrize("times", [3.0, 20.0])
def test_scatter_between_rests_is_found_and_counts(times: float) -> None:
    """Biases that differ from rest to rest by so many times the noise of a mean: 25 sessions. Six degrees of freedom
    know the scatter of the accelerometers to 30 %, so that their errors are Student's: rms 1.22."""
    u_accel, u_gyro = NAVIGATION.accel / np.sqrt(60.0), NAVIGATION.gyro / np.sqrt(60.0)
    noise = replace(NAVIGATION, accel_scatter=times * u_accel, gyro_scatter=times * u_gyro)
    found = trials(25, 79, noise)
    accel, rests, _ = found.fits[:, :, 2].T
    assert np.mean(accel) / (times * u_accel) == pytest.approx(0.92, abs=0.35)
    assert np.mean(rests) / (times * u_gyro) == pytest.approx(1.0, abs=0.15)
    assert np.all(rests > 0.0)
    rms = np.sqrt((found.normalised**2).mean(axis=0))
    assert 0.9 < np.sqrt((rms[:9] ** 2).mean()) < 1.5
    assert 0.8 < np.sqrt((rms[9:] ** 2).mean()) < 1.2


def test_scatter_of_turns_is_found_and_counts() -> None:
    """Turns off by 20″, thirty times their noise: 20 sessions."""
    found = trials(20, 80, replace(NAVIGATION, turn_scatter=20 * ARCSEC))
    turns = found.fits[:, 2, 2]
    assert np.mean(turns) == pytest.approx(20 * ARCSEC, rel=0.25)
    assert 0.8 < np.sqrt((found.normalised[:, 9:] ** 2).mean()) < 1.3


def test_scatter_makes_the_uncertainties_grow_with_it() -> None:
    """u of the accelerometer parameters goes with the quadratic sum of noise and scatter."""
    rng = np.random.default_rng(81)
    device, way = unit(rng), rough_table(rng)
    quiet = staged(observations(device, way, rng, NAVIGATION))
    u = NAVIGATION.accel / np.sqrt(60.0)
    loud = staged(observations(device, way, rng, replace(NAVIGATION, accel_scatter=50.0 * u)))
    scatter = loud.fits["accelerometers"].scatter
    assert scatter > 10.0 * u
    ratio = loud.u[:9] / quiet.u[:9]
    expected = np.hypot(scatter, u) / np.hypot(quiet.fits["accelerometers"].scatter, u)
    np.testing.assert_allclose(ratio, expected, rtol=0.01)


def test_a_single_bad_rest_is_named() -> None:
    """One rest of 30 off by 40 times its noise: the outcome says which."""
    rng = np.random.default_rng(82)
    device = unit(rng, COARSE)
    seen = observations(device, in_the_hand(rng), rng, MEMS)
    accel = seen.rests.accel.copy()
    accel[11] += 40.0 * MEMS.accel / np.sqrt(5.0) * seen.rests.accel[11] / SITE.gravity
    spoiled = replace(seen, rests=replace(seen.rests, accel=accel))
    assert verdict(staged(seen), seen).accepted
    outcome = verdict(staged(spoiled), spoiled)
    assert not outcome.accepted
    assert any("rest 12 " in reason for reason in outcome.reasons)
    assert not any("rest 1 " in reason for reason in outcome.reasons)


# -------------------- gravity and site --------------------


def test_the_uncertainty_of_gravity_goes_into_the_scale_factors() -> None:
    """And into nothing else; it is common to the three."""
    rng = np.random.default_rng(83)
    device, way = unit(rng), rough_table(rng)
    seen = observations(device, way, np.random.default_rng(84), NAVIGATION)
    uncertain = replace(seen, site=replace(SITE, gravity_u=3e-4))
    sure, unsure = staged(seen), staged(uncertain)
    added = np.diag(unsure.covariance - sure.covariance)[:9]
    relative = 3e-4 / SITE.gravity
    np.testing.assert_allclose(added[3:6], relative**2, rtol=2e-3)
    np.testing.assert_allclose(np.sqrt(np.abs(np.delete(added, [3, 4, 5]))), 0.0, atol=1e-3 * relative * SITE.gravity)
    correlation = unsure.covariance[3:6, 3:6] / np.outer(unsure.u[3:6], unsure.u[3:6])
    assert correlation.min() > 0.99
    np.testing.assert_allclose(unsure.values, sure.values, atol=1e-3 * sure.u.min())


def test_another_gravity_scales_the_accelerometers_alone() -> None:
    rng = np.random.default_rng(85)
    device = unit(rng)
    seen = observations(device, rough_table(rng), rng)
    other = staged(replace(seen, site=replace(SITE, gravity=SITE.gravity * 1.001)))
    factor = (1.0 + device.accel_truth[3:6]) / 1.001
    np.testing.assert_allclose(1.0 + other.values[3:6], factor, rtol=1e-9)
    np.testing.assert_allclose(np.delete(other.values, [3, 4, 5]), np.delete(device.truth, [3, 4, 5]), atol=1e-9)


def test_an_unknown_latitude_is_a_larger_uncertainty() -> None:
    """20 sessions: 420 normalised errors; a gyro bias is known to a part of the Earth's rate only."""
    rng = np.random.default_rng(86)
    normalised, u = [], []
    for _ in range(20):
        device = unit(rng)
        seen = observations(device, rough_table(rng), rng, NAVIGATION)
        estimate = staged(replace(seen, site=replace(SITE, latitude=None)))
        normalised.append(error_of(estimate, device) / estimate.u)
        u.append(estimate.u)
    assert 0.6 < np.sqrt(np.mean(np.square(normalised))) < 1.4
    bias_u = np.mean(u, axis=0)[9:12]
    assert np.all(bias_u > 3.0 * NAVIGATION.gyro / np.sqrt(15.0 * 60.0))
    assert np.all(bias_u < EARTH_RATE)


# -------------------- what is not determined --------------------

ANGLES = ("accel.axis.yx", "accel.axis.zx", "accel.axis.zy")


def missing_from(codes: Sequence[str], *, turns: int | None = None, noise: Noise = NAVIGATION) -> tuple[str, ...]:
    """Names of what is unobservable, with exact attitudes; only the first turns are kept."""
    rng = np.random.default_rng(87)
    device, way = unit(rng), at(codes)
    seen = observations(device, way, rng, noise)
    if turns is not None:
        assert seen.turns is not None
        assert seen.turn_samples is not None
        kept, samples = seen.turns, seen.turn_samples
        seen = replace(
            seen,
            turns=Turns(
                first=kept.first[:turns],
                last=kept.last[:turns],
                duration=kept.duration[:turns],
                C=kept.C[:turns],
                M=kept.M[:turns],
                B=kept.B[:turns],
                covariance=kept.covariance[:turns],
                arising=kept.arising[:turns],
                velocity_covariance=kept.velocity_covariance[:turns],
                jumps=kept.jumps[:turns],
                aliased=kept.aliased[:turns],
            ),
            turn_samples=TurnSamples(samples=samples.samples, start=samples.start[:turns], stop=samples.stop[:turns]),
        )
    estimate = staged(seen)
    outcome = verdict(estimate, seen)
    assert outcome.accepted == (estimate.unobservable == ())
    assert outcome.unobservable == estimate.unobservable
    for name in outcome.unobservable:
        assert any(name in reason for reason in outcome.reasons)
    seen_values = error_of(estimate, device)[estimate.observable] / estimate.u[estimate.observable]
    assert np.abs(seen_values).max(initial=0.0) < 5.5  # what is given is right
    return estimate.unobservable


def test_nine_positions_determine_everything() -> None:
    assert missing_from((*FACES, *OBLIQUE)) == ()


def test_six_exact_faces_do_not_determine_the_accelerometer_angles() -> None:
    missing = missing_from(FACES)
    assert missing[:3] == ANGLES
    assert all(name.startswith("gyro.axis") for name in missing[3:])


def test_two_opposite_rests_determine_one_accelerometer() -> None:
    missing = missing_from(FACES[:2])
    accel = [name for name in missing if name.startswith("accel")]
    assert accel == ["accel.bias.y", "accel.bias.z", "accel.scale.y", "accel.scale.z", *ANGLES]
    assert {"gyro.scale.y", "gyro.scale.z"} <= set(missing)


def test_one_rest_determines_gyro_biases_at_most() -> None:
    missing = missing_from(FACES[:1])
    everything = {*Block(kind="accel", axes=TRIAD).names, *Block(kind="gyro", axes=TRIAD).names}
    assert everything - set(missing) <= {"gyro.bias.x", "gyro.bias.y", "gyro.bias.z"}


def test_without_turns_the_gyro_matrix_of_a_mems_unit_is_not_determined() -> None:
    """Noise too large for the Earth's rate to tell."""
    missing = missing_from((*FACES, *OBLIQUE), turns=0, noise=MEMS)
    gyro = Block(kind="gyro", axes=TRIAD).names
    assert missing == gyro[3:]


def test_turns_about_one_axis_determine_one_scale_factor() -> None:
    """Turns by 90° about body Z, which stays level; the other axes are never turned about."""
    codes = ("UEN", "UEN N+90", "UEN N+180", "UEN N+270", *OBLIQUE, *FACES[2:])
    missing = missing_from(codes, turns=3, noise=MEMS)
    assert set(missing) >= {"gyro.scale.x", "gyro.scale.y", "gyro.axis.xy", "gyro.axis.yx"}
    assert "gyro.scale.z" not in missing
    assert not any(name.startswith("accel") for name in missing)
