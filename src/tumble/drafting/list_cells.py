"""Rows with lists of three numbers, `0.01,"[0.1, 0.2, 9.8]","[0. 0. 0.]"`, as programs in Python write them."""

from __future__ import annotations

import re
from collections.abc import Sequence

from tumble.drafting.spelling import Spelling, most_common
from tumble.recording.dialect import Dialect

_LIST = re.compile(r"[\[(]([^\[\]()]*)[\])]")
_AXES = ("_x", "_y", "_z")


def list_cells(lines: Sequence[str]) -> Spelling | None:
    """The spelling of such rows below the names of their columns; None where most lines are none."""
    sizes = most_common((_sizes(_cells(line)) for line in lines), lines)
    above = Dialect().cells(lines[0]) if lines else []
    if sizes is None or 3 not in sizes or len(above) != len(sizes):
        return None
    names = tuple(
        name + axis for name, size in zip(above, sizes, strict=True) for axis in (_AXES if size == len(_AXES) else [""])
    )

    def values(line: str) -> Sequence[str] | None:
        found = _cells(line)
        if _sizes(found) == sizes:
            return [number for cell in found for number in cell]
        return None if line == lines[0] else []

    return Spelling(names=names, values=values, said=f"lists of three numbers ({', '.join(names)})")


def _cells(line: str) -> list[list[str]]:
    """What stands in each cell of a line, and the numbers of those that are lists."""
    cells = Dialect().cells(line)
    return [_LIST.sub(r"\1", cell).replace(",", " ").split() if _LIST.fullmatch(cell) else [cell] for cell in cells]


def _sizes(cells: Sequence[Sequence[str]]) -> tuple[int, ...]:
    """How many numbers each cell has, of a row with lists of three."""
    return tuple(map(len, cells))
