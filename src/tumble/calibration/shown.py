"""A calibration as it shows itself: a line, a table, HTML, frames, a drawing on given axes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from tumble.calibration.further import BY_PRIOR, other_factors
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
    return _HEADINGS + tuple(heading for heading, _ in _more(calibration))


def rows(calibration: Calibration) -> list[tuple[str, ...]]:
    """Name, value, u, U = 2u and unit of every parameter, in the field's units, to the digits of the uncertainty; with
    coverage factor, degrees of freedom, prior and learned fraction where there are any."""
    sizes, more = _sizes(calibration), _more(calibration)
    return [
        (*_row(p, *sizes[p.name]), *(cell(p, sizes[p.name][0]) for _, cell in more)) for p in calibration.parameters
    ]


def _more(calibration: Calibration) -> list[tuple[str, Callable[[Parameter, float], str]]]:
    """Heading and cell of the columns that only some calibrations have."""
    parameters = calibration.parameters
    factors: list[tuple[str, Callable[[Parameter, float], str]]] = [("k", _factor), ("dof", _degrees)]
    priors: list[tuple[str, Callable[[Parameter, float], str]]] = [("prior", _prior), ("learned", _learned)]
    return [
        *(factors if other_factors(parameters) else ()),
        *(priors if any(p.prior is not None for p in parameters) else ()),
    ]


def _factor(parameter: Parameter, size: float) -> str:  # noqa: ARG001
    return "" if parameter.k is None else f"{parameter.k:.2f}"


def _degrees(parameter: Parameter, size: float) -> str:  # noqa: ARG001
    return "" if parameter.dof is None else f"{parameter.dof:.0f}" if parameter.k else f"{parameter.dof:.1g}"


def _prior(parameter: Parameter, size: float) -> str:
    return "" if parameter.prior is None else f"{parameter.prior / size:.2g}"


def _learned(parameter: Parameter, size: float) -> str:  # noqa: ARG001
    return "" if parameter.learned is None else f"{100.0 * parameter.learned:.0f} %"


def _sizes(calibration: Calibration) -> dict[str, tuple[float, str]]:
    """The unit in which each parameter is shown, one for all of a group, as (its size in SI, its name)."""
    largest: dict[str, float] = {}
    for p in calibration.parameters:
        group = group_name(p.name)
        largest[group] = max(largest.get(group, 0.0), abs(p.value), p.u or 0.0)
    return {p.name: shown_in(p.name, p.unit, largest[group_name(p.name)]) for p in calibration.parameters}


def _row(parameter: Parameter, size: float, unit: str) -> tuple[str, ...]:
    if parameter.u is None:
        return parameter.name, f"{parameter.value / size:.6g}", "", "", unit
    value, u = rounded(parameter.value / size, parameter.u / size)
    return parameter.name, value, u, rounded(0.0, 2.0 * parameter.u / size)[1], unit


def text_table(calibration: Calibration) -> str:
    """The rows in columns, under the headline, with the reasons against it and the remarks."""
    lines = [headings(calibration), *rows(calibration)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    words = {lines[0].index("parameter"), lines[0].index("unit")}
    said = [headline(calibration), *calibration.outcome.reasons, *calibration.outcome.remarks]
    for line in lines:
        cells = [c.ljust(w) if i in words else c.rjust(w) for i, (c, w) in enumerate(zip(line, widths, strict=True))]
        said.append("  ".join(cells).rstrip())
    return "\n".join(said)


def html(calibration: Calibration) -> str:
    """The same as HTML, everything escaped."""
    head = "".join(f"<th>{escape(heading)}</th>" for heading in headings(calibration))
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows(calibration))
    said = (*calibration.outcome.reasons, *calibration.outcome.remarks)
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
