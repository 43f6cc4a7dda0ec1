"""Control charts: every parameter over time with U and limits, as an SVG file or a self-contained HTML page.

Everything that comes from calibration files is escaped; the page loads nothing, and says so to the browser.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tumble.acceptance.conformity import RESULTS, RULE
from tumble.errors import InputError, needs_extra
from tumble.files import whole_file
from tumble.registry.monitor import Monitored
from tumble.registry.trend import Trend
from tumble.sensors.parameters import group_name, named_group
from tumble.views.blocks import ChartPanel, Document, Items, Panels, Part, Section, Table, Text, Tone, section
from tumble.views.chart_panel import draw_panel
from tumble.views.numbers import Units, cells, device_name, limit_cell, minus
from tumble.views.registry import (
    TONES,
    change_cells,
    change_lines,
    deviation_cell,
    drift_cells,
    expanded_of,
    forecast_lines,
    further_of,
    units_of,
)
from tumble.views.render.characters import drawable
from tumble.views.render.pictures import STYLE, for_a_page, svg_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = (".html", ".svg")
COLUMNS = 3
_SIZE = 2.9, 1.95
"""Width and height of a picture, inches."""

_NUMBERS = ("parameter", "latest ± U", "limits", "run to run", "drift/year ± U", "change", "Eₙ", "unit", "verdict")

_NOTES = (
    "Points: value with U (95.45 %), ▼ as found, ▲ as left after an adjustment (dotted line), ● without one; blue: "
    "pass of the limits of the periodic check or without any, brown: conditional pass, red: otherwise. Dashes beside a "
    "point: its launches. A bar of U that would make the rest too small to see runs out of the picture.",
    "Red line: a limit, with the guard band of the latest U; a limit far from the values stands as a note in the "
    "margin. Dashed line: the drift since the last adjustment, by weighted least squares with the instability from run "
    "to run.",
    "Change: the latest as found against the last as left, without what both share. A ring: Eₙ beyond 1 in size, the "
    "two contradict each other by more than 95.45 % allow; of 21 parameters that do not change one does so by chance.",
    f"{RULE[0].upper()}{RULE[1:]}.",
)


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
    from tumble.views.render.page import page

    record, (verdict, tone) = found.latest, _badge(found)
    numbers = {p.number: p.performed for t in found.trends for p in t.series.points}
    facts = (
        ("device", record.serial),
        ("type", record.model or "not stated"),
        ("calibrations", f"{len(numbers)}, {min(numbers.values()):%Y-%m-%d} to {max(numbers.values()):%Y-%m-%d}"),
        ("latest record", str(record.number)),
        ("frame", found.frame),
        ("due", _due(found)),
    )
    sections = (
        section("What has changed", *_findings(found)),
        *_parts(found, units_of(found)),
        section("How to read the pictures", *(Text(text=note, tone="small") for note in _NOTES)),
    )
    document = Document(
        title="Control chart",
        device=device_name(record.serial, record.model),
        tone=tone,
        verdict=verdict,
        facts=facts,
        parts=(Part(title="", sections=sections),),
        closing="End of the control chart",
    )
    return page(document)


def _badge(found: Monitored) -> tuple[str, Tone]:
    """One verdict: the worst on the latest values, or that the device has changed; and its colour."""
    verdicts = set(found.latest_verdicts().values())
    worst = next((each for each in RESULTS if each in verdicts), None)
    if worst != "fail" and found.changed():
        return "changed", "bad"
    if worst is not None:
        return worst, TONES[worst]
    several = any(len(trend.series.points) > 1 for trend in found.trends)
    return ("no change beyond chance", "good") if several else ("nothing to compare with yet", "doubt")


def _due(found: Monitored) -> str:
    """When the next calibration is due, and why."""
    drifting = next(iter(found.forecasts()), None)
    if drifting is not None and (found.by_calendar is None or drifting.earliest.date() < found.by_calendar):
        return f"{drifting.earliest:%Y-%m-%d}, by the drift of {drifting.name}"
    return "no interval is known" if found.by_calendar is None else f"{found.by_calendar}, by the calendar"


def _findings(found: Monitored) -> Iterator[Items]:
    """What is to be said before all numbers."""
    changed, verdicts, forecasts = found.changed(), found.latest_verdicts(), forecast_lines(found)
    units = units_of(found)
    if changed:
        said = f"changed since the calibration before, by more than chance: {', '.join(changed)}"
        yield Items(items=(said,), tone="bad")
    lines = [] if found.comparison is None else change_lines(found.comparison)
    if drifting := found.drifting():
        which = "; ".join(f"{trend.series.name} {_drift(trend, *units[trend.series.name])}" for trend in drifting)
        lines.append(f"drifts beyond their U: {which}")
    if lines:
        yield Items(items=tuple(lines))
    for result in RESULTS[:-1]:
        names = [name for name, verdict in verdicts.items() if verdict == result]
        if names:
            yield Items(items=(f"{result}: {', '.join(names)}",), tone=TONES[result])
    if verdicts and not forecasts:
        forecasts = ["forecast: no parameter drifts towards a limit by more than the U of its drift"]
    if not (changed or lines or verdicts):
        forecasts = ["one calibration: nothing to compare with yet"]
    if forecasts:
        yield Items(items=tuple(forecasts))


def _parts(found: Monitored, units: Units) -> Iterator[Section]:
    """Numbers and pictures of bias, scale and axes and of what has limits or has changed; then those of all else."""
    kept = {*found.limits, *found.changed()}
    further = further_of((trend.series.name for trend in found.trends), kept)
    for title, beyond in (("The latest calibration", False), ("All other parameters", True)):
        trends = [trend for trend in found.trends if (trend.series.name in further) == beyond]
        if not trends:
            continue
        yield section(title, _number_table(found, trends, units))
        by_group: dict[str, list[ChartPanel]] = {}
        for trend in trends:
            panel = _panel(f"t{found.trends.index(trend)}", found, trend, units[trend.series.name])
            by_group.setdefault(group_name(trend.series.name), []).append(panel)
        for group, panels in by_group.items():
            known = named_group(group)  # None for a name of another program
            title = group if known is None else known.words
            yield section(f"{title[:1].upper()}{title[1:]}", Panels(panels=tuple(panels)))


def _number_table(found: Monitored, trends: Sequence[Trend], units: Units) -> Table:
    rows: list[tuple[str, ...]] = []
    tones: list[tuple[Tone | Literal[""], ...]] = []
    for trend in trends:
        name, latest, change = trend.series.name, trend.series.points[-1], trend.last_change
        (size, unit), verdict = units[name], found.latest_verdicts().get(name, "")
        changed: Literal["", "bad"] = "bad" if change is not None and abs(change.e_n or 0.0) > 1.0 else ""
        limits = ""
        if name in found.limits:
            low, high = (limit_cell(limit, size) for limit in found.limits[name])
            limits = f"{low or '-∞'} … {high or '∞'}"
        value, drift = _with_u(cells(latest.value, expanded_of(latest), size)), _with_u(drift_cells(trend, size))
        run_to_run = deviation_cell(trend.run_to_run, size)
        rows.append((name, value, limits, run_to_run, drift, *change_cells(change, size), unit, verdict))
        tones.append(("", "", "", "", "", changed, changed, "", TONES.get(verdict, "")))
    return Table(columns=_NUMBERS, rows=tuple(rows), text=(0, 7, 8), tones=tuple(tones))


def _with_u(pair: tuple[str, str]) -> str:
    """A value with its U."""
    return " ± ".join(filter(None, pair))


def _panel(name: str, found: Monitored, trend: Trend, unit: tuple[float, str]) -> ChartPanel:
    said, verdict = [], found.latest_verdicts().get(trend.series.name, "")
    if trend.drift is not None and trend.drift.expanded is not None:
        said.append(f"drift {_drift(trend, *unit)}")
    if trend.run_to_run is not None:
        said.append(f"run to run {deviation_cell(trend.run_to_run, unit[0])} {unit[1]}")
    return ChartPanel(
        name=trend.series.name,
        verdict=verdict,
        tone=TONES.get(verdict, ""),
        svg=_picture(name, found, trend, unit),
        caption="; ".join(said) or "drift not known yet",
    )


def _drift(trend: Trend, size: float, unit: str) -> str:
    return f"{minus(_with_u(drift_cells(trend, size)))} {unit} a year"


# -------------------- pictures --------------------

_LETTERS_AS_TEXT: Any = STYLE | {"svg.fonttype": "none", "font.family": "sans-serif"}


def _picture(name: str, found: Monitored, trend: Trend, unit: tuple[float, str]) -> str:
    """The picture of a parameter for the page."""

    def draw(figure: Figure) -> None:
        limits = found.limits.get(trend.series.name)
        draw_panel(figure.add_subplot(), trend, limits, found.verdicts(trend), unit)

    return for_a_page(_saved(_SIZE, draw), name)


def _svg(found: Monitored) -> str:
    """All pictures in one."""
    rows, units, device = math.ceil(len(found.trends) / COLUMNS), units_of(found), found.latest

    def draw(figure: Figure) -> None:
        figure.suptitle(drawable(f"{device.serial} · {device.model or ''} · frame {found.frame}"), parse_math=False)
        panels = list(figure.subplots(rows, COLUMNS, squeeze=False).flat)
        for axes, trend in zip(panels, found.trends, strict=False):
            name = trend.series.name
            draw_panel(axes, trend, found.limits.get(name), found.verdicts(trend), units[name])
            axes.set_title(drawable(name), parse_math=False)
        for axes in panels[len(found.trends) :]:
            axes.remove()

    return _saved((_SIZE[0] * COLUMNS, 0.4 + 1.15 * _SIZE[1] * rows), draw)


def _saved(size: tuple[float, float], draw: Callable[[Figure], None]) -> str:
    """The SVG of a picture of this size, inches, that `draw` fills; letters are text."""
    return svg_of(size, draw, _LETTERS_AS_TEXT, {"Date": None})
