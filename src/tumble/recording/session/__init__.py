"""A session: its device, site, log with sensors, programme, and exclusions, in SI and radians.

A session is one power-on of one IMU: a folder with session.toml and its log, or such a description with arrays or
frames in place of the log (`session_file`).
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from tumble.brief import Brief
from tumble.documents import is_plain, shown
from tumble.errors import InputError, ProgrammeError, did_you_mean
from tumble.programme.positions import BUILT_IN, Programme, attitude, programme_of, programmes
from tumble.recording.text.dialect import Dialect
from tumble.sensors.model import Block
from tumble.units import Array, Unit

if TYPE_CHECKING:
    from tumble.recording.log_source import LogSource


# -------------------- tables of session.toml --------------------

LONGEST_NAME = 200
"""Largest number of characters of a serial number or a type."""


class SessionTable(BaseModel):
    """A table of the file, without other keys and other types."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False, defer_build=True)


def key(description: str, default: Any = None, **limits: Any) -> Any:
    """Return an optional key; `description` states the expected value."""
    return Field(default=default, description=description, **limits)


def check_known(value: str, known: Iterable[str], key: str = "") -> str:
    """Return the value. Raises ValueError if it is not one of `known`."""
    names = list(known)
    if value not in names:
        hint, before = did_you_mean(value, names), f"{key}: " if key else ""
        raise ValueError(f'{before}expected one of {", ".join(names)}, found "{value}"{hint}')
    return value


def one_of(names: Iterable[str]) -> AfterValidator:
    return AfterValidator(partial(check_known, known=tuple(names)))


def check_plain(text: str) -> str:
    if not is_plain(text):
        raise ValueError(f"expected no control characters, found {shown(text)}")
    return text


def check_name(text: str) -> str:
    if not (text.strip() and text.isprintable() and len(text) <= LONGEST_NAME):
        raise ValueError(f"expected 1 to {LONGEST_NAME} printable characters, found {shown(text)}")
    return text.strip()


def check_span(start: float | None, stop: float | None) -> None:
    if start is not None and stop is not None and start >= stop:
        raise ValueError(f"start: expected a start before the stop {stop:g} s, found {start:g} s")


# -------------------- a session in SI --------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class AutopilotSensor:
    """A three-axis accelerometer or gyro of an autopilot: its number, from 1, and its device id, None if unknown."""

    number: int
    id: int | None


def sensors_content(sensors: Mapping[str, AutopilotSensor]) -> dict[str, int]:
    """Return the sensors "accel" and "gyro" as the keys of [device.imu] and of the calibration file."""
    pairs = [
        (f"{kind}_{key}", value) for kind, s in sensors.items() for key, value in (("number", s.number), ("id", s.id))
    ]
    return {key: value for key, value in pairs if value is not None}


def sensors_from(content: Mapping[str, Any]) -> dict[str, AutopilotSensor]:
    """Return the sensors of such keys, the inverse of `sensors_content`."""
    kinds = [kind for kind in ("accel", "gyro") if content.get(f"{kind}_number") is not None]
    return {kind: AutopilotSensor(number=content[f"{kind}_number"], id=content.get(f"{kind}_id")) for kind in kinds}


@dataclass(frozen=True, kw_only=True, slots=True)
class Device:
    """The IMU.

    `systematic` is the path of the calibration file with its nominal values; `grade` the stated class of instrument;
    `prior` has standard deviations, SI, of groups of parameters from the data sheet; `imu` has the "accel" and "gyro"
    of an autopilot."""

    serial: str
    model: str | None = None
    systematic: Path | None = None
    grade: str | None = None
    prior: Mapping[str, float] = field(default_factory=dict)
    imu: Mapping[str, AutopilotSensor] = field(default_factory=dict)


AssumedGravity = Literal["nothing", "digits", "height", "place"]
"""Missing statement of a session about gravity: none, the uncertainty of a value, the height, or the place."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Site:
    """Place of the recording: geodetic latitude, rad; height, m; gravity and its standard uncertainty, m/s².

    Latitude and height are None if they are not stated. `field` is the modulus of the magnetic field in the unit of the
    magnetometer, None if unknown. `gravity_confirmed`: the stated gravity is intended although it is far from normal
    gravity. `gravity_is_unit`: local gravity is the unit, and `gravity` is its nominal value. `assumed`: the quantity
    that was assumed to obtain gravity."""

    latitude: float | None
    height: float | None
    gravity: float
    gravity_u: float
    field: float | None = None
    gravity_confirmed: bool = False
    gravity_is_unit: bool = False
    assumed: AssumedGravity = "nothing"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Channels:
    """The n sensors of one kind, and the conversion of their columns to SI.

    SI = (raw − offset) / scale · unit.factor, divided by the sample's interval if unit.kind is "increment".
    `unit_name` is the unit in session.toml. For raw units (count, V) `unit` is that of `scale_per`; for the others
    scale is 1 and offset 0. `axes` (n, 3): nominal sensing directions in the body frame, unit vectors. `range`: full
    scale in m/s² or rad/s, the smallest of the sensors'. `scale_stated`: the scale of counts is stated; otherwise it
    is 1. `doubt`: uncertainty about the unit, which ends where a recording determines the scale."""

    columns: tuple[str, ...]
    unit: Unit
    unit_name: str
    scale: Array
    offset: Array
    axes: Array
    range: float | None = None
    scale_stated: bool = True
    doubt: str = ""

    @property
    def raw(self) -> bool:
        """Whether the log has counts or volts, with a scale and an offset."""
        return self.unit_name in ("count", "V")

    def to_si(self, raw: Array, dt: Array) -> Array:
        """Return rates (m, n), m/s² or rad/s, from a log's numbers (m, n) and the samples' intervals (m,), s."""
        gain = self.unit.factor / self.scale
        out = raw - self.offset if self.offset.any() else raw
        if (gain != 1.0).any():
            out = out * gain
        if self.unit.kind == "increment":
            out = out / dt[:, None]
        return out

    def from_si(self, rates: Array) -> Array:
        """Return the log's numbers (m, n) for rates in SI, or for increments in SI if the log has these."""
        gain = self.scale / self.unit.factor
        out = rates * gain if (gain != 1.0).any() else rates
        return out + self.offset if self.offset.any() else out


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TemperatureChannels:
    """The columns of the T thermometers; temperatures are gain · number + shift in °C.

    `unit_name` is the unit in session.toml; `accel` and `gyro` are the indices of the thermometers of the channels."""

    columns: tuple[str, ...]
    accel: tuple[int, ...]
    gyro: tuple[int, ...]
    unit_name: str
    gain: float
    shift: float

    def to_celsius(self, numbers: Array) -> Array:
        """Return temperatures (m, T), °C, from a log's numbers (m, T)."""
        return np.asarray(self.gain * numbers + self.shift)

    def names(self, kind: str) -> tuple[str, ...]:
        """Return the column of the thermometer of each channel of a kind of sensor."""
        return tuple(self.columns[t] for t in (self.accel if kind == "accel" else self.gyro))


USUAL_CLOCK_U = 30e-6
"""Default relative standard uncertainty of time stamps: crystals are off by 20 to 50 ppm over temperature and age."""
USUAL_RATE_U = 1e-2
"""Default relative standard uncertainty of a sample rate without time stamps: data sheets specify the oscillator of a
sensor to some per cent."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LogSpec:
    """Files of a log, or tables in memory, and their columns.

    Times are in the column `time`, in units of `time_factor` s, or at `rate`, Hz. `magnetometer` is in the unit of the
    site's field. `clock`: the times are times of day or dates; `regular`: rows are equally spaced, without regard to
    their times; `doubt`: uncertainty about the log and its consequence; `dialect`: how text files are written, None for
    CSV files with names in the first line; `clock_u`: relative standard uncertainty of the time base, None if not
    stated; `clock_rate`: seconds in a second of the log's clock, by the Earth's rate."""

    files: tuple[Path | LogSource, ...]
    time: str | None = None
    time_factor: float = 1.0
    rate: float | None = None
    accel: Channels
    gyro: Channels | None = None
    temperature: TemperatureChannels | None = None
    magnetometer: Channels | None = None
    clock: bool = False
    regular: bool = False
    doubt: str = ""
    dialect: Dialect | None = None
    clock_u: float | None = None
    clock_rate: float = 1.0

    @property
    def unstamped(self) -> bool:
        """Whether missing rows cannot be recognised by their times."""
        return self.rate is not None or self.regular

    @property
    def time_base_u(self) -> float:
        """Relative standard uncertainty of the time base, stated or usual."""
        usual = USUAL_CLOCK_U if self.rate is None else USUAL_RATE_U
        return usual if self.clock_u is None else self.clock_u

    @property
    def doubts(self) -> tuple[str, ...]:
        """Uncertainties about the log and about the units of its sensors."""
        of_units = (channels.doubt for channels in (self.accel, self.gyro) if channels is not None)
        return tuple(filter(None, (*of_units, self.doubt)))

    @property
    def increments(self) -> dict[str, bool]:
        """Whether the readings are increments, by kind of sensor."""
        kinds = {"accel": self.accel, "gyro": self.gyro}
        return {kind: channels.unit.kind == "increment" for kind, channels in kinds.items() if channels is not None}

    @property
    def readings(self) -> tuple[str, ...]:
        """Columns of accelerometers, gyros, magnetometer and thermometers."""
        parts = (self.accel, self.gyro, self.magnetometer, self.temperature)
        return tuple(column for part in parts if part is not None for column in part.columns)

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns that are read: the time, and the readings."""
        return self.readings if self.time is None else (self.time, *self.readings)


class ListedPosition(SessionTable):
    """A position of the programme, [[programme.position]]: its attitude code, and the rest's start and stop, s."""

    attitude: str = Field(description="an attitude code, a string")
    start: float | None = key("a number (s)")
    stop: float | None = key("a number (s)")

    @model_validator(mode="after")
    def _check(self) -> Self:
        try:
            attitude(self.attitude)
        except ProgrammeError as error:
            raise ValueError(str(error)) from None
        if (self.start is None) != (self.stop is None):
            given = "start" if self.stop is None else "stop"
            raise ValueError(f"{given}: expected start and stop together, found {given} alone")
        check_span(self.start, self.stop)
        return self


def _check_programme(name: str) -> str:
    return name if name in BUILT_IN else check_known(name, programmes())


class ProgrammeSpec(SessionTable):
    """[programme]: either the name of a programme, or positions in order."""

    name: Annotated[str, AfterValidator(_check_programme)] | None = key("the name of a programme")
    position: list[ListedPosition] | None = key("one or more tables [[programme.position]]", min_length=1)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.name is None) == (self.position is None):
            given = "neither" if self.name is None else "both"
            raise ValueError(f"name: expected either programme.name or [[programme.position]], found {given}")
        return self

    @property
    def listed(self) -> Programme:
        """The programme by name, or of the listed positions."""
        return programme_of(self.name or [position.attitude for position in self.position or ()])


class Exclusion(SessionTable):
    """A part of a session that is left out, [[exclude]].

    It is a rest or a turn, numbered from 1 as in results, or the time from `start` to `stop`, s, in a file, numbered
    from 1, by default the first. `by` is the origin of the exclusion in words."""

    by: ClassVar[str] = "session.toml"
    rest: int | None = key("the number of a rest, from 1", ge=1)
    turn: int | None = key("the number of a turn, from 1", ge=1)
    start: float | None = key("a number (s)")
    stop: float | None = key("a number (s)")
    file: int | None = key("the number of a file of the log, from 1", ge=1)
    reason: str = key("a string", "")

    @model_validator(mode="after")
    def _check(self) -> Self:
        stated = [key for key in ("rest", "turn", "start", "stop") if getattr(self, key) is not None]
        if stated not in (["rest"], ["turn"], ["start", "stop"]):
            raise ValueError(
                f"rest: expected either rest, or turn, or start and stop together, found {', '.join(stated) or 'none'}"
            )
        check_span(self.start, self.stop)
        if self.file is not None and self.start is None:
            raise ValueError("file: expected only with start and stop, found it without")
        return self


class Request(Exclusion):
    """An exclusion by the caller."""

    by: ClassVar[str] = "request"


# -------------------- circumstances, for certificates --------------------


def _is_date(text: str) -> str:
    try:
        (dt.datetime if "T" in text else dt.date).fromisoformat(text)
    except ValueError:
        raise ValueError(f"expected a date, or a date with a time, found {shown(text)}") from None
    return text


IsoDate = Annotated[str, AfterValidator(_is_date)]
"""A date or a date with a time by ISO 8601."""


class AirConditions(SessionTable):
    """Temperature with its standard uncertainty, relative humidity and air pressure, as in session.conditions."""

    temperature_degC: float | None = key("a number from -90 to 200 (°C)", ge=-90, le=200)  # noqa: N815
    temperature_u: float | None = key("a number, not negative (K)", ge=0)
    humidity_percent: float | None = key("a number from 0 to 100 (%)", ge=0, le=100)
    pressure_hPa: float | None = key("a number from 0 to 1200 (hPa)", gt=0, le=1200)  # noqa: N815


@dataclass(frozen=True, kw_only=True, slots=True)
class Circumstances:
    """Circumstances of a session: date, operator, air, and equipment with its traceability in words.

    `date` is that of the recording as the session states it, else that of the log if its times are absolute."""

    date: IsoDate | None = None
    operator: str | None = None
    conditions: AirConditions = field(default_factory=AirConditions)
    equipment: tuple[str, ...] = ()


UNKNOWN = Circumstances()


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Session(Brief):
    """Content of session.toml, or of the description of samples in memory.

    `programme` is None for a free session, without assumptions on its orientations; `folder` is None in memory;
    `description` has the keys and values from which the session was made, as in session.toml.

    >>> import numpy as np, tumble
    >>> description = {
    ...     "format": 1,
    ...     "device": {"serial": "A-0007"},
    ...     "log": {"rate_hz": 100.0, "accel": {"columns": ["ax", "ay", "az"], "unit": "g"}},
    ... }
    >>> still = {"ax": np.zeros(300), "ay": np.zeros(300), "az": np.ones(300)}
    >>> session = tumble.session_of(description, still)
    >>> session.name, session.log.accel.unit_name
    ('session of A-0007 in memory', 'g')
    """

    folder: Path | None
    device: Device
    site: Site
    log: LogSpec
    programme: ProgrammeSpec | None = None
    excluded: tuple[Exclusion, ...] = ()
    circumstances: Circumstances = UNKNOWN
    description: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)

    @property
    def name(self) -> str:
        """Name of the session in messages."""
        return f"session of {self.device.serial} in memory" if self.folder is None else str(self.folder)

    @property
    def accel_block(self) -> Block:
        """The accelerometers and their parameters."""
        temperature = self.log.temperature
        return Block(
            kind="accel", axes=self.log.accel.axes, thermometers=() if temperature is None else temperature.accel
        )

    @property
    def gyro_block(self) -> Block | None:
        """The gyros and their parameters; None without gyros."""
        temperature = self.log.temperature
        if self.log.gyro is None:
            return None
        return Block(kind="gyro", axes=self.log.gyro.axes, thermometers=() if temperature is None else temperature.gyro)

    def of_known_scales(self) -> Session:
        """Return the session without its gyros if the scale of their counts is not stated."""
        return self if self.log.gyro is None or self.log.gyro.scale_stated else self.without_gyros()

    def without_gyros(self) -> Session:
        """Return the session with its accelerometers alone."""
        temperature = self.log.temperature
        accel_alone = None if temperature is None else replace(temperature, gyro=())
        return replace(self, log=replace(self.log, gyro=None, temperature=accel_alone))

    def check_new(self, out: Path, *, force: bool) -> None:
        """Raise InputError if a file to be written exists, unless by `force`, or is a file of the session's log."""
        if not out.exists():
            return
        if any(isinstance(file, Path) and file.exists() and out.samefile(file) for file in self.log.files):
            raise InputError(f"{out}: expected another file, found the recording of the session; choose another name")
        if not force:
            raise InputError(f"{out}: expected a new file, found one that exists; give --force to replace it")

    def without(self, rests: Iterable[int]) -> Session:
        """Return the session without rests, numbered from 1 as in results. Raises InputError for other numbers."""
        more = []
        for number in rests:
            if isinstance(number, bool) or not isinstance(number, int | np.integer) or number < 1:
                raise InputError(f"without: expected numbers of rests, from 1 as results count them, found {number!r}")
            more.append(Request(rest=int(number)))
        return replace(self, excluded=(*self.excluded, *more))
