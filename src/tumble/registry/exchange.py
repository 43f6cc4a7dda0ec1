"""Export and import as JSON lines.

The first line says how many records follow; then come all limits and all calibrations, superseded ones too, each on a
line, in the order in which they were added. Records refer to each other by the SHA-256 of their content, since numbers
belong to one registry. Importing adds what is not there yet.
"""

from __future__ import annotations

import json
import pickle
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import islice
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any, cast

from sqlalchemy import select

from tumble.acceptance.limits import parse_limits
from tumble.acceptance.schedule import OCCASIONS
from tumble.documents import check_regular, json_of, shown
from tumble.errors import InputError
from tumble.files import FilePath
from tumble.registry.connect import Registry
from tumble.registry.records import STATES, Particulars, Submission, past, submission, utc
from tumble.registry.schema import CALIBRATION
from tumble.registry.store import (
    LimitsRecord,
    add_limits_within,
    add_within,
    every_limits,
    every_record,
    file_within,
    limits_within,
    number_of,
)

FORMAT = 1
KIND = "tumble registry"
BATCH = 200
"""Records of an import in a transaction: other writers wait for less than a second."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Imported:
    """How many calibrations were added, and how many were there already."""

    added: int
    known: int


def export_lines(registry: Registry) -> Iterator[str]:
    """The lines of an export, of one state of the registry."""
    with registry.reading() as connection:
        limits, records = every_limits(connection), every_record(connection)
        yield _line({"kind": KIND, "format": FORMAT, "limits": len(limits), "calibrations": len(records)})
        for own in limits:
            content: dict[str, Any] = {"sha256": own.sha256, "model": own.model, "added": own.added.isoformat()}
            yield _line({"kind": "limits", **content, "file": own.file, "systematic": own.systematic})
        limits_sha = {own.number: own.sha256 for own in limits}
        record_sha = {record.number: record.sha256 for record in records}
        for record in records:
            content = {
                "sha256": record.sha256,
                "performed": record.performed.isoformat(),
                "occasion": record.occasion,
                "state": record.state,
                "limits": None if record.limits is None else limits_sha[record.limits],
                "supersedes": None if record.supersedes is None else record_sha[record.supersedes],
                "reason": record.reason,
                "added": record.added.isoformat(),
                "file": file_within(connection, record.number),
            }
            yield _line({"kind": "calibration", **content})


def _line(content: Mapping[str, Any]) -> str:
    return json.dumps(content, ensure_ascii=False)


@dataclass(frozen=True, kw_only=True, slots=True)
class Export:
    """An export that was looked at as a whole; `corrected`: records that it corrects and does not hold, and where."""

    staged: IO[bytes]
    corrected: Mapping[str, str]


@contextmanager
def read_export(file: FilePath) -> Iterator[Export]:
    """An export, every line of which is looked at. Raises InputError, one line, where the file is no whole one."""
    with TemporaryFile(prefix="tumble-") as staged:
        yield Export(staged=staged, corrected=_staged(Path(file), staged))


def import_file(registry: Registry, file: FilePath) -> Imported:
    """Add what an export holds and the registry does not. Every line is looked at before anything is added, without
    keeping other writers out; then records are added BATCH at a time.

    Raises InputError, one line, and adds nothing, where the file is no whole export; where what a record says is at
    odds with the registry, those before it have been added, and another import goes on from there."""
    with read_export(file) as export:
        return import_export(registry, export)


def import_export(registry: Registry, export: Export) -> Imported:
    """`import_file` of an export that was read."""
    with registry.reading() as connection:
        known = set(connection.execute(select(CALIBRATION.c.sha256)).scalars()) if export.corrected else set()
    for sha256, where in export.corrected.items():
        if sha256 not in known:
            raise _not_there("supersedes", sha256, where)
    export.staged.seek(0)
    return _add_staged(registry, export.staged)


def _staged(path: Path, staged: IO[bytes]) -> dict[str, str]:
    try:
        check_regular(path)
        with path.open(encoding="utf-8") as opened:
            return _stage(opened, str(path), staged)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected UTF-8 text, found {error.reason}") from error


@dataclass(frozen=True, kw_only=True, slots=True)
class _StagedLimits:
    """Limits of an export, checked; `sha256` is how its calibrations refer to them."""

    sha256: str
    model: str
    file: str
    systematic: str | None
    added: datetime


@dataclass(frozen=True, kw_only=True, slots=True)
class _StagedCalibration:
    """A calibration of an export, checked, with the SHA-256 of its limits and of the record that it corrects."""

    submission: Submission
    added: datetime
    limits: str | None
    supersedes: str | None


def _stage(lines: Iterator[str], path: str, staged: IO[bytes]) -> dict[str, str]:
    """Check every line of an export, and keep what is in it. Gives the records that it corrects and does not hold."""
    header = _header(next(lines, ""), f"{path}: line 1")
    known: set[str] = set()
    limits: set[str] = set()
    corrected: dict[str, str] = {}
    counts = {"limits": 0, "calibration": 0}
    for number, line in enumerate(lines, 2):
        where = f"{path}: line {number}"
        content = _parsed(line, where)
        kind = content.get("kind")
        if kind not in tuple(counts):
            raise InputError(f"{where}: kind: expected limits or calibration, found {shown(kind)}")
        _check_texts(content, kind, where)
        counts[kind] += 1
        if kind == "limits":
            limits.add(content["sha256"])
            pickle.dump(_limits(content, where), staged)
            continue
        calibration = _calibration(content, where)
        if calibration.limits is not None and calibration.limits not in limits:
            raise _not_there("limits", calibration.limits, where)
        if calibration.supersedes is not None and calibration.supersedes not in known:
            corrected.setdefault(calibration.supersedes, where)
        known.add(calibration.submission.sha256)
        pickle.dump(calibration, staged)
    if counts != header:
        raise InputError(
            f"{path}: expected the numbers of records that line 1 says, {_counts(header)}, found {_counts(counts)}; "
            "export it again"
        )
    return corrected


def _not_there(key: str, sha256: str, where: str) -> InputError:
    return InputError(f"{where}: expected a line of an export, found one without the {key} {sha256[:12]}… it names")


def _add_staged(registry: Registry, staged: IO[bytes]) -> Imported:
    """Add what was staged, BATCH records in a transaction."""
    limits: dict[str, LimitsRecord] = {}
    seen = added = 0
    while batch := list(islice(_unpickled(staged), BATCH)):
        with registry.writing() as connection:
            for each in batch:
                if isinstance(each, _StagedLimits):
                    number = add_limits_within(connection, each.model, each.file, each.systematic, each.added)
                    limits[each.sha256] = limits_within(connection, number)
                    continue
                submission, own = each.submission, None if each.limits is None else limits[each.limits]
                if each.supersedes is not None:
                    corrected = number_of(connection, each.supersedes)
                    particulars = replace(submission.particulars, supersedes=corrected)
                    submission = replace(submission, particulars=particulars)
                added += add_within(connection, submission, each.added, lambda _, own=own: own)[1]  # type: ignore[misc]
                seen += 1
    return Imported(added=added, known=seen - added)


def _unpickled(staged: IO[bytes]) -> Iterator[_StagedLimits | _StagedCalibration]:
    """What this program wrote into a file of its own."""
    with suppress(EOFError):
        while True:
            yield pickle.load(staged)


def _header(line: str, where: str) -> dict[str, int]:
    content = _parsed(line, where)
    if content.get("kind") != KIND or content.get("format") != FORMAT:
        raise InputError(f"{where}: expected an export of a tumble registry of format {FORMAT}, found another file")
    return {"limits": content.get("limits", 0), "calibration": content.get("calibrations", 0)}


def _limits(content: Mapping[str, Any], where: str) -> _StagedLimits:
    file, systematic = content["file"], content["systematic"]
    parse_limits(file, systematic, where)
    moment = past(content["added"], f"{where}: added")
    return _StagedLimits(
        sha256=content["sha256"], model=content["model"], file=file, systematic=systematic, added=moment
    )


def _calibration(content: Mapping[str, Any], where: str) -> _StagedCalibration:
    for key, allowed in (("occasion", OCCASIONS), ("state", STATES)):
        if content[key] not in cast(tuple[str, ...], allowed):
            raise InputError(f"{where}: {key}: expected one of {', '.join(allowed)}, found {shown(content[key])}")
    particulars = Particulars(
        performed=utc(content["performed"], f"{where}: performed"),
        occasion=content["occasion"],
        state=content["state"],
        reason=content["reason"],
    )
    return _StagedCalibration(
        submission=submission(content["file"], where, particulars),
        added=past(content["added"], f"{where}: added"),
        limits=content["limits"],
        supersedes=content["supersedes"],
    )


def _counts(counts: Mapping[str, int]) -> str:
    return f"{counts['limits']} limits and {counts['calibration']} calibrations"


def _parsed(line: str, where: str) -> dict[str, Any]:
    try:
        content = json_of(line)
    except ValueError as error:
        raise InputError(f"{where}: expected a line of JSON, found an error in its syntax: {error}") from None
    if not isinstance(content, dict) or not all(map(_encodable, content.values())):
        raise InputError(f"{where}: expected a JSON object, found something else")
    return content


_TEXTS = {
    "limits": {"model": False, "file": False, "systematic": True, "added": False, "sha256": False},
    "calibration": {
        "file": False, "performed": False, "occasion": False, "state": False, "added": False,
        "supersedes": True, "reason": True, "limits": True,
    },
}  # fmt: skip
"""Keys of a line of each kind, all of them texts, and whether they may be null."""


def _check_texts(content: Mapping[str, Any], kind: str, where: str) -> None:
    for key, optional in _TEXTS[kind].items():
        if key not in content:
            raise InputError(f"{where}: expected a line of an export, found one without {key!r}")
        if not isinstance(content[key], str) and not (optional and content[key] is None):
            raise InputError(f"{where}: {key}: expected a text, found {shown(content[key])}")


def _encodable(value: Any) -> bool:
    """Whether a value is no text with half a character, which no database keeps."""
    return not isinstance(value, str) or value == value.encode(errors="ignore").decode()
