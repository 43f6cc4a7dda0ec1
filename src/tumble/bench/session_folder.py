"""The session folder of a bench: made for a source, copied for the next unit, and the operator's answers.

An answer settles a fault; what it leaves out of the log is written into session.toml.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from itertools import chain, count
from pathlib import Path
from typing import Any

from tumble.bench.follow.faults import Fault
from tumble.bench.follow.progress import Progress
from tumble.documents import text_of_document, toml_of, whole_number
from tumble.errors import InputError, SessionError
from tumble.files import plain_name, whole_file
from tumble.recording.live.samples import SI_LOG
from tumble.recording.live.sources import is_recorded, source_of
from tumble.recording.session import Exclusion, Session
from tumble.recording.session_file import SESSION_FILE, read_session, write_session
from tumble.recording.text.dialect import DIALECT_KEYS
from tumble.units import ACCEL_UNITS, GYRO_UNITS, Unit

MOTIONCAL = Path(__file__).with_name("motioncal.toml")
"""The table [log] of what MotionCal's sketches send."""
_FILE = re.compile(r"^file *= *(\[[^\]]*\]|.*)$", re.MULTILINE)


def begin(folder: Path, *, log: Mapping[str, Any], serial: str, site: Mapping[str, Any], programme: str | None) -> None:
    """Make a session folder with this table [log]."""
    content: dict[str, Any] = {"format": 1, "device": {"serial": serial}, "site": dict(site), "log": dict(log)}
    if programme is not None:
        content["programme"] = {"name": programme}
    write_session(folder, content)


def begin_for(folder: Path, listen: str, serial: str | None, site: Mapping[str, Any], programme: str | None) -> None:
    """Make a session folder for a source, as --listen names it: a copy of the session that is replayed, with a CSV log
    and what else is given; otherwise for SI, or for MotionCal. Raises InputError where --serial or --latitude is
    missing."""
    kind, _, rest = listen.partition(":")
    if kind == "replay":
        original = Path(rest.rpartition("@")[0] if "@" in rest else rest)
        source_of(listen).close()
        content = _content(original)
        if not is_recorded(read_session(original).log):
            log = {key: value for key, value in content["log"].items() if key not in DIALECT_KEYS}
            content["log"] = {**log, "file": "log.csv"}
        content["device"] |= {} if serial is None else {"serial": serial}
        content["site"] |= site
        content |= {} if programme is None else {"programme": {"name": programme}}
        write_session(folder, content)
        return
    motioncal = kind == "serial" and rest.endswith(":motioncal")
    needed = {"--serial": serial, "--latitude": site.get("latitude_deg")}
    missing = [option for option, given in needed.items() if given is None]
    if serial is None or missing:
        raise InputError(
            f"{folder}: expected --serial (of the unit) and --latitude (of the place) for a new session, found no "
            f"{' and no '.join(missing)}"
        )
    described = toml_of(text_of_document(MOTIONCAL), MOTIONCAL.name) if motioncal else SI_LOG
    begin(folder, log=described, serial=serial, site=site, programme=programme)


def session_to_record(folder: Path) -> Session:
    """The session of a folder whose log may not exist yet: an empty file then takes its place.

    Raises SessionError for a session that is not recorded into one CSV file with commas."""
    try:
        files = _files(_content(folder))
    except (OSError, ValueError, AttributeError, InputError):
        return read_session(folder)  # which says what is wrong
    if not files or not all(isinstance(file, str) and file.endswith(".csv") for file in files):
        raise SessionError(
            f"{folder / SESSION_FILE}: log.file: expected .csv files to record into, found {', '.join(map(str, files))}"
        )
    (folder / files[-1]).touch()
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
    content["log"] = {**content["log"], "file": _files(content)[0]}
    content.pop("exclude", None)
    name = plain_name(serial)
    names = chain([name], (f"{name}-{number}" for number in count(2)))
    made = next(made for each in names if not (made := folder.parent / each).exists())
    write_session(made, content)
    return made


def add_file(folder: Path, file: Path) -> None:
    """Name another file of the log, in which the recording goes on. Whatever else is in session.toml stays as it is."""
    path = folder / SESSION_FILE
    text, content = text_of_document(path), _content(folder)
    files = [*_files(content), file.name]
    changed = _FILE.sub(lambda _: f"file = {json.dumps(files)}", text, count=1)
    if _files(toml_of(changed, str(path))) != files:  # written in another way
        write_session(folder, {**content, "log": {**content["log"], "file": files}})
        return
    with whole_file(path) as temporary:
        temporary.write_text(changed, encoding="utf-8")


def _files(content: Mapping[str, Any]) -> list[Any]:
    """The files of the log."""
    file = content.get("log", {}).get("file", "")
    return file if isinstance(file, list) else [file]


def set_unit(folder: Path, unit: str) -> None:
    """State the unit of the accelerometers in session.toml, with gyros of rad/s in °/s where it is g, as they come
    together."""
    content = _content(folder)
    log = content["log"]
    log["accel"] = _in_unit(log["accel"], unit, ACCEL_UNITS)
    if unit.endswith("g") and log.get("gyro", {}).get("unit") == "rad/s":
        log["gyro"] = _in_unit(log["gyro"], "deg/s", GYRO_UNITS)
    write_session(folder, content)


def _in_unit(table: Mapping[str, Any], unit: str, units: Mapping[str, Unit]) -> dict[str, Any]:
    """A table of channels that read in another unit; their full scale stays what it is."""
    full = {key: table[key] * units[table["unit"]].factor / units[unit].factor for key in ("range",) if key in table}
    return {**table, **full, "unit": unit}


def leave_out(folder: Path, one: Exclusion | None, instead_of: Exclusion | None = None) -> None:
    """Write a table [[exclude]] at the end of session.toml, and remove `instead_of`, which was added before. Whatever
    else is in the file stays as it is."""
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
    keys = ((key, getattr(one, key)) for key in ("rest", "start", "stop", "file"))
    lines = "".join(f"{key} = {value!r}\n" for key, value in keys if value is not None)
    return f"\n[[exclude]]\n{lines}reason = {json.dumps(one.reason, ensure_ascii=True)}\n"


# -------------------- what the operator has answered --------------------


class Answers:
    """The operator's answers in one session. What they leave out is written into the session.toml of its `folder`.

    `before` is what the session left out already. `go_on` says whether the operator wants more positions than are
    needed."""

    def __init__(self, folder: Path, before: tuple[Exclusion, ...]) -> None:
        self._answered: list[Fault] = []
        self.go_on = False
        self._folder, self._before = folder, before
        self._added: list[Exclusion] = []
        self._open: Exclusion | None = None
        """The one that lasts until the unit is moved."""

    @property
    def excluded(self) -> tuple[Exclusion, ...]:
        """What is left out, last what has no end yet."""
        ended = tuple(one for one in (*self._before, *self._added) if one != self._open)
        return ended if self._open is None else (*ended, self._open.model_copy(update={"stop": math.inf}))

    def has_answered(self, fault: Fault) -> bool:
        """Whether a fault is settled."""
        return any(fault.is_like(other) for other in self._answered)

    def moved(self, progress: Progress) -> None:
        """End what is left out until the unit is moved."""
        if self._open is None:
            return
        stops = {file: stop for file, _, stop in progress.blocks.in_files(-math.inf, progress.now)}
        ended = self._open.model_copy(update={"stop": stops[(self._open.file or 1) - 1]})
        leave_out(self._folder, ended, instead_of=self._open)
        self._added = [ended if one == self._open else one for one in self._added]
        self._open = None

    def again(self, fault: Fault | None, progress: Progress | None) -> str:
        """Leave out what a fault has spoilt, up to now or until the unit is moved."""
        if fault is None or progress is None:
            return "nothing is wrong"
        here = fault.kind == "knock"  # this rest begins anew
        self._leave_out(fault, progress, fault.start, progress.now, until_moved=not here)
        return "left out; hold still, this rest begins anew" if here else "left out; take it again"

    def passed(self, fault: Fault, progress: Progress) -> str:
        """Settle a fault that is over: a rest in a wrong position is left out, a gap is noted, and of a rest in which
        the clock started anew one part is kept."""
        if fault.kind == "gap":
            self._answered.append(fault)
            return f"noted: {fault.said}; the turn with it tells nothing"
        if "keep_first" in fault.choices:
            return f"{fault.said}; {self.keep_first(fault, progress)}"
        self._leave_out(fault, progress, fault.start, fault.stop, until_moved=False)
        if fault.kind == "restart":
            return f"{fault.said}; hold still, this rest begins anew"
        return "the right position is taken; the wrong one is left out"

    def keep_first(self, fault: Fault | None, progress: Progress | None) -> str:
        """Leave out what is wrong and what follows it, and keep what was before."""
        if fault is None or progress is None or "keep_first" not in fault.choices:
            return "there is no first part"
        self._leave_out(fault, progress, fault.stop, progress.now, until_moved=True)
        return "the first part is kept; go on to the next position"

    def going_on(self, fault: Fault | None) -> str:
        """Settle a fault without leaving anything out; where there is none, ask for more positions."""
        if fault is not None:
            self._answered.append(fault)
            return "noted; nothing is left out"
        self.go_on = True
        return "going on"

    def leave_out_rest(self, number: str, rests: int) -> str:
        """Leave out a rest by its number, of so many."""
        rest = whole_number(number)
        if rest is None or not 0 < rest <= rests:
            return f"expected the number of a rest from 1 to {rests}"
        self._add(Exclusion(rest=rest, reason="left out at the bench"))
        return f"rest {rest} is left out"

    def take_back(self) -> str:
        """Use again what was left out last."""
        if not self._added:
            return "nothing was left out here"
        one = self._added.pop()
        leave_out(self._folder, None, instead_of=one)
        self._open = None if self._open == one else self._open
        return "taken back"

    def _leave_out(self, fault: Fault, progress: Progress, start: float, stop: float, *, until_moved: bool) -> None:
        self._answered.append(fault)
        for file, begin, end in progress.blocks.in_files(start, max(stop, start + 1e-3)):
            one = Exclusion(start=begin, stop=end, file=file + 1 if file else None, reason=fault.said)
            self._add(one)
            self._open = one if until_moved else self._open

    def _add(self, one: Exclusion) -> None:
        leave_out(self._folder, one)
        self._added.append(one)
