"""A parameter over time as a picture: values with U, launches, limits with guard band, and the line of the drift.

The axis of values follows the data. A limit that is near is drawn; one that is not stands as a note in the margin.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tumble.registry.trend import YEAR, Trend
from tumble.registry.types import STATES
from tumble.views.numbers import limit_cell, minus
from tumble.views.registry import TONES, expanded_of
from tumble.views.render.characters import drawable
from tumble.views.render.pictures import COLOURS, GREY, INK, grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARKERS = dict(zip(STATES, ("v", "^", "o"), strict=True))
_COLOURS = {"good": "#22693d", "doubt": "#8a5a00", "bad": "#a32222"}
_LIMIT = _COLOURS["bad"]
_NEAR = 0.4
"""A limit is drawn where it is no further from the data than this part of their height."""
_MOST_DATES = 5
"""More would touch in a picture of this size."""
_LONGEST_BAR = 2.0
"""U decides the height of the picture up to so many times the spread of the values, or the usual U."""


def draw_panel(
    axes: Axes, trend: Trend, limits: tuple[float, float] | None, verdicts: Mapping[int, str], unit: tuple[float, str]
) -> None:
    """Draw one parameter; `verdicts` are those on its records by number, `unit` the size and name of what is shown."""
    import matplotlib.dates

    made: Any = matplotlib.dates  # its classes have no types
    size, name = unit
    values = np.array([p.value for p in trend.series.points]) / size
    bars = np.array([expanded_of(p) or 0.0 for p in trend.series.points]) / size
    low, high = _heights(values, bars, () if limits is None else tuple(limit / size for limit in limits))
    _draw_points(axes, trend, verdicts, values, bars)
    for point in trend.series.points:
        launches = [value / size for value, _ in point.launches]
        axes.plot(_times([point.performed] * len(launches)), launches, "_", markersize=4.0, color=GREY)
    _draw_drift(axes, trend, size)
    axes.set_ylim(low, high)
    if limits is not None:
        _draw_limits(axes, limits, float(bars[-1]), size)
    axes.set_ylabel(drawable(name))
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


def _draw_points(
    axes: Axes,
    trend: Trend,
    verdicts: Mapping[int, str],
    values: npt.NDArray[np.float64],
    bars: npt.NDArray[np.float64],
) -> None:
    """Values with U, in the colour of their verdict; rings where E_n is beyond 1, with it beside the value on the side
    from which it did not come."""
    changed = {c.later: c.e_n for c in trend.changes if c.e_n is not None and abs(c.e_n) > 1.0 and not c.adjustment}
    for point, value, bar in zip(trend.series.points, values.tolist(), bars.tolist(), strict=True):
        verdict, at = verdicts.get(point.number, ""), _times([point.performed])
        colour = COLOURS[0] if verdict in ("", "pass") else _COLOURS[TONES[verdict]]
        style: dict[str, Any] = {"markersize": 4.5, "color": colour, "capsize": 2.5, "linewidth": 1.0}
        axes.errorbar(at, [value], yerr=[bar], fmt=MARKERS[point.state], **style)
        if (e_n := changed.get(point.number)) is None:
            continue
        axes.plot(at, [value], "o", markersize=10, fillstyle="none", color=_LIMIT, markeredgewidth=1.2)
        side, align = (-1, "right") if e_n > 0.0 else (1, "left")
        style = {"textcoords": "offset points", "ha": align, "fontsize": 7, "color": _LIMIT}
        axes.annotate(minus(f"Eₙ {e_n:+.1f}"), (at[0], value), xytext=(7 * side, 5), **style)


def _draw_limits(axes: Axes, limits: tuple[float, float], guard: float, size: float) -> None:
    """Limits with their guard band where they are in the picture, else as notes."""
    low, high = axes.get_ylim()
    notes = []
    for limit in filter(math.isfinite, limits):
        at = limit / size
        if low <= at <= high:
            axes.axhline(at, color=_LIMIT, linewidth=1.0)
            axes.axhspan(at - guard, at + guard, color=_LIMIT, alpha=0.08, linewidth=0.0, zorder=0.5)
        else:
            notes.append(minus(f"{limit_cell(limit, size)} {'↑' if at > high else '↓'}"))
    if notes:
        said = f"limit{'s' if len(notes) > 1 else ''} {'   '.join(notes)}"
        axes.set_title(said, loc="right", fontsize=7, fontweight="normal", color=_LIMIT)


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
