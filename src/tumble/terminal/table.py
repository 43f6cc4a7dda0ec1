"""Tables for a terminal: no lines, words set to the left, numbers to the right.

Where a table is wider than the terminal its headings are broken between words; where that is not enough, it is set as
several tables below each other, each with the first column, or those that together name a row. A number is never cut or
broken; where not even one column has room beside the names of the first, these are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import zip_longest

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Column, Table
from rich.text import Text

_LEAST = 4
"""Characters of a name that are kept on a line."""


class PlainTable(Table):
    """A table without lines that fits the terminal. Its first `named_by` columns together name a row."""

    named_by: int = 1

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """The table, or the tables that it is set as."""
        fits = _together(self.columns) <= options.max_width
        columns = self.columns if fits else [_narrow(column) for column in self.columns]
        for number, group in enumerate(_groups(columns, self.named_by, options.max_width)):
            if number:
                yield Text("")
            shown = _with_room(group, options.max_width)
            widths = _widths(shown, options.max_width)
            sized = (replace(column, _cells=[], width=width) for column, width in zip(shown, widths, strict=True))
            part = Table(*sized, box=None, pad_edge=False)
            for row in zip_longest(*(column.cells for column in shown), fillvalue=""):
                part.add_row(*row)
            yield part


def plain_table(*headings: str, named_by: int = 1) -> Table:
    """A table that begins with columns of words, of which the first `named_by` together name a row."""
    table = PlainTable(box=None, pad_edge=False)
    table.named_by = named_by
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


def _with_room(columns: Sequence[Column], width: int) -> Sequence[Column]:
    """The columns with the lines of the first broken anywhere, where they are too wide together."""
    first, *rest = columns
    over = _together(columns) - 2 - width  # no blank at the edges
    room = max(_width(first) - over, _LEAST)
    if over <= 0 or room >= _width(first):
        return columns
    return [replace(first, header=_broken(first.header, room), _cells=[_broken(c, room) for c in first.cells]), *rest]


def _broken(cell: object, width: int) -> Text:
    """A cell with its lines broken after `width` characters."""
    lines = (line[i : i + width] for line in str(cell).split("\n") for i in range(0, max(len(line), 1), width))
    return Text("\n".join(lines))


def _widths(columns: Sequence[Column], width: int) -> list[int]:
    """Widths of columns side by side: none is narrower than its widest word, and what is left goes to where words would
    have to be broken into lines."""
    widths = [_width(column) for column in columns]
    whole = [max(map(cell_len, _whole_lines(column)), default=0) for column in columns]
    spare = width - _together(columns) + 2  # no blank at the edges
    while spare > 0 and any(now < most for now, most in zip(widths, whole, strict=True)):
        neediest = max(range(len(widths)), key=lambda i: whole[i] - widths[i])
        widths[neediest] += 1
        spare -= 1
    return widths


def _whole_lines(column: Column) -> Iterator[str]:
    return (line for cell in (column.header, *column.cells) for line in str(cell).split("\n"))


def _lines(cell: object, column: Column) -> Sequence[str]:
    return str(cell).split() if column.no_wrap is False and column.justify == "left" else str(cell).split("\n")


def _groups(columns: Sequence[Column], named_by: int, width: int) -> Iterator[list[Column]]:
    """The columns after those that name a row in groups that fit a width together with these; where these alone do not
    take more than two thirds of it, together with the first."""
    names, rest = list(columns[:named_by]), columns[named_by:]
    if 3 * _together(names) > 2 * width:
        names, rest = list(columns[:1]), columns[1:]
    group = list(names)
    for column in rest:
        if len(group) > len(names) and _together([*group, column]) > width:
            yield group
            group = list(names)
        group.append(column)
    yield group
