"""One log from separate sensors: messages of a binary recording, one of several devices in a table, or accelerometers
and gyros of a phone in one file each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import polars as pl

from tumble.drafting.foreign_log import SAMPLE_ROWS, SHOWN_NAMES, ForeignLog
from tumble.drafting.times import are_even, grows_mostly, recordings_of, times_of_column
from tumble.errors import InputError, LogError
from tumble.files import OutputFolder
from tumble.recording.columns.names import (
    ACCEL,
    GYRO,
    NAMED,
    Columns,
    Sensors,
    columns_by_name,
    groups_by_name,
    is_no_sensor,
    unit_of_name,
)
from tumble.recording.columns.numbers import time_by_data
from tumble.recording.formats import TIME, Message, messages, write_log
from tumble.recording.session import AutopilotSensor
from tumble.units import TIME_UNITS

_MOST_DEVICES = 8
_WINDOWS = 20  # of a recording
_FILLED_SHARE = 0.9  # least share of windows in which a device has half its usual rows or more


def log_of_recording(
    recordings: Sequence[Path], folder: OutputFolder, message: str | None
) -> tuple[ForeignLog, Mapping[str, AutopilotSensor]]:
    """Write the log of a message of a recording, and return it with the autopilot's sensors in it.

    The message is the one with the given name, or the first with the most sensors. Two files are one recording if one
    has the accelerometers and the other the gyros. Raises InputError for several recordings, and if no message has this
    name."""
    recording = recordings[0]
    candidates = messages(*recordings)
    with_accel = [m for m in candidates if m.accel]
    if len(recordings) > 1 and (len(candidates) > len(recordings) or len(with_accel) > 1):
        raise InputError(f"{recording}: expected one recording, found {len(recordings)}; give each its own session")
    matching = [m for m in with_accel if message in (None, m.name)]
    if not matching:
        raise InputError(f"{recording}: expected a message {message!r}, found {', '.join(m.name for m in with_accel)}")
    accel = max(matching, key=lambda m: m.gyro is not None) if message is None else matching[0]
    gyro = accel if accel.gyro else None
    if gyro is None and accel.timed:  # gyros of the same clock, and of the same number if both messages have one
        number = accel.name.rpartition(".")[2]
        both = ((m, {number, m.name.rpartition(".")[2]}) for m in candidates if m.gyro and m.timed)
        gyro = next((m for m, numbers in both if sum(map(str.isdecimal, numbers)) < 2), None)
    taken = [accel] if gyro is None or gyro is accel else [accel, gyro]
    thermometers = [m.temperatures for m in taken if m.temperatures]
    one_each = len(thermometers) == 2 and max(map(len, thermometers)) == 1
    temperatures = thermometers[0] + thermometers[1] if one_each else next(iter(thermometers), ())
    log = folder.new_file("log.parquet")
    write_log(log, accel, gyro)
    remarks = [f"{recording.name}: message {accel.name}, written to {log}"]
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
        temperatures=temperatures,
    )
    imu = {kind: sensor for m in reversed(taken) for kind, sensor in m.imu.items()}
    doubts = tuple(dict.fromkeys(m.doubt for m in taken if m.doubt))
    return ForeignLog(files=(log,), columns=columns, remarks=tuple(remarks), doubts=doubts), imu


def of_one_group(log: ForeignLog, name: str | None) -> ForeignLog:
    """Return the log with one of several groups of sensors that the names of its columns tell apart.

    `name` is that of a group, by default that of the first accelerometers."""
    named = log.columns
    roles = [column for column in log.names if column in (*log.numeric, *named.times)]
    groups = groups_by_name(roles)
    if not groups or (name not in (None, *groups) and any(map(NAMED["device"].fullmatch, log.names))):
        return log
    accel = columns_by_name(roles, suffixed=True).triads.get(ACCEL)
    first = [group for group, columns in groups.items() if accel is not None and accel.columns[0] in columns]
    taken = name or (first or list(groups))[0]
    log = _with_choice(log, "several groups of sensors by the names of columns", list(groups), taken)
    others = {column for group, columns in groups.items() if group != taken for column in columns} - {*groups[taken]}
    found = columns_by_name([column for column in roles if column not in others], suffixed=True)
    if found.time is None and named.time not in others:  # times of day
        found = replace(found, time=named.time, time_unit=named.time_unit)
    return replace(log, columns=found)


def _with_choice(log: ForeignLog, several: str, names: Sequence[str], taken: str) -> ForeignLog:
    """Return the log with a remark on the devices in it. Raises InputError if there is none of the name `taken`."""
    if taken not in names:
        raise InputError(f"{log.files[0]}: expected a message {taken!r}, found {', '.join(names)}")
    others = ", ".join(name for name in names if name != taken)
    remark = f"{several}, of which {taken} is taken; also there, and not used: {others} (--message takes another)"
    return replace(log, remarks=(*log.remarks, remark))


def of_one_device(log: ForeignLog, name: str | None) -> ForeignLog:
    """Return the log with the rows of one device if a column of few whole numbers separates several.

    `name` is that of a device, by default the first. Each device has rows throughout the log, unlike the values of a
    label or a state. A column that is not named as one of devices separates them only if the stamps of each device are
    even, and those of all together are not."""
    named = log.columns
    taken = {named.time, *named.times, *named.temperatures, *named.sensors}
    free = [column for column in log.numeric if column not in taken]
    for column in sorted(free, key=lambda column: not NAMED["device"].fullmatch(column)):
        cells = log.cells.get(column) or log.readings(column)[:SAMPLE_ROWS].tolist()
        is_named = NAMED["device"].fullmatch(column) is not None
        changes = sum(a != b for a, b in pairwise(cells))
        if len(set(cells)) > _MOST_DEVICES or not (is_named or 4 * changes > len(cells)):
            continue
        try:
            table = log.read([column, *([] if named.time is None else [named.time])])
        except LogError:  # of empty values
            continue
        table = table[np.isfinite(table).all(axis=1)]
        values = np.unique(table[:, 0])
        times = np.arange(len(table), dtype=float) if named.time is None else table[:, -1]
        by_device = [times[table[:, 0] == value] for value in values]
        if not 2 <= len(values) <= _MOST_DEVICES or (values % 1.0).any():
            continue
        counts = [np.histogram(each, _WINDOWS, (times.min(), times.max()))[0] for each in by_device]
        lasting = [bool(np.mean(2 * count >= count.mean()) >= _FILLED_SHARE) for count in counts]
        if not (all(lasting) and all(map(grows_mostly, by_device))):
            continue
        if not is_named and (named.time is None or are_even(times) or not all(map(are_even, by_device))):
            continue
        names = [f"{column}.{value:g}" for value in values]
        log = _with_choice(log, f"several devices by column {column!r}", names, name or names[0])
        return replace(log, instance={column: float(values[names.index(name or names[0])])})
    return log


def are_sensors_apart(logs: Sequence[ForeignLog]) -> bool:
    """Return whether logs have one kind of sensor each, by the names of their columns or files.

    If all files have room for two kinds, they are recordings of one device."""
    if len(logs) == 1:  # gyros according to the name of the file
        (log,) = logs
        return not log.columns.triads and len(log.cells) <= 4 and set(_first_by_kind(logs)) == {GYRO}
    if any({ACCEL, GYRO} <= set(log.columns.triads) for log in logs):
        return False

    def has_room(log: ForeignLog) -> bool:
        """Return whether there are columns for both kinds, and none named x, y and z alone."""
        axes_alone = set("xyz") <= {(name.split() or [""])[0].lower() for name in log.cells}
        return not axes_alone and sum(not is_no_sensor(name) for name in log.cells) >= 6

    if all(map(has_room, logs)):
        return False
    by_kind = _first_by_kind(logs)
    if set(by_kind) == {ACCEL, GYRO}:
        return all(len(log.cells) <= 4 for log in by_kind.values() if log.unnamed)
    return not any(log.columns.triads or log.unnamed for log in logs)


def _first_by_kind(logs: Sequence[ForeignLog]) -> dict[str, ForeignLog]:
    """Return the first log of each kind of sensor by the names of columns or file.

    Uncalibrated readings come last, and accelerometers that read gravity first."""
    by_kind: dict[str, list[ForeignLog]] = {}
    for log in sorted(logs, key=lambda log: NAMED["uncalibrated"].search(log.files[0].stem) is not None):
        name = log.files[0].stem
        kind = next((kind for kind in (ACCEL, GYRO) if kind in log.columns.triads), None)
        kind = kind or next((k for k in (ACCEL, GYRO) if NAMED[k].search(name)), None)
        if kind is not None and not (kind == ACCEL and NAMED["without_gravity"].search(name)):
            by_kind.setdefault(kind, []).append(log)
    first = {kind: candidates[0] for kind, candidates in by_kind.items()}
    with_gravity = next((log for log in by_kind.get(ACCEL, []) if _reads_gravity(log)), None)
    return first if with_gravity is None else {**first, ACCEL: with_gravity}


def _reads_gravity(log: ForeignLog) -> bool:
    return log.reads_gravity(_time_and_axes(log, ACCEL)[1])


def join_sensors(logs: Sequence[ForeignLog], folder: OutputFolder) -> ForeignLog:
    """Return accelerometers and gyros of separate logs as one log at the times of the gyros."""
    by_kind = _first_by_kind(logs)
    if not by_kind:
        logs[0].check_has_sensors(gyros_suffice=True)
    parts = {kind: _message(by_kind[kind], kind) for kind in (ACCEL, GYRO) if kind in by_kind}
    gravity = next((log for log in logs if NAMED["gravity"].search(log.files[0].stem)), None)
    summed = ""
    if ACCEL in by_kind and gravity is not None and not _reads_gravity(by_kind[ACCEL]):
        (total,), (more,) = parts[ACCEL].rows(), _message(gravity, ACCEL).rows()  # which a phone writes separately
        added = [pl.Series(c, total[c] + np.interp(total[TIME], more[TIME], more[c])) for c in parts[ACCEL].columns]
        summed_rows = total.with_columns(added)
        parts[ACCEL] = replace(parts[ACCEL], rows=lambda: iter([summed_rows]))
        summed = f", {gravity.files[0].name} added to the accelerometers, which are without gravity"
    if ACCEL in by_kind and all(map(NAMED["core_motion"].fullmatch, _time_and_axes(by_kind[ACCEL], ACCEL)[1])):
        summed = ", accelerometers of opposite sign, as Apple's CoreMotion has them"
    joined = folder.new_file("log.parquet")
    first = next(iter(parts.values()))
    write_log(joined, first, parts.get(GYRO))
    used = " and ".join(dict.fromkeys(log.files[0].name for log in by_kind.values()))
    columns = Columns(time=TIME, time_unit="s", triads={kind: m.triads[kind] for kind, m in parts.items()})
    unused = [log.files[0].name for log in logs if log not in by_kind.values() and not (summed and log is gravity)]
    others = (f"also there, and not used: {', '.join(unused)}",) if unused else ()
    remark = f"{used}: one log at the times of the gyros{summed}, written to {joined}"
    fastest = parts.get(GYRO, first)
    return ForeignLog(files=(joined,), columns=columns, remarks=(remark, *others, fastest.remark))


def _time_and_axes(log: ForeignLog, kind: str) -> tuple[ForeignLog, list[str]]:
    """Return a log with its time identified, and its columns x, y and z, by name or as the three beside the time."""
    if kind in log.columns.triads:
        return log, list(log.columns.triads[kind].columns)
    if not log.unnamed:
        renamed = {f"{'a' if kind == ACCEL else 'g'} {name.split()[0] if name else name}": name for name in log.cells}
        sensors = columns_by_name(renamed).triads.get(kind)
        return log, [] if sensors is None else [renamed[column] for column in sensors.columns]
    table = log.read(list(log.cells))
    growing = [name for name, column in zip(log.cells, table.T, strict=True) if grows_mostly(column)]
    time = time_by_data(list(log.cells), table) or (growing[0] if len(growing) == 1 else None)
    axes = [name for name in log.cells if name != time]
    return log.with_columns(time=time), axes if len(axes) == 3 else []


def _message(log: ForeignLog, kind: str) -> Message:
    """Return the three sensors of one kind in a log with their times, s, as a message."""
    log, source = _time_and_axes(log, kind)
    stamps = log.stamps()
    table = log.read([column for column in (log.columns.time, *source) if column is not None])
    whole = np.isfinite(table).all(axis=1)
    if stamps is not None:  # of the rows of these sensors
        stamps = replace(stamps, values=stamps.values[whole])
    times = None if stamps is None else times_of_column(stamps)
    if not source or stamps is None or times is None:
        raise InputError(
            f"{log.files[0]}: expected a time and columns x, y and z, found "
            f"{', '.join(list(log.cells)[:SHOWN_NAMES])}; write `time,x,y,z` above the rows"
        )
    unit = unit_of_name(kind, source[0]) or unit_of_name(kind, f"{'acc' if kind == ACCEL else 'gyro'} {source[0]}")
    x, y, z = (f"{kind}_{axis}" for axis in "xyz")
    table = table[whole]
    first, *further = recordings_of(table[:, 0]) or [(0, len(table))]
    table = table[slice(*first)]
    if further:
        raise InputError(
            f"{log.files[0]}: expected one recording, found a clock that starts anew; give each its own file"
        )
    if times.keys.get("regular"):
        rows = np.arange(len(table), dtype=float)
        table[:, 0] = np.polynomial.Polynomial.fit(rows, table[:, 0], 1)(rows)
    table = table[np.argsort(table[:, 0], kind="stable")]
    table[:, 1:] *= -1.0 if all(map(NAMED["core_motion"].fullmatch, source)) else 1.0
    table[:, 0] *= 1.0 if stamps.clock else TIME_UNITS[times.keys.get("time_unit", "s")]
    return Message(
        name=log.files[0].name,
        count=len(table),
        triads={kind: Sensors(columns=(x, y, z), unit=unit)},
        remark=f"{log.files[0].name}: {'; '.join(times.remarks)}",
        rows=lambda: iter([pl.DataFrame(table, schema=[TIME, x, y, z], orient="row")]),
    )
