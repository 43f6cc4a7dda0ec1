"""The files of a log: one reader per format, each giving tables of a bounded size; a table in memory is read as one.

A text file, compressed or not, is cut into pieces of whole lines for polars to parse, whatever its dialect. Where
polars refuses a piece, or leaves a value empty, the piece is halved until Python can read the few lines in question
one by one: it says where and why, or reads what only `float()` accepts (blanks after a number). A row that cannot be
read is not dropped here: it comes as NaN, together with what was found, and `gaps` decides.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
import sys
import time
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np
import polars as pl

from tumble.errors import LogError
from tumble.recording.clock import date_of, day_of, seconds_of
from tumble.recording.dialect import BLANKS, LINE_BYTES, Dialect, Recoded, head_lines, top_of
from tumble.recording.panic import LAST_WORDS, without_panic
from tumble.recording.samples import Samples
from tumble.recording.session import LogSpec
from tumble.recording.unpacked import unpacked
from tumble.units import Array

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd


_FIRST_PIECE_BYTES = 1 << 18
_PIECE_BYTES = 1 << 24
_SLOW_BYTES = 1 << 14
_SHOWN = 40
_PARQUET_ROWS = 1 << 15
_SLICE_ROWS = 1 << 17


class Kind(Enum):
    """What cannot be read: a value, a whole row; or a line that is no row of numbers but text, or a comment or blank,
    or the last one, which was cut."""

    VALUE = "value"
    ROW = "row"
    TEXT = "text"
    NO_ROW = "no row"
    CUT = "cut"


@dataclass(frozen=True, kw_only=True, slots=True)
class Unread:
    """A row of which something could not be read, and what was found there; `column` is None for the whole row."""

    row: int
    column: str | None
    found: str
    kind: Kind

    @property
    def what(self) -> str:
        """What was found, in words."""
        shown = self.found[:_SHOWN] + ("…" if len(self.found) > _SHOWN else "")
        if self.kind is Kind.CUT:
            return "the last line is cut"
        if self.column is not None:
            return (
                f"{shown!r} in '{self.column[:_SHOWN]}'"
                if shown.strip()
                else f"an empty value in '{self.column[:_SHOWN]}'"
            )
        return shown if self.kind is Kind.ROW or shown == "a blank line" else repr(shown)


class LogSource(Protocol):
    """A file of a log as tables."""

    @property
    def path(self) -> Path: ...

    @property
    def names(self) -> tuple[str, ...]:
        """Its column names in order."""

    def head(self, column: str, rows: int, *, clock: bool = False) -> Array:
        """The first numbers of a column, at most `rows`."""

    def first_date(self, column: str) -> str | None:
        """The date with the time, ISO 8601, in the first row of a column; None where it has no date."""

    def tables(self, columns: Sequence[str], clock: str | None = None) -> Iterator[tuple[pl.DataFrame, list[Unread]]]:
        """Its rows in order as tables of a bounded size: these columns as float64, times of day and dates in the column
        `clock` as seconds; and the rows in which something could not be read, NaN there."""

    def whole(self, numbers: Sequence[str]) -> Iterator[pl.DataFrame]:
        """Its rows in order as tables of a bounded size with every column, `numbers` as float64, the others as they
        are: of a text file the text."""

    def place(self, row: int, column: str | None = None) -> str:
        """File, data row and column as a message names them."""


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Whatever a library says of a file that cannot be read becomes one line."""
    try:
        yield
    except (OSError, EOFError, zlib.error, zstd.ZstdError, pl.exceptions.PolarsError) as error:
        said = " ".join(str(error).split())
        raise LogError(
            f"{path}: expected a readable {_ending(path)} file, found it damaged or incomplete: {said}; "
            "copy or record it again"
        ) from None


@contextmanager
def rows_of_numbers(path: Path) -> Iterator[None]:
    """Whatever polars says of the content of a file becomes one line."""
    try:
        yield
    except pl.exceptions.PolarsError as error:
        said = " ".join(str(error).split())[:200]
        raise LogError(f"{path}: expected rows of numbers, found: {said}; see `tumble inspect`") from None


def source_of(file: Path | Samples, dialect: Dialect | None = None) -> LogSource:
    """The reader of a file, or of a table in memory; with a dialect, of a text file of any name. Raises LogError for a
    format that cannot be read and an empty or damaged file."""
    return _Frame.of(file.path, file.table.lazy) if isinstance(file, Samples) else _source_of_file(file, dialect)


def _source_of_file(path: Path, dialect: Dialect | None) -> LogSource:
    ending = _ending(path)
    if ending not in ENDINGS and dialect is None:
        raise LogError(
            f"{path}: expected a file that ends in {', '.join(ENDINGS)}, found another; state log.delimiter for a text "
            "file, or let `tumble new` find out what it is"
        )
    with readable(path):
        if path.stat().st_size == 0:
            raise LogError(f"{path}: expected a log, found an empty file")
        return _open_parquet(path) if ending == ".parquet" else _open_csv(path, dialect)


def _ending(path: Path) -> str:
    """The format of a file by its name: its last suffix, and the one before for a compressed file."""
    suffixes = [suffix.lower() for suffix in path.suffixes]
    compressed = suffixes[-1:] in ([".gz"], [".zst"])
    return "".join(suffixes[-2:] if compressed else suffixes[-1:])


@dataclass(frozen=True, kw_only=True, slots=True)
class _Frame:
    """A Parquet file, or a table in memory; `scan` begins to read it."""

    path: Path
    types: Mapping[str, pl.DataType]
    rows: int
    scan: Callable[[], pl.LazyFrame]

    @classmethod
    def of(cls, path: Path, scan: Callable[[], pl.LazyFrame]) -> _Frame:
        with without_panic():
            types = dict(scan().collect_schema())
            rows = scan().select(pl.len()).collect().item()
        return cls(path=path, types=types, rows=rows, scan=scan)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.types)

    def head(self, column: str, rows: int, *, clock: bool = False) -> Array:
        scan = self._scan([column], column if clock else None)
        with readable(self.path), without_panic():
            table = scan.head(rows).collect()
        self._check_no_nulls(table, 1)
        return table[column].to_numpy()

    def first_date(self, column: str) -> str | None:
        if not isinstance(self.types[column], pl.Datetime):
            return None
        with readable(self.path), without_panic():
            first = self.scan().select(pl.col(column).first()).collect().item()
        return None if first is None else str(first.isoformat(timespec="seconds"))

    def tables(self, columns: Sequence[str], clock: str | None = None) -> Iterator[tuple[pl.DataFrame, list[Unread]]]:
        first = 1
        with readable(self.path):
            batches = iter(self._scan(columns, clock).collect_batches(chunk_size=_PARQUET_ROWS, maintain_order=True))
            while (table := _next(batches, self.rows - first + 1)) is not None:
                self._check_no_nulls(table, first)
                first += table.height
                yield table, []
        if first - 1 != self.rows:
            raise LogError(
                f"{self.path}: expected {self.rows} rows, found {first - 1} that can be read: the file is damaged; "
                "copy or record it again"
            )

    def _scan(self, columns: Sequence[str], clock: str | None) -> pl.LazyFrame:
        for column in columns:
            if column == clock and isinstance(self.types[column], pl.Datetime):
                continue
            if not self.types[column].is_numeric():
                raise LogError(
                    f"{self.path}: column '{column}': expected numbers, found the type {self.types[column]}; "
                    "write it as float64"
                )
        scan = self.scan().select(columns)
        if clock is not None and isinstance(self.types[clock], pl.Datetime):
            scan = scan.with_columns(self._since_midnight(clock))
        return scan.select(pl.col(columns).cast(pl.Float64))

    def _since_midnight(self, clock: str) -> pl.Expr:
        """Seconds of a column of dates with times, since midnight of the first."""
        with readable(self.path), without_panic():
            first = self.scan().select(pl.col(clock).dt.truncate("1d").first()).collect().item()
        return (pl.col(clock) - pl.lit(first)).dt.total_nanoseconds() * 1e-9

    def whole(self, numbers: Sequence[str]) -> Iterator[pl.DataFrame]:
        # in slices: as one scan a file would stay mapped, and count, as a whole
        for first in range(0, self.rows, _SLICE_ROWS):
            with readable(self.path), without_panic():
                table = self.scan().slice(first, _SLICE_ROWS).collect()
            with rows_of_numbers(self.path):
                yield table.with_columns(pl.col(numbers).cast(pl.Float64))

    def _check_no_nulls(self, table: pl.DataFrame, first: int) -> None:
        for column in table:
            if column.null_count():
                raise _empty_value(self.place(first + int(np.argmax(column.is_null().to_numpy())), column.name))

    def place(self, row: int, column: str | None = None) -> str:
        return f"{self.path}: row {row}" + _in_column(column)


def _next(batches: Iterator[pl.DataFrame], rows: int) -> pl.DataFrame | None:
    """The next table, or None, while so many rows are to come."""
    with without_panic():
        table = next(batches, None)
        if table is None and rows:
            time.sleep(LAST_WORDS)
        return table


def _open_parquet(path: Path) -> _Frame:
    return _Frame.of(path, partial(pl.scan_parquet, path, glob=False))


@dataclass(frozen=True, kw_only=True, slots=True)
class _Csv:
    """A text log. LogRows that cannot be read come as NaN, with what was found in them."""

    path: Path
    names: tuple[str, ...]
    dialect: Dialect
    top: int
    """Lines above the first data row."""

    def head(self, column: str, rows: int, *, clock: bool = False) -> Array:
        found: list[Array] = [np.empty(0)]
        for table, _ in self.tables([column], clock=column if clock else None):
            found.append(table[column].to_numpy())
            if sum(map(len, found)) >= rows:
                break
        return np.concatenate(found)[:rows]

    def first_date(self, column: str) -> str | None:
        return date_of(self._cell(next(self.pieces(), b""), column))

    def tables(self, columns: Sequence[str], clock: str | None = None) -> Iterator[tuple[pl.DataFrame, list[Unread]]]:
        first, text = 1, _Text(self, columns, clock)
        for piece in self.pieces():
            if clock is not None and text.day is None:
                text.day = day_of(self._cell(piece, clock))
            table, unread = text.table(piece, first)
            first += table.height
            yield table, unread

    def whole(self, numbers: Sequence[str]) -> Iterator[pl.DataFrame]:
        with readable(self.path), rows_of_numbers(self.path):
            for table in text_tables(self, numbers):
                yield table.with_columns(pl.col(numbers).cast(pl.Float64))

    def pieces(self) -> Iterator[bytes]:
        """The rows in pieces of whole lines that are parsed alike whatever the dialect."""
        with readable(self.path), opened(self.path, self.dialect.encoding) as stream:
            for _ in range(self.top):
                stream.readline(LINE_BYTES)
            for piece in whole_lines(stream, self.path):
                piece = piece.removeprefix(codecs.BOM_UTF8) if self.top == 0 else piece
                yield _with_tabs(piece) if self.dialect.delimiter == BLANKS else piece

    @property
    def separator(self) -> str:
        """What stands between the values of `pieces`."""
        return "\t" if self.dialect.delimiter == BLANKS else self.dialect.delimiter

    def _cell(self, piece: bytes, column: str) -> str:
        cells = self.cells(piece[: piece.find(b"\n")].decode("utf-8", errors="replace"))
        at = self.names.index(column)
        return cells[at] if at < len(cells) else ""

    def cells(self, line: str) -> list[str]:
        """The values in a line of a piece."""
        return next(csv.reader([line], delimiter=self.separator), [])

    def place(self, row: int, column: str | None = None) -> str:
        return f"{self.path}: row {row} (line {row + self.top})" + _in_column(column)


@dataclass(kw_only=False, slots=True)
class _Text:
    """The numbers of some columns in pieces of a text log. `day`: the day from which a clock counts."""

    source: _Csv
    columns: Sequence[str]
    clock: str | None
    day: int | None = None

    def table(self, piece: bytes, first: int) -> tuple[pl.DataFrame, list[Unread]]:
        """The rows of a piece that begins with data row `first`. Where there is something to be said about them, it is
        halved until few lines are left, which Python reads."""
        fast = self._at_once(piece)
        if fast is not None:
            return fast, []
        middle = piece.find(b"\n", len(piece) // 2) + 1
        if len(piece) <= _SLOW_BYTES or not 0 < middle < len(piece):
            return self._line_by_line(piece, first)
        above, said = self.table(piece[:middle], first)
        below, more = self.table(piece[middle:], first + above.height)
        return pl.concat([above, below]), said + more

    def _at_once(self, piece: bytes) -> pl.DataFrame | None:
        """The rows of a piece as polars reads them; None where it refuses, or leaves a value empty."""
        names = self.source.names
        kinds = {name: pl.String if name == self.clock else pl.Float64 for name in self.columns}
        schema = {(n if n in kinds else f"\0{j}"): kinds.get(n, pl.String) for j, n in enumerate(names)}
        comma = self.source.dialect.decimal == ","
        try:
            table = pl.read_csv(
                piece, has_header=False, schema=schema, separator=self.source.separator, decimal_comma=comma
            )
        except pl.exceptions.PolarsError:
            return None
        if table.height != _lines_in(piece):
            return None
        if names[-1] not in kinds and self._may_be_short(table, piece):
            return None
        used = table.select(pl.col(self.columns))
        if self.clock is not None:
            used = used.with_columns(seconds_of(used[self.clock], self.day or 0).alias(self.clock))
        return None if any(column.null_count() for column in used) else used

    def _may_be_short(self, table: pl.DataFrame, piece: bytes) -> bool:
        """Whether there may be rows with too few values, which polars fills up with nulls from the end."""
        if not table.to_series(-1).null_count():
            return False
        return piece.count(self.source.separator.encode()) != table.height * (len(self.source.names) - 1)

    def _line_by_line(self, piece: bytes, first: int) -> tuple[pl.DataFrame, list[Unread]]:
        """What `table` gives, by Python's csv and float(), which can say what is wrong in which row."""
        ended = piece.endswith(b"\n")
        lines = piece.decode("utf-8", errors="replace").removesuffix("\n").split("\n")
        numbers = np.full((len(lines), len(self.columns)), np.nan)
        unread: list[Unread] = []
        for i, line in enumerate(lines):
            last = i == len(lines) - 1 and not ended
            found = self._numbers(line.removesuffix("\r"), numbers[i])
            if found is not None:
                cut = last and found.kind != Kind.NO_ROW
                unread.append(replace(found, row=first + i, kind=Kind.CUT if cut else found.kind))
        return pl.DataFrame(numbers, schema=list(self.columns), orient="row"), unread

    def _numbers(self, line: str, out: Array) -> Unread | None:
        """Put the numbers of a line into `out`, NaN where one cannot be read; what was found instead of the first."""
        if not line.strip() or self.source.dialect.is_comment(line):
            return Unread(row=0, column=None, found="a blank line" if not line.strip() else line, kind=Kind.NO_ROW)
        try:
            values = self.source.cells(line)
        except csv.Error as error:
            return Unread(row=0, column=None, found=str(error), kind=Kind.ROW)
        if len(values) != len(self.source.names):
            number = self.source.dialect.is_number
            text = not any(number(v.strip()) for v in values)
            found = line.strip() if text else f"{len(values)} values"
            return Unread(row=0, column=None, found=found, kind=Kind.TEXT if text else Kind.ROW)
        fault: Unread | None = None
        for j, column in enumerate(self.columns):
            text_of = values[self.source.names.index(column)]
            try:
                out[j] = self._number(column, text_of)
            except ValueError:
                fault = fault or Unread(row=0, column=column, found=text_of, kind=Kind.VALUE)
        return fault

    def _number(self, column: str, text: str) -> float:
        if column == self.clock:
            seconds = seconds_of(pl.Series([text], dtype=pl.String), self.day or 0)[0]
            if seconds is None:
                raise ValueError(text)
            return float(seconds)
        return float(text.replace(",", ".") if self.source.dialect.decimal == "," else text)


def _lines_in(piece: bytes) -> int:
    """How many lines a piece has; numpy counts four times as fast as `bytes.count`."""
    ends = np.frombuffer(piece, dtype=np.uint8) == ord("\n")
    return int(np.count_nonzero(ends)) + (not piece.endswith(b"\n"))


def _with_tabs(piece: bytes) -> bytes:
    """Rows of values between blanks as rows of values between single tabs."""
    blank = piece.replace(b"\t", b" ").replace(b"\r\n", b"\n")
    return re.sub(rb" *\n *", b"\n", re.sub(rb"(?<=[^ \n]) +(?=[^ \n])", b"\t", blank)).strip(b" ")


def _open_csv(path: Path, dialect: Dialect | None) -> _Csv:
    """A text log: with its names in the first line, unless a dialect is stated."""
    if dialect is None:
        with opened(path) as stream:
            return _Csv(path=path, names=header(stream, path), dialect=Dialect(), top=1)
    with opened(path, dialect.encoding) as stream:
        top = top_of(head_lines(stream), dialect)
    if top is None:
        raise LogError(f"{path}: expected rows of numbers with log.delimiter {dialect.delimiter!r}, found none")
    return _Csv(path=path, names=top.names, dialect=dialect, top=top.lines)


def opened(path: Path, encoding: str = "utf-8") -> io.BufferedIOBase:
    """A file to read from as UTF-8, decompressed by its ending."""
    packed = path.suffix.lower() in (".gz", ".zst")
    stream = unpacked(path) if packed else path.open("rb")
    return stream if encoding == "utf-8" else Recoded(stream, encoding)


def header(stream: io.BufferedIOBase, path: Path) -> tuple[str, ...]:
    """The column names in the first line of a CSV file."""
    line = stream.readline(LINE_BYTES).decode("utf-8-sig", errors="replace")
    try:
        return tuple(name.strip() for name in next(csv.reader([line.rstrip("\r\n")]), []))
    except csv.Error as error:
        raise LogError(f"{path}: expected the names of the columns in the first line, found: {error}") from None


def whole_lines(stream: io.BufferedIOBase, path: Path) -> Iterator[bytes]:
    """The rest of a stream in pieces of whole lines, the first one small; blank lines at its end are left out."""
    rest = b""
    size = _FIRST_PIECE_BYTES
    while read := stream.read(size):
        text = rest + read
        end = text.rstrip().rfind(b"\n") + 1  # the line after it may go on, or be the last before blank ones
        if end:
            yield text[:end]
        rest = text[end:]
        if len(rest) > LINE_BYTES:
            raise LogError(f"{path}: expected lines of numbers, found one of more than {LINE_BYTES} bytes")
        size = _PIECE_BYTES
    if rest.strip():
        empty, line_end, _ = rest[len(rest.rstrip()) :].partition(b"\n")  # tabs are empty values
        yield rest.rstrip() + empty.rstrip(b"\r") + line_end


ENDINGS = (".csv", ".csv.gz", ".csv.zst", ".parquet")
"""Endings of the files that are read without being told how they are written."""


def _empty_value(place: str) -> LogError:
    return LogError(
        f"{place}: expected a number, found an empty value; correct or remove the row, or write nan for a lost sample"
    )


def unread_error(source: LogSource, unread: Unread) -> LogError:
    """What is said of a row that cannot be read where it cannot be left out either."""
    width, shown = len(source.names), unread.found[:_SHOWN]
    expected, found = "a number", repr(shown) if shown.strip() else "an empty value"
    if unread.column is None:
        expected, found = f"{width} values, one per column", unread.what
    return LogError(
        f"{source.place(unread.row, unread.column)}: expected {expected}, found {found}; correct or remove the row"
    )


def _in_column(column: str | None) -> str:
    return "" if column is None else f", column '{column}'"


# -------------------- every column of a text log --------------------


def text_tables(source: LogSource, numbers: Sequence[str]) -> Iterator[pl.DataFrame]:
    """The rows of a text log with all columns, these as numbers and the others as the text they are. Of a log of a
    stated dialect, what cannot be read is NaN, and lines that are no rows are left out; else polars' errors are
    raised."""
    assert isinstance(source, _Csv)
    schema = {name: pl.Float64 if name in numbers else pl.String for name in _distinct(source.names)}
    comma = source.dialect.decimal == ","
    for piece in source.pieces():
        try:
            yield pl.read_csv(piece, has_header=False, schema=schema, separator=source.separator, decimal_comma=comma)
        except pl.exceptions.PolarsError:
            if source.dialect == Dialect():
                raise
            yield _text_table(source, piece, schema)


def _text_table(source: _Csv, piece: bytes, schema: Mapping[str, type[pl.DataType]]) -> pl.DataFrame:
    rows = []
    for line in piece.decode("utf-8", errors="replace").splitlines():
        try:
            cells = source.cells(line)
        except csv.Error:
            continue
        if len(cells) == len(schema) and not source.dialect.is_comment(line):
            rows.append(cells)
    text = pl.DataFrame(rows, schema=dict.fromkeys(schema, pl.String), orient="row")
    point = pl.col([name for name, kind in schema.items() if kind == pl.Float64]).str.strip_chars()
    point = point.str.replace(",", ".") if source.dialect.decimal == "," else point
    return text.with_columns(point.cast(pl.Float64, strict=False).fill_null(float("nan")))


def _distinct(names: Sequence[str]) -> list[str]:
    """Names of all columns; those without one, or with that of another, get a number."""
    seen: set[str] = set()
    out = []
    for j, name in enumerate(names):
        out.append(f"column {j + 1}" if not name or name in seen else name)
        seen.add(name)
    return out


def times_of(column: pl.Series, spec: LogSpec) -> Array:
    """The times (s) of a log's time column, as it is in a table with all columns."""
    if spec.clock and column.dtype == pl.String:
        return seconds_of(column, 0).to_numpy()
    if isinstance(column.dtype, pl.Datetime):
        since = (column - column.dt.truncate("1d")[0]).dt.total_nanoseconds()
        return np.asarray(since.to_numpy() * 1e-9)
    comma = spec.dialect is not None and spec.dialect.decimal == "," and column.dtype == pl.String
    numbers = (column.str.replace(",", ".") if comma else column).cast(pl.Float64)
    return np.asarray(numbers.to_numpy() * spec.time_factor)
