"""The table [log] of session.toml with its inner tables."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, ClassVar, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from tumble.documents import as_written
from tumble.recording.session import Channels, LogSpec, SessionTable, TemperatureChannels, check_known, key, one_of
from tumble.recording.text.dialect import DELIMITERS, DIALECT_KEYS, Dialect
from tumble.sensors.model import thermometers_of
from tumble.units import ACCEL_UNITS, GYRO_UNITS, MAGNETIC_UNITS, TEMPERATURE_UNITS, TIME_UNITS, Array, Unit

CLOCK = "iso8601"
"""The time unit for dates with times and for times of day."""

_UNIT_NORM_TOLERANCE = 1e-6
_LEAST_SINGULAR_VALUE = 1e-3  # of the axes; smaller ones leave a direction unobserved
_LEAST_SINE = 1e-3  # of the angle between the first two accelerometers

Numbers = float | list[float] | None
"""One number for all columns, or one per column."""


def check_encoding(name: str) -> str:
    try:
        "é".encode(name, errors="replace").decode(name)
    except (LookupError, UnicodeError, ValueError, TypeError):
        raise ValueError(f"expected a text encoding such as utf-16, found {as_written(name)}") from None
    return name


class SensorsTable(SessionTable):
    """Common keys of [log.accel] and [log.gyro]."""

    UNITS: ClassVar[Mapping[str, Unit]]
    SCALE_PER: ClassVar[tuple[str, ...]]  # the first is the default
    SCALE_NEEDED: ClassVar[bool] = True

    columns: list[str] = Field(min_length=3, description="a list of at least three column names")
    unit: str = Field(description="the name of a unit, a string")
    scale: Numbers = key("a number or a list of numbers")
    scale_per: str | None = key("the name of a unit, a string")
    offset: Numbers = key("a number or a list of numbers")
    axes: list[list[float]] | None = key("a list of unit vectors [x, y, z]")
    range: float | None = key("a positive number", gt=0)
    doubt: str | None = key("a sentence")

    @property
    def scaled_unit(self) -> Unit:
        """The unit of (raw − offset) / scale."""
        raw = self.UNITS[self.unit].kind == "raw"
        return self.UNITS[(self.scale_per or self.SCALE_PER[0]) if raw else self.unit]

    def per_sensor(self, value: Numbers, default: float) -> Array:
        """Return a number or a list as an array (n,)."""
        return np.broadcast_to(np.asarray(default if value is None else value, float), len(self.columns)).copy()

    def directions(self) -> Array:
        """Return the axes (n, 3), normalised."""
        axes = np.eye(3) if self.axes is None else np.array(self.axes, dtype=float)
        return np.asarray(axes / np.linalg.norm(axes, axis=1, keepdims=True))

    @model_validator(mode="after")
    def _check(self) -> Self:
        check_known(self.unit, self.UNITS, "unit")
        if self.UNITS[self.unit].kind != "raw":
            for key in ("scale", "scale_per", "offset"):
                if getattr(self, key) is not None:
                    raise ValueError(f'{key}: expected only with unit "count" or "V", found unit "{self.unit}"')
        elif self.scale is None and self.SCALE_NEEDED:
            raise ValueError(f'scale: expected the nominal output per unit for unit "{self.unit}", found none')
        else:
            check_known(self.scale_per or self.SCALE_PER[0], self.SCALE_PER, "scale_per")
            columns = len(self.columns)
            for name, value in (("scale", self.scale), ("offset", self.offset)):
                if isinstance(value, list) and len(value) != columns:
                    raise ValueError(
                        f"{name}: expected a number or {columns} numbers, one per column, found {len(value)}"
                    )
            if self.scale is not None and not np.all(self.scale):
                raise ValueError(f"scale: expected numbers other than zero, found {as_written(self.scale)}")
        self._check_axes()
        return self

    def _check_axes(self) -> None:
        if self.axes is None:
            if len(self.columns) > 3:
                raise ValueError(f"axes: expected {len(self.columns)} unit vectors for a redundant block, found none")
            return
        if len(self.axes) != len(self.columns):
            raise ValueError(f"axes: expected {len(self.columns)} vectors, one per column, found {len(self.axes)}")
        for number, axis in enumerate(self.axes, 1):
            if len(axis) != 3:
                raise ValueError(f"axes: expected vectors [x, y, z], found {len(axis)} numbers in vector {number}")
            if abs(math.hypot(*axis) - 1.0) > _UNIT_NORM_TOLERANCE:
                raise ValueError(
                    f"axes: expected unit vectors within {_UNIT_NORM_TOLERANCE:g}, "
                    f"found norm {math.hypot(*axis):.7g} of vector {number}, {as_written(axis)}"
                )
        if np.linalg.svd(self.directions(), compute_uv=False)[2] < _LEAST_SINGULAR_VALUE:
            raise ValueError("axes: expected directions that span three dimensions, found them in one plane")

    def si(self, rate: float | None) -> Channels:
        scale = self.per_sensor(self.scale, 1.0)
        full_scale = None
        if self.range is not None:
            full_scale = float(self.range * self.scaled_unit.per_second(rate or 1.0) / np.abs(scale).max())
        return Channels(
            columns=tuple(self.columns),
            unit=self.scaled_unit,
            unit_name=self.unit,
            scale=scale,
            offset=self.per_sensor(self.offset, 0.0),
            axes=self.directions(),
            range=full_scale,
            scale_stated=self.UNITS[self.unit].kind != "raw" or self.scale is not None,
            doubt=self.doubt or "",
        )


class AccelTable(SensorsTable):
    """[log.accel]"""

    UNITS = ACCEL_UNITS
    SCALE_PER = ("m/s^2", "g", "m/s")

    def _check_axes(self) -> None:
        super()._check_axes()
        first, second = self.directions()[:2]
        if np.linalg.norm(np.cross(first, second)) < _LEAST_SINE:
            raise ValueError(
                "axes: expected the first two accelerometers, which fix the body frame, in different "
                "directions, found them parallel; list the sensors in another order"
            )


class GyroTable(SensorsTable):
    """[log.gyro]; the scale of counts may be absent, because rests alone do not determine it."""

    UNITS = GYRO_UNITS
    SCALE_NEEDED = False
    SCALE_PER = ("rad/s", "deg/s", "rad", "deg", "arcsec")


class MagnetometerTable(SessionTable):
    """[log.magnetometer]"""

    columns: list[str] = Field(min_length=3, max_length=3, description="a list of three column names")
    unit: Annotated[str, one_of(MAGNETIC_UNITS)] = Field(description="the name of a unit, a string")

    def channels(self) -> Channels:
        """Return the channels in their unit."""
        columns, one, ones = tuple(self.columns), Unit(factor=1.0, kind="rate"), np.ones(3)
        return Channels(columns=columns, unit=one, unit_name=self.unit, scale=ones, offset=np.zeros(3), axes=np.eye(3))


class TemperatureTable(SessionTable):
    """[log.temperature]: one column for all sensors, two for the accelerometers and the gyros, or one a sensor.

    In a list with one per sensor, accelerometers first, a thermometer may be repeated."""

    columns: list[str] = Field(min_length=1, description="a list of column names")
    unit: Annotated[str, one_of(TEMPERATURE_UNITS)] = key("the name of a unit, a string", "degC")

    def of_sensors(self, accel: int, gyro: int) -> tuple[int, ...]:
        """Return the index of the column of each accelerometer and gyro. Raises ValueError for another number."""
        places = thermometers_of(len(self.columns), accel, gyro)
        if places is None:
            two = "two for the accelerometers and the gyros, " if gyro else ""
            raise ValueError(
                f"temperature.columns: expected one column for all sensors, {two}or {accel + gyro}, one a sensor, "
                f"accelerometers first, found {len(self.columns)}"
            )
        return places

    def si(self, accel: int, gyro: int) -> TemperatureChannels:
        columns, (gain, shift) = tuple(dict.fromkeys(self.columns)), TEMPERATURE_UNITS[self.unit]
        number = tuple(columns.index(self.columns[place]) for place in self.of_sensors(accel, gyro))
        return TemperatureChannels(
            columns=columns,
            accel=number[:accel],
            gyro=number[accel:],
            unit_name=self.unit,
            gain=gain,
            shift=shift,
        )


class LogTable(SessionTable):
    """[log]"""

    file: str | list[str] = Field(min_length=1, description="a file name or a list of file names")
    time: str | None = key("a column name", min_length=1)
    time_unit: Annotated[str, one_of([*TIME_UNITS, CLOCK])] | None = key(f"one of {', '.join([*TIME_UNITS, CLOCK])}")
    rate_hz: float | None = key("a positive number", gt=0)
    regular: bool | None = key("true or false")
    doubt: str | None = key("a sentence")
    clock_ppm_u: float | None = key("a number from 0 to 1000000", ge=0, le=1e6)
    delimiter: Annotated[str, one_of(DELIMITERS)] | None = key("a character, or a blank for one or more blanks")
    decimal: Annotated[str, one_of(".,")] | None = key('"." or ","')
    comment: str | None = key("the mark that comments begin with", min_length=1, max_length=8)
    header: bool | None = key("true or false")
    encoding: Annotated[str, AfterValidator(check_encoding)] | None = key("the name of an encoding")
    accel: AccelTable = Field(description="the table [log.accel]")
    gyro: GyroTable | None = key("the table [log.gyro]")
    magnetometer: MagnetometerTable | None = key("the table [log.magnetometer]")
    temperature: TemperatureTable | None = key("the table [log.temperature]")

    @property
    def sensors(self) -> tuple[int, int]:
        """Numbers of accelerometers and gyros."""
        return len(self.accel.columns), 0 if self.gyro is None else len(self.gyro.columns)

    @model_validator(mode="after")
    def _check(self) -> Self:
        twice = [file for file, count in Counter(self.file).items() if count > 1] if isinstance(self.file, list) else []
        if twice:
            raise ValueError(f'file: expected different files, found "{twice[0]}" twice')
        if (self.time is None) == (self.rate_hz is None):
            given = "neither" if self.time is None else "both"
            raise ValueError(f"time: expected either log.time, a column, or log.rate_hz, found {given}")
        if self.time_unit is not None and self.time is None:
            raise ValueError("time_unit: expected only with log.time, found log.rate_hz")
        if self.regular and self.time is None:
            raise ValueError("regular: expected only with log.time, found log.rate_hz, which makes rows regular")
        # a column has one role; a thermometer may be repeated in a list with one per sensor
        keys = {"time": [self.time] if self.time is not None else []}
        for kind, table in (("accel", self.accel), ("gyro", self.gyro), ("magnetometer", self.magnetometer)):
            keys[f"{kind}.columns"] = table.columns if table is not None else []
        if self.temperature is not None:
            columns = self.temperature.columns
            one_each = len(columns) == len(self.temperature.of_sensors(*self.sensors))
            keys["temperature.columns"] = list(dict.fromkeys(columns)) if one_each else columns
        for column, count in Counter(c for columns in keys.values() for c in columns).items():
            if count > 1:
                using = [key for key, columns in keys.items() for c in columns if c == column]
                also = "twice" if using[0] == using[1] else f"in log.{using[0]} too"
                raise ValueError(f'{using[1]}: expected every column once, found "{column}" {also}')
        for kind, table in (("accel", self.accel), ("gyro", self.gyro)):
            ranged = table is not None and table.range is not None and table.scaled_unit.kind == "increment"
            if ranged and self.rate_hz is None:
                raise ValueError(
                    f"{kind}.range: expected log.rate_hz with the full scale of an increment per sample, "
                    "found log.time; leave range out"
                )
        return self

    def si(self, folder: Path) -> LogSpec:
        dialect = self.model_dump(include={*DIALECT_KEYS}, exclude_none=True)
        files = [self.file] if isinstance(self.file, str) else self.file
        return LogSpec(
            files=tuple(_as_given(folder / file) for file in files),
            time=self.time,
            time_factor=TIME_UNITS.get(self.time_unit or "s", 1.0),
            rate=self.rate_hz,
            accel=self.accel.si(self.rate_hz),
            gyro=None if self.gyro is None else self.gyro.si(self.rate_hz),
            temperature=None if self.temperature is None else self.temperature.si(*self.sensors),
            magnetometer=None if self.magnetometer is None else self.magnetometer.channels(),
            clock=self.time_unit == CLOCK,
            regular=bool(self.regular),
            doubt=self.doubt or "",
            dialect=Dialect(**dialect) if dialect else None,
            clock_u=None if self.clock_ppm_u is None else 1e-6 * self.clock_ppm_u,
        )


def _as_given(path: Path) -> Path:
    """Return the path of a file without `folder/..`, unless a link makes that another file."""
    plain = Path(os.path.normpath(path))
    return plain if path.is_file() and plain.is_file() and plain.samefile(path) else path
