"""Export and import as JSON lines.

The first line says how many records follow; then come all limits and all calibrations, superseded ones too, each on a
line, in the order in which they were added. Records refer to each other by the SHA-256 of their content, since numbers
belong to one registry. Importing adds what is not there yet.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import islice
from pathlib import Path
from typing import Any

from tumble.documents import check_regular, json_of, shown
from tumble.errors import InputError
from tumble.files import FilePath
from tumble.lab.limits import OCCASIONS, parse_limits
from tumble.lab.registry.adding import Particulars, Submission, add_within, is_past, submission, utc
from tumble.lab.registry.due import keep_forecasts
from tumble.lab.registry.store import rows
from tumble.lab.registry.store.connect import Registry
from tumble.lab.registry.types import STATES, LimitsRecord

FORMAT = 1
KIND = "tumble registry"
BATCH = 200
"""Records of an import in a transaction: other writers wait for less than a second."""

_KEYS = {
    "limits": ("sha256", "model", "added", "file", "systematic"),
    "calibration": ("performed", "occasion", "state", "limits", "supersedes", "reason", "added", "file"),
}
"""Of a line of each kind, all of them texts; an export has `sha256` of calibrations too, for who reads it."""
_MAY_BE_NULL = ("systematic", "limits", "supersedes", "reason")


@dataclass(frozen=True, kw_only=True, slots=True)
class Imported:
    """How many calibrations were added, and how many were there already."""

    added: int
    known: int


def export_lines(registry: Registry) -> Iterator[str]:
    """The lines of an export, of one state of the registry."""

    def line(**content: Any) -> str:
        return json.dumps(content, ensure_ascii=False)

    with registry.reading() as connection:
        limits, records = rows.every_limits(connection), rows.every_record(connection)
        yield line(kind=KIND, format=FORMAT, limits=len(limits), calibrations=len(records))
        for each in limits:
            stated = {key: getattr(each, key) for key in ("file", "systematic")}
            yield line(kind="limits", sha256=each.sha256, model=each.model, added=each.added.isoformat(), **stated)
        limits_sha: dict[int | None, str | None] = {None: None} | {each.number: each.sha256 for each in limits}
        record_sha: dict[int | None, str | None] = {None: None} | {record.number: record.sha256 for record in records}
        for record in records:
            yield line(
                kind="calibration",
                sha256=record.sha256,
                performed=record.performed.isoformat(),
                occasion=record.occasion,
                state=record.state,
                limits=limits_sha[record.limits],
                supersedes=record_sha[record.supersedes],
                reason=record.reason,
                added=record.added.isoformat(),
                file=rows.file_of(connection, record.number),
            )


@dataclass(frozen=True, kw_only=True, slots=True)
class _Exported:
    """A calibration of an export, checked, with the SHA-256 of its limits and of the record that it corrects."""

    submission: Submission
    added: datetime
    limits: str | None
    supersedes: str | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Export:
    """An export that was looked at as a whole; `corrected`: records that it corrects and does not hold, and where."""

    path: Path
    corrected: Mapping[str, str]


def read_export(file: FilePath) -> Export:
    """An export, every line of which is looked at. Raises InputError, one line, where the file is no whole one."""
    path, known, corrected = Path(file), set[str](), dict[str, str]()
    for where, each in _entries(path):
        if isinstance(each, _Exported):
            if each.supersedes is not None and each.supersedes not in known:
                corrected.setdefault(each.supersedes, where)
            known.add(each.submission.sha256)
    return Export(path=path, corrected=corrected)


def import_file(registry: Registry, file: FilePath) -> Imported:
    """Add what an export holds and the registry does not. Every line is looked at before anything is added, without
    keeping other writers out; then records are added BATCH at a time.

    Raises InputError, one line, and adds nothing, where the file is no whole export; where what a record says is at
    odds with the registry, those before it have been added, and another import goes on from there."""
    return import_export(registry, read_export(file))


def import_export(registry: Registry, export: Export) -> Imported:
    """`import_file` of an export that was read."""
    if export.corrected:
        with registry.reading() as connection:
            known = rows.hashes(connection)
        for sha256, where in export.corrected.items():
            if sha256 not in known:
                raise _not_there("supersedes", sha256, where)
    entries, limits = _entries(export.path), dict[str, LimitsRecord]()
    seen = added = 0
    while batch := list(islice(entries, BATCH)):
        with registry.writing() as connection:
            for _, each in batch:
                if isinstance(each, LimitsRecord):
                    limits[each.sha256] = rows.add_limits(
                        connection, each.model, each.file, each.systematic, each.added
                    )
                    continue
                given, judged_by = each.submission, None if each.limits is None else limits[each.limits]
                if each.supersedes is not None:
                    corrected = rows.number_of(connection, each.supersedes)
                    given = replace(given, particulars=replace(given.particulars, supersedes=corrected))
                added += add_within(connection, given, each.added, lambda _, limits=judged_by: limits)[1]  # type: ignore[misc]
                seen += 1
    keep_forecasts(registry)
    return Imported(added=added, known=seen - added)


def _entries(path: Path) -> Iterator[tuple[str, LimitsRecord | _Exported]]:
    """What is in every line of an export, checked, and where it stands."""
    try:
        check_regular(path)
        with path.open(encoding="utf-8") as opened:
            header = _parsed(next(opened, ""), f"{path}: line 1")
            if header.get("kind") != KIND or header.get("format") != FORMAT:
                raise InputError(
                    f"{path}: line 1: expected an export of a tumble registry of format {FORMAT}, found another file"
                )
            limits, counts = set[str](), dict.fromkeys(_KEYS, 0)
            for number, line in enumerate(opened, 2):
                where = f"{path}: line {number}"
                entry = _checked(_parsed(line, where), where, limits)
                kind = "limits" if isinstance(entry, LimitsRecord) else "calibration"
                counts[kind] += 1
                yield where, entry
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected UTF-8 text, found {error.reason}") from error
    stated = {"limits": header.get("limits", 0), "calibration": header.get("calibrations", 0)}
    if counts != stated:
        said, found = (f"{each['limits']} limits and {each['calibration']} calibrations" for each in (stated, counts))
        raise InputError(
            f"{path}: expected the numbers of records that line 1 says, {said}, found {found}; export it again"
        )


def _checked(content: dict[str, Any], where: str, limits: set[str]) -> LimitsRecord | _Exported:
    """What is in a line; `limits` are those of the lines before it (SHA-256), to which its own are added."""
    kind = content.get("kind")
    if kind not in tuple(_KEYS):
        raise InputError(f"{where}: kind: expected limits or calibration, found {shown(kind)}")
    for key in _KEYS[kind]:
        if key not in content:
            raise InputError(f"{where}: expected a line of an export, found one without {key!r}")
        if not isinstance(content[key], str) and not (key in _MAY_BE_NULL and content[key] is None):
            raise InputError(f"{where}: {key}: expected a text, found {shown(content[key])}")
    added = utc(content["added"], f"{where}: added")
    if not is_past(added):
        raise InputError(f"{where}: added: expected a date that is past, found {content['added']!r}")
    if kind == "limits":
        parse_limits(content["file"], content["systematic"], where)
        limits.add(content["sha256"])
        given = {key: content[key] for key in ("sha256", "model", "file", "systematic")}
        return LimitsRecord(number=0, **given, added=added)
    for key, allowed in (("occasion", OCCASIONS), ("state", STATES)):
        if content[key] not in tuple(allowed):
            raise InputError(f"{where}: {key}: expected one of {', '.join(allowed)}, found {shown(content[key])}")
    stated = {key: content[key] for key in ("occasion", "state", "reason")}
    particulars = Particulars(performed=utc(content["performed"], f"{where}: performed"), **stated)
    calibration = submission(content["file"], where, particulars)
    refers = {key: content[key] for key in ("limits", "supersedes")}
    if refers["limits"] is not None and refers["limits"] not in limits:
        raise _not_there("limits", refers["limits"], where)
    return _Exported(submission=calibration, added=added, **refers)


def _not_there(key: str, sha256: str, where: str) -> InputError:
    return InputError(f"{where}: expected a line of an export, found one without the {key} {sha256[:12]}… it names")


def _parsed(line: str, where: str) -> dict[str, Any]:
    """The object of a line, without half a character in its texts, which no database keeps."""
    try:
        content = json_of(line)
    except ValueError as error:
        raise InputError(f"{where}: expected a line of JSON, found an error in its syntax: {error}") from None
    texts = [value for value in content.values() if isinstance(value, str)] if isinstance(content, dict) else [None]
    if not all(text is not None and text == text.encode(errors="ignore").decode() for text in texts):
        raise InputError(f"{where}: expected a JSON object, found something else")
    return dict(content)
