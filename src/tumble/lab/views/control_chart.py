"""A control chart: the parameters of a device over time with U and limits, as a self-contained HTML page.

The axis of values follows the data: a limit that is near is drawn, one that is not stands as a note in the margin.
Everything that comes from calibration files is escaped; the page loads nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tumble.files import ending_in, whole_file
from tumble.lab.conformity import RESULTS, RULE, Result
from tumble.lab.registry.records import STATES
from tumble.lab.registry.trend import YEAR, ParameterTrend, Trend
from tumble.lab.views.registry import (
    TONES,
    calibrations_of,
    change_lines,
    deviation_cell,
    drift_cells,
    forecast_lines,
    further_of,
    trend_table,
    units_of,
)
from tumble.result.coverage import expanded_of
from tumble.sensors.parameters import group_name, named_group
from tumble.views.blocks import ChartPanel, Document, Items, Panels, Part, Section, Text, Tone, section
from tumble.views.numbers import limit_cell, minus
from tumble.views.render.characters import drawable
from tumble.views.render.pages import page
from tumble.views.render.pictures import COLOURS, GREY, INK, STYLE, for_a_page, grid, svg_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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


def write_chart(path: Path, found: Trend) -> None:
    """Write the control chart of a device.

    Raises InputError for another ending than .html, MissingExtraError without matplotlib."""
    ending_in(path, ".html")
    text = page(_document(found))
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _document(found: Trend) -> Document:
    verdict, tone = _badge(found)
    facts = (
        ("device", found.latest.serial),
        ("type", found.latest.model or "not stated"),
        ("calibrations", calibrations_of(found)),
        ("latest record", str(found.latest.number)),
        ("frame", found.frame),
    )
    sections = (
        section("What has changed", *_findings(found)),
        *_parts(found),
        section("How to read the pictures", *(Text(text=note, tone="small") for note in _NOTES)),
    )
    return Document(
        title="Control chart",
        device=found.latest.serial,
        tone=tone,
        verdict=verdict,
        facts=facts,
        parts=(Part(title="", sections=sections),),
        closing="End of the control chart",
    )


def _badge(found: Trend) -> tuple[str, Tone]:
    """One verdict: the worst on the latest values, or that the device has changed; and its colour."""
    worst = next((each for each in RESULTS if each in found.latest_verdicts.values()), None)
    if worst != "fail" and found.changed:
        return "changed", "bad"
    if worst is not None:
        return worst, TONES[worst]
    several = any(len(trend.points) > 1 for trend in found.parameters)
    return ("no change beyond chance", "good") if several else ("nothing to compare with yet", "doubt")


def _findings(found: Trend) -> Iterator[Items]:
    """What the numbers say, in sentences."""
    if found.changed:
        beyond = f"changed since the calibration before, by more than chance: {', '.join(found.changed)}"
        yield Items(items=(beyond,), tone="bad")
    for result in RESULTS[:-1]:
        names = [name for name, verdict in found.latest_verdicts.items() if verdict == result]
        if names:
            yield Items(items=(f"{result}: {', '.join(names)}",), tone=TONES[result])
    lines = (*change_lines(found), *forecast_lines(found))
    yield Items(items=lines or ("one calibration: nothing to compare with yet",))


def _parts(found: Trend) -> Iterator[Section]:
    """Numbers and pictures of bias, scale and axes and of what has limits or has changed; then those of all else."""
    kept, units = {*found.limits, *found.changed}, units_of(found)
    further = further_of((trend.name for trend in found.parameters), kept)
    for title, beyond in (("The latest calibration", False), ("All other parameters", True)):
        trends = [trend for trend in found.parameters if (trend.name in further) == beyond]
        if trends:
            yield section(title, trend_table(found, trends))
        panels: dict[str, list[ChartPanel]] = {}
        for trend in trends:
            panels.setdefault(group_name(trend.name), []).append(_panel(found, trend, *units[trend.name]))
        for group, of_group in panels.items():
            known = named_group(group)  # None for a name of another program
            words = group if known is None else known.words
            yield section(f"{words[:1].upper()}{words[1:]}", Panels(panels=tuple(of_group)))


def _panel(found: Trend, trend: ParameterTrend, size: float, unit: str) -> ChartPanel:
    """The picture of a parameter, whose letters are text, with the verdict, drift and run to run."""

    def draw(figure: Figure) -> None:
        draw_panel(figure.add_subplot(), trend, found.limits.get(trend.name), found.verdicts(trend), (size, unit))

    words = []
    if trend.drift is not None and trend.drift.expanded is not None:
        words.append(minus(f"drift {' ± '.join(drift_cells(trend, size))} {unit} a year"))
    if trend.run_to_run is not None:
        words.append(f"run to run {deviation_cell(trend.run_to_run, size)} {unit}")
    verdict = found.latest_verdicts.get(trend.name)
    return ChartPanel(
        name=trend.name,
        verdict=verdict or "",
        tone="" if verdict is None else TONES[verdict],
        svg=for_a_page(svg_of(_SIZE, draw, _LETTERS_AS_TEXT, {"Date": None}), f"t{found.parameters.index(trend)}"),
        caption="; ".join(words) or "drift not known yet",
    )


# -------------------- pictures --------------------


def draw_panel(
    axes: Axes,
    trend: ParameterTrend,
    limits: tuple[float, float] | None,
    verdicts: Mapping[int, Result],
    unit: tuple[float, str],
) -> None:
    """Draw one parameter: values with U in the colour of their verdict, launches, limits with guard band, and the line
    of the drift; a ring where E_n is beyond 1, with it on the side from which the value did not come. `verdicts` are
    those on its records by number, `unit` the size and name of what is shown."""
    import matplotlib.dates

    made: Any = matplotlib.dates  # its classes have no types
    size, points = unit[0], trend.points
    values = np.array([p.value for p in points]) / size
    bars = np.array([0.0 if p.u is None else expanded_of(p.u, p.dof) or 0.0 for p in points]) / size
    low, high = _heights(values, bars, () if limits is None else tuple(limit / size for limit in limits))
    changed = {c.later: c.e_n for c in trend.changes if c.e_n is not None and abs(c.e_n) > 1.0 and not c.adjustment}
    for point, value, bar in zip(points, values.tolist(), bars.tolist(), strict=True):
        verdict, at = verdicts.get(point.number, "pass"), _times([point.performed])
        colour = COLOURS[0] if verdict == "pass" else _COLOURS[TONES[verdict]]
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


def _draw_drift(axes: Axes, trend: ParameterTrend, size: float) -> None:
    """The line of the last stretch, and dotted ones at adjustments."""
    points, drift = trend.points, trend.drift
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
