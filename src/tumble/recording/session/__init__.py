"""What a session is: its device, its site, its log and the sensors in it, its programme, what it leaves out.

A session is one power-on of one IMU: a folder with session.toml and the log it names, or such a description with arrays
or frames in place of the log. Both give a `Session` (`session_file`), SI and radians inside.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from tumble.brief import Brief
from tumble.documents import shown
from tumble.errors import InputError, ProgrammeError
from tumble.programme.positions import BUILT_IN, Programme, attitude, programme_of, programmes
from tumble.recording.session.table import SessionTable, check_known, check_span, key
from tumble.recording.text.dialect import Dialect
from tumble.sensors.model import Block
from tumble.units import Array, Unit

if TYPE_CHECKING:
    from tumble.recording.log_source import LogSource


@dataclass(frozen=True, kw_only=True, slots=True)
class AutopilotSensor:
    """An accelerometer or a gyro of an autopilot, three axes: its number among those, from 1, and its device id, None
    where the recording does not have it."""

    number: int
    id: int | None


def sensors_content(sensors: Mapping[str, AutopilotSensor]) -> dict[str, int]:
    """The sensors "accel" and "gyro" as [device.imu] and the calibration file have them."""
    pairs = [
        (f"{kind}_{key}", value) for kind, s in sensors.items() for key, value in (("number", s.number), ("id", s.id))
    ]
    return {key: value for key, value in pairs if value is not None}


def sensors_from(content: Mapping[str, Any]) -> dict[str, AutopilotSensor]:
    """The sensors of what `sensors_content` gives."""
    kinds = [kind for kind in ("accel", "gyro") if content.get(f"{kind}_number") is not None]
    return {kind: AutopilotSensor(number=content[f"{kind}_number"], id=content.get(f"{kind}_id")) for kind in kinds}


@dataclass(frozen=True, kw_only=True, slots=True)
class Device:
    """The IMU. `systematic` is the path of the calibration file with its nominal values, if it has one."""

    serial: str
    model: str | None
    systematic: Path | None
    grade: str | None = None
    """The class of instrument, where the session says it."""
    prior: Mapping[str, float] = field(default_factory=dict)
    """Standard deviations, SI, of groups of parameters, where the data sheet gives them."""
    imu: Mapping[str, AutopilotSensor] = field(default_factory=dict)
    """Which "accel" and "gyro" of an autopilot it is, where it is one."""


AssumedGravity = Literal["nothing", "digits", "height", "place"]
"""What a session leaves open about gravity: nothing, the uncertainty of a stated value beyond its last digit, the
height of the place, or the place."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Site:
    """Where the session was recorded: geodetic latitude, rad; height, m; gravity and its standard
    uncertainty, m/s²; modulus of the magnetic field in the unit of the magnetometer, None where it is not known."""

    latitude: float | None
    height: float
    gravity: float
    gravity_u: float
    field: float | None = None
    gravity_confirmed: bool = False
    """That gravity is meant, however far it is from normal gravity."""
    gravity_is_unit: bool = False
    """That gravity at the place, whatever it is, is the unit, and `gravity` stands for it."""
    assumed: AssumedGravity = "nothing"
    """What gravity is taken from because the session does not state it."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Channels:
    """The n sensors of one kind, and what their columns are worth.

    SI = (raw − offset) / scale · unit.factor, divided by the sample's interval if unit.kind is "increment".
    `unit_name` is the unit as the file has it. For raw units (count, V) `unit` is that of `scale_per`;
    for the others scale is 1 and offset 0. `axes` (n, 3): nominal sensing directions in the body frame,
    unit vectors. `range`: full scale in m/s² or rad/s, the smallest of the sensors'. `scale_stated`: whether it is
    known what counts are worth; where it is not, scale is 1."""

    columns: tuple[str, ...]
    unit: Unit
    unit_name: str
    scale: Array
    offset: Array
    axes: Array
    range: float | None
    scale_stated: bool = True

    @property
    def raw(self) -> bool:
        """Whether the log has counts or volts, which need a scale and an offset."""
        return self.unit_name in ("count", "V")

    def to_si(self, raw: Array, dt: Array) -> Array:
        """Rates (m, n), m/s² or rad/s, of a log's numbers (m, n) and the samples' intervals (m,), s."""
        gain = self.unit.factor / self.scale
        out = raw - self.offset if self.offset.any() else raw
        if (gain != 1.0).any():
            out = out * gain
        if self.unit.kind == "increment":
            out = out / dt[:, None]
        return out

    def from_si(self, rates: Array) -> Array:
        """The log's numbers (m, n) of rates or, for increments, of increments in SI."""
        gain = self.scale / self.unit.factor
        out = rates * gain if (gain != 1.0).any() else rates
        return out + self.offset if self.offset.any() else out


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TemperatureChannels:
    """The columns of the thermometers, and what their numbers are in °C: gain · number + shift, both (T,). `unit_name`
    is the unit in session.toml; `accel` and `gyro` are the number of the thermometer that each channel has."""

    columns: tuple[str, ...]
    accel: tuple[int, ...]
    gyro: tuple[int, ...]
    unit_name: str
    gain: Array
    shift: Array

    def to_celsius(self, numbers: Array) -> Array:
        """Temperatures (m, T), °C, of a log's numbers (m, T)."""
        return np.asarray(self.gain * numbers + self.shift)

    def names(self, kind: str) -> tuple[str, ...]:
        """The column of the thermometer of each channel of a kind of sensors."""
        return tuple(self.columns[t] for t in (self.accel if kind == "accel" else self.gyro))


USUAL_CLOCK_U = 30e-6
"""Relative standard uncertainty of time stamps of which nothing is stated: crystals are off by some 20 to 50 ppm, over
temperature and with age."""
USUAL_RATE_U = 1e-2
"""The same of a sample rate without time stamps: it is that of the oscillator in a sensor's chip, which data sheets
have to some per cent, or a number of a configuration."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LogSpec:
    """The log's files, or tables in memory, and columns. Either `time`, a column in units of `time_factor` s, or
    `rate`, Hz. `clock`: the times are those of a clock or a calendar; `regular`: rows are equally spaced, whatever
    their times are; `dialect`: how text files are written, None for CSV files with their names in the first line;
    `clock_u`: the relative standard uncertainty of the time base, None where it is not stated."""

    files: tuple[Path | LogSource, ...]
    time: str | None
    time_factor: float
    rate: float | None
    accel: Channels
    gyro: Channels | None
    temperature: TemperatureChannels | None
    magnetometer: Channels | None = None
    """In its unit, which is that of the site's field too."""
    clock: bool = False
    regular: bool = False
    doubt: str = ""
    """What is not sure about the log, and what hangs on it."""
    dialect: Dialect | None = None
    clock_u: float | None = None
    clock_rate: float = 1.0
    """Seconds in a second of the log's clock, as the Earth's rate shows it."""

    @property
    def unstamped(self) -> bool:
        """Whether no time says that rows are missing."""
        return self.rate is not None or self.regular

    @property
    def time_base_u(self) -> float:
        """The relative standard uncertainty of the time base; where none is stated, that of a crystal for time stamps,
        and of an oscillator in a chip for a sample rate."""
        usual = USUAL_CLOCK_U if self.rate is None else USUAL_RATE_U
        return usual if self.clock_u is None else self.clock_u

    @property
    def increments(self) -> dict[str, bool]:
        """Whether the readings of each kind of sensor there is are increments."""
        kinds = {"accel": self.accel, "gyro": self.gyro}
        return {kind: channels.unit.kind == "increment" for kind, channels in kinds.items() if channels is not None}

    @property
    def columns(self) -> tuple[str, ...]:
        """Every column that is read: time, accelerometers, gyros, magnetometer, thermometers."""
        gyro = self.gyro.columns if self.gyro else ()
        magnetometer = self.magnetometer.columns if self.magnetometer else ()
        thermometers = () if self.temperature is None else self.temperature.columns
        columns = (self.time, *self.accel.columns, *gyro, *magnetometer, *thermometers)
        return tuple(column for column in columns if column is not None)


class ListedPosition(SessionTable):
    """A position of the programme, [[programme.position]]: its attitude code, and the rest's start and stop, s, where
    given."""

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
        """The programme that is meant."""
        return programme_of(self.name or [position.attitude for position in self.position or ()])


class Exclusion(SessionTable):
    """What a session leaves out, [[exclude]]: the rest or the turn of this number, from 1 as results count them, or
    what lies between `start` and `stop`, s, of a file (its number, from 1, the first where None)."""

    by: ClassVar[str] = "session.toml"
    """Who says so."""
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
    """What a caller leaves out."""

    by: ClassVar[str] = "request"


# -------------------- what a certificate needs and no log says --------------------


def _is_date(text: str) -> str:
    try:
        (dt.datetime if "T" in text else dt.date).fromisoformat(text)
    except ValueError:
        raise ValueError(f"expected a date, or a date with a time, found {shown(text)}") from None
    return text


IsoDate = Annotated[str, AfterValidator(_is_date)]
"""A date or a date with a time by ISO 8601."""


@dataclass(frozen=True, kw_only=True, slots=True)
class AirConditions:
    """Temperature with its standard uncertainty (K), relative humidity and air pressure; None where not known."""

    temperature_degC: float | None = None  # noqa: N815
    temperature_u: Annotated[float, Field(ge=0.0)] | None = None
    humidity_percent: float | None = None
    pressure_hPa: float | None = None  # noqa: N815


@dataclass(frozen=True, kw_only=True, slots=True)
class Circumstances:
    """Of a session: `date`, ISO 8601, a date or a date with a time, that which the session states, else the log's own
    where its times are absolute, and never the time of computing; who recorded it; the air; and the equipment with its
    traceability, in words."""

    date: IsoDate | None = None
    operator: str | None = None
    conditions: AirConditions = AirConditions()
    equipment: tuple[str, ...] = ()


UNKNOWN = Circumstances()


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Session(Brief):
    """What session.toml, or the description of samples in memory, says. `programme` is None for a free session:
    orientations are not assumed. `folder` is None in memory.

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
    programme: ProgrammeSpec | None
    excluded: tuple[Exclusion, ...] = ()
    circumstances: Circumstances = UNKNOWN
    description: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)
    """The keys and values that it was made of, as session.toml has them."""

    @property
    def name(self) -> str:
        """What messages call it."""
        return f"session of {self.device.serial} in memory" if self.folder is None else str(self.folder)

    @property
    def accel_block(self) -> Block:
        """The accelerometers and their parameters."""
        known = self.log.temperature
        return Block(kind="accel", axes=self.log.accel.axes, thermometers=() if known is None else known.accel)

    @property
    def gyro_block(self) -> Block | None:
        """The gyros and their parameters; None without gyros."""
        known = self.log.temperature
        if self.log.gyro is None:
            return None
        return Block(kind="gyro", axes=self.log.gyro.axes, thermometers=() if known is None else known.gyro)

    def of_known_scales(self) -> Session:
        """The session without its gyros where nobody states what their counts are worth."""
        known = self.log.temperature
        if self.log.gyro is None or self.log.gyro.scale_stated:
            return self
        log = replace(self.log, gyro=None, temperature=None if known is None else replace(known, gyro=()))
        return replace(self, log=log)

    def check_new(self, out: Path, *, force: bool) -> None:
        """Raises InputError where a file that is to be written exists, unless by `force`, and where it is one that the
        session is read from."""
        if not out.exists():
            return
        if any(isinstance(file, Path) and file.exists() and out.samefile(file) for file in self.log.files):
            raise InputError(f"{out}: expected another file, found the recording of the session; choose another name")
        if not force:
            raise InputError(f"{out}: expected a new file, found one that exists; give --force to replace it")

    def without(self, rests: Iterable[int]) -> Session:
        """The session without the rests of these numbers, from 1 as results count them, beside what it leaves out
        itself. Raises InputError for what is no such number."""
        more = []
        for number in rests:
            if isinstance(number, bool) or not isinstance(number, int | np.integer) or number < 1:
                raise InputError(f"without: expected numbers of rests, from 1 as results count them, found {number!r}")
            more.append(Request(rest=int(number)))
        return replace(self, excluded=(*self.excluded, *more))
