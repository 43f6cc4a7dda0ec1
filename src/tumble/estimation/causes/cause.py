"""A cause of residuals: its columns, its size by least squares, and how likely chance alone shows as much."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tumble.estimation.causes.chances import fall_chance, noise_chance
from tumble.estimation.causes.linearised_session import LinearisedSession
from tumble.estimation.causes.neighbouring_rests import Neighbours
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


def tested(
    candidate: Candidate,
    session: LinearisedSession,
    seen_by: tuple[Projection, Projection],
    alike: Iterable[Neighbours],
) -> Cause | None:
    """A candidate by Eq. (11) of the dynamics method, with the noise `alone` and with the scatter of the estimate: it
    is no more likely than by either. With the scatter, biases may be `alike` in neighbouring rests by as much as they
    are beside the candidate. None where the session does not see it."""
    alone, projection = seen_by
    columns = projection.whitened(candidate.rest, candidate.turn)
    fit = _fitted(columns, projection, candidate.known, alike)
    if fit is None:
        return None
    probability = fall_chance(projection, session.linearised.scatter, fit.fall, fit.q)
    if alone is not projection:
        by_noise = _fitted(alone.whitened(candidate.rest, candidate.turn), alone, np.inf)
        probability = max(probability, 1.0 if by_noise is None else noise_chance(by_noise.fall, by_noise.q))
    m = session.problem.instrument.linear_count
    damage = float(np.max(np.abs(projection.changes(columns @ fit.values)[:m]) / projection.u[:m]))
    largest, (scale, unit) = float(np.abs(fit.values).max()), candidate.unit
    return Cause(
        name=candidate.name,
        concerns=candidate.concerns,
        probability=probability,
        damage=damage,
        sentence=candidate.sentence.format(size=f"{largest / scale:.2g} {unit}".replace(" °", "°")),
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Explained:
    """What whitened columns explain: by how much chi-square falls, with how many combinations `q` that are seen, and
    the `values` of the columns, SI."""

    fall: float
    q: int
    values: Array


def _fitted(
    columns: Array, projection: Projection, known: float, alike: Iterable[Neighbours] = ()
) -> _Explained | None:
    """Whitened columns by least squares; None where one is not seen better than it is `known`, SI. Chi-square falls by
    as much as the covariance of their sizes has it, larger where biases are `alike` in neighbouring rests."""
    length = np.sqrt((columns**2).sum(axis=0))
    left = projection.left_of(columns / np.where(length > 0.0, length, 1.0))
    size, directions = np.linalg.eigh(left.T @ left)
    seen = size > UNSEEN**2
    if not seen.any() or 1.0 / np.sqrt(size[seen].min()) > known * length.max():
        return None
    across = directions[:, seen] / np.sqrt(size[seen])
    own = left @ across
    along = own.T @ projection.residual
    covariance = np.eye(len(along)) + sum(each.in_common(own, along) for each in alike)
    return _Explained(
        fall=float(along @ np.linalg.solve(covariance, along)),
        q=int(seen.sum()),
        values=across @ along / np.where(length > 0.0, length, np.inf),
    )
