"""Several calibrations of one device in one report: methods on one log, or launches and dates beside each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tumble.errors import CalibrationError
from tumble.result.calibration import Calibration
from tumble.result.coverage import expanded
from tumble.result.further import further_parameters, linear_parameters
from tumble.result.parts import Parameter
from tumble.views.blocks import Block, Figure, Section, Table, Text, section
from tumble.views.numbers import NONE, shown_units, to_digits_of, with_expanded
from tumble.views.report import figures


def compared(titles: Sequence[str], calibrations: Sequence[Calibration], name: str) -> Section:
    """Every parameter of the calibrations side by side, in the frame of the first."""
    first = calibrations[0]
    title = "Methods compared" if _one_log(calibrations) else "Calibrations compared"
    try:
        alike = [c.in_frame(first.frame) for c in calibrations]
    except CalibrationError as error:
        return section(title, Text(text=f"They cannot be compared: {error}"))
    if not first.parameters:
        return section(title, Text(text="The first calibration has no parameters to compare."))
    said = "The spread is the standard deviation of the values."
    if _one_log(calibrations):
        said = (
            "The calibrations are of one log: its noise is common to all of them, so that methods should agree within "
            "much less than U."
        )
    blocks: list[Block] = [
        Text(text=f"All in the frame “{first.frame}”. {said}"),
        _side_by_side(titles, alike, linear_parameters(alike[0].parameters), dense=len(titles) > 2),
        Figure(
            svg=figures.comparison(name, titles, alike),
            caption="Difference of every parameter from the mean of the calibrations, with U.",
        ),
    ]
    if further := further_parameters(alike[0].parameters):
        blocks += [Text(text="Beyond the linear model:"), _side_by_side(titles, alike, further, dense=True)]
    return section(title, *blocks)


def _one_log(calibrations: Sequence[Calibration]) -> bool:
    digests = {calibration.provenance.get("log_sha256") for calibration in calibrations}
    return len(digests) == 1 and None not in digests


def _side_by_side(
    titles: Sequence[str], calibrations: Sequence[Calibration], parameters: Sequence[Parameter], *, dense: bool
) -> Table:
    units, rows = shown_units(calibrations[0].parameters), []
    by_name = [{p.name: p for p in calibration.parameters} for calibration in calibrations]
    one_log = _one_log(calibrations)
    for p in parameters:
        size, unit = units[p.name]
        cells = [
            " ± ".join(each or NONE for each in with_expanded(q[p.name], size)) if p.name in q else "" for q in by_name
        ]
        values = [own[p.name].value for own in by_name if p.name in own]
        last = max(values) - min(values) if one_log else float(np.std(values, ddof=1)) if len(values) > 1 else None
        rows.append((p.name, *cells, to_digits_of(last, expanded(p), size), unit))
    columns = ("parameter", *titles, "range" if one_log else "spread", "unit")
    return Table(columns=columns, rows=tuple(rows), text=(0, len(columns) - 1), caption="Value ± U.", dense=dense)
