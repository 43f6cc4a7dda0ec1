"""A C header (C99, C++): bias and inverse matrix as constants, and functions that apply them, in double and float.

    out = inverse · (reading − bias)        inverse = M⁻¹, or the pseudo-inverse for more than three sensors

The sum runs from the first sensor to the last. If the calibration has quadratic, cubic or asymmetric terms or a
g-sensitivity of the gyros, the functions remove them by the fixed-point steps of `tumble.sensors.compensation`:

    out ← inverse · (reading − bias − nonlinear terms in out)

If parameters change with temperature, there are also functions of a temperature: with d = T − T₀ in °C

    out = inverse · ((reading − bias − d (b₁ + d (b₂ + d b₃))) / (1 + d (s₁ + d s₂)))

sensor by sensor. If sensors lag behind the thermometer by λ, a function for each kind follows their temperature from
reading to reading, exact where the temperature is linear between two (`tumble.reduction.rests.thermometer`): over h
seconds, with g = 1 − e^(−h/λ),

    y₁ = y₀ + g (T₀ − y₀) + (T₁ − T₀) (1 − g λ/h)

The header needs no library.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from tumble.export.exported import Exported, example_line, models, notes_of, origin, shown
from tumble.export.templates import render_layout
from tumble.reduction.rests.thermometer import followed
from tumble.result.calibration import Calibration
from tumble.result.correction import BY_FORCE, examples, nonlinear_tables, thermal_tables
from tumble.result.temperature_curves import measured_range, thermal_parameters, thermometer_notes
from tumble.sensors.compensation import FIXED_POINT_STEPS, Compensator
from tumble.sensors.model import UNITS, SensorKind, SensorModel
from tumble.sensors.parameters import OVER_TEMPERATURE
from tumble.units import Array

LAG_EXAMPLE = ((20.0, 0.0), (21.0, 10.0), (23.0, 10.0), (23.0, 60.0))
"""Readings of a thermometer, degC, and the seconds since the previous reading."""

HELD_OVER_TEMPERATURE = frozenset(
    f"{kind}.{what}.{t}" for kind in UNITS for what in ("bias", "scale") for t in OVER_TEMPERATURE
)
"""Groups that the functions of a temperature apply."""

TRUE_QUANTITY: Mapping[SensorKind, str] = {"accel": "true specific force", "gyro": "true angular rate"}


def c_header(calibration: Calibration) -> Exported:
    """Return the header of a calibration."""
    by_kind, compensator = models(calibration), calibration.compensator
    thermal = bool(thermal_parameters(calibration)) and calibration.reference_temperature is not None
    lags = {kind: lag for kind, lag in compensator.lags.items() if thermal and lag != 0.0 and kind in by_kind}
    held = (HELD_OVER_TEMPERATURE if thermal else frozenset()) | {f"{kind}.lag" for kind in lags}
    losses = notes_of(calibration, held=held)
    comments = origin(calibration)
    for kind, worked in examples(compensator, list(by_kind)).items():
        force = " in that specific force" if "accel" in by_kind else " without a specific force"
        where = force if BY_FORCE.keys() & nonlinear_tables(compensator, kind).keys() else ""
        comments.append(example_line(kind, worked, where=where))
    if thermal:
        measured = measured_range(calibration)
        span = "" if measured is None else f", measured from {measured[0]:.1f} to {measured[1]:.1f}"
        comments.append(
            f"functions without a temperature are for {calibration.reference_temperature:g} degC; those in _at take "
            f"it, in degC{span}"
        )
        comments += thermometer_notes(calibration)
    readings = "; ".join(f"{celsius:g} after {seconds:g} s" for celsius, seconds in LAG_EXAMPLE)
    for kind, lag in lags.items():
        comments += [
            f"{kind} lags behind the thermometer by {lag:.6g} s: give imu_correct_{kind}_at what imu_{kind}_celsius "
            "makes of every reading, with a state for each thermometer",
            f"example {kind} lag: the thermometer reads {readings}; the sensors have "
            f"{shown(_lagged_example(lag).round(9))}",
        ]
    functions = [
        _function(compensator, kind, model, single=single, at=at)
        for kind, model in by_kind.items()
        for single in (False, True)
        for at in ([None, calibration] if thermal else [None])
    ]
    text = render_layout("imu_calibration.h.j2", comments=[*comments, *losses], lags=lags, functions=functions)
    return Exported(content=text.encode(), losses=losses)


def _lagged_example(lag: float) -> Array:
    """Return the temperatures, °C, of sensors with a lag, for the readings of LAG_EXAMPLE."""
    out = [LAG_EXAMPLE[0][0]]
    for (before, _), (now, seconds) in pairwise(LAG_EXAMPLE):
        out.append(float(followed(np.array([before, now]), seconds, abs(lag), first=out[-1])[1]))
    celsius = np.array([each for each, _ in LAG_EXAMPLE])
    return np.array(out) if lag > 0.0 else 2.0 * celsius - np.array(out)


def _constant(number: str, name: str, values: Array) -> str:
    """Return a constant array of C, double or float, whose numbers read back exactly."""

    def row(each: Array) -> str:
        texts = map(repr, each.tolist()) if number == "double" else (f"{v!s}f" for v in each.astype(np.float32))
        return ", ".join(texts)

    sizes = "".join(f"[{size}]" for size in values.shape)
    rows = ",\n".join(f"        {{{row(each)}}}" for each in np.atleast_2d(values))
    text = f"\n{rows}\n    " if values.ndim > 1 else row(values)
    return f"    static const {number} {name}{sizes} = {{{text}}};\n"


def _function(
    compensator: Compensator, kind: SensorKind, model: SensorModel, *, single: bool, at: Calibration | None
) -> dict[str, Any]:
    """Return the names in the layout of a function for one kind of sensor, in double or single precision; with the
    temperature of the sensors, if `at` is a calibration."""
    number, n, beyond = "float" if single else "double", len(model.bias), nonlinear_tables(compensator, kind)
    tables = {"bias": model.bias, "inverse": model.inverse()} | beyond
    several, reference = False, ""
    needs = " and the true specific force, m/s^2" if BY_FORCE.keys() & beyond.keys() else ""
    argument = f"const {number} force[3], " if BY_FORCE.keys() & beyond.keys() else ""
    if at is not None:
        several = len(set(at.temperature.thermometers.get(kind, ()))) > 1
        warm = thermal_tables(compensator, kind)
        reference = "reference[j]" if several else f"({number}){float(warm['reference'][0])!r}"
        tables |= {name: table for name, table in warm.items() if several or name != "reference"}
        needs += " and their temperatures, degC" if several else " and a temperature, degC"
        argument += f"const {number} celsius[{n}], " if several else f"{number} celsius, "
    return {
        "what": TRUE_QUANTITY[kind],
        "unit": UNITS[kind],
        "n": n,
        "kind": kind,
        "type": number,
        "suffix": "f" if single else "",
        "needs": needs,
        "argument": argument,
        "constants": "".join(_constant(number, name, values) for name, values in tables.items()),
        "warm": at is not None,
        "cube": "bias_cube" in tables,
        "apart": several,
        "reference": reference,
        "linear": not beyond,
        "by_force": "by_force" in beyond,
        "by_products": "by_products" in beyond,
        "steps": FIXED_POINT_STEPS,
    }
