"""Where a table can be set to, and the ways from place to place, with what gyros see of them.

A table is stated by the axes about which it turns and the step at which it stops; `Places` are the attitudes it can be
set to: the device mounted in any of the 24 ways along north, up and east, and turned from there once about one of them
by a multiple of the step. Between two places there is a turn of the table where one about one of its axes will do, both
ways round for a half turn, and else, if the device may be taken in hand, any move, taken to be the shortest.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from tumble.errors import InputError
from tumble.planning.bounds import begun, view, whitened
from tumble.planning.itinerary import Itinerary
from tumble.planning.setup import Setup
from tumble.programme.positions import TRIPLES, Position, from_attitudes
from tumble.rotation import rotation_vector
from tumble.units import DEGREE, Array, BoolArray, IntArray

_AXES = "NUE"


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


class Ways(NamedTuple):
    """Ways (q) through k places each with e legs: places (q, k), rotation vectors of the moves (q, e, 3), which are
    turns of the table (q, e), and the whitened rows (q, e, t, 2d + p + 1) that join the rests at their ends, see
    `whitened`."""

    places: IntArray
    moves: Array
    turned: BoolArray
    rows: Array

    def followed(self, chosen: IntArray, others: Ways, then: IntArray, *, meeting: bool = False) -> Ways:
        """Ways of these, each followed by one of others; if `meeting`, the last place of the one is the first of the
        other."""
        then_places, *then_legs = (each[then] for each in others)
        second = [then_places[:, int(meeting) :], *then_legs]
        parts: list[Any] = [np.concatenate([a[chosen], b], axis=1) for a, b in zip(self, second, strict=True)]
        return Ways(*parts)

    def spliced(self, start: int, stop: int, others: Ways, chosen: int) -> Ways:
        """One way with the places start … stop − 1, and the legs to, between and from them, replaced by those of
        another."""
        first = max(start - 1, 0)
        parts: list[Any] = [
            np.concatenate([old[:, :a], new[chosen : chosen + 1], old[:, stop:]], axis=1)
            for old, new, a in zip(self, others, (start, first, first, first), strict=True)
        ]
        return Ways(*parts)


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
    _legs: dict[tuple[int, int], Ways] = field(default_factory=dict, repr=False)

    @staticmethod
    def of(table: TurnTable, setup: Setup, *, gyros: bool, last: Position | None = None) -> Places:
        """The places of a table, after those the one where the device is and what a turn from there leads to, if that
        is none of them."""
        quarter = round(90.0 * DEGREE / table.step)
        turns = _turns(_AXES, table.step, range(1, quarter), (1,))
        codes = [f"{letters} {turn}".rstrip() for turn in ("", *turns) for letters in TRIPLES]
        positions = list(from_attitudes(codes).positions)
        if last is not None:
            turns = _turns(table.axes, table.step, range(1, 2 * quarter + 1), (1, -1))
            turned = [last.attitude, *(f"{last.attitude} {turn}" for turn in turns)]
            known = np.array([position.matrix for position in positions])
            for position in from_attitudes(turned).positions:
                if not np.any(_same(known, position.matrix)):
                    positions.append(position)
                    known = np.concatenate([known, position.matrix[None]])
        attitudes = np.array([position.matrix for position in positions])
        still = Itinerary.through(attitudes, np.zeros((len(attitudes) - 1, 3)), setup)
        rest, _, states = whitened(view(still, setup, gyros=gyros))
        return Places(
            table=table,
            setup=setup,
            gyros=gyros,
            positions=tuple(positions),
            attitudes=attitudes,
            rest=rest,
            states=states,
        )

    def chain(self, places: IntArray) -> Array:
        """The whitened rows of the rests of a programme through some places."""
        rest = self.rest[places]
        rest[0] = begun(rest[0], self.states)
        return rest

    def index(self, matrix: Array) -> int:
        """The place with this attitude."""
        return int(np.flatnonzero(_same(self.attitudes, matrix))[0])

    def legs(self, place: int, sense: int) -> Ways:
        """The ways by one leg from a place to others (1), which are its places, or from others to it (−1); turns of the
        table first. Half turns by hand go the way that `itinerary_of` takes."""
        if (place, sense) in self._legs:
            return self._legs[place, sense]
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
        others, moves = np.concatenate([one, two, three]), np.concatenate([vectors[one], -vectors[two], vectors[three]])
        ends = np.stack([np.full(len(others), place), others], axis=1)[:, ::sense]
        # one leg after the other as if in one long session, without a turn from one to the next
        apart = np.stack([moves, np.zeros_like(moves)], axis=1).reshape(-1, 3)[:-1]
        course = Itinerary.through(self.attitudes[ends.ravel()], apart, self.setup)
        self._legs[place, sense] = Ways(
            places=others[:, None],
            moves=moves[:, None],
            turned=np.arange(len(moves))[:, None] < len(one) + len(two),
            rows=whitened(view(course, self.setup, gyros=self.gyros))[1][::2, None],
        )
        return self._legs[place, sense]

    def at(self, place: int) -> Ways:
        """The way that ends where it begins."""
        legs = self.legs(place, 1)
        return Ways(
            places=np.array([[place]]), moves=legs.moves[:1, :0], turned=legs.turned[:1, :0], rows=legs.rows[:1, :0]
        )

    def ways(self, before: int | None, after: int | None, k: int) -> Ways:
        """All ways through k places, from one place, if there is one before, and on to another, if there is one
        after."""
        onward = None if before is None else self.legs(before, 1)
        backward = None if after is None else self.legs(after, -1)
        if k == 1 and onward is not None and backward is not None:
            chosen, then = np.nonzero(onward.places == backward.places[:, 0])
            return onward.followed(chosen, backward, then, meeting=True)
        legs = backward if onward is None else onward
        assert legs is not None
        if k == 1:
            return legs
        parts = []
        for i, place in enumerate(legs.places[:, 0].tolist()):
            rest = self.ways(place, after, k - 1) if onward is not None else self.ways(None, place, k - 1)
            each, this = np.arange(len(rest.places)), np.full(len(rest.places), i)
            parts.append(legs.followed(this, rest, each) if onward is not None else rest.followed(each, legs, this))
        joined: list[Any] = [np.concatenate(each) for each in zip(*parts, strict=True)]
        return Ways(*joined)


def _turns(axes: str, step: float, angles: range, signs: tuple[int, ...]) -> list[str]:
    """Turns by multiples of a step as they are added to a code."""
    return [f"{axis}{sign * step / DEGREE * n:+.10g}" for axis in axes for n in angles for sign in signs]


def _same(attitudes: Array, matrix: Array) -> Array:
    """Which attitudes (n, 3, 3) are this one."""
    return np.asarray(np.abs(attitudes - matrix).max(axis=(1, 2)) < 1e-9)
