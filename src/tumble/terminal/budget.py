"""Budgets and requirements, as text."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from tumble.terminal.table import add_numbers, plain_table
from tumble.units import DEGREE, engineering

if TYPE_CHECKING:
    from tumble.planning.bounds import Bound
    from tumble.planning.budget import Budget
    from tumble.planning.requirements import Requirements


def budget_report(budget: Budget, bound: Bound | None) -> RenderableType:
    """Expected errors of every method, pass and group of parameters, beside the least that any method can have."""
    table = plain_table("method", "pass", "parameters", "estimator", named_by=3)
    add_numbers(table, "error (rms)", "of the spread", *(["bound"] if bound is not None else []))
    table.add_column("mostly from")
    for row in budget.rows:
        numbers = [_quantity(row.error, row.unit), f"{row.relative:.2%}"]
        numbers += [_quantity(bound.rms(row.group), row.unit)] if bound is not None else []
        table.add_row(row.method, str(row.iteration), row.group, row.estimator, *numbers, row.dominating)
    return table


def _quantity(value: float, unit: str) -> str:
    """A value, SI, in its engineering unit; nothing where it is infinite."""
    size, shown = engineering(unit, value)
    return f"{value / size:.3g} {shown}" if math.isfinite(value) else ""


def requirements_report(requirements: Requirements) -> RenderableType:
    """What each wanted accuracy asks of table, mounting and rests, and what meets all of them."""
    table = plain_table("parameters")
    add_numbers(table, "wanted", "table within", "mounting within", "rest at least")
    table.add_column("because")
    for row in requirements.rows:
        size, unit = engineering(row.unit, row.wanted)
        needs = (
            (_within(row.table_error, row.limited), _within(row.mounting_error, row.limited), f"{row.rest:.3g} s")
            if row.feasible
            else ("no table", "", "")
        )
        table.add_row(row.group, f"{row.wanted / size:.3g} {unit}", *needs, row.reason)
    together = (
        f"together: table within ±{requirements.table_error / DEGREE:.2f}°, mounting within "
        f"±{requirements.mounting_error / DEGREE:.2f}°, rests of at least {requirements.rest:.3g} s"
    )
    return Group(table, Text(""), Text(together)) if any(row.feasible for row in requirements.rows) else table


def _within(angle: float, limited: bool) -> str:
    return f"±{angle / DEGREE:.2f}°" if limited else "any (±5°)"
