"""The times of rows that are equally spaced, from all of their time stamps.

Stamps may be too coarse or too late to be times of rows at all: rows that are said to be regular are counted, and lie
on the straight line through all stamps. Or stamps are rounded, to thousandths of a second or to 32 bits, and otherwise
right: then they say which time of the line each row has, lost rows included. For increments that matters: their sum
over 35 s, divided by a duration that is 0.5 ms off, is wrong by 14 ppm of gravity, where a mean of rates is not.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tumble.errors import LogError
from tumble.recording.log_source import Kind, LogSource
from tumble.recording.rows.gaps import Grid, is_reading
from tumble.recording.session import LogSpec
from tumble.units import Array

_FINEST = 9
"""Decimals that stamps may be rounded to, in their unit."""
_COARSEST = 0.25
"""Of the interval: stamps that are rounded by more do not say which row is which."""
_OFF = 0.6
"""Of the step they are rounded to: stamps further from the straight line are not rounded times of it."""
_ROUNDING = 4.0 * np.finfo(float).eps


def regular_grid(source: LogSource, spec: LogSpec) -> Grid:
    """The grid of rows that are equally spaced: the straight line through all time stamps, whatever their resolution
    and their delays."""
    count, line = 0, _StampLine()
    for time in _stamps(source, spec):
        sound = is_reading(time)
        line.add(np.arange(count, count + len(time), dtype=float)[sound], time[sound])
        count += len(time)
    grid = line.grid()
    if not grid.interval > 0.0:
        raise LogError(
            f"{source.path}: expected times that grow, found rows {grid.interval:.3g} s apart; check log.time"
        )
    return grid


def rounded_grid(source: LogSource, spec: LogSpec, interval: float) -> Grid | None:
    """The grid whose times, rounded, are the time stamps of rows about `interval` s apart; None where they are none."""
    resolution, line, number, last = _Resolution(), _StampLine(), 0.0, None
    for time in _stamps(source, spec):
        step = resolution.of(time / spec.time_factor) * spec.time_factor
        if not 0.0 < step <= _COARSEST * interval:
            return None
        numbers = number + np.cumsum(np.rint(np.diff(time, prepend=time[:1] if last is None else last) / interval))
        line.add(numbers, time)
        if len(time):
            number, last = float(numbers[-1]), time[-1:]
    grid = line.grid(rounded=True)
    if not grid.interval > 0.0:
        return None
    off = (np.abs(time - grid.nearest(time)).max(initial=0.0) for time in _stamps(source, spec))
    return grid if max(off) <= _OFF * step else None


class _StampLine:
    """The straight line of least squares through times over numbers."""

    def __init__(self) -> None:
        self._start: float | None = None
        self._sums = np.zeros(5)  # of 1, k, t, k², k t

    def add(self, k: Array, time: Array) -> None:
        """Add times (m,), s, of these numbers (m,)."""
        if self._start is None and len(time):
            self._start = float(time[0])
        t = time - (self._start or 0.0)
        self._sums += [len(k), k.sum(), t.sum(), (k * k).sum(), (k * t).sum()]

    def grid(self, *, rounded: bool = False) -> Grid:
        """The line as a grid."""
        ones, k1, t1, k2, kt = self._sums.tolist()
        interval = (ones * kt - k1 * t1) / (ones * k2 - k1 * k1)
        return Grid(start=(self._start or 0.0) + (t1 - interval * k1) / ones, interval=interval, rounded=rounded)


def _stamps(source: LogSource, spec: LogSpec) -> Iterator[Array]:
    """All time stamps, s, of the lines that are rows, table by table."""
    assert spec.time is not None
    first = 1
    for table, unread in source.tables([spec.time], spec.time if spec.clock else None):
        keep = np.ones(table.height, dtype=bool)
        keep[[u.row - first for u in unread if u.kind in (Kind.NO_ROW, Kind.CUT)]] = False
        first += table.height
        yield table[spec.time].to_numpy()[keep] * spec.time_factor


class _Resolution:
    """What numbers are rounded to: decimals, or the last bit of 32."""

    def __init__(self) -> None:
        self._decimals, self._single, self._largest = 0, True, 0.0

    def of(self, numbers: Array) -> float:
        """The step of these numbers (m,) and all before; 0 where there is none."""
        if not is_reading(numbers).all():
            return 0.0
        self._largest = max(self._largest, float(np.abs(numbers).max(initial=0.0)))
        self._single &= bool((numbers.astype(np.float32) == numbers).all())
        while self._decimals <= _FINEST and not _on_decimals(numbers, self._decimals):
            self._decimals += 1
        if self._decimals <= _FINEST:
            return float(10.0**-self._decimals)
        return float(np.spacing(np.float32(self._largest))) if self._single else 0.0


def _on_decimals(values: Array, decimals: int) -> bool:
    """Whether numbers have no more decimals."""
    scaled = values * 10.0**decimals
    return bool((np.abs(scaled - np.rint(scaled)) <= _ROUNDING * np.abs(scaled) + 1e-9).all())
