"""Export and import as JSON lines.

The first line says how many records follow; then come all limits and all calibrations, superseded ones too, each on a
line, in the order in which they were added. Records refer to each other by the SHA-256 of their content, since numbers
belong to one registry. Importing adds what is not there yet: all of it, or nothing.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, cast

from sqlalchemy import select

from tumble.documents import check_regular, json_of, shown
from tumble.errors import InputError
from tumble.files import FilePath
from tumble.registry.connect import Registry, open_registry
from tumble.registry.limits import parse_limits
from tumble.registry.records import OCCASIONS, STATES, Particulars, submission, utc
from tumble.registry.schema import CALIBRATION
from tumble.registry.store import add_limits_within, add_within, every_limits, every_record

if TYPE_CHECKING:
    from sqlalchemy import Connection

FORMAT = 1
KIND = "tumble registry"


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
            file = connection.execute(select(CALIBRATION.c.file).where(CALIBRATION.c.number == record.number))
            content = {
                "sha256": record.sha256,
                "performed": record.performed.isoformat(),
                "occasion": record.occasion,
                "state": record.state,
                "limits": None if record.limits is None else limits_sha[record.limits],
                "supersedes": None if record.supersedes is None else record_sha[record.supersedes],
                "reason": record.reason,
                "added": record.added.isoformat(),
                "file": file.scalar_one(),
            }
            yield _line({"kind": "calibration", **content})


def _line(content: Mapping[str, Any]) -> str:
    return json.dumps(content, ensure_ascii=False)


def import_file(registry: Registry, file: FilePath) -> Imported:
    """Add what an export holds. Raises InputError, one line, and adds nothing, where a line cannot be added."""
    path = Path(file)
    try:
        check_regular(path)
        with path.open(encoding="utf-8") as opened, registry.writing() as connection:
            return _Import(connection, str(path)).run(opened)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected UTF-8 text, found {error.reason}") from error


def check_export(file: FilePath) -> None:
    """Check that an export can be added, without a registry of the user's: so an import that is refused makes none.
    Raises InputError as `import_file`."""
    with (
        TemporaryDirectory(prefix="tumble-") as folder,
        open_registry(Path(folder) / "registry.sqlite", create=True) as registry,
    ):
        import_file(registry, file)


class _Import:
    """An import on its way: the numbers that limits and calibrations have here, by their SHA-256."""

    def __init__(self, connection: Connection, path: str) -> None:
        self.connection, self.path = connection, path
        self.limits: dict[str, int] = {}
        self.records = {record.sha256: record.number for record in every_record(connection)}
        self.counts = {"limits": 0, "calibration": 0}
        self.added = 0

    def run(self, lines: Iterator[str]) -> Imported:
        """Add every line."""
        expected = self._header(next(lines, ""))
        for number, line in enumerate(lines, 2):
            where = f"{self.path}: line {number}"
            content = _parsed(line, where)
            kind = content.get("kind")
            if kind not in tuple(self.counts):
                raise InputError(f"{where}: kind: expected limits or calibration, found {shown(kind)}")
            _check_texts(content, kind, where)
            try:
                (self._limits if kind == "limits" else self._calibration)(content, where)
            except KeyError as error:
                raise InputError(f"{where}: expected a line of an export, found one without {error}") from error
            self.counts[kind] += 1
        if self.counts != expected:
            raise InputError(
                f"{self.path}: expected the numbers of records that line 1 says, {_counts(expected)}, found "
                f"{_counts(self.counts)}; export it again"
            )
        return Imported(added=self.added, known=self.counts["calibration"] - self.added)

    def _header(self, line: str) -> dict[str, int]:
        where = f"{self.path}: line 1"
        content = _parsed(line, where)
        if content.get("kind") != KIND or content.get("format") != FORMAT:
            raise InputError(f"{where}: expected an export of a tumble registry of format {FORMAT}, found another file")
        return {"limits": content.get("limits", 0), "calibration": content.get("calibrations", 0)}

    def _limits(self, content: Mapping[str, Any], where: str) -> None:
        file, systematic = content["file"], content["systematic"]
        parse_limits(file, systematic, where)
        added = utc(content["added"], f"{where}: added")
        number = add_limits_within(self.connection, content["model"], file, systematic, added)
        self.limits[content["sha256"]] = number

    def _calibration(self, content: Mapping[str, Any], where: str) -> None:
        for key, allowed in (("occasion", OCCASIONS), ("state", STATES)):
            if content[key] not in cast(tuple[str, ...], allowed):
                raise InputError(f"{where}: {key}: expected one of {', '.join(allowed)}, found {shown(content[key])}")
        particulars = Particulars(
            performed=utc(content["performed"], f"{where}: performed"),
            occasion=content["occasion"],
            state=content["state"],
            supersedes=None if content["supersedes"] is None else self.records[content["supersedes"]],
            reason=content["reason"],
        )
        limits = None if content["limits"] is None else self.limits[content["limits"]]
        done = add_within(
            self.connection,
            submission(content["file"], where, particulars),
            utc(content["added"], f"{where}: added"),
            lambda _: limits,
        )
        self.records[done.record.sha256] = done.record.number
        self.added += done.new


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
