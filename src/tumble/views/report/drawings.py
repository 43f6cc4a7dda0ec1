"""Drawings of a report: where the vertical was in the body, and the frame with the axes of the sensors in it.

Both are orthographic, seen from a fixed direction; picture coordinates are x right, y up, z towards the viewer.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tumble.sensors.model import SensorModel
from tumble.units import DEGREE, Array
from tumble.views.render.pictures import COLOURS, FAINT, GREY, INK, PAGE, drawn

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SPHERE, FRAME = 0.66, 0.5
"""Widths of the drawings as parts of the page."""

_SAME = 8.0 * DEGREE
"""Directions so near to each other are labelled together."""

_MOST_NUMBERS = 20
"""More rests than these are not numbered in the picture."""

_CIRCLE = np.linspace(0.0, 2.0 * math.pi, 181)
_SHOWN_LEAN = 0.22
"""What the largest deviation of a sensor's axis is drawn as, rad."""

_AZIMUTH, _ABOVE = 32.0 * DEGREE, 24.0 * DEGREE
_TOWARDS = np.array([math.cos(_AZIMUTH) * math.cos(_ABOVE), math.sin(_AZIMUTH) * math.cos(_ABOVE), math.sin(_ABOVE)])
"""From the body to a viewer at this azimuth, from X towards Y, and elevation."""
_RIGHT = np.array([-math.sin(_AZIMUTH), math.cos(_AZIMUTH), 0.0])
FRONT = np.stack([_RIGHT, np.cross(_TOWARDS, _RIGHT), _TOWARDS])
"""Body → picture (right, up, towards the viewer)."""
BACK = np.diag([-1.0, 1.0, -1.0]) @ FRONT
"""The other side of the sphere, seen after half a turn about the vertical of the picture."""


def sphere(name: str, found: Array, nominal: Array) -> str:
    """Both sides of the sphere of directions in the body with the vertical (N, 3) of every rest, by its number, and
    those of the programme (M, 3)."""
    together: list[list[int]] = []  # rests in groups whose directions are nearly one
    for i, direction in enumerate(found):
        near = [group for group in together if float(found[group[0]] @ direction) > math.cos(_SAME)]
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
                seen, ring = _in_front(nominal @ view.T), {"markeredgecolor": COLOURS[1], "markeredgewidth": 0.9}
                axes.plot(*seen, "o", label="programme", markerfacecolor="none", markersize=9, **ring)
            rests = found @ view.T
            axes.plot(*_in_front(rests), "o", color=COLOURS[0], markersize=3.5, label="vertical at a rest")
            for members in together if len(found) <= _MOST_NUMBERS else ():
                x, y, z = rests[members].mean(axis=0)
                if z >= 0.0:
                    numbers: dict[str, Any] = {"ha": "center", "va": "bottom", "fontsize": 7}
                    text = ", ".join(str(i + 1) for i in members)
                    axes.annotate(text, (x, y), (0, 6), textcoords="offset points", **numbers)
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2)

    return drawn(name, SPHERE * PAGE, 0.62 * SPHERE * PAGE, draw)


def _in_front(seen: Array) -> Array:
    """Picture coordinates (2, N) of directions (N, 3) on the near side."""
    return np.asarray(seen[seen[:, 2] >= 0.0, :2].T)


def _globe(axes: Axes, view: Array) -> None:
    axes.fill(np.cos(_CIRCLE), np.sin(_CIRCLE), facecolor="#f4f6f8", edgecolor=GREY, linewidth=0.8)
    for p, q, sine in [(p, q, s) for p, q in ((0, 1), (1, 2), (2, 0)) for s in (-0.5, 0.0, 0.5)]:
        circle = np.zeros((len(_CIRCLE), 3))
        radius = math.sqrt(1.0 - sine**2)
        circle[:, p], circle[:, q], circle[:, 3 - p - q] = radius * np.cos(_CIRCLE), radius * np.sin(_CIRCLE), sine
        seen = circle @ view.T
        seen[seen[:, 2] < 0.0] = np.nan
        axes.plot(seen[:, 0], seen[:, 1], color=GREY if sine == 0.0 else FAINT, linewidth=0.6 if sine == 0.0 else 0.4)
    for axis, sign in ((axis, sign) for axis in range(3) for sign in (1.0, -1.0)):
        x, y, z = sign * view[:, axis]
        if z > 0.0:
            axes.plot(x, y, "+", color=INK, markersize=6, markeredgewidth=0.8)
            mark = f"{'+' if sign > 0 else '−'}{'XYZ'[axis]} up"
            axes.annotate(mark, (x, y), (0, -9), textcoords="offset points", ha="center", va="top", color=GREY)


def farthest_from(found: Array) -> float:
    """The largest angle (rad) from any direction to the nearest of these (N, 3), to about a degree."""
    n = 5000
    k = np.arange(n) + 0.5
    z, azimuth = 1.0 - 2.0 * k / n, math.pi * (1.0 + math.sqrt(5.0)) * k
    radius = np.sqrt(1.0 - z**2)
    everywhere = np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z])
    return float(np.arccos(np.clip((everywhere @ found.T).max(axis=1), -1.0, 1.0)).max())


def lean_factor(models: Sequence[SensorModel]) -> float:
    """By how much deviations of the sensors' axes are drawn larger than they are: 1, 2 or 5 times a power of ten."""
    largest = max(float(np.abs(unit - nominal).max()) for unit, nominal in map(_axes, models))
    if largest < 1e-9:
        return 1.0
    wanted = max(_SHOWN_LEAN / largest, 1.0)
    power = 10.0 ** math.floor(math.log10(wanted))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= wanted))


def _axes(model: SensorModel) -> tuple[Array, Array]:
    """Unit sensing axes (n, 3) and for three sensors the signed body axes nearest to them; else the axes themselves."""
    unit = model.matrix / np.linalg.norm(model.matrix, axis=1)[:, None]
    if len(unit) != 3:
        return unit, unit
    nearest = np.argmax(np.abs(unit), axis=1)
    nominal = np.eye(3)[nearest] * np.sign(unit[np.arange(3), nearest])[:, None]
    return unit, nominal


def frame(name: str, accel: SensorModel, gyro: SensorModel | None) -> str:
    """The body frame, and in it the axes of the sensors, their deviations from the body axes drawn larger."""
    panels = [("accelerometers", accel, COLOURS[0])]
    panels += [] if gyro is None else [("gyros", gyro, COLOURS[1])]
    factor = lean_factor([model for _, model, _ in panels])

    def draw(figure: Figure) -> None:
        for axes, (title, model, colour) in zip(figure.subplots(1, 2), panels, strict=False):
            axes.set(aspect="equal", xlim=(-1.25, 1.45), ylim=(-0.85, 1.45))
            axes.set_title(title, loc="center", color=colour)
            for axis, shade in enumerate(("#e9edf1", "#dfe5ea", "#f3f5f7")):  # faces of a cube towards the viewer
                normal = (1.0 if FRONT[2, axis] > 0.0 else -1.0) * np.eye(3)[axis]
                first, second = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
                corners = np.array([normal + a * first + b * second for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))])
                seen = 0.42 * corners @ FRONT.T
                axes.fill(seen[:, 0], seen[:, 1], facecolor=shade, edgecolor=FAINT, linewidth=0.8)
            for letter, direction in zip("XYZ", 1.25 * FRONT.T, strict=True):
                _arrow(axes, direction, INK, 0.9)
                axes.annotate(letter, 1.1 * direction[:2], ha="center", va="center", fontweight="bold", fontsize=9)
            for p, (unit, nominal) in enumerate(zip(*_axes(model), strict=True)):
                leaning = nominal + factor * (unit - nominal)
                direction = FRONT @ (leaning / np.linalg.norm(leaning))
                _arrow(axes, direction, colour, 1.6)
                mark = "xyz"[int(np.argmax(np.abs(nominal)))] if len(model.matrix) == 3 else str(p)
                x, y = direction[:2] / max(float(np.hypot(*direction[:2])), 1e-9)
                beside: dict[str, Any] = {"ha": "center", "va": "center", "color": colour, "fontsize": 8}
                axes.annotate(mark, 0.85 * direction[:2], (7.0 * y, -7.0 * x), textcoords="offset points", **beside)
        for axes in figure.axes:
            axes.set_axis_off()

    return drawn(name, FRAME * PAGE, 0.46 * FRAME * PAGE, draw)


def _arrow(axes: Axes, tip: Array, colour: str, width: float) -> None:
    style = {"arrowstyle": "-|>", "color": colour, "linewidth": width, "shrinkA": 0.0, "shrinkB": 0.0}
    axes.annotate("", (float(tip[0]), float(tip[1])), (0.0, 0.0), arrowprops=style)
