"""What parameters change with: time, temperature and its square, the direction in which the temperature came, and, of
several sessions, that they are several.

Temperatures are those of the thermometer, or of what follows it with a lag (dynamics method, §8 and A5). The reference
T₀ is the mean of the thermometer over the rests, so that T − T₀ is small and a parameter has its value at T₀.
Hysteresis is h sgn(Ṫ)(1 − x²), x = −1 … 1 over the range of the rests.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tumble.reduction.observations import Observations
from tumble.sensors.parameters import Variable
from tumble.units import Array, BoolArray

OVER_TEMPERATURE = 10.0
"""K: where the rests span less, a lag and a hysteresis are not sought."""
BOTH_WAYS = 3
"""Rests that have to come from each side for a hysteresis to be sought."""
INNER = 0.8
"""Of half the range: beyond, a hysteresis does nothing."""
LAG_STEP = 1.0  # s, of the difference for the derivative

Variables = Mapping[Variable, tuple[Array, Array]]
"""In the middle of the rests (N,) and of the turns (K,)."""


def variables_of(observations: Observations, lag: float = 0.0) -> dict[Variable, tuple[Array, Array]]:
    """What parameters may change with: time from the middle of the session, s, temperature from its mean, K, and its
    square, in the middle of the rests (N,) and of the turns (K,); and of several sessions, each of them."""
    rests, turns, session = observations.rests, observations.turns, observations.session
    time = 0.5 * (rests.start + rests.stop)
    for of in (slice(None),) if session is None else (session == s for s in range(session[-1] + 1)):
        time[of] -= 0.5 * (time[of].min() + time[of].max())
    at_rest: dict[Variable, Array] = {"time": time}
    if session is not None:
        at_rest["launch"] = np.ones(len(rests))
    if rests.temperature is not None:
        at_rest |= _of_temperature(observations, rests.temperature, lag)
    if turns is None:
        return {name: (values, np.zeros(0)) for name, values in at_rest.items()}
    return {name: (v, 0.5 * (v[turns.first] + v[turns.last])) for name, v in at_rest.items()}


def _of_temperature(observations: Observations, kelvin: Array, lag: float) -> dict[Variable, Array]:
    """What goes with the temperature, at rest (N,)."""
    warmer = sensors_at(observations, kelvin, lag) - kelvin.mean()
    out: dict[Variable, Array] = {"temperature": warmer, "temperature²": warmer**2}
    if lag_is_sought(observations):
        out["lag"] = np.zeros(len(kelvin))
    if both_ways(observations):
        x = (warmer + kelvin.mean() - 0.5 * (kelvin.min() + kelvin.max())) / (0.5 * np.ptp(kelvin))
        out["hysteresis"] = directions(observations) * np.maximum(1.0 - x**2, 0.0)
    return out


def sensors_at(observations: Observations, kelvin: Array, lag: float) -> Array:
    """Temperatures (N,), K, of sensors that follow the thermometer with a lag, at rests where it has `kelvin` (N,)."""
    thermometer, rests = observations.thermometer, observations.rests
    if thermometer is None or lag == 0.0:
        return kelvin
    middle = 0.5 * (rests.start + rests.stop)
    return np.asarray(kelvin + thermometer.at(rests.file, middle, lag) - thermometer.at(rests.file, middle))


def by_lag(observations: Observations, lag: float) -> dict[Variable, tuple[Array, Array]]:
    """Derivatives by the lag, 1/s, of what goes with the temperature."""
    later, sooner = (variables_of(observations, lag + step) for step in (LAG_STEP, -LAG_STEP))
    return {
        name: (
            (later[name][0] - sooner[name][0]) / (2.0 * LAG_STEP),
            (later[name][1] - sooner[name][1]) / (2.0 * LAG_STEP),
        )
        for name in later
        if name in ("temperature", "temperature²", "hysteresis")
    }


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
