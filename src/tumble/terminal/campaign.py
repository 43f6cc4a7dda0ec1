"""What a campaign found, as text."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.text import Text

from tumble.campaigns.summary import SummaryLine, said, varying
from tumble.sensors.parameters import shown_in
from tumble.terminal.table import plain_table


def summary_report(lines: Sequence[SummaryLine]) -> RenderableType:
    """The lines as tables: first how the trials ended, then the errors, where there are any."""
    axes = varying(lines)
    ended, errors = plain_table(), plain_table()
    for table, headings in (
        (ended, ("trials", "accepted", "not accepted", "failed")),
        (errors, ("bias", "scatter", "rms", "unit", "rms/bound", "coverage")),
    ):
        for axis in axes:
            table.add_column(axis, justify="right")
        table.add_column("method")
        if table is errors:
            table.add_column("parameters")
        for heading in headings:
            table.add_column(heading, justify="left" if heading == "unit" else "right")
    before: list[str] = []
    for line in lines:
        where = [said(line.point[axis]) for axis in axes] + [line.method]
        if where != before:
            refused = line.trials - line.accepted - line.failed
            ended.add_row(*where, str(line.trials), str(line.accepted), str(refused), str(line.failed))
        if line.rms is not None:
            errors.add_row(*(where if where != before else [""] * len(where)), line.group, *_figures(line))
        before = where
    return Group(ended, Text(""), errors) if errors.row_count else ended


def _figures(line: SummaryLine) -> list[str]:
    assert line.bias is not None
    assert line.scatter is not None
    assert line.rms is not None
    size, unit = shown_in(line.group, line.unit, line.rms)
    return [
        *(f"{value / size:.3g}" for value in (line.bias, line.scatter, line.rms)),
        unit,
        "" if line.to_bound is None else f"{line.to_bound:.3f}",
        "" if line.coverage is None else f"{line.coverage:.1%}",
    ]
