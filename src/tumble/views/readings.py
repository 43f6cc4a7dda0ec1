"""Calibrations from a table of readings."""

from __future__ import annotations

import numpy as np

from tumble.result.further import linear_parameters, prediction_text
from tumble.run.from_readings import ReadingsCalibration, paper_form
from tumble.run.readings_table import unit_of_scale
from tumble.units import engineering
from tumble.views.blocks import Block, Items, Table, table
from tumble.views.calibration import group_table, parameter_table
from tumble.views.numbers import cells


def readings_blocks(result: ReadingsCalibration) -> list[Block]:
    """Return verdict, parameters and positions of a calibration, with sentences on the fit."""
    calibration, fit = result.calibration, result.fit
    blocks: list[Block] = [
        f"{result.table.path.name} · method {calibration.method} · frame {calibration.frame}",
        calibration.outcome.verdict,
        *(f"remark: {remark}" for remark in calibration.outcome.remarks),
    ]
    lines = []
    if fit is not None or calibration.parameters:
        blocks.append(parameter_table(calibration, linear_parameters(calibration.parameters)))
    if fit is not None:
        blocks.append(group_table(calibration))
        if calibration.frame == "paper":
            blocks.append(_paper_table(result))
        size, unit = engineering("m/s^2", float(np.abs(fit.residual[fit.used]).max()))
        rows = []
        for i, line in enumerate(result.table.lines):  # residuals |corrected reading| − g
            row = {"position": str(i + 1), "line": str(line), f"residual {unit}": f"{fit.residual[i] / size:+z.2f}"}
            row[f"left out {unit}"] = f"{fit.leave_one_out[i] / size:+z.2f}" if fit.degrees else ""
            row["u (k=1)"] = f"{fit.leave_one_out_u[i] / size:.2f}" if fit.degrees else ""
            row["sigmas"] = f"{fit.sigmas[i]:.1f}" if fit.degrees else ""
            rows.append(row | {"": "" if fit.used[i] else "bad"})
        blocks.append(table(rows, words=()))
        (size, unit), positions = engineering("m/s^2", fit.scatter), int(fit.used.sum())
        if fit.degrees == 0:
            lines.append("no more positions than parameters, so that nothing checks the fit")
        elif fit.scatter == 0.0:
            lines.append(f"{positions} positions for 9 parameters: no scatter")
        else:
            lines.append(
                f"{positions} positions for 9 parameters: a reading scatters by {fit.scatter / size:.3g} {unit}, "
                f"estimated with {fit.degrees} degrees of freedom"
            )
    if calibration.prediction is not None:
        lines.append(prediction_text(calibration.prediction))
    return [*blocks, Items(items=(*lines, *calibration.provenance.notes))]


def _paper_table(result: ReadingsCalibration) -> Table:
    (form, covariance), channels, rows = paper_form(result), result.channels, []
    u = np.zeros(9) if covariance is None else np.sqrt(np.diag(covariance))
    for i, axis in enumerate("xyz"):
        shown = [cells(float(form[j]), float(u[j]), size) for j, size in ((i, 1.0), (3 + i, 1e-5), (6 + i, 1e-5))]
        rows.append((axis, *(cell for value, each in shown for cell in (value, "" if covariance is None else each))))
    per = unit_of_scale(channels)
    headings = (f"k {channels.unit_name}/{per}", "θ 1e-5 rad", f"b 1e-5 {per}")
    return Table(columns=("axis", *(cell for name in headings for cell in (name, "u (k=1)"))), rows=tuple(rows))
