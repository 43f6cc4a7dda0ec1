"""The least-squares step of a linearised likelihood, with what belongs to single rests eliminated, its restricted
likelihood and the score of that, and what it leaves of residuals.

Rows are whitened. Of each session the unknowns of the rests, angles and states of in-run biases, are eliminated, which
leaves a triangle: what the session says of what it has of its own, of gravity and of the common parameters (`Told`).
Priors are folded in after that (`joined`).

With V the covariance of all rows and R the triangular factor of the elimination, priors of the groups included, is

    −2 ℓ = rᵀV⁻¹r + x̂ᵀP₀x̂ + ln |V| − ln |P₀| + 2 Σ ln |diag R|                        (restricted likelihood)

every determinant a sum of logarithms of diagonals that are there. With D = ∂V/∂v and P the projector onto residuals is
the score by the variance v of a component of scatter ½ (rᵀPDPr − tr PD); by the logarithm of a prior's size λ, of a
group c, it is Σ (E c²/λ²s² − 1), which is Fisher's identity.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tumble.inference.elimination import eliminate, fold, given_parameters, put_back
from tumble.inference.hyperparameters import SCATTER, Noise, Weights
from tumble.inference.in_run import InRun
from tumble.inference.likelihood import Problem, Rows, SessionSpan
from tumble.scipy_compiled import lapack
from tumble.units import Array, IntArray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Known:
    """What is known once the attitudes are eliminated: the least-squares step of gravity and the parameters (1 + m,),
    and of what each session has of its `own` (S, q); `roots` U (S, q + 1 + m, q + 1 + m), triangles, of the covariances
    U Uᵀ of what each has of its own, then gravity and the parameters; the sum of squares that is left, priors included;
    and −2 ln of the restricted likelihood, less its constant."""

    parameters: Array
    own: Array
    roots: Array
    square: float
    deviance: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Told:
    """What rows say without any prior: their weights, the process of the biases, the whitened rows of rests and turns,
    those that give the unknowns of the rests (N, d, ·), and of each session, these eliminated, a triangle
    (q + 1 + p, q + 1 + p) of what it has of its own, gravity and the common parameters."""

    weights: Weights
    process: InRun | None
    whitened: tuple[Array, Array]
    factor: Array
    sessions: Array

    @cached_property
    def solved(self) -> tuple[Array, Array, Array]:
        """The unknowns of the rests given others (`tumble.inference.elimination.put_back`)."""
        return put_back(self.factor)

    def given_unknowns(self, rows: Array, first: IntArray | slice) -> Array:
        """Whitened rows (K, t, ·) with the unknowns of the rests, the `first` of each and the one after it where rows
        have those too, as they follow from all others: [what these do | residual where they are zero] (K, t, p + 1)."""
        d, by = self.factor.shape[1], self.solved[2]
        width = by.shape[2]
        out = rows[:, :, -width:] + rows[:, :, :d] @ by[first]
        return out if rows.shape[2] == d + width else out + rows[:, :, d : 2 * d] @ by[1:][first]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Step(Known):
    """The least-squares step, with the `unknowns` (N, d) of the rests, angles and then states of in-run biases; the
    covariance of gravity and the parameters, and that of each session, of what it has of its own, gravity and the
    parameters; what the rows told, and `given` others the covariances of the unknowns of the rests with themselves and
    with those of the next (2, N, d, d); and the `rests` of each session."""

    covariance: Array
    own_covariance: Array
    unknowns: Array
    told: Told
    given: Array
    rests: tuple[slice, ...]

    @property
    def angles(self) -> Array:
        """The step of the angles (N, 3) of the attitudes."""
        return self.unknowns[:, :3]

    def along(self, unknowns: slice) -> Array:
        """How unknowns of the rests (N, k, p) go with what the others are uncertain by, a root of their covariance."""
        every = zip(self.rests, self.roots, strict=True)
        return np.concatenate([self.told.solved[2][rests, unknowns, :-1] @ root for rests, root in every])

    def covariances(self, unknowns: slice) -> Array:
        """Covariances of unknowns of the rests with themselves and those of the next (2, N, k, k)."""
        root, out = self.along(unknowns), self.given[:, :, unknowns, unknowns].copy()
        out[0] += root @ np.swapaxes(root, 1, 2)
        out[1, :-1] += root[:-1] @ np.swapaxes(root[1:], 1, 2)
        return out


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Left:
    """Whitened residuals after a step, and their covariances, 1 where the fit has no part in them: (N, r) and (N, r, r)
    of the rests, (K, t) and (K, t, t) of the turns."""

    rest: tuple[Array, Array]
    turn: tuple[Array, Array]


def solve(problem: Problem, rows: Rows, weight: Weights) -> Step:
    """The least-squares step with the attitudes eliminated, and with what each session has of its own."""
    told = tell(problem, rows, weight)
    return completed(problem, told, joined(problem, rows, told))


def completed(problem: Problem, told: Told, known: Known) -> Step:
    """The least-squares step of what is known once the attitudes are eliminated, with these put back."""
    q, rests = len(problem.own_known), tuple(part.rests for part in problem.parts)
    own_covariance = known.roots @ np.swapaxes(known.roots, 1, 2)
    inverse, by_next, by = told.solved
    others = (np.concatenate([own, known.parameters, [-1.0]]) for own in known.own)
    return Step(
        parameters=known.parameters,
        own=known.own,
        roots=known.roots,
        square=known.square,
        deviance=known.deviance,
        covariance=own_covariance[0, q:, q:],
        own_covariance=own_covariance,
        unknowns=np.concatenate([by[own] @ x for own, x in zip(rests, others, strict=True)]),
        told=told,
        given=given_parameters(inverse, by_next),
        rests=rests,
    )


def tell(problem: Problem, rows: Rows, weight: Weights) -> Told:
    """What the rows of every session say by themselves."""
    process = InRun.of(problem, weight.components) if weight.components.wanders else None
    rest, turn = whitened_rows(problem, rows, weight, process)
    size = len(problem.own_known) + len(rows.prior)
    d = 3 if process is None else 3 + len(process.sigma)
    factor, sessions, joints = np.empty((len(rest), d, 2 * d + size)), np.zeros((len(problem.parts), size, size)), turn
    sessions = np.swapaxes(sessions, 1, 2)
    if process is not None:
        joints = np.zeros((len(rest), turn.shape[1] + d - 3, 2 * d + size))
        joints[problem.before_turn, : turn.shape[1]] = turn
        process.write_steps(joints[:, turn.shape[1] :], d)
    begins = np.zeros((d, 2 * d + size))  # a chain of states begins as its process is
    begins[3:, 3:d] = np.eye(d - 3)
    for part, triangle in zip(problem.parts, sessions, strict=True):
        between = joints[part.turns if process is None else part.rests]
        eliminate(rest[part.rests], between, _links(part, process), factor[part.rests], triangle, begins)
    return Told(weights=weight, process=process, whitened=(rest, turn), factor=factor, sessions=sessions)


def _links(part: SessionSpan, process: InRun | None) -> IntArray:
    """What joins each rest of a session to the next, −1 where nothing does: its turn, or the steps of the biases with
    it."""
    return part.link if process is None else np.append(np.arange(len(part.link) - 1), -1)


def joined(problem: Problem, rows: Rows, told: Told) -> Known:
    """What all sessions together say, with the priors of the rows."""
    q, triangle, heads = len(problem.own_known), rows.prior, []
    for session, residual in zip(told.sessions, rows.own, strict=True):
        wide = with_own(problem, session, residual)
        heads.append(wide[:q])
        fold(triangle, wide[q:, q:], triangular=True)
        triangle = wide[q:, q:]
    exact = int(triangle[0, 0] == 0.0)  # gravity, of which the step is zero then
    p = len(triangle) - 1
    parameters, root = np.zeros(p), np.zeros((p, p))
    root[exact:, exact:] = inverse_of(triangle[exact:p, exact:p])
    parameters[exact:] = root[exact:, exact:] @ triangle[exact:p, p]
    own, roots = zip(*(_put_back_own(head, parameters, root) for head in heads), strict=True)

    whitened = np.concatenate([each.diagonal(0, 1, 2).ravel() for each in (told.weights.rest, told.weights.turn)])
    pivots = np.concatenate([told.factor.diagonal(0, 1, 2).ravel(), *(h.diagonal() for h in (*heads, triangle[:-1]))])
    sizes = [problem.measured[1][1 + problem.instrument.linear_count :], np.tile(problem.own_known, len(heads))]
    logarithms = (np.log(each[each > 0.0]).sum() for each in (np.abs(pivots), np.concatenate(sizes)))
    steps = 0.0 if told.process is None else told.process.log_determinant
    square = float(triangle[-1, -1] ** 2)
    return Known(
        parameters=parameters,
        own=np.array(own),
        roots=np.array(roots),
        square=square,
        deviance=float(2.0 * (sum(logarithms) - np.log(whitened).sum()) + steps + square),
    )


def with_own(problem: Problem, session: Array, residual: Array) -> Array:
    """What a session says, a triangle, with the prior of what it has of its own, of whitened residual (q,)."""
    wide, q = session.copy(order="F"), len(residual)
    if q:
        prior = np.zeros((q, len(wide)))
        prior[:, :q], prior[:, -1] = np.diag(1.0 / problem.own_known), residual
        fold(prior, wide, triangular=True)
    return wide


def whitened_rows(problem: Problem, rows: Rows, weight: Weights, process: InRun | None) -> tuple[Array, Array]:
    """The whitened rows of the rests and of the turns, as the elimination has them: after the unknowns of the rests
    what a session has of its own, then gravity and the common parameters."""
    rest = _own_first(problem, weight.rest @ rows.rest, 3)
    turn = _own_first(problem, weight.turn @ rows.turn, 6)
    if process is None:
        return rest, turn
    n, (N, r, c), (K, t, k) = len(process.sigma), rest.shape, turn.shape
    wide, wide_turn = np.empty((N, r, c + n)), np.empty((K, t, k + 2 * n))
    wide[:, :, :3], wide[:, :, 3 + n :] = rest[:, :, :3], rest[:, :, 3:]
    wide[:, :, 3 : 3 + n] = weight.rest[:, :, :n] * process.sigma
    wide_turn[:, :, :3], wide_turn[:, :, 3 + n : 6 + n] = turn[:, :, :3], turn[:, :, 3:6]
    wide_turn[:, :, 6 + 2 * n :] = turn[:, :, 6:]
    by_state = weight.turn @ rows.bias * process.sigma
    wide_turn[:, :, 3 : 3 + n] = (1.0 - problem.bias_after) * by_state
    wide_turn[:, :, 6 + n : 6 + 2 * n] = problem.bias_after * by_state
    return wide, wide_turn


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


def inverse_of(triangle: Array) -> Array:
    """The inverse of an upper triangle. Raises LinAlgError where it has none."""
    inverse, singular = lapack.dtrtri(triangle)
    if singular:
        raise np.linalg.LinAlgError("Singular matrix")
    return np.asarray(inverse)


def left(problem: Problem, step: Step) -> Left:
    """What a step leaves of the residuals. With A the columns of the unknowns of a rest, or of two, of covariance S for
    given others, and E what the others, of covariance U Uᵀ, do to a row directly and by these, the covariance is

        1 − A S Aᵀ − (E U)(E U)ᵀ"""
    told, S = step.told, step.given
    rest, turn = told.whitened
    out = [(np.empty(rows.shape[:2]), np.empty((*rows.shape[:2], rows.shape[1]))) for rows in (rest, turn)]
    for s, part in enumerate(problem.parts):
        i, others = part.rests.start + part.first, np.concatenate([step.own[s], step.parameters, [-1.0]])
        both = np.concatenate([
            np.concatenate([S[0, i], S[1, i]], axis=2),
            np.concatenate([np.swapaxes(S[1, i], 1, 2), S[0, i + 1]], axis=2),
        ], axis=1)  # fmt: skip
        for rows, first, own, (residual, covariance), where in (
            (rest[part.rests], part.rests, S[0, part.rests], out[0], part.rests),
            (turn[part.turns], i, both, out[1], part.turns),
        ):
            A, E = rows[:, :, : own.shape[1]], told.given_unknowns(rows, first)
            flat = E.reshape(-1, len(others))
            residual[where] = -(flat @ others).reshape(E.shape[:2])
            EU = (flat[:, :-1] @ step.roots[s]).reshape(*E.shape[:2], len(others) - 1)
            covariance[where] = np.eye(A.shape[1]) - A @ own @ np.swapaxes(A, 1, 2) - EU @ np.swapaxes(EU, 1, 2)
    return Left(rest=out[0], turn=out[1])


def scatter_score(noise: Noise, step: Step, after: Left) -> tuple[Array, Array, Array]:
    """The score (c,) of the restricted likelihood by the variances of the components of scatter, its information
    (c, c), of which the part within a rest and within a turn is taken,

        ½ (|Zᵀr|² − tr ZᵀCZ),   ½ Σ (ZᵀCZ)²

    with r and C what is left of whitened residuals and Z whitened directions, and the score by the variance of the
    scatter of every sensor at rest (n,), in parts of that of its kind. Raises LinAlgError where residuals are beyond
    all measure."""
    weights, slope, by_sensor = step.told.weights, np.zeros(len(SCATTER)), np.zeros(0)
    information = np.zeros((len(SCATTER),) * 2)
    for W, (r, C), (Z, of) in (
        (weights.turn, after.turn, noise.turn_directions),
        (weights.rest, after.rest, noise.at_rest(weights.components)),
    ):
        WZ, kind = W @ Z, np.eye(len(SCATTER))[of]
        seen = np.swapaxes(WZ, 1, 2) @ C @ WZ
        by_sensor = 0.5 * ((r[:, None] @ WZ)[:, 0] ** 2 - np.diagonal(seen, axis1=1, axis2=2)).sum(axis=0)
        slope += by_sensor @ kind
        information += 0.5 * kind.T @ (seen**2).sum(axis=0) @ kind
    if not (np.isfinite(slope).all() and np.isfinite(information).all()):
        raise np.linalg.LinAlgError("residuals are beyond all measure")
    return slope, information, by_sensor
