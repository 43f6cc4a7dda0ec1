"""A log as it came: its files, how they are written, and which of their columns are what."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tumble.drafting.log_times import Stamps, Times, times_of_column, times_without_column
from tumble.errors import InputError, LogError
from tumble.recording.dialect import Dialect, is_clock
from tumble.recording.formats.columns import ACCEL, Columns, is_no_sensor
from tumble.recording.gaps import is_reading
from tumble.recording.log_source import LogSource
from tumble.recording.readers import source_of
from tumble.reduction.blocks.tuning import USUAL
from tumble.units import Array

LONGEST = 2_000_000
"""Rows that are looked at."""

SAMPLE_ROWS = 200
_HEAD = 20_000
_FUSED = re.compile(r"grav|user_?acc|linear_?acc(?!.*cov)|\blacc", re.IGNORECASE)
SHOWN = 12
_SHORTEST_SESSION = 4 * USUAL.rest
"""s: what four rests alone take, and fewer tell nothing."""
_FILLED = 50
"""Rows that are alike in all sensors, at the end of a log, are no samples if they are as many."""


@dataclass(frozen=True, kw_only=True, slots=True)
class FoundLog:
    """Files of one kind, the keys of [log] that say how they are written, their columns, what was said above the
    numbers, cells of the first rows by column, and what there is to say."""

    files: tuple[Path, ...]
    keys: Mapping[str, Any]
    columns: Columns
    remarks: tuple[str, ...] = ()
    cells: Mapping[str, Sequence[str]] = field(default_factory=dict)
    said: tuple[str, ...] = ()
    dialect: Dialect | None = None

    def sources(self) -> Iterator[LogSource]:
        """The files, as they are read."""
        for file in self.files:
            yield source_of(file, self.dialect)

    def read(self, columns: Sequence[str], *, rows: int = LONGEST, clock: str | None = None) -> Array:
        """The first rows of some columns, of all files."""
        found, count = [np.empty((0, len(columns)))], 0
        for source in self.sources():
            for table, _ in source.tables(columns, clock):
                read = table.select(columns).to_numpy()[: rows - count]
                found.append(np.where(is_reading(read), read, np.nan))
                count += len(found[-1])
                if count >= rows:
                    return np.concatenate(found)
        return np.concatenate(found)

    def readings(self, column: str) -> Array:
        """The numbers in the first rows of a column; where there are none, those in all. None where some of its rows
        cannot be read."""
        with suppress(LogError):
            for rows in (_HEAD, LONGEST):
                found = self.read([column], rows=rows)[:, 0]
                if np.isfinite(found).any():
                    return found[np.isfinite(found)]
        return np.empty(0)

    def is_clock(self, column: str) -> bool:
        """Whether a column has times of day."""
        cells = [cell for cell in self.cells.get(column, ()) if cell]
        return bool(cells) and sum(map(is_clock, cells)) > len(cells) // 2

    def stamps(self) -> Stamps | None:
        """The time stamps of the first file, if it has any."""
        column = self.columns.time
        if column is None:
            return None
        clock = self.is_clock(column)
        first = replace(self, files=self.files[:1])
        values = first.read([column], clock=column if clock else None)[:, 0]
        if clock:  # past midnight
            values = values + 86400.0 * np.cumsum(np.diff(values, prepend=values[:1]) < -43200.0)
        return Stamps(column=column, values=values, unit=self.columns.time_unit, clock=clock)


def samples_in(read: Array) -> int:
    """How many of the rows (m, n) of readings are samples: those before a stretch, at the end, of rows that are all
    alike or empty, as memory is filled with beforehand. All of them where that stretch is short."""
    if not len(read):
        return 0
    alike = ((read == read[-1]) | ~np.isfinite(read)).all(axis=1)
    last = int(np.flatnonzero(~alike)[-1]) + 1 if not alike.all() else len(read)
    return last if len(read) - last >= _FILLED else len(read)


def check_has_accelerometers(log: FoundLog) -> None:
    """Raises InputError where no columns are those of accelerometers."""
    if ACCEL not in log.columns.triads:
        columns = next(iter(log.sources())).names
        names = ", ".join(columns[:SHOWN])
        if len(columns) == len("xyz") and all(name.isdecimal() for name in columns):
            raise InputError(
                f"{log.files[0]}: expected a recording, found three columns without names that are none by their "
                "numbers; of a table with a row a position write `x,y,z` above the rows, with commas between the "
                "values, and give it to `tumble ellipsoid`"
            )
        if any(_FUSED.search(name) for name in columns):
            raise InputError(
                f"{log.files[0]}: expected readings of accelerometers, found gravity and acceleration without it, "
                f"which a filter has made of them ({names[:120]}); log the raw accelerometers"
            )
        free = [name for name in columns if not is_no_sensor(name)]
        remedy = (
            "state which they are (--accel N,N,N, names or numbers from 1)"
            if len(free) >= len("xyz")
            else "log the readings of the accelerometers too"
        )
        raise InputError(
            f"{log.files[0]}: expected columns named as accelerometers are, such as ax, ay, az or acc_x, acc_y, acc_z; "
            f"found {names[:200]}; {remedy}"
        )


def times_of(log: FoundLog, rate: float | None) -> Times:
    """When the rows of a log were taken; `rate` as given, Hz."""
    if rate is not None:
        return times_without_column(rate, ())
    stamps = log.stamps()
    times = None if stamps is None else times_of_column(stamps)
    if times is not None and stamps is not None:
        span = len(stamps.values) / times.rate
        if len(log.files) > 1 or span >= _SHORTEST_SESSION:
            return times
        short = f"time: all of the log is {span:.3g} s by its times, too short to turn and rest in: is the unit right?"
        return replace(times, said=(*times.said, short))
    assumed = times_without_column(None, log.remarks)
    if stamps is None:
        return assumed
    return replace(assumed, said=(f"time: column {stamps.column!r} does not grow and is not used", *assumed.said))
