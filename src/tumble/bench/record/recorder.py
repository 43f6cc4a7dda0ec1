"""Recording of a source: everything received is written to the log before it is processed.

A thread appends rows in the order of their arrival, whatever their times are; the readers of the log decide which times
are wrong (`tumble.recording.rows`). Whole lines are appended, each batch in one unbuffered write, so that a killed
process loses nothing, and are synchronised once a second, so that a power failure loses at most the last second. While
the disk accepts nothing, lines are kept in memory; only whole lines are lost.

When the clock of the sensor restarts (reset or unplugged), another file of the log begins. A restart is recognised by
consecutive rows that agree on earlier times, to distinguish it from single wrong times.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path

import numpy as np

from tumble.bench.state import Received
from tumble.errors import InputError
from tumble.files import lock
from tumble.recording.live.lines import Lines, numbers_in
from tumble.recording.live.sources import Ended, LineSource
from tumble.recording.session import LogSpec, Session
from tumble.units import Array

log = logging.getLogger(__name__)

READ_SECONDS = 0.05
SILENT_SECONDS = 2.0
NOTHING_RECEIVED: Received = {"refused": 0, "why": "", "ended": False, "silent": False, "trouble": []}
SYNC_SECONDS = 0.9
KEPT_BYTES = 1 << 26  # maximum kept in memory while the disk accepts nothing
REFUSED_BYTES = 1 << 22  # maximum kept of input that is not a row
NEXT_SECONDS = 1.0  # largest step between consecutive times of one clock
AGREEING_ROWS = 20  # consecutive rows whose times are trusted
_WRITE_BYTES = 1 << 20
_LINE_BYTES = 1 << 16


class Recorder:
    """A log file that grows by whole lines, and the file `refused` beside it of input that is not a row.

    `trouble` describes a failure of the disk."""

    def __init__(self, path: Path, header: str) -> None:
        """Continue a log, or begin one with a header.

        Raises InputError if the log has another header, or another process is recording it."""
        self.path, self.refused = path, path.with_name("refused.txt")
        self.trouble: str | None = None
        self._lost = 0
        self._pending = bytearray()
        self._synced = time.monotonic()
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0), 0o666)
        try:
            if not lock(self._descriptor):  # against other recorders, while it is open
                raise InputError(f"{path}: expected a log that nobody records, found one that another process does")
            if not self._truncate_to_lines(keep_rest=True):
                self.append(header.encode() + b"\n")
                return
            first = self._read_at(_LINE_BYTES, 0).split(b"\n", 1)[0]
            found = first.decode("utf-8", errors="replace").strip()
            if found != header:
                raise InputError(f"{path}: expected the columns {header}, found {found}; record into another folder")
        except BaseException:
            os.close(self._descriptor)
            raise

    def _read_at(self, count: int, start: int) -> bytes:
        """Read bytes of the file from a position on; appending is not affected."""
        os.lseek(self._descriptor, start, os.SEEK_SET)
        return os.read(self._descriptor, count)

    def _truncate_to_lines(self, *, keep_rest: bool) -> int:
        """Remove an unfinished last line from the file, and return the remaining number of bytes."""
        size = stop = os.fstat(self._descriptor).st_size
        whole = 0
        while stop > 0 and not whole:
            start = max(0, stop - _WRITE_BYTES)
            whole = self._read_at(stop - start, start).rfind(b"\n") + 1
            whole, stop = whole and start + whole, start
        if whole < size and keep_rest:
            self.refuse(self._read_at(min(size - whole, _WRITE_BYTES), whole))
        os.ftruncate(self._descriptor, whole)
        return whole

    def append(self, lines: bytes) -> None:
        """Append whole lines to the log; those that the disk does not accept are tried again with the next."""
        self._pending += lines
        try:
            while self._pending:
                written = os.write(self._descriptor, self._pending[:_WRITE_BYTES])
                del self._pending[:written]
            self.trouble = f"{self._lost} samples are lost, which the disk did not take" if self._lost else None
        except OSError as error:
            if len(self._pending) > KEPT_BYTES:  # drop the lines beyond
                kept_bytes = self._pending.rfind(b"\n", 0, KEPT_BYTES) + 1
                self._lost += self._pending.count(b"\n", kept_bytes)
                del self._pending[kept_bytes:]
            kept = f"{len(self._pending) / 1e6:.1f} MB are kept in memory"
            lost = f", {self._lost} samples are lost" if self._lost else ""
            self.trouble = f"the disk takes nothing: {error.strerror}; {kept}{lost}"

    def refuse(self, raw: bytes) -> None:
        """Keep input that is not a row of the log."""
        with self._report_errors(), self.refused.open("ab") as file:
            if file.tell() < REFUSED_BYTES:
                file.write(raw.rstrip(b"\n") + b"\n")

    @contextmanager
    def _report_errors(self) -> Iterator[None]:
        """Turn errors of the disk into `trouble`."""
        try:
            yield
        except OSError as error:
            self.trouble = f"the disk takes nothing: {error.strerror}"

    def take_back(self, lines: bytes) -> None:
        """Remove the last lines from the log, which were appended as these."""
        os.ftruncate(self._descriptor, os.fstat(self._descriptor).st_size - len(lines))

    def last_line(self) -> bytes:
        """Return the last line of the log."""
        size = os.fstat(self._descriptor).st_size
        start = max(0, size - _LINE_BYTES)
        return self._read_at(size - start, start).rstrip(b"\n").rpartition(b"\n")[2]

    def sync_if_due(self) -> None:
        """Synchronise the log with the disk if that was not done for a second."""
        if time.monotonic() - self._synced >= SYNC_SECONDS:
            if self._pending:
                self.append(b"")
            with self._report_errors():
                os.fsync(self._descriptor)
            self._synced = time.monotonic()

    def close(self) -> None:
        """End the recording; it can be continued later. Lines that the disk does not accept now are lost."""
        self.append(b"")
        if self._pending:
            self._lost += self._pending.count(b"\n")
            self._pending.clear()
            self.trouble = f"{self._lost} samples are lost, which the disk did not take"
            with self._report_errors():
                self._truncate_to_lines(keep_rest=False)
        with self._report_errors():
            os.fsync(self._descriptor)
        os.close(self._descriptor)


def recorded_files(spec: LogSpec) -> list[Path]:
    """Return the files of a log, the growing one last."""
    return [file for file in spec.files if isinstance(file, Path)]


def _read_rows(files: Sequence[Path]) -> Iterator[bytes]:
    """Yield the rows of a log."""
    for path in files:
        with path.open("rb") as file:
            file.readline()
            yield from file


class Intake:
    """Records a source into the log of a session until it is stopped.

    `files` are those of the session and further ones that were begun after a restart of the clock; `rows` is the number
    of recorded rows; `ended` is True after the end of the source."""

    def __init__(self, source: LineSource, session: Session, *, now: Callable[[], float] = time.monotonic) -> None:
        spec = session.log
        self.source = source
        self.files = recorded_files(spec)
        self.recorder = Recorder(self.files[-1], ",".join(spec.columns))
        self.lines = Lines(columns=spec.columns, clock=spec.time, refuse=lambda raw: self.recorder.refuse(raw))
        self._clock = None if spec.time is None or spec.regular else spec.columns.index(spec.time)
        self._second = spec.time_factor
        self._last: float | None = None  # time of the last trusted row, s
        self._apart = list[tuple[bytes, float]]()  # later rows whose times agree with each other but not with `_last`
        if self._clock is not None:
            with suppress(ValueError, IndexError):
                self._last = float(self.recorder.last_line().split(b",")[self._clock]) * self._second
        self._now, self._heard = now, now()
        self.rows, self.ended = 0, False
        self._failure = ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="intake", daemon=True)
        self._recorded: Iterator[bytes] | None = None  # rows in the log, which a restarted source sends again
        if source.begins_anew:
            self._recorded = _read_rows(self.files)
            source.hurry(sum(1 for _ in _read_rows(self.files)))

    def start(self) -> None:
        """Start the recording thread."""
        self._thread.start()

    def _run(self) -> None:
        try:
            while not self._stop.is_set() and not self.ended:
                data = b""
                try:
                    data = self.source.read(READ_SECONDS)
                    self._take(data)
                except Ended:
                    self._take(b"\n")
                    self.ended = True
                except Exception as error:  # refuse the data and continue
                    failure = f"an error of the program while receiving ({type(error).__name__}: {error})"
                    if (failure := " ".join(failure.split())) != self._failure:
                        self._failure = failure
                        log.error("what is received cannot be recorded", exc_info=error)
                    self.recorder.refuse(data)
                    self._stop.wait(READ_SECONDS)
            self.source.close()
        finally:
            self.recorder.close()

    def _take(self, data: bytes) -> None:
        """Append the rows in received data."""
        whole = self.lines.cut(data)
        is_plain = self.lines.in_order and self._recorded is None
        numbers = numbers_in(whole, len(self.lines.columns)) if is_plain else None
        if numbers is not None:
            times = None if self._clock is None else numbers[:, self._clock]
        else:
            rows = [(row.text.encode() + b"\n", row.time) for row in self.lines.rows(whole)]
            rows = [each for each in rows if self._is_new(each[0])]
            whole = b"".join(row for row, _ in rows)
            times = None if self._clock is None else np.array([time for _, time in rows], dtype=float)
        if whole:
            self._heard = self._now()
            if times is None:
                self._append(whole)
            else:
                self._append_timed(whole, times * self._second)
        self.recorder.sync_if_due()

    def _append(self, rows: bytes) -> None:
        self.recorder.append(rows)
        self.rows += rows.count(b"\n")

    def _append_timed(self, whole: bytes, times: Array) -> None:
        """Append rows with these times, s, some of which may be wrong.

        If AGREEING_ROWS consecutive rows are earlier than those before, the clock has restarted, and they become the
        first of another file."""
        steps = np.diff(times, prepend=times[0] if self._last is None else self._last)
        if not self._apart and np.abs(steps).max() <= NEXT_SECONDS:
            self._append(whole)
            self._last = float(times[-1])
            return
        for row, at in zip(whole.splitlines(keepends=True), times.tolist(), strict=True):
            self._append(row)
            if self._last is None or abs(at - self._last) <= NEXT_SECONDS:
                self._last, self._apart = at, []
                continue
            if self._apart and not 0.0 <= at - self._apart[-1][1] <= NEXT_SECONDS:
                self._apart = []
            self._apart.append((row, at))
            if len(self._apart) >= AGREEING_ROWS and at > self._apart[0][1]:
                if at < self._last:
                    self._begin_file(b"".join(row for row, _ in self._apart))
                self._last, self._apart = at, []

    def _begin_file(self, rows: bytes) -> None:
        """Continue in another file, log-2.csv after log.csv, and move the last rows into it, unless the disk accepts
        nothing."""
        first = self.files[0]
        names = (first.with_stem(f"{first.stem}-{number}") for number in count(2))
        path = next(each for each in names if not each.exists())
        if self.recorder.trouble:
            return
        with suppress(OSError, InputError):
            following = Recorder(path, ",".join(self.lines.columns))
            following.append(rows)
            self.recorder.take_back(rows)
            self.recorder.close()
            self.recorder = following
            self.files.append(path)

    def _is_new(self, row: bytes) -> bool:
        """Return True for a row that is not yet in the log, and for all later rows."""
        if self._recorded is not None and next(self._recorded, None) == row:
            return False
        self._recorded = None
        return True

    def stop(self) -> None:
        """Stop the recording."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    @property
    def received(self) -> Received:
        """State of the input, with its troubles."""
        silent = 0.0 if self.ended else self._now() - self._heard
        trouble = [each for each in (self.recorder.trouble, self.source.trouble, self._failure) if each]
        if silent > SILENT_SECONDS and not self.source.trouble:
            trouble.append(f"nothing has come for {silent:.0f} s")
        return {
            "refused": self.lines.refused,
            "why": self.lines.last_refused,
            "ended": self.ended,
            "silent": silent > SILENT_SECONDS or (self.source.trouble is not None and not self.ended),
            "trouble": trouble,
        }
