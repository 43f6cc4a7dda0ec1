"""PX4: a parameter file as QGroundControl loads it, of one accelerometer and one gyro.

    CAL_ACC0_XOFF, _XSCALE and so on: (reading − offset) · scale        CAL_GYRO0_XOFF and so on: reading − offset

reading being that of the topics sensor_accel and sensor_gyro, m/s² and rad/s. PX4 counts from 0: the third IMU has
CAL_ACC2 and CAL_GYRO2. It uses the numbers for the sensor whose id is in CAL_ACC0_ID and CAL_GYRO0_ID, which are in the
file where the recording had them.

Source: PX4, parameter reference; library sensor_calibration, Accelerometer and Gyroscope; QGroundControl, "Parameters
file format".
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tumble.calibration.calibration_file import Calibration
from tumble.export.autopilot import FIRST, Diagonal, diagonal, sensors_of, whose, written
from tumble.export.exported import Exported, origin
from tumble.recording.autopilot import AutopilotSensor

REAL32 = 9
"""MAV_PARAM_TYPE_REAL32."""

INT32 = 6
"""MAV_PARAM_TYPE_INT32."""

MOST = 4
"""Calibrations of each kind that PX4 keeps."""

LEAST = 0.01
"""Length of the shortest offset (m/s², rad/s) and of the smallest change of scale that every release takes over."""


def px4(calibration: Calibration, imu: int | None = None) -> Exported:
    """The .params file of a calibration, of the IMU of this number, from 1, or of that which was recorded."""
    held, sensors = diagonal(calibration, "px4"), sensors_of(calibration, imu, "px4", MOST)
    losses = (*held.losses, *too_small(held), *whose(calibration, imu))
    unknown = [f"{stem}_ID" for stem, sensor in _stems(held, sensors).items() if sensor.id is None]
    plural = "ids of these sensors" if len(unknown) > 1 else "id of this sensor"
    comments = [
        *origin(calibration),
        *([f"{' and '.join(unknown)} have to be the {plural} already"] if unknown else []),
        *held.examples(),
        *losses,
        "",
        "Vehicle-Id Component-Id Name Value Type",
    ]
    rows = [f"1\t1\t{name}\t{value}\t{REAL32}" for name, value in parameters(held, sensors)]
    rows += [
        f"1\t1\t{stem}_ID\t{signed(sensor.id)}\t{INT32}"
        for stem, sensor in _stems(held, sensors).items()
        if sensor.id is not None
    ]
    text = "\n".join([*(f"# {line}".rstrip() for line in comments), *rows, ""])
    return Exported(content=text.encode(), losses=losses)


def _stems(held: Diagonal, sensors: Mapping[str, AutopilotSensor]) -> dict[str, AutopilotSensor]:
    """The sensors by what the names of their parameters begin with."""
    return {_stem(kind, sensors): sensors[kind] for kind in held.known}


def _stem(kind: str, sensors: Mapping[str, AutopilotSensor]) -> str:
    """What the names of the parameters of a sensor begin with."""
    return f"CAL_{'ACC' if kind == 'accel' else 'GYRO'}{sensors[kind].number - 1}"


def signed(device: int) -> int:
    """A device id as a parameter, a number with a sign."""
    return device - 2**32 if device >= 2**31 else device


def parameters(held: Diagonal, sensors: Mapping[str, AutopilotSensor] = FIRST) -> list[tuple[str, str]]:
    """Names and values of offsets and scales."""
    groups = []
    for kind, offset in held.offset.items():
        stem = _stem(kind, sensors)
        groups += [(f"{stem}_{{}}OFF", offset)]
        groups += [(f"{stem}_{{}}SCALE", held.factor[kind])] if kind == "accel" else []
    return [
        (name.format(axis), value) for name, three in groups for axis, value in zip("XYZ", written(three), strict=True)
    ]


def too_small(held: Diagonal) -> list[str]:
    """Corrections that some releases of PX4 do not take over."""
    changes = {}
    if "accel" in held.known:
        changes = {"accelerometer offsets": held.offset["accel"], "accelerometer scales": held.factor["accel"] - 1.0}
    if "gyro" in held.known:
        changes["gyro offsets"] = held.offset["gyro"]
    small = [name for name, three in changes.items() if np.linalg.norm(three) <= LEAST]
    said = (
        "some releases of PX4 ignore corrections shorter than 0.01 (m/s^2, 1, rad/s), as here: {}; see `sensors status`"
    )
    return [said.format(", ".join(small))] if small else []
