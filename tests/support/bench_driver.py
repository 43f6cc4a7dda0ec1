"""A simulated unit that a test turns, a station that follows it in log time, and the server of its page."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import uvicorn
from scipy.linalg import block_diag

from tumble.bench.session_folder import begin
from tumble.bench.station import Station
from tumble.bench.web.access import Access
from tumble.bench.web.connections import Connection
from tumble.bench.web.server import app_of
from tumble.earth import earth_rate
from tumble.programme.positions import programme as built_in
from tumble.recording.live.samples import SI_LOG
from tumble.rotation import rotation_matrix, rotation_vector
from tumble.sensors.grades import grade, spread_of
from tumble.sensors.model import Block
from tumble.units import DEGREE, Array
from tumble.usual_setup import LATITUDE_DEG

SITE = {"latitude_deg": 56.84}
TOKEN = "0123456789abcdef"
RATE = 45.0 * DEGREE
SAMPLE_RATE = 100.0
OFF = 1.0 * DEGREE
NEAR = 20.0 * DEGREE
"""From where a turn of the programme begins: from elsewhere the shortest way is taken."""
GRAVITY = 9.81579
KNOCK = 3.0
"""m/s², for a tenth of a second."""
FULL_SCALE = 300.0 * DEGREE
ROCKING = 1.0 * DEGREE
AXES = {"N": np.array([1.0, 0.0, 0.0]), "U": np.array([0.0, 1.0, 0.0]), "E": np.array([0.0, 0.0, 1.0])}


class Unit:
    """A unit of the grade "mems" on a table: each `line` is its next sample, the reading at the middle of an interval.
    Turns go smoothly up to RATE and down again; positions are up to OFF away."""

    def __init__(self, programme: str, *, temperature: bool = False) -> None:
        self.programme, self._rng = built_in(programme), np.random.default_rng(1)
        kind = grade("mems")
        noise = np.array([kind.noise.accel_white, kind.noise.gyro_white]) * SAMPLE_RATE**0.5
        models = []
        for block in (Block(kind="accel", axes=np.eye(3)), Block(kind="gyro", axes=np.eye(3))):
            size = np.array([spread_of(kind, name) for name in block.names])
            models.append(block.model(0.5 * size * self._rng.standard_normal(len(size))))
        self._matrix, self._bias = block_diag(*(m.matrix for m in models)), np.concatenate([m.bias for m in models])
        self._sigma, self._earth = np.repeat(noise, 3), np.array(earth_rate(LATITUDE_DEG * DEGREE))
        self.sample, self._turn, self._first, self._samples = 0, np.zeros(3), 0, 1
        self._from = self._to = self._near(self.programme.positions[0].matrix)
        self._until = dict.fromkeys(("knock", "lose", "stick"), -1)
        self._last_x, self._rocking, self._warming, self._temperature = 0.0, (0, 0), (0, 0.0), temperature

    def _near(self, attitude: Array) -> Array:
        return rotation_matrix(OFF * self._rng.uniform(-1.0, 1.0, 3)) @ attitude

    @property
    def moving(self) -> bool:
        return self.sample < self._first + self._samples

    def turn(self, axis: str, degrees: float, *, rate: float = RATE) -> None:
        """Turn about N, U or E."""
        self._start(degrees * DEGREE * AXES[axis], rate)

    def go_to(self, position: int) -> None:
        """Turn into a position of the programme, from 0, the way of the programme where it has one."""
        target, now = self._near(self.programme.positions[position].matrix), self._attitude(self.sample)[0]
        move, vector = self.programme.moves[position - 1] if position else None, rotation_vector(target @ now.T)
        if move is not None and move.axis is not None and move.angle is not None and np.linalg.norm(vector) > 1.0:
            whole = move.angle * move.axis
            rest = rotation_vector(rotation_matrix(-whole) @ target @ now.T)
            vector = whole + rest if np.linalg.norm(rest) < NEAR else vector
        self._start(vector, RATE)

    def _start(self, vector: Array, rate: float) -> None:
        self._from, _ = self._attitude(self.sample)
        self._turn, self._first, self._to = vector, self.sample, rotation_matrix(vector) @ self._from
        self._samples = max(round(2.0 * float(np.linalg.norm(vector)) / rate * SAMPLE_RATE), 10)

    def mischief(self, kind: str, seconds: float) -> None:
        """A blow against the table ("knock"), samples that do not arrive ("lose"), a channel that repeats itself
        ("stick"), for so long."""
        self._until[kind] = self.sample + round(seconds * SAMPLE_RATE)

    def rock(self, seconds: float = 1.5) -> None:
        """A unit put down with movement when the turn under way ends: it comes to rest slowly."""
        self._rocking = self._first + self._samples, round(seconds * SAMPLE_RATE)

    def warm(self, rate: float) -> None:
        """The temperature drifts from now on, K/s."""
        self._warming = self.sample, rate

    def _attitude(self, sample: float) -> tuple[Array, Array]:
        """Attitude, body → geographic, and angular rate, rad/s, in the geographic frame, at a time in samples."""
        part = max((sample - self._first) / self._samples, 0.0)
        if part < 1.0:
            L = rotation_matrix((part - np.sin(2.0 * np.pi * part) / (2.0 * np.pi)) * self._turn) @ self._from
            return L, (1.0 - np.cos(2.0 * np.pi * part)) * SAMPLE_RATE / self._samples * self._turn
        first, samples = self._rocking
        if not samples or (away := 1.0 - (sample - first) / samples) < 0.0:
            return self._to, np.zeros(3)
        back = -ROCKING * SAMPLE_RATE / samples if away <= 1.0 else 0.0
        return rotation_matrix(ROCKING * min(away, 1.0) * AXES["N"]) @ self._to, back * AXES["N"]

    def line(self) -> str:
        """The next sample as a line; empty where it does not arrive."""
        L, rate = self._attitude(self.sample + 0.5)
        force = L.T @ (GRAVITY * AXES["U"])
        if self.sample < self._until["knock"]:
            force = force + KNOCK * self._rng.standard_normal(3)
        true = np.concatenate([force, L.T @ (rate + self._earth)])
        row = (self._matrix @ true + self._bias + self._sigma * self._rng.standard_normal(6)).tolist()
        row[3:] = [min(max(value, -FULL_SCALE), FULL_SCALE) for value in row[3:]]
        if self.sample < self._until["stick"]:
            row[1] = self._last_x
        self._last_x, self.sample = row[1], self.sample + 1
        since, warming = self._warming
        celsius = [25.0 + warming * (self.sample - since) / SAMPLE_RATE] if self._temperature else []
        if self.sample < self._until["lose"]:
            return ""
        return ",".join(f"{value:.9g}" for value in [self.sample / SAMPLE_RATE, *row, *celsius]) + "\n"


class Bench:
    """A station whose clock is driven by the test: a step is a fifth of a second of log time. Without a `programme`
    positions are free; without `gyros` the session does not know of theirs."""

    def __init__(
        self, folder: Path, programme: str | None = "nine", *, temperature: bool = False, gyros: bool = True
    ) -> None:
        self.unit = Unit(programme or "nine", temperature=temperature)
        log = {**SI_LOG} | ({"temperature": {"columns": ["T"], "unit": "degC"}} if temperature else {})
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
            self.file.write("".join(self.unit.line() for _ in range(20)))
            self.file.flush()
            self.station.step()

    def until(self, what: Callable[[], bool], seconds: float = 30.0) -> float:
        """Let log time pass until something is so; how long it took."""
        passed = 0.0
        while not what():
            assert passed < seconds, f"it did not happen: {self.screen}, {self.said}"
            self.run(0.2)
            passed += 0.2
        return passed

    def moved(self) -> None:
        """Let the turn under way end."""
        self.until(lambda: not self.unit.moving)

    def take(self, position: int) -> None:
        """Go into a position, from 1, and stay until the page wants the next."""
        self.unit.go_to(position - 1)
        self.moved()
        self.until(lambda: self.screen in ("rest", "fault"))
        self.until(lambda: self.screen != "rest")

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


@contextmanager
def served(station: Station, port: int = 0) -> Iterator[str]:
    """The link to the page of a station."""
    with socket.create_server(("127.0.0.1", port)) as bound:
        port = bound.getsockname()[1]
        app = app_of(station, Access(host="127.0.0.1", port=port, token=TOKEN))
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
