"""Recordings corrected with a calibration: a log in, a log out, sample by sample.

Each row is corrected by `tumble.use.corrector` at its temperature. Rows are neither added nor bridged, and a number
that is not finite stays so. A column gets what a perfect sensor in its place would read, d · true, with its nominal
axis d, in SI, or in the log's unit if the names of the columns state it, as in "ax [g]". A redundant block is solved by
least squares, and its vector is added in the columns accel_x, accel_y, accel_z and gyro_x, gyro_y, gyro_z, in SI.

Increments stay increments: an integral over an interval T is corrected by bias · T. T is the step in time, less the
samples that are missing in it.
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
from tumble.sensors.parameters import groups, positions_by_group
from tumble.units import Array, Unit
from tumble.use.corrector import Stream

_SLICE = 1 << 14
"""Rows that are corrected at a time: what is made of them on the way fits the cache of a core."""


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
        The session, or its folder. The files of a log are written one below the other.
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
        For a calibration that is not accepted, belongs to another device or lacks a sensor, and for a log that cannot
        be read.

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
    read = _channels(calibration, session)
    written = {kind: _written(kind, each) for kind, each in read.items() if getattr(calibration, kind) is not None}
    log = open_log(session)
    nameless = path.suffix == ".csv" and session.log.dialect is not None and not session.log.dialect.header
    write_tables(path, _tables(session, calibration, read, written, 1.0 / log.rate), header=not nameless)
    content = description_of(session)
    table = {key: value for key, value in content["log"].items() if key not in (*DIALECT_KEYS, "file")}
    for kind, channels in written.items():
        if channels is not read[kind] and kind in table:
            stated = {key: table[kind][key] for key in ("columns", "axes") if key in table[kind]}
            table[kind] = {**stated, "unit": channels.unit_name}
    return {**content, "log": {"file": str(path.resolve()), **({"header": False} if nameless else {}), **table}}


def correction_notes(calibration: Calibration | FilePath, session: Session | FilePath) -> tuple[str, ...]:
    """Sentences on the parameters beyond the linear model that `apply_to_session` corrects, and that it does not."""
    calibration, session = accepted_part(calibration_from(calibration)), session_from(session)
    compensator = calibration.compensator
    groups_here = positions_by_group(p.name for p in calibration.parameters)
    out = [f"{absent}; their columns are copied as they are" for absent in calibration.provenance.absent]
    without = "the calibration" if session.log.gyro is not None else "the session"
    if np.any(compensator.levers) and (session.log.gyro is None or compensator.gyro is None):
        out.append(f"lever arms are not corrected: {without} has no gyros")
    elif np.any(compensator.levers):
        out.append("lever arms: the readings of the accelerometers are moved to the place of the last one")
    if np.any(late := 1e3 * compensator.delays):
        size = f"{late[0]:.3g} ms" if np.ptp(late) == 0.0 else f"{late.min():.3g} to {late.max():.3g} ms"
        out.append(f"the delay of the accelerometers, {size}, is not undone: take it off their times")
    if compensator.warm and session.log.temperature is None:
        reference = calibration.reference_temperature
        temperature = "the reference" if reference is None else f"{reference:.1f} °C"
        out.append(f"the session has no temperature: parameters are those at {temperature}")
    elif compensator.warm and any(compensator.lags.values()):
        lags = ", ".join(f"{lag:z.0f} s ({kind})" for kind, lag in compensator.lags.items())
        out.append(f"sensors follow the thermometer with a lag of {lags}")
    if any(group.variable == "hysteresis" for group in groups() if group.name in groups_here):
        out.append("hysteresis over temperature is not applied: parameters are the mean of both ways")
    if any(group.variable == "time" for group in groups() if group.name in groups_here):
        out.append("drift in time is not undone: it belongs to the session in which it was found")
    return tuple(out)


def _channels(calibration: Calibration, session: Session) -> dict[str, Channels]:
    """The sensors whose readings the correction takes, by kind; accelerometers that the calibration does not have for
    what gyros feel of them. Raises InputError for a calibration of another device or of other sensors."""
    check_device(calibration, session)
    log, compensator = session.log, calibration.compensator
    read = {"accel": log.accel}
    if log.gyro is not None and (calibration.gyro is not None or not calibration.provenance.absent):
        read["gyro"] = log.gyro
    for kind, channels in read.items():
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
        read["mag"] = log.magnetometer
    return read


def _written(kind: str, channels: Channels) -> Channels:
    """The corrected columns: in the log's unit, scale and offset if their names state them, else in SI."""
    if {unit_of_name(kind, column) for column in channels.columns} == {channels.unit_name}:
        return channels
    sensors, (rate, increment) = len(channels.columns), SI.get(kind, (channels.unit_name,) * 2)
    return replace(
        channels,
        unit=Unit(factor=1.0, kind=channels.unit.kind),
        unit_name=increment if channels.unit.kind == "increment" else rate,
        scale=np.ones(sensors),
        offset=np.zeros(sensors),
    )


def _vector_columns(kind: str, channels: Channels) -> list[str]:
    """Columns for the vector of a redundant block."""
    return [f"{kind}_{axis}" for axis in "xyz"] if len(channels.columns) > 3 else []


def _readings(channels: Channels, table: pl.DataFrame) -> Array:
    """Readings (N, n) of a table, SI; of increments the integrals themselves."""
    raw = side_by_side(table, channels.columns)
    return channels.to_si(raw, np.ones(len(raw)))


def _tables(
    session: Session,
    calibration: Calibration,
    read: Mapping[str, Channels],
    written: Mapping[str, Channels],
    interval: float,
) -> Iterator[pl.DataFrame]:
    """The corrected rows of all files, in tables of a bounded size."""
    names: list[str] | None = None
    spec = session.log
    numbers = [column for channels in read.values() for column in channels.columns]  # the others are as they are
    if spec.dialect is not None and spec.dialect.decimal == ",":  # all that the session names
        numbers = [column for column in spec.columns if not (spec.clock and column == spec.time)]
    heat = 1 if spec.temperature is None else len(spec.temperature.columns)
    compensator = calibration.compensator
    stream = Stream(compensator, interval, blocks=(session.accel_block, session.gyro_block), heat=heat)
    for file in spec.files:
        source = source_of(file, spec.dialect)
        added = (column for kind, channels in written.items() for column in _vector_columns(kind, channels))
        for column in (column for column in added if column in source.names):
            raise InputError(f"{source.path}: expected no column '{column}', the block's vector gets it; rename it")
        slices = chain.from_iterable(t.iter_slices(_SLICE) for t in one_ahead(source.whole(numbers)))
        for table, true in _corrected(slices, source.path, session, read, compensator, stream, interval):
            names = table.columns if names is None else names
            if table.columns != names:
                raise LogError(
                    f"{source.path}: expected the columns of the first file, {', '.join(names)}; write them alike"
                )
            if calibration.mag is not None and "mag" in read:
                true["mag"] = calibration.mag.apply(_readings(read["mag"], table))
            new = dict[str, Array]()
            for kind, channels in written.items():
                along_body = np.array_equal(channels.axes, np.eye(3))
                perfect = true[kind] if along_body else true[kind] @ channels.axes.T
                new |= zip(channels.columns, channels.from_si(perfect).T, strict=True)
                new |= zip(_vector_columns(kind, channels), true[kind].T, strict=False)
            corrected_columns = {name: pl.Series(name, column.copy()) for name, column in new.items()}
            # `with_columns` of polars takes as long as correcting a few thousand rows
            yield pl.DataFrame(list(({each.name: each for each in table} | corrected_columns).values()))


def _corrected(
    tables: Iterable[pl.DataFrame],
    path: Path,
    session: Session,
    read: Mapping[str, Channels],
    compensator: Compensator,
    stream: Stream,
    interval: float,
) -> Iterator[tuple[pl.DataFrame, dict[str, Array]]]:
    """Tables of one file with the true vectors (N, 3) of their rows by kind of sensor, or their increments. With a
    stream that has a delay, a table comes after the next one is read."""
    spec, increments = session.log, {kind for kind, channels in read.items() if channels.unit.kind == "increment"}
    irregular = spec.time is not None and not spec.regular and (stream.moved or bool(increments))
    warm = compensator.warm and bool(compensator.references)
    ready = {kind: np.zeros((0, 3)) for kind in ("accel", "gyro")[: 1 + stream.gyros]}
    waiting, last = list[tuple[pl.DataFrame, Array]](), None
    for table in chain(tables, [None]):
        if table is None:
            now = stream.finish()
        else:
            time = celsius = None
            intervals = np.ones((table.height, 1))
            with rows_of_numbers(path):
                if irregular:
                    time = times_of(table[spec.time or ""], spec)
                if spec.temperature is not None and warm:
                    numbers = table.select(pl.col(spec.temperature.columns).cast(pl.Float64)).to_numpy()
                    celsius = np.asarray(spec.temperature.to_celsius(numbers), dtype=float)
            if increments:  # each is the integral over its step in time, less the samples that are missing in it
                steps = np.full(table.height, interval)
                if time is not None:
                    steps = np.diff(time, prepend=time[0] - interval if last is None else last)
                    last = float(time[-1])
                    if not (steps > 0.0).all():
                        when = time[np.argmin(steps > 0.0)]
                        raise LogError(
                            f"{path}: expected times that increase, found {when:.9g} s after a later one; cut the log"
                        )
                    steps /= np.maximum(np.floor(steps / interval + 0.5), 1.0)
                intervals = steps[:, None]
            with np.errstate(invalid="ignore"):  # damaged readings or steps give readings that are no numbers
                means = {
                    kind: _readings(read[kind], table) / (intervals if kind in increments else 1.0)
                    for kind in ("accel", "gyro")
                    if kind in read
                }
            now = stream.add(means["accel"], means.get("gyro"), time, celsius)
            waiting.append((table, intervals))
        for kind, vectors in (("accel", now.force), ("gyro", now.rate)):
            if vectors is not None:
                ready[kind] = np.concatenate([ready[kind], vectors])
        while waiting and len(ready["accel"]) >= waiting[0][0].height:
            table, intervals = waiting.pop(0)
            N = table.height
            yield (
                table,
                {kind: true[:N] * (intervals if kind in increments else 1.0) for kind, true in ready.items()},
            )
            ready = {kind: true[N:] for kind, true in ready.items()}


def check_device(calibration: Calibration, session: Session) -> None:
    """Raise InputError for a session of another device than the calibration's, or one whose sensors have other
    thermometers, where they depend on temperature. A session without thermometers passes."""
    if session.device.serial != calibration.serial:
        raise InputError(
            f"{session.name}: expected a session of device {calibration.serial!r}, which was calibrated, found "
            f"{session.device.serial!r}"
        )
    temperature = session.log.temperature
    if (
        temperature is None
        or (calibration.accel is None and calibration.gyro is None)
        or not calibration.compensator.warm
    ):
        return
    compensator = calibration.compensator
    for made, now in ((compensator.accel, session.accel_block), (compensator.gyro, session.gyro_block)):
        if made is not None and now is not None and not np.array_equal(made.thermometer, now.thermometer):
            then = ", ".join(calibration.temperature.thermometers.get(made.kind, ())) or "one for all sensors"
            raise InputError(
                f"{session.name}: log.temperature.columns: expected a thermometer for each sensor {made.kind} as in "
                f"the calibration, {then}, found {', '.join(temperature.names(made.kind))}"
            )
