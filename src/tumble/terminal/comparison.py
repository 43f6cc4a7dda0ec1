"""Two calibrations side by side, as text."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from tumble.calibration.compare import Comparison, Difference
from tumble.sensors.parameters import group_name, shown_in
from tumble.terminal.table import add_numbers, plain_table
from tumble.terminal.text import probability_text
from tumble.units import rounded


def comparison_report(comparison: Comparison) -> RenderableType:
    """All that `tumble compare` prints."""
    parts: list[RenderableType] = [Text(f"frame {comparison.frame}"), Text(""), _table(comparison), Text("")]
    return Group(*parts, *map(Text, judged_lines(comparison)))


def judged_lines(comparison: Comparison) -> list[str]:
    """How many differences are beyond their U, how likely chance makes the largest of so many, and χ² of all together,
    in sentences."""
    beyond = [d.name for d in comparison.differences if d.e_n is not None and abs(d.e_n) > 1.0]
    judged = sum(d.e_n is not None for d in comparison.differences)
    line = f"{len(beyond)} of {judged} |E_n| beyond 1"
    if comparison.largest_by_chance is not None:
        chance = probability_text(comparison.largest_by_chance)
        line += f", one as large as the largest by chance with probability {chance}"
    if comparison.probability is None:
        return [line]
    return [
        line,
        f"all together: χ² {comparison.chi_square:.1f} for {comparison.degrees}, exceeded by chance with probability "
        f"{probability_text(comparison.probability)}",
    ]


def _table(comparison: Comparison) -> Table:
    """Values, difference, its uncertainty and E_n of every common parameter, in engineering units."""
    table = plain_table("parameter")
    add_numbers(table, "first", "second", "difference", "u (k=1)")
    table.add_column("unit")
    add_numbers(table, "d/u", "E_n")
    units = _units(comparison.differences)
    for d in comparison.differences:
        size, unit = units[group_name(d.name)]
        u = (d.u or 0.0) / size
        numbers = [rounded(value / size, u)[0] for value in (d.first, d.second, d.value)]
        judged = ["", ""] if d.e_n is None or not d.u else [f"{d.value / d.u:+z.2f}", f"{d.e_n:+z.2f}"]
        table.add_row(d.name, *numbers, rounded(0.0, u)[1] if d.u else "", unit, *judged)
    return table


def _units(differences: Sequence[Difference]) -> dict[str, tuple[float, str]]:
    """The unit in which each kind of parameter is shown, by its largest number, as (size in SI, unit)."""
    largest: dict[str, float] = {}
    for d in differences:
        kind = group_name(d.name)
        largest[kind] = max(largest.get(kind, 0.0), abs(d.first), abs(d.second), d.u or 0.0)
    si = {group_name(d.name): d.unit for d in differences}
    return {kind: shown_in(kind, si[kind], size) for kind, size in largest.items()}
