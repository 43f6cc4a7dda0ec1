"""Positions and moves of a programme in words, with their times, for the operator's sheet."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tumble.programme.positions import ANY_MOVE, Move, Position, Programme, timetable
from tumble.units import DEGREE, Array
from tumble.usual_setup import MOVE, ON_TABLE

REST, RATE = ON_TABLE.rest, ON_TABLE.rate_deg_s * DEGREE  # default duration of a rest, s, and rate of turns, rad/s

_OFF_THE_HORIZON = 0.1  # sine of the elevation
_COMPASS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")


@dataclass(frozen=True, kw_only=True, slots=True)
class SheetRow:
    """A position on the sheet. `points`: directions of body X, Y, Z. `start`, `stop`: of the rest, s."""

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


def sheet_rows(
    programme: Programme, *, rest: float = REST, rate: float = RATE, move: float = MOVE
) -> tuple[SheetRow, ...]:
    """Return every position of a programme in words, with its time; arguments as for `timetable`."""
    times = timetable(programme, rest=rest, rate=rate, move=move).tolist()
    rows = list[SheetRow]()
    for position, reached, (start, stop) in zip(programme.positions, (ANY_MOVE, *programme.moves), times, strict=True):
        how = move_text(reached) if rows else "start"
        if not programme.ordered:  # the number of axes off the horizon shows what the block stands on
            upright = np.count_nonzero(np.abs(position.vertical_b) > _OFF_THE_HORIZON)
            how = ("on a face", "on an edge", "on a corner")[upright - 1]
        row = SheetRow(
            number=len(rows) + 1, position=position, move=reached, how=how, attitude=short_code(position.attitude),
            points=points_of(position), start=start, stop=stop,
        )  # fmt: skip
        rows.append(row)
    return tuple(rows)


def move_text(move: Move) -> str:
    """Return a move in words: "turn +180° about N" or "any move"."""
    if move.axis is None or move.angle is None:
        return "any move"
    return f"turn {signed_angle(move.angle)} about {direction(move.axis)}"


def direction(vector_n: Array) -> str:
    """Return the direction of a unit vector (N, U, E), to the degree: N S E W U D, "NE", "45° up to E", or the bearing,
    clockwise from north: "120°", "35° down to 120°"."""
    elevation = round(math.asin(max(-1.0, min(1.0, float(vector_n[1])))) / DEGREE)
    if abs(elevation) == 90:
        return "U" if elevation > 0 else "D"
    bearing = round(math.atan2(float(vector_n[2]), float(vector_n[0])) / DEGREE) % 360
    course = f"{bearing:03d}°" if bearing % 45 else _COMPASS[bearing // 45]
    if elevation == 0:
        return course
    return f"{abs(elevation)}° {'up' if elevation > 0 else 'down'} to {course}"


def clock(seconds: float) -> str:
    """Return a time as minutes and seconds, "20:12", or with hours, "1:02:05"."""
    minutes, second = divmod(round(seconds), 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02d}:{second:02d}" if hours else f"{minute}:{second:02d}"


def points_of(position: Position) -> tuple[str, str, str]:
    """Return the directions of body X, Y, Z."""
    x, y, z = (direction(axis) for axis in position.matrix.T)
    return x, y, z


def signed_angle(angle: float) -> str:
    """Return an angle in degrees with its sign: "+180°", "−90.5°"."""
    return f"{angle / DEGREE:+.6g}°".replace("-", "−")


def short_code(code: str) -> str:
    """Return an attitude code with angles to six digits."""
    return re.sub(r"\d+\.\d+", lambda match: f"{float(match[0]):.6g}", code)


def pace_of(programme: Programme, rows: Sequence[SheetRow], rate: float, move: float) -> str:
    """Return, for example, "15 positions, 20:12 in all: rests of 60 s, turns at 10 °/s, 30 s for any other move"."""
    parts = [f"rests of {rows[0].stop - rows[0].start:g} s"]
    if any(m.angle is not None for m in programme.moves):
        parts.append(f"turns at {rate / DEGREE:g} °/s")
    if any(m.angle is None for m in programme.moves):
        parts.append(f"{move:g} s for any other move" if len(parts) > 1 else f"{move:g} s for a move")
    count = f"{len(rows)} position" + ("s" if len(rows) > 1 else "")
    return f"{count}, {clock(rows[-1].stop)} in all: {', '.join(parts)}"


_IN_ORDER = "In this order. Any move may be made between positions except where a turn is given."
_ANY_ORDER = (
    "In any order, and each turned about the vertical in any way: only what is up and down counts. The order and "
    "the directions given make the turns between the positions varied, which is good for gyros. Where the hand allows, "
    "go the long way round, by 240° in place of 120°: the scale factors of the gyros are known a fifth better."
)
_CODES = (
    "Three letters say where X, Y, Z point: to north N, south S, east E, west W, up U or down D. N+45 is then a turn "
    "by 45° about north."
)
POINTS = "45° up to E is 45° above the horizon over east; 120° is a bearing, clockwise from north."
"""Note where the directions of X, Y and Z are given beside the attitudes."""
_TURNS = (
    "Turns are about north N, up U or east E by the right-hand rule: thumb along the axis, a positive turn goes the "
    "way the fingers point."
)
_CARE = (
    "Keep the log running from the first rest to the last, moves included. Attitudes may be a few degrees off; "
    "nothing may move during a rest."
)


def notes_of(programme: Programme) -> list[str]:
    """Return notes for the operator, in sentences."""
    turns = [_TURNS] if any(m.angle is not None for m in programme.moves) else []
    return [_IN_ORDER if programme.ordered else _ANY_ORDER, *turns, _CODES, _CARE]
