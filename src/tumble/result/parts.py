"""What a calibration consists of: parameters, rests, turns, readings, launches, sessions together.

Each is a plain dataclass; the annotations beyond the types are what `tumble.result.file` holds a file to.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date, datetime
from math import erfc, inf, isfinite, sqrt
from typing import Annotated, Any

from pydantic import AfterValidator, Field, PlainSerializer
from scipy.special import stdtrit

from tumble.documents import shown
from tumble.inference.estimate import Fit
from tumble.inference.sources import Source
from tumble.recording.session import UNKNOWN, Circumstances, Site
from tumble.recording.session.log_tables import LONGEST_NAME
from tumble.sensors.parameters import is_parameter
from tumble.units import Array

MOST_PARAMETERS = 1000
LARGEST, LEAST = 1e60, 1e-60
"""No number of a file is larger, and no uncertainty that is not zero is smaller."""


def _is_name(text: str) -> str:
    if not text.strip() or not text.isprintable() or len(text) > LONGEST_NAME:
        raise ValueError(f"expected 1 to {LONGEST_NAME} printable characters, found {shown(text[:40])}")
    return text


def is_size(number: float) -> float:
    """A number that may be a standard uncertainty. Raises ValueError for another."""
    if not (number == 0.0 or LEAST <= number <= LARGEST):
        raise ValueError(f"expected zero or a number from {LEAST:g} to {LARGEST:g}, found {number:g}")
    return number


def _is_date(text: str) -> str:
    try:
        datetime.fromisoformat(text) if "T" in text else date.fromisoformat(text)
    except ValueError:
        raise ValueError(f"expected a date, or a date with a time, found {shown(text)}") from None
    return text


Name = Annotated[str, AfterValidator(_is_name)]
Size = Annotated[float, AfterValidator(is_size)]
Positive = Annotated[float, Field(gt=0.0), AfterValidator(is_size)]
Count = Annotated[int, Field(ge=0, le=10**9)]
IsoDate = Annotated[str, AfterValidator(_is_date)]
Vector = Annotated[tuple[float, ...], Field(max_length=MOST_PARAMETERS)]


@dataclass(frozen=True, kw_only=True, slots=True)
class Parameter:
    """A named quantity with its standard uncertainty (None where the method gives none), SI; where the session names a
    systematic (passport) calibration, with the deviation from it; for the mean of several launches with the standard
    deviation from launch to launch."""

    name: Name
    value: float
    u: float | None = None
    unit: Name
    deviation: float | None = None
    run_to_run: Size | None = None
    dof: Size | None = None
    """Degrees of freedom with which u was estimated; None where the noise is known."""
    prior: Positive | None = None
    """Standard deviation of what was known before, where that is of any weight."""
    learned: float | None = None
    """How much of the prior's variance the session has taken off, 0 to 1."""

    @property
    def k(self) -> float | None:
        """The coverage factor of U = k u, of 95.45 %: Student's t for `dof`; None where there are fewer than
        FEWEST_DEGREES."""
        return stated_factor(self.dof)


def learned_fraction(u: float, prior: float) -> float:
    """How much of the variance of a prior of this standard deviation u has taken off, 0 to 1."""
    return min(max(1.0 - (u / prior) ** 2, 0.0), 1.0)


def _is_known(parameter: Parameter) -> Parameter:
    if not is_parameter(parameter.name):
        raise ValueError(
            f"expected parameters that this version of tumble knows, found {shown(parameter.name)}: without it "
            "readings would be corrected wrongly; read the file with the version that wrote it"
        )
    if not isfinite(parameter.value) or not 0.0 <= (parameter.u or 0.0) < inf:
        raise ValueError(
            f"{parameter.name}: expected a finite value and a u of 0 or more, found {parameter.value} and {parameter.u}"
        )
    is_size(parameter.u or 0.0)
    return parameter


def parameter_content(parameter: Parameter) -> dict[str, Any]:
    """A parameter as the file has it: what is None is left out, but for u and the prior."""
    always = {key: getattr(parameter, key) for key in ("name", "value", "u", "unit", "prior", "k")}
    others = {key: getattr(parameter, key) for key in ("deviation", "run_to_run", "learned", "dof")}
    return always | {key: value for key, value in others.items() if value is not None}


Parameters = Annotated[
    tuple[Annotated[Parameter, AfterValidator(_is_known), PlainSerializer(parameter_content)], ...],
    Field(max_length=MOST_PARAMETERS),
]

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
class SourceContributions(Source):
    """A source of uncertainty, and what it has in the u of parameters of a calibration, SI, by their names; nothing in
    those that are not there."""

    contributions: Mapping[str, Size]


@dataclass(frozen=True, kw_only=True, slots=True)
class Readings:
    """What the readings of n sensors are: SI = (raw − offset) / scale of the log's columns, for increments divided by
    the interval of the sample. `scale` (n,) and `offset` (n,) are in the log's `unit`. Of a table, `row_u` (n,) is the
    standard uncertainty of one row, SI, beside the scatter between positions; empty where that is all there is."""

    columns: tuple[str, ...]
    unit: str
    increments: bool
    scale: Vector
    offset: Vector
    row_u: Vector = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class SensorsAtRest:
    """Of each of n sensors over a rest, SI: mean reading, density of its noise (unit/√Hz) and drift, its change; and
    the temperature of its thermometer, °C, where they have some."""

    mean: Vector
    noise: Vector
    drift: Vector
    temperature: Vector = ()


def _of_equal_length(sensors: SensorsAtRest) -> SensorsAtRest:
    if not len(sensors.mean) == len(sensors.noise) == len(sensors.drift):
        raise ValueError("expected as many means as noises and drifts, one for each sensor, found others")
    return sensors


@dataclass(frozen=True, kw_only=True, slots=True)
class RestResult:
    """A rest as used: times (s), residual |corrected reading| − g (m/s²) and how many sigmas it is from the fit; the
    code of its attitude in the programme, what its sensors read, and the temperature (°C), where there are such."""

    file: Count = 0
    start: float
    stop: float
    residual: float
    sigmas: float = 0.0
    attitude: str | None = None
    accel: Annotated[SensorsAtRest, AfterValidator(_of_equal_length)] | None = None
    gyro: Annotated[SensorsAtRest, AfterValidator(_of_equal_length)] | None = None
    temperature: float | None = None

    @property
    def temperatures(self) -> tuple[float, ...]:
        """Those of its sensors, °C, the accelerometers first; that of the rest where they are not known apart."""
        of_sensors = sum((sensors.temperature for sensors in (self.accel, self.gyro) if sensors is not None), ())
        return of_sensors or (() if self.temperature is None else (self.temperature,))


@dataclass(frozen=True, kw_only=True, slots=True)
class TurnResult:
    """A turn from one rest to another (from 0) as used: its duration (s), its angle as the calibrated gyros saw it and
    as the programme has it (rad, 0 … π; None where there is none) and how many sigmas it is from the fit."""

    first: Count
    last: Count
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
    rests: Count
    turns: Count
    temperatures: tuple[float, float]
    parameters: Parameters = ()
    date: IsoDate | None = None
    """When it was recorded, ISO 8601."""
