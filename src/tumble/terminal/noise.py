"""Noise of the sensors, as text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from tumble.terminal.table import add_numbers, plain_table

if TYPE_CHECKING:
    from tumble.reduction.allan_deviation import Panel


def noise_report(source: str, panels: Sequence[Panel]) -> RenderableType:
    """Noise coefficients of every channel."""
    from tumble.reduction.allan_deviation import shown

    table = plain_table("sensor", "noise", "symbol")
    add_numbers(table, "value", "u (k=1)")
    table.add_column("unit")
    for panel in panels:
        for channel, parameters in zip(panel.channels, panel.parameters, strict=True):
            coefficients = shown(parameters, panel.unit)
            for c in coefficients:
                table.add_row(channel, c.name, c.symbol, c.value, c.u, c.unit)
            if not coefficients:
                table.add_row(channel, "none that the record shows")
    return Group(Text(source), Text(""), table)
