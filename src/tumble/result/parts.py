"""What a calibration consists of: parameters, rests, turns, launches and fits, and how the calibration file has them.

Each part has a dataclass and a function that reads it from the content of a file; further keys may be there or not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import erfc, inf, isfinite, sqrt
from typing import Any, TypeVar

import numpy as np
from scipy.special import stdtrit

from tumble.inference.estimate import Fit
from tumble.recording.circumstances import UNKNOWN, Circumstances
from tumble.recording.session import Site
from tumble.units import Array

_Value = TypeVar("_Value")


@dataclass(frozen=True, kw_only=True, slots=True)
class Parameter:
    """A named quantity with its standard uncertainty (None where the method gives none), SI; where the session names a
    systematic (passport) calibration, with the deviation from it; for the mean of several launches with the standard
    deviation from launch to launch."""

    name: str
    value: float
    u: float | None
    unit: str
    deviation: float | None = None
    run_to_run: float | None = None
    dof: float | None = None
    """Degrees of freedom with which u was estimated; None where the noise is known."""
    prior: float | None = None
    """Standard deviation of what was known before, where that is of any weight."""
    learned: float | None = None
    """How much of the prior's variance the session has taken off, 0 to 1."""

    @property
    def k(self) -> float | None:
        """The coverage factor of U = k u, of 95.45 %: Student's t for `dof`; None where there are fewer than
        FEWEST_DEGREES."""
        return stated_factor(self.dof)


FEWEST_DEGREES = 0.99
"""Degrees of freedom without which no U is stated, those of two readings, one, but for its rounding: t is then beyond
14, and soon beyond any use, and says less of the value than of how little is known of u."""


def stated_factor(degrees: float | None) -> float | None:
    """The coverage factor for so many degrees of freedom, infinite where None; None where they are too few for a U."""
    known = inf if degrees is None else degrees
    return None if known < FEWEST_DEGREES else coverage_factor(known)


def coverage_factor(degrees: float) -> float:
    """t₉₅.₄₅(ν): within ±k u lies the true value in 95.45 of 100 cases, u being estimated with ν degrees of freedom."""
    return float(-stdtrit(degrees, 0.5 * erfc(sqrt(2.0)))) if isfinite(degrees) else 2.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Readings:
    """What the readings of n sensors are: SI = (raw − offset) / scale of the log's columns, for increments divided by
    the interval of the sample. `scale` (n,) and `offset` (n,) are in the log's `unit`. Of a table, `row_u` (n,) is the
    standard uncertainty of one row, SI, beside the scatter between positions; empty where that is all there is."""

    columns: tuple[str, ...]
    unit: str
    increments: bool
    scale: tuple[float, ...]
    offset: tuple[float, ...]
    row_u: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class SensorsAtRest:
    """Of each of n sensors over a rest, SI: mean reading, density of its noise (unit/√Hz) and drift, its change; and
    the temperature of its thermometer, °C, where they have some."""

    mean: tuple[float, ...]
    noise: tuple[float, ...]
    drift: tuple[float, ...]
    temperature: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class RestResult:
    """A rest as used: times (s), residual |corrected reading| − g (m/s²) and how many sigmas it is from the fit; the
    code of its attitude in the programme, what its sensors read, and the temperature (°C), where there are such."""

    file: int
    start: float
    stop: float
    residual: float
    sigmas: float
    attitude: str | None = None
    accel: SensorsAtRest | None = None
    gyro: SensorsAtRest | None = None
    temperature: float | None = None

    @property
    def temperatures(self) -> tuple[float, ...]:
        """Those of its sensors, °C, the accelerometers first; that of the rest where they are not known apart."""
        own = sum((sensors.temperature for sensors in (self.accel, self.gyro) if sensors is not None), ())
        return own or (() if self.temperature is None else (self.temperature,))


@dataclass(frozen=True, kw_only=True, slots=True)
class TurnResult:
    """A turn from one rest to another (from 0) as used: its duration (s), its angle as the calibrated gyros saw it and
    as the programme has it (rad, 0 … π; None where there is none) and how many sigmas it is from the fit."""

    first: int
    last: int
    duration: float
    angle: float | None
    programmed: float | None
    sigmas: float


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Launch:
    """One of several sessions behind a calibration."""

    session: str
    parameters: tuple[Parameter, ...]
    covariance: Array | None
    log_sha256: str
    site: Site | None = None
    rests: tuple[RestResult, ...] = ()
    turns: tuple[TurnResult, ...] = ()
    fits: Mapping[str, Fit] = field(default_factory=dict)
    circumstances: Circumstances = UNKNOWN


@dataclass(frozen=True, kw_only=True, slots=True)
class Member:
    """One of several sessions in one estimate: its name and the SHA-256 of its log, how many rests and turns it has,
    those that warm counted part by part, the lowest and the highest temperature of its rests, °C, and the parameters
    that it has of its own."""

    session: str
    log_sha256: str
    rests: int
    turns: int
    temperatures: tuple[float, float]
    parameters: tuple[Parameter, ...] = ()
    date: str | None = None
    """When it was recorded, ISO 8601."""


def member_content(member: Member) -> dict[str, Any]:
    """A session of several as the file has it."""
    return {
        "session": member.session,
        "log_sha256": member.log_sha256,
        "rests": member.rests,
        "turns": member.turns,
        "temperatures": list(member.temperatures),
        "parameters": [parameter_content(p) for p in member.parameters],
        "date": member.date,
    }


def member_from(content: Mapping[str, Any]) -> Member:
    """A session of several of the file."""
    low, high = map(float, content["temperatures"])
    return Member(
        session=content["session"],
        log_sha256=content["log_sha256"],
        rests=int(content["rests"]),
        turns=int(content["turns"]),
        temperatures=(low, high),
        parameters=tuple(map(parameter_from, content["parameters"])),
        date=content.get("date"),
    )


def parameter_content(parameter: Parameter) -> dict[str, Any]:
    """A parameter as the file has it."""
    content = {"name": parameter.name, "value": parameter.value, "u": parameter.u, "unit": parameter.unit}
    more = {
        "deviation": parameter.deviation,
        "run_to_run": parameter.run_to_run,
        "learned": parameter.learned,
        "dof": parameter.dof,
    }
    content |= {"prior": parameter.prior, "k": parameter.k}
    return content | {key: value for key, value in more.items() if value is not None}


def fits_content(fits: Mapping[str, Fit]) -> dict[str, Any]:
    """Fits as the file has them."""
    return {
        name: {
            "chi_square": f.chi_square,
            "degrees": f.degrees,
            "probability": f.probability,
            "scatter": f.scatter,
            "unit": f.scatter_unit,
        }
        for name, f in fits.items()
    }


def optional(read: Callable[[Any], _Value], value: Any) -> _Value | None:
    """What is read from a value, or None where that is null."""
    return None if value is None else read(value)


def parameter_from(content: Mapping[str, Any]) -> Parameter:
    """A parameter of the file."""
    return Parameter(
        name=content["name"],
        value=float(content["value"]),
        u=optional(float, content.get("u")),
        unit=content["unit"],
        deviation=optional(float, content.get("deviation")),
        run_to_run=optional(float, content.get("run_to_run")),
        dof=optional(float, content.get("dof")),
        prior=optional(float, content.get("prior")),
        learned=optional(float, content.get("learned")),
    )


def rest_from(content: Mapping[str, Any]) -> RestResult:
    """A rest of the file."""
    return RestResult(
        file=int(content.get("file", 0)),
        start=float(content["start"]),
        stop=float(content["stop"]),
        residual=float(content["residual"]),
        sigmas=float(content.get("sigmas", 0.0)),
        attitude=content.get("attitude"),
        accel=optional(_at_rest, content.get("accel")),
        gyro=optional(_at_rest, content.get("gyro")),
        temperature=optional(float, content.get("temperature")),
    )


def _at_rest(content: Mapping[str, Any]) -> SensorsAtRest:
    keys = ("mean", "noise", "drift", "temperature")
    return SensorsAtRest(**{key: tuple(map(float, content.get(key, ()))) for key in keys})


def turn_from(content: Mapping[str, Any]) -> TurnResult:
    """A turn of the file."""
    return TurnResult(
        first=int(content["first"]),
        last=int(content["last"]),
        duration=float(content["duration"]),
        angle=optional(float, content["angle"]),
        programmed=optional(float, content["programmed"]),
        sigmas=float(content["sigmas"]),
    )


def fits_from(content: Mapping[str, Any]) -> dict[str, Fit]:
    """The fits of the file or of one of its launches."""
    return {
        name: Fit(
            chi_square=float(f["chi_square"]),
            degrees=float(f["degrees"]),
            scatter=float(f["scatter"]),
            scatter_unit=f["unit"],
        )
        for name, f in content.get("fits", {}).items()
    }


def site_from(content: Mapping[str, Any]) -> Site | None:
    """The site of the file or of one of its launches, where it has one."""
    site = content.get("site")
    if site is None:
        return None
    return Site(
        latitude=optional(float, site["latitude"]),
        height=float(site["height"]),
        gravity=float(site["gravity"]),
        gravity_u=float(site["gravity_u"]),
        field=optional(float, site.get("field")),
        gravity_is_unit=bool(site.get("gravity_is_unit", False)),
    )


def readings_from(content: Mapping[str, Any]) -> Readings:
    """What the readings of sensors are, from the file."""
    return Readings(
        columns=tuple(content["columns"]),
        unit=content["unit"],
        increments=bool(content["increments"]),
        scale=tuple(map(float, content["scale"])),
        offset=tuple(map(float, content["offset"])),
        row_u=tuple(map(float, content.get("row_u", ()))),
    )


def covariance_from(rows: list[list[float]] | None, size: int) -> Array | None:
    """A covariance of `size` parameters, where the file has one. Raises ValueError for another shape."""
    if rows is None:
        return None
    matrix = np.array(rows, dtype=float)
    if matrix.shape != (size, size) and not size == matrix.size == 0:
        raise ValueError(f"a covariance of shape {matrix.shape} for {size} parameters")
    return matrix.reshape(size, size)
