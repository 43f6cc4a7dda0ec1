"""A bench: it records one unit, makes the state of the page, and carries out the operator's commands.

The state follows from the log on disk and session.toml alone, so that page and process can be restarted at any time.
`follow` reads the log and gives progress, faults and the estimate, `session_folder` keeps the operator's answers, and
`screens` makes the state. This module has the threads, the lock and the commands. One thread replaces `state` several
times a second; another computes estimates.
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
from tumble.bench.follow.faults import Fault, faults_of_rests, is_over, wrong_unit
from tumble.bench.follow.live import Live
from tumble.bench.follow.progress import Progress
from tumble.bench.follow.task import Task, Wanted
from tumble.bench.record.recorder import NOTHING_RECEIVED, Intake
from tumble.bench.state import Received, State, Trace
from tumble.errors import InputError, TumbleError
from tumble.programme.positions import programme as built_in
from tumble.recording.live.sources import LineSource, source_of
from tumble.recording.session_file import SESSION_FILE

log = logging.getLogger(__name__)

STEP_SECONDS = 0.2
_LONG_COMMANDS = {
    "calibrate": "calibrating",
    "report": "writing the report",
    "export": "exporting",
    "register": "registering",
}
"""Slow commands, during which the page is still updated. All but the first need a result."""


class Station:
    """A bench that records one unit into a session folder.

    `listen` opens the source to be recorded, None if another program writes the log. `wanted` are wanted uncertainties
    such as "gyro.scale=2ppm"; `grade` is that of the unit if its session gives none; `registry` is where calibrations
    are registered, None for the user's."""

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
            "report": lambda _: self._add_result_file(results.write_report(self.folder, self._stop)),
            "export": lambda to: self._add_result_file(*results.write_export(self.folder, to)),
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
        self._last_fault: Fault | None = None
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
                message = _log_error(error, "the page stands still; what is received is recorded")
                self.state = {**self.state, "message": message}

    def _add_files(self) -> None:
        """Add the files that were begun after a restart of the clock to session.toml."""
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
        """Read new data and update the state."""
        with self._guard:
            self._add_files()
            self._live.read(self._answers.excluded)
            self._estimates.take()
            self.state = self._state()

    # -------------------- state --------------------

    def _state(self) -> State:
        progress, screen = self._live.now, screens.WAITING
        if progress is not None and progress.so_far is not None:
            if not progress.still:
                self._answers.moved(progress)
            fault, _ = self._present_fault()
            if len(progress.groups) > self._taken > 0:
                self._message = ""  # about the position before
            while fault is not None and is_over(fault, self.task, progress):
                self._message = self._answers.passed(fault, progress)
                fault, _ = self._present_fault()
            self._estimates.ask(progress, self._answers.excluded)
            screen = screens.screen(self.task, progress, fault, self._estimates.shown, go_on=self._answers.go_on)
            if fault is not None and (self._last_fault is None or not fault.is_like(self._last_fault)):
                self._message = ""  # about the fault before
            self._last_fault, self._taken = fault, max(self._taken, len(progress.groups))
        intake, live, device, programme = self.intake, self._live, self.task.session.device, self.task.programme
        source = "recording has stopped" if self._listen is not None else "the log of another program"
        received: Received = NOTHING_RECEIVED if intake is None else intake.received
        if live.samples and screen is screens.WAITING:
            screen = {**screen, "headline": "Waiting for rest"}
        if received["silent"]:
            screen = {**screen, "headline": "Nothing comes from the sensor: is it plugged in?"}
        if received["ended"] and screen["fault"] is None and screen["screen"] != "done":
            screen = {**screen, "headline": "The recording has ended"}
        state: State = {
            **screen,
            "answers": [],
            "unit": {"serial": device.serial, "model": device.model},
            "session": self.folder.name,
            "listening": intake is not None and not intake.ended,
            "can_record": self._listen is not None,
            "received": {
                **received,
                "source": source if intake is None else intake.source.name,
                "samples": live.samples,
                "rate": None if live.interval is None else 1.0 / live.interval,
                "lost": live.lost,
                "trouble": [*received["trouble"], *filter(None, [live.trouble])],
            },
            "programme": None if programme is None else programme.name,
            "positions": self.task.positions,
            "wanted": dict(self.task.wanted.group),
            "estimate": self._estimates.shown,
            "estimating": self._estimates.under_way,
            "result": self._result,
            "calibrating": self._busy == _LONG_COMMANDS["calibrate"],
            "excluded": len(self._answers.excluded),
            "message": self._message,
        }
        state["answers"] = screens.answers(state)
        return state

    def _present_fault(self) -> tuple[Fault | None, Progress | None]:
        """Return the first fault that is not answered, and the progress of the log."""
        progress = self._live.now
        if progress is None:
            return None, None
        rest_faults = faults_of_rests(self.task, progress)
        faults = (*wrong_unit(self.task, progress), *self._live.faults, *rest_faults)
        return next((fault for fault in faults if not self._answers.has_answered(fault)), None), progress

    # -------------------- commands --------------------

    def command(self, name: str, value: str = "") -> str:
        """Carry out the command of a button, and return the outcome as a sentence."""
        with self._guard:
            if name not in self._buttons:
                return "no such command"
            if self._busy:
                return f"{self._busy}: wait until it is done"
            if name not in _LONG_COMMANDS:
                excluded = self._answers.excluded
                self._message = self._carry_out(name, value)
                if self._answers.excluded != excluded:
                    self._result = None  # it was computed with other exclusions
                return self._message
            if name != "calibrate" and self._result is None:
                return "nothing is calibrated yet"
            self._busy = _LONG_COMMANDS[name]
            self._message = f"{self._busy} …"
        message = self._carry_out(name, value)
        with self._guard:
            self._busy, self._message = "", message
        return message

    def _carry_out(self, name: str, value: str) -> str:
        try:
            return self._buttons[name](value)
        except (TumbleError, OSError) as error:
            text = error.for_command_line if isinstance(error, TumbleError) else str(error)
            return " ".join(text.split())
        except Exception as error:
            return _log_error(error, f"{name}: not done")

    def _set_unit(self) -> str:
        """Change the unit of the accelerometers to the suggested one, and read the log again."""
        fault, _ = self._present_fault()
        if fault is None or not fault.unit:
            return "no unit is asked about"
        outdated = self.trace(0)["next"]
        changed = session_folder.set_unit(self.folder, fault.unit)
        self._begin(self.folder)
        self._outdated = outdated
        return f"{changed}; what is recorded is read anew"

    def _stop_recording(self) -> str:
        """Stop recording, and return a sentence with the samples that could not be written."""
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

    def _next_unit(self, text: str) -> str:
        """Begin the unit with a serial number, typed or scanned, whose unprintable separators become spaces.

        Recording goes on until the folder of the next unit exists."""
        serial = " ".join("".join(c if c.isprintable() else " " for c in text).split())
        if not serial:
            return "expected the serial number of the next unit"
        folder = session_folder.begin_next(self.folder, serial)
        self._stop_recording()
        self._begin(folder)
        self._record()
        return f"next unit: {serial}"

    def _calibrate(self) -> str:
        """Stop recording and calibrate; an earlier result is dropped even if that fails."""
        with self._guard:
            stopped, self._result = self._stop_recording(), None
        self._result = results.page_content(results.calibrate_folder(self.folder, self._stop))
        message = "calibrated: accepted" if self._result["accepted"] else "calibrated: not accepted"
        return f"{message}; {stopped}" if ":" in stopped else message

    def _register(self) -> str:
        message = results.register(self.folder, self._registry, self._stop)
        if self._result is not None:
            self._result = {**self._result, "registered": message}
        return message

    def _add_result_file(self, name: str, loss: str = "") -> str:
        if self._result is not None:
            self._result = {**self._result, "files": list(dict.fromkeys([*self._result["files"], name]))}
        return f"written: {name}" + (f"; {loss}" if loss else "")

    # -------------------- trace and files --------------------

    @property
    def followed(self) -> int:
        """Bytes of the log that the state includes."""
        return self._live.at

    def trace(self, since: int) -> Trace:
        """Return block means from number `since` on, at most the last minute, or all if earlier ones are outdated."""
        now = self._live.now
        return screens.trace(None if now is None else now.blocks, since if since > self._outdated else 0)

    def file(self, name: str) -> Path | None:
        """Return the path of a file of the result, None if there is no such file."""
        return self.folder / name if self._result is not None and name in self._result["files"] else None


def _log_error(error: Exception, message: str) -> str:
    """Log an error of the program, and return it as a message of one line."""
    log.error(message, exc_info=error)
    return " ".join(f"{message} ({type(error).__name__}: {error})".split())


# -------------------- command line --------------------


def station_of(
    folder: Path,
    listen: str | None,
    *,
    serial: str | None = None,
    site: Mapping[str, Any],
    programme: str | None = None,
    **options: Any,
) -> Station:
    """Open the bench of a session folder, which is created if it is new.

    `listen` names the source as by --listen; it is opened each time recording begins. `options` are further arguments
    of `Station`. Raises InputError."""
    if programme is not None:
        built_in(programme)
    known = (folder / SESSION_FILE).exists()
    if listen is None:
        if not known:
            raise InputError(
                f"{folder}: expected a session folder, or --listen with what to record into it, found neither"
            )
        return Station(folder, None, **options)
    if not known:
        session_folder.begin_for(folder, listen, serial, site, programme)
    source = listen.removesuffix(":motioncal")
    return Station(folder, lambda: source_of(source), **options)
