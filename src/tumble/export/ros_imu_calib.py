"""The ROS package imu_calib: the file of accelerometer parameters that its node apply_calib reads.

    corrected = SM · raw − bias        SM: nine numbers, row by row

so SM = M⁻¹ and bias = M⁻¹ b. Gyros are not calibrated: the node takes the mean of its first 100 samples for their
bias.

Source: package imu_calib (D. Koch), README and class AccelCalib.
"""

from __future__ import annotations

from tumble.calibration.calibration_file import Calibration
from tumble.export.exported import (
    NO_UNCERTAINTY,
    Exported,
    example,
    gyro_matrix_lost,
    origin,
    shown,
    triads,
    yaml_list,
)
from tumble.export.larger_model import not_held


def ros_imu_calib(calibration: Calibration) -> Exported:
    """imu_calib.yaml of a calibration."""
    known = triads(calibration, "ros-imu-calib", needed=("accel",))
    model = known["accel"]
    inverse = model.inverse()
    losses = [*not_held(calibration), NO_UNCERTAINTY]
    if "gyro" in known:
        losses.insert(
            0, f"everything of the gyros: the node takes their bias at start; {gyro_matrix_lost(known['gyro'])}"
        )
    worked = example("accel", model)
    comments = [
        *origin(calibration),
        "corrected = SM * raw - bias, m/s^2",
        f"example: raw {shown(worked.reading)} is {shown(worked.true.round(9))}",
        *losses,
    ]
    rows = [f"SM: {yaml_list(inverse)}", f"bias: {yaml_list(inverse @ model.bias)}"]
    text = "\n".join([*(f"# {line}" for line in comments), *rows, ""])
    return Exported(content=text.encode(), losses=tuple(losses))
