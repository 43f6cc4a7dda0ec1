"""A log of unknown origin: its files, how they are written, and what its columns are."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tumble.drafting.times import Stamps, Times, past_midnight, times_of_column, times_without_column
from tumble.errors import GyrosAloneError, InputError, LogError, did_you_mean
from tumble.recording.columns.names import (
    ACCEL,
    GYRO,
    TIME_KIND,
    Columns,
    Sensors,
    is_no_sensor,
    time_unit,
    unit_of_name,
)
from tumble.recording.columns.scales import CANDIDATES
from tumble.recording.log_source import LogSource
from tumble.recording.readers import source_of
from tumble.recording.rows.gaps import is_reading
from tumble.recording.text.dialect import Dialect, is_clock
from tumble.reduction.blocks.tuning import USUAL
from tumble.units import Array

LONGEST = 2_000_000
"""Rows that are read at most to identify a log."""

HEAD_ROWS = 20_000
SAMPLE_ROWS = 200
_FUSED = re.compile(r"grav|(user|free|linear)_?acc(?!.*cov)|\blacc", re.IGNORECASE)
SHOWN = 12
_NEAR = 0.1
_FEWEST_ROWS = 50
_SHORTEST_SESSION = 4 * USUAL.rest
"""s: duration of four rests; fewer determine nothing."""
_FILLED = 50
"""Identical rows at the end of a log that are no samples, at least."""

Stated = Mapping[str, Sequence[str]]
"""Columns by role: three for "accel" and for "gyro", one for "time"."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ForeignLog:
    """Files of one kind, written alike, with identified columns.

    `keys` are those of [log] that describe the text, `preamble` the lines above the numbers that are neither names nor
    units, `cells` the first rows by column, and `remarks` sentences for the user."""

    files: tuple[Path, ...]
    keys: Mapping[str, Any]
    columns: Columns
    preamble: tuple[str, ...] = ()
    cells: Mapping[str, Sequence[str]] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    """What is not certain: its consequence, and how the user settles it."""
    dialect: Dialect | None = None
    kept: dict[Path, LogSource] = field(default_factory=dict)
    """Files that have been read, by path: none is read twice."""

    def with_columns(self, remarks: Sequence[str] = (), /, **changed: Any) -> ForeignLog:
        """A copy with some attributes of `columns` changed, and further remarks."""
        return replace(self, columns=replace(self.columns, **changed), remarks=(*self.remarks, *remarks))

    def sources(self) -> Iterator[LogSource]:
        """Readers of the files."""
        for file in self.files:
            path = file.resolve()
            if path not in self.kept:
                self.kept[path] = replace(source_of(file, self.dialect), kept={})
            yield self.kept[path]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns of the first file."""
        return next(self.sources()).names

    @property
    def unnamed(self) -> bool:
        """Whether the columns have no names, and are numbered from 1."""
        return all(map(str.isdecimal, self.cells))

    @property
    def clock(self) -> str | None:
        """The time column, if it has times of day or dates."""
        column = self.columns.time
        return column if column is not None and self.is_clock(column) else None

    def read(self, columns: Sequence[str], *, rows: int = LONGEST) -> Array:
        """Read the first rows of some columns of all files, (m, n): seconds for times of day, NaN where no number is.

        The columns that a session needs are read together, so that a file is parsed once."""
        named = self.columns
        sensors = [c for kind in ("accel", "gyro") if kind in named.triads for c in named.triads[kind].columns]
        together = [c for c in (named.time, *sensors) if c is not None]
        wanted = together if set(columns) <= set(together) else columns
        parts, count = [np.empty((0, len(columns)))], 0
        for source in self.sources():
            for table, _ in source.tables(wanted, self.clock if self.clock in wanted else None):
                numbers = table.select(columns).to_numpy()[: rows - count]
                parts.append(np.where(is_reading(numbers), numbers, np.nan))
                count += len(numbers)
                if count >= rows:
                    return np.concatenate(parts)
        return np.concatenate(parts)

    def readings(self, column: str) -> Array:
        """Numbers of a column in the first rows, or in all rows where the first have none; empty where it cannot be
        read."""
        with suppress(LogError):
            for rows in (HEAD_ROWS, LONGEST):
                numbers = self.read([column], rows=rows)[:, 0]
                if np.isfinite(numbers).any():
                    return numbers[np.isfinite(numbers)]
        return np.empty(0)

    def reads_gravity(self, columns: Sequence[str]) -> bool:
        """Whether the median length of three columns is that of gravity in a known unit; false for no columns."""
        length = np.linalg.norm(self.read(columns, rows=HEAD_ROWS), axis=1) if columns else np.empty(0)
        median = float(np.nanmedian(length)) if np.isfinite(length).any() else 0.0
        return any(c.unit is not None and abs(median / c.value - 1.0) < _NEAR for c in CANDIDATES[ACCEL])

    def is_clock(self, column: str) -> bool:
        """Whether most cells of a column are times of day or dates."""
        cells = [cell for cell in self.cells.get(column, ()) if cell]
        return bool(cells) and sum(map(is_clock, cells)) > len(cells) // 2

    def stamps(self) -> Stamps | None:
        """Time stamps of the first file; None without a time column. Times of day continue past midnight."""
        column = self.columns.time
        if column is None:
            return None
        clock = self.clock is not None
        values = replace(self, files=self.files[:1]).read([column])[:, 0]
        values = past_midnight(values) if clock else values
        return Stamps(column=column, values=values, unit=self.columns.time_unit, clock=clock)

    def times(self, rate: float | None) -> Times:
        """Times of the rows; `rate`, Hz, is the user's and overrides a time column."""
        if rate is not None:
            return times_without_column(rate, ())
        stamps = self.stamps()
        times = None if stamps is None else times_of_column(stamps)
        if times is not None and stamps is not None:
            span = len(stamps.values) / times.rate
            if len(self.files) > 1 or span >= _SHORTEST_SESSION:
                return times
            remark = f"time: all of the log is {span:.3g} s by its times, too short to turn and rest in"
            return replace(times, remarks=(*times.remarks, f"{remark}: is the unit right?"))
        assumed = times_without_column(None, self.preamble)
        if stamps is None:
            return assumed
        remark = f"time: column {stamps.column!r} does not grow and is not used"
        return replace(assumed, remarks=(remark, *assumed.remarks))

    def with_stated(self, stated: Stated, units: Mapping[str, str]) -> ForeignLog:
        """Assign sensors and time as the user states them, by column name or number from 1, and their units.

        A column that is stated loses any other role. Raises InputError for a column that does not exist."""
        columns = {kind: tuple(self._named(kind, c.strip()) for c in listed) for kind, listed in stated.items()}
        taken = [c for listed in columns.values() for c in listed]
        for kind, listed in columns.items():
            if len(listed) != (1 if kind == TIME_KIND else 3) or any(taken.count(c) > 1 for c in listed):
                three = "three columns that are nothing else, with commas between"
                expected = "one column" if kind == TIME_KIND else three
                raise InputError(f"--{kind}: expected {expected}, found {','.join(stated[kind])}")
        named = self.columns
        triads = {kind: s for kind, s in named.triads.items() if kind not in columns and not {*s.columns} & {*taken}}
        for kind in columns.keys() - {TIME_KIND}:
            x, y, z = columns[kind]
            triads[kind] = Sensors(columns=(x, y, z), unit=unit_of_name(kind, x))
        triads |= {kind: replace(triads[kind], unit=unit) for kind, unit in units.items() if kind in triads}
        if not taken:
            return self.with_columns(triads=triads)
        time = columns.get(TIME_KIND, (None if named.time in taken else named.time,))[0]
        return self.with_columns(
            [f"{kind}: {', '.join(listed)}, as stated" for kind, listed in columns.items()],
            triads=triads,
            time=time,
            time_unit=None if time is None else time_unit(time),
            times=named.times if time == named.time else (),
            temperatures=tuple(c for c in named.temperatures if c not in taken),
        )

    def _named(self, kind: str, column: str) -> str:
        """Name of the column with this name, or with this number from 1."""
        names = self.names
        if column in names:
            return column
        if column.isdecimal() and 0 < int(column) <= len(names):
            return names[int(column) - 1]
        raise InputError(
            f"{self.files[0]}: --{kind}: expected names of columns, or numbers from 1 to {len(names)}, found "
            f"{column!r}; there are {', '.join(names[:SHOWN])[:200]}{did_you_mean(column, names)}"
        )

    def check_has_sensors(self, *, gyros_suffice: bool) -> None:
        """Raise InputError if there are no accelerometers (or gyros, where these suffice), and for a short table
        without times, which is a table of positions."""
        rows = max(map(len, self.cells.values()), default=_FEWEST_ROWS)
        alone = len(self.files) == 1 and self.columns.time is None and GYRO not in self.columns.triads
        if rows < _FEWEST_ROWS and alone:
            raise InputError(
                f"{self.files[0]}: expected a recording, found a table of {rows} rows; a table of mean readings, a row "
                f"a position, is calibrated by `tumble ellipsoid {self.files[0].name}`"
            )
        if ACCEL in self.columns.triads or (gyros_suffice and GYRO in self.columns.triads):
            return
        names, found = self.names, ", ".join(self.names[:SHOWN])[:200]
        expected = "columns named as accelerometers are, such as ax, ay, az or acc_x, acc_y, acc_z"
        remedy = "log the readings of the accelerometers too"
        if GYRO in self.columns.triads:
            found = f"gyros alone ({', '.join(self.columns.triads[GYRO].columns)[:120]})"
            remedy += f"; of gyros alone tumble calibrate {self.files[0].name} tells the biases, tumble noise the noise"
        elif len(names) == len("xyz") and all(map(str.isdecimal, names)):
            expected, found = "a recording", "three columns without names that are no sensor by their numbers"
            remedy = "of a table with a row a position write `x,y,z` above the rows and give it to `tumble ellipsoid`"
        elif any(_FUSED.search(name) for name in names):
            expected = "readings of accelerometers"
            found = f"gravity and acceleration without it, which a filter has made of them ({found[:120]})"
            remedy = "log the raw accelerometers"
        elif sum(not is_no_sensor(name) for name in names) >= len("xyz"):
            remedy = "state which they are (--accel N,N,N, names or numbers from 1)"
        kind = GyrosAloneError if GYRO in self.columns.triads else InputError
        raise kind(f"{self.files[0]}: expected {expected}; found {found}; {remedy}")


def samples_in(read: Array) -> int:
    """Number of rows (m, n) before a long stretch of identical or empty rows at the end, with which a logger fills
    memory in advance; m where there is none."""
    if not len(read):
        return 0
    alike = ((read == read[-1]) | ~np.isfinite(read)).all(axis=1)
    last = int(np.flatnonzero(~alike)[-1]) + 1 if not alike.all() else len(read)
    return last if len(read) - last >= _FILLED else len(read)
