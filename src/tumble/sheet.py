"""The operator's sheet of a programme: a table for the terminal, a page to print, a picture of every position.

Pictures are orthographic, from a fixed viewpoint in front of the table: south, a little to the east, above. It is
chosen so that in no position of a built-in programme two arrows fall together. Picture coordinates are x right,
y up, z towards the viewer, in units of `SCALE` pixels; `VIEW` takes geographic (N, U, E) to them.

A picture is drawn from back to front. That is exact here: the cube is convex and about the origin, and an arrow
that starts on one of its faces is in front of it or behind it as that face is.
"""

from __future__ import annotations

import html
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from tumble.errors import InputError
from tumble.programme import ANY_MOVE, Move, Position, Programme, timetable
from tumble.rotation import tangent_basis
from tumble.units import DEGREE, Array

REST = 60.0
"""Duration of a rest, s, where nothing else is asked for."""

RATE = 10.0 * DEGREE
"""Rate of programmed turns, rad/s, where nothing else is asked for."""

MOVE = 30.0
"""What is allowed for a move that is not a programmed turn, s, where nothing else is asked for."""

_COMPASS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """A position as the sheet says it. `points` is where body X, Y, Z point; start and stop of the rest in s."""

    number: int
    position: Position
    move: Move
    how: str
    attitude: str
    points: tuple[str, str, str]
    start: float
    stop: float

    @property
    def when(self) -> str:
        """Start and stop of the rest: "1:18 – 2:18"."""
        return f"{clock(self.start)} – {clock(self.stop)}"


def sheet_rows(programme: Programme, *, rest: float = REST, rate: float = RATE, move: float = MOVE) -> tuple[Row, ...]:
    """Every position of a programme in words, with its time: rests of `rest` s, turns at `rate` rad/s, and `move` s
    for each other move. Raises ProgrammeError as `programme.timetable`."""
    times = timetable(programme, rest=rest, rate=rate, move=move)
    moves = (ANY_MOVE, *programme.moves)
    return tuple(
        Row(
            number=number,
            position=position,
            move=reached,
            how=_how(programme, position, reached, number),
            attitude=_short(position.attitude),
            points=_points(position),
            start=float(start),
            stop=float(stop),
        )
        for number, (position, reached, (start, stop)) in enumerate(
            zip(programme.positions, moves, times, strict=True), 1
        )
    )


def _how(programme: Programme, position: Position, move: Move, number: int) -> str:
    """How a position is reached; in a programme in any order, what the block is stood on: "on a corner"."""
    if not programme.ordered:
        upright = np.count_nonzero(np.abs(position.vertical_b) > _OFF_THE_HORIZON)
        return ("on a face", "on an edge", "on a corner")[upright - 1]
    return "start" if number == 1 else move_text(move)


_OFF_THE_HORIZON = 0.1


def move_text(move: Move) -> str:
    """A move in words: "turn +180° about N" or "any move"."""
    if move.axis is None or move.angle is None:
        return "any move"
    return f"turn {_signed(move.angle)} about {direction(move.axis)}"


def direction(vector_n: Array) -> str:
    """Where a unit vector (N, U, E) points: N S E W U D, "NE", "45° up to E", or by the bearing, clockwise from
    north: "120°", "35° down to 120°". To the degree."""
    elevation = round(math.asin(max(-1.0, min(1.0, float(vector_n[1])))) / DEGREE)
    if abs(elevation) == 90:
        return "U" if elevation > 0 else "D"
    bearing = round(math.atan2(float(vector_n[2]), float(vector_n[0])) / DEGREE) % 360
    course = f"{bearing:03d}°" if bearing % 45 else _COMPASS[bearing // 45]
    if elevation == 0:
        return course
    return f"{abs(elevation)}° {'up' if elevation > 0 else 'down'} to {course}"


def clock(seconds: float) -> str:
    """A time as minutes and seconds, "20:12", or from an hour on "1:02:05"."""
    minutes, second = divmod(round(seconds), 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02d}:{second:02d}" if hours else f"{minute}:{second:02d}"


def _points(position: Position) -> tuple[str, str, str]:
    x, y, z = (direction(axis) for axis in position.matrix.T)
    return x, y, z


def _signed(angle: float) -> str:
    """An angle in degrees with its sign: "+180°", "−90.5°"."""
    return f"{angle / DEGREE:+.6g}°".replace("-", "−")


def _short(code: str) -> str:
    """An attitude code with angles to a ten-thousandth of a degree or six digits."""
    return re.sub(r"\d+\.\d+", lambda found: f"{float(found[0]):.6g}", code)


# -------------------- words --------------------


def _pace(programme: Programme, rows: Sequence[Row], rate: float, move: float) -> str:
    """ "15 positions, 20:12 in all: rests of 60 s, turns at 10 °/s, 30 s for any other move"."""
    parts = [f"rests of {rows[0].stop - rows[0].start:g} s"]
    if any(m.angle is not None for m in programme.moves):
        parts.append(f"turns at {rate / DEGREE:g} °/s")
    if any(m.angle is None for m in programme.moves):
        parts.append(f"{move:g} s for any other move" if len(parts) > 1 else f"{move:g} s for a move")
    count = f"{len(rows)} position" + ("s" if len(rows) > 1 else "")
    return f"{count}, {clock(rows[-1].stop)} in all: {', '.join(parts)}"


def _order(programme: Programme) -> str:
    if programme.ordered:
        return "In this order. Any move may be made between positions except where a turn is given."
    return (
        "In any order, and each turned about the vertical in any way: only what is up and down counts. The order and "
        "the directions given make the turns between the positions varied, which is good for gyros."
    )


_CODES = (
    "X, Y, Z point to north N, south S, east E, west W, up U or down D; 45° up to E is 45° above the horizon over "
    "east; 120° is a bearing, clockwise from north."
)
_TURNS = (
    "Turns are about north N, up U or east E by the right-hand rule: thumb along the axis, a positive turn goes the "
    "way the fingers point."
)
_CARE = (
    "Keep the log running from the first rest to the last, moves included. Attitudes may be a few degrees off; "
    "nothing may move during a rest."
)


def _notes(programme: Programme) -> list[str]:
    return [_order(programme), *([_TURNS] if any(m.angle is not None for m in programme.moves) else []), _CODES, _CARE]


# -------------------- the table --------------------


def sheet_table(programme: Programme, *, rest: float = REST, rate: float = RATE, move: float = MOVE) -> RenderableType:
    """The sheet for a terminal: how to get to each position, where the body axes point, and when."""
    rows = sheet_rows(programme, rest=rest, rate=rate, move=move)
    table = Table(box=None, pad_edge=False)
    table.add_column("", justify="right", no_wrap=True)
    for heading in ("how to get there", "attitude", "X", "Y", "Z", "up and down"):
        table.add_column(heading)
    table.add_column("rest", justify="right", no_wrap=True)
    for row in rows:
        cells = (str(row.number), row.how, row.attitude, *row.points, row.position.label, row.when)
        table.add_row(*map(Text, cells))
    title = Text(f"{programme.name}: {_pace(programme, rows, rate, move)}")
    return Group(title, Text(""), table, Text(""), *map(Text, _notes(programme)))


# -------------------- markup --------------------


def _element(tag: str, *content: str, **attributes: object) -> str:
    """An element of HTML or SVG. Content is markup; values of attributes are escaped. `class_` is class and
    `stroke_width` is stroke-width."""
    named = {name.rstrip("_").replace("_", "-"): value for name, value in attributes.items()}
    inside = "".join(f' {name}="{html.escape(str(value))}"' for name, value in named.items())
    return f"<{tag}{inside}>{''.join(content)}</{tag}>" if content else f"<{tag}{inside}/>"


def _words(tag: str, text: str, **attributes: object) -> str:
    """An element that holds text, escaped."""
    return _element(tag, html.escape(text), **attributes)


def _number(value: float) -> str:
    return f"{round(float(value), 1) + 0.0:.1f}"


def _xy(point: Array) -> tuple[str, str]:
    """Picture coordinates as SVG has them: pixels, y down."""
    return _number(SCALE * point[0]), _number(-SCALE * point[1])


def _polyline(tag: str, points: Array, **attributes: object) -> str:
    return _element(tag, points=" ".join(",".join(_xy(point)) for point in points), **attributes)


def _line(start: Array, stop: Array, **attributes: object) -> str:
    (x1, y1), (x2, y2) = _xy(start), _xy(stop)
    return _element("line", x1=x1, y1=y1, x2=x2, y2=y2, **attributes)


def _label(at: Array, text: str, colour: str) -> str:
    """A bold letter centred at a point."""
    x, y = _xy(at)
    centred = {"text_anchor": "middle", "dy": "0.36em", "font_weight": "bold"}
    return _words("text", text, x=x, y=y, fill=colour, font_size=17, **centred)


def _svg(left: float, top: float, width: float, height: float, *content: str) -> str:
    return _element(
        "svg",
        *content,
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"{left:g} {top:g} {width:g} {height:g}",
        font_family="Helvetica, Arial, sans-serif",
    )


# -------------------- pictures --------------------

SCALE = 50.0
"""Pixels of SVG in a unit of length."""

AXIS = 1.4
"""Length of the arrow of a body axis, from the middle of the cube to its tip."""

CUBE = 0.43
"""Half an edge of the cube."""


def _view(east_of_south: float, above: float) -> Array:
    """Geographic → picture for a viewer in this azimuth, rad from south to east, and this far above the horizon."""
    s, c = math.sin(east_of_south), math.cos(east_of_south)
    towards = np.array([-c * math.cos(above), math.sin(above), s * math.cos(above)])
    right = np.array([s, 0.0, c])
    return np.stack([right, np.cross(towards, right), towards])


VIEW = _view(22.0 * DEGREE, 42.0 * DEGREE)
"""Geographic (N, U, E) → picture (right, up, towards the viewer), a rotation."""

BODY_COLOURS = {"X": "#c0392b", "Y": "#2e8b57", "Z": "#2c5fa8"}
_TURN_COLOUR = "#7d3c98"
_GREY = "#555555"
_LIGHT = np.array([-0.35, 0.75, 0.56])
_HEAD, _HEAD_RADIUS = 0.34, 0.115
_RING, _RING_RADIUS, _RING_HEAD = 1.52, 0.3, 0.5
_HALF = 1.86 * SCALE
_BEHIND = 1e-6  # an axis of a turn is drawn before the body axis along it
_MOST_OF_A_RING = 300.0 * DEGREE


def picture(position: Position, move: Move = ANY_MOVE) -> str:
    """SVG of a position: a cube with the body axes as arrows, and the turn that leads to it as an arrow about its
    axis."""
    said = _words("title", _described(position, move))
    return _svg(-_HALF, -_HALF, 2 * _HALF, 2 * _HALF, said, _scene(position, move))


def _described(position: Position, move: Move) -> str:
    x, y, z = _points(position)
    return f"{_short(position.attitude)}: X → {x}, Y → {y}, Z → {z}; {move_text(move)}"


def _scene(position: Position, move: Move) -> str:
    """What is in a picture, from back to front: (depth, markup) of the turn, the axes and the cube, sorted."""
    axes = VIEW @ position.matrix
    parts = _turn(move)
    for name, axis in zip("XYZ", axes.T, strict=True):
        parts.append((float(axis[2]), _arrow(name, AXIS * axis, BODY_COLOURS[name], start=CUBE / AXIS)))
    parts.append((0.0, _cube(axes)))
    drawn = [markup for _, markup in sorted(parts, key=lambda part: part[0])]
    return "".join(drawn) + _turn_label(move)


def _arrow(name: str, tip: Array, colour: str, *, start: float) -> str:
    """An arrow with a cone for its head, from `start` (part of its length) to `tip`, with its letter beyond."""
    length = float(np.linalg.norm(tip))
    along = tip / length
    base = tip - _HEAD * along
    shaft = _line(start * tip, base, stroke=colour, stroke_width=3.5)
    head = [_cone(tip, base, along, colour), _disc(base, along, colour if along[2] > 0.0 else _mix(colour, 0.0, 0.65))]
    order = [shaft, *head[::-1]] if along[2] > 0.0 else [*head, shaft]
    flat = tip[:2] / max(float(np.hypot(*tip[:2])), 1e-9)
    return _element("g", *order, _label(tip[:2] + 0.2 * flat, name, colour), class_=f"axis-{name}")


def _cone(tip: Array, base: Array, along: Array, colour: str) -> str:
    """Silhouette of a cone less its base; the first corner is the tip."""
    across = np.array([-along[1], along[0]]) / max(float(np.hypot(along[0], along[1])), 1e-9)
    corners = np.array([tip[:2], base[:2] + _HEAD_RADIUS * across, base[:2] - _HEAD_RADIUS * across])
    return _polyline("polygon", corners, fill=colour)


def _disc(centre: Array, along: Array, colour: str) -> str:
    """A circle across `along`, which in the picture is an ellipse."""
    turned = -math.atan2(float(along[1]), float(along[0])) / DEGREE + 90.0
    x, y = _xy(centre)
    radius = SCALE * _HEAD_RADIUS
    return _element(
        "ellipse",
        rx=_number(radius),
        ry=_number(radius * abs(float(along[2]))),
        fill=colour,
        transform=f"translate({x} {y}) rotate({_number(turned)})",
    )


def _cube(axes: Array) -> str:
    """The faces of the cube that are turned to the viewer, tinted by the body axis across them."""
    faces = []
    for i, name in enumerate("XYZ"):
        for sign in (1.0, -1.0):
            normal = sign * axes[:, i]
            if normal[2] > 0.0:
                shade = 0.78 + 0.22 * max(0.0, float(normal @ _LIGHT))
                fill = _mix(BODY_COLOURS[name], 0.7, shade)
                faces.append(_polyline("polygon", _face(axes, i, sign), fill=fill, stroke=_GREY, stroke_width=0.8))
    return _element("g", *faces, class_="cube", stroke_linejoin="round")


def _face(axes: Array, i: int, sign: float) -> Array:
    """Corners (4, 3) of the face of the cube across body axis i."""
    normal, first, second = sign * axes[:, i], axes[:, (i + 1) % 3], axes[:, (i + 2) % 3]
    return CUBE * np.array([normal + a * first + b * second for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))])


def _mix(colour: str, white: float, shade: float) -> str:
    """A colour with this part of white, then darkened to `shade` of itself."""
    channels = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return "#" + "".join(f"{round(shade * (white * 255 + (1.0 - white) * c)):02x}" for c in channels)


def _turn(move: Move) -> list[tuple[float, str]]:
    """(depth, markup) of the two halves of the axis of a turn and of the arrow about it."""
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
    """An arrow about an axis by an angle (a full turn is left open), its middle towards the viewer."""
    first, second = tangent_basis(axis)
    shown = math.copysign(min(abs(angle), _MOST_OF_A_RING), angle)
    middle = math.atan2(float(second[2]), float(first[2]))
    end = middle + 0.5 * shown

    def at(radius: float, phase: float) -> Array:
        return np.asarray(centre + radius * (math.cos(phase) * first + math.sin(phase) * second))

    arc = np.array([at(_RING_RADIUS, phase) for phase in np.linspace(middle - 0.5 * shown, end, 25)])
    tip = at(_RING_RADIUS, end + math.copysign(_RING_HEAD, angle))
    head = np.array([tip, at(_RING_RADIUS + 0.11, end), at(_RING_RADIUS - 0.11, end)])
    return _element(
        "g",
        _polyline("polyline", arc, fill="none", stroke=_TURN_COLOUR, stroke_width=3),
        _polyline("polygon", head, fill=_TURN_COLOUR),
        class_="turn",
    )


def _turn_label(move: Move) -> str:
    """Angle and axis of a turn in the upper left corner."""
    if move.axis is None or move.angle is None:
        return ""
    x, y = _xy(np.array([-1.8, 1.6]))
    return _words("text", f"{_signed(move.angle)} {direction(move.axis)}", x=x, y=y, fill=_TURN_COLOUR, font_size=14)


def legend() -> str:
    """SVG of north, up and east as the pictures have them."""
    return _svg(-_HALF, -_HALF, 2 * _HALF, 2 * _HALF, _words("title", "Directions in the pictures"), _directions())


def _directions() -> str:
    circle = np.array([VIEW @ [math.cos(t), 0.0, math.sin(t)] for t in np.linspace(0.0, 2.0 * math.pi, 49)])
    ground = _polyline("polygon", circle, fill="#f0f0f0", stroke="#bbbbbb", stroke_width=0.8)
    arrows = [_arrow(name, AXIS * axis, _GREY, start=0.0) for name, axis in zip("NUE", VIEW.T, strict=True)]
    return ground + "".join(arrows)


# -------------------- the drawing and the page --------------------

_LEGEND = "N north, U up, E east"
_COLUMNS, _CELL_WIDTH, _CELL_HEIGHT, _TOP = 4, 230.0, 250.0, 34.0


def sheet_drawing(programme: Programme, *, rest: float = REST, rate: float = RATE, move: float = MOVE) -> str:
    """One SVG with the picture of every position in order, what it is and how to get there, and the directions."""
    rows = sheet_rows(programme, rest=rest, rate=rate, move=move)
    title = f"{programme.name}: {_pace(programme, rows, rate, move)}"
    cells = [_cell(_directions(), ("", "", _LEGEND))]
    for row in rows:
        lines = (f"{row.number}. {row.how}", row.position.label, row.attitude)
        cells.append(_cell(_scene(row.position, row.move), lines))
    placed = []
    for i, cell in enumerate(cells):
        down, across = divmod(i, _COLUMNS)
        corner = f"translate({_CELL_WIDTH * across} {_TOP + _CELL_HEIGHT * down})"
        placed.append(_element("g", cell, transform=corner))
    width, height = _CELL_WIDTH * _COLUMNS, _TOP + _CELL_HEIGHT * math.ceil(len(cells) / _COLUMNS)
    paper = _element("rect", width=width, height=height, fill="#ffffff")
    heading = _words("text", title, x=12, y=24, font_size=15, font_weight="bold")
    return _svg(0, 0, width, height, _words("title", title), paper, heading, *placed) + "\n"


def _cell(scene: str, lines: tuple[str, str, str]) -> str:
    """A scene with lines of text below it."""
    middle = 0.5 * _CELL_WIDTH
    texts = [
        _words("text", line, x=middle, y=2 * _HALF + 18 + 16 * i, text_anchor="middle", font_size=12, **style)
        for i, (line, style) in enumerate(zip(lines, ({"font_weight": "bold"}, {}, {"fill": _GREY}), strict=True))
    ]
    return _element("g", scene, transform=f"translate({middle} {_HALF})") + "".join(texts)


_STYLE = """
@page { size: A4; margin: 11mm 12mm 11mm 16mm }
body { font: 9pt/1.3 Helvetica, Arial, sans-serif; color: #111; max-width: 182mm; margin: 0 auto }
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
    programme: Programme, *, rest: float = REST, rate: float = RATE, move: float = MOVE, serial: str = ""
) -> str:
    """A page of HTML to print on A4 and take to the table: every position with its picture, a box to tick and lines
    for times and notes. It needs nothing else: no script, no other file. Without a serial number a line is left
    for it."""
    rows = sheet_rows(programme, rest=rest, rate=rate, move=move)
    head = _element("head", _element("meta", charset="utf-8"), _words("title", programme.name), _style())
    body = _element(
        "body",
        _words("h1", programme.name),
        _words("p", _pace(programme, rows, rate, move)),
        _form(serial),
        _head(programme),
        _positions(rows),
    )
    return "<!DOCTYPE html>\n" + _element("html", head, body, lang="en") + "\n"


def _style() -> str:
    return _element("style", _STYLE)


def _form(serial: str) -> str:
    asked = (f"Device {serial}".rstrip(), "Operator", "Date", "Place", "Log")
    return _element("div", *(_words("span", text) for text in asked), class_="form")


def _head(programme: Programme) -> str:
    colours = [_words("b", name, style=f"color: {colour}") for name, colour in BODY_COLOURS.items()]
    key = _element("p", "Pictures: ", ", ".join(colours), f" body axes; {_LEGEND}, as drawn here.")
    notes = _element("ul", *(_words("li", note) for note in _notes(programme)))
    return _element("div", legend(), _element("div", key, notes), class_="head")


def _positions(rows: Sequence[Row]) -> str:
    columns = (("", "9mm"), ("position", "32mm"), ("how to get there", "70mm"), ("times and notes", "auto"))
    widths = _element("colgroup", *(_element("col", style=f"width: {width}") for _, width in columns))
    heads = _element("thead", _element("tr", *(_words("th", heading) for heading, _ in columns)))
    return _element("table", widths, heads, _element("tbody", *map(_position, rows)))


def _position(row: Row) -> str:
    points = [_words("span", f"{name} → {where}") for name, where in zip("XYZ", row.points, strict=True)]
    words = (
        _words("div", row.how, class_="how"),
        _words("div", row.position.label),
        _element("div", ", ".join(points), class_="points"),
        _words("div", row.attitude, class_="code"),
        _words("div", f"rest {row.when}"),
    )
    times = _element("div", _words("span", "start"), _words("span", "stop"), class_="line")
    number = _words("span", str(row.number), class_="number") + _element("span", "", class_="box")
    note = _element("div", "", class_="line")
    cells = (number, picture(row.position, row.move), "".join(words), times + 2 * note)
    return _element("tr", *(_element("td", cell) for cell in cells))


def write_sheet(
    path: Path, programme: Programme, *, rest: float = REST, rate: float = RATE, move: float = MOVE, serial: str = ""
) -> None:
    """Write the page (.html) or the drawing (.svg) by the ending of `path`. Raises InputError for another ending and
    where it cannot be written, and ProgrammeError as `sheet_rows`."""
    if path.suffix == ".html":
        text = sheet_page(programme, rest=rest, rate=rate, move=move, serial=serial)
    elif path.suffix == ".svg":
        text = sheet_drawing(programme, rest=rest, rate=rate, move=move)
    else:
        raise InputError(f"{path}: expected a name that ends in .html or .svg, found {path.suffix or 'no ending'!r}")
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: expected a file that can be written: {error.strerror or error}") from error
