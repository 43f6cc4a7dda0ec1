"""Where a table can be set to, and the ways from place to place, with what gyros see of them.

A table is stated by the axes about which it turns and the step at which it stops; `Places` are the attitudes it can be
set to: the device mounted in any of the 24 ways along north, up and east, and turned from there once about one of them
by a multiple of the step. Between two places there is a turn of the table where one about one of its axes will do, both
ways round for a half turn, and else, if the device may be taken in hand, any move, taken to be the shortest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from tumble.errors import InputError
from tumble.planning.bounds import Course, begun, course_through, view
from tumble.planning.setup import Setup
from tumble.programme.positions import TRIPLES, Position, from_attitudes
from tumble.rotation import rotation_vector
from tumble.units import DEGREE, Array, BoolArray, IntArray

_AXES = "NUE"
_T = TypeVar("_T", Array, IntArray, BoolArray)


@dataclass(frozen=True, kw_only=True, slots=True)
class TurnTable:
    """A table that turns about `axes`, some of N, U, E, and stops at multiples of `step`, rad, a part of 90°. If not
    `by_hand`, the device stays as it is mounted: every move is one turn about one of the axes."""

    axes: str = _AXES
    step: float = 45.0 * DEGREE
    by_hand: bool = True

    @staticmethod
    def of(axes: str | None, step_deg: float) -> TurnTable:
        """The table of axes written like "N,U", where the device stays as it is mounted, or of none, where any move
        will do. Raises InputError."""
        if not step_deg >= SMALLEST_STEP or abs(90.0 / step_deg - round(90.0 / step_deg)) > 1e-9:
            raise InputError(f"step: expected a part of 90 degrees, at least {SMALLEST_STEP:g}, found {step_deg:g}")
        if axes is None:
            return TurnTable(step=step_deg * DEGREE)
        letters = [letter.strip().upper() for letter in axes.split(",")]
        if not set(letters) <= set(_AXES) or len(set(letters)) < len(letters):
            raise InputError(f"axes: expected some of N, U, E, as in N,U, found {axes!r}")
        return TurnTable(axes="".join(letters), step=step_deg * DEGREE, by_hand=False)


ANY = TurnTable()
"""Whatever the table, the device can be taken in hand."""

SMALLEST_STEP = 5.0
"""Degrees; with finer ones there are too many places to try."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Legs:
    """Ways between one place and others (q,): rotation vectors (q, 3), which of them are turns of the table, and the
    whitened rows (q, t, 2d + p + 1) that join the rests at their ends, see `View.whitened`."""

    places: IntArray
    moves: Array
    turned: BoolArray
    rows: Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Places:
    """Where a table can be: positions and attitudes (n, 3, 3), and the whitened rows of a rest in each, with so many
    `states` of in-run biases."""

    table: TurnTable
    setup: Setup
    gyros: bool
    positions: tuple[Position, ...]
    attitudes: Array
    rest: Array
    states: int
    _onward: dict[int, Legs] = field(default_factory=dict, repr=False)
    _backward: dict[int, Legs] = field(default_factory=dict, repr=False)

    @staticmethod
    def of(table: TurnTable, setup: Setup, *, gyros: bool, last: Position | None = None) -> Places:
        """The places of a table, after those the one where the device is and what a turn from there leads to, if that
        is none of them."""
        codes = [letters + turn for turn in ("", *_turns(table.step)) for letters in TRIPLES]
        positions = list(from_attitudes(codes).positions)
        if last is not None:
            turned = [last.attitude, *(f"{last.attitude} {turn}" for turn in _all_turns(table))]
            known = np.array([position.matrix for position in positions])
            for position in from_attitudes(turned).positions:
                if not np.any(_same(known, position.matrix)):
                    positions.append(position)
                    known = np.concatenate([known, position.matrix[None]])
        attitudes = np.array([position.matrix for position in positions])
        still = course_through(attitudes, np.zeros((len(attitudes) - 1, 3)), setup)
        seen = view(still, setup, gyros=gyros)
        return Places(
            table=table,
            setup=setup,
            gyros=gyros,
            positions=tuple(positions),
            attitudes=attitudes,
            rest=seen.whitened()[0],
            states=seen.states,
        )

    def chain(self, places: IntArray) -> Array:
        """The whitened rows of the rests of a programme through some places."""
        rest = self.rest[places]
        rest[0] = begun(rest[0], self.states)
        return rest

    def index(self, matrix: Array) -> int:
        """The place with this attitude."""
        return int(np.flatnonzero(_same(self.attitudes, matrix))[0])

    def onward(self, place: int) -> Legs:
        """The legs from a place to others."""
        if place not in self._onward:
            self._onward[place] = self._legs(place, 1)
        return self._onward[place]

    def backward(self, place: int) -> Legs:
        """The legs from others to a place."""
        if place not in self._backward:
            self._backward[place] = self._legs(place, -1)
        return self._backward[place]

    def _legs(self, place: int, sense: int) -> Legs:
        """The legs from (1) or to (−1) a place; turns of the table first."""
        others, moves, turned = self._moves(place, sense)
        return Legs(places=others, moves=moves, turned=turned, rows=self._rows(place, others, moves, sense))

    def _moves(self, place: int, sense: int) -> tuple[IntArray, Array, BoolArray]:
        """The places that can be reached from one (1), or from which it can (−1), how, and whether by a turn of the
        table. Half turns by hand go the way that `course_of` takes."""
        away = self.attitudes @ self.attitudes[place].T
        vectors = rotation_vector(away if sense > 0 else np.swapaxes(away, 1, 2))
        angle, step = np.linalg.norm(vectors, axis=1), self.table.step
        axes = [_AXES.index(letter) for letter in self.table.axes]
        turned = (np.abs(vectors[:, axes]).max(axis=1) > angle - 1e-9) & (angle > 1e-9)
        turned &= np.abs(vectors / step - np.round(vectors / step)).max(axis=1) < 1e-6
        vectors = np.where(turned[:, None], step * np.round(vectors / step), vectors)
        half = turned & np.isclose(angle, np.pi)
        by_hand = ~turned & (angle > 1e-9) & self.table.by_hand
        one, two, three = (np.flatnonzero(kind) for kind in (turned, half, by_hand))
        moves = np.concatenate([vectors[one], -vectors[two], vectors[three]])
        return np.concatenate([one, two, three]), moves, np.arange(len(moves)) < len(one) + len(two)

    def _rows(self, place: int, others: IntArray, moves: Array, sense: int) -> Array:
        """The whitened rows of legs from or to a place, one after the other as if in one long course."""
        ends = np.stack([np.full(len(others), place), others], axis=1)[:, ::sense]
        course = Course(
            attitudes=self.attitudes[ends.ravel()],
            first=2 * np.arange(len(others)),
            moves=moves,
            seconds=np.linalg.norm(moves, axis=1) / self.setup.turn_rate,
        )
        return view(course, self.setup, gyros=self.gyros).whitened()[1][::2]


def _turns(step: float) -> list[str]:
    """Turns about each axis by multiples of a step below 90°, as they are added to a code."""
    angles = step / DEGREE * np.arange(1, round(90.0 * DEGREE / step))
    return [f" {axis}{angle:+.10g}" for axis in _AXES for angle in angles]


def _all_turns(table: TurnTable) -> list[str]:
    """All turns of a table by up to 180°, as they are added to a code."""
    angles = table.step / DEGREE * np.arange(1, round(180.0 * DEGREE / table.step) + 1)
    return [f"{axis}{sign * angle:+.10g}" for axis in table.axes for angle in angles for sign in (1, -1)]


def _same(attitudes: Array, matrix: Array) -> Array:
    """Which attitudes (n, 3, 3) are this one."""
    return np.asarray(np.abs(attitudes - matrix).max(axis=(1, 2)) < 1e-9)


# Ways through places


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Ways:
    """Ways (q) through k places each with e legs: places (q, k), moves (q, e, 3), which are turns of the table (q, e),
    and whitened rows (q, e, t, ·)."""

    places: IntArray
    moves: Array
    turned: BoolArray
    rows: Array

    @staticmethod
    def of(legs: Legs) -> Ways:
        """Ways through one place, by one leg."""
        return Ways(
            places=legs.places[:, None], moves=legs.moves[:, None], turned=legs.turned[:, None], rows=legs.rows[:, None]
        )

    @staticmethod
    def at(place: int, places: Places) -> Ways:
        """The way that ends where it begins."""
        legs = Ways.of(places.onward(place))
        return Ways(
            places=np.array([[place]]), moves=legs.moves[:1, :0], turned=legs.turned[:1, :0], rows=legs.rows[:1, :0]
        )

    def followed(self, chosen: IntArray, others: Ways, then: IntArray, *, meeting: bool = False) -> Ways:
        """Ways of these, each followed by one of others; if `meeting`, the last place of the one is the first of the
        other."""
        return Ways(
            places=np.concatenate([self.places[chosen], others.places[then][:, int(meeting) :]], axis=1),
            moves=np.concatenate([self.moves[chosen], others.moves[then]], axis=1),
            turned=np.concatenate([self.turned[chosen], others.turned[then]], axis=1),
            rows=np.concatenate([self.rows[chosen], others.rows[then]], axis=1),
        )

    def spliced(self, start: int, stop: int, others: Ways, chosen: int) -> Ways:
        """One way with the places start … stop − 1, and the legs to, between and from them, replaced by those of
        another."""
        first = max(start - 1, 0)

        def put(old: _T, new: _T, a: int) -> _T:
            return np.concatenate([old[:, :a], new[chosen : chosen + 1], old[:, stop:]], axis=1)

        return Ways(
            places=put(self.places, others.places, start),
            moves=put(self.moves, others.moves, first),
            turned=put(self.turned, others.turned, first),
            rows=put(self.rows, others.rows, first),
        )


def ways_through(places: Places, before: int | None, after: int | None, k: int) -> Ways:
    """All ways through k places, from one place, if there is one before, and on to another, if there is one after."""
    if k == 1:
        return _through_one(places, before, after)
    if before is not None:
        legs = Ways.of(places.onward(before))
        rests = [ways_through(places, int(place), after, k - 1) for place in legs.places[:, 0]]
        return _all([legs.followed(_many(i, rest), rest, _each(rest)) for i, rest in enumerate(rests)])
    assert after is not None
    legs = Ways.of(places.backward(after))
    starts = [ways_through(places, None, int(place), k - 1) for place in legs.places[:, 0]]
    return _all([start.followed(_each(start), legs, _many(i, start)) for i, start in enumerate(starts)])


def _through_one(places: Places, before: int | None, after: int | None) -> Ways:
    if before is None:
        assert after is not None
        return Ways.of(places.backward(after))
    onward = Ways.of(places.onward(before))
    if after is None:
        return onward
    backward = Ways.of(places.backward(after))
    chosen, then = np.nonzero(onward.places == backward.places[:, 0])
    return onward.followed(chosen, backward, then, meeting=True)


def _each(ways: Ways) -> IntArray:
    return np.arange(len(ways.places))


def _many(i: int, ways: Ways) -> IntArray:
    return np.full(len(ways.places), i)


def _all(ways: Sequence[Ways]) -> Ways:
    """All ways of several lists."""
    return Ways(
        places=np.concatenate([w.places for w in ways]),
        moves=np.concatenate([w.moves for w in ways]),
        turned=np.concatenate([w.turned for w in ways]),
        rows=np.concatenate([w.rows for w in ways]),
    )
