"""Calibrations as text on a terminal: parameters, launches, iterations and methods side by side, rests, fits.

Several launches have the form of the paper's Tables 1 to 3: every launch, the mean and the standard deviation from
launch to launch, the mean increments of the iterations, and the difference of the methods in percent.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from tumble.calibration.calibrate import ITERATED_METHODS
from tumble.calibration.calibration_file import Calibration
from tumble.calibration.coverage import without_expanded
from tumble.calibration.further import (
    decided_by_priors,
    group_lines,
    linear_parameters,
    other_factors,
    predicted,
    verdicts,
)
from tumble.calibration.launches import difference_percent
from tumble.calibration.results import Parameter
from tumble.calibration.shown import shown_units
from tumble.estimation.diagnosis.site_gravity import gravity_said
from tumble.terminal.table import add_numbers, plain_table
from tumble.units import G_STANDARD, engineering, rounded

WHAT_AN_INCREMENT_SAYS = (
    "All iterations work on the same readings. What a later one adds is the error that the one before made by its "
    "method: table, mounting, squares of the parameters. Noise, changes of the sensors between rests and a wrong "
    "gravity are in every iteration alike and in no increment: small increments say that the iterations have "
    "converged, not that the result is as exact as they are small. How exact it is, u says."
)
"""What a report of iterations has beside its increments."""


def parameter_table(calibration: Calibration, truth: Mapping[str, float] | None = None) -> Table:
    """Parameters with uncertainties in engineering units; where a coverage factor is not 2, with U = k u; where there
    are any, with deviations from the systematic values and from launch to launch; with `truth`, also true values and
    the distance from them in units of u."""
    several, expanded = bool(calibration.launches), other_factors(calibration.parameters)
    passport = any(p.deviation is not None for p in calibration.parameters)
    headings = ["mean" if several else "value", "u (k=1)"]
    headings += ["k", "U (95 %)"] if expanded else []
    headings += (["run to run"] if several else []) + (["deviation"] if passport else [])
    table = plain_table("parameter")
    add_numbers(table, *headings)
    table.add_column("unit")
    if truth is not None:
        add_numbers(table, "truth", "(value − truth)/u")
    units = shown_units(calibration.parameters)
    for p in calibration.parameters:
        size, unit = units[p.name]
        numbers = [p.value, *([p.run_to_run] if several else []), *([p.deviation] if passport else [])]
        row = [_shown(number, p.u, size) for number in numbers]
        row[1:1] = _uncertainty(p, size, expanded=expanded)
        table.add_row(p.name, *row, unit, *(_against(p, truth, size) if truth is not None else []))
    return table


def _uncertainty(parameter: Parameter, size: float, *, expanded: bool) -> list[str]:
    """u, and where it is wanted the coverage factor k and U = k u."""
    if parameter.u is None:
        return [""] * (3 if expanded else 1)
    u, k = parameter.u / size, parameter.k
    more = ["", ""] if k is None else [f"{k:.2f}", rounded(0.0, k * u)[1]]
    return [rounded(0.0, u)[1], *(more if expanded else [])]


def group_table(calibration: Calibration) -> Table:
    """A line for each group beyond the linear model: its largest |value| with u, what the session has learned of it,
    and how much its prior was widened."""
    table = plain_table("group")
    add_numbers(table, "largest", "u (k=1)")
    table.add_column("unit")
    add_numbers(table, "learned")
    table.add_column("")
    for line in group_lines(calibration):
        largest = line.largest
        value = "" if largest is None else _shown(abs(largest.value), largest.u, line.size)
        u = "" if largest is None or largest.u is None else rounded(0.0, largest.u / line.size)[1]
        table.add_row(line.name, value, u, line.shown if largest else "", line.learned_percent, line.remark)
    return table


def _shown(value: float | None, u: float | None, size: float) -> str:
    """A number of a parameter to the digits of its uncertainty; nothing where there is none."""
    if value is None:
        return ""
    text = rounded(value / size, (u or 0.0) / size)[0]
    return text if float(text) else text.lstrip("-")


def _against(parameter: Parameter, truth: Mapping[str, float], size: float) -> list[str]:
    if parameter.name not in truth or not parameter.u:
        return ["", ""]
    true = truth[parameter.name]
    return [_shown(true, parameter.u, size), f"{(parameter.value - true) / parameter.u:+z.2f}"]


def session_table(calibration: Calibration) -> Table:
    """The sessions of one estimate: rests, turns and temperatures of each."""
    table = plain_table("session")
    add_numbers(table, "rests", "turns", "from °C", "to °C")
    for member in calibration.together:
        low, high = member.temperatures
        table.add_row(Text(member.session), f"{member.rests}", f"{member.turns}", f"{low:z.1f}", f"{high:z.1f}")
    return table


def launch_table(calibration: Calibration, *, deviations: bool = False) -> Table:
    """The value of every parameter in every launch, the mean and the standard deviation from launch to launch, as in
    the paper's Tables 1 to 3; with `deviations`, those from the systematic values, which is what the paper has."""
    table = plain_table("deviation of" if deviations else "parameter")
    for launch in calibration.launches:
        table.add_column(Text(launch.session), justify="right")
    add_numbers(table, "mean", "run to run")
    table.add_column("unit")
    units = shown_units(calibration.parameters)
    for p in calibration.parameters:
        size, unit = units[p.name]
        own = [next(q for q in launch.parameters if q.name == p.name) for launch in calibration.launches]
        row = [_shown(q.deviation if deviations else q.value, q.u, size) for q in own]
        row += [_shown(p.deviation if deviations else p.value, p.u, size), _shown(p.run_to_run, p.u, size)]
        table.add_row(p.name, *row, unit)
    return table


def iteration_table(calibration: Calibration) -> Table:
    """What every iteration added to every parameter, of several launches the mean, beside the uncertainty."""
    table = plain_table("mean increment of" if calibration.launches else "increment of")
    for i in range(len(calibration.iterations)):
        add_numbers(table, f"iteration {i + 1}")
    add_numbers(table, "u (k=1)")
    table.add_column("unit")
    units = shown_units(calibration.parameters)
    for p in calibration.parameters:
        size, unit = units[p.name]
        steps = [f"{step[p.name] / size:.3g}" for step in calibration.iterations]
        table.add_row(p.name, *steps, rounded(p.value / size, (p.u or 0.0) / size)[1], unit)
    return table


def method_table(calibration: Calibration, other: Calibration) -> Table:
    """The parameters by another method beside those of a calibration, and the difference other − this, also in % of
    this, as in the last column of the paper's Table 1."""
    table = plain_table("parameter")
    add_numbers(table, calibration.method, other.method, "difference", "%")
    table.add_column("unit")
    units, theirs = shown_units(calibration.parameters), {p.name: p for p in other.parameters}
    for p in calibration.parameters:
        if p.name not in theirs:
            continue
        (size, unit), value = units[p.name], theirs[p.name].value
        percent = f"{difference_percent(value, p.value):+z.2f}" if p.value else ""
        difference = _shown(value - p.value, 0.1 * (p.u or 0.0), size)
        table.add_row(p.name, _shown(p.value, p.u, size), _shown(value, p.u, size), difference, percent, unit)
    return table


def rest_table(calibration: Calibration) -> Table:
    """Residual of every rest."""
    table = plain_table()
    add_numbers(table, "rest", "start s", "stop s", "residual µg", "sigmas")
    for i, rest in enumerate(calibration.rests, 1):
        table.add_row(
            str(i),
            f"{rest.start:z.1f}",
            f"{rest.stop:z.1f}",
            f"{rest.residual / G_STANDARD * 1e6:+z.1f}",
            f"{rest.sigmas:.1f}",
        )
    return table


def calibration_report(
    calibration: Calibration,
    truth: Mapping[str, float] | None = None,
    others: Sequence[Calibration] = (),
    *,
    every: bool = False,
) -> RenderableType:
    """All that `tumble calibrate` says about an accepted or rejected result; `others` are calibrations of the same
    sessions by other methods. The tables have the parameters of the linear model, then a line for each further group;
    with `every`, all parameters."""
    whole, calibration = calibration, calibration if every else linear_of(calibration)
    parts: list[RenderableType] = []
    device = calibration.serial if calibration.model is None else f"{calibration.serial} ({calibration.model})"
    parts.append(Text(f"device {device} · method {calibration.method} · frame {calibration.frame}"))
    if calibration.parameters:
        parts += [Text(""), parameter_table(calibration, truth)]
    if group_lines(whole):
        parts += [Text(""), group_table(whole)]
    if calibration.launches:
        parts += [Text(""), launch_table(calibration)]
        if any(p.deviation is not None for p in calibration.parameters):
            parts += [Text(""), launch_table(calibration, deviations=True)]
    if calibration.together:
        parts += [Text(""), session_table(calibration)]
    if calibration.method in ITERATED_METHODS and calibration.iterations:
        parts += [Text(""), iteration_table(calibration), Text(WHAT_AN_INCREMENT_SAYS)]
    for other in others if calibration.parameters else ():
        parts += [Text(""), method_table(calibration, other)]
    if calibration.rests:
        parts += [Text(""), rest_table(calibration)]
    if calibration.fits:
        parts += [Text(""), Text("\n".join(_fit_lines(calibration)))]
    if truth is not None:
        parts.append(Text(_truth_line(whole, truth)))
    if whole.prediction is not None:
        parts.append(Text(predicted(whole.prediction)))
    if decided := decided_by_priors(whole):
        parts.append(Text(decided))
    if calibration.site is not None and not calibration.site.gravity_is_unit:
        parts.append(Text(gravity_said(calibration.site)))
    parts += [Text(note) for note in (*without_expanded(calibration.parameters), *calibration.notes)]
    parts += [Text(f"remark: {remark}") for remark in calibration.outcome.remarks]
    parts += [Text(""), *map(Text, verdicts(calibration))]
    return Group(*parts)


def linear_of(calibration: Calibration) -> Calibration:
    """The calibration with the parameters of the linear model alone, in its launches too."""
    launches = tuple(replace(one, parameters=linear_parameters(one.parameters)) for one in calibration.launches)
    return replace(calibration, parameters=linear_parameters(calibration.parameters), launches=launches)


def _fit_lines(calibration: Calibration) -> list[str]:
    lines = []
    for name, fit in calibration.fits.items():
        if fit.degrees < 0.5:
            lines.append(f"{name}: no more data than unknowns, so that nothing checks the fit")
            continue
        line = f"{name}: chi-square {fit.chi_square:.1f} for {fit.degrees:.1f} degrees of freedom"
        if fit.scatter > 0.0:
            size, unit = engineering(fit.scatter_unit, fit.scatter)
            line += f", with a scatter of {fit.scatter / size:.3g} {unit} estimated on top of the noise within rests"
        else:
            line += f" (probability {fit.probability:.2f})"
            line += ", no scatter beyond the noise within rests" if fit.scatter_unit else ""
        lines.append(line)
    if calibration.turns:
        worst = max(turn.sigmas for turn in calibration.turns)
        lines.append(f"turns: {len(calibration.turns)}, the worst {worst:z.1f} sigma from the fit")
    return lines


def _truth_line(calibration: Calibration, truth: Mapping[str, float]) -> str:
    z = [(p.value - truth[p.name]) / p.u for p in calibration.parameters if p.u and p.name in truth]
    if not z:
        return "truth: no parameter was estimated that it has"
    rms = math.sqrt(sum(v * v for v in z) / len(z))
    return f"truth: {len(z)} parameters, rms of (value − truth)/u {rms:.2f}, expected about 1"
