"""Pictures as files (svg, png, pdf), and as SVG for pages, with letters as outlines and without external references.

The same numbers give the same bytes.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tumble.errors import needs_extra
from tumble.files import ending_in, whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, GREY, FAINT = "#1c2733", "#6b7785", "#d5dae0"
COLOURS = ("#1f4e79", "#c0561a", "#3d7d52", "#7d4f93", "#a08020", "#58728c")
"""Colours of accelerometers and gyros, or of the sensors of a block."""
PAGE_WIDTH = 6.7  # inches

STYLE: Any = {
    "svg.fonttype": "path",
    "svg.hashsalt": "tumble",
    "text.parse_math": False,
    "font.family": "DejaVu Sans",
    "font.size": 8.0,
    "text.color": INK,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.6,
    "axes.unicode_minus": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 8.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "legend.fontsize": 7.5,
    "lines.linewidth": 1.2,
}

_NO_METADATA = {"Creator": None, "Date": None, "Format": None, "Type": None}
_UNDATED: Mapping[str, dict[str, Any]] = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}


def write_picture(path: Path, what: str, size: tuple[float, float], draw: Callable[[Figure], None]) -> None:
    """Write a picture of this size in inches, filled by `draw`, in the format of the suffix. Text of an SVG stays text.

    Raises MissingExtraError, which names the picture as `what`, without matplotlib, InputError for another suffix."""
    ending = ending_in(path, ".svg", ".png", ".pdf")
    with needs_extra(what, "lab", "matplotlib"):
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    with rc_context(STYLE | {"svg.fonttype": "none"}):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure)
        with whole_file(path) as temporary:
            figure.savefig(temporary, dpi=150, metadata=_UNDATED.get(ending))


def svg_of(name: str, width: float, height: float, draw: Callable[[Figure], None]) -> str:
    """Return a figure of this size in inches, filled by `draw`, as an svg element without comments.

    `name` becomes the prefix of its identifiers, because the figures of a page share one name space."""
    with needs_extra("a figure", "lab", "matplotlib"):
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    with rc_context(STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        draw(figure)
        layout = figure.get_layout_engine()
        assert layout is not None
        layout.execute(figure)  # savefig would draw the figure twice for the layout
        figure.set_layout_engine("none")
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata=_NO_METADATA, transparent=True)
    svg = re.sub(r"<!--.*?-->", "", out.getvalue()[out.getvalue().index("<svg") :], flags=re.DOTALL)
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'\b(?:d|x|y)="[^"]*"', _round_coordinates, svg)
    references = dict.fromkeys(re.findall(r'(?:href="|url\()#([^")]+)', svg))
    ids = {reference: f"{name}-{i}" for i, reference in enumerate(references)}
    svg = re.sub(r' id="([^"]*)"', lambda match: f' id="{ids[match[1]]}"' if match[1] in ids else "", svg)
    svg = re.sub(r'(href="|url\()#([^")]+)', lambda match: f"{match[1]}#{ids[match[2]]}", svg)
    return re.sub(r"\s*\n\s*", "\n", svg).strip()


def _round_coordinates(attribute: re.Match[str]) -> str:
    """Round coordinates to a tenth of a point, and leave out repeated commands "L" of a path."""
    words, command = [], ""
    for word in re.sub(r"\d+\.\d+", lambda number: f"{float(number[0]):.1f}", attribute[0]).split():
        if word == "L" and command in ("M", "L"):
            continue
        command = word[-1] if word[-1].isalpha() else command
        words.append(word)
    return " ".join(words)


def grid(axes: Axes) -> None:
    """Draw faint lines at the ticks of the values."""
    axes.grid(axis="y", color=FAINT, linewidth=0.5)
    axes.set_axisbelow(True)
