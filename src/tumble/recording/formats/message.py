"""One kind of message in a recording: which sensors it has, in which units, and its rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import polars as pl

from tumble.recording.autopilot import AutopilotSensor

TIME = "t"
"""The column of the time in the rows of a message, s on a clock that all messages of a recording share."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Sensors:
    """Three columns of one kind of sensor, and their unit as session.toml names it; None where the recording does not
    say."""

    columns: tuple[str, str, str]
    unit: str | None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Message:
    """A kind of message: its name, the number of its rows, its sensors, the columns of the temperatures in °C, as
    [log.temperature] has them, and `rows`, tables of a bounded size in order, with the column TIME where `timed`.
    `remark` is what a user of the data must know."""

    name: str
    count: int
    accel: Sensors | None
    gyro: Sensors | None
    rows: Callable[[], Iterator[pl.DataFrame]]
    magnetometer: Sensors | None = None
    temperatures: tuple[str, ...] = ()
    timed: bool = True
    remark: str = ""
    imu: Mapping[str, AutopilotSensor] = field(default_factory=dict)
    """Which "accel" and "gyro" of an autopilot they are, where it is a log of one."""

    @property
    def thermometer(self) -> bool:
        """Whether the message has a temperature, times, and nothing else."""
        alone = self.accel is None and self.gyro is None and self.magnetometer is None
        return self.timed and alone and bool(self.temperatures)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the sensors' columns."""
        triads = (self.accel, self.gyro, self.magnetometer)
        named = [column for triad in triads if triad is not None for column in triad.columns]
        return (*named, *dict.fromkeys(self.temperatures))


AXES = "xyz"


def triad(name: str, unit: str | None) -> Sensors:
    """The sensors name_x, name_y, name_z."""
    x, y, z = (f"{name}_{axis}" for axis in AXES)
    return Sensors(columns=(x, y, z), unit=unit)
