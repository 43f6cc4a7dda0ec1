"""Targets that read JSON.

imucal (MaD Lab, FAU Erlangen), a FerrarisCalibrationInfo of format 2.0.0:

    acc = R_a⁻¹ K_a⁻¹ (acc_m − b_a)
    gyr = R_g⁻¹ K_g⁻¹ (gyr_m − K_ga acc − b_g)

so with M = K R, K the diagonal of the sensitivities along the sensors' axes and R the axes themselves as unit rows,
nothing of either matrix is lost. Units m/s² and, as is imucal's custom, deg/s, before and after.

DepthAI (Luxonis OAK cameras), an `ImuCalibrationParams`:

    corrected = A raw + b,    accelerometer and gyroscope = [A | b], 3 × 4, single precision

so A = M⁻¹ and b = −M⁻¹ bias; m/s² and rad/s. `noise` has a name alone: its numbers, whose units DepthAI does not state,
are those of a new object, zero.

RealSense, the table of Intel's rs-imu-calibration, rows from left to right:

    corrected = scale_and_alignmentᵀ raw − bias

so scale_and_alignment = M⁻ᵀ and bias = M⁻¹ b; m/s² and rad/s. The program itself leaves the gyros' matrix at 1.

MATLAB, from which `loadparams` takes the parameters of an `imuSensor`, to simulate this device:

    reading = 1/100 AxesMisalignment true + ConstantBias

so AxesMisalignment = 100 M, 3 × 3, and of the gyros ConstantBias = b. The accelerometer of imuSensor reads gravity
less acceleration, −f: at rest with Z down +9.81. What it gives, with the other sign, is to be what the device reads,
M f + b; so its ConstantBias is −b. Temperatures of the simulation and noise are left as they are.

Source: imucal, documentation of FerrarisCalibrationInfo; depthai-core, ImuParameters.hpp (members, and [1 | 0] where
nothing is known) and CalibrationHandler; librealsense, tools/rs-imu-calibration/rs-imu-calibration.py (check_X, and the
JSON that it writes); MathWorks, documentation of accelparams, gyroparams, imuSensor and loadparams.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from tumble.export.exported import (
    SINGLE_PRECISION,
    Exported,
    examples,
    g_sensitivity,
    losses_of,
    one_line,
    origin,
    still,
    triads,
)
from tumble.result.accepted import WORDS
from tumble.result.calibration import Calibration
from tumble.sensors.model import SensorKind, SensorModel
from tumble.units import DEGREE

NAMES: Mapping[SensorKind, str] = {"accel": "accelerometer", "gyro": "gyroscope"}
UNKNOWN = SensorModel(matrix=np.eye(3), bias=np.zeros(3))
"""What DepthAI and RealSense have where nothing is known."""


def imucal(calibration: Calibration) -> Exported:
    """The JSON file of a calibration for imucal."""
    known = triads(calibration, "imucal")
    accel, gyro = known["accel"], known["gyro"]
    K_a, K_g = (np.linalg.norm(model.matrix, axis=1) for model in (accel, gyro))
    sensitivity = g_sensitivity(calibration)
    losses = losses_of(calibration, held={"gyro.g_sensitivity"})
    worked = [
        *examples({"accel": accel}, "example {kind}: {reading} is {true} {unit}"),
        *examples({"gyro": gyro}, "example {kind}: {reading} is {true} deg/s", {"gyro": DEGREE}),
    ]
    content = {
        "acc_unit": "m/s^2",
        "gyr_unit": "deg/s",
        "from_acc_unit": "m/s^2",
        "from_gyr_unit": "deg/s",
        "comment": "; ".join([*origin(calibration), *worked, *still(sensitivity), *losses]),
        "K_a": np.diag(K_a).tolist(),
        "R_a": (accel.matrix / K_a[:, None]).tolist(),
        "b_a": accel.bias.tolist(),
        "K_g": np.diag(K_g).tolist(),
        "R_g": (gyro.matrix / K_g[:, None]).tolist(),
        "K_ga": (sensitivity / DEGREE).tolist(),
        "b_g": (gyro.bias / DEGREE).tolist(),
        "cal_type": "Ferraris",
        "_format_version": "2.0.0",
    }
    return _written(content, losses, indent=4)


def depthai(calibration: Calibration) -> Exported:
    """The JSON file of a calibration for DepthAI."""
    known = triads(calibration, "depthai", needed=())
    unknown = [f"{words}: not known, [1 | 0] in this file" for kind, words in WORDS.items() if kind not in known]
    noise = "noise densities are left at zero: set `noise` from `tumble noise`"
    losses = losses_of(calibration, *unknown, noise, precision=SINGLE_PRECISION)
    axes = {axis: {"noiseDensity": 0.0, "randomWalk": 0.0, "biasStability": 0.0} for axis in "xyz"}
    content: dict[str, Any] = {
        "comment": "; ".join([*origin(calibration), *examples(known), *losses]),
        "noise": {"name": one_line(calibration.model or ""), "accelerometer": axes, "gyroscope": axes},
    }
    for kind, name in NAMES.items():  # [A | b] (3, 4), in single precision
        model = known.get(kind, UNKNOWN)
        both = np.column_stack([model.inverse(), -model.inverse() @ model.bias])
        content[name] = [[float(f"{np.float32(number):.9g}") for number in row] for row in both]
    return _written(content, losses, indent=1)


def realsense(calibration: Calibration) -> Exported:
    """The JSON file of a calibration as rs-imu-calibration writes it."""
    known = triads(calibration, "realsense", needed=())
    unknown = [f"{words}: not known, 1 and 0 in this file" for kind, words in WORDS.items() if kind not in known]
    losses = losses_of(calibration, *unknown, precision=SINGLE_PRECISION)
    imu: dict[str, Any] = {}
    for kind, name in NAMES.items():
        A = (model := known.get(kind, UNKNOWN)).inverse()
        imu[name] = {"scale_and_alignment": A.T.ravel().tolist(), "bias": (A @ model.bias).tolist()}
    comment = "; ".join([*origin(calibration), *examples(known), *losses])
    content = {"comment": comment, "device_type": one_line(calibration.model or "D435i"), "imus": [imu]}
    return _written(content, losses, indent=4)


def matlab_imu(calibration: Calibration) -> Exported:
    """The JSON file of a calibration for MATLAB; the part has the serial number for its name."""
    known = triads(calibration, "matlab-imu", needed=())
    sign = ["imuSensor's accelerometer has the opposite sign of the device: negate what it gives"] * ("accel" in known)
    noise = "noise is not in this file: set NoiseDensity, BiasInstability and RandomWalk from `tumble noise`"
    losses = losses_of(calibration, *sign, noise)
    parts = {}
    for kind, model in known.items():
        bias = -model.bias if kind == "accel" else model.bias
        misaligned = (100.0 * model.matrix).tolist()
        parts[NAMES[kind].capitalize()] = {"ConstantBias": bias.tolist(), "AxesMisalignment": misaligned}
    worked = examples(known, "example {kind}: {true} reads {reading}")
    content = {"comment": "; ".join([*origin(calibration), *worked, *losses]), part_name(calibration.serial): parts}
    return _written(content, losses, indent=1)


def part_name(serial: str) -> str:
    """A serial number as a name that MATLAB takes: letters, digits and underscores, a letter first."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", serial)
    return name if name[:1].isalpha() else f"imu_{name}"


def _written(content: Mapping[str, Any], losses: Iterable[str], *, indent: int) -> Exported:
    text = json.dumps(content, indent=indent, allow_nan=False)
    return Exported(content=f"{text}\n".encode(), losses=tuple(losses))
