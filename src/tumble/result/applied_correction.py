"""The correction of a calibration as any program can apply it: its numbers, a formula, and a worked example.

Of the sensors j of a kind, with readings y (n,), SI, x the specific force or the rate in the frame of the calibration,
a_j the nominal axis of a sensor and s_j = a_j · x,

    x = inverse · (y − bias − terms(x))                                                                          (1)
    terms_j = quadratic_j · (x₁², x₁x₂, x₁x₃, x₂², x₂x₃, x₃²) + cubic_j s_j³ + asymmetry_j |s_j| + by_force_j · f

from x = inverse · (y − bias), repeated. At d = T − reference, °C, the bias is greater by
d (bias_slope + d (bias_curve + d bias_cube)), the cube where it is not zero, and what stands in the brackets is divided
by 1 + d (scale_slope + d scale_curve), sensor by sensor. Lever arms and delays need the motion and are not in it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tumble.result.accepted import accepted_kinds
from tumble.result.calibration import Calibration
from tumble.result.linear_fit import errors_left, linear_model
from tumble.result.temperature_curves import changing, coefficients, references
from tumble.sensors.compensation import FIXED_POINT_STEPS, Compensator
from tumble.sensors.instrument import is_linear
from tumble.sensors.model import SensorKind, SensorModel
from tumble.sensors.parameters import FORCE, OWN_CUBE, OWN_SIZE, PRODUCTS
from tumble.units import Array

_SYMBOLS: dict[SensorKind, tuple[str, str, tuple[float, ...]]] = {
    "accel": ("f", "m/s^2", (0.5, -1.0, 9.7)),
    "gyro": ("w", "rad/s", (0.1, -0.2, 0.3)),
}
"""Of each kind the symbol of its vector, its unit, and the vector near which the example is."""
_TERMS = {
    "quadratic": "quadratic · ({0}x², {0}x {0}y, {0}x {0}z, {0}y², {0}y {0}z, {0}z²)",
    "cubic": "cubic s³",
    "asymmetry": "asymmetry |s|",
    "by_force": "by_force · f",
}


def beyond_linear(compensator: Compensator, kind: SensorKind) -> dict[str, Array]:
    """The terms of Eq. (1) of the sensors of a kind by name, a row a sensor; none of a linear model, and "by_force" of
    gyros that feel the specific force."""
    block, K = compensator.sensors(kind)
    if block is None or is_linear(block, K):
        return {}
    tables = {"axis": block.axes, "asymmetry": K[:, OWN_SIZE], "cubic": K[:, OWN_CUBE]}
    if kind == "accel":
        return tables | {"quadratic": K[:, PRODUCTS]}
    return tables | ({"by_force": K[:, FORCE]} if np.any(K[:, FORCE]) else {})


def over_temperature(calibration: Calibration, kind: SensorKind, model: SensorModel) -> dict[str, Array]:
    """What changes with temperature of the sensors of a kind, by name, a number a sensor."""
    bias, scale = (coefficients(calibration, kind, what) for what in ("bias", "scale"))
    scale = scale / np.linalg.norm(model.matrix, axis=1)[:, None]
    tables = {
        "reference": references(calibration, kind),
        "bias_slope": bias[:, 0],
        "bias_curve": bias[:, 1],
        "scale_slope": scale[:, 0],
        "scale_curve": scale[:, 1],
    }
    return tables | ({"bias_cube": bias[:, 2]} if np.any(bias[:, 2]) else {})


def correction_content(calibration: Calibration) -> dict[str, Any]:
    """The correction of the accepted sensors of a calibration, by kind, for its file: `formula` with its numbers, an
    `example`, and where the formula is not linear the `linear` one that fits it best, with the errors it leaves."""
    out: dict[str, Any] = {}
    felt, compensator = np.zeros((1, 3)), calibration.compensator if accepted_kinds(calibration) else None
    for kind in accepted_kinds(calibration):
        assert compensator is not None
        symbol, unit, near = _SYMBOLS[kind]
        model = compensator.model(kind)
        tables = {"bias": model.bias, "inverse": model.inverse()} | beyond_linear(compensator, kind)
        terms = [words.format(symbol) for name, words in _TERMS.items() if np.any(tables.get(name, 0.0))]
        tables = {name: table for name, table in tables.items() if name in ("bias", "axis") or np.any(table)}
        formula = f"{symbol} = inverse · (y − bias{' − terms' if terms else ''})"
        if terms:
            formula += f", {FIXED_POINT_STEPS + 1} times from terms = 0, terms = {' + '.join(terms)}"
            formula += ", s = axis · " + symbol if {"cubic", "asymmetry"} & tables.keys() else ""
        if changing(calibration) and compensator.warm:
            tables |= over_temperature(calibration, kind, model)
            curve = "(bias_curve + d bias_cube)" if "bias_cube" in tables else "bias_curve"
            formula += (
                f"; at d = T − reference, °C: bias + d (bias_slope + d {curve}), and what stands in the brackets is "
                "divided by 1 + d (scale_slope + d scale_curve)"
            )
        reading = model.predict(np.array(near)).round(6)[None]
        true = compensator.force(reading) if kind == "accel" else compensator.rate(reading, felt)
        content = {"formula": formula, "unit": unit} | {name: table.tolist() for name, table in tables.items()}
        example = {"y": reading[0].tolist(), symbol: true[0].tolist()}
        if "by_force" in tables:
            example["f"] = felt[0].tolist()
        felt = true if kind == "accel" else felt
        out[kind] = content | {"example": example}
        if terms:
            best = linear_model(calibration, kind)
            off = errors_left(calibration, kind, best.apply)
            out[kind]["linear"] = {
                "formula": f"{symbol} = inverse · (y − bias)",
                "inverse": best.inverse().tolist(),
                "bias": best.bias.tolist(),
                "off_by": {"rms": float(np.sqrt(np.mean(off**2))), "most": float(off.max())},
            }
    return out
