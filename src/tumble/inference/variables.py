"""Variables with which parameters change: time, powers of temperature, hysteresis, lag, and launch.

Temperatures are those of the accelerometers and of the gyros, which follow their thermometers with one lag each
(docs/explanation/mathematics.md (15), section 12). They are means over each rest and each turn, because within a turn
the temperature may have an extremum, and because the mean of a square is not the square of the mean. The reference T₀
is the mean of each thermometer over the rests, so that T − T₀ is small and a parameter has its value at T₀. Hysteresis
is h sgn(Ṫ)(1 − x²), with x = −1 … 1 over the range of the thermometer in the recording, which is zero where the
temperature turns back.
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

BOTH_WAYS = 3  # fewest rests on each branch for an estimate of hysteresis
INNER = 0.8  # part of half the range outside which a hysteresis is too small to count
# K: range of temperatures in a session below which a lag is neglected. A lag changes a temperature by at most half the
# range, and that times a usual slope is within the usual instability of a bias, in every grade.
LEVEL = 0.05
RAMP_RANGE = 1.0  # K: range within a session from which hysteresis is estimated, or a remark made on motion
BETWEEN = 0.8  # part of the range without a rest above which all rests are at its two ends

NO_LAGS: Mapping[str, float] = MappingProxyType({})
KINDS: tuple[SensorKind, ...] = ("accel", "gyro")
# Values at the rests (N, 2 T) and in the turns (K, 2 T), and growth in the turns (K, 2 T), 1/s: for accelerometers with
# each of the T thermometers, then for gyros; or (·, 1) if all parameters have the same variable.
Variables = Mapping[Variable, tuple[Array, Array, Array]]
GROWING = 2  # index of the growth


def variables_of(
    observations: Observations, lags: Mapping[str, float] = NO_LAGS
) -> dict[Variable, tuple[Array, Array, Array]]:
    """Return the variables of a session, or of several, at rests and in turns.

    These are time from the mean of the rests of its session, s; temperatures of the sensors, with `lags` by kind of
    sensor, s, from the mean of the thermometer, K, with powers and hysteresis; and 1 for each of several launches."""
    rests, turns, session = observations.rests, observations.turns, observations.session
    time = 0.5 * (rests.start + rests.stop)
    for part in (slice(None),) if session is None else (session == s for s in range(session[-1] + 1)):
        time[part] -= time[part].mean() if len(time) else 0.0
    at_rest: dict[Variable, Array] = {"time": time[:, None]}
    if session is not None:
        at_rest["launch"] = np.ones((len(rests), 1))
    first, last = (np.zeros((2, 0), dtype=np.int64)) if turns is None else (turns.first, turns.last)
    grows = {"time": 1.0, "launch": 0.0}
    out = {name: (v, 0.5 * (v[first] + v[last]), np.full((len(first), 1), grows[name])) for name, v in at_rest.items()}
    if rests.temperatures is not None and observations.links is None:  # in motion in-run biases follow the temperature
        accel, gyro = (_temperature_regressors(observations, lags.get(kind, 0.0)) for kind in KINDS)
        for name in accel:
            rest, turn, growth = map(np.hstack, zip(accel[name], gyro[name], strict=True))
            out[name] = rest, turn, growth
    return out


@lru_cache(maxsize=4)
def _temperature_regressors(observations: Observations, lag: float) -> dict[Variable, tuple[Array, Array, Array]]:
    """Return the variables of temperature for sensors that follow each thermometer with a lag, s."""
    kelvin = observations.rests.temperatures
    assert kelvin is not None
    reference, seconds = kelvin.mean(axis=0), np.maximum(_turning(observations)[1], 1.0)[:, None]
    rest, turn, before, after = (
        _powers_of_temperature(warmth, reference) for warmth in _mean_temperatures(observations, kelvin, lag)
    )
    out = {name: (rest[name], turn[name], 2.0 * (after[name] - before[name]) / seconds) for name in rest}
    if _range_within_session(observations) > LEVEL:  # enough for a lag to matter; its effect is in the temperatures
        out["lag"] = np.zeros_like(rest["temperature"]), *np.zeros((2, *turn["temperature"].shape))
    if not on_a_ramp(observations):
        del out["hysteresis"]
    return out


def _powers_of_temperature(warmth: Warmth, reference: Array) -> dict[Variable, Array]:
    """Return mean powers of temperatures about the references (T,), K, and hysteresis."""
    difference = warmth.kelvin - reference
    square, cube = difference**2 + warmth.variance, difference**3 + 3.0 * difference * warmth.variance
    return {"temperature": difference, "temperature²": square, "temperature³": cube, "hysteresis": warmth.hysteresis}


def sensors_at(observations: Observations, kelvin: Array, lag: float) -> Array:
    """Return mean temperatures (N, T), K, at rest of sensors that follow thermometers of `kelvin` (N, T) with a lag."""
    return _mean_temperatures(observations, kelvin, lag)[0].kelvin


def _turning(observations: Observations) -> tuple[Array, Array]:
    """Return start and duration of the turns (K,), s."""
    rests, turns = observations.rests, observations.turns
    if turns is None:
        return np.zeros(0), np.zeros(0)
    return rests.stop[turns.first], rests.start[turns.last] - rests.stop[turns.first]


def _mean_temperatures(observations: Observations, kelvin: Array, lag: float) -> tuple[Warmth, Warmth, Warmth, Warmth]:
    """Return temperatures of the sensors in rests, in turns, and in the first and second halves of turns.

    Without records of the thermometers they are the `kelvin` (N, T) of the rests, and their means for turns."""
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
    means = thermometers.means(file, *when, lag)
    in_turns, before, after = (means[len(rests) + i * K : len(rests) + (i + 1) * K] for i in range(3))
    return means[: len(rests)], in_turns, before, after


def over_a_range(observations: Observations) -> bool:
    """Return True if the temperatures of all rests differ by enough to estimate coefficients."""
    kelvin = observations.rests.temperatures
    if observations.thermometers is None or kelvin is None:
        return False
    return bool(np.ptp(kelvin, axis=0).max() >= OVER_TEMPERATURE)


def on_a_ramp(observations: Observations) -> bool:
    """Return True if the temperature changes enough, overall and within a session, for hysteresis to matter."""
    return over_a_range(observations) and _range_within_session(observations) > RAMP_RANGE


def _range_within_session(observations: Observations) -> float:
    """Return the largest range of temperatures, K, of the rests of a session; 0 without a record of temperatures."""
    kelvin, session = observations.rests.temperatures, observations.session
    if kelvin is None or observations.thermometers is None:
        return 0.0
    sessions = [kelvin] if session is None else [kelvin[session == s] for s in range(session[-1] + 1)]
    return max(float(np.ptp(values, axis=0).max()) for values in sessions)


def at_two_temperatures(observations: Observations) -> bool:
    """Return True if all rests are at two temperatures, which determine slopes but no curvature."""
    kelvin = observations.rests.temperatures
    if kelvin is None or not over_a_range(observations):
        return False
    steps = np.diff(np.sort(kelvin, axis=0), axis=0)
    return bool(np.any(steps.max(axis=0) > BETWEEN * np.ptp(kelvin, axis=0)))


def directions(observations: Observations) -> Array:
    """Return 1 where the temperature of a rest (N, T) was rising, −1 where it was falling, or 0."""
    rests, thermometers = observations.rests, observations.thermometers
    if thermometers is None:
        return np.zeros((len(rests), 1))
    return thermometers.direction(rests.file, 0.5 * (rests.start + rests.stop))


def ramps_up_and_down(observations: Observations) -> bool:
    """Return True if enough rests within the range of every thermometer were on rising and on falling temperature."""
    kelvin = observations.rests.temperatures
    if kelvin is None or not on_a_ramp(observations):
        return False
    low, high = kelvin.min(axis=0), kelvin.max(axis=0)
    inner: BoolArray = np.abs(kelvin - 0.5 * (low + high)) < INNER * 0.5 * (high - low)
    direction = inner * directions(observations)
    return bool(min((direction > 0.0).sum(axis=0).min(), (direction < 0.0).sum(axis=0).min()) >= BOTH_WAYS)
