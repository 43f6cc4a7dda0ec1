"""The data sheet of a device type as tables, and as a page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from tumble.files import ending_in, whole_file
from tumble.lab.datasheet import Datasheet, DatasheetRow
from tumble.sensors.model import WORDS
from tumble.sensors.parameters import shown_in
from tumble.views.blocks import Block, Document, Facts, Part, Table, Text, section
from tumble.views.numbers import quantity_table
from tumble.views.render.pages import page

_MEANING = (
    "Min, typical (mean) and max of the units by their own recordings; s is the standard deviation between them, of "
    "which u is what the recordings do not know; run to run is what a unit changes by from power-on to power-on. The "
    "tolerance interval contains 95 % of all units of the type with 95 % confidence, where they are normally "
    "distributed (ISO 16269-6). Terms by IEEE Std 2700 and 952."
)


def datasheet_blocks(sheet: Datasheet) -> list[Block]:
    """The facts of a data sheet, a table for each kind of sensor, and what the columns are."""
    return [Facts(rows=_facts(sheet)), *_tables(sheet), Text(text=_MEANING, tone="small")]


def _facts(sheet: Datasheet) -> tuple[tuple[str, str], ...]:
    facts = [("type", sheet.model), ("units", str(sheet.units))]
    return (*facts, *([] if sheet.reference is None else [("at", f"{sheet.reference:.1f} °C")]))


def _tables(sheet: Datasheet) -> Iterator[Table]:
    """A table for each kind of sensor; a parameter is shown in the unit of its largest value."""
    for kind, words in WORDS.items():
        rows = [row for row in sheet.rows if row.name.startswith(f"{kind}.")]
        units = {
            row.name: shown_in(row.name.replace(".in_run", ".bias.x"), row.unit, max(abs(row.least), abs(row.most)))
            for row in rows
        }
        if rows:
            yield quantity_table(rows, units, _cells, words=("term",), caption=words.capitalize(), dense=True)


def _cells(row: DatasheetRow, size: float, unit: str) -> dict[str, str]:
    """The cells of a parameter by their headings."""

    def cell(value: float | None, digits: int = 3) -> str:
        return "" if value is None else f"{float(f'{value / size:.{digits}g}'):.10g}"

    return {
        "term": row.term,
        "N": str(row.units),
        "min": cell(row.least),
        "typical": cell(row.typical),
        "max": cell(row.most),
        "s": cell(row.between),
        "run to run": cell(row.run_to_run),
        "u": cell(row.u, 2),
        "95/95 from": cell(row.low),
        "to": cell(row.high),
        "unit": unit,
    }


def write_datasheet(sheet: Datasheet, out: Path, created: str) -> None:
    """Write a data sheet, `created` at a time (ISO 8601), as a page (.html). Raises InputError for another ending."""
    ending_in(out, ".html")
    sections = tuple(section(each.caption, replace(each, caption="")) for each in _tables(sheet))
    document = Document(
        title="Data sheet",
        device=sheet.model,
        tone="good",
        verdict=f"{sheet.units} units",
        facts=_facts(sheet),
        created=created,
        parts=(Part(title="", sections=sections, customer=len(sections)),),
        statements=(_MEANING,),
        closing="End of the data sheet",
    )
    with whole_file(out) as temporary:
        temporary.write_text(page(document), encoding="utf-8")
