"""The ROS package imu_calib: the file of accelerometer parameters that its node apply_calib reads.

    corrected = SM · raw − bias        SM: nine numbers, row by row

so SM = M⁻¹ and bias = M⁻¹ b. Gyros are not calibrated: the node takes the mean of its first 100 samples for their
bias.

Source: package imu_calib (D. Koch), README and class AccelCalib.
"""

from __future__ import annotations

from tumble.calibration.calibration_file import Calibration
from tumble.export.diagonal import gyro_matrix_lost
from tumble.export.exported import NO_UNCERTAINTY, Exported, commented, examples, origin, triads, yaml_list
from tumble.export.larger_model import not_held


def ros_imu_calib(calibration: Calibration) -> Exported:
    """imu_calib.yaml of a calibration."""
    known = triads(calibration, "ros-imu-calib", needed=("accel",))
    model, inverse = known["accel"], known["accel"].inverse()
    gyros = "everything of the gyros: the node takes their bias at start; "
    losses = [gyros + gyro_matrix_lost(known["gyro"])] if "gyro" in known else []
    losses += [*not_held(calibration), NO_UNCERTAINTY]
    comments = [
        *origin(calibration),
        "corrected = SM * raw - bias, m/s^2",
        *examples({"accel": model}, "example: raw {reading} is {true}"),
        *losses,
    ]
    return commented(comments, [f"SM: {yaml_list(inverse)}", f"bias: {yaml_list(inverse @ model.bias)}"], losses)
