"""Readers of Parquet files, text files and tables in memory as tables of bounded size, and a writer of such tables."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from polars.io.plugins import register_io_source

from tumble.documents import check_regular
from tumble.errors import InputError, LogError
from tumble.files import ending_in, whole_file
from tumble.recording.log_source import LogSource, Tables, ending_of, readable, rows_of_numbers
from tumble.recording.panic import PANIC_SECONDS, without_panic
from tumble.recording.text.dialect import Dialect
from tumble.recording.text.pieces import check_unpacked
from tumble.recording.text.text_log import text_log

ENDINGS = (".csv", ".csv.gz", ".csv.zst", ".parquet")
"""Endings of files that are read without a dialect."""

Data = Any
"""A mapping from column names to arrays (N,), a polars or a pandas frame; a sequence of them for several files. Pandas
is not a dependency, so its frames cannot be named in a type."""

_PARQUET_ROWS = 1 << 15
_NUMBER_BYTES = 8


def source_of(file: Path | LogSource, dialect: Dialect | None = None) -> LogSource:
    """Return the reader of a file, or a table in memory unchanged; with a dialect, any file is read as text.

    Raises LogError for a format that cannot be read, and for an empty or damaged file."""
    if not isinstance(file, Path):
        return file
    ending = ending_of(file)
    if ending not in ENDINGS and dialect is None:
        raise LogError(
            f"{file}: expected a file that ends in {', '.join(ENDINGS)}, found another; state log.delimiter for a text "
            "file, or let `tumble new` find out what it is"
        )
    check_regular(file)
    with readable(file):
        if file.stat().st_size == 0:
            raise LogError(f"{file}: expected a log, found an empty file")
        if ending == ".parquet":
            table = TableLog.of(file, partial(pl.scan_parquet, file, glob=False))
            check_unpacked(file, table.rows * len(table.types) * _NUMBER_BYTES)
            return table
        return text_log(file, dialect)


# -------------------- Parquet files and tables in memory --------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TableLog(LogSource):
    """A Parquet file, or a table `in_memory` with its name in messages as path; `scan` begins to read it."""

    types: Mapping[str, pl.DataType]
    rows: int
    scan: Callable[[], pl.LazyFrame]
    in_memory: bool

    @classmethod
    def of(cls, path: Path, scan: Callable[[], pl.LazyFrame], *, in_memory: bool = False) -> TableLog:
        """Return the reader of a scan."""
        with without_panic():
            types = dict(scan().collect_schema())
            rows = scan().select(pl.len()).collect().item()
        return cls(path=path, names=tuple(types), types=types, rows=rows, scan=scan, in_memory=in_memory)

    def first_date(self, column: str) -> str | None:
        if not isinstance(self.types[column], pl.Datetime):
            return None
        first = self._collected(self.scan().select(pl.col(column).first())).item()
        return None if first is None else str(first.isoformat(timespec="seconds"))

    def read(self, columns: Sequence[str], clock: str | None) -> Tables:
        scan = self.scan().select(columns)
        for column in columns:
            kind = self.types[column]
            if column == clock and isinstance(kind, pl.Datetime):  # seconds since midnight of the first
                day = self._collected(self.scan().select(pl.col(clock).dt.truncate("1d").first())).item()
                scan = scan.with_columns((pl.col(clock) - pl.lit(day)).dt.total_nanoseconds() * 1e-9)
            elif not kind.is_numeric():
                raise LogError(
                    f"{self.path}: column '{column}': expected numbers, found the type {kind}; write it as float64"
                )
        for table in self._batches(scan.select(pl.col(columns).cast(pl.Float64).fill_null(math.nan))):
            yield table, []

    def whole(self, numbers: Sequence[str]) -> Iterator[pl.DataFrame]:
        for table in self._batches(self.scan()):
            with rows_of_numbers(self.path):
                yield table.with_columns(pl.col(numbers).cast(pl.Float64))

    def content(self, columns: Sequence[str]) -> Iterator[bytes]:
        """Yield names and numbers of columns, for a hash."""
        for column in self._collected(self.scan().select(columns)):
            yield column.name.encode()
            yield np.ascontiguousarray(column.to_numpy(), dtype=np.float64).tobytes()

    def _collected(self, scan: pl.LazyFrame) -> pl.DataFrame:
        with readable(self.path), without_panic():
            return scan.collect()

    def _batches(self, scan: pl.LazyFrame) -> Iterator[pl.DataFrame]:
        """Yield all rows of a scan in order, in batches."""
        rows, batches = 0, None
        with readable(self.path):
            while True:
                with without_panic():
                    batches = batches or iter(scan.collect_batches(chunk_size=_PARQUET_ROWS, maintain_order=True))
                    table = next(batches, None)
                    if table is None and rows < self.rows:
                        time.sleep(PANIC_SECONDS)
                if table is None:
                    break
                rows += table.height
                yield table
        if rows != self.rows:
            raise LogError(
                f"{self.path}: expected {self.rows} rows, found {rows} that can be read: the file is damaged; "
                "copy or record it again"
            )


def samples_of(data: Data) -> tuple[TableLog, ...]:
    """Return the tables of a log in memory. Raises LogError for anything else."""
    several = isinstance(data, list | tuple)
    named = {f"samples {i}": part for i, part in enumerate(data, 1)} if several else {"samples": data}
    return tuple(TableLog.of(Path(name), _table(part).lazy, in_memory=True) for name, part in named.items())


def _table(data: Data) -> pl.DataFrame:
    if isinstance(data, pl.DataFrame):
        return data
    if not isinstance(data, Mapping) and not (hasattr(data, "columns") and hasattr(data, "__getitem__")):
        raise LogError(
            "samples: expected columns by name, as arrays, or a polars or pandas frame, found "
            f"{type(data).__name__}; name the columns as the description does"
        )
    arrays = {str(name): np.asarray(data[name]) for name in (data if isinstance(data, Mapping) else data.columns)}
    for name, array in arrays.items():
        if array.ndim != 1:
            raise LogError(
                f"samples: column '{name}': expected an array of one dimension, found the shape {array.shape}; give "
                "every sensor a column of its own"
            )
    if len(set(map(len, arrays.values()))) > 1:
        found = ", ".join(f"{len(array)} in '{name}'" for name, array in arrays.items())
        raise LogError(f"samples: expected as many numbers in every column, found {found}")
    numbers = {name: array if array.dtype.kind in "biuf" else array.tolist() for name, array in arrays.items()}
    return pl.DataFrame(numbers, strict=False)


# -------------------- tables written --------------------

FORMATS = (".csv", ".parquet")


def write_tables(path: Path, tables: Iterator[pl.DataFrame], *, header: bool = True) -> None:
    """Write tables of the same columns to one file, with their names in the first line of a CSV file if `header`.

    Memory does not grow with the number of tables; after an error the former file is unchanged. Raises InputError for a
    name that does not end in .csv or .parquet, and for columns that CSV cannot hold."""
    ending = ending_in(path, *FORMATS)
    failed: list[BaseException] = []
    first = next(tables)
    unwritten = [name for name, kind in first.schema.items() if kind.is_nested() or kind in (pl.Binary, pl.Object)]
    if ending == ".csv" and unwritten:
        raise InputError(
            f"{path}: expected columns of one value a row, which CSV has, found {unwritten[0]!r} of the type "
            f"{first.schema[unwritten[0]]}; write a .parquet file"
        )

    def source(*_: object) -> Iterator[pl.DataFrame]:
        try:
            yield from chain([first], tables)  # polars may drop the source in any thread; a chain needs no closing
        except (Exception, KeyboardInterrupt, SystemExit) as error:  # polars would replace or drop it
            failed.append(error)
            raise

    stream = register_io_source(source, schema=first.schema, validate_schema=True)
    with whole_file(path) as temporary, temporary.open("wb") as file:  # given a path, a late thread may recreate it
        try:
            if ending == ".csv":
                stream.sink_csv(file, include_header=header, maintain_order=True)
            else:
                stream.sink_parquet(file, maintain_order=True)
        except Exception as error:
            raise (*failed, error)[0] from None
