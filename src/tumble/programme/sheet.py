"""The operator's sheet of a programme: a page to print, a drawing of all positions, and pictures of single positions.

Pictures are orthographic, from a fixed viewpoint in front of the table: south, a little to the east, above, so that no
two arrows coincide in any position of a built-in programme. Picture coordinates are x right, y up, z towards the
viewer, in units of `SCALE` pixels; `VIEW` rotates geographic (N, U, E) to them.

A picture is drawn from back to front. This is exact: the cube is convex and centred at the origin, and an arrow that
starts on one of its faces is in front of it or behind it as that face is.
"""

from __future__ import annotations

import html
import math
from collections.abc import Sequence

import numpy as np

from tumble.programme.positions import ANY_MOVE, Move, Position, Programme
from tumble.programme.sheet_words import (
    POINTS,
    RATE,
    REST,
    SheetRow,
    direction,
    move_text,
    notes_of,
    pace_of,
    points_of,
    sheet_rows,
    short_code,
    signed_angle,
)
from tumble.rotation import tangent_basis
from tumble.units import DEGREE, Array
from tumble.usual_setup import MOVE


def element(tag: str, *content: str, **attributes: object) -> str:
    """Return an HTML or SVG element. Content is markup; attribute values are escaped. `class_` is class and
    `stroke_width` is stroke-width."""
    named = {name.rstrip("_").replace("_", "-"): value for name, value in attributes.items()}
    inside = "".join(f' {name}="{html.escape(str(value))}"' for name, value in named.items())
    return f"<{tag}{inside}>{''.join(content)}</{tag}>" if content else f"<{tag}{inside}/>"


def text_element(tag: str, text: str, **attributes: object) -> str:
    """Return an element with text, escaped."""
    return element(tag, html.escape(text), **attributes)


def _number(value: float) -> str:
    return f"{round(float(value), 1) + 0.0:.1f}"


def _xy(point: Array) -> tuple[str, str]:
    """Return picture coordinates in SVG: pixels, y down."""
    return _number(SCALE * point[0]), _number(-SCALE * point[1])


def _polyline(tag: str, points: Array, **attributes: object) -> str:
    return element(tag, points=" ".join(",".join(_xy(point)) for point in points), **attributes)


def _line(start: Array, stop: Array, **attributes: object) -> str:
    (x1, y1), (x2, y2) = _xy(start), _xy(stop)
    return element("line", x1=x1, y1=y1, x2=x2, y2=y2, **attributes)


def svg_picture(left: float, top: float, width: float, height: float, *content: str) -> str:
    """An SVG image of this content."""
    box, font = f"{left:g} {top:g} {width:g} {height:g}", "Helvetica, Arial, sans-serif"
    return element("svg", *content, xmlns="http://www.w3.org/2000/svg", viewBox=box, font_family=font)


SCALE = 50.0  # pixels of SVG in a unit of length
AXIS = 1.4  # length of the arrow of a body axis, from the middle of the cube to its tip
CUBE = 0.43  # half an edge of the cube


def _view(east_of_south: float, above: float) -> Array:
    """Return the rotation geographic → picture for a viewer at this azimuth, rad from south to east, and elevation,
    rad."""
    s, c = math.sin(east_of_south), math.cos(east_of_south)
    towards = np.array([-c * math.cos(above), math.sin(above), s * math.cos(above)])
    right = np.array([s, 0.0, c])
    return np.stack([right, np.cross(towards, right), towards])


VIEW = _view(22.0 * DEGREE, 42.0 * DEGREE)  # geographic (N, U, E) → picture (right, up, towards the viewer), a rotation

BODY_COLOURS = {"X": "#c0392b", "Y": "#2e8b57", "Z": "#2c5fa8"}
_TURN_COLOUR = "#7d3c98"
GREY = "#555555"
_LIGHT = np.array([-0.35, 0.75, 0.56])  # direction of the light, in picture coordinates
_HEAD, _HEAD_RADIUS = 0.34, 0.115  # length and radius of the cone at the tip of an arrow
_RING, _RING_RADIUS, _RING_HEAD = 1.52, 0.3, 0.5  # of a turn: distance and radius of its arc, and its head, rad
HALF = 1.86 * SCALE  # half a side of a picture, pixels
_BEHIND = 1e-6  # an axis of a turn is drawn before the body axis along it
_MOST_OF_A_RING = 300.0 * DEGREE


def picture(position: Position, move: Move = ANY_MOVE) -> str:
    """Return the SVG of a position: a cube with the body axes as arrows, and the turn to it as an arrow about its
    axis."""
    x, y, z = points_of(position)
    title = f"{short_code(position.attitude)}: X → {x}, Y → {y}, Z → {z}; {move_text(move)}"
    return _whole(title, scene_of(position, move))


def _whole(title: str, scene: str) -> str:
    return svg_picture(-HALF, -HALF, 2 * HALF, 2 * HALF, text_element("title", title), scene)


def ghost(attitude: Array) -> dict[str, list[list[float]]]:
    """Return the cube and its body axes in an attitude (3, 3), body → geographic, in picture coordinates: by name, the
    lines (x₁, y₁, x₂, y₂) of the "edges" and of the axes "X", "Y" and "Z", which end at the tip."""
    axes = VIEW @ attitude
    corners = [CUBE * axes @ sign for sign in (2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1.0)]
    edges = [(a, b) for i, a in enumerate(corners) for j, b in enumerate(corners) if i < j and (i ^ j) in (1, 2, 4)]
    lines = {"edges": edges, **{name: [(CUBE * axis, AXIS * axis)] for name, axis in zip("XYZ", axes.T, strict=True)}}
    return {
        name: [[round(SCALE * v, 1) for v in (a[0], -a[1], b[0], -b[1])] for a, b in pairs]
        for name, pairs in lines.items()
    }


def scene_of(position: Position, move: Move) -> str:
    """Return the markup of the turn, the axes and the cube of a picture, from back to front."""
    axes = VIEW @ position.matrix
    parts = _turn(move)
    for name, axis in zip("XYZ", axes.T, strict=True):
        parts.append((float(axis[2]), _arrow(name, AXIS * axis, BODY_COLOURS[name], start=CUBE / AXIS)))
    parts.append((0.0, _cube(axes)))
    drawn = [markup for _, markup in sorted(parts, key=lambda part: part[0])]
    if move.axis is not None and move.angle is not None:
        x, y = _xy(np.array([-1.8, 1.6]))
        words = f"{signed_angle(move.angle)} {direction(move.axis)}"
        drawn.append(text_element("text", words, x=x, y=y, fill=_TURN_COLOUR, font_size=14))
    return "".join(drawn)


def _arrow(name: str, tip: Array, colour: str, *, start: float) -> str:
    """Return an arrow with a conical head, from `start` (fraction of its length) to `tip`, with its letter beyond."""
    length = float(np.linalg.norm(tip))
    along = tip / length
    base = tip - _HEAD * along
    shaft = _line(start * tip, base, stroke=colour, stroke_width=3.5)
    # silhouette of the cone without its base, beginning at the tip, and the base, a circle seen as an ellipse
    across = _HEAD_RADIUS * np.array([-along[1], along[0]]) / max(float(np.hypot(along[0], along[1])), 1e-9)
    cone = _polyline("polygon", np.array([tip[:2], base[:2] + across, base[:2] - across]), fill=colour)
    turned = -math.atan2(float(along[1]), float(along[0])) / DEGREE + 90.0
    x, y = _xy(base)
    base_of_it = element(
        "ellipse",
        rx=_number(SCALE * _HEAD_RADIUS),
        ry=_number(SCALE * _HEAD_RADIUS * abs(float(along[2]))),
        fill=colour if along[2] > 0.0 else _mix(colour, 0.0, 0.65),
        transform=f"translate({x} {y}) rotate({_number(turned)})",
    )
    order = [shaft, base_of_it, cone] if along[2] > 0.0 else [cone, base_of_it, shaft]
    flat = tip[:2] / max(float(np.hypot(*tip[:2])), 1e-9)
    x, y = _xy(tip[:2] + 0.2 * flat)
    centred = {"text_anchor": "middle", "dy": "0.36em", "font_weight": "bold"}
    letter = text_element("text", name, x=x, y=y, fill=colour, font_size=17, **centred)
    return element("g", *order, letter, class_=f"axis-{name}")


def _cube(axes: Array) -> str:
    """Return the faces of the cube that face the viewer, tinted by the body axis normal to them."""
    faces = []
    for i, name in enumerate("XYZ"):
        for sign in (1.0, -1.0):
            normal = sign * axes[:, i]
            if normal[2] > 0.0:
                fill = _mix(BODY_COLOURS[name], 0.7, 0.78 + 0.22 * max(0.0, float(normal @ _LIGHT)))
                first, second = axes[:, (i + 1) % 3], axes[:, (i + 2) % 3]
                corners = [normal + a * first + b * second for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
                faces.append(_polyline("polygon", CUBE * np.array(corners), fill=fill, stroke=GREY, stroke_width=0.8))
    return element("g", *faces, class_="cube", stroke_linejoin="round")


def _mix(colour: str, white: float, shade: float) -> str:
    """Return a colour with this fraction of white, then darkened to the fraction `shade`."""
    channels = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return "#" + "".join(f"{round(shade * (white * 255 + (1.0 - white) * c)):02x}" for c in channels)


def _turn(move: Move) -> list[tuple[float, str]]:
    """Return (depth, markup) of the two halves of the axis of a turn and of the arrow about it."""
    if move.axis is None or move.angle is None:
        return []
    axis = VIEW @ move.axis
    reach = _RING / max(float(np.hypot(axis[0], axis[1])), 0.5)
    style = {"stroke": _TURN_COLOUR, "stroke_width": 1.2, "stroke_dasharray": "7 3 2 3"}
    depth = float(axis[2])
    return [
        (depth - _BEHIND, _line(CUBE * axis, 1.2 * reach * axis, **style)),
        (-depth - _BEHIND, _line(-CUBE * axis, -0.6 * reach * axis, **style)),
        (depth, _ring(reach * axis, axis, move.angle)),
    ]


def _ring(centre: Array, axis: Array, angle: float) -> str:
    """Return an arrow about an axis by an angle (a full turn is left open), its middle towards the viewer."""
    first, second = tangent_basis(axis)
    shown = math.copysign(min(abs(angle), _MOST_OF_A_RING), angle)
    middle = math.atan2(float(second[2]), float(first[2]))
    end = middle + 0.5 * shown

    def at(radius: float, phase: float) -> Array:
        return np.asarray(centre + radius * (math.cos(phase) * first + math.sin(phase) * second))

    arc = np.array([at(_RING_RADIUS, phase) for phase in np.linspace(middle - 0.5 * shown, end, 25)])
    tip = at(_RING_RADIUS, end + math.copysign(_RING_HEAD, angle))
    head = np.array([tip, at(_RING_RADIUS + 0.11, end), at(_RING_RADIUS - 0.11, end)])
    return element(
        "g",
        _polyline("polyline", arc, fill="none", stroke=_TURN_COLOUR, stroke_width=3),
        _polyline("polygon", head, fill=_TURN_COLOUR),
        class_="turn",
    )


def legend() -> str:
    """Return the SVG of north, up and east in the pictures."""
    return _whole("Directions in the pictures", scene_of_directions())


def scene_of_directions() -> str:
    """Return north, up and east with the horizon."""
    circle = np.array([VIEW @ [math.cos(t), 0.0, math.sin(t)] for t in np.linspace(0.0, 2.0 * math.pi, 49)])
    ground = _polyline("polygon", circle, fill="#f0f0f0", stroke="#bbbbbb", stroke_width=0.8)
    arrows = [_arrow(name, AXIS * axis, GREY, start=0.0) for name, axis in zip("NUE", VIEW.T, strict=True)]
    return ground + "".join(arrows)


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
    notes = element("ul", *(text_element("li", note) for note in (*notes_of(programme), POINTS)))
    columns = (("", "9mm"), ("position", "32mm"), ("how to get there", "70mm"), ("times and notes", "auto"))
    widths = element("colgroup", *(element("col", style=f"width: {width}") for _, width in columns))
    heads = element("thead", element("tr", *(text_element("th", heading) for heading, _ in columns)))
    body = element(
        "body",
        text_element("h1", programme.name),
        text_element("p", pace_of(programme, rows, rate, move)),
        *(_form(captions) for captions in form_of(serial, number, revision)),
        element("div", legend(), element("div", key, notes), class_="head"),
        element("table", widths, heads, element("tbody", *map(_table_row, rows))),
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


def _table_row(row: SheetRow) -> str:
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
