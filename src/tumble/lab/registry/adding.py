"""Adding calibrations, and limits of device types, to a registry.

A calibration file is known by its content: the SHA-256 of its JSON with sorted keys and without blanks. The same
calibration is the same record however its file is laid out or called.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

from tumble.errors import InputError
from tumble.files import FilePath
from tumble.lab.conformity import verdict_at
from tumble.lab.limits import Occasion, parse_limits
from tumble.lab.registry.due import keep_forecasts
from tumble.lab.registry.store import rows
from tumble.lab.registry.store.connect import Registry
from tumble.lab.registry.types import LimitsRecord, Record, State
from tumble.recording.session.table import LONGEST_NAME
from tumble.result.accepted import accepted_part
from tumble.result.calibration import Calibration, calibration_of, text_and_name

if TYPE_CHECKING:
    from sqlalchemy import Connection


@dataclass(frozen=True, kw_only=True, slots=True)
class Particulars:
    """What a calibration file does not say: when the device was calibrated (default: when it was recorded, or else when
    the file was made), at what check (default: `incoming` for the first record of a device, then `periodic`), in what
    state, and which record this one corrects, and why."""

    performed: datetime | None = None
    occasion: Occasion | None = None
    state: State = "unchanged"
    supersedes: int | None = None
    reason: str | None = None


NOTHING_SAID = Particulars()


@dataclass(frozen=True, kw_only=True, slots=True)
class Submission:
    """A calibration to add. `name` is what messages call it, `file` the whole text of its file, and `calibration` what
    is in it."""

    name: str
    sha256: str
    performed: datetime
    particulars: Particulars
    file: str
    calibration: Calibration


def read_submission(given: Calibration | FilePath, particulars: Particulars = NOTHING_SAID) -> Submission:
    """A calibration, or that of a file, to be added.

    Raises InputError, one line: no calibration file, one that was not accepted, a name that cannot be printed, a number
    that is not finite, a date that is missing or in the future."""
    return submission(*text_and_name(given), particulars)


def submission(text: str, name: str, particulars: Particulars) -> Submission:
    """The calibration of the text of a file, to be added, as `read_submission`; where the accelerometers or the gyros
    alone are accepted, the parameters of these."""
    calibration = accepted_part(calibration_of(text, name), name)
    if not calibration.parameters:
        raise InputError(f"{name}: parameters: expected at least one, found none")
    for launch in calibration.launches:
        session = launch.session or "-"
        if not session.strip() or not session.isprintable() or len(session) > LONGEST_NAME:
            raise InputError(
                f"{name}: launches: expected 1 to {LONGEST_NAME} printable characters, found {session[:40]!r}"
            )
    performed = particulars.performed
    if performed is None and calibration.circumstances.date is not None:
        performed = utc(calibration.circumstances.date, f"{name}: session.date")
    elif performed is None:
        if "created" not in calibration.provenance:
            raise InputError(f"{name}: provenance.created: expected a time, found none; give --date")
        performed = utc(calibration.provenance["created"], f"{name}: provenance.created")
    if not is_past(performed):
        raise InputError(f"{name}: expected a date that is past, found {performed:%Y-%m-%d}; give --date")
    return Submission(
        name=name,
        sha256=content_sha256(text),
        performed=performed,
        particulars=particulars,
        file=text,
        calibration=calibration,
    )


def content_sha256(text: str) -> str:
    """SHA-256 of the content of a JSON text (module docstring)."""
    canonical = json.dumps(json.loads(text), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()


def logs_of(calibration: Calibration) -> list[tuple[str | None, str]]:
    """The sessions behind a calibration, by name where there are several, with the SHA-256 of their logs."""
    one = (None, calibration.provenance.get("log_sha256", ""))
    return [(launch.session, launch.log_sha256) for launch in calibration.launches] or [one]


def utc(text: str, where: str) -> datetime:
    """A date or a time of day from ISO 8601; without an offset it is UTC."""
    try:
        moment = datetime.fromisoformat(text)
        return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    except (ValueError, OverflowError):
        raise InputError(f"{where}: expected a date such as 2026-03-31, found {text!r}") from None


def is_past(moment: datetime) -> bool:
    """Whether it has happened; a day is left to time zones."""
    return moment <= datetime.now(UTC) + timedelta(days=1)


@dataclass(frozen=True, kw_only=True, slots=True)
class Added:
    """A record, and whether it is new: a calibration that was there already is not added again."""

    record: Record
    new: bool


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


def add(registry: Registry, submission: Submission) -> Added:
    """Add a calibration, unless it is there already.

    Raises InputError, one line: another type for a known serial, a log that another record stands on, a correction
    without a reason or of something that is no longer in force."""
    with registry.writing() as connection:
        number, new = add_within(connection, submission, datetime.now(UTC), rows.limits_in_force(connection).get)
        record = rows.record_of(connection, number)
        corrected = None if record.supersedes is None else rows.record_of(connection, record.supersedes)
    if new:
        keep_forecasts(registry, {record.serial, record.serial if corrected is None else corrected.serial})
    return Added(record=record, new=new)


def add_within(
    connection: Connection, submission: Submission, added: datetime, limits_of: Callable[[str], LimitsRecord | None]
) -> tuple[int, bool]:
    """`add` in a transaction of the caller's: the number of the record, and whether it is new; `limits_of` gives the
    limits that were in force for a type."""
    known = rows.number_of(connection, submission.sha256)
    if known is not None:
        return known, False
    calibration, particulars, name = submission.calibration, submission.particulars, submission.name
    supersedes, corrected = particulars.supersedes, None
    if (supersedes is None) != (particulars.reason is None):
        raise InputError(f"{name}: expected --supersedes NUMBER with --reason TEXT, found one of them")
    if supersedes is not None:
        corrected = rows.record_of(connection, supersedes)
        if corrected.superseded_by is not None:
            raise InputError(
                f"record {supersedes}: expected one that is in force, found one superseded by "
                f"{corrected.superseded_by}; supersede that one"
            )
    of_device = rows.records_of_device(connection, calibration.serial)
    standing = [record for record in of_device if record.superseded_by is None and record != corrected]
    for record in standing:
        if calibration.model is not None and record.model not in (None, calibration.model):
            raise InputError(
                f"{name}: device.model: expected {record.model!r}, as device {calibration.serial} has it in record "
                f"{record.number}, found {calibration.model!r}; serial numbers must be unique"
            )
    logs = {log for _, log in logs_of(calibration)} - {""}
    for record in rows.records_with_logs(connection, logs):
        if record.superseded_by is None and record.number != supersedes:
            raise InputError(
                f"{name}: expected a log that is not in the registry, found that of record {record.number} "
                f"({record.serial}, {record.method}); to correct that record give --supersedes {record.number}"
            )
    model = calibration.model or next((r.model for r in standing if r.model is not None), None)  # that is known
    first = not standing if corrected is None else corrected.occasion == "incoming"
    occasion = particulars.occasion or ("incoming" if first else "periodic")
    limits = None if model is None else limits_of(model)
    verdict: str | None = None
    if limits is not None:  # in a word; none where they have none for such a check
        parsed = parse_limits(limits.file, limits.systematic, limits.name)
        try:
            judged = verdict_at(calibration, parsed, occasion)
            verdict = None if judged is None else judged.result
        except InputError:
            verdict = "other frame"
    values = {
        "sha256": submission.sha256,
        "serial": calibration.serial,
        "model": model,
        "method": calibration.method,
        "frame": calibration.frame,
        "performed": submission.performed,
        "occasion": occasion,
        "state": particulars.state,
        "limits": None if limits is None else limits.number,
        "verdict": verdict,
        "supersedes": supersedes,
        "reason": particulars.reason,
        "added": added,
    }
    return rows.add_record(connection, values, submission.file, logs), True


def set_limits(registry: Registry, model: str, file: str, systematic: str | None) -> tuple[LimitsRecord, bool]:
    """Put limits in force for a device type, from now on; and whether they are other ones than before."""
    with registry.writing() as connection:
        added, before = datetime.now(UTC), rows.limits_in_force(connection).get(model)
        if before is not None:
            if (before.file, before.systematic) == (file, systematic):
                return before, False
            added = max(added, before.added + timedelta(microseconds=1))  # those may come from a clock that is ahead
        limits = rows.add_limits(connection, model, file, systematic, added)
    keep_forecasts(registry)
    return limits, True
