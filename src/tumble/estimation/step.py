"""The least-squares step of a linearised likelihood, with the attitudes eliminated, and what it leaves of residuals.

Rows are whitened. Of each session the attitudes are eliminated, which leaves a triangle: what the session says of what
it has of its own, of gravity and of the common parameters (`Told`). Priors are folded in after that (`joined`), so that
others are tried without eliminating again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dtrmm
from scipy.linalg.lapack import dtrtri

from tumble.estimation.components import COMPONENTS, Noise, Weights
from tumble.estimation.elimination import eliminate, fold, put_back
from tumble.estimation.likelihood import Problem, Rows
from tumble.estimation.residual_loops import leave
from tumble.units import Array, IntArray

_EVERY = np.arange(len(COMPONENTS))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Known:
    """What is known once the attitudes are eliminated: the least-squares step of gravity and the parameters (1 + m,),
    and of what each session has of its `own` (S, q); `roots` U (S, q + 1 + m, q + 1 + m), triangles, of the covariances
    U Uᵀ of what each has of its own, then gravity and the parameters; the sum of squares that is left, priors included;
    and the diagonal of the triangle it is from."""

    parameters: Array
    own: Array
    roots: Array
    square: float
    pivots: Array

    @property
    def variances(self) -> Array:
        """Of what each session has of its own, gravity and the parameters (S, q + 1 + m)."""
        return np.asarray((self.roots**2).sum(axis=2))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Told:
    """What rows say without any prior: their weights, the whitened rows, those that give the attitudes (N, 3, ·), and
    of each session, its attitudes eliminated, a triangle (q + 1 + p, q + 1 + p) of what it has of its own, gravity and
    the common parameters."""

    weights: Weights
    whitened: tuple[Array, Array]
    factor: Array
    sessions: Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Step(Known):
    """The least-squares step, with that of the angles (N, 3); the covariance of gravity and the parameters, and that of
    each session, of what it has of its own, gravity and the parameters; twice the negative logarithm of the restricted
    likelihood, less its constant; what the rows told, and what `left` needs."""

    covariance: Array
    own_covariance: Array
    angles: Array
    deviance: float
    told: Told
    shared: tuple[Array, Array]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Left:
    """Whitened residuals after a step, and their covariances, 1 where the fit has no part in them: (N, r) and (N, r, r)
    of the rests, which count where no turn follows, (K, r + t) and (K, r + t, r + t) of the merged rows."""

    rest: tuple[Array, Array]
    merged: tuple[Array, Array]


def solve(problem: Problem, rows: Rows, weight: Weights) -> Step:
    """The least-squares step with the attitudes eliminated, and with what each session has of its own."""
    return completed(problem, rows, tell(problem, rows, weight))


def completed(problem: Problem, rows: Rows, told: Told) -> Step:
    """The least-squares step of what rows have told and of their priors."""
    known, N = joined(problem, rows, told), len(problem.link)
    angles, shared = np.empty((N, 3)), []
    own_covariance = known.roots @ np.swapaxes(known.roots, 1, 2)
    for part, own, covariance in zip(problem.parts, known.own, own_covariance, strict=True):
        both = np.concatenate([own, known.parameters])
        shared.append(put_back(told.factor[part.rests], part.link, both, covariance, angles[part.rests]))
    return Step(
        parameters=known.parameters,
        own=known.own,
        roots=known.roots,
        covariance=own_covariance[0, len(problem.own_known) :, len(problem.own_known) :],
        own_covariance=own_covariance,
        square=known.square,
        pivots=known.pivots,
        angles=angles,
        deviance=_deviance(problem, told, known),
        told=told,
        shared=(np.concatenate([each[0] for each in shared], axis=1), np.concatenate([each[1] for each in shared])),
    )


def tell(problem: Problem, rows: Rows, weight: Weights) -> Told:
    """What the rows of every session say by themselves."""
    rest, merged = whitened_rows(problem, rows, weight)
    size = len(problem.own_known) + len(rows.prior)
    factor, sessions = np.empty((len(rest), 3, 6 + size)), np.zeros((len(problem.parts), size, size))
    for part, triangle in zip(problem.parts, sessions, strict=True):
        eliminate(rest[part.rests], merged[part.turns], part.link, part.last, factor[part.rests], triangle)
    return Told(weights=weight, whitened=(rest, merged), factor=factor, sessions=sessions)


def joined(problem: Problem, rows: Rows, told: Told) -> Known:
    """What all sessions together say, with the priors of the rows."""
    q, triangle, heads = len(problem.own_known), rows.prior, []
    for session, residual in zip(told.sessions, rows.own, strict=True):
        wide = with_own(problem, session, residual)
        heads.append(wide[:q])
        fold(triangle, wide[q:, q:])
        triangle = wide[q:, q:]
    parameters, root = _solved(triangle)
    own = [_put_back_own(head, parameters, root) for head in heads]
    return Known(
        parameters=parameters,
        own=np.array([each[0] for each in own]),
        roots=np.array([each[1] for each in own]),
        square=float(triangle[-1, -1] ** 2),
        pivots=np.concatenate([each.diagonal() for each in (*heads, triangle[:-1])]),
    )


def with_own(problem: Problem, session: Array, residual: Array) -> Array:
    """What a session says, a triangle, with the prior of what it has of its own, of whitened residual (q,)."""
    wide, q = session.copy(), len(residual)
    if q:
        prior = np.zeros((q, len(wide)))
        prior[:, :q], prior[:, -1] = np.diag(1.0 / problem.own_known), residual
        fold(prior, wide)
    return wide


def whitened_rows(problem: Problem, rows: Rows, weight: Weights) -> tuple[Array, Array]:
    """The whitened rows of the rests, and of the turns with the rests before them, as the elimination has them: after
    the angles what a session has of its own, then gravity and the common parameters."""
    merged = weight.merged @ rows.merged(problem.before_turn)
    return _own_first(problem, weight.rest @ rows.rest, 3), _own_first(problem, merged, 6)


def _own_first(problem: Problem, rows: Array, angles: int) -> Array:
    """Rows in which what a session has of its own stands before gravity and the common parameters."""
    q = len(problem.own_known)
    if q == 0:
        return rows
    last = rows.shape[2] - 1
    order = [*range(angles), *range(last - q, last), *range(angles, last - q), last]
    return np.take(rows, order, axis=2)


def _put_back_own(head: Array, parameters: Array, root: Array) -> tuple[Array, Array]:
    """What a session has of its own (q,), from the rows (q, q + p + 1) that give it once the parameters are known, and
    a root (q + p, q + p) of its covariance with them."""
    q = len(head)
    if q == 0:
        return np.zeros(0), root
    inverse, whole = inverse_of(head[:, :q]), np.zeros((q + len(root), q + len(root)))
    by_parameter = -inverse @ head[:, q:-1]
    whole[:q, :q], whole[:q, q:], whole[q:, q:] = inverse, by_parameter @ root, root
    return inverse @ head[:, -1] + by_parameter @ parameters, whole


def _deviance(problem: Problem, told: Told, known: Known) -> float:
    """−2 log of the restricted likelihood, less its constant: log |Σ| + log |Aᵀ Σ⁻¹ A| + rᵀ P r."""
    own = told.weights.rest[problem.unlinked], told.weights.merged
    whitened = np.concatenate([each.diagonal(0, 1, 2).ravel() for each in own])
    pivots = np.abs(np.concatenate([told.factor.diagonal(0, 1, 2).ravel(), known.pivots]))
    return float(2.0 * (np.log(pivots[pivots > 0.0]).sum() - np.log(whitened).sum()) + known.square)


def _solved(triangle: Array) -> tuple[Array, Array]:
    """Step (1 + m,) of gravity and the parameters, and a root of their covariance; of gravity zero where it is taken as
    exact."""
    first = int(triangle[0, 0] == 0.0)
    p = len(triangle) - 1
    step, root = np.zeros(p), np.zeros((p, p))
    root[first:, first:] = inverse_of(triangle[first:p, first:p])
    step[first:] = root[first:, first:] @ triangle[first:p, p]
    return step, root


def inverse_of(triangle: Array) -> Array:
    """The inverse of an upper triangle. Raises LinAlgError where it has none."""
    inverse, singular = dtrtri(triangle)
    if singular:
        raise np.linalg.LinAlgError("Singular matrix")
    return np.asarray(inverse)


def left(problem: Problem, step: Step) -> Left:
    """What a step leaves of the residuals: nothing of rests that do not count."""
    rest, merged = step.told.whitened
    of_rests = np.zeros(rest.shape[:2]), np.zeros((*rest.shape[:2], rest.shape[1]))
    of_merged = np.empty(merged.shape[:2]), np.empty((*merged.shape[:2], merged.shape[1]))
    known = step.angles, *step.shared
    for s, part in enumerate(problem.parts):
        last, others = part.rests.start + part.last_rests, np.concatenate([step.own[s], step.parameters])
        for rows, first, (residual, covariance), own in (
            (rest[last], last, of_rests, last),
            (merged[part.turns], part.rests.start + part.first, of_merged, part.turns),
        ):
            predicted = _predicted(rows, step.roots[s])
            residual[own] = leave(rows, first, known, others, predicted)
            covariance[own] = predicted
    return Left(rest=of_rests, merged=of_merged)


def _predicted(rows: Array, root: Array) -> Array:
    """Covariances (M, r, r) of what rows predict with unknowns (p,) whose covariance has this `root`, alone."""
    M, r, _ = rows.shape
    by = rows[:, :, -1 - len(root) : -1].reshape(M * r, len(root))
    along = dtrmm(1.0, root.T, by.T, lower=1).T.reshape(M, r, len(root))
    return np.asarray(along @ np.swapaxes(along, 1, 2))


def variance_slopes(problem: Problem, step: Step, noise: Noise) -> Array:
    """Derivatives (c, 1 + m) of the variances of gravity and the parameters by those of the components of scatter: with
    the covariances S of what rows predict with the parameters, Σ (Zᵀ Wᵀ S)² over the directions of a component."""
    slopes = np.zeros((len(COMPONENTS), len(step.parameters)))
    (rest, merged), weights = step.told.whitened, step.told.weights
    (at_rest, of_rest), (of_merged, component) = noise.rest_directions, noise.merged_directions
    for covariance, part in zip(step.own_covariance, problem.parts, strict=True):
        last, first = part.rests.start + part.last_rests, part.rests.start + part.first
        of_rests = weights.rest[last] @ at_rest[last], _with_parameters(step, covariance, rest[last], last[:, None])
        two = np.stack([first, first + 1], axis=1)
        Z = weights.merged[part.turns] @ of_merged[part.turns]
        of_turns = Z, _with_parameters(step, covariance, merged[part.turns], two)
        for of, (Z, S) in ((of_rest, of_rests), (component, of_turns)):
            slopes += (_EVERY[:, None] == of) @ ((np.swapaxes(Z, 1, 2) @ S) ** 2).sum(axis=0)
    return slopes


def _with_parameters(step: Step, covariance: Array, rows: Array, rests: IntArray) -> Array:
    """Covariances (M, r, 1 + m) of what whitened rows of some `rests` (M, ·) each predict with gravity and the
    parameters, of those of a session (p, p)."""
    M, r, q = *rows.shape[:2], len(covariance) - len(step.parameters)
    shared = step.shared[1][rests].reshape(M, 3 * rests.shape[1], len(covariance))[:, :, q:]
    by = rows[:, :, shared.shape[1] : -1].reshape(M * r, len(covariance)) @ covariance[:, q:]
    return np.asarray(rows[:, :, : shared.shape[1]] @ shared + by.reshape(M, r, len(step.parameters)))
