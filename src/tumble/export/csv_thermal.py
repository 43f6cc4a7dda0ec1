"""A CSV table of parameters over temperature: one temperature a row, within the measured range.

Columns: the temperature in °C, then the value of each parameter that changes with it and U (95.45 %), in a column of
that name, SI. The values of the others, and what parameters are, are in `csv`.
"""

from __future__ import annotations

import csv
import io
import math

import numpy as np

from tumble.calibration.calibration_file import Calibration
from tumble.calibration.temperature_curves import Curve, Range, changing, curve, model_at, own_thermometers
from tumble.export.exported import Exported, example, models, numbers, origin, shown
from tumble.export.larger_model import not_held
from tumble.export.thermal import range_of, said, warm_end
from tumble.sensors.parameters import THERMAL, group_name, sensor_kind, variable_of
from tumble.units import Array

_STEPS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
_MOST_ROWS = 25
NO_COVARIANCE = "parameters that do not change with temperature, and covariances, have no place in this file"


def csv_thermal(calibration: Calibration) -> Exported:
    """The .csv file of a calibration over temperature."""
    known = models(calibration)
    measured = range_of(calibration, "csv-thermal")
    at = temperatures(measured, float(calibration.reference_temperature or 0.0))
    curves = [curve(calibration, name, at) for name in changing(calibration)]
    losses = (
        _between(calibration, curves, at),
        *not_held(calibration, {group_name(each.name) for each in curves} | _coefficients(calibration)),
        NO_COVARIANCE,
    )
    buffer = io.StringIO()
    head = [
        *origin(calibration),
        f"reference temperature {calibration.reference_temperature:g} degC; measured from {measured.low:.1f} to "
        f"{measured.high:.1f} degC, nothing is known outside",
        *own_thermometers(calibration),
        *(_example(calibration, kind, warm_end(measured)) for kind in known),
        *losses,
    ]
    buffer.writelines(f"# {line}\n" for line in head)
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["temperature_degC", *(title for each in curves for title in (each.name, f"U({each.name})"))])
    for i, temperature in enumerate(numbers(at)):
        writer.writerow([f"{temperature:.9g}", *(cell for each in curves for cell in _cells(each, i))])
    return Exported(content=buffer.getvalue().encode(), losses=losses)


def _coefficients(calibration: Calibration) -> set[str]:
    """The groups that the curves are made of."""
    names = {group_name(p.name) for p in calibration.parameters}
    return {name for name in names if variable_of(name) in THERMAL}


def temperatures(measured: Range, reference: float) -> Array:
    """Temperatures of the rows, °C: round ones, the reference, and both ends of the range."""
    span = measured.high - measured.low
    step = next((step for step in _STEPS if span / step <= _MOST_ROWS), _STEPS[-1])
    first, last = math.ceil(measured.low / step), math.floor(measured.high / step)
    round_ones = np.round(np.arange(first, last + 1) * step, 1)
    return np.unique(np.concatenate([[measured.low, reference, measured.high], round_ones]))


def _cells(each: Curve, i: int) -> list[str]:
    """Value and U with the digits that a spreadsheet needs."""
    return [f"{each.value[i]:.9g}", "" if each.expanded is None else f"{each.expanded[i]:.4g}"]


def _example(calibration: Calibration, kind: str, at: float) -> str:
    worked = example(kind, model_at(calibration, kind, at))
    return f"example {kind} at {at!r} degC: reading {shown(worked.reading)} is {shown(worked.true.round(9))}"


def _between(calibration: Calibration, curves: list[Curve], at: Array) -> str:
    """How far biases on straight lines between the rows are from the calibration's."""
    middle = 0.5 * (at[1:] + at[:-1])
    models_known = {"accel": calibration.accel, "gyro": calibration.gyro}
    error = {kind: 0.0 for kind, model in models_known.items() if model is not None}
    for each in curves:
        kind = sensor_kind(each.name)
        if group_name(each.name) == f"{kind}.bias":
            straight = 0.5 * (each.value[1:] + each.value[:-1])
            own = np.abs(straight - curve(calibration, each.name, middle).value).max()
            error[kind] = max(error[kind], float(own))
    return f"biases on straight lines between the rows are within {said(error)}"
