"""Calibrations from a table of readings."""

from __future__ import annotations

import numpy as np

from tumble.result.further import linear_parameters, prediction_text
from tumble.run.from_readings import ReadingsCalibration, paper_form
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
    form, nominal = paper_form(result), result.nominal
    u = np.zeros(9) if form.covariance is None else np.sqrt(np.diag(form.covariance))
    values, rows = ((form.k, u[:3], 1.0), (form.theta, u[3:6], 1e-5), (form.b, u[6:], 1e-5)), []
    for i, axis in enumerate("xyz"):
        shown = [cells(float(value[i]), float(of_value[i]), size) for value, of_value, size in values]
        has_u = form.covariance is not None
        rows.append((axis, *(cell for value, each in shown for cell in (value, each if has_u else ""))))
    headings = (f"k {nominal.unit}/{nominal.per}", "θ 1e-5 rad", f"b 1e-5 {nominal.per}")
    return Table(columns=("axis", *(cell for name in headings for cell in (name, "u (k=1)"))), rows=tuple(rows))
