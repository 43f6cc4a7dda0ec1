"""Programmes: the nominal attitudes into which an IMU is put, and the turns between them.

An attitude code gives the directions of body X, Y, Z, as three of N S E W U D, and then turns from there: "NUE N+45" is
X north, Y up, Z east, turned by +45° about north. Turns are about the geographic axes N, U, E by the right-hand rule
(N × U = E) and are applied in order. A block on its corner is "corner +X-Y+Z", with the body axes above (+) and below
(−) the horizon by 35.26° each; turns may state its azimuth: "corner +X-Y+Z U+120".

The rough-table programme is programme "A" of the turntable paper (index of equations), which does not state its
directions of rotation. They matter: with (+N, +U, −N) the accelerometer biases cancel in the gyro scale factors. The
body then turns in one sense about each of its horizontal axes, since the turn about U reverses it; with another +N at
the end of a series it turns in both senses, which shows whether the gyro scale factors differ between them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import permutations, product
from types import MappingProxyType

import numpy as np

from tumble.arguments import checked
from tumble.brief import Brief
from tumble.errors import ProgrammeError, did_you_mean
from tumble.plugins import entry_points_of, load
from tumble.rotation import rotation_matrix
from tumble.units import DEGREE, Array

_AXES = {"N": np.array([1.0, 0.0, 0.0]), "U": np.array([0.0, 1.0, 0.0]), "E": np.array([0.0, 0.0, 1.0])}
_DIRECTIONS = _AXES | {"S": -_AXES["N"], "D": -_AXES["U"], "W": -_AXES["E"]}
_OPPOSITE = dict(zip("NSUDEW", "SNDUWE", strict=True))
_TURN = re.compile(r"([NUE])([+-](?:[0-9]+\.?[0-9]*|\.[0-9]+))")
CORNER = "corner"  # first word of the code of a block on its corner
_SIGNS = re.compile(r"[+-]X[+-]Y[+-]Z")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Position:
    """A nominal attitude: its code, the matrix body → geographic (N, U, E), and a short label ("X up")."""

    attitude: str
    matrix: Array = field(repr=False, compare=False)
    label: str

    @property
    def vertical_b(self) -> Array:
        """Direction of the vertical in the body frame, a unit vector: u = Lᵀ e_U."""
        return np.asarray(self.matrix.T @ _AXES["U"])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Move:
    """A turn to the next position by `angle` (rad, signed) about the geographic unit vector `axis`; None and None for
    any movement."""

    axis: Array | None
    angle: float | None


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Programme(Brief):
    """Positions and the moves between them, one fewer.

    If it is not `ordered`, positions may be taken in any order and turned about the vertical in any way: only
    `vertical_b` counts."""

    name: str
    positions: tuple[Position, ...]
    moves: tuple[Move, ...]
    ordered: bool


ANY_MOVE = Move(axis=None, angle=None)


def attitude(code: str) -> Array:
    """Return the rotation matrix body → geographic (N, U, E), shape (3, 3), of an attitude code.

    Raises ProgrammeError for letters that are no right-handed triple, and for a turn that is not like N+45."""
    code = " ".join(code.split())
    letters, *turns = code.split(" ")
    if letters == CORNER:
        signs = turns.pop(0) if turns else ""
        if _SIGNS.fullmatch(signs) is None:
            raise ProgrammeError(
                f'attitude "{code}": expected the axes above (+) and below (-) the horizon, such as corner +X-Y+Z, '
                f'found "{signs}"'
            )
        lifted = _lifted_codes(_ON_CORNER)[tuple(int(f"{sign}1") for sign in signs[::2])]
        if " ".join(turns) in _AZIMUTHS:  # identical to a lifted triple, without rounding errors
            return attitude(lifted[_AZIMUTHS.index(" ".join(turns))])
        matrix = attitude(lifted[0])
    else:
        if len(letters) != 3 or not set(letters) <= set(_DIRECTIONS):
            raise ProgrammeError(
                f'attitude "{code}": expected three of N S E W U D, where body X, Y, Z point, found "{letters}"'
            )
        matrix = np.column_stack([_DIRECTIONS[letter] for letter in letters])
        handedness = round(float(np.linalg.det(matrix)))
        if handedness == 0:
            raise ProgrammeError(
                f'attitude "{code}": expected three perpendicular directions, found "{letters}"; '
                "take one of each pair N S, U D, E W"
            )
        if handedness < 0:
            mirrored = letters[:2] + _OPPOSITE[letters[2]]
            raise ProgrammeError(
                f'attitude "{code}": expected a right-handed triple (as N, U, E), found left-handed "{letters}"; '
                f'with this X and Y it is "{mirrored}"'
            )
    for turn in turns:
        axis, angle = _turn(code, turn)
        matrix = rotation_matrix(angle * axis) @ matrix
    return matrix


def code_of_vertical(vertical: Array) -> str:
    """Return the code of an attitude with this vertical (3,) in the body, to 1e-4 degrees: "NUE U+a N+b", in which the
    vertical is (sin b sin a, cos b, −sin b cos a)."""
    x, y, z = np.asarray(vertical) / np.linalg.norm(vertical)
    turns = {"U": math.atan2(x, -z) if math.hypot(x, z) > 1e-9 else 0.0, "N": math.atan2(math.hypot(x, z), y)}
    return " ".join(["NUE", *(f"{axis}{angle / DEGREE:+.4f}" for axis, angle in turns.items())])


def _turn(code: str, turn: str) -> tuple[Array, float]:
    """Return the geographic axis and signed angle, rad, of a turn like "E-90.5"."""
    match = _TURN.fullmatch(turn)
    if match is None or abs(float(match[2])) > 360.0:
        raise ProgrammeError(
            f'attitude "{code}": expected a turn about N, U or E by up to 360 degrees with a sign, '
            f'such as N+45 or E-90.5, found "{turn}"'
        )
    return _AXES[match[1]], float(match[2]) * DEGREE


def programmes() -> tuple[str, ...]:
    """Return the names of all programmes, built in and of other packages."""
    return (*dict.fromkeys([*BUILT_IN, *entry_points_of("programmes")]),)


def programme(name: str) -> Programme:
    """Return the programme of this name, built in or of another package. Raises ProgrammeError for an unknown name."""
    if name in BUILT_IN:
        return BUILT_IN[name]()
    codes: Sequence[str] | None = load("programmes", name, (list, tuple))
    if codes is None:
        advice = did_you_mean(name, programmes())
        raise ProgrammeError(f"programme: expected one of {', '.join(programmes())}, found {name!r}{advice}")
    return from_attitudes(codes, name)


@checked
def programme_of(given: str | Sequence[str]) -> Programme:
    """Return the programme of a name, or of positions listed by their attitude codes.

    Raises ProgrammeError for an unknown name or code.

    >>> import tumble
    >>> [len(tumble.programme_of(given).positions) for given in ("rough-table", ["NUE", "NUE N+45"])]
    [15, 2]
    """
    return programme(given) if isinstance(given, str) else from_attitudes(given)


def from_attitudes(codes: Sequence[str], name: str = "listed", *, ordered: bool = True) -> Programme:
    """Return the programme of positions listed by their codes, in this order if `ordered`, with any movement between
    them.

    Raises ProgrammeError for an empty list or an invalid code."""
    if not codes:
        raise ProgrammeError("programme: expected at least one position, found none")
    moves = (ANY_MOVE,) * (len(codes) - 1)
    return Programme(name=name, positions=tuple(map(_position, codes)), moves=moves, ordered=ordered)


def timetable(programme: Programme, *, rest: float, rate: float, move: float) -> Array:
    """Return start and stop of every rest (N, 2), s, from the start of the first.

    Rests last `rest` s, programmed turns have `rate` rad/s, and each other move takes `move` s. Raises ProgrammeError
    unless rest and rate are positive and move is not negative."""
    for what, value, expected, valid in (
        ("rest", rest, "a positive number of seconds", 0.0 < rest < math.inf),
        ("rate", rate / DEGREE, "a positive number of deg/s", 0.0 < rate < math.inf),
        ("move", move, "a number of seconds, not negative", 0.0 <= move < math.inf),
    ):
        if not valid:
            raise ProgrammeError(f"{what}: expected {expected}, found {value:g}")
    durations = [move if m.angle is None else abs(m.angle) / rate for m in programme.moves]
    starts = np.concatenate([[0.0], np.cumsum(np.array(durations) + rest)])
    return np.column_stack([starts, starts + rest])


def _position(code: str) -> Position:
    """Return an attitude with its label, the body axes above and below the horizon: "X up", "X 45° up, Y 45° down"."""
    matrix, label = attitude(code), list[str]()
    for name, sine in zip("XYZ", matrix[1], strict=True):
        elevation = round(math.degrees(math.asin(max(-1.0, min(1.0, sine)))))
        side = "up" if elevation > 0 else "down"
        if abs(elevation) == 90:
            label = [f"{name} {side}"]
            break
        if elevation != 0:
            label.append(f"{name} {abs(elevation)}° {side}")
    return Position(attitude=code, matrix=matrix, label=", ".join(label))


_OBLIQUE = ("UEN N+45", "UNW N-45", "NUE N+45")  # X, X, Y 45° above and Y, Z, Z 45° below the horizon


def _rough_table(name: str, *turns: str) -> Programme:
    """Return three series of turns by 180°, then three oblique rests: with three turns a series 15 rests and nine
    programmed turns, with four 18 and twelve."""
    codes: list[str] = []
    moves: list[Move] = []
    for start in ("NUE", "ENU", "UEN"):
        codes += [" ".join((start, *turns[:done])) for done in range(len(turns) + 1)]
        for turn in turns:
            axis, angle = _turn(start, turn)
            moves.append(Move(axis=axis, angle=angle))
        moves.append(ANY_MOVE)
    moves += [ANY_MOVE] * (len(_OBLIQUE) - 1)
    positions = tuple(map(_position, (*codes, *_OBLIQUE)))
    return Programme(name=name, positions=positions, moves=tuple(moves), ordered=True)


def _cube(name: str, *kinds: int) -> Programme:
    """Return positions of a cube on faces (1), edges (2), vertices (3): the numbers of body axes off the horizon.

    The azimuth changes from each position to the next, so that the turns, in the listed order, depend on every gyro
    parameter."""
    codes: list[str] = []
    for kind in kinds:
        for signs in product((1, 0, -1), repeat=3):
            if np.count_nonzero(signs) != kind:
                continue
            lifted, k = _lifted_codes(("", _ON_EDGE, _ON_CORNER)[kind - 1])[signs], len(codes)
            axes = "".join(f"{'+' if sign > 0 else '-'}{axis}" for sign, axis in zip(signs, "XYZ", strict=True))
            codes.append(f"{CORNER} {axes} {_AZIMUTHS[k % 3]}".rstrip() if kind == 3 else lifted[k % len(lifted)])
    return from_attitudes(codes, name, ordered=False)


_ON_EDGE, _ON_CORNER = " N+45", f" N+45 E+{math.degrees(math.atan(math.sqrt(0.5)))}"
_AZIMUTHS = ("", "U-120", "U+120")  # of a block on a corner, in the order of the triples


@cache
def _lifted_codes(lift: str) -> dict[tuple[int, ...], list[str]]:
    """Return the codes of right-handed triples lifted on an edge or a corner, by the body axes above (1), on (0) and
    below (−1) the horizon; those of one entry differ in azimuth.

    From a triple, +45° about N lifts the axes that pointed U and W, and atan(1/√2) about E lifts the one that pointed
    N."""
    codes: dict[tuple[int, ...], list[str]] = {}
    for code in (letters + lift for letters in TRIPLES):
        codes.setdefault(tuple(np.sign(attitude(code)[1].round(9)).astype(int).tolist()), []).append(code)
    return codes


TRIPLES = [
    letters
    for letters in map("".join, permutations("NUESDW", 3))
    if np.linalg.det(np.column_stack([_DIRECTIONS[letter] for letter in letters])) > 0.5
]
"""The 24 right-handed triples of directions."""

BUILT_IN: Mapping[str, Callable[[], Programme]] = MappingProxyType(
    {
        "rough-table": lambda: _rough_table("rough-table", "N+180", "U+180", "N-180"),
        "rough-table-18": lambda: _rough_table("rough-table-18", "N+180", "U+180", "N-180", "N+180"),
        # every body axis up and down, then the three oblique positions
        "nine": lambda: from_attitudes(("UEN", "DWN", "NUE", "NDW", "ENU", "WND", *_OBLIQUE), "nine"),
        "cube-14": lambda: _cube("cube-14", 1, 3),
        "cube-26": lambda: _cube("cube-26", 1, 2, 3),
        "cube-12": lambda: _cube("cube-12", 2),
        "faces-edges-18": lambda: _cube("faces-edges-18", 1, 2),
    }
)
