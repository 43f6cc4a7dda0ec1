"""What errs alike in a whole session: the rounding of channels that read the same, and the time base."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tumble
from tests.support.shared import copy_of, session
from tumble.diagnosis.verdict import verdict
from tumble.earth import earth_rate
from tumble.inference.joint import joint
from tumble.inference.problem import Problem
from tumble.inference.sources import clock_effects, clock_errors, common_covariances, common_rounding
from tumble.inference.start import initial_linearisation
from tumble.planning.setup import Setup
from tumble.recording.arrays import session_of_arrays
from tumble.recording.session import Site
from tumble.recording.session_file import description_of
from tumble.reduction.noise.rounding import Rounding
from tumble.reduction.observations import Observations
from tumble.reduction.rests.rests import Rests
from tumble.rotation import UP, rotation_matrix
from tumble.sensors.instrument import Instrument
from tumble.sensors.model import Block
from tumble.sensors.parameters import usual_sizes
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import scenario_of
from tumble.units import Array

STEP = 1e-3
ACCEL, GYRO = Block(kind="accel", axes=np.eye(3)), Block(kind="gyro", axes=np.eye(3))


def rounded(noise: float) -> Rounding:
    """Three channels of step STEP with a noise in steps."""
    relative = np.full(3, noise)
    size = np.full(3, STEP / np.pi * np.exp(-2.0 * (np.pi * noise) ** 2))
    return Rounding(step=np.full(3, STEP), noise=STEP * relative, rest_u=size, common_u=size)


def observed() -> Observations:
    return simulate_observations(
        scenario_of(Setup.of(grade="mems", positions=12), np.random.default_rng(1)), np.random.default_rng(2)
    )


def test_rests_that_read_the_same_have_all_of_the_rounding_in_common() -> None:
    found = rounded(0.1)
    np.testing.assert_allclose(common_rounding(found, np.full((20, 3), 7.0)), found.common_u)


def test_rests_that_read_many_steps_apart_have_nothing_in_common() -> None:
    readings = STEP * np.random.default_rng(0).uniform(-20.0, 20.0, (20, 3))
    assert np.all(common_rounding(rounded(0.1), readings) < 1e-3 * rounded(0.1).common_u)


def test_the_part_in_common_is_the_correlation_of_the_errors() -> None:
    """Noise of 0.3 of a step leaves the first harmonic: of true values that scatter by s, the part e^(−2π²s²/L²)."""
    s = 0.15
    at = s * np.random.default_rng(1).standard_normal((200_000, 1))
    phase = np.linspace(0.0, 1.0, 64, endpoint=False)
    common = np.array([np.sin(2.0 * np.pi * (at + x)).mean() for x in phase])
    expected = np.exp(-2.0 * (np.pi * s) ** 2)
    assert common.std() * np.sqrt(2.0) == pytest.approx(expected, rel=0.02)
    slope = 1.0 + 2.0 * np.exp(-2.0 * (np.pi * 0.3) ** 2)
    found = common_rounding(rounded(0.3), STEP * slope * np.tile([-s, s], 10)[:, None] * np.ones(3))
    np.testing.assert_allclose(found, expected * rounded(0.3).common_u, rtol=5e-3)


def test_rounding_and_time_base_are_in_the_covariance_of_the_joint_method() -> None:
    plain = replace(observed(), usual={})
    coarse = replace(plain, rests=replace(plain.rests, gyro=np.round(plain.rests.gyro / 1e-9) * 1e-9))
    with_errors = replace(coarse, rounding={"gyro": rounded(0.1)}, by_clock={"gyro.scale": 3e-4})
    before, after = joint(coarse), joint(with_errors)
    np.testing.assert_array_equal(after.values, before.values)
    change = after.covariance - before.covariance
    scales = [before.names.index(f"gyro.scale.{axis}") for axis in "xyz"]
    biases = [before.names.index(f"gyro.bias.{axis}") for axis in "xyz"]
    np.testing.assert_allclose(change[np.ix_(scales, scales)], 9e-8, rtol=1e-6)
    size = common_rounding(rounded(0.1), coarse.rests.gyro)
    np.testing.assert_allclose(change[np.ix_(biases, biases)], np.diag(size**2), rtol=1e-6, atol=1e-18)
    rest = np.delete(np.arange(len(change)), scales + biases)
    assert np.all(change[np.ix_(rest, rest)] == 0.0)
    assert before.prediction is not None
    assert after.prediction is not None
    assert (after.prediction.rate_u or 0.0) > (before.prediction.rate_u or 0.0)


@pytest.mark.parametrize(
    ("accel", "gyro", "changed"),
    [
        ("m/s^2", "rad/s", {"gyro.scale": 20e-6}),
        ("m/s^2", "rad", {}),
        ("m/s", "rad", {"accel.scale": -20e-6}),
        ("m/s", "rad/s", {"gyro.scale": 20e-6, "accel.scale": -20e-6}),
    ],
)
def test_the_time_base_is_that_of_rates_and_of_increments_of_velocity(
    accel: str, gyro: str, changed: dict[str, float]
) -> None:
    """Increments of gyros are angles, whatever the clock says; forces are compared with gravity, unless they are
    increments divided by their intervals."""
    log = described(accel, gyro, clock_ppm_u=20).log
    found = clock_effects(log.time_base_u, log.increments)
    assert found == pytest.approx(changed)
    names = Instrument.of(ACCEL, GYRO).names
    by_name = clock_errors(names, found)
    assert by_name.tolist() == pytest.approx([changed.get(name.rpartition(".")[0], 0.0) for name in names])


def described(accel: str, gyro: str, **log: float) -> tumble.Session:
    """A session of such units."""
    sensors = {"columns": ["x", "y", "z"], "unit": accel}, {"columns": ["p", "q", "r"], "unit": gyro}
    given = {"rate_hz": 100.0, "accel": sensors[0], "gyro": sensors[1], **log}
    samples = dict.fromkeys("xyzpqr", np.zeros(300))
    return tumble.session_of({"format": 1, "device": {"serial": "A"}, "log": given}, samples)


def test_a_time_base_that_is_not_stated_is_that_of_a_crystal_and_said(tmp_path: Path) -> None:
    """30 ppm in the scale factors of the gyros; stated as 0 it is exact, which a simulated session says."""
    folder = copy_of(session(tumble.Setup.of(grade="tactical", positions=12, rest=5.0), seed=1), tmp_path / "s")
    text = (folder / "session.toml").read_text()
    assert "clock_ppm_u = 0\n" in text
    exact = tumble.calibrate(folder)
    (folder / "session.toml").write_text(text.replace("clock_ppm_u = 0\n", ""))
    unsaid = tumble.calibrate(folder)
    name = "gyro.scale.x"
    assert (unsaid[name].u or 0.0) ** 2 == pytest.approx((exact[name].u or 0.0) ** 2 + 30e-6**2)
    assert unsaid["accel.scale.x"].u == pytest.approx(exact["accel.scale.x"].u)
    assert (exact.provenance.clock_u, unsaid.provenance.clock_u) == (0.0, 30e-6)
    said = [note for note in unsaid.provenance.assumptions if "time base" in note]
    assert len(said) == 1
    assert "30 ppm" in said[0]
    assert not any("time base" in note for note in exact.provenance.assumptions)


def test_readings_in_memory_have_a_time_base() -> None:
    still = np.tile([0.0, 0.0, 9.81], (300, 1))
    stamps = 0.01 * np.arange(300.0)
    for given, of_rate, of_stamps in ((None, 1e-2, 30e-6), (0.0, 0.0, 0.0), (5.0, 5e-6, 5e-6)):
        session = session_of_arrays(accel=still, gyro=0.0 * still, time=stamps, clock_ppm_u=given)
        assert session.log.time_base_u == pytest.approx(of_stamps)
        session = session_of_arrays(accel=still, gyro=0.0 * still, rate=100.0, clock_ppm_u=given)
        assert session.log.time_base_u == pytest.approx(of_rate)
        again = description_of(session)["log"]
        assert again.get("clock_ppm_u") == (None if given is None else pytest.approx(given))


@pytest.mark.parametrize("noise", [(1.0, 1.0, 1.0), (1.0, 1e-3, 1e-3), (1e-3, 1.0, 1e-6)])
def test_the_noise_of_a_turn_is_a_covariance_however_unlike_its_gyros_are(noise: tuple[float, ...]) -> None:
    """Rotation R and velocity: P_Vφ = −½ X R and P_VV = ⅓ X R Xᵀ, Eq. (8), so that what the rotation leaves of P_VV is
    X R Xᵀ/12 and the noise of the accelerometers."""
    observations = replace(observed(), usual=usual_sizes("mems"))
    turns = observations.turns
    assert turns is not None
    spread: Array = np.median(turns.covariance[:, 0, 0]) * np.diag(noise)
    velocity = np.broadcast_to(1e-12 * np.eye(3), turns.covariance.shape)
    turns = replace(turns, covariance=np.broadcast_to(spread, turns.covariance.shape), velocity_covariance=velocity)
    observations = replace(observations, turns=turns)
    instrument = Instrument.of(observations.accel_block, observations.gyro_block, observations.usual)
    problem = Problem.of(observations, instrument=instrument, usual=observations.usual)
    at = initial_linearisation(problem)
    found = at.noise.rows["turn"].covariance
    size = np.sqrt(np.diagonal(found, axis1=1, axis2=2))
    assert np.linalg.eigvalsh(found / size[:, :, None] / size[:, None, :]).min() > 0.0


def lying_still(latitude: float | None, seed: int, noise: float, bias: Array) -> Observations:
    """Three rests of a minute in one attitude of any heading, by gyros of this `noise`, rad/s/√Hz, and `bias`; the
    latitude is 48° where it is not known."""
    rng, B = np.random.default_rng(seed), np.radians(48.0) if latitude is None else latitude
    tilt = rotation_matrix(rng.normal(0.0, 0.5, 3))
    attitudes = np.tile(rotation_matrix(rng.uniform(-np.pi, np.pi) * UP) @ tilt, (3, 1, 1))
    start = np.array([0.0, 60.0, 120.0])
    rests = Rests.of_white_noise(
        start,
        start + 60.0,
        accel=9.81 * attitudes[:, 1] + 1e-4 * rng.standard_normal((3, 3)),
        gyro=bias + np.array(earth_rate(B)) @ attitudes + noise / np.sqrt(60.0) * rng.standard_normal((3, 3)),
        densities=(1e-3, noise),
    )
    site = Site(latitude=latitude, height=0.0, gravity=9.81, gravity_u=1e-4)
    return Observations(accel_block=ACCEL, gyro_block=GYRO, site=site, rests=rests)


@pytest.mark.parametrize("latitude", [0.0, 0.53, -0.84, 1.4, 0.5 * np.pi, None])
def test_one_attitude_shows_the_gyro_biases_at_any_latitude(latitude: float | None) -> None:
    bias = np.array([0.68, 0.87, 2.48])
    estimate = joint(lying_still(latitude, 1, 2e-4, bias).of_rest(0))
    at = [estimate.names.index(name) for name in GYRO.names[:3]]
    assert estimate.converged
    assert estimate.observable[at].all()
    u = np.sqrt(estimate.covariance[at, at])
    assert np.all(u < 1e-4)
    assert np.all(np.abs(estimate.values[at] - bias) < 4.0 * u)


@pytest.mark.parametrize("latitude", [0.2, -0.84, None])
@pytest.mark.parametrize("noise", [1e-6, 3e-4])
def test_gyro_biases_in_one_attitude_err_by_their_u(latitude: float | None, noise: float) -> None:
    """Be it by their noise or by the level rate of the Earth, of which three rests show no more than one, and whose
    square is always its mean: without noise the sum over two level axes is 2."""
    squares = list[float]()
    for seed in range(24):
        bias = np.random.default_rng(100 + seed).normal(0.0, 0.02, 3)
        estimate = joint(lying_still(latitude, seed, noise, bias), intervals=False)
        at = [estimate.names.index(name) for name in GYRO.names[:3]]
        error = estimate.values[at] - bias
        squares.append(float(error @ np.linalg.solve(estimate.covariance[np.ix_(at, at)], error)))
    assert 1.7 < np.mean(squares) < 4.0
    assert np.max(squares) < 20.0


def test_only_what_lies_in_one_attitude_has_the_level_rate_of_the_earth_in_common() -> None:
    still, several = lying_still(0.8, 1, 1e-6, np.zeros(3)), observed()
    assert still.one_attitude
    assert not several.one_attitude
    assert "earth" in common_covariances(still, Instrument(accel=ACCEL, gyro=GYRO))
    assert "earth" not in common_covariances(several, Instrument(accel=ACCEL, gyro=GYRO))


def test_a_bias_that_no_gyro_has_is_a_remark() -> None:
    for size, remarks in ((0.1, 0), (2.48, 1)):
        still = lying_still(0.8, 1, 2e-4, np.array([0.0, 0.05, -size]))
        outcome = verdict(joint(still), still)
        assert len([each for each in outcome.remarks if each.startswith("gyro.bias.z of -142.1 °/s")]) == remarks
        assert sum("did the device turn?" in each for each in outcome.remarks) == remarks
