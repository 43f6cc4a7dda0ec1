"""Best next positions of a programme.

The criterion is the mean square of u over weights, which are the wanted accuracies or by default the spreads of
`tumble.inference.estimate`. A prior as wide as the spreads makes u finite while there are too few positions; later it
has no effect. Drifts are left out, as the time of a position is not known.

The elimination of the attitudes and in-run biases of all rests but the last leaves rows of those of the last and a
triangle of the parameters (`tumble.inference.elimination`). Each candidate is then an elimination of two rests for any
length of the programme. Of equally good candidates the first is taken; turns of the table come before other moves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tumble.errors import InputError
from tumble.inference.elimination import fold
from tumble.inference.normal_equations import eliminate_rests, rows_by_station, whitened_rows
from tumble.planning.bounds import instrument_of, linearised_course
from tumble.planning.itinerary import Itinerary, itinerary_of
from tumble.planning.setup import Setup
from tumble.programme.positions import ANY_MOVE, TRIPLES, Move, Position, Programme, from_attitudes
from tumble.rotation import rotation_vector
from tumble.sensors.parameters import group_name, limits_of
from tumble.units import DEGREE, Array, BoolArray, IntArray

EQUAL = 1e-6  # relative difference of the criteria of equally good positions, as by symmetry
PRIOR_WEIGHT = 1e-6  # inverse width, in rad or in-run biases, of the prior of undetermined headings
SMALLEST_STEP = 5.0  # degrees; finer steps make too many positions
_AXES = "NUE"


@dataclass(frozen=True, kw_only=True, slots=True)
class TurnTable:
    """A turntable."""

    axes: str = _AXES  #: some of N, U, E
    step: float = 45.0 * DEGREE  #: rad, a part of 90°
    by_hand: bool = True  #: otherwise the device stays mounted, and every move is one turn about one of the axes

    def __post_init__(self) -> None:
        step_deg = self.step / DEGREE
        if not step_deg >= SMALLEST_STEP or abs(90.0 / step_deg - round(90.0 / step_deg)) > 1e-9:
            raise InputError(f"step: expected a part of 90 degrees, at least {SMALLEST_STEP:g}, found {step_deg:g}")
        if not self.axes or not set(self.axes) <= set(_AXES) or len(set(self.axes)) < len(self.axes):
            raise InputError(f"axes: expected some of N, U, E, as in NU, found {self.axes!r}")

    @staticmethod
    def of_programme(programme: Programme) -> TurnTable:
        """Return the table of a programme: it has the axes of the programme's turns, all three without such turns, and
        the device is mounted by hand in any of 24 ways."""
        turned = [move.axis for move in programme.moves if move.axis is not None]
        return TurnTable(axes="".join(a for i, a in enumerate(_AXES) if any(axis[i] for axis in turned)) or _AXES)

    def positions(self, last: Position) -> tuple[Position, ...]:
        """Return the positions that are possible after the last one: the 24 ways along north, up and east, these turned
        once about an axis of the table by a multiple of the step, and the last one turned so."""
        quarter = round(90.0 * DEGREE / self.step)
        ways = ("", *self._turns(range(1, quarter)))
        codes = [f"{letters}{turn}" for turn in ways for letters in TRIPLES]
        codes += [f"{last.attitude}{turn}" for turn in self._turns(range(-2 * quarter, 2 * quarter + 1))]
        positions = from_attitudes(codes).positions
        matrices = np.round([position.matrix for position in positions], 9) + 0.0
        first = np.sort(np.unique(matrices.reshape(len(codes), 9), axis=0, return_index=True)[1])
        return tuple(positions[i] for i in first.tolist())

    def _turns(self, multiples: range) -> list[str]:
        """Return turns by multiples of the step, as appended to a code."""
        return [f" {axis}{self.step / DEGREE * n:+.10g}" for axis in self.axes for n in multiples if n]

    def moves(self, start: Array, ends: Array) -> tuple[IntArray, Array, BoolArray]:
        """Return the moves from an attitude (3, 3) to others (n, 3, 3), turns of the table first, half turns both ways.

        They are the indices (q,) of the ends, the rotation vectors (q, 3), and whether each is a turn (q,)."""
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
    """A position to add to a programme."""

    position: Position
    move: Move  #: that leads there
    as_good: int  #: number of other positions that are as good
    ratio: float  #: of the criterion to that of the programme without it
    u: Mapping[str, float] = field(default_factory=dict, hash=False)  #: in a plan, the expected u by group, SI

    def added(self, setup: Setup) -> Setup:
        """Return a set-up whose programme ends with this position."""
        before = setup.programme
        moves = (*before.moves, self.move)
        return replace(setup, programme=replace(before, positions=(*before.positions, self.position), moves=moves))


def next_positions(
    setup: Setup, *, wanted: Mapping[str, float] | None = None, gyros: bool = True, table: TurnTable | None = None
) -> tuple[NextPosition, ...]:
    """Return the best positions to add to a set-up's programme, the best first; of equally good ones the first.

    Parameters
    ----------
    setup
        Instrument, programme and site.
    wanted
        Accuracies by group, SI, as weights; by default the spreads of the linear parameters.
    gyros
        Whether gyros are calibrated, or accelerometers alone.
    table
        The turntable, by default that of the programme.

    Raises
    ------
    InputError
        For invalid values, if there is no noise, and if nothing that is calibrated is wanted.
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
    prior_rows = np.diag([gravity, *(1.0 / prior), 0.0])

    def criterion(triangles: Array) -> Array:
        """Return the rms (q,) of u over the weights, from triangles (q, m + 2, m + 2) of gravity and parameters."""
        u = np.linalg.inv(triangles[:, 1:-1, 1:-1]) / weight[:, None]
        return np.asarray(np.sqrt((u**2).sum(axis=(1, 2)) / np.isfinite(weight).sum()))

    equations = eliminate_rests(linearised_course(itinerary_of(setup), setup, gyros=gyros))
    d, last, triangle = equations.unknowns, equations.rest_factors[-1], prior_rows.copy()
    fold(equations.session_factors[0], triangle)
    before = float(criterion(triangle[None])[0])

    end, table = setup.programme.positions[-1], table or TurnTable.of_programme(setup.programme)
    positions = table.positions(end)
    places, moves, turned = table.moves(end.matrix, np.array([position.matrix for position in positions]))
    if not len(places):
        return ()
    # all candidates in one long session: pairs of rests without turns from pair to pair
    pairs = np.stack([np.broadcast_to(end.matrix, (len(places), 3, 3)),
                      np.array([positions[i].matrix for i in places])], axis=1)  # fmt: skip
    apart = np.stack([moves, np.zeros_like(moves)], axis=1).reshape(-1, 3)[:-1]
    rows_of_pairs = linearised_course(Itinerary.through(pairs.reshape(-1, 3, 3), apart, setup), setup, gyros=gyros)
    whitened = whitened_rows(rows_of_pairs, rows_of_pairs.noise.whitening())
    rest, turn = (rows[first::2] for rows, first in zip(rows_by_station(rows_of_pairs, whitened), (1, 0), strict=True))
    t = d + turn.shape[1]
    rows = np.zeros((len(places), t + rest.shape[1] + 2 * d, turn.shape[2]))
    rows[:, :d, :d], rows[:, :d, 2 * d :] = last[:, :d], last[:, 2 * d :]
    rows[:, d:t] = turn
    rows[:, t : -2 * d, d : 2 * d], rows[:, t : -2 * d, 2 * d :] = rest[..., :d], rest[..., d:]
    rows[:, -2 * d :, : 2 * d] = PRIOR_WEIGHT * np.eye(2 * d)
    remaining = np.asarray(np.linalg.qr(rows, mode="r"))[:, 2 * d :, 2 * d :]
    both = np.concatenate([np.broadcast_to(triangle, (len(places), *triangle.shape)), remaining], axis=1)
    values = criterion(np.asarray(np.linalg.qr(both, mode="r")))
    order = np.argsort(values, kind="stable")
    alike = np.split(order, np.flatnonzero(np.diff(np.log(values[order])) > EQUAL) + 1)
    return tuple(
        NextPosition(
            position=positions[places[i]],
            move=Move(axis=np.eye(3)[component], angle=float(moves[i, component])) if turned[i] else ANY_MOVE,
            as_good=others,
            ratio=float(values[i] / before),
        )
        for i, others in ((int(each.min()), len(each) - 1) for each in alike)
        for component in [int(np.abs(moves[i]).argmax())]
    )
