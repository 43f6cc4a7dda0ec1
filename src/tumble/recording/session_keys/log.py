"""The keys of [log]."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from tumble.recording.dialect import DELIMITERS, Dialect
from tumble.recording.session_keys.sensors import AccelTable, GyroTable, MagnetometerTable
from tumble.recording.session_keys.table import SessionTable, as_written, check_known, repeated
from tumble.recording.session_keys.temperature import TemperatureTable
from tumble.units import TIME_UNITS

CLOCK = "iso8601"
"""The time unit of dates with times and times of day."""


class LogTable(SessionTable):
    """[log]"""

    file: str | list[str] = Field(min_length=1, description="a file name or a list of file names")
    time: str | None = Field(default=None, min_length=1, description="a column name")
    time_unit: str | None = Field(default=None, description=f"one of {', '.join([*TIME_UNITS, CLOCK])}")
    rate_hz: float | None = Field(default=None, gt=0, description="a positive number")
    regular: bool | None = Field(default=None, description="true or false")
    clock_ppm_u: float | None = Field(default=None, ge=0, description="a number that is not negative")
    delimiter: str | None = Field(default=None, description="a character, or a blank for one or more blanks")
    decimal: str | None = Field(default=None, description='"." or ","')
    comment: str | None = Field(
        default=None, min_length=1, max_length=8, description="the mark that comments begin with"
    )
    header: bool | None = Field(default=None, description="true or false")
    encoding: str | None = Field(default=None, description="the name of an encoding")
    accel: AccelTable = Field(description="the table [log.accel]")
    gyro: GyroTable | None = Field(default=None, description="the table [log.gyro]")
    magnetometer: MagnetometerTable | None = Field(default=None, description="the table [log.magnetometer]")
    temperature: TemperatureTable | None = Field(default=None, description="the table [log.temperature]")

    @property
    def files(self) -> list[str]:
        """The file names, one or more."""
        return [self.file] if isinstance(self.file, str) else self.file

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.time is None) == (self.rate_hz is None):
            found = "neither" if self.time is None else "both"
            raise ValueError(f"time: expected either log.time, a column, or log.rate_hz, found {found}")
        if self.time_unit is not None:
            if self.time is None:
                raise ValueError("time_unit: expected only with log.time, found log.rate_hz")
            check_known("time_unit", self.time_unit, [*TIME_UNITS, CLOCK])
        if self.regular and self.time is None:
            raise ValueError("regular: expected only with log.time, found log.rate_hz, which makes rows regular")
        self._check_dialect()
        for file in repeated(self.files):
            raise ValueError(f'file: expected different files, found "{file}" twice')
        self._check_columns()
        self._check_ranges()
        return self

    def dialect(self) -> Dialect | None:
        """How the text files are written; None where nothing is said about it."""
        given = {key: getattr(self, key) for key in ("delimiter", "decimal", "comment", "header", "encoding")}
        stated = {key: value for key, value in given.items() if value is not None}
        return Dialect(**stated) if stated else None

    def _check_dialect(self) -> None:
        if self.delimiter is not None:
            check_known("delimiter", self.delimiter, DELIMITERS)
        if self.decimal is not None:
            check_known("decimal", self.decimal, (".", ","))
        if self.encoding is not None and not _is_encoding(self.encoding):
            raise ValueError(f"encoding: expected a text encoding such as utf-16, found {as_written(self.encoding)}")

    def _check_columns(self) -> None:
        keys = {
            "time": [self.time] if self.time is not None else [],
            "accel.columns": self.accel.columns,
            "gyro.columns": self.gyro.columns if self.gyro else [],
            "magnetometer.columns": self.magnetometer.columns if self.magnetometer else [],
            "temperature.columns": self._thermometers(),
        }
        for column in repeated(c for columns in keys.values() for c in columns):
            using = [key for key, columns in keys.items() for c in columns if c == column]
            also = "twice" if using[0] == using[1] else f"in log.{using[0]} too"
            raise ValueError(f'{using[1]}: expected every column once, found "{column}" {also}')

    def _thermometers(self) -> list[str]:
        """The columns of the thermometers; of one a sensor every one once."""
        if self.temperature is None:
            return []
        accel, gyro = len(self.accel.columns), 0 if self.gyro is None else len(self.gyro.columns)
        each, columns = self.temperature.of_sensors(accel, gyro), self.temperature.columns
        return list(dict.fromkeys(columns)) if len(columns) == len(each) else columns

    def _check_ranges(self) -> None:
        for key, sensors in (("accel", self.accel), ("gyro", self.gyro)):
            if sensors is None or sensors.range is None or self.rate_hz is not None:
                continue
            if sensors.worth().kind == "increment":
                raise ValueError(
                    f"{key}.range: expected log.rate_hz with the full scale of an increment per sample, "
                    "found log.time; leave range out"
                )


def _is_encoding(name: str) -> bool:
    """Whether Python knows an encoding of text by this name."""
    try:
        return "é".encode(name, errors="replace").decode(name) is not None
    except (LookupError, UnicodeError, ValueError, TypeError):
        return False
