"""Correction of a recorded log with a calibration, sample by sample.

Each row is corrected by `tumble.use.corrector` at its temperature. No rows are added, gaps are not bridged, and numbers
that are not finite remain so. A column gets the reading d · true of a perfect sensor along its nominal axis d, in SI,
or in the log's unit if the names of the columns state it, as in "ax [g]". A redundant block is solved by least squares,
and its vector is added in the columns accel_x, accel_y, accel_z and gyro_x, gyro_y, gyro_z, in SI.

Increments stay increments: an integral over an interval T is corrected by bias · T. T is the step in time without
missing samples.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from tumble.arguments import checked
from tumble.errors import InputError, LogError
from tumble.files import FilePath
from tumble.recording.arrays import SI
from tumble.recording.columns.names import unit_of_name
from tumble.recording.log import open_log
from tumble.recording.log_source import one_ahead, rows_of_numbers
from tumble.recording.readers import source_of, write_tables
from tumble.recording.rows.gaps import side_by_side
from tumble.recording.session import Channels, Session
from tumble.recording.session_file import description_of, session_from
from tumble.recording.text.dialect import DIALECT_KEYS
from tumble.recording.text.text_log import times_of
from tumble.result.accepted import accepted_part
from tumble.result.calibration import Calibration, calibration_from
from tumble.sensors.compensation import Compensator
from tumble.sensors.model import Block
from tumble.sensors.parameters import variable_of
from tumble.units import Array, Unit
from tumble.use.corrector import Corrected, Stream

_SLICE = 1 << 14
"""Rows corrected at a time: intermediate results fit the cache of a core."""


@checked
def apply_to_session(
    calibration: Calibration | FilePath, session: Session | FilePath, out: FilePath, *, force: bool = False
) -> dict[str, Any]:
    """Correct the log of a session.

    Every column keeps its name and place; a log without names stays without. Sensors are corrected as by
    `Calibration.apply`, in SI or in the unit that the names of their columns state. Everything else is copied, from CSV
    as text. Memory does not grow with the log.

    Parameters
    ----------
    calibration
        An accepted calibration of the device, or its file. If only its accelerometers or its gyros are accepted, the
        columns of the others are copied.
    session
        The session, or its folder. Several files of a log are concatenated.
    out
        File to write, .csv or .parquet. It is written whole or not at all.
    force
        Whether to replace an existing file; the log itself is never replaced.

    Returns
    -------
    dict
        Description of the corrected log, as `session_of` and `write_session` take it.

    Raises
    ------
    InputError
        If the calibration is not accepted, belongs to another device or lacks a sensor, or the log cannot be read.

    Examples
    --------
    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> description = tumble.apply_to_session(tumble.calibrate(folder), folder, "corrected.parquet")
    >>> description["log"]["gyro"]
    {'columns': ['gx', 'gy', 'gz'], 'unit': 'rad/s'}
    """
    calibration, session, path = accepted_part(calibration_from(calibration)), session_from(session), Path(out)
    session.check_new(path, force=force)
    inputs = _input_channels(calibration, session)
    outputs = {kind: channels for kind, channels in inputs.items() if getattr(calibration, kind) is not None}
    for kind, channels in outputs.items():  # in the unit that the names of the columns state, else in SI
        if {unit_of_name(kind, column) for column in channels.columns} != {channels.unit_name}:
            sensors = len(channels.columns)
            rate, increment = SI.get(kind, (channels.unit_name, channels.unit_name))  # names of the units
            outputs[kind] = replace(
                channels,
                unit=Unit(factor=1.0, kind=channels.unit.kind),
                unit_name=increment if channels.unit.kind == "increment" else rate,
                scale=np.ones(sensors),
                offset=np.zeros(sensors),
            )
    log = open_log(session)
    headerless = path.suffix == ".csv" and session.log.dialect is not None and not session.log.dialect.header
    write_tables(path, _corrected_tables(session, calibration, inputs, outputs, 1.0 / log.rate), header=not headerless)
    content = description_of(session)
    table = {key: value for key, value in content["log"].items() if key not in (*DIALECT_KEYS, "file")}
    for kind, channels in outputs.items():
        if channels is not inputs[kind] and kind in table:
            kept = {key: table[kind][key] for key in ("columns", "axes") if key in table[kind]}
            table[kind] = {**kept, "unit": channels.unit_name}
    return {**content, "log": {"file": str(path.resolve()), **({"header": False} if headerless else {}), **table}}


def correction_notes(calibration: Calibration | FilePath, session: Session | FilePath) -> tuple[str, ...]:
    """Return sentences on which groups beyond the linear model `apply_to_session` applies, and which it does not."""
    calibration, session = accepted_part(calibration_from(calibration)), session_from(session)
    compensator = calibration.compensator
    variables = {variable_of(p.name) for p in calibration.parameters}
    notes = [f"{absent}; their columns are copied as they are" for absent in calibration.provenance.absent]
    without = "the calibration" if session.log.gyro is not None else "the session"
    if np.any(compensator.levers) and (session.log.gyro is None or compensator.gyro is None):
        notes.append(f"lever arms are not corrected: {without} has no gyros")
    elif np.any(compensator.levers):
        notes.append("lever arms: the readings of the accelerometers are moved to the place of the last one")
    if np.any(late_ms := 1e3 * compensator.delays):
        size = f"{late_ms[0]:.3g} ms" if np.ptp(late_ms) == 0.0 else f"{late_ms.min():.3g} to {late_ms.max():.3g} ms"
        notes.append(f"the delay of the accelerometers, {size}, is not corrected: subtract it from their times")
    if compensator.warm and session.log.temperature is None:
        reference = calibration.reference_temperature
        temperature = "the reference" if reference is None else f"{reference:.1f} °C"
        notes.append(f"the session has no temperature: parameters are those at {temperature}")
    elif compensator.warm and any(compensator.lags.values()):
        lags = ", ".join(f"{lag:z.0f} s ({kind})" for kind, lag in compensator.lags.items())
        notes.append(f"sensors follow the thermometer with a lag of {lags}")
    if "hysteresis" in variables:
        notes.append("hysteresis over temperature is not applied: parameters are the mean of both ways")
    if "time" in variables:
        notes.append("drift in time is not corrected: it belongs to the session in which it was found")
    return tuple(notes)


def _input_channels(calibration: Calibration, session: Session) -> dict[str, Channels]:
    """Return the sensors whose readings the correction needs; the g-sensitivity of gyros needs the accelerometers.

    Raises InputError for a calibration of another device or of other sensors."""
    check_device(calibration, session)
    log, compensator = session.log, calibration.compensator
    inputs = {"accel": log.accel}
    if log.gyro is not None and (calibration.gyro is not None or not calibration.provenance.absent):
        inputs["gyro"] = log.gyro
    for kind, channels in inputs.items():
        block: Block | None = getattr(compensator, kind)
        count = 0 if block is None else block.size
        if count != len(channels.columns):
            raise InputError(
                f"{session.name}: log.{kind}: expected as many sensors as the calibration has, {count}, found "
                f"{len(channels.columns)}; columns that the session does not name are copied"
            )
    if log.magnetometer is not None and calibration.mag is not None:
        unit = calibration["mag.bias.x"].unit
        if log.magnetometer.unit_name != unit:
            raise InputError(
                f"{session.name}: log.magnetometer.unit: expected that of the calibration, {unit!r}, found "
                f"{log.magnetometer.unit_name!r}; calibrate in the unit of the log"
            )
        inputs["mag"] = log.magnetometer
    return inputs


def _vector_columns(kind: str, channels: Channels) -> list[str]:
    """Return the names of the columns that a redundant block's vector gets; none for a triad."""
    return [f"{kind}_{axis}" for axis in "xyz"] if len(channels.columns) > 3 else []


def _readings(channels: Channels, table: pl.DataFrame) -> Array:
    """Return the readings (N, n) of a table, SI; increments as integrals."""
    raw = side_by_side(table, channels.columns)
    return channels.to_si(raw, np.ones(len(raw)))


def _corrected_tables(
    session: Session,
    calibration: Calibration,
    inputs: Mapping[str, Channels],
    outputs: Mapping[str, Channels],
    interval: float,
) -> Iterator[pl.DataFrame]:
    """Yield the corrected tables of all files of a log, with the columns `outputs` for the sensors `inputs`."""
    names: list[str] | None = None  # columns of the first file
    layout = session.log
    numbers = [column for channels in inputs.values() for column in channels.columns]
    if layout.dialect is not None and layout.dialect.decimal == ",":  # all columns that the session names
        numbers = [column for column in layout.columns if not (layout.clock and column == layout.time)]
    thermometers = 1 if layout.temperature is None else len(layout.temperature.columns)
    compensator = calibration.compensator
    stream = Stream(compensator, interval, blocks=(session.accel_block, session.gyro_block), thermometers=thermometers)
    for file in layout.files:
        source = source_of(file, layout.dialect)
        added = (column for kind, channels in outputs.items() for column in _vector_columns(kind, channels))
        for column in (column for column in added if column in source.names):
            raise InputError(f"{source.path}: expected no column '{column}', the block's vector gets it; rename it")
        slices = chain.from_iterable(t.iter_slices(_SLICE) for t in one_ahead(source.whole(numbers)))
        for table, true in _corrected_vectors(slices, source.path, session, inputs, compensator, stream, interval):
            names = table.columns if names is None else names
            if table.columns != names:
                raise LogError(
                    f"{source.path}: expected the columns of the first file, {', '.join(names)}; write them alike"
                )
            if calibration.mag is not None and "mag" in inputs:
                true["mag"] = calibration.mag.apply(_readings(inputs["mag"], table))
            columns = dict[str, Array]()
            for kind, channels in outputs.items():
                along_body = np.array_equal(channels.axes, np.eye(3))
                perfect = true[kind] if along_body else true[kind] @ channels.axes.T
                columns |= zip(channels.columns, channels.from_si(perfect).T, strict=True)
                columns |= zip(_vector_columns(kind, channels), true[kind].T, strict=False)
            corrected_columns = {name: pl.Series(name, column.copy()) for name, column in columns.items()}
            # polars' `with_columns` takes as long as correcting a few thousand rows
            yield pl.DataFrame(list(({each.name: each for each in table} | corrected_columns).values()))


def _corrected_vectors(
    tables: Iterable[pl.DataFrame],
    path: Path,
    session: Session,
    inputs: Mapping[str, Channels],
    compensator: Compensator,
    stream: Stream,
    interval: float,
) -> Iterator[tuple[pl.DataFrame, dict[str, Array]]]:
    """Yield the tables of one file with the true vectors (N, 3) of their rows, or their increments, by kind of sensor.

    If the stream has a delay, each table is yielded after the next one is read."""
    layout = session.log
    increments = {kind for kind, channels in inputs.items() if channels.unit.kind == "increment"}
    irregular = layout.time is not None and not layout.regular and (stream.moved or bool(increments))
    warm = compensator.warm and bool(compensator.references)
    ready = {kind: np.zeros((0, 3)) for kind in ("accel", "gyro")[: 1 + stream.gyros]}  # vectors not yet yielded
    waiting = list[tuple[pl.DataFrame, Array]]()  # tables whose vectors are not all ready, and intervals (N, 1), s
    last: float | None = None  # time of the row before the table, s

    def complete(corrected: Corrected) -> Iterator[tuple[pl.DataFrame, dict[str, Array]]]:
        """Yield the tables that have all their vectors with these."""
        for kind, vectors in (("accel", corrected.force), ("gyro", corrected.rate)):
            if vectors is not None:
                ready[kind] = np.concatenate([ready[kind], vectors])
        while waiting and len(ready["accel"]) >= waiting[0][0].height:
            table, intervals = waiting.pop(0)
            N = table.height
            yield table, {kind: true[:N] * (intervals if kind in increments else 1.0) for kind, true in ready.items()}
            ready.update({kind: true[N:] for kind, true in ready.items()})

    for table in tables:
        time = celsius = None
        with rows_of_numbers(path):
            if irregular:
                time = times_of(table[layout.time or ""], layout)
            if layout.temperature is not None and warm:
                numbers = table.select(pl.col(layout.temperature.columns).cast(pl.Float64)).to_numpy()
                celsius = np.asarray(layout.temperature.to_celsius(numbers), dtype=float)
        steps = np.full(table.height, interval)
        if increments and time is not None:
            steps = _steps(time, time[0] - interval if last is None else last, interval, path)
            last = float(time[-1])
        intervals = steps[:, None]
        with np.errstate(invalid="ignore"):  # damaged readings or steps give NaN
            means = {
                kind: _readings(inputs[kind], table) / (intervals if kind in increments else 1.0)
                for kind in ("accel", "gyro")
                if kind in inputs
            }
        waiting.append((table, intervals))
        yield from complete(stream.add(means["accel"], means.get("gyro"), time, celsius))
    yield from complete(stream.finish())


def _steps(time: Array, before: float, interval: float, path: Path) -> Array:
    """Return the steps in time (N,) up to each row, s, without missing samples; `before` is the time of the row before
    the first. Raises LogError if the times do not increase."""
    steps = np.diff(time, prepend=before)
    if not (steps > 0.0).all():
        when = time[np.argmin(steps > 0.0)]
        raise LogError(f"{path}: expected times that increase, found {when:.9g} s after a later one; cut the log")
    return np.asarray(steps / np.maximum(np.floor(steps / interval + 0.5), 1.0))


def check_device(calibration: Calibration, session: Session) -> None:
    """Raise InputError for a session of another device, or with other thermometers if the parameters need them.

    A session without thermometers passes."""
    if session.device.serial != calibration.serial:
        raise InputError(
            f"{session.name}: expected a session of device {calibration.serial!r}, which was calibrated, found "
            f"{session.device.serial!r}"
        )
    temperature = session.log.temperature
    if temperature is None or (calibration.accel is None and calibration.gyro is None):
        return
    compensator = calibration.compensator
    blocks = (compensator.accel, session.accel_block), (compensator.gyro, session.gyro_block)
    for block, here in blocks if compensator.warm else ():
        if block is not None and here is not None and not np.array_equal(block.thermometer, here.thermometer):
            names = ", ".join(calibration.temperature.thermometers.get(block.kind, ())) or "one for all sensors"
            raise InputError(
                f"{session.name}: log.temperature.columns: expected a thermometer for each sensor {block.kind} as in "
                f"the calibration, {names}, found {', '.join(temperature.names(block.kind))}"
            )
