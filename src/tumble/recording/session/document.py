"""session.toml as one description: its tables and keys, what is expected of each, and what they are in SI.

Each key's `description` says what is expected of it, and every message is made from it: "session.toml:
site.latitude_deg: expected a number from -90 to 90, found 145.5". What concerns several keys at once is checked by the
validators of the tables. `si` gives what a table says in SI and radians; `description_of` is the way back.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from datetime import date as date_type
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, get_args

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from tumble.documents import dotted, is_plain, shown
from tumble.earth import NORMAL_GRAVITY_U, normal_gravity
from tumble.errors import ProgrammeError, did_you_mean
from tumble.programme import positions as programme
from tumble.recording.autopilot import sensors_from
from tumble.recording.circumstances import circumstances_from
from tumble.recording.session import (
    Channels,
    Device,
    Exclusion,
    ListedPosition,
    LogSpec,
    Magnetometer,
    ProgrammeSpec,
    Session,
    Site,
    TemperatureChannels,
)
from tumble.recording.text.dialect import DELIMITERS, Dialect
from tumble.sensors.model import thermometers_of
from tumble.sensors.typed_quantities import prior_of
from tumble.units import (
    ACCEL_UNITS,
    DEGREE,
    G_STANDARD,
    GYRO_UNITS,
    MAGNETIC_UNITS,
    TEMPERATURE_UNITS,
    TIME_UNITS,
    Array,
    Unit,
)

CLOCK = "iso8601"
"""The time unit of dates with times and times of day."""
RAW = "raw"
"""The unit of numbers of thermometers that need a scale."""
LONGEST_NAME = 200
"""Characters of a serial number and of a type."""
LEAST_GRAVITY_U = 1e-15
"""m/s²: a smaller uncertainty than no gravimeter reaches is zero, or a mistake."""
UNKNOWN_SITE_GRAVITY_U = 0.03
"""Standard uncertainty of standard gravity as a value of local gravity at an unknown place on Earth, m/s²."""

_TESLA = {"nT": 1e-9, "uT": 1e-6, "gauss": 1e-4, "mgauss": 1e-7, "T": 1.0}
_FIELD_ON_EARTH = (1.5e-5, 8e-5)  # T, at the ground: 22 to 67 µT, and magnetic rock
_UNIT_NORM_TOLERANCE = 1e-6
_LEAST_SINGULAR_VALUE = 1e-3
_LEAST_SINE = 1e-3
_WIDTH = 60
"""Of a value in a message, characters."""

Numbers = float | list[float] | None
"""One for all columns, or one a column."""


class SessionTable(BaseModel):
    """A table of the file: no other keys, no other types."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False, defer_build=True)


def check_known(value: str, known: Iterable[str], key: str = "") -> str:
    """The value. Raises ValueError where it is none of those known."""
    names = list(known)
    if value not in names:
        hint, before = did_you_mean(value, names), f"{key}: " if key else ""
        raise ValueError(f'{before}expected one of {", ".join(names)}, found "{value}"{hint}')
    return value


def _one_of(names: Iterable[str]) -> AfterValidator:
    return AfterValidator(partial(check_known, known=tuple(names)))


def _visible(text: str) -> str:
    if not is_plain(text):
        raise ValueError(f"expected no control characters, found {shown(text)}")
    return text


def _name(text: str) -> str:
    if not (text.strip() and text.isprintable() and len(text) <= LONGEST_NAME):
        raise ValueError(f"expected 1 to {LONGEST_NAME} printable characters, found {shown(text)}")
    return text


def _encoding(name: str) -> str:
    try:
        "é".encode(name, errors="replace").decode(name)
    except (LookupError, UnicodeError, ValueError, TypeError):
        raise ValueError(f"expected a text encoding such as utf-16, found {_as_written(name)}") from None
    return name


def _different(files: str | list[str]) -> str | list[str]:
    for file, count in Counter([files] if isinstance(files, str) else files).items():
        if count > 1:
            raise ValueError(f'expected different files, found "{file}" twice')
    return files


def _check_span(start: float | None, stop: float | None) -> None:
    if start is not None and stop is not None and start >= stop:
        raise ValueError(f"start: expected a start before the stop {stop:g} s, found {start:g} s")


def _check_one_per_column(table: SensorsTable | TemperatureTable) -> None:
    for key, value in (("scale", table.scale), ("offset", table.offset)):
        columns = len(table.columns)
        if isinstance(value, Sequence) and len(value) != columns:
            raise ValueError(f"{key}: expected a number or {columns} numbers, one per column, found {len(value)}")


# -------------------- the tables --------------------


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

    def check_field(self, unit: str | None) -> None:
        """Raises ValueError where the field is not one on Earth in the unit of the magnetometer; None is none."""
        if self.field is None:
            return
        if unit is None:
            raise ValueError("site.field: expected only with [log.magnetometer], found no magnetometer")
        low, high = (limit / _TESLA[unit] for limit in _FIELD_ON_EARTH)
        if not low <= self.field <= high:
            raise ValueError(
                f"site.field: expected the field on Earth, from {low:g} to {high:g} {unit}, the unit of "
                f"[log.magnetometer], found {self.field:g}"
            )

    def si(self) -> Site:
        """Where gravity is not stated, it is normal gravity, or of an unknown place the standard one."""
        latitude = None if self.latitude_deg is None else self.latitude_deg * DEGREE
        gravity, u = G_STANDARD, UNKNOWN_SITE_GRAVITY_U
        if self.gravity is not None:
            gravity, u = self.gravity, 0.0
        elif latitude is not None:
            gravity, u = normal_gravity(latitude, self.height_m), NORMAL_GRAVITY_U
        return Site(
            latitude=latitude,
            height=self.height_m,
            gravity=gravity,
            gravity_u=u if self.gravity_u is None else self.gravity_u,
            field=self.field,
            gravity_confirmed=self.gravity_confirmed,
        )


class ImuTable(SessionTable):
    """[device.imu]"""

    accel_number: int | None = Field(default=None, ge=1, le=9, description="a number from 1 to 9")
    accel_id: int | None = Field(default=None, ge=1, lt=2**32, description="a device id, a whole number")
    gyro_number: int | None = Field(default=None, ge=1, le=9, description="a number from 1 to 9")
    gyro_id: int | None = Field(default=None, ge=1, lt=2**32, description="a device id, a whole number")


class DeviceTable(SessionTable):
    """[device]"""

    serial: Annotated[str, AfterValidator(_name)] = Field(
        min_length=1, description="the serial number, a string that is not empty"
    )
    model: Annotated[str, AfterValidator(_name)] | None = Field(default=None, description="a string")
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
        flat = {
            f"{key}.{of}" if of else key: text
            for key, value in self.prior.items()
            for of, text in ({"": value} if isinstance(value, str) else value).items()
        }
        return dict(prior_of(key, text) for key, text in flat.items())

    @model_validator(mode="after")
    def _check(self) -> Self:
        self.priors()
        return self

    def si(self, folder: Path) -> Device:
        return Device(
            serial=self.serial,
            model=self.model,
            systematic=None if self.systematic is None else folder / self.systematic,
            grade=self.grade,
            prior=self.priors(),
            imu=sensors_from(self.imu.model_dump()),
        )


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
    operator: Annotated[str, AfterValidator(_visible)] | None = Field(
        default=None, min_length=1, description="a name, a string"
    )
    conditions: ConditionsTable = Field(default_factory=ConditionsTable, description="a table of conditions")
    equipment: list[Annotated[str, AfterValidator(_visible)]] = Field(
        default_factory=list, description="a list of strings"
    )


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
        stated = [key for key in ("rest", "turn", "start", "stop") if getattr(self, key) is not None]
        if stated not in (["rest"], ["turn"], ["start", "stop"]):
            raise ValueError(
                f"rest: expected either rest, or turn, or start and stop together, found {', '.join(stated) or 'none'}"
            )
        _check_span(self.start, self.stop)
        if self.file is not None and self.start is None:
            raise ValueError("file: expected only with start and stop, found it without")
        return self

    def si(self) -> Exclusion:
        return Exclusion(**{**self.model_dump(), "file": (self.file or 1) - 1})


class SensorsTable(SessionTable):
    """The common keys of [log.accel] and [log.gyro]."""

    UNITS: ClassVar[Mapping[str, Unit]]
    SCALE_PER: ClassVar[tuple[str, ...]]  # the first is the default

    columns: list[str] = Field(min_length=3, description="a list of at least three column names")
    unit: str = Field(description="the name of a unit, a string")
    scale: Numbers = Field(default=None, description="a number or a list of numbers")
    scale_per: str | None = Field(default=None, description="the name of a unit, a string")
    offset: Numbers = Field(default=None, description="a number or a list of numbers")
    axes: list[list[float]] | None = Field(default=None, description="a list of unit vectors [x, y, z]")
    range: float | None = Field(default=None, gt=0, description="a positive number")

    @property
    def worth(self) -> Unit:
        """The unit of (raw − offset) / scale."""
        raw = self.UNITS[self.unit].kind == "raw"
        return self.UNITS[(self.scale_per or self.SCALE_PER[0]) if raw else self.unit]

    def per_sensor(self, value: Numbers, default: float) -> Array:
        """A number or a list as an array (n,)."""
        return np.broadcast_to(np.asarray(default if value is None else value, float), len(self.columns)).copy()

    def directions(self) -> Array:
        """The axes (n, 3), exactly of unit length."""
        axes = np.eye(3) if self.axes is None else np.array(self.axes, dtype=float)
        return np.asarray(axes / np.linalg.norm(axes, axis=1, keepdims=True))

    @model_validator(mode="after")
    def _check(self) -> Self:
        check_known(self.unit, self.UNITS, "unit")
        if self.UNITS[self.unit].kind != "raw":
            for key in ("scale", "scale_per", "offset"):
                if getattr(self, key) is not None:
                    raise ValueError(f'{key}: expected only with unit "count" or "V", found unit "{self.unit}"')
        elif self.scale is None:
            raise ValueError(f'scale: expected the nominal output per unit for unit "{self.unit}", found none')
        else:
            check_known(self.scale_per or self.SCALE_PER[0], self.SCALE_PER, "scale_per")
            _check_one_per_column(self)
            if not np.all(self.scale):
                raise ValueError(f"scale: expected numbers other than zero, found {_as_written(self.scale)}")
        self._check_axes()
        return self

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
                    f"found norm {math.hypot(*axis):.7g} of vector {number}, {_as_written(axis)}"
                )
        if np.linalg.svd(self.directions(), compute_uv=False)[2] < _LEAST_SINGULAR_VALUE:
            raise ValueError("axes: expected directions that span three dimensions, found them in one plane")

    def si(self, rate: float | None) -> Channels:
        scale = self.per_sensor(self.scale, 1.0)
        full_scale = None
        if self.range is not None:
            full_scale = float(self.range * self.worth.per_second(rate or 1.0) / np.abs(scale).max())
        return Channels(
            columns=tuple(self.columns),
            unit=self.worth,
            unit_name=self.unit,
            scale=scale,
            offset=self.per_sensor(self.offset, 0.0),
            axes=self.directions(),
            range=full_scale,
        )


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


class MagnetometerTable(SessionTable):
    """[log.magnetometer]"""

    columns: list[str] = Field(min_length=3, max_length=3, description="a list of three column names")
    unit: Annotated[str, _one_of(MAGNETIC_UNITS)] = Field(description="the name of a unit, a string")

    def si(self) -> Magnetometer:
        return Magnetometer(columns=tuple(self.columns), unit=self.unit)


class TemperatureTable(SessionTable):
    """[log.temperature]: one column for all sensors, two for the accelerometers and the gyros, or one a sensor, the
    accelerometers first; then a thermometer may come several times."""

    columns: list[str] = Field(min_length=1, description="a list of column names")
    unit: Annotated[str, _one_of([*TEMPERATURE_UNITS, RAW])] = Field(
        default="degC", description="the name of a unit, a string"
    )
    scale: Numbers = Field(default=None, description="a number or a list of numbers: raw numbers per degC")
    offset: Numbers = Field(default=None, description="a number or a list of numbers: the raw number at 0 degC")

    def celsius(self) -> tuple[Array, Array]:
        """Gain and shift (T,) of each column: °C are gain · number + shift."""
        ones = np.ones(len(self.columns))
        if self.unit != RAW:
            gain, shift = TEMPERATURE_UNITS[self.unit]
            return gain * ones, shift * ones
        scale, offset = ones * np.asarray(self.scale, float), ones * np.asarray(self.offset or 0.0, float)
        return 1.0 / scale, -offset / scale

    def of_sensors(self, accel: int, gyro: int) -> tuple[int, ...]:
        """The place of the column of each of so many accelerometers and gyros. Raises ValueError where there is another
        number of columns."""
        places = thermometers_of(len(self.columns), accel, gyro)
        if places is None:
            two = "two for the accelerometers and the gyros, " if gyro else ""
            raise ValueError(
                f"temperature.columns: expected one column for all sensors, {two}or {accel + gyro}, one a sensor, "
                f"accelerometers first, found {len(self.columns)}"
            )
        return places

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.unit == RAW and (self.scale is None or not np.all(self.scale)):
            raise ValueError(
                f'scale: expected the raw numbers per degC for unit "raw", found {"none" if self.scale is None else 0}'
            )
        if self.unit != RAW and (self.scale is not None or self.offset is not None):
            key = "offset" if self.scale is None else "scale"
            raise ValueError(f'{key}: expected only with unit "raw", found unit "{self.unit}"')
        _check_one_per_column(self)
        if len(set(zip(self.columns, *self.celsius(), strict=True))) > len(set(self.columns)):
            raise ValueError("scale: expected one scale and offset for a column that is named again, found others")
        return self

    def si(self, accel: int, gyro: int) -> TemperatureChannels:
        gain, shift = self.celsius()
        columns = tuple(dict.fromkeys(self.columns))
        first = [self.columns.index(column) for column in columns]
        number = tuple(columns.index(self.columns[place]) for place in self.of_sensors(accel, gyro))
        return TemperatureChannels(
            columns=columns,
            accel=number[:accel],
            gyro=number[accel:],
            unit_name=self.unit,
            gain=gain[first],
            shift=shift[first],
        )


class LogTable(SessionTable):
    """[log]"""

    file: Annotated[str | list[str], AfterValidator(_different)] = Field(
        min_length=1, description="a file name or a list of file names"
    )
    time: str | None = Field(default=None, min_length=1, description="a column name")
    time_unit: Annotated[str, _one_of([*TIME_UNITS, CLOCK])] | None = Field(
        default=None, description=f"one of {', '.join([*TIME_UNITS, CLOCK])}"
    )
    rate_hz: float | None = Field(default=None, gt=0, description="a positive number")
    regular: bool | None = Field(default=None, description="true or false")
    clock_ppm_u: float | None = Field(default=None, ge=0, description="a number that is not negative")
    delimiter: Annotated[str, _one_of(DELIMITERS)] | None = Field(
        default=None, description="a character, or a blank for one or more blanks"
    )
    decimal: Annotated[str, _one_of(".,")] | None = Field(default=None, description='"." or ","')
    comment: str | None = Field(
        default=None, min_length=1, max_length=8, description="the mark that comments begin with"
    )
    header: bool | None = Field(default=None, description="true or false")
    encoding: Annotated[str, AfterValidator(_encoding)] | None = Field(
        default=None, description="the name of an encoding"
    )
    accel: AccelTable = Field(description="the table [log.accel]")
    gyro: GyroTable | None = Field(default=None, description="the table [log.gyro]")
    magnetometer: MagnetometerTable | None = Field(default=None, description="the table [log.magnetometer]")
    temperature: TemperatureTable | None = Field(default=None, description="the table [log.temperature]")

    @property
    def sensors(self) -> tuple[int, int]:
        """How many accelerometers and gyros there are."""
        return len(self.accel.columns), 0 if self.gyro is None else len(self.gyro.columns)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.time is None) == (self.rate_hz is None):
            given = "neither" if self.time is None else "both"
            raise ValueError(f"time: expected either log.time, a column, or log.rate_hz, found {given}")
        if self.time_unit is not None and self.time is None:
            raise ValueError("time_unit: expected only with log.time, found log.rate_hz")
        if self.regular and self.time is None:
            raise ValueError("regular: expected only with log.time, found log.rate_hz, which makes rows regular")
        self._check_columns()
        for key, table in (("accel", self.accel), ("gyro", self.gyro)):
            ranged = table is not None and table.range is not None and table.worth.kind == "increment"
            if ranged and self.rate_hz is None:
                raise ValueError(
                    f"{key}.range: expected log.rate_hz with the full scale of an increment per sample, "
                    "found log.time; leave range out"
                )
        return self

    def _check_columns(self) -> None:
        """Every column is one thing; a thermometer may be that of several sensors where each has one."""
        keys = {"time": [self.time] if self.time is not None else []}
        for kind, table in (("accel", self.accel), ("gyro", self.gyro), ("magnetometer", self.magnetometer)):
            keys[f"{kind}.columns"] = table.columns if table is not None else []
        if self.temperature is not None:
            columns = self.temperature.columns
            one_each = len(columns) == len(self.temperature.of_sensors(*self.sensors))
            keys["temperature.columns"] = list(dict.fromkeys(columns)) if one_each else columns
        for column, count in Counter(c for columns in keys.values() for c in columns).items():
            if count > 1:
                using = [key for key, columns in keys.items() for c in columns if c == column]
                also = "twice" if using[0] == using[1] else f"in log.{using[0]} too"
                raise ValueError(f'{using[1]}: expected every column once, found "{column}" {also}')

    def si(self, folder: Path) -> LogSpec:
        dialect = self.model_dump(include={"delimiter", "decimal", "comment", "header", "encoding"}, exclude_none=True)
        return LogSpec(
            files=tuple(folder / file for file in ([self.file] if isinstance(self.file, str) else self.file)),
            time=self.time,
            time_factor=TIME_UNITS.get(self.time_unit or "s", 1.0),
            rate=self.rate_hz,
            accel=self.accel.si(self.rate_hz),
            gyro=None if self.gyro is None else self.gyro.si(self.rate_hz),
            temperature=None if self.temperature is None else self.temperature.si(*self.sensors),
            magnetometer=None if self.magnetometer is None else self.magnetometer.si(),
            clock=self.time_unit == CLOCK,
            regular=bool(self.regular),
            dialect=Dialect(**dialect) if dialect else None,
            clock_u=None if self.clock_ppm_u is None else 1e-6 * self.clock_ppm_u,
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
        _check_span(self.start, self.stop)
        return self


class ProgrammeTable(SessionTable):
    """[programme]"""

    name: Annotated[str, _one_of(programme.BUILT_IN)] | None = Field(
        default=None, description="the name of a built-in programme"
    )
    position: list[PositionTable] | None = Field(
        default=None, min_length=1, description="one or more tables [[programme.position]]"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.name is None) == (self.position is None):
            given = "neither" if self.name is None else "both"
            raise ValueError(f"name: expected either programme.name or [[programme.position]], found {given}")
        return self

    def si(self) -> ProgrammeSpec:
        positions = tuple(ListedPosition(**position.model_dump()) for position in self.position or [])
        return ProgrammeSpec(name=self.name, positions=positions)


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
        self.site.check_field(None if self.log.magnetometer is None else self.log.magnetometer.unit)
        return self

    def si(self, folder: Path | None) -> Session:
        """The session, its files in a folder; None where samples are in memory."""
        place = folder or Path()
        return Session(
            folder=folder,
            device=self.device.si(place),
            site=self.site.si(),
            log=self.log.si(place),
            programme=None if self.programme is None else self.programme.si(),
            excluded=tuple(table.si() for table in self.exclude),
            circumstances=circumstances_from(self.session.model_dump()),
        )


# -------------------- what is said of a file that is not as it should be --------------------


def table_behind(annotation: Any) -> type[SessionTable] | None:
    """The table that the values of a key are, or are lists of; None where they are none."""
    if isinstance(annotation, type) and issubclass(annotation, SessionTable):
        return annotation
    return next((table for part in get_args(annotation) if (table := table_behind(part)) is not None), None)


def faults_of(error: ValidationError, content: Mapping[str, Any]) -> list[str]:
    """Every fault once, as "key: expected …, found …"."""
    faults: dict[tuple[int | str, ...], str] = {}
    for fault in error.errors(include_url=False):
        key: tuple[int | str, ...] = ()
        table: type[SessionTable] = SessionDocument
        inner: type[SessionTable] | None = SessionDocument  # the table of the last part, if it is one
        expected = ""
        for part in fault["loc"]:
            if isinstance(part, int) and inner is not None and key:
                key += (part,)
                continue
            if inner is None or part not in inner.model_fields:
                break
            table, field = inner, inner.model_fields[str(part)]
            key, expected, inner = (*key, part), field.description or "", table_behind(field.annotation)
        table = inner or table
        if fault["type"] == "extra_forbidden":
            unknown = str(fault["loc"][-1])
            where = f"in [{dotted(key)}]" if key else "at the top level"
            faults[(*key, unknown)] = f"unknown key '{unknown}' {where}{did_you_mean(unknown, table.model_fields)}"
        elif fault["type"] == "value_error":
            separator = "" if not key else ": " if inner is None else "."
            faults[key] = f"{dotted(key)}{separator}{fault['ctx']['error']}"
        else:
            value: Any = content
            if fault["type"] != "missing":
                for part in key:
                    value = value[part]
            found = "none" if fault["type"] == "missing" else _as_written(value)
            faults.setdefault(key, f"{dotted(key)}: expected {expected}, found {found}")
    return list(faults.values())


def _as_written(value: Any) -> str:
    """A value as TOML has it, on one line, shortened."""
    if isinstance(value, Mapping):
        return "a table"
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= _WIDTH else f"{text[: _WIDTH - 1]}…"
