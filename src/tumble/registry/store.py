"""What is in a registry: adding calibrations and limits, listing devices and records, showing one.

Every function is one transaction. Numbers of records are those of the registry and never used again; a correction does
not take the number of what it corrects.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cache
from typing import TYPE_CHECKING, Any

from sqlalchemy import Row, Select, bindparam, func, insert, select

from tumble.acceptance.schedule import Occasion
from tumble.errors import InputError
from tumble.files import FilePath
from tumble.registry.connect import Registry
from tumble.registry.records import (
    LaunchRow,
    ParameterRow,
    Particulars,
    Record,
    Submission,
    all_parameter_rows,
    read_submission,
)
from tumble.registry.schema import CALIBRATION, CONTENT, LAUNCH, LIMITS

if TYPE_CHECKING:
    from sqlalchemy import Connection

    from tumble.calibration.calibration_file import Calibration


NOTHING_SAID = Particulars()

_LIMITS_ORDER = (LIMITS.c.added, LIMITS.c.number)
"""In which limits of a type follow each other; the last ones are in force."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Added:
    """A record, and whether it is new: a calibration that was there already is not added again."""

    record: Record
    new: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class LimitsRecord:
    """Acceptance limits of a device type: `file` is the text of the TOML file, `systematic` that of the calibration
    file with the type's systematic values, if it names one."""

    number: int
    sha256: str
    model: str
    file: str
    systematic: str | None
    added: datetime


# -------------------- calibrations --------------------


def add(registry: Registry, submission: Submission) -> Added:
    """Add a calibration, unless it is there already.

    Raises InputError, one line: another type for a known serial, a log that another record stands on, a correction
    without a reason or of something that is no longer in force."""
    with registry.writing() as connection:
        number, new = add_within(
            connection, submission, datetime.now(UTC), lambda model: _latest_limits(connection, model)
        )
        return Added(record=_one(connection, number), new=new)


def add_calibration(
    registry: Registry, calibration: Calibration | FilePath, particulars: Particulars = NOTHING_SAID
) -> Added:
    """Add a calibration, or that of a file, unless it is there already, with what it does not say of itself. Raises as
    `read_submission` and `add`.

    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> tumble.calibrate(folder).write("calibration.json")
    >>> with tumble.open_registry("registry.sqlite", create=True) as registry:
    ...     added = tumble.add_calibration(registry, "calibration.json")
    >>> added.record.serial, added.new
    ('mems-1', True)
    """
    return add(registry, read_submission(calibration, particulars))


def add_within(
    connection: Connection, submission: Submission, added: datetime, limits_of: Callable[[str], LimitsRecord | None]
) -> tuple[int, bool]:
    """`add` in a transaction of the caller's: the number of the record, and whether it is new; `limits_of` gives the
    limits that were in force for a type."""
    known = connection.execute(_known(), {"sha256": submission.sha256}).scalar()
    if known is not None:
        return int(known), False
    corrected = _corrected(connection, submission)
    standing = [record for record in _standing(connection, submission.serial) if record != corrected]
    model = _model(submission, standing)
    _check_logs(connection, submission)
    particulars = submission.particulars
    first = not standing if corrected is None else corrected.occasion == "incoming"
    occasion = particulars.occasion or ("incoming" if first else "periodic")
    limits = None if model is None else limits_of(model)
    values = {
        "sha256": submission.sha256,
        "serial": submission.serial,
        "model": model,
        "method": submission.method,
        "frame": submission.frame,
        "performed": submission.performed,
        "occasion": occasion,
        "state": particulars.state,
        "limits": None if limits is None else limits.number,
        "verdict": None if limits is None else _judged(submission, limits, occasion),
        "supersedes": particulars.supersedes,
        "reason": particulars.reason,
        "added": added,
    }
    number = int(connection.execute(_INSERT, values).scalar_one())
    connection.execute(insert(CONTENT), {"calibration": number, "file": submission.file})
    rows = [
        {"calibration": number, "number": i, "session": launch.session, "log_sha256": launch.log_sha256}
        for i, launch in enumerate(submission.launches, 1)
    ]
    connection.execute(insert(LAUNCH), rows)
    return number, True


def _judged(submission: Submission, limits: LimitsRecord, occasion: Occasion) -> str | None:
    """What limits say of a calibration, in a word; None where they have none for such a check."""
    from tumble.acceptance.conformity import verdict_at
    from tumble.acceptance.limits import parse_limits

    parsed = parse_limits(limits.file, limits.systematic, f"limits {limits.number}")
    try:
        verdict = verdict_at(submission.calibration, parsed, occasion)
    except InputError:
        return "other frame"
    return None if verdict is None else verdict.result


def number_of(connection: Connection, sha256: str) -> int:
    """The number of the record of a content."""
    return int(connection.execute(_known(), {"sha256": sha256}).scalar_one())


def _corrected(connection: Connection, submission: Submission) -> Record | None:
    """The record that a submission corrects."""
    number, reason = submission.particulars.supersedes, submission.particulars.reason
    if (number is None) != (reason is None):
        raise InputError(f"{submission.name}: expected --supersedes NUMBER with --reason TEXT, found one of them")
    if number is None:
        return None
    record = _one(connection, number)
    if record.superseded_by is not None:
        raise InputError(
            f"record {number}: expected one that is in force, found one superseded by {record.superseded_by}; "
            "supersede that one"
        )
    return record


def _model(submission: Submission, standing: Sequence[Record]) -> str | None:
    """The type of the device; a file that names none is of the type that is known."""
    for record in standing:
        if submission.model is not None and record.model not in (None, submission.model):
            raise InputError(
                f"{submission.name}: device.model: expected {record.model!r}, as device {submission.serial} has it "
                f"in record {record.number}, found {submission.model!r}; serial numbers must be unique"
            )
    return submission.model or next((r.model for r in standing if r.model is not None), None)


def _check_logs(connection: Connection, submission: Submission) -> None:
    """That no log would count twice."""
    logs = {launch.log_sha256 for launch in submission.launches} - {""}
    for row in connection.execute(_with_logs(), {"logs": sorted(logs)}):
        record = _record(row)
        if record.superseded_by is None and record.number != submission.particulars.supersedes:
            raise InputError(
                f"{submission.name}: expected a log that is not in the registry, found that of record {record.number} "
                f"({record.serial}, {record.method}); to correct that record give --supersedes {record.number}"
            )


# -------------------- reading back --------------------


@cache
def _records(column: str | None = None) -> Select[Any]:
    """All records, or those with a value of a column, which is a parameter of the same name. Made once: making such a
    query takes longer than running it."""
    later = CALIBRATION.alias("later")
    every = (
        select(*CALIBRATION.c, later.c.number.label("superseded_by"))
        .select_from(CALIBRATION.outerjoin(later, later.c.supersedes == CALIBRATION.c.number))
        .order_by(CALIBRATION.c.number)
    )
    return every if column is None else every.where(CALIBRATION.c[column] == bindparam(column))


@cache
def _with_logs() -> Select[Any]:
    """The records that have one of these `logs`."""
    return (
        _records()
        .join(LAUNCH, LAUNCH.c.calibration == CALIBRATION.c.number)
        .where(LAUNCH.c.log_sha256.in_(bindparam("logs", expanding=True)))
    )


@cache
def _known() -> Select[Any]:
    return select(CALIBRATION.c.number).where(CALIBRATION.c.sha256 == bindparam("sha256"))


_INSERT = insert(CALIBRATION).returning(CALIBRATION.c.number)


def _record(row: Row[Any]) -> Record:
    return Record(**row._asdict())


def _one(connection: Connection, number: int) -> Record:
    row = connection.execute(_records("number"), {"number": number}).first()
    if row is None:
        raise InputError(f"record {number}: expected a record of the registry, found none of this number")
    return _record(row)


def _standing(connection: Connection, serial: str) -> list[Record]:
    rows = connection.execute(_records("serial"), {"serial": serial})
    return [record for record in map(_record, rows) if record.superseded_by is None]


def every_record(connection: Connection) -> list[Record]:
    """All records, superseded ones too, by number."""
    return [_record(row) for row in connection.execute(_records())]


def records(registry: Registry, serial: str | None = None) -> list[Record]:
    """The records of a device, or of all of them, superseded ones too, in the order in which they were performed.

    Raises InputError for a device that has none.

    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> tumble.calibrate(folder).write("calibration.json")
    >>> with tumble.open_registry("registry.sqlite", create=True) as registry:
    ...     _ = tumble.add_calibration(registry, "calibration.json")
    ...     found = tumble.records(registry, "mems-1")
    >>> [record.method for record in found]
    ['joint']
    """
    with registry.reading() as connection:
        if serial is None:
            found = every_record(connection)
        else:
            found = [_record(row) for row in connection.execute(_records("serial"), {"serial": serial})]
        if serial is not None and not found:
            raise InputError(f"device {serial!r}: expected a device of the registry, found none of this serial number")
    return sorted(found, key=lambda r: (r.performed, r.number))


def latest_records(registry: Registry) -> list[tuple[Record, int]]:
    """Of every device the record in force that was performed last, and how many are in force."""
    C = CALIBRATION.c
    in_force = C.number.not_in(select(C.supersedes).where(C.supersedes.is_not(None)))
    last = select(C.serial, func.max(C.performed).label("performed"), func.count().label("count"))
    devices = last.where(in_force).group_by(C.serial).subquery()
    query = (
        select(devices.c.count, *C)
        .join(devices, (C.serial == devices.c.serial) & (C.performed == devices.c.performed))
        .where(in_force)
        .order_by(C.serial, C.number)
    )
    names = [column.name for column in C]
    with registry.reading() as connection:
        found = [(dict(zip(names, row, strict=True)), count) for count, *row in connection.execute(query)]
    latest = {values["serial"]: (values, count) for values, count in found}  # of one moment the one added last
    return [(Record(**values, superseded_by=None), count) for values, count in latest.values()]


def latest_record(registry: Registry, serial: str) -> Record:
    """The record of a device in force that was performed last. Raises InputError for an unknown device."""
    found = [record for record in records(registry, serial) if record.superseded_by is None]
    if not found:
        raise InputError(f"device {serial!r}: expected a record in force, found none; its records are superseded")
    return found[-1]


def record(registry: Registry, number: int) -> Record:
    """The record of a number. Raises InputError where there is none."""
    with registry.reading() as connection:
        return _one(connection, number)


def file_of(registry: Registry, number: int) -> str:
    """The text of the calibration file of a record."""
    with registry.reading() as connection:
        _one(connection, number)
        return file_within(connection, number)


def file_within(connection: Connection, number: int) -> str:
    """The text of the calibration file of a record, in a transaction of the caller's."""
    return str(connection.execute(select(CONTENT.c.file).where(CONTENT.c.calibration == number)).scalar_one())


def parameters_of(registry: Registry, numbers: Iterable[int]) -> Mapping[int, list[ParameterRow]]:
    """Parameters of records with those of their launches, in the order of the files."""
    from tumble.calibration.calibration_file import calibration_of

    return {
        number: list(all_parameter_rows(calibration_of(file_of(registry, number), f"record {number}")))
        for number in numbers
    }


def launches_of(connection: Connection, number: int) -> list[LaunchRow]:
    """The launches behind a record."""
    rows = connection.execute(select(LAUNCH).where(LAUNCH.c.calibration == number).order_by(LAUNCH.c.number))
    return [LaunchRow(session=row.session, log_sha256=row.log_sha256) for row in rows]


# -------------------- limits of device types --------------------


def set_limits(registry: Registry, model: str, file: str, systematic: str | None) -> tuple[LimitsRecord, bool]:
    """Put limits in force for a device type, from now on; and whether they are other ones than before."""
    with registry.writing() as connection:
        added, before = datetime.now(UTC), _latest_limits(connection, model)
        if before is not None:
            if (before.file, before.systematic) == (file, systematic):
                return before, False
            added = max(added, before.added + timedelta(microseconds=1))  # those may come from a clock that is ahead
        return limits_within(connection, add_limits_within(connection, model, file, systematic, added)), True


def add_limits_within(connection: Connection, model: str, file: str, systematic: str | None, added: datetime) -> int:
    """The number of new limits, or of those of the same content and time."""
    parts = (model, added.isoformat(), file, systematic or "")
    digest = hashlib.sha256("\0".join(parts).encode()).hexdigest()
    known = connection.execute(select(LIMITS.c.number).where(LIMITS.c.sha256 == digest)).scalar()
    if known is not None:
        return int(known)
    values = {"sha256": digest, "model": model, "file": file, "systematic": systematic, "added": added}
    return int(connection.execute(insert(LIMITS).returning(LIMITS.c.number), values).scalar_one())


def _latest_limits(connection: Connection, model: str) -> LimitsRecord | None:
    """The limits in force for a type: those that were given last, wherever. An import numbers older limits after newer
    ones."""
    latest = select(LIMITS).where(LIMITS.c.model == model).order_by(*(c.desc() for c in _LIMITS_ORDER)).limit(1)
    row = connection.execute(latest).first()
    return None if row is None else LimitsRecord(**row._asdict())


def limits_within(connection: Connection, number: int) -> LimitsRecord:
    """The limits of a number, in a transaction of the caller's."""
    row = connection.execute(select(LIMITS).where(LIMITS.c.number == number)).one()
    return LimitsRecord(**row._asdict())


def every_limits(connection: Connection) -> list[LimitsRecord]:
    """All limits of all types, former ones too, in the order in which they came in force."""
    return [LimitsRecord(**row._asdict()) for row in connection.execute(select(LIMITS).order_by(*_LIMITS_ORDER))]


def limits_records(registry: Registry) -> list[LimitsRecord]:
    """`every_limits` in a transaction of its own."""
    with registry.reading() as connection:
        return every_limits(connection)


def limits_in_force(registry: Registry) -> Mapping[str, LimitsRecord]:
    """The limits that are in force, by device type."""
    return {found.model: found for found in limits_records(registry)}
