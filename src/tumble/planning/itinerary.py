"""Where a device rests, how it gets there, and when: of a programme, and of a simulated session."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tumble.planning.setup import Setup
from tumble.rotation import rotation_vector
from tumble.units import Array, BoolArray, IntArray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Itinerary:
    """Rests in order, and the moves between them.

    `attitudes` (N, 3, 3), body → geographic, and start and stop of the `rests` (N, 2), s; `moves` (N − 1, 3) between
    them, rotation vectors, geographic, rad. `turned` (N − 1,) says which moves are turns of the log, and `still`
    (N − 1,) is the time at each of their ends in which nothing moves, s. `positions` are the places of the rests in a
    programme.
    """

    attitudes: Array
    rests: Array
    moves: Array
    turned: BoolArray
    still: Array
    positions: tuple[int, ...] = ()

    @staticmethod
    def through(attitudes: Array, moves: Array, setup: Setup) -> Itinerary:
        """The itinerary through attitudes by moves, with the rests and the rate of a set-up; where nothing moves there
        is no turn."""
        seconds = np.linalg.norm(moves, axis=1) / setup.turn_rate
        start = setup.rest * np.arange(len(attitudes)) + np.append(0.0, np.cumsum(seconds))
        return Itinerary(
            attitudes=attitudes,
            rests=np.column_stack([start, start + setup.rest]),
            moves=moves,
            turned=seconds > 0.0,
            still=np.zeros(len(moves)),
        )

    @property
    def first(self) -> IntArray:
        """The rests (K,) that a turn of the log follows."""
        return np.flatnonzero(self.turned)

    @property
    def seconds(self) -> Array:
        """Duration of the motion of the turns (K,), s."""
        k = self.first
        return np.asarray(self.rests[k + 1, 0] - self.rests[k, 1] - 2.0 * self.still[k])

    @property
    def middle(self) -> float:
        """Mean time of the rests, s, from the start of the session."""
        return float(self.rests.mean())

    def as_logged(self, ramp: float, margin: float) -> Itinerary:
        """The same as a log shows it: turns begin and end with a ramp, s, and the segmentation cuts a margin, s, off
        both ends of every rest, which belongs to the turn."""
        later = np.append(0.0, ramp * np.cumsum(self.turned))
        return Itinerary(
            attitudes=self.attitudes,
            rests=self.rests + later[:, None] + [margin, -margin],
            moves=self.moves,
            turned=self.turned,
            still=np.where(self.turned, self.still + 0.5 * ramp + margin, 0.0),
            positions=self.positions,
        )


def itinerary_of(setup: Setup) -> Itinerary:
    """The positions of a set-up's programme in the order listed, with the programme's turns, and the shortest move
    where any will do, all at the rate of the set-up."""
    attitudes = np.array([position.matrix for position in setup.programme.positions])
    shortest = rotation_vector(attitudes[1:] @ np.swapaxes(attitudes[:-1], 1, 2))
    moves = [
        way if move.axis is None or move.angle is None else move.angle * move.axis
        for move, way in zip(setup.programme.moves, shortest, strict=True)
    ]
    return Itinerary.through(attitudes, np.array(moves).reshape(-1, 3), setup)
