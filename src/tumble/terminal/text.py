"""Results as text on a terminal: rests and turns found, noise, budgets. `calibration_text` has the calibrations."""

from __future__ import annotations

import io
import math
import sys
from collections.abc import Sequence

from rich.console import Console, RenderableType
from rich.segment import Segment, Segments

from tumble.calibration.further import by_group
from tumble.calibration.results import Parameter
from tumble.documents import plain
from tumble.sensors.parameters import group_name, shown_in


def shown_units(parameters: Sequence[Parameter]) -> dict[str, tuple[float, str]]:
    """The unit in which each parameter is shown, by its name, as (size in SI, unit): one for all of a kind, by their
    root mean square."""
    of_kind = {
        kind: shown_in(kind, alike[0].unit, math.sqrt(sum(p.value**2 for p in alike) / len(alike)))
        for kind, alike in by_group(parameters).items()
    }
    return {p.name: of_kind[group_name(p.name)] for p in parameters}


def probability_text(probability: float) -> str:
    """A probability to two digits, none as if it were 1."""
    return "above 0.99" if probability > 0.99 else f"{probability:.2g}"


def print_report(report: RenderableType) -> None:
    """Print to standard output, as wide as the terminal, or as needed where there is none; characters that it cannot
    show become question marks."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    console = Console(highlight=False, soft_wrap=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=160)
    shown = (Segment(plain(s.text), s.style, s.control) for s in console.render(report))
    console.print(Segments(shown), end="")
