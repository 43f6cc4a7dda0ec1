"""Session folder of a bench: its creation, copies for the next unit, and the operator's answers to faults.

Parts of the log excluded by an answer are written into session.toml.
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
"""Table [log] of the output of MotionCal's sketches."""
_FILE = re.compile(r"^file *= *(\[[^\]]*\]|.*)$", re.MULTILINE)


def begin(folder: Path, *, log: Mapping[str, Any], serial: str, site: Mapping[str, Any], programme: str | None) -> None:
    """Create a session folder with a table [log]."""
    content: dict[str, Any] = {"format": 1, "device": {"serial": serial}, "site": dict(site), "log": dict(log)}
    if programme is not None:
        content["programme"] = {"name": programme}
    write_session(folder, content)


def begin_for(folder: Path, listen: str, serial: str | None, site: Mapping[str, Any], programme: str | None) -> None:
    """Create a session folder for a source, named as by --listen.

    For a replay it is a copy of the replayed session with a CSV log; otherwise the log is in SI, or that of MotionCal.
    Raises InputError if --serial or --latitude is missing."""
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
    is_motioncal = kind == "serial" and rest.endswith(":motioncal")
    needed = {"--serial": serial, "--latitude": site.get("latitude_deg")}
    missing = [option for option, given in needed.items() if given is None]
    if serial is None or missing:
        raise InputError(
            f"{folder}: expected --serial (of the unit) and --latitude (of the place) for a new session, found no "
            f"{' and no '.join(missing)}"
        )
    described = toml_of(text_of_document(MOTIONCAL), MOTIONCAL.name) if is_motioncal else SI_LOG
    begin(folder, log=described, serial=serial, site=site, programme=programme)


def session_to_record(folder: Path) -> Session:
    """Return the session of a folder; a log that does not exist yet is created as an empty file.

    Raises SessionError unless it is recorded into CSV files with commas."""
    try:
        files = _files(_content(folder))
    except (OSError, ValueError, AttributeError, InputError):
        return read_session(folder)  # raises the error in full
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
    """Create the folder of the next unit beside `folder`: the same session with another serial number and without
    exclusions."""
    content = _content(folder)
    content["device"] = {**content["device"], "serial": serial}
    content["log"] = {**content["log"], "file": _files(content)[0]}
    content.pop("exclude", None)
    name = plain_name(serial)
    names = chain([name], (f"{name}-{number}" for number in count(2)))
    new = next(new for each in names if not (new := folder.parent / each).exists())
    write_session(new, content)
    return new


def add_file(folder: Path, file: Path) -> None:
    """Add a file to the log in session.toml, leaving the rest of the text as it is."""
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
    file = content.get("log", {}).get("file", "")
    return file if isinstance(file, list) else [file]


def set_unit(folder: Path, unit: str) -> str:
    """Change the unit of the accelerometers in session.toml, and return what was changed in words.

    With g that of gyros becomes °/s instead of rad/s."""
    content = _content(folder)
    log, gyros = content["log"], ""
    log["accel"] = _in_unit(log["accel"], unit, ACCEL_UNITS)
    if unit.endswith("g") and log.get("gyro", {}).get("unit") == "rad/s":
        log["gyro"] = _in_unit(log["gyro"], "deg/s", GYRO_UNITS)
        gyros = ", the gyros in deg/s; if that is wrong, change it in session.toml"
    write_session(folder, content)
    return f"the accelerometers are in {unit}{gyros}"


def _in_unit(table: Mapping[str, Any], unit: str, units: Mapping[str, Unit]) -> dict[str, Any]:
    """Return a table of channels with another unit and the same full scale."""
    full_scale = {
        key: table[key] * units[table["unit"]].factor / units[unit].factor for key in ("range",) if key in table
    }
    return {**table, **full_scale, "unit": unit}


def write_exclusion(folder: Path, exclusion: Exclusion | None, instead_of: Exclusion | None = None) -> None:
    """Append a table [[exclude]] to session.toml, and remove `instead_of`, which was appended before."""
    path, text = folder / SESSION_FILE, text_of_document(folder / SESSION_FILE)
    old, new = ("" if each is None else _exclude_table(each) for each in (instead_of, exclusion))
    before, _, after = text.rpartition(old) if old else (text, "", "")
    text = f"{before}{after}".rstrip("\n") + "\n" + new
    toml_of(text, str(path))
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _content(folder: Path) -> dict[str, Any]:
    path = folder / SESSION_FILE
    return toml_of(text_of_document(path), str(path))


def _exclude_table(exclusion: Exclusion) -> str:
    keys = ((key, getattr(exclusion, key)) for key in ("rest", "start", "stop", "file"))
    lines = "".join(f"{key} = {value!r}\n" for key, value in keys if value is not None)
    return f"\n[[exclude]]\n{lines}reason = {json.dumps(exclusion.reason, ensure_ascii=True)}\n"


# -------------------- answers of the operator --------------------


class Answers:
    """The operator's answers in a session with the exclusions `before`; further exclusions are written to its `folder`.

    `go_on` is True if the operator wants more positions than necessary."""

    def __init__(self, folder: Path, before: tuple[Exclusion, ...]) -> None:
        self._answered: list[Fault] = []
        self.go_on = False
        self._folder, self._before = folder, before
        self._added: list[Exclusion] = []
        self._open: Exclusion | None = None  # ends when the unit is moved

    @property
    def excluded(self) -> tuple[Exclusion, ...]:
        """All exclusions; one without an end yet is the last."""
        ended = tuple(each for each in (*self._before, *self._added) if each != self._open)
        return ended if self._open is None else (*ended, self._open.model_copy(update={"stop": math.inf}))

    def has_answered(self, fault: Fault) -> bool:
        """Return True if a fault is settled."""
        return any(fault.is_like(other) for other in self._answered)

    def moved(self, progress: Progress) -> None:
        """End the exclusion that lasts until the unit is moved."""
        if self._open is None:
            return
        stops = {file: stop for file, _, stop in progress.blocks.in_files(-math.inf, progress.now)}
        ended = self._open.model_copy(update={"stop": stops[(self._open.file or 1) - 1]})
        write_exclusion(self._folder, ended, instead_of=self._open)
        self._added = [ended if each == self._open else each for each in self._added]
        self._open = None

    def again(self, fault: Fault | None, progress: Progress | None) -> str:
        """Exclude the part that a fault has spoilt, up to now or until the unit is moved."""
        if fault is None or progress is None:
            return "nothing is wrong"
        is_knock = fault.kind == "knock"  # this rest begins anew
        self._exclude(fault, progress, fault.start, progress.now, until_moved=not is_knock)
        return "left out; hold still, this rest begins anew" if is_knock else "left out; take it again"

    def passed(self, fault: Fault, progress: Progress) -> str:
        """Settle a fault that is over: exclude a rest in a wrong position, note a gap, and keep one part of a rest in
        which the clock restarted."""
        if fault.kind == "gap":
            self._answered.append(fault)
            return f"noted: {fault.said}; the turn with it is not used"
        if "keep_first" in fault.choices:
            return f"{fault.said}; {self.keep_first(fault, progress)}"
        self._exclude(fault, progress, fault.start, fault.stop, until_moved=False)
        if fault.kind == "restart":
            return f"{fault.said}; hold still, this rest begins anew"
        return "the right position is taken; the wrong one is left out"

    def keep_first(self, fault: Fault | None, progress: Progress | None) -> str:
        """Exclude a fault and what follows it until the unit is moved; keep the part before."""
        if fault is None or progress is None or "keep_first" not in fault.choices:
            return "there is no first part"
        self._exclude(fault, progress, fault.stop, progress.now, until_moved=True)
        return "the first part is kept; go on to the next position"

    def going_on(self, fault: Fault | None) -> str:
        """Settle a fault without an exclusion; without a fault ask for more positions."""
        if fault is not None:
            self._answered.append(fault)
            return "noted; nothing is left out"
        self.go_on = True
        return "going on"

    def leave_out_rest(self, number: str, rests: int) -> str:
        """Exclude a rest by its number, from 1 to `rests`."""
        rest = whole_number(number)
        if rest is None or not 0 < rest <= rests:
            return f"expected the number of a rest from 1 to {rests}"
        self._add(Exclusion(rest=rest, reason="left out at the bench"))
        return f"rest {rest} is left out"

    def take_back(self) -> str:
        """Remove the last exclusion."""
        if not self._added:
            return "nothing was left out here"
        last = self._added.pop()
        write_exclusion(self._folder, None, instead_of=last)
        self._open = None if self._open == last else self._open
        return "taken back"

    def _exclude(self, fault: Fault, progress: Progress, start: float, stop: float, *, until_moved: bool) -> None:
        self._answered.append(fault)
        for file, begin, end in progress.blocks.in_files(start, max(stop, start + 1e-3)):
            exclusion = Exclusion(start=begin, stop=end, file=file + 1 if file else None, reason=fault.said)
            self._add(exclusion)
            self._open = exclusion if until_moved else self._open

    def _add(self, exclusion: Exclusion) -> None:
        write_exclusion(self._folder, exclusion)
        self._added.append(exclusion)
