"""The files of a log: one reader per format, each giving tables of a bounded size; a table in memory is read as one.

A CSV file, compressed or not, is cut into pieces of whole lines for polars to parse. Where polars refuses a piece, or
leaves a value empty, Python reads the piece line by line and says where and why, or reads what only `float()` accepts
(blanks after a number).
"""

from __future__ import annotations

import csv
import gzip
import io
import sys
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np
import polars as pl

from tumble.errors import LogError
from tumble.recording.samples import Samples
from tumble.units import Array

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd


_FIRST_PIECE_BYTES = 1 << 18
_PIECE_BYTES = 1 << 24
LINE_BYTES = 1 << 20
_PARQUET_ROWS = 1 << 15
_SLICE_ROWS = 1 << 17


class LogSource(Protocol):
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

    def whole(self, numbers: Sequence[str]) -> Iterator[pl.DataFrame]:
        """Its rows in order as tables of a bounded size with every column, `numbers` as float64 where they are
        numbers, the others as they are: of a text file the text."""

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


def source_of(file: Path | Samples) -> LogSource:
    """The reader of a file. Raises LogError for a format that cannot be read and an empty or damaged file."""
    return _Frame.of(file.path, file.table.lazy) if isinstance(file, Samples) else _source_of_file(file)


def _source_of_file(path: Path) -> LogSource:
    ending = _ending(path)
    if ending not in _READERS:
        raise LogError(f"{path}: expected a file that ends in {', '.join(_READERS)}, found another; convert it")
    with readable(path):
        if path.stat().st_size == 0:
            raise LogError(f"{path}: expected a log, found an empty file")
        return _READERS[ending](path)


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
        types = dict(scan().collect_schema())
        return cls(path=path, types=types, rows=scan().select(pl.len()).collect().item(), scan=scan)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.types)

    def head(self, column: str, rows: int) -> Array:
        with readable(self.path):
            table = self._scan([column]).head(rows).collect()
        self._check_no_nulls(table, 1)
        return table[column].to_numpy()

    def tables(self, columns: Sequence[str]) -> Iterator[pl.DataFrame]:
        first = 1
        with readable(self.path):
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
        return self.scan().select(pl.col(columns).cast(pl.Float64))

    def whole(self, numbers: Sequence[str]) -> Iterator[pl.DataFrame]:
        # in slices: as one scan a file would stay mapped, and count, as a whole
        for first in range(0, self.rows, _SLICE_ROWS):
            with readable(self.path):
                table = self.scan().slice(first, _SLICE_ROWS).collect()
            yield _with_numbers(table, numbers, self.path)

    def _check_no_nulls(self, table: pl.DataFrame, first: int) -> None:
        for column in table:
            if column.null_count():
                raise _empty_value(self.place(first + int(np.argmax(column.is_null().to_numpy())), column.name))

    def place(self, row: int, column: str | None = None) -> str:
        return f"{self.path}: row {row}" + _in_column(column)


def _open_parquet(path: Path) -> _Frame:
    return _Frame.of(path, partial(pl.scan_parquet, path, glob=False))


@dataclass(frozen=True, kw_only=True, slots=True)
class _Csv:
    path: Path
    names: tuple[str, ...]

    def head(self, column: str, rows: int) -> Array:
        found: list[Array] = [np.empty(0)]
        for table in self.tables([column]):
            found.append(table[column].to_numpy())
            if sum(map(len, found)) >= rows:
                break
        return np.concatenate(found)[:rows]

    def tables(self, columns: Sequence[str]) -> Iterator[pl.DataFrame]:
        first = 1
        with readable(self.path), opened(self.path) as stream:
            stream.readline(LINE_BYTES)
            for piece in whole_lines(stream, self.path):
                table = self._table(piece, first, columns)
                first += table.height
                yield table

    def whole(self, numbers: Sequence[str]) -> Iterator[pl.DataFrame]:
        schema = dict.fromkeys(self.names, pl.String)
        with readable(self.path), opened(self.path) as stream:
            stream.readline(LINE_BYTES)
            for piece in whole_lines(stream, self.path):
                with rows_of_numbers(self.path):
                    table = pl.read_csv(piece, has_header=False, schema=schema | dict.fromkeys(numbers, pl.Float64))
                yield _with_numbers(table, numbers, self.path)

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


@contextmanager
def rows_of_numbers(path: Path) -> Iterator[None]:
    """Whatever polars says of the content of a file becomes one line."""
    try:
        yield
    except pl.exceptions.PolarsError as error:
        said = " ".join(str(error).split())[:200]
        raise LogError(f"{path}: expected rows of numbers, found: {said}; see `tumble inspect`") from None


def _with_numbers(table: pl.DataFrame, numbers: Sequence[str], path: Path) -> pl.DataFrame:
    """A table with these columns as float64."""
    with rows_of_numbers(path):
        return table.with_columns(pl.col(numbers).cast(pl.Float64))


def _open_csv(path: Path) -> _Csv:
    with opened(path) as stream:
        names = header(stream)
    return _Csv(path=path, names=names)


def opened(path: Path) -> io.BufferedIOBase:
    """A file to read from, decompressed by its ending."""
    ending = path.suffix.lower()
    if ending == ".gz":
        return gzip.GzipFile(path)
    return zstd.ZstdFile(path) if ending == ".zst" else path.open("rb")


def header(stream: io.BufferedIOBase) -> tuple[str, ...]:
    """The column names in the first line of a CSV file."""
    line = stream.readline(LINE_BYTES).decode("utf-8-sig", errors="replace")
    return tuple(name.strip() for name in next(csv.reader([line]), []))


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
        yield rest.rstrip()


_READERS: Mapping[str, Callable[[Path], LogSource]] = {
    ".csv": _open_csv,
    ".csv.gz": _open_csv,
    ".csv.zst": _open_csv,
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
    return source_of(path).names


def log_head(path: Path, column: str, rows: int) -> Array:
    """The first numbers of a column of a log, at most `rows`."""
    return source_of(path).head(column, rows)
