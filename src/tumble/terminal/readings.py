"""A calibration from a table of readings, as text."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tumble.calibration.readings_table import Nominal
from tumble.estimation.ellipsoid import EllipsoidFit
from tumble.terminal.calibration import parameter_table
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
    if result.fit is not None:
        parts += [Text(""), parameter_table(calibration)]
        if calibration.frame == "paper":
            parts += [Text(""), _paper_table(result)]
        parts += [Text(""), _positions_table(result), Text(""), Text(_fit_line(nominal, result.fit))]
    parts += [Text(note) for note in calibration.notes]
    parts += [Text(""), Text("accepted" if calibration.outcome.accepted else "not accepted")]
    return Group(*parts)


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
