"""imucal (MaD Lab, FAU Erlangen): the JSON of a FerrarisCalibrationInfo, format 2.0.0.

    acc = R_a⁻¹ K_a⁻¹ (acc_m − b_a)
    gyr = R_g⁻¹ K_g⁻¹ (gyr_m − K_ga acc − b_g)

so with M = K R, K the diagonal of the sensitivities along the sensors' axes and R the axes themselves as unit rows,
nothing of either matrix is lost. Units m/s² and, as is imucal's custom, deg/s, before and after.

Source: imucal, documentation of FerrarisCalibrationInfo.
"""

from __future__ import annotations

import json

import numpy as np

from tumble.calibration.calibration_file import Calibration
from tumble.export.exported import NO_UNCERTAINTY, Exported, example, origin, shown, triads
from tumble.export.larger_model import g_sensitivity, not_held, still
from tumble.sensors.model import SensorModel
from tumble.units import DEGREE, Array


def imucal(calibration: Calibration) -> Exported:
    """The JSON file of a calibration."""
    known = triads(calibration, "imucal")
    accel, gyro = known["accel"], known["gyro"]
    (K_a, R_a), (K_g, R_g) = (_scale_and_axes(model) for model in (accel, gyro))
    sensitivity = g_sensitivity(calibration)
    losses = (*not_held(calibration, {"gyro.g_sensitivity"}), NO_UNCERTAINTY)
    content = {
        "acc_unit": "m/s^2",
        "gyr_unit": "deg/s",
        "from_acc_unit": "m/s^2",
        "from_gyr_unit": "deg/s",
        "comment": "; ".join([*origin(calibration), *_examples(known), *still(sensitivity), *losses]),
        "K_a": K_a.tolist(),
        "R_a": R_a.tolist(),
        "b_a": accel.bias.tolist(),
        "K_g": K_g.tolist(),
        "R_g": R_g.tolist(),
        "K_ga": (sensitivity / DEGREE).tolist(),
        "b_g": (gyro.bias / DEGREE).tolist(),
        "cal_type": "Ferraris",
        "_format_version": "2.0.0",
    }
    return Exported(content=(json.dumps(content, indent=4, allow_nan=False) + "\n").encode(), losses=losses)


def _scale_and_axes(model: SensorModel) -> tuple[Array, Array]:
    norms = np.linalg.norm(model.matrix, axis=1)
    return np.diag(norms), model.matrix / norms[:, None]


def _examples(known: dict[str, SensorModel]) -> list[str]:
    out = []
    for kind, size, unit in (("accel", 1.0, "m/s^2"), ("gyro", DEGREE, "deg/s")):
        worked = example(kind, known[kind])
        reading, true = (shown((vector / size).round(9)) for vector in (worked.reading, worked.true))
        out.append(f"example {kind}: {reading} is {true} {unit}")
    return out
