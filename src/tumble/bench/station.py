"""One bench: a unit that is recorded, what the page shows of it, and what the operator answers.

The state follows from the log on disk and from session.toml, so that the page and this process may each be started
again at any time: `follow` reads the log and gives progress, faults and the estimate, `session_folder` keeps the
operator's answers, and `screens` makes the state that the page shows. This module has the threads, the lock and the
buttons. `state` is replaced as a whole, several times a second, by one thread; another makes the estimates.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from tumble.bench import results, screens, session_folder
from tumble.bench.follow.estimates import Estimates
from tumble.bench.follow.faults import Fault, another_unit, faults_of_rests, is_over
from tumble.bench.follow.live import Live
from tumble.bench.follow.progress import Progress
from tumble.bench.follow.wishes import Task, Wanted
from tumble.bench.record.recorder import NOTHING_RECEIVED, Intake
from tumble.bench.state import Received, State, Trace
from tumble.errors import InputError, TumbleError
from tumble.programme.positions import programme as built_in
from tumble.recording.live.sources import LineSource, source_of
from tumble.recording.session_file import SESSION_FILE

log = logging.getLogger(__name__)

STEP_SECONDS = 0.2
_LONG = {
    "calibrate": "calibrating",
    "report": "writing the report",
    "export": "exporting",
    "register": "registering",
}
"""Buttons whose work takes long: the page goes on meanwhile. All but the first are about a result."""


class Station:
    """A bench that records one unit into a session folder and shows its page. `listen` opens the source that is
    recorded, None where another program writes the log; `wanted` are uncertainties that are wanted, such as
    "gyro.scale=2ppm"; `grade` is that of the unit where its session gives none; calibrations are registered in the
    `registry`, None for the user's."""

    def __init__(
        self,
        folder: Path,
        listen: Callable[[], LineSource] | None,
        *,
        wanted: tuple[str, ...] = (),
        grade: str = "mems",
        registry: str | None = None,
    ) -> None:
        self._listen, self._grade, self._registry = listen, grade, registry
        self._wanted = Wanted.of(wanted, grade)
        self._guard = threading.RLock()
        self._stop = threading.Event()
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="estimate")
        self._thread = threading.Thread(target=self._run, name="station", daemon=True)
        self._buttons: Mapping[str, Callable[[str], str]] = {
            "again": lambda _: self._answers.again(*self._present_fault()),
            "keep_first": lambda _: self._answers.keep_first(*self._present_fault()),
            "unit": lambda _: self._set_unit(),
            "go_on": lambda _: self._answers.going_on(self._present_fault()[0]),
            "leave_out": lambda number: self._answers.leave_out_rest(
                number, 0 if self._estimates.shown is None else self._estimates.shown["rests"]
            ),
            "take_back": lambda _: self._answers.take_back(),
            "stop": lambda _: self._stop_recording(),
            "resume": lambda _: self._resume(),
            "calibrate": lambda _: self._calibrate(),
            "report": lambda _: self._written(results.report_of(self.folder, self._stop)),
            "export": lambda to: self._written(*results.exported(self.folder, to)),
            "register": lambda _: self._register(),
            "next_unit": self._next_unit,
        }
        self.intake: Intake | None = None
        self._begin(folder)
        self.state = self._state()

    def _begin(self, folder: Path) -> None:
        self.folder = folder
        self.task = Task.of(session_folder.session_to_record(folder), self._wanted, self._grade)
        self._live = Live(self.task)
        self._answers = session_folder.Answers(folder, self.task.session.excluded)
        self._estimates = Estimates(self.task, self._worker)
        self._result: dict[str, Any] | None = None
        self._busy = self._message = ""
        self._wrong: Fault | None = None
        self._taken = self._outdated = 0

    # -------------------- running --------------------

    def start(self) -> None:
        self._record()
        self._thread.start()

    def _record(self) -> None:
        if self._listen is not None:
            source = self._listen()
            try:
                self.intake = Intake(source, self.task.session)
            except BaseException:
                source.close()
                raise
            self.intake.start()

    def _run(self) -> None:
        while not self._stop.wait(STEP_SECONDS):
            try:
                self.step()
            except OSError as error:
                self.state = {**self.state, "message": f"{self.folder}: cannot be read: {error.strerror}"}
            except Exception as error:
                said = _said_of(error, "the page stands still; what is received is recorded")
                self.state = {**self.state, "message": said}

    def _add_files(self) -> None:
        """Name in session.toml the files that were begun where the clock started anew."""
        for file in [] if self.intake is None else self.intake.files[len(self._live.files) :]:
            session_folder.add_file(self.folder, file)
            self._live.files.append(file)

    def stop(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        if self.intake is not None:
            self.intake.stop()
            self._add_files()
        self._worker.shutdown(wait=True)

    def step(self) -> None:
        """Read what has come and make the state anew."""
        with self._guard:
            self._add_files()
            self._live.read(self._answers.excluded)
            self._estimates.take()
            self.state = self._state()

    # -------------------- the state --------------------

    def _state(self) -> State:
        progress, shown = self._live.now, screens.WAITING
        if progress is not None and progress.so_far is not None:
            if not progress.still:
                self._answers.moved(progress)
            fault, _ = self._present_fault()
            while fault is not None and is_over(fault, self.task, progress):
                self._message = self._answers.passed(fault, progress)
                fault, _ = self._present_fault()
            self._estimates.ask(progress, self._answers.excluded)
            shown = screens.screen(self.task, progress, fault, self._estimates.shown, go_on=self._answers.go_on)
            another = fault is not None and (self._wrong is None or not fault.is_like(self._wrong))
            if another or len(progress.groups) > self._taken > 0:
                self._message = ""  # which was of what was wrong before, or of the position before
            self._wrong, self._taken = fault, max(self._taken, len(progress.groups))
        intake, live, device, programme = self.intake, self._live, self.task.session.device, self.task.programme
        source = "recording has stopped" if self._listen is not None else "the log of another program"
        received: Received = NOTHING_RECEIVED if intake is None else intake.received
        if live.samples and shown is screens.WAITING:
            shown = {**shown, "headline": "Waiting for rest"}
        if received["silent"]:
            shown = {**shown, "headline": "Nothing comes from the sensor: is it plugged in?"}
        if received["ended"] and shown["fault"] is None and shown["screen"] != "done":
            shown = {**shown, "headline": "The recording has ended"}
        following = [live.trouble] if live.trouble else []
        state: State = {
            **shown,
            "answers": [],
            "unit": {"serial": device.serial, "model": device.model},
            "session": self.folder.name,
            "listening": intake is not None and not intake.ended,
            "can_record": self._listen is not None,
            "received": {
                "source": source if intake is None else intake.source.name,
                "samples": live.samples,
                "rate": None if live.interval is None else 1.0 / live.interval,
                "lost": live.lost,
                "refused": received["refused"],
                "why": received["why"],
                "ended": received["ended"],
                "silent": received["silent"],
                "trouble": [*received["trouble"], *following],
            },
            "programme": None if programme is None else programme.name,
            "positions": self.task.positions,
            "wanted": dict(self.task.wanted.group),
            "estimate": self._estimates.shown,
            "estimating": self._estimates.under_way,
            "result": self._result,
            "calibrating": self._busy == _LONG["calibrate"],
            "excluded": len(self._answers.excluded),
            "message": self._message,
        }
        state["answers"] = screens.answers(state)
        return state

    def _present_fault(self) -> tuple[Fault | None, Progress | None]:
        """The first fault of the log as it was read last that is not answered, and how far the log is."""
        progress = self._live.now
        if progress is None:
            return None, None
        of_rests = faults_of_rests(self.task, progress)
        faults = (*another_unit(self.task, progress), *self._live.faults, *of_rests)
        return next((fault for fault in faults if not self._answers.has_answered(fault)), None), progress

    # -------------------- the buttons --------------------

    def command(self, name: str, value: str = "") -> str:
        """Do what a button asks for; what came of it, in a sentence."""
        with self._guard:
            if name not in self._buttons:
                return "no such command"
            if self._busy:
                return f"{self._busy}: wait until it is done"
            if name not in _LONG:
                excluded = self._answers.excluded
                self._message = self._answered(name, value)
                if self._answers.excluded != excluded:
                    self._result = None  # which was of what was left out before
                return self._message
            if name != "calibrate" and self._result is None:
                return "nothing is calibrated yet"
            self._busy = _LONG[name]
            self._message = f"{self._busy} …"
        said = self._answered(name, value)
        with self._guard:
            self._busy, self._message = "", said
        return said

    def _answered(self, name: str, value: str) -> str:
        try:
            return self._buttons[name](value)
        except (TumbleError, OSError) as error:
            return " ".join(str(error).split())
        except Exception as error:
            return _said_of(error, f"{name}: not done")

    def _set_unit(self) -> str:
        """State the unit that is asked about, and read the log anew by it."""
        fault, _ = self._present_fault()
        if fault is None or not fault.unit:
            return "no unit is asked about"
        outdated = self.trace(0)["next"]
        session_folder.set_unit(self.folder, fault.unit)
        self._begin(self.folder)
        self._outdated = outdated
        return f"the accelerometers are in {fault.unit}; what is recorded is read anew"

    def _stop_recording(self) -> str:
        """Stop recording; that it is so, and what of it the disk has not taken."""
        trouble = None
        if self.intake is not None:
            self.intake.stop()
            self._add_files()
            trouble, self.intake = self.intake.recorder.trouble, None
        return "recording has stopped" + (f": {trouble}" if trouble else "")

    def _resume(self) -> str:
        if self.intake is None:
            self._record()
            self._result = None
        return "recording goes on"

    def _next_unit(self, given: str) -> str:
        """Begin the unit of a serial number, typed or scanned; separators in a bar code, which no text shows, become
        spaces. What is recorded goes on until the folder of the next unit is there."""
        serial = " ".join("".join(c if c.isprintable() else " " for c in given).split())
        if not serial:
            return "expected the serial number of the next unit"
        folder = session_folder.begin_next(self.folder, serial)
        self._stop_recording()
        self._begin(folder)
        self._record()
        return f"next unit: {serial}"

    def _calibrate(self) -> str:
        """Stop recording and calibrate. Whatever comes of it, an earlier result is none of this."""
        with self._guard:
            stopped, self._result = self._stop_recording(), None
        self._result = results.shown(results.calibrated(self.folder, self._stop))
        said = "calibrated: accepted" if self._result["accepted"] else "calibrated: not accepted"
        return f"{said}; {stopped}" if ":" in stopped else said

    def _register(self) -> str:
        said = results.registered(self.folder, self._registry, self._stop)
        if self._result is not None:
            self._result = {**self._result, "registered": said}
        return said

    def _written(self, name: str, loss: str = "") -> str:
        if self._result is not None:
            self._result = {**self._result, "files": list(dict.fromkeys([*self._result["files"], name]))}
        return f"written: {name}" + (f"; {loss}" if loss else "")

    # -------------------- what is fetched beside the state --------------------

    @property
    def followed(self) -> int:
        """Bytes of the log that are in the state."""
        return self._live.at

    def trace(self, since: int) -> Trace:
        """Block means from number `since` on, at most the last minute; all of it where those before are outdated."""
        now = self._live.now
        return screens.trace(None if now is None else now.blocks, since if since > self._outdated else 0)

    def file(self, name: str) -> Path | None:
        """A result that can be fetched."""
        return self.folder / name if self._result is not None and name in self._result["files"] else None


def _said_of(error: Exception, what: str) -> str:
    """What is said of an error of the program, which the log of the process has in full."""
    log.error(what, exc_info=error)
    return " ".join(f"{what} ({type(error).__name__}: {error})".split())


# -------------------- from the words of the command line --------------------


def station_of(
    folder: Path,
    listen: str | None,
    *,
    serial: str | None = None,
    site: Mapping[str, Any],
    programme: str | None = None,
    **wishes: Any,
) -> Station:
    """Open the bench of a session folder, which is made where it is new.

    `listen` names the source as --listen does; it is opened anew each time recording begins. `wishes` are further
    arguments of `Station`. Raises InputError."""
    if programme is not None:
        built_in(programme)
    known = (folder / SESSION_FILE).exists()
    if listen is None:
        if not known:
            raise InputError(
                f"{folder}: expected a session folder, or --listen with what to record into it, found neither"
            )
        return Station(folder, None, **wishes)
    if not known:
        session_folder.begin_for(folder, listen, serial, site, programme)
    source = listen.removesuffix(":motioncal")
    return Station(folder, lambda: source_of(source), **wishes)
