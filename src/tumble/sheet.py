"""The operator's sheet of a programme: a table for the terminal, a page to print, a picture of every position.

Pictures are orthographic, from a fixed viewpoint in front of the table: south, a little to the east, above. It is
chosen so that in no position of a built-in programme two arrows fall together. Picture coordinates are x right,
y up, z towards the viewer, in half lengths of a body axis or so; `VIEW` takes geographic (N, U, E) to them.

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
            how="start" if number == 1 else move_text(reached),
            attitude=_short(position.attitude),
            points=_points(position),
            start=float(start),
            stop=float(stop),
        )
        for number, (position, reached, (start, stop)) in enumerate(
            zip(programme.positions, moves, times, strict=True), 1
        )
    )


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
        "In any order, and turned about the vertical in any way: only what is up and down counts. "
        "The directions given are one way of standing so."
    )


_CODES = (
    "Where X, Y, Z point: north, south, east, west, up, down, or an angle above or below the horizon and the "
    "direction over which it is, 120° being a bearing clockwise from north."
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


def sheet_table(
    programme: Programme, *, rest: float = REST, rate: float = RATE, move: float = MOVE
) -> RenderableType:
    """The sheet for a terminal: how to get to each position, where the body axes point, and when."""
    rows = sheet_rows(programme, rest=rest, rate=rate, move=move)
    table = Table(box=None, pad_edge=False)
    table.add_column("", justify="right")
    for heading in ("how to get there", "attitude", "X", "Y", "Z", "so that"):
        table.add_column(heading)
    table.add_column("rest", justify="right")
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


def _label(at: Array, text: str, colour: str, **attributes: object) -> str:
    """A bold letter centred at a point, with a white rim so that it can be read over anything."""
    x, y = _xy(at)
    style = {"stroke": "#ffffff", "stroke_width": 3, "stroke_linejoin": "round", "paint_order": "stroke"}
    centred = {"text_anchor": "middle", "dominant_baseline": "central", "font_weight": "bold"}
    return _words("text", text, x=x, y=y, fill=colour, font_size=15, **style, **centred, **attributes)


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

AXIS = 1.3
"""Length of the arrow of a body axis, from the middle of the cube to its tip."""

CUBE = 0.55
"""Half an edge of the cube."""


def _view(east_of_south: float, above: float) -> Array:
    """Geographic → picture for a viewer in this azimuth, rad from south to east, and this far above the horizon."""
    s, c = math.sin(east_of_south), math.cos(east_of_south)
    towards = np.array([-c * math.cos(above), math.sin(above), s * math.cos(above)])
    right = np.array([s, 0.0, c])
    return np.stack([right, np.cross(towards, right), towards])


VIEW = _view(18.0 * DEGREE, 37.0 * DEGREE)
"""Geographic (N, U, E) → picture (right, up, towards the viewer), a rotation."""

BODY_COLOURS = {"X": "#c0392b", "Y": "#2e8b57", "Z": "#2c5fa8"}
_TURN_COLOUR = "#7d3c98"
_GREY = "#555555"
_LIGHT = np.array([-0.35, 0.75, 0.56])
_HEAD, _HEAD_RADIUS = 0.32, 0.105
_RING, _RING_RADIUS, _RING_HEAD = 1.5, 0.3, 0.5
_MOST_OF_A_RING = 300.0 * DEGREE


def picture(position: Position, move: Move = ANY_MOVE) -> str:
    """SVG of a position: a cube with the body axes as arrows, and the turn that leads to it as an arrow about its
    axis."""
    half = 1.85 * SCALE
    return _svg(-half, -half, 2 * half, 2 * half, _words("title", _described(position, move)), _scene(position, move))


def _described(position: Position, move: Move) -> str:
    x, y, z = _points(position)
    return f"{position.attitude}: X points {x}, Y {y}, Z {z}; {move_text(move)}"


def _scene(position: Position, move: Move) -> str:
    """What is in a picture, from back to front: (depth, markup) of the turn, the axes and the cube, sorted."""
    axes = VIEW @ position.matrix
    parts = _turn(move)
    for name, axis in zip("XYZ", axes.T, strict=True):
        parts.append((float(axis[2]), _arrow(name, AXIS * axis, BODY_COLOURS[name], start=CUBE / AXIS)))
    parts.append((0.0, _cube(axes)))
    drawn = [markup for _, markup in sorted(parts, key=lambda part: part[0])]
    return "".join(drawn) + _turn_label(move)


def _arrow(name: str, tip: Array, colour: str, *, start: float, said: str = "") -> str:
    """An arrow with a cone for its head, from `start` (part of its length) to `tip`, with its letter beyond."""
    length = float(np.linalg.norm(tip))
    along = tip / length
    base = tip - _HEAD * along
    shaft = _line(start * tip, base, stroke=colour, stroke_width=3.5)
    head = [_cone(tip, base, along, colour), _disc(base, along, colour if along[2] > 0.0 else _mix(colour, 0.0, 0.65))]
    order = [shaft, *head[::-1]] if along[2] > 0.0 else [*head, shaft]
    flat = tip[:2] / max(float(np.hypot(*tip[:2])), 1e-9)
    return _element("g", *order, _label(tip[:2] + 0.2 * flat, said or name, colour), class_=f"axis-{name}")


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
        (depth, _line(CUBE * axis, 1.2 * reach * axis, **style)),
        (-depth, _line(-CUBE * axis, -reach * axis, **style)),
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
    half = 1.85 * SCALE
    return _svg(-half, -half, 2 * half, 2 * half, _words("title", "Directions in the pictures"), _directions())


def _directions() -> str:
    circle = np.array([VIEW @ [math.cos(t), 0.0, math.sin(t)] for t in np.linspace(0.0, 2.0 * math.pi, 49)])
    ground = _polyline("polygon", circle, fill="#f0f0f0", stroke="#bbbbbb", stroke_width=0.8)
    names = (("N", "N north"), ("E", "E east"), ("U", "U up"))
    axes = dict(zip("NUE", VIEW.T, strict=True))
    arrows = [_arrow(name, AXIS * axes[name], _GREY, start=0.0, said=said) for name, said in names]
    return ground + "".join(arrows)
