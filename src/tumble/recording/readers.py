"""The files of a log: one reader per format, each giving tables of a bounded size; a table in memory is read as one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import polars as pl

from tumble.documents import check_regular
from tumble.errors import LogError, TumbleError
from tumble.recording.log_source import LogSource, Unread, ending_of, first_numbers, readable
from tumble.recording.samples import Samples
from tumble.recording.table_log import TableLog, parquet_log
from tumble.recording.text.dialect import Dialect
from tumble.recording.text.text_log import text_log
from tumble.units import Array

ENDINGS = (".csv", ".csv.gz", ".csv.zst", ".parquet")
"""Endings of the files that are read without being told how they are written."""


_KEPT_ROWS = 4_000_000


@dataclass(frozen=True, kw_only=False, slots=True, eq=False)
class KeptLog:
    """A file of a log that is looked at several times, and read once: the tables of the columns that were asked for are
    kept as far as they were read, of long files the first."""

    source: LogSource
    _kept: dict[tuple[tuple[str, ...], str | None], _Kept] = field(default_factory=dict)

    @property
    def path(self) -> Path:
        return self.source.path

    @property
    def names(self) -> tuple[str, ...]:
        return self.source.names

    def head(self, column: str, rows: int, *, clock: bool = False) -> Array:
        return first_numbers(self, column, rows, clock=clock)

    def first_date(self, column: str) -> str | None:
        return self.source.first_date(column)

    def tables(self, columns: Sequence[str], clock: str | None = None) -> Iterator[tuple[pl.DataFrame, list[Unread]]]:
        """Those of the columns, or of more columns that were read already."""
        wanted = set(columns)
        key = tuple(columns), clock
        for read in self._kept:
            if wanted <= set(read[0]) and (read[1] == clock or read[1] not in wanted):
                key = read
        kept = self._kept.setdefault(key, _Kept())
        if kept.coming is None:
            kept.coming = self.source.tables(*key)
        place, rows = 0, 0
        try:
            while True:
                if place < len(kept.tables):
                    table, unread = kept.tables[place]
                    place += 1
                elif (coming := next(kept.coming, None)) is None:
                    return
                else:
                    table, unread = coming
                    if rows < _KEPT_ROWS:
                        kept.tables.append(coming)
                        place += 1
                    else:  # it goes on, and who comes next reads anew
                        self._kept.pop(key, None)
                rows += table.height
                yield table.select(columns), [u for u in unread if u.column is None or u.column in wanted]
        except TumbleError:
            self._kept.pop(key, None)
            raise

    def whole(self, numbers: Sequence[str]) -> Iterator[pl.DataFrame]:
        return self.source.whole(numbers)

    def place(self, row: int, column: str | None = None) -> str:
        return self.source.place(row, column)


@dataclass(kw_only=True, slots=True, eq=False)
class _Kept:
    """Tables that were read, and those that are coming."""

    tables: list[tuple[pl.DataFrame, list[Unread]]] = field(default_factory=list)
    coming: Iterator[tuple[pl.DataFrame, list[Unread]]] | None = None


def source_of(file: Path | Samples | KeptLog, dialect: Dialect | None = None) -> LogSource:
    """The reader of a file, of a table in memory, or of what was kept of a file; with a dialect, of a text file of any
    name. Raises LogError for a format that cannot be read and an empty or damaged file."""
    if isinstance(file, KeptLog):
        return file
    return TableLog.of(file.path, file.table.lazy) if isinstance(file, Samples) else _source_of_file(file, dialect)


def _source_of_file(path: Path, dialect: Dialect | None) -> LogSource:
    ending = ending_of(path)
    if ending not in ENDINGS and dialect is None:
        raise LogError(
            f"{path}: expected a file that ends in {', '.join(ENDINGS)}, found another; state log.delimiter for a text "
            "file, or let `tumble new` find out what it is"
        )
    check_regular(path)
    with readable(path):
        if path.stat().st_size == 0:
            raise LogError(f"{path}: expected a log, found an empty file")
        return parquet_log(path) if ending == ".parquet" else text_log(path, dialect)
