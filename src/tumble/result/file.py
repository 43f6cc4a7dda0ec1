"""The calibration file: its one description, by which it is read, checked and written.

JSON; parameters in SI and radians with standard uncertainties and covariance, the matrices and biases that apply them,
the outcome with its reasons, and where it all came from. Keys that are not known are ignored. `CalibrationFile` is the
whole, and its JSON Schema is `CalibrationFile.model_json_schema()`. A message names the key: "found 'much' in place of
a number at parameters[3].value".
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PlainSerializer,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
    model_validator,
)

from tumble.documents import dotted, faults_of, is_plain, json_of, shown
from tumble.errors import CalibrationError
from tumble.inference.estimate import Fit, GroupFinding, HyperparameterEstimate, Integral, Outcome, ProcessBias
from tumble.inference.prediction import Prediction
from tumble.recording.session import Site
from tumble.recording.session.document import ImuTable
from tumble.result.parts import (
    LARGEST,
    LEAST,
    MOST_PARAMETERS,
    IsoDate,
    Member,
    Name,
    Parameters,
    Positive,
    Readings,
    RestResult,
    Size,
    SourceContributions,
    TurnResult,
    Vector,
    is_size,
)
from tumble.sensors.model import SensorModel
from tumble.units import Array

FORMAT = 1
MOST_RESTS, MOST_LAUNCHES = 100_000, 1000
LONGEST_TEXT = 10_000

_LEAST_SINGULAR_VALUE = 1e-9
_CORRELATION_ROUNDING = 1e-9
"""What numbers of 17 digits, and sums of as many terms as 1000 parameters make, are off: 1000² · 2⁻⁵² = 2e-10."""

Matrix = Annotated[tuple[Vector, ...], Field(max_length=MOST_PARAMETERS)]


class _Table(BaseModel):
    """A table of the file: keys that are not known are ignored."""

    model_config = ConfigDict(
        extra="ignore", strict=True, frozen=True, allow_inf_nan=False, ser_json_inf_nan="constants"
    )
    optional: ClassVar[frozenset[str]] = frozenset()
    """The keys that are not written where there is nothing to write."""

    @model_serializer(mode="wrap")
    def _written(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        written: dict[str, Any] = handler(self)
        return {key: value for key, value in written.items() if key not in self.optional or value not in (None, {}, [])}


def _sizes(*names: str) -> AfterValidator:
    """Checks that fields which are standard uncertainties or sizes of something may be such."""

    def check(part: Any) -> Any:
        for name in names:
            is_size(getattr(part, name) or 0.0)
        return part

    return AfterValidator(check)


class SensorTable(_Table):
    """The linear model of a kind of sensor, reading = matrix @ true + bias, and beside it, by name, the values of the
    groups beyond it."""

    model_config = ConfigDict(extra="allow")

    matrix: Matrix
    bias: Vector
    unit: str = ""

    @model_validator(mode="after")
    def _check(self) -> Self:
        shape = {len(row) for row in self.matrix}
        if shape != {3} or len(self.matrix) != len(self.bias):
            raise ValueError("expected a matrix of three columns, with a row for each bias, found another")
        if np.linalg.svd(np.array(self.matrix), compute_uv=False)[-1] < _LEAST_SINGULAR_VALUE or len(self.bias) < 3:
            raise ValueError("expected a matrix that can be inverted, found a singular one")
        return self

    @property
    def model(self) -> SensorModel:
        """The model of the sensors."""
        return SensorModel(matrix=np.array(self.matrix, float), bias=np.array(self.bias, float))


class AutopilotTable(ImuTable, extra="ignore"):
    """Which sensors of an autopilot, where they are of one."""


class DeviceContent(_Table):
    """The device."""

    optional = frozenset({"imu"})

    serial: Name
    model: Name | None
    imu: Annotated[AutopilotTable, PlainSerializer(lambda imu: imu.model_dump(exclude_none=True))] = AutopilotTable()


class _SensorOutcomeTable(_Table):
    verdict: Any = None
    reasons: tuple[str, ...]
    remarks: tuple[str, ...]


class OutcomeTable(_Table):
    """Whether the values can be used, and if not, why; of the accelerometers and the gyros too, and of the groups of
    their parameters that are judged otherwise than they."""

    accepted: Any = None
    verdict: str | None = None
    reasons: tuple[str, ...]
    remarks: tuple[str, ...] = ()
    unobservable: tuple[str, ...] = ()
    accel: _SensorOutcomeTable | None = None
    gyro: _SensorOutcomeTable | None = None
    groups: dict[str, _SensorOutcomeTable] = {}

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.verdict is not None and (self.accel is None or self.gyro is None):
            raise ValueError("expected outcomes of accelerometers and of gyros beside the verdict, found none")
        return self

    @property
    def outcome(self) -> Outcome:
        """The outcome."""
        if self.verdict is None:
            return Outcome(reasons=self.reasons, unobservable=self.unobservable)
        return Outcome.from_content(self.model_dump())


def fit_content(fit: Fit) -> dict[str, Any]:
    """A fit as the file has it."""
    content = {"chi_square": fit.chi_square, "degrees": fit.degrees, "probability": fit.probability}
    return content | {"scatter": fit.scatter, "unit": fit.unit}


_Fit = Annotated[Fit, _sizes("chi_square", "scatter"), PlainSerializer(fit_content)]
_Group = Annotated[GroupFinding, _sizes("prior", "prior_widened")]


class TemperatureContent(_Table):
    """At which temperatures parameters have their values and between which they were measured, °C, by which
    thermometers, and the lag behind these, s."""

    optional = frozenset({"thermometers", "references", "lag"})

    reference: float | None = None
    range: tuple[float, float] | None = None
    thermometers: dict[str, tuple[str, ...]] = {}
    references: dict[str, Vector] = {}
    lag: float | None = None


class IncrementTable(_Table):
    """What an iteration has added to a parameter."""

    name: str
    increment: float


class IterationTable(_Table):
    """What an iteration has added."""

    parameters: tuple[IncrementTable, ...]


class _AirTable(_Table):
    temperature_degC: float | None = None  # noqa: N815
    temperature_u: Size | None = None
    humidity_percent: float | None = None
    pressure_hPa: float | None = None  # noqa: N815


class CircumstancesContent(_Table):
    """When, by whom, with what and in what air it was recorded."""

    date: IsoDate | None = None
    operator: str | None = None
    conditions: _AirTable = _AirTable()
    equipment: tuple[str, ...] = ()


_Circumstances = Annotated[CircumstancesContent, PlainSerializer(lambda table: table.model_dump(exclude_defaults=True))]


def _check_site(site: Site) -> Site:
    if not 1.0 <= site.gravity <= 100.0:
        raise ValueError(f"expected a gravity from 1 to 100 m/s^2, found {site.gravity:g}")
    return site


class _ResultTable(_Table):
    """What a calibration and each of its launches have."""

    parameters: Parameters
    covariance: Matrix | None
    site: Annotated[Site, _sizes("gravity_u"), AfterValidator(_check_site)] | None = None
    rests: tuple[RestResult, ...] = Field(default=(), max_length=MOST_RESTS)
    turns: tuple[TurnResult, ...] = Field(default=(), max_length=MOST_RESTS)
    fits: dict[str, _Fit] = {}

    @model_validator(mode="after")
    def _check_covariance(self) -> Self:
        rows = self.covariance or ()
        if rows and {len(rows), *map(len, rows)} != {len(self.parameters)}:
            shape = f"shape ({len(rows)}, {len(rows[0])}) for {len(self.parameters)} parameters"
            raise ValueError(
                f"covariance: expected a row and a column for each parameter, found a covariance of {shape}"
            )
        for number, row in enumerate(rows, 1):
            variance = row[number - 1]
            if variance < 0.0:
                raise ValueError(f"covariance[{number}][{number}]: expected no variance below 0, found {variance:g}")
            if 0.0 < variance < LEAST**2:
                raise ValueError(
                    f"covariance[{number}][{number}]: expected zero or a variance of at least {LEAST**2:g}, "
                    f"found {variance:g}"
                )
        if rows:
            _check_correlations(np.array(rows))
        for name, count in Counter(parameter.name for parameter in self.parameters).items():
            if count > 1:
                raise ValueError(f"parameters: expected every name once, found {name!r} twice")
        return self

    @model_validator(mode="after")
    def _check_rests(self) -> Self:
        for number, (rest, following) in enumerate(pairwise(self.rests), 2):
            if not rest.file <= following.file < MOST_RESTS:
                raise ValueError(f"rests[{number}].file: expected {rest.file} or a later file, found {following.file}")
        for number, turn in enumerate(self.turns, 1):
            if self.rests and not turn.first < turn.last < len(self.rests):
                raise ValueError(
                    f"turns[{number}]: expected two of {len(self.rests)} rests, in their order and counted from 0, "
                    f"found {turn.first} and {turn.last}"
                )
        return self


def _check_correlations(covariance: Array) -> None:
    """Raises ValueError for a covariance without negative variances that is not symmetric, or that has a combination
    of parameters with a negative one."""
    u = np.sqrt(np.diag(covariance))
    exact, size = u == 0.0, np.where(u == 0.0, 1.0, u)
    correlation = covariance / size[:, None] / size
    if covariance[exact].any() or covariance[:, exact].any():
        raise ValueError("covariance: expected zeros beside a variance of 0, found others")
    if np.abs(correlation - correlation.T).max() > _CORRELATION_ROUNDING:
        raise ValueError("covariance: expected a symmetric matrix, found another")
    strongest = float(np.abs(correlation).max())
    if strongest > 1.0 + _CORRELATION_ROUNDING:
        raise ValueError(f"covariance: expected correlations from -1 to 1, found one of {strongest:.3g} in size")
    if np.linalg.eigvalsh(correlation)[0] < -_CORRELATION_ROUNDING:
        raise ValueError("covariance: expected correlations that can be together, found a negative variance of a sum")


class LaunchTable(_ResultTable):
    """One of several sessions behind a calibration."""

    session: str
    log_sha256: str = ""
    circumstances: _Circumstances = CircumstancesContent()


def _of_unit_length(axis: tuple[float, ...]) -> tuple[float, ...]:
    if not abs(float(np.linalg.norm(axis)) - 1.0) < 1e-6:
        raise ValueError("expected a unit vector, found one of another length")
    return axis


def _check_scales(readings: Readings) -> Readings:
    seen = all(abs(scale) >= LEAST for scale in readings.scale)
    if not len(readings.columns) == len(readings.scale) == len(readings.offset) or not seen:
        raise ValueError("expected a scale, not zero, and an offset for every column, found others")
    if len(readings.row_u) not in (0, len(readings.columns)):
        raise ValueError("expected row_u for every column or none, found others")
    return readings


_Direction = Annotated[tuple[float, ...], Field(min_length=3, max_length=3), AfterValidator(_of_unit_length)]
_Hyperparameter = Annotated[HyperparameterEstimate, _sizes("value", "low", "high", "usual")]


class _HeadTable(_Table):
    """What the file begins with."""

    format: Literal[1]
    device: DeviceContent
    method: Name
    frame: Name


class CalibrationFile(_ResultTable, _HeadTable):
    """The whole file. Where a key is an attribute of `Calibration`, it is the same."""

    accel: SensorTable | None
    gyro: SensorTable | None
    mag: SensorTable | None = None
    outcome: OutcomeTable
    groups: tuple[_Group, ...] = Field(default=(), max_length=MOST_PARAMETERS)
    hyperparameters: tuple[_Hyperparameter, ...] = Field(default=(), max_length=MOST_PARAMETERS)
    integral: Integral | None = None
    process_bias: tuple[Annotated[ProcessBias, _sizes("u", "next_u")], ...] = Field(
        default=(), max_length=MOST_PARAMETERS
    )
    budget: tuple[Annotated[SourceContributions, _sizes("u")], ...] = Field(default=(), max_length=MOST_PARAMETERS)
    prediction: Annotated[Prediction, _sizes("force_u", "rate_u")] | None = None
    axes: dict[str, tuple[_Direction, ...]] = {}
    temperature: TemperatureContent = TemperatureContent()
    iterations: tuple[IterationTable, ...]
    sample_rate: Positive | None = None
    clock_u: Size = 0.0
    session: _Circumstances = CircumstancesContent()
    programme: str | None = None
    readings: dict[str, Annotated[Readings, AfterValidator(_check_scales)]] = {}
    rests: tuple[RestResult, ...] = Field(max_length=MOST_RESTS)
    notes: tuple[str, ...] = ()
    absent: tuple[str, ...] = ()
    launches: tuple[LaunchTable, ...] = Field(default=(), max_length=MOST_LAUNCHES)
    together: tuple[Member, ...] = Field(default=(), max_length=MOST_LAUNCHES)
    provenance: dict[str, str]

    @model_validator(mode="after")
    def _check_sensors(self) -> Self:
        for kind in ("accel", "gyro"):
            counts = dict(self._sensors(kind))
            if len(set(counts.values())) > 1:
                (first, expected), *others = counts.items()
                key, found = next((key, found) for key, found in others if found != expected)
                raise ValueError(f"{key}: expected {expected} sensors, as {first} has, found {found}")
        return self

    def _sensors(self, kind: str) -> Iterator[tuple[str, int]]:
        """How many sensors of a kind each part of the file has, by its key."""
        model = getattr(self, kind)
        if model is not None:
            yield f"{kind}.bias", len(model.bias)
        if kind in self.axes:
            yield f"axes.{kind}", len(self.axes[kind])
        if kind in self.readings:
            yield f"readings.{kind}", len(self.readings[kind].columns)
        launches = [(f"launches[{number}].rests", launch.rests) for number, launch in enumerate(self.launches, 1)]
        for place, rests in (("rests", self.rests), *launches):
            for number, rest in enumerate(rests, 1):
                at_rest = getattr(rest, kind)
                if at_rest is not None:
                    yield f"{place}[{number}].{kind}", len(at_rest.mean)
        for key in ("thermometers", "references"):
            of_sensors = getattr(self.temperature, key).get(kind)
            if of_sensors is not None:
                yield f"temperature.{key}.{kind}", len(of_sensors)


# -------------------- reading --------------------


def parsed(text: str, name: str) -> CalibrationFile:
    """The tables of the text of a file, which messages call `name`. Raises CalibrationError with the first fault."""
    try:
        content = json_of(text)
    except ValueError as error:
        raise no_calibration(name, error) from error
    if not isinstance(content, dict) or "format" not in content:
        raise no_calibration(name, "no key 'format'")
    if content["format"] != FORMAT:
        raise CalibrationError(f"{name}: expected format {FORMAT}, found {shown(content['format'])}")
    try:
        for key, value in _values(content):
            if isinstance(value, float) and abs(value) > LARGEST:
                size = f"expected a number of at most {LARGEST:g} in size, found {value:g}"
                raise ValueError(f"{dotted(key)[:80]}: {size}")
        file = CalibrationFile.model_validate_json(text)
        for key, value in _values(content):
            if isinstance(value, str) and not _is_text(value, key):
                limits = f"at most {LONGEST_TEXT} characters and no control characters"
                raise ValueError(f"{dotted(key)[:80]}: expected {limits}, found {shown(value)}")
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        if first["type"] == "json_invalid":
            raise no_calibration(name, first["msg"].removeprefix("Invalid JSON: ")) from None
        raise CalibrationError(f"{name}: {faults_of(error, content, CalibrationFile)[0]}") from None
    except ValueError as error:
        raise CalibrationError(f"{name}: {error}") from None
    return file


def _values(content: Any, key: tuple[int | str, ...] = ()) -> Iterator[tuple[tuple[int | str, ...], Any]]:
    """Every number and text of a document, the names of keys too, with its key."""
    if isinstance(content, dict):
        for name, each in content.items():
            yield key, name
            yield from _values(each, (*key, name))
    elif isinstance(content, list):
        for index, each in enumerate(content):
            yield from _values(each, (*key, index))
    else:
        yield key, content


def _is_text(text: str, key: tuple[int | str, ...]) -> bool:
    """Whether a text is not too long, and, but for notes, of characters that do nothing."""
    return len(text) <= LONGEST_TEXT and (key[:1] in (("notes",), ("absent",)) or is_plain(text))


def no_calibration(name: str, found: object) -> CalibrationError:
    """That a file is no calibration."""
    return CalibrationError(f"{name}: expected a calibration file of tumble, found {found}")
