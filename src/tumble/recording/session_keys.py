"""The tables of session.toml, and what is said where one of them is not as it should be.

Each key's `description` says what is expected of it, and every message is made from it: "session.toml:
site.latitude_deg: expected a number from -90 to 90, found 145.5". What concerns several keys at once is checked by the
validators of the tables.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from datetime import date as date_type
from datetime import datetime
from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from tumble.documents import dotted, is_plain, shown
from tumble.errors import ProgrammeError, did_you_mean
from tumble.programme import positions as programme
from tumble.recording.dialect import DELIMITERS, Dialect
from tumble.sensors.model import thermometers_of
from tumble.sensors.typed_quantities import prior_of
from tumble.units import ACCEL_UNITS, GYRO_UNITS, MAGNETIC_UNITS, TEMPERATURE_UNITS, TIME_UNITS, Array, Unit

CLOCK = "iso8601"
"""The time unit of dates with times and times of day."""

LEAST_GRAVITY_U = 1e-15
"""m/s²: a smaller uncertainty than no gravimeter reaches is zero, or a mistake."""
LONGEST_NAME = 200
"""Characters of a serial number and of a type."""

_TESLA = {"nT": 1e-9, "uT": 1e-6, "gauss": 1e-4}
_FIELD_ON_EARTH = (1.5e-5, 8e-5)  # T, at the ground: 22 to 67 µT, and magnetic rock
_UNIT_NORM_TOLERANCE = 1e-6
_LEAST_SINGULAR_VALUE = 1e-3
_LEAST_SINE = 1e-3


# -------------------- the tables of the file --------------------


class SessionTable(BaseModel):
    """A table of the file: no other keys, no other types."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class ImuTable(SessionTable):
    """[device.imu]"""

    accel_number: int | None = Field(default=None, ge=1, le=9, description="a number from 1 to 9")
    accel_id: int | None = Field(default=None, ge=1, lt=2**32, description="a device id, a whole number")
    gyro_number: int | None = Field(default=None, ge=1, le=9, description="a number from 1 to 9")
    gyro_id: int | None = Field(default=None, ge=1, lt=2**32, description="a device id, a whole number")


class DeviceTable(SessionTable):
    """[device]"""

    serial: str = Field(min_length=1, description="the serial number, a string that is not empty")
    model: str | None = Field(default=None, description="a string")
    systematic: str | None = Field(default=None, min_length=1, description="the path of a calibration file")
    grade: Literal["navigation", "tactical", "mems", "consumer"] | None = Field(
        default=None, description="one of navigation, tactical, mems, consumer"
    )
    imu: ImuTable = Field(default_factory=ImuTable, description="a table of sensors of an autopilot")
    prior: dict[str, str | dict[str, str]] = Field(
        default_factory=dict, description='standard deviations such as accel_quadratic = "20 ug/g^2"'
    )

    def priors(self) -> dict[str, float]:
        """Standard deviations, SI, by group. Raises ValueError for a group or a unit that is not known."""
        found: dict[str, float] = {}
        for key, value in self.prior.items():
            if isinstance(value, str):
                found |= [prior_of(key, value)]
            else:
                found |= [prior_of(f"{key}.{of}", each) for of, each in value.items()]
        return found

    @model_validator(mode="after")
    def _check(self) -> Self:
        for key, text in (("serial", self.serial), ("model", self.model)):
            if text is not None and not (text.strip() and text.isprintable() and len(text) <= LONGEST_NAME):
                raise ValueError(f"{key}: expected 1 to {LONGEST_NAME} printable characters, found {shown(text)}")
        self.priors()
        return self


class SiteTable(SessionTable):
    """[site]"""

    latitude_deg: float | None = Field(default=None, ge=-90, le=90, description="a number from -90 to 90")
    height_m: float = Field(default=0.0, ge=-1000, le=10000, description="a number from -1000 to 10000 (m)")
    gravity: float | None = Field(
        default=None, ge=9.7, le=9.9, description="a number from 9.7 to 9.9 (m/s^2, on Earth)"
    )
    gravity_u: float | None = Field(default=None, ge=0, le=0.1, description="a number from 0 to 0.1 (m/s^2)")
    gravity_confirmed: bool = Field(default=False, description="true or false")
    field: float | None = Field(default=None, gt=0, description="a positive number, in the unit of [log.magnetometer]")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.gravity_u is not None and 0.0 < self.gravity_u < LEAST_GRAVITY_U:
            raise ValueError(f"gravity_u: expected 0 or at least {LEAST_GRAVITY_U:g} m/s^2, found {self.gravity_u:g}")
        if self.gravity_u is not None and self.gravity is None and self.latitude_deg is None:
            raise ValueError("gravity_u: expected site.gravity or site.latitude_deg with it, found neither")
        return self


class SensorsTable(SessionTable):
    """The common keys of [log.accel] and [log.gyro]."""

    UNITS: ClassVar[Mapping[str, Unit]]
    SCALE_PER: ClassVar[tuple[str, ...]]  # the first is the default

    columns: list[str] = Field(min_length=3, description="a list of at least three column names")
    unit: str = Field(description="the name of a unit, a string")
    scale: float | list[float] | None = Field(default=None, description="a number or a list of numbers")
    scale_per: str | None = Field(default=None, description="the name of a unit, a string")
    offset: float | list[float] | None = Field(default=None, description="a number or a list of numbers")
    axes: list[list[float]] | None = Field(default=None, description="a list of unit vectors [x, y, z]")
    range: float | None = Field(default=None, gt=0, description="a positive number")

    @property
    def raw(self) -> bool:
        """Whether the columns need a scale."""
        return self.UNITS[self.unit].kind == "raw"

    def worth(self) -> Unit:
        """The unit of (raw − offset) / scale."""
        return self.UNITS[(self.scale_per or self.SCALE_PER[0]) if self.raw else self.unit]

    def per_sensor(self, value: float | Sequence[float] | None, default: float) -> Array:
        """A number or a list as an array (n,)."""
        return np.broadcast_to(np.asarray(default if value is None else value, float), len(self.columns)).copy()

    def directions(self) -> Array:
        """The axes (n, 3), exactly of unit length."""
        axes = np.eye(3) if self.axes is None else np.array(self.axes, dtype=float)
        return np.asarray(axes / np.linalg.norm(axes, axis=1, keepdims=True))

    @model_validator(mode="after")
    def _check(self) -> Self:
        _check_known("unit", self.unit, self.UNITS)
        self._check_scale()
        self._check_axes()
        return self

    def _check_scale(self) -> None:
        if not self.raw:
            for key in ("scale", "scale_per", "offset"):
                if getattr(self, key) is not None:
                    raise ValueError(f'{key}: expected only with unit "count" or "V", found unit "{self.unit}"')
            return
        if self.scale is None:
            raise ValueError(f'scale: expected the nominal output per unit for unit "{self.unit}", found none')
        _check_known("scale_per", self.scale_per or self.SCALE_PER[0], self.SCALE_PER)
        for key in ("scale", "offset"):
            given = getattr(self, key)
            if isinstance(given, list) and len(given) != len(self.columns):
                raise ValueError(
                    f"{key}: expected a number or {len(self.columns)} numbers, one per column, found {len(given)}"
                )
        if not self.per_sensor(self.scale, 1.0).all():
            raise ValueError(f"scale: expected numbers other than zero, found {_shown(self.scale)}")

    def _check_axes(self) -> None:
        if self.axes is None:
            if len(self.columns) > 3:
                raise ValueError(f"axes: expected {len(self.columns)} unit vectors for a redundant block, found none")
            return
        if len(self.axes) != len(self.columns):
            raise ValueError(f"axes: expected {len(self.columns)} vectors, one per column, found {len(self.axes)}")
        for number, axis in enumerate(self.axes, 1):
            if len(axis) != 3:
                raise ValueError(f"axes: expected vectors [x, y, z], found {len(axis)} numbers in vector {number}")
            if abs(math.hypot(*axis) - 1.0) > _UNIT_NORM_TOLERANCE:
                raise ValueError(
                    f"axes: expected unit vectors within {_UNIT_NORM_TOLERANCE:g}, "
                    f"found norm {math.hypot(*axis):.7g} of vector {number}, {_shown(axis)}"
                )
        if np.linalg.svd(self.directions(), compute_uv=False)[2] < _LEAST_SINGULAR_VALUE:
            raise ValueError("axes: expected directions that span three dimensions, found them in one plane")


class AccelTable(SensorsTable):
    """[log.accel]"""

    UNITS = ACCEL_UNITS
    SCALE_PER = ("m/s^2", "g", "m/s")

    def _check_axes(self) -> None:
        super()._check_axes()
        first, second = self.directions()[:2]
        if np.linalg.norm(np.cross(first, second)) < _LEAST_SINE:
            raise ValueError(
                "axes: expected the first two accelerometers, which fix the body frame, in different "
                "directions, found them parallel; list the sensors in another order"
            )


class GyroTable(SensorsTable):
    """[log.gyro]"""

    UNITS = GYRO_UNITS
    SCALE_PER = ("rad/s", "deg/s", "rad", "deg", "arcsec")


class TemperatureTable(SessionTable):
    """[log.temperature]: one column for all sensors, two for the accelerometers and the gyros, or one a sensor, the
    accelerometers first; then a thermometer may come several times."""

    RAW: ClassVar = "raw"

    columns: list[str] = Field(min_length=1, description="a list of column names")
    unit: str = Field(default="degC", description="the name of a unit, a string")
    scale: float | list[float] | None = Field(
        default=None, description="a number or a list of numbers: raw numbers per degC"
    )
    offset: float | list[float] | None = Field(
        default=None, description="a number or a list of numbers: the raw number at 0 degC"
    )

    def celsius(self) -> tuple[Array, Array]:
        """Gain and shift (T,) of each column: °C are gain · number + shift."""
        ones = np.ones(len(self.columns))
        if self.unit != self.RAW:
            gain, shift = TEMPERATURE_UNITS[self.unit]
            return gain * ones, shift * ones
        scale, offset = ones * np.asarray(self.scale, float), ones * np.asarray(self.offset or 0.0, float)
        return 1.0 / scale, -offset / scale

    def of_sensors(self, accel: int, gyro: int) -> tuple[int, ...]:
        """The place of the column of each of so many accelerometers and gyros. Raises ValueError where there is another
        number of columns."""
        found = thermometers_of(len(self.columns), accel, gyro)
        if found is None:
            two = "two for the accelerometers and the gyros, " if gyro else ""
            raise ValueError(
                f"temperature.columns: expected one column for all sensors, {two}or {accel + gyro}, one a sensor, "
                f"accelerometers first, found {len(self.columns)}"
            )
        return found

    @model_validator(mode="after")
    def _check(self) -> Self:
        _check_known("unit", self.unit, [*TEMPERATURE_UNITS, self.RAW])
        if self.unit == self.RAW and (self.scale is None or not np.all(self.scale)):
            found = "none" if self.scale is None else "0"
            raise ValueError(f'scale: expected the raw numbers per degC for unit "raw", found {found}')
        if self.unit != self.RAW and (self.scale is not None or self.offset is not None):
            key = "offset" if self.scale is None else "scale"
            raise ValueError(f'{key}: expected only with unit "raw", found unit "{self.unit}"')
        for key in ("scale", "offset"):
            given = getattr(self, key)
            if isinstance(given, list) and len(given) != len(self.columns):
                raise ValueError(
                    f"{key}: expected a number or {len(self.columns)} numbers, one per column, found {len(given)}"
                )
        if len(set(zip(self.columns, *self.celsius(), strict=True))) > len(set(self.columns)):
            raise ValueError("scale: expected one scale and offset for a column that is named again, found others")
        return self


class MagnetometerTable(SessionTable):
    """[log.magnetometer]"""

    columns: list[str] = Field(min_length=3, max_length=3, description="a list of three column names")
    unit: str = Field(description="the name of a unit, a string")

    @model_validator(mode="after")
    def _check(self) -> Self:
        _check_known("unit", self.unit, MAGNETIC_UNITS)
        return self


class LogTable(SessionTable):
    """[log]"""

    file: str | list[str] = Field(min_length=1, description="a file name or a list of file names")
    time: str | None = Field(default=None, min_length=1, description="a column name")
    time_unit: str | None = Field(default=None, description=f"one of {', '.join([*TIME_UNITS, CLOCK])}")
    rate_hz: float | None = Field(default=None, gt=0, description="a positive number")
    regular: bool | None = Field(default=None, description="true or false")
    clock_ppm_u: float | None = Field(default=None, ge=0, description="a number that is not negative")
    delimiter: str | None = Field(default=None, description="a character, or a blank for one or more blanks")
    decimal: str | None = Field(default=None, description='"." or ","')
    comment: str | None = Field(
        default=None, min_length=1, max_length=8, description="the mark that comments begin with"
    )
    header: bool | None = Field(default=None, description="true or false")
    encoding: str | None = Field(default=None, description="the name of an encoding")
    accel: AccelTable = Field(description="the table [log.accel]")
    gyro: GyroTable | None = Field(default=None, description="the table [log.gyro]")
    magnetometer: MagnetometerTable | None = Field(default=None, description="the table [log.magnetometer]")
    temperature: TemperatureTable | None = Field(default=None, description="the table [log.temperature]")

    @property
    def files(self) -> list[str]:
        """The file names, one or more."""
        return [self.file] if isinstance(self.file, str) else self.file

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.time is None) == (self.rate_hz is None):
            found = "neither" if self.time is None else "both"
            raise ValueError(f"time: expected either log.time, a column, or log.rate_hz, found {found}")
        if self.time_unit is not None:
            if self.time is None:
                raise ValueError("time_unit: expected only with log.time, found log.rate_hz")
            _check_known("time_unit", self.time_unit, [*TIME_UNITS, CLOCK])
        if self.regular and self.time is None:
            raise ValueError("regular: expected only with log.time, found log.rate_hz, which makes rows regular")
        self._check_dialect()
        for file in _repeated(self.files):
            raise ValueError(f'file: expected different files, found "{file}" twice')
        self._check_columns()
        self._check_ranges()
        return self

    def dialect(self) -> Dialect | None:
        """How the text files are written; None where nothing is said about it."""
        given = {key: getattr(self, key) for key in ("delimiter", "decimal", "comment", "header", "encoding")}
        stated = {key: value for key, value in given.items() if value is not None}
        return Dialect(**stated) if stated else None

    def _check_dialect(self) -> None:
        if self.delimiter is not None:
            _check_known("delimiter", self.delimiter, DELIMITERS)
        if self.decimal is not None:
            _check_known("decimal", self.decimal, (".", ","))
        if self.encoding is not None:
            try:
                known = "é".encode(self.encoding, errors="replace").decode(self.encoding) is not None
            except (LookupError, UnicodeError, ValueError, TypeError):
                known = False
            if not known:
                raise ValueError(f"encoding: expected a text encoding such as utf-16, found {_shown(self.encoding)}")

    def _check_columns(self) -> None:
        keys = {
            "time": [self.time] if self.time is not None else [],
            "accel.columns": self.accel.columns,
            "gyro.columns": self.gyro.columns if self.gyro else [],
            "magnetometer.columns": self.magnetometer.columns if self.magnetometer else [],
            "temperature.columns": self._thermometers(),
        }
        for column in _repeated(c for columns in keys.values() for c in columns):
            using = [key for key, columns in keys.items() for c in columns if c == column]
            also = "twice" if using[0] == using[1] else f"in log.{using[0]} too"
            raise ValueError(f'{using[1]}: expected every column once, found "{column}" {also}')

    def _thermometers(self) -> list[str]:
        """The columns of the thermometers; of one a sensor every one once."""
        if self.temperature is None:
            return []
        accel, gyro = len(self.accel.columns), 0 if self.gyro is None else len(self.gyro.columns)
        each, columns = self.temperature.of_sensors(accel, gyro), self.temperature.columns
        return list(dict.fromkeys(columns)) if len(columns) == len(each) else columns

    def _check_ranges(self) -> None:
        for key, sensors in (("accel", self.accel), ("gyro", self.gyro)):
            if sensors is None or sensors.range is None or self.rate_hz is not None:
                continue
            if sensors.worth().kind == "increment":
                raise ValueError(
                    f"{key}.range: expected log.rate_hz with the full scale of an increment per sample, "
                    "found log.time; leave range out"
                )


class PositionTable(SessionTable):
    """[[programme.position]]"""

    attitude: str = Field(description="an attitude code, a string")
    start: float | None = Field(default=None, description="a number (s)")
    stop: float | None = Field(default=None, description="a number (s)")

    @model_validator(mode="after")
    def _check(self) -> Self:
        try:
            programme.attitude(self.attitude)
        except ProgrammeError as error:
            raise ValueError(str(error)) from None
        if (self.start is None) != (self.stop is None):
            given = "start" if self.stop is None else "stop"
            raise ValueError(f"{given}: expected start and stop together, found {given} alone")
        if self.start is not None and self.stop is not None and self.start >= self.stop:
            raise ValueError(f"start: expected a start before the stop {self.stop:g} s, found {self.start:g} s")
        return self


class ProgrammeTable(SessionTable):
    """[programme]"""

    name: str | None = Field(default=None, description="the name of a built-in programme")
    position: list[PositionTable] | None = Field(
        default=None, min_length=1, description="one or more tables [[programme.position]]"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.name is None) == (self.position is None):
            found = "neither" if self.name is None else "both"
            raise ValueError(f"name: expected either programme.name or [[programme.position]], found {found}")
        if self.name is not None:
            _check_known("name", self.name, programme.BUILT_IN)
        return self


class ConditionsTable(SessionTable):
    """session.conditions"""

    temperature_degC: float | None = Field(  # noqa: N815
        default=None, ge=-90, le=200, description="a number from -90 to 200 (°C)"
    )
    temperature_u: float | None = Field(default=None, ge=0, description="a number, not negative (K)")
    humidity_percent: float | None = Field(default=None, ge=0, le=100, description="a number from 0 to 100 (%)")
    pressure_hPa: float | None = Field(  # noqa: N815
        default=None, gt=0, le=1200, description="a number from 0 to 1200 (hPa)"
    )


class CircumstancesTable(SessionTable):
    """[session]"""

    date: datetime | date_type | None = Field(default=None, description="a date, or a date with a time, without quotes")
    operator: str | None = Field(default=None, min_length=1, description="a name, a string")
    conditions: ConditionsTable = Field(default_factory=ConditionsTable, description="a table of conditions")
    equipment: list[str] = Field(default_factory=list, description="a list of strings")

    @model_validator(mode="after")
    def _check(self) -> Self:
        for key, text in (("operator", self.operator or ""), *(("equipment", each) for each in self.equipment)):
            if not is_plain(text):
                raise ValueError(f"{key}: expected no control characters, found {shown(text)}")
        return self


class ExcludeTable(SessionTable):
    """[[exclude]]"""

    rest: int | None = Field(default=None, ge=1, description="the number of a rest, from 1")
    turn: int | None = Field(default=None, ge=1, description="the number of a turn, from 1")
    start: float | None = Field(default=None, description="a number (s)")
    stop: float | None = Field(default=None, description="a number (s)")
    file: int | None = Field(default=None, ge=1, description="the number of a file of the log, from 1")
    reason: str = Field(default="", description="a string")

    @model_validator(mode="after")
    def _check(self) -> Self:
        stated = {"rest": self.rest is not None, "turn": self.turn is not None, "start": self.start is not None}
        if sum(stated.values()) != 1 or (self.start is None) != (self.stop is None):
            raise ValueError(
                "rest: expected either rest, or turn, or start and stop together, found "
                f"{', '.join(k for k in ('rest', 'turn', 'start', 'stop') if getattr(self, k) is not None) or 'none'}"
            )
        if self.start is not None and self.stop is not None and self.start >= self.stop:
            raise ValueError(f"start: expected a start before the stop {self.stop:g} s, found {self.start:g} s")
        if self.file is not None and self.start is None:
            raise ValueError("file: expected only with start and stop, found it without")
        return self


class SessionDocument(SessionTable):
    """The whole file."""

    format: int = Field(ge=1, le=1, description="1, the format of this file")
    device: DeviceTable = Field(description="the table [device]")
    site: SiteTable = Field(default_factory=SiteTable, description="the table [site]")
    log: LogTable = Field(description="the table [log]")
    programme: ProgrammeTable | None = Field(default=None, description="the table [programme]")
    session: CircumstancesTable = Field(default_factory=CircumstancesTable, description="the table [session]")
    exclude: list[ExcludeTable] = Field(default_factory=list, description="tables [[exclude]]")

    @model_validator(mode="after")
    def _check(self) -> Self:
        magnetometer = self.log.magnetometer
        if self.site.field is None:
            return self
        if magnetometer is None:
            raise ValueError("site.field: expected only with [log.magnetometer], found no magnetometer")
        low, high = (limit / _TESLA[magnetometer.unit] for limit in _FIELD_ON_EARTH)
        if not low <= self.site.field <= high:
            raise ValueError(
                f"site.field: expected the field on Earth, from {low:g} to {high:g} {magnetometer.unit}, the unit of "
                f"[log.magnetometer], found {self.site.field:g}"
            )
        return self


TABLES: Mapping[str, type[SessionTable]] = {
    "device": DeviceTable,
    "imu": ImuTable,
    "site": SiteTable,
    "log": LogTable,
    "accel": AccelTable,
    "gyro": GyroTable,
    "magnetometer": MagnetometerTable,
    "temperature": TemperatureTable,
    "programme": ProgrammeTable,
    "position": PositionTable,
    "session": CircumstancesTable,
    "conditions": ConditionsTable,
}
"""The table behind every key that is one."""


def _check_known(key: str, value: str, known: Iterable[str]) -> None:
    names = list(known)
    if value not in names:
        raise ValueError(f'{key}: expected one of {", ".join(names)}, found "{value}"{did_you_mean(value, names)}')


def _repeated(values: Iterable[str]) -> list[str]:
    return [value for value, count in Counter(values).items() if count > 1]


# -------------------- messages --------------------


def faults_of(error: ValidationError, content: Mapping[str, Any]) -> list[str]:
    """Every fault once, as "key: expected …, found …"."""
    faults: dict[tuple[int | str, ...], str] = {}
    for fault in error.errors(include_url=False):
        key, table, expected = _located(fault["loc"])
        if fault["type"] == "extra_forbidden":
            unknown = str(fault["loc"][-1])
            said = f"unknown key '{unknown}' {_in_table(key)}{did_you_mean(unknown, table.model_fields)}"
            faults[(*key, unknown)] = said
        elif fault["type"] == "value_error":
            dot = "." if key else ""
            faults[key] = f"{dotted(key)}{dot}{fault['ctx']['error']}"
        else:
            found = "none" if fault["type"] == "missing" else _shown(_value_at(key, content))
            faults.setdefault(key, f"{dotted(key)}: expected {expected}, found {found}")
    return list(faults.values())


def _located(loc: tuple[int | str, ...]) -> tuple[tuple[int | str, ...], type[SessionTable], str]:
    """The key a fault belongs to, the innermost table on the way, and what the key expects."""
    table: type[SessionTable] = SessionDocument
    expected = ""
    key: list[int | str] = []
    for part in loc:
        if isinstance(part, int) and key == ["programme", "position"]:
            key.append(part)
            continue
        if part not in table.model_fields:
            break
        key.append(part)
        expected = table.model_fields[str(part)].description or ""
        if part not in TABLES:
            break
        table = TABLES[str(part)]
    return tuple(key), table, expected


def _value_at(key: tuple[int | str, ...], content: Any) -> Any:
    for part in key:
        content = content[part]
    return content


def _in_table(key: tuple[int | str, ...]) -> str:
    return f"in [{dotted(key)}]" if key else "at the top level"


def _shown(value: Any, width: int = 60) -> str:
    """A value as TOML has it, on one line, shortened."""
    if isinstance(value, Mapping):
        return "a table"
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= width else f"{text[: width - 1]}…"
