"""A calibration as it shows itself: a line, a table, HTML, frames, a drawing on given axes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from tumble.calibration.further import BY_PRIOR, by_group, other_factors
from tumble.errors import MissingExtraError
from tumble.sensors.parameters import group_name, sensor_kind, shown_in
from tumble.units import engineering, rounded

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    from matplotlib.axes import Axes

    from tumble.calibration.calibration_file import Calibration
    from tumble.calibration.results import Parameter

_HEADINGS = ("parameter", "value", "u", "U (95 %)", "unit")
_COLUMNS = ("name", "value", "u", "unit", "deviation", "run_to_run", "k", "dof", "prior", "learned")
_GROUPS = {"accel": "#1f4e79", "gyro": "#c0561a", "mag": "#3d7d52"}


def headline(calibration: Calibration) -> str:
    """The device, the method, how many parameters, and whether it was accepted, in a line."""
    several = f" of {len(calibration.launches)} launches" if calibration.launches else ""
    count, verdict = len(calibration.parameters), calibration.outcome.verdict
    return f"Calibration of {calibration.serial}: {calibration.method}{several}, {count} parameters, {verdict}"


def headings(calibration: Calibration) -> tuple[str, ...]:
    """What the columns of the rows are."""
    parameters = calibration.parameters
    factors = ("k", "dof") if other_factors(parameters) else ()
    priors = ("prior", "learned") if any(p.prior is not None for p in parameters) else ()
    return _HEADINGS + factors + priors


def rows(calibration: Calibration) -> list[tuple[str, ...]]:
    """Name, value, u, U = k u and unit of every parameter, in the field's units, to the digits of the uncertainty; with
    coverage factor, degrees of freedom, prior and learned fraction where there are any."""
    sizes, wanted = shown_units(calibration.parameters), headings(calibration)
    cells = (_cells(p, *sizes[p.name]) for p in calibration.parameters)
    return [tuple(row[heading] for heading in wanted) for row in cells]


def _cells(parameter: Parameter, size: float, unit: str) -> dict[str, str]:
    """The cells of a parameter by their headings, in the unit of this size; empty where there is nothing to say."""
    u, k, dof, prior, learned = parameter.u, parameter.k, parameter.dof, parameter.prior, parameter.learned
    value, shown = (f"{parameter.value / size:.6g}", "") if u is None else rounded(parameter.value / size, u / size)
    return {
        "parameter": parameter.name,
        "value": value,
        "u": shown,
        "U (95 %)": "" if u is None or k is None else rounded(0.0, k * u / size)[1],
        "unit": unit,
        "k": "" if k is None else f"{k:.2f}",
        "dof": "" if dof is None else f"{dof:.0f}" if k else f"{dof:.1g}",
        "prior": "" if prior is None else f"{prior / size:.2g}",
        "learned": "" if learned is None else f"{100.0 * learned:.0f} %",
    }


def shown_units(parameters: Sequence[Parameter]) -> dict[str, tuple[float, str]]:
    """The unit in which each parameter is shown, by its name, as (size in SI, unit): one for all of a kind, by their
    root mean square."""
    of_kind = {
        kind: shown_in(kind, alike[0].unit, math.sqrt(sum(p.value**2 for p in alike) / len(alike)))
        for kind, alike in by_group(parameters).items()
    }
    return {p.name: of_kind[group_name(p.name)] for p in parameters}


def text_table(calibration: Calibration) -> str:
    """The rows in columns, under the headline, with the reasons against it, the remarks and the notes."""
    lines = [headings(calibration), *rows(calibration)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    words = {lines[0].index("parameter"), lines[0].index("unit")}
    said = [headline(calibration), *calibration.outcome.reasons, *calibration.outcome.remarks]
    for line in lines:
        cells = [c.ljust(w) if i in words else c.rjust(w) for i, (c, w) in enumerate(zip(line, widths, strict=True))]
        said.append("  ".join(cells).rstrip())
    said += [f"note: {note}" for note in calibration.notes]
    return "\n".join(said)


def html(calibration: Calibration) -> str:
    """The same as HTML, everything escaped."""
    head = "".join(f"<th>{escape(heading)}</th>" for heading in headings(calibration))
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows(calibration))
    said = (*calibration.outcome.reasons, *calibration.outcome.remarks, *calibration.notes)
    listed = "<ul>" + "".join(f"<li>{escape(each)}</li>" for each in said) + "</ul>" if said else ""
    return (
        f"<div><p><b>{escape(headline(calibration))}</b></p>{listed}"
        f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _columns(calibration: Calibration) -> Mapping[str, list[Any]]:
    return {name: [getattr(parameter, name) for parameter in calibration.parameters] for name in _COLUMNS}


def polars_frame(calibration: Calibration) -> pl.DataFrame:
    """The parameters, a row each, in SI."""
    import polars as pl

    schema = {name: pl.String if name in ("name", "unit") else pl.Float64 for name in _COLUMNS}
    return pl.DataFrame(_columns(calibration), schema=schema)


def pandas_frame(calibration: Calibration) -> pd.DataFrame:
    """The parameters, a row each, in SI. Raises MissingExtraError without pandas."""
    try:
        import pandas as pd
    except ModuleNotFoundError as error:
        said = "a pandas frame needs pandas; install it with: pip install pandas, or take to_polars()"
        raise MissingExtraError(said) from error
    return pd.DataFrame(_columns(calibration))


def draw(calibration: Calibration, axes: Axes) -> None:
    """The residual of every rest on axes, with the scatter between rests as a band; without rests the parameters in
    units of their uncertainty."""
    axes.axhline(0.0, color="0.7", linewidth=0.8)
    if calibration.rests:
        _draw_residuals(calibration, axes)
    else:
        _draw_parameters(calibration, axes)
    axes.set_title(headline(calibration), fontsize="medium")


def _draw_residuals(calibration: Calibration, axes: Axes) -> None:
    residual = np.array([rest.residual for rest in calibration.rests])
    size, unit = engineering("m/s^2", float(np.abs(residual).max()))
    fit = calibration.fits.get("accelerometers")
    if fit is not None and fit.scatter > 0.0:
        band = fit.scatter / size
        axes.axhspan(-band, band, color=_GROUPS["accel"], alpha=0.12, linewidth=0, label="scatter between rests")
        axes.legend(frameon=False)
    number = np.arange(1, len(residual) + 1)
    axes.vlines(number, 0.0, residual / size, color=_GROUPS["accel"], linewidth=1.0)
    axes.plot(number, residual / size, "o", color=_GROUPS["accel"], markersize=4.0)
    axes.set_xlabel("rest")
    axes.set_ylabel(f"|f| − g, {unit}")


def _draw_parameters(calibration: Calibration, axes: Axes) -> None:
    shown = [p for p in calibration.parameters if p.u]
    for kind, colour in _GROUPS.items():
        own = [(i, p) for i, p in enumerate(shown) if sensor_kind(p.name) == kind]
        for filled in (True, False):  # hollow: known by the prior rather than by the data
            at = [(i, p) for i, p in own if filled == (p.learned is None or p.learned >= BY_PRIOR)]
            face = colour if filled else "none"
            sizes = [p.value / (p.u or 1.0) for _, p in at]
            axes.plot([i for i, _ in at], sizes, "o", color=colour, markerfacecolor=face, markersize=4.0)
    axes.set_xticks(range(len(shown)), [p.name for p in shown], rotation=90)
    axes.set_ylabel("value / u")
