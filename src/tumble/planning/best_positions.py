"""Programmes by what they show: the best next position, and programmes optimised for a number of positions.

How good a programme is (`Criterion`), smaller being better: by "A" the root mean square of u over the weights, which
are the spreads of `tumble.inference.estimate` or wanted accuracies; by "D" the geometric mean of the semi-axes of
the ellipsoid of uncertainty, which does not depend on weights. A prior as wide as the spreads makes either finite
while positions are too few; afterwards it counts for nothing. Groups of parameters beyond the linear model have their
usual spreads as prior; they count by A only where an accuracy of them is wanted. Drifts with time are left out, as a
position is sought before it is known when it comes. Biases are the means of their processes, for what is said of those
over a session changes with every position that is added.

A position costs little to add or to exchange. Eliminating what belongs to all rests before it, attitudes and states of
in-run biases, leaves as many rows on those of the last of them and a triangle on the parameters
(`tumble.inference.elimination`), and those after it likewise. What a candidate shows is then an elimination of two to
four rests, whatever the length of the programme: about 0.1 ms, and four times as much with in-run biases.

A programme is begun with X, Y or Z up, grows by the best position to add, and is improved by exchange of one position
at a time, or of neighbours where the table leaves no other way, until no exchange makes it better. By A it is sought
once more from what is found by D, which is the better guide while positions are few. The best of what is found is
taken. Nothing is random: of equally good candidates the first is taken, and turns come before other moves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tumble.brief import Brief
from tumble.errors import InputError
from tumble.inference.elimination import eliminate
from tumble.inference.estimate import DETERMINED
from tumble.inference.prior import Prior
from tumble.planning.bounds import Bound, begun, bound, instrument_of, stated, view, whitened
from tumble.planning.itinerary import itinerary_of
from tumble.planning.reachable_attitudes import ANY, Places, TurnTable, Ways
from tumble.planning.setup import Setup, check_setup, with_all_groups
from tumble.programme.positions import ANY_MOVE, Move, Position, Programme
from tumble.programme.positions import programme as built_in
from tumble.sensors.parameters import group_name, limits_of
from tumble.units import Array

Letter = Literal["A", "D"]

SAME = 1e-9
"""Criteria that differ by this part are equal."""

ALIKE = 1e-6
"""Next positions whose criteria differ by this part are as good as each other: symmetry makes them so."""

UPRIGHT = 0.99
"""Cosine from which an axis is up."""

_FIRST: Mapping[Letter, tuple[Letter, ...]] = {"A": ("A", "D"), "D": ("D",)}
"""By which criteria a programme is sought before it is improved by its own."""

COMPARED = ("nine", "cube-14", "rough-table", "faces-edges-18")
"""What an optimised programme is compared with: the nine, 14, 15 and 18 positions of the literature."""


Progress = Callable[[int, int], None]
"""What is told how many parts of a search are done, and of how many."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Aim:
    """What a programme is for: the criterion's letter; wanted accuracies by group, SI, for A, none for the spreads;
    and whether gyros are calibrated or accelerometers alone."""

    letter: Letter = "A"
    wanted: Mapping[str, float] | None = None
    gyros: bool = True


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Criterion:
    """How good a programme is: by A, with `weight` (m,), SI, of the parameters, infinite for those that do not count,
    or by D. `prior` (m,) are the spreads, SI, of which the first `linear` are those of the linear model, and `known`
    the triangle of what is known before: measured gravity, and the prior."""

    letter: Letter
    weight: Array
    prior: Array
    linear: int
    known: Array

    @staticmethod
    def of(aim: Aim, setup: Setup) -> Criterion:
        """The criterion of an aim. Raises InputError if it is for no parameter."""
        instrument = instrument_of(setup, aim.gyros)
        groups, linear = list(map(group_name, instrument.names)), instrument.linear_count
        prior = limits_of(instrument.names)
        prior[linear:] = [setup.further[group] for group in groups[linear:]]
        weight = np.where(np.arange(len(prior)) < linear, prior, np.inf)
        if aim.wanted:
            weight = np.array([aim.wanted.get(group, np.inf) for group in groups])
        if not np.any(np.isfinite(weight)):
            raise InputError("wanted: expected an accuracy of parameters that are calibrated, found none")
        gravity = 1.0 / setup.gravity_u if setup.gravity_u > 0.0 else 0.0
        known = np.diag([gravity, *(1.0 / prior), 0.0])
        return Criterion(letter=aim.letter, weight=weight, prior=prior, linear=linear, known=known)

    def of_triangles(self, triangles: Array) -> Array:
        """Its values (q,) for triangles (q, 1 + m + 1, 1 + m + 1) on gravity and the parameters."""
        R = triangles[:, 1:-1, 1:-1]
        if self.letter == "D":
            diagonal = np.abs(np.diagonal(R, axis1=1, axis2=2)) * self.prior
            return np.asarray(np.exp(-np.log(diagonal).mean(axis=1)))
        u = np.linalg.inv(R) / self.weight[:, None]
        return np.asarray(np.sqrt((u**2).sum(axis=(1, 2)) / np.isfinite(self.weight).sum()))


def _timeless(setup: Setup) -> Setup:
    """A set-up whose instrument does not change with time, for positions are sought without when they are taken."""
    further = instrument_of(setup, gyros=True).further
    return replace(setup, further={g.name: setup.further[g.name] for g in further if g.variable is None})


# What a programme and its candidates show


def _eliminated(rest: Array, joint: Array, triangle: Array) -> tuple[Array, Array]:
    """What rests (N, r, ·) and the rows (N − 1, t, ·) that join each to the next show when what belongs to each is
    eliminated: rows (r, ·) on the last, in the form of a rest, and a triangle on the parameters, to which one is
    added."""
    N, d, triangle = len(rest), joint.shape[2] - rest.shape[2], triangle.copy()
    factor = np.empty((N, d, rest.shape[2] + d))
    eliminate(rest, joint, np.append(np.arange(N - 1), -1), factor, triangle)
    last = np.zeros(rest.shape[1:])
    last[:d, :d], last[:d, d:] = factor[-1, :, :d], factor[-1, :, 2 * d :]
    return last, triangle


def _triangles(rest: Array, joint: Array, triangle: Array) -> Array:
    """Triangles (q, p + 1, p + 1) after q chains of rests (q, n, r, ·) and the rows (q, n − 1, t, ·) that join them."""
    out, n, d = np.repeat(triangle[None], len(rest), axis=0), rest.shape[1], joint.shape[3] - rest.shape[3]
    factor, link = np.empty((n, d, rest.shape[3] + d)), np.append(np.arange(n - 1), -1)
    for chain_rest, chain_joint, own in zip(rest, joint, out, strict=True):
        eliminate(chain_rest, chain_joint, link, factor, own)
    return out


@dataclass(frozen=True, kw_only=True, slots=True)
class _Search:
    """What a search needs."""

    places: Places
    criterion: Criterion

    def exchanged(self, way: Ways, start: int, k: int) -> tuple[Ways, float]:
        """A programme with the k places from `start` on exchanged for the best, or added at its end, and its value:
        infinite where there is nothing to exchange them for."""
        places, rest, stop = way.places[0], self.places.rest, start + k
        before = int(places[start - 1]) if start > 0 else None
        after = int(places[stop]) if stop < len(places) else None
        ways = self.places.ways(before, after, k)
        q, triangle, chain = len(ways.places), self.criterion.known, [rest[ways.places]]
        if q == 0:
            return way, np.inf
        if before is None:
            chain[0][:, 0] = begun(chain[0][:, 0], self.places.states)
        else:
            own = self.places.chain(places[:start])
            last, triangle = _eliminated(own, way.rows[0, : start - 1], triangle)
            chain.insert(0, _repeated(last, q))
        if after is not None:
            joint, d = way.rows[0, stop:][::-1], 3 + self.places.states  # gone through from its end
            joint = np.concatenate([joint[..., d : 2 * d], joint[..., :d], joint[..., 2 * d :]], axis=-1)
            last, more = _eliminated(rest[places[stop:][::-1]], joint, np.zeros_like(triangle))
            triangle = np.asarray(np.linalg.qr(np.concatenate([triangle, more]), mode="r"))
            chain.append(_repeated(last, q))
        values = self.criterion.of_triangles(_triangles(np.concatenate(chain, axis=1), ways.rows, triangle))
        best = int(np.argmax(values <= values.min() * (1.0 + SAME)))
        return way.spliced(start, stop, ways, best), float(values[best])

    def grown(self, start: int, positions: int) -> Ways:
        """So many positions from a place on, each the best to add; where not every place can be reached from every
        other, two at a time."""
        way, k = self.places.at(start), 1 if self.places.table.by_hand else 2
        while (n := way.places.shape[1]) < positions:
            way, _ = self.exchanged(way, n, min(k, positions - n))
        return way

    def improved(self, way: Ways) -> tuple[Ways, float]:
        """A programme after exchanges, until none makes it better: of one position at a time or, where not every place
        can be reached from every other, of up to two neighbours, and three while not all linear parameters are
        determined."""
        if self.places.table.by_hand:
            return self._settled(way, (1,))
        way, value = self._settled(way, (1, 2))
        spread = self.criterion.prior[: self.criterion.linear]
        u = np.linalg.inv(self._triangle(way)[0, 1:-1, 1:-1])[: len(spread)]
        determined = np.linalg.norm(u / spread[:, None], ord=2) < 1.0 / DETERMINED
        return (way, value) if determined else self._settled(way, (1, 2, 3))

    def _settled(self, way: Ways, widths: Sequence[int]) -> tuple[Ways, float]:
        """A programme that no exchange of so many neighbours makes better."""
        value, before = float(self.criterion.of_triangles(self._triangle(way))[0]), np.inf
        while value < before:
            before = value
            for k in widths:
                for start in range(way.places.shape[1] - k + 1):
                    other, found = self.exchanged(way, start, k)
                    if found < value * (1.0 - SAME):
                        way, value = other, found
        return way, value

    def _triangle(self, way: Ways) -> Array:
        """The triangle (1, p + 1, p + 1) of a programme."""
        return _triangles(self.places.chain(way.places[0])[None], way.rows, self.criterion.known)


def _repeated(last: Array, q: int) -> Array:
    """One rest (r, ·) as the same in q chains (q, 1, r, ·)."""
    return np.broadcast_to(last, (q, 1, *last.shape))


# Optimised programmes


def optimised(
    setup: Setup,
    positions: int,
    aim: Aim = Aim(),
    table: TurnTable = ANY,
    progress: Progress = lambda _done, _all: None,
) -> Programme:
    """A programme of so many positions that shows most by a criterion; the set-up's own does not count. `progress` is
    told how many searches are done, and of how many.

    Raises InputError for fewer than two positions, for values that make no sense, and where there is no noise."""
    if positions < 2:
        raise InputError(f"positions: expected at least 2, found {positions}")
    setup = _timeless(setup)
    places = Places.of(table, setup, gyros=aim.gyros)
    by = {
        letter: _Search(places=places, criterion=Criterion.of(replace(aim, letter=letter), setup))
        for letter in _FIRST[aim.letter]
    }
    starts = [int(np.argmax(places.attitudes[:, 1, p] > UPRIGHT)) for p in range(3)]
    searches = [(start, first) for start in starts for first in _FIRST[aim.letter]]
    ends: list[tuple[Ways, float]] = []
    for start, first in searches:
        progress(len(ends), len(searches))
        end = by[first].improved(by[first].grown(start, positions))
        ends.append(end if first == aim.letter else by[aim.letter].improved(end[0]))
    way, _ = min(ends, key=lambda end: round(np.log(end[1]), 8))
    return Programme(
        name=f"{aim.letter}-optimal",
        positions=tuple(places.positions[place] for place in way.places[0]),
        moves=tuple(_move(*leg) for leg in zip(way.moves[0], way.turned[0], strict=True)),
        ordered=True,
    )


def _move(vector: Array, turned: bool) -> Move:
    """A move by a rotation vector; turns of the table are about the positive axis."""
    if not turned:
        return ANY_MOVE
    component = int(np.argmax(np.abs(vector)))
    return Move(axis=np.eye(3)[component], angle=float(vector[component]))


# One more position


@dataclass(frozen=True, kw_only=True, slots=True)
class Next:
    """A programme with one more position: what the position is, how it is reached, how many others are `as_good`, the
    criterion over that of the programme before, and the bound with it."""

    position: Position
    move: Move
    as_good: int
    ratio: float
    bound: Bound


def next_positions(setup: Setup, aim: Aim = Aim(), table: TurnTable = ANY, *, count: int = 5) -> tuple[Next, ...]:
    """The positions that a set-up's programme gains most by, the best first; of equally good ones the first.

    Raises InputError for values that make no sense, and where there is no noise."""
    timeless = _timeless(setup)
    places = Places.of(table, timeless, gyros=aim.gyros, last=setup.programme.positions[-1])
    before, values, legs = candidates(timeless, aim, places)
    order = np.argsort(values, kind="stable")
    steps = np.flatnonzero(np.diff(np.log(values[order])) > ALIKE)
    nexts = []
    for group in np.split(order, steps + 1)[:count]:
        best, programme = int(np.min(group)), setup.programme
        position, move = places.positions[legs.places[best, 0]], _move(legs.moves[best, 0], bool(legs.turned[best, 0]))
        longer = replace(programme, positions=(*programme.positions, position), moves=(*programme.moves, move))
        nexts.append(
            Next(
                position=position,
                move=move,
                as_good=len(group) - 1,
                ratio=float(values[best] / before),
                bound=bound(replace(setup, programme=longer), gyros=aim.gyros),
            )
        )
    return tuple(nexts)


def candidates(setup: Setup, aim: Aim, places: Places) -> tuple[float, Array, Ways]:
    """The criterion of a set-up's programme, and its values (q,) with one more position, by each leg (q) from where it
    ends."""
    criterion = Criterion.of(aim, setup)
    last, triangle = _shown(setup, aim, criterion)
    legs = places.legs(places.index(setup.programme.positions[-1].matrix), 1)
    rest = np.concatenate([_repeated(last, len(legs.places)), places.rest[legs.places]], axis=1)
    before = criterion.of_triangles(_closed(last, triangle)[None])[0]
    return float(before), criterion.of_triangles(_triangles(rest, legs.rows, triangle)), legs


def _shown(setup: Setup, aim: Aim, criterion: Criterion) -> tuple[Array, Array]:
    """What a set-up's programme shows, see `_eliminated`."""
    rest, joint, states = whitened(view(itinerary_of(setup), setup, gyros=aim.gyros))
    rest[0] = begun(rest[0], states)
    return _eliminated(rest, joint, criterion.known)


def _closed(last: Array, triangle: Array) -> Array:
    """The triangle on the parameters when a chain ends with rows (r, ·) on its last rest."""
    d = last.shape[1] - len(triangle)
    rows = np.asarray(np.linalg.qr(last, mode="r"))[d:, d:]
    return np.asarray(np.linalg.qr(np.concatenate([triangle, rows]), mode="r"))


def value_of(setup: Setup, aim: Aim = Aim()) -> float:
    """The criterion of a set-up's programme."""
    criterion = Criterion.of(aim, setup)
    return float(criterion.of_triangles(_closed(*_shown(setup, aim, criterion))[None])[0])


# Programmes beside each other


@dataclass(frozen=True, kw_only=True, slots=True)
class Compared:
    """A programme, its bound, and its criterion."""

    programme: Programme
    bound: Bound
    value: float


def compared(setup: Setup, programmes: Sequence[Programme], aim: Aim = Aim()) -> tuple[Compared, ...]:
    """Programmes beside each other in the same set-up. Raises InputError."""
    return tuple(
        Compared(programme=listed, bound=bound(one, gyros=aim.gyros), value=value_of(_timeless(one), aim))
        for listed, one in ((listed, replace(setup, programme=listed)) for listed in programmes)
    )


# The plan of a set-up


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class PlanResult(Brief):
    """What a set-up's programme can show at best, of the linear model, and what `calibrate` will state of the `whole`
    instrument. `following`
    are the positions it would gain most by, where it was given; `programmes` the programme that was found and those of
    the literature, where one was to be found."""

    setup: Setup
    bound: Bound
    whole: Bound
    following: tuple[Next, ...]
    programmes: tuple[Compared, ...]


def plan(
    setup: Setup,
    *,
    positions: int | None = None,
    aim: Aim = Aim(),
    table: TurnTable = ANY,
    progress: Progress = lambda _done, _all: None,
    prior: Prior | None = None,
) -> PlanResult:
    """The least uncertainty that the programme of a set-up allows, and the best next positions on a table; with
    `positions` the best programme of so many that is found, beside those of the literature, its search told to
    `progress`. With a `prior`, such as `Registry.prior` makes of a type, what `calibrate` will state is with it.
    Raises InputError for values that make no sense, and where there is no noise.

    >>> import tumble
    >>> setup = tumble.Setup.of(rest=120.0)
    >>> found = tumble.plan(setup)
    >>> len(found.following), found.bound.groups[0]
    (5, 'accel.bias')
    """
    check_setup(setup, 1)
    if positions is None:
        return PlanResult(
            setup=setup,
            bound=bound(setup, gyros=aim.gyros),
            whole=stated(with_all_groups(setup), gyros=aim.gyros, prior=prior),
            following=next_positions(setup, aim, table),
            programmes=(),
        )
    setup = replace(setup, programme=optimised(setup, positions, aim, table, progress))
    rows = compared(setup, (setup.programme, *map(built_in, COMPARED)), aim)
    whole = stated(with_all_groups(setup), gyros=aim.gyros, prior=prior)
    return PlanResult(setup=setup, bound=rows[0].bound, whole=whole, following=(), programmes=rows)
