"""Rows with a unit behind every number, `0.01 s, 0.1 g, -0.2 g, 0.98 g, 1.2°/s, …`, below the names of the columns."""

from __future__ import annotations

import re
from collections.abc import Sequence

from tumble.drafting.spelling import LEAST_NUMBERS, Spelling, most_common
from tumble.recording.dialect import UNIT_WORDS, Dialect

_MEASURED = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*)?")
_DELIMITERS = (",", ";", "\t")


def units_in_cells(lines: Sequence[str]) -> Spelling | None:
    """The spelling of such rows; None where most lines are none."""
    return next((found for each in _DELIMITERS if (found := _spelling(lines, Dialect(delimiter=each)))), None)


def _spelling(lines: Sequence[str], dialect: Dialect) -> Spelling | None:
    units = most_common((_units(dialect.cells(line)) for line in lines), lines)
    above = dialect.cells(lines[0]) if lines else []
    if units is None or len(above) != len(units) or _units(above) is not None:
        return None
    names = tuple(
        f"{name} [{unit}]" if unit and "[" not in name and "(" not in name else name
        for name, unit in zip(above, units, strict=True)
    )

    def values(line: str) -> Sequence[str] | None:
        cells = dialect.cells(line)
        if _units(cells) == units:
            return [found[1] for cell in cells if (found := _MEASURED.fullmatch(cell))]
        return None if line == lines[0] else []

    return Spelling(names=names, values=values, said=f"a unit behind every number ({', '.join(names)})")


def _units(cells: Sequence[str]) -> tuple[str, ...] | None:
    """The units behind the numbers of a row, of which three at least have one; None where it is no row of these."""
    found = [_MEASURED.fullmatch(cell) for cell in cells]
    units = tuple((each[2] or "") if each else "?" for each in found)
    known = all(not unit or UNIT_WORDS.fullmatch(unit) for unit in units)
    return units if known and sum(map(bool, units)) >= LEAST_NUMBERS else None
