"""The keys of a calibration file and what is expected of each: a file is checked against them once, and trusted after.

Further keys may be there or not. A message names the key: "found 'much' in place of a number at parameters[3].value".
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from datetime import date, datetime
from itertools import pairwise
from math import inf, isfinite
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from tumble.documents import dotted, is_plain, shown
from tumble.errors import CalibrationError
from tumble.recording.session.document import ImuTable
from tumble.recording.session.table import LONGEST_NAME
from tumble.sensors.parameters import is_parameter
from tumble.units import Array

MOST_PARAMETERS, MOST_RESTS, MOST_LAUNCHES = 1000, 100_000, 1000
LONGEST_TEXT = 10_000
LARGEST, LEAST = 1e60, 1e-60
"""No number is larger, and no uncertainty that is not zero is smaller."""

_LEAST_SINGULAR_VALUE = 1e-9
_CORRELATION_ROUNDING = 1e-9
"""What numbers of 17 digits, and sums of as many terms as 1000 parameters make, are off: 1000² · 2⁻⁵² = 2e-10."""


def _is_name(text: str) -> str:
    if not text.strip() or not text.isprintable() or len(text) > LONGEST_NAME:
        raise ValueError(f"expected 1 to {LONGEST_NAME} printable characters, found {shown(text[:40])}")
    return text


def _is_plain(text: str) -> str:
    if len(text) > LONGEST_TEXT or not is_plain(text):
        raise ValueError(f"expected at most {LONGEST_TEXT} characters and no control characters, found {shown(text)}")
    return text


def _is_date(text: str) -> str:
    try:
        datetime.fromisoformat(text) if "T" in text else date.fromisoformat(text)
    except ValueError:
        raise ValueError(f"expected a date, or a date with a time, found {shown(text)}") from None
    return text


def _is_sized(number: float) -> float:
    if not abs(number) <= LARGEST:
        raise ValueError(f"expected a number of at most {LARGEST:g} in size, found {number:g}")
    return number


def _is_size(number: float) -> float:
    if not (number == 0.0 or LEAST <= number <= LARGEST):
        raise ValueError(f"expected zero or a number from {LEAST:g} to {LARGEST:g}, found {number:g}")
    return number


Name = Annotated[str, AfterValidator(_is_name)]
Text = Annotated[str, AfterValidator(_is_plain)]
Number = Annotated[float, AfterValidator(_is_sized)]
Size = Annotated[float, AfterValidator(_is_size)]
Rate = Annotated[float, Field(gt=0.0), AfterValidator(_is_size)]
Spread = Annotated[float, Field(gt=0.0), AfterValidator(_is_size)]
Date = Annotated[str, AfterValidator(_is_date)]
Count = Annotated[int, Field(ge=0, le=10**9)]
Vector = Annotated[list[Number], Field(max_length=MOST_PARAMETERS)]
Pair = Annotated[list[Number], Field(min_length=2, max_length=2)]
Matrix = Annotated[list[Vector], Field(max_length=MOST_PARAMETERS)]


class _Keys(BaseModel):
    """A table of the file: further keys are ignored."""

    model_config = ConfigDict(extra="ignore", strict=True, frozen=True)


class _AutopilotKeys(ImuTable, extra="ignore"):
    """Which sensors of an autopilot."""


class _DeviceKeys(_Keys):
    serial: Name
    model: Name | None
    imu: _AutopilotKeys = _AutopilotKeys()


class _ParameterKeys(_Keys):
    name: Name
    value: float
    u: float | None = None
    unit: Name
    deviation: Number | None = None
    run_to_run: Size | None = None
    dof: Size | None = None
    prior: Spread | None = None
    learned: Number | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not is_parameter(self.name):
            raise ValueError(
                f"expected parameters that this version of tumble knows, found {shown(self.name)}: without it readings "
                "would be corrected wrongly; read the file with the version that wrote it"
            )
        if not isfinite(self.value) or not 0.0 <= (self.u or 0.0) < inf:
            raise ValueError(
                f"{self.name}: expected a finite value and a u of 0 or more, found {self.value} and {self.u}"
            )
        _is_sized(self.value)
        _is_size(self.u or 0.0)
        return self


class _ModelKeys(_Keys):
    matrix: Matrix
    bias: Vector

    @model_validator(mode="after")
    def _check(self) -> Self:
        shape = {len(row) for row in self.matrix}
        if shape != {3} or len(self.matrix) != len(self.bias):
            raise ValueError("expected a matrix of three columns, with a row for each bias, found another")
        if np.linalg.svd(np.array(self.matrix), compute_uv=False)[-1] < _LEAST_SINGULAR_VALUE or len(self.bias) < 3:
            raise ValueError("expected a matrix that can be inverted, found a singular one")
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


class _SensorOutcomeKeys(_Keys):
    reasons: list[Text]
    remarks: list[Text]


def _unit_length(axis: list[float]) -> list[float]:
    if not abs(float(np.linalg.norm(axis)) - 1.0) < 1e-6:
        raise ValueError("expected a unit vector, found one of another length")
    return axis


_Direction = Annotated[list[Number], Field(min_length=3, max_length=3), AfterValidator(_unit_length)]


class _OutcomeKeys(_Keys):
    reasons: list[Text]
    unobservable: list[Text] = []
    remarks: list[Text] = []
    verdict: Text | None = None
    accel: _SensorOutcomeKeys | None = None
    gyro: _SensorOutcomeKeys | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.verdict is not None and (self.accel is None or self.gyro is None):
            raise ValueError("expected outcomes of accelerometers and of gyros beside the verdict, found none")
        return self


class _GroupKeys(_Keys):
    name: Text
    kept: bool
    prior: Size
    prior_widened: Size
    learned: Vector


class _HyperparameterKeys(_Keys):
    name: Text
    unit: Text
    words: Text
    value: Size
    low: Size
    high: Size
    usual: Size


class _IntegralKeys(_Keys):
    points: int
    effective: Number
    pareto: Number


class _ProcessBiasKeys(_Keys):
    name: Text
    value: Number
    u: Size
    next_u: Size


class _PredictionKeys(_Keys):
    force_u: Size
    rate_u: Size | None
    at_rate: Number | None


class _TemperatureKeys(_Keys):
    reference: Number | None = None
    range: Pair | None = None
    lag: Number | None = None
    thermometers: dict[Text, list[Text]] = {}
    references: dict[Text, Vector] = {}


class _IncrementKeys(_Keys):
    name: Text
    increment: Number


class _IterationKeys(_Keys):
    parameters: list[_IncrementKeys]


class _AtRestKeys(_Keys):
    mean: Vector
    noise: Vector
    drift: Vector
    temperature: Vector = []

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not len(self.mean) == len(self.noise) == len(self.drift):
            raise ValueError("expected as many means as noises and drifts, one for each sensor, found others")
        return self


class _RestKeys(_Keys):
    file: Count = 0
    start: Number
    stop: Number
    residual: Number
    sigmas: Number = 0.0
    attitude: Text | None = None
    accel: _AtRestKeys | None = None
    gyro: _AtRestKeys | None = None
    temperature: Number | None = None


class _TurnKeys(_Keys):
    first: Count
    last: Count
    duration: Number
    angle: Number | None
    programmed: Number | None
    sigmas: Number


class _FitKeys(_Keys):
    chi_square: Size
    degrees: Number
    scatter: Size
    unit: Text


class _SiteKeys(_Keys):
    latitude: Number | None
    height: Number
    gravity: Annotated[float, Field(ge=1.0, le=100.0)]
    gravity_u: Size
    field: Number | None = None
    gravity_is_unit: bool = False


class _AirKeys(_Keys):
    temperature_degC: Number | None = None  # noqa: N815
    temperature_u: Size | None = None
    humidity_percent: Number | None = None
    pressure_hPa: Number | None = None  # noqa: N815


class _CircumstancesKeys(_Keys):
    date: Date | None = None
    operator: Text | None = None
    conditions: _AirKeys = _AirKeys()
    equipment: list[Text] = []


class _ReadingsKeys(_Keys):
    columns: list[Text]
    unit: Text
    increments: bool
    scale: Vector
    offset: Vector
    row_u: Vector = []

    @model_validator(mode="after")
    def _check(self) -> Self:
        seen = all(abs(scale) >= LEAST for scale in self.scale)
        if not len(self.columns) == len(self.scale) == len(self.offset) or not seen:
            raise ValueError("expected a scale, not zero, and an offset for every column, found others")
        if len(self.row_u) not in (0, len(self.columns)):
            raise ValueError("expected row_u for every column or none, found others")
        return self


class _ResultKeys(_Keys):
    """What a result and each of its launches have."""

    parameters: list[_ParameterKeys] = Field(max_length=MOST_PARAMETERS)
    covariance: Matrix | None
    site: _SiteKeys | None = None
    rests: list[_RestKeys] = Field(default=[], max_length=MOST_RESTS)
    turns: list[_TurnKeys] = Field(default=[], max_length=MOST_RESTS)
    fits: dict[Text, _FitKeys] = {}

    @model_validator(mode="after")
    def _check(self) -> Self:
        rows = self.covariance or []
        if rows and {len(rows), *map(len, rows)} != {len(self.parameters)}:
            shape = f"({len(rows)}, {len(rows[0])}) for {len(self.parameters)} parameters"
            raise PydanticCustomError("shape", "a covariance of shape {shape}", {"shape": shape})
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


class _LaunchKeys(_ResultKeys):
    session: Text
    log_sha256: Text = ""
    circumstances: _CircumstancesKeys = _CircumstancesKeys()


class _MemberKeys(_Keys):
    """One of several sessions in one estimate."""

    session: Text
    log_sha256: Text
    rests: Count
    turns: Count
    temperatures: Pair
    parameters: list[_ParameterKeys] = Field(max_length=MOST_PARAMETERS)
    date: Date | None = None


class _FormatKeys(_Keys):
    """What is looked at first."""

    format: Literal[1]


class _CalibrationKeys(_ResultKeys, _FormatKeys):
    """The whole file."""

    device: _DeviceKeys
    method: Name
    frame: Name
    accel: _ModelKeys | None
    gyro: _ModelKeys | None
    mag: _ModelKeys | None = None
    outcome: _OutcomeKeys
    groups: list[_GroupKeys] = Field(default=[], max_length=MOST_PARAMETERS)
    hyperparameters: list[_HyperparameterKeys] = Field(default=[], max_length=MOST_PARAMETERS)
    integral: _IntegralKeys | None = None
    process_bias: list[_ProcessBiasKeys] = Field(default=[], max_length=MOST_PARAMETERS)
    prediction: _PredictionKeys | None = None
    axes: dict[Text, list[_Direction]] = {}
    temperature: _TemperatureKeys = _TemperatureKeys()
    iterations: list[_IterationKeys]
    sample_rate: Rate | None = None
    clock_u: Annotated[float, Field(ge=0.0), AfterValidator(_is_size)] = 0.0
    session: _CircumstancesKeys = _CircumstancesKeys()
    programme: Text | None = None
    readings: dict[Text, _ReadingsKeys] = {}
    notes: list[Annotated[str, Field(max_length=LONGEST_TEXT)]] = []
    absent: list[Annotated[str, Field(max_length=LONGEST_TEXT)]] = []
    launches: list[_LaunchKeys] = Field(default=[], max_length=MOST_LAUNCHES)
    together: list[_MemberKeys] = Field(default=[], max_length=MOST_LAUNCHES)
    rests: list[_RestKeys] = Field(max_length=MOST_RESTS)
    provenance: dict[Text, Text]

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
            found = getattr(self.temperature, key).get(kind)
            if found is not None:
                yield f"temperature.{key}.{kind}", len(found)


def check_keys(content: Any, name: str) -> None:
    """Check the content of a calibration file, in messages `name`. Raises CalibrationError with the first fault."""
    try:
        _CalibrationKeys.model_validate(content)
    except ValidationError as error:
        raise CalibrationError(f"{name}: {_said(error.errors(include_url=False)[0], content)}") from None


_EXPECTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "a text",
    "bool_type": "true or false",
    "list_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "greater_than": "a larger number",
    "greater_than_equal": "a larger number",
    "less_than_equal": "a smaller number",
    "too_short": "a longer list",
    "too_long": "a shorter list",
    "literal_error": "1, the format of this file",
}


def _said(fault: Mapping[str, Any], content: Any) -> str:
    """What is to be said of a fault, after the name of the file."""
    place = dotted(fault["loc"])[:80]
    if fault["type"] == "value_error":
        return f"{place}: {fault['ctx']['error']}".removeprefix(": ")
    if fault["type"] == "missing":
        above = dotted(fault["loc"][:-1])[:80]
        found = f"no key {str(fault['loc'][-1])!r}" + (f" in {above}" if above else "")
    elif fault["type"] == "shape":
        found = fault["msg"]
    else:
        value = content
        for part in fault["loc"]:
            value = part if part == "[key]" else value[part]
        found = f"{shown(value)} in place of {_EXPECTED.get(fault['type'], 'what can be there')}"
        found += f" at {place}" if place else ""
    return f"expected a calibration file of tumble, found {found}"
