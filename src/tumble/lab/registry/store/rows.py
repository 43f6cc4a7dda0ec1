"""Records, files, limits and forecasts in the tables; every function is within a transaction of the caller's.

Numbers of records are those of the registry and never used again; a correction does not take the number of what it
corrects.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from datetime import datetime
from typing import TYPE_CHECKING, Any

from sqlalchemy import bindparam, func, insert, select

from tumble.errors import InputError
from tumble.lab.registry.store.tables import CALIBRATION, CONTENT, FORECAST, LIMITS, LOG
from tumble.lab.registry.types import Forecast, LatestRecord, LimitsRecord, Record

if TYPE_CHECKING:
    from sqlalchemy import Connection

# Statements are made once: making one takes longer than running it.
_C, _LATER = CALIBRATION.c, CALIBRATION.alias("later")
_EVERY = (
    select(*_C, _LATER.c.number.label("superseded_by"))
    .select_from(CALIBRATION.outerjoin(_LATER, _LATER.c.supersedes == _C.number))
    .order_by(_C.number)
)
_OF_NUMBER = _EVERY.where(_C.number == bindparam("of"))
_OF_DEVICE = _EVERY.where(_C.serial == bindparam("of"))
_OF_LOGS = _EVERY.join(LOG, LOG.c.calibration == _C.number).where(LOG.c.sha256.in_(bindparam("of", expanding=True)))
_NUMBER = select(_C.number).where(_C.sha256 == bindparam("of"))
_FILE = select(CONTENT.c.file).where(CONTENT.c.calibration == bindparam("of"))
_ADD = insert(CALIBRATION).returning(_C.number)
_LIMITS = select(LIMITS).order_by(LIMITS.c.added, LIMITS.c.number)
"""In which limits of a type follow each other; the last ones are in force. An import numbers older ones after newer
ones."""

# -------------------- calibrations --------------------


def record_of(connection: Connection, number: int) -> Record:
    """The record of a number. Raises InputError where there is none."""
    row = connection.execute(_OF_NUMBER, {"of": number}).first()
    if row is None:
        raise InputError(f"record {number}: expected a record of the registry, found none of this number")
    return Record(**row._asdict())


def number_of(connection: Connection, sha256: str) -> int | None:
    """The number of the record of a content; None where there is none."""
    return connection.execute(_NUMBER, {"of": sha256}).scalar()


def every_record(connection: Connection) -> list[Record]:
    """All records, superseded ones too, by number."""
    return [Record(**row._asdict()) for row in connection.execute(_EVERY)]


def records_of_device(connection: Connection, serial: str) -> list[Record]:
    """The records of a device, superseded ones too, by number."""
    return [Record(**row._asdict()) for row in connection.execute(_OF_DEVICE, {"of": serial})]


def records_with_logs(connection: Connection, logs: Iterable[str]) -> list[Record]:
    """The records that stand on one of these logs (SHA-256)."""
    return [Record(**row._asdict()) for row in connection.execute(_OF_LOGS, {"of": sorted(logs)})]


def file_of(connection: Connection, number: int) -> str:
    """The text of the calibration file of a record."""
    return str(connection.execute(_FILE, {"of": number}).scalar_one())


def hashes(connection: Connection) -> set[str]:
    """The SHA-256 of the content of every record."""
    return set(connection.execute(select(_C.sha256)).scalars())


def add_record(connection: Connection, values: Mapping[str, Any], file: str, logs: Iterable[str]) -> int:
    """The number of a new record with these values of its columns, its file, and the logs (SHA-256) it stands on."""
    number = int(connection.execute(_ADD, values).scalar_one())
    connection.execute(insert(CONTENT), {"calibration": number, "file": file})
    rows = [{"calibration": number, "sha256": log} for log in sorted(logs)]
    if rows:
        connection.execute(insert(LOG), rows)
    return number


# -------------------- limits of device types --------------------


def every_limits(connection: Connection) -> list[LimitsRecord]:
    """All limits of all types, former ones too, in the order in which they came in force."""
    return [LimitsRecord(**row._asdict()) for row in connection.execute(_LIMITS)]


def limits_in_force(connection: Connection) -> dict[str, LimitsRecord]:
    """The limits that are in force, by device type: those that were given last, wherever."""
    return {limits.model: limits for limits in every_limits(connection)}


def add_limits(connection: Connection, model: str, file: str, systematic: str | None, added: datetime) -> LimitsRecord:
    """New limits of a type, or those that are there of the same content and time."""
    parts = (model, added.isoformat(), file, systematic or "")
    digest = hashlib.sha256("\0".join(parts).encode()).hexdigest()
    query = select(LIMITS).where(LIMITS.c.sha256 == digest)
    if connection.execute(query).first() is None:
        values = {"sha256": digest, "model": model, "file": file, "systematic": systematic, "added": added}
        connection.execute(insert(LIMITS), values)
    return LimitsRecord(**connection.execute(query).one()._asdict())


# -------------------- devices --------------------

_OF_A_FORECAST = ("name", "unit", "limit", "expected", "earliest", "latest")


def latest_records(connection: Connection, serials: Iterable[str] | None = None) -> list[LatestRecord]:
    """Of every device that has a record in force, or of some of them, the latest, with what is kept of its drift."""
    corrected = _C.number.in_(select(_C.supersedes).where(_C.supersedes.is_not(None)))
    numbers = func.max(_C.performed).label("performed"), func.max(_C.number).label("last"), func.count().label("count")
    devices = select(_C.serial, *numbers).where(~corrected).group_by(_C.serial)
    devices = devices if serials is None else devices.where(_C.serial.in_(list(serials)))
    of, F = devices.subquery(), FORECAST.c
    in_force = LIMITS.c.number.in_([limits.number for limits in limits_in_force(connection).values()])
    kept = (F.limits == LIMITS.c.number) & (F.serial == _C.serial) & (F.last == of.c.last) & (F.count == of.c.count)
    query = (
        select(of.c.last, of.c.count, LIMITS.c.number, F.last, *(F[name] for name in _OF_A_FORECAST), *_C)
        .join(of, (_C.serial == of.c.serial) & (_C.performed == of.c.performed))
        .outerjoin(LIMITS, (LIMITS.c.model == _C.model) & in_force)
        .outerjoin(FORECAST, kept)
        .where(~corrected)
    )
    names, latest = [column.name for column in _C], dict[str, LatestRecord]()
    for last, count, limits, kept_last, *values in connection.execute(query):
        of_forecast, of_record = values[: len(_OF_A_FORECAST)], values[len(_OF_A_FORECAST) :]
        record = Record(superseded_by=None, **dict(zip(names, of_record, strict=True)))
        known = latest.get(record.serial)
        if known is not None and known.record.number > record.number:  # of one moment the one added last
            continue
        met = of_forecast[0] is not None
        forecast = Forecast(**dict(zip(_OF_A_FORECAST, of_forecast, strict=True))) if met else None
        latest[record.serial] = LatestRecord(
            record=record, last=last, count=count, limits=limits, is_kept=kept_last is not None, forecast=forecast
        )
    return list(latest.values())


def keep_forecasts(connection: Connection, forecasts: Mapping[str, tuple[LatestRecord, Forecast | None]]) -> None:
    """Keep what was found of devices, by serial number, unless they have changed or it is kept meanwhile."""
    now = {each.record.serial: each for each in latest_records(connection, forecasts)}
    rows = [
        {name: getattr(forecast, name, None) for name in _OF_A_FORECAST}
        | {"limits": each.limits, "serial": serial, "last": each.last, "count": each.count}
        for serial, (each, forecast) in forecasts.items()
        if now.get(serial) == each
    ]
    if rows:
        connection.execute(insert(FORECAST), rows)
