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

Components of variance and sizes of priors may be a stack of several, for which all is done at once: then every array
that depends on them has further axes before those that are stated.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from tumble.inference.elimination import along_chains, eliminate, fold, given_parameters, given_unknowns, put_back
from tumble.inference.in_run import InRun
from tumble.inference.likelihood import Problem, Rows, SessionSpan
from tumble.inference.noise_components import SCATTER, Noise, Weights
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
    square: Array
    deviance: Array

    @property
    def others(self) -> Array:
        """Of each session what it has of its own, gravity and the parameters, and −1 (S, q + 1 + m + 1)."""
        common = np.broadcast_to(self.parameters[..., None, :], (*self.own.shape[:-1], self.parameters.shape[-1]))
        return np.concatenate([self.own, common, np.full((*self.own.shape[:-1], 1), -1.0)], axis=-1)


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
        return self.unknowns[..., :3]

    def along(self, unknowns: slice) -> Array:
        """How unknowns of the rests (N, k, p) go with what the others are uncertain by, a root of their covariance."""
        by = self.told.solved[2][..., unknowns, :-1]
        return np.concatenate(
            [times(by[..., own, :, :], self.roots[..., s, :, :]) for s, own in enumerate(self.rests)], axis=-3
        )

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
    q, rests = len(problem.own_usual), tuple(part.rests for part in problem.parts)
    own_covariance = known.roots @ np.swapaxes(known.roots, -1, -2)
    inverse, by_next, by = told.solved
    others = np.moveaxis(known.others, -2, 0)[..., None, :, None]
    unknowns = [(by[..., own, :, :] @ x)[..., 0] for own, x in zip(rests, others, strict=True)]
    return Step(
        parameters=known.parameters,
        own=known.own,
        roots=known.roots,
        square=known.square,
        deviance=known.deviance,
        covariance=own_covariance[..., 0, q:, q:],
        own_covariance=own_covariance,
        unknowns=np.concatenate(unknowns, axis=-2),
        told=told,
        given=given_parameters(inverse, by_next),
        rests=rests,
    )


def tell(problem: Problem, rows: Rows, weight: Weights) -> Told:
    """What the rows of every session say by themselves."""
    process = InRun.of(problem, weight.components) if weight.components.wanders else None
    rest, turn = whitened_rows(problem, rows, weight, process)
    *stack, N, _, width = rest.shape
    d = 3 if process is None else 3 + problem.sensors
    factor, size = np.empty((*stack, N, d, d + width)), width - d
    sessions = np.swapaxes(np.zeros((*stack, len(problem.parts), size, size)), -1, -2)
    joints = turn if process is None else joining(problem, turn, process)
    begins = np.zeros((d, d + width))  # a chain of states begins as its process is
    begins[3:, 3:d] = np.eye(d - 3)
    for at in np.ndindex(*stack):
        for part, triangle in zip(problem.parts, sessions[at], strict=True):
            between = joints[at][part.turns if process is None else part.rests]
            eliminate(rest[at][part.rests], between, _links(part, process), factor[at][part.rests], triangle, begins)
    return Told(weights=weight, process=process, whitened=(rest, turn), factor=factor, sessions=sessions)


def joining(problem: Problem, turn: Array, process: InRun | None) -> Array:
    """The rows (N, t + n, 2d + p + 1) that join each rest to the next: those of its `turn`, zero where it has none, and
    the steps of the n states of the biases."""
    *stack, _, t, width = turn.shape
    n = 0 if process is None else problem.sensors
    joints = np.zeros((*stack, len(problem.link), t + n, width))
    joints[..., problem.before_turn, :t, :] = turn
    if process is not None:
        process.write_steps(joints[..., t:, :], 3 + n)
    return joints


def _links(part: SessionSpan, process: InRun | None) -> IntArray:
    """What joins each rest of a session to the next, −1 where nothing does: its turn, or the steps of the biases with
    it."""
    return part.link if process is None else np.append(np.arange(len(part.link) - 1), -1)


def joined(problem: Problem, rows: Rows, told: Told) -> Known:
    """What all sessions together say, with the priors of the rows."""
    q, S, p, u = len(problem.own_usual), len(problem.parts), rows.prior.shape[-1] - 1, problem.measured[1]
    stack = np.broadcast_shapes(rows.prior.shape[:-2], told.sessions.shape[:-3])
    sessions = np.broadcast_to(told.sessions, (*stack, S, q + p + 1, q + p + 1))
    prior = np.broadcast_to(rows.prior, (*stack, p + 1, p + 1))
    own_known, residuals = (
        np.broadcast_to(x, (*stack, *x.shape[-n:])) for x, n in ((problem.own_known, 1), (rows.own, 2))
    )
    parameters, own = np.zeros((*stack, p)), np.zeros((*stack, S, q))
    roots, pivots, square = np.zeros((*stack, S, q + p, q + p)), np.empty((*stack, S * q + p)), np.empty(stack)
    for at in np.ndindex(*stack):
        triangle, heads = prior[at], []
        for session, residual in zip(sessions[at], residuals[at], strict=True):
            wide = with_own(own_known[at], session, residual)
            heads.append(wide[:q])
            fold(triangle, wide[q:, q:], triangular=True)
            triangle = wide[q:, q:]
        exact = int(triangle[0, 0] == 0.0)  # gravity, of which the step is zero then
        root = np.zeros((p, p))
        root[exact:, exact:] = inverse_of(triangle[exact:p, exact:p])
        parameters[at][exact:] = root[exact:, exact:] @ triangle[exact:p, p]
        for s, head in enumerate(heads):
            own[at][s], roots[at][s] = _put_back_own(head, parameters[at], root)
        pivots[at], square[at] = np.concatenate([h.diagonal() for h in (*heads, triangle[:p])]), triangle[p, p] ** 2

    whitened = sum(np.log(W.diagonal(0, -2, -1)).sum(axis=(-2, -1)) for W in (told.weights.rest, told.weights.turn))
    of_rests = _logarithms(told.factor.diagonal(0, -2, -1)).sum(axis=-1)
    sizes = _logarithms(u[..., 1 + problem.instrument.linear_count :]) + S * _logarithms(problem.own_known)
    steps = 0.0 if told.process is None else told.process.log_determinant
    deviance = 2.0 * (of_rests + _logarithms(pivots) + sizes - whitened) + steps + square
    return Known(parameters=parameters, own=own, roots=roots, square=square, deviance=deviance)


def _logarithms(values: Array) -> Array:
    """The sum of the logarithms (…) of values (…, n) that are not zero."""
    size = np.abs(values)
    return np.asarray(np.log(np.where(size > 0.0, size, 1.0)).sum(axis=-1))


def with_own(known: Array, session: Array, residual: Array) -> Array:
    """What a session says, a triangle, with the prior of what it has of its own, of standard deviations `known` and
    whitened residual (q,)."""
    wide, q = session.copy(order="F"), len(residual)
    if q:
        prior = np.zeros((q, len(wide)))
        prior[:, :q], prior[:, -1] = np.diag(1.0 / known), residual
        fold(prior, wide, triangular=True)
    return wide


def whitened_rows(problem: Problem, rows: Rows, weight: Weights, process: InRun | None) -> tuple[Array, Array]:
    """The whitened rows of the rests and of the turns, as the elimination has them: after the unknowns of the rests
    what a session has of its own, then gravity and the common parameters."""
    n, q = 0 if process is None else problem.sensors, len(problem.own_usual)

    def whitened(W: Array, *columns: Array) -> Array:
        last = columns[-1].shape[2] - 1 - q
        others = columns[-1][:, :, last:-1], columns[-1][:, :, :last], columns[-1][:, :, -1:]
        return np.asarray(W @ np.concatenate([*columns[:-1], *others], axis=2))

    states = np.broadcast_to(np.eye(rows.rest.shape[1], n), (*rows.rest.shape[:2], n))
    here, after = (share * rows.bias[:, :, :n] for share in (1.0 - problem.bias_after, problem.bias_after))
    rest = whitened(weight.rest, rows.rest[:, :, :3], states, rows.rest[:, :, 3:])
    turn = whitened(weight.turn, rows.turn[:, :, :3], here, rows.turn[:, :, 3:6], after, rows.turn[:, :, 6:])
    if process is not None:
        for of_states in (rest[..., 3 : 3 + n], turn[..., 3 : 3 + n], turn[..., 6 + n : 6 + 2 * n]):
            of_states *= process.sigma[..., None, None, :]
    return rest, turn


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
    inverse, singular = scipy.linalg.lapack.dtrtri(triangle)
    if singular:
        raise np.linalg.LinAlgError("Singular matrix")
    return np.asarray(inverse)


def left(problem: Problem, step: Step) -> Left:
    """What a step leaves of the residuals. With A the columns of the unknowns of a rest, or of two, of covariance S for
    given others, and E what the others, of covariance U Uᵀ, do to a row directly and by these, the covariance is

        1 − A S Aᵀ − (E U)(E U)ᵀ"""
    (own, with_next), i = np.moveaxis(step.given, -4, 0), problem.before_turn
    across, out = with_next[..., i, :, :], list[tuple[Array, Array]]()
    upper = np.concatenate([own[..., i, :, :], across], axis=-1)
    lower = np.concatenate([np.swapaxes(across, -1, -2), own[..., i + 1, :, :]], axis=-1)
    both, places = (
        np.concatenate([upper, lower], axis=-2),
        ([p.rests for p in problem.parts], [p.turns for p in problem.parts]),
    )
    for rows, S, E, parts in zip(step.told.whitened, (own, both), by_others(problem, step.told), places, strict=True):
        A = rows[..., : S.shape[-1]]
        residual, EU = np.empty(E.shape[:-1]), np.empty((*E.shape[:-1], E.shape[-1] - 1))
        for s, part in enumerate(parts):
            residual[..., part, :] = -times(E[..., part, :, :], step.others[..., s, :, None])[..., 0]
            EU[..., part, :, :] = times(E[..., part, :, :-1], step.roots[..., s, :, :])
        fitted = A @ S @ np.swapaxes(A, -1, -2) + EU @ np.swapaxes(EU, -1, -2)
        out.append((residual, np.eye(fitted.shape[-1]) - fitted))
    return Left(rest=out[0], turn=out[1])


def by_others(problem: Problem, told: Told) -> tuple[Array, Array]:
    """The whitened rows of rests and of turns with the unknowns of the rests as they follow from all others: [what
    these do | residual where they are zero] (N, r, p + 1) and (K, t, p + 1)."""
    (rest, turn), by = told.whitened, told.solved[2]
    return given_unknowns(rest, by, np.arange(len(problem.link))), given_unknowns(turn, by, problem.before_turn)


def times(rows: Array, matrix: Array) -> Array:
    """Rows (…, K, t, p) times a matrix (…, p, y), in one product."""
    flat = rows.reshape(*rows.shape[:-3], -1, rows.shape[-1])
    return np.asarray(flat @ matrix).reshape(*rows.shape[:-1], matrix.shape[-1])


def scatter_score(noise: Noise, step: Step, after: Left) -> tuple[Array, Array, Array]:
    """The score (c,) of the restricted likelihood by the variances of the components of scatter, its information
    (c, c), of which the part within a rest and within a turn is taken,

        ½ (|Zᵀr|² − tr ZᵀCZ),   ½ Σ (ZᵀCZ)²

    with r and C what is left of whitened residuals and Z whitened directions, and the score by the variance of the
    scatter of every sensor at rest (n,), in parts of that of its kind. Raises LinAlgError where residuals are beyond
    all measure."""
    weights, kinds = step.told.weights, np.eye(len(SCATTER))
    slope, information, by_sensor = np.zeros(len(SCATTER)), np.zeros((len(SCATTER),) * 2), np.zeros(0)
    for W, (r, C), (Z, of) in (
        (weights.turn, after.turn, noise.turn_directions),
        (weights.rest, after.rest, noise.at_rest(weights.components)),
    ):
        WZ, kind = W @ Z, kinds[of]
        seen = np.swapaxes(WZ, -1, -2) @ C @ WZ
        square = (r[..., None, :] @ WZ)[..., 0, :] ** 2
        by_sensor = 0.5 * (square - np.diagonal(seen, axis1=-2, axis2=-1)).sum(axis=-2)
        slope = slope + by_sensor @ kind
        information = information + 0.5 * kind.T @ (seen**2).sum(axis=-3) @ kind
    if not (np.isfinite(slope).all() and np.isfinite(information).all()):
        raise np.linalg.LinAlgError("residuals are beyond all measure")
    return slope, information, by_sensor


def in_run_scores(process: InRun, step: Step) -> tuple[Array, Array, Array]:
    """∂ℓ/∂ ln σ and ∂ℓ/∂ ln τ of every sensor (n,), each for itself, and how many independent values the data say
    of its states."""
    states, follows = slice(-process.sigma.shape[-1], None), process.follows
    first = np.append(True, ~follows[:-1])
    here, following = np.flatnonzero(follows), np.flatnonzero(follows) + 1
    b, root = step.unknowns[..., states], step.along(states)
    own, with_next = np.moveaxis(np.diagonal(step.given, axis1=-2, axis2=-1)[..., states], -3, 0)
    variance = own + (root**2).sum(axis=-1)
    with_next = with_next[..., here, :] + (root[..., here, :, :] * root[..., following, :, :]).sum(axis=-1)
    rho, square = process.rho[..., here, :], process.deviation[..., here, :] ** 2
    moment = b**2 + variance
    before, after, begins = moment[..., here, :], moment[..., following, :], moment[..., first, :]
    across = b[..., here, :] * b[..., following, :] + with_next
    e2 = (after - 2.0 * rho * across + rho**2 * before) / square
    by_size = (e2 - 1.0).sum(axis=-2) + (begins - 1.0).sum(axis=-2)
    passed = process.passed[..., here, :]
    growth = np.where(np.isfinite(passed), passed, 0.0) * rho
    by_time = (growth * ((across - rho * before) + rho * (1.0 - e2)) / square).sum(axis=-2)
    unknown = (variance[..., following, :] - 2.0 * rho * with_next + rho**2 * variance[..., here, :]) / square
    told = sum((1.0 - np.clip(each, 0.0, 1.0)).sum(axis=-2) for each in (unknown, variance[..., first, :]))
    return by_size, by_time, np.asarray(told)


def mean_along(told: Told) -> tuple[Array, Array]:
    """The mean over the rests of a session of its in-run biases: what it changes with x, what the session has of its
    own, gravity and the common parameters, and its value where x is zero, turned round (n, q + 1 + m + 1); and what it
    changes with the noise e of every rest (N, n, d), followed along the chain of unknowns u_i = A_i u_{i+1} + B_i x +
    a_i + R_i⁻¹ e_i from the first."""
    (inverse, by_next, by), process = told.solved, told.process
    assert process is not None
    (*stack, N, d, _), n = inverse.shape, process.sigma.shape[-1]
    carried, back = np.zeros((*stack, N, d, n)), np.zeros((*stack, N, d, d))  # transposed, from the last rest on
    carried[..., d - n :, :] = process.sigma[..., None, None, :] * np.eye(n) / N
    back[..., :-1, :, :] = np.swapaxes(by_next[..., -2::-1, :, :], -1, -2)
    along_chains(back, carried)
    of_rests = np.swapaxes(carried[..., ::-1, :, :], -1, -2) @ inverse
    return process.sigma[..., None] * by[..., d - n :, :].mean(axis=-3), of_rests
