"""What files of text or Parquet are: how they are written, and which columns are those of which sensors; and which
files hold no readings tumble can use, or hold them in a form that other programs read, and what to do."""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import polars as pl

from tumble.documents import check_regular
from tumble.drafting.containers.several_sensors import split_by_header, split_by_sensor, tables_of_json
from tumble.drafting.dialects.respelled import respelled
from tumble.drafting.found_log import LONGEST, SAMPLE_ROWS, FoundLog, Stated, samples_in
from tumble.drafting.mended import nanoseconds_of
from tumble.drafting.sensors_apart import are_sensors_apart, of_sensors_apart
from tumble.drafting.times import times_of_column
from tumble.errors import InputError
from tumble.files import OutputFolder
from tumble.recording.columns.names import ACCEL, GYRO, columns_by_name, is_no_sensor, time_unit, unit_of_name
from tumble.recording.columns.numbers import columns_by_data, time_by_data
from tumble.recording.log_source import readable
from tumble.recording.readers import ENDINGS, source_of
from tumble.recording.text.dialect import LINE_BYTES, Dialect, dialect_of, is_clock
from tumble.recording.text.pieces import opened

_SEEN_BYTES = 1 << 18
_GROWING = 0.9  # of the steps of stamps that are those of rows
_NO_LOGS = (".toml", ".json", ".md", ".pdf", ".png", ".html")
_DELIMITER_WORDS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "blanks"}
_BINARY = (
    (0, b"\xb5b", "UBX of a u-blox receiver", "write its ESF-RAW messages as a table with a row a sample (pyubx2)"),
    (0, b"$IMURAW", "IMR of Waypoint", "write it as text in Inertial Explorer"),
    (0, b"H Product:Blackbox", "a black box of Betaflight", "decode it with blackbox_decode, and give the .csv"),
    (0, b"\xfa\xff", "MTB of Xsens", "export it as text in MT Manager, with Acc and Gyr"),
    (4, b"ftyp", "a video", "write its sensors as CSV, of a GoPro with a reader of GPMF"),
    (0, b"TDSm", "TDMS of LabVIEW", "export it as CSV"),
    (0, b"SQLite format 3", "a database", "export its readings as CSV"),
    (0, b"%PDF", "a document", "give the file with the readings"),
    (257, b"ustar", "an archive of several files (tar)", "unpack it, and give its files"),
)
_RECORD = struct.Struct("<17d")
_WEEK, _HALF_TURN = 604_800.0, 3.1416
_OXTS = 30


def files_of(log: Path) -> list[Path]:
    """The files that a path means: itself, those of a folder, or those that a pattern fits, in the order of the numbers
    in their names: pos2 before pos10."""
    pattern = not log.exists() and bool(set(log.name) & set("*?["))
    if log.is_dir() and not (log / "metadata.yaml").is_file():
        files = [file for file in log.iterdir() if file.is_file() and not file.name.startswith(".")]
        files = [file for file in files if file.suffix.lower() not in _NO_LOGS]
        missing = "a folder with logs, found none in it"
    elif pattern:
        files, missing = list(log.parent.glob(log.name)), "files that fit this pattern, found none"
    else:
        check_regular(log)
        files, missing = [log] if log.exists() else [], "a log, found no such file"
    if not files:
        raise InputError(f"{log}: expected {missing}")

    def natural(path: Path) -> list[tuple[int, str]]:
        parts = re.split(r"([0-9]+)", path.name)
        return [(int(part) if re.fullmatch("[0-9]{1,18}", part) else -1, part) for part in parts]

    return sorted(files, key=natural)


def found_log(files: Sequence[Path], folder: OutputFolder, stated: Stated = MappingProxyType({})) -> FoundLog:
    """What text and Parquet files are, and which of their columns are what, where it is not `stated`. Files alike whose
    columns no name tells are one log: a file of one position does not tell what they are, all of them do. Raises
    InputError for those that are no logs, or not alike."""
    logs: list[FoundLog] = []
    without: list[_NoRowsError] = []
    omitted: tuple[str, ...] = ()
    for file in files:  # text without rows beside logs that have some, as the metadata that a phone writes, is left out
        try:
            logs += [log.with_stated(stated) for log in _found(file, folder)]
        except _NoRowsError as error:
            without.append(error)
            omitted += (f"{file.name} has no rows of readings and is left out",)
    if not logs:
        raise without[0]
    logs = [_with_thermometers(_with_finest_time(log) if len(log.columns.times) > 1 else log) for log in logs]
    if are_sensors_apart(logs):
        apart = of_sensors_apart(logs, folder)
        return replace(apart, said=(*apart.said, *omitted))
    whole = [log for log in logs if ACCEL in log.columns.triads]
    beside = [log for log in logs if whole and log not in whole and not log.unnamed]
    omitted += tuple(f"{log.files[0].name} has no accelerometers and is left out" for log in beside)
    logs = [log for log in logs if log not in beside]
    first = logs[0]
    alike = all(log.cells and (log.keys, set(log.cells)) == (first.keys, set(first.cells)) for log in logs)
    if len(logs) > 1 and not whole and alike:
        numeric = _numeric(first)
        time = first.columns.time or time_by_data(numeric, first.read(numeric, rows=LONGEST // 10))
        logs = [replace(first.with_columns(time=time), files=tuple(file for log in logs for file in log.files))]
    logs = [_with_time(log) if log in whole else _by_data(log) for log in logs]
    first = logs[0]
    for log in logs[1:]:
        if (log.keys, log.columns.triads, log.columns.time) != (first.keys, first.columns.triads, first.columns.time):
            raise InputError(
                f"{log.files[0]}: expected a log written as {first.files[0].name} is, found another; give them to "
                "sessions of their own"
            )
    first.check_has_accelerometers()
    taken = tuple(file for log in logs for file in log.files)
    kept = {path: source for log in logs for path, source in log.kept.items()}
    said = first.said + ((f"{len(taken)} files, each a recording of its own",) if len(taken) > 1 else ()) + omitted
    return replace(first, files=taken, said=said, kept=kept)


class _NoRowsError(InputError):
    """A text file without rows of readings."""


def _found(file: Path, folder: OutputFolder) -> list[FoundLog]:
    """What a file is: one log, or where its rows are of single sensors one of each."""
    if file.suffix.lower() == ".parquet":
        return [FoundLog(files=(file,), keys={}, columns=columns_by_name(source_of(file).names))]
    with readable(file), opened(file) as stream:
        seen = stream.read(_SEEN_BYTES)
    if not seen:
        raise _NoRowsError(f"{file}: expected a log, found an empty file")
    _check_is_log(file, seen)
    if parts := split_by_header(file, seen, folder):
        return [log for part in parts for log in _found(part, folder)]
    copied = respelled(file, seen, folder) or tables_of_json(file, seen, folder)
    if copied is not None:
        parts, remark = copied
        return [replace(log, said=(remark, *log.said)) for part in parts for log in _found(part, folder)]
    dialect_and_top = dialect_of(seen)
    if dialect_and_top is None and (max(map(len, seen.split(b"\n"))) > LINE_BYTES // 8 or b"\0" in seen[:1000]):
        raise InputError(f"{file}: expected a log of rows of numbers, found something else; is it a recording?")
    if dialect_and_top is not None:
        dialect, top = dialect_and_top
        if parts := split_by_sensor(file, seen, dialect, top, folder):
            return [log for part in parts for log in _found(part, folder)]
        lines = seen.decode(dialect.encoding, errors="replace").split("\n")[top.lines : top.lines + SAMPLE_ROWS]
        rows = [row for line in lines if len(row := dialect.cells(line)) == len(top.names)]
    if dialect_and_top is None or len(rows) < 2:
        raise _NoRowsError(f"{file}: expected rows of readings below the names of the columns, found none")
    cells = {name: [row[j] for row in rows] for j, name in enumerate(top.names) if name}
    filled = {name: [cell for cell in column if cell.strip()] for name, column in cells.items()}
    numbers = {name for name, column in filled.items() if any(dialect.is_number(c) or is_clock(c) for c in column)}
    words = {name for name, column in filled.items() if column} - numbers  # as week and seconds, `2022:120847.300`
    how = [f"{_DELIMITER_WORDS[dialect.delimiter]} between the values"]
    how += ["decimal commas"] if dialect.decimal == "," else []
    how += [dialect.encoding] if dialect.encoding != "utf-8" else []
    how += ["columns without names"] if not dialect.header else []
    how += [f"{top.lines} lines above the numbers"] if top.lines > 1 else []
    plain = dialect == Dialect() and top.lines == 1 and "".join(file.suffixes[-2:]).lower().endswith(ENDINGS)
    log = FoundLog(
        files=(file,),
        keys={} if plain else dialect.keys(),
        columns=columns_by_name([name for name in top.names if top.names.count(name) == 1 and name not in words]),
        remarks=top.remarks,
        cells=cells,
        said=() if plain else (f"text: {', '.join(how)}",),
        dialect=None if plain else dialect,
    )
    clock = next((name for name in cells if log.is_clock(name)), None)
    return [log.with_columns(time=clock) if log.columns.time is None else log]


def _check_is_log(file: Path, seen: bytes) -> None:
    """Raises InputError that names the format of a file, by its first bytes `seen`, and what to do: one of the table,
    records of 17 numbers, a time of the week that grows, a latitude, a longitude and more, or one line of 30 numbers
    that begins with a latitude and a longitude."""
    for start, mark, name, advice in _BINARY:
        if seen[start : start + len(mark)] == mark:
            raise InputError(f"{file}: expected a log, found {name}; {advice}")
    if file.stat().st_size % _RECORD.size == 0 and len(seen) >= 3 * _RECORD.size:
        first, second = (_RECORD.unpack_from(seen, k * _RECORD.size) for k in (0, 1))
        angles = [abs(first[k]) for k in (1, 2, 7, 8)]
        grows = 0.0 <= first[0] < second[0] < first[0] + 1.0 < 2.0 * _WEEK
        if grows and 1e-6 < max(angles) <= 2.0 * _HALF_TURN and max(map(abs, (*first[1:], *second[1:]))) < 1e6:
            raise InputError(
                f"{file}: expected readings of accelerometers and gyros, found a trajectory (SBET), which a filter has "
                "made of them; write the raw readings of the same mission as text"
            )
    try:
        values = [float(cell) for cell in seen.split()] if b"\n" not in seen.strip() else []
    except ValueError:
        return
    if len(values) == _OXTS and abs(values[0]) <= 90.0 and abs(values[1]) <= 180.0:
        raise InputError(
            f"{file}: expected a log, found one sample of a vehicle that moves (oxts of KITTI, a file for each); a "
            "drive has no rests in other attitudes to calibrate from: record some, in one table"
        )


def _numeric(log: FoundLog) -> list[str]:
    """Columns of numbers."""
    if not log.cells:
        schema = pl.scan_parquet(log.files[0], glob=False).collect_schema()
        return [name for name, kind in schema.items() if kind.is_numeric()]
    is_number = (log.dialect or Dialect()).is_number
    return [name for name, cells in log.cells.items() if sum(map(is_number, cells)) > len(cells) // 2]


def _by_data(log: FoundLog) -> FoundLog:
    """A log whose accelerometers, and gyros unless they are named, are told by their numbers, if they can be. Columns
    whose names say that they are something else are left aside; gx, gy and gz may be no gyros."""
    known, names, numeric = log.columns, list(log.names), _numeric(log)
    named = {kind: sensors for kind, sensors in known.triads.items() if kind != ACCEL}
    for beside in (named, {kind: sensors for kind, sensors in named.items() if kind != GYRO}):
        taken = {column for sensors in beside.values() for column in sensors.columns} | {known.time}
        free = [n for n in numeric if n not in taken and names.count(n) == 1 and not is_no_sensor(n)]
        read = log.read(free) if len(free) >= 3 else np.empty((0, len(free)))
        every = np.full((samples_in(read), len(names)), np.nan)
        every[:, [names.index(name) for name in free]] = read[: len(every)]
        told = columns_by_data(names, every)
        if ACCEL in told.columns.triads:
            found = told.columns.triads.items()
            triads = {kind: replace(s, unit=unit_of_name(kind, s.columns[0])) for kind, s in found}
            time = known.time or told.columns.time
            return log.with_columns(told.said(beside), triads=triads | beside, time=time, others=(), times=())
        if GYRO not in named:
            break
    return log


def _with_finest_time(log: FoundLog) -> FoundLog:
    """A log with several times: with the first whose stamps grow from row to row, else the first that grows at all."""
    growing: list[FoundLog] = []
    for name in dict.fromkeys((log.columns.time, *log.columns.times)):
        trial = log.with_columns(time=name, time_unit=time_unit(name or ""))
        stamps = trial.stamps()
        steps = np.zeros(1) if stamps is None else np.diff(stamps.values)
        finest = np.mean(steps > 0.0) > _GROWING
        whole_seconds = np.mean(steps >= 0.0) > _GROWING and np.any(steps > 0.0) and nanoseconds_of(trial) is not None
        is_time = stamps is not None and times_of_column(stamps) is not None
        if whole_seconds or (finest and is_time):
            return trial
        growing += [trial] if is_time else []
    return next(iter(growing), log)


def _with_thermometers(log: FoundLog) -> FoundLog:
    """A log without the thermometers that read nothing, so that one that does is taken."""
    empty = [name for name in log.columns.temperatures if not len(log.readings(name))]
    if not empty:
        return log
    known = log.columns
    sensors = [column for triad in known.triads.values() for column in triad.columns]
    anew = columns_by_name([n for n in (*sensors, *known.temperatures, *known.others) if n not in empty])
    said = f"temperature: {', '.join(empty)} is left out, for it reads nothing or cannot be read"
    return _with_thermometers(log.with_columns([said], temperatures=anew.temperatures, others=anew.others))


def _with_time(log: FoundLog) -> FoundLog:
    """A log whose time, if no name says which column it is, is one that grows as times do."""
    if log.columns.time is not None:
        return log
    known = {log.columns.counter, *(c for triad in log.columns.triads.values() for c in triad.columns)}
    names = [name for name in _numeric(log) if name not in known]
    time = time_by_data(names, log.read(names, rows=LONGEST // 10)) if names else None
    if time is None:
        return log
    said = f"time: column {time!r}, by its numbers (a guess)"
    return log.with_columns([said], time=time, time_unit=time_unit(time))
