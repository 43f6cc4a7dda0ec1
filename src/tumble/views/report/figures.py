"""Figures of a report: residuals, convergence, noise and drift, several calibrations beside each other."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tumble.inference.estimate import FIT_SIGMAS
from tumble.result.calibration import Calibration
from tumble.result.coverage import expanded
from tumble.result.further import by_group, linear_parameters
from tumble.result.parts import Parameter, RestResult, SensorsAtRest, TurnResult
from tumble.sensors.parameters import within_group
from tumble.units import Array, engineering
from tumble.views.numbers import raised, shown_units
from tumble.views.render.characters import drawable
from tumble.views.render.pictures import COLOURS, GREY, INK, PAGE, drawn, grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def _rest_ticks(axes: Axes, count: int, most: int = 25) -> None:
    """Numbers of rests below an axis, no more than fit."""
    step = max(1, math.ceil(count / most))
    axes.set_xticks(range(1, count + 1, step))
    axes.set_xlim(0.4, count + 0.6)


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
        _rest_ticks(bottom, len(rests))

    return drawn(name, PAGE, 3.5, draw)


def convergence(name: str, steps: Sequence[Mapping[str, float]], parameters: Sequence[Parameter]) -> str:
    """The largest increment of each kind of parameter in every iteration, in units of its standard uncertainty."""
    kinds = by_group(p for p in parameters if p.u)

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        for i, (kind, alike) in enumerate(kinds.items()):
            sizes = np.array([max(abs(step.get(p.name, 0.0)) / (p.u or 1.0) for p in alike) for step in steps])
            shown = np.where(sizes > 0.0, sizes, np.nan)
            axes.plot(
                np.arange(1, len(steps) + 1), shown, "o-", markersize=3, color=COLOURS[i % 6], label=drawable(kind)
            )
        axes.axhline(1.0, color=GREY, linewidth=0.8, linestyle="--")
        axes.set(yscale="log", xlabel="iteration", ylabel="largest increment / u")
        axes.yaxis.set_major_formatter(
            lambda value, _: f"10{raised(round(np.log10(value)))}" if 0.0 < value < np.inf else ""
        )
        axes.yaxis.set_minor_formatter("")
        axes.set_xticks(range(1, len(steps) + 1))
        grid(axes)
        figure.legend(loc="outside right center")

    return drawn(name, PAGE, 2.3, draw)


def noise_and_drift(name: str, rests: Sequence[RestResult], sensors: Mapping[str, Sequence[str]]) -> str:
    """Noise density and drift of every sensor at every rest, and the temperature; `sensors` are the names of those of
    "accel" and "gyro"."""
    kinds = [("accel", "m/s^2", "accelerometers"), ("gyro", "rad/s", "gyros")]
    present = [kind for kind in kinds if all(getattr(rest, kind[0]) is not None for rest in rests)]
    temperatures = [rest.temperature for rest in rests if rest.temperature is not None]
    warm = len(temperatures) == len(rests)

    def draw(figure: Figure) -> None:
        rows = figure.subplots(len(present) + warm, 2, squeeze=False)
        for (noise, drift), (kind, unit, title) in zip(rows, present, strict=False):
            seen: list[SensorsAtRest] = [getattr(rest, kind) for rest in rests]
            _per_rest(noise, np.array([s.noise for s in seen]), unit, "/√Hz", sensors[kind])
            _per_rest(drift, np.array([s.drift for s in seen]), unit, "", sensors[kind])
            noise.set(ylim=(0.0, 1.1 * noise.get_ylim()[1]), title=f"{title}: noise density")
            drift.set(title=f"{title}: drift over a rest")
            noise.legend(loc="lower left", ncols=3, handlelength=1.0, columnspacing=1.0)
        if warm:
            left, right = rows[-1]
            right.set_visible(False)
            left.plot(range(1, len(rests) + 1), temperatures, "o-", markersize=2.5, color=INK, linewidth=0.7)
            left.set(title="temperature", ylabel="°C")
            grid(left)
            _rest_ticks(left, len(rests), most=12)
        for axes in rows[-1]:
            axes.set_xlabel("rest")

    return drawn(name, PAGE, 1.65 * (len(present) + warm) + 0.1, draw)


def _per_rest(axes: Axes, values: Array, unit: str, per: str, sensors: Sequence[str]) -> None:
    size, shown = engineering(unit, float(np.sqrt(np.mean(values**2))))
    for sensor, series in enumerate((values / size).T):
        label = drawable(sensors[sensor])
        style: dict[str, Any] = {"markersize": 2.5, "linewidth": 0.7, "color": COLOURS[sensor % 6], "label": label}
        axes.plot(np.arange(1, len(series) + 1), series, "o-", **style)
    axes.set_ylabel(shown + per)
    grid(axes)
    _rest_ticks(axes, len(values), most=12)


def comparison(name: str, titles: Sequence[str], calibrations: Sequence[Calibration]) -> str:
    """Parameters of the linear model of several calibrations with U (95 %), each as a difference from their mean, one
    panel a kind."""
    kinds = by_group(linear_parameters(calibrations[0].parameters))
    units = shown_units(calibrations[0].parameters)
    by_name = [{p.name: p for p in calibration.parameters} for calibration in calibrations]
    style: dict[str, Any] = {"fmt": "o", "markersize": 3, "linewidth": 0.9, "capsize": 1.5}

    def draw(figure: Figure) -> None:
        columns = min(3, len(kinds))
        panels = figure.subplots(-(-len(kinds) // columns), columns, squeeze=False).ravel()
        for axes, (kind, members) in zip(panels, kinds.items(), strict=False):
            names, (size, unit) = [p.name for p in members], units[members[0].name]
            means = [np.mean([there[name].value for there in by_name if name in there]) for name in names]
            for i, (title, there) in enumerate(zip(titles, by_name, strict=True)):
                values = [there[n].value - mean if n in there else np.nan for n, mean in zip(names, means, strict=True)]
                bars = np.array([(expanded(there[n]) or 0.0) if n in there else 0.0 for n in names]) / size
                beside = np.arange(len(names)) + 0.5 * (i + 1) / (len(titles) + 1) - 0.25
                label = drawable(title)
                axes.errorbar(beside, np.array(values) / size, bars, color=COLOURS[i % 6], label=label, **style)
            axes.axhline(0.0, color=GREY, linewidth=0.6)
            axes.set_xticks(np.arange(len(names)), [drawable(within_group(name)) for name in names])
            axes.set(ylabel="arcsec" if unit == '"' else drawable(unit), title=drawable(kind))
            grid(axes)
        for axes in panels[len(kinds) :]:
            axes.set_visible(False)
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=min(4, len(titles)))

    return drawn(name, PAGE, 1.7 * -(-len(kinds) // 3) + 0.4, draw)
