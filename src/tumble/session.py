"""Session folders: session.toml read, checked and written.

A session is one power-on of one IMU: a folder with session.toml and the log it names. Reading gives a
`Session`, SI and radians inside. The keys, with examples, are in docs/session-file.md.

The tables of the file are the pydantic models below. Each key's `description` says what is expected of it,
and every message is made from it: "session.toml: site.latitude_deg: expected a number from -90 to 90, found
145.5". What concerns several keys at once is checked by the validators of the tables.
"""

from __future__ import annotations

import json
import math
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np
import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from tumble import programme
from tumble.earth import NORMAL_GRAVITY_U, normal_gravity
from tumble.errors import ProgrammeError, SessionError
from tumble.model import Block
from tumble.units import ACCEL_UNITS, DEGREE, G_STANDARD, GYRO_UNITS, MAGNETIC_UNITS, TIME_UNITS, Array, Unit

SESSION_FILE = "session.toml"

UNKNOWN_SITE_GRAVITY_U = 0.03
"""Standard uncertainty of standard gravity as a value of local gravity at an unknown place on Earth, m/s²."""

_TESLA = {"nT": 1e-9, "uT": 1e-6, "gauss": 1e-4}
_FIELD_ON_EARTH = (1.5e-5, 8e-5)  # T, at the ground: 22 to 67 µT, and magnetic rock

_FAULTS_SHOWN = 3
_UNIT_NORM_TOLERANCE = 1e-6
_LEAST_SINGULAR_VALUE = 1e-3
_LEAST_SINE = 1e-3


# -------------------- what a session is --------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class Device:
    """The IMU. `systematic` is the path of the calibration file with its nominal values, if it has one."""

    serial: str
    model: str | None
    systematic: Path | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Site:
    """Where the session was recorded: geodetic latitude, rad; height, m; gravity and its standard
    uncertainty, m/s²; modulus of the magnetic field in the unit of the magnetometer, None where it is not known."""

    latitude: float | None
    height: float
    gravity: float
    gravity_u: float
    field: float | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Channels:
    """The n sensors of one kind, and what their columns are worth.

    SI = (raw − offset) / scale · unit.factor, divided by the sample's interval if unit.kind is "increment".
    `unit_name` is the unit as the file has it. For raw units (count, V) `unit` is that of `scale_per`;
    for the others scale is 1 and offset 0. `axes` (n, 3): nominal sensing directions in the body frame,
    unit vectors. `range`: full scale in m/s² or rad/s, the smallest of the sensors'."""

    columns: tuple[str, ...]
    unit: Unit
    unit_name: str
    scale: Array
    offset: Array
    axes: Array
    range: float | None

    def to_si(self, raw: Array, dt: Array) -> Array:
        """Rates (m, n), m/s² or rad/s, of a log's numbers (m, n) and the samples' intervals (m,), s."""
        gain = self.unit.factor / self.scale
        out = raw - self.offset if self.offset.any() else raw
        if (gain != 1.0).any():
            out = out * gain
        if self.unit.kind == "increment":
            out = out / dt[:, None]
        return out


@dataclass(frozen=True, kw_only=True, slots=True)
class Magnetometer:
    """The three channels of a magnetometer and their unit, which is that of the site's field too."""

    columns: tuple[str, ...]
    unit: str


@dataclass(frozen=True, kw_only=True, slots=True)
class LogSpec:
    """The log's files and columns. Either `time`, a column in units of `time_factor` s, or `rate`, Hz."""

    files: tuple[Path, ...]
    time: str | None
    time_factor: float
    rate: float | None
    accel: Channels
    gyro: Channels | None
    temperature: str | None
    magnetometer: Magnetometer | None = None

    @property
    def columns(self) -> tuple[str, ...]:
        """Every column that is read: time, accelerometers, gyros, magnetometer, temperature."""
        gyro = self.gyro.columns if self.gyro else ()
        magnetometer = self.magnetometer.columns if self.magnetometer else ()
        columns = (self.time, *self.accel.columns, *gyro, *magnetometer, self.temperature)
        return tuple(column for column in columns if column is not None)


@dataclass(frozen=True, kw_only=True, slots=True)
class Position:
    """A position of the programme: its attitude code, and the rest's start and stop, s, where given."""

    attitude: str
    start: float | None
    stop: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class ProgrammeSpec:
    """Either the name of a built-in programme, or positions in order."""

    name: str | None
    positions: tuple[Position, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Session:
    """What session.toml says. `programme` is None for a free session: orientations are not assumed."""

    folder: Path
    device: Device
    site: Site
    log: LogSpec
    programme: ProgrammeSpec | None

    @property
    def accel_block(self) -> Block:
        """The accelerometers and their parameters."""
        return Block(kind="accel", axes=self.log.accel.axes)

    @property
    def gyro_block(self) -> Block | None:
        """The gyros and their parameters; None without gyros."""
        return None if self.log.gyro is None else Block(kind="gyro", axes=self.log.gyro.axes)


# -------------------- reading and writing --------------------


def read_session(folder: Path) -> Session:
    """The session of a folder, or of the path of its session.toml.

    Raises SessionError, one line, with up to three faults of the file: missing, not TOML, an unknown key, a
    value that is not what its key expects, a log that does not exist."""
    path = folder if folder.is_file() or folder.name == SESSION_FILE else folder / SESSION_FILE
    document = _checked(_parsed(path), path)
    session = _session(document, path.parent)
    _check_files(session, path)
    return session


def write_session(folder: Path, content: Mapping[str, Any]) -> None:
    """Write session.toml with this content, keys and values as in the file, into a folder, made if need be.

    Raises SessionError if the content is not a session's; the log need not exist yet."""
    path = folder / SESSION_FILE
    _checked(content, path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(tomli_w.dumps(content), encoding="utf-8")
    except OSError as error:
        raise SessionError(f"{path}: expected a folder to write to, found: {error.strerror}") from None


def _parsed(path: Path) -> dict[str, Any]:
    if path.name != SESSION_FILE:
        raise SessionError(f"{path}: expected a session folder or its {SESSION_FILE}, found another file")
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        found = "none" if path.parent.is_dir() else "no such folder"
        raise SessionError(f"{path}: expected a session folder with a {SESSION_FILE}, found {found}") from None
    except UnicodeDecodeError as error:
        raise SessionError(f"{path}: expected UTF-8 text, found {error.reason}; save it as UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise SessionError(f"{path}: expected TOML, found an error in its syntax: {error}") from None
    except OSError as error:
        raise SessionError(f"{path}: expected a readable file, found: {error.strerror}") from None


def _checked(content: Mapping[str, Any], path: Path) -> _Document:
    try:
        return _Document.model_validate(content)
    except ValidationError as error:
        faults = _faults(error, content)
    said = faults[:_FAULTS_SHOWN]
    if len(faults) > len(said):
        said.append(f"and {len(faults) - len(said)} more")
    raise SessionError(f"{path}: {'; '.join(said)}")


def _check_files(session: Session, path: Path) -> None:
    for file in session.log.files:
        if not file.is_file():
            raise SessionError(f"{path}: log.file: expected a log at {file}, found no such file")
    passport = session.device.systematic
    if passport is not None and not passport.is_file():
        raise SessionError(f"{path}: device.systematic: expected a calibration file at {passport}, found no such file")


# -------------------- the tables of the file --------------------


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class _Device(_Table):
    serial: str = Field(min_length=1, description="the serial number, a string that is not empty")
    model: str | None = Field(default=None, description="a string")
    systematic: str | None = Field(default=None, min_length=1, description="the path of a calibration file")


class _Site(_Table):
    latitude_deg: float | None = Field(default=None, ge=-90, le=90, description="a number from -90 to 90")
    height_m: float = Field(default=0.0, ge=-1000, le=10000, description="a number from -1000 to 10000 (m)")
    gravity: float | None = Field(
        default=None, ge=9.7, le=9.9, description="a number from 9.7 to 9.9 (m/s^2, on Earth)"
    )
    gravity_u: float | None = Field(default=None, ge=0, le=0.1, description="a number from 0 to 0.1 (m/s^2)")
    field: float | None = Field(default=None, gt=0, description="a positive number, in the unit of [log.magnetometer]")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.gravity_u is not None and self.gravity is None and self.latitude_deg is None:
            raise ValueError("gravity_u: expected site.gravity or site.latitude_deg with it, found neither")
        return self


class _Sensors(_Table):
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


class _Accel(_Sensors):
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


class _Gyro(_Sensors):
    UNITS = GYRO_UNITS
    SCALE_PER = ("rad/s", "deg/s", "rad", "deg", "arcsec")


class _Temperature(_Table):
    columns: list[str] = Field(min_length=1, max_length=1, description="a list of one column name")
    unit: Literal["degC"] = Field(default="degC", description='"degC"')


class _Magnetometer(_Table):
    columns: list[str] = Field(min_length=3, max_length=3, description="a list of three column names")
    unit: str = Field(description="the name of a unit, a string")

    @model_validator(mode="after")
    def _check(self) -> Self:
        _check_known("unit", self.unit, MAGNETIC_UNITS)
        return self


class _Log(_Table):
    file: str | list[str] = Field(min_length=1, description="a file name or a list of file names")
    time: str | None = Field(default=None, min_length=1, description="a column name")
    time_unit: str | None = Field(default=None, description=f"one of {', '.join(TIME_UNITS)}")
    rate_hz: float | None = Field(default=None, gt=0, description="a positive number")
    accel: _Accel = Field(description="the table [log.accel]")
    gyro: _Gyro | None = Field(default=None, description="the table [log.gyro]")
    magnetometer: _Magnetometer | None = Field(default=None, description="the table [log.magnetometer]")
    temperature: _Temperature | None = Field(default=None, description="the table [log.temperature]")

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
            _check_known("time_unit", self.time_unit, TIME_UNITS)
        for file in _repeated(self.files):
            raise ValueError(f'file: expected different files, found "{file}" twice')
        self._check_columns()
        self._check_ranges()
        return self

    def _check_columns(self) -> None:
        keys = {
            "time": [self.time] if self.time is not None else [],
            "accel.columns": self.accel.columns,
            "gyro.columns": self.gyro.columns if self.gyro else [],
            "magnetometer.columns": self.magnetometer.columns if self.magnetometer else [],
            "temperature.columns": self.temperature.columns if self.temperature else [],
        }
        for column in _repeated(c for columns in keys.values() for c in columns):
            using = [key for key, columns in keys.items() for c in columns if c == column]
            also = "twice" if using[0] == using[1] else f"in log.{using[0]} too"
            raise ValueError(f'{using[1]}: expected every column once, found "{column}" {also}')

    def _check_ranges(self) -> None:
        for key, sensors in (("accel", self.accel), ("gyro", self.gyro)):
            if sensors is None or sensors.range is None or self.rate_hz is not None:
                continue
            if sensors.worth().kind == "increment":
                raise ValueError(
                    f"{key}.range: expected log.rate_hz with the full scale of an increment per sample, "
                    "found log.time; leave range out"
                )


class _Position(_Table):
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


class _Programme(_Table):
    name: str | None = Field(default=None, description="the name of a built-in programme")
    position: list[_Position] | None = Field(
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


class _Document(_Table):
    format: int = Field(ge=1, le=1, description="1, the format of this file")
    device: _Device = Field(description="the table [device]")
    site: _Site = Field(default_factory=_Site, description="the table [site]")
    log: _Log = Field(description="the table [log]")
    programme: _Programme | None = Field(default=None, description="the table [programme]")

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


_TABLES: Mapping[str, type[_Table]] = {
    "device": _Device,
    "site": _Site,
    "log": _Log,
    "accel": _Accel,
    "gyro": _Gyro,
    "magnetometer": _Magnetometer,
    "temperature": _Temperature,
    "programme": _Programme,
    "position": _Position,
}
"""The table behind every key that is one."""


def _check_known(key: str, value: str, known: Iterable[str]) -> None:
    names = list(known)
    if value not in names:
        raise ValueError(f'{key}: expected one of {", ".join(names)}, found "{value}"{_nearest(value, names)}')


def _repeated(values: Iterable[str]) -> list[str]:
    return [value for value, count in Counter(values).items() if count > 1]


# -------------------- messages --------------------


def _faults(error: ValidationError, content: Mapping[str, Any]) -> list[str]:
    """Every fault once, as "key: expected …, found …"."""
    faults: dict[tuple[int | str, ...], str] = {}
    for fault in error.errors(include_url=False):
        key, table, expected = _located(fault["loc"])
        if fault["type"] == "extra_forbidden":
            unknown = str(fault["loc"][-1])
            said = f"unknown key '{unknown}' {_in_table(key)}{_nearest(unknown, table.model_fields)}"
            faults[(*key, unknown)] = said
        elif fault["type"] == "value_error":
            dot = "." if key else ""
            faults[key] = f"{_dotted(key)}{dot}{fault['ctx']['error']}"
        else:
            found = "none" if fault["type"] == "missing" else _shown(_value_at(key, content))
            faults.setdefault(key, f"{_dotted(key)}: expected {expected}, found {found}")
    return list(faults.values())


def _located(loc: tuple[int | str, ...]) -> tuple[tuple[int | str, ...], type[_Table], str]:
    """The key a fault belongs to, the innermost table on the way, and what the key expects."""
    table: type[_Table] = _Document
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
        if part not in _TABLES:
            break
        table = _TABLES[str(part)]
    return tuple(key), table, expected


def _value_at(key: tuple[int | str, ...], content: Any) -> Any:
    for part in key:
        content = content[part]
    return content


def _dotted(key: tuple[int | str, ...]) -> str:
    """A key as log.accel.unit; positions are counted from 1: programme.position[2]."""
    return "".join(f"[{part + 1}]" if isinstance(part, int) else f".{part}" for part in key).lstrip(".")


def _in_table(key: tuple[int | str, ...]) -> str:
    return f"in [{_dotted(key)}]" if key else "at the top level"


def _nearest(name: str, known: Iterable[str]) -> str:
    near = get_close_matches(name, list(known), n=1)
    return f"; did you mean '{near[0]}'?" if near else ""


def _shown(value: Any, width: int = 60) -> str:
    """A value as TOML has it, on one line, shortened."""
    if isinstance(value, Mapping):
        return "a table"
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= width else f"{text[: width - 1]}…"


# -------------------- from the tables to SI --------------------


def _session(document: _Document, folder: Path) -> Session:
    device = document.device
    return Session(
        folder=folder,
        device=Device(
            serial=device.serial,
            model=device.model,
            systematic=None if device.systematic is None else folder / device.systematic,
        ),
        site=_site(document.site),
        log=_log(document.log, folder),
        programme=None if document.programme is None else _programme(document.programme),
    )


def _site(site: _Site) -> Site:
    latitude = None if site.latitude_deg is None else site.latitude_deg * DEGREE
    if site.gravity is not None:
        gravity, u = site.gravity, 0.0
    elif latitude is not None:
        gravity, u = normal_gravity(latitude, site.height_m), NORMAL_GRAVITY_U
    else:
        gravity, u = G_STANDARD, UNKNOWN_SITE_GRAVITY_U
    return Site(
        latitude=latitude,
        height=site.height_m,
        gravity=gravity,
        gravity_u=u if site.gravity_u is None else site.gravity_u,
        field=site.field,
    )


def _log(log: _Log, folder: Path) -> LogSpec:
    return LogSpec(
        files=tuple(folder / file for file in log.files),
        time=log.time,
        time_factor=TIME_UNITS[log.time_unit or "s"],
        rate=log.rate_hz,
        accel=_channels(log.accel, log.rate_hz),
        gyro=None if log.gyro is None else _channels(log.gyro, log.rate_hz),
        temperature=None if log.temperature is None else log.temperature.columns[0],
        magnetometer=None if log.magnetometer is None else _magnetometer(log.magnetometer),
    )


def _magnetometer(given: _Magnetometer) -> Magnetometer:
    return Magnetometer(columns=tuple(given.columns), unit=given.unit)


def _channels(sensors: _Sensors, rate: float | None) -> Channels:
    unit = sensors.worth()
    scale = sensors.per_sensor(sensors.scale, 1.0)
    full_scale = None
    if sensors.range is not None:
        per_second = rate if unit.kind == "increment" and rate is not None else 1.0
        full_scale = float(sensors.range * unit.factor * per_second / np.abs(scale).max())
    return Channels(
        columns=tuple(sensors.columns),
        unit=unit,
        unit_name=sensors.unit,
        scale=scale,
        offset=sensors.per_sensor(sensors.offset, 0.0),
        axes=sensors.directions(),
        range=full_scale,
    )


def _programme(given: _Programme) -> ProgrammeSpec:
    positions = [
        Position(attitude=position.attitude, start=position.start, stop=position.stop)
        for position in given.position or []
    ]
    return ProgrammeSpec(name=given.name, positions=tuple(positions))
