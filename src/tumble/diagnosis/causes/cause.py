"""A cause of residuals: its columns, its size by least squares, and how likely chance alone shows as much."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from tumble.diagnosis.causes.projection import Projection
from tumble.units import DEGREE, G_STANDARD, Array

Concerns = Literal["accel", "gyro", "both"]
UNITS = {"accel": (1e-6 * G_STANDARD, "µg"), "gyro": (DEGREE / 3600.0, "°/h")}
"""In which the size of a cause is said, (SI, name)."""
WORDS = {"accel": "accelerometers", "gyro": "gyros"}


@dataclass(frozen=True, kw_only=True, slots=True)
class Cause:
    """A candidate cause: its `name`, which sensors it `concerns`, the `probability` that chance alone shows as much,
    by how much the parameters of the linear model err without it at most, in their u, and a `sentence` with size and
    remedy."""

    name: str
    concerns: Concerns
    probability: float
    damage: float
    sentence: str


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Candidate:
    """Columns of the rows of rests (N, r, q) and of turns (K, t, q) of a candidate, per SI unit of its size; sentences
    with a place for the size, one or that of each session, which is said in a `unit` (size in SI, name)."""

    name: str
    concerns: Concerns
    rest: Array
    turn: Array
    unit: tuple[float, str]
    sentences: tuple[str, ...]
    known: float = np.inf
    """A session that knows the size to no better, SI, says nothing of it."""
    tried: int = 1
    """Of how many places it is the most likely."""

    def tested(self, s: int, some: slice, alone: Projection, whole: Projection, linear: int) -> Cause | None:
        """The candidate in session s, its columns being `some` of those in the projections with the noise alone and
        with the components of variance of the estimate: it is no more likely than by either. None where the session
        does not see it."""
        explained = whole.explained(some, self.known)
        if explained is None:
            return None
        by_noise = alone.explained(some)
        probability = 1.0 if by_noise is None else alone.chance(by_noise.fall, by_noise.q)
        largest, (scale, unit) = float(np.abs(explained.values).max()), self.unit
        sentence = self.sentences[min(s, len(self.sentences) - 1)]
        return Cause(
            name=self.name,
            concerns=self.concerns,
            probability=max(probability, whole.chance(explained.fall, explained.q)),
            damage=float(np.max(np.abs(explained.moved[:linear]) / whole.u[:linear])),
            sentence=sentence.format(size=f"{largest / scale:.2g} {unit}".replace(" °", "°")),
        )
