"""Figures of a report: where the vertical was in the body at each rest, and residuals.

The sphere is orthographic, seen from a fixed direction; picture coordinates are x right, y up, z towards the viewer.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tumble.inference.estimate import FIT_SIGMAS
from tumble.result.accepted import accepted_kinds
from tumble.result.calibration import Calibration
from tumble.result.correction import session_rate
from tumble.result.further import linear_parameters
from tumble.result.parts import RestResult, TurnResult
from tumble.sensors.model import WORDS
from tumble.sensors.parameters import group_name, sensor_kind, within_kind
from tumble.units import DEGREE, G_STANDARD, Array, engineering
from tumble.views.render.pictures import COLOURS, FAINT, GREY, INK, PAGE, drawn, grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SPHERE = 0.66
"""Width of the drawing as a part of the page."""

_SAME = 8.0 * DEGREE
"""Directions so near to each other are labelled together."""

_MOST_NUMBERS = 20
"""More rests than these are not numbered in the picture."""

_MOST_TICKS = 25
"""Rests that are numbered below a figure."""

_CIRCLE = np.linspace(0.0, 2.0 * math.pi, 181)

_AZIMUTH, _ABOVE = 32.0 * DEGREE, 24.0 * DEGREE
_TOWARDS = np.array([math.cos(_AZIMUTH) * math.cos(_ABOVE), math.sin(_AZIMUTH) * math.cos(_ABOVE), math.sin(_ABOVE)])
"""From the body to a viewer at this azimuth, from X towards Y, and elevation."""
_RIGHT = np.array([-math.sin(_AZIMUTH), math.cos(_AZIMUTH), 0.0])
FRONT = np.stack([_RIGHT, np.cross(_TOWARDS, _RIGHT), _TOWARDS])
"""Body → picture (right, up, towards the viewer)."""
BACK = np.diag([-1.0, 1.0, -1.0]) @ FRONT
"""The other side of the sphere, seen after half a turn about the vertical of the picture."""


def sphere(name: str, verticals: Array, nominal: Array) -> str:
    """Both sides of the sphere of directions in the body with the vertical (N, 3) of every rest, by its number, and
    those of the programme (M, 3)."""
    together: list[list[int]] = []  # rests in groups whose directions are nearly one
    for i, direction in enumerate(verticals):
        near = [group for group in together if float(verticals[group[0]] @ direction) > math.cos(_SAME)]
        if near:
            near[0].append(i)
        else:
            together.append([i])

    def draw(figure: Figure) -> None:
        for axes, view, title in zip(figure.subplots(1, 2), (FRONT, BACK), ("front", "back"), strict=True):
            axes.set(aspect="equal", xlim=(-1.3, 1.3), ylim=(-1.22, 1.22))
            axes.set_axis_off()
            axes.set_title(title, loc="center", fontweight="normal", color=GREY)
            _globe(axes, view)
            if len(nominal):
                positions, ring = _in_front(nominal @ view.T), {"markeredgecolor": COLOURS[1], "markeredgewidth": 0.9}
                axes.plot(*positions, "o", label="programme", markerfacecolor="none", markersize=9, **ring)
            rests = verticals @ view.T
            axes.plot(*_in_front(rests), "o", color=COLOURS[0], markersize=3.5, label="vertical at a rest")
            for members in together if len(verticals) <= _MOST_NUMBERS else ():
                x, y, z = rests[members].mean(axis=0)
                if z >= 0.0:
                    numbers: dict[str, Any] = {"ha": "center", "va": "bottom", "fontsize": 7}
                    text = ", ".join(str(i + 1) for i in members)
                    axes.annotate(text, (x, y), (0, 6), textcoords="offset points", **numbers)
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2)

    return drawn(name, SPHERE * PAGE, 0.62 * SPHERE * PAGE, draw)


def _in_front(directions: Array) -> Array:
    """Picture coordinates (2, N) of directions (N, 3) on the near side."""
    return np.asarray(directions[directions[:, 2] >= 0.0, :2].T)


def _globe(axes: Axes, view: Array) -> None:
    axes.fill(np.cos(_CIRCLE), np.sin(_CIRCLE), facecolor="#f4f6f8", edgecolor=GREY, linewidth=0.8)
    for p, q, sine in [(p, q, s) for p, q in ((0, 1), (1, 2), (2, 0)) for s in (-0.5, 0.0, 0.5)]:
        circle = np.zeros((len(_CIRCLE), 3))
        radius = math.sqrt(1.0 - sine**2)
        circle[:, p], circle[:, q], circle[:, 3 - p - q] = radius * np.cos(_CIRCLE), radius * np.sin(_CIRCLE), sine
        projected = circle @ view.T
        projected[projected[:, 2] < 0.0] = np.nan
        colour, width = (GREY, 0.6) if sine == 0.0 else (FAINT, 0.4)
        axes.plot(projected[:, 0], projected[:, 1], color=colour, linewidth=width)
    for axis, sign in ((axis, sign) for axis in range(3) for sign in (1.0, -1.0)):
        x, y, z = sign * view[:, axis]
        if z > 0.0:
            axes.plot(x, y, "+", color=INK, markersize=6, markeredgewidth=0.8)
            mark = f"{'+' if sign > 0 else '−'}{'XYZ'[axis]} up"
            axes.annotate(mark, (x, y), (0, -9), textcoords="offset points", ha="center", va="top", color=GREY)


def farthest_from(verticals: Array) -> float:
    """The largest angle (rad) from any direction to the nearest of these (N, 3), to about a degree."""
    n = 5000
    k = np.arange(n) + 0.5
    z, azimuth = 1.0 - 2.0 * k / n, math.pi * (1.0 + math.sqrt(5.0)) * k
    radius = np.sqrt(1.0 - z**2)
    everywhere = np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z])
    return float(np.arccos(np.clip((everywhere @ verticals.T).max(axis=1), -1.0, 1.0)).max())


def before_and_after(name: str, calibration: Calibration) -> str:
    """The error of a reading at 1 g, and at the rate of the session, that each parameter makes before the calibration,
    and its standard uncertainty afterwards."""
    rate, linear = session_rate(calibration), [p for p in linear_parameters(calibration.parameters) if p.u]
    shown = {kind: [p for p in linear if sensor_kind(p.name) == kind] for kind in accepted_kinds(calibration)}
    kinds = [kind for kind, parameters in shown.items() if parameters]

    def draw(figure: Figure) -> None:
        for axes, kind in zip(figure.subplots(1, len(kinds), squeeze=False)[0], kinds, strict=True):
            unit, full = ("m/s^2", G_STANDARD) if kind == "accel" else ("rad/s", rate)
            in_reading = [1.0 if within_kind(group_name(p.name)) == "bias" else full for p in shown[kind]]
            before = np.array([abs(p.value) * w for p, w in zip(shown[kind], in_reading, strict=True)])
            after = np.array([(p.u or 0.0) * w for p, w in zip(shown[kind], in_reading, strict=True)])
            (size, per), rows = engineering(unit, float(np.median(before))), -np.arange(len(before))
            axes.hlines(rows, after / size, before / size, color=FAINT, linewidth=2.0)
            axes.plot(before / size, rows, "o", color=GREY, markersize=4, label="before: the error")
            axes.plot(after / size, rows, "o", color=COLOURS[kind == "gyro"], markersize=4, label=f"after: u, {kind}")
            where = "in 1 g" if kind == "accel" else f"at {rate / DEGREE:.2g} °/s"
            axes.set(xscale="log", xlabel=per, title=f"{WORDS[kind]}, {where}")
            axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
            axes.set_yticks(rows, [within_kind(p.name) for p in shown[kind]])
            axes.grid(axis="x", color=FAINT, linewidth=0.5)
        handles = {label: h for axes in figure.axes for h, label in zip(*axes.get_legend_handles_labels(), strict=True)}
        figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=3)

    return drawn(name, PAGE, 0.8 + 0.15 * max(map(len, shown.values())), draw)


def residuals(name: str, rests: Sequence[RestResult], turns: Sequence[TurnResult]) -> str:
    """Residual of every rest, and how many sigmas rests and turns are from the fit."""
    numbers = np.arange(1, len(rests) + 1)

    def draw(figure: Figure) -> None:
        top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(1.25, 1.0))
        values = np.array([rest.residual for rest in rests])
        size, unit = engineering("m/s^2", float(np.sqrt(np.mean(values**2))))
        top.axhline(0.0, color=GREY, linewidth=0.6)
        top.bar(numbers, values / size, width=0.55, color=COLOURS[0])
        top.set(ylabel=unit, title="|corrected reading| − g")
        bottom.plot(numbers, [rest.sigmas for rest in rests], "o", markersize=4, color=COLOURS[0], label="rests")
        if turns:
            between = [0.5 * (turn.first + turn.last) + 1.0 for turn in turns]
            sigmas = [turn.sigmas for turn in turns]
            bottom.plot(between, sigmas, "D", markersize=3.5, color=COLOURS[1], label="turns")
        bottom.axhline(FIT_SIGMAS, color="#b02a2a", linewidth=0.8, linestyle="--", label="limit")
        bottom.set(ylabel="sigmas", xlabel="rest", title="distance from the fit", ylim=(0.0, None))
        figure.legend(*bottom.get_legend_handles_labels(), loc="outside lower right", ncols=3)
        for axes in (top, bottom):
            grid(axes)
        bottom.set_xticks(range(1, len(rests) + 1, math.ceil(len(rests) / _MOST_TICKS)))
        bottom.set_xlim(0.4, len(rests) + 0.6)

    return drawn(name, PAGE, 3.5, draw)
