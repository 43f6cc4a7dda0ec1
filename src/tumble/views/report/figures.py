"""Figures of a report: errors before and after the calibration, and residuals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tumble.inference.estimate import FIT_SIGMAS
from tumble.result.accepted import accepted_kinds
from tumble.result.calibration import Calibration
from tumble.result.correction import session_rate
from tumble.result.further import linear_parameters
from tumble.result.parts import RestResult, TurnResult
from tumble.sensors.model import WORDS
from tumble.sensors.parameters import group_name, sensor_kind, within_kind
from tumble.units import DEGREE, G_STANDARD, engineering
from tumble.views.render.pictures import COLOURS, FAINT, GREY, PAGE_WIDTH, grid, svg_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MAX_TICKS = 25  # numbers of rests below a figure


def before_and_after(name: str, calibration: Calibration) -> str:
    """Draw, for each parameter, its error of a reading at 1 g or at the rate of the session before the calibration, and
    its standard uncertainty afterwards."""
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

    return svg_of(name, PAGE_WIDTH, 0.8 + 0.15 * max(map(len, shown.values())), draw)


def residuals(name: str, rests: Sequence[RestResult], turns: Sequence[TurnResult]) -> str:
    """Draw the residuals of the rests, and the distance of rests and turns from the fit in sigmas."""
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
        bottom.set_xticks(range(1, len(rests) + 1, math.ceil(len(rests) / _MAX_TICKS)))
        bottom.set_xlim(0.4, len(rests) + 0.6)

    return svg_of(name, PAGE_WIDTH, 3.5, draw)
