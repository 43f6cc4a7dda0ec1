"""Residuals of rests before and after a correction, as text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.console import RenderableType

from tumble.calibration.apply import RestResidual
from tumble.terminal.table import add_numbers, plain_table
from tumble.units import G_STANDARD


def residual_table(rests: Sequence[RestResidual]) -> RenderableType:
    """Residuals of rests, mg before and after correction, and their root mean squares."""
    table = plain_table()
    add_numbers(table, "rest", "start s", "stop s", "before mg", "after mg")
    both = np.array([[rest.before, rest.after] for rest in rests]) / (1e-3 * G_STANDARD)
    for i, (rest, numbers) in enumerate(zip(rests, both, strict=True), 1):
        table.add_row(str(i), f"{rest.start:z.1f}", f"{rest.stop:z.1f}", *(f"{number:+z.4f}" for number in numbers))
    table.add_row("rms", "", "", *(f"{number:.4f}" for number in np.sqrt(np.mean(both**2, axis=0))))
    return table
