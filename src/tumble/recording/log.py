"""Logs: columns of files, or of tables in memory, as SI arrays in chunks.

A file is read as a stream of tables of bounded size (`readers`), which become rows with times in s, numbers as written,
and row numbers for messages (`rows.timed`). Short gaps are bridged (`rows.gaps`); then follow intervals, units and SI.
"""

from __future__ import annotations

import datetime as dt
import filecmp
import hashlib
import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np

from tumble.brief import Brief
from tumble.errors import LogError, TumbleError, did_you_mean
from tumble.recording.log_source import LogSource, readable
from tumble.recording.readers import TableLog, source_of
from tumble.recording.rows.gaps import Bridge, Gap, Grid, Tables, seconds_of_stamps, side_by_side
from tumble.recording.rows.timed import TimedRows, burst_grid, check_head, regular_grid, rounded_grid
from tumble.recording.session import LogSpec, Session
from tumble.units import ZERO_CELSIUS, Array

HEAD_ROWS = 1000  # rows from which the median interval of a file is taken
_FIRST_READER: dict[str, int] = {}  # process id of the first process that has read logs
UNIX_TIMES = (946_684_800.0, 4_102_444_800.0)
"""Beginning of 2000 and of 2100 in seconds since 1970; times of a log between them are absolute."""
_FEWEST_ROWS = 50
_RATE_TOLERANCE = 0.1  # relative, between the files of a log
_SHORTEST_INTERVAL, _LONGEST_INTERVAL = 1e-15, 1e15  # s; other intervals overflow


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Chunk:
    """Consecutive samples of one file, which has the index `file` in session.log.files.

    `time` (m,) are the ends of the samples by the clock of the log, s, `dt` (m,) the intervals, corrected for the rate
    of that clock, s. The readings are those of accelerometers (m, na), m/s²; gyros (m, ng), rad/s; thermometers (m, T),
    K; and a magnetometer (m, 3) in its unit."""

    file: int
    time: Array
    dt: Array
    accel: Array
    gyro: Array | None
    temperature: Array | None
    magnetometer: Array | None = None

    def part(self, rows: slice) -> Chunk:
        """Return a part of the samples."""
        names = "time", "dt", "accel", "gyro", "temperature", "magnetometer"
        arrays: dict[str, Any] = {name: array[rows] for name in names if (array := getattr(self, name)) is not None}
        return replace(self, **arrays)


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Log(Brief):
    """The log of a session, open for reading. `rate`: nominal sample rate, Hz, of the first file."""

    session: Session
    rate: float
    _sources: tuple[LogSource, ...] = field(repr=False)
    _grids: tuple[Grid, ...] = field(repr=False)
    _first_stamp: float = field(repr=False)
    _gaps: list[Gap] = field(default_factory=list, repr=False)

    @property
    def name(self) -> str:
        """Paths of the files, for messages."""
        return ", ".join(str(source.path) for source in self._sources)

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """Gaps in the chunks read so far by the latest `chunks()`."""
        return tuple(self._gaps)

    @property
    def recorded(self) -> str | None:
        """Time of the first sample, ISO 8601; None if the times of the log are not absolute."""
        spec = self.session.log
        if spec.time is None:
            return None
        if spec.clock:
            return self._sources[0].first_date(spec.time)
        seconds = self._first_stamp * spec.time_factor
        if not UNIX_TIMES[0] < seconds < UNIX_TIMES[1]:
            return None
        return dt.datetime.fromtimestamp(seconds, dt.UTC).isoformat(timespec="seconds")

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the times."""
        jitter = max(grid.jitter for grid in self._grids)
        early_or_late = f"read up to {1e3 * jitter:.2g} ms late or early"
        note = f"time stamps are those of bursts, {early_or_late}: rows are taken as even"
        return (note,) if jitter > 0.0 else ()

    def chunks(self, rows: int = 65536) -> Iterator[Chunk]:
        """Yield the samples in order, file by file, at most `rows` at a time, with the same numbers for any `rows`.

        Memory does not grow with the log (one row group of a Parquet file is held). Raises LogError, one line with the
        file, the row and the column, what was expected and found."""
        if rows < 1:
            raise ValueError(f"rows: expected at least 1, found {rows}")
        self._gaps.clear()
        spec = self.session.log
        before = 2 if spec.time is None else 1  # columns for the number of a row, and for its time if it has none
        for file, (source, grid) in enumerate(zip(self._sources, self._grids, strict=True)):
            tables = source.tables(spec.columns, spec.time if spec.clock else None)
            as_written = ((side_by_side(table, spec.columns, before), unread) for table, unread in tables)
            for chunk in samples_of(as_written, source, spec, file, grid, self._gaps):
                for start in range(0, len(chunk.time), rows):
                    yield chunk.part(slice(start, start + rows))

    def sha256(self) -> str:
        """Return the SHA-256 of the bytes of all files in order, hexadecimal, as `sha256sum` for one file.

        For samples in memory it is that of the names and numbers of the columns that are read."""
        digest = hashlib.sha256()
        for file in self.session.log.files:
            if isinstance(file, TableLog) and file.in_memory:
                for piece in file.content(self.session.log.columns):
                    digest.update(piece)
            else:
                path = file if isinstance(file, Path) else file.path
                with readable(path), path.open("rb", buffering=0) as stream:
                    hashlib.file_digest(stream, lambda: digest)
        return digest.hexdigest()


def samples_of(
    tables: Tables, source: LogSource, spec: LogSpec, file: int, grid: Grid, gaps: list[Gap]
) -> Iterator[Chunk]:
    """Yield the samples of one file in SI from its rows as written, with gaps bridged or left out and added to `gaps`.

    `source` has its path and columns, for messages."""
    bridge = Bridge(source=source, file=file, spec=spec, interval=grid.interval, gaps=gaps)
    timed = TimedRows(source=source, spec=spec, file=file, grid=grid, gaps=gaps)
    parts = [spec.accel, spec.gyro, spec.magnetometer, spec.temperature]
    ends = np.cumsum([0 if part is None else len(part.columns) for part in parts])
    for time, dt_of_log, values in bridge.samples(timed.rows(tables)):
        dt = dt_of_log if spec.clock_rate == 1.0 else spec.clock_rate * dt_of_log
        accel, gyro, magnetometer, temperature, _ = np.split(values, ends, axis=1)
        yield Chunk(
            file=file,
            time=time,
            dt=dt,
            accel=spec.accel.to_si(accel, dt),
            gyro=spec.gyro.to_si(gyro, dt) if spec.gyro else None,
            temperature=spec.temperature.to_celsius(temperature) + ZERO_CELSIUS if spec.temperature else None,
            magnetometer=magnetometer if spec.magnetometer else None,
        )


def open_log(session: Session) -> Log:
    """Open the log of a session, and check its files, their columns and their times.

    Raises LogError for a format that cannot be read, a damaged or empty file and missing columns, and TumbleError in a
    process forked from one that has read logs, because it lacks the threads of the reader."""
    if _FIRST_READER.setdefault("process", os.getpid()) != os.getpid():
        raise TumbleError(
            "this process was forked from one that had read logs, whose threads it lacks: it would wait for ever; "
            "start workers anew: multiprocessing.get_context('spawn') or 'forkserver'"
        )
    spec, grids, first_stamps = session.log, list[Grid](), list[float]()
    sources = tuple(source_of(file, spec.dialect) for file in spec.files)
    for one, other in combinations([file for file in spec.files if isinstance(file, Path)], 2):
        if one.stat().st_size == other.stat().st_size and filecmp.cmp(one, other, shallow=False):
            raise LogError(f"{other}: holds the same recording as {one}; name every recording once")
    for source, column in product(sources, spec.columns):
        if column not in source.names:
            shown = ", ".join(source.names[:12]) + (", …" if len(source.names) > 12 else "")
            hint = did_you_mean(column, source.names, alike=0.5)
            raise LogError(f"{source.path}: expected a column '{column}', found {shown[:200]}{hint}")
    for source in sources:
        # the first times as written; without times, the first numbers of a sensor
        column, head = spec.time or spec.accel.columns[0], np.empty(0)
        for table, _ in source.tables([column], column if spec.clock else None):
            head = np.concatenate([head, table[column].to_numpy()])[:HEAD_ROWS]
            if len(head) == HEAD_ROWS:
                break
        if not len(head):
            raise LogError(f"{source.path}: expected a log, found no rows; the file is empty")
        if len(head) < _FEWEST_ROWS:
            raise LogError(f"{source.path}: expected at least {_FEWEST_ROWS} samples, found {len(head)}")
        first_stamps.append(float(head[0]))
        if spec.rate is not None:
            grids.append(Grid(start=1.0 / spec.rate, interval=1.0 / spec.rate))
        elif spec.regular:
            grids.append(regular_grid(source, spec))
        else:  # the median over the first rows; the mean over all rows for increments with rounded stamps
            time = check_head(source, spec, seconds_of_stamps(head, spec))
            grid = Grid(start=float(time[0]), interval=float(np.median(np.diff(time))))
            rounded = rounded_grid(source, spec, grid.interval) if any(spec.increments.values()) else None
            grids.append(rounded or burst_grid(source, spec, time) or grid)
    intervals = [grid.interval for grid in grids]
    for source, interval in zip(sources, intervals, strict=True):
        if abs(interval / intervals[0] - 1.0) > _RATE_TOLERANCE:
            raise LogError(
                f"{source.path}: expected the sample rate of {sources[0].path.name}, "
                f"{1 / intervals[0]:.6g} Hz, found {1 / interval:.6g} Hz; give a log of another rate its own "
                "session"
            )
    if not _SHORTEST_INTERVAL <= intervals[0] <= _LONGEST_INTERVAL:
        raise LogError(
            f"{sources[0].path}: expected samples from {_SHORTEST_INTERVAL:g} to {_LONGEST_INTERVAL:g} s apart, found "
            f"{intervals[0]:.3g} s; check log.time, log.time_unit or log.rate_hz"
        )
    rate = 1.0 / intervals[0] if spec.rate is None else spec.rate
    return Log(session=session, rate=rate, _sources=sources, _grids=tuple(grids), _first_stamp=first_stamps[0])
