"""The cases of a self-test, as text."""

from __future__ import annotations

from rich.table import Table

from tumble.selftest import SelftestRecord
from tumble.terminal.table import add_numbers, plain_table


def record_table(record: SelftestRecord) -> Table:
    """The cases of a record."""
    table = plain_table("case", "compared with")
    add_numbers(table, "found", "allowed")
    table.add_column("")
    for case in record.cases:
        allowed = f"{case.low:g} … {case.high:g}" if case.low > 0.0 else f"≤ {case.high:g}"
        verdict = "passed" if case.passed else "FAILED"
        table.add_row(
            case.name, case.source, f"{case.figure:.3g}", f"{allowed} {case.unit}".removesuffix(" 1"), verdict
        )
    return table
