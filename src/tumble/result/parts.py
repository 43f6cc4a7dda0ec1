"""Parts of a calibration: parameters, rests, turns, readings, launches, evidence and provenance.

The annotations of the fields contain the checks of the calibration file, and define how types that are no plain
dataclasses are read from it (`FromTable`); `tumble.result.file` writes it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from math import erfc, inf, isfinite, sqrt
from typing import Annotated, Any, Protocol

import numpy as np
import scipy
from pydantic import AfterValidator, Field, GetCoreSchemaHandler
from pydantic_core import core_schema

from tumble.documents import shown
from tumble.inference.estimate import Fit, HyperparameterEstimate, Integral, ProcessBias
from tumble.inference.sources import Source
from tumble.recording.session import UNKNOWN, AutopilotSensor, Circumstances, IsoDate, Site, check_name, sensors_from
from tumble.recording.session.document import ImuTable
from tumble.sensors.model import SensorModel
from tumble.sensors.parameters import is_parameter
from tumble.units import Array

SERIAL_NOT_STATED = "the serial number is not stated"  # begin of a note, with which no certificate is issued
MOST_PARAMETERS, MOST_RESTS, MOST_LAUNCHES = 1000, 100_000, 1000
LARGEST, LEAST = 1e60, 1e-60  # largest number of a file, and smallest uncertainty other than zero
FEWEST_DEGREES = 0.99  # of freedom of a stated U: one, as of two readings, less rounding; with fewer, t exceeds 14
_LEAST_SINGULAR_VALUE = 1e-9  # of the matrix of a sensor model; smaller ones count as zero
_CORRELATION_ROUNDING = 1e-9  # above that of sums over 1000 parameters, 1000² · 2⁻⁵² = 2e-10


@dataclass(frozen=True, kw_only=True, slots=True)
class FromTable:
    """Annotation of a type that is a `table` in the file; the function `read` converts the table to the type."""

    table: Any
    read: Callable[[Any], Any]

    def __get_pydantic_core_schema__(self, _: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        """Return the schema of the table."""
        return core_schema.no_info_after_validator_function(self.read, handler.generate_schema(self.table))


def checked_sizes(*names: str) -> AfterValidator:
    """Return a validator of fields that are standard uncertainties or sizes."""

    def check(part: Any) -> Any:
        for name in names:
            is_size(getattr(part, name) or 0.0)
        return part

    return AfterValidator(check)


def is_size(number: float) -> float:
    """Return a number that may be a standard uncertainty. Raises ValueError for any other."""
    if not (number == 0.0 or LEAST <= number <= LARGEST):
        raise ValueError(f"expected zero or a number from {LEAST:g} to {LARGEST:g}, found {number:g}")
    return number


Name = Annotated[str, AfterValidator(check_name)]
Size = Annotated[float, AfterValidator(is_size)]
Positive = Annotated[float, Field(gt=0.0), AfterValidator(is_size)]
Count = Annotated[int, Field(ge=0, le=10**9)]
Vector = Annotated[tuple[float, ...], Field(max_length=MOST_PARAMETERS)]
Matrix = Annotated[tuple[Vector, ...], Field(max_length=MOST_PARAMETERS)]


class Estimated(Protocol):
    """A value with its standard uncertainty, SI, and the degrees of freedom of u, None if infinite."""

    @property
    def value(self) -> float: ...
    @property
    def u(self) -> float | None: ...
    @property
    def dof(self) -> float | None: ...


@dataclass(frozen=True, kw_only=True, slots=True)
class Parameter:
    """A named quantity with its standard uncertainty `u`, SI, None if the method gives none.

    `dof` are the degrees of freedom of u, None if the noise is known. `prior` is the standard deviation of the prior,
    `learned` the fraction of its variance that the session has removed, 0 to 1. `deviation` is from the systematic
    (passport) calibration of the session, `run_to_run` the standard deviation from launch to launch for a mean."""

    name: Name
    value: float
    u: float | None = None
    unit: Name
    deviation: float | None = None
    run_to_run: Size | None = None
    dof: Size | None = None
    prior: Positive | None = None
    learned: float | None = None

    @property
    def k(self) -> float | None:
        """Coverage factor of U = k u, 95.45 %: Student's t for `dof`; None if these are fewer than FEWEST_DEGREES."""
        return stated_factor(self.dof)


def learned_fraction(u: float, prior: float) -> float:
    """Return the fraction, 0 to 1, by which u² is below the variance of a prior with a standard deviation."""
    return min(max(1.0 - (u / prior) ** 2, 0.0), 1.0)


def _known(parameter: Parameter) -> Parameter:
    if not is_parameter(parameter.name):
        raise ValueError(
            f"expected parameters that this version of tumble knows, found {shown(parameter.name)}: without it "
            "readings would be corrected wrongly; read the file with the version that wrote it, or install the "
            "package that adds the parameter"
        )
    return parameter


Parameters = Annotated[
    tuple[Annotated[Parameter, AfterValidator(_known), checked_sizes("u")], ...], Field(max_length=MOST_PARAMETERS)
]


def stated_factor(degrees: float | None) -> float | None:
    """Return the coverage factor for degrees of freedom, infinite if None; None if they are too few for a U."""
    count = inf if degrees is None else degrees
    return None if count < FEWEST_DEGREES else coverage_factor(count)


def coverage_factor(degrees: float) -> float:
    """Return t₉₅.₄₅(ν), the coverage factor for u with ν degrees of freedom."""
    return float(-scipy.special.stdtrit(degrees, 0.5 * erfc(sqrt(2.0)))) if isfinite(degrees) else 2.0


@dataclass(frozen=True, kw_only=True, slots=True)
class SourceContributions(Source):
    """A source of uncertainty with its nonzero contributions to the u of parameters, SI, by their names."""

    contributions: Mapping[str, Size]


@dataclass(frozen=True, kw_only=True, slots=True)
class Readings:
    """Conversion of the readings of n sensors: SI = (raw − offset) / scale, for increments divided by the interval.

    `scale` (n,) and `offset` (n,) are in the log's `unit`. For a table `row_u` (n,) is the standard uncertainty of one
    row, SI, without the scatter between positions; empty if it is part of the scatter."""

    columns: tuple[str, ...]
    unit: str
    increments: bool
    scale: Vector
    offset: Vector
    row_u: Vector = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class SensorsAtRest:
    """Readings of n sensors over a rest, SI: mean, noise density (unit/√Hz), drift (change), and temperature, °C."""

    mean: Vector
    noise: Vector
    drift: Vector
    temperature: Vector = ()


def _of_equal_length(sensors: SensorsAtRest) -> SensorsAtRest:
    if not len(sensors.mean) == len(sensors.noise) == len(sensors.drift):
        raise ValueError("expected as many means as noises and drifts, one for each sensor, found others")
    return sensors


AtRest = Annotated[SensorsAtRest, AfterValidator(_of_equal_length)]


@dataclass(frozen=True, kw_only=True, slots=True)
class RestResult:
    """A rest as used: times, s, residual |corrected reading| − g, m/s², and its distance from the fit in sigmas.

    It also has its attitude code in the programme, the readings of its sensors and its temperature, °C, if known."""

    file: Count = 0
    start: float
    stop: float
    residual: float
    sigmas: float = 0.0
    attitude: str | None = None
    accel: AtRest | None = None
    gyro: AtRest | None = None
    temperature: float | None = None

    @property
    def temperatures(self) -> tuple[float, ...]:
        """Temperatures of the sensors, °C, accelerometers first, or that of the rest."""
        by_sensor = sum((sensors.temperature for sensors in (self.accel, self.gyro) if sensors is not None), ())
        return by_sensor or (() if self.temperature is None else (self.temperature,))


@dataclass(frozen=True, kw_only=True, slots=True)
class TurnResult:
    """A turn as used, from one rest to another, counted from 0: its duration, s, its angle by the calibrated gyros and
    by the programme, rad, 0 … π or None, and its distance from the fit in sigmas."""

    first: Count
    last: Count
    duration: float
    angle: float | None
    programmed: float | None
    sigmas: float


# -------------------- tables of the file --------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class SensorTable:
    """Linear model of a kind of sensor, reading = matrix @ true + bias. The file also has the groups beyond it."""

    matrix: Matrix
    bias: Vector
    unit: str = ""


def _model_of(table: SensorTable) -> SensorModel:
    if {len(row) for row in table.matrix} != {3} or len(table.matrix) != len(table.bias):
        raise ValueError("expected a matrix of three columns, with a row for each bias, found another")
    matrix = np.array(table.matrix, float)
    if np.linalg.svd(matrix, compute_uv=False)[-1] < _LEAST_SINGULAR_VALUE or len(table.bias) < 3:
        raise ValueError("expected a matrix that can be inverted, found a singular one")
    return SensorModel(matrix=matrix, bias=np.array(table.bias, float))


@dataclass(frozen=True, kw_only=True, slots=True)
class IncrementTable:
    """Increment of a parameter in an iteration."""

    name: str
    increment: float


@dataclass(frozen=True, kw_only=True, slots=True)
class IterationTable:
    """Increments of an iteration."""

    parameters: tuple[IncrementTable, ...]


class RecordedImu(ImuTable, extra="ignore"):
    """Sensors of an autopilot."""


def _check_site(site: Site) -> Site:
    if not 1.0 <= site.gravity <= 100.0:
        raise ValueError(f"expected a gravity from 1 to 100 m/s^2, found {site.gravity:g}")
    return site


def _square(rows: tuple[tuple[float, ...], ...]) -> Array:
    if any(len(row) != len(rows) for row in rows):
        raise ValueError("expected as many columns as rows, found others")
    return np.array(rows, float).reshape(len(rows), len(rows))


ModelFromTable = Annotated[SensorModel, FromTable(table=SensorTable, read=_model_of)]
Increments = Annotated[
    Mapping[str, float],
    FromTable(table=IterationTable, read=lambda step: {p.name: p.increment for p in step.parameters}),
]
Imu = Annotated[
    Mapping[str, AutopilotSensor], FromTable(table=RecordedImu, read=lambda table: sensors_from(table.model_dump()))
]
Covariance = Annotated[Array, FromTable(table=Matrix, read=_square)]
Place = Annotated[Site, checked_sizes("gravity_u"), AfterValidator(_check_site)]
Fits = Mapping[str, Annotated[Fit, checked_sizes("chi_square", "scatter")]]
Rests = Annotated[tuple[RestResult, ...], Field(max_length=MOST_RESTS)]
Turns = Annotated[tuple[TurnResult, ...], Field(max_length=MOST_RESTS)]


@dataclass(frozen=True, kw_only=True, slots=True)
class CalibratedDevice:
    """Serial number and type of the device, and the recorded "accel" and "gyro" if it is an autopilot."""

    serial: Name
    model: Name | None = None
    imu: Imu = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, slots=True)
class CalibratedTemperature:
    """Reference temperatures of the parameters, °C.

    `reference` is the mean over the thermometers, `range` that of rests not in the file. `thermometers` and
    `references` have, for each sensor of "accel" and "gyro", the column of its thermometer and its own reference."""

    reference: float | None = None
    range: tuple[float, float] | None = None
    thermometers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    references: Mapping[str, Vector] = field(default_factory=dict)


def check_result(result: Launch) -> Launch:
    """Return the result. Raises ValueError, with the key, for an impossible covariance, or turns between no rests."""
    for name, count in Counter(parameter.name for parameter in result.parameters).items():
        if count > 1:
            raise ValueError(f"parameters: expected every name once, found {name!r} twice")
    for number, (rest, following) in enumerate(pairwise(result.rests), 2):
        if not rest.file <= following.file < MOST_RESTS:
            raise ValueError(f"rests[{number}].file: expected {rest.file} or a later file, found {following.file}")
    for number, turn in enumerate(result.turns, 1):
        if result.rests and not turn.first < turn.last < len(result.rests):
            raise ValueError(
                f"turns[{number}]: expected two of {len(result.rests)} rests, in their order and counted from 0, "
                f"found {turn.first} and {turn.last}"
            )
    if result.covariance is None or not result.covariance.size:
        return result
    if len(result.covariance) != len(result.parameters):
        sizes = f"one of {len(result.covariance)} for {len(result.parameters)} parameters"
        raise ValueError(f"covariance: expected a row and a column for each parameter, found {sizes}")
    for number, variance in enumerate(np.diag(result.covariance).tolist(), 1):
        if variance < 0.0 or 0.0 < variance < LEAST**2:
            least = "no variance below 0" if variance < 0.0 else f"zero or a variance of at least {LEAST**2:g}"
            raise ValueError(f"covariance[{number}][{number}]: expected {least}, found {variance:g}")
    u = np.sqrt(np.diag(result.covariance))
    exact, size = u == 0.0, np.where(u == 0.0, 1.0, u)
    correlation = result.covariance / size[:, None] / size
    strongest = float(np.abs(correlation).max())
    if result.covariance[exact].any() or result.covariance[:, exact].any():
        raise ValueError("covariance: expected zeros beside a variance of 0, found others")
    if np.abs(correlation - correlation.T).max() > _CORRELATION_ROUNDING:
        raise ValueError("covariance: expected a symmetric matrix, found another")
    if strongest > 1.0 + _CORRELATION_ROUNDING:
        raise ValueError(f"covariance: expected correlations from -1 to 1, found one of {strongest:.3g} in size")
    if np.linalg.eigvalsh(correlation)[0] < -_CORRELATION_ROUNDING:
        raise ValueError("covariance: expected correlations that can be together, found a negative variance of a sum")
    return result


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Launch:
    """One of several sessions behind a calibration."""

    parameters: Parameters
    covariance: Covariance | None
    site: Place | None = None
    rests: Rests = ()
    turns: Turns = ()
    fits: Fits = field(default_factory=dict)
    session: str
    log_sha256: str = ""
    circumstances: Circumstances = UNKNOWN


@dataclass(frozen=True, kw_only=True, slots=True)
class Member:
    """One of several sessions in one estimate.

    It has the numbers of its rests (of the parts of rests that warm) and turns, the lowest and highest temperature of
    its rests, °C, and the parameters of this session alone; `date` is ISO 8601."""

    session: str
    log_sha256: str
    rests: Count
    turns: Count
    temperatures: tuple[float, float]
    parameters: Parameters = ()
    date: IsoDate | None = None


# -------------------- evidence and provenance --------------------


def _check_scales(readings: Readings) -> Readings:
    nonzero = all(abs(scale) >= LEAST for scale in readings.scale)
    if not len(readings.columns) == len(readings.scale) == len(readings.offset) or not nonzero:
        raise ValueError("expected a scale, not zero, and an offset for every column, found others")
    if len(readings.row_u) not in (0, len(readings.columns)):
        raise ValueError("expected row_u for every column or none, found others")
    return readings


_PerParameter, _PerSession = Field(max_length=MOST_PARAMETERS), Field(max_length=MOST_LAUNCHES)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Evidence:
    """Data and fit behind the parameters of a calibration.

    `fits` have chi-square, degrees of freedom and scatter by group of residuals, `hyperparameters` the estimated
    quantities of the noise model, over which the posterior was integrated (`integral`). `process_bias` are the means of
    the in-run processes, about which the biases of the next minutes vary; empty unless the frame is that of the
    accelerometers. `budget` has the contributions to u by source, empty in another frame than that of the estimate,
    and `iterations` the increments of the parameters. `launches` are sessions whose calibrations were averaged,
    `together` those of one estimate."""

    rests: Rests = ()
    turns: Turns = ()
    fits: Fits = field(default_factory=dict)
    hyperparameters: Annotated[
        tuple[Annotated[HyperparameterEstimate, checked_sizes("value", "low", "high", "usual")], ...], _PerParameter
    ] = ()
    integral: Integral | None = None
    process_bias: Annotated[tuple[Annotated[ProcessBias, checked_sizes("u", "next_u")], ...], _PerParameter] = ()
    budget: Annotated[tuple[Annotated[SourceContributions, checked_sizes("u")], ...], _PerParameter] = ()
    iterations: tuple[Increments, ...] = ()
    launches: Annotated[tuple[Annotated[Launch, AfterValidator(check_result)], ...], _PerSession] = ()
    together: Annotated[tuple[Member, ...], _PerSession] = ()

    @property
    def all_rests(self) -> Rests:
        """Rests of the session, or of all sessions whose calibrations were averaged."""
        return (*self.rests, *(rest for launch in self.launches for rest in launch.rests))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Provenance:
    """Recording, circumstances and software of a calibration.

    `log_sha256` is that of the log or of the list of several, `created` the time of computing, ISO 8601, `prior` names
    the devices of the type whose calibrations were the prior, `sample_rate` is in Hz, and `clock_u` is the relative
    standard uncertainty of the time base. `readings` describe "accel", "gyro" and "mag". `notes` are sentences on the
    recording and the estimate, `assumptions` on missing statements, and `absent` on sensors that the calibration does
    not have. `unstated` has, for each assumption that is in u, its source in the uncertainty budget."""

    log_sha256: str | None = None
    software: str | None = None
    created: str | None = None
    prior: str | None = None
    site: Place | None = None
    sample_rate: Positive | None = None
    clock_u: Size = 0.0
    circumstances: Annotated[Circumstances, Field(alias="session")] = UNKNOWN
    programme: str | None = None
    readings: Mapping[str, Annotated[Readings, AfterValidator(_check_scales)]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()
    unstated: Mapping[str, str] = field(default_factory=dict)
    absent: tuple[str, ...] = ()

    @property
    def doubts(self) -> tuple[str, ...]:
        """Assumptions that the log may contradict."""
        return tuple(sentence for sentence in self.assumptions if sentence.startswith("doubt: "))
