"""Observations of a simulated session, made from the truth without a log, in about a millisecond.

    scenario = scenario_of(setup, rng)                   or another `Scenario`
    observations = simulate_observations(scenario, rng)
    estimate = joint(observations)                       or any other method; compare with scenario.truth

A rest is its true mean reading plus noise of the stated covariance. A turn is a rotation at a constant inertial rate
about an axis fixed in the body, from one true attitude to the next. Its readings are constant, and a few samples
integrate to the rotation about any gyro model without discretisation error. These samples (SAMPLES per turn, with white
noise) are kept with readings of the accelerometers: the exact mean of gravity over each interval through their model,
with bias and white noise. The sensitivities M and B are midpoint sums over the samples, accurate to about 1e-4. In logs
made by `simulate`, turns have ramps and geographic axes, which changes M and B by some 1e-3, and the noise is
estimated; here the covariances are the true ones.

There is no vibration, and no coloured noise except in-run biases (`tumble.simulation.sensors`), which are not part of
the covariances. The stated gravity differs from the true one by a draw with the stated uncertainty.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tumble.earth import earth_rate
from tumble.errors import InputError
from tumble.planning.itinerary import Itinerary, inertial_turns, white_turns
from tumble.reduction.blocks.motion_samples import MotionSamples
from tumble.reduction.observations import Observations
from tumble.reduction.rests.rests import Rests
from tumble.reduction.turns.turns import (
    AHEAD,
    TURN_FLOOR,
    VELOCITY_FLOOR,
    VELOCITY_STEP,
    TurnReadings,
    Turns,
    TurnSamples,
)
from tumble.rotation import UP, onto_body, rotation_matrix, skew
from tumble.sensors.parameters import prior_sizes
from tumble.simulation.scenario import Scenario, itinerary
from tumble.simulation.sensors import NODES, WEIGHTS, InRunBias, SimulatedBlock, harmonic_coefficients, harmonics
from tumble.units import Array

SAMPLES = 256  # of a turn


def simulate_observations(
    scenario: Scenario, rng: np.random.Generator, *, course: Itinerary | None = None, only_programmed: bool = False
) -> Observations:
    """Simulate the observations of one session.

    Parameters
    ----------
    scenario
        The scenario, with the true parameters.
    rng
        Random numbers.
    course
        Attitudes and times of the rests, by default random ones.
    only_programmed
        Whether to leave out turns that the programme does not prescribe, as if the log had been stopped for them.

    Raises
    ------
    InputError
        For a scenario that is impossible or vibrates.
    """
    if scenario.vibration.amplitude > 0.0:
        raise InputError(
            f"vibration: expected none in observations without a log, found {scenario.vibration.amplitude:g} m/s^2; "
            "take simulated_recording.record"
        )
    geometry, noise, place = rng.spawn(3)
    course = itinerary(scenario, geometry) if course is None else course
    accel, gyro = (SimulatedBlock.of(block, scenario, course.middle) for block in (scenario.accel, scenario.gyro))
    biases = tuple(
        block.bias(noise.standard_normal((len(course.rests), len(block.coefficients))), course.rests)
        for block in (accel, gyro)
    )
    rests = _rests(scenario, course, (accel, gyro), biases, noise)
    listed = scenario.programme
    if only_programmed:
        programmed = [move.axis is not None for move in listed.moves] if listed is not None else False
        course = replace(course, turned=course.turned & programmed)
    turns, samples, integrals = _turns(scenario, course, (accel, gyro), biases, noise)
    site = scenario.site
    observations = Observations(
        accel_block=scenario.accel,
        gyro_block=scenario.gyro,
        site=replace(site, gravity=site.gravity + site.gravity_u * place.standard_normal()),
        rests=rests,
        turns=turns,
        turn_samples=samples,
        programme=listed,
        position=None if listed is None else np.array(course.positions),
        turn_readings=integrals if scenario.gyro.size > 3 else None,
        usual=prior_sizes(scenario.setup.instrument, usual=scenario.setup.further),
        thermometers=None if scenario.climate is None else scenario.climate.record,
    )
    return replace(observations, turns=observations.turns_about(scenario.gyro.nominal()))


def _rests(
    scenario: Scenario,
    course: Itinerary,
    sensors: tuple[SimulatedBlock, SimulatedBlock],
    biases: tuple[InRunBias, ...],
    rng: np.random.Generator,
) -> Rests:
    """Return the rests, with in-run biases of accelerometers and gyros."""
    start, stop = course.rests.T
    seconds, files, climate = stop - start, np.zeros(len(start), dtype=np.int64), scenario.climate
    force = scenario.setup.gravity * course.attitudes[:, 1]
    rate = np.array(earth_rate(scenario.setup.latitude)) @ course.attitudes
    means = []
    for block, bias in zip(sensors, biases, strict=True):
        noise = block.white / np.sqrt(seconds)[:, None] * rng.standard_normal(bias.values.shape)
        means.append(block.read(force, rate, 0.5 * (start + stop), seconds) + bias.values + noise)
    return Rests.of_white_noise(
        start,
        stop,
        accel=means[0],
        gyro=means[1],
        densities=(sensors[0].white, sensors[1].white),
        temperatures=None if climate is None else climate.record.means(files, start, stop).kelvin,
    )


def _turns(
    scenario: Scenario,
    course: Itinerary,
    sensors: tuple[SimulatedBlock, SimulatedBlock],
    biases: tuple[InRunBias, ...],
    rng: np.random.Generator,
) -> tuple[Turns, TurnSamples, TurnReadings]:
    """Return the turns (K,), not yet integrated, their samples, and the integrals of their gyro readings.

    The first step of a turn needs AHEAD samples before it, as if it were already turning. All have white noise except
    those of the gyros ahead."""
    accel, gyro = sensors
    first, T, g = course.first, course.seconds, scenario.setup.gravity
    start = course.attitudes[first]
    vector = inertial_turns(start, course.attitudes[first + 1], course.moves[first], T, scenario.setup.latitude)
    K, n, S = len(first), gyro.block.size, SAMPLES + AHEAD
    dt = T / SAMPLES
    when = course.rests[first, 1][:, None] + (np.arange(S) - AHEAD + 0.5) * dt[:, None]
    rate = np.repeat((vector / T[:, None])[:, None], S, axis=1)

    # readings of the gyros (K, S, n), of the accelerometers (K, S, n) at their delays
    force = g * _mean_verticals(scenario, start, vector, T)
    gyro_samples = _sampled(gyro, force, rate, when) + biases[1].at(when)
    gyro_samples[:, AHEAD:] += gyro.white / np.sqrt(dt)[:, None, None] * rng.standard_normal((K, SAMPLES, n))
    delays = scenario.instrument.delays(scenario.values)
    if np.any(delays):
        distinct, which = np.unique(delays, return_inverse=True)
        delayed = [_mean_verticals(scenario, start, vector, T, delay) for delay in distinct.tolist()]
        force = g * np.stack(delayed, axis=2)[:, :, which]
    accel_samples = _sampled(accel, _with_levers(scenario, course, force, vector, T), rate, when)
    noise = rng.spawn(1)[0].standard_normal(accel_samples.shape)
    accel_samples += biases[0].at(when) + accel.white / np.sqrt(dt)[:, None, None] * noise
    to_rate, to_force = onto_body(gyro.block.axes), onto_body(accel.block.axes)
    stored = MotionSamples()
    stored.append(
        (gyro_samples @ to_rate.T).reshape(-1, 3), (accel_samples @ to_force.T).reshape(-1, 3), np.repeat(dt, S)
    )
    first_sample = AHEAD + S * np.arange(K)
    samples = TurnSamples(samples=stored, start=first_sample, stop=first_sample + SAMPLES)

    # covariances of rotations, of velocities, and of the integrals of the gyros
    density = to_rate @ to_rate.T
    if not np.allclose(density, density[0, 0] * np.eye(3), rtol=1e-12, atol=0.0):
        path = rotation_matrix(((np.arange(SAMPLES) + 0.5) / SAMPLES)[:, None, None] * vector)
        density = (path @ density @ np.swapaxes(path, -1, -2)).mean(axis=0)
    covariance = gyro.white**2 * T[:, None, None] * density + TURN_FLOOR**2 * np.eye(3)
    accel_density = np.trace(to_force @ to_force.T) / 3.0
    floor = VELOCITY_FLOOR + VELOCITY_STEP * g * T * (np.linalg.norm(vector, axis=1) / SAMPLES) ** 3
    turns = white_turns(first, T, covariance, accel.white**2 * T * accel_density + floor**2)
    variance = gyro.white**2 * T + TURN_FLOOR**2
    integrals = TurnReadings(
        integral=gyro_samples[:, AHEAD:].sum(axis=1) * dt[:, None], covariance=variance[:, None, None] * np.eye(n)
    )
    return turns, samples, integrals


def _sampled(sensors: SimulatedBlock, force: Array, rate: Array, when: Array) -> Array:
    """Return readings (K, S, n) at times (K, S), s, for forces (K, S, 3) or (K, S, n, 3) and rates (K, S, 3)."""
    (K, S), flat = when.shape, force.reshape(when.size, *force.shape[2:])
    return sensors.read(flat, rate.reshape(K * S, 3), when.ravel()).reshape(K, S, len(sensors.coefficients))


def _with_levers(scenario: Scenario, course: Itinerary, force: Array, vector: Array, T: Array) -> Array:
    """Return forces at the accelerometers (K, S, n, 3) from those of the body (K, S, 3), or (K, S, n, 3) with delays.

    At a constant rate ω, an arm r adds [ω×]²r. At both ends, where the turn starts and stops at once, the velocity
    jumps by ±(ω − ω_rest) × r; it is part of the first and last sample, rotated by half a sample to their middle, and
    by the delays. Without lever arms the forces are unchanged."""
    instrument = scenario.instrument
    if instrument.turn_only("lever") is None:
        return force
    arms, delays = instrument.levers(scenario.values), instrument.delays(scenario.values)
    rate, dt = vector / T[:, None], T / SAMPLES
    earth = np.array(earth_rate(scenario.setup.latitude))
    out = np.repeat(force[:, :, None], len(arms), axis=2) if force.ndim == 3 else force.copy()
    centripetal = skew(rate) @ skew(rate) @ arms.T
    out[:, AHEAD:] += centripetal.swapaxes(1, 2)[:, None]
    for sample, rests, sign in ((AHEAD, course.first, 1.0), (-1, course.first + 1, -1.0)):
        jump = skew(rate - earth @ course.attitudes[rests]) @ arms.T
        turned = rotation_matrix((delays - 0.5 * sign * dt[:, None])[..., None] * rate[:, None])
        out[:, sample] += np.einsum("kpij,kjp->kpi", turned, jump) * (sign / dt)[:, None, None]
    return out


def _mean_verticals(scenario: Scenario, start: Array, vector: Array, T: Array, delay: float = 0.0) -> Array:
    """Return the mean upward vertical in the body (K, SAMPLES + AHEAD, 3) over each sample, `delay` s earlier.

    Turns are from attitudes `start` through rotation vectors `vector` (K, 3) in `T` (K,) s. The first AHEAD samples are
    before the turn, as if already turning. With the axis n in the body, the rate ω of the turn and the Earth's Ω m,
    they are the means of exp(−[n×] ωt) L₀ᵀ exp([m×] Ωt) e_U, by Gauss–Legendre sums."""
    earth = np.array(earth_rate(scenario.setup.latitude))
    angle, earth_norm = np.linalg.norm(vector, axis=1), float(np.linalg.norm(earth))
    axis = vector / np.where(angle > 0.0, angle, 1.0)[:, None]
    t = (np.arange(SAMPLES + AHEAD)[:, None] - AHEAD + NODES) * (T / SAMPLES)[:, None, None] - delay
    by_earth, by_turn = harmonics(-earth_norm * t), harmonics((angle / T)[:, None, None] * t)
    mean = np.einsum("ksnp,ksnq,n->kspq", by_earth, by_turn, WEIGHTS)
    at_start = harmonic_coefficients(earth / earth_norm, UP) @ start  # in the body
    coefficients = harmonic_coefficients(axis[:, None], at_start)
    return np.asarray(mean.reshape(*t.shape[:2], 9) @ coefficients.reshape(-1, 9, 3))
