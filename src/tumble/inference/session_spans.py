"""Where each of several sessions stands among the rests and turns of all."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tumble.reduction.observations import Observations
from tumble.units import IntArray


@dataclass(frozen=True, kw_only=True, eq=False)
class SessionSpan:
    """One of several sessions: its rests and turns, and the turn among these after each of its rests, or −1."""

    rests: slice
    turns: slice
    link: IntArray

    @cached_property
    def first(self) -> IntArray:
        """The rest before each turn."""
        linked = np.flatnonzero(self.link >= 0)
        return linked[np.argsort(self.link[linked])]


def session_spans(
    observations: Observations, link: IntArray
) -> tuple[tuple[SessionSpan, ...], tuple[IntArray, IntArray]]:
    """The sessions, and that of every rest and turn."""
    session, turns = observations.session, observations.turns
    of_rest = np.zeros(len(link), dtype=np.int64) if session is None else session
    of_turn = np.zeros(0, dtype=np.int64) if turns is None else of_rest[turns.first]
    edges, turn_edges = (np.searchsorted(of, np.arange(of_rest[-1] + 2)) for of in (of_rest, of_turn))
    parts = []
    for s in range(len(edges) - 1):
        rests, own = slice(edges[s], edges[s + 1]), slice(turn_edges[s], turn_edges[s + 1])
        parts.append(SessionSpan(rests=rests, turns=own, link=np.where(link[rests] < 0, -1, link[rests] - own.start)))
    return tuple(parts), (of_rest, of_turn)
