"""The data sheet of a device type as tables, Markdown, and a document."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from tumble.documents import plain
from tumble.errors import needs_extra
from tumble.files import ending_in, whole_file
from tumble.result.further import KINDS
from tumble.sensors.parameters import group_name, shown_in
from tumble.views.blocks import Block, Document, Facts, Part, Table, Text, section, table
from tumble.views.render.data import Content, fields

if TYPE_CHECKING:
    from tumble.lab.datasheet import Datasheet, DatasheetRow

ENDINGS = (".md", ".html", ".pdf")
_EXPLAINED = (
    "Min, typical (mean) and max of the units by their own recordings; s is the standard deviation between them, of "
    "which u is what the recordings do not know; run to run is what a unit changes by from power-on to power-on. The "
    "tolerance interval contains 95 % of all units of the type with 95 % confidence, where they are normally "
    "distributed (ISO 16269-6). Terms by IEEE Std 2700, or else by IEEE Std 528 and 952."
)


def datasheet_blocks(sheet: Datasheet) -> list[Block]:
    """The facts of a data sheet, a table for each kind of sensor, and what the columns are."""
    return [Facts(rows=_facts(sheet)), *_tables(sheet), Text(text=_EXPLAINED, tone="small")]


def datasheet_data(sheet: Datasheet) -> Content:
    """A data sheet as data, SI."""
    return fields(sheet, "model units recordings reference") | {"content": 0.95, "confidence": 0.95, "rows": sheet.rows}


def _facts(sheet: Datasheet) -> tuple[tuple[str, str], ...]:
    facts = [("type", sheet.model), ("units", str(sheet.units)), ("recordings", str(sheet.recordings))]
    return (*facts, *([] if sheet.reference is None else [("at", f"{sheet.reference:.1f} °C")]))


def _tables(sheet: Datasheet) -> Iterator[Table]:
    """A table for each kind of sensor; a group is shown in one unit."""
    for kind, words in KINDS.items():
        rows = [row for row in sheet.rows if row.name.startswith(f"{kind}.")]
        largest: dict[str, float] = {}
        for row in rows:
            group = _group(row)
            largest[group] = max(largest.get(group, 0.0), abs(row.least), abs(row.most))
        if rows:
            yield table(
                (_cells(row, largest[_group(row)]) for row in rows),
                words=_WORDS,
                caption=words.capitalize(),
                dense=True,
            )


_WORDS = ("parameter", "term", "unit")


def _group(row: DatasheetRow) -> str:
    return row.name if row.name.endswith(".in_run") else group_name(row.name)


def _cells(row: DatasheetRow, largest: float) -> dict[str, str]:
    """The cells of a parameter by their headings."""
    size, unit = shown_in(row.name.replace(".in_run", ".bias.x"), row.unit, largest)

    def cell(value: float | None, digits: int = 3) -> str:
        return "" if value is None else f"{float(f'{value / size:.{digits}g}'):.10g}"

    return {
        "parameter": row.name,
        "term": row.term or row.inertial_term,
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


def markdown(blocks: Iterable[Block]) -> str:
    """Facts, tables and paragraphs as Markdown."""
    lines: list[str] = []
    for block in blocks:
        if isinstance(block, Facts):
            lines += [f"* {name}: {_escaped(value)}" for name, value in block.rows]
        elif isinstance(block, Table):
            lines += [f"## {block.caption}", "", _line(block.columns)]
            lines.append(_line(":--" if i in block.text else "--:" for i in range(len(block.columns))))
            lines += [_line(map(_escaped, row)) for row in block.rows]
        elif isinstance(block, Text):
            lines.append(_escaped(block.text))
        lines.append("")
    return "\n".join(lines)


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _escaped(text: str) -> str:
    return plain(text).replace("\\", "\\\\").replace("|", "\\|").replace("<", "&lt;")


def write_datasheet(sheet: Datasheet, out: Path, created: str) -> None:
    """Write a data sheet, `created` at a time in ISO 8601, as Markdown, HTML or PDF by the ending of the file. Raises
    InputError for another, MissingExtraError without the extra for the last two."""
    ending = ending_in(out, *ENDINGS)
    blocks = datasheet_blocks(sheet)
    if ending == ".md":
        content = f"# Data sheet: {_escaped(sheet.model)}\n\n{markdown(blocks)}".encode()
    else:
        sections = tuple(section(each.caption, replace(each, caption="")) for each in _tables(sheet))
        document = Document(
            title="Data sheet",
            device=sheet.model,
            tone="good",
            verdict=f"{sheet.units} units",
            facts=_facts(sheet),
            created=created,
            parts=(Part(title="", sections=sections, customer=len(sections)),),
            statements=(_EXPLAINED,),
            closing="End of the data sheet",
        )
        with needs_extra("a data sheet as a page", "lab", "jinja2", "matplotlib", "typst"):
            from tumble.views.render.pages import written

            content = written(document, ending)
    with whole_file(out) as temporary:
        temporary.write_bytes(content)
