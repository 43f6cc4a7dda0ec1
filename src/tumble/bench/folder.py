"""The session folder of the bench: made for a source that says what it sends, copied for the next unit, and what the
operator leaves out written into it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tumble.documents import text_of_document, toml_of
from tumble.errors import InputError, SessionError
from tumble.files import plain_name, whole_file
from tumble.recording.session import Exclusion, Session
from tumble.recording.session_file import SESSION_FILE, read_session, write_session

_DIALECT = ("delimiter", "decimal", "comment", "header", "encoding")


def begin(
    folder: Path,
    *,
    log: Mapping[str, Any],
    serial: str,
    site: Mapping[str, Any],
    programme: str | None,
) -> None:
    """Make a session folder with this table [log]."""
    content: dict[str, Any] = {"format": 1, "device": {"serial": serial}, "site": dict(site), "log": dict(log)}
    if programme is not None:
        content["programme"] = {"name": programme}
    write_session(folder, content)


def begin_as_csv(folder: Path, original: Path) -> None:
    """Make the session folder of another one whose log is recorded as CSV: what is said of how its file is written is
    left out."""
    content = _content(original)
    log = {key: value for key, value in content["log"].items() if key not in _DIALECT}
    write_session(folder, {**content, "log": {**log, "file": "log.csv"}})


def session_to_record(folder: Path) -> Session:
    """The session of a folder whose log may not exist yet: an empty file then takes its place.

    Raises SessionError for a session that is not recorded into one CSV file with commas."""
    try:
        file = _content(folder).get("log", {}).get("file", "")
    except (OSError, ValueError, AttributeError, InputError):
        return read_session(folder)  # which says what is wrong
    if not isinstance(file, str) or not file.endswith(".csv"):
        raise SessionError(f"{folder / SESSION_FILE}: log.file: expected one .csv file to record into, found {file!r}")
    (folder / file).touch()
    session = read_session(folder)
    if session.log.dialect is not None or session.log.clock:
        raise SessionError(
            f"{folder / SESSION_FILE}: log: expected a log with commas and a header to record into, found another form"
        )
    return session


def next_folder(folder: Path, serial: str) -> Path:
    """A new folder beside `folder` for the unit of this serial number."""
    name = plain_name(serial)
    number, found = 1, folder.parent / name
    while found.exists():
        number += 1
        found = folder.parent / f"{name}-{number}"
    return found


def begin_next(folder: Path, serial: str) -> Path:
    """Make the folder of the next unit: the session of `folder` with another serial number, nothing left out."""
    content = _content(folder)
    content["device"] = {**content["device"], "serial": serial}
    content.pop("exclude", None)
    made = next_folder(folder, serial)
    write_session(made, content)
    return made


def leave_out(folder: Path, one: Exclusion, instead_of: Exclusion | None = None) -> None:
    """Add a table [[exclude]] at the end of session.toml, or put it in the place of one added before; whatever else is
    in the file stays as it is."""
    path = folder / SESSION_FILE
    text = text_of_document(path)
    if instead_of is not None:
        before, found, after = text.rpartition(_table(instead_of))
        text = before + after if found else text
    _written(path, text.rstrip("\n") + "\n" + _table(one))


def take_back(folder: Path, one: Exclusion) -> None:
    """Take a table [[exclude]] out of session.toml that was added to it."""
    path = folder / SESSION_FILE
    before, _, after = text_of_document(path).rpartition(_table(one))
    _written(path, before + after)


def _content(folder: Path) -> dict[str, Any]:
    """The tables of session.toml."""
    path = folder / SESSION_FILE
    return toml_of(text_of_document(path), str(path))


def _written(path: Path, text: str) -> None:
    toml_of(text, str(path))
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _table(one: Exclusion) -> str:
    if one.rest is not None:
        keys = f"rest = {one.rest}\n"
    elif one.turn is not None:
        keys = f"turn = {one.turn}\n"
    else:
        keys = f"start = {one.start!r}\nstop = {one.stop!r}\n" + (f"file = {one.file + 1}\n" if one.file else "")
    return f"\n[[exclude]]\n{keys}reason = {json.dumps(one.reason, ensure_ascii=True)}\n"
