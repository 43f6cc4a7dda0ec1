"""Noise of the sensors: coefficients, and Allan deviations as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tumble.reduction.noise.allan_deviation import Panel, shown
from tumble.units import engineering
from tumble.views.blocks import Block, Text, table
from tumble.views.render.data import Content, fields
from tumble.views.render.pictures import write_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tumble.run.quiet_samples import RecordedNoise

_COLUMNS = ("sensor", "noise", "symbol", "value", "u (k=1)", "unit")


def noise_blocks(source: str, panels: Sequence[Panel]) -> list[Block]:
    """Noise coefficients of every channel."""
    rows = []
    for panel in panels:
        for channel, parameters in zip(panel.channels, panel.parameters, strict=True):
            coefficients = [(c.name, c.symbol, c.value, c.u, c.unit) for c in shown(parameters, panel.unit)]
            for coefficient in coefficients or [("none that the record shows", "", "", "", "")]:
                rows.append(dict(zip(_COLUMNS, (channel, *coefficient), strict=True)))
    return [Text(text=source), table(rows, words=("sensor", "noise", "symbol", "unit"), columns=_COLUMNS)]


def noise_data(noise: RecordedNoise) -> Content:
    """Noise coefficients of every channel."""
    channels = [
        {"name": name, "unit": panel.unit, "noise": parameters}
        for panel in noise.panels
        for name, parameters in zip(panel.channels, panel.parameters, strict=True)
    ]
    return fields(noise, "source rate") | {"channels": channels}


def plot(panels: Sequence[Panel], path: Path) -> None:
    """Write the Allan deviations with 68 % bands, the fit and its terms, a panel for each kind of sensor, as svg,
    png or pdf by the ending of the file. Needs matplotlib.

    Raises MissingExtraError without matplotlib, InputError for another ending."""

    def draw(figure: Figure) -> None:
        for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
            _draw(axes, panel)

    write_picture(path, "a plot of the Allan deviation", (6.2 * len(panels), 5.6), draw)


def _draw(axes: Axes, panel: Panel) -> None:
    """One panel: band and line of every channel, its fit dashed, the terms of the fit dotted where they matter."""
    tau, allan = panel.deviation.tau, panel.deviation
    size, unit_name = engineering(panel.unit, float(np.median(allan.deviation)))
    for i, (channel, parameters) in enumerate(zip(panel.channels, panel.parameters, strict=True)):
        colour = f"C{i}"
        low, middle, high = (band[:, i] / size for band in (allan.low, allan.deviation, allan.high))
        said = ", ".join(f"{s.symbol} = {s.value} ± {s.u} {s.unit}" for s in shown(parameters, panel.unit))
        axes.fill_between(tau, low, high, color=colour, alpha=0.2, linewidth=0.0)
        axes.plot(tau, middle, color=colour, linewidth=1.5, label=f"{channel}: {said}" if said else channel)
        terms = parameters.variances(tau)
        if terms:
            total = np.sum(list(terms.values()), axis=0)
            axes.plot(tau, np.sqrt(total) / size, color=colour, linewidth=0.9, linestyle="--")
            for term in terms.values():
                part = np.where(term > 0.05 * total, np.sqrt(term) / size, np.nan)
                axes.plot(tau, part, color=colour, linewidth=0.8, linestyle=":")
    axes.set(title=panel.title, xlabel="averaging time τ, s", ylabel=f"Allan deviation, {unit_name}")
    axes.set(xscale="log", yscale="log" if allan.deviation.any() else "linear")
    axes.grid(which="major", alpha=0.5, linewidth=0.6)
    axes.grid(which="minor", alpha=0.2, linewidth=0.4)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
    below: Any = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.11)}
    axes.legend(fontsize=8.0, title="68 % band, fit dashed, its terms dotted", title_fontsize=8.0, **below)
