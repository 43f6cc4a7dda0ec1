"""A log of unknown form (`ForeignLog`), statements of the user about it (`Given`), and the draft of its session."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from tumble.diagnosis.turn_likelihood import WIDTHS, Widths
from tumble.drafting.times import Stamps, Times, times_of_column, times_without_column
from tumble.errors import GyrosAloneError, InputError, LogError, did_you_mean
from tumble.programme.positions import programmes
from tumble.recording.columns.names import (
    ACCEL,
    GYRO,
    MAGNETOMETER,
    NAMED,
    TIME_KIND,
    Columns,
    Sensors,
    is_no_sensor,
    time_unit,
    unit_of_name,
)
from tumble.recording.columns.numbers import differ_in_axis_alone, time_by_data
from tumble.recording.columns.scales import CANDIDATES
from tumble.recording.log_source import LogSource
from tumble.recording.readers import source_of
from tumble.recording.rows.gaps import is_reading
from tumble.recording.rows.timed import past_midnight
from tumble.recording.session import USUAL_RATE_U, Session
from tumble.recording.session_file import session_of, session_of_gyros
from tumble.recording.text.clock import is_clock
from tumble.recording.text.dialect import Dialect
from tumble.reduction.blocks.tuning import USUAL
from tumble.units import ACCEL_UNITS, GYRO_UNITS, Array

LONGEST = 2_000_000  # rows that are read to identify a log
HEAD_ROWS = 20_000
SAMPLE_ROWS = 200
SHOWN_NAMES = 12  # in a message
_REFUSALS = tomllib.loads(Path(__file__).with_name("refusals.toml").read_text(encoding="utf-8"))
_GRAVITY_TOLERANCE = 0.1  # of gravity
_FEWEST_ROWS = 50
_SHORTEST_SESSION = 4 * USUAL.rest  # s, the time of four rests; fewer determine nothing


@dataclass(frozen=True, kw_only=True, slots=True)
class Given:
    """Statements of the user about a log.

    `latitude` is in °, `height` in m, `sample_rate` in Hz; `message` names a message of a recording; columns are names
    or numbers from 1. Raises InputError for numbers and programmes that cannot be."""

    serial: str | None = None
    latitude: float | None = None
    height: float | None = None
    sample_rate: float | None = None
    programme: str | None = None
    message: str | None = None
    accel: Sequence[str] = ()
    gyro: Sequence[str] = ()
    time: str | None = None
    accel_unit: str | None = None
    gyro_unit: str | None = None

    def __post_init__(self) -> None:
        if self.programme is not None and self.programme not in programmes():
            raise InputError(f"--programme: expected one of {', '.join(programmes())}, found {self.programme!r}")
        for option, number, least, most, words in (
            ("latitude", self.latitude, -90.0, 90.0, "from -90 to 90"),
            ("height", self.height, -1000.0, 10000.0, "from -1000 to 10000, m"),
            ("sample-rate", self.sample_rate, 1e-6, 1e9, "from 1e-6 to 1e9 (Hz)"),
        ):
            if number is not None and not least <= number <= most:
                raise InputError(f"--{option}: expected a number {words}, found {number:g}")

    @property
    def units(self) -> dict[str, str]:
        """Stated units by kind of sensor. Raises InputError for units that session.toml lacks."""
        out = {}
        for kind, unit, units in ((ACCEL, self.accel_unit, ACCEL_UNITS), (GYRO, self.gyro_unit, GYRO_UNITS)):
            if unit is not None:
                out[kind] = unit if unit in units else unit_of_name(kind, f"x [{unit}]") or ""
                if not out[kind]:
                    hint = did_you_mean(unit, units)
                    raise InputError(f"--{kind}-unit: expected one of {', '.join(units)}, found {unit!r}{hint}")
        return out

    @property
    def columns(self) -> dict[str, Sequence[str]]:
        """Stated columns by role."""
        stated = {ACCEL: self.accel, GYRO: self.gyro, TIME_KIND: () if self.time is None else (self.time,)}
        return {kind: columns for kind, columns in stated.items() if columns}

    @property
    def options(self) -> list[str]:
        """Options by which columns and units are stated."""
        return [f"--{option}" for option in (*self.columns, *(f"{kind}-unit" for kind in self.units))]


NOTHING_GIVEN = Given()


@dataclass(frozen=True, kw_only=True, slots=True)
class ForeignLog:
    """Files in one dialect, with identified columns.

    `preamble`: lines above the numbers that are neither names nor units. `cells`: cells of the first rows by column,
    empty for Parquet. `remarks`, `doubts`: sentences for the user. `dialect`: None for plain CSV and for Parquet.
    `instance`: the column that separates several devices in the rows, with the value of the one that is read. `kept`:
    readers already opened, by path."""

    files: tuple[Path, ...]
    columns: Columns
    preamble: tuple[str, ...] = ()
    cells: Mapping[str, Sequence[str]] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    dialect: Dialect | None = None
    instance: Mapping[str, float] = field(default_factory=dict)
    kept: dict[Path, LogSource] = field(default_factory=dict)

    def with_columns(self, remarks: Sequence[str] = (), /, **changed: Any) -> ForeignLog:
        """Return a copy with some attributes of `columns` changed, and further remarks."""
        return replace(self, columns=replace(self.columns, **changed), remarks=(*self.remarks, *remarks))

    def sources(self) -> Iterator[LogSource]:
        """Yield readers of the files."""
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
    def numeric(self) -> list[str]:
        """Names of the columns of numbers."""
        if not self.cells:
            schema = pl.scan_parquet(self.files[0], glob=False).collect_schema()
            return [name for name, kind in schema.items() if kind.is_numeric()]
        is_number = (self.dialect or Dialect()).is_number
        return [name for name, cells in self.cells.items() if sum(map(is_number, cells)) > len(cells) // 2]

    def time_by_data(self) -> str | None:
        """Return a column of numbers that grows like a time, by its name no counter and no sensor; None without."""
        names = [n for n in self.numeric if n not in self.columns.sensors and not NAMED["counter"].fullmatch(n)]
        return time_by_data(names, self.read(names, rows=LONGEST // 10)) if names else None

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
        """Read the first rows of some columns of all files, (m, n), with seconds for times of day and NaN for no
        number.

        All columns that a session needs are read together, so that each file is parsed once."""
        named = self.columns
        sensors = [c for kind in (ACCEL, GYRO) if kind in named.triads for c in named.triads[kind].columns]
        together = [c for c in (named.time, *sensors) if c is not None]
        wanted = list(dict.fromkeys((*(together if set(columns) <= set(together) else columns), *self.instance)))
        parts, count = [np.empty((0, len(columns)))], 0
        for source in self.sources():
            for table, _ in source.tables(wanted, self.clock if self.clock in wanted else None):
                numbers = self.rows_of_instance(table).select(columns).to_numpy()[: rows - count]
                parts.append(np.where(is_reading(numbers), numbers, np.nan))
                count += len(numbers)
                if count >= rows:
                    return np.concatenate(parts)
        return np.concatenate(parts)

    def rows_of_instance(self, rows: pl.DataFrame) -> pl.DataFrame:
        """Return the rows of the instance that is read; all rows without instances."""
        return rows.filter(**self.instance) if self.instance else rows

    def readings(self, column: str) -> Array:
        """Return the numbers of a column in the first rows, or in all rows if the first rows have none."""
        with suppress(LogError):
            for rows in (HEAD_ROWS, LONGEST):
                numbers = self.read([column], rows=rows)[:, 0]
                if np.isfinite(numbers).any():
                    return numbers[np.isfinite(numbers)]
        return np.empty(0)

    def magnitude(self, columns: Sequence[str]) -> float:
        """Return the median magnitude of three columns in the first rows; 0 without readings."""
        lengths = np.linalg.norm(self.read(columns, rows=HEAD_ROWS), axis=1) if columns else np.empty(0)
        return float(np.nanmedian(lengths)) if np.isfinite(lengths).any() else 0.0

    def reads_gravity(self, columns: Sequence[str]) -> bool:
        """Return whether the magnitude of three columns is gravity in a known unit, or in counts of data sheets for
        whole numbers; False for no columns."""
        numbers = self.read(columns, rows=HEAD_ROWS) if columns else np.empty((0, 3))
        whole = np.array_equal(numbers, np.floor(numbers), equal_nan=True)
        units = [scale.value for scale in CANDIDATES[ACCEL] if scale.unit is not None or whole]
        return any(abs(self.magnitude(columns) / one_g - 1.0) < _GRAVITY_TOLERANCE for one_g in units)

    def is_clock(self, column: str) -> bool:
        """Return whether most cells of a column are times of day or dates."""
        cells = [cell for cell in self.cells.get(column, ()) if cell]
        return bool(cells) and sum(map(is_clock, cells)) > len(cells) // 2

    def stamps(self) -> Stamps | None:
        """Return the time stamps of the first file, continued past midnight; None without a time column."""
        column = self.columns.time
        if column is None:
            return None
        clock = self.clock is not None
        values = replace(self, files=self.files[:1]).read([column])[:, 0]
        values = past_midnight(values) if clock else values
        return Stamps(column=column, values=values, unit=self.columns.time_unit, clock=clock)

    def times(self, rate: float | None) -> Times:
        """Return the times of the rows; a stated `rate`, Hz, replaces a time column unless that shows the same rate."""
        if rate is not None:
            # the rate given may be rounded to its digits
            last_digit = 10.0 ** min(int(Decimal(str(rate)).normalize().as_tuple().exponent), 0)
            tolerance = min(0.5 * last_digit, USUAL_RATE_U * rate)
            shown = [t for t in self.stamped_times() if t.even and abs(t.rate - rate) <= tolerance]
            if not shown:
                return times_without_column(rate, ())
            remark = f"time: the column shows the rate given, {rate:g}"
            return replace(shown[0], rivals=(), remarks=(*shown[0].remarks, remark))
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
        remark = f"time: column {stamps.column!r} does not grow as a time does and is not used"
        return replace(assumed, remarks=(remark, *assumed.remarks))

    def stamped_times(self) -> list[Times]:
        """Return the times by the time column in every possible unit; none if it counts samples."""
        stamps = self.stamps()
        times = None if stamps is None else times_of_column(stamps)
        if stamps is None or times is None or (stamps.unit is None and np.median(np.diff(stamps.values)) == 1.0):
            return []
        return [each for each in (times, *times.rivals) if each.stamped]

    def with_stated(self, given: Given) -> ForeignLog:
        """Assign sensors and time as the user states them, by column name or number from 1, and their units.

        A stated column loses any other role. Raises InputError for a column that does not exist."""
        stated = given.columns
        columns = {kind: tuple(self._column(kind, c.strip()) for c in listed) for kind, listed in stated.items()}
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
        triads |= {kind: replace(triads[kind], unit=unit) for kind, unit in given.units.items() if kind in triads}
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

    def _column(self, kind: str, column: str) -> str:
        """Return the name of the column with this name, or with this number from 1."""
        names = self.names
        if column in names:
            return column
        if column.isdecimal() and 0 < int(column) <= len(names):
            return names[int(column) - 1]
        raise InputError(
            f"{self.files[0]}: --{kind}: expected names of columns, or numbers from 1 to {len(names)}, found "
            f"{column!r}; there are {', '.join(names[:SHOWN_NAMES])[:200]}{did_you_mean(column, names)}"
        )

    def check_has_sensors(self, *, gyros_suffice: bool) -> None:
        """Raise InputError without accelerometers (or gyros, where these suffice), and for a table of positions.

        A table of positions has few rows and no times."""
        triads, names = self.columns.triads, self.names
        name = self.files[0].name
        rows = max(map(len, self.cells.values()), default=_FEWEST_ROWS)
        if rows < _FEWEST_ROWS and len(self.files) == 1 and self.columns.time is None and GYRO not in triads:
            raise InputError(
                f"{self.files[0]}: expected a recording, found a table of {rows} rows; a table of mean readings, a row "
                f"a position, is calibrated by `tumble ellipsoid {name}`"
            )
        if ACCEL not in triads and (linear := list(filter(NAMED["linear_acceleration"].search, names))):
            raise linear_acceleration(self.files[0], linear)
        if ACCEL in triads or (gyros_suffice and GYRO in triads):
            return
        sensors = list(self.columns.sensors)
        known = {self.columns.time, *self.columns.temperatures, *sensors}
        unknown = [name for name in names if name not in known and not is_no_sensor(name)]
        others = [name for name in names if not is_no_sensor(name)]
        kind = "unknown" if len(others) >= 3 else "nothing"
        if GYRO in triads:
            understood = len(unknown) < 3 or not differ_in_axis_alone(unknown[:3])
            kind, sensors = "gyros" if understood else "gyros and unknown", list(triads[GYRO].columns)
        elif MAGNETOMETER in triads and len({*others} - {*triads[MAGNETOMETER].columns}) < 3:
            kind = "magnetometer"
        elif len(names) == 3 and all(map(str.isdecimal, names)):
            kind = "three columns"
        elif any(map(NAMED["gravity"].search, names)):
            kind = "gravity"
        words = {
            "names": ", ".join(names[:SHOWN_NAMES])[:200],
            "sensors": ", ".join(sensors)[:120],
            "unknown": ", ".join(unknown[:SHOWN_NAMES])[:120],
            "first": ",".join(unknown[:3]),
            "file": name,
        }
        message = "expected {expected}; found {found}; {remedy}".format(**_REFUSALS[kind]).format(**words)
        raise (GyrosAloneError if kind == "gyros" else InputError)(f"{self.files[0]}: {message}")


@dataclass(kw_only=True, slots=True)
class Draft:
    """The content of a session.toml as far as it is known, with remarks on how each part was found.

    `doubts` are uncertainties, each with its consequence and the option that settles it. `source` is the log, `given`
    what the user states about it, `times` are those of its rows. `widths` are the standard deviations of the cost of
    hypotheses. `magnetometer` is the table [log.magnetometer], written as a comment because nearby iron disturbs
    its readings."""

    source: ForeignLog
    times: Times
    content: dict[str, Any]
    remarks: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    magnetometer: dict[str, Any] | None = None
    given: Given = NOTHING_GIVEN
    widths: Widths = WIDTHS

    @property
    def log(self) -> dict[str, Any]:
        """The table [log]."""
        table: dict[str, Any] = self.content["log"]
        return table

    @property
    def rate(self) -> float:
        """Sample rate, Hz."""
        return self.times.rate

    @property
    def rate_guessed(self) -> bool:
        """Whether neither a column nor the user states the rate."""
        return bool(self.times.rivals) and not self.times.stamped

    @property
    def files(self) -> tuple[Path, ...]:
        """Paths of the files of the log."""
        file = self.log["file"]
        return tuple(map(Path, [file] if isinstance(file, str) else file))

    @property
    def triads(self) -> dict[str, Sensors]:
        """Accelerometers and gyros."""
        triads = self.source.columns.triads
        return {kind: triads[kind] for kind in (ACCEL, GYRO) if kind in triads}

    def say(self, *remarks: str) -> None:
        """Add remarks."""
        self.remarks += remarks

    def unit(self, kind: str) -> str | None:
        """Return the unit in the column names of a kind of sensor."""
        return self.triads[kind].unit

    def session(self, **log: Any) -> Session:
        """Return the session of the content, with other keys of [log], None for none, without reading files again."""
        table = {key: value for key, value in {**self.log, **log}.items() if value is not None}
        content = {**self.content, "log": table}
        session = session_of(content) if ACCEL in table else session_of_gyros(content)
        files = tuple(self.source.kept.get(Path(str(file)), file) for file in session.log.files)
        return replace(session, log=replace(session.log, files=files))


def linear_acceleration(file: Path, columns: Sequence[str]) -> InputError:
    """Return the error for accelerations without gravity in place of accelerometers."""
    return InputError(
        f"{file}: expected readings of accelerometers, found linear acceleration, which a filter has taken gravity off "
        f"({', '.join(columns)[:120]}); log the raw accelerometers"
    )
