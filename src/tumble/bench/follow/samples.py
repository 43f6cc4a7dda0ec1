"""The samples that the rows of a log are, as they come."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tumble.recording.log import Chunk
from tumble.recording.rows.gaps import JUMP
from tumble.recording.rows.timed import leaping
from tumble.recording.session import LogSpec
from tumble.units import ZERO_CELSIUS, Array

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
    _last: float | None = None
    _count: int = 0
    _start: float = 0.0
    _before: tuple[Array, ...] = ()
    """Rows that came before the interval was known."""
    _held: Array | None = None

    def samples(self, rows: Array) -> tuple[Chunk, Array] | None:
        """The sound samples of the next rows, SI, and how many are lost before each; None while the interval is not
        known, or where there are none."""
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
        if not len(time):
            return None
        dt = np.diff(time, prepend=time[0] - interval if last is None else last)
        lost = np.where(dt > 1.5 * interval, np.round(dt / interval) - 1.0, 0.0)
        dt, self._last = np.where(lost > BRIDGED, interval, dt), float(time[-1])
        n, heat = len(spec.accel.columns), 0 if spec.temperature is None else len(spec.temperature.columns)
        gyro = kelvin = None
        if spec.gyro is not None:
            gyro = spec.gyro.to_si(values[:, n : n + len(spec.gyro.columns)], dt)
        if spec.temperature is not None:
            kelvin = spec.temperature.to_celsius(values[:, -heat:]) + ZERO_CELSIUS
        accel = spec.accel.to_si(values[:, :n], dt)
        return Chunk(file=0, time=time, dt=dt, accel=accel, gyro=gyro, temperature=kelvin), lost
