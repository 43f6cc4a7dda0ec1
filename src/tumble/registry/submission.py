"""A calibration file as something to add.

A file is known by its content: the SHA-256 of its JSON with sorted keys and without blanks. The same calibration is the
same record however its file is laid out or called.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from tumble.acceptance.schedule import Occasion
from tumble.calibration.calibration_file import Calibration, calibration_of, text_and_name
from tumble.calibration.half import accepted_part
from tumble.errors import InputError
from tumble.files import FilePath
from tumble.recording.session.table import LONGEST_NAME
from tumble.registry.types import State


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
    return Submission(
        name=name,
        sha256=content_sha256(text),
        performed=_performed(calibration, particulars, name),
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


def _performed(calibration: Calibration, particulars: Particulars, name: str) -> datetime:
    performed = particulars.performed
    if performed is None:
        if calibration.circumstances.date is not None:
            return utc(calibration.circumstances.date, f"{name}: session.date")
        if "created" not in calibration.provenance:
            raise InputError(f"{name}: provenance.created: expected a time, found none; give --date")
        performed = utc(calibration.provenance["created"], f"{name}: provenance.created")
    if not is_past(performed):
        raise InputError(f"{name}: expected a date that is past, found {performed:%Y-%m-%d}; give --date")
    return performed
