"""Observations without a log: they are those of the truth, and what they state of themselves is true."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.direct import PYRAMID
from tests.support.formula_setup import device_setup
from tumble.earth import earth_rate
from tumble.errors import InputError
from tumble.programme.positions import programme
from tumble.rotation import rotation_matrix, rotation_vector
from tumble.sensors.grades import NoiseModel
from tumble.sensors.model import Block, SensorModel
from tumble.simulation.observations import SAMPLES, simulate_observations
from tumble.simulation.scenario import Scenario, Vibration, itinerary, scenario_of
from tumble.simulation.sensors import SimulatedBlock
from tumble.units import DEGREE, Array

SETUP = device_setup(latitude=56.8 * DEGREE, gravity=9.815817, rest=120.0)
QUIET = replace(SETUP, noise=NoiseModel())


def quiet(seed: int = 1) -> Scenario:
    return scenario_of(QUIET, np.random.default_rng(seed))


def attitudes_of(scenario: Scenario, seed: int) -> Array:
    """True attitudes of a session simulated with this seed."""
    return itinerary(scenario, np.random.default_rng(seed).spawn(3)[0]).attitudes


def gyro_of(scenario: Scenario) -> SensorModel:
    return scenario.gyro.model(np.array([scenario.truth[name] for name in scenario.gyro.names]))


@pytest.mark.parametrize("hand", [False, True], ids=["table", "hand"])
def test_noiseless_observations_are_those_of_the_truth(hand: bool) -> None:
    """Readings at rest to rounding; turns about the true gyros lead from one true attitude to the next, the Earth's
    rotation included, to 1e-12 rad."""
    scenario = quiet().changed(by_hand=20) if hand else quiet()
    found, L = simulate_observations(scenario, np.random.default_rng(5)), attitudes_of(scenario, 5)
    accel = scenario.accel.model(np.array([scenario.truth[name] for name in scenario.accel.names]))
    earth = np.array(earth_rate(SETUP.latitude))
    np.testing.assert_allclose(accel.apply(found.rests.accel), SETUP.gravity * L[:, 1], atol=1e-13)
    np.testing.assert_allclose(gyro_of(scenario).apply(found.rests.gyro), earth @ L, atol=1e-18)
    turns = found.turns_about(gyro_of(scenario))
    carried = L[turns.first] @ turns.C
    expected = rotation_matrix(turns.duration[:, None] * earth) @ L[turns.last]
    np.testing.assert_allclose(carried, expected, rtol=0.0, atol=1e-12)


def test_turns_go_the_programmed_way() -> None:
    """∫ C ω dt of a half turn is along its axis: +180° about north, up, −180° about north."""
    scenario = quiet().changed(programme=programme("rough-table"), table_error=1e-6, mounting_error=0.0)
    found, L = simulate_observations(scenario, np.random.default_rng(6)), attitudes_of(scenario, 6)
    turns = found.turns_about(gyro_of(scenario))
    way = np.einsum("kij,kjpp->ki", L[turns.first], turns.M[:, :, :, :])
    for k, move in enumerate(programme("rough-table").moves):
        if move.axis is not None and move.angle is not None:
            np.testing.assert_allclose(way[k], move.angle * move.axis, atol=5e-3)


def test_sensitivities_are_those_of_the_rotation() -> None:
    """M and B against differences of the turns integrated about other gyros: midpoint sums, right to 3e-4."""
    scenario = quiet()
    found, model = simulate_observations(scenario, np.random.default_rng(7)), gyro_of(scenario)
    turns = found.turns_about(model)
    for p in range(3):
        for q in range(4):
            step = np.zeros((3, 4))
            step[p, q] = 1e-6
            moved = SensorModel(
                matrix=model.matrix + step[:, :3] @ model.matrix, bias=model.bias + step[:, 3]
            )  # ω̂ = (I + E) S ω + b + δ
            change = rotation_vector(found.turns_about(moved).C @ np.swapaxes(turns.C, 1, 2))
            inverse = np.linalg.inv(model.matrix)
            E, offset = inverse @ step[:, :3] @ model.matrix, inverse @ step[:, 3]
            expected = -(np.einsum("kipq,pq->ki", turns.M, E) + turns.B @ offset)
            scale = np.abs(expected).max()
            np.testing.assert_allclose(change, expected, rtol=0.0, atol=3e-4 * scale)


def test_noise_is_what_the_covariances_say() -> None:
    """Over 150 sessions: rests and turns scatter about the truth with unit normalised variance, ±5 standard errors."""
    accel, gyro, turn = [], [], []
    for seed in range(150):
        scenario = scenario_of(SETUP, np.random.default_rng([seed, 1]))
        found, L = simulate_observations(scenario, np.random.default_rng(seed)), attitudes_of(scenario, seed)
        values = np.array([scenario.truth[name] for name in scenario.accel.names])
        force = scenario.accel.model(values).predict(SETUP.gravity * L[:, 1])
        rate = gyro_of(scenario).predict(np.array(earth_rate(SETUP.latitude)) @ L)
        turns = found.turns_about(gyro_of(scenario))
        earth = rotation_matrix(turns.duration[:, None] * np.array(earth_rate(SETUP.latitude)))
        off = rotation_vector(turns.C @ np.swapaxes(L[turns.last], 1, 2) @ np.swapaxes(earth, 1, 2) @ L[turns.first])
        accel.append(normalised(found.rests.accel - force, found.rests.accel_covariance))
        gyro.append(normalised(found.rests.gyro - rate, found.rests.gyro_covariance))
        turn.append(normalised(off, turns.covariance))
    for z in (accel, gyro, turn):
        assert np.mean(np.square(z)) == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / np.size(z)))


def normalised(error: Array, covariance: Array) -> Array:
    return np.asarray(np.linalg.solve(np.linalg.cholesky(covariance), error[:, :, None]))[:, :, 0]


def test_instability_is_a_bias_of_each_rest() -> None:
    scenario = scenario_of(
        replace(SETUP, noise=NoiseModel(accel_instability=1e-3, instability_time=0.0)), np.random.default_rng(1)
    )
    spread = []
    for seed in range(40):
        noisy = simulate_observations(scenario, np.random.default_rng(seed)).rests.accel
        calm = scenario.changed(noise=NoiseModel())
        spread.append(noisy - simulate_observations(calm, np.random.default_rng(seed)).rests.accel)
    assert np.std(spread) == pytest.approx(1e-3, rel=5.0 / np.sqrt(2.0 * np.size(spread)))


@pytest.mark.parametrize("time", [0.0, 30.0, 300.0, 3000.0])
def test_in_run_biases_are_alike_as_the_correlation_time_says(time: float) -> None:
    """20 000 sensors: a covariance is known to 0.01 σ² at most, and 0.055 is more than five of its standard errors."""
    noise = NoiseModel(gyro_instability=2.0, instability_time=time)
    scenario = scenario_of(replace(SETUP, noise=noise), np.random.default_rng(1))
    sensors = SimulatedBlock.of(scenario.gyro, scenario, 0.0)
    rests = np.array([[0.0, 60.0], [80.0, 100.0], [120.0, 200.0], [500.0, 510.0]])
    values = sensors.bias(np.random.default_rng(2).standard_normal((4, 20_000)), rests).values
    apart = np.abs(np.subtract.outer(rests.mean(axis=1), rests.mean(axis=1)))
    expected = np.exp(-apart / time) if time > 0.0 else np.eye(4)
    about = np.eye(4) - 0.25 * (time > 0.0)  # one that lasts is about its mean over the session
    expected = about @ expected @ about
    np.testing.assert_allclose(values @ values.T / 20_000, 4.0 * expected, atol=4.0 * 0.055)


def test_the_turns_have_the_mean_of_the_biases_of_their_rests() -> None:
    noise = NoiseModel(accel_instability=1e-3, gyro_instability=1e-4)
    scenario = scenario_of(replace(SETUP, noise=noise), np.random.default_rng(1))
    noisy = simulate_observations(scenario, np.random.default_rng(3))
    calm = simulate_observations(scenario.changed(noise=NoiseModel()), np.random.default_rng(3))
    assert noisy.turn_samples is not None
    assert calm.turn_samples is not None
    assert noisy.turns is not None
    bias = noisy.rests.gyro - calm.rests.gyro
    for k, (start, stop) in enumerate(zip(noisy.turn_samples.start, noisy.turn_samples.stop, strict=True)):
        rates = [each.samples.read(int(start), int(stop))[0] for each in (noisy.turn_samples, calm.turn_samples)]
        expected = 0.5 * (bias[noisy.turns.first[k]] + bias[noisy.turns.last[k]])
        np.testing.assert_allclose((rates[0] - rates[1]).mean(axis=0), expected, atol=1e-12)


def test_only_programmed_turns_are_kept_on_demand() -> None:
    found = simulate_observations(quiet(), np.random.default_rng(1), only_programmed=True)
    assert found.turns is not None
    assert found.turns.first.tolist() == [0, 1, 2, 4, 5, 6, 8, 9, 10]
    everything = simulate_observations(quiet(), np.random.default_rng(1))
    assert everything.turns is not None
    np.testing.assert_array_equal(found.turns.C, everything.turns.C[[0, 1, 2, 4, 5, 6, 8, 9, 10]])


def test_gravity_is_stated_with_its_error() -> None:
    scenario = scenario_of(replace(SETUP, gravity_u=1e-3), np.random.default_rng(1))
    stated = [simulate_observations(scenario, np.random.default_rng(seed)).site.gravity for seed in range(200)]
    assert np.std(stated) == pytest.approx(1e-3, rel=5.0 / np.sqrt(400.0))
    assert np.mean(stated) == pytest.approx(SETUP.gravity, abs=5e-3 / np.sqrt(200.0))


def test_more_gyros_have_their_integrals() -> None:
    """Without noise, the integrals of the readings are those of the rate that the turn is made with."""
    gyro = Block(kind="gyro", axes=PYRAMID)
    truth = dict.fromkeys(gyro.names, 1e-3) | dict(quiet().truth)
    scenario = replace(quiet(), gyro=gyro, truth={n: truth[n] for n in quiet().accel.names + gyro.names})
    found = simulate_observations(scenario, np.random.default_rng(1))
    assert found.turns is not None
    assert found.turn_readings is not None
    model = gyro_of(scenario)
    net = found.turn_readings.integral - found.turns.duration[:, None] * model.bias
    beyond = np.eye(4) - model.matrix @ model.inverse()
    np.testing.assert_allclose(net @ beyond, 0.0, atol=1e-12)


def test_vibration_is_refused() -> None:
    shaken = replace(quiet(), vibration=Vibration(amplitude=0.1, frequency=20.0))
    with pytest.raises(InputError, match="vibration: expected none"):
        simulate_observations(shaken, np.random.default_rng(1))


def test_the_forces_that_are_kept_go_through_the_accelerometers() -> None:
    """Without noise, compensated forces have the size of gravity where a sample turns little, and the first
    samples of a turn read what the rest before it does."""
    made = quiet(72)
    seen = simulate_observations(made, np.random.default_rng(73))
    assert seen.turn_samples is not None
    assert seen.turns is not None
    model = made.accel.model(np.array([made.truth[name] for name in made.accel.names]))
    angles = np.linalg.norm(rotation_vector(seen.turns.C), axis=1)
    for pieces in seen.turn_samples.pieces():
        forces = pieces.forces
        for k, a, b in zip(pieces.turn, pieces.start, pieces.stop, strict=True):
            true = model.apply(forces[a:b])
            size = np.linalg.norm(true, axis=1) / made.site.gravity  # a mean of directions on an arc is shorter
            assert np.all(size < 1.0 + 1e-12)
            assert np.all(size > 1.0 - (angles[k] / SAMPLES) ** 2 / 24 - 1e-6)
            np.testing.assert_allclose(0.5 * (forces[a - 1] + forces[a]), seen.rests.accel[k], atol=0.01)
