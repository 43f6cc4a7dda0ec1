"""Control charts: every parameter over time with U and limits, as an SVG file or a self-contained HTML page.

Everything that comes from calibration files is escaped; the page loads nothing, and says so to the browser.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tumble.acceptance.conformity import RESULTS, RULE
from tumble.errors import InputError, needs_extra
from tumble.files import whole_file
from tumble.registry.monitor import Monitored
from tumble.registry.trend import Trend
from tumble.report.limits import TONES
from tumble.report.numbers import minus
from tumble.sensors.parameters import group_name, group_of
from tumble.terminal.registry import (
    change_cells,
    change_lines,
    drift_cells,
    expanded_of,
    forecast_lines,
    further_of,
    limit_cell,
    significant,
    units_of,
    with_expanded,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = (".html", ".svg")
COLUMNS = 3
_SIZE = 2.9, 1.95
"""Width and height of a picture, inches."""

_COLUMNS = ("parameter", "latest ± U", "limits", "run to run", "drift/year ± U", "change", "Eₙ", "unit", "verdict")

_NOTES = (
    "Points: value with U (95.45 %), ▼ as found, ▲ as left after an adjustment (dotted line), ● without one; blue: "
    "pass of the limits of the periodic check or without any, brown: conditional pass, red: otherwise. Dashes beside a "
    "point: its launches. A bar of U that would make the rest too small to see runs out of the picture.",
    "Red line: a limit, with the guard band of the latest U; a limit far from the values stands as a note in the "
    "margin. Dashed line: the drift since the last adjustment, by weighted least squares with the instability from run "
    "to run.",
    "Change: the latest as found against the last as left, without what both share. A ring: Eₙ beyond 1 in size, the "
    "two contradict each other by more than 95.45 % allow; of 21 parameters that do not change one does so by chance.",
)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Cell:
    text: str
    tone: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class _Panel:
    name: str
    verdict: str
    tone: str
    svg: str
    caption: str


@dataclass(frozen=True, kw_only=True, slots=True)
class _Part:
    """A section: the numbers of parameters in rows, or their pictures."""

    title: str
    rows: tuple[list[_Cell], ...] = ()
    panels: tuple[_Panel, ...] = ()


def write_chart(path: Path, found: Monitored) -> None:
    """Write the control charts of the parameters of a device.

    Raises InputError for another ending than .html and .svg, MissingExtraError without matplotlib."""
    ending = path.suffix.lower()
    if ending not in FORMATS:
        raise InputError(f"{path}: expected a file that ends in {' or '.join(FORMATS)}, found {path.suffix!r}")
    with needs_extra("a control chart", "report", "matplotlib"):
        text = _svg(found) if ending == ".svg" else _page(found)
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


# -------------------- the page --------------------


def _page(found: Monitored) -> str:
    from tumble.report.page import rendered

    record, units = found.latest, units_of(found)
    verdict, tone = _badge(found)
    numbers = {p.number: p.performed for t in found.trends for p in t.series.points}
    facts = [
        ("device", record.serial),
        ("type", record.model or "not stated"),
        ("calibrations", f"{len(numbers)}, {min(numbers.values()):%Y-%m-%d} to {max(numbers.values()):%Y-%m-%d}"),
        ("latest record", str(record.number)),
        ("frame", found.frame),
        ("due", _due(found)),
    ]
    chart = {
        "title": "Control chart",
        "device": record.serial,
        "verdict": verdict,
        "tone": tone,
        "facts": facts,
        "findings": _findings(found),
        "columns": _COLUMNS,
        "words": (0, 7, 8),
        "parts": _parts(found, units),
        "notes": (*_NOTES, f"{RULE[0].upper()}{RULE[1:]}."),
        "closing": "End of the control chart",
    }
    return rendered("chart.html", chart=chart)


def _badge(found: Monitored) -> tuple[str, str]:
    """One verdict: the worst on the latest values, or that the device has changed; and its colour."""
    verdicts = set(found.latest_verdicts().values())
    worst = next((each for each in RESULTS if each in verdicts), None)
    if worst == "fail":
        return "fail", "bad"
    if found.changed():
        return "changed", "bad"
    if worst is not None:
        return worst, TONES[worst]
    several = any(len(trend.series.points) > 1 for trend in found.trends)
    return ("no change beyond chance", "good") if several else ("nothing to compare with yet", "doubt")


def _due(found: Monitored) -> str:
    """When the next calibration is due, and why."""
    drifting = next(iter(found.forecasts()), None)
    by_calendar = found.by_calendar
    if drifting is not None and (by_calendar is None or drifting.earliest.date() < by_calendar):
        return f"{drifting.earliest:%Y-%m-%d}, by the drift of {drifting.name}"
    return "no interval is known" if by_calendar is None else f"{by_calendar}, by the calendar"


def _findings(found: Monitored) -> list[_Cell]:
    """What is to be said before all numbers."""
    said = []
    changed = found.changed()
    if changed:
        which = ", ".join(changed)
        said.append(_Cell(text=f"changed since the calibration before, by more than chance: {which}", tone="bad"))
    if found.comparison is not None:
        said += [_Cell(text=line) for line in change_lines(found.comparison)]
    if drifting := found.drifting():
        units = units_of(found)
        which = "; ".join(f"{trend.series.name} {_drift(trend, *units[trend.series.name])}" for trend in drifting)
        said.append(_Cell(text=f"drifts beyond their U: {which}"))
    verdicts = found.latest_verdicts()
    for result in RESULTS[:-1]:
        names = [name for name, verdict in verdicts.items() if verdict == result]
        if names:
            said.append(_Cell(text=f"{result}: {', '.join(names)}", tone=TONES[result]))
    forecasts = forecast_lines(found)
    said += [_Cell(text=line) for line in forecasts]
    if verdicts and not forecasts:
        said.append(_Cell(text="forecast: no parameter drifts towards a limit by more than the U of its drift"))
    return said or [_Cell(text="one calibration: nothing to compare with yet")]


def _row(found: Monitored, trend: Trend, size: float, unit: str) -> list[_Cell]:
    latest = trend.series.points[-1]
    limits = found.limits.get(trend.series.name)
    verdict = found.latest_verdicts().get(trend.series.name, "")
    change, e_n = change_cells(trend.last_change, size)
    beyond = trend.last_change is not None and abs(trend.last_change.e_n or 0.0) > 1.0
    return [
        _Cell(text=trend.series.name),
        _Cell(text=_with(with_expanded(latest.value, expanded_of(latest), size))),
        _Cell(text="" if limits is None else _between(limits, size)),
        _Cell(text=significant(trend.run_to_run, size)),
        _Cell(text=_with(drift_cells(trend, size))),
        _Cell(text=minus(change), tone="bad" if beyond else ""),
        _Cell(text=minus(e_n), tone="bad" if beyond else ""),
        _Cell(text=unit),
        _Cell(text=verdict, tone=TONES.get(verdict, "")),
    ]


def _with(cells: list[str]) -> str:
    """A value with its U."""
    value, expanded = cells
    return minus(f"{value} ± {expanded}" if expanded else value)


def _between(limits: tuple[float, float], size: float) -> str:
    low, high = (minus(limit_cell(limit, size)) for limit in limits)
    return f"{low or '−∞'} … {high or '∞'}"


def _parts(found: Monitored, units: Mapping[str, tuple[float, str]]) -> list[_Part]:
    """Numbers and pictures of bias, scale and axes and of what has limits or has changed; then those of all else."""
    kept = {*found.limits, *found.changed()}
    further = further_of((trend.series.name for trend in found.trends), kept)
    last = [trend for trend in found.trends if trend.series.name in further]
    first = [trend for trend in found.trends if trend.series.name not in further]
    parts = []
    for title, trends in (("The latest calibration", first), ("All other parameters", last)):
        if trends:
            rows = tuple(_row(found, trend, *units[trend.series.name]) for trend in trends)
            parts += [_Part(title=title, rows=rows), *_pictures(found, trends, units)]
    return parts


def _pictures(found: Monitored, trends: Sequence[Trend], units: Mapping[str, tuple[float, str]]) -> list[_Part]:
    """The pictures by group of parameters."""
    names = dict.fromkeys(group_name(trend.series.name) for trend in trends)
    panels = {name: list[_Panel]() for name in names}
    for trend in trends:
        name = trend.series.name
        panels[group_name(name)].append(_panel(f"t{found.trends.index(trend)}", found, trend, units[name]))
    return [_Part(title=_title(name), panels=tuple(own)) for name, own in panels.items()]


def _title(group: str) -> str:
    try:
        words = group_of(group).words
    except KeyError:  # a name of another program
        words = group
    return words[:1].upper() + words[1:]


def _panel(name: str, found: Monitored, trend: Trend, unit: tuple[float, str]) -> _Panel:
    verdict = found.latest_verdicts().get(trend.series.name, "")
    return _Panel(
        name=trend.series.name,
        verdict=verdict,
        tone=TONES.get(verdict, ""),
        svg=_picture(name, found, trend, unit),
        caption=_caption(trend, *unit),
    )


def _caption(trend: Trend, size: float, unit: str) -> str:
    said = []
    if trend.drift is not None and trend.drift.expanded is not None:
        said.append(f"drift {_drift(trend, size, unit)}")
    if trend.run_to_run is not None:
        said.append(f"run to run {significant(trend.run_to_run, size)} {unit}")
    return "; ".join(said) or "drift not known yet"


def _drift(trend: Trend, size: float, unit: str) -> str:
    return f"{_with(drift_cells(trend, size))} {unit} a year"


# -------------------- pictures --------------------


def _style() -> Any:
    """The style of a report, with letters as text."""
    from tumble.report.figures import STYLE

    return STYLE | {"svg.fonttype": "none", "font.family": "sans-serif"}


def _picture(name: str, found: Monitored, trend: Trend, unit: tuple[float, str]) -> str:
    """The picture of a parameter for the page."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    from tumble.report.chart_panel import draw_panel
    from tumble.report.figures import for_a_page

    with rc_context(_style()):
        figure = Figure(figsize=_SIZE, layout="constrained")
        limits = found.limits.get(trend.series.name)
        draw_panel(figure.add_subplot(), trend, limits, found.verdicts(trend), unit)
        return for_a_page(_saved(figure), name)


def _svg(found: Monitored) -> str:
    """All pictures in one."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    from tumble.report.characters import drawable
    from tumble.report.chart_panel import draw_panel

    rows, units = math.ceil(len(found.trends) / COLUMNS), units_of(found)
    with rc_context(_style()):
        figure = Figure(figsize=(_SIZE[0] * COLUMNS, 0.4 + 1.15 * _SIZE[1] * rows), layout="constrained")
        device = found.latest
        figure.suptitle(drawable(f"{device.serial} · {device.model or ''} · frame {found.frame}"), parse_math=False)
        panels = list(figure.subplots(rows, COLUMNS, squeeze=False).flat)
        for axes, trend in zip(panels, found.trends, strict=False):
            name = trend.series.name
            draw_panel(axes, trend, found.limits.get(name), found.verdicts(trend), units[name])
            axes.set_title(drawable(name), parse_math=False)
        for axes in panels[len(found.trends) :]:
            axes.remove()
        return _saved(figure)


def _saved(figure: Figure) -> str:
    out = io.StringIO()
    figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()
