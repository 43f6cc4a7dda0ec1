"""What a campaign found: how its trials ended, errors, and these as a picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tumble.campaigns.summary import SummaryLine, varying
from tumble.errors import InputError, needs_extra
from tumble.planning.setup import GROUPS
from tumble.sensors.parameters import shown_in
from tumble.views.blocks import Block, table
from tumble.views.render.pictures import write_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDE = 5.0
"""Ratio of the errors in a panel from which its scale is logarithmic."""


def summary_blocks(lines: Sequence[SummaryLine]) -> list[Block]:
    """How the trials ended, then the errors, where there are any."""
    axes, ended, errors = varying(lines), [], []
    before: dict[str, str] = {}
    for line in lines:
        where = {axis: said(line.point[axis]) for axis in axes} | {"method": line.method}
        if where != before:
            refused = line.trials - line.accepted - line.failed
            counts = {"trials": line.trials, "accepted": line.accepted, "not accepted": refused, "failed": line.failed}
            ended.append(where | {name: str(count) for name, count in counts.items()})
        if line.rms is not None and line.bias is not None and line.scatter is not None:
            size, unit = shown_in(line.group, line.unit, line.rms)
            named = where if where != before else dict.fromkeys(where, "")
            sizes = {"bias": line.bias, "scatter": line.scatter, "rms": line.rms}
            errors.append(
                named
                | {"parameters": line.group}
                | {name: f"{value / size:.3g}" for name, value in sizes.items()}
                | {
                    "unit": unit,
                    "rms/bound": "" if line.to_bound is None else f"{line.to_bound:.3f}",
                    "coverage": "" if line.coverage is None else f"{line.coverage:.1%}",
                }
            )
        before = where
    words = ("method", "parameters", "unit")
    return [table(rows, words=words) for rows in (ended, errors) if rows]


def said(value: Any) -> str:
    """The value of an axis in words, nothing for none."""
    return "" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def plot(lines: Sequence[SummaryLine], path: Path) -> None:
    """Draw the rms errors, a panel for each group, over the first axis of numbers that varies (over the methods if none
    does), with one line for each method and value of the other axes; where it is known, the bound dotted. As svg, png
    or pdf by the ending of the file.

    Raises MissingExtraError without matplotlib, InputError where no trial was accepted."""
    with needs_extra("a plot of a campaign", "lab", "matplotlib"):
        from matplotlib import lines as strokes
    lines = [line for line in lines if line.rms is not None]
    if not lines:
        raise InputError(f"{path}: expected an accepted trial to draw, found none")
    axes = varying(lines)
    along = next((a for a in axes if isinstance(lines[0].point[a], int | float)), None)
    groups = [group for group in GROUPS if any(line.group == group for line in lines)]
    height = math.ceil(len(groups) / 3)

    def draw(figure: Figure) -> None:
        panels = figure.subplots(height, min(3, len(groups)), squeeze=False).ravel()
        for panel, group in zip(panels, groups, strict=True):
            _draw(panel, [line for line in lines if line.group == group], axes, along)
        handles, names = panels[0].get_legend_handles_labels()
        if any(line.to_bound for line in lines):
            handles, names = [*handles, strokes.Line2D([], [], color="0.3", linestyle=":")], [*names, "bound"]
        figure.legend(handles, names, loc="outside lower center", ncols=4, fontsize=8.0)

    write_picture(path, "a plot of a campaign", (10.5, 3.2 * height + 0.4), draw)


def _draw(panel: Axes, lines: Sequence[SummaryLine], axes: Sequence[str], along: str | None) -> None:
    """One group: rms errors against the axis `along`."""
    size, unit = shown_in(lines[0].group, lines[0].unit, max(line.rms or 0.0 for line in lines))
    series: dict[str, list[SummaryLine]] = {}
    for line in lines:
        others = [f"{axis} {said(line.point[axis])}" for axis in axes if axis != along]
        series.setdefault(", ".join([line.method, *others]), []).append(line)
    for i, (name, members) in enumerate(series.items()):
        x = [i if along is None else line.point[along] for line in members]
        rms = np.array([line.rms for line in members]) / size
        panel.plot(x, rms, "o-", color=f"C{i}", markersize=3.5, linewidth=1.3, label=name)
        if all(line.to_bound for line in members):
            bound = rms / np.array([line.to_bound for line in members])
            panel.plot(x, bound, "_:" if along is None else ":", color=f"C{i}", linewidth=1.0)
    shown = "arcsec" if unit == '"' else unit
    panel.set(title=lines[0].group, ylabel=f"rms error, {shown}", xlabel="method" if along is None else along)
    drawn = [(line.rms or 0.0) / below for line in lines for below in (1.0, line.to_bound or 1.0)]
    largest, least = max(drawn), min(drawn)
    if largest > WIDE * least:
        panel.set(yscale="log")
    else:
        panel.set_ylim(0.0, 1.1 * largest / size)
    if along is None:
        panel.set_xticks([])
    panel.grid(which="major", alpha=0.5, linewidth=0.6)
    for formatter in (panel.yaxis.set_major_formatter, panel.yaxis.set_minor_formatter):
        formatter("{x:g}")
