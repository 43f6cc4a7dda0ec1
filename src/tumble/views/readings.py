"""A calibration from a table of readings."""

from __future__ import annotations

import numpy as np

from tumble.methods.ellipsoid_fit import TRIAD, EllipsoidFit
from tumble.result.further import group_lines, linear_parameters, predicted
from tumble.run.from_readings import ReadingsCalibration, paper_form
from tumble.sensors.frames import Convention, frame_of
from tumble.units import engineering
from tumble.views.blocks import Block, Items, Table, table
from tumble.views.calibration import group_table, parameter_table
from tumble.views.numbers import cells


def readings_blocks(result: ReadingsCalibration) -> list[Block]:
    """The verdict, parameters, positions, and what the fit says."""
    calibration, nominal, fit = result.calibration, result.nominal, result.fit
    blocks: list[Block] = [
        f"{result.table.path.name} · {nominal.sensor} · method {calibration.method} · frame {calibration.frame}",
        calibration.outcome.verdict,
        *(f"remark: {remark}" for remark in calibration.outcome.remarks),
    ]
    lines = []
    if fit is not None and result.recorded:
        blocks.append(_correction_table(result))
        lines.append(
            f"a recording, {len(fit.used)} samples: true = matrix · (reading − bias), in {nominal.per}; a sample "
            f"scatters by {100.0 * fit.scatter / nominal.modulus:.2g} % of the vector; u is of "
            f"{fit.noise_degrees + 1:.0f} stretches left out in turn, since neighbours err alike"
        )
    elif fit is not None:
        blocks.append(parameter_table(calibration, linear_parameters(calibration.parameters)))
        blocks += [group_table(calibration)] if group_lines(calibration) else []
        blocks += [_paper_table(result)] if calibration.frame == "paper" else []
        blocks.append(_position_table(result, fit))
        (size, unit), positions = engineering(nominal.result_unit, fit.scatter), int(fit.used.sum())
        if fit.degrees == 0:
            lines.append("no more positions than parameters, so that nothing checks the fit")
        elif fit.scatter == 0.0:
            lines.append(f"{positions} positions for 9 parameters: no scatter")
        else:
            lines.append(
                f"{positions} positions for 9 parameters: a reading scatters by {fit.scatter / size:.3g} {unit}, "
                f"estimated with {fit.degrees} degrees of freedom"
            )
    elif calibration.parameters:
        blocks.append(parameter_table(calibration, linear_parameters(calibration.parameters)))
    if calibration.prediction is not None:
        lines.append(predicted(calibration.prediction))
    return [*blocks, Items(items=(*lines, *calibration.provenance.notes))]


def _correction_table(result: ReadingsCalibration) -> Table:
    """What corrects the readings, an axis a line: true = matrix (reading − bias), the bias in the unit of the readings,
    the matrix in that of the result per unit of the readings, each row with the largest u of its elements."""
    calibration, nominal = result.calibration, result.nominal
    hard, soft = ("hard iron", "soft iron") if nominal.sensor == "mag" else ("bias", "matrix")
    values = np.array([p.value for p in calibration.parameters[:9]])
    convention = Convention(frame=frame_of(calibration.frame), block=TRIAD)
    by_values, matrix = convention.jacobian(values)[:, :3], convention.model(values).inverse()
    to_result = 1.0 / (nominal.scale * nominal.per_factor)
    change = -np.einsum("ip,pqm,qj->ijm", matrix, by_values, matrix) * to_result[:, None]
    covariance = np.zeros((9, 9)) if calibration.covariance is None else calibration.covariance[:9, :9]
    u = np.sqrt(np.einsum("ijm,mn,ijn->ij", change, covariance, change)).max(axis=1)
    rows = []
    for i, axis in enumerate("xyz"):
        bias = cells(values[i] * nominal.scale[i], float(np.sqrt(covariance[i, i]) * abs(nominal.scale[i])))
        row = [cells(float(element), float(u[i])) for element in matrix[i] * to_result]
        rows.append((axis, *bias, *(element for element, _ in row), row[i][1]))
    columns = ("axis", f"{hard} {nominal.unit}", "u (k=1)", f"{soft}: x", "y", "z", "u (k=1)")
    return Table(columns=columns, rows=tuple(rows))


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


def _position_table(result: ReadingsCalibration, fit: EllipsoidFit) -> Table:
    """Residual |corrected reading| less the modulus of every position, plain and against the fit through the others."""
    size, unit = engineering(result.nominal.result_unit, float(np.abs(fit.residual[fit.used]).max()))
    rows = []
    for i, line in enumerate(result.table.lines):
        row = {"position": str(i + 1), "line": str(line), f"residual {unit}": f"{fit.residual[i] / size:+z.2f}"}
        row[f"left out {unit}"] = f"{fit.leave_one_out[i] / size:+z.2f}" if fit.degrees else ""
        row["u (k=1)"] = f"{fit.leave_one_out_u[i] / size:.2f}" if fit.degrees else ""
        row["sigmas"] = f"{fit.sigmas[i]:.1f}" if fit.degrees else ""
        rows.append(row | {"": "" if fit.used[i] else "bad"})
    return table(rows, words=())
