"""DepthAI (Luxonis OAK cameras): the JSON of an `ImuCalibrationParams`.

    corrected = A raw + b,    accelerometer and gyroscope = [A | b], 3 × 4, single precision

so A = M⁻¹ and b = −M⁻¹ bias; m/s² and rad/s. `noise` has a name alone: its numbers, whose units DepthAI does not state,
are those of a new object, zero.

Source: depthai-core, ImuParameters.hpp (members, and [1 | 0] where nothing is known) and CalibrationHandler.
"""

from __future__ import annotations

import json

import numpy as np

from tumble.calibration.calibration_file import Calibration
from tumble.calibration.half import WORDS
from tumble.export.exported import (
    NO_UNCERTAINTY,
    SINGLE_PRECISION,
    Exported,
    example,
    one_line,
    origin,
    shown,
    triads,
)
from tumble.export.larger_model import not_held
from tumble.sensors.model import SensorModel

UNKNOWN = SensorModel(matrix=np.eye(3), bias=np.zeros(3))
"""What DepthAI keeps where nothing is known."""
NO_NOISE = "noise densities are left at zero: set `noise` from `tumble noise`"


def depthai(calibration: Calibration) -> Exported:
    """The JSON file of a calibration."""
    known = triads(calibration, "depthai", needed=())
    unknown = [f"{words}: not known, [1 | 0] in this file" for kind, words in WORDS.items() if kind not in known]
    losses = (*unknown, NO_NOISE, *not_held(calibration), SINGLE_PRECISION, NO_UNCERTAINTY)
    nothing = {"noiseDensity": 0.0, "randomWalk": 0.0, "biasStability": 0.0}
    axes = dict.fromkeys("xyz", nothing)
    content = {
        "comment": "; ".join([*origin(calibration), *_examples(known), *losses]),
        "noise": {"name": one_line(calibration.model or ""), "accelerometer": axes, "gyroscope": axes},
        "accelerometer": _affine(known.get("accel", UNKNOWN)),
        "gyroscope": _affine(known.get("gyro", UNKNOWN)),
    }
    return Exported(content=(json.dumps(content, indent=1, allow_nan=False) + "\n").encode(), losses=losses)


def _affine(model: SensorModel) -> list[list[float]]:
    """[A | b] (3, 4), in single precision."""
    inverse = model.inverse()
    both = np.column_stack([inverse, -inverse @ model.bias])
    return [[float(f"{np.float32(number):.9g}") for number in row] for row in both]


def _examples(known: dict[str, SensorModel]) -> list[str]:
    worked = {kind: example(kind, model) for kind, model in known.items()}
    return [f"example {kind}: {shown(one.reading)} is {shown(one.true.round(9))}" for kind, one in worked.items()]
