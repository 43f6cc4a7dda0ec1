"""Rows of a file that have a time of their own, in the order of time.

A row is left out if its time cannot be read or repeats that of the row before; if it leaps, alone or with the following
rows, beyond the time of a later row; or if it falls back to or before the time of a row that was kept. If as many
intervals pass as rows are left out, their stamps were wrong, and the missing samples are bridged. Otherwise the clock
was set back, or rows are in the file twice: the elapsed time is unknown, and a turn in it cannot be integrated.

Stamps can be unusable as the times of rows:

* Rows that are stated to be regular are counted, and lie on the straight line through all stamps.
* Stamps rounded to decimals or to 32 bits identify the time of each row on the line, lost rows included. For increments
  this matters: a sum over 35 s, divided by a duration that is 0.5 ms off, is wrong by 14 ppm of gravity, unlike a mean
  of rates.
* A driver that reads a buffer of samples at once spreads them evenly over the time since it read the last buffer. The
  intervals are equal within a burst and differ between bursts by the delays of the driver, unlike those of the sensor's
  clock. If the stamps of a file stay about a straight line, rows lie on it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tumble.errors import LogError
from tumble.recording.log_source import BLANK_LINE, Kind, LogSource, Unread, unread_error
from tumble.recording.rows.gaps import (
    GAP_STEP,
    LEFT_OUT_FREE,
    LEFT_OUT_SHARE,
    MOST_GAPS,
    NUMBER,
    REGULAR_HINT,
    TIME,
    Gap,
    Grid,
    Tables,
    check_time,
    is_reading,
    runs_backwards,
    seconds_of_stamps,
)
from tumble.recording.session import LogSpec
from tumble.units import Array, BoolArray

_HALF_DAY = 43200.0  # s; a clock that falls by more has passed midnight
_PASSED_TOLERANCE = 0.5  # intervals, of the time that passed while rows were left out
_LONGEST_LEAP = 20  # rows that leap together; after a longer run the rows that fall back are taken as wrong
_MOST_DECIMALS = 9  # of rounded stamps, in their unit
_COARSEST = 0.25  # of the interval; stamps rounded more coarsely do not distinguish rows
_ROUNDING_TOLERANCE = 0.6  # of the rounding step, of stamps about the straight line
_ROUNDING_ERROR = 4.0 * np.finfo(float).eps
_UNEVEN = 3e-3  # of the interval; smaller scatter of the intervals of bursts is harmless
_WITHIN_BURST = 0.05  # of the scatter of intervals: median difference of neighbouring intervals in a burst
_INTERVAL_DECIMALS, _FEW_INTERVALS = 6, 4  # even rows with rounded stamps have few different intervals
_BURSTS_PER_WINDOW = 40  # over which the mean distance of stamps from a straight line is taken
_LINE_INTERVALS, _LINE_SCATTERS = 0.3, 0.5  # tolerance of that mean: intervals, less than a lost sample, and scatters
_JITTER_RATIO = 2.0  # least ratio of the scatter to these means, where intervals jitter and the clock does not wander


def check_head(source: LogSource, spec: LogSpec, time: Array) -> Array:
    """Return the first times (m,) of a file, s, without unreadable, repeated, leaping and falling ones.

    Raises LogError unless these are few."""
    finite = np.flatnonzero(is_reading(time))
    in_order = finite[~leaping(time[finite], -math.inf, 0.0)]
    late = _is_late(time[in_order], -math.inf)
    kept = in_order[~late]
    repeated = np.count_nonzero(late[1:] & (np.diff(time[in_order]) == 0.0))
    dropped = len(finite) - len(kept) - repeated
    few = dropped <= LEFT_OUT_FREE + LEFT_OUT_SHARE * len(time) and 2 * repeated < len(finite)
    if not few or len(kept) < 2:
        check_time(source, spec, np.arange(1, len(time) + 1), time)
    return np.asarray(time[kept])


def leaping(time: Array, before: float, step: float) -> BoolArray:
    """Return which times (m,) exceed a later time by more than a `step`.

    `before` is the time of the row before them, −inf at the start of a file."""
    leaps = np.zeros(len(time), dtype=bool)
    for stop in (np.flatnonzero(time[1:] < time[:-1]) + 1).tolist():
        beyond = time[max(0, stop - _LONGEST_LEAP - 1) : stop] > time[stop]
        start = stop - (len(beyond) if beyond.all() else int(np.argmin(beyond[::-1])))
        former = time[start - 1] if start else before
        longest = _LONGEST_LEAP if former > -math.inf else 1  # at the start the rows before a fall may be wrong too
        if stop - start <= longest and former < time[stop] and time[start] - former > step:
            leaps[start:stop] = True
    return leaps


def _is_late(time: Array, before: float) -> BoolArray:
    """Return which times (m,) are no later than an earlier one, or than the time `before` them."""
    return np.asarray(time <= np.maximum.accumulate(np.concatenate([[before], time]))[: len(time)])


@dataclass(kw_only=True, slots=True)
class TimedRows:
    """The rows of a file that have a time of their own; what is left out is added to `gaps`.

    `count` rows were passed on, the last of them at the time `last`, s; `midnights` is added to times of day, s. The
    next table decides whether the `pending` rows leap or fall back. `falls` has, for each run of rows that fall back,
    the number of rows, the first row, the time before it and its own time, s; `blank` has gaps for blank lines between
    rows. `left_out` rows were left out, of which `repeated` repeat a stamp; `first` is the first gap."""

    source: LogSource
    spec: LogSpec
    file: int
    grid: Grid
    gaps: list[Gap]
    count: int = 0
    last: float = -math.inf
    midnights: float = 0.0
    pending: Array | None = None
    falls: list[tuple[int, int, float, float]] = field(default_factory=list)
    blank: list[Gap] = field(default_factory=list)
    left_out: int = 0
    repeated: int = 0
    first: Gap | None = None

    def rows(self, tables: Tables) -> Tables:
        """Yield the rows of tables whose times are as written and which are not numbered yet, in order."""
        first = 1
        for rows, unread in tables:
            rows[:, NUMBER] = np.arange(first, first + len(rows))
            rows[:, TIME] = seconds_of_stamps(rows[:, TIME], self.spec)
            yield self.feed(rows, unread), unread
            first += len(rows)
        if self.pending is not None:
            yield self.in_order(self.pending, last=True), ()
        self.finish(first - 1)

    def feed(self, rows: Array, unread: Sequence[Unread]) -> Array:
        """Add the rows of the next table, and return those, with pending ones, that have a time of their own."""
        counted = self.spec.unstamped or self.grid.jitter > 0.0  # row k has time k of the grid, whatever its stamp
        untimed = (None, self.spec.time) if not counted else ()
        faults = [u for u in unread if u.kind in (Kind.NO_ROW, Kind.CUT) or u.column in untimed]
        if not counted and not (timed := is_reading(rows[:, TIME])).all():
            known = {u.row for u in faults}
            without = (row for row in rows[~timed, NUMBER].astype(int).tolist() if row not in known)
            faults += [Unread(row=row, column=self.spec.time, found="", kind=Kind.TEXT) for row in without]
            faults.sort(key=lambda u: u.row)
        if faults:
            is_row = np.ones(len(rows), dtype=bool)
            is_row[np.array([u.row for u in faults]) - int(rows[0, NUMBER])] = False
            rows = rows[is_row]
        if counted:
            rows[:, TIME] = self.grid.start + self.grid.interval * np.arange(self.count, self.count + len(rows))
        else:
            rows = self._by_stamps(rows)
        for u in faults:
            if u.row == 1 and u.kind in (Kind.ROW, Kind.VALUE):
                raise unread_error(self.source, u)
            at = int(np.searchsorted(rows[:, NUMBER], u.row)) - 1
            before = float(rows[at, TIME]) if at >= 0 else self.last
            if u.kind is not Kind.NO_ROW:
                self._leave_out(self._gap(u.row, before, f"{u.what}: left out"))
            elif counted and u.found == BLANK_LINE:
                gap = self._gap(u.row, before, "a blank line, which may have been a sample")
                self.blank.append(replace(gap, stop=gap.time + self.grid.interval, integrable=False))
        self.count += len(rows)
        self.last = float(rows[-1, TIME]) if len(rows) else self.last
        return rows

    @np.errstate(invalid="ignore")  # the time before the first is -inf
    def _by_stamps(self, rows: Array) -> Array:
        """Return rows in the order of their stamps, past midnight too, without leaping, falling or repeated stamps."""
        time = rows[:, TIME]
        if self.spec.clock and len(rows):
            time += self.midnights
            passed = np.cumsum(np.diff(time, prepend=self.last if np.isfinite(self.last) else time[0]) < -_HALF_DAY)
            self.midnights += 2.0 * _HALF_DAY * float(passed[-1])
            time += 2.0 * _HALF_DAY * passed
        if self.grid.rounded:
            time[:] = self.grid.nearest(time)
        steps = np.diff(time, prepend=self.last)
        rising = self.pending is None and len(steps) > _LONGEST_LEAP and steps.min() > 0.0
        if rising and steps[-_LONGEST_LEAP:].max() <= GAP_STEP * self.grid.interval:
            return rows
        return self.in_order(rows if self.pending is None else np.concatenate([self.pending, rows]), last=False)

    @np.errstate(invalid="ignore")
    def in_order(self, rows: Array, *, last: bool) -> Array:
        """Return rows without those that leap and those whose time is not after an earlier one.

        Unless the rows are the `last` ones of the file, rows at the end that may leap or fall back become pending."""
        step, unsure = GAP_STEP * self.grid.interval, rows[:0]
        leaps = leaping(rows[:, TIME], self.last, step)
        for at in np.flatnonzero(leaps).tolist():
            before = rows[:at][~leaps[:at]][-1:, TIME].tolist() or [self.last]
            what = "a time stamp beyond that of a row behind it: left out"
            self._leave_out(self._gap(int(rows[at, NUMBER]), before[0], what))
        rows = rows[~leaps] if leaps.any() else rows
        far = np.diff(rows[:, TIME], prepend=self.last)[-_LONGEST_LEAP:] > step
        if far.any() and not last:
            first = len(rows) - len(far) + int(np.argmax(far))
            unsure, rows = rows[first:], rows[:first]
        late = _is_late(rows[:, TIME], self.last)
        end = len(late) - int(np.argmin(late[::-1])) if not late.all() else 0  # after the last row that is not late
        if last or len(late) - end > MOST_GAPS - self.left_out:
            end = len(late)
        pending = np.concatenate([rows[end:], unsure])
        self.pending = pending if len(pending) else None
        rows, late = rows[:end], late[:end]
        if not late.any():
            return rows
        self._leave_out_late(rows, late)
        return rows[~late]

    def _leave_out_late(self, rows: Array, late: BoolArray) -> None:
        """Leave out runs of late rows: one by one if as much time passes as they take, else as a gap."""
        at_late = np.flatnonzero(late)
        for run in np.split(at_late, np.flatnonzero(np.diff(at_late) > 1) + 1):
            first, count = int(rows[run[0], NUMBER]), len(run)
            before = float(rows[run[0] - 1, TIME]) if run[0] else self.last
            after = float(rows[run[-1] + 1, TIME]) if run[-1] + 1 < len(rows) else math.nan
            passed = (after - before) / self.grid.interval
            falls = float(rows[run, TIME].min()) < before
            if falls:
                self.falls.append((count, first, before, float(rows[run[0], TIME])))
            else:
                self.repeated += count
            if not falls or abs(passed - count - 1.0) < _PASSED_TOLERANCE:
                what = "a time stamp before that of the row before" if falls else "the time stamp of the row before"
                for row in rows[run, NUMBER].astype(int).tolist():
                    self._leave_out(self._gap(row, before, f"{what}: left out"))
            else:
                gap = replace(self._gap(first, before, "time stamps that fall back"), time=before, samples=count)
                gap = replace(gap, stop=after, integrable=False, why="the clock falls back in it")
                self._leave_out(gap, count)

    def _gap(self, row: int, before: float, what: str) -> Gap:
        """Return a gap at a row without missing samples; `before` is the time of the row before, s."""
        return Gap(file=self.file, row=row, time=max(before, 0.0), samples=0, what=what)

    def _leave_out(self, gap: Gap, rows: int = 1) -> None:
        """Add a gap at rows that are left out. Raises LogError if these are too many."""
        self.left_out += rows
        self.first = self.first or gap
        if self.left_out > MOST_GAPS:
            raise self._too_many(self.count)
        self.gaps.append(gap)

    def finish(self, rows: int) -> None:
        """Check the whole file, which has so many rows. Raises LogError if too many of them were left out.

        Without stamps a blank line may have been a sample; many blank lines, or evenly spaced ones, are layout."""
        distances = np.diff([gap.row for gap in self.blank])
        tolerated = LEFT_OUT_FREE + LEFT_OUT_SHARE * rows
        if len(self.blank) <= tolerated and (len(distances) < 2 or np.ptp(distances) > 0):
            self.gaps += self.blank
        if self.left_out - self.repeated > tolerated or 2 * self.repeated >= rows:
            raise self._too_many(rows)

    def _too_many(self, rows: int) -> LogError:
        """Return the error for a file of which too many of so many rows were left out."""
        assert self.first is not None
        if 2 * sum(count for count, *_ in self.falls) > self.left_out:
            return runs_backwards(self.source, self.spec, *self.falls[0][1:])
        advice = f"; {REGULAR_HINT}" if "stamp" in self.first.what else "; look at the file, or record again"
        return LogError(
            f"{self.source.place(self.first.row)}: expected at most {LEFT_OUT_SHARE:.0%} of the rows and "
            f"{LEFT_OUT_FREE} to be left out, found {self.left_out} of {rows}, the first here "
            f"({self.first.what}){advice}"
        )


# -------------------- equally spaced rows --------------------


def regular_grid(source: LogSource, spec: LogSpec) -> Grid:
    """Return the grid of equally spaced rows: the straight line through all time stamps."""
    stamps = _stamps(source, spec)
    grid = _line_through(np.arange(len(stamps), dtype=float), stamps)
    if not grid.interval > 0.0:
        raise LogError(
            f"{source.path}: expected times that grow, found rows {grid.interval:.3g} s apart; check log.time"
        )
    return grid


def rounded_grid(source: LogSource, spec: LogSpec, interval: float) -> Grid | None:
    """Return the grid whose rounded times are the time stamps of rows about `interval` s apart; None without.

    Times are rounded to decimals, or to the last bit of 32."""
    stamps = _stamps(source, spec)
    step = _rounding_step(stamps / spec.time_factor) * spec.time_factor
    if not (is_reading(stamps).all() and 0.0 < step <= _COARSEST * interval):
        return None
    grid = _line_through(np.cumsum(np.rint(np.diff(stamps, prepend=stamps[:1]) / interval)), stamps)
    largest = np.abs(stamps - grid.nearest(stamps)).max(initial=0.0) if grid.interval > 0.0 else math.inf
    return replace(grid, rounded=True) if largest <= _ROUNDING_TOLERANCE * step else None


def _rounding_step(stamps: Array) -> float:
    """Return the step to which numbers are rounded, a decimal or the last bit of 32; 0 without."""
    for decimals in range(_MOST_DECIMALS + 1):
        for part in (stamps[:1000], stamps):  # the first rows decide in most logs
            scaled = part * 10.0**decimals
            if (np.abs(scaled - np.rint(scaled)) > _ROUNDING_ERROR * np.abs(scaled) + 1e-9).any():
                break
        else:
            return float(10.0**-decimals)
    single = (stamps.astype(np.float32) == stamps).all()
    return float(np.spacing(np.float32(np.abs(stamps).max(initial=0.0)))) if single else 0.0


def burst_grid(source: LogSource, spec: LogSpec, head: Array) -> Grid | None:
    """Return the grid of rows whose stamps are spread evenly over bursts.

    None if the stamps `head` (m,), s, are not bursts, or if the stamps of the file depart from one straight line."""
    steps = np.diff(head)
    interval, scatter, changes = float(np.median(steps)), float(np.std(steps)), np.abs(np.diff(steps))
    different = len(np.unique(np.round(steps / interval, _INTERVAL_DECIMALS)))
    if scatter <= _UNEVEN * interval or np.median(changes) > _WITHIN_BURST * scatter or different <= _FEW_INTERVALS:
        return None
    bursts = 1 + int(np.count_nonzero(changes > _WITHIN_BURST * scatter))
    window = _BURSTS_PER_WINDOW * math.ceil(len(head) / bursts)
    time = _stamps(source, spec)
    number = np.arange(len(time), dtype=float)
    grid = _line_through(number, time)
    late = time - grid.start - grid.interval * number
    windows = len(late) // window
    if windows < 2 or not grid.interval > 0.0 or not is_reading(time).all():
        return None
    parts = late[: windows * window].reshape(windows, -1)
    means, jitter = parts.mean(axis=1), float(parts.std(axis=1).mean())
    on_line = np.abs(means).max() <= _LINE_INTERVALS * grid.interval + _LINE_SCATTERS * jitter
    return replace(grid, jitter=jitter) if on_line and jitter > _JITTER_RATIO * means.std() else None


def _line_through(numbers: Array, stamps: Array) -> Grid:
    """Return the least-squares line through time stamps (m,), s, of rows with these numbers (m,)."""
    finite = is_reading(stamps)
    k, t = numbers[finite], stamps[finite]
    k_mean, t_mean = float(k.mean()), float(t.mean())
    k = k - k_mean
    interval = float(k @ (t - t_mean)) / float(k @ k)
    return Grid(start=t_mean - interval * k_mean, interval=interval)


def _stamps(source: LogSource, spec: LogSpec) -> Array:
    """Return the time stamps (m,), s, of all rows; times of day continue past midnight."""
    assert spec.time is not None
    first, parts = 1, [np.empty(0)]
    for table, unread in source.tables([spec.time], spec.time if spec.clock else None):
        is_row = np.ones(table.height, dtype=bool)
        is_row[[u.row - first for u in unread if u.kind in (Kind.NO_ROW, Kind.CUT)]] = False
        parts.append(seconds_of_stamps(table[spec.time].to_numpy()[is_row], spec))
        first += table.height
    stamps = np.concatenate(parts)
    return past_midnight(stamps) if spec.clock else stamps


def past_midnight(time: Array) -> Array:
    """Return times of day (m,), s, continued past midnight."""
    return np.asarray(time + 2.0 * _HALF_DAY * np.cumsum(np.diff(time, prepend=time[:1]) < -_HALF_DAY))
