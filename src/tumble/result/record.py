"""A calibration as data: the fields that its file has, and what corrects readings by them.

The modules beside it take this class; `Calibration` is it with what a user asks of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Annotated, TypeVar

import numpy as np
from pydantic import AfterValidator, Field

from tumble.errors import CalibrationError, InputError
from tumble.inference.estimate import GroupFinding
from tumble.inference.prediction import Prediction
from tumble.recording.session import AutopilotSensor
from tumble.result.parts import (
    MOST_PARAMETERS,
    CalibratedDevice,
    CalibratedTemperature,
    Covariance,
    Evidence,
    Judged,
    Launch,
    Name,
    Parameter,
    Parameters,
    Provenance,
    Sensors,
    checked_sizes,
)
from tumble.sensors.compensation import Compensator
from tumble.sensors.frames import triad_axes
from tumble.sensors.model import Block, SensorKind, SensorModel
from tumble.sensors.parameters import sensor_kind, to_temperature, within_group
from tumble.units import Array


def _of_unit_length(axis: tuple[float, ...]) -> tuple[float, ...]:
    if not abs(float(np.linalg.norm(axis)) - 1.0) < 1e-6:
        raise ValueError("expected a unit vector, found one of another length")
    return axis


_Direction = Annotated[tuple[float, ...], Field(min_length=3, max_length=3), AfterValidator(_of_unit_length)]
SensingAxes = tuple[_Direction, ...]
"""Sensing directions, a row a sensor."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class CalibrationData(Mapping[str, Parameter]):
    """Fields of a calibration, see `Calibration`."""

    device: CalibratedDevice
    method: Name
    frame: Name
    parameters: Parameters
    covariance: Covariance | None
    accel: Sensors | None
    gyro: Sensors | None
    mag: Sensors | None = None
    outcome: Judged
    groups: Annotated[
        tuple[Annotated[GroupFinding, checked_sizes("prior", "prior_widened")], ...], Field(max_length=MOST_PARAMETERS)
    ] = ()
    prediction: Annotated[Prediction, checked_sizes("force_u", "rate_u")] | None = None
    axes: Mapping[str, SensingAxes] = field(default_factory=dict)
    temperature: CalibratedTemperature = field(default_factory=CalibratedTemperature)
    evidence: Evidence = field(default_factory=Evidence)
    provenance: Provenance = field(default_factory=Provenance)

    @property
    def serial(self) -> str:
        """The serial number of the device."""
        return self.device.serial

    @property
    def model(self) -> str | None:
        """The type of the device."""
        return self.device.model

    @property
    def imu(self) -> Mapping[str, AutopilotSensor]:
        """Which "accel" and "gyro" of an autopilot were recorded, where they are of one."""
        return self.device.imu

    @property
    def reference_temperature(self) -> float | None:
        """°C, at which parameters that change with temperature have their values; of several thermometers the mean."""
        return self.temperature.reference

    @property
    def compensator(self) -> Compensator:
        """What corrects readings: the whole model. Gyros alone feel the specific force of accelerometers as they are.
        Raises CalibrationError without any sensors."""
        if self.accel is None and self.gyro is None:
            raise CalibrationError("calibration: expected one with accelerometers or gyros, found none")
        as_they_are = np.array(self.axes.get("accel", np.eye(3)))
        perfect = SensorModel(matrix=as_they_are, bias=np.zeros(len(as_they_are)))
        models = perfect if self.accel is None else self.accel, self.gyro
        accel = _block(self, "accel", models[0])
        gyro = None if models[1] is None else _block(self, "gyro", models[1])
        values = {p.name: p.value for p in self.parameters if sensor_kind(p.name) != "mag"}
        references = {str(block.kind): _references(self, block) for block in (accel, gyro) if block is not None}
        stated = references if self.reference_temperature is not None else {}
        return Compensator.of((accel, gyro), models, values, stated)

    @property
    def temperature_range(self) -> tuple[float, float] | None:
        """The lowest and the highest temperature, °C, that the rests of all launches have of every sensor; None where
        they have none."""
        every = chain(self.evidence.rests, *(launch.rests for launch in self.evidence.launches))
        by_sensor = list(zip(*(rest.temperatures for rest in every if rest.temperature is not None), strict=False))
        if not by_sensor:
            return self.temperature.range
        low, high = max(map(min, by_sensor)), min(map(max, by_sensor))
        return (low, high) if low <= high else None

    def as_launch(self, session: str) -> Launch:
        """This calibration of one session as one of the launches behind a mean, with the name of the session."""
        return Launch(
            session=session,
            log_sha256=self.provenance.log_sha256 or "",
            parameters=self.parameters,
            covariance=self.covariance,
            site=self.provenance.site,
            circumstances=self.provenance.circumstances,
            rests=self.evidence.rests,
            turns=self.evidence.turns,
            fits=self.evidence.fits,
        )

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


AnyCalibration = TypeVar("AnyCalibration", bound=CalibrationData)


def reference_of_parameter(calibration: CalibrationData, name: str) -> float:
    """The temperature, °C, by the thermometer of its sensor, at which a parameter has its value; 0 where there is
    none."""
    kind, sensor = sensor_kind(name), within_group(name).partition(".")[0]
    model, of_all = getattr(calibration, kind, None), calibration.reference_temperature or 0.0
    if kind not in calibration.temperature.references or model is None:
        return of_all
    block = _block(calibration, "accel" if kind == "accel" else "gyro", model)
    channel = dict(zip(block.sensors, block.channels.tolist(), strict=True)).get(sensor)
    return of_all if channel is None else float(_references(calibration, block)[channel])


def to_references(calibration: CalibrationData, names: Sequence[str], temperature: CalibratedTemperature) -> Array:
    """What takes (m, m) values of parameters of a calibration to their values at the references of another one."""
    moved = replace(calibration, temperature=temperature)
    warmer = [reference_of_parameter(moved, name) - reference_of_parameter(calibration, name) for name in names]
    return to_temperature(names, np.array(warmer))


def _references(calibration: CalibrationData, block: Block) -> Array:
    """The reference temperature (n,), °C, of each channel of a block."""
    of_all = block.size * (calibration.reference_temperature or 0.0,)
    return np.array(calibration.temperature.references.get(block.kind, of_all))


def _block(calibration: CalibrationData, kind: SensorKind, model: SensorModel) -> Block:
    """The sensors of a kind with their thermometers; along the axes of their model where the nominal ones are not
    known, those of a triad the body's."""
    axes = model.matrix / np.linalg.norm(model.matrix, axis=1, keepdims=True)
    if kind in calibration.axes:
        axes = np.array(calibration.axes[kind])
    elif len(model.bias) == 3:
        with suppress(InputError):  # of three that are skew
            axes = triad_axes(model.matrix)
    columns = calibration.temperature.thermometers
    numbers = {column: t for t, column in enumerate(dict.fromkeys(chain(*columns.values())))}
    return Block(kind=kind, axes=axes, thermometers=tuple(numbers[column] for column in columns.get(kind, ())))
