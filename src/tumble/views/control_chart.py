"""Control charts: every parameter over time with U and limits, as an SVG file or a self-contained HTML page.

The axis of values follows the data: a limit that is near is drawn, one that is not stands as a note in the margin.
Everything that comes from calibration files is escaped; the page loads nothing, and says so to the browser.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from tumble.errors import needs_extra
from tumble.files import ending_in, whole_file
from tumble.lab.conformity import RESULTS, RULE
from tumble.lab.registry.monitor import Monitored
from tumble.lab.registry.trend import YEAR, Trend
from tumble.lab.registry.types import STATES
from tumble.result.coverage import expanded_of
from tumble.sensors.parameters import group_name, named_group
from tumble.views.blocks import ChartPanel, Document, Items, Panels, Part, Section, Table, Text, Tone, section
from tumble.views.numbers import Units, device_name, limit_cell, minus
from tumble.views.registry import (
    TONES,
    change_lines,
    deviation_cell,
    drift_cells,
    forecast_lines,
    further_of,
    trend_row,
    units_of,
)
from tumble.views.render.characters import drawable
from tumble.views.render.pictures import COLOURS, GREY, INK, STYLE, for_a_page, grid, svg_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = (".html", ".svg")
COLUMNS = 3
_SIZE = 2.9, 1.95
"""Width and height of a picture, inches."""
MARKERS = dict(zip(STATES, ("v", "^", "o"), strict=True))
_COLOURS = {"good": "#22693d", "doubt": "#8a5a00", "bad": "#a32222"}
_LIMIT = _COLOURS["bad"]
_NEAR = 0.4
"""A limit is drawn where it is no further from the data than this part of their height."""
_MOST_DATES = 5
"""More would touch in a picture of this size."""
_LONGEST_BAR = 2.0
"""U decides the height of the picture up to so many times the spread of the values, or the usual U."""
_LETTERS_AS_TEXT: Any = STYLE | {"svg.fonttype": "none", "font.family": "sans-serif"}

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
    ending = ending_in(path, *FORMATS)
    with needs_extra("a control chart", "lab", "jinja2", "matplotlib", "typst"):
        text = _svg(found) if ending == ".svg" else _page(found)
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


# -------------------- the page --------------------


def _page(found: Monitored) -> str:
    from tumble.views.render.pages import page

    record, (verdict, tone) = found.latest, _badge(found)
    numbers = {p.number: p.performed for t in found.trends for p in t.series.points}
    drifting = next(iter(found.forecasts()), None)
    due = "no interval is known" if found.by_calendar is None else f"{found.by_calendar}, by the calendar"
    if drifting is not None and (found.by_calendar is None or drifting.earliest.date() < found.by_calendar):
        due = f"{drifting.earliest:%Y-%m-%d}, by the drift of {drifting.name}"
    facts = (
        ("device", record.serial),
        ("type", record.model or "not stated"),
        ("calibrations", f"{len(numbers)}, {min(numbers.values()):%Y-%m-%d} to {max(numbers.values()):%Y-%m-%d}"),
        ("latest record", str(record.number)),
        ("frame", found.frame),
        ("due", due),
    )
    units = units_of(found)
    sections = (
        section("What has changed", *_findings(found, units)),
        *_parts(found, units),
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


def _findings(found: Monitored, units: Units) -> Iterator[Items]:
    """What is to be said before all numbers."""
    changed, verdicts, forecasts = found.changed(), found.latest_verdicts(), forecast_lines(found)
    if changed:
        beyond = f"changed since the calibration before, by more than chance: {', '.join(changed)}"
        yield Items(items=(beyond,), tone="bad")
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
        rows: list[tuple[str, ...]] = []
        tones: list[tuple[Tone | Literal[""], ...]] = []
        panels: dict[str, list[ChartPanel]] = {}
        for trend in trends:
            name, change, unit = trend.series.name, trend.last_change, units[trend.series.name]
            row = trend_row(found, trend, unit)
            verdict, run_to_run = row["verdict"], row["run to run"]
            changed: Literal["", "bad"] = "bad" if change is not None and abs(change.e_n or 0.0) > 1.0 else ""
            limits = f"{row['lowest'] or '-∞'} … {row['highest'] or '∞'}" if name in found.limits else ""
            value, drift = _with_u(row["latest"], row["U"]), _with_u(row["drift/year"], row["U (95 %)"])
            rows.append((name, value, limits, run_to_run, drift, row["change"], row["E_n"], unit[1], verdict))
            tones.append(("", "", "", "", "", changed, changed, "", TONES.get(verdict, "")))
            words = []
            if trend.drift is not None and trend.drift.expanded is not None:
                words.append(f"drift {_drift(trend, *unit)}")
            if trend.run_to_run is not None:
                words.append(f"run to run {deviation_cell(trend.run_to_run, unit[0])} {unit[1]}")
            panels.setdefault(group_name(name), []).append(
                ChartPanel(
                    name=name,
                    verdict=verdict,
                    tone=TONES.get(verdict, ""),
                    svg=_picture(f"t{found.trends.index(trend)}", found, trend, unit),
                    caption="; ".join(words) or "drift not known yet",
                )
            )
        yield section(title, Table(columns=_NUMBERS, rows=tuple(rows), text=(0, 7, 8), tones=tuple(tones)))
        for group, of_group in panels.items():
            known = named_group(group)  # None for a name of another program
            title = group if known is None else known.words
            yield section(f"{title[:1].upper()}{title[1:]}", Panels(panels=tuple(of_group)))


def _with_u(value: str, u: str) -> str:
    """A value with its U."""
    return " ± ".join(filter(None, (value, u)))


def _drift(trend: Trend, size: float, unit: str) -> str:
    return f"{minus(_with_u(*drift_cells(trend, size)))} {unit} a year"


# -------------------- pictures --------------------


def _picture(name: str, found: Monitored, trend: Trend, unit: tuple[float, str]) -> str:
    """The picture of a parameter for the page; letters are text."""

    def draw(figure: Figure) -> None:
        limits = found.limits.get(trend.series.name)
        draw_panel(figure.add_subplot(), trend, limits, found.verdicts(trend), unit)

    return for_a_page(svg_of(_SIZE, draw, _LETTERS_AS_TEXT, {"Date": None}), name)


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

    size = _SIZE[0] * COLUMNS, 0.4 + 1.15 * _SIZE[1] * rows
    return svg_of(size, draw, _LETTERS_AS_TEXT, {"Date": None})


def draw_panel(
    axes: Axes, trend: Trend, limits: tuple[float, float] | None, verdicts: Mapping[int, str], unit: tuple[float, str]
) -> None:
    """Draw one parameter: values with U in the colour of their verdict, launches, limits with guard band, and the line
    of the drift; a ring where E_n is beyond 1, with it on the side from which the value did not come. `verdicts` are
    those on its records by number, `unit` the size and name of what is shown."""
    import matplotlib.dates

    made: Any = matplotlib.dates  # its classes have no types
    size, points = unit[0], trend.series.points
    values = np.array([p.value for p in points]) / size
    bars = np.array([0.0 if p.u is None else expanded_of(p.u, p.dof) or 0.0 for p in points]) / size
    low, high = _heights(values, bars, () if limits is None else tuple(limit / size for limit in limits))
    changed = {c.later: c.e_n for c in trend.changes if c.e_n is not None and abs(c.e_n) > 1.0 and not c.adjustment}
    for point, value, bar in zip(points, values.tolist(), bars.tolist(), strict=True):
        verdict, at = verdicts.get(point.number, ""), _times([point.performed])
        colour = COLOURS[0] if verdict in ("", "pass") else _COLOURS[TONES[verdict]]
        style: dict[str, Any] = {"markersize": 4.5, "color": colour, "capsize": 2.5, "linewidth": 1.0}
        axes.errorbar(at, [value], yerr=[bar], fmt=MARKERS[point.state], **style)
        if (e_n := changed.get(point.number)) is not None:
            axes.plot(at, [value], "o", markersize=10, fillstyle="none", color=_LIMIT, markeredgewidth=1.2)
            side, align = (-1, "right") if e_n > 0.0 else (1, "left")
            style = {"textcoords": "offset points", "ha": align, "fontsize": 7, "color": _LIMIT}
            axes.annotate(minus(f"Eₙ {e_n:+.1f}"), (at[0], value), xytext=(7 * side, 5), **style)
    for point in points:
        launches = [value / size for value, _ in point.launches]
        axes.plot(_times([point.performed] * len(launches)), launches, "_", markersize=4.0, color=GREY)
    _draw_drift(axes, trend, size)
    axes.set_ylim(low, high)
    notes, guard = [], float(bars[-1])
    for limit in filter(math.isfinite, limits or ()):
        at_limit = limit / size
        if low <= at_limit <= high:
            axes.axhline(at_limit, color=_LIMIT, linewidth=1.0)
            axes.axhspan(at_limit - guard, at_limit + guard, color=_LIMIT, alpha=0.08, linewidth=0.0, zorder=0.5)
        else:
            notes.append(minus(f"{limit_cell(limit, size)} {'↑' if at_limit > high else '↓'}"))
    if notes:
        outside = f"limit{'s' if len(notes) > 1 else ''} {'   '.join(notes)}"
        axes.set_title(outside, loc="right", fontsize=7, fontweight="normal", color=_LIMIT)
    axes.set_ylabel(drawable(unit[1]))
    dates = made.AutoDateLocator(minticks=2, maxticks=_MOST_DATES)
    axes.xaxis.set(major_locator=dates, major_formatter=made.ConciseDateFormatter(dates))
    axes.margins(x=0.08)
    grid(axes)


def _heights(
    values: npt.NDArray[np.float64], bars: npt.NDArray[np.float64], limits: tuple[float, ...]
) -> tuple[float, float]:
    """The lowest and the highest value shown."""
    longest = _LONGEST_BAR * max(float(np.ptp(values)), float(np.median(bars)))
    shown = np.minimum(bars, longest)
    low, high = float((values - shown).min()), float((values + shown).max())
    height = (high - low) or abs(high) or 1.0
    near = [limit for limit in limits if low - _NEAR * height <= limit <= high + _NEAR * height]
    low, high = min([low, *near]), max([high, *near])
    margin = 0.1 * ((high - low) or height)
    return low - margin, high + margin


def _draw_drift(axes: Axes, trend: Trend, size: float) -> None:
    """The line of the last stretch, and dotted ones at adjustments."""
    points, drift = trend.series.points, trend.drift
    adjusted = [i for i, p in enumerate(points) if i > 0 and p.state == "as-left"]
    for i in adjusted:
        axes.axvline(_times([points[i].performed])[0], color=GREY, linewidth=0.6, linestyle=":")
    stretch = points[adjusted[-1] if adjusted else 0 :]
    if drift is None or len(stretch) < 2:
        return
    middle = points[0].performed + drift.since * YEAR
    ends = stretch[0].performed, stretch[-1].performed
    values = [(drift.level + drift.per_year * ((t - middle) / YEAR)) / size for t in ends]
    axes.plot(_times(ends), values, color=INK, linewidth=0.9, linestyle="--")


def _times(moments: Iterable[datetime]) -> npt.NDArray[np.datetime64]:
    return np.array([moment.replace(tzinfo=None) for moment in moments], dtype="datetime64[s]")
