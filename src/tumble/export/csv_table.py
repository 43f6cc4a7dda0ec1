"""A CSV table for spreadsheets and scripts: parameters with u and covariance, then matrices, biases and an example.

One quantity a row: name, value, u, unit, and for a parameter its prior, learned fraction, k, degrees of freedom and
its covariance with every parameter, in a column of that name. `accel.matrix.2.1` is row 2, column 1 of M,
`accel.bias_of.2` the bias of channel 2, both counted from 1:

    reading = matrix · true + bias
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator

from tumble.calibration.calibration_file import Calibration
from tumble.calibration.results import Parameter
from tumble.export.exported import Exported, example, models, numbers, origin
from tumble.export.larger_model import NOT_IN_MATRIX, not_held

LOSSES = ("rests, turns, launches and iterations of the calibration have no place in this file",)
_MORE = ("prior", "learned", "k", "dof")
_UNITS = {"accel": "m/s^2", "gyro": "rad/s"}


def csv_table(calibration: Calibration) -> Exported:
    """The .csv file of a calibration."""
    losses = (*LOSSES, *not_held(calibration, said=NOT_IN_MATRIX))
    names = [p.name for p in calibration.parameters]
    buffer = io.StringIO()
    for line in (*origin(calibration), "reading = matrix * true + bias, SI", *losses):
        buffer.write(f"# {line}\n")
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["name", "value", "u", "unit", *_MORE, *names])
    empty, no_more = [""] * len(names), [""] * len(_MORE)
    for i, p in enumerate(calibration.parameters):
        row = empty if calibration.covariance is None else [repr(c) for c in numbers(calibration.covariance[i])]
        writer.writerow([p.name, repr(p.value), "" if p.u is None else repr(p.u), p.unit, *_more(p), *row])
    writer.writerows([name, repr(value), "", unit, *no_more, *empty] for name, value, unit in _models(calibration))
    return Exported(content=buffer.getvalue().encode(), losses=losses)


def _more(parameter: Parameter) -> list[str]:
    """What is beside value and u."""
    values = (parameter.prior, parameter.learned, parameter.k, parameter.dof)
    return ["" if value is None else repr(value) for value in values]


def _models(calibration: Calibration) -> Iterator[tuple[str, float, str]]:
    """Entries of matrices, biases and examples: name, value, unit."""
    for kind, model in models(calibration).items():
        unit, worked = _UNITS[kind], example(kind, model)
        for p, row in enumerate(model.matrix, 1):
            yield from ((f"{kind}.matrix.{p}.{q}", value, "1") for q, value in enumerate(numbers(row), 1))
        channels = (("bias_of", model.bias), ("example.reading", worked.reading), ("example.true", worked.true))
        for name, vector in channels:
            yield from ((f"{kind}.{name}.{p}", value, unit) for p, value in enumerate(numbers(vector), 1))
