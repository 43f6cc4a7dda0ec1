"""What a calibration means for a vehicle: errors before and after in a table, what contributes, and a picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tumble.units import ARCSEC, DEGREE, coarsest, two_digits
from tumble.use.mission import QUANTITIES, Mission
from tumble.views.blocks import Block, table
from tumble.views.render.data import Content, fields, rows
from tumble.views.render.pictures import COLOURS, write_picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_UNITS = {"rad": ((ARCSEC, '"'), (DEGREE / 60.0, "'"), (DEGREE, "°")), "m": ((1e-3, "mm"), (1.0, "m"), (1e3, "km"))}
_WORDS = ("heading", "tilt", "position", "height")
SHOWN = 0.02
"""Of the variance of some quantity: sources with less everywhere are summed up in one line."""
LEAST = 0.03
"""Of the whole error: less of a source is not drawn."""


def mission_blocks(found: Mission, *, every: bool = False) -> list[Block]:
    """What remains at the end and what most of it is from; what becomes of heading, tilt and position, before and after
    calibration; and the parts of the variance at the end, with `every` at each of the marks."""
    shown = []
    for k in found.marks:
        row = {"after": f"{found.times[k]:g} s"}
        for i, quantity in enumerate(_WORDS):
            row[quantity] = _in_unit(i, found.after[k, i])
            row[f"{quantity} uncalibrated"] = _in_unit(i, found.before[k, i])
        shown.append(row)
    caption = "Standard uncertainties without aid; tilt and position are those of both horizontal directions together."
    end = found.marks[-1]
    largest = [found.sources[int(np.argmax(found.after_parts[:, end, i]))] for i in (0, 2)]
    heading, tilt, position, _ = (_in_unit(i, u) for i, u in enumerate(found.after[end]))
    headline = (
        f"{found.serial} on the trajectory {found.trajectory}, after {found.times[end]:g} s without aid: heading known "
        f"to {heading}, tilt to {tilt}, position to {position}, mostly from the {' and '.join(dict.fromkeys(largest))}."
    )
    blocks: list[Block] = [
        headline,
        table(shown, words=(), caption=caption),
        *(_parts(found, k) for k in (found.marks if every else found.marks[-1:])),
    ]
    return [*blocks, *(f"{remark[0].upper()}{remark[1:]}." for remark in found.remarks)]


def _parts(found: Mission, k: int) -> Block:
    """Parts of the variance after calibration at one time, the largest first."""
    parts = found.after_parts[:, k] / np.maximum(found.after[k] ** 2, 1e-300)
    order = np.argsort(-np.abs(parts).mean(axis=1)).tolist()
    large = [s for s in order if np.abs(parts[s]).max() >= SHOWN]
    lines = [(found.sources[s], parts[s]) for s in large]
    lines.append(("all others", parts[[s for s in order if s not in large]].sum(axis=0)))
    cells = [
        {"source": words} | {w: f"{100.0 * p:z.0f} %" for w, p in zip(_WORDS, part, strict=True)}
        for words, part in lines
    ]
    caption = f"Parts of the variance after calibration, at {found.times[k]:g} s."
    return table(cells, words=("source",), caption=caption)


def _in_unit(quantity: int, u: float) -> str:
    size, unit = coarsest(_UNITS[list(QUANTITIES.values())[quantity]], u)
    return f"{two_digits(u / size)} {unit}"


def mission_data(found: Mission) -> Content:
    """Errors at every time before and after calibration, and what contributes to their variances."""
    return {
        **fields(found, "serial trajectory grade"),
        "quantities": list(QUANTITIES),
        "units": list(QUANTITIES.values()),
        "marks": found.times[list(found.marks)],
        "times": rows("time before after", found.times, found.before, found.after),
        "sources": rows("source before after", found.sources, found.before_parts, found.after_parts),
        **fields(found, "covariance remarks"),
    }


def plot(found: Mission, path: Path) -> None:
    """Write heading and position over time, before and after calibration, with the largest sources, as svg, png or pdf
    by the ending of the file. Needs matplotlib.

    Raises MissingExtraError without matplotlib, InputError for another ending."""

    def draw(figure: Figure) -> None:
        for axes, i in zip(figure.subplots(1, 2), (0, 2), strict=True):
            size, unit = (DEGREE, "°") if i == 0 else (1.0, "m")
            axes.loglog(
                found.times, found.before[:, i] / size, color="grey", linestyle="--", label="before calibration"
            )
            axes.loglog(found.times, found.after[:, i] / size, color="black", linewidth=2.0, label="after")
            order = np.argsort(-found.after_parts[:, -1, i])[: len(COLOURS)].tolist()
            for s, colour in zip(order, COLOURS, strict=True):
                part = np.sqrt(np.maximum(found.after_parts[s, :, i], 0.0))
                shown = np.where(part > LEAST * found.after[:, i], part, np.nan)
                axes.loglog(found.times, shown / size, color=colour, label=found.sources[s])
            axes.set(xlabel="time without aid, s", ylabel=f"{_WORDS[i]}, {unit}")
            axes.legend(fontsize=7, frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.15))

    write_picture(path, "a plot of a mission", (9.5, 6.0), draw)
