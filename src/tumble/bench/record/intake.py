"""From a source to the log of a session, in a thread of its own that does nothing else."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from tumble.bench.record.lines import Lines, numbers_in
from tumble.bench.record.order import Order
from tumble.bench.record.recorder import Recorder, growing_file
from tumble.bench.record.sources import Ended, LineSource
from tumble.bench.state import Received
from tumble.recording.session import Session

log = logging.getLogger(__name__)

READ_SECONDS = 0.05
SILENT_SECONDS = 2.0
NOTHING_RECEIVED: Received = {"refused": 0, "why": "", "late": 0, "repeated": 0, "ended": False, "trouble": []}


class Intake:
    """Records a source into the log of a session until it is stopped; `rows` are recorded, and the source may have
    `ended`."""

    def __init__(self, source: LineSource, session: Session, *, now: Callable[[], float] = time.monotonic) -> None:
        spec = session.log
        self.source = source
        self.recorder = Recorder(growing_file(spec), ",".join(spec.columns))
        self.lines = Lines(columns=spec.columns, clock=spec.time, refuse=self.recorder.refuse)
        self._now, self._heard = now, now()
        self.rows, self.ended = 0, False
        self._failure = ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="intake", daemon=True)
        try:
            recorded = self.lines.feed(self.recorder.last_line().encode() + b"\n") if spec.time is not None else []
            self.order = Order(
                unordered=source.unordered,
                seconds=spec.time_factor,
                refuse=self.recorder.refuse,
                last=recorded[-1].time if recorded else None,
            )
            waited = [row for line in self.recorder.waiting() for row in self.lines.feed(line.encode() + b"\n")]
            self.recorder.append(self.order.feed(waited))
            self.recorder.hold(self.order.waiting)
            if self.order.last is not None:
                source.skip_to(self.order.last * spec.time_factor)
        except BaseException:
            self.recorder.close()
            raise

    def start(self) -> None:
        self._thread.start()

    def _run(self) -> None:
        try:
            while not self._stop.is_set() and not self.ended:
                self._take_next()
            self.source.close()
        finally:  # with a complete log
            self.recorder.append(self.order.end())
            self.recorder.hold([])
            self.recorder.close()

    def _take_next(self) -> None:
        """Record what comes next. An error costs what came with it, which is refused; the recording goes on."""
        data = b""
        try:
            data = self.source.read(READ_SECONDS)
            self._take(data)
        except Ended:
            self._take(b"\n")
            self.ended = True
        except Exception as error:
            failure = " ".join(f"an error of the program while receiving ({type(error).__name__}: {error})".split())
            if failure != self._failure:
                self._failure = failure
                log.error("what is received cannot be recorded", exc_info=error)
            self.recorder.refuse(data)
            self._stop.wait(READ_SECONDS)

    def _take(self, data: bytes) -> None:
        waited = bool(self.order.waiting)
        rows: list[str] = []
        if data or waited:
            whole = self.lines.cut(data)
            rows = self._sound(whole) or self.order.feed(self.lines.rows(whole))
        if rows:
            self.recorder.append(rows)
            self.rows += len(rows)
            self._heard = self._now()
        if waited or self.order.waiting:
            self.recorder.hold(self.order.waiting)
        self.recorder.sync_if_due()

    def _sound(self, whole: bytes) -> list[str]:
        """The rows in whole lines where nothing is wrong with any of them, so that they need be looked at together
        only; else none."""
        lines = self.lines
        numbers = numbers_in(whole, len(lines.columns)) if lines.clock is not None and lines.in_order else None
        if numbers is None or not self.order.passes(numbers[:, lines.columns.index(lines.clock or "")]):
            return []
        return whole[:-1].decode("ascii").split("\n")

    def stop(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    @property
    def received(self) -> Received:
        """What was wrong with what has come so far: what was refused (a row whose time leaps too), late or repeated."""
        silent = 0.0 if self.ended else self._now() - self._heard
        trouble = [said for said in (self.recorder.trouble, self.source.trouble, self._failure) if said]
        if self.order.restarted:
            trouble.append("the clock of the unit has started anew: this is another power-on, record it as one")
        if silent > SILENT_SECONDS and not self.source.trouble:
            trouble.append(f"nothing has come for {silent:.0f} s")
        return {
            "refused": self.lines.refused + self.order.leapt,
            "why": self.lines.last_refused or ("a time far from the next" if self.order.leapt else ""),
            "late": self.order.late,
            "repeated": self.order.repeated,
            "ended": self.ended,
            "trouble": trouble,
        }
