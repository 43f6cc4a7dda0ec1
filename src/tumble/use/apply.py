"""Recordings corrected with a calibration: a log in, a log out, sample by sample.

Each row is corrected by `tumble.use.corrector` at its temperature. Rows are neither added nor bridged, and a number
that is not finite stays so. A column gets what a perfect sensor in its place would read, d · true, with its nominal
axis d, in SI, or in the log's unit if the names of the columns state it, as in "ax [g]". A redundant block is solved by
least squares, and its vector is added in the columns accel_x, accel_y, accel_z and gyro_x, gyro_y, gyro_z, in SI.

Increments stay increments: an integral over an interval T is corrected by bias · T. T is the step in time, less the
samples that are missing in it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
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
from tumble.sensors.model import SensorModel
from tumble.sensors.parameters import groups, positions_by_group
from tumble.units import Array, Unit
from tumble.use.corrector import Stream

_SLICE = 1 << 14
"""Rows that are corrected at a time: what is made of them on the way fits the cache of a core."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Correction:
    """The sensors of one kind and their model. If they are not in the calibration, their columns are `copied`, and
    their readings are used in the correction of others."""

    kind: str
    channels: Channels
    model: SensorModel
    copied: bool = False

    @cached_property
    def written(self) -> Channels:
        """The corrected columns: in the log's unit, scale and offset if their names state them, else in SI."""
        named = {unit_of_name(self.kind, column) for column in self.channels.columns}
        if self.copied or named == {self.channels.unit_name}:
            return self.channels
        sensors, (rate, increment) = len(self.channels.columns), SI.get(self.kind, (self.channels.unit_name,) * 2)
        return replace(
            self.channels,
            unit=Unit(factor=1.0, kind=self.channels.unit.kind),
            unit_name=increment if self.increments else rate,
            scale=np.ones(sensors),
            offset=np.zeros(sensors),
        )

    @property
    def increments(self) -> bool:
        return self.channels.unit.kind == "increment"

    @property
    def added(self) -> tuple[str, ...]:
        """Columns for the vector of a redundant block."""
        return (
            tuple(f"{self.kind}_{axis}" for axis in "xyz") if len(self.channels.columns) > 3 and not self.copied else ()
        )

    def readings(self, table: pl.DataFrame) -> Array:
        """Readings (N, n) of a table, SI; of increments the integrals themselves."""
        raw = side_by_side(table, self.channels.columns)
        return self.channels.to_si(raw, np.ones(len(raw)))

    def columns(self, true: Array) -> dict[str, Array]:
        """The columns of corrected vectors (N, 3)."""
        if self.copied:
            return {}
        along_body = np.array_equal(self.channels.axes, np.eye(3))
        perfect = true if along_body else true @ self.channels.axes.T
        out = dict(zip(self.channels.columns, self.written.from_si(perfect).T, strict=True))
        return out | dict(zip(self.added, true.T, strict=False))


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
    parts = _parts(calibration, session)
    log = open_log(session)
    nameless = path.suffix == ".csv" and session.log.dialect is not None and not session.log.dialect.header
    write_tables(path, _tables(session, parts, calibration.compensator, 1.0 / log.rate), header=not nameless)
    content = description_of(session)
    table = {key: value for key, value in content["log"].items() if key not in (*DIALECT_KEYS, "file")}
    for part in parts:
        if part.written is not part.channels and part.kind in table:
            stated = {key: table[part.kind][key] for key in ("columns", "axes") if key in table[part.kind]}
            table[part.kind] = {**stated, "unit": part.written.unit_name}
    return {**content, "log": {"file": str(path.resolve()), **({"header": False} if nameless else {}), **table}}


def applied(calibration: Calibration | FilePath, session: Session | FilePath) -> tuple[str, ...]:
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


def _parts(calibration: Calibration, session: Session) -> tuple[_Correction, ...]:
    """The sensors to correct. Raises InputError for a calibration of another device or of other sensors."""
    check_device(calibration, session)
    copied = calibration.accel is None
    wanted: list[tuple[str, SensorModel | None, Channels]] = [
        ("accel", calibration.accel or calibration.compensator.model("accel"), session.log.accel)
    ]
    if session.log.gyro is not None and (calibration.gyro is not None or not calibration.provenance.absent):
        wanted.append(("gyro", calibration.gyro, session.log.gyro))
    parts = []
    for kind, model, channels in wanted:
        count = 0 if model is None else len(model.bias)
        if model is None or count != len(channels.columns):
            raise InputError(
                f"{session.name}: log.{kind}: expected as many sensors as the calibration has, {count}, found "
                f"{len(channels.columns)}; columns that the session does not name are copied"
            )
        parts.append(_Correction(kind=kind, channels=channels, model=model, copied=copied and kind == "accel"))
    if session.log.magnetometer is not None and calibration.mag is not None:
        magnetometer, unit = session.log.magnetometer, calibration["mag.bias.x"].unit
        if magnetometer.unit_name != unit:
            raise InputError(
                f"{session.name}: log.magnetometer.unit: expected that of the calibration, {unit!r}, found "
                f"{magnetometer.unit_name!r}; calibrate in the unit of the log"
            )
        parts.append(_Correction(kind="mag", channels=magnetometer, model=calibration.mag))
    return tuple(parts)


def _tables(
    session: Session, parts: tuple[_Correction, ...], compensator: Compensator, interval: float
) -> Iterator[pl.DataFrame]:
    """The corrected rows of all files, in tables of a bounded size."""
    names: list[str] | None = None
    spec = session.log
    numbers = [column for part in parts for column in part.channels.columns]  # the other columns are as they are
    if spec.dialect is not None and spec.dialect.decimal == ",":  # all that the session names
        numbers = [column for column in spec.columns if not (spec.clock and column == spec.time)]
    blocks, heat = (session.accel_block, session.gyro_block), 1
    if spec.temperature is not None:
        heat = len(spec.temperature.columns)
    stream = Stream(compensator, interval, blocks=blocks, heat=heat)
    for file in spec.files:
        source = source_of(file, spec.dialect)
        for added in (column for part in parts for column in part.added if column in source.names):
            raise InputError(f"{source.path}: expected no column '{added}', the block's vector gets it; rename it")
        slices = chain.from_iterable(t.iter_slices(_SLICE) for t in one_ahead(source.whole(numbers)))
        for table, true in _corrected(slices, source.path, session, parts, compensator, stream, interval):
            names = table.columns if names is None else names
            if table.columns != names:
                raise LogError(
                    f"{source.path}: expected the columns of the first file, {', '.join(names)}; write them alike"
                )
            true |= {part.kind: part.model.apply(part.readings(table)) for part in parts if part.kind == "mag"}
            new = {name: c for part in parts for name, c in part.columns(true[part.kind]).items()}
            corrected_columns = {name: pl.Series(name, column.copy()) for name, column in new.items()}
            # `with_columns` of polars takes as long as correcting a few thousand rows
            yield pl.DataFrame(list(({each.name: each for each in table} | corrected_columns).values()))


def _corrected(
    tables: Iterable[pl.DataFrame],
    path: Path,
    session: Session,
    parts: tuple[_Correction, ...],
    compensator: Compensator,
    stream: Stream,
    interval: float,
) -> Iterator[tuple[pl.DataFrame, dict[str, Array]]]:
    """Tables of one file with the true vectors (N, 3) of their rows by kind of sensor, or their increments. With a
    stream that has a delay, a table comes after the next one is read."""
    spec, increments = session.log, [part.kind for part in parts if part.increments]
    irregular = spec.time is not None and not spec.regular and (stream.moved or bool(increments))
    warm = compensator.warm and bool(compensator.references)
    ready = {kind: np.zeros((0, 3)) for kind in ("accel", "gyro")[: 1 + stream.gyros]}
    waiting, last = list[tuple[pl.DataFrame, Array | None]](), None
    for table in chain(tables, [None]):
        if table is None:
            now = stream.finish()
        else:
            time = celsius = intervals = None
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
                    part.kind: part.readings(table) / (intervals if intervals is not None and part.increments else 1.0)
                    for part in parts
                    if part.kind in ("accel", "gyro")
                }
            now = stream.add(means["accel"], means.get("gyro"), time, celsius)
            waiting.append((table, intervals))
        for kind, vectors in (("accel", now.force), ("gyro", now.rate)):
            if vectors is not None:
                ready[kind] = np.concatenate([ready[kind], vectors])
        while waiting and len(ready["accel"]) >= waiting[0][0].height:
            table, intervals = waiting.pop(0)
            yield (
                table,
                {
                    kind: vectors[: table.height] * (intervals if intervals is not None and kind in increments else 1.0)
                    for kind, vectors in ready.items()
                },
            )
            ready = {kind: vectors[table.height :] for kind, vectors in ready.items()}


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
