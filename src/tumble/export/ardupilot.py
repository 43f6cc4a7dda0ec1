"""ArduPilot: a parameter file for the first IMU.

    INS_ACCOFFS_X, INS_ACCSCAL_X and so on: (reading − offset) · scale        INS_GYROFFS_X and so on: reading − offset

reading being that of the sensor, m/s² and rad/s, before the board's orientation. Offsets of the gyros are estimated
anew at every start unless INS_GYR_CAL is 0.

Source: ArduPilot, parameter reference; library AP_InertialSensor.
"""

from __future__ import annotations

from tumble.calibration.calibration_file import Calibration
from tumble.export.autopilot import Diagonal, diagonal, written
from tumble.export.exported import Exported, origin

ESTIMATED_ANEW = "gyro offsets are estimated anew at every start unless INS_GYR_CAL is 0"


def ardupilot(calibration: Calibration) -> Exported:
    """The .param file of a calibration."""
    held = diagonal(calibration, "ardupilot")
    losses = (*held.losses, *([] if held.gyro_offset is None else [ESTIMATED_ANEW]))
    comments = [f"# {line}" for line in (*origin(calibration), *held.examples(), *losses)]
    rows = [f"{name},{value}" for name, value in parameters(held)]
    return Exported(content="\n".join([*comments, *rows, ""]).encode(), losses=losses)


def parameters(held: Diagonal) -> list[tuple[str, str]]:
    """Names and values of offsets and scales."""
    groups = [("INS_ACCOFFS", held.accel_offset), ("INS_ACCSCAL", held.accel_factor)]
    groups += [] if held.gyro_offset is None else [("INS_GYROFFS", held.gyro_offset)]
    return [
        (f"{name}_{axis}", value) for name, three in groups for axis, value in zip("XYZ", written(three), strict=True)
    ]
