"""Recordings corrected with a calibration: a log in, a log out, sample by sample.

A correction needs no other sample than its own, so rows are neither added nor bridged: a number that is not finite
stays so in its row. What a column gets is what a perfect sensor in that place would read, d · true with its nominal
axis d, those of a magnetometer being the axes of its own frame; for three sensors along the body axes that is the true
vector itself. A redundant block is solved by least squares first, and its vector is added in the columns accel_x,
accel_y, accel_z and gyro_x, gyro_y, gyro_z.

Increments stay increments: an integral over an interval T is corrected by bias · T, and its interval is the step in
time, as in `log`, less the samples that are missing in it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from tumble.calibration.calibrate import inspect_session
from tumble.calibration.calibration_file import Calibration, corrected
from tumble.errors import InputError, LogError
from tumble.recording.log import open_log
from tumble.recording.readers import readable, source_of, text_tables, times_of
from tumble.recording.session import Channels, Magnetometer, Session
from tumble.recording.writer import write_tables
from tumble.sensors.model import SensorModel
from tumble.units import Array, Unit

_SLICE_ROWS = 1 << 17


@dataclass(frozen=True, kw_only=True, slots=True)
class _Correction:
    """The sensors of one kind and what corrects them."""

    kind: str
    channels: Channels
    model: SensorModel

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
        out = dict(zip(self.channels.columns, perfect.T, strict=True))
        return out | dict(zip(self.added, true.T, strict=False))


def apply_to_session(calibration: Calibration, session: Session, out: Path) -> None:
    """Correct the log of a session, SI, into a .csv or .parquet file, whole or not at all, as a stream: memory does not
    grow with the log. Several files of a log come one below the other.

    Every column keeps its name and place; sensors are corrected as `Calibration.apply` does, everything else is copied,
    from CSV as the text it is. Raises InputError for a calibration that is not accepted, is of another device or lacks
    a sensor, and for a log that cannot be read."""
    parts = _parts(calibration, session)
    log = open_log(session)
    write_tables(out, _tables(session, parts, 1.0 / log.rate))


def _parts(calibration: Calibration, session: Session) -> tuple[_Correction, ...]:
    """What is to be corrected; the calibration is that of the session's device."""
    if not calibration.outcome.accepted:
        raise InputError(f"calibration: expected an accepted one, found: {'; '.join(calibration.outcome.reasons)}")
    if calibration.serial != session.device.serial:
        raise InputError(
            f"{session.folder}: expected the device of the calibration, {calibration.serial!r}, found "
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
            f"{session.folder}: log.{kind}: expected as many sensors as the calibration has, {found}, found "
            f"{len(channels.columns)}; columns that the session does not name are copied"
        )
    return _Correction(kind=kind, channels=channels, model=model)


def _magnetometer_part(
    calibration: Calibration, model: SensorModel, given: Magnetometer, session: Session
) -> _Correction:
    unit = calibration["mag.bias.x"].unit
    if given.unit != unit:
        raise InputError(
            f"{session.folder}: log.magnetometer.unit: expected that of the calibration, {unit!r}, found "
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
    for path in session.log.files:
        clock = _Clock(path=path, session=session, interval=interval)
        for table in _rows(path, parts, session):
            names = table.columns if names is None else names
            if table.columns != names:
                raise LogError(f"{path}: expected the columns of the first file, {', '.join(names)}; write them alike")
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
        with _parsed(self.path):
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


def _rows(path: Path, parts: tuple[_Correction, ...], session: Session) -> Iterator[pl.DataFrame]:
    """A file in tables of a bounded size, with every column: sensors as numbers, the others as they are."""
    sensors = [column for part in parts for column in part.channels.columns]
    with _parsed(path):
        text = path.suffix.lower() != ".parquet"
        tables = text_tables(source_of(path, session.log.dialect), sensors) if text else _parquet(path)
        for table in tables:
            for added in (column for part in parts for column in part.added if column in table.columns):
                raise InputError(f"{path}: expected no column '{added}', the block's vector gets it; rename it")
            yield table.with_columns(pl.col(sensors).cast(pl.Float64))


def _parquet(path: Path) -> Iterator[pl.DataFrame]:
    """A Parquet file in slices: as one scan it would stay mapped, and count, as a whole."""
    rows = pl.scan_parquet(path, glob=False).select(pl.len()).collect().item()
    for first in range(0, rows, _SLICE_ROWS):
        yield pl.scan_parquet(path, glob=False).slice(first, _SLICE_ROWS).collect()


@contextmanager
def _parsed(path: Path) -> Iterator[None]:
    """Whatever polars says of the content of a file, or a library of a damaged one, becomes one line."""
    with readable(path):
        try:
            yield
        except pl.exceptions.PolarsError as error:
            said = " ".join(str(error).split())[:200]
            raise LogError(f"{path}: expected rows of numbers, found: {said}; see `tumble inspect`") from None


# -------------------- was it worth it --------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class RestResidual:
    """|f| − g (m/s²) of a rest's mean, taken as it is and corrected; its start and stop, s, and file."""

    file: int
    start: float
    stop: float
    before: float
    after: float


def rest_residuals(calibration: Calibration, session: Session) -> tuple[RestResidual, ...]:
    """Every rest of a session before and after correction. Raises InputError as `apply_to_session` does, and where
    nothing rests."""
    accel = _parts(calibration, session)[0].model
    _, observations, faults = inspect_session(session)
    if observations is None or faults:
        found = faults[0] if faults else "none"
        raise InputError(f"{session.folder}: expected rests to verify with, found {found}; leave out --verify")
    rests, g = observations.rests, session.site.gravity
    models = (session.accel_block.nominal(), accel)
    before, after = (np.linalg.norm(model.apply(rests.accel), axis=1) - g for model in models)
    return tuple(
        RestResidual(file=int(f), start=float(start), stop=float(stop), before=float(b), after=float(a))
        for f, start, stop, b, a in zip(rests.file, rests.start, rests.stop, before, after, strict=True)
    )
