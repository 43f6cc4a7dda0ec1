"""Biases that are alike in neighbouring rests: instability that lasts longer than a rest.

The estimate takes what differs from rest to rest as independent. Where it lasts for some tens of seconds the biases of
a rest and of the next have errors in common, and slow functions of time a larger variance than the estimate says: with
a correlation ρ of neighbours up to 1 + 2ρ times. Three gyros do not tell it from a drift; the many of an array do.

With the whitened directions D of the biases, of unit length, one for each rest and sensor, what the unknowns leave of
them B = (1 − Q Qᵀ) D, y = Bᵀ e, M = Bᵀ B, and J, which joins those of a sensor in neighbouring rests, ρ is the score
½ (yᵀ J y − tr J M) of the restricted likelihood over its information ½ tr J M J M. The estimate remains what it is:
it is linear in the noise, whose covariance, whitened, is 1 + ρ D J Dᵀ.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import special

from tumble.estimation.by_session import each_session
from tumble.estimation.causes.projection import Projection
from tumble.estimation.components import COMPONENTS
from tumble.estimation.likelihood import Linearised
from tumble.units import Array, IntArray

ALIKE = 1e-3
"""Biases of a kind are alike in neighbouring rests where chance alone would make them seem so less often."""
ALIKE_SIGMAS = -float(special.ndtri(ALIKE))
MOST_ALIKE = 0.5
"""The largest correlation of neighbours alone that there can be."""
FEW = 3
"""Sensors of a kind that do not tell it from drift."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Neighbours:
    """The biases of a `kind` of sensor at rest: their whitened directions (rows, P), the columns of which, `before` and
    `after`, belong to a sensor in neighbouring rests, and what the unknowns leave: y (P,) and M (P, P)."""

    kind: Literal["accel", "gyro"]
    directions: Array
    before: IntArray
    after: IntArray
    along: Array
    covariance: Array

    def correlation(self, explained: Array, by: Array) -> float:
        """ρ beside what a cause explains, by orthonormal columns in which the biases have the parts H (P, s) and the
        residuals so many (s,); 0 where it does not stand out."""
        y, M = self.along - explained @ by, self.covariance - explained @ explained.T
        a, b = self.before, self.after
        score = float(y[a] @ y[b] - M[a, b].sum())
        across = M[np.ix_(a, b)]
        information = float((M[np.ix_(a, a)] * M[np.ix_(b, b)]).sum() + (across * across.T).sum())
        if score <= ALIKE_SIGMAS * np.sqrt(information):
            return 0.0
        return min(score / information, MOST_ALIKE)

    @property
    def alone(self) -> float:
        """ρ beside no cause."""
        return self.correlation(np.zeros((len(self.along), 0)), np.zeros(0))

    def in_common(self, own: Array, along: Array) -> Array:
        """What is to be added to the covariance 1 (s, s) of the residuals `along` orthonormal columns (·, s) of what
        the unknowns leave of a cause, ρ being that beside it."""
        explained = self.directions.T @ own[: len(self.directions)]
        return self.correlation(explained, along) * self.joined(explained)

    def joined(self, by: Array) -> Array:
        """Gᵀ J G (s, s) of columns G (P, s)."""
        half = by[self.before].T @ by[self.after]
        return np.asarray(half + half.T)


def neighbours(linearised: Linearised, projection: Projection) -> Iterator[Neighbours]:
    """The biases of each kind of which there are enough sensors, without those that wander by themselves."""
    (rest, of), (merged, _) = linearised.noise.rest_directions, linearised.noise.merged_directions
    link, r = linearised.problem.link, rest.shape[1]
    joined = np.flatnonzero(link >= 0)
    kinds: tuple[Literal["accel", "gyro"], ...] = ("accel", "gyro")
    for kind in kinds:
        own = np.flatnonzero(of == COMPONENTS.index(kind))
        if len(own) <= FEW or not len(joined):
            continue
        directions = projection.apart(rest[:, :, own], merged[:, r:, own])
        directions /= np.sqrt((directions**2).sum(axis=0))
        left = projection.left_of(directions)
        before = (len(own) * joined[:, None] + np.arange(len(own))).ravel()
        yield Neighbours(
            kind=kind,
            directions=directions,
            before=before,
            after=before + len(own),
            along=left.T @ projection.residual,
            covariance=left.T @ left,
        )


def common_to_neighbours(linearised: Linearised) -> Array:
    """What is to be added to the covariance (m, m) of the parameters because biases are alike in neighbouring rests."""
    m = len(linearised.problem.instrument.names)
    added = np.zeros((m, m))
    if max(block.size for block in linearised.problem.instrument.blocks) <= FEW:
        return added
    for session in each_session(linearised):
        projection = Projection(session, session.scatter)
        for each in neighbours(session, projection):
            if (correlation := each.alone) > 0.0:
                added += correlation * each.joined(projection.changes(each.directions)[:m].T)
    return added
