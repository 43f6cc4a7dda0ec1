"""A Parquet file of a log, or a table in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl

from tumble.errors import LogError
from tumble.recording.log_source import (
    Unread,
    empty_value,
    in_column,
    readable,
    rows_of_numbers,
)
from tumble.recording.panic import wait_for_last_words, without_panic
from tumble.units import Array

_PARQUET_ROWS = 1 << 15


@dataclass(frozen=True, kw_only=True, slots=True)
class TableLog:
    """A Parquet file, or a table in memory; `scan` begins to read it."""

    path: Path
    types: Mapping[str, pl.DataType]
    rows: int
    scan: Callable[[], pl.LazyFrame]

    @classmethod
    def of(cls, path: Path, scan: Callable[[], pl.LazyFrame]) -> TableLog:
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
        for table in self._batches(self._scan(columns, clock)):
            self._check_no_nulls(table, first)
            first += table.height
            yield table, []

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
        for table in self._batches(self.scan()):
            with rows_of_numbers(self.path):
                yield table.with_columns(pl.col(numbers).cast(pl.Float64))

    def _batches(self, scan: pl.LazyFrame) -> Iterator[pl.DataFrame]:
        """All rows of a scan in order, some at a time."""
        rows = 0
        with readable(self.path):
            batches = iter(scan.collect_batches(chunk_size=_PARQUET_ROWS, maintain_order=True))
            while (table := _next(batches, self.rows - rows)) is not None:
                rows += table.height
                yield table
        if rows != self.rows:
            raise LogError(
                f"{self.path}: expected {self.rows} rows, found {rows} that can be read: the file is damaged; "
                "copy or record it again"
            )

    def _check_no_nulls(self, table: pl.DataFrame, first: int) -> None:
        for column in table:
            if column.null_count():
                raise empty_value(self.place(first + int(np.argmax(column.is_null().to_numpy())), column.name))

    def place(self, row: int, column: str | None = None) -> str:
        return f"{self.path}: row {row}" + in_column(column)


def _next(batches: Iterator[pl.DataFrame], rows: int) -> pl.DataFrame | None:
    """The next table, or None, while so many rows are to come."""
    with without_panic():
        table = next(batches, None)
        if table is None and rows:
            wait_for_last_words()
        return table


def parquet_log(path: Path) -> TableLog:
    return TableLog.of(path, partial(pl.scan_parquet, path, glob=False))
