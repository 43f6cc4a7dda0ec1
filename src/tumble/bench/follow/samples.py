"""The rows of a log on disk as it grows, and the samples they are."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tumble.bench.record.lines import Lines
from tumble.bench.record.recorder import growing_file
from tumble.recording.log import Chunk
from tumble.recording.rows.gaps import JUMP
from tumble.recording.rows.timed import leaping
from tumble.recording.session import LogSpec
from tumble.units import ZERO_CELSIUS, Array

PIECE_BYTES = 1 << 18
BRIDGED = 25
"""Samples in a row that may be missing without a turn being lost."""
_HEAD = 100


class Follower:
    """Reads whole lines of a growing text log; `at` is where the next begins."""

    def __init__(self, spec: LogSpec) -> None:
        self.at = 0
        self._path = growing_file(spec)
        self._lines = Lines(columns=spec.columns, clock=spec.time, refuse=lambda _: None)

    def rows(self) -> Array:
        """Rows (m, columns) that have come since the last time, at most those of a piece of the file. What is no row is
        counted by whoever records it."""
        with self._path.open("rb") as file:
            file.seek(self.at)
            data = file.read(PIECE_BYTES)
        data = data[: data.rfind(b"\n") + 1]
        self.at += len(data)
        return self._lines.numbers(data)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SoundSamples:
    """Sound samples: end times and intervals, s, and the numbers of the log without its time; `lost` before each."""

    time: Array
    dt: Array
    values: Array
    lost: Array

    def chunk(self, spec: LogSpec, file: int = 0) -> Chunk:
        """The samples in SI."""
        readings, first = list[Array](), 0
        for channels in (spec.accel, spec.gyro):
            if channels is not None:
                last = first + len(channels.columns)
                readings.append(channels.to_si(self.values[:, first:last], self.dt))
                first = last
        temperature = None
        if spec.temperature is not None:
            warmth = self.values[:, -len(spec.temperature.columns) :]
            temperature = spec.temperature.to_celsius(warmth) + ZERO_CELSIUS
        gyro = None if spec.gyro is None else readings[1]
        return Chunk(file=file, time=self.time, dt=self.dt, accel=readings[0], gyro=gyro, temperature=temperature)


@dataclass(kw_only=True, slots=True, eq=False)
class Clock:
    """Makes samples of rows: in the order of their times, with the interval of each. `interval` is None until there
    are enough rows to know it. A row that leaps beyond the next one is none, as in the log that is calibrated; a last
    one that may is held until the next has come."""

    spec: LogSpec
    head: int = _HEAD
    """Rows from which the interval is learned."""
    interval: float | None = None
    _last: float | None = None
    _count: int = 0
    _start: float = 0.0
    _before: tuple[Array, ...] = ()
    """Rows that came before the interval was known."""
    _held: Array | None = None

    def samples(self, rows: Array) -> SoundSamples | None:
        """The samples of the next rows; None while the interval is not known."""
        spec = self.spec
        if self.interval is None:
            self._before = (*self._before, rows)
            if sum(map(len, self._before)) < self.head:
                return None
            rows, self._before = np.concatenate(self._before), ()
            if spec.time is None:
                self.interval = self._start = 1.0 / (spec.rate or 1.0)
            else:
                time = rows[: self.head, 0] * spec.time_factor
                regular = (time[-1] - time[0]) / (len(time) - 1)
                self.interval = float(regular if spec.regular else np.median(np.diff(time)))
                self._start = float(time[0])
        interval, last = self.interval, self._last
        if spec.time is None or spec.regular:
            time = self._start + interval * np.arange(self._count, self._count + len(rows), dtype=float)
            self._count += len(rows)
        else:  # those whose times increase, without those that leap beyond the next
            rows = rows if self._held is None else np.concatenate([self._held, rows])
            time = rows[:, 0] * spec.time_factor
            times = np.concatenate([[-math.inf if last is None else last], time])
            keep = ~leaping(time, float(times[0]), JUMP * interval)
            self._held = rows[-1:] if len(time) and times[-1] - times[-2] > JUMP * interval else None
            if self._held is not None:
                keep[-1] = False
            rows, time = rows[keep], time[keep]
            later = time > np.maximum.accumulate(np.concatenate([times[:1], time]))[:-1]
            rows, time = rows[later], time[later]
        sound = np.isfinite(rows).all(axis=1)
        values, time = (rows if spec.time is None else rows[:, 1:])[sound], time[sound]
        before = time[:1] - interval if last is None else np.array([last])
        dt = np.diff(np.concatenate([before, time])) if len(time) else np.empty(0)
        lost = np.where(dt > 1.5 * interval, np.round(dt / interval) - 1.0, 0.0)
        if len(time):
            self._last = float(time[-1])
        return SoundSamples(time=time, dt=np.where(lost > BRIDGED, interval, dt), values=values, lost=lost)
