"""The rows of a file that have a time of their own, in the order of time.

A row is left out whose time cannot be read, or is that of the row before; that leaps, alone or with the rows behind it,
beyond a row that follows the one before them; or that falls back, to or before the time of one that was kept. If as
many intervals pass as rows are left out, the stamps were wrong, and what is missing is bridged. Else the clock was set
back, or rows are there twice: nobody knows what time passed, and no turn is known there.

Stamps may be too coarse or too late to be times of rows at all: rows that are said to be regular are counted, and lie
on the straight line through all stamps. Or stamps are rounded, to thousandths of a second or to 32 bits, and otherwise
right: then they say which time of the line each row has, lost rows included. For increments that matters: their sum
over 35 s, divided by a duration that is 0.5 ms off, is wrong by 14 ppm of gravity, where a mean of rates is not.

A driver that reads a buffer of samples at once knows when it has read it, and spreads the samples over the time since
it did so before. Their intervals are equal within a burst and change from one to the next, by as much as the reading is
late; the sensor's own clock does not. Where the stamps of a file stay about a straight line, rows lie on it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from tumble.errors import LogError
from tumble.recording.log_source import Kind, LogSource, unread_error
from tumble.recording.rows.gaps import (
    FREE,
    JUMP,
    MOST,
    REGULAR_HINT,
    SHARE,
    Gap,
    Grid,
    LogRows,
    check_time,
    is_reading,
    runs_backwards,
    side_by_side,
)
from tumble.recording.session import LogSpec
from tumble.units import Array, BoolArray

_HALF_DAY = 43200.0  # s: a clock that falls by more has passed midnight
_PASSED = 0.5
"""Of an interval: so far from the time of the rows between, the time that has passed is another one."""
_TOGETHER = 20
"""Rows that leap together at most: of more, those that fall back behind them are the wrong ones."""
_FINEST = 9
"""Decimals that stamps may be rounded to, in their unit."""
_COARSEST = 0.25
"""Of the interval: stamps that are rounded by more do not say which row is which."""
_OFF = 0.6
"""Of the step they are rounded to: stamps further from the straight line are not rounded times of it."""
_ROUNDING = 4.0 * np.finfo(float).eps
_UNEVEN = 3e-3
"""Of an interval: intervals of bursts that differ by less do no harm."""
_WITHIN = 0.05
"""Of the scatter of intervals: what neighbours in a burst differ by, at the median."""
_DIGITS, _OF_ROUNDING = 6, 4
"""Different intervals, in parts of one to so many decimals, that even rows have whose stamps are rounded."""
_ABOUT_LINE = 40
"""Bursts, over which the mean distance of stamps from a straight line is taken."""
_STAYS, _LATE = 0.3, 0.5
"""Of an interval, and of the scatter about that mean: how far it may be from the line, less than a lost sample."""
_FAST = 2.0
"""Times that mean: the scatter about it, where intervals jitter and the clock does not wander."""


def check_head(source: LogSource, spec: LogSpec, time: Array) -> Array:
    """The first times of a file without those that cannot be read, are repeated, leap or fall back, if they are few."""
    read = np.flatnonzero(is_reading(time))
    number = read[~leaping(time[read], -math.inf, 0.0)]
    late = _no_later(time[number], -math.inf)
    kept = number[~late]
    again = np.count_nonzero(late[1:] & (np.diff(time[number]) == 0.0))
    few = len(read) - len(kept) - again <= FREE + SHARE * len(time) and 2 * again < len(read)
    if not few or len(kept) < 2:
        check_time(source, spec, np.arange(1, len(time) + 1), time)
    return np.asarray(time[kept])


def leaping(time: Array, before: float, step: float) -> BoolArray:
    """Which of times (m,) leap, by more than a step, beyond one that follows the row `before` them."""
    found = np.zeros(len(time), dtype=bool)
    for stop in (np.flatnonzero(time[1:] < time[:-1]) + 1).tolist():
        beyond = time[max(0, stop - _TOGETHER - 1) : stop] > time[stop]
        start = stop - (len(beyond) if beyond.all() else int(np.argmin(beyond[::-1])))
        former = time[start - 1] if start else before
        most = _TOGETHER if former > -math.inf else 1  # of the first rows of a file none says which are wrong
        if stop - start <= most and former < time[stop] and time[start] - former > step:
            found[start:stop] = True
    return found


def _no_later(time: Array, before: float) -> BoolArray:
    """Which of times (m,) are no later than one `before` or another before them."""
    read = np.where(is_reading(time), time, -math.inf)
    latest = np.maximum.accumulate(np.concatenate([[before], read]))[: len(time)]
    return np.asarray((time <= latest) & is_reading(time))


def rows_of(
    source: LogSource, spec: LogSpec, file: int, grid: Grid, gaps: list[Gap], *, on_grid: bool
) -> Iterator[LogRows]:
    """The rows of a file that have a time; `on_grid` row k, counted from 0, has its k-th time, or the one nearest to
    its stamp. Lines that are left out are added to `gaps`."""
    groups = [part.columns for part in (spec.accel, spec.gyro, spec.magnetometer, spec.temperature) if part is not None]
    sieve = _Sieve(source=source, spec=spec, file=file, grid=grid, on_grid=on_grid, gaps=gaps)
    first = 1
    for table, unread in source.tables(spec.columns, spec.time if spec.clock else None):
        numbers = np.arange(first, first + table.height)
        time = table[spec.time].to_numpy() * spec.time_factor if spec.time is not None else np.empty(table.height)
        values = tuple(side_by_side(table, group) for group in groups)
        yield sieve.kept(LogRows(numbers=numbers, time=time, values=values, unread={u.row: u for u in unread}))
        first += table.height
    if sieve.held is not None:
        yield sieve.judged(sieve.held, last=True)
    if sieve.left_out - sieve.repeated > FREE + SHARE * (first - 1) or 2 * sieve.repeated >= first - 1:
        raise sieve.too_many(first - 1)


@dataclass(kw_only=True, slots=True)
class _Sieve:
    """Leaves out the rows of a file that have no time of their own. `count`: rows that went out; `last`: the time of
    the last of them; `shift`: what midnights have added to a clock, s; `held`: the last rows, of which only the next
    ones tell whether they leap or fall back; `falls`: of rows that do how many there are, the first, the time before it
    and its own, s."""

    source: LogSource
    spec: LogSpec
    file: int
    grid: Grid
    on_grid: bool
    gaps: list[Gap]
    count: int = 0
    last: float = -math.inf
    shift: float = 0.0
    held: LogRows | None = None
    falls: list[tuple[int, int, float, float]] = field(default_factory=list)
    left_out: int = 0
    repeated: int = 0
    first: Gap | None = None

    def kept(self, rows: LogRows) -> LogRows:
        """The rows of a table, and those that were held before, that have a time of their own."""
        counted = self.on_grid and not self.grid.rounded  # whatever their stamps say
        untimed = (None, self.spec.time) if not counted else ()
        lines = [u for u in rows.unread.values() if u.kind in (Kind.NO_ROW, Kind.CUT) or u.column in untimed]
        if lines:
            keep = np.ones(len(rows.numbers), dtype=bool)
            keep[np.array([u.row for u in lines]) - rows.numbers[0]] = False
            rows = rows.part(keep)
        if counted:
            number = np.arange(self.count, self.count + len(rows.time), dtype=float)
            rows = replace(rows, time=np.asarray(self.grid.start + self.grid.interval * number, dtype=float))
        else:
            rows = self._timed(rows)
        for u in lines:
            if u.row == 1 and u.kind in (Kind.ROW, Kind.VALUE):
                raise unread_error(self.source, u)
            if u.kind is not Kind.NO_ROW:
                before = int(np.searchsorted(rows.numbers, u.row)) - 1
                self._leave_out(u.row, u.what, float(rows.time[before]) if before >= 0 else self.last)
        self.count += len(rows.time)
        self.last = float(rows.time[-1]) if len(rows.time) else self.last
        return rows

    @np.errstate(invalid="ignore")  # of a first time that is -inf, as the one before it
    def _timed(self, rows: LogRows) -> LogRows:
        """The rows in the order of their times, which go on past midnight, without those that leap, fall or repeat."""
        if self.spec.clock and len(rows.time):
            time = rows.time + self.shift
            passed = np.cumsum(np.diff(time, prepend=self.last if np.isfinite(self.last) else time[0]) < -_HALF_DAY)
            self.shift += 2.0 * _HALF_DAY * float(passed[-1])
            rows = replace(rows, time=time + 2.0 * _HALF_DAY * passed)
        if self.on_grid:
            rows = replace(rows, time=self.grid.nearest(rows.time))
        steps = np.diff(rows.time, prepend=self.last)
        free = self.held is None and len(steps) > _TOGETHER and steps.min() > 0.0
        if free and steps[-_TOGETHER:].max() <= JUMP * self.grid.interval:
            return rows
        return self.judged(rows if self.held is None else self.held.followed_by(rows), last=False)

    @np.errstate(invalid="ignore")
    def judged(self, rows: LogRows, *, last: bool) -> LogRows:
        """Without rows that leap and without rows that are no later than one before them. Unless they are the `last` of
        the file, rows at the end that may leap are held back, and so are those that are no later."""
        step, unsure = JUMP * self.grid.interval, None
        leaps = leaping(rows.time, self.last, step)
        for at in np.flatnonzero(leaps).tolist():
            before = rows.time[:at][~leaps[:at]][-1:].tolist() or [self.last]
            self._leave_out(int(rows.numbers[at]), "a time stamp beyond that of a row behind it", before[0])
        rows = rows.part(~leaps) if leaps.any() else rows
        far = np.diff(rows.time, prepend=self.last)[-_TOGETHER:] > step
        if far.any() and not last:
            first = len(rows.time) - len(far) + int(np.argmax(far))
            unsure, rows = rows.part(slice(first, None)), rows.part(slice(0, first))
        late = _no_later(rows.time, self.last)
        sound = np.flatnonzero(~late)
        end = int(sound[-1]) + 1 if len(sound) else 0
        if last or len(late) - end > MOST - self.left_out:
            end = len(late)
        behind, self.held = rows.part(slice(end, None)), unsure
        if end < len(late):
            self.held = behind if unsure is None else behind.followed_by(unsure)
        rows, late = rows.part(slice(0, end)), late[:end]
        found = np.flatnonzero(late)
        for run in np.split(found, np.flatnonzero(np.diff(found) > 1) + 1) if len(found) else ():
            before = float(rows.time[run[0] - 1]) if run[0] else self.last
            after = float(rows.time[run[-1] + 1]) if run[-1] + 1 < end else math.nan
            self._behind(rows.numbers[run].tolist(), rows.time[run], before, after)
        return rows.part(~late) if len(found) else rows

    def _behind(self, rows: list[int], time: Array, before: float, after: float) -> None:
        """Report rows whose times (m,) are no later than one `before` them; `after` is the time of the next row, nan
        where there is none. s."""
        falls, passed = float(time.min()) < before, (after - before) / self.grid.interval
        if falls:
            self.falls.append((len(rows), rows[0], before, float(time[0])))
        if not falls or abs(passed - len(rows) - 1.0) < _PASSED:
            what = "a time stamp before that of the row before" if falls else "the time stamp of the row before"
            self.repeated += 0 if falls else len(rows)
            for row in rows:
                self._leave_out(row, what, before)
            return
        self.left_out += len(rows)
        self._report(
            Gap(
                file=self.file,
                row=rows[0],
                time=before,
                samples=len(rows),
                what="time stamps that fall back",
                stop=after,
                integrable=False,
                why="the clock falls back in it",
            )
        )

    def _leave_out(self, row: int, what: str, before: float) -> None:
        self.left_out += 1
        self._report(Gap(file=self.file, row=row, time=max(before, 0.0), samples=0, what=f"{what}: left out"))

    def _report(self, gap: Gap) -> None:
        self.first = self.first or gap
        if self.left_out > MOST:
            raise self.too_many(self.count)
        self.gaps.append(gap)

    def too_many(self, rows: int) -> LogError:
        """What is said where too many of so many rows were left out."""
        assert self.first is not None
        if 2 * sum(count for count, *_ in self.falls) > self.left_out:
            return runs_backwards(self.source, self.spec, *self.falls[0][1:])
        advice = f"; {REGULAR_HINT}" if "stamp" in self.first.what else "; look at the file, or record again"
        return LogError(
            f"{self.source.place(self.first.row)}: expected at most {SHARE:.0%} of the rows and {FREE} to be left "
            f"out, found {self.left_out} of {rows}, the first here ({self.first.what}){advice}"
        )


# -------------------- equally spaced rows --------------------


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
    """The grid whose times, rounded to decimals or to the last bit of 32, are the time stamps of rows about `interval`
    s apart; None where they are none."""
    line, number, last = _StampLine(), 0.0, None
    decimals, single, largest = 0, True, 0.0
    for time in _stamps(source, spec):
        stamps = time / spec.time_factor
        largest = max(largest, float(np.abs(stamps).max(initial=0.0)))
        single &= bool((stamps.astype(np.float32) == stamps).all())
        while decimals <= _FINEST:
            scaled = stamps * 10.0**decimals
            if (np.abs(scaled - np.rint(scaled)) <= _ROUNDING * np.abs(scaled) + 1e-9).all():
                break
            decimals += 1
        step = 10.0**-decimals if decimals <= _FINEST else float(np.spacing(np.float32(largest))) if single else 0.0
        step *= spec.time_factor
        if not (is_reading(stamps).all() and 0.0 < step <= _COARSEST * interval):
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


def burst_grid(source: LogSource, spec: LogSpec, head: Array) -> Grid | None:
    """The grid of rows whose stamps are spread evenly over bursts; None where those of the head (m,), s, are not, or
    where stamps do not stay about one straight line."""
    steps = np.diff(head)
    interval, scatter, changes = float(np.median(steps)), float(np.std(steps)), np.abs(np.diff(steps))
    different = len(np.unique(np.round(steps / interval, _DIGITS)))
    if scatter <= _UNEVEN * interval or np.median(changes) > _WITHIN * scatter or different <= _OF_ROUNDING:
        return None
    bursts = 1 + int(np.count_nonzero(changes > _WITHIN * scatter))
    window = _ABOUT_LINE * math.ceil(len(head) / bursts)
    grid, time = regular_grid(source, spec), np.concatenate(list(_stamps(source, spec)))
    off = time - grid.start - grid.interval * np.arange(len(time))
    windows = len(off) // window
    if windows < 2 or not is_reading(time).all():
        return None
    parts = off[: windows * window].reshape(windows, -1)
    means, jitter = parts.mean(axis=1), float(parts.std(axis=1).mean())
    stays = np.abs(means).max() <= _STAYS * grid.interval + _LATE * jitter
    return replace(grid, jitter=jitter) if stays and jitter > _FAST * means.std() else None


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
    """All time stamps, s, of the lines that are rows, table by table; times of day go on past midnight."""
    assert spec.time is not None
    first, days, last = 1, 0, np.empty(0)
    for table, unread in source.tables([spec.time], spec.time if spec.clock else None):
        keep = np.ones(table.height, dtype=bool)
        keep[[u.row - first for u in unread if u.kind in (Kind.NO_ROW, Kind.CUT)]] = False
        first += table.height
        time = table[spec.time].to_numpy()[keep] * spec.time_factor
        passed = days + np.cumsum(np.diff(np.concatenate([last, time])) < -_HALF_DAY) if spec.clock else np.zeros(0)
        if len(passed):
            last, days = time[-1:], int(passed[-1])
            time = time + 2.0 * _HALF_DAY * np.concatenate([np.zeros(len(time) - len(passed)), passed])
        yield time
