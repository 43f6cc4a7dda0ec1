"""Tables for a terminal: no lines, words set to the left, numbers to the right."""

from __future__ import annotations

from rich.table import Table


def plain_table(*headings: str) -> Table:
    """A table that begins with columns of words."""
    table = Table(box=None, pad_edge=False)
    for heading in headings:
        table.add_column(heading)
    return table


def add_numbers(table: Table, *headings: str) -> None:
    """Add columns of numbers, which are never broken."""
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
