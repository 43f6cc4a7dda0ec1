"""Mended copies of logs, for what a session file cannot express: numbers of 16 bits read as unsigned, times in ticks,
intervals or seconds and nanoseconds, counters that overflow, rows that are no samples, and positions that follow each
other without a turn."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import polars as pl

from tumble.drafting.foreign_log import LONGEST, SAMPLE_ROWS, ForeignLog, samples_in
from tumble.drafting.times import Stamps, grows_mostly, overflow_of, past_midnight, recordings_of, times_of_column
from tumble.errors import InputError
from tumble.files import OutputFolder
from tumble.recording.columns.names import ACCEL, GYRO, MAGNETOMETER, time_unit
from tumble.recording.formats import TIME
from tumble.recording.readers import write_tables
from tumble.recording.rows.gaps import JUMP
from tumble.units import TIME_UNITS, Array

_TICK = 1e-4  # s, of an Xsens SampleTimeFine
_TENTHS_OF_MICROSECONDS = (6.2e17, 6.7e17), (1.2e17, 1.7e17)  # of dates from 1965 to 2139
_DAYS, _DAY = ((7.2e5, 7.7e5), (2.5e4, 8e4)), 86400.0  # of dates in MATLAB, and in tables of offices
_SHORTEST, _LONGEST = 5e-5, 0.5  # s, between samples
_NANO = re.compile("(nano|n)(?=sec)", re.IGNORECASE)
_BLANK_SHARE = 0.02
_READ_SHARE = 0.5
"""Of its sensors, that a sample at least reads: a row with words and numbers of something else reads fewer."""
_FEWEST_ROWS = 50
_JUMP = 0.2
_LABEL = re.compile(
    r"part|pos(ition)?|pose|label|section|segment|step|lage|stellung|положение|позиция|位置", re.IGNORECASE
)

Mend = tuple[str, Callable[[pl.DataFrame], pl.DataFrame]]
"""A remark on a change of the rows of a file, and the change."""


def repaired(log: ForeignLog, folder: OutputFolder, rate: float | None) -> ForeignLog:
    """A log of which a session file can say all that is needed: the log itself, or a mended copy of it in the folder.
    A `rate`, Hz, that the user states stands for time stamps. Raises InputError for sensors without numbers, and
    positions of too few rows."""
    triads = log.columns.triads
    for kind, sensors in triads.items():
        if kind != MAGNETOMETER and not np.isfinite(log.read(sensors.columns, rows=SAMPLE_ROWS)).any():
            raise InputError(f"{log.files[0]}: expected numbers in {', '.join(sensors.columns)[:200]}, found none")
    stamps = log.stamps()
    if stamps is not None and len(stamps.values) >= _FEWEST_ROWS and grows_mostly(-stamps.values):
        return repaired(_copy(log, folder, [stamps.column], [_newest_last(stamps)]), folder, rate)
    mends = _rows_that_are_samples(log)
    time, in_seconds, of_time = _time(log, rate)
    unsigned = [kind for kind in (ACCEL, GYRO) if kind in triads and _wrapped(log.read(triads[kind].columns))]
    parts, why, one = None, "", len(log.files) == 1
    if one and not (mends or of_time) and rate is None and stamps is not None and not stamps.clock:
        parts = recordings_of(stamps.values[np.isfinite(stamps.values)]) if len(stamps.values) < LONGEST else None
        why = f"time: the clock starts anew, so that there are {len(parts or ())} recordings: a file each"
    if parts is None:
        parts, why = _positions_apart(log, unsigned=ACCEL in unsigned)
    if unsigned:
        named = " and ".join({ACCEL: "accelerometers", GYRO: "gyros"}[kind] for kind in unsigned)
        remark = f"{named}: numbers of 16 bits that were read without their sign: 65536 taken off where it is due"
        wound = [c for kind in unsigned for c in triads[kind].columns]
        signed = [pl.when(pl.col(c) >= 32768.0).then(pl.col(c) - 65536.0).otherwise(pl.col(c)) for c in wound]
        mends.append((remark, lambda rows: rows.with_columns(signed)))
    mends += of_time
    if not mends and parts is None:
        return log
    return _copy(log, folder, time, mends, in_seconds=in_seconds, parts=parts, why=why)


def _copy(
    log: ForeignLog,
    folder: OutputFolder,
    time: list[str],
    mends: list[Mend],
    *,
    in_seconds: bool = False,
    parts: list[tuple[int, int]] | None = None,
    why: str = "",
) -> ForeignLog:
    """The log of a mended copy: a file for each file or for each of the `parts`, first and last + 1 row; with a column
    TIME in place of those of the time where it is `in_seconds`, and the remark `why` there are parts."""
    triads = log.columns.triads
    every = (*time, *(c for triad in triads.values() for c in triad.columns), *log.columns.temperatures)
    stamp, files = [TIME] if in_seconds else time, list[Path]()
    for number, source in enumerate(log.sources(), 1):
        rows = pl.concat(table for table, _ in source.tables(list(dict.fromkeys(every)), log.clock))
        for _, mend in mends:
            rows = mend(rows)
        rows = rows.filter(pl.all_horizontal(pl.col(stamp).is_finite())) if stamp else rows
        if parts is None:
            name = "log.parquet" if len(log.files) == 1 else f"log-{number:02d}.parquet"
            files.append(source.path if source.path in folder.written else folder.new_file(name))
            write_tables(files[-1], iter([rows]))
        for position, (start, stop) in enumerate(parts or (), 1):
            files.append(folder.new_file(f"position-{position:02d}.parquet"))
            write_tables(files[-1], iter([rows.slice(start, stop - start)]))
    columns = replace(log.columns, time_unit="s") if log.clock is not None else log.columns
    columns = replace(columns, time=TIME, time_unit="s") if in_seconds else columns
    copied = f"so mended, the log is copied to {files[0].name}{' …' * (len(files) > 1)}"
    every_remark = (*log.remarks, *(remark for remark, _ in mends), *filter(None, [why]), copied)
    return ForeignLog(
        files=tuple(files), keys={}, columns=columns, preamble=log.preamble, remarks=every_remark, doubts=log.doubts
    )


def _newest_last(stamps: Stamps) -> Mend:
    """The change that turns a log round whose time falls from row to row."""

    def turned(rows: pl.DataFrame) -> pl.DataFrame:
        rows = rows.reverse()
        time = rows[stamps.column].to_numpy()
        return rows.with_columns(pl.Series(stamps.column, past_midnight(time) if stamps.clock else time))

    return f"time: column {stamps.column!r} falls from row to row: rows put in the order of time", turned


def _rows_that_are_samples(log: ForeignLog) -> list[Mend]:
    """Changes that leave out rows that are no samples: memory filled in advance behind the last sample, and rows of
    other sensors. Rows without readings are lost samples instead if they are few, and the stamps about them have a
    gap."""
    mends: list[Mend] = []
    sensors = [c for kind, triad in log.columns.triads.items() if kind != MAGNETOMETER for c in triad.columns]
    read, one = log.read(sensors), len(log.files) == 1
    filled = len(read) > 0 and all(len(set(three)) == 1 for three in np.nan_to_num(read[-1]).reshape(-1, 3).tolist())
    samples = samples_in(read) if filled and one and len(read) < LONGEST else len(read)
    if samples < len(read):
        remark = f"rows: the last {len(read) - samples} are all alike and no samples: left out"
        mends.append((remark, lambda rows: rows.head(samples)))
    whole = np.asarray(np.isfinite(read[:samples]).mean(axis=1) >= _READ_SHARE)
    blank = int(np.count_nonzero(~whole))
    others = blank > _BLANK_SHARE * samples
    if one and blank and not others:
        others = not whole[0]
        stamps = log.stamps()
        time = np.empty(0) if stamps is None else stamps.values[:samples]
        if len(time) == samples and whole[1:].any() and np.isfinite(time[~whole]).any():  # messages have no time
            steps, between = np.diff(time[whole]), np.diff(np.flatnonzero(whole)) > 1
            others |= bool(between.any() and np.median(steps[between]) < JUMP * np.median(steps))
    if others:
        remark = f"rows: {blank} of {samples} have no readings of these sensors, as rows of others: left out"
        has_readings = pl.mean_horizontal(pl.col(sensors).is_finite()) >= _READ_SHARE
        mends.append((remark, lambda rows: rows.filter(has_readings)))
    return mends


def _time(log: ForeignLog, rate: float | None) -> tuple[list[str], bool, list[Mend]]:
    """Columns of the time, whether the changes make a column TIME of them, s, and the changes."""
    column, interval, mends = log.columns.time, log.columns.interval, list[Mend]()
    if rate is not None:
        return [] if column is None else [column], False, []
    if column is None:
        steps = np.empty(0) if interval is None or len(log.files) > 1 else log.read([interval])[:, 0]
        steps = steps[np.isfinite(steps)]
        times = times_of_column(Stamps(column=interval or "", values=np.cumsum(steps), unit=time_unit(interval or "")))
        if interval is None or times is None or (steps < 0.0).any():
            return [], False, []
        unit = times.keys.get("time_unit", "s")
        remark = f"time: none, but column {interval!r} has the intervals between samples, in {unit}: added up"
        added = pl.col(interval).fill_nan(0.0).cum_sum()
        return (
            [interval],
            True,
            [(remark, lambda rows: _in_seconds(rows.with_columns(added), interval, TIME_UNITS[unit]))],
        )
    nanoseconds = nanoseconds_of(log)
    if nanoseconds is not None:
        remark = f"time: columns {column!r} and {nanoseconds!r}, seconds and nanoseconds, added"
        return [column, nanoseconds], True, [(remark, lambda rows: _in_seconds(rows, column, 1.0, nanoseconds))]
    # the unit, s, of times in none that a session names
    tick = None
    if log.columns.time_unit is None and log.clock is None:
        stamps = log.read([column], rows=10_000)[:, 0]
        if np.isfinite(np.diff(stamps)).any():
            step, middle = float(np.nanmedian(np.diff(stamps))), float(np.nanmedian(stamps))
            if "sampletimefine" in re.sub(r"\W|_", "", column.lower()):
                tick = _TICK if step < 2000.0 else None  # microseconds where steps are thousands
            elif any(first < middle < last for first, last in _TENTHS_OF_MICROSECONDS):
                tick = 1e-7
            elif any(first < middle < last for first, last in _DAYS) and _SHORTEST < step * _DAY < _LONGEST:
                tick = _DAY if step < _SHORTEST else None
    overflow = overflow_of(log.read([column])[:, 0])
    if overflow is not None:
        remark = f"time: column {column!r} starts anew at {overflow:.10g}: that much is added where it does"
        mends.append((remark, lambda rows: rows.with_columns(_grown(rows[column], overflow))))
    if tick is not None:
        remark = f"time: column {column!r} in ticks of {tick:g} s, made seconds"
        mends.append((remark, lambda rows: _in_seconds(rows, column, tick)))
    return [column], tick is not None, mends


def _in_seconds(rows: pl.DataFrame, column: str, factor: float, nanoseconds: str | None = None) -> pl.DataFrame:
    """Rows with a column, and one of nanoseconds beside it, made TIME in s."""
    part = pl.lit(0.0) if nanoseconds is None else 1e-9 * pl.col(nanoseconds)
    return rows.rename({column: TIME}).with_columns(pl.col(TIME) * factor + part)


def _grown(column: pl.Series, overflow: float) -> pl.Series:
    """Times that grow, from stamps of a counter that overflows."""
    stamps = column.to_numpy().copy()
    known = np.isfinite(stamps)
    read = stamps[known]
    stamps[known] += overflow * np.cumsum(np.diff(read, prepend=read[:1]) < -0.5 * overflow)
    return pl.Series(column.name, stamps)


def nanoseconds_of(log: ForeignLog) -> str | None:
    """The column of nanoseconds beside a time in whole seconds: header.stamp.nsecs beside header.stamp.secs."""
    return next((n for n in log.names if _NANO.search(n) and _NANO.sub("", n) == log.columns.time), None)


def _wrapped(columns: Array) -> bool:
    """Whether integers (m, n) are signed numbers of 16 bits read as unsigned: from 0 to 65535, with hardly any in the
    middle."""
    if not np.isfinite(columns).any():
        return False
    low, high = np.nanmin(columns), np.nanmax(columns)
    if low < 0.0 or not 49152.0 < high < 65536.0 or not np.array_equal(columns, np.floor(columns), equal_nan=True):
        return False
    middle = (columns > 24576.0) & (columns < 40960.0)
    return bool(middle.mean() < 0.02 and (columns < 24576.0).any() and (columns > 40960.0).mean() > 1e-3)


def _unwrapped(columns: Array) -> Array:
    """Signed numbers of 16 bits from unsigned ones."""
    return np.where(columns >= 32768.0, columns - 65536.0, columns)


def with_signs(columns: Array) -> Array:
    """Columns (m, n) of which those of 16 bits that were read without their sign have it."""
    return np.column_stack([_unwrapped(c) if _wrapped(c) else c for c in columns.T]) if columns.size else columns


# -------------------- positions without turns between them --------------------


def _positions_apart(log: ForeignLog, *, unsigned: bool) -> tuple[list[tuple[int, int]] | None, str]:
    """First and last + 1 row of positions that follow each other without a turn, and the remark on them: by a column
    that names them, or where the reading jumps between two still stretches; None if there are none.

    `unsigned`: the accelerometers are numbers of 16 bits read as unsigned. Raises InputError for positions of too few
    rows."""
    if len(log.files) > 1 or ACCEL not in log.columns.triads:
        return None, ""
    accel = log.read(log.columns.triads[ACCEL].columns)
    accel = _unwrapped(accel) if unsigned else accel
    if np.isnan(accel).all(axis=0).any() or not 2 * _FEWEST_ROWS <= len(accel) < LONGEST:
        return None, ""
    label = next((n for n in log.cells if _LABEL.fullmatch(n.strip()) and n != log.columns.time), None)
    if label is not None:
        labels = pl.concat([table[label].cast(pl.String) for table in next(log.sources()).whole(())])
        starts = np.flatnonzero((labels != labels.shift(1)).fill_null(False).to_numpy()).tolist()
    else:  # the specific force is another than in the row before, while ten rows before and behind are steady
        size = float(np.nanmedian(np.linalg.norm(accel - np.nanmedian(accel, axis=0), axis=1)))
        starts = (np.flatnonzero(np.linalg.norm(np.diff(accel, axis=0), axis=1) > _JUMP * size) + 1).tolist()
        starts = starts if len(starts) <= len(accel) // _FEWEST_ROWS + 1 else []
        for row in starts:
            before, behind = accel[max(row - 10, 0) : row], accel[row : row + 10]
            scatter = max(np.ptp(before, axis=0).max(), np.ptp(behind, axis=0).max())
            jump = float(np.linalg.norm(behind.mean(axis=0) - before.mean(axis=0)))
            if not (scatter < 0.5 * jump and scatter < _JUMP * size):
                return None, ""
    if len(starts) < 3:
        return None, ""
    edges = list(pairwise([0, *starts, len(accel)]))
    shortest = min(stop - start for start, stop in edges)
    if shortest < _FEWEST_ROWS:
        raise InputError(
            f"{log.files[0]}: expected at least {_FEWEST_ROWS} rows a position, found {shortest}; take the mean of "
            "each position and give the table to `tumble ellipsoid`"
        )
    return edges, f"{len(edges)} positions one below the other without turns: a file each"
