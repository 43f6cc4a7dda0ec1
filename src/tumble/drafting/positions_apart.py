"""Positions that follow each other in a log without a turn between them."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np
import polars as pl

from tumble.drafting.found_log import LONGEST, FoundLog
from tumble.drafting.raw_scale import unwrapped
from tumble.errors import InputError
from tumble.recording.formats.columns import ACCEL
from tumble.units import Array

FEWEST_ROWS = 50
_JUMP = 0.2
_LABEL = re.compile(
    r"part|pos(ition)?|pose|label|section|segment|step|lage|stellung|положение|позиция|位置", re.IGNORECASE
)


def positions_apart(log: FoundLog, *, unsigned: bool) -> list[tuple[int, int]] | None:
    """First and last + 1 row of positions that follow each other without a turn: by a column that names them, or where
    gravity jumps from one row to the next while nothing moves before and after; None where there are none. With
    `unsigned`, 16 bits of the accelerometers were read without their sign. Raises InputError for positions of too few
    rows."""
    if len(log.files) > 1:
        return None
    accel = log.read(log.columns.triads[ACCEL].columns)
    accel = unwrapped(accel) if unsigned else accel
    if np.isnan(accel).all(axis=0).any():
        return None
    if len(accel) < 2 * FEWEST_ROWS or len(accel) == LONGEST:
        return None
    label = next((n for n in log.cells if _LABEL.fullmatch(n.strip()) and n != log.columns.time), None)
    at = _label_changes(log, label) if label is not None else _jumps(accel)
    if at is None or len(at) < 3:
        return None
    edges = list(pairwise([0, *at, len(accel)]))
    shortest = min(stop - start for start, stop in edges)
    if shortest < FEWEST_ROWS:
        raise InputError(
            f"{log.files[0]}: expected at least {FEWEST_ROWS} rows a position, found {shortest}; take the mean of "
            "each position and give the table to `tumble ellipsoid`"
        )
    return edges


def _label_changes(log: FoundLog, label: str) -> list[int] | None:
    """Rows where a column that names positions changes."""
    source = next(iter(log.sources()))
    labels = pl.concat([table[label].cast(pl.String) for table in source.whole(())])
    return (np.flatnonzero((labels != labels.shift(1)).fill_null(False).to_numpy())).tolist()


def _jumps(accel: Array) -> list[int] | None:
    """Rows at which the specific force is another than in the row before, while ten rows before and behind are
    steady."""
    about = accel - np.nanmedian(accel, axis=0)
    size = float(np.nanmedian(np.linalg.norm(about, axis=1)))
    steps = np.linalg.norm(np.diff(accel, axis=0), axis=1)
    candidates = np.flatnonzero(steps > _JUMP * size) + 1
    if not 3 <= len(candidates) <= len(accel) // FEWEST_ROWS + 1:
        return None
    found = []
    for k in candidates.tolist():
        before, behind = accel[max(k - 10, 0) : k], accel[k : k + 10]
        scatter = max(np.ptp(before, axis=0).max(), np.ptp(behind, axis=0).max())
        if scatter < 0.5 * float(np.linalg.norm(behind.mean(axis=0) - before.mean(axis=0))) and scatter < _JUMP * size:
            found.append(k)
    return found if len(found) == len(candidates) else None
