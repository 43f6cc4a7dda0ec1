"""One log from sensors that come apart: messages of a recording in another format than text and Parquet, and
accelerometers and gyros of a phone in a file each."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import takewhile
from operator import eq
from pathlib import Path

import numpy as np
import polars as pl

from tumble.drafting.foreign_log import SHOWN, ForeignLog
from tumble.drafting.times import grows_mostly, recordings_of, times_of_column
from tumble.errors import InputError
from tumble.files import OutputFolder
from tumble.recording.columns.names import (
    ACCEL,
    GYRO,
    SENSOR_WORDS,
    Columns,
    Sensors,
    columns_by_name,
    is_no_sensor,
    unit_of_name,
)
from tumble.recording.columns.numbers import time_by_data
from tumble.recording.columns.patterns import WITHOUT_GRAVITY
from tumble.recording.formats import TIME, Message, as_log, messages
from tumble.recording.session import AutopilotSensor
from tumble.units import TIME_UNITS

_UNCALIBRATED = re.compile(r"uncal", re.IGNORECASE)
_GRAVITY = re.compile(r"grav|schwerkraft", re.IGNORECASE)


def log_of_recording(
    recordings: Sequence[Path], folder: OutputFolder, message: str | None
) -> tuple[ForeignLog, Mapping[str, AutopilotSensor]]:
    """The log of a recording's message, by name or the first with most sensors, and the autopilot's sensors in it.

    Several files are one recording if the accelerometers are in one and the gyros in the other. Raises InputError for
    several recordings, and if no message has this name."""
    recording, found = recordings[0], messages(*recordings)
    with_accel = [m for m in found if m.accel]
    if len(recordings) > 1 and (len(found) > len(recordings) or len(with_accel) > 1):
        raise InputError(f"{recording}: expected one recording, found {len(recordings)}; give each its own session")
    candidates = [m for m in with_accel if message in (None, m.name)]
    if not candidates:
        raise InputError(f"{recording}: expected a message {message!r}, found {', '.join(m.name for m in with_accel)}")
    accel = max(candidates, key=lambda m: m.gyro is not None) if message is None else candidates[0]
    gyro = accel if accel.gyro else next((m for m in found if m.gyro and _pairs(accel, m)), None)
    taken = [accel] if gyro is None or gyro is accel else [accel, gyro]
    beside = [m.temperatures for m in taken if m.temperatures]
    one_each = len(beside) == 2 and max(map(len, beside)) == 1
    temperatures = beside[0] + beside[1] if one_each else next(iter(beside), ())
    apart = [] if temperatures else [m for m in found if m.thermometer]
    thermometers = _thermometers(accel, gyro, apart)
    log = folder.new_file("log.parquet")
    as_log(log, accel, gyro, thermometers)
    remarks = [f"{recording.name}: message {accel.name}, written to {log}"]
    remarks += [f"temperature from {thermometer.name}, interpolated" for thermometer in thermometers]
    unused = [m.name for m in apart if m not in thermometers]
    remarks += [f"other thermometers, not used: {', '.join(unused)}"] if unused else []
    triads = accel.triads
    if gyro is not None and gyro is not accel:
        remarks.append(f"gyros from {gyro.name}; the accelerometers are interpolated at their times")
        triads = {ACCEL: accel.triads[ACCEL], GYRO: gyro.triads[GYRO]}
    others = [m.name for m in with_accel if m not in taken]
    remarks += [f"also there, and not used: {', '.join(others)} (--message takes another)"] if others else []
    remarks += [remark for remark in dict.fromkeys(m.remark for m in taken) if remark]
    columns = Columns(
        time=TIME if accel.timed else None,
        time_unit="s" if accel.timed else None,
        triads=triads,
        temperatures=temperatures or tuple(t for m in thermometers for t in m.temperatures),
    )
    imu = {kind: sensor for m in reversed(taken) for kind, sensor in m.imu.items()}
    return ForeignLog(files=(log,), keys={}, columns=columns, remarks=tuple(remarks)), imu


def _pairs(accel: Message, gyro: Message) -> bool:
    """Whether gyros in another message have the same clock, and the same instance where messages are numbered."""
    counted = accel.name.rpartition(".")[2], gyro.name.rpartition(".")[2]
    return accel.timed and gyro.timed and (not all(c.isdecimal() for c in counted) or counted[0] == counted[1])


def _thermometers(accel: Message, gyro: Message | None, apart: Sequence[Message]) -> list[Message]:
    """Messages of thermometers to use: one each of the accelerometers and the gyros, or else the one whose topic is
    most like that of the accelerometers."""
    way = accel.name.split("/")
    near = sorted(apart, key=lambda m: len(list(takewhile(bool, map(eq, m.name.split("/"), way)))), reverse=True)
    first = {m.temperatures: m for m in reversed(near)}
    both = [first[name] for kind in (ACCEL, GYRO) if (name := (f"{kind}_temperature",)) in first]
    return both if gyro is not None and len(both) == 2 else near[:1]


# -------------------- files of one kind of sensors each --------------------


def are_sensors_apart(logs: Sequence[ForeignLog]) -> bool:
    """Whether logs have one kind of sensors each, by the names of their columns, or else of their files. Files that all
    have room for two kinds are recordings of one device."""
    if len(logs) == 1:  # of gyros, by the name of its file
        (log,) = logs
        return not log.columns.triads and len(log.cells) <= 1 + len("xyz") and set(_by_kind(logs)) == {GYRO}
    if any({ACCEL, GYRO} <= set(log.columns.triads) for log in logs):
        return False
    for log in logs:  # columns for accelerometers and gyros, and none named x, y and z alone
        axes_alone = set("xyz") <= {(name.split() or [""])[0].lower() for name in log.cells}
        if axes_alone or sum(not is_no_sensor(name) for name in log.cells) < 2 * len("xyz"):
            break
    else:
        return False
    by_kind = _by_kind(logs)
    if set(by_kind) == {ACCEL, GYRO}:
        return all(len(log.cells) <= 1 + len("xyz") for log in by_kind.values() if log.unnamed)
    return not any(log.columns.triads or log.unnamed for log in logs)


def _by_kind(logs: Sequence[ForeignLog]) -> dict[str, ForeignLog]:
    """The first log of each kind of sensors, by the names of its columns or else of its file; uncalibrated readings
    last, and of accelerometers one that reads gravity first."""
    by_kind: dict[str, list[ForeignLog]] = {}
    for log in sorted(logs, key=lambda log: _UNCALIBRATED.search(log.files[0].stem) is not None):
        name = log.files[0].stem
        named = next((kind for kind in (ACCEL, GYRO) if kind in log.columns.triads), None)
        kind = named or next((k for k, pattern in SENSOR_WORDS.items() if pattern.search(name)), None)
        if kind is not None and not (kind == ACCEL and WITHOUT_GRAVITY.search(name)):
            by_kind.setdefault(kind, []).append(log)
    first = {kind: found[0] for kind, found in by_kind.items()}
    with_gravity = next((log for log in by_kind.get(ACCEL, []) if _reads_gravity(log)), None)
    return first if with_gravity is None else {**first, ACCEL: with_gravity}


def _reads_gravity(log: ForeignLog) -> bool:
    """Whether the accelerometers of a log read gravity in a unit."""
    return log.reads_gravity(_three(log, ACCEL)[1])


def of_sensors_apart(logs: Sequence[ForeignLog], folder: OutputFolder) -> ForeignLog:
    """Accelerometers and gyros in a file each, as one log at the times of the gyros."""
    by_kind = _by_kind(logs)
    if not by_kind:
        logs[0].check_has_sensors(gyros_suffice=True)
    read = {kind: _message(by_kind[kind], kind) for kind in (ACCEL, GYRO) if kind in by_kind}
    gravity = next((log for log in logs if _GRAVITY.search(log.files[0].stem)), None)
    summed = ""
    if ACCEL in by_kind and gravity is not None and not _reads_gravity(by_kind[ACCEL]):
        read[ACCEL] = _sum(read[ACCEL], _message(gravity, ACCEL))
        summed = f", {gravity.files[0].name} added to the accelerometers, which are without gravity"
    joined = folder.new_file("log.parquet")
    first = next(iter(read.values()))
    as_log(joined, first, read.get(GYRO))
    named = " and ".join(dict.fromkeys(log.files[0].name for log in by_kind.values()))
    columns = Columns(time=TIME, time_unit="s", triads={kind: m.triads[kind] for kind, m in read.items()})
    unused = [log.files[0].name for log in logs if log not in by_kind.values() and not (summed and log is gravity)]
    also = (f"also there, and not used: {', '.join(unused)}",) if unused else ()
    remark = f"{named}: one log at the times of the gyros{summed}, written to {joined}"
    fastest = read.get(GYRO, first)
    return ForeignLog(files=(joined,), keys={}, columns=columns, remarks=(remark, *also, fastest.remark))


def _sum(accel: Message, gravity: Message) -> Message:
    """Sum of acceleration without gravity and gravity, into which a phone has parted its readings."""

    def rows() -> Iterator[pl.DataFrame]:
        (more,) = gravity.rows()
        for table in accel.rows():
            columns = accel.columns
            added = (pl.Series(c, table[c] + np.interp(table[TIME], more[TIME], more[c])) for c in columns)
            yield table.with_columns(added)

    return replace(accel, rows=rows)


def _three(log: ForeignLog, kind: str) -> tuple[ForeignLog, list[str]]:
    """A log with its time, and its columns x, y and z, by name or else the three beside one that grows; none if it has
    none."""
    if kind in log.columns.triads:
        return log, list(log.columns.triads[kind].columns)
    if not log.unnamed:
        renamed = {f"{'a' if kind == ACCEL else 'g'} {name.split()[0] if name else name}": name for name in log.cells}
        sensors = columns_by_name(renamed).triads.get(kind)
        return log, [] if sensors is None else [renamed[column] for column in sensors.columns]
    read = log.read(list(log.cells))
    rising = [name for name, column in zip(log.cells, read.T, strict=True) if grows_mostly(column)]
    time = time_by_data(list(log.cells), read) or (rising[0] if len(rising) == 1 else None)
    three = [name for name in log.cells if name != time]
    return log.with_columns(time=time), three if len(three) == len("xyz") else []


def _message(log: ForeignLog, kind: str) -> Message:
    """The three sensors of one kind in a log, with their times, s."""
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
    return Message(
        name=log.files[0].name,
        count=len(read),
        triads={kind: Sensors(columns=(x, y, z), unit=unit)},
        remark=f"{log.files[0].name}: {'; '.join(times.remarks)}",
        rows=lambda: iter([pl.DataFrame(read, schema=[TIME, x, y, z], orient="row")]),
    )
