"""The best next positions of a programme.

A position is better the more it reduces the mean square of u over weights, which are wanted accuracies or else the
spreads of `tumble.inference.estimate`. A prior as wide as the spreads makes u finite while positions are too few;
afterwards it counts for nothing. Drifts with time are left out, as it is not known when a position comes.

Eliminating the attitudes and in-run biases of all rests but the last leaves rows on those of the last and a triangle on
the parameters (`tumble.inference.elimination`). A candidate is then an elimination of two rests, whatever the length of
the programme. Of equally good candidates the first is taken, and turns of the table come before other moves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tumble.errors import InputError
from tumble.inference.elimination import fold
from tumble.inference.normal_equations import eliminate_rests, joint_rows, whiten
from tumble.planning.bounds import instrument_of, view
from tumble.planning.itinerary import Itinerary, itinerary_of
from tumble.planning.setup import Setup
from tumble.programme.positions import ANY_MOVE, TRIPLES, Move, Position, Programme, from_attitudes
from tumble.rotation import rotation_vector
from tumble.sensors.parameters import group_name, limits_of
from tumble.units import DEGREE, Array, BoolArray, IntArray

ALIKE = 1e-6
"""Positions whose criteria differ by this part are as good as each other: symmetry makes them so."""
UNSEEN = 1e-6
"""Inverse of the width, in rad or in-run biases, of the prior of a heading that nothing shows."""
SMALLEST_STEP = 5.0
"""Degrees; with finer ones there are too many places to try."""
_AXES = "NUE"


@dataclass(frozen=True, kw_only=True, slots=True)
class TurnTable:
    """A table that turns about `axes`, some of N, U, E, and stops at multiples of `step`, rad, a part of 90°. If not
    `by_hand`, the device stays as it is mounted, and every move is one turn about one of the axes."""

    axes: str = _AXES
    step: float = 45.0 * DEGREE
    by_hand: bool = True

    @staticmethod
    def of(axes: str | None, step_deg: float, programme: Programme | None = None) -> TurnTable:
        """The table of axes such as "N,U", on which the device stays as it is mounted, or of None, that of a programme:
        it turns about the axes that the programme's turns are about, and the device is mounted by hand in any of 24
        ways; without such turns it is held by hand throughout. Raises InputError."""
        if not step_deg >= SMALLEST_STEP or abs(90.0 / step_deg - round(90.0 / step_deg)) > 1e-9:
            raise InputError(f"step: expected a part of 90 degrees, at least {SMALLEST_STEP:g}, found {step_deg:g}")
        if axes is None:
            turned = [] if programme is None else [move.axis for move in programme.moves if move.axis is not None]
            own = "".join(letter for i, letter in enumerate(_AXES) if any(axis[i] for axis in turned))
            return TurnTable(axes=own or _AXES, step=step_deg * DEGREE)
        letters = [letter.strip().upper() for letter in axes.split(",")]
        if not set(letters) <= set(_AXES) or len(set(letters)) < len(letters):
            raise InputError(f"axes: expected some of N, U, E, as in N,U, found {axes!r}")
        return TurnTable(axes="".join(letters), step=step_deg * DEGREE, by_hand=False)

    def positions(self, last: Position) -> tuple[Position, ...]:
        """Where the device can be set to: in any of the 24 ways along north, up and east, turned from there once about
        an axis of the table by a multiple of the step, and where such a turn leads from the last position."""
        quarter = round(90.0 * DEGREE / self.step)
        ways = ("", *self._turns(self.axes, range(1, quarter)))
        codes = [f"{letters}{turn}" for turn in ways for letters in TRIPLES]
        codes += [f"{last.attitude}{turn}" for turn in self._turns(self.axes, range(-2 * quarter, 2 * quarter + 1))]
        positions = from_attitudes(codes).positions
        matrices = np.round([position.matrix for position in positions], 9) + 0.0
        first = np.sort(np.unique(matrices.reshape(len(codes), 9), axis=0, return_index=True)[1])
        return tuple(positions[i] for i in first.tolist())

    def _turns(self, axes: str, multiples: range) -> list[str]:
        """Turns by multiples of the step, as they are added to a code."""
        return [f" {axis}{self.step / DEGREE * n:+.10g}" for axis in axes for n in multiples if n]

    def moves(self, start: Array, ends: Array) -> tuple[IntArray, Array, BoolArray]:
        """Moves from an attitude (3, 3) to others (n, 3, 3), turns of the table first, half turns both ways round:
        the places (q,) they lead to, their rotation vectors (q, 3), and which of them are turns (q,)."""
        vectors = rotation_vector(ends @ start.T)
        angle, axes = np.linalg.norm(vectors, axis=1), [_AXES.index(letter) for letter in self.axes]
        turned = (np.abs(vectors[:, axes]).max(axis=1) > angle - 1e-9) & (angle > 1e-9)
        turned &= np.abs(vectors / self.step - np.round(vectors / self.step)).max(axis=1) < 1e-6
        vectors = np.where(turned[:, None], self.step * np.round(vectors / self.step), vectors)
        kinds = turned, turned & np.isclose(angle, np.pi), ~turned & (angle > 1e-9) & self.by_hand
        one, two, three = (np.flatnonzero(kind) for kind in kinds)
        places = np.concatenate([one, two, three])
        moves = np.concatenate([vectors[one], -vectors[two], vectors[three]])
        return places, moves, np.arange(len(moves)) < len(one) + len(two)


@dataclass(frozen=True, kw_only=True, slots=True)
class NextPosition:
    """A position to add to a programme: the move that leads there, how many others are `as_good`, the criterion over
    that of the programme without it, and, in a plan, the u by group that will then be stated, SI."""

    position: Position
    move: Move
    as_good: int
    ratio: float
    u: Mapping[str, float] = field(default_factory=dict, hash=False)

    def added(self, setup: Setup) -> Setup:
        """A set-up whose programme has this position at its end."""
        before = setup.programme
        moves = (*before.moves, self.move)
        return replace(setup, programme=replace(before, positions=(*before.positions, self.position), moves=moves))


def next_positions(
    setup: Setup, *, wanted: Mapping[str, float] | None = None, gyros: bool = True, table: TurnTable | None = None
) -> tuple[NextPosition, ...]:
    """The positions that a set-up's programme gains most by, the best first; of equally good ones the first.

    `wanted` are accuracies by group, SI, as weights in place of the spreads of the linear parameters; without `gyros`
    accelerometers alone are calibrated. Without a `table` it is that of the programme. Raises InputError for values
    that make no sense, where there is no noise, and where nothing that is calibrated is wanted.
    """
    timeless = (group for group in instrument_of(setup, gyros=True).further if group.variable is None)
    setup = replace(setup, further={group.name: setup.further[group.name] for group in timeless})
    instrument = instrument_of(setup, gyros)
    groups, linear = list(map(group_name, instrument.names)), instrument.linear_count
    prior = limits_of(instrument.names)
    prior[linear:] = [setup.further[group] for group in groups[linear:]]
    weight = np.where(np.arange(len(prior)) < linear, prior, np.inf)
    if wanted:
        weight = np.array([wanted.get(group, np.inf) for group in groups])
    if not np.any(np.isfinite(weight)):
        raise InputError("wanted: expected an accuracy of parameters that are calibrated, found none")
    gravity = 1.0 / setup.gravity_u if setup.gravity_u > 0.0 else 0.0
    known = np.diag([gravity, *(1.0 / prior), 0.0])

    def criterion(triangles: Array) -> Array:
        """Root mean square (q,) of u over the weights, from triangles (q, 1 + m + 1, 1 + m + 1) on gravity and the
        parameters."""
        u = np.linalg.inv(triangles[:, 1:-1, 1:-1]) / weight[:, None]
        return np.asarray(np.sqrt((u**2).sum(axis=(1, 2)) / np.isfinite(weight).sum()))

    equations = eliminate_rests(view(itinerary_of(setup), setup, gyros=gyros))
    d, last, shown = equations.unknowns, equations.rest_factors[-1], known.copy()
    fold(equations.session_factors[0], shown)
    before = float(criterion(shown[None])[0])

    end, table = setup.programme.positions[-1], table or TurnTable.of(None, 45.0, setup.programme)
    positions = table.positions(end)
    places, moves, turned = table.moves(end.matrix, np.array([position.matrix for position in positions]))
    if not len(places):
        return ()
    # one move after the other as if in one long session, without a turn from one to the next
    pairs = np.stack([np.broadcast_to(end.matrix, (len(places), 3, 3)),
                      np.array([positions[i].matrix for i in places])], axis=1)  # fmt: skip
    apart = np.stack([moves, np.zeros_like(moves)], axis=1).reshape(-1, 3)[:-1]
    seen = view(Itinerary.through(pairs.reshape(-1, 3, 3), apart, setup), setup, gyros=gyros)
    rest, turn, link = whiten(seen, *seen.noise.whitening())
    rest, turn = rest[1::2], joint_rows(seen, turn, link)[::2]
    t = d + turn.shape[1]
    rows = np.zeros((len(places), t + rest.shape[1] + 2 * d, turn.shape[2]))
    rows[:, :d, :d], rows[:, :d, 2 * d :] = last[:, :d], last[:, 2 * d :]
    rows[:, d:t] = turn
    rows[:, t : -2 * d, d : 2 * d], rows[:, t : -2 * d, 2 * d :] = rest[..., :d], rest[..., d:]
    rows[:, -2 * d :, : 2 * d] = UNSEEN * np.eye(2 * d)
    left = np.asarray(np.linalg.qr(rows, mode="r"))[:, 2 * d :, 2 * d :]
    both = np.concatenate([np.broadcast_to(shown, (len(places), *shown.shape)), left], axis=1)
    values = criterion(np.asarray(np.linalg.qr(both, mode="r")))
    order = np.argsort(values, kind="stable")
    alike = np.split(order, np.flatnonzero(np.diff(np.log(values[order])) > ALIKE) + 1)
    return tuple(
        NextPosition(
            position=positions[places[i]],
            move=_move(moves[i]) if turned[i] else ANY_MOVE,
            as_good=others,
            ratio=float(values[i] / before),
        )
        for i, others in ((int(each.min()), len(each) - 1) for each in alike)
    )


def _move(vector: Array) -> Move:
    """A turn of the table by a rotation vector, about the positive axis."""
    component = int(np.argmax(np.abs(vector)))
    return Move(axis=np.eye(3)[component], angle=float(vector[component]))
