"""Temperatures of thermometers and sensors in simulated sessions: constant, in ramps, or by self-heating.

    "25"            a chamber at 25 °C
    "-10:60"        from −10 to 60 °C over the session, and "-10:60:-10" up in the first half and down in the second
    "22+15@600"     switched on at 22 °C: T(t) = 22 + 15 (1 − exp(−t / 600 s)); so with a ramp, "-10:60:-10+8@300"
    "22+3@200+12@600"   two chips with a thermometer each: the accelerometers warm by 3 K, the gyros by 12 K

True values are those at `REFERENCE` for any profile, so that sessions of one device at several temperatures belong
together; `truth_at` converts them to another temperature.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import get_args

import numpy as np

from tumble.errors import InputError
from tumble.reduction.rests.thermometer import MOVED, Thermometers, followed
from tumble.sensors.grades import GRADES
from tumble.sensors.model import Block, SensorKind, thermometers_of
from tumble.sensors.parameters import FURTHER, THERMAL, Variable, to_temperature
from tumble.units import ZERO_CELSIUS, Array

FINE = 0.1  # s: interval of the temperatures of the sensors
_IN_MEAN = 128  # temperatures in the mean over a rest


@dataclass(frozen=True, kw_only=True, eq=False)
class Climate:
    """Temperatures throughout a session."""

    time: Array  # (N,), s
    kelvin: Array  # (N, T): of the thermometers, linear between the times
    reference: float  # K, at which the parameters have their true values
    lags: Mapping[str, float] = field(default_factory=dict)  # of the sensors behind their thermometers, s, by kind
    span: tuple[float | Array, float | Array] = (
        0.0,
        1.0,
    )  # (T,) each: middle and half the range of each thermometer, K

    def variables(self, time: Array, block: Block) -> dict[Variable, Array]:
        """Return the variables (N, n) with which parameters of the sensors of a block change, at times (N,), s."""
        sensors = self.sensors(time, block.kind)
        x = (sensors - self.span[0]) / self.span[1]
        warmer = sensors - self.reference
        direction = self.record.direction(np.zeros(len(time), dtype=np.int64), time)
        variables: dict[Variable, Array] = {v: warmer**power for power, v in enumerate(THERMAL, 1)}
        variables["hysteresis"] = direction * np.maximum(1.0 - x**2, 0.0)
        return {variable: values[:, block.thermometer] for variable, values in variables.items()}

    def means(self, start: Array, stop: Array, block: Block) -> dict[Variable, Array]:
        """Return the means of these variables from `start` to `stop` (N,), s."""
        nodes = start[:, None] + (stop - start)[:, None] * (np.arange(_IN_MEAN) + 0.5) / _IN_MEAN
        variables = self.variables(nodes.ravel(), block)
        return {variable: values.reshape(*nodes.shape, -1).mean(axis=1) for variable, values in variables.items()}

    def thermometers(self, time: Array) -> Array:
        """Return the temperatures (N, T), K, of the thermometers at times (N,), s."""
        return np.column_stack([np.interp(time, self.time, kelvin) for kelvin in self.kelvin.T])

    def sensors(self, time: Array, kind: SensorKind) -> Array:
        """Return the temperatures (N, T), K, of the sensors of a kind at each thermometer, at times (N,), s."""
        fine, kelvin = self._sensors
        return np.column_stack([np.interp(time, fine, each) for each in kelvin[kind]])

    @cached_property
    def _sensors(self) -> tuple[Array, dict[str, Array]]:
        """Times, s, and temperatures (T, ·), K, of the sensors of each kind."""
        fine = np.arange(self.time[0], self.time[-1] + FINE, FINE)
        read = self.thermometers(fine).T
        lags = {kind: self.lags.get(kind, 0.0) for kind in get_args(SensorKind)}
        return fine, {kind: np.array([followed(each, FINE, lag) for each in read]) for kind, lag in lags.items()}

    @cached_property
    def record(self) -> Thermometers:
        """The record of the thermometers."""
        return Thermometers.of({0: (self.time, self.kelvin)})


REFERENCE = 25.0  # °C, at which the parameters of simulated devices have their true values
REFERENCE_NAME = "temperature.reference"  # its name in truth.json

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)"
_RISE = rf"([-+](?:\d+\.?\d*|\.\d+))@({_NUMBER})"
_PROFILE = re.compile(rf"(.+?)((?:{_RISE})*)")
_LOWEST, _HIGHEST = -100.0, 200.0
_PIECES = 2000  # linear pieces of an exponential, accurate to 1e-6 of its rise in a session of three time constants


@dataclass(frozen=True, kw_only=True, slots=True)
class TemperatureProfile:
    """Temperatures of a session."""

    celsius: tuple[float, ...]  #: °C, at equal steps from start to end; one if constant
    heating: tuple[tuple[float, float], ...] = ((0.0, 600.0),)
    """Rise of each thermometer after power-on, K, and its time constant, s: one for all sensors, two for accelerometers
    and gyros, or one for each sensor."""

    def climate(self, duration: float, lags: Mapping[str, float] | None = None) -> Climate:
        """Return the temperatures of a session of a duration, s, whose sensors have `lags`, s, by kind."""
        celsius = np.array(self.celsius if len(self.celsius) > 1 else 2 * self.celsius)
        time = np.linspace(0.0, duration, len(celsius))
        rise, constant = np.array(self.heating).T
        if rise.any():
            fine = np.union1d(np.linspace(0.0, duration, _PIECES + 1), time)
            celsius, time = np.interp(fine, time, celsius), fine
        kelvin = celsius[:, None] - rise * np.expm1(-time[:, None] / constant) + ZERO_CELSIUS
        low, high = kelvin.min(axis=0), kelvin.max(axis=0)
        return Climate(
            time=time,
            kelvin=kelvin,
            reference=REFERENCE + ZERO_CELSIUS,
            lags=lags or {},
            span=(0.5 * (low + high), np.maximum(0.5 * (high - low), MOVED)),
        )

    def blocks(self, accel: Block, gyro: Block) -> tuple[Block, Block]:
        """Return accelerometers and gyros with these thermometers; raise InputError for an impossible number."""
        numbers = thermometers_of(len(self.heating), accel.size, gyro.size)
        if numbers is None:
            raise InputError(
                f"temperature: expected a rise for all sensors, two for the accelerometers and the gyros, or "
                f"{accel.size + gyro.size}, one a sensor, found {len(self.heating)}"
            )
        by_block = numbers[: accel.size], numbers[accel.size :]
        return replace(accel, thermometers=by_block[0]), replace(gyro, thermometers=by_block[1])


def temperature_profile(text: str) -> TemperatureProfile:
    """Return the profile of a text such as "25", "-10:60:-10", "22+15@600" or "-10:60:-10+8@300+3@200".

    Raises InputError for another text."""
    parts = _PROFILE.fullmatch(text.strip())
    course, rises = (text, "") if parts is None else parts.group(1, 2)
    heating = tuple((float(rise), float(constant)) for rise, constant in re.findall(_RISE, rises))
    profile = TemperatureProfile(celsius=tuple(map(_number, course.split(":"))), heating=heating or ((0.0, 600.0),))
    possible = all(_LOWEST <= c <= _HIGHEST for c in profile.celsius)
    if not possible or not all(abs(rise) <= _HIGHEST and constant > 0.0 for rise, constant in profile.heating):
        raise InputError(
            f"temperature: expected {_LOWEST:g} to {_HIGHEST:g} degC, as 25, -10:60, -10:60:-10, or "
            f"START+RISE@SECONDS, such as 22+15@600, found {text!r}"
        )
    return profile


def _number(text: str) -> float:
    """Return a number, or NaN."""
    return float(text) if re.fullmatch(_NUMBER, text.strip()) else math.nan


def draw_thermal(
    spreads: Mapping[str, float], grade: str, blocks: Mapping[str, Block], rng: np.random.Generator
) -> dict[str, float]:
    """Draw true values of parameters over temperature by name, Gaussian with the standard deviations of a set-up, SI.

    Those missing from the set-up are of its grade; hysteresis is drawn only if the set-up has it."""
    truth: dict[str, float] = {}
    for group in FURTHER:
        usual = group.variable in THERMAL and group.usual
        if not usual and not (group.variable in (*THERMAL, "hysteresis") and group.name in spreads):
            continue
        spread = spreads.get(group.name, group.usual[grade] if grade in GRADES else 0.0)
        names = group.names(blocks[group.kind])
        truth |= zip(names, (spread * rng.standard_normal(len(names))).tolist(), strict=True)
    return truth


def draw_lags(spreads: Mapping[str, float], rng: np.random.Generator) -> dict[str, float]:
    """Draw the lags of the sensors behind the thermometer, s, by kind: absolute Gaussian numbers with the standard
    deviations of a set-up; none without these."""
    sizes = {kind: spreads[f"{kind}.lag"] for kind in get_args(SensorKind) if f"{kind}.lag" in spreads}
    return {kind: abs(spread * float(rng.standard_normal())) for kind, spread in sizes.items()}


def truth_at(
    truth: Mapping[str, float], celsius: float | None, reference_of: Callable[[str], float] | None = None
) -> dict[str, float]:
    """Return true values at another reference temperature, °C, or each at that of `reference_of`; None changes none."""
    if REFERENCE_NAME not in truth or celsius is None:
        return dict(truth)
    names = list(truth)
    temperatures = np.array([celsius if reference_of is None else reference_of(name) for name in names])
    moved = to_temperature(names, temperatures - truth[REFERENCE_NAME]) @ np.array([truth[name] for name in names])
    return dict(zip(names, moved.tolist(), strict=True)) | {REFERENCE_NAME: celsius}


def thermometer_columns(climate: Climate, time: Array) -> dict[str, Array]:
    """Return readings (N,), °C, of the thermometers at times (N,), s: T; T_accel and T_gyro; or T0, T1, …"""
    celsius = climate.thermometers(time).T - ZERO_CELSIUS
    names = {1: ["T"], 2: ["T_accel", "T_gyro"]}.get(len(celsius), [f"T{t}" for t in range(len(celsius))])
    return dict(zip(names, celsius, strict=True))
