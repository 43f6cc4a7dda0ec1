"""A file of a log as a stream of tables, the common form of all readers, and errors about unreadable parts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from dataclasses import dataclass
from enum import Enum
from functools import partial
from itertools import tee
from pathlib import Path
from typing import TypeVar

import polars as pl

from tumble.errors import LogError, TumbleError

BLANK_LINE = "a blank line"
_SHOWN = 40  # characters in a message
_KEPT_ROWS = 4_000_000
_Part = TypeVar("_Part")


class Kind(Enum):
    """Kind of an unreadable part: a value, a row, a line of text, a comment or blank line, or a cut last line."""

    VALUE = "value"
    ROW = "row"
    TEXT = "text"
    NO_ROW = "no row"
    CUT = "cut"


@dataclass(frozen=True, kw_only=True, slots=True)
class Unread:
    """An unreadable part of a row, and the text found there; `column` is None for the whole row, or all its values."""

    row: int
    column: str | None
    found: str
    kind: Kind

    @property
    def is_row(self) -> bool:
        """Whether the row cannot be read; if its values cannot, it is one."""
        return self.column is None and self.kind is not Kind.VALUE

    @property
    def what(self) -> str:
        """The text found, for messages."""
        shown = self.found[:_SHOWN] + ("…" if len(self.found) > _SHOWN else "")
        if self.kind is Kind.CUT:
            return "the last line is cut"
        if self.column is not None:
            return f"{repr(shown) if shown.strip() else 'an empty value'} in '{self.column[:_SHOWN]}'"
        return shown if self.kind in (Kind.ROW, Kind.VALUE) or shown == BLANK_LINE else repr(shown)


Tables = Iterator[tuple[pl.DataFrame, list[Unread]]]
"""Tables of the rows of a file in order, with the unreadable parts of each."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LogSource:
    """A file of a log, read as tables of bounded size, with the names of its columns in order.

    `kept` has the tables read so far, by requested columns, so that a file is read only once unless it is long; None
    for a file that is read anew each time."""

    path: Path
    names: tuple[str, ...]
    kept: dict[tuple[tuple[str, ...], str | None], Tables] | None = None

    def first_date(self, column: str) -> str | None:
        """Return the date with the time, ISO 8601, in the first row of a column; None without a date."""
        raise NotImplementedError

    def tables(self, columns: Sequence[str], clock: str | None = None) -> Tables:
        """Yield rows of some columns as float64, NaN for unreadable numbers.

        Times of day and dates in the column `clock` become seconds."""
        if self.kept is None:
            yield from self.read(columns, clock)
            return
        wanted, key = set(columns), (tuple(columns), clock)
        for kept_key in self.kept:  # tables with these columns, or with more
            if wanted <= set(kept_key[0]) and (kept_key[1] == clock or kept_key[1] not in wanted):
                key = kept_key
        self.kept[key], tables = tee(self.kept.get(key) or self.read(*key))
        rows = 0
        try:
            for table, unread in tables:
                rows += table.height
                if rows > _KEPT_ROWS:  # later calls read the file anew
                    self.kept.pop(key, None)
                yield table.select(columns), [u for u in unread if u.column is None or u.column in wanted]
        except TumbleError:
            self.kept.pop(key, None)
            raise

    def read(self, columns: Sequence[str], clock: str | None) -> Tables:
        """Yield `tables` without keeping them."""
        raise NotImplementedError

    def whole(self, numbers: Sequence[str]) -> Iterator[pl.DataFrame]:
        """Yield rows of all columns, `numbers` as float64, the others unchanged (text in a text file)."""
        raise NotImplementedError

    def place(self, row: int, column: str | None = None) -> str:
        """Return file, data row and column in words."""
        return f"{self.path}: {self.row_in_words(row)}" + ("" if column is None else f", column '{column}'")

    def row_in_words(self, row: int) -> str:
        """Return the number of a data row in words."""
        return f"row {row}"


def one_ahead(parts: Iterator[_Part]) -> Iterator[_Part]:
    """Yield parts, and prepare the next part in a thread, with the caller's context, while one is used."""
    following = partial(copy_context().run, lambda: next(parts, None))
    with ThreadPoolExecutor(max_workers=1) as beside:
        ahead = beside.submit(following)
        while (part := ahead.result()) is not None:
            ahead = beside.submit(following)
            yield part


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Turn errors of libraries about an unreadable file into a LogError."""
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
    """Turn errors of polars about the content of a file into a LogError."""
    try:
        yield
    except pl.exceptions.PolarsError as error:
        words = " ".join(str(error).split())[:200]
        raise LogError(f"{path}: expected rows of numbers, found: {words}; see `tumble inspect`") from None


def ending_of(path: Path) -> str:
    """Return the last suffix of a file's name, with the one before for a compressed file."""
    suffixes = [suffix.lower() for suffix in path.suffixes]
    compressed = suffixes[-1:] in ([".gz"], [".zst"])
    return "".join(suffixes[-2:] if compressed else suffixes[-1:])


def unread_error(source: LogSource, unread: Unread) -> LogError:
    """Return the error for a row that can neither be read nor left out."""
    width, shown = len(source.names), unread.found[:_SHOWN]
    expected, found = "a number", repr(shown) if shown.strip() else "an empty value"
    if unread.column is None:
        expected, found = f"{width} values, one per column", unread.what
    return LogError(
        f"{source.place(unread.row, unread.column)}: expected {expected}, found {found}; correct or remove the row"
    )
