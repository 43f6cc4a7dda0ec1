"""The session folder of a bench: made for a source, copied for the next unit, and what the operator leaves out written
into it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from itertools import chain, count
from pathlib import Path
from typing import Any

from tumble.bench.record.lines import MOTIONCAL_COLUMNS
from tumble.bench.record.sources import is_recorded, source_of
from tumble.bench.record.virtual_table import FULL_SCALE, GRAVITY
from tumble.documents import text_of_document, toml_of
from tumble.errors import InputError, SessionError
from tumble.files import plain_name, whole_file
from tumble.recording.session import Exclusion, Session
from tumble.recording.session_file import SESSION_FILE, read_session, write_session
from tumble.usual_setup import LATITUDE_DEG

_DIALECT = ("delimiter", "decimal", "comment", "header", "encoding")

MOTIONCAL_LOG: Mapping[str, Any] = {
    "file": "log.csv",
    "time": MOTIONCAL_COLUMNS[0],
    "regular": True,
    "accel": {"columns": list(MOTIONCAL_COLUMNS[1:4]), "unit": "count", "scale": 8192.0, "scale_per": "g"},
    "gyro": {"columns": list(MOTIONCAL_COLUMNS[4:7]), "unit": "count", "scale": 16.0, "scale_per": "deg/s"},
    "magnetometer": {"columns": list(MOTIONCAL_COLUMNS[7:]), "unit": "uT"},
}
"""The table [log] of what MotionCal's sketches send: 8192 a g, 16 a °/s, 10 a µT."""


def in_si() -> dict[str, Any]:
    """The table [log] of a source that sends t, ax, ay, az, gx, gy, gz in SI."""
    return {
        "file": "log.csv",
        "time": "t",
        "accel": {"columns": ["ax", "ay", "az"], "unit": "m/s^2"},
        "gyro": {"columns": ["gx", "gy", "gz"], "unit": "rad/s"},
    }


def begin(folder: Path, *, log: Mapping[str, Any], serial: str, site: Mapping[str, Any], programme: str | None) -> None:
    """Make a session folder with this table [log]."""
    content: dict[str, Any] = {"format": 1, "device": {"serial": serial}, "site": dict(site), "log": dict(log)}
    if programme is not None:
        content["programme"] = {"name": programme}
    write_session(folder, content)


def begin_for(folder: Path, listen: str, serial: str | None, site: Mapping[str, Any], programme: str | None) -> None:
    """Make a session folder for what stands after --listen: a copy of what is replayed, of a log in another form as
    that of CSV; else of a source that sends SI, or MotionCal. Raises InputError for what is to be told and is not."""
    kind, _, rest = listen.partition(":")
    if kind == "replay":
        original = Path(rest.rpartition("@")[0] if "@" in rest else rest)
        source_of(listen).close()
        if is_recorded(read_session(original).log):
            folder.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(original / SESSION_FILE, folder / SESSION_FILE)
        else:
            content = _content(original)
            log = {key: value for key, value in content["log"].items() if key not in _DIALECT}
            write_session(folder, {**content, "log": {**log, "file": "log.csv"}})
        return
    motioncal = kind == "serial" and rest.endswith(":motioncal")
    log = dict(MOTIONCAL_LOG) if motioncal else in_si()
    if kind == "simulator":
        log["gyro"] = log["gyro"] | {"range": FULL_SCALE}
        there = {"latitude_deg": LATITUDE_DEG, "gravity": GRAVITY}
        if {**there, **site} != there:
            raise InputError(
                f"--latitude, --gravity: expected those of the simulated unit, {LATITUDE_DEG}° and {GRAVITY} m/s², "
                "found others; leave them out"
            )
        site = there | {"gravity_u": 1e-6}
        programme, serial = programme or rest.partition("@")[0] or "rough-table", serial or "virtual-1"
    told = {"--serial": serial, "--latitude": site.get("latitude_deg")}
    missing = [option for option, given in told.items() if given is None]
    if serial is None or missing:
        raise InputError(
            f"{folder}: expected --serial (of the unit) and --latitude (of the place) for a new session, found no "
            f"{' and no '.join(missing)}"
        )
    begin(folder, log=log, serial=serial, site=site, programme=programme)


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
    if not is_recorded(session.log):
        raise SessionError(
            f"{folder / SESSION_FILE}: log: expected a log with commas and a header to record into, found another form"
        )
    return session


def begin_next(folder: Path, serial: str) -> Path:
    """Make the folder of the next unit beside `folder`: its session with another serial number, nothing left out."""
    content = _content(folder)
    content["device"] = {**content["device"], "serial": serial}
    content.pop("exclude", None)
    name = plain_name(serial)
    names = chain([name], (f"{name}-{number}" for number in count(2)))
    made = next(made for each in names if not (made := folder.parent / each).exists())
    write_session(made, content)
    return made


def leave_out(folder: Path, one: Exclusion | None, instead_of: Exclusion | None = None) -> None:
    """Add a table [[exclude]] at the end of session.toml, in the place of one that was added before or, where None,
    take that one out; whatever else is in the file stays as it is."""
    path = folder / SESSION_FILE
    text, old, new = text_of_document(path), *("" if each is None else _table(each) for each in (instead_of, one))
    before, _, after = text.rpartition(old) if old else (text, "", "")
    text = f"{before}{after}".rstrip("\n") + "\n" + new
    toml_of(text, str(path))
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _content(folder: Path) -> dict[str, Any]:
    path = folder / SESSION_FILE
    return toml_of(text_of_document(path), str(path))


def _table(one: Exclusion) -> str:
    keys = f"start = {one.start!r}\nstop = {one.stop!r}\n" if one.rest is None else f"rest = {one.rest}\n"
    return f"\n[[exclude]]\n{keys}reason = {json.dumps(one.reason, ensure_ascii=True)}\n"
