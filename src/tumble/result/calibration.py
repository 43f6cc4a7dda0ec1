"""The calibration of a device: data, the file that keeps them, and what they correct.

What the file has of it stands in `tumble.result.file`; `Calibration.tables` and `calibration_of` are the way there and
back. It is written whole or not at all.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tumble.documents import json_of, text_of_document
from tumble.errors import CalibrationError, InputError, MissingExtraError
from tumble.files import FilePath, whole_file
from tumble.inference.estimate import Fit, GroupFinding, HyperparameterEstimate, Integral, Outcome, ProcessBias
from tumble.inference.prediction import Prediction
from tumble.recording.session import (
    UNKNOWN,
    AutopilotSensor,
    Circumstances,
    Site,
    circumstances_content,
    circumstances_from,
    sensors_content,
    sensors_from,
)
from tumble.result.correction import corrected_readings
from tumble.result.coverage import with_degrees
from tumble.result.file import (
    FORMAT,
    AutopilotTable,
    CalibrationFile,
    CircumstancesContent,
    DeviceContent,
    IncrementTable,
    IterationTable,
    LaunchTable,
    OutcomeTable,
    SensorTable,
    TemperatureContent,
    no_calibration,
    parsed,
)
from tumble.result.frames import Turned, increments_in, turned, with_spread
from tumble.result.parts import Launch, Member, Parameter, Readings, RestResult, SourceContributions, TurnResult
from tumble.result.shown import views
from tumble.result.uncertainty_budget import BudgetLine, uncertainty_budget
from tumble.sensors.compensation import Compensator
from tumble.sensors.frames import frame_of, triad_axes
from tumble.sensors.model import Block, SensorKind, SensorModel
from tumble.sensors.parameters import group_name, sensor_kind, within_group, within_kind
from tumble.units import Array

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    from matplotlib.axes import Axes

    from tumble.recording.arrays import Temperatures

SensingAxes = tuple[tuple[float, ...], ...]
"""Sensing directions, a row a sensor."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Calibration(Mapping[str, Parameter]):
    """The result for one device, a mapping of the names of its parameters to them. `covariance` is in the order of
    `parameters`; `accel` and `gyro` are None where a parameter they need is unobservable. Two are equal whose files
    are. `fits` are chi-square, degrees of freedom and estimated scatter; `programme`
    is the name of the programme, `readings` what the readings of "accel" and "gyro" are."""

    serial: str
    model: str | None
    method: str
    frame: str
    parameters: tuple[Parameter, ...]
    covariance: Array | None
    accel: SensorModel | None
    gyro: SensorModel | None
    outcome: Outcome
    mag: SensorModel | None = None
    """The magnetometer, in its own frame, fixed as that of the accelerometers, and in the unit of `mag.bias.x`."""
    iterations: tuple[Mapping[str, float], ...] = ()
    rests: tuple[RestResult, ...] = ()
    turns: tuple[TurnResult, ...] = ()
    fits: Mapping[str, Fit] = field(default_factory=dict)
    site: Site | None = None
    programme: str | None = None
    readings: Mapping[str, Readings] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    launches: tuple[Launch, ...] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)
    groups: tuple[GroupFinding, ...] = ()
    """What the session says of the groups of parameters beyond the linear model."""
    hyperparameters: tuple[HyperparameterEstimate, ...] = ()
    """What the model did not know about itself: scatter, in-run biases, sizes of groups."""
    integral: Integral | None = None
    """How the posterior was integrated over them."""
    process_bias: tuple[ProcessBias, ...] = ()
    """The biases as the means of their processes, what the next minute's are about; the parameters are those of the
    session. In the frame of the accelerometers alone."""
    budget: tuple[SourceContributions, ...] = ()
    """What the u of every parameter is made of, by source; empty in a frame it was not made in."""
    prediction: Prediction | None = None
    """What corrected readings are known to."""
    axes: Mapping[str, SensingAxes] = field(default_factory=dict)
    """Nominal sensing directions (n, 3) of "accel" and "gyro"."""
    reference_temperature: float | None = None
    """°C, at which parameters that change with temperature have their values; of several thermometers the mean."""
    references: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """The same of each sensor of "accel" and "gyro", by its own thermometer."""
    thermometers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """The column of the thermometer of each sensor of "accel" and "gyro", where there are such."""
    measured_between: tuple[float, float] | None = None
    """°C, the range of rests that are not here, as those of a calibration that a check has updated."""
    circumstances: Circumstances = UNKNOWN
    """When, by whom, with what and in what air it was recorded."""
    imu: Mapping[str, AutopilotSensor] = field(default_factory=dict)
    """Which "accel" and "gyro" of an autopilot were recorded, where they are of one."""
    sample_rate: float | None = None
    """Samples a second of the recording."""
    clock_u: float = 0.0
    """Relative standard uncertainty of the time base as it is in the scale factors of the gyros."""
    together: tuple[Member, ...] = ()
    """The sessions, where several are in one estimate."""
    absent: tuple[str, ...] = ()
    """In sentences, the sensors of the device that are not in this calibration, and why."""

    @property
    def compensator(self) -> Compensator:
        """What corrects readings: the whole model. Gyros alone feel the specific force of accelerometers as they are.
        Raises CalibrationError without any sensors."""
        if self.accel is None and self.gyro is None:
            raise CalibrationError("calibration: expected one with accelerometers or gyros, found none")
        as_they_are = np.array(self.axes.get("accel", np.eye(3)))
        perfect = SensorModel(matrix=as_they_are, bias=np.zeros(len(as_they_are)))
        accel = self._block("accel", perfect if self.accel is None else self.accel)
        gyro = None if self.gyro is None else self._block("gyro", self.gyro)
        values = {p.name: p.value for p in self.parameters if sensor_kind(p.name) != "mag"}
        models = perfect if self.accel is None else self.accel, self.gyro
        references = {str(block.kind): self._references(block) for block in (accel, gyro) if block is not None}
        known = references if self.reference_temperature is not None else {}
        return Compensator.of((accel, gyro), models, values, known)

    def _references(self, block: Block) -> Array:
        """The reference temperature (n,), °C, of each channel of a block."""
        return np.array(self.references.get(block.kind, block.size * (self.reference_temperature or 0.0,)))

    def reference_of(self, name: str) -> float:
        """The temperature, °C, by the thermometer of its sensor, at which a parameter has its value; 0 where there is
        none."""
        kind, sensor = sensor_kind(name), within_group(name).partition(".")[0]
        model = {"accel": self.accel, "gyro": self.gyro}.get(kind)
        if kind not in self.references or model is None:
            return self.reference_temperature or 0.0
        block = self._block("accel" if kind == "accel" else "gyro", model)
        channel = dict(zip(block.sensors, block.channels.tolist(), strict=True)).get(sensor)
        return (self.reference_temperature or 0.0) if channel is None else float(self._references(block)[channel])

    def _block(self, kind: SensorKind, model: SensorModel) -> Block:
        axes = np.array(self.axes[kind]) if kind in self.axes else _nominal_axes(model)
        numbers = {column: t for t, column in enumerate(dict.fromkeys(chain(*self.thermometers.values())))}
        own = tuple(numbers[column] for column in self.thermometers.get(kind, ()))
        return Block(kind=kind, axes=axes, thermometers=own)

    @property
    def temperature_range(self) -> tuple[float, float] | None:
        """The lowest and the highest temperature, °C, that the rests of all launches have of every sensor; None where
        they have none."""
        every = chain(self.rests, *(launch.rests for launch in self.launches))
        by_sensor = list(zip(*(rest.temperatures for rest in every if rest.temperature is not None), strict=False))
        if not by_sensor:
            return self.measured_between
        low, high = max(map(min, by_sensor)), min(map(max, by_sensor))
        return (low, high) if low <= high else None

    def covariance_of(self, names: Sequence[str]) -> Array | None:
        """The covariance (m, m) of the parameters of these names; None where there is none."""
        if self.covariance is None:
            return None
        order = list(self)
        chosen = [order.index(name) for name in names]
        return np.asarray(self.covariance[np.ix_(chosen, chosen)])

    def __getitem__(self, name: str) -> Parameter:
        """The parameter of that name. Raises KeyError, which says of a calibration without any why it has none."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        names = ", ".join(self)
        raise KeyError(
            f"no parameter {name!r}; there are {names}"
            if names
            else f"no parameter {name!r}: not calibrated: {'; '.join(self.outcome.reasons)}"
        )

    def __iter__(self) -> Iterator[str]:
        """The names of the parameters."""
        return (parameter.name for parameter in self.parameters)

    def __len__(self) -> int:
        """How many parameters there are."""
        return len(self.parameters)

    def __bool__(self) -> bool:
        """True, also without parameters."""
        return True

    def __eq__(self, other: object) -> bool:
        """Whether the calibration files of both are the same."""
        return self.content() == other.content() if isinstance(other, Calibration) else NotImplemented

    def __hash__(self) -> int:
        """Of the device, the method and where it is from."""
        return hash((self.serial, self.method, self.frame, *sorted(self.provenance.items())))

    @property
    def headline(self) -> str:
        """The device, the method, how many parameters, and whether it was accepted, in a line."""
        several = f" of {len(self.launches)} launches" if self.launches else ""
        count, verdict = len(self.parameters), self.outcome.verdict
        return f"Calibration of {self.serial}: {self.method}{several}, {count} parameters, {verdict}"

    def __repr__(self) -> str:
        """The headline."""
        return f"<{self.headline}>"

    def _repr_html_(self) -> str:
        """What a notebook shows: the headline, the reasons and the table of parameters."""
        return views().as_html(self)

    def uncertainty_budget(self, name: str) -> tuple[BudgetLine, ...]:
        """What the u of a parameter is made of, the largest first: source, type A or B, its standard uncertainty, the
        sensitivity, contribution and share of u². Raises KeyError for a name that is none, and CalibrationError
        where there is no budget."""
        return uncertainty_budget(self, name)

    def table(self) -> str:
        """The parameters in the field's units, with standard and expanded uncertainty (k = 2), as plain text; where
        there are such, with coverage factor, degrees of freedom, prior and learned fraction."""
        return views().as_text(self)

    def plot(self, axes: Axes) -> None:
        """Draw the residual of every rest, |corrected reading| − g, on matplotlib axes, and the scatter between rests
        as a band; without rests the parameters in units of their uncertainty, hollow where a prior gives it."""
        views().draw(self, axes)

    def to_polars(self) -> pl.DataFrame:
        """The parameters as a polars frame, a row each, in SI: name, value, u, unit, deviation, run_to_run, and
        the coverage factor k, dof, prior and learned."""
        import polars as pl

        schema = {name: pl.String if name in ("name", "unit") else pl.Float64 for name in _COLUMNS}
        return pl.DataFrame(self._columns(), schema=schema)

    def to_pandas(self) -> pd.DataFrame:
        """The same as a pandas frame. Raises MissingExtraError without pandas."""
        try:
            import pandas as pd
        except ModuleNotFoundError as error:
            raise MissingExtraError(
                "a pandas frame needs pandas; install it with: pip install pandas, or take to_polars()"
            ) from error
        return pd.DataFrame(self._columns())

    def _columns(self) -> dict[str, list[Any]]:
        return {name: [getattr(parameter, name) for parameter in self.parameters] for name in _COLUMNS}

    def apply(
        self,
        accel: npt.ArrayLike,
        gyro: npt.ArrayLike | None = None,
        *,
        dt: npt.ArrayLike | None = None,
        temperature: Temperatures | None = None,
    ) -> tuple[Array, Array | None]:
        """Specific force and angular rate (..., 3), m/s² and rad/s in the calibration's frame, by the whole model from
        readings (..., n) in SI after nominal scale and offset, arrays or frames, of more than three sensors by least
        squares. With the intervals `dt` (...), s, of the samples both are increments, m/s and rad. Without gyro
        readings the rate is None; without accelerometers in the calibration the specific force is not a number, and
        what the gyros feel of it is as their readings have it. The `temperature` (...), K, of the sensors counts where
        parameters change with it (in a stream it follows the thermometer with temperature.lag), of accelerometers and
        gyros with thermometers of their own a mapping of "accel" and "gyro", (...) or (..., n); without it they are
        those of the reference temperature. Lever arms and delays, which need the motion, are not applied: see
        `apply_to_session`.

        Raises CalibrationError where none of these sensors were accepted (what is there all the same corrects by the
        `compensator`), and InputError for another number of sensors than the calibration has, numbers that are not
        finite, intervals that are not positive, columns of a frame whose names say another unit, and temperatures that
        are not in kelvin."""
        judged = (self.outcome.accel,) if gyro is None else (self.outcome.accel, self.outcome.gyro)
        if not any(judged):
            reasons = "; ".join(self.outcome.reasons)
            raise CalibrationError(f"calibration: expected accepted accelerometers or gyros, found: {reasons}")
        force, rate = corrected_readings(self.compensator, accel, gyro, dt=dt, temperature=temperature)
        return (np.full_like(force, np.nan) if self.accel is None else force), rate

    def in_frame(self, frame: str) -> Calibration:
        """This calibration of triads in the frame `accelerometer`, `paper` or `symmetric`, with covariance, iterations
        and launches; g-sensitivity and lever arms turn with the frame; deviations from a systematic calibration are
        left out. A magnetometer keeps its own frame.

        Raises CalibrationError for the case, which only the session gives, where a parameter of accelerometers or
        gyros is missing, and for more than three of them."""
        if frame == self.frame:
            return self
        missing = tuple(name for name in self.outcome.unobservable if sensor_kind(name) != "mag")
        missing = missing or (() if self.accel is not None else ("those of accelerometers",))
        if missing:
            raise CalibrationError(f"frame {frame!r}: expected all parameters, found {', '.join(missing)} missing")
        try:
            return self._turned(frame)
        except InputError as error:
            raise CalibrationError(str(error)) from error

    def _turned(self, frame: str) -> Calibration:
        """A complete calibration of triads in another frame."""
        assert self.accel is not None
        accel = Block(kind="accel", axes=triad_axes(self.accel.matrix))
        gyro = None if self.gyro is None else Block(kind="gyro", axes=triad_axes(self.gyro.matrix))

        def in_frame(result: Calibration | Launch) -> Turned:
            frames = frame_of(self.frame), frame_of(frame)
            return turned((accel, gyro), frames, result.parameters, result.covariance)

        mean, launches = in_frame(self), [in_frame(launch) for launch in self.launches]
        return replace(
            self,
            frame=frame,
            parameters=with_spread(mean, launches),
            covariance=mean.covariance,
            accel=mean.framed.accel,
            gyro=mean.framed.gyro,
            process_bias=(),
            budget=(),
            iterations=tuple(increments_in(mean, [p.name for p in self.parameters], step) for step in self.iterations),
            launches=tuple(
                replace(launch, parameters=each.parameters, covariance=each.covariance)
                for launch, each in zip(self.launches, launches, strict=True)
            ),
        )

    def write(self, path: FilePath, *, force: bool = False) -> None:
        """Write the calibration file, whole or not at all. An existing calibration file is replaced only if it came
        from the same log by the same method, if neither its accelerometers nor its gyros were accepted, or with
        `force`; a file that is none is not replaced."""
        path = Path(path)
        if path.exists():
            if not os.access(path, os.W_OK):
                raise CalibrationError(f"{path}: cannot be replaced: it is read-only; choose another --out")
            if path.stat().st_size:  # an empty file holds nothing of anyone's
                self._check_replaceable(path, force)
        try:
            text = self.text()
        except ValueError:
            raise CalibrationError(
                f"{self.serial}: expected an estimate in numbers, found one beyond measure: the recording contradicts "
                "itself; look for a stretch of it in another unit, and leave it out with [[exclude]]"
            ) from None
        try:
            with whole_file(path) as temporary:
                temporary.write_text(text, encoding="utf-8")
        except OSError as error:
            raise CalibrationError(f"{path}: cannot be written: {error.strerror}; choose another --out") from error

    def _check_replaceable(self, path: Path, force: bool) -> None:
        try:
            old = json_of(text_of_document(path))
            same = old["method"] == self.method and old["provenance"]["log_sha256"] == self.provenance["log_sha256"]
            of_use = any(not old["outcome"][kind]["reasons"] and old[kind] is not None for kind in ("accel", "gyro"))
        except (OSError, ValueError, KeyError, TypeError, InputError) as error:
            raise CalibrationError(
                f"{path}: expected a calibration to replace, found another file; remove it, or choose another --out"
            ) from error
        if of_use and not same and not force:
            raise CalibrationError(
                f"{path}: holds a calibration from another log or by another method; give --force to replace it, or "
                "--out for another file"
            )

    def text(self) -> str:
        """The text of the calibration file."""
        return json.dumps(self.content(), indent=1, ensure_ascii=False, allow_nan=False) + "\n"

    def content(self) -> dict[str, Any]:
        """What the calibration file holds, as JSON has it."""
        return self.tables().model_dump(mode="json", warnings=False)

    def tables(self) -> CalibrationFile:
        """What the calibration file holds, as `tumble.result.file` describes it."""
        lag = [p.value for p in self.parameters if p.name == "temperature.lag"]
        return CalibrationFile.model_construct(
            **_same(self, CalibrationFile),
            format=FORMAT,
            device=DeviceContent.model_construct(
                serial=self.serial, model=self.model, imu=AutopilotTable.model_validate(sensors_content(self.imu))
            ),
            accel=self._sensor_table("accel", self.accel, "m/s^2"),
            gyro=self._sensor_table("gyro", self.gyro, "rad/s"),
            mag=self._sensor_table("mag", self.mag, self["mag.bias.x"].unit if self.mag is not None else ""),
            outcome=OutcomeTable.model_validate(self.outcome.content(), strict=False),
            temperature=TemperatureContent.model_construct(
                reference=self.reference_temperature,
                range=self.temperature_range,
                thermometers=self.thermometers,
                references=self.references,
                lag=lag[0] if lag else None,
            ),
            iterations=tuple(
                IterationTable.model_construct(
                    parameters=tuple(IncrementTable.model_construct(name=n, increment=v) for n, v in step.items())
                )
                for step in self.iterations
            ),
            session=_circumstances_table(self.circumstances),
            launches=tuple(
                LaunchTable.model_construct(
                    **_same(launch, LaunchTable),
                    circumstances=_circumstances_table(launch.circumstances),
                )
                for launch in self.launches
            ),
        )

    def _sensor_table(self, kind: str, model: SensorModel | None, unit: str) -> SensorTable | None:
        """The model of a kind of sensor, and beside it the values of the groups beyond it."""
        if model is None:
            return None
        further: dict[str, Any] = {}
        for group in self.groups:
            members = [p for p in self.parameters if group_name(p.name) == group.name]
            if group.kept and sensor_kind(group.name) == kind and members:
                values = {within_group(p.name) or within_kind(p.name): p.value for p in members}
                further[within_kind(group.name)] = values
        return SensorTable.model_construct(matrix=model.matrix.tolist(), bias=model.bias.tolist(), unit=unit, **further)


_COLUMNS = ("name", "value", "u", "unit", "deviation", "run_to_run", "k", "dof", "prior", "learned")
_OTHERWISE = {
    "covariance",
    "accel",
    "gyro",
    "mag",
    "outcome",
    "iterations",
    "launches",
    "circumstances",
}
"""What a calibration and its file have under one name but in another form."""


def _same(result: Calibration | Launch, table: type[CalibrationFile | LaunchTable]) -> dict[str, Any]:
    """What a result has in common with its table, and its covariance."""
    names = {each.name for each in fields(result)} & set(table.model_fields) - _OTHERWISE
    same = {name: getattr(result, name) for name in names}
    return same | {"covariance": None if result.covariance is None else result.covariance.tolist()}


def _read(table: CalibrationFile | LaunchTable, result: type[Calibration | Launch]) -> dict[str, Any]:
    """What a result and each of its launches have of their tables."""
    names = {each.name for each in fields(result)} & set(type(table).model_fields) - _OTHERWISE
    size = len(table.parameters)
    return {name: getattr(table, name) for name in names} | {
        "parameters": with_degrees(table.parameters, table.fits),
        "covariance": None if table.covariance is None else np.array(table.covariance, float).reshape(size, size),
    }


def _circumstances_table(circumstances: Circumstances) -> CircumstancesContent:
    return CircumstancesContent.model_validate(circumstances_content(circumstances), strict=False)


def _nominal_axes(model: SensorModel) -> Array:
    """Nominal axes of a model of which they are not known: the body axes of a triad, else the axes themselves."""
    if len(model.bias) == 3:
        try:
            return triad_axes(model.matrix)
        except InputError:  # three that are skew
            pass
    return np.asarray(model.matrix / np.linalg.norm(model.matrix, axis=1, keepdims=True))


def read_calibration(path: FilePath) -> Calibration:
    """A calibration file as written by `Calibration.write`. Raises CalibrationError for a file that is none.

    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> tumble.calibrate(folder).write("calibration.json")
    >>> tumble.read_calibration("calibration.json")
    <Calibration of mems-1: joint, 60 parameters, accepted>
    """
    return calibration_of(text_of(Path(path)), str(path))


def calibration_from(given: Calibration | FilePath) -> Calibration:
    """A calibration as it is, or that of a file. Raises InputError for anything else."""
    return given if isinstance(given, Calibration) else calibration_of(*text_and_name(given))


def text_and_name(given: Calibration | FilePath) -> tuple[str, str]:
    """The text of a calibration file, or that a calibration in memory would have, and what it is called in messages.
    Raises InputError for anything else."""
    if isinstance(given, Calibration):
        return given.text(), f"calibration of {given.serial}"
    if not isinstance(given, str | os.PathLike):
        raise InputError(
            f"calibration: expected a Calibration or the path of a calibration file, found {type(given).__name__}"
        )
    return text_of(Path(given)), str(given)


def text_of(path: Path) -> str:
    """The text of a calibration file, not yet looked at."""
    try:
        return text_of_document(path)
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:  # not UTF-8
        raise no_calibration(str(path), error) from error


def calibration_of(text: str, name: str) -> Calibration:
    """The calibration of the text of a file; in messages the file is called `name`."""
    file = parsed(text, name)
    temperature = file.temperature
    accel, gyro, mag = (None if table is None else table.model for table in (file.accel, file.gyro, file.mag))
    return Calibration(
        **_read(file, Calibration),
        serial=file.device.serial,
        model=file.device.model,
        imu=sensors_from(file.device.imu.model_dump()),
        accel=accel,
        gyro=gyro,
        mag=mag,
        outcome=file.outcome.outcome,
        reference_temperature=temperature.reference,
        thermometers=temperature.thermometers,
        references=temperature.references,
        measured_between=temperature.range,
        iterations=tuple({p.name: p.increment for p in step.parameters} for step in file.iterations),
        circumstances=circumstances_from(file.session.model_dump()),
        launches=tuple(
            Launch(**_read(launch, Launch), circumstances=circumstances_from(launch.circumstances.model_dump()))
            for launch in file.launches
        ),
    )
