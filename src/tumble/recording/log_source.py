"""A file of a log as tables: what every reader gives, and messages about what cannot be read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from itertools import tee
from pathlib import Path
from typing import TypeVar

import numpy as np
import polars as pl

from tumble.errors import LogError, TumbleError
from tumble.units import Array

BLANK_LINE = "a blank line"
_SHOWN = 40
_KEPT_ROWS = 4_000_000
_Part = TypeVar("_Part")


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
            return f"{repr(shown) if shown.strip() else 'an empty value'} in '{self.column[:_SHOWN]}'"
        return shown if self.kind is Kind.ROW or shown == BLANK_LINE else repr(shown)


Tables = Iterator[tuple[pl.DataFrame, list[Unread]]]
"""Tables of the rows of a file in order, with what could not be read in each."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LogSource:
    """A file of a log, read as tables of a bounded size, with the names of its columns in order.

    Of a file that is looked at several times, `kept` has the tables by the columns that were asked for, as far as they
    were read: it is read once, unless it is long. None for a file that is read anew each time."""

    path: Path
    names: tuple[str, ...]
    kept: dict[tuple[tuple[str, ...], str | None], Tables] | None = None

    def first_date(self, column: str) -> str | None:
        """Date with the time, ISO 8601, in the first row of a column; None if it has no date."""
        del column
        return None

    def tables(self, columns: Sequence[str], clock: str | None = None) -> Tables:
        """Rows of some columns as float64, times of day and dates in the column `clock` as seconds; NaN where something
        could not be read."""
        if self.kept is None:
            yield from self.read(columns, clock)
            return
        wanted, key = set(columns), (tuple(columns), clock)
        for read in self.kept:  # of these columns or of more
            if wanted <= set(read[0]) and (read[1] == clock or read[1] not in wanted):
                key = read
        self.kept[key], tables = tee(self.kept.get(key) or self.read(*key))
        rows = 0
        try:
            for table, unread in tables:
                rows += table.height
                if rows > _KEPT_ROWS:  # it goes on, and who comes next reads anew
                    self.kept.pop(key, None)
                yield table.select(columns), [u for u in unread if u.column is None or u.column in wanted]
        except TumbleError:
            self.kept.pop(key, None)
            raise

    def read(self, columns: Sequence[str], clock: str | None) -> Tables:
        """`tables`, read anew."""
        raise NotImplementedError

    def whole(self, numbers: Sequence[str]) -> Iterator[pl.DataFrame]:
        """Rows of all columns, `numbers` as float64, the others as they are: text of a text file."""
        raise NotImplementedError

    def place(self, row: int, column: str | None = None) -> str:
        """File, data row and column as a message names them."""
        return f"{self.path}: row {row}" + in_column(column)


def first_numbers(source: LogSource, column: str, rows: int, *, clock: bool) -> Array:
    """The first numbers of a column, at most `rows`, from the tables of a source."""
    parts: list[Array] = [np.empty(0)]
    for table, _ in source.tables([column], column if clock else None):
        parts.append(table[column].to_numpy())
        if sum(map(len, parts)) >= rows:
            break
    return np.concatenate(parts)[:rows]


def one_ahead(parts: Iterator[_Part]) -> Iterator[_Part]:
    """The same parts; the next one is read while this one is worked on."""
    with ThreadPoolExecutor(max_workers=1) as beside:
        ahead = beside.submit(next, parts, None)
        while (part := ahead.result()) is not None:
            ahead = beside.submit(next, parts, None)
            yield part


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Whatever a library says of a file that cannot be read becomes one line."""
    try:
        yield
    except (OSError, EOFError, pl.exceptions.PolarsError) as error:
        words = " ".join(str(error).split())
        raise LogError(
            f"{path}: expected a readable {ending_of(path)} file, found it damaged or incomplete: {words}; "
            "copy or record it again"
        ) from None


@contextmanager
def rows_of_numbers(path: Path) -> Iterator[None]:
    """Whatever polars says of the content of a file becomes one line."""
    try:
        yield
    except pl.exceptions.PolarsError as error:
        words = " ".join(str(error).split())[:200]
        raise LogError(f"{path}: expected rows of numbers, found: {words}; see `tumble inspect`") from None


def ending_of(path: Path) -> str:
    """The format of a file by its name: its last suffix, and the one before for a compressed file."""
    suffixes = [suffix.lower() for suffix in path.suffixes]
    compressed = suffixes[-1:] in ([".gz"], [".zst"])
    return "".join(suffixes[-2:] if compressed else suffixes[-1:])


def unread_error(source: LogSource, unread: Unread) -> LogError:
    """Error for a row that can neither be read nor left out."""
    width, shown = len(source.names), unread.found[:_SHOWN]
    expected, found = "a number", repr(shown) if shown.strip() else "an empty value"
    if unread.column is None:
        expected, found = f"{width} values, one per column", unread.what
    return LogError(
        f"{source.place(unread.row, unread.column)}: expected {expected}, found {found}; correct or remove the row"
    )


def in_column(column: str | None) -> str:
    return "" if column is None else f", column '{column}'"
