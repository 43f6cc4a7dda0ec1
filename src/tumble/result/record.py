"""Fields of a calibration, and the correction of readings by them.

The functions of this folder take `CalibrationData`; its subclass `Calibration` has the methods for users.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Annotated, ClassVar, TypeVar

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field

from tumble.errors import CalibrationError, InputError, did_you_mean
from tumble.inference.estimate import GroupFinding, Outcome
from tumble.inference.prediction import Prediction
from tumble.recording.session import AutopilotSensor
from tumble.result.parts import (
    MOST_PARAMETERS,
    CalibratedDevice,
    CalibratedTemperature,
    Covariance,
    Evidence,
    Launch,
    ModelFromTable,
    Name,
    Parameter,
    Parameters,
    Provenance,
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
"""Sensing directions, a row per sensor."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class CalibrationData(Mapping[str, Parameter]):
    """Fields of a calibration, see `Calibration`."""

    __pydantic_config__: ClassVar = ConfigDict(extra="ignore", strict=True, allow_inf_nan=False)

    device: CalibratedDevice
    method: Name
    frame: Name
    parameters: Parameters
    covariance: Covariance | None
    accel: ModelFromTable | None
    gyro: ModelFromTable | None
    mag: ModelFromTable | None = None
    outcome: Outcome
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
        """Serial number of the device."""
        return self.device.serial

    @property
    def model(self) -> str | None:
        """Type of the device."""
        return self.device.model

    @property
    def imu(self) -> Mapping[str, AutopilotSensor]:
        """Recorded "accel" and "gyro" of an autopilot."""
        return self.device.imu

    @property
    def reference_temperature(self) -> float | None:
        """Reference temperature of the parameters, °C; the mean over several thermometers."""
        return self.temperature.reference

    @property
    def compensator(self) -> Compensator:
        """Correction of readings by the whole model.

        Without accelerometers their uncorrected readings serve for the g-sensitivity of gyros. Raises CalibrationError
        without any sensors."""
        if self.accel is None and self.gyro is None:
            raise CalibrationError("calibration: expected one with accelerometers or gyros, found none")
        axes = np.array(self.axes.get("accel", np.eye(3)))
        nominal = SensorModel(matrix=axes, bias=np.zeros(len(axes)))
        models = nominal if self.accel is None else self.accel, self.gyro
        accel = _block(self, "accel", models[0])
        gyro = None if models[1] is None else _block(self, "gyro", models[1])
        values = {p.name: p.value for p in self.parameters if sensor_kind(p.name) != "mag"}
        references = {str(block.kind): _references(self, block) for block in (accel, gyro) if block is not None}
        stated = references if self.reference_temperature is not None else {}
        return Compensator.of((accel, gyro), models, values, stated)

    @property
    def temperature_range(self) -> tuple[float, float] | None:
        """Lowest and highest temperature, °C, of every sensor in the rests of all launches; None if not known."""
        temperatures = (rest.temperatures for rest in self.evidence.all_rests if rest.temperature is not None)
        by_sensor = list(zip(*temperatures, strict=False))
        if not by_sensor:
            return self.temperature.range
        low, high = max(map(min, by_sensor)), min(map(max, by_sensor))
        return (low, high) if low <= high else None

    def as_launch(self, session: str) -> Launch:
        """Return this calibration as one of the launches behind a mean, with the name of its session."""
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
        """Return the covariance (m, m) of parameters, or None."""
        if self.covariance is None:
            return None
        order = list(self)
        chosen = [order.index(name) for name in names]
        return np.asarray(self.covariance[np.ix_(chosen, chosen)])

    def __getitem__(self, name: str) -> Parameter:
        """Return the parameter of that name. Raises KeyError, with the reason if the calibration has no parameters."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        if not self.parameters:
            raise KeyError(f"no parameter {name!r}: not calibrated: {'; '.join(self.outcome.reasons)}")
        raise KeyError(f"no parameter {name!r}" + (did_you_mean(name, self) or f"; there are {', '.join(self)}"))

    def __contains__(self, name: object) -> bool:
        """Return True if there is a parameter of that name."""
        return any(parameter.name == name for parameter in self.parameters)

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the parameters."""
        return (parameter.name for parameter in self.parameters)

    def __len__(self) -> int:
        """Return the number of parameters."""
        return len(self.parameters)

    def __bool__(self) -> bool:
        """Return True, also without parameters."""
        return True


AnyCalibration = TypeVar("AnyCalibration", bound=CalibrationData)


def reference_of_parameter(calibration: CalibrationData, name: str) -> float:
    """Return the reference temperature of a parameter, °C, by the thermometer of its sensor; 0 if there is none."""
    kind, sensor = sensor_kind(name), within_group(name).partition(".")[0]
    model, reference = getattr(calibration, kind, None), calibration.reference_temperature or 0.0
    if kind not in calibration.temperature.references or model is None:
        return reference
    block = _block(calibration, "accel" if kind == "accel" else "gyro", model)
    channel = dict(zip(block.sensors, block.channels.tolist(), strict=True)).get(sensor)
    return reference if channel is None else float(_references(calibration, block)[channel])


def to_references(calibration: CalibrationData, names: Sequence[str], temperature: CalibratedTemperature) -> Array:
    """Return the matrix (m, m) that converts parameters of a calibration to other reference temperatures."""
    target = replace(calibration, temperature=temperature)
    change = [reference_of_parameter(target, name) - reference_of_parameter(calibration, name) for name in names]
    return to_temperature(names, np.array(change))


def _references(calibration: CalibrationData, block: Block) -> Array:
    """Return the reference temperature (n,), °C, of each channel of a block."""
    default = block.size * (calibration.reference_temperature or 0.0,)
    return np.array(calibration.temperature.references.get(block.kind, default))


def _block(calibration: CalibrationData, kind: SensorKind, model: SensorModel) -> Block:
    """Return the sensors of a kind with their thermometers.

    If the nominal axes are not known they are those of the model, or the body axes for a triad."""
    axes = model.matrix / np.linalg.norm(model.matrix, axis=1, keepdims=True)
    if kind in calibration.axes:
        axes = np.array(calibration.axes[kind])
    elif len(model.bias) == 3:
        with suppress(InputError):  # three axes that are no triad
            axes = triad_axes(model.matrix)
    columns = calibration.temperature.thermometers
    numbers = {column: t for t, column in enumerate(dict.fromkeys(chain(*columns.values())))}
    return Block(kind=kind, axes=axes, thermometers=tuple(numbers[column] for column in columns.get(kind, ())))
