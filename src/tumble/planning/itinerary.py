"""Where a device rests and how it gets there, and when: as a programme has it, and as a simulated session does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tumble.planning.setup import Setup
from tumble.rotation import rotation_vector
from tumble.units import Array, BoolArray, IntArray

NO_TIME = 1e-6
"""s: of a turn that takes none."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Itinerary:
    """Attitudes (N, 3, 3), body → geographic, of the rests in order, when these begin and end, `rests` (N, 2), s, and
    the `moves` between them (N − 1, 3), rotation vectors, geographic, rad. Those that are `turned` (N − 1,) are turns
    of the log, of which nothing moves for so long after they begin and before they end, `still` (N − 1,), s.
    `positions` says which of its programme each rest is in, where it is of one."""

    attitudes: Array
    rests: Array
    moves: Array
    turned: BoolArray
    still: Array
    positions: tuple[int, ...] = ()

    @staticmethod
    def through(attitudes: Array, moves: Array, setup: Setup) -> Itinerary:
        """That through attitudes by moves with the rests of a set-up and at its rate; where nothing moves the log has
        no turn."""
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
        """How long the turns (K,) take from where they begin to move, s."""
        k = self.first
        return np.asarray(np.maximum(self.rests[k + 1, 0] - self.rests[k, 1] - 2.0 * self.still[k], NO_TIME))

    @property
    def middle(self) -> float:
        """Mean time of the rests, s, from the start of the session."""
        return float(self.rests.mean())

    def as_logged(self, ramp: float, margin: float) -> Itinerary:
        """The same as a log has it: turns are reached and left in a ramp, s, and the segmentation cuts a margin, s, off
        both ends of every rest, which belongs to the turn."""
        later = np.append(0.0, ramp * np.cumsum(self.turned))
        rests = self.rests + later[:, None] + [margin, -margin]
        return Itinerary(
            attitudes=self.attitudes,
            rests=rests,
            moves=self.moves,
            turned=self.turned,
            still=np.where(self.turned, self.still + 0.5 * ramp + margin, 0.0),
            positions=self.positions,
        )

    @staticmethod
    def joined(several: Sequence[Itinerary]) -> Itinerary:
        """Those of several sessions as one, without a turn from one to the next; each keeps its own times."""
        every: dict[str, list[Any]] = {name: [] for name in ("attitudes", "rests", "moves", "turned", "still")}
        for one in several:
            for name, parts in every.items():
                if parts and name in ("moves", "turned", "still"):
                    parts.append(np.zeros((1, *parts[0].shape[1:]), dtype=parts[0].dtype))
                parts.append(getattr(one, name))
        fields: dict[str, Any] = {name: np.concatenate(parts) for name, parts in every.items()}
        return Itinerary(**fields)


def itinerary_of(setup: Setup) -> Itinerary:
    """The positions of a set-up's programme in the order listed, with the programme's turns and, where any move will
    do, the shortest, all at the rate of the set-up."""
    attitudes = np.array([position.matrix for position in setup.programme.positions])
    shortest = rotation_vector(attitudes[1:] @ np.swapaxes(attitudes[:-1], 1, 2))
    moves = [
        way if move.axis is None or move.angle is None else move.angle * move.axis
        for move, way in zip(setup.programme.moves, shortest, strict=True)
    ]
    return Itinerary.through(attitudes, np.array(moves).reshape(-1, 3), setup)
