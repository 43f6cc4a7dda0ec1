"""From a source to the log of a session, in a thread of its own that does nothing else."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass

from tumble.bench.follow import growing_file
from tumble.bench.lines import Lines, numbers_in
from tumble.bench.order import Order
from tumble.bench.recorder import Recorder
from tumble.bench.sources import Ended, LineSource
from tumble.recording.session import Session

log = logging.getLogger(__name__)

READ_SECONDS = 0.05
SILENT_SECONDS = 2.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Received:
    """What has come so far: rows recorded, what was refused (a row whose time leaps too), late or repeated; whether the
    source has `ended`, for how long it has been `silent`, s, and what is wrong, in words."""

    source: str
    rows: int
    refused: int
    last_refused: str
    late: int
    repeated: int
    ended: bool
    silent: float
    trouble: tuple[str, ...]


class Intake:
    """Records a source into the log of a session until it is stopped."""

    def __init__(self, source: LineSource, session: Session, *, now: Callable[[], float] = time.monotonic) -> None:
        spec = session.log
        columns = spec.columns
        self.path = growing_file(spec)
        self.recorder = Recorder(self.path, ",".join(columns))
        self.source = source
        self.lines = Lines(columns=columns, clock=spec.time, refuse=self.recorder.refuse)
        self.order = Order(
            unordered=source.unordered,
            seconds=spec.time_factor,
            refuse=self.recorder.refuse,
            last=self._last(spec.time),
        )
        self._now, self._heard = now, now()
        self.rows, self.ended = 0, False
        self._failure = ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="intake", daemon=True)
        try:
            self._resume(spec.time_factor)
        except BaseException:
            self.recorder.close()
            raise

    def _last(self, clock: str | None) -> float | None:
        """The time of the last row that is recorded."""
        rows = self.lines.feed(self.recorder.last_line().encode() + b"\n") if clock is not None else []
        return rows[-1].time if rows else None

    def _resume(self, seconds: float) -> None:
        """Record what waited when the recording ended, and let the source go on from there if it can."""
        waited = [row for line in self.recorder.waiting() for row in self.lines.feed(line.encode() + b"\n")]
        self.recorder.append(self.order.feed(waited))
        self.recorder.hold(self.order.waiting)
        skip_to = getattr(self.source, "skip_to", None)
        if skip_to is not None and self.order.last is not None:
            skip_to(self.order.last * seconds)

    def start(self) -> None:
        """Begin to listen."""
        self._thread.start()

    def _run(self) -> None:
        with ExitStack() as ending:
            ending.callback(self._finish)
            ending.callback(self.source.close)
            while not self._stop.is_set() and not self.ended:
                self._take_next()

    def _take_next(self) -> None:
        """Record what comes next. An error costs what came with it, which is refused; the recording goes on."""
        data = b""
        try:
            data = self.source.read(READ_SECONDS)
            self.take(data)
        except Ended:
            self.take(b"\n")
            self.ended = True
        except Exception as error:
            failure = " ".join(f"an error of the program while receiving ({type(error).__name__}: {error})".split())
            if failure != self._failure:
                self._failure = failure
                log.error("what is received cannot be recorded", exc_info=error)
            self.recorder.refuse(data)
            self._stop.wait(READ_SECONDS)

    def _finish(self) -> None:
        """Leave a complete log."""
        self.recorder.append(self.order.end())
        self.recorder.hold([])
        self.recorder.close()

    def take(self, data: bytes) -> None:
        """Record what was received."""
        waited = bool(self.order.waiting)
        rows = self._rows(data) if data or waited else []
        if rows:
            self.recorder.append(rows)
            self.rows += len(rows)
            self._heard = self._now()
        if waited or self.order.waiting:
            self.recorder.hold(self.order.waiting)
        self.recorder.sync_if_due()

    def _rows(self, data: bytes) -> list[str]:
        """The rows that pass now. Where nothing is wrong with any of them, they are looked at together."""
        lines, whole = self.lines, self.lines.cut(data)
        if lines.clock is not None and lines.in_order:
            numbers = numbers_in(whole, len(lines.columns))
            if numbers is not None and self.order.passes(numbers[:, lines.columns.index(lines.clock)]):
                return whole[:-1].decode("ascii").split("\n")
        return self.order.feed(lines.rows(whole))

    def stop(self) -> None:
        """Stop listening and leave a complete log."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    @property
    def received(self) -> Received:
        """What has come so far."""
        silent = 0.0 if self.ended else self._now() - self._heard
        trouble = [said for said in (self.recorder.trouble, self.source.trouble, self._failure) if said]
        if self.order.restarted:
            trouble.append("the clock of the unit has started anew: this is another power-on, record it as one")
        if silent > SILENT_SECONDS and not self.source.trouble:
            trouble.append(f"nothing has come for {silent:.0f} s")
        return Received(
            source=self.source.name,
            rows=self.rows,
            refused=self.lines.refused + self.order.leapt,
            last_refused=self.lines.last_refused or ("a time far from the next" if self.order.leapt else ""),
            late=self.order.late,
            repeated=self.order.repeated,
            ended=self.ended,
            silent=silent,
            trouble=tuple(trouble),
        )
