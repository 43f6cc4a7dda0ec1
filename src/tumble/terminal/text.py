"""Results as text on a terminal: rests and turns found, noise, budgets. `calibration_text` has the calibrations."""

from __future__ import annotations

import io
import sys

from rich.console import Console, RenderableType
from rich.segment import Segment, Segments

from tumble.documents import plain


def probability_text(probability: float) -> str:
    """A probability to two digits, none as if it were 1."""
    return "above 0.99" if probability > 0.99 else f"{probability:.2g}"


def print_report(report: RenderableType) -> None:
    """Print to standard output, as wide as the terminal; where there is none sentences are not broken, and tables are
    160 characters wide at most. Characters that it cannot show become question marks."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    console = Console(highlight=False, soft_wrap=False)
    options = console.options
    if not console.is_terminal:
        options = options.update(width=160, no_wrap=True, overflow="ignore")
    shown = (Segment(plain(s.text), s.style, s.control) for s in console.render(report, options))
    console.print(Segments(shown), end="", crop=console.is_terminal)
