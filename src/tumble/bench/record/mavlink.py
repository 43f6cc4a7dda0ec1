"""The IMU messages of an autopilot, as lines: RAW_IMU, SCALED_IMU, SCALED_IMU2, SCALED_IMU3, HIGHRES_IMU.

Of several kinds that come, the first of HIGHRES_IMU, SCALED_IMU3 … RAW_IMU that is seen in a second is taken. Numbers
become SI as the messages define them; RAW_IMU has no unit of its own, and ArduPilot's and PX4's, which are those of
SCALED_IMU, are taken for it.
"""

from __future__ import annotations

import time
from typing import Any

from tumble.bench.record.sources import LOOPBACK, LineSource
from tumble.errors import InputError, needs_extra
from tumble.units import G_STANDARD

MESSAGES = ("HIGHRES_IMU", "SCALED_IMU", "RAW_IMU", "SCALED_IMU2", "SCALED_IMU3")
_CHOOSE_SECONDS = 1.0
_MILLI = 1e-3


class Mavlink(LineSource):
    """MAVLink on a UDP port or a serial line."""

    unordered = True

    def __init__(self, where: str) -> None:
        with needs_extra("MAVLink", "bench", "pymavlink"):
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
        self._seen: set[str] = set()
        self._chosen: str | None = None
        self._first = 0.0

    def read(self, timeout: float) -> bytes:
        out: list[str] = []
        wait = timeout
        while len(out) < 256 and (message := self._link.recv_match(type=list(MESSAGES), blocking=True, timeout=wait)):
            wait = 0.001
            if self._takes(message.get_type()):
                out.append(line_of(message))
        return "".join(out).encode("ascii")

    def _takes(self, kind: str) -> bool:
        if self._chosen is None:
            self._first = self._first or time.monotonic()
            self._seen.add(kind)
            if time.monotonic() - self._first > _CHOOSE_SECONDS:
                self._chosen = next(name for name in MESSAGES if name in self._seen)
        return kind == self._chosen

    def close(self) -> None:
        self._link.close()


def line_of(message: Any) -> str:
    """A message as a line of t, ax, ay, az, gx, gy, gz in SI."""
    kind = message.get_type()
    seconds = message.time_boot_ms * 1e-3 if kind.startswith("SCALED") else message.time_usec * 1e-6
    accel, gyro = (1.0, 1.0) if kind == "HIGHRES_IMU" else (_MILLI * G_STANDARD, _MILLI)
    values = [seconds] + [accel * getattr(message, f"{axis}acc") for axis in "xyz"]
    values += [gyro * getattr(message, f"{axis}gyro") for axis in "xyz"]
    return ",".join(map(repr, values)) + "\n"
