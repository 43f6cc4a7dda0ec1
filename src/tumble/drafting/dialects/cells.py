"""Rows whose cells are more than numbers: lists of three, numbers with their unit, marks between thousands, brackets
about a row, a clock before it."""

from __future__ import annotations

import re
from collections.abc import Sequence

from tumble.drafting.dialects.spelling import LEAST_NUMBERS, Spelling, below_names, most_common
from tumble.recording.columns.patterns import is_unit
from tumble.recording.text.dialect import Dialect

_LIST = re.compile(r"[\[(]([^\[\]()]*)[\])]")
_AXES = ("_x", "_y", "_z")
_MEASURED = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*)?")
_THOUSANDS = re.compile("(?<=\\d)['’\u00a0\u202f](?=\\d{3}(?!\\d))")
_QUOTED_THOUSANDS = re.compile(r'"(-?\d{1,3}(?:,\d{3})+(?:\.\d*)?)"')
_BRACKETED = re.compile(r"\s*[\[({][-+.\d][^\[\](){}:]*[\])}]\s*[,;]?\s*")
_MONITORED = re.compile(r"\s*(\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?)\s*->\s*(.*)")


def list_cells(lines: Sequence[str]) -> Spelling | None:
    """Rows with lists of three numbers, `0.01,"[0.1, 0.2, 9.8]","[0. 0. 0.]"`, as programs in Python write them."""

    def parts(line: str) -> list[list[str]]:
        cells = Dialect().cells(line)
        return [_LIST.sub(r"\1", c).replace(",", " ").split() if _LIST.fullmatch(c) else [c] for c in cells]

    def sizes(row: list[list[str]]) -> tuple[int, ...]:
        return tuple(map(len, row))

    common = most_common((sizes(parts(line)) for line in lines), lines)
    above = Dialect().cells(lines[0]) if lines else []
    if common is None or 3 not in common or len(above) != len(common):
        return None
    names = tuple(n + axis for n, size in zip(above, common, strict=True) for axis in (_AXES if size == 3 else [""]))

    def numbers(line: str) -> list[str] | None:
        row = parts(line)
        return [number for cell in row for number in cell] if sizes(row) == common else None

    return below_names(names, lines, numbers, "lists of three numbers")


def units_in_cells(lines: Sequence[str]) -> Spelling | None:
    """Rows with a unit behind every number, `0.01 s, 0.1 g, -0.2 g, 0.98 g, 1.2°/s, …`."""
    for delimiter in (",", ";", "\t"):
        dialect = Dialect(delimiter=delimiter)
        units = most_common((_units(dialect.cells(line)) for line in lines), lines)
        above = dialect.cells(lines[0]) if lines else []
        if units is None or len(above) != len(units) or _units(above) is not None:
            continue
        names = tuple(
            f"{name} [{unit}]" if unit and "[" not in name and "(" not in name else name
            for name, unit in zip(above, units, strict=True)
        )

        def numbers(line: str, dialect: Dialect = dialect, units: tuple[str, ...] = units) -> list[str] | None:
            cells = dialect.cells(line)
            if _units(cells) != units:
                return None
            return [measured[1] for cell in cells if (measured := _MEASURED.fullmatch(cell))]

        return below_names(names, lines, numbers, "a unit behind every number")
    return None


def _units(cells: Sequence[str]) -> tuple[str, ...] | None:
    """The units behind the numbers of a row, of which three at least have one; None where it is no row of these."""
    measured = [_MEASURED.fullmatch(cell) for cell in cells]
    units = tuple((each[2] or "") if each else "?" for each in measured)
    known = all(not unit or is_unit(unit) for unit in units)
    return units if known and sum(map(bool, units)) >= LEAST_NUMBERS else None


def in_brackets(lines: Sequence[str]) -> Spelling | None:
    """Rows in brackets, unless they begin a document of JSON."""
    first = next((line.strip() for line in lines if line.strip()), "")
    nested = first.startswith(("{", "[")) and not _BRACKETED.fullmatch(first)
    if nested or not most_common((bool(_BRACKETED.fullmatch(line)) for line in lines), lines):
        return None
    return Spelling(values=lambda line: [line.strip(" \t,;[](){}")], said="rows in brackets")


def behind_a_clock(lines: Sequence[str]) -> Spelling | None:
    """Rows behind the clock of a serial monitor, `13:02:11.345 -> 0.1,…`: that is the first column."""
    if not most_common((bool(_MONITORED.fullmatch(line)) for line in lines), lines):
        return None

    def values(line: str) -> list[str]:
        row = _MONITORED.fullmatch(line)
        if row is None:
            return []
        clock, rest = row.groups()
        delimiter = next((mark for mark in "\t;," if mark in rest), " ")
        return [f"{clock if rest[:1] in '+-.0123456789' else 'clock'}{delimiter}{rest}"]

    return Spelling(values=values, said="rows behind the clock of a serial monitor")


def thousands(lines: Sequence[str]) -> Spelling | None:
    """Numbers with marks between their thousands, 1'000 or "1,000"."""

    def without(line: str) -> str:
        return _QUOTED_THOUSANDS.sub(lambda number: number[1].replace(",", ""), _THOUSANDS.sub("", line))

    if sum(without(line) != line for line in lines) <= 1:
        return None
    return Spelling(values=lambda line: [without(line)], said="marks between thousands, as in 1'000")
