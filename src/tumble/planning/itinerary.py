"""Attitudes, moves and times of a programme or of a simulated session."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tumble.planning.setup import Setup
from tumble.rotation import rotation_vector
from tumble.units import Array, BoolArray, IntArray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Itinerary:
    """Rests in order, and the moves between them."""

    attitudes: Array  # (N, 3, 3), body → geographic
    rests: Array  # (N, 2): start and stop, s
    moves: Array  # (N − 1, 3): rotation vectors, geographic, rad
    turned: BoolArray  # (N − 1,): whether a move is a turn of the log
    still: Array  # (N − 1,): time without motion at both ends of a turn, s
    positions: tuple[int, ...] = ()  # of the rests in a programme

    @staticmethod
    def through(attitudes: Array, moves: Array, setup: Setup) -> Itinerary:
        """Return the itinerary through attitudes by moves, with the rests and the rate of a set-up; a zero move is no
        turn."""
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
        """The rests (K,) before the turns of the log."""
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
        """Return the itinerary as found in a log, where turns have ramps, s, and the segmentation adds a margin, s, at
        both ends of every rest to the turns."""
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
    """Return the itinerary of a set-up's programme in the order listed, with the shortest move where any is allowed."""
    attitudes = np.array([position.matrix for position in setup.programme.positions])
    shortest = rotation_vector(attitudes[1:] @ np.swapaxes(attitudes[:-1], 1, 2))
    moves = [
        by_shortest if move.axis is None or move.angle is None else move.angle * move.axis
        for move, by_shortest in zip(setup.programme.moves, shortest, strict=True)
    ]
    return Itinerary.through(attitudes, np.array(moves).reshape(-1, 3), setup)
