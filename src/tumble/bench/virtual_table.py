"""A simulated unit on a virtual table that is turned from the page: to try the bench, and to make every mistake.

The unit is of the grade "mems". Turns go smoothly up to RATE and down again; positions are up to a degree off. A
sample is the reading at the middle of its interval, which for 100 Hz is the mean to 1e-6 of it.
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass

import numpy as np

from tumble.documents import whole_number
from tumble.earth import earth_rate
from tumble.errors import InputError
from tumble.programme.positions import Programme, programme
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
ROCKING = 1.0 * DEGREE
FULL_SCALE = 300.0 * DEGREE
_SEED = 1
AXES = {"N": np.array([1.0, 0.0, 0.0]), "U": np.array([0.0, 1.0, 0.0]), "E": np.array([0.0, 0.0, 1.0])}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Move:
    """A rotation `vector` (3,) in the geographic frame, rad, from attitude `start` at sample `first` on."""

    vector: Array
    start: Array
    first: int
    samples: int

    def attitude(self, sample: float) -> Array:
        """Body → geographic at a time in samples."""
        part = min(max((sample - self.first) / self.samples, 0.0), 1.0)
        smooth = part - np.sin(2.0 * np.pi * part) / (2.0 * np.pi)
        return rotation_matrix(smooth * self.vector) @ self.start

    def rate(self, sample: float) -> Array:
        """Angular rate, rad/s, in the geographic frame."""
        part = (sample - self.first) / self.samples
        inside = 0.0 <= part <= 1.0
        return self.vector * ((1.0 - np.cos(2.0 * np.pi * part)) * SAMPLE_RATE / self.samples if inside else 0.0)


class VirtualTable:
    """A source: what a unit on the virtual table sends, in SI, `speed` times as fast as time passes."""

    unordered = False

    def __init__(self, programme_name: str, *, temperature: bool = False) -> None:
        name, _, speed = programme_name.partition("@")
        self.programme: Programme = programme(name or "rough-table")
        self.name = f"simulator:{self.programme.name}"
        self.trouble: str | None = None
        self.temperature = temperature
        try:
            self.speed = float(speed.removesuffix("x")) if speed else 1.0
        except ValueError:
            raise InputError(f"--listen simulator:{programme_name}: expected a speed such as @5x") from None
        self._rng = np.random.default_rng(_SEED)
        kind = grade("mems")
        blocks = Block(kind="accel", axes=np.eye(3)), Block(kind="gyro", axes=np.eye(3))
        self._models = []
        for block in blocks:
            size = np.array([spread_of(kind, name) for name in block.names])
            self._models.append(block.model(0.5 * size * self._rng.standard_normal(len(size))))
        self._sigma = [kind.noise.accel_white * SAMPLE_RATE**0.5, kind.noise.gyro_white * SAMPLE_RATE**0.5]
        self._sample = 0
        self._begun: float | None = None
        self._move = _Move(vector=np.zeros(3), start=self._near(self.programme.positions[0].matrix), first=0, samples=1)
        self._knocked = self._lost = self._stuck = -1
        self._rocking: tuple[int, int] | None = None
        self._warming: tuple[int, float] | None = None
        self._last_row: list[float] = []

    def skip_to(self, at: float) -> None:
        """Go on after this time of the log, s."""
        self._sample = round(at * SAMPLE_RATE)

    def _near(self, attitude: Array) -> Array:
        return rotation_matrix(OFF * self._rng.uniform(-1.0, 1.0, 3)) @ attitude

    @property
    def moving(self) -> bool:
        """Whether a turn is under way."""
        return self._sample < self._move.first + self._move.samples

    def turn(self, axis: str, degrees: float, *, rate: float = RATE) -> None:
        """Turn about N, U or E."""
        self._start(degrees * DEGREE * AXES[axis], rate)

    def go_to(self, position: int, *, rate: float = RATE) -> None:
        """Turn into a position of the programme, the way of the programme where it has one."""
        target = self._near(self.programme.positions[position].matrix)
        move = self.programme.moves[position - 1] if position else None
        vector = rotation_vector(target @ self._now().T)
        if move is not None and move.axis is not None and move.angle is not None and np.linalg.norm(vector) > 1.0:
            whole = move.angle * move.axis
            rest = rotation_vector(rotation_matrix(-whole) @ target @ self._now().T)
            vector = whole + rest if np.linalg.norm(rest) < NEAR else vector
        self._start(vector, rate)

    def told(self, what: str) -> None:
        """Do what is said: "N+90" or "to 3", "knock", "lose" or "stick"; nothing for anything else."""
        if what in ("knock", "lose", "stick"):
            getattr(self, what)()
        elif what.startswith("to "):
            number = whole_number(what[3:])
            if number is not None and 0 < number <= len(self.programme.positions):
                self.go_to(number - 1)
        elif what[:1] in AXES:
            with contextlib.suppress(ValueError):
                self.turn(what[0], float(what[1:]))

    def _start(self, vector: Array, rate: float) -> None:
        angle = float(np.linalg.norm(vector))
        samples = max(round(2.0 * angle / rate * SAMPLE_RATE), 10)
        self._move = _Move(vector=vector, start=self._now(), first=self._sample, samples=samples)

    def _now(self) -> Array:
        return self._move.attitude(self._sample)

    def knock(self) -> None:
        """A blow against the table."""
        self._knocked = self._sample + 10

    def lose(self, seconds: float = 0.5) -> None:
        """Samples that do not arrive."""
        self._lost = self._sample + round(seconds * SAMPLE_RATE)

    def stick(self, seconds: float = 2.0) -> None:
        """A channel that repeats itself."""
        self._stuck = self._sample + round(seconds * SAMPLE_RATE)

    def rock(self, seconds: float = 1.5) -> None:
        """A unit put down with movement when the turn under way ends: it comes to rest slowly."""
        self._rocking = self._move.first + self._move.samples, round(seconds * SAMPLE_RATE)

    def warm(self, rate: float = 1.0) -> None:
        """The temperature drifts from now on, K/s, where it is sent."""
        self._warming = self._sample, rate

    def read(self, timeout: float) -> bytes:
        if self._begun is None:
            self._begun = time.monotonic() - self._sample / SAMPLE_RATE / self.speed
        due = int((time.monotonic() - self._begun) * self.speed * SAMPLE_RATE)
        if due <= self._sample:
            time.sleep(min(timeout, 0.02))
            return b""
        lines = [self.line() for _ in range(min(due - self._sample, 4096))]
        return "".join(lines).encode("ascii")

    def line(self) -> str:
        """The next sample as a line; empty where it does not arrive."""
        middle = self._sample + 0.5
        still, rocking = self._rocked(middle)
        L, rate = still @ self._move.attitude(middle), still @ self._move.rate(middle) + rocking
        force = L.T @ (GRAVITY * AXES["U"])
        if self._sample < self._knocked:
            force = force + KNOCK * self._rng.standard_normal(3)
        true = [force, L.T @ (rate + np.array(earth_rate(LATITUDE_DEG * DEGREE)))]
        row = [
            value
            for model, sigma, vector in zip(self._models, self._sigma, true, strict=True)
            for value in model.matrix @ vector + model.bias + sigma * self._rng.standard_normal(3)
        ]
        row[3:] = np.clip(row[3:], -FULL_SCALE, FULL_SCALE).tolist()
        if self._sample < self._stuck:
            row[1] = self._last_row[1]
        self._last_row, self._sample = row, self._sample + 1
        lost = self._sample < self._lost
        row += [self._degrees()] if self.temperature else []
        return "" if lost else ",".join(f"{value:.9g}" for value in [self._sample / SAMPLE_RATE, *row]) + "\n"

    def _rocked(self, sample: float) -> tuple[Array, Array]:
        """How far the unit still is from where it will lie, and how fast it goes there, rad/s."""
        if self._rocking is None:
            return np.eye(3), np.zeros(3)
        first, samples = self._rocking
        left = 1.0 - (sample - first) / samples
        rate = -ROCKING * SAMPLE_RATE / samples if 0.0 <= left <= 1.0 else 0.0
        return rotation_matrix(ROCKING * min(max(left, 0.0), 1.0) * AXES["N"]), rate * AXES["N"]

    def _degrees(self) -> float:
        since, rate = self._warming or (self._sample, 0.0)
        return 25.0 + rate * (self._sample - since) / SAMPLE_RATE

    def close(self) -> None:
        """Nothing is open."""
