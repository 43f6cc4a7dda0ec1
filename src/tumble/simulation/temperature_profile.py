"""Temperatures of a simulated session as they are asked for: a level, a ramp, a ramp up and down, self-heating.

    "25"            a chamber at 25 °C
    "-10:60"        from −10 to 60 °C over the session, and "-10:60:-10" up in the first half and down in the second
    "22+15@600"     switched on at 22 °C: T(t) = 22 + 15 (1 − exp(−t / 600 s)); so with a ramp, "-10:60:-10+8@300"
    "22+3@200+12@600"   two chips with a thermometer each: the accelerometers warm by 3 K, the gyros by 12 K

True values are those at `REFERENCE`, whatever the profile, so that sessions of one device at several levels belong
together; `truth_at` gives them at another temperature.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from tumble.errors import InputError
from tumble.reduction.rests.thermometer import MOVED
from tumble.sensors.grades import GRADES
from tumble.sensors.model import Block, thermometers_of
from tumble.sensors.parameters import FURTHER, ParameterGroup, to_temperature
from tumble.simulation.climate import Climate
from tumble.units import ZERO_CELSIUS, Array

REFERENCE = 25.0
"""°C, at which the true parameters of simulated devices have their values."""
REFERENCE_NAME = "temperature.reference"
"""What truth.json calls it."""
LAG_NAME = "temperature.lag"
"""And the lag of the sensors behind the thermometer."""

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)"
_RISE = rf"([-+](?:\d+\.?\d*|\.\d+))@({_NUMBER})"
_PROFILE = re.compile(rf"(.+?)((?:{_RISE})*)")
_LOWEST, _HIGHEST = -100.0, 200.0
_NODES = 2000
"""Straight pieces of an exponential: closer to it than 1e-6 of its rise in a session of three time constants."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TemperatureProfile:
    """Temperatures, °C, at equal steps from the start of a session to its end, one where it stays the same, and on top
    of them the `heating` of each thermometer from power-on, K, which is reached exponentially with a time constant, s:
    one for all sensors, two for the accelerometers and the gyros, or one a sensor."""

    celsius: tuple[float, ...]
    heating: tuple[tuple[float, float], ...] = ((0.0, 600.0),)

    def climate(self, duration: float, lag: float = 0.0) -> Climate:
        """The temperatures of a session that lasts so long, s, with sensors that follow them with a lag, s."""
        celsius = np.array(self.celsius if len(self.celsius) > 1 else 2 * self.celsius)
        time = np.linspace(0.0, duration, len(celsius))
        rise, constant = np.array(self.heating).T
        if rise.any():
            fine = np.union1d(np.linspace(0.0, duration, _NODES + 1), time)
            celsius, time = np.interp(fine, time, celsius), fine
        kelvin = celsius[:, None] - rise * np.expm1(-time[:, None] / constant) + ZERO_CELSIUS
        low, high = kelvin.min(axis=0), kelvin.max(axis=0)
        return Climate(
            time=time,
            kelvin=kelvin,
            reference=REFERENCE + ZERO_CELSIUS,
            lag=lag,
            span=(0.5 * (low + high), np.maximum(0.5 * (high - low), MOVED)),
        )

    def blocks(self, accel: Block, gyro: Block) -> tuple[Block, Block]:
        """Accelerometers and gyros with these thermometers. Raises InputError for another number than they can have."""
        found = thermometers_of(len(self.heating), accel.size, gyro.size)
        if found is None:
            raise InputError(
                f"temperature: expected a rise for all sensors, two for the accelerometers and the gyros, or "
                f"{accel.size + gyro.size}, one a sensor, found {len(self.heating)}"
            )
        own = found[: accel.size], found[accel.size :]
        return replace(accel, thermometers=own[0]), replace(gyro, thermometers=own[1])


def temperature_profile(text: str) -> TemperatureProfile:
    """The profile of a text such as "25", "-10:60:-10", "22+15@600" or "-10:60:-10+8@300+3@200". Raises InputError,
    one line."""
    parts = _PROFILE.fullmatch(text.strip())
    course, rises = (text, "") if parts is None else parts.group(1, 2)
    heating = tuple((float(rise), float(constant)) for rise, constant in re.findall(_RISE, rises))
    found = TemperatureProfile(celsius=tuple(map(_number, course.split(":"))), heating=heating or ((0.0, 600.0),))
    possible = all(_LOWEST <= c <= _HIGHEST for c in found.celsius)
    if not possible or not all(abs(rise) <= _HIGHEST and constant > 0.0 for rise, constant in found.heating):
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
    where it has none, of its grade; and where the set-up has them, of hysteresis."""
    found: dict[str, float] = {}
    hysteresis = [group for group in FURTHER if group.variable == "hysteresis" and group.name in spreads]
    for group in thermal_groups() + hysteresis:
        spread = spreads.get(group.name, group.usual[grade] if grade in GRADES else 0.0)
        names = group.names(blocks[group.kind])
        found |= zip(names, (spread * rng.standard_normal(len(names))).tolist(), strict=True)
    return found


def draw_lag(spreads: Mapping[str, float], rng: np.random.Generator) -> float:
    """The lag of the sensors behind the thermometer, s, the size of a Gaussian number with the standard deviation of a
    set-up; none where that has none."""
    return abs(spreads[LAG_NAME] * float(rng.standard_normal())) if LAG_NAME in spreads else 0.0


def truth_at(
    truth: Mapping[str, float], celsius: float | None, own: Callable[[str], float] | None = None
) -> dict[str, float]:
    """True values at another temperature than their reference, or each at its `own`; as they are where there is
    none."""
    if REFERENCE_NAME not in truth or celsius is None:
        return dict(truth)
    names = list(truth)
    there = np.array([celsius if own is None else own(name) for name in names])
    moved = to_temperature(names, there - truth[REFERENCE_NAME]) @ np.array([truth[name] for name in names])
    return dict(zip(names, moved.tolist(), strict=True)) | {REFERENCE_NAME: celsius}


def thermometer_columns(climate: Climate, time: Array) -> dict[str, Array]:
    """Readings (N,), °C, of the thermometers at times (N,), s: T; T_accel and T_gyro; or T0, T1, … of the sensors."""
    celsius = climate.thermometers(time).T - ZERO_CELSIUS
    names = {1: ["T"], 2: ["T_accel", "T_gyro"]}.get(len(celsius), [f"T{t}" for t in range(len(celsius))])
    return dict(zip(names, celsius, strict=True))
