"""The keys of [log.temperature]."""

from __future__ import annotations

from typing import ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from tumble.recording.session_keys.table import SessionTable, check_known, check_one_per_column
from tumble.sensors.model import thermometers_of
from tumble.units import TEMPERATURE_UNITS, Array


class TemperatureTable(SessionTable):
    """[log.temperature]: one column for all sensors, two for the accelerometers and the gyros, or one a sensor, the
    accelerometers first; then a thermometer may come several times."""

    RAW: ClassVar = "raw"

    columns: list[str] = Field(min_length=1, description="a list of column names")
    unit: str = Field(default="degC", description="the name of a unit, a string")
    scale: float | list[float] | None = Field(
        default=None, description="a number or a list of numbers: raw numbers per degC"
    )
    offset: float | list[float] | None = Field(
        default=None, description="a number or a list of numbers: the raw number at 0 degC"
    )

    def celsius(self) -> tuple[Array, Array]:
        """Gain and shift (T,) of each column: °C are gain · number + shift."""
        ones = np.ones(len(self.columns))
        if self.unit != self.RAW:
            gain, shift = TEMPERATURE_UNITS[self.unit]
            return gain * ones, shift * ones
        scale, offset = ones * np.asarray(self.scale, float), ones * np.asarray(self.offset or 0.0, float)
        return 1.0 / scale, -offset / scale

    def of_sensors(self, accel: int, gyro: int) -> tuple[int, ...]:
        """The place of the column of each of so many accelerometers and gyros. Raises ValueError where there is another
        number of columns."""
        found = thermometers_of(len(self.columns), accel, gyro)
        if found is None:
            two = "two for the accelerometers and the gyros, " if gyro else ""
            raise ValueError(
                f"temperature.columns: expected one column for all sensors, {two}or {accel + gyro}, one a sensor, "
                f"accelerometers first, found {len(self.columns)}"
            )
        return found

    @model_validator(mode="after")
    def _check(self) -> Self:
        check_known("unit", self.unit, [*TEMPERATURE_UNITS, self.RAW])
        if self.unit == self.RAW and (self.scale is None or not np.all(self.scale)):
            found = "none" if self.scale is None else "0"
            raise ValueError(f'scale: expected the raw numbers per degC for unit "raw", found {found}')
        if self.unit != self.RAW and (self.scale is not None or self.offset is not None):
            key = "offset" if self.scale is None else "scale"
            raise ValueError(f'{key}: expected only with unit "raw", found unit "{self.unit}"')
        for key in ("scale", "offset"):
            check_one_per_column(key, getattr(self, key), self.columns)
        if len(set(zip(self.columns, *self.celsius(), strict=True))) > len(set(self.columns)):
            raise ValueError("scale: expected one scale and offset for a column that is named again, found others")
        return self
