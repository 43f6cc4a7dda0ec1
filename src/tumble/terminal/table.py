"""Tables for a terminal: no lines, words set to the left, numbers to the right.

Where a table is wider than the terminal its headings are broken between words; where that is not enough, it is set as
several tables below each other, each with the first column. A number is never cut or broken.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import zip_longest

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Column, Table
from rich.text import Text


class PlainTable(Table):
    """A table without lines that fits the terminal."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """The table, or the tables that it is set as."""
        if _together(self.columns) <= options.max_width:
            yield from super().__rich_console__(console, options)
            return
        narrow = [_narrow(column) for column in self.columns]
        for number, columns in enumerate(_groups(narrow, options.max_width)):
            if number:
                yield Text("")
            part = Table(*(replace(column, _cells=[]) for column in columns), box=None, pad_edge=False)
            for row in zip_longest(*(column.cells for column in columns), fillvalue=""):
                part.add_row(*row)
            yield part


def plain_table(*headings: str) -> Table:
    """A table that begins with columns of words."""
    table = PlainTable(box=None, pad_edge=False)
    for heading in headings:
        table.add_column(heading)
    return table


def add_numbers(table: Table, *headings: str) -> None:
    """Add columns of numbers, which are never broken."""
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)


def _narrow(column: Column) -> Column:
    """A column with its heading broken between words; whole words are not broken."""
    heading = Text("\n".join(str(column.header).split()))
    return replace(column, header=heading, no_wrap=column.no_wrap or not any(" " in str(c) for c in column.cells))


def _together(columns: Sequence[Column]) -> int:
    """Width of columns side by side, with a blank on both sides of each."""
    return sum(_width(column) + 2 for column in columns)


def _width(column: Column) -> int:
    """Of its widest line; where it may be broken between words, of its widest word."""
    return max((cell_len(line) for cell in (column.header, *column.cells) for line in _lines(cell, column)), default=0)


def _lines(cell: object, column: Column) -> Sequence[str]:
    return str(cell).split() if column.no_wrap is False and column.justify == "left" else str(cell).split("\n")


def _groups(columns: Sequence[Column], width: int) -> Iterator[list[Column]]:
    """The columns after the first in groups that fit a width together with it."""
    first, *rest = columns
    group = [first]
    for column in rest:
        if len(group) > 1 and _together([*group, column]) > width:
            yield group
            group = [first]
        group.append(column)
    yield group
