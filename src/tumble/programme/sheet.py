"""The operator's sheet of a programme: a table for the terminal, a page to print, a drawing of all positions."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tumble.programme.positions import Programme
from tumble.programme.sheet_pictures import (
    BODY_COLOURS,
    GREY,
    HALF,
    element,
    legend,
    picture,
    scene_of,
    scene_of_directions,
    svg_picture,
    text_element,
)
from tumble.programme.sheet_words import RATE, REST, SheetRow, notes_of, pace_of, sheet_rows
from tumble.usual_setup import MOVE

_LEGEND = "N north, U up, E east"
_COLUMNS, _CELL_WIDTH, _CELL_HEIGHT, _TOP = 4, 230.0, 250.0, 34.0


def sheet_drawing(programme: Programme, *, rest: float = REST, rate: float = RATE, move: float = MOVE) -> str:
    """Return an SVG with the directions and, for every position in order, its picture, its label and the move to it."""
    rows = sheet_rows(programme, rest=rest, rate=rate, move=move)
    title = f"{programme.name}: {pace_of(programme, rows, rate, move)}"
    cells = [_cell(scene_of_directions(), ("", "", _LEGEND))]
    for row in rows:
        lines = (f"{row.number}. {row.how}", row.position.label, row.attitude)
        cells.append(_cell(scene_of(row.position, row.move), lines))
    placed = []
    for i, cell in enumerate(cells):
        down, across = divmod(i, _COLUMNS)
        corner = f"translate({_CELL_WIDTH * across} {_TOP + _CELL_HEIGHT * down})"
        placed.append(element("g", cell, transform=corner))
    width, height = _CELL_WIDTH * _COLUMNS, _TOP + _CELL_HEIGHT * math.ceil(len(cells) / _COLUMNS)
    paper = element("rect", width=width, height=height, fill="#ffffff")
    heading = text_element("text", title, x=12, y=24, font_size=15, font_weight="bold")
    return svg_picture(0, 0, width, height, text_element("title", title), paper, heading, *placed) + "\n"


def _cell(scene: str, lines: tuple[str, str, str]) -> str:
    """Return a scene with lines of text below it."""
    middle = 0.5 * _CELL_WIDTH
    texts = [
        text_element("text", line, x=middle, y=2 * HALF + 18 + 16 * i, text_anchor="middle", font_size=12, **style)
        for i, (line, style) in enumerate(zip(lines, ({"font_weight": "bold"}, {}, {"fill": GREY}), strict=True))
    ]
    return element("g", scene, transform=f"translate({middle} {HALF})") + "".join(texts)


_STYLE = """
@page { size: A4; margin: 11mm 12mm 11mm 16mm }
body { font: 9pt/1.3 Helvetica, Arial, sans-serif; color: #111; max-width: 182mm; margin: 0 auto }
@media screen { body { padding: 6mm } }
h1 { font-size: 15pt; margin: 0 }
p { margin: 0 }
.form { display: flex; gap: 4mm; margin: 1mm 0 2mm }
.form span { flex: 1 1 0; border-bottom: .3mm solid #888; padding-top: 4mm }
.head { display: flex; gap: 4mm; align-items: center; margin: 0 0 1mm; font-size: 8pt }
.head svg { width: 28mm; height: 28mm; flex: none }
.head ul { margin: .5mm 0; padding-left: 4mm }
table { border-collapse: collapse; width: 100%; table-layout: fixed }
thead th { text-align: left; font-weight: normal; color: #555; border-bottom: .5mm solid #111; padding: 0 2mm .5mm 0 }
tr { break-inside: avoid }
tbody td { border-bottom: .2mm solid #bbb; padding: 0 2mm 0 0; vertical-align: middle }
td svg { display: block; width: 28mm; height: 28mm }
.number { font-size: 15pt; font-weight: bold }
.box { display: block; width: 6mm; height: 6mm; border: .4mm solid #111; margin-top: 1mm }
.how { font-weight: bold; font-size: 10pt }
.points span { white-space: nowrap }
.code { font-family: monospace }
.line { border-bottom: .3mm solid #888; height: 7.5mm; display: flex; align-items: flex-end; color: #555 }
.line span { flex: 1 1 0 }
"""


def sheet_page(
    programme: Programme,
    *,
    rest: float = REST,
    rate: float = RATE,
    move: float = MOVE,
    serial: str = "",
    number: str = "",
    revision: str = "",
) -> str:
    """Return an HTML page to print on A4: every position with its picture, a box to tick, and lines for times, notes
    and signatures.

    It is self-contained, without scripts or other files. A missing serial number of the device, or number and revision
    of the sheet, leaves an empty line."""
    rows = sheet_rows(programme, rest=rest, rate=rate, move=move)
    title = text_element("title", programme.name)
    head = element("head", element("meta", charset="utf-8"), title, element("style", _STYLE))
    colours = [text_element("b", name, style=f"color: {colour}") for name, colour in BODY_COLOURS.items()]
    key = element("p", "Pictures: ", ", ".join(colours), f" body axes; {_LEGEND}, as drawn here.")
    notes = element("ul", *(text_element("li", note) for note in notes_of(programme)))
    columns = (("", "9mm"), ("position", "32mm"), ("how to get there", "70mm"), ("times and notes", "auto"))
    widths = element("colgroup", *(element("col", style=f"width: {width}") for _, width in columns))
    heads = element("thead", element("tr", *(text_element("th", heading) for heading, _ in columns)))
    body = element(
        "body",
        text_element("h1", programme.name),
        text_element("p", pace_of(programme, rows, rate, move)),
        *(_form(captions) for captions in form_of(serial, number, revision)),
        element("div", legend(), element("div", key, notes), class_="head"),
        element("table", widths, heads, element("tbody", *map(_position, rows))),
        _form(SIGNATURES),
    )
    return "<!DOCTYPE html>\n" + element("html", head, body, lang="en") + "\n"


SIGNATURES = ("Recorded: name, date, signature", "Checked: name, date, signature")


def form_of(serial: str, number: str, revision: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the captions of the lines to write on, in two rows, with the values that are known."""
    device, sheet, issue = (
        f"{caption} {value}".rstrip()
        for caption, value in (("Device", serial), ("Sheet no.", number), ("Revision", revision))
    )
    return (device, "Operator", "Date", "Place"), (sheet, issue, "Log", "Conditions, equipment")


def _form(captions: Sequence[str]) -> str:
    return element("div", *(text_element("span", text) for text in captions), class_="form")


def _position(row: SheetRow) -> str:
    points = [text_element("span", f"{name} → {where}") for name, where in zip("XYZ", row.points, strict=True)]
    words = (
        text_element("div", row.how, class_="how"),
        text_element("div", row.position.label),
        element("div", ", ".join(points), class_="points"),
        text_element("div", row.attitude, class_="code"),
        text_element("div", f"rest {row.when}"),
    )
    times = element("div", text_element("span", "start"), text_element("span", "stop"), class_="line")
    number = text_element("span", str(row.number), class_="number") + element("span", "", class_="box")
    note = element("div", "", class_="line")
    cells = (number, picture(row.position, row.move), "".join(words), times + 2 * note)
    return element("tr", *(element("td", cell) for cell in cells))
