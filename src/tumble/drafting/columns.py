"""Identification of the columns of text and Parquet files by statements of the user, names and units, and numbers.

Names and units are trusted; numbers only decide which columns without meaningful names are sensors or a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tumble.drafting.containers import BINARY_ENDINGS, NoLogError, check_format
from tumble.drafting.dialects import copy_as_tables
from tumble.drafting.foreign_log import HEAD_ROWS, NOTHING_GIVEN, SAMPLE_ROWS, ForeignLog, Given
from tumble.drafting.repairs import nanoseconds_column, with_signs
from tumble.drafting.sensors_apart import are_sensors_apart, join_sensors, of_one_device, of_one_group
from tumble.drafting.times import grows_mostly, times_of_column
from tumble.errors import InputError
from tumble.files import OutputFolder
from tumble.recording.columns.names import (
    ACCEL,
    GYRO,
    MAGNETOMETER,
    columns_by_name,
    is_no_sensor,
    time_unit,
    unit_of_name,
)
from tumble.recording.columns.numbers import columns_by_data, grows, guess_remarks
from tumble.recording.log_source import readable
from tumble.recording.readers import ENDINGS, source_of
from tumble.recording.text.clock import is_clock
from tumble.recording.text.dialect import LINE_BYTES, SEEN_BYTES, Dialect, dialect_of, head_lines
from tumble.recording.text.pieces import opened

_GROWING_SHARE = 0.9  # of the steps of stamps, if these are the times of rows
_DELIMITER_WORDS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "blanks"}


def identify_log(files: Sequence[Path], folder: OutputFolder, given: Given = NOTHING_GIVEN) -> ForeignLog:
    """Return one log of text and Parquet files, with its columns identified.

    Statements of the user take precedence; a message names one of several devices in a table, by default the first.
    Files in one dialect whose columns have no meaningful names are identified together, because one position is not
    enough to recognise sensors. Raises InputError for files that are no logs, or are in different dialects."""
    logs: list[ForeignLog] = []
    errors: list[NoLogError] = []
    omitted: tuple[str, ...] = ()
    # text without rows, such as the metadata of a phone, is left out
    for file in files:
        try:
            read = _logs_in(file, folder)
            read = read if given.accel else [of_one_group(log, given.message) for log in read]
            logs += [log.with_stated(given) for log in read]
        except NoLogError as error:
            errors.append(error)
            omitted += (f"{file.name} has no rows of readings and is left out",)
    if not logs:
        raise errors[0]
    logs = [of_one_device(log, given.message) for log in logs]
    logs = [_without_empty_thermometers(_with_finest_time(log)) for log in logs]
    parts = _parts_with_own_times(logs[0]) if len(logs) == 1 else []
    if parts or are_sensors_apart(logs):
        joined, columns = join_sensors(parts or logs, folder), logs[0].columns
        unused = [
            *columns.temperatures,
            *(columns.triads[MAGNETOMETER].columns if MAGNETOMETER in columns.triads else ()),
        ]
        omitted += (f"also there, and not used: {', '.join(unused)}",) if parts and unused else ()
        return replace(joined, remarks=(*joined.remarks, *omitted))
    named = [log for log in logs if ACCEL in log.columns.triads]
    without_accel = [log for log in logs if named and log not in named and not log.unnamed]
    omitted += tuple(f"{log.files[0].name} has no accelerometers and is left out" for log in without_accel)
    logs = [log for log in logs if log not in without_accel]
    first = logs[0]
    alike = all(log.cells and (log.dialect, set(log.cells)) == (first.dialect, set(first.cells)) for log in logs)
    if len(logs) > 1 and not named and alike:
        time = first.columns.time or first.time_by_data()
        logs = [replace(first.with_columns(time=time), files=tuple(file for log in logs for file in log.files))]
    logs = [_with_columns_by_data(_with_time(_with_gravity(log)) if log in named else log) for log in logs]
    first = logs[0]
    for log in logs[1:]:
        written, first_written = (
            (each.dialect, each.columns.triads, each.columns.time, each.instance) for each in (log, first)
        )
        if written != first_written:
            raise InputError(
                f"{log.files[0]}: expected the format and columns of {first.files[0].name}, found others; make a "
                "session of each"
            )
    first.check_has_sensors(gyros_suffice=True)
    all_files = tuple(file for log in logs for file in log.files)
    kept = {path: source for log in logs for path, source in log.kept.items()}
    several = (f"{len(all_files)} files, each a recording of its own",) if len(all_files) > 1 else ()
    return replace(first, files=all_files, remarks=(*first.remarks, *several, *omitted), kept=kept)


def _logs_in(file: Path, folder: OutputFolder) -> list[ForeignLog]:
    """Return the log in a file, or one log per sensor if each row belongs to one sensor."""
    check_format(file, recording=file.suffix.lower() in BINARY_ENDINGS)
    if file.suffix.lower() == ".parquet":
        return [ForeignLog(files=(file,), columns=columns_by_name(source_of(file).names))]
    with readable(file), opened(file) as stream:
        start = stream.read(SEEN_BYTES)
    if not start:
        raise NoLogError(f"{file}: expected a log, found an empty file")
    if start.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] in (b"{", b"[") and start.count(b"\n") < 3:
        raise InputError(f"{file}: expected rows of readings, found a document of JSON; write the readings as CSV")
    if (copied := copy_as_tables(file, start, folder)) is not None:
        parts, remarks = copied
        return [replace(log, remarks=(*remarks, *log.remarks)) for part in parts for log in _logs_in(part, folder)]
    dialect_and_top = dialect_of(start)
    if dialect_and_top is None and max(map(len, start.split(b"\n"))) > LINE_BYTES // 2:
        raise InputError(f"{file}: expected a log of rows of numbers, found something else; is it a recording?")
    if dialect_and_top is not None:
        dialect, top = dialect_and_top
        lines = head_lines(start, dialect.encoding)[top.lines : top.lines + SAMPLE_ROWS]
        rows = [row for line in lines if len(row := dialect.cells(line)) == len(top.names)]
    if dialect_and_top is None or len(rows) < 2:
        raise NoLogError(f"{file}: expected rows of readings below the names of the columns, found none")
    cells = {name: [row[j] for row in rows] for j, name in enumerate(top.names) if name}
    filled = {name: [cell for cell in column if cell.strip()] for name, column in cells.items()}
    numbers = {name for name, column in filled.items() if any(dialect.is_number(c) or is_clock(c) for c in column)}
    text = {name for name, column in filled.items() if column} - numbers
    how = [f"{_DELIMITER_WORDS[dialect.delimiter]} between the values"]
    how += ["decimal commas"] if dialect.decimal == "," else []
    how += [dialect.encoding] if dialect.encoding != "utf-8" else []
    how += ["columns without names"] if not dialect.header else []
    how += [f"{top.lines} lines above the numbers"] if top.lines > 1 else []
    plain = dialect == Dialect() and top.lines == 1 and "".join(file.suffixes[-2:]).lower().endswith(ENDINGS)
    log = ForeignLog(
        files=(file,),
        columns=columns_by_name([name for name in top.names if name not in text]),
        preamble=top.preamble,
        cells=cells,
        remarks=() if plain else (f"text: {', '.join(how)}",),
        dialect=None if plain else dialect,
    )
    clock = next((name for name in cells if log.is_clock(name)), None)
    return [log.with_columns(time=clock) if log.columns.time is None else log]


def _with_columns_by_data(log: ForeignLog) -> ForeignLog:
    """Identify sensors by their numbers where names do not identify them.

    Accelerometers and gyros are sought among columns whose names do not exclude it. If accelerometers are named, gyros
    with a name that does not tell them are taken only if they turn the accelerometers' vector."""
    named, names = log.columns, list(log.names)
    accel = named.triads[ACCEL].columns if ACCEL in named.triads else ()
    taken = {*named.sensors, named.time}
    free = [name for name in log.numeric if name not in taken and not is_no_sensor(name)]
    if accel:  # those of other devices are no gyros
        taken |= {*columns_by_name(free).sensors}
        free = [name for name in free if name not in taken]
    nameless = [name for name in free if name.isdecimal()]
    if len(free) < 3 or (accel and GYRO in named.triads):
        return log
    numbers = np.column_stack([with_signs(column) for column in log.read([*accel, *free]).T])
    numbers = numbers[np.isfinite(numbers).any(axis=1)]
    table = np.full((len(numbers), len(names)), np.nan)
    table[:, [names.index(name) for name in (*accel, *free)]] = numbers
    by_data = columns_by_data(names, table)
    found = GYRO in by_data.triads and set(by_data.triads[ACCEL].columns) == set(accel)
    if accel and not (found and (by_data.turning or set(by_data.triads[GYRO].columns) <= set(nameless))):
        if len(nameless) < 3:
            return log
        unused = f"columns without names, {', '.join(nameless)}, are not used"
        doubt = f"{unused}: the accelerometers alone are calibrated; state --gyro if some are gyros"
        return replace(log, doubts=(doubt,))
    if ACCEL not in by_data.triads:
        return log
    triads = {kind: replace(s, unit=unit_of_name(kind, s.columns[0])) for kind, s in by_data.triads.items()}
    remarks = guess_remarks(by_data, named.triads)
    if accel:
        return log.with_columns(remarks, triads={**triads, **named.triads})
    doubt = (
        "columns were identified by their numbers, and others would fit too: all values depend on this; state --accel, "
        "--gyro"
    )
    log = replace(log, doubts=(doubt,)) if by_data.ambiguous else log
    return log.with_columns(
        remarks, triads={**triads, **named.triads}, time=named.time or by_data.time, others=(), times=()
    )


def _with_gravity(log: ForeignLog) -> ForeignLog:
    """Choose the second triad of accelerometers if it reads gravity and the first does not: phones write several."""
    first = log.columns.triads[ACCEL].columns
    second = columns_by_name([name for name in log.cells if name not in first]).triads.get(ACCEL)
    if second is None or log.reads_gravity(first) or not log.reads_gravity(second.columns):
        return log
    remark = f"accel: {', '.join(second.columns)}, since {', '.join(first)} do not read gravity"
    others = (*(name for name in log.columns.others if name not in second.columns), *first)
    return log.with_columns([remark], triads={**log.columns.triads, ACCEL: second}, others=others)


def _with_finest_time(log: ForeignLog) -> ForeignLog:
    """Choose the first of several times that grows from row to row, else the first that grows at all."""
    if len(log.columns.times) < 2:
        return log
    growing: list[ForeignLog] = []
    for name in dict.fromkeys((log.columns.time, *log.columns.times)):
        trial = log.with_columns(time=name, time_unit=time_unit(name or ""))
        stamps = trial.stamps()
        steps = np.zeros(1) if stamps is None else np.diff(stamps.values)
        is_finest = np.mean(steps > 0.0) > _GROWING_SHARE
        has_nanoseconds = np.any(steps > 0.0) and nanoseconds_column(trial) is not None
        is_time = stamps is not None and times_of_column(stamps) is not None
        if (np.mean(steps >= 0.0) > _GROWING_SHARE and has_nanoseconds) or (is_finest and is_time):
            return trial
        growing += [trial] if is_time else []
    return next(iter(growing), log)


def _without_empty_thermometers(log: ForeignLog) -> ForeignLog:
    """Leave out thermometers without readings."""
    empty = [name for name in log.columns.temperatures if not len(log.readings(name))]
    if not empty:
        return log
    named = log.columns
    rest = columns_by_name([n for n in (*named.sensors, *named.temperatures, *named.others) if n not in empty])
    remark = f"temperature: {', '.join(empty)} is left out, for it reads nothing or cannot be read"
    return _without_empty_thermometers(log.with_columns([remark], temperatures=rest.temperatures, others=rest.others))


def _parts_with_own_times(log: ForeignLog) -> list[ForeignLog]:
    """Return a log for each kind of sensor if each kind has its own times: in a column before those of the sensors, or
    in rows of its own, so that at most each second row has readings of all."""
    names, numeric = list(log.names), log.numeric
    parts = [log.with_columns(triads={k: log.columns.triads[k]}) for k in (ACCEL, GYRO) if k in log.columns.triads]
    timed, triads = list[ForeignLog](), [next(iter(part.columns.triads.values())) for part in parts]
    for part, sensors in zip(parts, triads, strict=True):
        first = min(map(names.index, sensors.columns))
        before = names[first - 1] if first else ""
        stamps = log.read([before])[:, 0] if before in numeric else np.empty(0)
        if grows(stamps) and grows_mostly(stamps):
            unit = log.columns.time_unit if before.isdecimal() else time_unit(before)
            timed.append(part.with_columns(time=before, time_unit=unit))
    if len(timed) == len(parts) and len({part.columns.time for part in timed}) > 1:
        return timed
    if len(parts) < 2 or log.columns.time is None:
        return []
    read = np.array([np.isfinite(log.read(sensors.columns, rows=HEAD_ROWS)).all(axis=1) for sensors in triads])
    of_both, of_any = np.count_nonzero(read.all(axis=0)), np.count_nonzero(read.any(axis=0))
    return parts if 2 * of_both <= of_any + 1 and read.any(axis=1).all() else []


def _with_time(log: ForeignLog) -> ForeignLog:
    """Choose a column that grows like a time if no column is named as the time."""
    if log.columns.time is not None:
        return log
    time = log.time_by_data()
    if time is None:
        return log
    remark = f"time: column {time!r}, by its numbers (a guess)"
    return log.with_columns([remark], time=time, time_unit=time_unit(time))
