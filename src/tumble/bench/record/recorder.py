"""From a source to the log of a session: what is received is on disk before anything else is done with it.

A thread that does nothing else appends rows to the log in the order in which they are received, whatever their times
are: whoever reads the log decides which of them are wrong (`tumble.recording.rows`). Lines are appended whole, in one
write without a buffer, so that a process that is killed leaves all it has received, and are forced to the disk once a
second, so that a machine that loses its power leaves all but the last second. Where the disk takes no more, lines are
kept in memory and written when it does again; what is lost is whole lines.

Where the clock of the sensor starts anew, since it was reset or unplugged, another file of the log begins: so many rows
as agree on earlier times are no single wrong ones.
"""

from __future__ import annotations

import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path

import numpy as np

from tumble.bench.state import Received
from tumble.errors import InputError
from tumble.recording.live.lines import Lines, numbers_in
from tumble.recording.live.sources import Ended, LineSource
from tumble.recording.session import LogSpec, Session
from tumble.units import Array

log = logging.getLogger(__name__)

READ_SECONDS = 0.05
SILENT_SECONDS = 2.0
NOTHING_RECEIVED: Received = {"refused": 0, "why": "", "ended": False, "silent": False, "trouble": []}
SYNC_SECONDS = 0.9
KEPT_BYTES = 1 << 26
"""What is kept in memory while the disk takes nothing, at most."""
REFUSED_BYTES = 1 << 22
"""What is kept of what is no row, at most."""
NEXT_SECONDS = 1.0
"""A time that is farther from the one before belongs to another clock, or is wrong."""
AGREEING_ROWS = 20
"""So many rows whose times follow each other are right, wherever they are."""
_WRITE_BYTES = 1 << 20
_LINE_BYTES = 1 << 16
_LOCKED = 1 << 40
"""The byte that a lock is on where locks are of bytes: one that no log has."""


class Recorder:
    """A log file that grows by whole lines, and the file `refused` beside it of what was received and is no row.
    `trouble` says what the disk does not do."""

    def __init__(self, path: Path, header: str) -> None:
        """Go on with a log, or begin one with a header.

        Raises InputError if the log has another header, or another process is recording it."""
        self.path, self.refused = path, path.with_name("refused.txt")
        self.trouble: str | None = None
        self._lost = 0
        self._pending = bytearray()
        self._synced = time.monotonic()
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0), 0o666)
        try:
            try:  # keep other processes from recording the same log, as long as it is open
                if sys.platform == "win32":
                    import msvcrt

                    os.lseek(self._descriptor, _LOCKED, os.SEEK_SET)
                    msvcrt.locking(self._descriptor, msvcrt.LK_NBLCK, 1)
                else:
                    import fcntl

                    fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise InputError(
                    f"{path}: expected a log that nobody records, found one that another process does"
                ) from None
            if not self._whole_lines(keep_rest=True):
                self.append(header.encode() + b"\n")
                return
            first = self._at(_LINE_BYTES, 0).split(b"\n", 1)[0]
            found = first.decode("utf-8", errors="replace").strip()
            if found != header:
                raise InputError(f"{path}: expected the columns {header}, found {found}; record into another folder")
        except BaseException:
            os.close(self._descriptor)
            raise

    def _at(self, count: int, start: int) -> bytes:
        """So many bytes of the file from a place on; what is appended is at its end all the same."""
        os.lseek(self._descriptor, start, os.SEEK_SET)
        return os.read(self._descriptor, count)

    def _whole_lines(self, *, keep_rest: bool) -> int:
        """Cut a line that was not finished off the file; how many bytes are left of it."""
        size = stop = os.fstat(self._descriptor).st_size
        whole = 0
        while stop > 0 and not whole:
            start = max(0, stop - _WRITE_BYTES)
            whole = self._at(stop - start, start).rfind(b"\n") + 1
            whole, stop = whole and start + whole, start
        if whole < size and keep_rest:
            self.refuse(self._at(min(size - whole, _WRITE_BYTES), whole))
        os.ftruncate(self._descriptor, whole)
        return whole

    def append(self, lines: bytes) -> None:
        """Add whole lines to the log; what the disk does not take now is tried again with the next."""
        self._pending += lines
        try:
            while self._pending:
                written = os.write(self._descriptor, self._pending[:_WRITE_BYTES])
                del self._pending[:written]
            self.trouble = f"{self._lost} samples are lost, which the disk did not take" if self._lost else None
        except OSError as error:
            if len(self._pending) > KEPT_BYTES:  # what is behind the last whole line of so many bytes is given up
                kept_bytes = self._pending.rfind(b"\n", 0, KEPT_BYTES) + 1
                self._lost += self._pending.count(b"\n", kept_bytes)
                del self._pending[kept_bytes:]
            kept = f"{len(self._pending) / 1e6:.1f} MB are kept in memory"
            lost = f", {self._lost} samples are lost" if self._lost else ""
            self.trouble = f"the disk takes nothing: {error.strerror}; {kept}{lost}"

    def refuse(self, raw: bytes) -> None:
        """Keep what was received and is no row of the log."""
        with self._troubled(), self.refused.open("ab") as file:
            if file.tell() < REFUSED_BYTES:
                file.write(raw.rstrip(b"\n") + b"\n")

    @contextmanager
    def _troubled(self) -> Iterator[None]:
        """What the disk does not do is said, and the recording goes on."""
        try:
            yield
        except OSError as error:
            self.trouble = f"the disk takes nothing: {error.strerror}"

    def take_back(self, lines: bytes) -> None:
        """Cut the last lines off the log, which were appended as these."""
        os.ftruncate(self._descriptor, os.fstat(self._descriptor).st_size - len(lines))

    def last_line(self) -> bytes:
        """The last line of the log as it is now."""
        size = os.fstat(self._descriptor).st_size
        start = max(0, size - _LINE_BYTES)
        return self._at(size - start, start).rstrip(b"\n").rpartition(b"\n")[2]

    def sync_if_due(self) -> None:
        """Force the log to the disk if that was not done for a second."""
        if time.monotonic() - self._synced >= SYNC_SECONDS:
            if self._pending:
                self.append(b"")
            with self._troubled():
                os.fsync(self._descriptor)
            self._synced = time.monotonic()

    def close(self) -> None:
        """End the recording; it may go on later. What the disk does not take now is lost, and the log ends with a whole
        line."""
        self.append(b"")
        if self._pending:
            self._lost += self._pending.count(b"\n")
            self._pending.clear()
            self.trouble = f"{self._lost} samples are lost, which the disk did not take"
            with self._troubled():
                self._whole_lines(keep_rest=False)
        with self._troubled():
            os.fsync(self._descriptor)
        os.close(self._descriptor)


def recorded_files(spec: LogSpec) -> list[Path]:
    """The files of a log, of which the last grows."""
    return [file for file in spec.files if isinstance(file, Path)]


def _rows_of(files: Sequence[Path]) -> Iterator[bytes]:
    """The rows of a log as it is now, from the first."""
    for path in files:
        with path.open("rb") as file:
            file.readline()
            yield from file


class Intake:
    """Records a source into the log of a session until it is stopped. Of the `files` of the log those behind the
    session's own were begun where the clock started anew; `rows` were recorded; `ended` says whether the source has."""

    def __init__(self, source: LineSource, session: Session, *, now: Callable[[], float] = time.monotonic) -> None:
        spec = session.log
        self.source = source
        self.files = recorded_files(spec)
        self.recorder = Recorder(self.files[-1], ",".join(spec.columns))
        self.lines = Lines(columns=spec.columns, clock=spec.time, refuse=lambda raw: self.recorder.refuse(raw))
        self._clock = None if spec.time is None or spec.regular else spec.columns.index(spec.time)
        self._second = spec.time_factor
        self._last: float | None = None
        """Time of the last row in its place, s."""
        self._apart = list[tuple[bytes, float]]()
        """The last rows, with their times, where these follow each other and not that one."""
        if self._clock is not None:
            with suppress(ValueError, IndexError):
                self._last = float(self.recorder.last_line().split(b",")[self._clock]) * self._second
        self._now, self._heard = now, now()
        self.rows, self.ended = 0, False
        self._failure = ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="intake", daemon=True)
        self._recorded: Iterator[bytes] | None = None
        """Rows that are in the log already and that the source, which begins anew, sends again."""
        if source.begins_anew:
            self._recorded = _rows_of(self.files)
            source.hurry(sum(1 for _ in _rows_of(self.files)))

    def start(self) -> None:
        """Begin to record."""
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
                except Exception as error:  # costs what came with it, which is refused; the recording goes on
                    failure = f"an error of the program while receiving ({type(error).__name__}: {error})"
                    if (failure := " ".join(failure.split())) != self._failure:
                        self._failure = failure
                        log.error("what is received cannot be recorded", exc_info=error)
                    self.recorder.refuse(data)
                    self._stop.wait(READ_SECONDS)
            self.source.close()
        finally:  # with a complete log
            self.recorder.close()

    def _take(self, data: bytes) -> None:
        """Append the rows in what was received."""
        whole = self.lines.cut(data)
        plain = self.lines.in_order and self._recorded is None
        numbers = numbers_in(whole, len(self.lines.columns)) if plain else None
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
                self._sort(whole, times * self._second)
        self.recorder.sync_if_due()

    def _append(self, rows: bytes) -> None:
        self.recorder.append(rows)
        self.rows += rows.count(b"\n")

    def _sort(self, whole: bytes, times: Array) -> None:
        """Append rows of these times, s, which may be wrong. Where as many as agree are earlier than those before, the
        clock has started anew, and they are the first of another file."""
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
        """Go on in another file, log-2.csv behind log.csv, with the last rows of the present one. In that where the
        disk takes nothing."""
        first = self.files[0]
        names = (first.with_stem(f"{first.stem}-{number}") for number in count(2))
        path = next(each for each in names if not each.exists())
        if self.recorder.trouble:
            return
        with suppress(OSError, InputError):
            begun = Recorder(path, ",".join(self.lines.columns))
            begun.append(rows)
            self.recorder.take_back(rows)
            self.recorder.close()
            self.recorder = begun
            self.files.append(path)

    def _is_new(self, row: bytes) -> bool:
        """Whether a row is not in the log yet; from the first new one on all are."""
        if self._recorded is not None and next(self._recorded, None) == row:
            return False
        self._recorded = None
        return True

    def stop(self) -> None:
        """End the recording."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    @property
    def received(self) -> Received:
        """What was wrong with what has come so far."""
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
