"""Parameters of programs on robots.

Fusion, the library of xio Technologies: constants of C for FusionCalibrationInertial, in g and deg/s,

    calibrated = misalignment · (sensitivity ∘ (uncalibrated − offset))

so that with sensitivity 1/Mᵢᵢ and misalignment M⁻¹ diag(M) the whole matrix and the bias are held.

Autoware's node imu_corrector takes offsets, rad/s, off the gyros' readings, and nothing off the accelerometers'.

Source: Fusion, FusionCalibration.h; Autoware, package autoware_imu_corrector, imu_corrector_core.cpp.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tumble.export.autopilots import gyro_matrix_lost
from tumble.export.exported import (
    NO_UNCERTAINTY,
    Exported,
    commented,
    examples,
    origin,
    triads,
    yaml_number,
)
from tumble.export.larger_model import not_held
from tumble.result.calibration import Calibration
from tumble.sensors.model import SensorKind
from tumble.units import DEGREE, G_STANDARD, Array

_NAMES: Mapping[SensorKind, tuple[str, float]] = {"accel": ("accelerometer", G_STANDARD), "gyro": ("gyroscope", DEGREE)}


def fusion(calibration: Calibration) -> Exported:
    """The constants of a calibration in C."""
    known = triads(calibration, "fusion", needed=())
    losses = [*not_held(calibration), "Fusion computes in single precision: 7 digits of each number", NO_UNCERTAINTY]
    sizes = {kind: size for kind, (_, size) in _NAMES.items()}
    comments = [
        *origin(calibration),
        "calibrated = misalignment * (sensitivity o (uncalibrated - offset)), in g and deg/s",
    ]
    comments += examples(known, "example {kind}: uncalibrated {reading} is {true}", sizes)
    lines = []
    for kind, model in known.items():
        name, size = _NAMES[kind]
        sensitivity = 1.0 / np.diag(model.matrix)
        rows = ", ".join(_braced(row) for row in model.inverse() / sensitivity)
        lines += [
            f"static const FusionMatrix {name}Misalignment = {{.array = {{{rows}}}}};",
            f"static const FusionVector {name}Sensitivity = {{.array = {_braced(sensitivity)}}};",
            f"static const FusionVector {name}Offset = {{.array = {_braced(model.bias / size)}}};",
        ]
    text = "\n".join(["/*", *(f" * {line}" for line in (*comments, *losses)), " */", *lines, ""])
    return Exported(content=text.encode(), losses=tuple(losses))


def autoware(calibration: Calibration) -> Exported:
    """imu_corrector.param.yaml of a calibration."""
    known = triads(calibration, "autoware", needed=("gyro",))
    losses = [gyro_matrix_lost(known["gyro"])]
    losses += ["everything of the accelerometers: the node takes them as they are"] if "accel" in known else []
    losses += [*not_held(calibration), NO_UNCERTAINTY]
    bias = known["gyro"].bias
    comments = [*origin(calibration), "corrected = raw - offset, rad/s, in the frame of the IMU", *losses]
    offsets = [f"    angular_velocity_offset_{axis}: {yaml_number(b)}" for axis, b in zip("xyz", bias, strict=True)]
    return commented(comments, ["/**:", "  ros__parameters:", *offsets], losses)


def _braced(values: Array) -> str:
    """Numbers as an initialiser, in single precision."""
    return "{" + ", ".join(f"{np.float32(value)!s}f" for value in values) + "}"
