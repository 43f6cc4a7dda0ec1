"""Repaired copies of logs that a session file cannot describe: 16-bit numbers read as unsigned, integers that stand for
no reading, times in ticks, intervals or seconds and nanoseconds, counters that overflow, rows in reverse order, twice
or without samples, and successive positions."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import polars as pl

from tumble.drafting.foreign_log import LONGEST, SAMPLE_ROWS, ForeignLog
from tumble.drafting.times import Stamps, grows_mostly, overflow_of, recordings_of, times_of_column
from tumble.errors import InputError
from tumble.files import OutputFolder
from tumble.recording.columns.names import ACCEL, MAGNETOMETER, NAMED, is_interval, time_unit
from tumble.recording.columns.scales import PRIORS
from tumble.recording.formats import TIME
from tumble.recording.readers import write_tables
from tumble.recording.rows.gaps import GAP_STEP
from tumble.recording.rows.timed import past_midnight
from tumble.units import TIME_UNITS, Array, BoolArray

_XSENS_TICK = 1e-4  # s, of SampleTimeFine
_BLANK_SHARE = 0.02  # of rows without readings; a larger share are rows of other sensors
_READ_SHARE = 0.5  # least share of its sensors that a sample has; a row of words and other numbers has fewer
_FEWEST_ROWS = 50
_POSITION_JUMP = 0.2  # of gravity
_STILL_SHARE = 0.01  # of a jump: rows of a position drift less, those of a turn more
_NOISE_SIGMAS = 5.0  # of the noise in a drift
_SIGN, _WRAP = 32768.0, 65536.0  # of 16-bit numbers
_NEGATIVE_SHARE = 1e-3  # least share of numbers at the upper end, if 16-bit numbers were read as unsigned
_MIDDLE_SHARE = 0.02  # largest share of numbers in the middle, if so
_UNLED = 2.0  # steps to a limit over the largest other step; at most 1.1 in turns of up to 80 times the range

Repair = tuple[str, Callable[[pl.DataFrame], pl.DataFrame]]
"""A remark on a change of the rows of a file, and the change."""


def repair_log(log: ForeignLog, folder: OutputFolder, rate: float | None) -> ForeignLog:
    """Return a log that a session file can describe: the log itself, or a repaired copy in the folder.

    A `rate`, Hz, stated by the user replaces time stamps that show another one. Raises InputError for sensors without
    numbers, and for positions of too few rows."""
    triads = log.columns.triads
    for kind, sensors in triads.items():
        if kind != MAGNETOMETER and not np.isfinite(log.read(sensors.columns, rows=SAMPLE_ROWS)).any():
            raise InputError(f"{log.files[0]}: expected numbers in {', '.join(sensors.columns)[:200]}, found none")
    time_columns = [column for column in (log.columns.time, nanoseconds_column(log)) if column is not None]
    if log.instance:
        ((column, value),) = log.instance.items()
        repair = f"rows: those with {value:g} in column {column!r}, of one device", log.rows_of_instance
        return repair_log(_copy(log, folder, [*time_columns, column], [repair]), folder, rate)
    stamps = log.stamps()
    if stamps is not None and len(stamps.values) >= _FEWEST_ROWS and grows_mostly(-stamps.values):
        remark = f"time: column {stamps.column!r} falls from row to row: rows put in the order of time"
        return repair_log(_copy(log, folder, [stamps.column], [(remark, pl.DataFrame.reverse)]), folder, rate)
    if copies := _copied_rows(log, time_columns):
        return repair_log(_copy(log, folder, time_columns, copies), folder, rate)
    rate = None if rate is not None and log.times(rate).stamped else rate
    repairs = _leave_out_other_rows(log) + _mend_readings(log)
    time_columns, in_seconds, time_repairs = _repair_time(log, rate)
    parts, why = None, ""
    untouched = len(log.files) == 1 and not (repairs or time_repairs) and rate is None
    if untouched and stamps is not None and not stamps.clock and len(stamps.values) < LONGEST:
        parts = recordings_of(stamps.values[np.isfinite(stamps.values)])
        why = f"time: the clock starts anew, so that there are {len(parts or ())} recordings: a file each"
        if parts is not None and len(parts) == 1:
            why = f"time: the clock starts anew: rows {parts[0][0] + 1} to {parts[0][1]} are taken"
    if parts is None:
        parts, why = _successive_positions(log)
    repairs += time_repairs
    if not repairs and parts is None:
        return log
    return _copy(log, folder, time_columns, repairs, in_seconds=in_seconds, parts=parts, why=why)


def _copy(
    log: ForeignLog,
    folder: OutputFolder,
    time_columns: list[str],
    repairs: list[Repair],
    *,
    in_seconds: bool = False,
    parts: list[tuple[int, int]] | None = None,
    why: str = "",
) -> ForeignLog:
    """Return the log of a repaired copy, one file for each file or for each range of rows in `parts`.

    With `in_seconds` the repairs have replaced the time by a column TIME. `why` is the remark on the parts."""
    columns = (*time_columns, *log.columns.sensors, *log.columns.temperatures)
    stamp = [TIME] if in_seconds else time_columns
    files = list[Path]()
    for number, source in enumerate(log.sources(), 1):
        rows = pl.concat(table for table, _ in source.tables(list(dict.fromkeys(columns)), log.clock))
        for _, repair in repairs:
            rows = repair(rows)
        rows = rows.filter(pl.all_horizontal(pl.col(stamp).is_finite())) if stamp else rows
        if log.clock is not None:
            rows = rows.with_columns(pl.Series(log.clock, past_midnight(rows[log.clock].to_numpy())))
        if parts is None:
            name = "log.parquet" if len(log.files) == 1 else f"log-{number:02d}.parquet"
            files.append(source.path if source.path in folder.written else folder.new_file(name))
            write_tables(files[-1], iter([rows]))
        for position, (start, stop) in enumerate(parts or (), 1):
            files.append(folder.new_file(f"position-{position:02d}.parquet" if len(parts or ()) > 1 else "log.parquet"))
            write_tables(files[-1], iter([rows.slice(start, stop - start)]))
    described = replace(log.columns, time_unit="s") if log.clock is not None else log.columns
    described = replace(described, time=TIME, time_unit="s") if in_seconds else described
    copied = f"so mended, the log is copied to {files[0].name}{' …' * (len(files) > 1)}"
    remarks = (*log.remarks, *(remark for remark, _ in repairs), *filter(None, [why]), copied)
    return ForeignLog(files=tuple(files), columns=described, preamble=log.preamble, remarks=remarks, doubts=log.doubts)


def _leave_out_other_rows(log: ForeignLog) -> list[Repair]:
    """Leave out rows that are no samples but those of other sensors.

    A few rows without readings are kept as lost samples if the stamps have a gap there."""
    sensors = [c for kind, triad in log.columns.triads.items() if kind != MAGNETOMETER for c in triad.columns]
    whole = np.asarray(np.isfinite(log.read(sensors)).mean(axis=1) >= _READ_SHARE)
    blank = int(np.count_nonzero(~whole))
    are_others = blank > _BLANK_SHARE * len(whole)
    if len(log.files) == 1 and blank and not are_others:
        are_others = not whole[0]
        stamps = log.stamps()
        time = np.empty(0) if stamps is None else stamps.values
        if len(time) == len(whole) and whole[1:].any() and np.isfinite(time[~whole]).any():  # messages have no time
            steps, across = np.diff(time[whole]), np.diff(np.flatnonzero(whole)) > 1
            are_others |= bool(across.any() and np.median(steps[across]) < GAP_STEP * np.median(steps))
    if not are_others:
        return []
    remark = f"rows: {blank} of {len(whole)} have no readings of these sensors, as rows of others: left out"
    return [(remark, lambda rows: rows.filter(pl.mean_horizontal(pl.col(sensors).is_finite()) >= _READ_SHARE))]


def _copied_rows(log: ForeignLog, time_columns: list[str]) -> list[Repair]:
    """Leave out rows that are in the file of a log twice, with one time stamp and equal readings.

    Where a clock is coarse, stamps repeat with other readings. Files with the same rows are refused when they are
    read."""
    if len(log.files) > 1:
        return []
    columns = [*time_columns, *log.columns.sensors]
    rows = pl.DataFrame(log.read(columns), schema=columns, orient="row")
    repeated = _BLANK_SHARE * rows.height
    stamps = rows.select(time_columns).n_unique() if time_columns else rows.height
    if rows.height - stamps <= repeated or (different := rows.n_unique()) - stamps > repeated:
        return []
    copies = f"{rows.height - different} of {rows.height} are in the log twice, with the same time and readings"
    return [(f"rows: {copies}: left out", lambda rows: rows.unique(columns, maintain_order=True))]


def _repair_time(log: ForeignLog, rate: float | None) -> tuple[list[str], bool, list[Repair]]:
    """Return the time columns, whether the repairs replace them by a column TIME in s, and the repairs."""
    column, repairs = log.columns.time, list[Repair]()
    if rate is None and (intervals := _intervals(log)) is not None:
        name, unit = intervals
        remark = f"time: column {name!r} has the intervals between samples, in {unit}: added up"
        added = pl.col(name).fill_nan(0.0).cum_sum()
        return [name], True, [(remark, lambda rows: _in_seconds(rows.with_columns(added), name, TIME_UNITS[unit]))]
    if column is None or rate is not None:
        return [] if column is None else [column], False, []
    nanoseconds = nanoseconds_column(log)
    if nanoseconds is not None:
        remark = f"time: columns {column!r} and {nanoseconds!r}, seconds and nanoseconds, added"
        return [column, nanoseconds], True, [(remark, lambda rows: _in_seconds(rows, column, 1.0, nanoseconds))]
    tick = None
    if log.columns.time_unit is None and log.clock is None and "sampletimefine" in re.sub(r"\W|_", "", column.lower()):
        steps = np.diff(log.read([column], rows=10_000)[:, 0])
        # steps of thousands are microseconds
        tick = _XSENS_TICK if np.isfinite(steps).any() and float(np.nanmedian(steps)) < 2000.0 else None
    overflow = overflow_of(log.read([column])[:, 0])
    if overflow is not None:
        remark = f"time: column {column!r} starts anew at {overflow:.10g}: that much is added where it does"
        repairs.append((remark, lambda rows: rows.with_columns(_without_overflow(rows[column], overflow))))
    if tick is not None:
        remark = f"time: column {column!r} in ticks of {tick:g} s, made seconds"
        repairs.append((remark, lambda rows: _in_seconds(rows, column, tick)))
    return [column], tick is not None, repairs


def _intervals(log: ForeignLog) -> tuple[str, str] | None:
    """Return the column of intervals between samples in place of times, and its unit; None for other logs.

    By their numbers, intervals are of one size, change without a trend, and are whole unless in s, so that temperatures
    are none."""
    column = log.columns.time or next(filter(is_interval, log.names), None)
    steps = np.empty(0) if column is None else log.read([column])[:, 0]
    steps = steps[np.isfinite(steps)]
    if column is None or len(steps) < _FEWEST_ROWS or steps.min() < 0.0:
        return None
    low, median, high = np.quantile(steps, (0.05, 0.5, 0.95))
    trend = np.mean(steps[len(steps) // 2 :]) - np.mean(steps[: len(steps) // 2])
    is_even = 0.3 * median < low < high < 3.0 * median and abs(trend) < np.std(steps)
    in_unit = median < 1.0 or np.array_equal(steps, np.floor(steps))
    if not ((is_even and in_unit) or (is_interval(column) and trend < 0.5 * median)):
        return None
    unit = log.columns.time_unit or time_unit(column)
    times = times_of_column(Stamps(column=column, values=np.cumsum(steps), unit=unit))
    return None if times is None else (column, times.keys.get("time_unit", "s"))


def _in_seconds(rows: pl.DataFrame, column: str, factor: float, nanoseconds: str | None = None) -> pl.DataFrame:
    """Replace a column, with one of nanoseconds beside it, by TIME in s."""
    part = pl.lit(0.0) if nanoseconds is None else 1e-9 * pl.col(nanoseconds)
    return rows.rename({column: TIME}).with_columns(pl.col(TIME) * factor + part)


def _without_overflow(column: pl.Series, overflow: float) -> pl.Series:
    """Return growing times from the stamps of a counter that overflows."""
    stamps = column.to_numpy().copy()
    finite = np.isfinite(stamps)
    numbers = stamps[finite]
    stamps[finite] += overflow * np.cumsum(np.diff(numbers, prepend=numbers[:1]) < -0.5 * overflow)
    return pl.Series(column.name, stamps)


def nanoseconds_column(log: ForeignLog) -> str | None:
    """Return the column of nanoseconds beside a time in whole seconds: header.stamp.nsecs beside header.stamp.secs."""
    nano = NAMED["nanoseconds"]
    return next((n for n in log.names if nano.search(n) and nano.sub("", n) == log.columns.time), None)


def _are_unsigned(columns: Array) -> bool:
    """Return whether integers are signed 16-bit numbers read as unsigned: at both ends, hardly any in the middle."""
    numbers = columns[np.isfinite(columns)]
    if not len(numbers) or numbers.min() < 0.0 or numbers.max() >= _WRAP or (numbers != np.floor(numbers)).any():
        return False
    has_ends = numbers.min() < 0.5 * _SIGN and np.mean(numbers > 1.5 * _SIGN) > _NEGATIVE_SHARE
    return bool(has_ends and np.mean(np.abs(numbers - _SIGN) < 0.25 * _SIGN) < _MIDDLE_SHARE)


def with_signs(columns: Array) -> Array:
    """Return columns, of the readings of one kind of sensor, with their signs if they were read as unsigned."""
    return np.where(columns >= _SIGN, columns - _WRAP, columns) if _are_unsigned(columns) else columns


def stand_for_none(columns: Array) -> BoolArray:
    """Return which integers (m, 3) of one kind of sensor stand for no reading.

    These are limits of 16 or 32 bits to which the readings step, and from which they step back, at least twice as far
    as anywhere else: a sensor that is driven to its limit approaches it, as the motion does."""
    at_limit, finite = np.isin(columns, PRIORS["numbers"]["limits"]), np.isfinite(columns)
    if not at_limit.any() or (columns[finite] != np.floor(columns[finite])).any():
        return np.zeros(columns.shape, dtype=bool)
    at = np.asarray(at_limit.any(axis=1))
    steps = np.linalg.norm(np.diff(columns, axis=0), axis=1)
    largest = np.max(steps[np.isfinite(steps) & ~(at[1:] | at[:-1])], initial=0.0)
    for start, stop in np.flatnonzero(np.diff(at, prepend=False, append=False)).reshape(-1, 2).tolist():
        if min((*steps[max(start - 1, 0) : start], *steps[stop - 1 : stop]), default=0.0) <= _UNLED * largest:
            at_limit[start:stop] = False
    return at_limit


def _mend_readings(log: ForeignLog) -> list[Repair]:
    """Restore the signs of 16-bit numbers that were read as unsigned, and mark integers that stand for no reading."""
    triads = [triad.columns for triad in log.columns.triads.values()]
    unsigned = list[str]()
    marked = list[str]()
    for columns in triads:
        numbers = log.read(columns)
        unsigned += columns if _are_unsigned(numbers) else ()
        numbers = with_signs(numbers)
        lost = stand_for_none(numbers)
        limits = " and ".join(f"{limit:.0f}" for limit in np.unique(numbers[lost]))
        marked += [f"{', '.join(columns)}: {limits} in {lost.any(axis=1).sum()} rows"] if limits else []

    def mended(rows: pl.DataFrame) -> pl.DataFrame:
        rows = rows.with_columns(pl.col(c) - _WRAP * (pl.col(c) >= _SIGN) for c in unsigned)
        for columns in triads:
            numbers = rows.select(columns).to_numpy()
            numbers = np.where(stand_for_none(numbers), np.nan, numbers)
            rows = rows.with_columns(pl.DataFrame(numbers, schema=list(columns), orient="row"))
        return rows

    remarks = list[str]()
    if unsigned:
        remarks.append(
            f"{', '.join(unsigned)}: 16-bit numbers read without their sign: 65536 taken off where it is due"
        )
    if marked:
        found = f"{'; '.join(marked)}, to which no other readings lead"
        remarks.append(f"{found}, stand for no reading: lost samples")
    return [("; ".join(remarks), mended)] if remarks else []


def _successive_positions(log: ForeignLog) -> tuple[list[tuple[int, int]] | None, str]:
    """Return the ranges of rows of positions without turns between them, and a remark; None for other logs.

    Positions are named by a column, or the reading jumps between two still stretches.
    Raises InputError for positions of too few rows."""
    if len(log.files) > 1 or ACCEL not in log.columns.triads:
        return None, ""
    accel = with_signs(log.read(log.columns.triads[ACCEL].columns))
    if np.isnan(accel).all(axis=0).any() or not 2 * _FEWEST_ROWS <= len(accel) < LONGEST:
        return None, ""
    label = next((n for n in log.cells if NAMED["label"].fullmatch(n.strip()) and n != log.columns.time), None)
    if label is not None:
        labels = pl.concat([table[label].cast(pl.String) for table in next(log.sources()).whole(())])
        starts = np.flatnonzero((labels != labels.shift(1)).fill_null(False).to_numpy()).tolist()
    else:  # the force jumps between ten steady rows before and after
        size = float(np.nanmedian(np.linalg.norm(accel - np.nanmedian(accel, axis=0), axis=1)))
        steps = np.linalg.norm(np.diff(accel, axis=0), axis=1)
        starts = (np.flatnonzero(steps > _POSITION_JUMP * size) + 1).tolist()
        starts = starts if len(starts) <= len(accel) // _FEWEST_ROWS + 1 else []
        for row in starts:
            before, behind = accel[max(row - 10, 0) : row], accel[row : row + 10]
            scatter = max(np.ptp(before, axis=0).max(), np.ptp(behind, axis=0).max())
            jump = float(np.linalg.norm(behind.mean(axis=0) - before.mean(axis=0)))
            turns = any(_drift(rows) > _STILL_SHARE * jump for rows in (before, behind))  # whose middle is lost
            if turns or not (scatter < 0.5 * jump and scatter < _POSITION_JUMP * size):
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


def _drift(rows: Array) -> float:
    """Return by how much the means of the halves of rows (m, 3) differ beyond _NOISE_SIGMAS of their noise."""
    half = len(rows) // 2
    if half < 2:  # too few to show a change
        return 0.0
    change = np.linalg.norm(rows[half:].mean(axis=0) - rows[:half].mean(axis=0))
    return float(change - _NOISE_SIGMAS * np.linalg.norm(np.diff(rows, axis=0).std(axis=0)) / (len(rows) / 2) ** 0.5)
