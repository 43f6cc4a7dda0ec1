"""Temperatures of a simulated session as they are asked for: a level, a ramp, a ramp up and down, self-heating.

    "25"            a chamber at 25 °C
    "-10:60"        from −10 to 60 °C over the session, and "-10:60:-10" up in the first half and down in the second
    "22+15@600"     switched on at 22 °C: T(t) = 22 + 15 (1 − exp(−t / 600 s))

True values are those at `REFERENCE`, whatever the profile, so that sessions of one device at several levels belong
together; `truth_at` gives them at another temperature.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tumble.errors import InputError
from tumble.sensors.grades import GRADES
from tumble.sensors.model import Block
from tumble.sensors.parameters import FURTHER, ParameterGroup, to_temperature
from tumble.simulation.climate import Climate
from tumble.units import ZERO_CELSIUS, Array

REFERENCE = 25.0
"""°C, at which the true parameters of simulated devices have their values."""
REFERENCE_NAME = "temperature.reference"
"""What truth.json calls it."""

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)"
_HEATING = re.compile(rf"({_NUMBER})([-+](?:\d+\.?\d*|\.\d+))@({_NUMBER})")
_LOWEST, _HIGHEST = -100.0, 200.0
_NODES = 2000
"""Straight pieces of an exponential: closer to it than 1e-6 of its rise in a session of three time constants."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TemperatureProfile:
    """Temperatures, °C, at equal steps from the start of a session to its end, one where it stays the same. With a time
    constant, s, the first is that at power-on, which then goes to the second exponentially."""

    celsius: tuple[float, ...]
    time_constant: float | None = None

    def climate(self, duration: float) -> Climate:
        """The temperature of a session that lasts so long, s."""
        if self.time_constant is None:
            celsius = np.array(self.celsius if len(self.celsius) > 1 else 2 * self.celsius)
            time = np.linspace(0.0, duration, len(celsius))
        else:
            start, end = self.celsius
            time = np.linspace(0.0, duration, _NODES + 1)
            celsius = end + (start - end) * np.exp(-time / self.time_constant)
        return Climate(time=time, kelvin=celsius + ZERO_CELSIUS, reference=REFERENCE + ZERO_CELSIUS)


def temperature_profile(text: str) -> TemperatureProfile:
    """The profile of a text such as "25", "-10:60:-10" or "22+15@600". Raises InputError, one line."""
    heating = _HEATING.fullmatch(text.strip())
    if heating is not None:
        start, rise, constant = map(float, heating.groups())
        found = TemperatureProfile(celsius=(start, start + rise), time_constant=constant)
    else:
        found = TemperatureProfile(celsius=tuple(map(_number, text.split(":"))))
    possible = all(_LOWEST <= celsius <= _HIGHEST for celsius in found.celsius)
    if not possible or (found.time_constant is not None and not found.time_constant > 0.0):
        raise InputError(
            f"temperature: expected {_LOWEST:g} to {_HIGHEST:g} degC, as 25, -10:60, -10:60:-10, or "
            f"START+RISE@SECONDS, such as 22+15@600, found {text!r}"
        )
    return found


def _number(text: str) -> float:
    """A number, or not a number."""
    return float(text) if re.fullmatch(_NUMBER, text.strip()) else math.nan


def thermal_groups() -> list[ParameterGroup]:
    """The groups of the table that change with temperature or its square."""
    return [group for group in FURTHER if group.variable in ("temperature", "temperature²")]


def draw_thermal(
    spreads: Mapping[str, float], grade: str, blocks: Mapping[str, Block], rng: np.random.Generator
) -> dict[str, float]:
    """True values by name of what changes with temperature, Gaussian with the standard deviations, SI, of a set-up or,
    where it has none, of its grade."""
    found: dict[str, float] = {}
    for group in thermal_groups():
        spread = spreads.get(group.name, group.usual[grade] if grade in GRADES else 0.0)
        names = group.names(blocks[group.kind])
        found |= zip(names, (spread * rng.standard_normal(len(names))).tolist(), strict=True)
    return found


def truth_at(truth: Mapping[str, float], celsius: float | None) -> dict[str, float]:
    """True values at another temperature than their reference; as they are where there is none."""
    if REFERENCE_NAME not in truth or celsius is None:
        return dict(truth)
    names = list(truth)
    moved = to_temperature(names, celsius - truth[REFERENCE_NAME]) @ np.array([truth[name] for name in names])
    return dict(zip(names, moved.tolist(), strict=True)) | {REFERENCE_NAME: celsius}


def thermometer_column(climate: Climate, time: Array) -> Array:
    """Readings (N,), °C, of the thermometer at times (N,), s."""
    return np.asarray(climate.thermometer(time) - ZERO_CELSIUS)
