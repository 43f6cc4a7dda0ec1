"""A calibration from a table of readings, as text."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tumble.calibration.further import group_lines, predicted
from tumble.calibration.readings_table import Nominal
from tumble.estimation.ellipsoid import TRIAD, EllipsoidFit
from tumble.sensors.frames import Convention, frame_of
from tumble.terminal.calibration import group_table, linear_of, parameter_table
from tumble.terminal.table import add_numbers, plain_table
from tumble.units import engineering, rounded

if TYPE_CHECKING:
    from rich.console import RenderableType
from tumble.calibration.from_readings import ReadingsCalibration, paper_form


def result_report(result: ReadingsCalibration) -> RenderableType:
    """Parameters, positions, what the fit says and the verdict."""
    from rich.console import Group
    from rich.text import Text

    calibration, nominal = result.calibration, result.nominal
    parts: list[RenderableType] = [
        Text(f"{result.table.path.name} · {nominal.sensor} · method ellipsoid · frame {calibration.frame}")
    ]
    if result.fit is not None and result.recorded:
        parts += [Text(""), _correction_table(result), Text(""), Text(_samples_line(result, result.fit))]
    elif result.fit is not None:
        parts += [Text(""), parameter_table(linear_of(calibration))]
        if group_lines(calibration):
            parts += [Text(""), group_table(calibration)]
        if calibration.frame == "paper":
            parts += [Text(""), _paper_table(result)]
        parts += [Text(""), _positions_table(result), Text(""), Text(_fit_line(nominal, result.fit))]
    if calibration.prediction is not None:
        parts.append(Text(predicted(calibration.prediction)))
    parts += [Text(note) for note in calibration.notes]
    parts += [Text(f"remark: {remark}") for remark in calibration.outcome.remarks]
    parts += [Text(""), Text(calibration.outcome.verdict)]
    return Group(*parts)


def _correction_table(result: ReadingsCalibration) -> RenderableType:
    """What corrects the readings, an axis a line: true = matrix (reading − bias), the bias in the unit of the readings,
    the matrix in that of the result per unit of the readings, each row with the largest u of its elements."""
    calibration, nominal = result.calibration, result.nominal
    hard, soft = ("hard iron", "soft iron") if nominal.sensor == "mag" else ("bias", "matrix")
    values = np.array([p.value for p in calibration.parameters[:9]])
    convention = Convention(frame=frame_of(calibration.frame), block=TRIAD)
    by_values, matrix = convention.jacobian(values)[:, :3], convention.model(values).inverse()
    to_result = 1.0 / (nominal.scale * nominal.per_factor)
    change = -np.einsum("ip,pqm,qj->ijm", matrix, by_values, matrix) * to_result[:, None]
    known = np.zeros((9, 9)) if calibration.covariance is None else calibration.covariance[:9, :9]
    u = np.sqrt(np.einsum("ijm,mn,ijn->ij", change, known, change)).max(axis=1)
    table = plain_table("axis")
    add_numbers(table, f"{hard} {nominal.unit}", "u (k=1)", f"{soft}: x", "y", "z", "u (k=1)")
    for i, axis in enumerate("xyz"):
        bias, of_bias = rounded(values[i] * nominal.scale[i], float(np.sqrt(known[i, i]) * abs(nominal.scale[i])))
        row = [rounded(float(element), float(u[i])) for element in matrix[i] * to_result]
        table.add_row(axis, bias, of_bias, *(element for element, _ in row), row[i][1])
    return table


def _samples_line(result: ReadingsCalibration, found: EllipsoidFit) -> str:
    """How many samples there are, how they scatter and what u is made from."""
    nominal = result.nominal
    return (
        f"a recording, {len(found.used)} samples: true = matrix · (reading − bias), in {nominal.per}; a sample "
        f"scatters by {100.0 * found.scatter / nominal.modulus:.2g} % of the vector; u is of "
        f"{found.noise_degrees + 1:.0f} stretches left out in turn, since neighbours err alike"
    )


def _paper_table(result: ReadingsCalibration) -> RenderableType:
    form, nominal = paper_form(result), result.nominal
    table = plain_table("axis")
    for heading in (f"k {nominal.unit}/{nominal.per}", "θ 1e-5 rad", f"b 1e-5 {nominal.per}"):
        add_numbers(table, heading, "u (k=1)")
    known = form.covariance is not None
    u = np.zeros(9) if form.covariance is None else np.sqrt(np.diag(form.covariance))
    for i, axis in enumerate("xyz"):
        cells: list[str] = []
        for value, each, size in ((form.k[i], u[i], 1.0), (form.theta[i], u[3 + i], 1e-5), (form.b[i], u[6 + i], 1e-5)):
            said, uncertainty = rounded(float(value) / size, float(each) / size)
            cells += [said, uncertainty if known else ""]
        table.add_row(axis, *cells)
    return table


def _positions_table(result: ReadingsCalibration) -> RenderableType:
    """Residual |corrected reading| less the modulus of every position, plain and against the fit through the others."""
    found = result.fit
    assert found is not None
    size, unit = engineering(result.nominal.result_unit, float(np.abs(found.residual[found.used]).max()))
    table = plain_table()
    add_numbers(table, "position", "line", f"residual {unit}", f"left out {unit}", "u (k=1)", "sigmas", "")
    for i, line in enumerate(result.table.lines):
        by_others = (
            f"{found.leave_one_out[i] / size:+z.2f}",
            f"{found.leave_one_out_u[i] / size:.2f}",
            f"{found.sigmas[i]:.1f}",
        )
        table.add_row(
            str(i + 1),
            str(line),
            f"{found.residual[i] / size:+z.2f}",
            *(by_others if found.degrees else ("", "", "")),
            "" if found.used[i] else "bad",
        )
    return table


def _fit_line(nominal: Nominal, found: EllipsoidFit) -> str:
    if found.degrees == 0:
        return "no more positions than parameters, so that nothing checks the fit"
    size, unit = engineering(nominal.result_unit, found.scatter)
    if found.scatter == 0.0:
        return f"{int(found.used.sum())} positions for 9 parameters: no scatter"
    return (
        f"{int(found.used.sum())} positions for 9 parameters: a reading scatters by {found.scatter / size:.3g} {unit}, "
        f"estimated with {found.degrees} degrees of freedom"
    )
