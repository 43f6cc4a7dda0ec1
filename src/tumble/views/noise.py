"""Noise of sensors: coefficients, and a plot of the Allan deviation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tumble.reduction.noise.wavelet_moments import LINEAR, MISFIT_PROBABILITY, Coefficient, NoiseParameters, Panel
from tumble.units import ARCSEC, DEGREE, DEGREE_PER_HOUR, G_STANDARD, engineering, rounded
from tumble.views.blocks import Block, table
from tumble.views.render.pictures import write_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tumble.run.quiet_samples import RecordedNoise

CLOSE = 4.0  # difference of −2 ln likelihood below which the second best sum of processes is also named
_COLUMNS = ("sensor", "noise", "symbol", "value", "u (k=1)", "unit")
_MICRO_G = 1e-6 * G_STANDARD
_SYMBOLS_AND_UNITS = {
    # symbol, then display unit of gyros and of accelerometers: size in SI, name
    "quantisation": ("Q", (ARCSEC, '"'), (1e-3, "mm/s")),
    "white_noise": ("N", (DEGREE / 60.0, "°/√h"), (_MICRO_G, "µg/√Hz")),
    "bias_instability": ("B", (DEGREE_PER_HOUR, "°/h"), (_MICRO_G, "µg")),
    "rate_random_walk": ("K", (DEGREE_PER_HOUR / 60.0, "°/h/√h"), (_MICRO_G / 60.0, "µg/√h")),
    "ramp": ("R", (DEGREE_PER_HOUR / 3600.0, "°/h/h"), (_MICRO_G / 3600.0, "µg/h")),
    "Gauss–Markov noise": ("σ", (DEGREE_PER_HOUR, "°/h"), (_MICRO_G, "µg")),
    "correlation time": ("T", (1.0, "s"), (1.0, "s")),
}


class NoiseRow(NamedTuple):
    """A noise coefficient as text: "white noise", "N", "0.0030", "0.0002", "°/√h"."""

    name: str
    symbol: str
    value: str
    u: str
    unit: str


def coefficient_rows(parameters: NoiseParameters, unit: str) -> list[NoiseRow]:
    """Return the coefficients of a channel in the units of data sheets; the samples are in `unit`, "rad/s" or
    "m/s^2"."""
    coefficients: list[tuple[str, Coefficient | None]] = [(name, getattr(parameters, name)) for name in LINEAR]
    for process in parameters.gauss_markov:
        coefficients += [("Gauss–Markov noise", process.sigma), ("correlation time", process.time)]
    rows = []
    for name, coefficient in coefficients:
        if coefficient is not None:
            symbol, gyro, accel = _SYMBOLS_AND_UNITS[name]
            size, unit_name = gyro if unit == "rad/s" else accel
            value, u = rounded(coefficient.value / size, coefficient.u / size)
            rows.append(NoiseRow(name.replace("_", " "), symbol, value, u, unit_name))
    return rows


def noise_blocks(noise: RecordedNoise) -> list[Block]:
    """Return the noise coefficients of every channel, with doubts about the choice of processes."""
    rows, doubts = list[dict[str, str]](), list[str]()
    for panel in noise.panels:
        for channel, p in zip(panel.channels, panel.parameters, strict=True):
            found = coefficient_rows(p, panel.unit) or [NoiseRow("none that the record shows", "", "", "", "")]
            rows += [dict(zip(_COLUMNS, (channel, *coefficient), strict=True)) for coefficient in found]
            if p.runner_up and p.margin < CLOSE:
                doubts.append(f"{channel}: {p.runner_up} fits nearly as well; a longer record can decide.")
            if p.probability < MISFIT_PROBABILITY:
                none = "no sum of processes fits (vibration, a filter?); u is enlarged by what is left."
                doubts.append(f"{channel}: {none}")
    doubts += [f"doubt: {noise.doubt}"] if noise.doubt else []
    return [noise.source, table(rows, words=("sensor", "noise", "symbol", "unit"), columns=_COLUMNS), *doubts]


def plot(panels: Sequence[Panel], path: Path) -> None:
    """Plot Allan deviations with 68 % bands, the fit and its terms, as svg, png or pdf by the suffix of the file.

    Raises MissingExtraError without matplotlib, InputError for another suffix."""

    def draw(figure: Figure) -> None:
        for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
            _draw(axes, panel)

    write_picture(path, "a plot of the Allan deviation", (6.2 * len(panels), 5.6), draw)


def _draw(axes: Axes, panel: Panel) -> None:
    """Draw the band and line of every channel, its fit dashed, and the terms of the fit dotted where they matter."""
    tau, allan = panel.deviation.tau, panel.deviation
    size, unit_name = engineering(panel.unit, float(np.median(allan.deviation)))
    for i, (channel, parameters) in enumerate(zip(panel.channels, panel.parameters, strict=True)):
        colour = f"C{i}"
        low, middle, high = (band[:, i] / size for band in (allan.low, allan.deviation, allan.high))
        rows = coefficient_rows(parameters, panel.unit)
        caption = ", ".join(f"{s.symbol} = {s.value} ± {s.u} {s.unit}" for s in rows)
        axes.fill_between(tau, low, high, color=colour, alpha=0.2, linewidth=0.0)
        axes.plot(tau, middle, color=colour, linewidth=1.5, label=f"{channel}: {caption}" if caption else channel)
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
