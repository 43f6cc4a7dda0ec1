"""A simulated unit on a virtual table that is turned from the page: to try the bench, and to make every mistake.

The unit is of the grade "mems". Turns go smoothly up to RATE and down again; positions are up to a degree off. A
sample is the reading at the middle of its interval, which for 100 Hz is the mean to 1e-6 of it.
"""

from __future__ import annotations

import contextlib
import time

import numpy as np
from scipy.linalg import block_diag

from tumble.documents import whole_number
from tumble.earth import earth_rate
from tumble.programme.positions import Programme, programme
from tumble.recording.live.sources import LineSource, speed_of
from tumble.rotation import rotation_matrix, rotation_vector
from tumble.sensors.grades import grade, spread_of
from tumble.sensors.model import Block
from tumble.units import DEGREE, Array
from tumble.usual_setup import LATITUDE_DEG

RATE = 45.0 * DEGREE
SAMPLE_RATE = 100.0
OFF = 1.0 * DEGREE
NEAR = 20.0 * DEGREE
"""From where a turn of the programme begins: from elsewhere the shortest way is taken."""
GRAVITY = 9.81579
KNOCK = 3.0
"""m/s², for a tenth of a second."""
FULL_SCALE = 300.0 * DEGREE
LASTING = {"knock": 0.1, "lose": 0.5, "stick": 2.0}
"""s, of each mischief."""
_SEED = 1
AXES = {"N": np.array([1.0, 0.0, 0.0]), "U": np.array([0.0, 1.0, 0.0]), "E": np.array([0.0, 0.0, 1.0])}


class VirtualTable(LineSource):
    """A source: what a unit on the virtual table sends, in SI, so many times as fast as time passes."""

    def __init__(self, programme_name: str) -> None:
        name, _, speed = programme_name.partition("@")
        self.programme: Programme = programme(name or "rough-table")
        self.name = f"simulator:{self.programme.name}"
        self._speed = speed_of(f"simulator:{programme_name}", speed or "1x")
        self._rng = np.random.default_rng(_SEED)
        kind = grade("mems")
        noise = np.array([kind.noise.accel_white, kind.noise.gyro_white]) * SAMPLE_RATE**0.5
        models = []
        for block in (Block(kind="accel", axes=np.eye(3)), Block(kind="gyro", axes=np.eye(3))):
            size = np.array([spread_of(kind, name) for name in block.names])
            models.append(block.model(0.5 * size * self._rng.standard_normal(len(size))))
        self._matrix, self._bias = block_diag(*(m.matrix for m in models)), np.concatenate([m.bias for m in models])
        self._sigma, self._earth = np.repeat(noise, 3), np.array(earth_rate(LATITUDE_DEG * DEGREE))
        self.sample = 0
        """The number of those that were made."""
        self._begun: float | None = None
        self._turn, self.first, self.samples = np.zeros(3), 0, 1
        """A turn by this vector (3,) in the geographic frame, rad, from this sample on, over so many."""
        self._from = self._to = self._near(self.programme.positions[0].matrix)
        """The attitudes, body → geographic, at which it began and where it ends."""
        self._until = dict.fromkeys(LASTING, -1)
        """The sample until which each mischief lasts."""
        self._last_x = 0.0

    def skip_to(self, at: float) -> None:
        self.sample = round(at * SAMPLE_RATE)

    def _near(self, attitude: Array) -> Array:
        return rotation_matrix(OFF * self._rng.uniform(-1.0, 1.0, 3)) @ attitude

    def turned(self, sample: float) -> tuple[Array, Array]:
        """Attitude, body → geographic, and angular rate, rad/s, in the geographic frame, at a time in samples."""
        part = max((sample - self.first) / self.samples, 0.0)
        if part >= 1.0:
            return self._to, np.zeros(3)
        L = rotation_matrix((part - np.sin(2.0 * np.pi * part) / (2.0 * np.pi)) * self._turn) @ self._from
        return L, (1.0 - np.cos(2.0 * np.pi * part)) * SAMPLE_RATE / self.samples * self._turn

    @property
    def moving(self) -> bool:
        return self.sample < self.first + self.samples

    def turn(self, axis: str, degrees: float, *, rate: float = RATE) -> None:
        """Turn about N, U or E."""
        self._start(degrees * DEGREE * AXES[axis], rate)

    def go_to(self, position: int) -> None:
        """Turn into a position of the programme, the way of the programme where it has one."""
        target = self._near(self.programme.positions[position].matrix)
        move = self.programme.moves[position - 1] if position else None
        now, _ = self.turned(self.sample)
        vector = rotation_vector(target @ now.T)
        if move is not None and move.axis is not None and move.angle is not None and np.linalg.norm(vector) > 1.0:
            whole = move.angle * move.axis
            rest = rotation_vector(rotation_matrix(-whole) @ target @ now.T)
            vector = whole + rest if np.linalg.norm(rest) < NEAR else vector
        self._start(vector, RATE)

    def told(self, what: str) -> None:
        """Do what is said: "N+90" or "to 3", "knock", "lose" or "stick"; nothing for anything else."""
        if what in self._until:
            self.mischief(what)
        elif what.startswith("to "):
            number = whole_number(what[3:])
            if number is not None and 0 < number <= len(self.programme.positions):
                self.go_to(number - 1)
        elif what[:1] in AXES:
            with contextlib.suppress(ValueError):
                self.turn(what[0], float(what[1:]))

    def _start(self, vector: Array, rate: float) -> None:
        self._from, _ = self.turned(self.sample)
        self._turn, self.first, self._to = vector, self.sample, rotation_matrix(vector) @ self._from
        self.samples = max(round(2.0 * float(np.linalg.norm(vector)) / rate * SAMPLE_RATE), 10)

    def mischief(self, kind: str, seconds: float | None = None) -> None:
        """A blow against the table ("knock"), samples that do not arrive ("lose"), a channel that repeats itself
        ("stick"), for so long."""
        self._until[kind] = self.sample + round((LASTING[kind] if seconds is None else seconds) * SAMPLE_RATE)

    def read(self, timeout: float) -> bytes:
        if self._begun is None:
            self._begun = time.monotonic() - self.sample / SAMPLE_RATE / self._speed
        due = int((time.monotonic() - self._begun) * self._speed * SAMPLE_RATE)
        if due <= self.sample:
            time.sleep(min(timeout, 0.02))
            return b""
        lines = [self.line() for _ in range(min(due - self.sample, 4096))]
        return "".join(lines).encode("ascii")

    def line(self) -> str:
        """The next sample as a line; empty where it does not arrive."""
        L, rate = self.turned(self.sample + 0.5)
        force = L.T @ (GRAVITY * AXES["U"])
        if self.sample < self._until["knock"]:
            force = force + KNOCK * self._rng.standard_normal(3)
        true = np.concatenate([force, L.T @ (rate + self._earth)])
        row = (self._matrix @ true + self._bias + self._sigma * self._rng.standard_normal(6)).tolist()
        row[3:] = [min(max(value, -FULL_SCALE), FULL_SCALE) for value in row[3:]]
        if self.sample < self._until["stick"]:
            row[1] = self._last_x
        self._last_x, self.sample = row[1], self.sample + 1
        if self.sample < self._until["lose"]:
            return ""
        return ",".join(f"{value:.9g}" for value in [self.sample / SAMPLE_RATE, *row]) + "\n"
