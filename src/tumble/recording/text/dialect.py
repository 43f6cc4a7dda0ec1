"""Dialects of text logs: delimiter, decimal mark, comments and encoding, and the lines above the numbers.

`Dialect` has the keys of session.toml for a text log; `dialect_of` finds it in the first lines of a file. `Top`
describes the lines above the first row of numbers: the names of the columns are in the last line with as many words as
the rows have numbers, and may be followed by a line of units.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

from tumble.recording.text.clock import is_clock

LINE_BYTES = 1 << 18
"""Longest line of a log; splitting a line into values takes four hundred times its memory."""
FIRST_ROWS = 5  # rows from which a missing name is recognised
SEEN_BYTES = 1 << 18  # first bytes of a file, from which its dialect is determined
BLANKS = " "  # the delimiter for one or more blanks or tabs

DELIMITERS = (",", ";", "\t", "|", BLANKS)
COMMENTS = ("#", "//", "%", "!", ";", "*")

_TOP_LINES = 2000
_FEWEST_NUMBERS = 3
_ENCODINGS = {"utf-8": "", "cp1251": "[а-яё]{3}", "gb18030": "[\u4e00-\u9fff]{2}"}
"""Encodings in the order of trial, with the letters that such a text must contain; a degree sign alone is Latin."""
_BOMS = {codecs.BOM_UTF8: "utf-8", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}

_POINT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?nan|[+-]?inf", re.IGNORECASE)
_COMMA = re.compile(r"[+-]?(\d+|\d*,\d+)([eE][+-]?\d+)?|[+-]?nan|[+-]?inf", re.IGNORECASE)
_PLAIN_LENGTH, _NOT_PLAIN = 4096, re.compile('["\r\n\0]')
"""Shorter lines without these characters can be split at their delimiters."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Dialect:
    """How a text log is written; by default as a CSV file with names in the first line."""

    delimiter: str = ","
    decimal: str = "."
    comment: str | None = None
    header: bool = True
    encoding: str = "utf-8"

    def keys(self) -> dict[str, Any]:
        """Return the keys of [log]: the delimiter, and what differs from a plain CSV file."""
        return {k: v for k, v in asdict(self).items() if k == "delimiter" or v != getattr(Dialect(), k)}

    def cells(self, line: str) -> list[str]:
        """Return the cells of a line, stripped; a line that is no CSV is one cell."""
        if self.delimiter == BLANKS:
            return line.split()
        if line and len(line) < _PLAIN_LENGTH and not _NOT_PLAIN.search(line):  # much faster than csv
            return [cell.strip() for cell in line.split(self.delimiter)]
        try:
            return [
                cell.strip() for cell in next(csv.reader([line], delimiter=self.delimiter, skipinitialspace=True), [])
            ]
        except csv.Error:
            return [line]

    def is_number(self, cell: str) -> bool:
        """Return whether a cell is a number with the decimal mark of the dialect."""
        return bool((_POINT if self.decimal == "." else _COMMA).fullmatch(cell))

    def is_comment(self, line: str) -> bool:
        """Return whether a line begins with the mark of comments."""
        return self.comment is not None and line.lstrip().startswith(self.comment)

    def is_row(self, cells: Sequence[str]) -> bool:
        """Return whether cells are a row: at least three numbers, and numbers or clocks in half of the filled cells."""
        if len(cells) < _FEWEST_NUMBERS:
            return False
        numbers, filled = sum(map(self.is_number, cells)), sum(map(bool, cells))
        return numbers >= _FEWEST_NUMBERS and (
            2 * numbers >= filled or 2 * (numbers + sum(map(is_clock, cells))) >= filled
        )


DIALECT_KEYS = tuple(asdict(Dialect()))


@dataclass(frozen=True, kw_only=True, slots=True)
class Top:
    """Names of the columns, number of lines above the numbers, and those of the lines without names and units."""

    names: tuple[str, ...]
    lines: int
    preamble: tuple[str, ...] = ()


# -------------------- lines above the numbers --------------------


@lru_cache(maxsize=4)
def top_of(lines: tuple[str, ...], dialect: Dialect) -> Top | None:
    """Return the top of a file by its first lines; None if they have no row of numbers.

    It is cached because a file is opened several times for a calibration."""
    rows = {i: len(cells) for i, line in enumerate(lines) if dialect.is_row(cells := dialect.cells(line))}
    if 0 in rows:  # pandas writes numbers of columns, `,0,1,2,…`
        empty, *others = dialect.cells(lines[0])
        if not empty and others == [str(k) for k in range(len(others))]:
            del rows[0]
    # the first row that is as wide as the next one, or the last
    data_rows = [(i, width) for i, width in rows.items() if not dialect.is_comment(lines[i])]
    following = [width for _, width in data_rows[1:]] + [None]
    first = next((i for (i, width), after in zip(data_rows, following, strict=False) if after in (None, width)), None)
    if first is None:
        return None
    width = Counter(width for i, width in rows.items() if i >= first).most_common(1)[0][0]
    above = [line.lstrip().lstrip(dialect.comment) if dialect.is_comment(line) else line for line in lines[:first]]
    below = [dialect.cells(lines[i]) for i, columns in rows.items() if i >= first and columns == width][:FIRST_ROWS]
    candidates = {
        i: n for i, line in enumerate(above) if (n := _names(dialect.cells(line), below, dialect)) is not None
    }
    names, used = tuple(str(i + 1) for i in range(width)), set[int]()
    wordy = [i for i, n in candidates.items() if sum(map(dialect.is_number, n)) < _FEWEST_NUMBERS]
    at = max(wordy or candidates, default=-1) if dialect.header else -1  # a row of mostly text may follow the names

    def groups(at: int) -> tuple[str, ...]:
        """Return the names in the line above, as many as there are columns."""
        return names_of_rows([cell.strip('"') for cell in dialect.cells(above[at - 1])], below) if at else ()

    def are_telling(at: int) -> bool:
        """Return whether names identify sensors or a time."""
        from tumble.recording.columns.names import columns_by_name

        columns = columns_by_name(_with_group_names(candidates[at], groups(at)) or candidates[at])
        return bool(columns.triads) or columns.time is not None

    if at >= 0 and any(line.strip() for line in above[at + 1 :]) and not are_telling(at):  # boot messages
        at = max((i for i in wordy if are_telling(i)), default=-1)
    if at >= 0:
        names, used = candidates[at], {at}
        if at - 1 in candidates and _are_units(names):
            at, units = at - 1, names
            pairs = zip(candidates[at], units, strict=True)
            names = tuple(f"{name} [{_bare(unit)}]".removesuffix(" []") for name, unit in pairs)
            used.add(at)
        grouped = _with_group_names(names, groups(at))
        if grouped is not None:
            names = grouped
            used.add(at - 1)
    preamble = (" ".join(line.split()) for i, line in enumerate(above) if i not in used)
    return Top(names=numbered(names), lines=first, preamble=tuple(filter(None, preamble)))


def _names(cells: Sequence[str], rows: Sequence[Sequence[str]], dialect: Dialect) -> tuple[str, ...] | None:
    """Return the names in a line, as many as the rows below have columns; None for another line."""
    names = names_of_rows([cell.strip().strip('"') for cell in cells], rows)
    if len(names) != len(rows[0]) or not names[1] or sum(map(bool, names)) < _FEWEST_NUMBERS:
        return None
    return None if 2 * sum(map(dialect.is_number, names)) > sum(map(bool, names)) else names


def _with_group_names(names: tuple[str, ...], above: Sequence[str]) -> tuple[str, ...] | None:
    """Return repeated names such as x, y, z, x, y, z with the names of their groups, which are above the first of each;
    None if they remain repeated."""

    def without_units(names: Sequence[str]) -> list[str]:
        return [re.sub(r"\s*[\[(].*", "", name).lower() for name in names]

    repeated = [bool(name) and without_units(names).count(name) > 1 for name in without_units(names)]
    if not any(repeated) or len(above) != len(names):
        return None
    group, out = "", []
    for name, upper, is_repeated in zip(names, above, repeated, strict=True):
        group = upper or group
        if is_repeated:
            out.append(f"{group} {name}".strip())
        else:
            out.append(f"{upper} [{_bare(name)}]" if upper and name and _are_units([name]) else name or upper)
    unique = without_units([name for name in out if name])
    return tuple(out) if len(set(unique)) == len(unique) else None


def names_of_rows(names: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return names for as many columns as most rows have.

    Empty names at the end are dropped if rows have no such columns. A missing name is that of the first column if it
    numbers the rows, as written by R, or grows evenly below a name that may be that of a sensor; else that of the last,
    as in rows that end with a comma."""
    width = Counter(map(len, rows)).most_common(1)[0][0] if rows else len(names)
    while len(names) > width and not names[-1]:
        names = names[:-1]
    if len(names) != width - 1:
        return (*names, *[""] * (width - len(names)))
    from tumble.recording.columns.names import NAMED, is_no_sensor  # compiles patterns, which most logs do not need

    wider = [cells for cells in rows if len(cells) == width]
    numbers = [cells[0].strip('"') for cells in wider]
    numbered = any(numbers == [str(first + i) for i in range(len(numbers))] for first in (0, 1))
    steps = [float(b) - float(a) for a, b in pairwise(numbers)] if all(map(_POINT.fullmatch, numbers)) else []
    even = len(steps) >= FIRST_ROWS - 1 and 0.0 < max(steps) < 2.0 * min(steps) and not is_no_sensor(names[0])
    if all(cells[-1] for cells in wider) and (numbered or even) and not NAMED["counter"].fullmatch(names[0]):
        return ("", *names)
    return (*names, "")


def numbered(names: Sequence[str]) -> tuple[str, ...]:
    """Return unique names: a column whose name is missing or repeated is called by its number, from 1."""
    counts = Counter(names)
    return tuple(
        name if name and counts[name] == 1 else f"column {j}" if str(j) in counts else str(j)
        for j, name in enumerate(names, 1)
    )


def _are_units(names: Sequence[str]) -> bool:
    """Return whether all cells of a line are units."""
    from tumble.recording.columns.names import is_unit

    return all(not name or is_unit(_bare(name)) for name in names)


def _bare(unit: str) -> str:
    """Return a unit without brackets."""
    return re.sub(r"[\[\]()]", "", unit).strip()


def head_lines(seen: bytes, encoding: str = "utf-8") -> tuple[str, ...]:
    """Return the complete first lines of a text, by its first SEEN_BYTES."""
    lines = seen.decode(encoding, errors="replace").removeprefix("\ufeff").replace("\0", "").split("\n")
    if len(seen) >= SEEN_BYTES and len(lines) > 1:
        lines = lines[:-1]
    return tuple(line.rstrip("\r") for line in lines[:_TOP_LINES])


# -------------------- the dialect of a file --------------------


def encoding_of(seen: bytes) -> str:
    """Return the encoding of a text by its first bytes."""
    zeros = [seen[k:4096:2].count(0) for k in (0, 1)]
    for bom, name in _BOMS.items():
        if seen.startswith(bom) and (name == "utf-8" or any(zeros)):  # else noise of a serial line
            return name
    if max(zeros) > len(seen[:4096]) // 4 and min(zeros) < max(zeros) // 8:  # else unwritten memory
        return "utf-16-le" if zeros[1] > zeros[0] else "utf-16-be"
    for name, words in _ENCODINGS.items():
        try:
            text = codecs.getincrementaldecoder(name)().decode(seen)
        except UnicodeDecodeError:
            continue
        if re.search(words, text):
            return name
    return "latin-1"


@lru_cache(maxsize=2)
def dialect_of(seen: bytes) -> tuple[Dialect, Top] | None:
    """Return the dialect of a text log and its top by its first bytes; None without rows of numbers."""
    encoding = encoding_of(seen)
    lines = head_lines(seen, encoding)
    # the most common mark at the start of lines, if other lines have none
    marks = Counter(mark for line in lines for mark in COMMENTS if line.lstrip().startswith(mark))
    mark, count = marks.most_common(1)[0] if marks else ("", 0)
    comment = mark if 0 < count < sum(bool(line.strip()) for line in lines) else None
    rows_by_dialect: dict[Dialect, int] = {}
    for delimiter in DELIMITERS:
        kept = comment if comment != delimiter else None
        trials = [Dialect(delimiter=delimiter, decimal=mark, comment=kept, encoding=encoding) for mark in ".,"]
        rows = [trials[0].cells(line) for line in lines if delimiter == BLANKS or delimiter in line]
        for trial in trials:
            widths = Counter(len(row) for row in rows if trial.is_row(row))
            rows_by_dialect[trial] = max(widths.values(), default=0)
    dialect = max(rows_by_dialect, key=lambda trial: rows_by_dialect[trial])
    top = top_of(lines, dialect) if rows_by_dialect[dialect] else None
    if top is None:
        return None
    return replace(dialect, header=any(not name.isdecimal() for name in top.names)), top
