"""A foreign log: its files, how they are written, and what its columns are."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tumble.drafting.times import Stamps, Times, times_of_column, times_without_column
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
from tumble.recording.readers import KeptLog, source_of
from tumble.recording.rows.gaps import is_reading
from tumble.recording.text.dialect import Dialect, is_clock
from tumble.reduction.blocks.tuning import USUAL
from tumble.units import Array

LONGEST = 2_000_000
"""Rows that are looked at."""

HEAD_ROWS = 20_000
SAMPLE_ROWS = 200
_FUSED = re.compile(r"grav|(user|free|linear)_?acc(?!.*cov)|\blacc", re.IGNORECASE)
SHOWN = 12
_NEAR = 0.1
_FEWEST_ROWS = 50
_SHORTEST_SESSION = 4 * USUAL.rest
"""s: what four rests alone take, and fewer tell nothing."""
_FILLED = 50
"""Rows that are alike in all sensors, at the end of a log, are no samples if they are as many."""

Stated = Mapping[str, Sequence[str]]
"""Columns by what they are: three of "accel" and of "gyro", one of "time"; nothing where none are stated."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ForeignLog:
    """Files of one kind, the keys of [log] that say how they are written, their columns, what was said above the
    numbers, cells of the first rows by column, and what there is to say."""

    files: tuple[Path, ...]
    keys: Mapping[str, Any]
    columns: Columns
    remarks: tuple[str, ...] = ()
    cells: Mapping[str, Sequence[str]] = field(default_factory=dict)
    said: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    """What is not sure, each with what hangs on it and how it is settled."""
    dialect: Dialect | None = None
    kept: dict[Path, KeptLog] = field(default_factory=dict)
    """The files that were read, by their paths: every look at them is at what was read once."""

    def with_columns(self, said: Sequence[str] = (), /, **changed: Any) -> ForeignLog:
        """The log with other columns of these kinds, and what there is to say of them."""
        return replace(self, columns=replace(self.columns, **changed), said=(*self.said, *said))

    def sources(self) -> Iterator[KeptLog]:
        """The files, as they are read."""
        for file in self.files:
            path = file.resolve()
            if path not in self.kept:
                self.kept[path] = KeptLog(source_of(file, self.dialect))
            yield self.kept[path]

    @property
    def names(self) -> tuple[str, ...]:
        """The columns of the first file."""
        return next(self.sources()).names

    @property
    def unnamed(self) -> bool:
        """Whether the columns of a text have no names, and so numbers from 1."""
        return all(map(str.isdecimal, self.cells))

    @property
    def clock(self) -> str | None:
        """The column of times of day, where that of the time is one."""
        column = self.columns.time
        return column if column is not None and self.is_clock(column) else None

    def read(self, columns: Sequence[str], *, rows: int = LONGEST) -> Array:
        """The first rows of some columns, of all files; those that a session would read are read together. Of times of
        day seconds, NaN for what is no reading."""
        known = self.columns
        sensors = [c for kind in ("accel", "gyro") if kind in known.triads for c in known.triads[kind].columns]
        together = [c for c in (known.time, *sensors) if c is not None]
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
        """The numbers in the first rows of a column; where there are none, those in all; none where it cannot be
        read."""
        with suppress(LogError):
            for rows in (HEAD_ROWS, LONGEST):
                numbers = self.read([column], rows=rows)[:, 0]
                if np.isfinite(numbers).any():
                    return numbers[np.isfinite(numbers)]
        return np.empty(0)

    def reads_gravity(self, columns: Sequence[str]) -> bool:
        """Whether three columns, if they are some, have the length of gravity in a unit, at the median."""
        length = np.linalg.norm(self.read(columns, rows=HEAD_ROWS), axis=1) if columns else np.empty(0)
        median = float(np.nanmedian(length)) if np.isfinite(length).any() else 0.0
        return any(c.unit is not None and abs(median / c.value - 1.0) < _NEAR for c in CANDIDATES[ACCEL])

    def is_clock(self, column: str) -> bool:
        """Whether a column has times of day."""
        cells = [cell for cell in self.cells.get(column, ()) if cell]
        return bool(cells) and sum(map(is_clock, cells)) > len(cells) // 2

    def stamps(self) -> Stamps | None:
        """The time stamps of the first file, if it has any; times of day go on past midnight."""
        column = self.columns.time
        if column is None:
            return None
        clock = self.clock is not None
        values = replace(self, files=self.files[:1]).read([column])[:, 0]
        if clock:
            values = values + 86400.0 * np.cumsum(np.diff(values, prepend=values[:1]) < -43200.0)
        return Stamps(column=column, values=values, unit=self.columns.time_unit, clock=clock)

    def times(self, rate: float | None) -> Times:
        """When the rows were taken; `rate` as given, Hz."""
        if rate is not None:
            return times_without_column(rate, ())
        stamps = self.stamps()
        times = None if stamps is None else times_of_column(stamps)
        if times is not None and stamps is not None:
            span = len(stamps.values) / times.rate
            if len(self.files) > 1 or span >= _SHORTEST_SESSION:
                return times
            said = f"time: all of the log is {span:.3g} s by its times, too short to turn and rest in"
            return replace(times, said=(*times.said, f"{said}: is the unit right?"))
        assumed = times_without_column(None, self.remarks)
        if stamps is None:
            return assumed
        return replace(assumed, said=(f"time: column {stamps.column!r} does not grow and is not used", *assumed.said))

    def with_stated(self, stated: Stated, units: Mapping[str, str]) -> ForeignLog:
        """The log with sensors and time as the user states them, by name or by number from 1, and in stated units.

        What these columns were taken for otherwise is dropped. Raises InputError for columns that it does not have."""
        columns = {kind: tuple(self._named(kind, c.strip()) for c in listed) for kind, listed in stated.items()}
        taken = [c for listed in columns.values() for c in listed]
        if not taken:
            return self._in_units(units)
        for kind, listed in columns.items():
            if len(listed) != (1 if kind == TIME_KIND else 3) or any(taken.count(c) > 1 for c in listed):
                three = "three columns that are nothing else, with commas between"
                expected = "one column" if kind == TIME_KIND else three
                raise InputError(f"--{kind}: expected {expected}, found {','.join(stated[kind])}")
        known = self.columns
        triads = {kind: s for kind, s in known.triads.items() if kind not in columns and not {*s.columns} & {*taken}}
        for kind in columns.keys() - {TIME_KIND}:
            x, y, z = columns[kind]
            triads[kind] = Sensors(columns=(x, y, z), unit=unit_of_name(kind, x))
        time = columns.get(TIME_KIND, (None if known.time in taken else known.time,))[0]
        return self.with_columns(
            [f"{kind}: {', '.join(listed)}, as stated" for kind, listed in columns.items()],
            triads=triads,
            time=time,
            time_unit=None if time is None else time_unit(time),
            times=known.times if time == known.time else (),
            temperatures=tuple(c for c in known.temperatures if c not in taken),
        )._in_units(units)

    def _in_units(self, units: Mapping[str, str]) -> ForeignLog:
        """The log with its sensors in stated units."""
        triads = self.columns.triads
        stated = {kind: replace(s, unit=units[kind]) for kind, s in triads.items() if kind in units}
        return self.with_columns(triads={**triads, **stated})

    def _named(self, kind: str, column: str) -> str:
        """The name of a column that is given by that, or by its number from 1."""
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
        """Raise InputError where no columns are those of accelerometers, nor of gyros where these suffice, and for a
        short table of accelerometers without times, which are positions."""
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
    """How many of the rows (m, n) of readings are samples: those before a stretch, at the end, of rows that are all
    alike or empty, as memory is filled with beforehand. All of them where that stretch is short."""
    if not len(read):
        return 0
    alike = ((read == read[-1]) | ~np.isfinite(read)).all(axis=1)
    last = int(np.flatnonzero(~alike)[-1]) + 1 if not alike.all() else len(read)
    return last if len(read) - last >= _FILLED else len(read)
