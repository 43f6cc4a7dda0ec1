"""Best next positions of a programme.

The criterion is the root mean square of u/w, where w are the wanted accuracies or by default the spreads of
`tumble.inference.estimate`. A prior as wide as the spreads makes u finite while there are too few positions; later it
has no effect. Drifts are left out, as the time of a position is not known.

The programme is eliminated once, Eq. (22): what remains are rows in the unknowns of its last rest and a triangle of the
parameters. Each candidate is then an elimination of two rests, however long the programme is. Of equally good
candidates the first is taken; turns of the table come before other moves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tumble.errors import InputError
from tumble.inference.elimination import fold
from tumble.inference.normal_equations import NormalEquations, eliminate_rests, rows_by_station, whitened_rows
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
        angle = np.linalg.norm(vectors, axis=1)
        axes = [_AXES.index(letter) for letter in self.axes]
        steps = np.round(vectors / self.step)
        is_turn = (np.abs(vectors[:, axes]).max(axis=1) > angle - 1e-9) & (angle > 1e-9)
        is_turn &= np.abs(vectors / self.step - steps).max(axis=1) < 1e-6
        vectors = np.where(is_turn[:, None], self.step * steps, vectors)
        turns = np.flatnonzero(is_turn)
        half_turns = np.flatnonzero(is_turn & np.isclose(angle, np.pi))
        others = np.flatnonzero(~is_turn & (angle > 1e-9) & self.by_hand)
        places = np.concatenate([turns, half_turns, others])
        moves = np.concatenate([vectors[turns], -vectors[half_turns], vectors[others]])
        return places, moves, is_turn[places]


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

    def criterion(triangles: Array) -> Array:
        """Return the rms (q,) of u over the weights, from triangles (q, m + 2, m + 2) of gravity and parameters."""
        u = np.linalg.inv(triangles[:, 1:-1, 1:-1]) / weight[:, None]
        return np.asarray(np.sqrt((u**2).sum(axis=(1, 2)) / np.isfinite(weight).sum()))

    equations = eliminate_rests(linearised_course(itinerary_of(setup), setup, gyros=gyros))
    gravity = 1.0 / setup.gravity_u if setup.gravity_u > 0.0 else 0.0
    triangle = np.diag([gravity, *(1.0 / prior), 0.0])
    fold(equations.session_factors[0], triangle)

    end, table = setup.programme.positions[-1], table or TurnTable.of_programme(setup.programme)
    positions = table.positions(end)
    places, moves, turned = table.moves(end.matrix, np.array([position.matrix for position in positions]))
    if not len(places):
        return ()
    ends = np.array([positions[i].matrix for i in places])
    rows = _rows_of_candidates(setup, equations, ends, moves, gyros=gyros)
    both = np.concatenate([np.broadcast_to(triangle, (len(places), *triangle.shape)), rows], axis=1)
    before = float(criterion(triangle[None])[0])
    values = criterion(np.asarray(np.linalg.qr(both, mode="r")))

    order = np.argsort(values, kind="stable")
    best = list[NextPosition]()
    for alike in np.split(order, np.flatnonzero(np.diff(np.log(values[order])) > EQUAL) + 1):
        i = int(alike.min())
        axis = int(np.abs(moves[i]).argmax())
        best.append(
            NextPosition(
                position=positions[places[i]],
                move=Move(axis=np.eye(3)[axis], angle=float(moves[i, axis])) if turned[i] else ANY_MOVE,
                as_good=len(alike) - 1,
                ratio=float(values[i] / before),
            )
        )
    return tuple(best)


def _rows_of_candidates(setup: Setup, equations: NormalEquations, ends: Array, moves: Array, *, gyros: bool) -> Array:
    """Return the rows (q, r, m + 2) in gravity and the parameters that one more rest adds to an eliminated programme.

    The rest is in the attitudes `ends` (q, 3, 3), after the moves (q, 3). All candidates are in one long session, as
    pairs of the last rest of the programme and the new one, without turns from pair to pair. In the unknowns of the
    first rest, of the second, and in x, the rows of a pair are

        R  0  R_x      left by the elimination of the programme
        turn
        0  rest        of the second rest and x
        small  0       prior of undetermined headings
    """
    pairs = np.stack([np.broadcast_to(setup.programme.positions[-1].matrix, ends.shape), ends], axis=1)
    apart = np.stack([moves, np.zeros_like(moves)], axis=1).reshape(-1, 3)[:-1]
    session = linearised_course(Itinerary.through(pairs.reshape(-1, 3, 3), apart, setup), setup, gyros=gyros)
    at_rests, of_turns = rows_by_station(session, whitened_rows(session, session.noise.whitening()))
    d, (q, _, width) = equations.unknowns, of_turns[::2].shape
    of_programme = np.broadcast_to(equations.rest_factors[-1], (q, d, width)).copy()
    of_programme[:, :, d : 2 * d] = 0.0
    of_rest = np.pad(at_rests[1::2], ((0, 0), (0, 0), (d, 0)))
    prior = np.broadcast_to(PRIOR_WEIGHT * np.eye(2 * d, width), (q, 2 * d, width))
    rows = np.concatenate([of_programme, of_turns[::2], of_rest, prior], axis=1)
    return np.asarray(np.linalg.qr(rows, mode="r"))[:, 2 * d :, 2 * d :]
