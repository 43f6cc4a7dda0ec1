"""What parameters change with: time, temperature and its square, the direction in which the temperature came, and, of
several sessions, that they are several.

Temperatures are those of the thermometer, or of what follows it with a lag (dynamics method, §8 and A5), as means over
each rest and each turn: where a ramp turns back within a turn the rests beside it do not say how warm it was, and the
mean of a square is not the square of a mean. The reference T₀ is the mean of the thermometer over the rests, so that
T − T₀ is small and a parameter has its value at T₀. Hysteresis is h sgn(Ṫ)(1 − x²), x = −1 … 1 over the range of the
thermometer in the recording: it is nothing where the temperature turns back.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tumble.reduction.observations import Observations
from tumble.reduction.thermometer import Warmth
from tumble.reduction.warming import OVER_TEMPERATURE
from tumble.sensors.parameters import Variable
from tumble.units import Array, BoolArray

BOTH_WAYS = 3
"""Rests that have to come from each side for a hysteresis to be sought."""
INNER = 0.8
"""Of half the range: beyond, a hysteresis does nothing."""
LAG_STEP = 1.0  # s, of the difference for the derivative

Variables = Mapping[Variable, tuple[Array, Array, Array]]
"""Of the rests (N,) and of the turns (K,), and by how much a second it grows within the turns (K,)."""
GROWING = 2
"""The place of the last."""


def variables_of(observations: Observations, lag: float = 0.0) -> dict[Variable, tuple[Array, Array, Array]]:
    """What parameters may change with, of the rests and turns: time from the middle of the session, s, temperature from
    its mean, K, and its square, and the direction it came from; and of several sessions, each of them."""
    rests, turns, session = observations.rests, observations.turns, observations.session
    time = 0.5 * (rests.start + rests.stop)
    for of in (slice(None),) if session is None else (session == s for s in range(session[-1] + 1)):
        time[of] -= 0.5 * (time[of].min() + time[of].max())
    at_rest: dict[Variable, Array] = {"time": time}
    if session is not None:
        at_rest["launch"] = np.ones(len(rests))
    first, last = (np.zeros((2, 0), dtype=np.int64)) if turns is None else (turns.first, turns.last)
    grows = {"time": 1.0, "launch": 0.0}
    out = {name: (v, 0.5 * (v[first] + v[last]), np.full(len(first), grows[name])) for name, v in at_rest.items()}
    if rests.temperature is not None:
        out |= _of_temperature(observations, rests.temperature, lag)
    return out


def _of_temperature(
    observations: Observations, kelvin: Array, lag: float
) -> dict[Variable, tuple[Array, Array, Array]]:
    """What goes with the temperature."""
    reference, seconds = float(kelvin.mean()), np.maximum(_turning(observations)[1], 1.0)
    rest, turn, before, after = (_of_warmth(each, reference) for each in _warmth(observations, kelvin, lag))
    out = {name: (rest[name], turn[name], 2.0 * (after[name] - before[name]) / seconds) for name in rest}
    if not both_ways(observations):
        del out["hysteresis"]
    if lag_is_sought(observations):
        out["lag"] = np.zeros(len(kelvin)), np.zeros(len(seconds)), np.zeros(len(seconds))
    return out


def _of_warmth(warmth: Warmth, reference: float) -> dict[Variable, Array]:
    """What goes with a temperature, of a reference, K."""
    warmer = warmth.kelvin - reference
    return {"temperature": warmer, "temperature²": warmer**2 + warmth.variance, "hysteresis": warmth.hysteresis}


def sensors_at(observations: Observations, kelvin: Array, lag: float) -> Array:
    """Mean temperatures (N,), K, of sensors that follow the thermometer with a lag, at rests where it has `kelvin`
    (N,)."""
    return _warmth(observations, kelvin, lag)[0].kelvin


def _turning(observations: Observations) -> tuple[Array, Array]:
    """When the turns begin, and how long they last (K,), s."""
    rests, turns = observations.rests, observations.turns
    if turns is None:
        return np.zeros(0), np.zeros(0)
    return rests.stop[turns.first], rests.start[turns.last] - rests.stop[turns.first]


def _warmth(observations: Observations, kelvin: Array, lag: float) -> tuple[Warmth, Warmth, Warmth, Warmth]:
    """What the sensors have in the rests, in the turns, and in the first and in the second half of these, by the record
    of the thermometer; without one the `kelvin` (N,) of the rests, and of the turns what is between."""
    rests, turns, thermometer = observations.rests, observations.turns, observations.thermometer
    first, last = (np.zeros((2, 0), dtype=np.int64)) if turns is None else (turns.first, turns.last)
    if thermometer is None:
        between = 0.5 * (kelvin[first] + kelvin[last])
        at_rest, in_turns = (Warmth(kelvin=k, variance=0.0 * k, hysteresis=0.0 * k) for k in (kelvin, between))
        return at_rest, in_turns, in_turns, in_turns
    begin, seconds = _turning(observations)
    middle, end, K = begin + 0.5 * seconds, begin + seconds, len(first)
    file = np.concatenate([rests.file, np.tile(rests.file[first], 3)])
    when = np.concatenate([rests.start, begin, begin, middle]), np.concatenate([rests.stop, end, middle, end])
    every = thermometer.means(file, *when, lag)
    in_turns, before, after = (every[len(rests) + i * K : len(rests) + (i + 1) * K] for i in range(3))
    return every[: len(rests)], in_turns, before, after


def by_lag(observations: Observations, lag: float) -> dict[Variable, tuple[Array, Array, Array]]:
    """Derivatives by the lag, 1/s, of what goes with the temperature."""
    later, sooner = (variables_of(observations, lag + step) for step in (LAG_STEP, -LAG_STEP))
    out: dict[Variable, tuple[Array, Array, Array]] = {}
    for name in (name for name in later if name in ("temperature", "temperature²", "hysteresis")):
        rest, turn, grows = ((b - a) / (2.0 * LAG_STEP) for b, a in zip(later[name], sooner[name], strict=True))
        out[name] = rest, turn, grows
    return out


def lag_is_sought(observations: Observations) -> bool:
    """Whether a lag of the sensors behind the thermometer may matter: the temperatures differ by enough."""
    kelvin = observations.rests.temperature
    return observations.thermometer is not None and kelvin is not None and bool(np.ptp(kelvin) >= OVER_TEMPERATURE)


def directions(observations: Observations) -> Array:
    """Whether the temperature of each rest (N,) came from below, 1, or from above, −1, or 0."""
    rests, thermometer = observations.rests, observations.thermometer
    if thermometer is None:
        return np.zeros(len(rests))
    return thermometer.direction(rests.file, 0.5 * (rests.start + rests.stop))


def both_ways(observations: Observations) -> bool:
    """Whether enough rests within the range of temperatures came from below, and from above."""
    kelvin = observations.rests.temperature
    if kelvin is None or not lag_is_sought(observations):
        return False
    inner: BoolArray = np.abs(kelvin - 0.5 * (kelvin.min() + kelvin.max())) < INNER * 0.5 * np.ptp(kelvin)
    came = directions(observations)[inner]
    return bool(min((came > 0.0).sum(), (came < 0.0).sum()) >= BOTH_WAYS)
