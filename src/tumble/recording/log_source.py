"""A file of a log as tables: what every reader gives, and what is said of what cannot be read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np
import polars as pl

from tumble.errors import LogError
from tumble.units import Array

BLANK_LINE = "a blank line"
_SHOWN = 40
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


class LogSource(Protocol):
    """A file of a log as tables."""

    @property
    def path(self) -> Path: ...

    @property
    def names(self) -> tuple[str, ...]:
        """Its column names in order."""

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
        said = " ".join(str(error).split())
        raise LogError(
            f"{path}: expected a readable {ending_of(path)} file, found it damaged or incomplete: {said}; "
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


def ending_of(path: Path) -> str:
    """The format of a file by its name: its last suffix, and the one before for a compressed file."""
    suffixes = [suffix.lower() for suffix in path.suffixes]
    compressed = suffixes[-1:] in ([".gz"], [".zst"])
    return "".join(suffixes[-2:] if compressed else suffixes[-1:])


def unread_error(source: LogSource, unread: Unread) -> LogError:
    """What is said of a row that cannot be read where it cannot be left out either."""
    width, shown = len(source.names), unread.found[:_SHOWN]
    expected, found = "a number", repr(shown) if shown.strip() else "an empty value"
    if unread.column is None:
        expected, found = f"{width} values, one per column", unread.what
    return LogError(
        f"{source.place(unread.row, unread.column)}: expected {expected}, found {found}; correct or remove the row"
    )


def in_column(column: str | None) -> str:
    return "" if column is None else f", column '{column}'"
