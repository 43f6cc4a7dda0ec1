"""Session folders: session.toml read, checked and written.

A session is one power-on of one IMU: a folder with session.toml and the log it names. Reading gives a
`Session`, SI and radians inside. The keys, with examples, are in docs/session-file.md; `session_tables` checks them.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from pydantic import ValidationError

from tumble.earth import NORMAL_GRAVITY_U, normal_gravity
from tumble.errors import SessionError
from tumble.files import whole_file
from tumble.recording.dialect import Dialect
from tumble.recording.session_keys import (
    CLOCK,
    LogTable,
    MagnetometerTable,
    ProgrammeTable,
    SensorsTable,
    SessionDocument,
    SiteTable,
    faults_of,
)
from tumble.sensors.model import Block
from tumble.units import DEGREE, G_STANDARD, TIME_UNITS, Array, Unit

SESSION_FILE = "session.toml"

UNKNOWN_SITE_GRAVITY_U = 0.03
"""Standard uncertainty of standard gravity as a value of local gravity at an unknown place on Earth, m/s²."""

_FAULTS_SHOWN = 3


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
    """The log's files and columns. Either `time`, a column in units of `time_factor` s, or `rate`, Hz. `clock`: the
    times are those of a clock or a calendar; `regular`: rows are equally spaced, whatever their times are; `dialect`:
    how text files are written, None for CSV files with their names in the first line."""

    files: tuple[Path, ...]
    time: str | None
    time_factor: float
    rate: float | None
    accel: Channels
    gyro: Channels | None
    temperature: str | None
    magnetometer: Magnetometer | None = None
    clock: bool = False
    regular: bool = False
    dialect: Dialect | None = None

    @property
    def columns(self) -> tuple[str, ...]:
        """Every column that is read: time, accelerometers, gyros, magnetometer, temperature."""
        gyro = self.gyro.columns if self.gyro else ()
        magnetometer = self.magnetometer.columns if self.magnetometer else ()
        columns = (self.time, *self.accel.columns, *gyro, *magnetometer, self.temperature)
        return tuple(column for column in columns if column is not None)


@dataclass(frozen=True, kw_only=True, slots=True)
class ListedPosition:
    """A position of the programme: its attitude code, and the rest's start and stop, s, where given."""

    attitude: str
    start: float | None
    stop: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class ProgrammeSpec:
    """Either the name of a built-in programme, or positions in order."""

    name: str | None
    positions: tuple[ListedPosition, ...]


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
        with whole_file(path) as temporary:
            temporary.write_text(tomli_w.dumps(content), encoding="utf-8")
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
    except (ValueError, RecursionError):  # a number of thousands of digits, hundreds of brackets
        raise SessionError(f"{path}: expected TOML, found a number or a nesting without measure") from None
    except OSError as error:
        raise SessionError(f"{path}: expected a readable file, found: {error.strerror}") from None


def _checked(content: Mapping[str, Any], path: Path) -> SessionDocument:
    try:
        return SessionDocument.model_validate(content)
    except ValidationError as error:
        faults = faults_of(error, content)
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


# -------------------- from the tables to SI --------------------


def _session(document: SessionDocument, folder: Path) -> Session:
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


def _site(site: SiteTable) -> Site:
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


def _log(log: LogTable, folder: Path) -> LogSpec:
    return LogSpec(
        files=tuple(folder / file for file in log.files),
        time=log.time,
        time_factor=TIME_UNITS.get(log.time_unit or "s", 1.0),
        rate=log.rate_hz,
        accel=_channels(log.accel, log.rate_hz),
        gyro=None if log.gyro is None else _channels(log.gyro, log.rate_hz),
        temperature=None if log.temperature is None else log.temperature.columns[0],
        magnetometer=None if log.magnetometer is None else _magnetometer(log.magnetometer),
        clock=log.time_unit == CLOCK,
        regular=bool(log.regular),
        dialect=log.dialect(),
    )


def _magnetometer(given: MagnetometerTable) -> Magnetometer:
    return Magnetometer(columns=tuple(given.columns), unit=given.unit)


def _channels(sensors: SensorsTable, rate: float | None) -> Channels:
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


def _programme(given: ProgrammeTable) -> ProgrammeSpec:
    positions = [
        ListedPosition(attitude=position.attitude, start=position.start, stop=position.stop)
        for position in given.position or []
    ]
    return ProgrammeSpec(name=given.name, positions=tuple(positions))
