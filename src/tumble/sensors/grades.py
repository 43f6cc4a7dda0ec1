"""Grades of instruments: typical errors before calibration, and noise."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

from tumble.earth import EARTH_RATE
from tumble.errors import InputError, did_you_mean
from tumble.sensors.parameters import LINEAR, group_name, sensor_kind, size_of, within_kind
from tumble.usual_setup import INSTABILITY_TIME

OUTLYING = 100.0  # gyro bias, in spreads of a grade, that no gyro of the grade has


@dataclass(frozen=True, kw_only=True, slots=True)
class NoiseModel:
    """Noise of every sensor of a block.

    `accel_white`, `gyro_white`: densities of the white noise, m/s²/√Hz and rad/s/√Hz. `accel_instability`,
    `gyro_instability`: standard deviations of the change of a bias within a session, m/s² and rad/s, a stationary
    Gauss–Markov process with the correlation time `instability_time`, s. With a time of 0 it is drawn for every rest
    and kept during the move that follows."""

    accel_white: float = 0.0
    gyro_white: float = 0.0
    accel_instability: float = 0.0
    gyro_instability: float = 0.0
    instability_time: float = INSTABILITY_TIME

    def scaled(self, factor: float) -> NoiseModel:
        """Return the model with all noise multiplied by a factor."""
        sizes = ("accel_white", "gyro_white", "accel_instability", "gyro_instability")
        return replace(self, **{size: factor * getattr(self, size) for size in sizes})


@dataclass(frozen=True, kw_only=True, slots=True)
class Spread:
    """Standard deviations over instruments of the parameters before calibration: bias, m/s² or rad/s; scale-factor
    error; axis angles, rad."""

    bias: float
    scale: float
    axis: float


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Spreads:
    """Standard deviations of the parameters of both kinds of sensors."""

    accel: Spread
    gyro: Spread


@dataclass(frozen=True, kw_only=True, slots=True)
class Grade(Spreads):
    """Typical errors before calibration, and noise, of a class of instruments."""

    noise: NoiseModel


def spread_of(instruments: Spreads, parameter: str) -> float:
    """Return the standard deviation, SI, of a parameter or group of the linear model, such as "accel.bias.x" or
    "accel.bias"."""
    spread = getattr(instruments, sensor_kind(parameter))
    return float(getattr(spread, within_kind(group_name(parameter))))


def _spreads(sizes: Mapping[str, float | str]) -> dict[str, Spread]:
    """Return spreads by kind of sensors from sizes by group of the linear model, in SI or with a unit."""
    return {
        kind: Spread(**{what: size_of(sizes[f"{kind}.{what}"]) for what in ("bias", "scale", "axis")})
        for kind in ("accel", "gyro")
    }


_TABLE = tomllib.loads((Path(__file__).parent / "grades.toml").read_text(encoding="utf-8"))
GRADES: Mapping[str, Grade] = MappingProxyType(
    {
        name: Grade(
            **_spreads({group.name: group.usual[name] for group in LINEAR}),
            noise=NoiseModel(**{key: size_of(size) for key, size in noise.items()}),
        )
        for name, noise in _TABLE["noise"].items()
    }
)
TURN_ON: Mapping[str, Spreads] = MappingProxyType(
    {name: Spreads(**_spreads(sizes)) for name, sizes in _TABLE["power_on"].items()}
)
"""Standard deviation of parameters over power-ons, by grade."""


def grade(name: str) -> Grade:
    """Return the grade of this name. Raises InputError for an unknown name."""
    if name not in GRADES:
        advice = did_you_mean(name, GRADES)
        raise InputError(f"grade: expected one of {', '.join(GRADES)}, found {name!r}{advice}")
    return GRADES[name]


def guessed_grade(accel_white: float, gyro_white: float | None, gyro_bias: float = 0.0) -> tuple[str, str]:
    """Return the grade whose white noise is nearest, by ratios, and the evidence for it in words.

    `accel_white`, `gyro_white`: white noise of a recording, m/s²/√Hz and rad/s/√Hz, None without gyros. Accelerometers
    have less weight: those of one grade differ more than its gyros. `gyro_bias`: largest gyro reading at rest, rad/s,
    which excludes grades with smaller biases."""

    def distance(name: str) -> float:
        noise = GRADES[name].noise
        by_accel = 0.3 * abs(math.log(max(accel_white, 1e-12) / noise.accel_white))
        return by_accel if gyro_white is None else by_accel + abs(math.log(max(gyro_white, 1e-15) / noise.gyro_white))

    *others, poorest = GRADES
    possible = [name for name in others if gyro_bias < OUTLYING * GRADES[name].gyro.bias + EARTH_RATE]
    by_noise, nearest = min(GRADES, key=distance), min([*possible, poorest], key=distance)
    return nearest, "the noise" if nearest == by_noise else "the biases of the gyros"
