"""Least squares of a linearised likelihood in square-root form, its restricted likelihood, and what it leaves of
residuals: docs/explanation/mathematics.md, sections 7 and 8.

    whiten              rows times Σ^{−½}; the steps of the in-run biases are rows of covariance 1
    eliminate_rests     angles and states of biases of every rest eliminated: of each session a triangle is left
    add_priors          priors folded into these triangles; gravity and the parameters solved for
    back_substitute     the unknowns of the rests, given all others

With V the covariance of all rows, P₀ the precision of the priors and R every triangle of the elimination,

    −2 ln L = rᵀV⁻¹r + x̂ᵀP₀x̂ + ln |V| − ln |P₀| + 2 Σ ln |diag R|                      (restricted likelihood, 23)

every determinant a sum of logarithms of diagonals that are there.

Components of variance and sizes of priors may be a stack of several, for which all is done at once: then every array
that depends on them has further axes before those that are stated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product

import numpy as np
import scipy

from tumble.inference.elimination import along_chains, eliminate, fold, given_parameters, put_back
from tumble.inference.elimination_kernels import residuals
from tumble.inference.linearisation import Linearisation
from tumble.inference.noise import NoiseModel, VarianceComponents
from tumble.inference.problem import Problem, SessionSpan
from tumble.units import Array, IntArray


@dataclass(frozen=True, kw_only=True, eq=False)
class NormalEquations:
    """Square-root information of one linearisation, before priors.

    Parameters
    ----------
    noise
        The noise by which rows are whitened.
    rest_whitening, turn_whitening, link_whitening : (N, r, r), (K, t, t) and (J, 9, 9)
        Σ^{−½} of the rows of rests, turns and links.
    rest_rows, turn_rows, link_rows : (N, r, d + w), (K, t, 2 d + w) and (J, 9, 2 d + w)
        Whitened rows: the d unknowns of a rest, or of both stations of a turn or a link, then the w − 1 that are left,
        what the session has beside, gravity and the parameters, and the right-hand side.
    rest_factors : (M, d, 2 d + w)
        Triangular factors by which the unknowns of each station are back-substituted.
    session_factors : (S, w, w)
        Of each session a triangle of what is left when its rests are eliminated.
    """

    noise: NoiseModel
    rest_whitening: Array
    turn_whitening: Array
    link_whitening: Array
    rest_rows: Array
    turn_rows: Array
    link_rows: Array
    rest_factors: Array
    session_factors: Array

    @property
    def unknowns(self) -> int:
        """d, the unknowns of a station (`tumble.inference.noise.NoiseModel.unknowns`)."""
        return int(self.rest_factors.shape[-2])

    @property
    def wanders(self) -> bool:
        """Whether states of biases are among the unknowns of the rests."""
        return self.noise.components.wanders

    @cached_property
    def inverses(self) -> tuple[Array, Array]:
        """R⁻¹ and A of the rests (`tumble.inference.elimination.put_back`)."""
        return put_back(self.rest_factors)

    @cached_property
    def follow(self) -> Array:
        """How the unknowns of the rests follow from what is left, along the chain: [∂δ/∂x | −δ at x = 0] (M, d, w)."""
        inverse, by_next = self.inverses
        out = -(inverse @ self.rest_factors[..., 2 * self.unknowns :])
        along_chains(by_next, out)
        return out


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """The least-squares solution of a linearised likelihood with priors.

    Parameters
    ----------
    linearisation
        The rows, with the problem whose priors are in the solution.
    equations
        The normal equations it solves.
    parameters : (1 + m,)
        The step of gravity and the parameters.
    local : (S, q)
        The step of what each session has beside.
    roots : (S, q + 1 + m, q + 1 + m)
        Of each session a triangle U of the covariance U Uᵀ of what it has beside, gravity and the parameters.
    square
        The sum of squares that is left, priors included.
    deviance
        −2 ln of the restricted likelihood, less its constant.
    phi, of_prior
        The hyperparameters (D,) it is at, and of each the logarithm of its prior density less a constant, its
        derivative, and the curvature of its negative (3, D); empty where components of variance were given.
    """

    linearisation: Linearisation
    equations: NormalEquations
    parameters: Array
    local: Array
    roots: Array
    square: Array
    deviance: Array
    phi: Array = field(default_factory=lambda: np.zeros(0))
    of_prior: Array = field(default_factory=lambda: np.zeros((3, 0)))

    @property
    def problem(self) -> Problem:
        """The problem, with its priors."""
        return self.linearisation.problem

    @property
    def components(self) -> VarianceComponents:
        """The components of variance."""
        return self.equations.noise.components

    @property
    def log_posterior(self) -> Array:
        """ℓ(φ) (23)."""
        return np.asarray(self.of_prior[0].sum(axis=-1) - 0.5 * self.deviance)

    @cached_property
    def shared(self) -> Array:
        """Of each session what it has beside, gravity and the parameters, and −1 (S, q + 1 + m + 1)."""
        q = self.local.shape[-1]
        out = np.full((*self.local.shape[:-1], q + self.parameters.shape[-1] + 1), -1.0)
        out[..., :q], out[..., q:-1] = self.local, self.parameters[..., None, :]
        return out

    @cached_property
    def session_covariances(self) -> Array:
        """Of each session the covariance (S, q + 1 + m, q + 1 + m) of what it has beside, gravity and the
        parameters."""
        return np.asarray(self.roots @ np.swapaxes(self.roots, -1, -2))

    @property
    def covariance(self) -> Array:
        """The covariance (1 + m, 1 + m) of gravity and the parameters."""
        q = self.local.shape[-1]
        return np.asarray(self.session_covariances[..., 0, q:, q:])

    @cached_property
    def unknowns(self) -> Array:
        """The unknowns (M, d) of the stations, by back substitution: angles, velocities where they move, states."""
        follow, parts = self.equations.follow, enumerate(self.problem.parts)
        every = (follow[..., part.stations, :, :] @ self.shared[..., s, None, :, None] for s, part in parts)
        return np.concatenate([each[..., 0] for each in every], axis=-2)

    @property
    def angles(self) -> Array:
        """The step of the angles (M, 3) of the attitudes."""
        return self.unknowns[..., :3]

    @property
    def states(self) -> Array:
        """The states (M, s): of in-run biases, and of displacements, in units of their sizes."""
        return self.unknowns[..., self.equations.unknowns - self.equations.noise.states :]

    @cached_property
    def conditional_covariances(self) -> Array:
        """Covariances of the unknowns of the rests given all others, with themselves and with those of the next rest
        (2, N, d, d)."""
        return given_parameters(*self.equations.inverses)

    def along(self, unknowns: slice) -> Array:
        """How unknowns of the rests (N, k, p) go with what the others are uncertain by, a root of their covariance."""
        follow = self.equations.follow[..., unknowns, :-1]
        parts = enumerate(self.problem.parts)
        return np.concatenate(
            [times(follow[..., part.stations, :, :], self.roots[..., s, :, :]) for s, part in parts], axis=-3
        )

    def covariances(self, unknowns: slice) -> Array:
        """Covariances of unknowns of the rests with themselves and those of the next (2, N, k, k)."""
        root, out = self.along(unknowns), self.conditional_covariances[:, :, unknowns, unknowns].copy()
        out[0] += root @ np.swapaxes(root, 1, 2)
        out[1, :-1] += root[:-1] @ np.swapaxes(root[1:], 1, 2)
        return out

    @property
    def by_kind(self) -> Iterator[tuple[Array, tuple[Array, Array], tuple[Array, IntArray]]]:
        """Of rests, turns and links Σ^{−½}, residuals with covariances, and directions of scatter with their places in
        SCATTER."""
        equations = self.equations
        whitening = equations.rest_whitening, equations.turn_whitening, equations.link_whitening
        residuals = self.rest_residuals, self.turn_residuals, self.link_residuals
        return zip(whitening, residuals, equations.noise.weighted_directions, strict=True)

    @cached_property
    def rest_residuals(self) -> tuple[Array, Array]:
        """Whitened residuals (N, r) of the rests, and their covariances (N, r, r), 1 where the fit has no part in
        them."""
        return self._residuals[0]

    @cached_property
    def turn_residuals(self) -> tuple[Array, Array]:
        """The same (K, t) and (K, t, t) of the turns."""
        return self._residuals[1]

    @cached_property
    def link_residuals(self) -> tuple[Array, Array]:
        """The same (J, 9) and (J, 9, 9) of the links."""
        return self._residuals[2]

    @cached_property
    def _residuals(self) -> list[tuple[Array, Array]]:
        """Of rests, turns and links. With A the columns of the unknowns of a rest, or of two, of covariance S for given
        others, and E what the others, of covariance U Uᵀ, do to a row directly and by these, the covariance is

            1 − A S Aᵀ − (E U)(E U)ᵀ"""
        problem, equations, out = self.problem, self.equations, list[tuple[Array, Array]]()
        (own, with_next), follow = self.conditional_covariances, equations.follow
        kinds = (
            (equations.rest_rows, problem.station, [part.rests for part in problem.parts]),
            (equations.turn_rows, problem.before_turn, [part.turns for part in problem.parts]),
            (equations.link_rows, problem.before_link, [slice(None)] * problem.moves),
        )
        for rows, before, parts in kinds:
            (K, t, columns), width = rows.shape, follow.shape[-1]
            residual, covariance, work = np.zeros((K, t)), np.zeros((K, t, t)), np.empty((t, columns + width))
            for part, root, shared in zip(parts, self.roots, self.shared, strict=False):
                here = rows[part], before[part], follow, own, with_next
                residuals(*here, root, shared, residual[part], covariance[part], work)
            out.append((residual, covariance))
        return out


def solve(linearisation: Linearisation, components: VarianceComponents | None = None) -> Solution:
    """The least-squares solution of a linearised likelihood, at its components of variance or at others."""
    if components is not None:
        linearisation = linearisation.with_components(components)
    return add_priors(linearisation, eliminate_rests(linearisation))


def eliminate_rests(linearisation: Linearisation) -> NormalEquations:
    """The normal equations of every session, the unknowns of its rests eliminated (22)."""
    problem, noise = linearisation.problem, linearisation.noise
    whitening = noise.whitening()
    rest, turn, link = whiten(linearisation, *whitening)
    d, states = noise.unknowns, noise.states
    *stack, _, _, width = rest.shape
    factors, size = np.empty((*stack, len(problem.link), d, d + width)), width - d
    triangles = np.swapaxes(np.zeros((*stack, len(problem.parts), size, size)), -1, -2)
    at_stations = station_rows(problem, rest)
    joints = joint_rows(linearisation, turn, link) if states else turn
    begins = np.zeros((d, d + width))  # a chain of states begins as its process is
    begins[d - states :, d - states : d] = np.eye(states)
    for at in product(*map(range, stack)):
        for part, triangle in zip(problem.parts, triangles[at], strict=True):
            between, links = (
                joints[at][part.stations if states else part.turns],
                session_links(part, chained=states > 0),
            )
            eliminate(at_stations[at][part.stations], between, links, factors[at][part.stations], triangle, begins)
    return NormalEquations(
        noise=noise,
        rest_whitening=whitening[0],
        turn_whitening=whitening[1],
        link_whitening=whitening[2],
        rest_rows=rest,
        turn_rows=turn,
        link_rows=link,
        rest_factors=factors,
        session_factors=triangles,
    )


def whiten(
    linearisation: Linearisation, rest_whitening: Array, turn_whitening: Array, link_whitening: Array
) -> tuple[Array, Array, Array]:
    """The whitened rows of rests, turns and links as the elimination has them: after the unknowns of the stations what
    a session has beside, then gravity and the common parameters."""
    problem, noise, s = linearisation.problem, linearisation.noise, linearisation.noise.states
    n, d = sum(noise.sensors), noise.unknowns - noise.states
    rows = linearisation.ordered
    if noise.biases == 0:  # without their columns
        one, both = np.arange(d, d + n), np.r_[d : d + n, 2 * d + n + s : 2 * (d + n) + s]
        rows = np.delete(rows[0], one, axis=2), np.delete(rows[1], both, axis=2), np.delete(rows[2], both, axis=2)
    rest, turn, link = (W @ x for W, x in zip((rest_whitening, turn_whitening, link_whitening), rows, strict=True))
    if s:
        d, sigma = noise.unknowns, noise.state_sigma[..., None, None, :]
        rest[..., d - s : d] *= sigma
        for joint in (turn, link) if problem.moves else (turn,):
            joint[..., d - s : d] *= sigma
            joint[..., 2 * d - s : 2 * d] *= sigma
    return rest, turn, link


def station_rows(problem: Problem, rest: Array) -> Array:
    """The rows of the rests (N, r, ·) at their stations (M, r, ·), zero at nodes; none (M, 0, ·) without rests."""
    if not problem.moves:
        return rest
    rest = rest if len(problem.station) else rest[..., :0, :]
    out = np.zeros((*rest.shape[:-3], len(problem.link), *rest.shape[-2:]))
    out[..., problem.station, :, :] = rest
    return out


def joint_rows(linearisation: Linearisation, turn: Array, link: Array) -> Array:
    """The rows (M, t + 9 + s, 2 d + w) that join each station to the next: those of its `turn` (K, t, 2 d + w) or of
    its `link` (J, 9, 2 d + w), zero where it has none, and the steps of the s states (19)."""
    problem, noise = linearisation.problem, linearisation.noise
    s, d = noise.states, noise.unknowns
    turn = turn if len(problem.before_turn) else turn[..., :0, :]
    *stack, _, t, width = turn.shape
    k = link.shape[-2] if problem.moves else 0
    joints = np.zeros((*stack, len(problem.link), t + k + s, width))
    joints[..., problem.before_turn, :t, :] = turn
    if problem.moves:
        joints[..., problem.before_link, t : t + k, :] = link
    if s == 0:
        return joints
    state, here, step = np.arange(s), np.flatnonzero(noise.follows)[:, None], noise.state_step[..., noise.follows, :]
    joints[..., here, t + k + state, d - s + state] = -noise.state_rho[..., noise.follows, :] / step
    joints[..., here, t + k + state, 2 * d - s + state] = 1.0 / step
    return joints


def session_links(part: SessionSpan, *, chained: bool) -> IntArray:
    """What joins each station of a session to the next, −1 where nothing does: its turn, or what is `chained`."""
    return np.append(np.arange(len(part.link) - 1), -1) if chained else part.link


def add_priors(linearisation: Linearisation, equations: NormalEquations, **at_phi: Array) -> Solution:
    """The solution of normal equations with the priors of a linearisation, those of single sessions folded in first,
    what these have beside eliminated, and then the common ones; `at_phi` are the fields of hyperparameters."""
    problem = linearisation.problem
    q, S, p = len(problem.usual_local_u), len(problem.parts), linearisation.prior.shape[-1] - 1
    stack = max(linearisation.prior.shape[:-2], equations.session_factors.shape[:-3], key=len)

    def stacked(x: Array, axes: int) -> Array:
        return np.broadcast_to(x, (*stack, *x.shape[x.ndim - axes :])) if stack else x

    factors, prior = stacked(equations.session_factors, 3), stacked(linearisation.prior, 2)
    local_u, residuals = stacked(problem.local_u, 1), stacked(linearisation.local_prior, 2)
    further_u = stacked(problem.prior_u[..., 1 + problem.instrument.linear_count :], 1)
    parameters, local, roots = np.zeros((*stack, p)), np.zeros((*stack, S, q)), np.zeros((*stack, S, q + p, q + p))
    diagonals, square = np.empty((*stack, 2 * S * q + p + further_u.shape[-1])), np.empty(stack)
    for at in product(*map(range, stack)):
        triangle, heads = fold_sessions(prior[at], factors[at], local_u[at], residuals[at])
        exact = int(triangle[0, 0] == 0.0)  # gravity, of which the step is zero then
        root = np.zeros((p, p))
        root[exact:, exact:] = inverse_of(triangle[exact:p, exact:p])
        parameters[at][exact:] = root[exact:, exact:] @ triangle[exact:p, p]
        for s, head in enumerate(heads):
            local[at][s], roots[at][s] = _local_solution(head, parameters[at], root)
        pivots = [rows.diagonal() for rows in (*heads, triangle[:p])]
        np.concatenate([*pivots, further_u[at], *(S * [local_u[at]])], out=diagonals[at])
        square[at] = triangle[p, p] ** 2
    deviance = 2.0 * _logarithms(diagonals) + rests_deviance(equations) + square
    return Solution(
        linearisation=linearisation,
        equations=equations,
        parameters=parameters,
        local=local,
        roots=roots,
        square=square,
        deviance=deviance,
        **at_phi,
    )


def fold_sessions(prior: Array, factors: Array, local_u: Array, residuals: Array) -> tuple[Array, list[Array]]:
    """The triangle (p + 1, p + 1) of the common parameters with their prior, and of each session the rows
    (q, q + p + 1) that give what it has beside."""
    triangle, heads, q = prior, list[Array](), len(local_u)
    for factor, residual in zip(factors, residuals, strict=True):
        wide = with_local_prior(local_u, factor, residual)
        heads.append(wide[:q])
        fold(triangle, wide[q:, q:], triangular=True)
        triangle = wide[q:, q:]
    return triangle, heads


def with_local_prior(local_u: Array, factor: Array, residual: Array) -> Array:
    """The triangle of a session with the prior of what it has beside, of standard deviations `local_u` and whitened
    residual (q,)."""
    wide, q = factor.copy(order="F"), len(residual)
    if q:
        prior = np.zeros((q, len(wide)))
        prior[:, :q], prior[:, -1] = np.diag(1.0 / local_u), residual
        fold(prior, wide, triangular=True)
    return wide


def _local_solution(head: Array, parameters: Array, root: Array) -> tuple[Array, Array]:
    """What a session has beside (q,), from the rows (q, q + p + 1) that give it once the parameters are known, and a
    root (q + p, q + p) of its covariance with them."""
    q = len(head)
    if q == 0:
        return np.zeros(0), root
    inverse, whole = inverse_of(head[:, :q]), np.zeros((q + len(root), q + len(root)))
    by_parameter = -inverse @ head[:, q:-1]
    whole[:q, :q], whole[:q, q:], whole[q:, q:] = inverse, by_parameter @ root, root
    return inverse @ head[:, -1] + by_parameter @ parameters, whole


def rests_deviance(equations: NormalEquations) -> Array:
    """ln |V| + 2 Σ ln |diag R| of the rows and of the unknowns of the rests."""
    noise, every = equations.noise, (equations.rest_whitening, equations.turn_whitening, equations.link_whitening)
    whitened = sum(np.log(W.diagonal(0, -2, -1)).sum(axis=(-2, -1)) for W in every)
    steps = np.log(noise.state_step[..., noise.follows, :]).sum(axis=(-2, -1)) if noise.states else 0.0
    return np.asarray(2.0 * (_logarithms(equations.rest_factors.diagonal(0, -2, -1)).sum(axis=-1) + steps - whitened))


def _logarithms(values: Array) -> Array:
    """The sum of the logarithms (…) of values (…, n) that are not zero."""
    size = np.abs(values)
    return np.asarray(np.log(np.where(size > 0.0, size, 1.0)).sum(axis=-1))


def inverse_of(triangle: Array) -> Array:
    """The inverse of an upper triangle. Raises LinAlgError where it has none."""
    inverse, singular = scipy.linalg.lapack.dtrtri(triangle)
    if singular:
        raise np.linalg.LinAlgError("Singular matrix")
    return np.asarray(inverse)


def times(rows: Array, matrix: Array) -> Array:
    """Rows (…, K, t, p) times a matrix (…, p, y), in one product."""
    flat = rows.reshape(*rows.shape[:-3], -1, rows.shape[-1])
    return np.asarray(flat @ matrix).reshape(*rows.shape[:-1], matrix.shape[-1])


def session_mean_bias(equations: NormalEquations) -> tuple[Array, Array]:
    """The mean over the rests of a session of its in-run biases (20).

    Returns
    -------
    by_shared : (n, q + 1 + m + 1)
        What it changes with what the session has beside, gravity and the common parameters, and its value where these
        are zero, with the sign turned round.
    by_noise : (N, n, d)
        What it changes with the noise e of every rest, followed along the chain of unknowns
        u_i = A_i u_{i+1} + B_i x + a_i + R_i⁻¹ e_i from the first.
    """
    inverse, by_next = equations.inverses
    n = equations.noise.biases
    sigma, first = equations.noise.state_sigma[..., :n], equations.unknowns - equations.noise.states
    biases, (*stack, N, d, _) = slice(first, first + n), inverse.shape
    carried, back = np.zeros((*stack, N, d, n)), np.zeros((*stack, N, d, d))  # transposed, from the last station on
    carried[..., biases, :] = sigma[..., None, None, :] * np.eye(n) / N
    back[..., :-1, :, :] = np.swapaxes(by_next[..., -2::-1, :, :], -1, -2)
    along_chains(back, carried)
    by_noise = np.swapaxes(carried[..., ::-1, :, :], -1, -2) @ inverse
    along, rows = np.swapaxes(by_noise, -3, -2).reshape(*stack, n, -1), equations.rest_factors[..., 2 * d :]
    return -(along @ rows.reshape(*stack, N * d, -1)), by_noise


def mean_by_common(by_shared: Array, head: Array) -> tuple[Array, Array]:
    """The mean over a session of its biases, what the session has beside following from the common parameters.

    Parameters
    ----------
    by_shared : (n, q + 1 + m + 1)
        What it changes with, as of `session_mean_bias`.
    head : (q, q + 1 + m + 1)
        The rows that give what the session has beside (`fold_sessions`).

    Returns
    -------
    by_common : (n, 1 + m + 1)
        What it changes with gravity and the common parameters, and its value where these are zero, with the sign turned
        round.
    by_local : (n, q)
        What it changes with the noise of what the session has beside.
    """
    q = len(head)
    if q == 0:
        return by_shared, by_shared[:, :0]
    by_local = by_shared[:, :q] @ inverse_of(head[:, :q])
    return by_shared[:, q:] - by_local @ head[:, q:], by_local
