"""A log as it came: its files, how they are written, and which of their columns are what.

What a session file cannot say about a log is mended in a copy (log.parquet in the session's folder): numbers of 16 bits
that were read without their sign, times in ticks, samples that a counter shows to be missing, positions that follow
each other without a turn between them, sensors in files of their own.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from tumble.calibration.log_times import Stamps, Times, overflow_of, times_of_column, times_without_column, unwound
from tumble.calibration.raw_scale import unwrapped, wrapped
from tumble.calibration.respelled import respelled
from tumble.calibration.sensor_rows import files_by_sensor
from tumble.errors import InputError
from tumble.recording import formats
from tumble.recording.dialect import LINE_BYTES, Dialect, Top, dialect_of, is_clock
from tumble.recording.formats.columns import (
    ACCEL,
    GYRO,
    MAGNETOMETER,
    SENSOR_WORDS,
    Columns,
    columns_by_name,
    time_unit,
)
from tumble.recording.formats.columns_by_data import columns_by_data, time_by_data
from tumble.recording.formats.message import TIME, Message, Sensors
from tumble.recording.gaps import is_likely
from tumble.recording.readers import ENDINGS, LogSource, opened, readable, source_of, text_tables
from tumble.recording.writer import write_tables
from tumble.units import TIME_UNITS, Array

LONGEST = 2_000_000
"""Rows that are looked at."""

_SEEN_BYTES = 1 << 18
_SAMPLE_ROWS = 200
_FEWEST_ROWS = 50
_JUMP = 0.2
_LABEL = re.compile(
    r"part|pos(ition)?|pose|label|section|segment|step|lage|stellung|положение|позиция|位置", re.IGNORECASE
)
_TICK = 1e-4  # s, of an Xsens SampleTimeFine
_SHOWN = 12


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
        for file in self.files:
            yield source_of(file, self.dialect)

    def read(self, columns: Sequence[str], *, rows: int = LONGEST, clock: str | None = None) -> Array:
        """The first rows of some columns, of all files."""
        found, count = [np.empty((0, len(columns)))], 0
        for source in self.sources():
            for table, _ in source.tables(columns, clock):
                read = table.select(columns).to_numpy()[: rows - count]
                found.append(np.where(is_likely(read), read, np.nan))
                count += len(found[-1])
                if count >= rows:
                    return np.concatenate(found)
        return np.concatenate(found)

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


# -------------------- files --------------------


def files_of(log: Path) -> list[Path]:
    """The files that a path means: itself, those of a folder, or those that a pattern fits."""
    if log.is_dir():
        if (log / "metadata.yaml").is_file():
            return [log]
        found = [file for file in log.iterdir() if file.is_file() and not file.name.startswith(".")]
        found = [
            file for file in found if file.suffix.lower() not in (".toml", ".json", ".md", ".pdf", ".png", ".html")
        ]
        if not found:
            raise InputError(f"{log}: expected a folder with logs, found none in it")
        return sorted(found, key=_natural)
    if not log.exists() and set(log.name) & set("*?["):
        found = sorted(log.parent.glob(log.name), key=_natural)
        if not found:
            raise InputError(f"{log}: expected files that fit this pattern, found none")
        return found
    if not log.exists():
        raise InputError(f"{log}: expected a log, found no such file")
    return [log]


def _natural(path: Path) -> list[tuple[int, str]]:
    """Names in the order of the numbers in them: pos2 before pos10."""
    return [(int(part) if re.fullmatch("[0-9]{1,18}", part) else -1, part) for part in re.split(r"([0-9]+)", path.name)]


def found_log(files: Sequence[Path], folder: Path) -> FoundLog:
    """What text and Parquet files are. Raises InputError for those that are no logs, or not alike."""
    parts = [part for file in files for part in files_by_sensor(file, folder) or [file]]
    logs, left = _those_with_rows(parts, folder)
    if len(logs) > 1 and not any(log.columns.triads for log in logs):
        apart = _of_sensors_apart(logs, folder)
        return replace(apart, said=(*apart.said, *left))
    logs = [_by_data(log) if ACCEL not in log.columns.triads else _with_time(log) for log in logs]
    first = logs[0]
    for log in logs[1:]:
        if (
            log.keys != first.keys
            or log.columns.triads != first.columns.triads
            or log.columns.time != first.columns.time
        ):
            raise InputError(
                f"{log.files[0]}: expected a log written as {first.files[0].name} is, found another; give them to "
                "sessions of their own"
            )
    _check_has_accelerometers(first)
    said = first.said + ((f"{len(logs)} files, each a recording of its own",) if len(logs) > 1 else ()) + left
    return replace(first, files=tuple(file for log in logs for file in log.files), said=said)


class _NoRowsError(InputError):
    """A text file without rows of readings."""


def _those_with_rows(files: Sequence[Path], folder: Path) -> tuple[list[FoundLog], tuple[str, ...]]:
    """What the files are, and what is said of those left out: text without rows of readings beside logs that have
    some, as the metadata that a phone writes."""
    logs: list[FoundLog] = []
    without: list[_NoRowsError] = []
    said: list[str] = []
    for file in files:
        try:
            logs.append(_found(file, folder))
        except _NoRowsError as error:
            without.append(error)
            said.append(f"{file.name} has no rows of readings and is left out")
    if not logs:
        raise without[0]
    return logs, tuple(said)


def _found(file: Path, folder: Path) -> FoundLog:
    if file.suffix.lower() == ".parquet":
        return FoundLog(files=(file,), keys={}, columns=columns_by_name(source_of(file).names))
    with readable(file), opened(file) as stream:
        seen = stream.read(_SEEN_BYTES)
    if not seen:
        raise InputError(f"{file}: expected a log, found an empty file")
    copied = respelled(file, seen, folder)
    if copied is not None:
        log = _found(copied[0], folder)
        return replace(log, said=(copied[1], *log.said))
    dialect_and_top = dialect_of(seen)
    if dialect_and_top is None:
        if max(map(len, seen.split(b"\n"))) > LINE_BYTES // 8 or b"\0" in seen[:1000]:
            raise InputError(f"{file}: expected a log of rows of numbers, found something else; is it a recording?")
        raise _NoRowsError(f"{file}: expected rows of readings below the names of the columns, found none")
    return _found_text(file, seen, *dialect_and_top)


def _found_text(file: Path, seen: bytes, dialect: Dialect, top: Top) -> FoundLog:
    plain = dialect == Dialect() and top.lines == 1 and "".join(file.suffixes[-2:]).lower().endswith(ENDINGS)
    lines = seen.decode(dialect.encoding, errors="replace").split("\n")[top.lines : top.lines + _SAMPLE_ROWS]
    rows = [row for line in lines if len(row := dialect.cells(line)) == len(top.names)]
    if len(rows) < 2:
        raise _NoRowsError(f"{file}: expected rows of readings below the names of the columns, found none")
    cells = {name: [row[j] for row in rows] for j, name in enumerate(top.names) if name}
    log = FoundLog(
        files=(file,),
        keys={} if plain else _keys(dialect),
        columns=columns_by_name([name for name in top.names if top.names.count(name) == 1]),
        remarks=top.remarks,
        cells=cells,
        said=() if plain else (_described(dialect, top),),
        dialect=None if plain else dialect,
    )
    if log.columns.time is None:
        clock = next((name for name in cells if log.is_clock(name)), None)
        log = replace(log, columns=replace(log.columns, time=clock))
    return log


def _keys(dialect: Dialect) -> dict[str, Any]:
    """What differs from a plain CSV file, and the delimiter."""
    keys: dict[str, Any] = {"delimiter": dialect.delimiter}
    for key in ("decimal", "comment", "header", "encoding"):
        if getattr(dialect, key) != getattr(Dialect(), key):
            keys[key] = getattr(dialect, key)
    return keys


_DELIMITER_WORDS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "blanks"}


def _described(dialect: Dialect, top: Top) -> str:
    parts = [f"{_DELIMITER_WORDS[dialect.delimiter]} between the values"]
    parts += ["decimal commas"] if dialect.decimal == "," else []
    parts += [dialect.encoding] if dialect.encoding != "utf-8" else []
    parts += ["columns without names"] if not dialect.header else []
    parts += [f"{top.lines} lines above the numbers"] if top.lines > 1 else []
    return f"text: {', '.join(parts)}"


def _numeric(log: FoundLog) -> list[str]:
    """Columns of numbers."""
    if not log.cells:
        schema = pl.scan_parquet(log.files[0], glob=False).collect_schema()
        return [name for name, kind in schema.items() if kind.is_numeric()]
    is_number = (log.dialect or Dialect()).is_number
    return [name for name, cells in log.cells.items() if sum(map(is_number, cells)) > len(cells) // 2]


def _by_data(log: FoundLog) -> FoundLog:
    """A log whose sensors are told by their numbers, if they can be."""
    names = list(next(iter(log.sources())).names)
    numeric = [name for name in _numeric(log) if names.count(name) == 1]
    if len(numeric) < 3:
        return log
    found = columns_by_data(numeric, log.read(numeric, rows=LONGEST // 10))
    time, unit = log.columns.time, log.columns.time_unit
    columns = replace(found, time=time or found.time, time_unit=unit, counter=log.columns.counter)
    if ACCEL not in found.triads:
        return log
    said = [f"{kind}: columns {', '.join(s.columns)}, by their numbers (a guess)" for kind, s in found.triads.items()]
    return replace(log, columns=columns, said=(*log.said, *said))


def _with_time(log: FoundLog) -> FoundLog:
    """A log whose time, if no name says which column it is, is one that grows as times do."""
    if log.columns.time is not None:
        return log
    known = {log.columns.counter, *(c for triad in log.columns.triads.values() for c in triad.columns)}
    names = [name for name in _numeric(log) if name not in known]
    if not names:
        return log
    time = time_by_data(names, log.read(names, rows=LONGEST // 10))
    if time is None:
        return log
    said = f"time: column {time!r}, by its numbers (a guess)"
    return replace(log, columns=replace(log.columns, time=time, time_unit=time_unit(time)), said=(*log.said, said))


def _check_has_accelerometers(log: FoundLog) -> None:
    if ACCEL not in log.columns.triads:
        names = ", ".join(next(iter(log.sources())).names[:_SHOWN])
        raise InputError(
            f"{log.files[0]}: expected columns named as accelerometers are, such as ax, ay, az or acc_x, acc_y, acc_z; "
            f"found {names[:200]}; rename them"
        )


# -------------------- when --------------------


def times_of(log: FoundLog, rate: float | None) -> Times:
    """When the rows of a log were taken; `rate` as given, Hz."""
    if rate is not None:
        return times_without_column(rate, ())
    stamps = log.stamps()
    times = None if stamps is None else times_of_column(stamps)
    if times is not None:
        return times
    assumed = times_without_column(None, log.remarks)
    if stamps is None:
        return assumed
    return replace(assumed, said=(f"time: column {stamps.column!r} does not grow and is not used", *assumed.said))


# -------------------- copies --------------------


def mended(log: FoundLog, folder: Path, rate: float | None) -> FoundLog:
    """A log, or the copy of one of which a session file cannot say what it needs."""
    for kind, sensors in log.columns.triads.items():
        if kind != MAGNETOMETER and not np.isfinite(log.read(sensors.columns, rows=_SAMPLE_ROWS)).any():
            raise InputError(f"{log.files[0]}: expected numbers in {', '.join(sensors.columns)[:200]}, found none")
    wraps = [k for k in (ACCEL, GYRO) if k in log.columns.triads and wrapped(log.read(log.columns.triads[k].columns))]
    steps: list[str] = []
    if wraps:
        named = " and ".join({ACCEL: "accelerometers", GYRO: "gyros"}[k] for k in wraps)
        steps.append(f"{named}: numbers of 16 bits that were read without their sign: 65536 taken off where it is due")
    tick = _tick(log) if rate is None else None
    if tick is not None:
        steps.append(f"time: column {log.columns.time!r} in ticks of {tick:g} s, made seconds")
    overflow = _overflow(log) if rate is None else None
    if overflow is not None:
        steps.append(
            f"time: column {log.columns.time!r} starts anew at {overflow:.10g}: that much is added where it does"
        )
    counter = _counting(log) if log.columns.time is None else None
    if counter is not None:
        steps.append(f"time: none, but column {counter!r} counts the samples and shows some to be missing")
    edges = _positions(log, wraps) if len(log.files) == 1 else None
    if edges is not None:
        shortest = min(b - a for a, b in edges)
        if shortest < _FEWEST_ROWS:
            raise InputError(
                f"{log.files[0]}: expected at least {_FEWEST_ROWS} rows a position, found {shortest}; take the mean of "
                "each position and give the table to `tumble ellipsoid`"
            )
        steps.append(f"{len(edges)} positions one below the other without turns: a file each")
    if not steps:
        return log
    per_second = rate or times_without_column(None, log.remarks).rate
    factor = tick if tick is not None else 1.0 / per_second if counter is not None else None
    column = log.columns.time if tick is not None else counter
    time = None if factor is None or column is None else (column, factor)
    return _copied(log, folder, wraps, time, overflow, edges, steps)


def _copied(
    log: FoundLog,
    folder: Path,
    wraps: Sequence[str],
    time: tuple[str, float] | None,
    overflow: float | None,
    edges: Sequence[tuple[int, int]] | None,
    steps: Sequence[str],
) -> FoundLog:
    """The columns that matter, mended, as Parquet files in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    sensors = [c for triad in log.columns.triads.values() for c in triad.columns]
    signed = [c for kind in wraps for c in log.columns.triads[kind].columns]
    used = [
        c
        for c in (log.columns.time if time is None else time[0], *sensors, *dict.fromkeys(log.columns.temperatures))
        if c is not None
    ]
    clock = log.columns.time if log.columns.time is not None and log.is_clock(log.columns.time) else None
    stamp = log.columns.time if time is None else TIME

    def tables(source: LogSource) -> Iterator[pl.DataFrame]:
        last: float | None = None
        for read, _ in source.tables(used, clock):
            table = read.with_columns(pl.Series(c, unwrapped(read[c].to_numpy())) for c in signed)
            if overflow is not None:
                stamps = unwound(read[used[0]].to_numpy(), overflow, last)
                last = next((float(t) for t in stamps[::-1] if np.isfinite(t)), last)
                table = table.with_columns(pl.Series(used[0], stamps))
            if time is not None:
                table = table.rename({time[0]: TIME}).with_columns(pl.col(TIME) * time[1])
            yield table if stamp is None else table.filter(pl.col(stamp).is_finite())

    files: list[Path] = []
    if edges is not None:
        whole = pl.concat(tables(next(iter(log.sources()))))
        for number, (start, stop) in enumerate(edges, 1):
            files.append(folder / f"position-{number:02d}.parquet")
            write_tables(files[-1], iter([whole.slice(start, stop - start)]))
    else:
        for number, source in enumerate(log.sources(), 1):
            files.append(folder / ("log.parquet" if len(log.files) == 1 else f"log-{number:02d}.parquet"))
            write_tables(files[-1], tables(source))
    columns = replace(log.columns, time=stamp, time_unit="s" if time is not None or clock else log.columns.time_unit)
    said = (*log.said, *steps, f"so mended, the log is copied to {files[0].name}{' …' if len(files) > 1 else ''}")
    return FoundLog(files=tuple(files), keys={}, columns=columns, remarks=log.remarks, said=said)


def _overflow(log: FoundLog) -> float | None:
    """The number at which the counter behind the time stamps starts anew, where it does."""
    column = log.columns.time
    return None if column is None or log.is_clock(column) else overflow_of(log.read([column])[:, 0])


def _tick(log: FoundLog) -> float | None:
    """The unit, s, of an Xsens SampleTimeFine: microseconds where steps are thousands."""
    column = log.columns.time
    if (
        column is None
        or log.columns.time_unit is not None
        or "sampletimefine" not in re.sub(r"\W|_", "", column.lower())
    ):
        return None
    step = float(np.nanmedian(np.diff(log.read([column], rows=10_000)[:, 0])))
    return _TICK if step < 2000.0 else None


def _counting(log: FoundLog) -> str | None:
    """A column that counts the samples and jumps here and there."""
    column = log.columns.counter
    if column is None:
        return None
    steps = np.diff(log.read([column])[:, 0])
    steps = steps[np.isfinite(steps)]
    return column if len(steps) and (steps >= 1.0).all() and np.median(steps) == 1.0 and (steps > 1.0).any() else None


def _positions(log: FoundLog, wraps: Sequence[str]) -> list[tuple[int, int]] | None:
    """First and last + 1 row of positions that follow each other without a turn: by a column that names them, or where
    gravity jumps from one row to the next while nothing moves before and after."""
    accel = log.read(log.columns.triads[ACCEL].columns)
    accel = unwrapped(accel) if ACCEL in wraps else accel
    if len(accel) < 2 * _FEWEST_ROWS or len(accel) == LONGEST:
        return None
    label = next((n for n in log.cells if _LABEL.fullmatch(n.strip()) and n != log.columns.time), None)
    at = _label_changes(log, label) if label is not None else _jumps(accel)
    if at is None or len(at) < 3:
        return None
    edges = [0, *at, len(accel)]
    return list(pairwise(edges))


def _label_changes(log: FoundLog, label: str) -> list[int] | None:
    """Rows where a column that names positions changes."""
    source = next(iter(log.sources()))
    tables = [table[label] for table in _text_columns(source, label)]
    labels = pl.concat(tables)
    return (np.flatnonzero((labels != labels.shift(1)).fill_null(False).to_numpy())).tolist()


def _text_columns(source: LogSource, label: str) -> Iterator[pl.DataFrame]:
    for table in text_tables(source, ()):
        yield table.select(pl.col(label).cast(pl.String))


def _jumps(accel: Array) -> list[int] | None:
    """Rows at which the specific force is another than in the row before, while ten rows before and behind are
    steady."""
    about = accel - np.nanmedian(accel, axis=0)
    size = float(np.nanmedian(np.linalg.norm(about, axis=1)))
    steps = np.linalg.norm(np.diff(accel, axis=0), axis=1)
    candidates = np.flatnonzero(steps > _JUMP * size) + 1
    if not 3 <= len(candidates) <= len(accel) // _FEWEST_ROWS + 1:
        return None
    found = []
    for k in candidates.tolist():
        before, behind = accel[max(k - 10, 0) : k], accel[k : k + 10]
        scatter = max(np.ptp(before, axis=0).max(), np.ptp(behind, axis=0).max())
        if scatter < 0.5 * float(np.linalg.norm(behind.mean(axis=0) - before.mean(axis=0))) and scatter < _JUMP * size:
            found.append(k)
    return found if len(found) == len(candidates) else None


# -------------------- sensors in files of their own --------------------

_UNCALIBRATED = re.compile(r"acc.*uncal", re.IGNORECASE)
_NOT_ACCEL = re.compile(r"linear|user|uncal|without|\bno[_ ]?g", re.IGNORECASE)


def _of_sensors_apart(logs: Sequence[FoundLog], folder: Path) -> FoundLog:
    """Accelerometers and gyros that come in a file each, as of phones, as one log at the times of the gyros."""
    by_kind: dict[str, FoundLog] = {}
    for log in logs:
        name = log.files[0].stem
        kind = next((k for k, pattern in SENSOR_WORDS.items() if pattern.search(name)), None)
        if kind is not None and not (kind == ACCEL and _NOT_ACCEL.search(name)):
            by_kind.setdefault(kind, log)
    uncalibrated = next((log for log in logs if _UNCALIBRATED.search(log.files[0].stem)), None)
    if ACCEL not in by_kind and uncalibrated is not None:
        by_kind[ACCEL] = uncalibrated
    if ACCEL not in by_kind:
        _check_has_accelerometers(logs[0])
    accel, gyro = _message(by_kind[ACCEL], ACCEL), _message(by_kind[GYRO], GYRO) if GYRO in by_kind else None
    folder.mkdir(parents=True, exist_ok=True)
    formats.as_log(folder / "log.parquet", accel, gyro)
    triads = {ACCEL: accel.accel, GYRO: gyro.gyro if gyro is not None else None}
    named = " and ".join(log.files[0].name for log in by_kind.values())
    columns = Columns(
        time=TIME,
        time_unit="s",
        triads={kind: sensors for kind, sensors in triads.items() if sensors is not None},
        temperatures=(),
        others=(),
    )
    said = f"{named}: one log at the times of the gyros, written to {folder / 'log.parquet'}"
    return FoundLog(files=(folder / "log.parquet",), keys={}, columns=columns, said=(said,))


def _message(log: FoundLog, kind: str) -> Message:
    """The three columns of the one kind of sensors in a log, with their times, s."""
    renamed = {name: f"{'a' if kind == ACCEL else 'g'} {name.split()[0] if name else name}" for name in log.cells}
    known = columns_by_name(renamed.values())
    named = {new: old for old, new in renamed.items()}
    stamps, sensors = log.stamps(), known.triads.get(kind)
    times = None if stamps is None else times_of_column(stamps)
    if sensors is None or stamps is None or times is None:
        raise InputError(
            f"{log.files[0]}: expected a time and columns x, y and z, found {', '.join(list(log.cells)[:_SHOWN])}; "
            "rename them"
        )
    source = [named[column] for column in sensors.columns]
    unit = columns_by_name([f"{'acc' if kind == ACCEL else 'gyro'} {n}" for n in source]).triads[kind].unit
    x, y, z = (f"{kind}_{axis}" for axis in "xyz")
    read = log.read([stamps.column, *source], clock=stamps.column if stamps.clock else None)
    read[:, 0] *= 1.0 if stamps.clock else TIME_UNITS[times.keys.get("time_unit", "s")]
    found = Sensors(columns=(x, y, z), unit=unit)
    return Message(
        name=log.files[0].name,
        count=len(read),
        accel=found if kind == ACCEL else None,
        gyro=found if kind == GYRO else None,
        rows=lambda: iter([pl.DataFrame(read[np.isfinite(read).all(axis=1)], schema=[TIME, x, y, z], orient="row")]),
    )
