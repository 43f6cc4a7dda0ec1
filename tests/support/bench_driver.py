"""A station at the virtual table, and its page, whose clock is driven by a test."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import uvicorn

from tumble.bench.record.virtual_table import AXES, FULL_SCALE, SAMPLE_RATE, VirtualTable
from tumble.bench.session_folder import begin, in_si
from tumble.bench.station import Station
from tumble.bench.web.access import Access
from tumble.bench.web.connections import Connection
from tumble.bench.web.server import app_of
from tumble.rotation import rotation_matrix
from tumble.units import DEGREE, Array

SITE = {"latitude_deg": 56.84}
TOKEN = "0123456789abcdef"


class ClumsyTable(VirtualTable):
    """The virtual table with a thermometer, where it is asked for, and a unit that may be put down with movement."""

    ROCKING = 1.0 * DEGREE

    def __init__(self, programme_name: str, *, temperature: bool) -> None:
        self._rocking: tuple[int, int] | None = None
        self._warming, self._temperature = (0, 0.0), temperature
        super().__init__(programme_name)

    def rock(self, seconds: float = 1.5) -> None:
        """A unit put down with movement when the turn under way ends: it comes to rest slowly."""
        self._rocking = self.first + self.samples, round(seconds * SAMPLE_RATE)

    def warm(self, rate: float) -> None:
        """The temperature drifts from now on, K/s."""
        self._warming = self.sample, rate

    def turned(self, sample: float) -> tuple[Array, Array]:
        L, rate = super().turned(sample)
        if self._rocking is not None:
            first, samples = self._rocking
            if (away := 1.0 - (sample - first) / samples) >= 0.0:
                still = rotation_matrix(self.ROCKING * min(away, 1.0) * AXES["N"])
                back = -self.ROCKING * SAMPLE_RATE / samples if away <= 1.0 else 0.0
                return still @ L, still @ rate + back * AXES["N"]
        return L, rate

    def line(self) -> str:
        line = super().line()
        since, warming = self._warming
        celsius = 25.0 + warming * (self.sample - since) / SAMPLE_RATE
        return f"{line[:-1]},{celsius:.9g}\n" if line and self._temperature else line


class Bench:
    """A station whose clock is driven by the test: a step is a fifth of a second of log time. Without a `programme`
    positions are free; without `gyros` the session does not know of theirs."""

    def __init__(
        self, folder: Path, programme: str | None = "nine", *, temperature: bool = False, gyros: bool = True
    ) -> None:
        self.table = ClumsyTable(f"{programme or 'nine'}@1000x", temperature=temperature)
        log = in_si() | ({"temperature": {"columns": ["T"], "unit": "degC"}} if temperature else {})
        columns = [log["time"], *log["accel"]["columns"], *log["gyro"]["columns"], *(["T"] if temperature else [])]
        log["gyro"] = log["gyro"] | {"range": FULL_SCALE}
        if not gyros:
            del log["gyro"]
        begin(folder, log=log, serial="virtual-1", site=SITE, programme=programme)
        self.file = (folder / "log.csv").open("a")
        self.file.write(",".join(columns) + "\n")
        self.station = Station(folder, None, wanted=("accel.bias=1mg", "gyro.bias=100deg/h"))

    def run(self, seconds: float) -> None:
        """Let so much log time pass."""
        for _ in range(round(seconds / 0.2)):
            self.file.write("".join(self.table.line() for _ in range(20)))
            self.file.flush()
            self.station.step()

    def until(self, what: Callable[[], bool], seconds: float = 30.0) -> float:
        """Let time pass until something is so; how long it took."""
        passed = 0.0
        while not what():
            assert passed < seconds, f"it did not happen: {self.screen}, {self.said}"
            self.run(0.2)
            passed += 0.2
        return passed

    def close(self) -> None:
        """End it."""
        self.station.stop()
        self.file.close()

    @property
    def state(self) -> dict[str, Any]:
        return {**self.station.state}

    @property
    def screen(self) -> str:
        return str(self.state["screen"])

    @property
    def said(self) -> str:
        fault = self.state["fault"]
        return str(fault["said"]) if fault else str(self.state["headline"])

    def take(self, position: int) -> None:
        """Go into a position and stay until the page wants the next."""
        self.table.go_to(position - 1)
        self.until(lambda: not self.table.moving)
        self.until(lambda: self.screen in ("rest", "fault"))
        self.until(lambda: self.screen != "rest")


@contextmanager
def served(*stations: Station) -> Iterator[str]:
    """The link to the page of a station, or to the list of several."""
    with socket.create_server(("127.0.0.1", 0)) as bound:
        port = bound.getsockname()[1]
        app = app_of(stations, Access(host="127.0.0.1", port=port, token=TOKEN))
        config = uvicorn.Config(app, http=Connection, log_level="warning", timeout_graceful_shutdown=1)
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [bound]})
        thread.start()
        while not server.started:
            time.sleep(0.01)
        try:
            yield f"http://127.0.0.1:{port}/?token={TOKEN}"
        finally:
            app.state.stopping = server.should_exit = True
            thread.join()
