"""Sensors that come in files of their own, as of phones, put together into one log."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import polars as pl

from tumble.drafting.found_log import HEAD_ROWS, SHOWN, FoundLog
from tumble.drafting.times import grows_mostly, recordings_of, times_of_column
from tumble.errors import InputError
from tumble.files import OutputFolder
from tumble.recording.columns.names import (
    ACCEL,
    GYRO,
    SENSOR_WORDS,
    Columns,
    columns_by_name,
    is_no_sensor,
    unit_of_name,
)
from tumble.recording.columns.numbers import time_by_data
from tumble.recording.columns.scales import CANDIDATES
from tumble.recording.formats import as_log
from tumble.recording.formats.message import TIME, Message, Sensors
from tumble.units import TIME_UNITS

_NEAR = 0.1
_UNCALIBRATED = re.compile(r"acc.*uncal|uncal.*acc", re.IGNORECASE)
_NOT_ACCEL = re.compile(r"lin|user|uncal|without|\bno[_ ]?g", re.IGNORECASE)


def are_sensors_apart(logs: Sequence[FoundLog]) -> bool:
    """Whether logs are of one kind of sensors each: the names of their columns say so, or no names of columns say which
    and those of the files do; where columns have no names, they are no more than a time and three sensors. Files that
    all have room for two kinds are recordings of one device."""
    if len(logs) < 2 or any({ACCEL, GYRO} <= set(log.columns.triads) for log in logs):
        return False
    if all(sum(not is_no_sensor(name) for name in log.cells) >= len("xyz") + len("xyz") for log in logs):
        return False
    by_kind = _by_kind(logs)
    if set(by_kind) == {ACCEL, GYRO}:
        return all(len(log.cells) <= 1 + len("xyz") for log in by_kind.values() if _without_names(log))
    return not any(log.columns.triads or _without_names(log) for log in logs)


def _by_kind(logs: Sequence[FoundLog]) -> dict[str, FoundLog]:
    """The first log of each kind of sensors by the names of its columns, or where they do not say of its file; of
    accelerometers the first that reads gravity, if one does: what a phone calls so may be without it."""
    by_kind: dict[str, FoundLog] = {}
    for log in logs:
        name = log.files[0].stem
        named = next((kind for kind in (ACCEL, GYRO) if kind in log.columns.triads), None)
        kind = named or next((k for k, pattern in SENSOR_WORDS.items() if pattern.search(name)), None)
        if kind == ACCEL and not _NOT_ACCEL.search(name) and ACCEL in by_kind:
            by_kind[ACCEL] = by_kind[ACCEL] if _reads_gravity(by_kind[ACCEL]) or not _reads_gravity(log) else log
        if kind is not None and not (kind == ACCEL and _NOT_ACCEL.search(name)):
            by_kind.setdefault(kind, log)
    uncalibrated = [log for log in logs if _UNCALIBRATED.search(log.files[0].stem)]
    return {ACCEL: uncalibrated[0], **by_kind} if uncalibrated else by_kind


def _reads_gravity(log: FoundLog) -> bool:
    """Whether the three sensors of a log of accelerometers read gravity in a unit."""
    columns = _three(log, ACCEL)[1]
    if not columns:
        return False
    length = float(np.nanmedian(np.linalg.norm(log.read(columns, rows=HEAD_ROWS), axis=1)))
    return any(c.unit is not None and abs(length / c.value - 1.0) < _NEAR for c in CANDIDATES[ACCEL])


def of_sensors_apart(logs: Sequence[FoundLog], folder: OutputFolder) -> FoundLog:
    """Accelerometers and gyros that come in a file each, as of phones, as one log at the times of the gyros."""
    by_kind = _by_kind(logs)
    if ACCEL not in by_kind:
        logs[0].check_has_accelerometers()
    accel, gyro = _message(by_kind[ACCEL], ACCEL), _message(by_kind[GYRO], GYRO) if GYRO in by_kind else None
    joined = folder.new_file("log.parquet")
    as_log(joined, accel, gyro)
    triads = {ACCEL: accel.accel, GYRO: gyro.gyro if gyro is not None else None}
    named = " and ".join(log.files[0].name for log in by_kind.values())
    columns = Columns(
        time=TIME,
        time_unit="s",
        triads={kind: sensors for kind, sensors in triads.items() if sensors is not None},
    )
    unused = [log.files[0].name for log in logs if log not in by_kind.values()]
    also = (f"also there, and not used: {', '.join(unused)}",) if unused else ()
    said = f"{named}: one log at the times of the gyros, written to {joined}"
    fastest = accel if gyro is None else gyro
    return FoundLog(files=(joined,), keys={}, columns=columns, said=(said, *also, fastest.remark))


def _without_names(log: FoundLog) -> bool:
    """Whether the columns of a log have no names."""
    return all(name.isdecimal() for name in log.cells)


def _three(log: FoundLog, kind: str) -> tuple[FoundLog, list[str]]:
    """A log with its time, and its columns x, y and z, none where it has no such: by their names, else the three beside
    one that grows."""
    if kind in log.columns.triads:
        return log, list(log.columns.triads[kind].columns)
    if not _without_names(log):
        renamed = {f"{'a' if kind == ACCEL else 'g'} {name.split()[0] if name else name}": name for name in log.cells}
        sensors = columns_by_name(renamed).triads.get(kind)
        return log, [] if sensors is None else [renamed[column] for column in sensors.columns]
    read = log.read(list(log.cells))
    rising = [name for name, column in zip(log.cells, read.T, strict=True) if grows_mostly(column)]
    time = time_by_data(list(log.cells), read) or (rising[0] if len(rising) == 1 else None)
    three = [name for name in log.cells if name != time]
    return replace(log, columns=replace(log.columns, time=time)), three if len(three) == len("xyz") else []


def _message(log: FoundLog, kind: str) -> Message:
    """The three columns of the one kind of sensors in a log, with their times, s."""
    log, source = _three(log, kind)
    stamps = log.stamps()
    times = None if stamps is None else times_of_column(stamps)
    if not source or stamps is None or times is None:
        raise InputError(
            f"{log.files[0]}: expected a time and columns x, y and z, found {', '.join(list(log.cells)[:SHOWN])}; "
            "write `time,x,y,z` above the rows"
        )
    unit = unit_of_name(kind, source[0]) or unit_of_name(kind, f"{'acc' if kind == ACCEL else 'gyro'} {source[0]}")
    x, y, z = (f"{kind}_{axis}" for axis in "xyz")
    read = log.read([stamps.column, *source])
    read = read[np.isfinite(read).all(axis=1)]
    if recordings_of(read[:, 0]) is not None:
        raise InputError(
            f"{log.files[0]}: expected one recording, found a clock that starts anew; give each its own file"
        )
    if times.keys.get("regular"):
        rows = np.arange(len(read), dtype=float)
        read[:, 0] = np.polynomial.Polynomial.fit(rows, read[:, 0], 1)(rows)
    read = read[np.argsort(read[:, 0], kind="stable")]
    read[:, 0] *= 1.0 if stamps.clock else TIME_UNITS[times.keys.get("time_unit", "s")]
    found = Sensors(columns=(x, y, z), unit=unit)
    return Message(
        name=log.files[0].name,
        count=len(read),
        accel=found if kind == ACCEL else None,
        gyro=found if kind == GYRO else None,
        remark=f"{log.files[0].name}: {'; '.join(times.said)}",
        rows=lambda: iter([pl.DataFrame(read, schema=[TIME, x, y, z], orient="row")]),
    )
