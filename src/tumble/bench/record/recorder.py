"""From a source to the log of a session: what is received is on disk before anything else is done with it, by a thread
that does nothing else.

Lines are appended whole, in one write without a buffer, so that a process that is killed leaves all it has received,
and are forced to the disk once a second, so that a machine that loses its power leaves all but the last second. Where
the disk takes no more, lines are kept in memory and written when it does again; what is lost is whole lines.
"""

from __future__ import annotations

import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from tumble.bench.record.order import Order
from tumble.bench.state import Received
from tumble.errors import InputError
from tumble.recording.live.lines import Lines, numbers_in
from tumble.recording.live.sources import Ended, LineSource
from tumble.recording.session import LogSpec, Session

log = logging.getLogger(__name__)

READ_SECONDS = 0.05
SILENT_SECONDS = 2.0
NOTHING_RECEIVED: Received = {"refused": 0, "why": "", "late": 0, "repeated": 0, "ended": False, "trouble": []}
SYNC_SECONDS = 0.9
KEPT_BYTES = 1 << 26
"""What is kept in memory while the disk takes nothing, at most."""
REFUSED_BYTES = 1 << 22
"""What is kept of what was no row, at most."""
_WRITE_BYTES = 1 << 20
_LINE_BYTES = 1 << 16
_LOCKED = 1 << 40
"""The byte that a lock is on where locks are of bytes: one that no log has."""


class Recorder:
    """A log file that grows by whole lines. `refused` is the file beside it for what was received and is no row;
    `held` that for rows which wait for late ones before them; `trouble` is what the disk does not do, in words."""

    def __init__(self, path: Path, header: str) -> None:
        """Go on with a log, or begin one with a header.

        Raises InputError if the log has another header, or another process is recording it."""
        self.path = path
        self.refused, self.held = path.with_name("refused.txt"), path.with_name("held.csv")
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
                self.append([header])
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

    def append(self, lines: Iterable[str]) -> None:
        """Add lines to the log; what the disk does not take now is tried again with the next."""
        self._pending += _text(lines).encode("utf-8")
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

    def hold(self, lines: Iterable[str]) -> None:
        text = _text(lines)
        if text or self.held.exists():
            with self._troubled():
                self.held.write_text(text, encoding="utf-8")

    @contextmanager
    def _troubled(self) -> Iterator[None]:
        """What the disk does not do is said, and the recording goes on."""
        try:
            yield
        except OSError as error:
            self.trouble = f"the disk takes nothing: {error.strerror}"

    def waiting(self) -> list[str]:
        """Whole rows that waited when the recording ended."""
        if not self.held.exists():
            return []
        return self.held.read_text(encoding="utf-8", errors="replace").split("\n")[:-1]

    def last_line(self) -> str:
        """The last row of the log, empty where there is only a header."""
        size = os.fstat(self._descriptor).st_size
        tail = self._at(_LINE_BYTES, max(0, size - _LINE_BYTES))
        lines = tail.decode("utf-8", errors="replace").rstrip("\n").split("\n")
        return lines[-1] if len(lines) > 1 or size > _LINE_BYTES else ""

    def sync_if_due(self) -> None:
        """Force the log to the disk if that was not done for a second."""
        if time.monotonic() - self._synced >= SYNC_SECONDS:
            if self._pending:
                self.append([])
            with self._troubled():
                os.fsync(self._descriptor)
            self._synced = time.monotonic()

    def close(self) -> None:
        """End the recording; it may go on later. What the disk does not take now is lost, and the log ends with a whole
        line."""
        self.append([])
        if self._pending:
            self._lost += self._pending.count(b"\n")
            self._pending.clear()
            self.trouble = f"{self._lost} samples are lost, which the disk did not take"
            with self._troubled():
                self._whole_lines(keep_rest=False)
        with self._troubled():
            os.fsync(self._descriptor)
        os.close(self._descriptor)
        if self.held.exists() and not self.held.stat().st_size:
            self.held.unlink()


def growing_file(spec: LogSpec) -> Path:
    """The last file of a log, which is the one that grows."""
    path = spec.files[-1]
    assert isinstance(path, Path)
    return path


def _text(lines: Iterable[str]) -> str:
    return "".join(f"{line}\n" for line in lines)


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
            self.recorder.append(self.order.end())
            self.recorder.hold([])
            self.recorder.close()

    def _take(self, data: bytes) -> None:
        waited = bool(self.order.waiting)
        rows: list[str] = []
        if data or waited:
            lines, whole = self.lines, self.lines.cut(data)
            # where nothing is wrong with any of the rows they need be looked at together only
            numbers = numbers_in(whole, len(lines.columns)) if lines.clock is not None and lines.in_order else None
            if numbers is not None and self.order.passes(numbers[:, lines.columns.index(lines.clock or "")]):
                rows = whole[:-1].decode("ascii").split("\n")
            rows = rows or self.order.feed(lines.rows(whole))
        if rows:
            self.recorder.append(rows)
            self.rows += len(rows)
            self._heard = self._now()
        if waited or self.order.waiting:
            self.recorder.hold(self.order.waiting)
        self.recorder.sync_if_due()

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
