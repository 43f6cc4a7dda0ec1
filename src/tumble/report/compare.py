"""Several calibrations of one device in one report: methods on one log, or launches and dates beside each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tumble.calibration.calibration_file import Calibration
from tumble.calibration.further import further_parameters, linear_parameters
from tumble.calibration.results import Parameter
from tumble.calibration.shown import shown_units
from tumble.errors import CalibrationError
from tumble.report import figures
from tumble.report.blocks import Block, Figure, ReportTable, Section, Text
from tumble.report.numbers import NONE, as_value, with_expanded


def compared(titles: Sequence[str], calibrations: Sequence[Calibration], name: str) -> Section:
    """Every parameter of the calibrations side by side, in the frame of the first."""
    first = calibrations[0]
    title = "Methods compared" if _one_log(calibrations) else "Calibrations compared"
    try:
        alike = [c.in_frame(first.frame) for c in calibrations]
    except CalibrationError as error:
        return Section(title=title, blocks=(Text(text=f"They cannot be compared: {error}"),))
    if not first.parameters:
        return Section(title=title, blocks=(Text(text="The first calibration has no parameters to compare."),))
    blocks: list[Block] = [
        Text(text=_said(calibrations)),
        _side_by_side(titles, alike, linear_parameters(alike[0].parameters), dense=len(titles) > 2),
        Figure(
            svg=figures.comparison(name, titles, alike),
            caption="Difference of every parameter from the mean of the calibrations, with U.",
        ),
    ]
    if further := further_parameters(alike[0].parameters):
        blocks += [Text(text="Beyond the linear model:"), _side_by_side(titles, alike, further, dense=True)]
    return Section(title=title, blocks=tuple(blocks))


def _one_log(calibrations: Sequence[Calibration]) -> bool:
    digests = {calibration.provenance.get("log_sha256") for calibration in calibrations}
    return len(digests) == 1 and None not in digests


def _said(calibrations: Sequence[Calibration]) -> str:
    frame = f"All in the frame “{calibrations[0].frame}”."
    if _one_log(calibrations):
        return (
            f"{frame} The calibrations are of one log: its noise is common to all of them, so that methods "
            "should agree within much less than U."
        )
    return f"{frame} The spread is the standard deviation of the values."


def _side_by_side(
    titles: Sequence[str], calibrations: Sequence[Calibration], parameters: Sequence[Parameter], *, dense: bool
) -> ReportTable:
    units = shown_units(calibrations[0].parameters)
    found = [{p.name: p for p in calibration.parameters} for calibration in calibrations]
    spread = not _one_log(calibrations)
    rows = []
    for p in parameters:
        size, unit = units[p.name]
        cells = [" ± ".join(with_expanded(own[p.name], size)) if p.name in own else NONE for own in found]
        values = [own[p.name].value for own in found if p.name in own]
        width = float(np.std(values, ddof=1)) if len(values) > 1 else None
        last = width if spread else max(values) - min(values)
        rows.append((p.name, *cells, as_value(last, p, size), unit))
    columns = ("parameter", *titles, "spread" if spread else "range", "unit")
    return ReportTable(
        columns=columns,
        rows=tuple(rows),
        text=(0, len(columns) - 1),
        caption="Value ± U.",
        dense=dense,
    )
