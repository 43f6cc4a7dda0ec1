"""What a log on disk says so far, followed as it grows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tumble.bench.lines import Lines, numbers_in
from tumble.recording.rows.gaps import JUMP
from tumble.recording.rows.timed import leaping
from tumble.recording.session import LogSpec
from tumble.units import Array

PIECE_BYTES = 1 << 18


@dataclass(kw_only=True, slots=True)
class Follower:
    """Reads whole lines of a growing text log: `columns` are those of the session, in its order; `at` is where the next
    begins."""

    path: Path
    columns: tuple[str, ...]
    clock: str | None
    at: int = 0
    _lines: Lines | None = None

    @staticmethod
    def of(spec: LogSpec) -> Follower:
        """Of the file of a log."""
        return Follower(path=growing_file(spec), columns=spec.columns, clock=spec.time)

    def rows(self) -> Array:
        """Rows (m, columns) that have come since the last time, at most those of a piece of the file."""
        with self.path.open("rb") as file:
            file.seek(self.at)
            data = file.read(PIECE_BYTES)
        data = data[: data.rfind(b"\n") + 1]
        self.at += len(data)
        if not data:
            return np.empty((0, len(self.columns)))
        if self._lines is None:
            self._lines = Lines(columns=self.columns, clock=self.clock, refuse=_nothing)
        return self._parsed(self._lines, data)

    def _parsed(self, lines: Lines, data: bytes) -> Array:
        if lines.in_order:
            numbers = numbers_in(data, len(self.columns))
            if numbers is not None:
                return numbers
        values = [float(value) for row in lines.feed(data) for value in row.text.split(",")]
        return np.array(values).reshape(-1, len(self.columns))


def growing_file(spec: LogSpec) -> Path:
    """The last file of a log, which is the one that grows."""
    path = spec.files[-1]
    assert isinstance(path, Path)
    return path


def _nothing(_: bytes) -> None:
    """What is no row is counted by whoever records it."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SoundSamples:
    """Sound samples: end times and intervals, s, and the numbers of the log without its time; `lost` before each."""

    time: Array
    dt: Array
    values: Array
    lost: Array


BRIDGED = 25
"""Samples in a row that may be missing without a turn being lost."""
_HEAD = 100


@dataclass(kw_only=True, slots=True, eq=False)
class Clock:
    """Makes samples of rows: in the order of their times, with the interval of each. `interval` is None until there
    are enough rows to know it. A row that leaps beyond the next one is none, as in the log that is calibrated; a last
    one that may is held until the next has come."""

    spec: LogSpec
    head: int = _HEAD
    """Rows from which the interval is learned."""
    interval: float | None = None
    last: float | None = None
    count: int = 0
    start: float = 0.0
    _head: list[Array] | None = None
    _held: Array | None = None

    def samples(self, rows: Array) -> SoundSamples | None:
        """The samples of the next rows; None while the interval is not known."""
        if self.interval is None:
            self._head = [*(self._head or []), rows]
            if sum(map(len, self._head)) < self.head:
                return None
            rows, self._head = np.concatenate(self._head), None
            self._learn(rows[: self.head])
        assert self.interval is not None
        if self.spec.time is None or self.spec.regular:
            time = np.asarray(self.start + self.interval * np.arange(self.count, self.count + len(rows)), dtype=float)
            self.count += len(rows)
        else:
            rows, time = self._in_order(rows, JUMP * self.interval)
        values = rows if self.spec.time is None else rows[:, 1:]
        sound = np.isfinite(rows).all(axis=1)
        return self._steps(time[sound], values[sound], self.interval)

    def _in_order(self, rows: Array, step: float) -> tuple[Array, Array]:
        """The rows whose times, s, increase, without those that leap by more than a `step` beyond the next."""
        rows = rows if self._held is None else np.concatenate([self._held, rows])
        time = rows[:, 0] * self.spec.time_factor
        before = -math.inf if self.last is None else self.last
        keep = ~leaping(time, before, step)
        times = np.concatenate([[before], time])
        self._held = rows[-1:] if len(time) and times[-1] - times[-2] > step else None
        if self._held is not None:
            keep[-1] = False
        rows, time = rows[keep], time[keep]
        later = time > np.maximum.accumulate(np.concatenate([[before], time]))[:-1]
        return rows[later], time[later]

    def _learn(self, rows: Array) -> None:
        if self.spec.time is None:
            self.interval = 1.0 / (self.spec.rate or 1.0)
            self.start = self.interval
            return
        time = rows[:, 0] * self.spec.time_factor
        regular = (time[-1] - time[0]) / (len(time) - 1)
        self.interval = float(regular if self.spec.regular else np.median(np.diff(time)))
        self.start = float(time[0])

    def _steps(self, time: Array, values: Array, interval: float) -> SoundSamples:
        first = time[:1] - interval if self.last is None else np.array([self.last])
        dt = np.diff(np.concatenate([first, time])) if len(time) else np.empty(0)
        lost = np.where(dt > 1.5 * interval, np.round(dt / interval) - 1.0, 0.0)
        if len(time):
            self.last = float(time[-1])
        return SoundSamples(time=time, dt=np.where(lost > BRIDGED, interval, dt), values=values, lost=lost)
