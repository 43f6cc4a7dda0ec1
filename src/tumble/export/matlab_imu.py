"""MATLAB: the JSON from which `loadparams` takes the parameters of an `imuSensor`, to simulate this device.

    reading = 1/100 AxesMisalignment true + ConstantBias

so AxesMisalignment = 100 M, 3 × 3, and of the gyros ConstantBias = b. The accelerometer of imuSensor reads gravity
less acceleration, −f: at rest with Z down +9.81. What it gives, with the other sign, is to be what the device reads,
M f + b; so its ConstantBias is −b. Temperatures of the simulation and noise are left as they are.

Source: MathWorks, documentation of accelparams, gyroparams and imuSensor, and of its loadparams.
"""

from __future__ import annotations

import json
import re
from typing import Any

from tumble.calibration.calibration_file import Calibration
from tumble.export.exported import NO_UNCERTAINTY, Exported, example, origin, shown, triads
from tumble.export.larger_model import not_held
from tumble.sensors.model import SensorModel

SIGN = "imuSensor's accelerometer has the opposite sign of the device: negate what it gives"
NO_NOISE = "noise is not in this file: set NoiseDensity, BiasInstability and RandomWalk from `tumble noise`"


def matlab_imu(calibration: Calibration) -> Exported:
    """The JSON file of a calibration; the part has the serial number for its name."""
    known = triads(calibration, "matlab-imu", needed=())
    losses = (*([SIGN] if "accel" in known else []), NO_NOISE, *not_held(calibration), NO_UNCERTAINTY)
    content = {
        "comment": "; ".join([*origin(calibration), *_examples(known), *losses]),
        part_name(calibration.serial): {
            name: _parameters(known[kind], sign)
            for name, kind, sign in (("Accelerometer", "accel", -1.0), ("Gyroscope", "gyro", 1.0))
            if kind in known
        },
    }
    return Exported(content=(json.dumps(content, indent=1, allow_nan=False) + "\n").encode(), losses=losses)


def part_name(serial: str) -> str:
    """A serial number as a name that MATLAB takes: letters, digits and underscores, a letter first."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", serial)
    return name if name[:1].isalpha() else f"imu_{name}"


def _parameters(model: SensorModel, sign: float) -> dict[str, Any]:
    return {"ConstantBias": (sign * model.bias).tolist(), "AxesMisalignment": (100.0 * model.matrix).tolist()}


def _examples(known: dict[str, SensorModel]) -> list[str]:
    worked = {kind: example(kind, model) for kind, model in known.items()}
    return [f"example {kind}: {shown(one.true.round(9))} reads {shown(one.reading)}" for kind, one in worked.items()]
