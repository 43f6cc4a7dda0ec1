"""Where rows come from: whatever is named after --listen, as bytes of lines.

    file:PATH   replay:FOLDER@20x   stdin   udp:[HOST:]PORT   tcp:[HOST:]PORT   serial:DEVICE:BAUD
    mavlink:udp:[HOST:]PORT   mavlink:DEVICE:BAUD   simulator[:PROGRAMME]

A source that is interrupted says so in `trouble` and tries again; only a file that is replayed, and standard input,
come to an end.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import socket
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

from tumble.bench.lines import MOTIONCAL_COLUMNS
from tumble.documents import whole_number
from tumble.errors import InputError, needs_extra
from tumble.recording.session import LogSpec
from tumble.recording.session_file import read_session

_READ_BYTES = 1 << 16
_AGAIN_SECONDS = 0.5
_SILENT_SECONDS = 2.0
_BUFFER_BYTES = 1 << 22
LOOPBACK = "127.0.0.1"


class Ended(Exception):  # noqa: N818
    """Nothing comes from this source any more."""


class LineSource(Protocol):
    """Something that sends lines."""

    name: str
    unordered: bool
    """Whether rows may come in another order than they were sent in."""
    trouble: str | None

    def read(self, timeout: float) -> bytes:
        """What has come, nothing after `timeout` s without. Raises Ended."""

    def close(self) -> None:
        """Listen no more."""


def in_si() -> dict[str, Any]:
    """The table [log] of a source that sends t, ax, ay, az, gx, gy, gz in SI."""
    return {
        "file": "log.csv",
        "time": "t",
        "accel": {"columns": ["ax", "ay", "az"], "unit": "m/s^2"},
        "gyro": {"columns": ["gx", "gy", "gz"], "unit": "rad/s"},
    }


MOTIONCAL_LOG: Mapping[str, Any] = {
    "file": "log.csv",
    "time": MOTIONCAL_COLUMNS[0],
    "regular": True,
    "accel": {"columns": list(MOTIONCAL_COLUMNS[1:4]), "unit": "count", "scale": 8192.0, "scale_per": "g"},
    "gyro": {"columns": list(MOTIONCAL_COLUMNS[4:7]), "unit": "count", "scale": 16.0, "scale_per": "deg/s"},
    "magnetometer": {"columns": list(MOTIONCAL_COLUMNS[7:]), "unit": "uT"},
}
"""The table [log] of what MotionCal's sketches send: 8192 a g, 16 a °/s, 10 a µT."""


class GrowingFile:
    """A text file that another program writes: from its beginning, or from a place on."""

    unordered = False

    def __init__(self, path: Path) -> None:
        self.name, self.path = f"file:{path}", path
        self.trouble: str | None = None
        if not path.is_file():
            raise InputError(f"--listen {self.name}: expected a file, found none")
        self._file = path.open("rb", buffering=0)

    def read(self, timeout: float) -> bytes:
        data = self._file.read(_READ_BYTES) or b""
        if not data:
            time.sleep(timeout)
        return data

    def close(self) -> None:
        self._file.close()


class StandardInput:
    """Lines on standard input."""

    name, unordered = "stdin", False
    trouble: str | None = None

    def __init__(self, descriptor: int | None = None) -> None:
        if descriptor is None and sys.stdin is None:
            raise InputError("--listen stdin: expected standard input, found it closed")
        self._descriptor = sys.stdin.fileno() if descriptor is None else descriptor

    def read(self, timeout: float) -> bytes:
        if not select.select([self._descriptor], [], [], timeout)[0]:
            return b""
        data = os.read(self._descriptor, _READ_BYTES)
        if not data:
            raise Ended
        return data

    def close(self) -> None:
        """Standard input stays open."""


class Udp:
    """Datagrams of whole lines."""

    unordered = True

    def __init__(self, host: str, port: int) -> None:
        self.name = f"udp:{host}:{port}"
        self.trouble: str | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
        _bound(self._socket, host, port, self.name)
        self.port = self._socket.getsockname()[1]

    def read(self, timeout: float) -> bytes:
        out = bytearray()
        while select.select([self._socket], [], [], 0.0 if out else timeout)[0] and len(out) < _READ_BYTES:
            out += self._socket.recv(_READ_BYTES)
            if not out.endswith(b"\n"):
                out += b"\n"
        return bytes(out)

    def close(self) -> None:
        self._socket.close()


class Tcp:
    """One connection at a time that sends lines; when it ends, the next is waited for. One that has sent nothing for
    two seconds gives way to the next: a sender that has lost its power ends no connection."""

    unordered = False

    def __init__(self, host: str, port: int) -> None:
        self.name = f"tcp:{host}:{port}"
        self.trouble: str | None = None
        self._listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        _bound(self._listening, host, port, self.name)
        self._listening.listen(1)
        self.port = self._listening.getsockname()[1]
        self._connection: socket.socket | None = None
        self._heard = 0.0

    def read(self, timeout: float) -> bytes:
        waited_for = [self._listening] if self._connection is None else [self._connection]
        if self._connection is not None and time.monotonic() - self._heard > _SILENT_SECONDS:
            waited_for.append(self._listening)
        ready = select.select(waited_for, [], [], timeout)[0]
        if self._connection in ready:
            return self._received(self._connection)
        if self._listening not in ready:
            return b""
        if self._connection is not None:
            self._connection.close()
        self._connection, _ = self._listening.accept()
        self._connection.setblocking(False)
        self.trouble, self._heard = None, time.monotonic()
        return b"\n"

    def _received(self, connection: socket.socket) -> bytes:
        """What a connection has sent."""
        self._heard = time.monotonic()
        try:
            data = connection.recv(_READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            connection.close()
            self._connection, self.trouble = None, "the connection ended; the next is waited for"
            return b"\n"
        return data

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()
        self._listening.close()


def _bound(made: socket.socket, host: str, port: int, name: str) -> None:
    try:
        made.bind((host, port))
    except OSError as error:
        made.close()
        raise InputError(f"--listen {name}: expected a port that is free, found: {error.strerror}") from None


class Serial:
    """A serial line; when the cable is pulled, it is opened again as soon as it is there."""

    unordered = False

    def __init__(self, device: str, baud: int) -> None:
        with needs_extra("a serial line", "bench", "serial"):
            import serial
        self.name = f"serial:{device}:{baud}"
        self.trouble: str | None = None
        self._open: Callable[[], Any] = lambda: serial.Serial(device, baud, timeout=0)
        self._errors = (serial.SerialException, OSError)
        self._port: Any = None
        try:
            self._port = self._open()
        except self._errors as error:
            raise InputError(f"--listen {self.name}: expected a serial line, found: {_said(error)}") from None

    def read(self, timeout: float) -> bytes:
        if self._port is None and not self._again():
            time.sleep(min(timeout, _AGAIN_SECONDS))
            return b""
        try:
            if not select.select([self._port.fileno()], [], [], timeout)[0]:
                return b""
            data: bytes = self._port.read(_READ_BYTES)
            if not data:
                raise OSError("the line is closed")
        except self._errors as error:
            self.trouble = f"the serial line is gone: {_said(error)}; it is waited for"
            with contextlib.suppress(*self._errors):
                self._port.close()
            self._port = None
            return b"\n"
        return data

    def _again(self) -> bool:
        try:
            self._port, self.trouble = self._open(), None
        except self._errors:
            return False
        return True

    def close(self) -> None:
        if self._port is not None:
            self._port.close()


def _said(error: Exception) -> str:
    return " ".join(str(getattr(error, "strerror", None) or error).split())


class Replay:
    """The log of a session, as fast as it was recorded or so many times as fast; `speed` infinite: at once. That of a
    CSV file with commas as it is written there; that of another file as lines of CSV."""

    unordered = False

    def __init__(self, folder: Path, speed: float) -> None:
        self.name, self.speed = f"replay:{folder.name}@{speed:g}x", speed
        self.trouble: str | None = None
        self.session = read_session(folder)
        log = self.session.log
        file = log.files[0]
        if len(log.files) > 1 or not isinstance(file, Path) or log.clock:
            raise InputError(
                f"--listen replay:{folder}: expected a session of one file with times in seconds or none, found "
                "another; replay a session in that form"
            )
        self._open = contextlib.ExitStack()
        if is_recorded(log):
            self._file = self._open.enter_context(file.open("rb"))
            self._header = self._file.readline()
            names = self._header.decode("utf-8-sig").strip().split(",")
            lines: Iterator[bytes] = iter(self._file)
        else:
            self._header, names = ",".join(log.columns).encode() + b"\n", list(log.columns)
            lines = _as_csv(log, file)
        self._clock = None if log.time is None else names.index(log.time)
        self._scale = log.time_factor if log.rate is None else 1.0 / log.rate
        self._lines = self._timed(lines)
        self._next: tuple[float, bytes] | None = next(self._lines, None)
        self._begun: tuple[float, float] | None = None
        self._said_header = False

    def skip_to(self, at: float) -> None:
        """Leave out the rows up to this time of the log, s."""
        while self._next is not None and self._next[0] <= at * (1.0 + 1e-15):
            self._next = next(self._lines, None)

    def _timed(self, lines: Iterator[bytes]) -> Iterator[tuple[float, bytes]]:
        at = 0.0
        for number, line in enumerate(lines, 1):
            if self._clock is None:
                yield number * self._scale, line
                continue
            with contextlib.suppress(ValueError, IndexError):
                found = float(line.split(b",")[self._clock]) * self._scale
                at = found if math.isfinite(found) else at
                yield at, line

    def read(self, timeout: float) -> bytes:
        if not self._said_header:
            self._said_header = True
            return self._header
        if self._next is None:
            raise Ended
        if self._begun is None:
            self._begun = time.monotonic(), self._next[0]
        started, first = self._begun
        until = time.monotonic() + timeout
        due = started + (self._next[0] - first) / self.speed
        if due > until:
            time.sleep(timeout)
            return b""
        time.sleep(max(0.0, due - time.monotonic()))
        return self._due(first + (time.monotonic() - started) * self.speed)

    def _due(self, until: float) -> bytes:
        out = bytearray()
        while self._next is not None and self._next[0] <= until and len(out) < _READ_BYTES:
            out += self._next[1]
            self._next = next(self._lines, None)
        return bytes(out)

    def close(self) -> None:
        self._open.close()


def is_recorded(log: LogSpec) -> bool:
    """Whether a log is written as the bench writes it: one CSV file with commas, with its names in the first line."""
    file = log.files[0]
    plain = len(log.files) == 1 and isinstance(file, Path) and file.suffix == ".csv"
    return plain and log.dialect is None and not log.clock


def _as_csv(log: LogSpec, file: Path) -> Iterator[bytes]:
    """The rows of a file as lines of the columns of its log, to the last digit; what could not be read is nan."""
    from tumble.recording.readers import source_of as reader_of

    for table, _ in reader_of(file, log.dialect).tables(log.columns):
        for row in table.iter_rows():
            yield ",".join(map(repr, row)).encode("ascii") + b"\n"


def source_of(text: str) -> LineSource:
    """The source that is meant by what stands after --listen. Raises InputError, one line, for anything else."""
    kind, _, rest = text.partition(":")
    if kind == "stdin" and not rest:
        return StandardInput()
    if kind == "file" and rest:
        return GrowingFile(Path(rest))
    if kind == "replay" and rest:
        folder, _, speed = rest.rpartition("@") if "@" in rest else (rest, "", "1x")
        return Replay(Path(folder), _speed(text, speed))
    if kind in ("udp", "tcp"):
        host, port = _address(text, rest)
        return Udp(host, port) if kind == "udp" else Tcp(host, port)
    if kind == "serial" and rest:
        return Serial(*_line(text, rest))
    if kind == "mavlink" and rest:
        from tumble.bench.mavlink import Mavlink

        return Mavlink(rest)
    if kind == "simulator":
        from tumble.bench.virtual_table import VirtualTable

        return VirtualTable(rest or "rough-table")
    raise InputError(
        "--listen: expected file:PATH, replay:FOLDER@20x, stdin, udp:PORT, tcp:PORT, serial:DEVICE:BAUD, "
        f"mavlink:udp:PORT or simulator, found {text!r}"
    )


def _speed(text: str, speed: str) -> float:
    try:
        found = float("inf") if speed == "max" else float(speed.removesuffix("x"))
    except ValueError:
        found = 0.0
    if not found > 0.0:
        raise InputError(f"--listen {text}: expected a speed such as @20x, found @{speed}")
    return found


def _address(text: str, rest: str) -> tuple[str, int]:
    host, _, port = rest.rpartition(":")
    number = whole_number(port)
    if number is None or number > 65535:
        raise InputError(f"--listen {text}: expected a port from 0 to 65535, found {port!r}")
    return host or LOOPBACK, number


def _line(text: str, rest: str) -> tuple[str, int]:
    device, _, baud = rest.rpartition(":")
    rate = whole_number(baud)
    if not device or rate is None:
        raise InputError(f"--listen {text}: expected serial:DEVICE:BAUD, e.g. serial:/dev/ttyUSB0:115200")
    return device, rate
