"""Tables for spreadsheets and scripts, and a file for MATLAB (version 5) and GNU Octave.

`json` holds the correction with its formula (`tumble.result.correction`).

`csv` has one quantity per row: name, value, u, unit, and for a parameter its prior, learned fraction, k, degrees of
freedom, and its covariances, each in the column named after the other parameter. `accel.matrix.2.1` is row 2, column 1
of M, `accel.bias_of.2` the bias of channel 2, both counted from 1:

    reading = matrix · true + bias

`csv-thermal` has one temperature per row, within the measured range: the temperature in °C, then the value of each
parameter that changes with it and its U (95.45 %), SI.

`mat` has the content of `csv` as arrays:

    true = accel_matrix \\ (reading - accel_bias)    columns: one sample each; least squares for more than three sensors
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Sequence

import numpy as np

from tumble.export.autopilots import example_temperature, temperature_range
from tumble.export.exported import Exported, example_line, in_units, models, notes_of, origin, table_notes
from tumble.result.calibration import Calibration
from tumble.result.correction import linear_example
from tumble.result.file import content_of
from tumble.result.temperature_curves import temperature_curve, thermal_parameters, thermometer_notes
from tumble.sensors.model import UNITS
from tumble.sensors.parameters import THERMAL, group_name, groups, variable_of

NOT_RESULTS = "not in this file: rests, turns, launches and iterations of the calibration"
_FURTHER = ("prior", "learned", "k", "dof")
_STEPS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)  # K
_MAX_ROWS = 25


def json_file(calibration: Calibration) -> Exported:
    """Return the .json file of a calibration: its readings, and the correction with its formula."""
    models(calibration)  # raises InputError if there are none
    content, held = content_of(calibration), {group.name for group in groups() if group.variable in THERMAL}
    losses = notes_of(calibration, held=held)
    about = ["y: readings in SI, (raw - offset) / scale of the columns in readings", *origin(calibration), *losses]
    kept = {key: content[key] for key in ("frame", "readings", "temperature", "correction", "provenance")}
    text = json.dumps({"about": about} | kept, indent=1, ensure_ascii=False)
    return Exported(content=f"{text}\n".encode(), losses=losses)


def csv_table(calibration: Calibration) -> Exported:
    """Return the .csv file of a calibration."""
    losses = (NOT_RESULTS, *table_notes(calibration))
    names = [p.name for p in calibration.parameters]
    rows = [["name", "value", "u", "unit", *_FURTHER, *names]]
    empty = [""] * (len(_FURTHER) + len(names))
    for i, p in enumerate(calibration.parameters):
        further = ["" if (value := getattr(p, name)) is None else repr(value) for name in _FURTHER]
        row = [""] * len(names) if calibration.covariance is None else map(repr, calibration.covariance[i].tolist())
        rows.append([p.name, repr(p.value), "" if p.u is None else repr(p.u), p.unit, *further, *row])
    for kind, model in models(calibration).items():
        worked, matrix = linear_example(kind, model), enumerate(model.matrix.tolist(), 1)
        entries = [(f"matrix.{p}.{q}", value, "1") for p, row in matrix for q, value in enumerate(row, 1)]
        vectors = {"bias_of": model.bias, "example.reading": worked.reading, "example.true": worked.true}
        for name, vector in vectors.items():
            entries += [(f"{name}.{p}", value, UNITS[kind]) for p, value in enumerate(vector.tolist(), 1)]
        rows += [[f"{kind}.{name}", repr(value), "", unit, *empty] for name, value, unit in entries]
    return _csv_file((*origin(calibration), "reading = matrix * true + bias, SI", *losses), rows, losses)


def _csv_file(comments: Iterable[str], rows: Iterable[Sequence[str]], losses: tuple[str, ...]) -> Exported:
    buffer = io.StringIO()
    buffer.writelines(f"# {comment}\n" for comment in comments)
    csv.writer(buffer, lineterminator="\n").writerows(rows)
    return Exported(content=buffer.getvalue().encode(), losses=losses)


def csv_thermal(calibration: Calibration) -> Exported:
    """Return the .csv file of a calibration over temperature."""
    by_kind = models(calibration)
    measured = temperature_range(calibration, "csv-thermal")
    low, high = measured
    step = next((step for step in _STEPS if (high - low) / step <= _MAX_ROWS), _STEPS[-1])
    round_ones = np.round(np.arange(math.ceil(low / step), math.floor(high / step) + 1) * step, 1)
    celsius = np.unique([low, calibration.reference_temperature or 0.0, high, *round_ones])
    curves = [temperature_curve(calibration, name, celsius) for name in thermal_parameters(calibration)]
    thermal_groups = {group_name(p.name) for p in calibration.parameters if variable_of(group_name(p.name)) in THERMAL}
    middle = 0.5 * (celsius[1:] + celsius[:-1])
    errors = dict.fromkeys(by_kind, 0.0)  # of biases by linear interpolation, in the middle between two rows
    for each in curves:
        kind = next((kind for kind in by_kind if group_name(each.name) == f"{kind}.bias"), None)
        if kind is not None:
            interpolated = 0.5 * (each.value[1:] + each.value[:-1])
            error = np.abs(interpolated - temperature_curve(calibration, each.name, middle).value).max()
            errors[kind] = max(errors[kind], float(error))
    within = " and ".join(in_units(kind, error) for kind, error in errors.items())
    losses = notes_of(
        calibration,
        remarks=[f"biases on straight lines between the rows are within {within}"],
        held={group_name(each.name) for each in curves} | thermal_groups,
        lacks=["parameters that do not change with temperature", "covariances"],
    )
    warm = example_temperature(measured)
    at_warm = {kind: linear_example(kind, calibration.compensator.model(kind, warm)) for kind in by_kind}
    comments = [
        *origin(calibration),
        f"reference temperature {calibration.reference_temperature:g} degC; measured from {low:.1f} to "
        f"{high:.1f} degC, nothing is known outside",
        *thermometer_notes(calibration),
        *(example_line(kind, worked, where=f" at {warm!r} degC") for kind, worked in at_warm.items()),
        *losses,
    ]
    rows = [["temperature_degC", *(title for each in curves for title in (each.name, f"U({each.name})"))]]
    for i, temperature in enumerate(celsius.tolist()):
        row = [f"{temperature:.9g}"]
        for each in curves:
            row += [f"{each.value[i]:.9g}", "" if each.expanded is None else f"{each.expanded[i]:.4g}"]
        rows.append(row)
    return _csv_file(comments, rows, losses)


def mat(calibration: Calibration) -> Exported:
    """Return the .mat file of a calibration."""
    from scipy.io import savemat

    parameters = calibration.parameters
    losses = (NOT_RESULTS, *table_notes(calibration))
    numeric = {
        f"parameter_{name}": np.array([np.nan if (value := getattr(p, name)) is None else value for p in parameters])
        for name in ("value", *_FURTHER, "u")
    }
    content = {
        "serial": calibration.serial,
        "frame": calibration.frame,
        "about": "\n".join([*origin(calibration), "true = accel_matrix \\ (reading - accel_bias), SI", *losses]),
        "parameter_name": np.array([p.name for p in parameters], dtype=object),
        "parameter_unit": np.array([p.unit for p in parameters], dtype=object),
        **numeric,
        "covariance": np.empty((0, 0)) if calibration.covariance is None else calibration.covariance,
    }
    for kind, model in models(calibration).items():
        worked = linear_example(kind, model)
        content[f"{kind}_matrix"], content[f"{kind}_bias"] = model.matrix, model.bias
        content[f"{kind}_example_reading"], content[f"{kind}_example_true"] = worked.reading, worked.true
    buffer = io.BytesIO()
    savemat(buffer, content, oned_as="column")  # type: ignore[arg-type]  # the stubs know file names only
    return Exported(content=buffer.getvalue(), losses=losses)
