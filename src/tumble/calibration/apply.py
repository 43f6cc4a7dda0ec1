"""Recordings corrected with a calibration: a log in, a log out, sample by sample.

A correction needs no other sample than its own, so rows are neither added nor bridged: a number that is not finite
stays so in its row. What a column gets is what a perfect sensor in that place would read, d · true with its nominal
axis d, those of a magnetometer being the axes of its own frame; for three sensors along the body axes that is the true
vector itself. It is in SI, unless the names of the columns say the log's unit: "ax [g]" stays in g. A redundant block
is solved by least squares first, and its vector is added in the columns accel_x, accel_y, accel_z and gyro_x, gyro_y,
gyro_z, in SI.

Increments stay increments: an integral over an interval T is corrected by bias · T, and its interval is the step in
time, as in `log`, less the samples that are missing in it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from tumble.calibration.calibration_file import Calibration, calibration_from, corrected
from tumble.calibration.observed import inspect_session
from tumble.errors import InputError, LogError
from tumble.files import FilePath
from tumble.recording.arrays import SI
from tumble.recording.description import description_of
from tumble.recording.formats.columns import unit_of_name
from tumble.recording.log import open_log
from tumble.recording.readers import LogSource, rows_of_numbers, source_of, times_of
from tumble.recording.session import Channels, LogSpec, Magnetometer, Session, session_from
from tumble.recording.writer import write_tables
from tumble.sensors.model import SensorModel
from tumble.units import Array, Unit


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Correction:
    """The sensors of one kind and what corrects them."""

    kind: str
    channels: Channels
    model: SensorModel

    @property
    def written(self) -> Channels:
        """What the corrected columns are: in the log's own unit, with its nominal scale and offset, where the names of
        the columns say it, else in SI."""
        if self._unit_is_named:
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
    def _unit_is_named(self) -> bool:
        """Whether the name of every column says the log's unit."""
        said = {unit_of_name(self.kind, column) for column in self.channels.columns}
        return said == {self.channels.unit_name}

    @property
    def increments(self) -> bool:
        return self.channels.unit.kind == "increment"

    @property
    def along_body(self) -> bool:
        return np.array_equal(self.channels.axes, np.eye(3))

    @property
    def added(self) -> tuple[str, ...]:
        """Columns for the vector of a redundant block."""
        return tuple(f"{self.kind}_{axis}" for axis in "xyz") if len(self.channels.columns) > 3 else ()

    def columns(self, table: pl.DataFrame, dt: Array | None) -> dict[str, Array]:
        """The corrected columns of a table with intervals `dt`, s."""
        raw = np.ascontiguousarray(table.select(self.channels.columns).to_numpy())
        # the integral itself, for increments: the mean over an interval of 1 s
        readings = self.channels.to_si(raw, np.ones(len(raw)))
        true = corrected(self.model, readings, dt if self.increments else None)
        perfect = true if self.along_body else true @ self.channels.axes.T
        out = dict(zip(self.channels.columns, self.written.from_si(perfect).T, strict=True))
        return out | dict(zip(self.added, true.T, strict=False))


def apply_to_session(calibration: Calibration | FilePath, session: Session | FilePath, out: FilePath) -> dict[str, Any]:
    """Correct the log of a session, into a .csv or .parquet file, whole or not at all, as a stream: memory does not
    grow with the log. Several files of a log come one below the other. The calibration is one or its file, the session
    one or its folder. Returns the description of the corrected log, as `session_of` and `write_session` take it.

    Every column keeps its name and place; sensors are corrected as `Calibration.apply` does and are in SI, or, where
    the names of their columns say the log's unit, in that; everything else is copied, from CSV as the text it is.
    Raises InputError for a calibration that is not accepted, is of another device or lacks a sensor, and for a log
    that cannot be read.

    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> description = tumble.apply_to_session(tumble.calibrate(folder), folder, "corrected.parquet")
    >>> description["log"]["gyro"]
    {'columns': ['gx', 'gy', 'gz'], 'unit': 'rad/s'}
    """
    calibration, session, path = calibration_from(calibration), session_from(session), Path(out)
    parts = _parts(calibration, session)
    log = open_log(session)
    write_tables(path, _tables(session, parts, 1.0 / log.rate))
    return _described(session, parts, path)


def _described(session: Session, parts: tuple[_Correction, ...], out: Path) -> dict[str, Any]:
    """The description of the corrected log."""
    channels = {part.kind: part.written for part in parts}
    spec = replace(session.log, files=(out.resolve(),), dialect=None)
    return description_of(replace(session, log=replace(spec, accel=channels["accel"], gyro=channels.get("gyro"))))


def _parts(calibration: Calibration, session: Session) -> tuple[_Correction, ...]:
    """What is to be corrected; the calibration is that of the session's device."""
    if not calibration.outcome.accepted:
        raise InputError(f"calibration: expected an accepted one, found: {'; '.join(calibration.outcome.reasons)}")
    if calibration.serial != session.device.serial:
        raise InputError(
            f"{session.name}: expected the device of the calibration, {calibration.serial!r}, found "
            f"{session.device.serial!r}; calibrate that device"
        )
    parts = [_part("accel", calibration.accel, session.log.accel, session)]
    if session.log.gyro is not None:
        parts.append(_part("gyro", calibration.gyro, session.log.gyro, session))
    if session.log.magnetometer is not None and calibration.mag is not None:
        parts.append(_magnetometer_part(calibration, calibration.mag, session.log.magnetometer, session))
    return tuple(parts)


def _part(kind: str, model: SensorModel | None, channels: Channels, session: Session) -> _Correction:
    found = 0 if model is None else len(model.bias)
    if model is None or found != len(channels.columns):
        raise InputError(
            f"{session.name}: log.{kind}: expected as many sensors as the calibration has, {found}, found "
            f"{len(channels.columns)}; columns that the session does not name are copied"
        )
    return _Correction(kind=kind, channels=channels, model=model)


def _magnetometer_part(
    calibration: Calibration, model: SensorModel, given: Magnetometer, session: Session
) -> _Correction:
    unit = calibration["mag.bias.x"].unit
    if given.unit != unit:
        raise InputError(
            f"{session.name}: log.magnetometer.unit: expected that of the calibration, {unit!r}, found "
            f"{given.unit!r}; calibrate in the unit of the log"
        )
    channels = Channels(
        columns=given.columns,
        unit=Unit(factor=1.0, kind="rate"),
        unit_name=unit,
        scale=np.ones(3),
        offset=np.zeros(3),
        axes=np.eye(3),
        range=None,
    )
    return _Correction(kind="mag", channels=channels, model=model)


def _tables(session: Session, parts: tuple[_Correction, ...], interval: float) -> Iterator[pl.DataFrame]:
    """The corrected rows of all files."""
    names: list[str] | None = None
    for file in session.log.files:
        source = source_of(file, session.log.dialect)
        clock = _Clock(path=source.path, session=session, interval=interval)
        for table in _rows(source, parts, session.log):
            names = table.columns if names is None else names
            if table.columns != names:
                raise LogError(
                    f"{source.path}: expected the columns of the first file, {', '.join(names)}; write them alike"
                )
            dt = clock.intervals(table) if any(part.increments for part in parts) else None
            new: Mapping[str, Array] = {name: c for part in parts for name, c in part.columns(table, dt).items()}
            yield table.with_columns(pl.Series(name, np.ascontiguousarray(c)) for name, c in new.items())


@dataclass(kw_only=True, slots=True)
class _Clock:
    """Intervals of the samples of one file, table after table. `last`: time of the last row, s."""

    path: Path
    session: Session
    interval: float
    last: float | None = None

    def intervals(self, table: pl.DataFrame) -> Array:
        """What each increment is the integral over, s."""
        spec = self.session.log
        if spec.time is None or spec.regular:
            return np.full(table.height, self.interval)
        with rows_of_numbers(self.path):
            time = times_of(table[spec.time], spec)
        before = time[0] - self.interval if self.last is None else self.last
        self.last = float(time[-1])
        steps = np.diff(time, prepend=before)
        if not (steps > 0.0).all():
            at = time[np.argmin(steps > 0.0)]
            raise LogError(
                f"{self.path}: expected times that increase, found {at:.9g} s after a later one; cut the log"
            )
        return np.asarray(steps / np.maximum(np.floor(steps / self.interval + 0.5), 1.0))


def _rows(source: LogSource, parts: tuple[_Correction, ...], spec: LogSpec) -> Iterator[pl.DataFrame]:
    """A file in tables of a bounded size, with every column: sensors as numbers, the others as they are; where these
    have decimal commas, all that the session names as numbers."""
    for added in (column for part in parts for column in part.added if column in source.names):
        raise InputError(f"{source.path}: expected no column '{added}', the block's vector gets it; rename it")
    numbers = [column for part in parts for column in part.channels.columns]
    if spec.dialect is not None and spec.dialect.decimal == ",":
        numbers = [column for column in spec.columns if not (spec.clock and column == spec.time)]
    yield from source.whole(numbers)


# -------------------- was it worth it --------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class RestResidual:
    """|f| − g (m/s²) of a rest's mean, taken as it is and corrected; its start and stop, s, and file."""

    file: int
    start: float
    stop: float
    before: float
    after: float


def rest_residuals(calibration: Calibration | FilePath, session: Session | FilePath) -> tuple[RestResidual, ...]:
    """Every rest of a session before and after correction. Raises InputError as `apply_to_session` does, and where
    nothing rests.

    >>> import tumble
    >>> request = tumble.Setup.of(grade="mems", positions=12)
    >>> folders = [tumble.simulate_session(f"launch-{i}", request, seed=1, launch=i) for i in (1, 2)]
    >>> rests = tumble.rest_residuals(tumble.calibrate(folders[0]), folders[1])
    >>> max(abs(rest.after) for rest in rests) < max(abs(rest.before) for rest in rests)
    True
    """
    calibration, session = calibration_from(calibration), session_from(session)
    accel = _parts(calibration, session)[0].model
    seen = inspect_session(session)
    observations = seen.observations
    if observations is None or seen.faults:
        found = seen.faults[0] if seen.faults else "none"
        raise InputError(f"{session.name}: expected rests to verify with, found {found}; leave out --verify")
    rests, g = observations.rests, session.site.gravity
    models = (session.accel_block.nominal(), accel)
    before, after = (np.linalg.norm(model.apply(rests.accel), axis=1) - g for model in models)
    return tuple(
        RestResidual(file=int(f), start=float(start), stop=float(stop), before=float(b), after=float(a))
        for f, start, stop, b, a in zip(rests.file, rests.start, rests.stop, before, after, strict=True)
    )
