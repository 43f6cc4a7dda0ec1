"""A calibration as it shows itself: a line, a table, HTML, frames, a drawing on given axes."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from tumble.errors import MissingExtraError
from tumble.units import engineering, rounded

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    from matplotlib.axes import Axes

    from tumble.calibration.calibration_file import Calibration
    from tumble.calibration.results import Parameter

_HEADINGS = ("parameter", "value", "u", "U (k = 2)", "unit")
_COLUMNS = ("name", "value", "u", "unit", "deviation", "run_to_run")
_GROUPS = {"accel": "#1f4e79", "gyro": "#c0561a", "mag": "#3d7d52"}


def headline(calibration: Calibration) -> str:
    """The device, the method, how many parameters, and whether it was accepted, in a line."""
    verdict = "accepted" if calibration.outcome.accepted else "not accepted"
    several = f" of {len(calibration.launches)} launches" if calibration.launches else ""
    count = len(calibration.parameters)
    return f"Calibration of {calibration.serial}: {calibration.method}{several}, {count} parameters, {verdict}"


def rows(calibration: Calibration) -> list[tuple[str, ...]]:
    """Name, value, u, U = 2u and unit of every parameter, in the field's units, to the digits of the uncertainty."""
    sizes = _sizes(calibration)
    return [_row(parameter, *sizes[parameter.name]) for parameter in calibration.parameters]


def _sizes(calibration: Calibration) -> dict[str, tuple[float, str]]:
    """The unit in which each parameter is shown, one for all of a group, as (its size in SI, its name)."""
    largest: dict[str, float] = {}
    for p in calibration.parameters:
        group = p.name.rpartition(".")[0]
        largest[group] = max(largest.get(group, 0.0), abs(p.value), p.u or 0.0)
    return {p.name: engineering(p.unit, largest[p.name.rpartition(".")[0]]) for p in calibration.parameters}


def _row(parameter: Parameter, size: float, unit: str) -> tuple[str, ...]:
    if parameter.u is None:
        return parameter.name, f"{parameter.value / size:.6g}", "", "", unit
    value, u = rounded(parameter.value / size, parameter.u / size)
    return parameter.name, value, u, rounded(0.0, 2.0 * parameter.u / size)[1], unit


def text_table(calibration: Calibration) -> str:
    """The rows in columns, under the headline, with the reasons where it was not accepted."""
    lines = [_HEADINGS, *rows(calibration)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(_HEADINGS))]
    said = [headline(calibration), *calibration.outcome.reasons]
    for name, *numbers, unit in lines:
        cells = [name.ljust(widths[0]), *(n.rjust(w) for n, w in zip(numbers, widths[1:], strict=False)), unit]
        said.append("  ".join(cells).rstrip())
    return "\n".join(said)


def html(calibration: Calibration) -> str:
    """The same as HTML, everything escaped."""
    head = "".join(f"<th>{escape(heading)}</th>" for heading in _HEADINGS)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows(calibration))
    reasons = "".join(f"<li>{escape(reason)}</li>" for reason in calibration.outcome.reasons)
    listed = f"<ul>{reasons}</ul>" if reasons else ""
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
        at = [i for i, p in enumerate(shown) if p.name.startswith(f"{kind}.")]
        axes.plot(at, [shown[i].value / (shown[i].u or 1.0) for i in at], "o", color=colour, markersize=4.0)
    axes.set_xticks(range(len(shown)), [p.name for p in shown], rotation=90)
    axes.set_ylabel("value / u")
