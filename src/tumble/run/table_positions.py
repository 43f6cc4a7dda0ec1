"""The positions of a table of readings: blocks of rows, each block once.

A block is N rows of one position, N = 1 unless stated. Its reading is the mean; the covariance of a mean comes from the
scatter within all blocks, which is taken to be the same in each. Blocks that are equal to the last digit are copies of
one reading, not several, and count once.

A table of more rows than anyone puts a device into positions is a recording of one that is waved about, as compass
calibrations are made. Its rows err alike in neighbours, so that it is judged by BLOCKS stretches of it, not by rows.

No reading is known better than the last digit it is written with: its standard uncertainty is at least the step of that
digit over √12, and a mean of several has the same.

Source: JCGM 100:2008 (GUM), F.2.2.1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tumble.errors import InputError
from tumble.run.readings_table import ReadingsTable
from tumble.units import Array, IntArray

_SHOWN = 3

BLOCKS = 20
"""Of a recording: the fewer, the longer what errs alike may last, and the less is u itself known; twice the nine
parameters is the least that leaves each of them something to be judged by."""

CONSECUTIVE = 5 * BLOCKS
"""So many rows are a recording. A table with as many positions, of which each errs for itself, has the same u by blocks
but for the 16 % to which 19 degrees of freedom know it."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TablePositions:
    """A `table` with a row a position, in which `lines` are those of the first row of each; the `covariance` (3, 3) of
    a reading from the scatter within blocks, None where a block is one row, with its `degrees` of freedom; and in
    words what was `left_out`. A block has so many `rows`. Of a recording `stretch` (N,) is the number of the stretch
    that each row is in, None where rows are positions."""

    table: ReadingsTable
    covariance: Array | None
    rows: int
    degrees: int
    left_out: tuple[str, ...]
    stretch: IntArray | None

    @property
    def resolution_u(self) -> Array:
        """Standard uncertainty (3,) of a reading from the last digit it is written with, in the unit of the table."""
        return np.asarray(self.table.steps / np.sqrt(12.0))

    @property
    def row_u(self) -> Array:
        """Standard uncertainty (3,) of a single row, from its last digit and the scatter within blocks, as above."""
        within = 0.0 if self.covariance is None else self.rows * np.diag(self.covariance)
        return np.sqrt(self.resolution_u**2 + within)


def positions_of(table: ReadingsTable, rows_per_position: int = 1) -> TablePositions:
    """The positions of a table with so many rows each. Raises InputError where they do not go into the table."""
    N, rows = len(table.values), rows_per_position
    if rows < 1 or N % rows:
        raise InputError(
            f"--rows-per-position: expected a number that goes into the {N} rows of {table.path}, found {rows}"
        )
    blocks = table.values.reshape(-1, rows, 3)
    _, first, inverse = np.unique(blocks.reshape(len(blocks), -1), axis=0, return_index=True, return_inverse=True)
    own = np.sort(first)
    lines = table.lines[::rows]
    means = blocks[own].mean(axis=1)
    return TablePositions(
        table=replace(table, values=means, lines=tuple(lines[i] for i in own)),
        covariance=None if rows == 1 else _covariance_of_mean(blocks[own], means),
        rows=rows,
        degrees=len(own) * (rows - 1),
        left_out=_copies(lines, first[inverse.ravel()], rows),
        stretch=np.arange(len(own)) * BLOCKS // len(own) if rows == 1 and len(own) >= CONSECUTIVE else None,
    )


def _covariance_of_mean(blocks: Array, means: Array) -> Array:
    """Of the mean of a block, (3, 3), from the scatter within all blocks (B, N, 3)."""
    away = (blocks - means[:, None]).reshape(-1, 3)
    B, N, _ = blocks.shape
    return np.asarray(away.T @ away / (B * (N - 1)) / N)


def _copies(lines: tuple[int, ...], first: IntArray, rows: int) -> tuple[str, ...]:
    """That blocks repeat others, in words; `first` (B,) is the first block that is equal to each."""
    again = np.flatnonzero(first != np.arange(len(first)))
    if not len(again):
        return ()
    named = [f"line {lines[i]} as line {lines[first[i]]}" for i in again[:_SHOWN]]
    named += [f"{len(again) - _SHOWN} more"] if len(again) > _SHOWN else []
    what = "rows" if rows == 1 else f"blocks of {rows} rows"
    said = (
        f"{what} that repeat others to the last digit: {len(again)} ({', '.join(named)}); a copy is no further reading"
    )
    return (f"{said}, and each counts once",)
