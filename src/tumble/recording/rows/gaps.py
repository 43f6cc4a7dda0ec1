"""Gaps: runs of lost samples in a file.

A sample is lost if its row is missing or cannot be read, or if one of its numbers is not finite or beyond those of
64 bits. What is done with a run depends on its length:

* At most five samples are bridged: missing rows are inserted at evenly spaced times, and numbers that are not finite
  are interpolated linearly in time between their neighbours.
* Longer runs are left out, and the samples continue after them. Rests remain valid. A turn with a missing part cannot
  be integrated: its `Gap` is not `integrable`, and `tumble.reduction.turns.turns` leaves the turn out.
* Runs before the first sound row and after the last one are left out.

A row without a time of its own is left out (`timed`), and is a missing sample unless the next row follows in time. In a
log without times each row counts as a sample; if a row may not have been a sample, the gap is not integrable. Each case
is reported as a `Gap`.

The result does not depend on how the stream is divided into tables: rows that depend on the next table are pending.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import polars as pl

from tumble.errors import LogError
from tumble.recording.log_source import LogSource, Unread, unread_error
from tumble.recording.session import LogSpec
from tumble.units import TIME_UNITS, Array, BoolArray, IntArray

GAP_STEP = 1.5  # intervals; a longer step in time is a gap
_BRIDGED_SAMPLES = 5
MOST_GAPS = 100_000  # in a file; the scatter of turns contains the error of bridging
LEFT_OUT_SHARE, LEFT_OUT_FREE = 2e-2, 3
"""Tolerated rows without a time of their own in a file: share of its rows, and number."""
REGULAR_HINT = (
    "if the rows are equally spaced whatever their time stamps say, put regular = true in [log], or with arrays give "
    "rate= instead of time="
)
NUMBER, TIME, READINGS = 0, 1, slice(2, None)
"""Columns of the rows (m, 2 + n) of a file: number of the row, from 1, time, s, and the n readings as written, of
accelerometers, gyros, magnetometer and thermometers."""
Tables = Iterator[tuple[Array, Sequence[Unread]]]
"""Rows of a file in order, table by table, with their unreadable parts."""
_SHORTEST_LOG = 2.0  # s
_LARGEST = math.nextafter(2.0**63, 0.0)
"""Largest number that can be a reading: the limits of integers of 64 bits stand for no value, and no sensor or clock
reaches them in any unit. Its tenth power is finite."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Gap:
    """A run of lost samples.

    Attributes
    ----------
    file, row
        Number of the file, from 0, and of the first lost data row, from 1, or of the row after missing ones.
    time, stop
        Times of the first lost and the next sound sample, s.
    samples
        Number of lost samples; 0 if a line was left out and nothing is missing.
    what
        Text or fault found.
    integrable
        Whether a turn across the gap can be integrated.
    why
        Reason why it cannot, as a clause about the turn; empty if `what` is sufficient.
    """

    file: int
    row: int
    time: float
    samples: int
    what: str
    stop: float = field(default=math.nan, compare=False)
    integrable: bool = True
    why: str = "samples are lost in it"


def is_reading(numbers: Array) -> BoolArray:
    """Return which numbers can be readings of a sensor or a clock: finite and not beyond `_LARGEST`."""
    return np.asarray(np.abs(numbers) <= _LARGEST)


def seconds_of_stamps(stamps: Array, spec: LogSpec) -> Array:
    """Return time stamps of a log in s, with NaN for those that are no times."""
    return np.where(is_reading(stamps), stamps * spec.time_factor, np.nan)


def check_time(source: LogSource, spec: LogSpec, numbers: Array | IntArray, time: Array) -> Array:
    """Return the steps (m − 1,) of times (m,), s, of data rows. Raises LogError unless they are finite and increase."""
    if not is_reading(time).all():
        at = int(np.argmin(is_reading(time)))
        raise LogError(
            f"{source.place(int(numbers[at]), spec.time)}: expected a time, found {time[at]}; remove the row"
        )
    steps = np.diff(time)
    if steps.min(initial=1.0) <= 0.0:
        at = int(np.argmax(steps <= 0.0)) + 1
        if steps[at - 1] < 0.0:
            raise runs_backwards(source, spec, int(numbers[at]), float(time[at - 1]), float(time[at]))
        raise LogError(
            f"{source.place(int(numbers[at]), spec.time)}: expected a time after {time[at - 1]:.9g} s, "
            f"found {time[at]:.9g} s again; {REGULAR_HINT}"
        )
    return steps


def runs_backwards(source: LogSource, spec: LogSpec, row: int, before: float, time: float) -> LogError:
    """Return the error for a file whose time, s, falls back at a row and does not recover."""
    return LogError(
        f"{source.place(row, spec.time)}: expected a time after {before:.9g} s, found {time:.9g} s running backwards; "
        "list recordings whose time restarts as separate files"
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class Grid:
    """Times of equally spaced rows: the first and the interval, s.

    The time of a row follows from its number; if the stamps are `rounded` times of the grid, it is the grid time
    nearest to the stamp. `jitter` is the scatter of the stamps of bursts, s."""

    start: float
    interval: float
    rounded: bool = False
    jitter: float = 0.0

    def nearest(self, time: Array) -> Array:
        """Return the times of the grid nearest to these times, s."""
        return np.asarray(self.start + self.interval * np.rint((time - self.start) / self.interval))


def side_by_side(table: pl.DataFrame, columns: Sequence[str], before: int = 0) -> Array:
    """Return columns of a table as an array (m, before + n) in column-major order, with zeros before them."""
    out = np.empty((before + len(columns), table.height))
    out[:before] = 0.0
    for j, column in enumerate(columns, before):
        out[j] = table[column].to_numpy()
    return out.T


@dataclass(kw_only=True, slots=True)
class Bridge:
    """Conversion of the rows of one file to samples, with gaps bridged or left out and added to `gaps`.

    `last` is the last row that was passed on, always a sound one. `pending` are lost rows after it whose end is not
    known yet; of a run too long to be bridged only the first rows are kept. `unread` are the unreadable parts of the
    rows by number; `count` is the number of gaps, `first` the first."""

    source: LogSource
    file: int
    spec: LogSpec
    interval: float
    gaps: list[Gap]
    last: Array | None = None
    pending: Array = field(default_factory=lambda: np.empty((0, 0)))
    unread: dict[int, Unread] = field(default_factory=dict)
    count: int = 0
    first: Gap | None = None

    def samples(self, stream: Tables) -> Iterator[tuple[Array, Array, Array]]:
        """Yield times and intervals, s, and numbers of all samples, interpolated if lost."""
        n_lost, start = 0, 0.0  # rows after the last sound one, of which the first are pending; time of the first, s
        for new, unread in stream:
            self.unread |= {u.row: u for u in unread}
            if not len(new):  # no new rows of a growing log
                yield new[:, TIME], new[:, TIME], new[:, READINGS]
                continue
            rows = np.concatenate([self.pending, new]) if len(self.pending) else new
            lost = _lost(rows)
            if self.last is None and lost.any():
                first = len(lost) if lost.all() else int(np.argmin(lost))
                if int(rows[0, NUMBER]) in self.unread:
                    raise unread_error(self.source, self.unread[int(rows[0, NUMBER])])
                if first:
                    stop = float(rows[first, TIME]) if first < len(lost) else math.nan
                    self._leave_out(rows[:first], first, stop)
                rows, lost = rows[first:], lost[first:]
            if self.last is None and len(rows):
                start = float(rows[0, TIME])
            sound = len(lost) - int(np.argmin(lost[::-1])) if not lost.all() else 0
            self.pending = rows[sound : sound + _BRIDGED_SAMPLES + 1]
            n_lost = len(lost) - sound if sound else n_lost + len(new)
            if sound:
                yield self._repaired(rows[:sound], lost[:sound])
            pending = {*self.pending[:, NUMBER].astype(int).tolist()}
            self.unread = {n: u for n, u in self.unread.items() if n > new[-1, NUMBER] or n in pending}
        # checks at the end of the file
        if self.last is None:
            raise LogError(f"{self.source.path}: expected a log, found no rows; the file is empty")
        length = float(self.last[0, TIME]) - start + self.interval
        if length < _SHORTEST_LOG * (1.0 - 1e-9):
            hint, factor = "", 1e3 * self.spec.time_factor
            unit = next((unit for unit, size in TIME_UNITS.items() if math.isclose(size, factor)), None)
            if self.spec.time is not None and not self.spec.clock and unit is not None:
                hint = f"; is the time {self.spec.time!r} in {unit}, {1e3 * length:.6g} s? State time_unit in [log]"
            raise LogError(f"{self.source.path}: expected at least {_SHORTEST_LOG:g} s, found {length:.6g} s{hint}")
        if len(self.pending):
            self._leave_out(self.pending, n_lost, math.nan)

    def _leave_out(self, lost: Array, samples: int, stop: float) -> None:
        """Report lost samples at the start or the end of the file; `lost` are the first of them."""
        what = [u.what for u in self._unread_in(lost)] + [f"{v} in '{column}'" for column, v in self._not_finite(lost)]
        row, time = int(lost[0, NUMBER]), float(lost[0, TIME])
        gap = Gap(file=self.file, row=row, time=time, samples=samples, what=what[0], stop=stop, integrable=False)
        self.gaps.append(gap)

    def _repaired(self, rows: Array, lost: BoolArray) -> tuple[Array, Array, Array]:
        """Return times, intervals and numbers of the samples of rows, with short gaps filled and long ones left out.

        The last row must be sound, as must any row passed on before. All returned numbers are finite."""
        before, self.last = self.last, rows[-1:]
        new = 0 if before is None else 1  # index of the first new sample
        of_both = [rows] if before is None else [before, rows]
        number, time = (np.concatenate([part[:, column] for part in of_both]) for column in (NUMBER, TIME))
        steps = check_time(self.source, self.spec, number, time)
        values = rows[:, READINGS]
        after_long = np.empty(0, dtype=np.int64)  # samples after a run that is left out, which have the usual interval
        if lost.any() or steps.max(initial=0.0) > GAP_STEP * self.interval:
            rows = np.concatenate(of_both)
            # missing samples before rows 1, 2, … by their steps in time, at most one more than can be bridged
            missing = np.where(steps > GAP_STEP * self.interval, np.floor(steps / self.interval + 0.5) - 1.0, 0.0)
            missing = np.minimum(missing, _BRIDGED_SAMPLES + 1).astype(np.int64)
            place = np.arange(len(rows)) + np.concatenate([[0], np.cumsum(missing)])
            time = np.interp(np.arange(place[-1] + 1), place, rows[:, TIME])
            absent, kept = np.ones((2, len(time)), dtype=bool)
            absent[place] = _lost(rows)
            for start, stop in (np.flatnonzero(np.diff(absent)) + 1).reshape(-1, 2).tolist():
                self._report(rows, place, time, start, stop)
                kept[start:stop] = stop - start <= _BRIDGED_SAMPLES
            after_long = np.flatnonzero(np.diff(np.flatnonzero(kept)) > 1) + 1
            out = np.full((len(time), values.shape[1]), np.nan, order="F")
            out[place] = rows[:, READINGS]
            for column in out.T:  # linear in time between finite numbers
                bad = ~is_reading(column)
                if bad.any():
                    column[bad] = np.interp(time[bad], time[~bad], column[~bad])
            values, time = out[kept][new:], time[kept]
            steps = np.diff(time)
        dt = steps if new else np.concatenate([[self.interval], steps])
        dt[slice(None) if self.spec.unstamped else after_long - new] = self.interval
        return time[new:], dt, values

    def _report(self, rows: Array, place: IntArray, time: Array, start: int, stop: int) -> None:
        """Add the lost samples start … stop − 1 to the gaps; row i of `rows` is sample place[i].

        The gap names the first unreadable row and the first number of each column that is not finite."""
        first, end = np.searchsorted(place, [start, stop]).tolist()
        lost = rows[first:end]
        unread = self._unread_in(lost)
        columns = {u.column for u in unread}
        what = [u.what for u in unread[:1]]
        what += [f"{v} in '{column}'" for column, v in self._not_finite(lost) if not columns & {column, None}]
        long = stop - start > _BRIDGED_SAMPLES
        samples = max(stop - start, round(float(time[stop] - time[start - 1]) / self.interval) - 1)
        what += ["missing samples"] if end - first < samples and not long else []
        gap = Gap(
            file=self.file,
            row=int(rows[first, NUMBER]),
            time=float(time[start]) if not long else float(time[start - 1]) + self.interval,
            samples=samples,
            what=" and ".join(what) or "missing samples",
            stop=float(time[stop]),
            integrable=not long and not (self.spec.unstamped and None in columns),  # without times it may be no sample
        )
        self.count += 1
        self.first = self.first or gap
        self.gaps.append(gap)
        if self.count > MOST_GAPS:
            raise LogError(
                f"{self.source.place(self.first.row)}: expected at most {MOST_GAPS} gaps in a file, found more, the "
                f"first here ({self.first.what}); record again"
            )

    def _unread_in(self, rows: Array) -> list[Unread]:
        """Return the unreadable parts of rows."""
        return [self.unread[n] for n in rows[:, NUMBER].astype(int).tolist() if n in self.unread] if self.unread else []

    def _not_finite(self, rows: Array) -> list[tuple[str, float]]:
        """Return columns with numbers that are not finite, with the first such number of each."""
        values, names = rows[:, READINGS], self.spec.readings
        bad = ~is_reading(values)
        return [(names[j], float(values[np.argmax(bad[:, j]), j])) for j in np.flatnonzero(bad.any(axis=0))]


def _lost(rows: Array) -> BoolArray:
    """Return which rows have a number that is no reading."""
    values = rows[:, READINGS]
    if values.min(initial=0.0) >= -_LARGEST and values.max(initial=0.0) <= _LARGEST:
        return np.zeros(len(rows), dtype=bool)
    return np.asarray(~is_reading(values).all(axis=1))
