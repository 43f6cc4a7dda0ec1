"""Allan deviations, as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tumble.errors import InputError, needs_extra
from tumble.files import whole_file
from tumble.units import engineering

if TYPE_CHECKING:
    from matplotlib.axes import Axes
from tumble.reduction.allan_deviation import NoiseParameters, Panel, shown


def plot(panels: Sequence[Panel], path: Path) -> None:
    """Write the Allan deviations with 68 % bands, the fit and its terms, a panel for each kind of sensor, as svg,
    png or pdf by the ending of the file. Needs matplotlib.

    Raises MissingExtraError without matplotlib, InputError for another ending."""
    if path.suffix.lower() not in (".svg", ".png", ".pdf"):
        raise InputError(f"{path}: expected a file that ends in .svg, .png or .pdf, found {path.suffix!r}")
    with needs_extra("a plot of the Allan deviation", "report", "matplotlib"):
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "tumble", "font.size": 9.0}):
        figure = Figure(figsize=(6.2 * len(panels), 5.6), layout="constrained")
        for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
            _draw(axes, panel)
        undated = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
        with whole_file(path) as temporary:
            figure.savefig(temporary, dpi=150, metadata=undated.get(path.suffix.lower()))


def _draw(axes: Axes, panel: Panel) -> None:
    """One panel: band and line of every channel, its fit dashed, the terms of the fit dotted where they matter."""
    tau = panel.deviation.tau
    size, unit_name = engineering(panel.unit, float(np.median(panel.deviation.deviation)))
    for i, (channel, parameters) in enumerate(zip(panel.channels, panel.parameters, strict=True)):
        colour = f"C{i}"
        low, middle, high = (
            band[:, i] / size for band in (panel.deviation.low, panel.deviation.deviation, panel.deviation.high)
        )
        axes.fill_between(tau, low, high, color=colour, alpha=0.2, linewidth=0.0)
        axes.plot(tau, middle, color=colour, linewidth=1.5, label=_label(channel, parameters, panel.unit))
        terms = parameters.variances(tau)
        if terms:
            total = np.sum(list(terms.values()), axis=0)
            axes.plot(tau, np.sqrt(total) / size, color=colour, linewidth=0.9, linestyle="--")
            for term in terms.values():
                part = np.where(term > 0.05 * total, np.sqrt(term) / size, np.nan)
                axes.plot(tau, part, color=colour, linewidth=0.8, linestyle=":")
    axes.set(title=panel.title, xlabel="averaging time τ, s", ylabel=f"Allan deviation, {unit_name}")
    axes.set(xscale="log", yscale="log" if panel.deviation.deviation.any() else "linear")
    axes.grid(which="major", alpha=0.5, linewidth=0.6)
    axes.grid(which="minor", alpha=0.2, linewidth=0.4)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
    axes.legend(
        fontsize=8.0,
        title="68 % band, fit dashed, its terms dotted",
        title_fontsize=8.0,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.11),
    )


def _label(channel: str, parameters: NoiseParameters, unit: str) -> str:
    """A line of the legend: "x: N = 0.0030 ± 0.0002 °/√h, …"."""
    terms = ", ".join(f"{s.symbol} = {s.value} ± {s.u} {s.unit}" for s in shown(parameters, unit))
    return f"{channel}: {terms}" if terms else channel
