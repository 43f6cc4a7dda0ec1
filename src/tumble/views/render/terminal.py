"""Blocks on a terminal: sentences as they are, tables without lines, words set to the left, numbers to the right.

Where a table is wider than the terminal its headings are broken between words; where that is not enough, it is set as
several tables below each other, each with the first column, which names a row. A number is never cut or broken; where
not even one column has room beside the names of the first, these are.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from textwrap import TextWrapper, wrap
from unicodedata import combining, east_asian_width

import click

from tumble.documents import plain
from tumble.views.blocks import Block, Facts, Items, Table, Text

_LEAST = 4
"""Characters of a name that are kept on a line."""
_IN_A_PIPE = 160
"""Width of tables where there is no terminal, characters."""


def print_blocks(*blocks: Block, width: int | None = None) -> None:
    """Print blocks to standard output, as wide as the terminal; where there is none as wide as `width`, without which
    sentences are not broken. What the output cannot show becomes question marks."""
    shown = text_of(blocks, shutil.get_terminal_size().columns if sys.stdout.isatty() else width)
    encoding = sys.stdout.encoding or "utf-8"
    click.echo(shown.encode(encoding, "replace").decode(encoding), nl=False)


def text_of(blocks: Iterable[Block], width: int | None = None) -> str:
    """Blocks as lines of text, tables and lists apart from others by a blank one; without `width` sentences are not
    broken."""
    shown = [(block, own) for block in blocks if (own := list(_lines(block, width)))]
    lines: list[str] = []
    for i, (block, own) in enumerate(shown):
        apart = isinstance(block, Table | Items) or (i > 0 and isinstance(shown[i - 1][0], Table | Items))
        lines += ["", *own] if i > 0 and apart else own
    return plain("".join(f"{line}\n" for line in lines))


def _lines(block: Block, width: int | None) -> Iterator[str]:
    if isinstance(block, Table):
        yield from _table_lines(block, width or _IN_A_PIPE)
        sentences: Sequence[str] = block.caption.split("\n") if block.caption else []
    elif isinstance(block, str | Text):
        sentences = (block if isinstance(block, str) else block.text).split("\n")
    elif isinstance(block, Items):
        sentences = [line for item in block.items for line in item.split("\n")]
    elif isinstance(block, Facts):
        sentences = [f"{name}: {value}" for name, value in block.rows]
    else:
        return  # a picture
    # neither a path nor an option is broken: they are to be copied
    broken = TextWrapper(width or 0, break_on_hyphens=False, break_long_words=False)
    broken.subsequent_indent = "  " if isinstance(block, Items) else ""
    for sentence in sentences:
        yield from [sentence] if width is None else broken.wrap(sentence) or [""]


def cell_len(text: str) -> int:
    """Columns of the terminal that a text takes: wide characters two, combining ones none."""
    if text.isascii():
        return len(text)
    return sum(0 if combining(c) else 2 if east_asian_width(c) in "WF" else 1 for c in text)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Column:
    """Heading and cells; words may be broken between words, numbers never. `least` is the width that it needs, of its
    widest word or number, `whole` that at which no line is broken."""

    cells: tuple[str, ...]
    words: bool
    least: int
    whole: int

    @staticmethod
    def of(cells: Sequence[str], *, words: bool) -> _Column:
        """A column of these cells, the heading first."""
        whole = max(cell_len(line) for cell in cells for line in cell.split("\n"))
        least = max((cell_len(word) for cell in cells for word in cell.split()), default=0) if words else whole
        return _Column(cells=tuple(cells), words=words, least=least, whole=whole)

    def broken(self, room: int) -> _Column:
        """With its lines broken anywhere after so many characters."""
        lines = (cell.split("\n") for cell in self.cells)
        pieces = ([line[i : i + room] for line in cell for i in range(0, max(len(line), 1), room)] for cell in lines)
        return _Column.of(["\n".join(cell) for cell in pieces], words=True)

    def set(self, cell: str, width: int) -> list[str]:
        """The lines of one of its cells, all of this width."""
        lines = cell.split("\n")
        if not self.words:
            return [" " * (width - cell_len(line)) + line for line in lines]
        fitting = ([line] if cell_len(line) <= width else wrap(line, width, break_on_hyphens=False) for line in lines)
        return [part + " " * (width - cell_len(part)) for parts in fitting for part in parts]


def _table_lines(table: Table, width: int) -> Iterator[str]:
    if not table.columns:
        return
    by_column = [list(cells) for cells in zip(table.columns, *table.rows, strict=True)]
    columns = [_Column.of(cells, words=i in table.text) for i, cells in enumerate(by_column)]
    if _together(columns) > width:
        broken = (["\n".join(heading.split()), *cells] for heading, *cells in by_column)
        columns = [_Column.of(cells, words=i in table.text) for i, cells in enumerate(broken)]
    for number, group in enumerate(_groups(columns, width)):
        if number:
            yield ""
        over = _together(group) - width
        if over > 0 and max(group[0].least - over, _LEAST) < group[0].least:
            group[0] = group[0].broken(max(group[0].least - over, _LEAST))
        widths = _widths(group, width)
        for row in zip(*(column.cells for column in group), strict=True):
            cells = [column.set(cell, size) for column, cell, size in zip(group, row, widths, strict=True)]
            for i in range(max(map(len, cells))):
                line = (c[i] if i < len(c) else " " * size for c, size in zip(cells, widths, strict=True))
                yield "  ".join(line).rstrip()


def _together(columns: Sequence[_Column]) -> int:
    """The least width of columns side by side, two blanks apart."""
    return sum(column.least + 2 for column in columns) - 2


def _widths(columns: Sequence[_Column], width: int) -> list[int]:
    """Widths of columns side by side: none is narrower than its widest word, and what is left goes to where words would
    have to be broken into lines."""
    widths = [column.least for column in columns]
    for _ in range(width - _together(columns)):
        neediest = max(range(len(widths)), key=lambda i: columns[i].whole - widths[i])
        if columns[neediest].whole <= widths[neediest]:
            break
        widths[neediest] += 1
    return widths


def _groups(columns: Sequence[_Column], width: int) -> Iterator[list[_Column]]:
    """The columns after the first in groups that fit a width together with it."""
    group = [columns[0]]
    for column in columns[1:]:
        if len(group) > 1 and _together([*group, column]) > width:
            yield group
            group = [columns[0]]
        group.append(column)
    yield group
