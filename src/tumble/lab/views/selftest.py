"""The reference cases of a self-test."""

from __future__ import annotations

from tumble.lab.selftest import SelftestRecord
from tumble.views.blocks import Block, table


def selftest_blocks(record: SelftestRecord) -> list[Block]:
    """The cases, on which machine they ran, and whether all passed."""
    rows = []
    for case in record.cases:
        allowed = f"{case.low:g} … {case.high:g}" if case.low > 0.0 else f"≤ {case.high:g}"
        row = {"case": case.name, "compared with": case.source, "found": f"{case.figure:.3g}"}
        row |= {"allowed": f"{allowed} {case.unit}".removesuffix(" 1"), "": "passed" if case.passed else "FAILED"}
        rows.append(row)
    return [
        table(rows, words=("case", "compared with", "")),
        f"{record.software} on {record.machine['system']}, {record.date}, run by {record.by}\n"
        f"{'passed' if record.passed else 'FAILED'}",
    ]
