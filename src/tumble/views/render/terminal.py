"""Blocks on a terminal: tables without rules, words aligned left, numbers right.

If a table is wider than the terminal, its headings are broken between words; if that is not enough, it becomes several
tables below each other, each with the first column, which names the rows. Numbers are never cut or broken; if not even
one column fits beside the first, the names in the first column are broken.
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

_MIN_NAME_WIDTH = 4  # characters, of a broken name
_PIPE_WIDTH = 160  # characters, of tables without a terminal


def print_blocks(*blocks: Block, width: int | None = None) -> None:
    """Print blocks to standard output in the width of the terminal, or without a terminal in `width` characters.

    Without either sentences are not broken. Characters that the output cannot encode become question marks."""
    shown = text_of(blocks, shutil.get_terminal_size().columns if sys.stdout.isatty() else width)
    encoding = sys.stdout.encoding or "utf-8"
    click.echo(shown.encode(encoding, "replace").decode(encoding), nl=False)


def text_of(blocks: Iterable[Block], width: int | None = None) -> str:
    """Return blocks as lines of text, with blank lines around tables and lists.

    Without `width` sentences are not broken."""
    lines: list[str] = []
    previous_set_off = False
    for block in blocks:
        block_lines = list(_lines(block, width))
        if not block_lines:
            continue
        set_off = isinstance(block, Table | Items)
        lines += ["", *block_lines] if lines and (set_off or previous_set_off) else block_lines
        previous_set_off = set_off
    return plain("".join(f"{line}\n" for line in lines))


def _lines(block: Block, width: int | None) -> Iterator[str]:
    if isinstance(block, Table):
        yield from _table_lines(block, width or _PIPE_WIDTH)
        sentences: Sequence[str] = block.caption.split("\n") if block.caption else []
    elif isinstance(block, str | Text):
        sentences = (block if isinstance(block, str) else block.text).split("\n")
    elif isinstance(block, Items):
        sentences = [line for item in block.items for line in item.split("\n")]
    elif isinstance(block, Facts):
        sentences = [f"{name}: {value}" for name, value in block.rows]
    else:
        return  # a picture
    # paths and options are not broken, so that they can be copied
    wrapper = TextWrapper(width or 0, break_on_hyphens=False, break_long_words=False)
    wrapper.subsequent_indent = "  " if isinstance(block, Items) else ""
    for sentence in sentences:
        yield from [sentence] if width is None else wrapper.wrap(sentence) or [""]


def cell_len(text: str) -> int:
    """Return the columns of the terminal that a text takes: two for wide characters, none for combining ones."""
    if text.isascii():
        return len(text)
    return sum(0 if combining(c) else 2 if east_asian_width(c) in "WF" else 1 for c in text)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Column:
    """Heading and cells of a column. `least` is its smallest width, that of its widest word or number, `whole` the
    width at which no line is broken."""

    cells: tuple[str, ...]
    words: bool
    least: int
    whole: int

    @staticmethod
    def of(cells: Sequence[str], *, words: bool) -> _Column:
        """Return a column of these cells, the heading first."""
        whole = max(cell_len(line) for cell in cells for line in cell.split("\n"))
        least = max((cell_len(word) for cell in cells for word in cell.split()), default=0) if words else whole
        return _Column(cells=tuple(cells), words=words, least=least, whole=whole)

    def broken(self, room: int) -> _Column:
        """Return the column with lines broken after so many characters."""
        lines = (cell.split("\n") for cell in self.cells)
        pieces = ([line[i : i + room] for line in cell for i in range(0, max(len(line), 1), room)] for cell in lines)
        return _Column.of(["\n".join(cell) for cell in pieces], words=True)

    def set(self, cell: str, width: int) -> list[str]:
        """Return the lines of a cell, padded to a width."""
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
    if _least_width(columns) > width:
        broken = (["\n".join(heading.split()), *cells] for heading, *cells in by_column)
        columns = [_Column.of(cells, words=i in table.text) for i, cells in enumerate(broken)]
    for number, group in enumerate(_groups(columns, width)):
        if number:
            yield ""
        over = _least_width(group) - width
        if over > 0 and max(group[0].least - over, _MIN_NAME_WIDTH) < group[0].least:
            group[0] = group[0].broken(max(group[0].least - over, _MIN_NAME_WIDTH))
        widths = _widths(group, width)
        for row in zip(*(column.cells for column in group), strict=True):
            cells = [column.set(cell, size) for column, cell, size in zip(group, row, widths, strict=True)]
            for i in range(max(map(len, cells))):
                line = (c[i] if i < len(c) else " " * size for c, size in zip(cells, widths, strict=True))
                yield "  ".join(line).rstrip()


def _least_width(columns: Sequence[_Column]) -> int:
    """Return the smallest width of columns side by side, two blanks apart."""
    return sum(column.least + 2 for column in columns) - 2


def _widths(columns: Sequence[_Column], width: int) -> list[int]:
    """Return widths of columns side by side: at least that of the widest word, and more for columns whose lines would
    have to be broken."""
    widths = [column.least for column in columns]
    for _ in range(width - _least_width(columns)):
        neediest = max(range(len(widths)), key=lambda i: columns[i].whole - widths[i])
        if columns[neediest].whole <= widths[neediest]:
            break
        widths[neediest] += 1
    return widths


def _groups(columns: Sequence[_Column], width: int) -> Iterator[list[_Column]]:
    """Yield groups of columns that fit in a width, each after the first column."""
    group = [columns[0]]
    for column in columns[1:]:
        if len(group) > 1 and _least_width([*group, column]) > width:
            yield group
            group = [columns[0]]
        group.append(column)
    yield group
