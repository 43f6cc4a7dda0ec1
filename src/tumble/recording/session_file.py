"""Sessions read from session.toml, checked and written, and made of the same description of samples in memory.

The keys, with examples, are in docs/reference/session-file.md; `session_keys` checks them, and what it lets through
becomes SI and radians here.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import tomli_w
from pydantic import ValidationError

from tumble.documents import text_of_document, toml_of
from tumble.earth import NORMAL_GRAVITY_U, normal_gravity
from tumble.errors import InputError, SessionError
from tumble.files import FilePath, whole_file
from tumble.recording.autopilot import sensors_from
from tumble.recording.circumstances import Circumstances, circumstances_from
from tumble.recording.session_keys.circumstances import CircumstancesTable, ExcludeTable
from tumble.recording.session_keys.document import SessionDocument
from tumble.recording.session_keys.faults import faults_of
from tumble.recording.session_keys.log import CLOCK, LogTable
from tumble.recording.session_keys.programme import ProgrammeTable
from tumble.recording.session_keys.sensors import MagnetometerTable, SensorsTable
from tumble.recording.session_keys.site import SiteTable
from tumble.recording.session_keys.temperature import TemperatureTable
from tumble.units import DEGREE, G_STANDARD, TIME_UNITS

if TYPE_CHECKING:
    from tumble.recording.samples import Data
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

SESSION_FILE = "session.toml"

UNKNOWN_SITE_GRAVITY_U = 0.03
"""Standard uncertainty of standard gravity as a value of local gravity at an unknown place on Earth, m/s²."""

_FAULTS_SHOWN = 3
_DESCRIPTION = "session"
"""What messages call the description of a session that is not in a file."""


def read_session(folder: FilePath) -> Session:
    """The session of a folder, or of the path of its session.toml.

    Raises SessionError, one line, with up to three faults of the file: missing, not TOML, an unknown key, a
    value that is not what its key expects, a log that does not exist.

    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=4), seed=1)
    >>> tumble.read_session(folder).device.serial
    'mems-1'
    """
    given = Path(folder)
    path = given if given.is_file() or given.name == SESSION_FILE else given / SESSION_FILE
    document = _checked(_parsed(path), str(path))
    session = _session(document, path.parent)
    _check_files(session, str(path))
    return session


def session_of(description: Mapping[str, Any], data: Data | None = None) -> Session:
    """The session of a description, the content of session.toml as a mapping. With `data` (arrays by column name, a
    polars or a pandas frame, or a sequence of them for a log of several files) the description names no log.file;
    without, its files are relative to the working folder.

    Raises SessionError as `read_session`, and LogError for data that are not columns of one length.

    >>> import numpy as np, tumble
    >>> accel = {"columns": ["ax", "ay", "az"], "unit": "count", "scale": 1000.0, "scale_per": "g"}
    >>> description = {"format": 1, "device": {"serial": "A-0007"}, "log": {"rate_hz": 100.0, "accel": accel}}
    >>> counts = {"ax": np.zeros(300), "ay": np.zeros(300), "az": np.full(300, 1000.0)}
    >>> chunk = next(tumble.open_log(tumble.session_of(description, counts)).chunks())
    >>> chunk.accel[0].tolist()
    [0.0, 0.0, 9.80665]
    """
    if data is None:
        session = _session(_checked(description, _DESCRIPTION), None)
        _check_files(session, _DESCRIPTION)
        return session
    from tumble.recording.samples import samples_of  # polars is heavy, and only needed here

    log, samples = description.get("log"), samples_of(data)
    if isinstance(log, Mapping) and "file" in log:
        raise SessionError(f"{_DESCRIPTION}: log.file: expected none beside samples in memory, found {log['file']!r}")
    if isinstance(log, Mapping):
        description = {**description, "log": {**log, "file": [part.name for part in samples]}}
    session = _session(_checked(description, _DESCRIPTION), None)
    session = replace(session, log=replace(session.log, files=samples))
    _check_files(session, _DESCRIPTION)
    return session


def session_from(given: Session | FilePath) -> Session:
    """A session as it is, or that of a folder. Raises InputError for anything else."""
    if isinstance(given, Session):
        return given
    if not isinstance(given, str | os.PathLike):
        raise InputError(
            f"session: expected the path of a session folder or a Session, found {type(given).__name__}; give arrays "
            "by name: accel=…, gyro=…, time=… or rate=…"
        )
    return read_session(given)


def write_session(folder: FilePath, content: Mapping[str, Any]) -> None:
    """Write session.toml with this content, keys and values as in the file, into a folder, made if need be.

    Raises SessionError if the content is not a session's; the log need not exist yet.

    >>> import numpy as np, tumble
    >>> session = tumble.session_of_arrays(accel=np.tile([0.0, 0.0, 9.81], (300, 1)), rate=100.0)
    >>> content = tumble.description_of(session)
    >>> tumble.write_session("session", content | {"log": {"file": "log.csv", **content["log"]}})
    """
    folder = Path(folder)
    path = folder / SESSION_FILE
    _checked(content, str(path))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as temporary:
            temporary.write_text(tomli_w.dumps(content), encoding="utf-8")
    except OSError as error:
        raise SessionError(f"{path}: expected a folder to write to, found: {error.strerror}") from None


def _parsed(path: Path) -> dict[str, Any]:
    if path.name != SESSION_FILE:
        raise SessionError(
            f"{path}: expected a session folder or its {SESSION_FILE}, found another file; of a log `tumble new` makes "
            "a session, and so does `tumble calibrate` with --latitude"
        )
    try:
        return toml_of(text_of_document(path), str(path), SessionError)
    except FileNotFoundError:
        found = "none" if path.parent.is_dir() else "no such folder"
        raise SessionError(f"{path}: expected a session folder with a {SESSION_FILE}, found {found}") from None
    except UnicodeDecodeError as error:
        raise SessionError(f"{path}: expected UTF-8 text, found {error.reason}; save it as UTF-8") from None
    except OSError as error:
        raise SessionError(f"{path}: expected a readable file, found: {error.strerror}") from None


def _checked(content: Mapping[str, Any], where: str) -> SessionDocument:
    try:
        return SessionDocument.model_validate(content)
    except ValidationError as error:
        faults = faults_of(error, content)
    said = faults[:_FAULTS_SHOWN]
    if len(faults) > len(said):
        said.append(f"and {len(faults) - len(said)} more")
    raise SessionError(f"{where}: {'; '.join(said)}")


def _check_files(session: Session, where: str) -> None:
    for file in session.log.files:
        if isinstance(file, Path) and not file.is_file():
            raise SessionError(f"{where}: log.file: expected a log at {file}, found no such file")
    passport = session.device.systematic
    if passport is not None and not passport.is_file():
        raise SessionError(f"{where}: device.systematic: expected a calibration file at {passport}, found no such file")


def _session(document: SessionDocument, folder: Path | None) -> Session:
    device, place = document.device, folder or Path()
    return Session(
        folder=folder,
        device=Device(
            serial=device.serial,
            model=device.model,
            systematic=None if device.systematic is None else place / device.systematic,
            grade=device.grade,
            prior=device.priors(),
            imu=sensors_from(device.imu.model_dump()),
        ),
        site=_site(document.site),
        log=_log(document.log, place),
        programme=None if document.programme is None else _programme(document.programme),
        excluded=tuple(_exclusion(given) for given in document.exclude),
        circumstances=_circumstances(document.session),
    )


def _circumstances(given: CircumstancesTable) -> Circumstances:
    return circumstances_from(given.model_dump())


def _exclusion(given: ExcludeTable) -> Exclusion:
    return Exclusion(
        rest=given.rest,
        turn=given.turn,
        start=given.start,
        stop=given.stop,
        file=(given.file or 1) - 1,
        reason=given.reason,
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
        gravity_confirmed=site.gravity_confirmed,
    )


def _log(log: LogTable, folder: Path) -> LogSpec:
    return LogSpec(
        files=tuple(folder / file for file in log.files),
        time=log.time,
        time_factor=TIME_UNITS.get(log.time_unit or "s", 1.0),
        rate=log.rate_hz,
        accel=_channels(log.accel, log.rate_hz),
        gyro=None if log.gyro is None else _channels(log.gyro, log.rate_hz),
        temperature=None if log.temperature is None else _thermometers(log.temperature, log),
        magnetometer=None if log.magnetometer is None else _magnetometer(log.magnetometer),
        clock=log.time_unit == CLOCK,
        regular=bool(log.regular),
        dialect=log.dialect(),
        clock_u=None if log.clock_ppm_u is None else 1e-6 * log.clock_ppm_u,
    )


def _thermometers(given: TemperatureTable, log: LogTable) -> TemperatureChannels:
    accel, gyro = len(log.accel.columns), 0 if log.gyro is None else len(log.gyro.columns)
    each = given.of_sensors(accel, gyro)
    gain, shift = given.celsius()
    columns = tuple(dict.fromkeys(given.columns))
    first = [given.columns.index(column) for column in columns]
    number = tuple(columns.index(given.columns[i]) for i in each)
    return TemperatureChannels(
        columns=columns,
        accel=number[:accel],
        gyro=number[accel:],
        unit_name=given.unit,
        gain=gain[first],
        shift=shift[first],
    )


def _magnetometer(given: MagnetometerTable) -> Magnetometer:
    return Magnetometer(columns=tuple(given.columns), unit=given.unit)


def _channels(sensors: SensorsTable, rate: float | None) -> Channels:
    unit = sensors.worth()
    scale = sensors.per_sensor(sensors.scale, 1.0)
    full_scale = None
    if sensors.range is not None:
        full_scale = float(sensors.range * unit.per_second(rate or 1.0) / np.abs(scale).max())
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
