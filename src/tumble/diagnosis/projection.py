"""Least-squares fits of candidate columns to the residuals of an estimate, at a cost that is linear in the number of
rests: docs/explanation/mathematics.md (36).

Columns A_c are appended to the parameters without a prior, and all unknowns are eliminated once. In the triangle

    R_θ  R_θc | r_θ
         R_c  | r_c         R_cᵀ R_c = BᵀB,   R_cᵀ r_c = Bᵀe
              | ρ

B is what the other unknowns leave of the columns, and e are the residuals. All candidates share one elimination; each
is fitted by its own columns of R_c. If errors of sizes ĉ are left out, the parameters err by R_θ⁻¹ R_θc ĉ. Each of
several sessions is judged by itself, with the triangles of the others as prior of the common parameters.

A heading that the gyros hardly determine may be far from where the rows were linearised. The northward Earth's rate
that they then predict is wrong by its own size, which is noise (`with_unknown_headings`).

Degrees of freedom are the rows less the unknowns that these determine, of the parameters γ = m − tr ΛC with the
information Λ of the priors and the covariance C (MacKay, Neural Comput. 4 (1992) 415): a device may be far better than
usual. Columns that leave less than one degree of freedom fit whatever drifts, and explain nothing.

The sum of squares of residuals along whitened directions S is Σ λ χ²₁, where λ are the eigenvalues of Sᵀ P S and P is
the covariance of the residuals. With X = S Sᵀ, Σ λ = tr P X and Σ λ² ≤ tr P X², with equality if the directions have
one length; otherwise the test is conservative. X consists of blocks of single rests and turns, so blocks of P suffice.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from tumble.inference.elimination import fold
from tumble.inference.linearisation import Linearisation
from tumble.inference.noise import VarianceComponents
from tumble.inference.normal_equations import eliminate_rests, inverse_of, session_mean_bias, with_local_prior
from tumble.units import Array, IntArray

DETERMINED_HEADING = 0.05
"""rad: headings with a smaller uncertainty from the gyros at rest are close to where the rows were linearised."""
RELATIVE_RANK = 1e-4
"""Combinations of columns that lose all but this part of their length to the other unknowns are not determined."""
FALSE_ALARMS = 5e-3  # probability that all tests together find something in a session in which nothing is wrong
NO_COLUMNS = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ColumnFit:
    """Least-squares fit of columns to residuals."""

    drop: float  # decrease of chi-square
    rank: int  # number of combinations of the columns that are determined
    values: Array  # (q,): fitted sizes, SI
    shift: Array  # (m,): errors of the parameters if the columns are left out


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Projection:
    """Columns and residuals of one session after the elimination of all unknowns."""

    triangle: Array  # (c, c): R_c, of columns scaled to unit length
    residual: Array  # (c,): r_c
    by_columns: Array  # (m, c): R_θ⁻¹ R_θc, shift of the parameters by the scaled columns
    length: Array  # (c,): lengths of the columns
    u: Array  # (m,): standard uncertainties of the parameters
    chi_square: float  # of all residuals
    degrees: float

    def fit(self, columns: slice | IntArray) -> ColumnFit | None:
        """Fit some of the columns; return None if no combination of them is determined."""
        R, length = self.triangle[:, columns], self.length[columns]
        eigenvalue, vectors = np.linalg.eigh(R.T @ R)
        determined = eigenvalue > RELATIVE_RANK**2
        if not determined.any():
            return None
        root = vectors[:, determined] / np.sqrt(eigenvalue[determined])
        explained = root.T @ (R.T @ self.residual)
        scaled = root @ explained
        return ColumnFit(
            drop=float(explained @ explained),
            rank=int(determined.sum()),
            values=scaled / np.where(length > 0.0, length, np.inf),
            shift=self.by_columns[:, columns] @ scaled,
        )

    def p_value(self, columns: IntArray, beside: IntArray = NO_COLUMNS, handicap: float = 0.0) -> float:
        """Return the probability that chance explains as much as columns do beyond some of them, those `beside`.

        The decrease of chi-square counts less a `handicap`. The distribution is Fisher's, as the scale of the residuals
        comes from themselves."""
        fit, before = self.fit(columns), self.fit(beside)
        if fit is None:
            return 1.0
        drop, rank = fit.drop - handicap, fit.rank
        if before is not None:
            drop, rank = drop - before.drop, rank - before.rank
        remaining = self.degrees - fit.rank
        if min(drop, rank) <= 0 or remaining < 1.0:
            return 1.0
        chi_square = max(self.chi_square - fit.drop, 1e-9)
        overstated = min(1.0, self.chi_square / self.degrees)  # residuals below the stated noise prove nothing
        return float(scipy.special.fdtrc(rank, remaining, overstated * drop / rank / (chi_square / remaining)))


def projections(
    linearised: Linearisation, components: VarianceComponents, rest: Array, turn: Array
) -> Iterator[Projection]:
    """Yield the projection of every session for columns (N, r, c) of the rests and (K, t, c) of the turns, SI."""
    problem, noise = linearised.problem, linearised.noise
    q, c, m = len(problem.local_u), rest.shape[2], len(problem.instrument.names)
    p, rows = 1 + m, linearised.with_components(components).with_columns(rest, turn)
    equations = eliminate_rests(rows)
    of_sessions = zip(equations.session_factors, rows.local_prior, strict=True)
    triangles = [with_local_prior(problem.local_u, *each)[q:, q:] for each in of_sessions]
    common = np.append(np.arange(p), p + c)
    for s, part in enumerate(problem.session_spans):
        whitened = [equations.rows[kind][at] for kind, at in part.rows.items() if kind != "link"]
        length = np.sqrt(sum((each[..., -1 - c : -1] ** 2).sum(axis=(0, 1)) for each in whitened))

        # triangle of the session, with the other sessions and the priors; columns of unit length
        triangle, others = triangles[s].copy(), 0
        for o, other in enumerate(triangles):
            if o != s:
                prior = np.zeros((p, p + c + 1))
                prior[:, common] = other[:p, common]
                others += int(np.count_nonzero(prior.diagonal()))
                fold(prior, triangle)
        fold(rows.prior[rows.prior.any(axis=1)], triangle, triangular=True)  # without the zero rows of the columns
        triangle[:, p : p + c] /= np.where(length > 0.0, length, 1.0)

        # shift of the parameters by the columns, and their variances; biases are the means over a single session
        exact = int(triangle[0, 0] == 0.0)  # 1 if gravity is exact
        inverse = inverse_of(triangle[exact:p, exact:p])
        by_columns, variance = inverse @ triangle[exact:p, p : p + c], (inverse**2).sum(axis=1)
        if equations.wanders and len(problem.session_spans) == 1:
            biases = 1 - exact + problem.biases
            by_common, by_rests = session_mean_bias(equations)
            scale = np.append(np.ones(p - exact), np.where(length > 0.0, length, 1.0))
            by_common = by_common[:, q + exact : -1] / scale
            variance[biases] = ((inverse[biases] + by_common[:, : p - exact] @ inverse) ** 2).sum(axis=1)
            variance[biases] += (by_rests**2).sum(axis=(0, 2))
            by_columns[biases] += by_common @ np.vstack([by_columns, -np.eye(c)])

        # degrees of freedom: rows that are not left out, less the unknowns that these determine
        determined = p - exact - float(((rows.prior[:, exact:p] @ inverse) ** 2).sum())  # γ
        undetermined = np.count_nonzero(equations.rest_factors[part.rests].diagonal(0, 1, 2)[:, :3] == 0.0)
        weights = (noise.rows[kind].root_weights[at] ** 2 for kind, at in part.rows.items() if kind != "link")
        kept = sum(weight.sum() for weight in weights)
        angles = 3 * (part.stations.stop - part.stations.start)
        yield Projection(
            triangle=triangle[p : p + c, p : p + c],
            residual=triangle[p : p + c, -1],
            by_columns=by_columns[1 - exact :],
            length=length,
            u=np.sqrt(variance[1 - exact :]),
            chi_square=float((triangle[p:, -1] ** 2).sum()),
            degrees=max(1.0, float(kept) - angles + undetermined + others - determined),
        )


def with_unknown_headings(rows: Linearisation) -> Linearisation:
    """Add the northward Earth's rate, 0 ± 1 of its size, to the noise where the heading is poorly known."""
    problem, noise = rows.problem, rows.noise
    gyro, n = problem.observations.gyro_block, problem.observations.accel_block.size
    if gyro is None or problem.earth[0] == 0.0:
        return rows
    of_gyros, of_turns = noise.rows["gyro"], noise.rows["turn"]
    variance = np.diagonal(of_gyros.covariance, axis1=1, axis2=2)
    information = np.bincount(problem.chain, (rows.rows["gyro"][:, :, 2] ** 2 / variance).sum(axis=1))
    unknown = (information < DETERMINED_HEADING**-2)[problem.chain]
    rest, turn = north_rate_columns(rows)
    rest, turn = rest[:, n:] * unknown[:, None], turn * unknown[problem.before_turn][:, None]
    by_rest, by_turn = (each[:, :, None] * each[:, None] for each in (rest, turn))
    added = {
        "gyro": replace(of_gyros, sources={**of_gyros.sources, "north": by_rest}),
        "turn": replace(of_turns, sources={**of_turns.sources, "north": by_turn}),
    }
    return replace(rows, noise=replace(noise, rows={**noise.rows, **added}))


def north_rate_columns(rows: Linearisation) -> tuple[Array, Array]:
    """Return the effect of the northward Earth's rate Ω_N on the rows of rests (N, r) and turns (K, t).

    It is the rate that gyros read at rest, T Ω_N along north of a rotation, and ½ T² Ω_N g along east of a velocity.
    """
    problem, L = rows.problem, rows.point.attitudes
    gyro, n, north = problem.observations.gyro_block, problem.observations.accel_block.size, problem.earth[0]
    assert gyro is not None
    rest, turn = map(np.zeros_like, rows.residuals)
    rest[:, n : n + gyro.size] = north * L[:, 0] @ gyro.axes.T
    turns = problem.observations.turns
    if turns is not None:
        T, start = turns.duration[:, None], L[turns.first]
        turn[:, :3] = T * north * start[:, 0]
        if problem.instrument.in_velocities:
            turn[:, 3:6] = 0.5 * T**2 * north * rows.point.gravity * start[:, 2]
    return rest, turn


def approximate_drops(columns: Array, residual: Array, covariance: Array) -> Array:
    """Return the approximate decreases of chi-square (M,) by an error in each of M turns alone.

    `columns` (M, r, q), `residual` (M, r) and its `covariance` (M, r, r) are whitened."""
    score = np.einsum("krq,kr->kq", columns, residual)
    eigenvalue, vectors = np.linalg.eigh(np.swapaxes(columns, 1, 2) @ covariance @ columns)
    along = (score[:, None] @ vectors)[:, 0]
    determined = eigenvalue > RELATIVE_RANK**2 * (columns**2).sum(axis=(1, 2))[:, None]
    return np.asarray(np.where(determined, along**2 / np.where(determined, eigenvalue, 1.0), 0.0).sum(axis=1))


# -------------------- probabilities --------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class SumOfSquares:
    """Sum of squares of residuals, with its expectation and half its variance by the noise."""

    square: float
    mean: float
    half_variance: float

    @staticmethod
    def along(directions: Array, residual: Array, covariance: Array) -> SumOfSquares:
        """Return the sum for residuals (M, r) of covariance (M, r, r) along whitened directions (M, r, q)."""
        outer = directions @ np.swapaxes(directions, 1, 2)
        product = covariance @ outer
        return SumOfSquares(
            square=float((np.einsum("kr,krq->kq", residual, directions) ** 2).sum()),
            mean=float(np.trace(product, axis1=1, axis2=2).sum()),
            half_variance=float((product * np.swapaxes(outer, 1, 2)).sum()),
        )

    @property
    def degrees(self) -> float:
        """Degrees of freedom of the scaled chi-square with the same mean and variance."""
        return self.mean**2 / self.half_variance if self.half_variance > 0.0 else 0.0

    @property
    def p_value(self) -> float:
        """Probability that chance exceeds the sum."""
        if self.degrees <= 0.0:
            return 1.0
        return float(scipy.special.chdtrc(self.degrees, self.degrees * self.square / self.mean))

    def p_value_against(self, other: SumOfSquares) -> float:
        """Return the probability that chance exceeds the ratio to another sum, whatever their common scale."""
        if min(self.degrees, other.degrees, other.square) <= 0.0:
            return 1.0
        ratio = self.square / self.mean / (other.square / other.mean)
        return float(scipy.special.fdtrc(self.degrees, other.degrees, ratio))


def holm_limit(p_values: Sequence[float]) -> float:
    """Return the largest significant of m p-values by Holm's rule at level FALSE_ALARMS, 0 if none is.

    The i-th smallest is significant if it and all smaller ones are below FALSE_ALARMS/(m − i + 1)."""
    limit, m = 0.0, len(p_values)
    for i, p_value in enumerate(sorted(p_values)):
        if p_value * (m - i) > FALSE_ALARMS:
            break
        limit = p_value
    return limit
