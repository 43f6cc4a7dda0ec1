"""Sources of rows, named as by --listen, which return the bytes of lines:

    file:PATH   replay:FOLDER@20x   stdin   udp:[HOST:]PORT   tcp:[HOST:]PORT   serial:DEVICE:BAUD
    mavlink:udp:[HOST:]PORT   mavlink:DEVICE:BAUD

An interrupted source states the reason in `trouble` and tries again; only a replay and standard input come to an end.

Of the IMU messages of an autopilot (MAVLink), the first kind in the order of `MESSAGES` that arrives within a second is
used. Its numbers are converted to SI as the messages define them. RAW_IMU defines no unit: ArduPilot and PX4 use that
of SCALED_IMU.
"""

from __future__ import annotations

import contextlib
import math
import os
import queue
import select
import socket
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tumble.documents import whole_number
from tumble.errors import InputError, needs_extra
from tumble.recording.session import LogSpec, Session
from tumble.recording.session_file import read_session
from tumble.units import G_STANDARD

_READ_BYTES = 1 << 16
_RETRY_SECONDS = 0.5
_SILENT_SECONDS = 2.0  # after which a TCP connection gives way to the next
_SOCKET_BYTES = 1 << 22
LOOPBACK = "127.0.0.1"
MESSAGES = ("HIGHRES_IMU", "SCALED_IMU", "RAW_IMU", "SCALED_IMU2", "SCALED_IMU3")
_CHOOSE_SECONDS = 1.0
_MILLI = 1e-3  # SCALED_IMU has mg and mrad/s


class Ended(Exception):  # noqa: N818
    """The source has come to its end."""


class LineSource:
    """Base of the sources of lines.

    `begins_anew`: it sends everything from the beginning when it is opened again. `trouble`: the reason for an
    interruption. `session`: the session that is replayed."""

    name = ""
    begins_anew = False
    trouble: str | None = None
    session: Session | None = None

    def read(self, timeout: float) -> bytes:
        """Return the received bytes, none if nothing arrives in `timeout` s. Raises Ended at the end of the source."""
        raise NotImplementedError

    def hurry(self, rows: int) -> None:
        """Send the first `rows` at once, because they are recorded already."""

    def close(self) -> None:
        """Stop listening."""


class GrowingFile(LineSource):
    """A text file that another program writes, read from its beginning."""

    begins_anew = True

    def __init__(self, path: Path) -> None:
        self.name = f"file:{path}"
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


class StandardInput(LineSource):
    """Lines on standard input, which stays open."""

    name = "stdin"

    def __init__(self, descriptor: int | None = None) -> None:
        if descriptor is None and sys.stdin is None:
            raise InputError("--listen stdin: expected standard input, found it closed")
        self._descriptor = sys.stdin.fileno() if descriptor is None else descriptor
        self._read: queue.Queue[bytes] = queue.Queue(maxsize=8)
        threading.Thread(target=self._run, daemon=True).start()  # on Windows select() cannot wait for a console

    def _run(self) -> None:
        while data := os.read(self._descriptor, _READ_BYTES):
            self._read.put(data)
        self._read.put(b"")

    def read(self, timeout: float) -> bytes:
        try:
            data = self._read.get(timeout=timeout)
        except queue.Empty:
            return b""
        if not data:
            self._read.put(b"")
            raise Ended
        return data


class Udp(LineSource):
    """Datagrams of whole lines, in the order in which they arrive."""

    def __init__(self, host: str, port: int) -> None:
        self.name = f"udp:{host}:{port}"
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _SOCKET_BYTES)
        self.port = _bind(self._socket, host, port, self.name)

    def read(self, timeout: float) -> bytes:
        out = bytearray()
        while select.select([self._socket], [], [], 0.0 if out else timeout)[0] and len(out) < _READ_BYTES:
            out += self._socket.recv(_READ_BYTES)
            if not out.endswith(b"\n"):
                out += b"\n"
        return bytes(out)

    def close(self) -> None:
        self._socket.close()


class Tcp(LineSource):
    """Lines of one connection at a time.

    A connection that has sent nothing for two seconds gives way to the next, because a sender without power cannot
    close its connection."""

    def __init__(self, host: str, port: int) -> None:
        self.name = f"tcp:{host}:{port}"
        self._listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.port = _bind(self._listening, host, port, self.name)
        self._listening.listen(1)
        self._connection: socket.socket | None = None
        self._heard = 0.0

    def read(self, timeout: float) -> bytes:
        connection = self._connection
        waited_for = [self._listening] if connection is None else [connection]
        if connection is not None and time.monotonic() - self._heard > _SILENT_SECONDS:
            waited_for.append(self._listening)
        ready = select.select(waited_for, [], [], timeout)[0]
        if not ready:
            return b""
        self._heard = time.monotonic()
        if connection is not None and connection in ready:
            try:
                data = connection.recv(_READ_BYTES)
            except BlockingIOError:
                return b""
            except OSError:
                data = b""
            if not data:
                connection.close()
                self._connection, self.trouble = None, "the connection ended; the next is waited for"
            return data or b"\n"
        if connection is not None:
            connection.close()
        self._connection, _ = self._listening.accept()
        self._connection.setblocking(False)
        self.trouble = None
        return b"\n"

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()
        self._listening.close()


def _bind(made: socket.socket, host: str, port: int, name: str) -> int:
    """Bind a socket and return its port."""
    try:
        made.bind((host, port))
    except OSError as error:
        made.close()
        raise InputError(f"--listen {name}: expected a port that is free, found: {error.strerror}") from None
    return int(made.getsockname()[1])


class Serial(LineSource):
    """A serial line; if the cable is pulled, the line is opened again as soon as it is back."""

    def __init__(self, device: str, baud: int) -> None:
        with needs_extra("a serial line", "bench", "serial"):
            import serial
        self.name = f"serial:{device}:{baud}"
        self._port: Any = serial.serial_for_url(device, baud, timeout=0, do_not_open=True)
        try:
            self._port.open()
        except OSError as error:  # of pyserial too
            words = " ".join(str(error.strerror or error).split())
            raise InputError(f"--listen {self.name}: expected a serial line, found: {words}") from None

    def read(self, timeout: float) -> bytes:
        if not self._port.is_open:
            try:
                self._port.open()
            except OSError:
                time.sleep(min(timeout, _RETRY_SECONDS))
                return b""
            self.trouble = None
        try:
            self._port.timeout = timeout
            data: bytes = self._port.read(1)
            data += self._port.read(min(self._port.in_waiting, _READ_BYTES)) if data else b""
        except OSError as error:
            self.trouble = (
                f"the serial line is gone: {' '.join(str(error.strerror or error).split())}; it is waited for"
            )
            with contextlib.suppress(OSError):
                self._port.close()
            return b"\n"
        return data

    def close(self) -> None:
        self._port.close()


class Mavlink(LineSource):
    """The IMU of an autopilot by MAVLink, on a UDP port or a serial line, as lines of SI_LOG."""

    def __init__(self, where: str) -> None:
        with needs_extra("MAVLink", "formats", "pymavlink"):
            from pymavlink import mavutil
        self.name = f"mavlink:{where}"
        kind, _, rest = where.partition(":")
        host, _, port = rest.rpartition(":")
        device, _, baud = where.rpartition(":")
        try:
            if kind == "udp":
                self._link: Any = mavutil.mavlink_connection(f"udpin:{host or LOOPBACK}:{port}")
            else:
                self._link = mavutil.mavlink_connection(device, baud=int(baud))
        except (OSError, ValueError) as error:
            raise InputError(
                f"--listen {self.name}: expected mavlink:udp:PORT or mavlink:DEVICE:BAUD: {error}"
            ) from None
        self._received: set[str] = set()
        self._chosen: str | None = None
        self._first = 0.0

    def read(self, timeout: float) -> bytes:
        out: list[str] = []
        wait = timeout
        while len(out) < 256 and (message := self._link.recv_match(type=list(MESSAGES), blocking=True, timeout=wait)):
            wait, kind = 0.001, message.get_type()
            if self._chosen is None:
                self._first = self._first or time.monotonic()
                self._received.add(kind)
                if time.monotonic() - self._first > _CHOOSE_SECONDS:
                    self._chosen = next(name for name in MESSAGES if name in self._received)
            if kind == self._chosen:
                out.append(line_of(message))
        return "".join(out).encode("ascii")

    def close(self) -> None:
        self._link.close()


def line_of(message: Any) -> str:
    """Return a MAVLink message as a line of t, ax, ay, az, gx, gy, gz in SI."""
    kind = message.get_type()
    seconds = message.time_boot_ms * 1e-3 if kind.startswith("SCALED") else message.time_usec * 1e-6
    accel, gyro = (1.0, 1.0) if kind == "HIGHRES_IMU" else (_MILLI * G_STANDARD, _MILLI)
    values = [seconds] + [accel * getattr(message, f"{axis}acc") for axis in "xyz"]
    values += [gyro * getattr(message, f"{axis}gyro") for axis in "xyz"]
    return ",".join(map(repr, values)) + "\n"


class Replay(LineSource):
    """The log of a session at `speed` times the pace of its recording; infinite means all at once.

    A CSV file with commas is sent unchanged, any other file as lines of CSV."""

    begins_anew = True

    def __init__(self, folder: Path, speed: float) -> None:
        self.name, self._speed = f"replay:{folder.name}@{speed:g}x", speed
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
            recorded = self._open.enter_context(file.open("rb"))
            self._header, lines = recorded.readline(), iter(recorded)
        else:  # to the last digit, with nan for unreadable numbers
            from tumble.recording.readers import source_of as reader_of

            rows = (row for table, _ in reader_of(file, log.dialect).tables(log.columns) for row in table.iter_rows())
            self._header = ",".join(log.columns).encode() + b"\n"
            lines = (",".join(map(repr, row)).encode("ascii") + b"\n" for row in rows)
        self._lines = _timed(log, self._header.decode("utf-8-sig").strip().split(","), lines)
        self._next: tuple[float, bytes] | None = next(self._lines, None)
        self._begun: tuple[float, float] | None = None
        self._at_once = 0

    def hurry(self, rows: int) -> None:
        self._at_once = rows

    def read(self, timeout: float) -> bytes:
        if self._header:
            header, self._header = self._header, b""
            return header
        if self._next is None:
            raise Ended
        until, most = math.inf, self._at_once
        if not most:
            self._begun = self._begun or (time.monotonic(), self._next[0])
            started, first = self._begun
            wait = started + (self._next[0] - first) / self._speed - time.monotonic()
            time.sleep(min(max(wait, 0.0), timeout))
            if wait > timeout:
                return b""
            until, most = first + (time.monotonic() - started) * self._speed, sys.maxsize
        out, rows = bytearray(), 0
        while self._next is not None and self._next[0] <= until and rows < most and len(out) < _READ_BYTES:
            out += self._next[1]
            self._next, rows = next(self._lines, None), rows + 1
        self._at_once = max(self._at_once - rows, 0)
        return bytes(out)

    def close(self) -> None:
        self._open.close()


def _timed(log: LogSpec, names: list[str], lines: Iterator[bytes]) -> Iterator[tuple[float, bytes]]:
    """Yield lines with their times, s; lines without a time are left out."""
    scale = log.time_factor if log.rate is None else 1.0 / log.rate
    if log.time is None:
        yield from ((number * scale, line) for number, line in enumerate(lines, 1))
        return
    clock, at = names.index(log.time), 0.0
    for line in lines:
        with contextlib.suppress(ValueError, IndexError):
            stated = float(line.split(b",")[clock]) * scale
            at = stated if math.isfinite(stated) else at
            yield at, line


def is_recorded(log: LogSpec) -> bool:
    """Return whether a log has the form of those of the bench: CSV files with commas and names in the first line."""
    plain = all(isinstance(file, Path) and file.suffix == ".csv" for file in log.files)
    return plain and log.dialect is None and not log.clock


def source_of(text: str) -> LineSource:
    """Return the source named as by --listen. Raises InputError for any other text."""
    kind, _, rest = text.partition(":")
    before, _, last = rest.rpartition(":")
    number = whole_number(last)
    match kind:
        case "stdin" if not rest:
            return StandardInput()
        case "file" if rest:
            return GrowingFile(Path(rest))
        case "replay" if rest:
            folder, _, speed = rest.rpartition("@") if "@" in rest else (rest, "", "1x")
            with contextlib.suppress(ValueError):
                times = math.inf if speed == "max" else float(speed.removesuffix("x"))
                if times > 0.0:
                    return Replay(Path(folder), times)
            raise InputError(f"--listen {text}: expected a speed such as @20x, found @{speed}")
        case "udp" | "tcp":
            if number is None or number > 65535:
                raise InputError(f"--listen {text}: expected a port from 0 to 65535, found {last!r}")
            return (Udp if kind == "udp" else Tcp)(before or LOOPBACK, number)
        case "serial" if rest:
            if not before or number is None:
                raise InputError(f"--listen {text}: expected serial:DEVICE:BAUD, e.g. serial:/dev/ttyUSB0:115200")
            return Serial(before, number)
        case "mavlink" if rest:
            return Mavlink(rest)
    raise InputError(
        "--listen: expected file:PATH, replay:FOLDER@20x, stdin, udp:PORT, tcp:PORT, serial:DEVICE:BAUD "
        f"or mavlink:udp:PORT, found {text!r}"
    )
