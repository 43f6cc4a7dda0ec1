"""A cause of residuals: its columns, its size by least squares, and how likely chance alone shows as much."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from tumble.estimation.causes.chances import fall_chance
from tumble.estimation.causes.linearised_session import LinearisedSession
from tumble.estimation.causes.projection import Projection
from tumble.units import DEGREE, G_STANDARD, Array

UNSEEN = 1e-4
"""A combination of a cause's columns of which the projection leaves less than this part of the length is not seen."""

Concerns = Literal["accel", "gyro", "both"]
UNITS = {"accel": (1e-6 * G_STANDARD, "µg"), "gyro": (DEGREE / 3600.0, "°/h")}
"""In which the size of a cause is said, (SI, name)."""
WORDS = {"accel": "accelerometers", "gyro": "gyros"}


@dataclass(frozen=True, kw_only=True, slots=True)
class Cause:
    """A candidate cause: its `name`, which sensors it `concerns`, the `probability` that chance alone shows as much,
    by how much the 21 parameters err without it at most, in their u, and a `sentence` with size and remedy."""

    name: str
    concerns: Concerns
    probability: float
    damage: float
    sentence: str


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Candidate:
    """Columns of rest rows (N, r, q) and rows of turns (K, t, q) of a candidate, per SI unit of its size; `sentence`
    with a place for the size, which is said in a `unit` (size in SI, name)."""

    name: str
    concerns: Concerns
    rest: Array
    turn: Array
    unit: tuple[float, str]
    sentence: str
    known: float = np.inf
    """A session that knows the size to no better, SI, says nothing of it."""


def tested(candidate: Candidate, session: LinearisedSession, projection: Projection) -> Cause | None:
    """A candidate by Eq. (11) of the dynamics method; None where the session does not see it."""
    columns = projection.whitened(candidate.rest, candidate.turn)
    length = np.sqrt((columns**2).sum(axis=0))
    columns = columns / np.where(length > 0.0, length, 1.0)
    left = projection.left_of(columns)
    size, directions = np.linalg.eigh(left.T @ left)
    seen = size > UNSEEN**2
    if not seen.any() or 1.0 / np.sqrt(size[seen].min()) > candidate.known * length.max():
        return None
    along = directions[:, seen].T @ (left.T @ projection.residual)
    fall, q = float((along**2 / size[seen]).sum()), int(seen.sum())
    values = directions[:, seen] @ (along / size[seen])
    m = session.problem.instrument.linear_count
    damage = float(np.max(np.abs(projection.change(columns, values)[:m]) / projection.u[:m]))
    largest = float(np.max(np.abs(values / np.where(length > 0.0, length, np.inf))))
    scale, unit = candidate.unit
    return Cause(
        name=candidate.name,
        concerns=candidate.concerns,
        probability=fall_chance(projection, session.linearised.scatter, fall, q),
        damage=damage,
        sentence=candidate.sentence.format(size=f"{largest / scale:.2g} {unit}".replace(" °", "°")),
    )
