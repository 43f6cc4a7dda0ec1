"""The rows of a file that have a time of their own, in the order of time.

A row is left out whose time cannot be read, or is that of the row before; that leaps beyond the next one, where this
follows the row before; or that falls back, to or before the time of one that was kept. If as many intervals pass as
rows are left out, the stamps were wrong, and what is missing is bridged. Else the clock was set back, or rows are there
twice: nobody knows what time passed, and no turn is known there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from tumble.errors import LogError
from tumble.recording.log_source import Kind, LogSource, Unread, unread_error
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
from tumble.units import Array, BoolArray, IntArray

_HALF_DAY = 43200.0  # s: a clock that falls by more has passed midnight
_PASSED = 0.5
"""Of an interval: so far from the time of the rows between, the time that has passed is another one."""


def check_head(source: LogSource, spec: LogSpec, time: Array) -> Array:
    """The first times of a file without those that cannot be read, are repeated, leap or fall back, if they are few."""
    read = np.flatnonzero(is_reading(time))
    number = read[~leaping(time[read], -math.inf, 0.0)]
    kept = number[~_no_later(time[number], -math.inf)]
    if len(read) - len(kept) > FREE + SHARE * len(time) or len(kept) < 2:
        check_time(source, spec, np.arange(1, len(time) + 1), time)
    return np.asarray(time[kept])


def leaping(time: Array, before: float, step: float) -> BoolArray:
    """Which of times (m,) leap, by more than a step, beyond the next one, though this follows the row `before`."""
    found = np.zeros(len(time), dtype=bool)
    former = np.concatenate([[before], time])[: len(time) - 1]
    here, after = time[:-1], time[1:]
    found[:-1] = (here > after) & (after > former) & (here - former > step)
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
    groups = [spec.accel.columns]
    groups += [spec.gyro.columns] if spec.gyro else []
    groups += [spec.magnetometer.columns] if spec.magnetometer else []
    groups += [spec.temperature.columns] if spec.temperature else []
    sieve = _Sieve(source=source, spec=spec, file=file, grid=grid, on_grid=on_grid, gaps=gaps)
    first = 1
    for table, unread in source.tables(spec.columns, spec.time if spec.clock else None):
        numbers = np.arange(first, first + table.height)
        time = table[spec.time].to_numpy() * spec.time_factor if spec.time is not None else np.empty(table.height)
        values = tuple(side_by_side(table, group) for group in groups)
        rows = LogRows(numbers=numbers, time=time, values=values, unread={u.row: u for u in unread})
        yield sieve.kept(rows)
        first += table.height
    if sieve.held is not None:
        yield sieve.held
    sieve.check_end(first - 1)


@dataclass(kw_only=True, slots=True)
class _Behind:
    """Rows behind each other whose time is no later than one `before`, s, of a row that was kept: their numbers, the
    first of their times and the least, s."""

    before: float
    first: float
    least: float
    rows: list[int]


@dataclass(kw_only=True, slots=True)
class _Sieve:
    """Leaves out the rows of a file that have no time of their own. `count`: rows that went out; `last`: the time of
    the last of them; `shift`: what midnights have added to a clock, s; `held`: a row that may leap beyond the next;
    `behind`: the rows since the last that went out; `falls`: the first of those that fall back."""

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
    behind: _Behind | None = None
    falls: list[_Behind] = field(default_factory=list)
    left_out: int = 0
    first: Gap | None = None

    def kept(self, rows: LogRows) -> LogRows:
        """The rows of a table, and those that were held before, that have a time of their own."""
        lines = [u for u in rows.unread.values() if u.kind in (Kind.NO_ROW, Kind.CUT) or self._untimed(u)]
        if lines:
            keep = np.ones(len(rows.numbers), dtype=bool)
            keep[np.array([u.row for u in lines]) - rows.numbers[0]] = False
            rows = rows.part(keep)
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

    def _untimed(self, unread: Unread) -> bool:
        """Whether a row has lost the time that it had."""
        return not self._counted and (unread.column is None or unread.column == self.spec.time)

    @property
    def _counted(self) -> bool:
        """Whether rows are counted, whatever their stamps say."""
        return self.on_grid and not self.grid.rounded

    def _timed(self, rows: LogRows) -> LogRows:
        if self._counted:
            number = np.arange(self.count, self.count + len(rows.time), dtype=float)
            return replace(rows, time=np.asarray(self.grid.start + self.grid.interval * number, dtype=float))
        if self.spec.clock and len(rows.time):
            time = rows.time + self.shift
            passed = np.cumsum(np.diff(time, prepend=self.last if np.isfinite(self.last) else time[0]) < -_HALF_DAY)
            self.shift += 2.0 * _HALF_DAY * float(passed[-1])
            rows = replace(rows, time=time + 2.0 * _HALF_DAY * passed)
        if self.on_grid:
            rows = replace(rows, time=self.grid.nearest(rows.time))
        return rows if self._grow(rows.time) else self._in_order(self._without_leaps(rows))

    def _grow(self, time: Array) -> bool:
        """Whether times (m,) follow those before, and each other, and the last does not leap."""
        if self.held is not None or self.behind is not None or len(time) < 2 or not time[0] > self.last:
            return False
        steps = np.diff(time)
        return bool(steps.min() > 0.0 and steps[-1] <= JUMP * self.grid.interval)

    def _without_leaps(self, rows: LogRows) -> LogRows:
        """Without single rows that leap; a last one that may is held back until the next is known."""
        rows = rows if self.held is None else self.held.followed_by(rows)
        self.held, step = None, JUMP * self.grid.interval
        former = np.concatenate([[self.last], rows.time])[-2:]
        if len(rows.time) and former[1] - former[0] > step:
            self.held, rows = rows.part(slice(-1, None)), rows.part(slice(0, -1))
            leaps = leaping(np.concatenate([rows.time, self.held.time]), self.last, step)[:-1]
        else:
            leaps = leaping(rows.time, self.last, step)
        if not leaps.any():
            return rows
        for at in np.flatnonzero(leaps).tolist():
            before = float(rows.time[at - 1]) if at else self.last
            self._leave_out(int(rows.numbers[at]), "a time stamp beyond that of the next row", before)
        return rows.part(~leaps)

    def _in_order(self, rows: LogRows) -> LogRows:
        """Without the rows that are no later than one before them."""
        late = _no_later(rows.time, self.last)
        if self.behind is not None and len(late) and not late[0]:
            self._caught_up(float(rows.time[0]))
        if not late.any():
            return rows
        found = np.flatnonzero(late)
        for run in np.split(found, np.flatnonzero(np.diff(found) > 1) + 1):
            self._fall_behind(rows.numbers[run], rows.time[run], float(rows.time[run[0] - 1]) if run[0] else self.last)
            if run[-1] + 1 < len(late):
                self._caught_up(float(rows.time[run[-1] + 1]))
        return rows.part(~late)

    def _fall_behind(self, numbers: IntArray, time: Array, before: float) -> None:
        if self.behind is None:
            self.behind = _Behind(before=before, first=float(time[0]), least=math.inf, rows=[])
        self.behind.least = min(self.behind.least, float(time.min()))
        self.behind.rows.extend(numbers.tolist())
        if self.left_out + len(self.behind.rows) > MOST:
            self._caught_up(math.nan)

    def _caught_up(self, time: float) -> None:
        """Report the rows behind, now that the time of the next row, s, is known; nan where there is none."""
        found, self.behind = self.behind, None
        assert found is not None
        falls, passed = found.least < found.before, (time - found.before) / self.grid.interval
        if falls:
            self.falls.append(found)
        if falls and not abs(passed - len(found.rows) - 1.0) < _PASSED:
            self.left_out += len(found.rows)
            self._report(
                Gap(
                    file=self.file,
                    row=found.rows[0],
                    time=found.before,
                    samples=len(found.rows),
                    what="time stamps that fall back",
                    stop=time,
                    integrable=False,
                    why="the clock falls back in it",
                )
            )
            return
        what = "a time stamp before that of the row before" if falls else "the time stamp of the row before"
        for row in found.rows:
            self._leave_out(row, what, found.before)

    def _leave_out(self, row: int, what: str, before: float) -> None:
        self.left_out += 1
        self._report(Gap(file=self.file, row=row, time=max(before, 0.0), samples=0, what=f"{what}: left out"))

    def _report(self, gap: Gap) -> None:
        self.first = self.first or gap
        if self.left_out > MOST:
            raise self._too_many(self.count)
        self.gaps.append(gap)

    def check_end(self, rows: int) -> None:
        """Whether few rows were left out."""
        if self.behind is not None:
            self._caught_up(math.nan)
        if self.left_out > FREE + SHARE * rows:
            raise self._too_many(rows)

    def _too_many(self, rows: int) -> LogError:
        assert self.first is not None
        if 2 * sum(len(fall.rows) for fall in self.falls) > self.left_out:
            fall = self.falls[0]
            return runs_backwards(self.source, self.spec, fall.rows[0], fall.before, fall.first)
        advice = f"; {REGULAR_HINT}" if "stamp" in self.first.what else "; look at the file, or record again"
        return LogError(
            f"{self.source.place(self.first.row)}: expected at most {SHARE:.0%} of the rows and {FREE} to be left "
            f"out, found {self.left_out} of {rows}, the first here ({self.first.what}){advice}"
        )
