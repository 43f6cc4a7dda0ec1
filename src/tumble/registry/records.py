"""A calibration file as something to add, and records as they are read back.

A file is known by its content: the SHA-256 of its JSON with sorted keys and without blanks. The same calibration is the
same record however its file is laid out or called.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Literal, get_args

from tumble.acceptance.schedule import Occasion
from tumble.errors import InputError
from tumble.files import FilePath

if TYPE_CHECKING:
    from tumble.calibration.calibration_file import Calibration
    from tumble.calibration.results import Parameter

State = Literal["as-found", "as-left", "unchanged"]
STATES: tuple[State, ...] = get_args(State)
"""Before an adjustment, after it, or without one: then the device leaves as it was found."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ParameterRow:
    """A parameter of the result (`launch` 0) or of a launch (from 1): value and standard uncertainty, SI, and the
    degrees of freedom of the latter; None where it is known."""

    launch: int
    name: str
    value: float
    u: float | None
    unit: str
    dof: float | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class LaunchRow:
    """A power-on behind a calibration, and the hash of its log."""

    session: str | None
    log_sha256: str


@dataclass(frozen=True, kw_only=True, slots=True)
class Particulars:
    """What a calibration file does not say: when the device was calibrated (default: when it
    was recorded, or else when the file was made), at what
    check (default: `incoming` for the first record of a device, then `periodic`), in what state, and which record this
    one corrects, and why."""

    performed: datetime | None = None
    occasion: Occasion | None = None
    state: State = "unchanged"
    supersedes: int | None = None
    reason: str | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Submission:
    """A calibration to add. `name` is what messages call it, `file` the whole text of its file, and `calibration` what
    is in it."""

    name: str
    sha256: str
    serial: str
    model: str | None
    method: str
    frame: str
    performed: datetime
    particulars: Particulars
    launches: tuple[LaunchRow, ...]
    file: str
    calibration: Calibration


@dataclass(frozen=True, kw_only=True, slots=True)
class Record:
    """A calibration in the registry. `limits` is the number of the acceptance limits that were in force, `verdict` what
    they said of it, in a word; None without any."""

    number: int
    sha256: str
    serial: str
    model: str | None
    method: str
    frame: str
    performed: datetime
    occasion: Occasion
    state: State
    limits: int | None
    verdict: str | None
    supersedes: int | None
    superseded_by: int | None
    reason: str | None
    added: datetime


def read_submission(given: Calibration | FilePath, particulars: Particulars) -> Submission:
    """A calibration, or that of a file, to be added.

    Raises InputError, one line: no calibration file, one that was not accepted, a name that cannot be printed, a number
    that is not finite, a date that is missing or in the future."""
    from tumble.calibration.calibration_file import text_and_name

    return submission(*text_and_name(given), particulars)


def submission(text: str, name: str, particulars: Particulars) -> Submission:
    """The calibration of the text of a file, to be added, as `read_submission`; where the accelerometers or the gyros
    alone are accepted, the parameters of these."""
    from tumble.calibration.calibration_file import calibration_of
    from tumble.calibration.half import accepted_part

    calibration = accepted_part(calibration_of(text, name), name)
    if not calibration.parameters:
        raise InputError(f"{name}: parameters: expected at least one, found none")
    _check_names(calibration, name)
    return Submission(
        name=name,
        sha256=content_sha256(text),
        serial=calibration.serial,
        model=calibration.model,
        method=calibration.method,
        frame=calibration.frame,
        performed=_performed(calibration, particulars, name),
        particulars=particulars,
        launches=_launch_rows(calibration),
        file=text,
        calibration=calibration,
    )


def content_sha256(text: str) -> str:
    """SHA-256 of the content of a JSON text (module docstring)."""
    canonical = json.dumps(json.loads(text), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()


def utc(text: str, where: str) -> datetime:
    """A date or a time of day from ISO 8601; without an offset it is UTC."""
    try:
        found = datetime.fromisoformat(text)
        return found.replace(tzinfo=UTC) if found.tzinfo is None else found.astimezone(UTC)
    except (ValueError, OverflowError):
        raise InputError(f"{where}: expected a date such as 2026-03-31, found {text!r}") from None


def past(text: str, where: str) -> datetime:
    """`utc` of what has happened; a day is left to time zones."""
    moment = utc(text, where)
    if moment > datetime.now(UTC) + timedelta(days=1):
        raise InputError(f"{where}: expected a date that is past, found {text!r}")
    return moment


def all_parameter_rows(calibration: Calibration) -> Iterable[ParameterRow]:
    """Parameters of a calibration and of its launches."""
    yield from parameter_rows(calibration.parameters)
    for number, launch in enumerate(calibration.launches, 1):
        yield from (replace(row, launch=number) for row in parameter_rows(launch.parameters))


def parameter_rows(parameters: Iterable[Parameter]) -> Iterable[ParameterRow]:
    """Parameters of a result."""
    for p in parameters:
        yield ParameterRow(launch=0, name=p.name, value=p.value, u=p.u, unit=p.unit, dof=p.dof)


def _launch_rows(calibration: Calibration) -> tuple[LaunchRow, ...]:
    if calibration.launches:
        return tuple(LaunchRow(session=x.session, log_sha256=x.log_sha256) for x in calibration.launches)
    return (LaunchRow(session=None, log_sha256=calibration.provenance.get("log_sha256", "")),)


def _performed(calibration: Calibration, particulars: Particulars, name: str) -> datetime:
    performed = particulars.performed
    if performed is None:
        if calibration.circumstances.date is not None:
            return utc(calibration.circumstances.date, f"{name}: session.date")
        if "created" not in calibration.provenance:
            raise InputError(f"{name}: provenance.created: expected a time, found none; give --date")
        performed = utc(calibration.provenance["created"], f"{name}: provenance.created")
    if performed > datetime.now(UTC) + timedelta(days=1):
        raise InputError(f"{name}: expected a date that is past, found {performed:%Y-%m-%d}; give --date")
    return performed


def _check_names(calibration: Calibration, name: str) -> None:
    """That names of sessions can be printed and kept by every database, as the others of a calibration file can."""
    from tumble.recording.session_keys.device import LONGEST_NAME

    for value in (launch.session or "-" for launch in calibration.launches):
        if not value.strip() or not value.isprintable() or len(value) > LONGEST_NAME:
            raise InputError(
                f"{name}: launches: expected 1 to {LONGEST_NAME} printable characters, found {value[:40]!r}"
            )
