"""ArduPilot: a parameter file for the first IMU.

    INS_ACCOFFS_X, INS_ACCSCAL_X and so on: (reading − offset) · scale        INS_GYROFFS_X and so on: reading − offset

reading being that of the sensor, m/s² and rad/s, before the board's orientation. Offsets of the gyros are estimated
anew at every start unless INS_GYR_CAL is 0.

Source: ArduPilot, parameter reference; library AP_InertialSensor.
"""

from __future__ import annotations

from tumble.calibration.calibration_file import Calibration
from tumble.export.autopilot import diagonal, written
from tumble.export.exported import Exported, origin


def ardupilot(calibration: Calibration) -> Exported:
    """The .param file of a calibration."""
    held = diagonal(calibration, "ardupilot")
    groups = [("INS_ACCOFFS", held.accel_offset), ("INS_ACCSCAL", held.accel_factor)]
    losses = list(held.losses)
    if held.gyro_offset is not None:
        groups.append(("INS_GYROFFS", held.gyro_offset))
        losses.append("gyro offsets are estimated anew at every start unless INS_GYR_CAL is 0")
    rows = [
        f"{name}_{axis},{value}" for name, three in groups for axis, value in zip("XYZ", written(three), strict=True)
    ]
    comments = [f"# {line}" for line in (*origin(calibration), *held.examples(), *losses)]
    return Exported(content="\n".join([*comments, *rows, ""]).encode(), losses=tuple(losses))
