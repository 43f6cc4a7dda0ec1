"""Control charts: every parameter over time with U and limits, as an SVG file or a self-contained HTML page.

Everything that comes from calibration files is escaped; the page loads nothing, and says so to the browser.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterable
from datetime import datetime, timedelta
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tumble.errors import InputError, needs_extra
from tumble.files import whole_file
from tumble.registry.limits import RULE
from tumble.registry.monitor import Monitored
from tumble.registry.records import STATES
from tumble.registry.trend import YEAR, Trend
from tumble.terminal.registry import (
    change_cells,
    drift_cells,
    expanded_of,
    limit_cell,
    significant,
    with_expanded,
)
from tumble.units import engineering

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FORMATS = (".html", ".svg")
COLUMNS = 3
_MARKERS = dict(zip(STATES, ("v", "^", "o"), strict=True))
_LIMIT_COLOUR = "#b3261e"

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'">
<title>{title}</title>
<style>
body {{ font: 15px/1.5 system-ui, sans-serif; margin: 2em auto; max-width: 76em; padding: 0 1em; color: #1b1b1b }}
svg {{ width: 100%; height: auto }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums }}
th, td {{ padding: .15em .8em; text-align: right; border-bottom: 1px solid #ddd }}
th:first-child, td:first-child {{ text-align: left }}
</style></head><body>
<h1>{title}</h1>
<p>{about}</p>
{chart}
<table><tr><th>parameter</th><th>latest</th><th>U</th><th>lowest</th><th>highest</th><th>run to run</th>
<th>drift a year</th><th>U (95 %)</th><th>change</th><th>E<sub>n</sub></th><th>unit</th></tr>
{rows}
</table>
<p>Points: value with U (95.45 %); ▼ as found, ▲ as left after an adjustment, ● without one. Dashed: drift, by weighted
least squares with the instability from run to run, since the last adjustment. Red: limits of the periodic check; grey:
their guard band of the latest U. {rule}. Change: the latest as found against the last as left; |E<sub>n</sub>| above 1
is a change of the device.</p>
</body></html>
"""


def write_chart(path: Path, found: Monitored) -> None:
    """Write the control charts of the parameters of a device.

    Raises InputError for another ending than .html and .svg, MissingExtraError without matplotlib."""
    ending = path.suffix.lower()
    if ending not in FORMATS:
        raise InputError(f"{path}: expected a file that ends in {' or '.join(FORMATS)}, found {path.suffix!r}")
    svg = _svg(found)
    text = svg if ending == ".svg" else _page(svg, found)
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _page(svg: str, found: Monitored) -> str:
    record = found.latest
    return _PAGE.format(
        title=f"Device {escape(record.serial)}",
        about=escape(f"Type {record.model or 'not stated'}, frame {found.frame}, latest record {record.number}."),
        chart=re.sub(r"\A.*?(?=<svg)", "", svg, flags=re.S),
        rows="\n".join(_row(trend, found.limits.get(trend.series.name)) for trend in found.trends),
        rule=escape(RULE[0].upper() + RULE[1:]),
    )


def _row(trend: Trend, limits: tuple[float, float] | None) -> str:
    series, latest = trend.series, trend.series.points[-1]
    size, unit = _unit(trend)
    cells = [
        series.name,
        *with_expanded(latest.value, expanded_of(latest), size),
        *(limit_cell(limit, size) for limit in limits or (math.nan, math.nan)),
        significant(trend.run_to_run, size),
        *drift_cells(trend, size),
        *change_cells(trend.last_change, size),
        unit,
    ]
    return "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>"


def _unit(trend: Trend) -> tuple[float, str]:
    return engineering(trend.series.unit, max(abs(p.value) for p in trend.series.points))


# -------------------- drawing --------------------


def _svg(found: Monitored) -> str:
    with needs_extra("a control chart", "report", "matplotlib"):
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    rows = math.ceil(len(found.trends) / COLUMNS)
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "tumble", "font.size": 8.0, "date.converter": "concise"}):
        figure = Figure(figsize=(4.2 * COLUMNS, 0.4 + 2.5 * rows), layout="constrained")
        device = found.latest
        figure.suptitle(f"{device.serial} · {device.model or ''} · frame {found.frame}", parse_math=False)
        panels = list(figure.subplots(rows, COLUMNS, squeeze=False).flat)
        for axes, trend in zip(panels, found.trends, strict=False):
            _draw(axes, trend, found.limits.get(trend.series.name))
        for axes in panels[len(found.trends) :]:
            axes.remove()
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()


def _draw(axes: Axes, trend: Trend, limits: tuple[float, float] | None) -> None:
    """One parameter: points with U, limits with guard band, the line of the drift."""
    size, unit = _unit(trend)
    points = trend.series.points
    for state, marker in _MARKERS.items():
        own = [p for p in points if p.state == state]
        bars = [(expanded_of(p) or 0.0) / size for p in own]
        style: dict[str, Any] = {"fmt": marker, "markersize": 3.5, "color": "C0", "capsize": 2.0, "linewidth": 0.9}
        axes.errorbar(_times(p.performed for p in own), [p.value / size for p in own], yerr=bars, **style)
    _draw_drift(axes, trend, size)
    if limits is not None:
        guard = (expanded_of(points[-1]) or 0.0) / size
        for limit in (v / size for v in limits if math.isfinite(v)):
            axes.axhline(limit, color=_LIMIT_COLOUR, linewidth=1.0)
            axes.axhspan(limit - guard, limit + guard, color="0.85", linewidth=0.0, zorder=0.5)
    axes.set_title(trend.series.name, parse_math=False)
    axes.set_ylabel(unit, parse_math=False)
    axes.grid(visible=True, alpha=0.4, linewidth=0.5)


def _times(moments: Iterable[datetime]) -> npt.NDArray[np.datetime64]:
    return np.array([moment.replace(tzinfo=None) for moment in moments], dtype="datetime64[s]")


def _draw_drift(axes: Axes, trend: Trend, size: float) -> None:
    """The line of the last stretch."""
    points, drift = trend.series.points, trend.drift
    if drift is None:
        return
    adjusted = [i for i, p in enumerate(points) if i > 0 and p.state == "as-left"]
    stretch = points[adjusted[-1] if adjusted else 0 :]
    if len(stretch) < 2:
        return
    middle: timedelta = drift.since * YEAR
    ends = stretch[0].performed, stretch[-1].performed
    values = [drift.level + drift.per_year * ((t - points[0].performed - middle) / YEAR) for t in ends]
    axes.plot(_times(ends), [v / size for v in values], color="0.35", linewidth=0.9, linestyle="--")
