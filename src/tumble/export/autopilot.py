"""Autopilots: an offset and a factor for each accelerometer, an offset for each gyro.

    acceleration = (reading − offset) · factor        rate = reading − offset

in the sensor's axes, m/s² and rad/s, single precision; board rotations come afterwards. The offsets are the biases b.
The factors are 1/Mᵢᵢ: what is left of the accelerometers' matrix then has a unit diagonal.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass

import numpy as np

from tumble.calibration.calibration_file import Calibration
from tumble.errors import InputError
from tumble.export.exported import (
    NO_UNCERTAINTY,
    SINGLE_PRECISION,
    aligned,
    example,
    gyro_matrix_lost,
    misalignment_lost,
    shown,
    triads,
)
from tumble.export.larger_model import not_held
from tumble.recording.autopilot import AutopilotSensor
from tumble.sensors.model import SensorModel
from tumble.units import Array

FIRST: Mapping[str, AutopilotSensor] = {kind: AutopilotSensor(number=1, id=None) for kind in ("accel", "gyro")}
"""The sensors of the first IMU, whatever their ids are."""


def sensors_of(calibration: Calibration, imu: int | None, target: str, most: int) -> Mapping[str, AutopilotSensor]:
    """Which sensors of an autopilot the calibration is of: those that were recorded, else the first of each kind, or
    those of the number `imu`, from 1 to `most`. Raises InputError where others were recorded."""
    if imu is not None and not 1 <= imu <= most:
        raise InputError(f"--imu: expected a number from 1 to {most} for {target}, found {imu}")
    if imu is None:
        return {**FIRST, **calibration.imu}
    for kind, sensor in calibration.imu.items():
        if sensor.number != imu:
            device = "" if sensor.id is None else f" with the device id {sensor.id}"
            raise InputError(
                f"export to {target}: expected the sensors that were recorded, {kind} {sensor.number}{device}, found "
                f"--imu {imu}; calibrate a recording of IMU {imu}, or leave --imu out"
            )
    return {kind: calibration.imu.get(kind, AutopilotSensor(number=imu, id=None)) for kind in FIRST}


def whose(calibration: Calibration, imu: int | None) -> list[str]:
    """What is supposed where neither the calibration nor the user says which IMU it is."""
    said = "the calibration does not say which IMU it is of: these are parameters of the first, --imu N of another"
    return [said] if imu is None and not calibration.imu else []


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Diagonal:
    """What an autopilot can hold, in single precision, of the kinds of sensors that are `known`: their offsets (3,),
    and factors (3,), which gyros have none of: 1."""

    offset: Mapping[str, Array]
    factor: Mapping[str, Array]
    known: Mapping[str, SensorModel]
    losses: tuple[str, ...]

    def examples(self) -> list[str]:
        """Readings, what the autopilot makes of them and what they are, line by line."""
        out = []
        for kind, model in self.known.items():
            worked = example(kind, model)
            target = (worked.reading - self.offset[kind]) * self.factor[kind]
            out.append(
                f"example {kind}: reading {shown(worked.reading)} becomes {shown(target.round(6))}; it is "
                f"{shown(worked.true.round(6))}"
            )
        return out


def diagonal(calibration: Calibration, target: str, apart: Container[str] = ()) -> Diagonal:
    """Offsets and factors of a calibration, and what is lost, but for the groups of parameters that are told of
    `apart`. Raises InputError unless the channels are X, Y, Z."""
    known = triads(calibration, target, needed=())
    aligned(known, target)
    factors = {kind: 1.0 / np.diag(model.matrix) if kind == "accel" else np.ones(3) for kind, model in known.items()}
    losses = [misalignment_lost(model) if kind == "accel" else gyro_matrix_lost(model) for kind, model in known.items()]
    return Diagonal(
        offset={kind: single(model.bias) for kind, model in known.items()},
        factor={kind: single(factor) for kind, factor in factors.items()},
        known=known,
        losses=(*losses, *not_held(calibration, apart), SINGLE_PRECISION, NO_UNCERTAINTY),
    )


def written(values: Array) -> list[str]:
    """Numbers of single precision as text, with as many digits as it takes to read them back in single precision."""
    return [np.format_float_positional(value, trim="0") for value in values.astype(np.float32)]


def single(values: Array) -> Array:
    """Numbers as single precision keeps them."""
    return np.asarray(values.astype(np.float32), dtype=float)
