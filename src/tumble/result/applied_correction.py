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

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tumble.result.accepted import accepted_kinds
from tumble.result.linear_fit import errors_left, linear_model
from tumble.result.record import CalibrationData
from tumble.result.temperature_curves import changing
from tumble.sensors.compensation import FIXED_POINT_STEPS, Compensator
from tumble.sensors.instrument import is_linear
from tumble.sensors.model import UNITS, SensorKind, SensorModel
from tumble.sensors.parameters import FORCE, OWN_CUBE, OWN_SIZE, PRODUCTS
from tumble.units import Array

_SYMBOLS: dict[SensorKind, str] = {"accel": "f", "gyro": "w"}
"""The symbol of the vector of each kind."""
_EXAMPLES = {"accel": (0.5, -1.0, 9.7), "gyro": (0.1, -0.2, 0.3), "mag": (0.4, -0.2, 0.3)}
"""True vectors near which the examples are, SI or in the unit of the field."""
_TERMS = {
    "quadratic": "quadratic · ({0}x², {0}x {0}y, {0}x {0}z, {0}y², {0}y {0}z, {0}z²)",
    "cubic": "cubic s³",
    "asymmetry": "asymmetry |s|",
    "by_force": "by_force · f",
}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Example:
    """A reading (n,), the true vector (3,) that it is corrected to, and the specific force (3,) in which gyros read it,
    all SI."""

    reading: Array
    true: Array
    force: Array


def linear_example(kind: str, model: SensorModel) -> Example:
    """A reading of six decimals, and what matrix and bias alone make of it."""
    reading = np.round(model.predict(np.array(_EXAMPLES[kind])), 6)
    return Example(reading=reading, true=model.apply(reading), force=np.zeros(3))


def examples(compensator: Compensator, kinds: Sequence[SensorKind], warmer: float = 0.0) -> dict[SensorKind, Example]:
    """Readings of six decimals of these kinds of sensors, and what the whole correction makes of them.

    Parameters
    ----------
    compensator
        The correction.
    kinds
        "accel" before "gyro", whose example is in the force of that of the accelerometers, or in none without them.
    warmer
        Temperature of the sensors above their references, K.
    """
    out, force = dict[SensorKind, Example](), np.zeros((1, 3))
    for kind in kinds:
        reading, celsius = linear_example(kind, compensator.model(kind)).reading, compensator.reference(kind) + warmer
        if kind == "accel":
            true = force = compensator.force(reading[None], celsius)
        else:
            true = compensator.rate(reading[None], force, celsius)
        out[kind] = Example(reading=reading, true=true[0], force=force[0])
    return out


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


def over_temperature(compensator: Compensator, kind: SensorKind) -> dict[str, Array]:
    """What changes with temperature of the sensors of a kind, by name, a number a sensor."""
    bias, scale = (compensator.changes(kind, what) for what in ("bias", "scale"))
    scale = scale / np.linalg.norm(compensator.model(kind).matrix, axis=1)[:, None]
    tables = {
        "reference": compensator.reference(kind),
        "bias_slope": bias[:, 0],
        "bias_curve": bias[:, 1],
        "scale_slope": scale[:, 0],
        "scale_curve": scale[:, 1],
    }
    return tables | ({"bias_cube": bias[:, 2]} if np.any(bias[:, 2]) else {})


def correction_content(calibration: CalibrationData) -> dict[str, Any]:
    """The correction of the accepted sensors of a calibration, by kind, for its file: `formula` with its numbers, an
    `example`, and where the formula is not linear the `linear` one that fits it best, with the errors it leaves."""
    out, kinds = dict[str, Any](), accepted_kinds(calibration)
    if not kinds:
        return out
    compensator = calibration.compensator
    for kind, worked in examples(compensator, kinds).items():
        symbol = _SYMBOLS[kind]
        model = compensator.model(kind)
        tables = {"bias": model.bias, "inverse": model.inverse()} | beyond_linear(compensator, kind)
        terms = [words.format(symbol) for name, words in _TERMS.items() if np.any(tables.get(name, 0.0))]
        tables = {name: table for name, table in tables.items() if name in ("bias", "axis") or np.any(table)}
        formula = f"{symbol} = inverse · (y − bias{' − terms' if terms else ''})"
        if terms:
            formula += f", {FIXED_POINT_STEPS + 1} times from terms = 0, terms = {' + '.join(terms)}"
            formula += ", s = axis · " + symbol if {"cubic", "asymmetry"} & tables.keys() else ""
        if changing(calibration) and compensator.warm:
            tables |= over_temperature(compensator, kind)
            curve = "(bias_curve + d bias_cube)" if "bias_cube" in tables else "bias_curve"
            formula += (
                f"; at d = T − reference, °C: bias + d (bias_slope + d {curve}), and what stands in the brackets is "
                "divided by 1 + d (scale_slope + d scale_curve)"
            )
        content = {"formula": formula, "unit": UNITS[kind]} | {name: table.tolist() for name, table in tables.items()}
        example = {"y": worked.reading.tolist(), symbol: worked.true.tolist()}
        if "by_force" in tables:
            example["f"] = worked.force.tolist()
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
