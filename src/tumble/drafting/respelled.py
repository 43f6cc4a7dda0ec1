"""Text logs that are no table, as one: each dialect tells from the first lines whether a log is spelled so. Those whose
lines name their values, and sentences with a checksum, have files of their own; here are rows whose cells are more
than numbers: lists of three, numbers with their unit, marks between thousands, brackets about a row, a clock before it.

What is written is a CSV file in the session's folder, a row for each line. A line that a dialect does not know is left
as it is, for the reader to report.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from tumble.drafting.named_values import json_lines, named_values, several_lines
from tumble.drafting.sentences import sentences
from tumble.drafting.spelling import LEAST_NUMBERS, Columns, Spelling, copied, listed, most_common, spelt_alike
from tumble.files import OutputFolder
from tumble.recording.columns.patterns import is_unit
from tumble.recording.text.dialect import Dialect, encoding_of

_LIST = re.compile(r"[\[(]([^\[\]()]*)[\])]")
_MEASURED = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*)?")
_THOUSANDS = re.compile("(?<=\\d)['’\u00a0\u202f](?=\\d{3}(?!\\d))")
_QUOTED_THOUSANDS = re.compile(r'"(-?\d{1,3}(?:,\d{3})+(?:\.\d*)?)"')
_BRACKETED = re.compile(r"\s*[\[({][-+.\d][^\[\](){}:]*[\])}]\s*[,;]?\s*")
_MONITORED = re.compile(r"\s*(\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?)\s*->\s*(.*)")
_SEEN_LINES = 200


def list_cells(lines: Sequence[str]) -> Spelling | None:
    """Rows with lists of three numbers, `0.01,"[0.1, 0.2, 9.8]","[0. 0. 0.]"`, as programs in Python write them."""
    above = Dialect().cells(lines[0]) if lines else []

    def row(line: str) -> tuple[tuple[int, ...], list[str]]:
        cells = Dialect().cells(line)
        parts = [_LIST.sub(r"\1", c).replace(",", " ").split() if _LIST.fullmatch(c) else [c] for c in cells]
        return tuple(map(len, parts)), [number for cell in parts for number in cell]

    def columns(sizes: tuple[int, ...]) -> Columns | None:
        if 3 not in sizes or len(above) != len(sizes):
            return None
        axes = {3: ("_x", "_y", "_z")}
        names = (n + axis for n, size in zip(above, sizes, strict=True) for axis in axes.get(size, ("",)))
        return listed("lists of three numbers")(tuple(names))

    return spelt_alike(lines, row, columns, below_names=True)


def units_in_cells(lines: Sequence[str]) -> Spelling | None:
    """Rows with a unit behind three numbers at least, `0.01 s, 0.1 g, -0.2 g, 0.98 g, 1.2°/s, …`."""

    def of(dialect: Dialect) -> Spelling | None:
        above = dialect.cells(lines[0]) if lines else []

        def row(line: str) -> tuple[tuple[str, ...], list[str]] | None:
            measured = [_MEASURED.fullmatch(cell) for cell in dialect.cells(line)]
            units = tuple((m[2] or "") if m else "?" for m in measured)
            known = all(not unit or is_unit(unit) for unit in units) and sum(map(bool, units)) >= LEAST_NUMBERS
            return (units, [m[1] for m in measured if m]) if known else None

        def columns(units: tuple[str, ...]) -> Columns | None:
            if len(above) != len(units) or row(lines[0]) is not None:
                return None
            pairs = zip(above, units, strict=True)
            names = (f"{name} [{unit}]" if unit and not {"[", "("} & {*name} else name for name, unit in pairs)
            return listed("a unit behind every number")(tuple(names))

        return spelt_alike(lines, row, columns, below_names=True)

    return next((spelling for mark in ",;\t" if (spelling := of(Dialect(delimiter=mark))) is not None), None)


def in_brackets(lines: Sequence[str]) -> Spelling | None:
    """Rows in brackets, unless they begin a document of JSON."""
    first = next((line.strip() for line in lines if line.strip()), "")
    if first.startswith(("{", "[")) and not _BRACKETED.fullmatch(first):
        return None
    if not most_common((bool(_BRACKETED.fullmatch(line)) for line in lines), lines):
        return None
    return Spelling(values=lambda line: [line.strip(" \t,;[](){}")], said="rows in brackets")


def behind_a_clock(lines: Sequence[str]) -> Spelling | None:
    """Rows behind the clock of a serial monitor, `13:02:11.345 -> 0.1,…`: that is the first column."""

    def row(line: str) -> tuple[bool, list[str]] | None:
        monitored = _MONITORED.fullmatch(line)
        if monitored is None:
            return None
        clock, rest = monitored.groups()
        delimiter = next((mark for mark in "\t;," if mark in rest), " ")
        return True, [f"{clock if rest[:1] in '+-.0123456789' else 'clock'}{delimiter}{rest}"]

    return spelt_alike(lines, row, lambda _: ((), "rows behind the clock of a serial monitor"))


def thousands(lines: Sequence[str]) -> Spelling | None:
    """Numbers with marks between their thousands, 1'000 or "1,000"."""

    def without(line: str) -> str:
        return _QUOTED_THOUSANDS.sub(lambda number: number[1].replace(",", ""), _THOUSANDS.sub("", line))

    if sum(without(line) != line for line in lines) <= 1:
        return None
    return Spelling(values=lambda line: [without(line)], said="marks between thousands, as in 1'000")


DIALECTS: tuple[Callable[[Sequence[str]], Spelling | None], ...] = (
    sentences,
    json_lines,
    several_lines,
    list_cells,
    units_in_cells,
    named_values,
    in_brackets,
    behind_a_clock,
    thousands,
)
"""Each is asked in this order, with the first lines of a file, for their spelling."""


def respelled(file: Path, seen: bytes, folder: OutputFolder) -> tuple[Path, str] | None:
    """The copy of a text log in a folder as a table, and a remark on it; None for one that can be read as it is.
    `seen`: the first bytes of the file."""
    encoding = encoding_of(seen)
    text = seen.decode(encoding, errors="replace")
    lines = re.split("[\r\n]+", text)[:-1][:_SEEN_LINES]
    spelling = next((spelling for dialect in DIALECTS if (spelling := dialect(lines)) is not None), None)
    if spelling is None and text.count("\r") > 2 and "\n" not in text:
        spelling = Spelling(values=lambda line: [line], said="lines that end in a carriage return")
    if spelling is None:
        return None
    of_line, names = spelling.values, ",".join(spelling.names)

    def row(_number: int, line: str) -> tuple[str, str] | None:
        values = of_line(line)
        return None if values is None else ("", ",".join(values) or line.replace(",", " "))

    (table,) = copied(file, encoding, folder, lambda _: names, row)
    return table, f"text: {spelling.said}: copied to {table.name} as a table"
