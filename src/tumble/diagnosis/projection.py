"""What the unknowns of an estimate leave of its residuals and of the columns of causes, at a cost that is linear in the
number of rests: docs/explanation/mathematics.md (36).

Columns A_c are appended to the parameters, without a prior, and everything is eliminated once. Of the triangle

    R_θ  R_θc | r_θ
         R_c  | r_c         R_cᵀ R_c = BᵀB,   R_cᵀ r_c = Bᵀe
              | ρ

B being what all other unknowns leave of the columns, and e the residuals. Several causes share one elimination, for
what is asked of one is asked of its columns of R_c. Without columns of sizes ĉ the parameters err by R_θ⁻¹ R_θc ĉ. Of
several sessions each is judged by itself, with what the others say of the common parameters, their triangles, as its
prior.

A heading that the gyros hardly see may be far from where the rows were linearised. The horizontal Earth's rate is
linear in its cosine and sine, so the part along north is another unknown of each chain of rests that has such a
heading.

The sum of the squares of residuals along whitened directions S, what the unknowns leave of them being P, is Σ λ χ²₁
with the eigenvalues λ of Sᵀ P S. With X = S Sᵀ, blocks of single rests and turns, Σ λ = tr P X, and Σ λ² ≤ tr P X²: as
large where the directions are of one length, else the test is the more cautious. So the blocks of P do.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from tumble.inference.elimination import fold
from tumble.inference.linearisation import Linearisation
from tumble.inference.noise import VarianceComponents
from tumble.inference.normal_equations import (
    Solution,
    eliminate_rests,
    inverse_of,
    session_mean_bias,
    solve,
    with_local_prior,
)
from tumble.inference.problem import Problem
from tumble.units import Array, IntArray

SEEN_HEADING = 0.05
"""rad: a heading that the gyros at rest know better is where the rows were linearised."""
UNSEEN = 1e-4
"""A combination of columns of which the unknowns leave less than this part of the length is not seen."""
FALSE_ALARMS = 5e-3
"""Of sessions in which there is nothing, those of which something is said: by all tests together."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Explained:
    """What columns explain: by how much chi-square falls, with how many combinations `q` that are seen, their `values`,
    SI, and by how much the parameters (m,) err without them."""

    fall: float
    q: int
    values: Array
    moved: Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Projection:
    """Of one session: R_c (c, c), of columns of unit length, and r_c (c,); R_θ⁻¹ R_θc (m, c), the lengths (c,) of the
    columns, u (m,) of the parameters, and chi-square of everything with its degrees of freedom. `scatters`: whether
    there are components of variance, estimated from the same residuals."""

    triangle: Array
    along: Array
    moving: Array
    length: Array
    u: Array
    chi_square: float
    degrees: float
    scatters: bool

    def explained(self, some: slice | IntArray, known: float = np.inf) -> Explained | None:
        """Some of the columns by least squares; None where one is not seen better than it is `known`, SI."""
        own, length = self.triangle[:, some], self.length[some]
        size, directions = np.linalg.eigh(own.T @ own)
        seen = size > UNSEEN**2
        if not seen.any() or 1.0 / np.sqrt(size[seen].min()) > known * length.max():
            return None
        across = directions[:, seen] / np.sqrt(size[seen])
        along = across.T @ (own.T @ self.along)
        values = across @ along
        return Explained(
            fall=float(along @ along),
            q=int(seen.sum()),
            values=values / np.where(length > 0.0, length, np.inf),
            moved=self.moving[:, some] @ values,
        )

    def chance(self, fall: float, q: int, before: tuple[float, int] = (0.0, 0)) -> float:
        """Probability of a fall of chi-square with q parameters, after one with others `before`: by Fisher's
        distribution where the scale of the residuals was estimated from them; 1 where nothing is left beside them to
        tell it by."""
        if not self.scatters:
            return float(scipy.special.chdtrc(q, fall))
        others = self.degrees - q - before[1]
        if others < 1.0:
            return 1.0
        rest = max(self.chi_square - fall - before[0], 1e-9)
        overstated = min(1.0, self.chi_square / self.degrees)  # noise that is less than said proves nothing
        return float(scipy.special.fdtrc(q, others, overstated * fall / q / (rest / others)))


def projections(
    linearised: Linearisation, components: VarianceComponents, rest: Array, turn: Array
) -> Iterator[Projection]:
    """Of every session what its unknowns leave of columns of the rests (N, r, c) and turns (K, t, c), SI, with
    components of variance."""
    rows = _judged_rows(linearised).with_components(components)
    problem, noise = rows.problem, rows.noise
    q, c, p, m = len(problem.local_u), rest.shape[2], len(rows.prior) - 1, len(problem.instrument.names)
    rows = rows.with_columns(rest, turn)
    equations = eliminate_rests(rows)
    of_sessions = zip(equations.session_factors, rows.local_prior, strict=True)
    triangles = [with_local_prior(problem.local_u, *each)[q:, q:] for each in of_sessions]
    common = np.append(np.arange(p), p + c)
    for s, part in enumerate(problem.parts):
        places = (equations.rest_rows[part.rests], equations.turn_rows[part.turns])
        length = np.sqrt(sum((each[..., -1 - c : -1] ** 2).sum(axis=(0, 1)) for each in places))
        triangle, others = triangles[s].copy(), 0
        for o, each in enumerate(triangles):
            if o != s:
                known = np.zeros((p, p + c + 1))
                known[:, common] = each[:p, common]
                others += int(np.count_nonzero(known.diagonal()))
                fold(known, triangle)
        fold(rows.prior, triangle)
        triangle[:, p : p + c] /= np.where(length > 0.0, length, 1.0)
        first = int(triangle[0, 0] == 0.0)  # gravity is taken as exact
        inverse = inverse_of(triangle[first:p, first:p])
        moving, variance = inverse @ triangle[first:p, p : p + c], (inverse**2).sum(axis=1)
        if equations.wanders and len(problem.parts) == 1:
            biases = 1 - first + problem.biases
            by, by_rests = session_mean_bias(equations)
            by = by[:, q + first : -1] / np.append(np.ones(p - first), np.where(length > 0.0, length, 1.0))
            variance[biases] = ((inverse[biases] + by[:, : p - first] @ inverse) ** 2).sum(axis=1)
            variance[biases] += (by_rests**2).sum(axis=(0, 2))
            moving[biases] += by @ np.vstack([moving, -np.eye(c)])
        hidden = np.count_nonzero(equations.rest_factors[part.rests].diagonal(0, 1, 2)[:, :3] == 0.0)
        kept = (noise.rest_weights[part.rests] ** 2).sum() + (
            noise.turn_weights[part.turns] ** 2
        ).sum()  # rows not left out
        yield Projection(
            triangle=triangle[p : p + c, p : p + c],
            along=triangle[p : p + c, -1],
            moving=moving[1 - first : 1 - first + m],
            length=length,
            u=np.sqrt(variance[1 - first : 1 - first + m]),
            chi_square=float((triangle[p:, -1] ** 2).sum()),
            degrees=float(kept) - 3 * len(part.link) + hidden + others,
            scatters=components.wanders or bool(np.any(components.variances > 0.0)),
        )


def judged_solution(linearised: Linearisation, components: VarianceComponents, *, usual: bool = False) -> Solution:
    """The solution from where the rows were linearised with components of variance, beside priors of groups as wide as
    these are large, or of `usual` size."""
    return solve(_judged_rows(linearised, usual), components)


def _judged_rows(linearised: Linearisation, usual: bool = False) -> Linearisation:
    """The rows, with their priors and their noise, by which residuals and causes are judged."""
    problem = linearised.problem
    if usual:
        problem = replace(problem, prior_u=problem.usual_u, local_u=problem.usual_local_u)
    else:
        problem = _as_large_as_they_are(linearised)
    return _with_norths(linearised.with_priors(problem))


def _as_large_as_they_are(linearised: Linearisation) -> Problem:
    """The problem with the prior of every group at least as wide as the group is large: no cause is to gain from a
    prior that the estimate contradicts."""
    problem, point = linearised.problem, linearised.point
    known, own = problem.prior_u.copy(), problem.local_u.copy()
    off = np.append(0.0, point.values) - np.append(0.0, problem.prior_mean[1:])
    for members in problem.instrument.members.values():
        some = slice(members.start + 1, members.stop + 1)
        known[some] *= max(1.0, float(np.sqrt(np.mean((off[some] / known[some]) ** 2))))
    if problem.local is not None:
        for members in problem.local.members.values():
            some = slice(members.start - problem.local.linear_count, members.stop - problem.local.linear_count)
            own[some] *= max(1.0, float(np.sqrt(np.mean((point.local[:, some] / own[some]) ** 2))))
    return replace(problem, prior_u=known, local_u=own)


def _with_norths(rows: Linearisation) -> Linearisation:
    """The rows with the part of the Earth's rate along north as an unknown, 0 ± 1, of every chain whose heading is
    hardly seen, and the noise: of a single rest it is a part of that."""
    problem, noise = rows.problem, rows.noise
    gyro, n = problem.observations.gyro_block, problem.observations.accel_block.size
    if gyro is None or problem.earth[0] == 0.0:
        return rows
    of_gyros = slice(n, n + gyro.size)
    variance = np.diagonal(noise.rest, axis1=1, axis2=2)[:, of_gyros]
    hardly = np.bincount(problem.chain, (rows.headings[:, of_gyros] ** 2 / variance).sum(axis=1)) < SEEN_HEADING**-2
    single = np.bincount(problem.chain) == 1
    rest, turn = by_north(rows)
    alone = rest * (hardly & single)[problem.chain][:, None]
    chains = np.flatnonzero(hardly & ~single)
    own = problem.chain[:, None] == chains
    wide = rows.with_columns(rest[:, :, None] * own[:, None], turn[:, :, None] * own[problem.before_turn][:, None])
    unknown = np.arange(len(rows.prior) - 1, len(wide.prior) - 1)
    wide.prior[unknown, unknown] = 1.0
    return replace(wide, noise=replace(noise, rest=noise.rest + alone[:, :, None] * alone[:, None]))


def by_north(rows: Linearisation) -> tuple[Array, Array]:
    """What the part of the Earth's rate along north predicts of the rows of the rests (N, r) and of the turns (K, t):
    the rate that gyros read at rest, T Ω_N along north of a rotation, and ½ T² Ω_N g along east of a velocity."""
    problem, L = rows.problem, rows.point.attitudes
    gyro, n, north = problem.observations.gyro_block, problem.observations.accel_block.size, problem.earth[0]
    assert gyro is not None
    rest, turn = np.zeros(rows.rest.shape[:2]), np.zeros(rows.turn.shape[:2])
    rest[:, n : n + gyro.size] = north * L[:, 0] @ gyro.axes.T
    turns = problem.observations.turns
    if turns is not None:
        T, start = turns.duration[:, None], L[turns.first]
        turn[:, :3] = T * north * start[:, 0]
        if problem.instrument.in_velocities:
            turn[:, 3:6] = 0.5 * T**2 * north * rows.point.gravity * start[:, 2]
    return rest, turn


def falls_by_place(places: Array, columns: Array, residual: Array, covariance: Array) -> Array:
    """By about how much chi-square falls (p,) with columns that are in several rests or turns at once: whitened ones
    (M, r, q) in parts `places` (p, M), of residuals (M, r) with covariances (M, r, r)."""
    score = places @ np.einsum("krq,kr->kq", columns, residual)
    information = np.tensordot(places**2, np.swapaxes(columns, 1, 2) @ covariance @ columns, axes=1)
    size, directions = np.linalg.eigh(information)
    along = (score[:, None] @ directions)[:, 0]
    seen = size > UNSEEN**2 * np.tensordot(places**2, (columns**2).sum(axis=(1, 2)), axes=1)[:, None]
    return np.asarray(np.where(seen, along**2 / np.where(seen, size, 1.0), 0.0).sum(axis=1))


# -------------------- how likely by chance --------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class SumOfSquares:
    """A sum of squares, its mean where chance alone is at work, and half its variance."""

    square: float
    mean: float
    half_variance: float

    @staticmethod
    def along(directions: Array, residual: Array, covariance: Array) -> SumOfSquares:
        """Of residuals (M, r) with these covariances (M, r, r) along whitened directions (M, r, q)."""
        outer = directions @ np.swapaxes(directions, 1, 2)
        once = covariance @ outer
        return SumOfSquares(
            square=float((np.einsum("kr,krq->kq", residual, directions) ** 2).sum()),
            mean=float(np.trace(once, axis1=1, axis2=2).sum()),
            half_variance=float((once * np.swapaxes(outer, 1, 2)).sum()),
        )

    @property
    def degrees(self) -> float:
        """Of the chi-square with the same mean and variance, in its own unit."""
        return self.mean**2 / self.half_variance if self.half_variance > 0.0 else 0.0

    @property
    def chance(self) -> float:
        """Probability that chance alone makes it as large."""
        if self.degrees <= 0.0:
            return 1.0
        return float(scipy.special.chdtrc(self.degrees, self.degrees * self.square / self.mean))

    @property
    def excess(self) -> float:
        """The variance along the directions that is there beside what is expected, by the score."""
        return max(0.0, self.square - self.mean) / self.half_variance if self.half_variance > 0.0 else 0.0

    def chance_beside(self, other: SumOfSquares) -> float:
        """Probability that chance alone makes it as large as it is beside another, whatever the scale of both."""
        if min(self.degrees, other.degrees, other.square) <= 0.0:
            return 1.0
        ratio = self.square / self.mean / (other.square / other.mean)
        return float(scipy.special.fdtrc(self.degrees, other.degrees, ratio))


def standing_out(probabilities: Sequence[float]) -> float:
    """The largest of the probabilities of many tests that stands out, by Holm's rule: the i-th smallest of m does where
    it and all before it are below FALSE_ALARMS/(m − i + 1). 0 where none does."""
    limit, m = 0.0, len(probabilities)
    for i, probability in enumerate(sorted(probabilities)):
        if probability * (m - i) > FALSE_ALARMS:
            break
        limit = probability
    return limit
