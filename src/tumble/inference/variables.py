"""What parameters change with: time, powers of temperature, the direction in which the temperature came, and, of
several sessions, that they are several.

Temperatures are those of the accelerometers and of the gyros, each of which follow their thermometer with a lag of
their own (docs/explanation/mathematics.md (15), section 12), as means over each rest and each turn: where a ramp turns
back within a turn the rests beside it do not say how warm it was, and the mean of a square is not the square of a mean.
The reference T₀ is the mean of each thermometer over the rests, so that T − T₀ is small and a parameter has its value
at T₀. Hysteresis is h sgn(Ṫ)(1 − x²), x = −1 … 1 over the range of the thermometer in the recording: it is nothing
where the temperature turns back.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from types import MappingProxyType

import numpy as np

from tumble.reduction.observations import Observations
from tumble.reduction.rests.thermometer import Warmth
from tumble.reduction.rests.warming import OVER_TEMPERATURE
from tumble.sensors.model import SensorKind
from tumble.sensors.parameters import Variable
from tumble.units import Array, BoolArray

BOTH_WAYS = 3
"""Rests that have to come from each side for a hysteresis to be sought."""
INNER = 0.8
"""Of half the range: beyond, a hysteresis does nothing."""
LEVEL = 0.05
"""K: rests of a session whose temperatures differ by no more are at one level: half of it, more of which a lag does not
make, times a usual slope is within the usual instability of a bias, in every grade."""
RAMP_RANGE = 1.0
"""K: by what a temperature changes within a session that is to show a hysteresis, or is worth a remark in motion."""
BETWEEN = 0.8
"""Of the range of temperatures: where so much of it has no rest, all are at its two ends."""

NO_LAGS: Mapping[str, float] = MappingProxyType({})
KINDS: tuple[SensorKind, ...] = ("accel", "gyro")
Variables = Mapping[Variable, tuple[Array, Array, Array]]
"""Of the rests (N, 2 T) and of the turns (K, 2 T), and by how much a second it grows within the turns (K, 2 T): of
accelerometers with each of the T thermometers, then of gyros, or (·, 1) where all parameters go with the same."""
GROWING = 2
"""The place of the last."""


def variables_of(
    observations: Observations, lags: Mapping[str, float] = NO_LAGS
) -> dict[Variable, tuple[Array, Array, Array]]:
    """What parameters may change with, of the rests and of the turns: time from the mean of its rests, s, the
    temperatures of the sensors, which follow their thermometers with `lags`, s, by kind of sensor, from the mean of the
    thermometer, K, and their squares, and the direction they came from; and of several sessions, each of them."""
    rests, turns, session = observations.rests, observations.turns, observations.session
    time = 0.5 * (rests.start + rests.stop)
    for of in (slice(None),) if session is None else (session == s for s in range(session[-1] + 1)):
        time[of] -= time[of].mean() if len(time) else 0.0
    at_rest: dict[Variable, Array] = {"time": time[:, None]}
    if session is not None:
        at_rest["launch"] = np.ones((len(rests), 1))
    first, last = (np.zeros((2, 0), dtype=np.int64)) if turns is None else (turns.first, turns.last)
    grows = {"time": 1.0, "launch": 0.0}
    out = {name: (v, 0.5 * (v[first] + v[last]), np.full((len(first), 1), grows[name])) for name, v in at_rest.items()}
    if rests.temperatures is not None and observations.links is None:  # in motion biases follow as processes in time
        every = [_temperature_regressors(observations, lags.get(kind, 0.0)) for kind in KINDS]
        for name in every[0]:
            rest, turn, grown = (np.hstack(each) for each in zip(*(of_kind[name] for of_kind in every), strict=True))
            out[name] = rest, turn, grown
    return out


@lru_cache(maxsize=4)
def _temperature_regressors(observations: Observations, lag: float) -> dict[Variable, tuple[Array, Array, Array]]:
    """What goes with the temperatures of sensors that follow each thermometer with a lag, s."""
    kelvin = observations.rests.temperatures
    assert kelvin is not None
    reference, seconds = kelvin.mean(axis=0), np.maximum(_turning(observations)[1], 1.0)[:, None]
    rest, turn, before, after = (
        _powers_of_temperature(each, reference) for each in _mean_temperatures(observations, kelvin, lag)
    )
    out = {name: (rest[name], turn[name], 2.0 * (after[name] - before[name]) / seconds) for name in rest}
    if lag_is_sought(observations):
        out["lag"] = np.zeros_like(rest["temperature"]), *np.zeros((2, *turn["temperature"].shape))
    if not on_a_ramp(observations):
        del out["hysteresis"]
    return out


def _powers_of_temperature(warmth: Warmth, reference: Array) -> dict[Variable, Array]:
    """What goes with the temperatures, about the references (T,), K."""
    warmer = warmth.kelvin - reference
    square, cube = warmer**2 + warmth.variance, warmer**3 + 3.0 * warmer * warmth.variance
    return {"temperature": warmer, "temperature²": square, "temperature³": cube, "hysteresis": warmth.hysteresis}


def sensors_at(observations: Observations, kelvin: Array, lag: float) -> Array:
    """Mean temperatures (N, T), K, of sensors that follow each thermometer with a lag, at rests where it has `kelvin`
    (N, T)."""
    return _mean_temperatures(observations, kelvin, lag)[0].kelvin


def _turning(observations: Observations) -> tuple[Array, Array]:
    """When the turns begin, and how long they last (K,), s."""
    rests, turns = observations.rests, observations.turns
    if turns is None:
        return np.zeros(0), np.zeros(0)
    return rests.stop[turns.first], rests.start[turns.last] - rests.stop[turns.first]


def _mean_temperatures(observations: Observations, kelvin: Array, lag: float) -> tuple[Warmth, Warmth, Warmth, Warmth]:
    """What the sensors have in the rests, in the turns, and in the first and in the second half of these, by the
    records of the thermometers; without them the `kelvin` (N, T) of the rests, and of the turns what is between."""
    rests, turns, thermometers = observations.rests, observations.turns, observations.thermometers
    first, last = (np.zeros((2, 0), dtype=np.int64)) if turns is None else (turns.first, turns.last)
    if thermometers is None:
        between = 0.5 * (kelvin[first] + kelvin[last])
        at_rest, in_turns = (Warmth(kelvin=k, variance=0.0 * k, hysteresis=0.0 * k) for k in (kelvin, between))
        return at_rest, in_turns, in_turns, in_turns
    begin, seconds = _turning(observations)
    middle, end, K = begin + 0.5 * seconds, begin + seconds, len(first)
    file = np.concatenate([rests.file, np.tile(rests.file[first], 3)])
    when = np.concatenate([rests.start, begin, begin, middle]), np.concatenate([rests.stop, end, middle, end])
    every = thermometers.means(file, *when, lag)
    in_turns, before, after = (every[len(rests) + i * K : len(rests) + (i + 1) * K] for i in range(3))
    return every[: len(rests)], in_turns, before, after


def over_a_range(observations: Observations) -> bool:
    """Whether the temperatures of the rests, of one session or of several, differ by enough to show coefficients."""
    kelvin = observations.rests.temperatures
    if observations.thermometers is None or kelvin is None:
        return False
    return bool(np.ptp(kelvin, axis=0).max() >= OVER_TEMPERATURE)


def lag_is_sought(observations: Observations) -> bool:
    """Whether a lag of the sensors behind the thermometer may matter: where the temperature changes within a session.
    At a level there is nothing to follow but the noise of the thermometer."""
    return _change_within(observations) > LEVEL


def on_a_ramp(observations: Observations) -> bool:
    """Whether a hysteresis may matter: over a range of temperatures, where they change within a session."""
    return over_a_range(observations) and _change_within(observations) > RAMP_RANGE


def _change_within(observations: Observations) -> float:
    """By how much, K, the temperatures of the rests of a session differ at most; 0 without a record of them."""
    kelvin, session = observations.rests.temperatures, observations.session
    if kelvin is None or observations.thermometers is None:
        return 0.0
    each = [kelvin] if session is None else [kelvin[session == s] for s in range(session[-1] + 1)]
    return max(float(np.ptp(own, axis=0).max()) for own in each)


def at_two_temperatures(observations: Observations) -> bool:
    """Whether the rests are at two temperatures, and none between: they show slopes, and no curvature."""
    kelvin = observations.rests.temperatures
    if kelvin is None or not over_a_range(observations):
        return False
    steps = np.diff(np.sort(kelvin, axis=0), axis=0)
    return bool(np.any(steps.max(axis=0) > BETWEEN * np.ptp(kelvin, axis=0)))


def directions(observations: Observations) -> Array:
    """Whether the temperatures of each rest (N, T) came from below, 1, or from above, −1, or 0."""
    rests, thermometers = observations.rests, observations.thermometers
    if thermometers is None:
        return np.zeros((len(rests), 1))
    return thermometers.direction(rests.file, 0.5 * (rests.start + rests.stop))


def ramps_up_and_down(observations: Observations) -> bool:
    """Whether enough rests within the range of every thermometer came from below, and from above."""
    kelvin = observations.rests.temperatures
    if kelvin is None or not on_a_ramp(observations):
        return False
    low, high = kelvin.min(axis=0), kelvin.max(axis=0)
    inner: BoolArray = np.abs(kelvin - 0.5 * (low + high)) < INNER * 0.5 * (high - low)
    came = inner * directions(observations)
    return bool(min((came > 0.0).sum(axis=0).min(), (came < 0.0).sum(axis=0).min()) >= BOTH_WAYS)
