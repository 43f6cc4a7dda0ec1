"""Lost samples of a log, bridged.

A lost sample is a row of NaN or a row that is not there. Runs of at most five of them are bridged: the missing rows are
put in with evenly spaced times, and every row that is not finite is interpolated linearly in time between its sound
neighbours. What was bridged is reported as `Gap`.

Nothing depends on how the stream is cut: rows that cannot be judged before the next table are held back.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import polars as pl

from tumble.errors import LogError
from tumble.recording.readers import LogSource
from tumble.recording.session import LogSpec
from tumble.units import Array

_JUMP = 1.5
"""A step in time longer than this many intervals is a gap."""

_BRIDGED_SAMPLES = 5
_BRIDGED_SHARE = 1e-3
_BRIDGED_FREE = 3
_BRIDGED_MOST = 10_000
"""A gap of so many samples is bridged; in a file as many gaps as 0.1 % of its rows and 3, and never more than
10 000."""
_SHORTEST_TIME = 2.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Gap:
    """Lost samples that were bridged: how many, the time of the first, s, and what was found. `row` is the
    first data row, counted from 1, that is not finite or that comes after missing ones."""

    file: int
    row: int
    time: float
    samples: int
    what: str


def check_time(source: LogSource, spec: LogSpec, first: int, time: Array) -> None:
    """Times (m,) from data row `first` on must be finite and increase."""
    if not np.isfinite(time).all():
        at = int(np.argmin(np.isfinite(time)))
        raise LogError(f"{source.place(first + at, spec.time)}: expected a time, found {time[at]}; remove the row")
    steps = np.diff(time)
    if (steps <= 0.0).any():
        at = int(np.argmax(steps <= 0.0)) + 1
        what = "again" if steps[at - 1] == 0.0 else "running backwards"
        raise LogError(
            f"{source.place(first + at, spec.time)}: expected a time after {time[at - 1]:.9g} s, "
            f"found {time[at]:.9g} s {what}; list recordings whose time restarts as separate files"
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LogRows:
    """Consecutive rows of a file: the number of the first, times (m,), s, and the numbers of accelerometers
    (m, na), gyros (m, ng), magnetometer (m, 3) and temperature (m, 1) as the file has them."""

    first: int
    time: Array
    values: tuple[Array, ...]

    def part(self, start: int, stop: int) -> LogRows:
        return LogRows(
            first=self.first + start,
            time=self.time[start:stop],
            values=tuple(v[start:stop] for v in self.values),
        )

    def followed_by(self, other: LogRows) -> LogRows:
        return LogRows(
            first=self.first,
            time=np.concatenate([self.time, other.time]),
            values=tuple(np.concatenate(pair) for pair in zip(self.values, other.values, strict=True)),
        )

    def lost(self) -> npt.NDArray[np.bool_]:
        """Which rows have a number that is not finite."""
        if all(np.isfinite(v).all() for v in self.values):
            return np.zeros(len(self.time), dtype=bool)
        return np.asarray(~np.isfinite(np.hstack(self.values)).all(axis=1))


def rows_of(source: LogSource, spec: LogSpec) -> Iterator[LogRows]:
    """The rows of a file; without a time column sample k, counted from 1, ends at k / rate."""
    groups = [spec.accel.columns]
    groups += [spec.gyro.columns] if spec.gyro else []
    groups += [spec.magnetometer.columns] if spec.magnetometer else []
    groups += [(spec.temperature,)] if spec.temperature else []
    first = 1
    for table in source.tables(spec.columns):
        if spec.time is not None:
            time = table[spec.time].to_numpy() * spec.time_factor
        else:
            time = np.arange(first, first + table.height) / (spec.rate or 1.0)
        yield LogRows(first=first, time=time, values=tuple(_matrix(table, group) for group in groups))
        first += table.height


def _matrix(table: pl.DataFrame, columns: Sequence[str]) -> Array:
    """Columns of a table side by side, row after row in memory."""
    out = np.empty((table.height, len(columns)))
    for j, column in enumerate(columns):
        out[:, j] = table[column].to_numpy()
    return out


@dataclass(kw_only=True, slots=True)
class Bridge:
    """Bridges the gaps of one file, row stream in, sample stream out, and adds them to `gaps`.

    `last`: the last row that went out, always a sound one; `held`: lost rows after it, whose end is not yet
    known."""

    source: LogSource
    file: int
    spec: LogSpec
    interval: float
    gaps: list[Gap]
    last: LogRows | None = None
    held: LogRows | None = None
    start: float = 0.0
    bridged: int = 0

    def samples(self, stream: Iterator[LogRows]) -> Iterator[tuple[Array, Array, tuple[Array, ...]]]:
        """Times, intervals, s, and numbers of all samples, those of lost ones interpolated."""
        for new in stream:
            rows = new if self.held is None else self.held.followed_by(new)
            lost = rows.lost()
            if self.last is None:
                self._check_begins_sound(rows, lost)
                self.start = float(rows.time[0])
            sound = len(lost) - int(np.argmin(lost[::-1])) if not lost.all() else 0
            self.held = self._hold(rows.part(sound, len(lost)))
            if sound:
                yield self._repaired(rows.part(0, sound), lost[:sound])
        self._check_end()

    def _hold(self, rows: LogRows) -> LogRows | None:
        if len(rows.time) > _BRIDGED_SAMPLES:
            raise self._too_long(rows)
        return rows if len(rows.time) else None

    def _repaired(self, rows: LogRows, lost: npt.NDArray[np.bool_]) -> tuple[Array, Array, tuple[Array, ...]]:
        """Samples of rows of which the last is sound; the row before them went out already, or is none."""
        before, self.last = self.last, rows.part(len(rows.time) - 1, len(rows.time))
        time = rows.time if before is None else np.concatenate([before.time, rows.time])
        check_time(self.source, self.spec, rows.first - (before is not None), time)
        steps = np.diff(time)
        values = rows.values
        if lost.any() or (steps > _JUMP * self.interval).any():
            filled = self._filled(rows if before is None else before.followed_by(rows), steps)
            steps = np.diff(filled.time)
            time, values = filled.time, tuple(v[before is not None :] for v in filled.values)
        dt = steps if before is not None else np.concatenate([[self.interval], steps])
        if self.spec.time is None:
            dt = np.full(len(dt), self.interval)
        return time[before is not None :], dt, values

    def _filled(self, rows: LogRows, steps: Array) -> LogRows:
        """Rows of which the first and the last are sound, missing rows put in and every number finite."""
        missing = self._missing(rows, steps)
        place = np.arange(len(rows.time)) + np.concatenate([[0], np.cumsum(missing)])
        time = np.interp(np.arange(place[-1] + 1), place, rows.time)
        lost = np.ones(len(time), dtype=bool)
        lost[place] = rows.lost()
        self._report(rows, place, lost, time)
        return LogRows(first=rows.first, time=time, values=tuple(_interpolated(v, place, time) for v in rows.values))

    def _missing(self, rows: LogRows, steps: Array) -> npt.NDArray[np.int64]:
        """How many samples are missing before rows 1, 2, …, by their steps in time."""
        missing = np.where(steps > _JUMP * self.interval, np.floor(steps / self.interval + 0.5) - 1.0, 0.0)
        if (missing > _BRIDGED_SAMPLES).any():
            at = int(np.argmax(missing > _BRIDGED_SAMPLES))
            raise LogError(
                f"{self.source.place(rows.first + at + 1, self.spec.time)}: expected the next sample after "
                f"{self.interval:.6g} s, found a gap of {steps[at]:.6g} s ({missing[at]:.0f} samples) "
                f"after {rows.time[at]:.9g} s; at most {_BRIDGED_SAMPLES} are bridged: cut the log there and "
                "list the parts in log.file"
            )
        return missing.astype(np.int64)

    def _report(self, rows: LogRows, place: npt.NDArray[np.int64], lost: npt.NDArray[np.bool_], time: Array) -> None:
        """Add every run of lost samples to the gaps; row i of `rows` is sample place[i]."""
        edges = np.flatnonzero(np.diff(lost)) + 1
        for start, stop in edges.reshape(-1, 2).tolist():
            first, end = np.searchsorted(place, [start, stop]).tolist()
            if stop - start > _BRIDGED_SAMPLES:
                raise self._too_long(rows.part(first, end))
            what = [f"{value} in '{column}'" for column, value in self._not_finite(rows.part(first, end))]
            what += ["missing samples"] if end - first < stop - start else []
            self.bridged += 1
            self.gaps.append(
                Gap(
                    file=self.file,
                    row=rows.first + first,
                    time=float(time[start]),
                    samples=stop - start,
                    what=" and ".join(what),
                )
            )
        if self.bridged > _BRIDGED_MOST:
            raise self._too_many(f"{_BRIDGED_MOST}", "a file")

    def _not_finite(self, rows: LogRows) -> list[tuple[str, float]]:
        """Columns with numbers that are not finite, and the first such number of each."""
        numbers = np.hstack(rows.values)
        bad = ~np.isfinite(numbers)
        columns = [column for column in self.spec.columns if column != self.spec.time]
        return [(columns[j], float(numbers[np.argmax(bad[:, j]), j])) for j in np.flatnonzero(bad.any(axis=0))]

    def _check_begins_sound(self, rows: LogRows, lost: npt.NDArray[np.bool_]) -> None:
        if lost[0]:
            column, value = self._not_finite(rows.part(0, 1))[0]
            raise LogError(
                f"{self.source.place(rows.first, column)}: expected a finite number in the first row, "
                f"found {value}; remove the row"
            )

    def _check_end(self) -> None:
        """What can be said of a file only when it has ended."""
        if self.held is not None:
            column, value = self._not_finite(self.held)[0]
            raise LogError(
                f"{self.source.place(self.held.first, column)}: expected finite numbers up to the last row, "
                f"found {value}; remove the rows from here on"
            )
        if self.last is None:
            raise LogError(f"{self.source.path}: expected a log, found no rows; the file is empty")
        length = float(self.last.time[0]) - self.start + self.interval
        if length < _SHORTEST_TIME * (1.0 - 1e-9):
            raise LogError(f"{self.source.path}: expected at least {_SHORTEST_TIME:g} s, found {length:.6g} s")
        allowed = _BRIDGED_FREE + math.floor(_BRIDGED_SHARE * self.last.first)
        if self.bridged > allowed:
            raise self._too_many(f"{allowed}", f"{self.last.first} rows ({_BRIDGED_SHARE:.1%} and {_BRIDGED_FREE})")

    def _too_long(self, rows: LogRows) -> LogError:
        column, value = self._not_finite(rows)[0]
        return LogError(
            f"{self.source.place(rows.first, column)}: expected a finite number, found {value} and more than "
            f"{_BRIDGED_SAMPLES} lost samples in a row, too many to bridge: cut the log there and "
            "list the parts in log.file"
        )

    def _too_many(self, allowed: str, where: str) -> LogError:
        first = self.gaps[-self.bridged]
        return LogError(
            f"{self.source.place(first.row)}: expected at most {allowed} gaps in {where}, "
            f"found {self.bridged}, the first here ({first.what}); record again"
        )


def _interpolated(numbers: Array, place: npt.NDArray[np.int64], time: Array) -> Array:
    """Columns (m, n) of rows at samples `place`, as columns of all samples, linear in time between what is
    finite."""
    out = np.full((len(time), numbers.shape[1]), np.nan)
    out[place] = numbers
    for column in out.T:
        bad = ~np.isfinite(column)
        if bad.any():
            column[bad] = np.interp(time[bad], time[~bad], column[~bad])
    return out
