"""What is in a registry: adding calibrations and limits, listing devices and records, showing one.

Every function is one transaction. Numbers of records are those of the registry and never used again; a correction does
not take the number of what it corrects.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sqlalchemy import Row, Select, insert, select

from tumble.errors import InputError
from tumble.files import FilePath
from tumble.registry.connect import Registry
from tumble.registry.records import LaunchRow, ParameterRow, Particulars, Record, Submission, read_submission
from tumble.registry.schema import CALIBRATION, LAUNCH, LIMITS, PARAMETER

if TYPE_CHECKING:
    from sqlalchemy import Connection


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
        return add_within(connection, submission, datetime.now(UTC), lambda model: _number_of_limits(connection, model))


def add_calibration(registry: Registry, file: FilePath, particulars: Particulars = NOTHING_SAID) -> Added:
    """Add the calibration of a file, unless it is there already, with what the file does not say of it. Raises as
    `read_submission` and `add`.

    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> tumble.calibrate(folder).write("calibration.json")
    >>> with tumble.open_registry("registry.sqlite", create=True) as registry:
    ...     added = tumble.add_calibration(registry, "calibration.json")
    >>> added.record.serial, added.new
    ('mems-1', True)
    """
    return add(registry, read_submission(Path(file), particulars))


def add_within(
    connection: Connection, submission: Submission, added: datetime, limits_of: Callable[[str], int | None]
) -> Added:
    """`add` in a transaction of the caller's; `limits_of` gives the limits that were in force for a type."""
    known = connection.execute(_records().where(CALIBRATION.c.sha256 == submission.sha256)).first()
    if known is not None:
        return Added(record=_record(known), new=False)
    corrected = _corrected(connection, submission)
    standing = [record for record in _standing(connection, submission.serial) if record != corrected]
    model = _model(submission, standing)
    _check_logs(connection, submission)
    particulars = submission.particulars
    first = not standing if corrected is None else corrected.occasion == "incoming"
    values = {
        "sha256": submission.sha256,
        "serial": submission.serial,
        "model": model,
        "method": submission.method,
        "frame": submission.frame,
        "performed": submission.performed,
        "occasion": particulars.occasion or ("incoming" if first else "periodic"),
        "state": particulars.state,
        "limits": None if model is None else limits_of(model),
        "supersedes": particulars.supersedes,
        "reason": particulars.reason,
        "added": added,
        "file": submission.file,
    }
    number = connection.execute(insert(CALIBRATION).returning(CALIBRATION.c.number), values).scalar_one()
    _insert_parts(connection, number, submission.launches, submission.parameters)
    return Added(record=_record(connection.execute(_records().where(CALIBRATION.c.number == number)).one()), new=True)


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
    query = _records().join(LAUNCH, LAUNCH.c.calibration == CALIBRATION.c.number).where(LAUNCH.c.log_sha256.in_(logs))
    for row in connection.execute(query):
        record = _record(row)
        if record.superseded_by is None and record.number != submission.particulars.supersedes:
            raise InputError(
                f"{submission.name}: expected a log that is not in the registry, found that of record {record.number} "
                f"({record.serial}, {record.method}); to correct that record give --supersedes {record.number}"
            )


def _insert_parts(
    connection: Connection, number: int, launches: Iterable[LaunchRow], parameters: Iterable[ParameterRow]
) -> None:
    rows = [
        {"calibration": number, "number": i, "session": launch.session, "log_sha256": launch.log_sha256}
        for i, launch in enumerate(launches, 1)
    ]
    connection.execute(insert(LAUNCH), rows)
    values: list[dict[str, Any]] = []
    for p in parameters:
        own = {"launch": p.launch, "name": p.name, "value": p.value, "u": p.u, "unit": p.unit}
        values.append({"calibration": number, "place": len(values), **own})
    connection.execute(insert(PARAMETER), values)


# -------------------- reading back --------------------


def _records() -> Select[Any]:
    later = CALIBRATION.alias("later")
    kept = [column for column in CALIBRATION.c if column.name != "file"]
    return (
        select(*kept, later.c.number.label("superseded_by"))
        .select_from(CALIBRATION.outerjoin(later, later.c.supersedes == CALIBRATION.c.number))
        .order_by(CALIBRATION.c.number)
    )


def _record(row: Row[Any]) -> Record:
    return Record(**row._asdict())


def _one(connection: Connection, number: int) -> Record:
    row = connection.execute(_records().where(CALIBRATION.c.number == number)).first()
    if row is None:
        raise InputError(f"record {number}: expected a record of the registry, found none of this number")
    return _record(row)


def _standing(connection: Connection, serial: str) -> list[Record]:
    rows = connection.execute(_records().where(CALIBRATION.c.serial == serial))
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
        found = [r for r in every_record(connection) if serial in (None, r.serial)]
        if serial is not None and not found:
            raise InputError(f"device {serial!r}: expected a device of the registry, found none of this serial number")
    return sorted(found, key=lambda r: (r.performed, r.number))


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
        return str(connection.execute(select(CALIBRATION.c.file).where(CALIBRATION.c.number == number)).scalar_one())


def parameters_of(registry: Registry, numbers: Iterable[int]) -> Mapping[int, list[ParameterRow]]:
    """Parameters of records with those of their launches, in the order of the files."""
    found: dict[int, list[ParameterRow]] = {number: [] for number in numbers}
    query = select(PARAMETER).where(PARAMETER.c.calibration.in_(found)).order_by(*PARAMETER.primary_key.columns)
    with registry.reading() as connection:
        for row in connection.execute(query):
            found[row.calibration].append(
                ParameterRow(launch=row.launch, name=row.name, value=row.value, u=row.u, unit=row.unit)
            )
    return found


def launches_of(connection: Connection, number: int) -> list[LaunchRow]:
    """The launches behind a record."""
    rows = connection.execute(select(LAUNCH).where(LAUNCH.c.calibration == number).order_by(LAUNCH.c.number))
    return [LaunchRow(session=row.session, log_sha256=row.log_sha256) for row in rows]


# -------------------- limits of device types --------------------


def set_limits(registry: Registry, model: str, file: str, systematic: str | None) -> tuple[LimitsRecord, bool]:
    """Put limits in force for a device type, from now on; and whether they are other ones than before."""
    with registry.writing() as connection:
        added = datetime.now(UTC)
        number = _number_of_limits(connection, model)
        if number is not None:
            before = _limits(connection, number)
            if (before.file, before.systematic) == (file, systematic):
                return before, False
            added = max(added, before.added + timedelta(microseconds=1))  # those may come from a clock that is ahead
        return _limits(connection, add_limits_within(connection, model, file, systematic, added)), True


def add_limits_within(connection: Connection, model: str, file: str, systematic: str | None, added: datetime) -> int:
    """The number of new limits, or of those of the same content and time."""
    parts = (model, added.isoformat(), file, systematic or "")
    digest = hashlib.sha256("\0".join(parts).encode()).hexdigest()
    known = connection.execute(select(LIMITS.c.number).where(LIMITS.c.sha256 == digest)).scalar()
    if known is not None:
        return int(known)
    values = {"sha256": digest, "model": model, "file": file, "systematic": systematic, "added": added}
    return int(connection.execute(insert(LIMITS).returning(LIMITS.c.number), values).scalar_one())


def _number_of_limits(connection: Connection, model: str) -> int | None:
    """The number of the limits in force for a type: those that were given last, wherever. An import numbers older
    limits after newer ones."""
    latest = select(LIMITS.c.number).where(LIMITS.c.model == model).order_by(*(c.desc() for c in _LIMITS_ORDER))
    return connection.execute(latest.limit(1)).scalar()


def _limits(connection: Connection, number: int) -> LimitsRecord:
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
