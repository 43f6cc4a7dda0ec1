"""What a session file cannot say about a log is mended in a copy of it, in the session's folder.

So are numbers of 16 bits that were read without their sign, times in ticks or in seconds and nanoseconds, samples that
a counter shows to be missing, rows that are no samples, and positions that follow each other without a turn between
them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl

from tumble.drafting.found_log import LONGEST, SAMPLE_ROWS, FoundLog, samples_in
from tumble.drafting.log_times import (
    Stamps,
    overflow_of,
    recordings_of,
    times_of_column,
    times_without_column,
    unwound,
)
from tumble.drafting.positions_apart import positions_apart
from tumble.drafting.raw_scale import unwrapped, wrapped
from tumble.errors import InputError
from tumble.files import OutputFolder
from tumble.recording.formats.columns import ACCEL, GYRO, MAGNETOMETER, time_unit
from tumble.recording.formats.message import TIME
from tumble.recording.gaps import JUMP
from tumble.recording.log_source import LogSource
from tumble.recording.writer import write_tables
from tumble.units import TIME_UNITS, BoolArray

_TICK = 1e-4  # s, of an Xsens SampleTimeFine
_TENTHS_OF_MICROSECONDS = (6.2e17, 6.7e17), (1.2e17, 1.7e17)  # of dates from 1965 to 2139
_DAYS, _DAY = ((7.2e5, 7.7e5), (2.5e4, 8e4)), 86400.0  # of dates in MATLAB, and in tables of offices
_SHORTEST, _LONGEST = 5e-5, 0.5  # s, between samples
_NANO = re.compile("(nano|n)(?=sec)", re.IGNORECASE)
_BLANK_SHARE = 0.02
_READ_SHARE = 0.5
"""Of its sensors, that a sample at least reads: a row with words and numbers of something else reads fewer."""


@dataclass(frozen=True, kw_only=True, slots=True)
class _Mending:
    """What of a log a session file cannot say: the kinds of sensors whose 16 bits were read `unsigned`, a column and
    what makes its numbers seconds, whether these are `intervals` to be added up, the column of the nanoseconds beside
    it, at which number its time stamps start anew, how many rows at the beginning are samples, whether rows without
    readings are left out, the first and last + 1 rows of positions without turns between them, and all that in
    words."""

    unsigned: tuple[str, ...] = ()
    time: tuple[str, float] | None = None
    intervals: bool = False
    nanoseconds: str | None = None
    overflow: float | None = None
    samples: int | None = None
    without_blank: bool = False
    positions: Sequence[tuple[int, int]] | None = None
    said: tuple[str, ...] = ()


def mended(log: FoundLog, folder: OutputFolder, rate: float | None) -> FoundLog:
    """A log, or the copy of one of which a session file cannot say what it needs."""
    for kind, sensors in log.columns.triads.items():
        if kind != MAGNETOMETER and not np.isfinite(log.read(sensors.columns, rows=SAMPLE_ROWS)).any():
            raise InputError(f"{log.files[0]}: expected numbers in {', '.join(sensors.columns)[:200]}, found none")
    mending = _with_positions(_with_time(_with_signs(_with_samples(log), log), log, rate), log, rate)
    return _copied(log, folder, mending) if mending.said else log


def _with_samples(log: FoundLog) -> _Mending:
    """Without the rows that are no samples: what memory was filled with behind the last, and rows of other sensors."""
    sensors = [c for kind, triad in log.columns.triads.items() if kind != MAGNETOMETER for c in triad.columns]
    read = log.read(sensors)
    mending = _Mending()
    filled = len(read) > 0 and all(len(set(three)) == 1 for three in np.nan_to_num(read[-1]).reshape(-1, 3).tolist())
    samples = samples_in(read) if filled and len(log.files) == 1 and len(read) < LONGEST else len(read)
    if samples < len(read):
        said = f"rows: the last {len(read) - samples} are all alike and no samples: left out"
        mending = replace(mending, samples=samples, said=(said,))
    found = np.asarray(np.isfinite(read[:samples]).mean(axis=1) >= _READ_SHARE)
    blank = int(np.count_nonzero(~found))
    one = len(log.files) == 1 and samples > 0
    if blank > _BLANK_SHARE * samples or (one and blank and (not found[0] or _are_between(log, found))):
        said = f"rows: {blank} of {samples} have no readings of these sensors, as rows of others: left out"
        mending = replace(mending, without_blank=True, said=(*mending.said, said))
    return mending


def _are_between(log: FoundLog, found: BoolArray) -> bool:
    """Whether most rows without readings are between samples that follow each other as usual: none is a lost sample."""
    stamps = log.stamps()
    time = np.empty(0) if stamps is None else stamps.values[: len(found)]
    if len(time) < len(found) or not found[1:].any() or not np.isfinite(time[~found]).any():  # messages have no time
        return False
    samples = np.flatnonzero(found)
    steps = np.diff(time[samples])
    between = np.diff(samples) > 1
    return bool(between.any() and np.median(steps[between]) < JUMP * np.median(steps))


def _with_signs(mending: _Mending, log: FoundLog) -> _Mending:
    triads = log.columns.triads
    unsigned = tuple(kind for kind in (ACCEL, GYRO) if kind in triads and wrapped(log.read(triads[kind].columns)))
    if not unsigned:
        return mending
    named = " and ".join({ACCEL: "accelerometers", GYRO: "gyros"}[kind] for kind in unsigned)
    said = f"{named}: numbers of 16 bits that were read without their sign: 65536 taken off where it is due"
    return replace(mending, unsigned=unsigned, said=(*mending.said, said))


def _with_time(mending: _Mending, log: FoundLog, rate: float | None) -> _Mending:
    """With what a column of ticks or a counter of samples needs; `rate` as given, Hz, which stands for time stamps."""
    column, said = log.columns.time, list(mending.said)
    intervals = None if rate is not None else _intervals(log)
    if intervals is not None:
        column, unit = intervals
        said.append(f"time: none, but column {column!r} has the intervals between samples, in {unit}: added up")
        return replace(mending, time=(column, TIME_UNITS[unit]), intervals=True, said=tuple(said))
    if column is None:
        counter = _counting(log)
        if counter is None:
            return mending
        said.append(f"time: none, but column {counter!r} counts the samples and shows some to be missing")
        per_second = rate or times_without_column(None, log.remarks).rate
        return replace(mending, time=(counter, 1.0 / per_second), said=tuple(said))
    nanoseconds = nanoseconds_of(log) if rate is None else None
    if nanoseconds is not None:
        said.append(f"time: columns {column!r} and {nanoseconds!r}, seconds and nanoseconds, added")
        return replace(mending, time=(column, 1.0), nanoseconds=nanoseconds, said=tuple(said))
    tick, overflow = (_tick(log), _overflow(log)) if rate is None else (None, None)
    if tick is not None:
        said.append(f"time: column {column!r} in ticks of {tick:g} s, made seconds")
    if overflow is not None:
        said.append(f"time: column {column!r} starts anew at {overflow:.10g}: that much is added where it does")
    time = None if tick is None else (column, tick)
    return replace(mending, time=time, overflow=overflow, said=tuple(said))


def _with_positions(mending: _Mending, log: FoundLog, rate: float | None) -> _Mending:
    as_they_are = replace(mending, unsigned=(), said=()) == _Mending()
    stamps = log.stamps() if as_they_are and rate is None and len(log.files) == 1 else None
    whole = stamps is not None and not stamps.clock and len(stamps.values) < LONGEST
    recordings = recordings_of(stamps.values[np.isfinite(stamps.values)]) if stamps is not None and whole else None
    if recordings is not None:
        said = f"time: the clock starts anew, so that there are {len(recordings)} recordings: a file each"
        return replace(mending, positions=recordings, said=(*mending.said, said))
    positions = positions_apart(log, unsigned=ACCEL in mending.unsigned)
    if positions is None:
        return mending
    said = f"{len(positions)} positions one below the other without turns: a file each"
    return replace(mending, positions=positions, said=(*mending.said, said))


def _copied(log: FoundLog, folder: OutputFolder, mending: _Mending) -> FoundLog:
    """The columns that matter, mended, as Parquet files in a folder."""
    files: list[Path] = []
    if mending.positions is not None:
        whole = pl.concat(_tables(next(iter(log.sources())), log, mending))
        for number, (start, stop) in enumerate(mending.positions, 1):
            files.append(folder.new_file(f"position-{number:02d}.parquet"))
            write_tables(files[-1], iter([whole.slice(start, stop - start)]))
    else:
        for number, source in enumerate(log.sources(), 1):
            name = "log.parquet" if len(log.files) == 1 else f"log-{number:02d}.parquet"
            files.append(source.path if source.path in folder.written else folder.new_file(name))
            write_tables(files[-1], _tables(source, log, mending))
    columns = log.columns
    if mending.time is not None:
        columns = replace(columns, time=TIME, time_unit="s")
    elif _clock(log) is not None:
        columns = replace(columns, time_unit="s")
    said = (*log.said, *mending.said, f"so mended, the log is copied to {files[0].name}{' …' * (len(files) > 1)}")
    return FoundLog(files=tuple(files), keys={}, columns=columns, remarks=log.remarks, said=said)


def _clock(log: FoundLog) -> str | None:
    """The column of times of day, where there is one."""
    column = log.columns.time
    return column if column is not None and log.is_clock(column) else None


def _tables(source: LogSource, log: FoundLog, mending: _Mending) -> Iterator[pl.DataFrame]:
    """The rows of a file that have a time, mended."""
    triads, time = log.columns.triads, mending.time
    column = log.columns.time if time is None else time[0]
    sensors = [c for triad in triads.values() for c in triad.columns]
    warm = dict.fromkeys(log.columns.temperatures)
    used = [c for c in (column, mending.nanoseconds, *sensors, *warm) if c is not None]
    left = mending.samples
    unsigned = [c for kind in mending.unsigned for c in triads[kind].columns]
    last: float | None = None
    for rows, _ in source.tables(used, _clock(log)):
        read = rows if left is None else rows.head(left)
        left = None if left is None else left - len(read)
        if mending.without_blank:
            read = read.filter(pl.mean_horizontal(pl.col(sensors).is_finite()) >= _READ_SHARE)
        table = read.with_columns(pl.Series(c, unwrapped(read[c].to_numpy())) for c in unsigned)
        if mending.overflow is not None and column is not None:
            stamps = unwound(read[column].to_numpy(), mending.overflow, last)
            last = next((float(t) for t in stamps[::-1] if np.isfinite(t)), last)
            table = table.with_columns(pl.Series(column, stamps))
        if mending.intervals and time is not None:
            stamps = (last or 0.0) + read[time[0]].fill_nan(0.0).cum_sum().to_numpy()
            last = float(stamps[-1]) if len(stamps) else last
            table = table.with_columns(pl.Series(time[0], stamps))
        if time is not None:
            part = pl.lit(0.0) if mending.nanoseconds is None else 1e-9 * pl.col(mending.nanoseconds)
            table = table.rename({time[0]: TIME}).with_columns(pl.col(TIME) * time[1] + part)
        stamp = column if time is None else TIME
        yield table if stamp is None else table.filter(pl.col(stamp).is_finite())


def _intervals(log: FoundLog) -> tuple[str, str] | None:
    """The column of the intervals from sample to sample, and their unit, where no column has the times."""
    column = log.columns.interval
    if column is None or log.columns.time is not None or len(log.files) > 1:
        return None
    steps = log.read([column])[:, 0]
    steps = steps[np.isfinite(steps)]
    times = times_of_column(Stamps(column=column, values=np.cumsum(steps), unit=time_unit(column)))
    return None if times is None or (steps < 0.0).any() else (column, times.keys.get("time_unit", "s"))


def _overflow(log: FoundLog) -> float | None:
    """The number at which the counter behind the time stamps starts anew, where it does."""
    column = log.columns.time
    return None if column is None or log.is_clock(column) else overflow_of(log.read([column])[:, 0])


def nanoseconds_of(log: FoundLog) -> str | None:
    """The column of the nanoseconds, where that of the time has the whole seconds alone: header.stamp.nsecs beside
    header.stamp.secs."""
    column = log.columns.time
    names = next(iter(log.sources())).names
    return next((n for n in names if _NANO.search(n) and _NANO.sub("", n) == column), None)


def _tick(log: FoundLog) -> float | None:
    """The unit, s, of times in none that a session names: of an Xsens SampleTimeFine, microseconds where steps are
    thousands; of dates in days; and of those in tenths of microseconds since the year 1 or 1601."""
    column = log.columns.time
    if column is None or log.columns.time_unit is not None or log.is_clock(column):
        return None
    stamps = log.read([column], rows=10_000)[:, 0]
    if not np.isfinite(np.diff(stamps)).any():
        return None
    step, middle = float(np.nanmedian(np.diff(stamps))), float(np.nanmedian(stamps))
    if "sampletimefine" in re.sub(r"\W|_", "", column.lower()):
        return _TICK if step < 2000.0 else None
    if any(first < middle < last for first, last in _TENTHS_OF_MICROSECONDS):
        return 1e-7
    in_days = any(first < middle < last for first, last in _DAYS)
    return _DAY if in_days and _SHORTEST < step * _DAY < _LONGEST and step < _SHORTEST else None


def _counting(log: FoundLog) -> str | None:
    """A column that counts the samples and jumps here and there."""
    column = log.columns.counter
    if column is None:
        return None
    steps = np.diff(log.read([column])[:, 0])
    steps = steps[np.isfinite(steps)]
    return column if len(steps) and (steps >= 1.0).all() and np.median(steps) == 1.0 and (steps > 1.0).any() else None
