"""Observations of a simulated session, made directly from the truth: no log is sampled, so a session takes a
millisecond and thousands are cheap.

    scenario = scenario_of(setup, rng)                   or a `Scenario` of one's own
    observations = simulate_observations(scenario, rng)
    estimate = joint(observations)                       or any other method; compare with scenario.truth

What is exact. A rest is its true mean reading plus noise of the covariance that is stated: the mean of white noise
is what it is in a log. A turn is a rotation at constant inertial rate about an axis fixed in the body, from one true
attitude to the next; every reading of it is then constant, so that a few samples integrate to the rotation about any
gyro model without an error of discretisation. These samples (SAMPLES a turn, with white noise) are kept, so that
`Observations.turns_about` works as it does for a log; the sensitivities M and B are midpoint sums over them, right to
about 1e-4. A log made by `simulate` differs in that its turns have ramps and geographic axes, which moves M and B by
some 1e-3, and in that the noise has to be estimated from it; here the covariances are the true ones.

What is not here: vibration, whatever a log has besides rests and turns, and coloured noise other than a bias that is
drawn anew at every rest and held through the move that follows (`NoiseModel`), of which the covariances know nothing.
The stated gravity differs from the true one by a draw with the stated uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tumble.earth import earth_rate
from tumble.errors import InputError
from tumble.planning.inertial_turns import inertial_turns
from tumble.reduction.blocks import GyroSamples
from tumble.reduction.observations import (
    ACCEL_FLOOR,
    GYRO_FLOOR,
    TURN_FLOOR,
    Observations,
    Rests,
    TurnReadings,
    Turns,
    TurnSamples,
)
from tumble.rotation import onto_body, rotation_matrix
from tumble.sensors.model import Block, SensorModel
from tumble.simulation.scenario import Itinerary, OnTable, Scenario, itinerary
from tumble.units import Array, IntArray

SAMPLES = 64
"""Samples of a turn."""


def simulate_observations(
    scenario: Scenario, rng: np.random.Generator, *, only_programmed: bool = False
) -> Observations:
    """The observations of one session of a scenario; the truth is `scenario.truth`. With `only_programmed` the turns
    that the programme does not prescribe are left out, as if the log had been stopped for them.

    Raises InputError, one line, for a scenario that is impossible or vibrates."""
    if scenario.vibration.amplitude > 0.0:
        raise InputError(
            f"vibration: expected none in observations without a log, found {scenario.vibration.amplitude:g} m/s^2; "
            "take simulated_recording.record"
        )
    geometry, noise, place = rng.spawn(3)
    way = itinerary(scenario, geometry)
    accel = _NoisyBlock.of(scenario.accel, scenario, len(way.rests), noise)
    gyro = _NoisyBlock.of(scenario.gyro, scenario, len(way.rests), noise)
    rests = _rests(scenario, way, accel, gyro, noise)
    linked = np.array(way.programmed, dtype=bool) | (not only_programmed)
    turns, samples, readings = _turns(scenario, way, np.flatnonzero(linked).astype(np.int64), gyro, noise)
    site = scenario.site
    observations = Observations(
        accel_block=scenario.accel,
        gyro_block=scenario.gyro,
        site=replace(site, gravity=site.gravity + site.gravity_u * place.standard_normal()),
        rests=rests,
        turns=turns,
        turn_samples=samples,
        programme=scenario.course.programme if isinstance(scenario.course, OnTable) else None,
        position=np.array(way.positions) if isinstance(scenario.course, OnTable) else None,
        turn_readings=readings if scenario.gyro.size > 3 else None,
    )
    return replace(observations, turns=observations.turns_about(scenario.gyro.nominal()))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _NoisyBlock:
    """A block at work: its model, the bias (N, n) it has at each rest and in the move that follows, and the density
    of its white noise."""

    model: SensorModel
    bias: Array
    white: float

    @staticmethod
    def of(block: Block, scenario: Scenario, rests: int, rng: np.random.Generator) -> _NoisyBlock:
        noise = scenario.noise
        white, instability = (
            (noise.accel_white, noise.accel_instability)
            if block.kind == "accel"
            else (noise.gyro_white, noise.gyro_instability)
        )
        model = block.model(np.array([scenario.truth[name] for name in block.names]))
        return _NoisyBlock(
            model=model, bias=model.bias + instability * rng.standard_normal((rests, block.size)), white=white
        )

    def mean(self, true: Array, seconds: Array, rng: np.random.Generator) -> Array:
        """Mean readings (N, n) of true vectors (N, 3) over so many seconds (N,)."""
        noise = self.white / np.sqrt(seconds)[:, None] * rng.standard_normal(self.bias.shape)
        return np.asarray(true @ self.model.matrix.T + self.bias + noise)

    def covariance(self, seconds: Array, floor: float) -> Array:
        """Covariance (N, n, n) of the means over so many seconds."""
        variance = self.white**2 / seconds + floor**2
        return np.asarray(variance[:, None, None] * np.eye(self.bias.shape[1]))


def _rests(
    scenario: Scenario, way: Itinerary, accel: _NoisyBlock, gyro: _NoisyBlock, rng: np.random.Generator
) -> Rests:
    start, stop = way.rests.T
    seconds = stop - start
    force = scenario.site.gravity * way.attitudes[:, 1]
    rate = np.array(earth_rate(scenario.latitude)) @ way.attitudes
    return Rests(
        file=np.zeros(len(start), dtype=np.int64),
        start=start,
        stop=stop,
        accel=accel.mean(force, seconds, rng),
        accel_covariance=accel.covariance(seconds, ACCEL_FLOOR),
        accel_drift=np.zeros_like(accel.bias),
        accel_noise=np.full_like(accel.bias, accel.white),
        gyro=gyro.mean(rate, seconds, rng),
        gyro_covariance=gyro.covariance(seconds, GYRO_FLOOR),
        gyro_drift=np.zeros_like(gyro.bias),
        gyro_noise=np.full_like(gyro.bias, gyro.white),
        temperature=None,
    )


def _turns(
    scenario: Scenario, way: Itinerary, first: IntArray, gyro: _NoisyBlock, rng: np.random.Generator
) -> tuple[Turns, TurnSamples, TurnReadings]:
    """The turns after the rests `first` (K,), not yet integrated, and their samples: for each turn one more is kept
    ahead of it, which the coning term wants."""
    block = scenario.gyro
    K, n, to_body = len(first), block.size, onto_body(block.axes)
    T = way.rests[first + 1, 0] - way.rests[first, 1]
    before, after = way.attitudes[first], way.attitudes[first + 1]
    vector = inertial_turns(before, after, way.moves[first], T, scenario.latitude)
    readings = (vector / T[:, None]) @ gyro.model.matrix.T + gyro.bias[first]
    dt = T / SAMPLES
    sampled = np.repeat(readings[:, None, :], SAMPLES + 1, axis=1)
    sampled[:, 1:] += gyro.white / np.sqrt(dt)[:, None, None] * rng.standard_normal((K, SAMPLES, n))
    stored = GyroSamples()
    stored.append((sampled @ to_body.T).reshape(-1, 3), np.repeat(dt, SAMPLES + 1))
    start = 1 + (SAMPLES + 1) * np.arange(K)
    turns = Turns(
        first=first,
        last=first + 1,
        duration=T,
        C=np.broadcast_to(np.eye(3), (K, 3, 3)),
        M=np.zeros((K, 3, 3, 3)),
        B=np.zeros((K, 3, 3)),
        covariance=gyro.white**2 * T[:, None, None] * _carried(vector, to_body @ to_body.T) + TURN_FLOOR**2 * np.eye(3),
    )
    variance = gyro.white**2 * T + TURN_FLOOR**2
    integrals = TurnReadings(
        integral=sampled[:, 1:].sum(axis=1) * dt[:, None], covariance=variance[:, None, None] * np.eye(n)
    )
    return turns, TurnSamples(samples=stored, start=start, stop=start + SAMPLES), integrals


def _carried(vector: Array, density: Array) -> Array:
    """Mean of R N Rᵀ (K, 3, 3) over turns through rotation vectors (K, 3), for a density N (3, 3)."""
    if np.allclose(density, density[0, 0] * np.eye(3), rtol=1e-12, atol=0.0):
        return np.broadcast_to(density, (len(vector), 3, 3))
    middle = (np.arange(SAMPLES) + 0.5) / SAMPLES
    path = rotation_matrix(middle[:, None, None] * vector)
    return np.asarray((path @ density @ np.swapaxes(path, -1, -2)).mean(axis=0))
