"""The recording as a picture: what the sensors read over time, with its rests and its turns.

`plot` draws a session as it was recorded, `overview` what a calibration file has of it. The files of a log stand one
after the other.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tumble.units import DEGREE
from tumble.views.render.characters import drawable
from tumble.views.render.pictures import COLOURS, PAGE, STYLE, drawn, write_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tumble.result.parts import RestResult, TurnResult
    from tumble.run.observed import Observed

_RESTS, _TURNS = "#e3e8ee", "#f6e3d6"
"""Colours of the spans of rests and turns."""

_NUMBER = 7.0
"""Height of the number of a rest, points; a digit is 0.65 of it wide."""

_DRAWN = 0.8
"""The part of a figure's width that readings take, about; the rest is for scale and legend."""

Spans = Sequence[tuple[float, float]]
"""Start and stop, s."""


def plot(observed: Observed, path: Path) -> None:
    """Write the recording of a session, accelerometers and below them gyros of all blocks of its log, with its rests
    and turns as svg, png or pdf by the ending of the file.

    Raises MissingExtraError without matplotlib, InputError for another ending."""
    files, log = observed.reduction.files, observed.session.log
    starts = _starts(float(file.edges[-1] - file.edges[0]) for file in files)
    later = [start - float(file.edges[0]) for start, file in zip(starts, files, strict=True)]
    found = [(r.start + later[r.file], r.stop + later[r.file], r.file) for r in observed.segmentation.rests]
    rests = [(start, stop) for start, stop, _ in found]
    turns = [(before[1], after[0]) for before, after in pairwise(found) if before[2] == after[2]]
    panels = [("accel", log.accel, 1.0, "m/s²")] + ([("gyro", log.gyro, DEGREE, "°/s")] if log.gyro else [])

    def draw(figure: Figure) -> None:
        axes_of = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (kind, channels, size, unit) in zip(axes_of, panels, strict=True):
            assert channels is not None
            for i, column in enumerate(channels.columns):
                for file, start in zip(files, starts, strict=True):
                    middle = 0.5 * (file.edges[1:] + file.edges[:-1]) - file.edges[0] + start
                    label = drawable(column) if file is files[0] else None
                    values = getattr(file, kind).means[:, i] / size
                    axes.plot(middle, values, color=COLOURS[i % len(COLOURS)], linewidth=0.8, label=label)
            axes.set_ylabel(unit)
            _spans(axes, rests, turns)
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        _numbers(axes_of[0], rests)
        axes_of[-1].set_xlabel("time, s")

    write_picture(path, "a picture of the recording", (10.0, 5.0), draw, STYLE)


def overview(name: str, rests: Sequence[RestResult], turns: Sequence[TurnResult], columns: Sequence[str]) -> str:
    """The mean readings of the accelerometers at the rests over time, thin lines from each to the next, and the angle
    of every turn between them as the gyros saw it, as the SVG of a figure `name`; the accelerometers are called by
    their columns."""
    starts = _starts(max((r.stop for r in rests if r.file == file), default=0.0) for file in range(rests[-1].file + 1))
    spans = [(r.start + starts[r.file], r.stop + starts[r.file]) for r in rests]
    between = [(spans[t.first][1], spans[t.last][0]) for t in turns]

    def draw(figure: Figure) -> None:
        told = any(t.angle is not None for t in turns)
        all_axes = figure.subplots(2 if told else 1, 1, sharex=True, squeeze=False, height_ratios=(2, 1)[: 1 + told])
        top, times = all_axes[0, 0], np.ravel(np.array(spans))
        for i, means in enumerate(np.array([r.accel.mean for r in rests if r.accel is not None]).T):
            label, colour = drawable(columns[i]) if i < len(columns) else str(i), COLOURS[i % len(COLOURS)]
            top.plot(times, np.repeat(means, 2), color=colour, linewidth=0.4)
            for span, mean in zip(spans, means, strict=True):
                top.plot(span, (mean, mean), color=colour, linewidth=2.0, label=label if span is spans[0] else None)
        top.set_ylabel("m/s²")
        _spans(top, spans, between)
        _numbers(top, spans)
        top.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        if told:
            bottom = all_axes[1, 0]
            for turn, (start, stop) in zip(turns, between, strict=True):
                if turn.angle is not None:
                    bottom.bar(start, turn.angle / DEGREE, stop - start, align="edge", color="#c0561a")
            bottom.set(ylabel="turn, °", ylim=(0.0, 190.0), yticks=(0, 90, 180))
        all_axes[-1, 0].set_xlabel("time, s")

    return drawn(name, PAGE, 2.4, draw)


def _starts(lasted: Iterable[float]) -> list[float]:
    """When each file begins, the files standing one after the other."""
    return [0.0, *np.cumsum(list(lasted)).tolist()][:-1]


def _spans(axes: Axes, rests: Spans, turns: Spans) -> None:
    """Rests and turns as bands behind the readings."""
    for spans, colour in ((rests, _RESTS), (turns, _TURNS)):
        for start, stop in spans:
            axes.axvspan(start, stop, color=colour, linewidth=0.0, zorder=0)
    axes.margins(x=0.005)


def _numbers(axes: Axes, rests: Spans) -> None:
    """The number of every rest above it, where there is room beside the one before."""
    if not rests:
        return
    figure = axes.get_figure(root=True)
    assert figure is not None
    point = (rests[-1][1] - rests[0][0]) / (72.0 * _DRAWN * figure.get_figwidth())
    taken = -math.inf
    for number, (start, stop) in enumerate(rests, 1):
        middle, half = 0.5 * (start + stop), 0.325 * _NUMBER * len(str(number)) * point
        if middle - half < taken:
            continue
        place: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "ha": "center", "va": "bottom"}
        axes.annotate(str(number), (middle, 1.0), fontsize=_NUMBER, **place)
        taken = middle + half + 0.4 * _NUMBER * point
