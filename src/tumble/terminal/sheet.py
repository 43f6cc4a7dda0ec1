"""The operator's sheet of a programme, as text."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.text import Text

from tumble.programme.positions import Programme
from tumble.programme.sheet_words import RATE, REST, notes_of, pace_of, sheet_rows
from tumble.terminal.table import add_numbers, plain_table
from tumble.usual_setup import MOVE


def sheet_table(programme: Programme, *, rest: float = REST, rate: float = RATE, move: float = MOVE) -> RenderableType:
    """The sheet for a terminal: how to get to each position, where the body axes point, and when."""
    rows = sheet_rows(programme, rest=rest, rate=rate, move=move)
    table = plain_table()
    add_numbers(table, "")
    for heading in ("how to get there", "attitude", "X", "Y", "Z", "up and down"):
        table.add_column(heading)
    add_numbers(table, "rest")
    for row in rows:
        cells = (str(row.number), row.how, row.attitude, *row.points, row.position.label, row.when)
        table.add_row(*map(Text, cells))
    title = Text(f"{programme.name}: {pace_of(programme, rows, rate, move)}")
    return Group(title, Text(""), table, Text(""), *map(Text, notes_of(programme)))
