"""Logs: columns of files become SI arrays, in chunks.

A file is read as a stream of tables of a bounded size, one reader per format, which become `_Rows`: times in
s, numbers as the file has them, and the number of their first data row (counted from 1), so that a message
can name the row. A lost sample is a row of NaN or a row that is not there. Runs of at most five of them are
bridged: the missing rows are put in with evenly spaced times, and every row that is not finite is
interpolated linearly in time between its sound neighbours. What was bridged is reported as `Gap`. Only then
come intervals, units and SI.

Nothing depends on how the stream is cut: rows that cannot be judged before the next table are held back.

A CSV file, compressed or not, is cut into pieces of whole lines for polars to parse. Where polars refuses a
piece, or leaves a value empty, Python reads the piece line by line and says where and why, or reads what only
`float()` accepts (blanks after a number).
"""

from __future__ import annotations

import csv
import gzip
import hashlib
import io
import math
import sys
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt
import polars as pl

from tumble.errors import LogError
from tumble.session import LogSpec, Session
from tumble.units import Array

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

_HEAD_ROWS = 1000
"""Rows from which the interval of a file is taken, their median."""

_JUMP = 1.5
"""A step in time longer than this many intervals is a gap."""

_BRIDGED_SAMPLES = 5
_BRIDGED_SHARE = 1e-3
_BRIDGED_FREE = 3
_BRIDGED_MOST = 10_000
"""A gap of so many samples is bridged; in a file as many gaps as 0.1 % of its rows and 3, and never more than
10 000."""

_SHORTEST_ROWS = 50
_SHORTEST_TIME = 2.0
_RATE_TOLERANCE = 0.1
_SHORTEST_INTERVAL, _LONGEST_INTERVAL = 1e-15, 1e15  # beyond, nothing can be computed

_FIRST_PIECE_BYTES = 1 << 18
_PIECE_BYTES = 1 << 24
_LINE_BYTES = 1 << 20
_PARQUET_ROWS = 1 << 15


@dataclass(frozen=True, kw_only=True, slots=True)
class Chunk:
    """Consecutive samples of one file, `file` being its index in session.log.files: end time and interval of
    each sample, s; accelerometers (m, na), m/s²; gyros (m, ng), rad/s; temperature, K; magnetometer (m, 3) in its
    unit."""

    file: int
    time: Array
    dt: Array
    accel: Array
    gyro: Array | None
    temperature: Array | None
    magnetometer: Array | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Gap:
    """Lost samples that were bridged: how many, the time of the first, s, and what was found. `row` is the
    first data row, counted from 1, that is not finite or that comes after missing ones."""

    file: int
    row: int
    time: float
    samples: int
    what: str


@dataclass(frozen=True, kw_only=True, slots=True)
class Log:
    """The log of a session, open for reading. `rate`: nominal sample rate, Hz, of the first file."""

    session: Session
    rate: float
    _sources: tuple[_Source, ...] = field(repr=False)
    _intervals: tuple[float, ...] = field(repr=False)
    _gaps: list[Gap] = field(default_factory=list, repr=False)

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """What was bridged in the chunks read so far by the latest `chunks()`."""
        return tuple(self._gaps)

    def chunks(self, rows: int = 65536) -> Iterator[Chunk]:
        """The samples in order, file by file, at most `rows` at a time; together the same to the bit for any
        `rows`. Memory does not grow with the log (of a Parquet file one row group is held).

        Raises LogError, one line that names the file, the row and the column, what was expected and found."""
        if rows < 1:
            raise ValueError(f"rows: expected at least 1, found {rows}")
        self._gaps.clear()
        for file in range(len(self._sources)):
            for chunk in self._samples(file):
                for start in range(0, len(chunk.time), rows):
                    yield _part(chunk, slice(start, start + rows))

    def sha256(self) -> str:
        """SHA-256 of the bytes of all files in order, hexadecimal: for one file that of `sha256sum`."""
        digest = hashlib.sha256()
        for source in self._sources:
            with _readable(source.path), source.path.open("rb") as stream:
                while piece := stream.read(_LINE_BYTES):
                    digest.update(piece)
        return digest.hexdigest()

    def _samples(self, file: int) -> Iterator[Chunk]:
        """The samples of one file as they come from its reader, repaired and in SI."""
        spec = self.session.log
        source, interval = self._sources[file], self._intervals[file]
        bridge = _Bridge(source=source, file=file, spec=spec, interval=interval, gaps=self._gaps)
        for time, dt, values in bridge.samples(_rows(source, spec)):
            yield Chunk(
                file=file,
                time=time,
                dt=dt,
                accel=spec.accel.to_si(values[0], dt),
                gyro=spec.gyro.to_si(values[1], dt) if spec.gyro else None,
                temperature=values[-1][:, 0] + _ZERO_CELSIUS if spec.temperature else None,
                magnetometer=values[2 if spec.gyro else 1] if spec.magnetometer else None,
            )


_ZERO_CELSIUS = 273.15
"""0 °C in K, exact (ITS-90)."""


def open_log(session: Session) -> Log:
    """The log of a session: every file is there, has the columns the session names and a plausible time.

    Raises LogError for a format that cannot be read, a damaged or empty file, missing or repeated columns."""
    sources = tuple(_source(path) for path in session.log.files)
    for source in sources:
        _check_columns(source, session.log)
    intervals = tuple(_interval(source, session.log) for source in sources)
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
    rate = 1.0 / intervals[0] if session.log.rate is None else session.log.rate
    return Log(session=session, rate=rate, _sources=sources, _intervals=intervals)


def _part(chunk: Chunk, rows: slice) -> Chunk:
    return Chunk(
        file=chunk.file,
        time=chunk.time[rows],
        dt=chunk.dt[rows],
        accel=chunk.accel[rows],
        gyro=None if chunk.gyro is None else chunk.gyro[rows],
        temperature=None if chunk.temperature is None else chunk.temperature[rows],
        magnetometer=None if chunk.magnetometer is None else chunk.magnetometer[rows],
    )


# -------------------- what is checked when a log is opened --------------------


def _check_columns(source: _Source, spec: LogSpec) -> None:
    names = source.names
    for column in spec.columns:
        if column not in names:
            near = get_close_matches(column, names, n=1, cutoff=0.5)
            hint = f"; did you mean '{near[0]}'?" if near else ""
            shown = ", ".join(names[:12]) + (", …" if len(names) > 12 else "")
            raise LogError(f"{source.path}: expected a column '{column}', found {shown}{hint}")
        if Counter(names)[column] > 1:
            raise LogError(f"{source.path}: expected one column '{column}', found {Counter(names)[column]}; rename one")


def _interval(source: _Source, spec: LogSpec) -> float:
    """The interval of a file's samples, s: the median over its first rows, or that of the nominal rate."""
    head = source.head(spec.time or spec.accel.columns[0], _HEAD_ROWS)
    if not len(head):
        raise LogError(f"{source.path}: expected a log, found no rows; the file is empty")
    if len(head) < _SHORTEST_ROWS:
        raise LogError(f"{source.path}: expected at least {_SHORTEST_ROWS} samples, found {len(head)}")
    if spec.rate is not None:
        return 1.0 / spec.rate
    time = head * spec.time_factor
    _check_time(source, spec, 1, time)
    return float(np.median(np.diff(time)))


def _check_time(source: _Source, spec: LogSpec, first: int, time: Array) -> None:
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


# -------------------- rows, and the bridging of lost samples --------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class _Rows:
    """Consecutive rows of a file: the number of the first, times (m,), s, and the numbers of accelerometers
    (m, na), gyros (m, ng), magnetometer (m, 3) and temperature (m, 1) as the file has them."""

    first: int
    time: Array
    values: tuple[Array, ...]

    def part(self, start: int, stop: int) -> _Rows:
        return _Rows(
            first=self.first + start,
            time=self.time[start:stop],
            values=tuple(v[start:stop] for v in self.values),
        )

    def followed_by(self, other: _Rows) -> _Rows:
        return _Rows(
            first=self.first,
            time=np.concatenate([self.time, other.time]),
            values=tuple(np.concatenate(pair) for pair in zip(self.values, other.values, strict=True)),
        )

    def lost(self) -> npt.NDArray[np.bool_]:
        """Which rows have a number that is not finite."""
        if all(np.isfinite(v).all() for v in self.values):
            return np.zeros(len(self.time), dtype=bool)
        return np.asarray(~np.isfinite(np.hstack(self.values)).all(axis=1))


def _rows(source: _Source, spec: LogSpec) -> Iterator[_Rows]:
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
        yield _Rows(first=first, time=time, values=tuple(_matrix(table, group) for group in groups))
        first += table.height


def _matrix(table: pl.DataFrame, columns: Sequence[str]) -> Array:
    """Columns of a table side by side, row after row in memory."""
    out = np.empty((table.height, len(columns)))
    for j, column in enumerate(columns):
        out[:, j] = table[column].to_numpy()
    return out


@dataclass(kw_only=True, slots=True)
class _Bridge:
    """Bridges the gaps of one file, row stream in, sample stream out, and adds them to `gaps`.

    `last`: the last row that went out, always a sound one; `held`: lost rows after it, whose end is not yet
    known."""

    source: _Source
    file: int
    spec: LogSpec
    interval: float
    gaps: list[Gap]
    last: _Rows | None = None
    held: _Rows | None = None
    start: float = 0.0
    bridged: int = 0

    def samples(self, stream: Iterator[_Rows]) -> Iterator[tuple[Array, Array, tuple[Array, ...]]]:
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

    def _hold(self, rows: _Rows) -> _Rows | None:
        if len(rows.time) > _BRIDGED_SAMPLES:
            raise self._too_long(rows)
        return rows if len(rows.time) else None

    def _repaired(self, rows: _Rows, lost: npt.NDArray[np.bool_]) -> tuple[Array, Array, tuple[Array, ...]]:
        """Samples of rows of which the last is sound; the row before them went out already, or is none."""
        before, self.last = self.last, rows.part(len(rows.time) - 1, len(rows.time))
        time = rows.time if before is None else np.concatenate([before.time, rows.time])
        _check_time(self.source, self.spec, rows.first - (before is not None), time)
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

    def _filled(self, rows: _Rows, steps: Array) -> _Rows:
        """Rows of which the first and the last are sound, missing rows put in and every number finite."""
        missing = self._missing(rows, steps)
        place = np.arange(len(rows.time)) + np.concatenate([[0], np.cumsum(missing)])
        time = np.interp(np.arange(place[-1] + 1), place, rows.time)
        lost = np.ones(len(time), dtype=bool)
        lost[place] = rows.lost()
        self._report(rows, place, lost, time)
        return _Rows(first=rows.first, time=time, values=tuple(_interpolated(v, place, time) for v in rows.values))

    def _missing(self, rows: _Rows, steps: Array) -> npt.NDArray[np.int64]:
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

    def _report(self, rows: _Rows, place: npt.NDArray[np.int64], lost: npt.NDArray[np.bool_], time: Array) -> None:
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

    def _not_finite(self, rows: _Rows) -> list[tuple[str, float]]:
        """Columns with numbers that are not finite, and the first such number of each."""
        numbers = np.hstack(rows.values)
        bad = ~np.isfinite(numbers)
        columns = [column for column in self.spec.columns if column != self.spec.time]
        return [(columns[j], float(numbers[np.argmax(bad[:, j]), j])) for j in np.flatnonzero(bad.any(axis=0))]

    def _check_begins_sound(self, rows: _Rows, lost: npt.NDArray[np.bool_]) -> None:
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

    def _too_long(self, rows: _Rows) -> LogError:
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


# -------------------- files: one reader per format --------------------


class _Source(Protocol):
    """A file of a log as tables."""

    @property
    def path(self) -> Path: ...

    @property
    def names(self) -> tuple[str, ...]:
        """Its column names in order."""

    def head(self, column: str, rows: int) -> Array:
        """The first numbers of a column, at most `rows`."""

    def tables(self, columns: Sequence[str]) -> Iterator[pl.DataFrame]:
        """Its rows in order as tables of a bounded size: these columns as float64, no empty values."""

    def place(self, row: int, column: str | None = None) -> str:
        """File, data row and column as a message names them."""


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Whatever a library says of a file that cannot be read becomes one line."""
    try:
        yield
    except (OSError, EOFError, zlib.error, zstd.ZstdError, pl.exceptions.PolarsError) as error:
        said = " ".join(str(error).split())
        raise LogError(
            f"{path}: expected a readable {_ending(path)} file, found it damaged or incomplete: {said}; "
            "copy or record it again"
        ) from None


def _source(path: Path) -> _Source:
    ending = _ending(path)
    if ending not in _READERS:
        raise LogError(f"{path}: expected a file that ends in {', '.join(_READERS)}, found another; convert it")
    with _readable(path):
        if path.stat().st_size == 0:
            raise LogError(f"{path}: expected a log, found an empty file")
        return _READERS[ending](path)


def _ending(path: Path) -> str:
    """The format of a file by its name: its last suffix, and the one before for a compressed file."""
    suffixes = [suffix.lower() for suffix in path.suffixes]
    compressed = suffixes[-1:] in ([".gz"], [".zst"])
    return "".join(suffixes[-2:] if compressed else suffixes[-1:])


@dataclass(frozen=True, kw_only=True, slots=True)
class _Parquet:
    path: Path
    names: tuple[str, ...]
    types: Mapping[str, pl.DataType]
    rows: int

    def head(self, column: str, rows: int) -> Array:
        with _readable(self.path):
            table = self._scan([column]).head(rows).collect()
        self._check_no_nulls(table, 1)
        return table[column].to_numpy()

    def tables(self, columns: Sequence[str]) -> Iterator[pl.DataFrame]:
        first = 1
        with _readable(self.path):
            for table in self._scan(columns).collect_batches(chunk_size=_PARQUET_ROWS, maintain_order=True):
                self._check_no_nulls(table, first)
                first += table.height
                yield table
        if first - 1 != self.rows:
            raise LogError(f"{self.path}: expected {self.rows} rows, found {first - 1}; copy or record it again")

    def _scan(self, columns: Sequence[str]) -> pl.LazyFrame:
        for column in columns:
            if not self.types[column].is_numeric():
                raise LogError(
                    f"{self.path}: column '{column}': expected numbers, found the type {self.types[column]}; "
                    "write it as float64"
                )
        return pl.scan_parquet(self.path, glob=False).select(pl.col(columns).cast(pl.Float64))

    def _check_no_nulls(self, table: pl.DataFrame, first: int) -> None:
        for column in table:
            if column.null_count():
                raise _empty_value(self.place(first + int(np.argmax(column.is_null().to_numpy())), column.name))

    def place(self, row: int, column: str | None = None) -> str:
        return f"{self.path}: row {row}" + _in_column(column)


def _open_parquet(path: Path) -> _Parquet:
    scan = pl.scan_parquet(path, glob=False)
    types = dict(scan.collect_schema())
    rows = scan.select(pl.len()).collect().item()
    return _Parquet(path=path, names=tuple(types), types=types, rows=rows)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Csv:
    path: Path
    names: tuple[str, ...]
    opened: Callable[[Path], io.BufferedIOBase]

    def head(self, column: str, rows: int) -> Array:
        found: list[Array] = [np.empty(0)]
        for table in self.tables([column]):
            found.append(table[column].to_numpy())
            if sum(map(len, found)) >= rows:
                break
        return np.concatenate(found)[:rows]

    def tables(self, columns: Sequence[str]) -> Iterator[pl.DataFrame]:
        first = 1
        with _readable(self.path), self.opened(self.path) as stream:
            stream.readline(_LINE_BYTES)
            for piece in self._pieces(stream):
                table = self._table(piece, first, columns)
                first += table.height
                yield table

    def _pieces(self, stream: io.BufferedIOBase) -> Iterator[bytes]:
        """The rest of a stream in pieces of whole lines, the first one small; blank lines at its end are left
        out."""
        rest = b""
        size = _FIRST_PIECE_BYTES
        while read := stream.read(size):
            text = rest + read
            end = text.rstrip().rfind(b"\n") + 1  # the line after it may go on, or be the last before blank ones
            if end:
                yield text[:end]
            rest = text[end:]
            if len(rest) > _LINE_BYTES:
                raise LogError(f"{self.path}: expected lines of numbers, found one of more than {_LINE_BYTES} bytes")
            size = _PIECE_BYTES
        if rest.strip():
            yield rest.rstrip()

    def _table(self, piece: bytes, first: int, columns: Sequence[str]) -> pl.DataFrame:
        """The rows of a piece that begins with data row `first`."""
        schema = {
            (name if name in columns else f"\0{j}"): pl.Float64 if name in columns else pl.String
            for j, name in enumerate(self.names)
        }
        try:
            table = pl.read_csv(piece, has_header=False, schema=schema)
        except pl.exceptions.PolarsError:
            return self._line_by_line(piece, first, columns)
        short = self.names[-1] not in columns and self._may_be_short(table, piece)
        used = table.select(pl.col(columns))
        if short or any(column.null_count() for column in used):
            return self._line_by_line(piece, first, columns)
        return used

    def _may_be_short(self, table: pl.DataFrame, piece: bytes) -> bool:
        """Whether there may be rows with too few values, which polars fills up with nulls from the end."""
        if not table.to_series(-1).null_count():
            return False
        return piece.count(b",") != table.height * (len(self.names) - 1)

    def _line_by_line(self, piece: bytes, first: int, columns: Sequence[str]) -> pl.DataFrame:
        """What `_table` gives, by Python's csv and float(), which can say what is wrong in which row."""
        used = [(self.names.index(column), column) for column in columns]
        text = io.StringIO(piece.decode("utf-8", errors="replace"), newline="\n")
        numbers: list[list[float]] = []
        try:
            for row, values in enumerate(csv.reader(text), first):
                self._check_width(row, values)
                numbers.append([self._number(row, column, values[j]) for j, column in used])
        except csv.Error as error:
            raise LogError(f"{self.place(first + len(numbers))}: expected numbers, found: {error}") from None
        return pl.DataFrame(np.array(numbers), schema=list(columns), orient="row")

    def _check_width(self, row: int, values: Sequence[str]) -> None:
        if len(values) != len(self.names):
            found = str(len(values)) if any(value.strip() for value in values) else "a blank line"
            raise LogError(
                f"{self.place(row)}: expected {len(self.names)} values, one per column, found {found}; "
                "correct or remove the row"
            )

    def _number(self, row: int, column: str, text: str) -> float:
        try:
            return float(text)
        except ValueError:
            if not text.strip():
                raise _empty_value(self.place(row, column)) from None
            raise LogError(
                f"{self.place(row, column)}: expected a number, found {text[:40]!r}; correct or remove the row"
            ) from None

    def place(self, row: int, column: str | None = None) -> str:
        return f"{self.path}: row {row} (line {row + 1})" + _in_column(column)


def _open_csv(path: Path, opened: Callable[[Path], io.BufferedIOBase]) -> _Csv:
    with opened(path) as stream:
        header = stream.readline(_LINE_BYTES).decode("utf-8-sig", errors="replace")
    names = next(csv.reader([header]), [])
    return _Csv(path=path, names=tuple(name.strip() for name in names), opened=opened)


def _opened(path: Path) -> io.BufferedReader:
    return path.open("rb")


_READERS: Mapping[str, Callable[[Path], _Source]] = {
    ".csv": lambda path: _open_csv(path, _opened),
    ".csv.gz": lambda path: _open_csv(path, gzip.GzipFile),
    ".csv.zst": lambda path: _open_csv(path, zstd.ZstdFile),
    ".parquet": _open_parquet,
}


def _empty_value(place: str) -> LogError:
    return LogError(
        f"{place}: expected a number, found an empty value; correct or remove the row, or write nan for a lost sample"
    )


def _in_column(column: str | None) -> str:
    return "" if column is None else f", column '{column}'"


def log_columns(path: Path) -> tuple[str, ...]:
    """The names of a log's columns in order."""
    return _source(path).names


def log_head(path: Path, column: str, rows: int) -> Array:
    """The first numbers of a column of a log, at most `rows`."""
    return _source(path).head(column, rows)
