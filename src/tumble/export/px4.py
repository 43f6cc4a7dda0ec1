"""PX4: a parameter file as QGroundControl loads it, calibration number 0 of accelerometer and gyro.

    CAL_ACC0_XOFF, _XSCALE and so on: (reading − offset) · scale        CAL_GYRO0_XOFF and so on: reading − offset

reading being that of the topics sensor_accel and sensor_gyro, m/s² and rad/s. PX4 uses the numbers for the sensor whose
id is in CAL_ACC0_ID and CAL_GYRO0_ID, which this file leaves as they are.

Source: PX4, parameter reference; library sensor_calibration, Accelerometer and Gyroscope; QGroundControl, "Parameters
file format".
"""

from __future__ import annotations

import numpy as np

from tumble.calibration.calibration_file import Calibration
from tumble.export.autopilot import Diagonal, diagonal, written
from tumble.export.exported import Exported, origin

REAL32 = 9
"""MAV_PARAM_TYPE_REAL32."""

LEAST = 0.01
"""Length of the shortest offset (m/s², rad/s) and of the smallest change of scale that every release takes over."""


def px4(calibration: Calibration) -> Exported:
    """The .params file of a calibration."""
    held = diagonal(calibration, "px4")
    losses = (*held.losses, *too_small(held))
    comments = [
        *origin(calibration),
        "CAL_ACC0_ID and CAL_GYRO0_ID have to be the ids of these sensors already",
        *held.examples(),
        *losses,
        "",
        "Vehicle-Id Component-Id Name Value Type",
    ]
    rows = [f"1\t1\t{name}\t{value}\t{REAL32}" for name, value in parameters(held)]
    text = "\n".join([*(f"# {line}".rstrip() for line in comments), *rows, ""])
    return Exported(content=text.encode(), losses=losses)


def parameters(held: Diagonal) -> list[tuple[str, str]]:
    """Names and values of offsets and scales."""
    groups = [("CAL_ACC0_{}OFF", held.accel_offset), ("CAL_ACC0_{}SCALE", held.accel_factor)]
    groups += [] if held.gyro_offset is None else [("CAL_GYRO0_{}OFF", held.gyro_offset)]
    return [
        (name.format(axis), value) for name, three in groups for axis, value in zip("XYZ", written(three), strict=True)
    ]


def too_small(held: Diagonal) -> list[str]:
    """Corrections that some releases of PX4 do not take over."""
    changes = {"accelerometer offsets": held.accel_offset, "accelerometer scales": held.accel_factor - 1.0}
    if held.gyro_offset is not None:
        changes["gyro offsets"] = held.gyro_offset
    small = [name for name, three in changes.items() if np.linalg.norm(three) <= LEAST]
    said = (
        "some releases of PX4 ignore corrections shorter than 0.01 (m/s^2, 1, rad/s), as here: {}; see `sensors status`"
    )
    return [said.format(", ".join(small))] if small else []
