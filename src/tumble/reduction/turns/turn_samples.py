"""Where the samples of the turns are, and how they are read in batches."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from tumble.reduction.blocks.motion_samples import MotionSamples
from tumble.reduction.rests.blemishes import NO_BAD_SAMPLES, BadSamples
from tumble.reduction.turns.moments import Pieces
from tumble.units import IntArray

BATCH_SAMPLES = 2**17
"""Of turns, that are in memory at a time: 7 MB."""
KEPT_SAMPLES = 2**19
"""So few of turns are gathered once and stay in memory: 29 MB."""
AHEAD = 2
"""Samples kept ahead of every piece of a turn, which the first step wants."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TurnSamples:
    """Where the samples of the turns are: turn k is samples start[k] … stop[k] − 1 of `samples`, the `bad` ones among
    them replaced; those of further sessions are `others`, after so many turns."""

    samples: MotionSamples
    start: IntArray
    stop: IntArray
    bad: BadSamples = NO_BAD_SAMPLES
    others: tuple[tuple[int, TurnSamples], ...] = ()
    _kept: list[Pieces] = field(default_factory=list, repr=False)

    @property
    def lengths(self) -> IntArray:
        """How many samples the turns have (K,)."""
        return np.concatenate([self.stop - self.start, *(other.lengths for _, other in self.others)])

    def pieces(self) -> Iterator[Pieces]:
        """Batches of whole or cut turns, of no turn two pieces."""
        yield from self._own_pieces()
        for before, other in self.others:
            yield from (replace(pieces, turn=pieces.turn + before) for pieces in other.pieces())

    def _own_pieces(self) -> Iterator[Pieces]:
        """Those of these samples."""
        if self._kept:
            return iter(self._kept)
        if int(np.sum(self.stop - self.start)) < KEPT_SAMPLES:
            self._kept.extend(self._gathered())
            return iter(self._kept)
        return self._gathered()

    def _gathered(self) -> Iterator[Pieces]:
        parts: list[tuple[int, int, int, int]] = []
        count = 0
        for turn, (start, stop) in enumerate(zip(self.start, self.stop, strict=True)):
            for at in range(int(start), int(stop), BATCH_SAMPLES):
                end, ahead = min(at + BATCH_SAMPLES, int(stop)), min(AHEAD, at)
                parts.append((turn, at - ahead, at, end))
                count += end - at + ahead
                if count >= BATCH_SAMPLES:
                    yield self._pieces(parts, count)
                    parts, count = [], 0
        if parts:
            yield self._pieces(parts, count)

    def _pieces(self, parts: list[tuple[int, int, int, int]], count: int) -> Pieces:
        """So many samples in parts of turns: turn, first sample to be read, first of the part, and its end."""
        rates, forces, intervals = np.empty((count, 3)), np.empty((count, 3)), np.empty(count)
        pieces, done = [], 0
        for turn, first, at, end in parts:
            into = slice(done, done + end - first)
            rates[into], forces[into], intervals[into] = self.samples.read(first, end)
            bad = slice(*np.searchsorted(self.bad.at, [first, end]))
            places = done + self.bad.at[bad] - first
            rates[places], forces[places] = np.hsplit(self.bad.values[bad], 2)
            pieces.append((turn, done + at - first, done + end - first))
            done += end - first
        turns, start, stop = np.array(pieces).T
        return Pieces(rates=rates, forces=forces, intervals=intervals, turn=turns, start=start, stop=stop)
