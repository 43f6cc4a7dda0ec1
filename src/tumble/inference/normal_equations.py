"""Square-root least squares of a linearised likelihood, and its restricted likelihood.

Sections 7 and 8 of docs/explanation/mathematics.md. Whitened rows, Σ^{−½} times the Jacobians and residuals, are
reduced by orthogonal transformations. The unknowns of the rests are eliminated first, which leaves one triangle for
each session (`eliminate_rests`); the priors are folded into these triangles and gravity and the parameters are solved
for (`add_priors`); the unknowns of the rests follow by back-substitution (`Solution.unknowns`). With V the covariance
of all rows, P₀ the precision of the priors and R all triangles of the elimination,

    −2 ln L = rᵀV⁻¹r + x̂ᵀP₀x̂ + ln |V| − ln |P₀| + 2 Σ ln |diag R|                      (restricted likelihood, 23)

where each determinant is a sum of logarithms of a diagonal that the elimination computes.

Components of variance and prior sizes may be stacks, which are solved together; all arrays that depend on them then
have the axes of the stack before those stated below.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product

import numpy as np
import scipy

from tumble.inference.elimination import conditional_covariances, eliminate, fold, invert_factors, recur_backwards
from tumble.inference.elimination_kernels import reduced_rows, residual_covariances
from tumble.inference.linearisation import Linearisation
from tumble.inference.noise import STATIONS, NoiseModel, VarianceComponents
from tumble.inference.problem import Problem
from tumble.units import Array, IntArray


@dataclass(frozen=True, kw_only=True, eq=False)
class NormalEquations:
    """Square-root information of one linearisation, before priors.

    Parameters
    ----------
    noise
        Noise that whitens the rows.
    whitening : (K, r, r)
        Σ^{−½} by kind of rows.
    rows : (K, r, d + w) or (K, r, 2 d + w)
        Whitened rows by kind. Columns: the d unknowns of their station, or of both stations of a turn or a link; the
        w − 1 shared unknowns, namely the parameters of the session, gravity and the common parameters; the right-hand
        side.
    rest_factors : (M, d, 2 d + w)
        Triangular factors for the back-substitution of the unknowns of each station.
    session_factors : (S, w, w)
        Triangle of each session for the shared unknowns, after elimination of its rests.
    """

    noise: NoiseModel
    whitening: Mapping[str, Array]
    rows: Mapping[str, Array]
    rest_factors: Array
    session_factors: Array

    @property
    def unknowns(self) -> int:
        """Number d of unknowns of a station."""
        return int(self.rest_factors.shape[-2])

    @property
    def wanders(self) -> bool:
        """True if in-run biases are among the unknowns of the rests."""
        return self.noise.components.wanders

    @cached_property
    def inverses(self) -> tuple[Array, Array]:
        """R⁻¹ and A of `tumble.inference.elimination.invert_factors` (M, d, d)."""
        return invert_factors(self.rest_factors)

    @cached_property
    def sensitivity(self) -> Array:
        """Unknowns δ of the stations as functions of the shared unknowns x: [∂δ/∂x | −δ at x = 0] (M, d, w)."""
        inverse, by_next = self.inverses
        out = -(inverse @ self.rest_factors[..., 2 * self.unknowns :])
        recur_backwards(by_next, out)
        return out


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """Least-squares solution of a linearised likelihood with priors.

    Parameters
    ----------
    linearisation
        Linearisation, whose problem has the priors of the solution.
    equations
        Its normal equations.
    parameters : (1 + m,)
        Step of gravity and the common parameters.
    local : (S, q)
        Steps of the parameters of each session.
    roots : (S, q + 1 + m, q + 1 + m)
        For each session a triangle U of the covariance U Uᵀ of its parameters, gravity and the common parameters.
    square
        Sum of squared residuals, priors included.
    deviance
        −2 ln of the restricted likelihood, up to a constant.
    phi : (D,)
        Hyperparameters of the solution; empty if components of variance were given instead.
    prior_terms : (3, D)
        Logarithm of the prior density of each hyperparameter, up to a constant, its derivative, and minus its second
        derivative.
    """

    linearisation: Linearisation
    equations: NormalEquations
    parameters: Array
    local: Array
    roots: Array
    square: Array
    deviance: Array
    phi: Array = field(default_factory=lambda: np.zeros(0))
    prior_terms: Array = field(default_factory=lambda: np.zeros((3, 0)))

    @property
    def problem(self) -> Problem:
        """Problem with the priors of the solution."""
        return self.linearisation.problem

    @property
    def components(self) -> VarianceComponents:
        """Components of variance."""
        return self.equations.noise.components

    @property
    def log_posterior(self) -> Array:
        """ℓ(φ) (23)."""
        return np.asarray(self.prior_terms[0].sum(axis=-1) - 0.5 * self.deviance)

    @cached_property
    def shared(self) -> Array:
        """Shared unknowns of each session, and −1: the factor of the right-hand side (S, q + 1 + m + 1)."""
        q = self.local.shape[-1]
        out = np.full((*self.local.shape[:-1], q + self.parameters.shape[-1] + 1), -1.0)
        out[..., :q], out[..., q:-1] = self.local, self.parameters[..., None, :]
        return out

    @cached_property
    def session_covariances(self) -> Array:
        """Covariance of the shared unknowns of each session (S, q + 1 + m, q + 1 + m)."""
        return np.asarray(self.roots @ np.swapaxes(self.roots, -1, -2))

    @property
    def covariance(self) -> Array:
        """Covariance of gravity and the common parameters (1 + m, 1 + m)."""
        q = self.local.shape[-1]
        return np.asarray(self.session_covariances[..., 0, q:, q:])

    @cached_property
    def mean_bias(self) -> tuple[Array, Array] | None:
        """Derivatives of the mean in-run biases (`session_mean_bias`); None without biases or for several sessions."""
        return (
            session_mean_bias(self.equations)
            if self.equations.wanders and len(self.problem.session_spans) == 1
            else None
        )

    @cached_property
    def session_root(self) -> Array:
        """Root (1 + m, q + 1 + m) of the covariance of gravity and the common parameters by shared unknowns, biases
        being the means over the session."""
        roots = self.roots[..., 0, :, :]
        root = roots[..., len(self.problem.usual_local_u) :, :].copy()
        if self.mean_bias is not None:
            root[..., 1 + self.problem.biases, :] += self.mean_bias[0][..., :-1] @ roots
        return root

    @property
    def session_step(self) -> Array:
        """Step of gravity and the common parameters (1 + m,), biases being the means over the session."""
        step = self.parameters.copy()
        if self.mean_bias is not None:
            by_shared, _ = self.mean_bias
            step[..., 1 + self.problem.biases] += (by_shared @ self.shared[..., 0, :, None])[..., 0]
        return step

    @property
    def session_covariance(self) -> Array:
        """Covariance of gravity and the common parameters (1 + m, 1 + m), biases being the means over the session."""
        root, biases = self.session_root, 1 + self.problem.biases
        covariance = root @ np.swapaxes(root, -1, -2)
        if self.mean_bias is not None:
            _, by_noise = self.mean_bias
            along = np.swapaxes(by_noise, -3, -2).reshape(*covariance.shape[:-2], len(biases), -1)
            covariance[..., biases[:, None], biases] += along @ np.swapaxes(along, -1, -2)
        return np.asarray(covariance)

    @cached_property
    def unknowns(self) -> Array:
        """Step of the unknowns (M, d) of the stations by back-substitution: angles, velocities if any, states."""
        sensitivity, parts = self.equations.sensitivity, enumerate(self.problem.session_spans)
        steps = (sensitivity[..., part.stations, :, :] @ self.shared[..., s, None, :, None] for s, part in parts)
        return np.concatenate([step[..., 0] for step in steps], axis=-2)

    @property
    def angles(self) -> Array:
        """Step of the angles (M, 3) of the attitudes."""
        return self.unknowns[..., :3]

    @property
    def states(self) -> Array:
        """States (M, s): in-run biases, then displacements, divided by their standard deviations."""
        return self.unknowns[..., self.equations.unknowns - self.equations.noise.states :]

    @cached_property
    def conditional_covariances(self) -> Array:
        """Covariances of the unknowns of each rest, and with those of the next, given the shared (2, N, d, d)."""
        return conditional_covariances(*self.equations.inverses)

    @cached_property
    def residuals(self) -> dict[str, tuple[Array, Array]]:
        """By kind of rows: whitened residuals (K, r), and their covariances (K, r, r), below 1 by what the fit absorbs.

        A are the coefficients of a row for the unknowns of its stations, of covariance S given the shared unknowns, and
        E those for the shared unknowns, directly and through the stations. The covariance of the residual is

            1 − A S Aᵀ − (E U)(E U)ᵀ"""
        sensitivity, out = self.equations.sensitivity, dict[str, tuple[Array, Array]]()
        here, with_next = self.conditional_covariances
        for kind, rows in self.equations.rows.items():
            (K, r, columns), width, first = rows.shape, sensitivity.shape[-1], self.problem.first_station[kind]
            residual, covariance, work = np.zeros((K, r)), np.zeros((K, r, r)), np.empty((r, columns - width))
            for part, root, shared in zip(self.problem.session_spans, self.roots, self.shared, strict=True):
                at = part.rows[kind]
                of_part, along = (rows[at], first[at]), np.empty((len(first[at]), r, width - 1))
                reduced_rows(*of_part, sensitivity, shared, residual[at], along)
                along = times_root(along, root)
                residual_covariances(*of_part, here, with_next, along, covariance[at], work)
            out[kind] = residual, covariance
        return out

    @cached_property
    def scatter(self) -> list[tuple[str, Array, Array, Array, IntArray]]:
        """For every kind of rows its name, whitened residuals (K, r) with covariances (K, r, r), the whitened
        directions (K, r, q) of its components of variance, and their indices (q,) in SCATTER."""
        noise, out = self.equations.noise, list[tuple[str, Array, Array, Array, IntArray]]()
        for kind, (residual, covariance) in self.residuals.items():
            rows, Z = noise.rows[kind], noise.directions[kind]
            if not rows.whole:  # the whitening contains the weights
                Z = Z / rows.root_weights[:, :, None]
            out.append((kind, residual, covariance, self.equations.whitening[kind] @ Z, rows.component))
        return out


def solve(linearisation: Linearisation, components: VarianceComponents | None = None) -> Solution:
    """Return the least-squares solution of a linearisation, at its components of variance or at others."""
    if components is not None:
        linearisation = linearisation.with_components(components)
    return add_priors(linearisation, eliminate_rests(linearisation))


def eliminate_rests(linearisation: Linearisation) -> NormalEquations:
    """Return the normal equations of every session after elimination of its rests (22)."""
    problem, noise = linearisation.problem, linearisation.noise
    whitening = noise.whitening()
    rows = whitened_rows(linearisation, whitening)
    at_stations, joints = rows_by_station(linearisation, rows)
    d, states = noise.unknowns, noise.states
    *stack, M, _, width = at_stations.shape
    factors, size = np.empty((*stack, M, d, d + width)), width - d
    triangles = np.swapaxes(np.zeros((*stack, len(problem.session_spans), size, size)), -1, -2)
    initial = np.zeros((d, d + width))  # states of the first station have unit variance
    initial[d - states :, d - states : d] = np.eye(states)
    for s, part in enumerate(problem.session_spans):
        stations = part.stations
        link = np.append(np.arange(stations.stop - stations.start - 1), -1)
        for at in product(*map(range, stack)):
            of_part = at_stations[at][stations], joints[at][stations]
            eliminate(*of_part, link, factors[at][stations], triangles[at][s], initial)
    return NormalEquations(noise=noise, whitening=whitening, rows=rows, rest_factors=factors, session_factors=triangles)


def whitened_rows(linearisation: Linearisation, whitening: Mapping[str, Array]) -> dict[str, Array]:
    """Return the whitened rows by kind (`NormalEquations`), with in-run biases and displacements of unit variance."""
    problem, noise, s = linearisation.problem, linearisation.noise, linearisation.noise.states
    d, out, biases = noise.unknowns, dict[str, Array](), np.arange(problem.station_columns)[problem.bias_columns]
    for kind, rows in linearisation.rows.items():
        if noise.biases == 0:  # delete their columns
            rows = np.delete(rows, [biases + e * problem.station_columns for e in range(STATIONS[kind])], axis=2)
        out[kind] = whitening[kind] @ rows
        for last in range(d, (1 + STATIONS[kind]) * d, d) if s else ():
            out[kind][..., last - s : last] *= noise.state_sigma[..., None, None, :]
    return out


def rows_by_station(linearisation: Linearisation, rows: Mapping[str, Array]) -> tuple[Array, Array]:
    """Return the whitened rows of every station (M, r, d + w), and those that join it to the next (M, t, 2 d + w).

    Rows are zero where a kind has none. The last of those that join are the steps of the s states (19)."""
    problem, noise = linearisation.problem, linearisation.noise
    s, d, M = noise.states, noise.unknowns, len(problem.chain)

    def joined_kinds(stations: int, always: str, further: int) -> Array:
        """Return the kinds of rows in the unknowns of one or two stations, one below the other, then `further` zeros.

        The kind `always` has an array, perhaps without rows, in every problem."""
        kinds = {kind: of_kind for kind, of_kind in rows.items() if STATIONS[kind] == stations and of_kind.shape[-3]}
        *stack, _, _, width = rows[always].shape
        out, top = np.zeros((*stack, M, sum(each.shape[-2] for each in kinds.values()) + further, width)), 0
        for kind, of_kind in kinds.items():
            bottom = top + of_kind.shape[-2]
            out[..., problem.first_station[kind], top:bottom, :] = of_kind
            top = bottom
        return out

    at_stations, joints = joined_kinds(1, "accel", 0), joined_kinds(2, "turn", s)
    if s:
        here, step = np.flatnonzero(noise.follows)[:, None], noise.state_step[..., noise.follows, :]
        state = np.arange(s)
        joints[..., here, state - s, d - s + state] = -noise.state_rho[..., noise.follows, :] / step
        joints[..., here, state - s, 2 * d - s + state] = 1.0 / step
    return at_stations, joints


def add_priors(linearisation: Linearisation, equations: NormalEquations, **at_phi: Array) -> Solution:
    """Return the solution of normal equations with the priors of a linearisation.

    Priors of each session are folded in first and its parameters eliminated; then the common priors. `at_phi` are the
    fields `phi` and `prior_terms` of the solution."""
    problem = linearisation.problem
    q, S, p = len(problem.usual_local_u), len(problem.session_spans), linearisation.prior.shape[-1] - 1
    stack = max(linearisation.prior.shape[:-2], equations.session_factors.shape[:-3], key=len)

    def stacked(x: Array, axes: int) -> Array:
        return np.broadcast_to(x, (*stack, *x.shape[x.ndim - axes :])) if stack else x

    factors, prior = stacked(equations.session_factors, 3), stacked(linearisation.prior, 2)
    local_u, local_prior = stacked(problem.local_u, 1), stacked(linearisation.local_prior, 2)
    further_u = stacked(problem.prior_u[..., 1 + problem.instrument.linear_count :], 1)
    parameters, local, roots = np.zeros((*stack, p)), np.zeros((*stack, S, q)), np.zeros((*stack, S, q + p, q + p))
    diagonals, square = np.empty((*stack, 2 * S * q + p + further_u.shape[-1])), np.empty(stack)
    for at in product(*map(range, stack)):
        triangle, heads = fold_sessions(prior[at], factors[at], local_u[at], local_prior[at])
        exact = int(triangle[0, 0] == 0.0)  # if gravity is exact its step is zero
        root = np.zeros((p, p))
        root[exact:, exact:] = inverse_of(triangle[exact:p, exact:p])
        parameters[at][exact:] = root[exact:, exact:] @ triangle[exact:p, p]
        roots[at][:, q:, q:] = root
        for s, head in enumerate(heads if q else ()):
            inverse = inverse_of(head[:, :q])
            by_parameter = -inverse @ head[:, q:-1]
            local[at][s] = inverse @ head[:, -1] + by_parameter @ parameters[at]
            roots[at][s, :q, :q], roots[at][s, :q, q:] = inverse, by_parameter @ root
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


def fold_sessions(prior: Array, factors: Array, local_u: Array, local_prior: Array) -> tuple[Array, list[Array]]:
    """Fold the triangles of all sessions into the prior of the common parameters.

    Returns the triangle (p + 1, p + 1) of the common parameters and, for each session, its `head` (q, q + p + 1): the
    rows that determine its own parameters once the common ones are known."""
    triangle, heads, q = prior, list[Array](), len(local_u)
    for factor, residual in zip(factors, local_prior, strict=True):
        wide = with_local_prior(local_u, factor, residual)
        heads.append(wide[:q])
        fold(triangle, wide[q:, q:], triangular=True)
        triangle = wide[q:, q:]
    return triangle, heads


def with_local_prior(local_u: Array, factor: Array, residual: Array) -> Array:
    """Return the triangle of a session with the priors of its parameters, of whitened `residual` (q,)."""
    wide, q = factor.copy(order="F"), len(residual)
    if q:
        prior = np.zeros((q, len(wide)))
        prior[:, :q], prior[:, -1] = np.diag(1.0 / local_u), residual
        fold(prior, wide, triangular=True)
    return wide


def rests_deviance(equations: NormalEquations) -> Array:
    """Return ln |V| + 2 Σ ln |diag R| over the rows and the unknowns of the rests."""
    noise = equations.noise
    whitened = sum(np.log(W.diagonal(0, -2, -1)).sum(axis=(-2, -1)) for W in equations.whitening.values())
    steps = np.log(noise.state_step[..., noise.follows, :]).sum(axis=(-2, -1)) if noise.states else 0.0
    return np.asarray(2.0 * (_logarithms(equations.rest_factors.diagonal(0, -2, -1)).sum(axis=-1) + steps - whitened))


def _logarithms(values: Array) -> Array:
    """Return the sum (…) of the logarithms of the values (…, n) that are not zero."""
    size = np.abs(values)
    return np.asarray(np.log(np.where(size > 0.0, size, 1.0)).sum(axis=-1))


def inverse_of(triangle: Array) -> Array:
    """Return the inverse of an upper triangle; LinAlgError if it is singular."""
    inverse, singular = scipy.linalg.lapack.dtrtri(triangle)
    if singular:
        raise np.linalg.LinAlgError("Singular matrix")
    return np.asarray(inverse)


def times(rows: Array, matrix: Array) -> Array:
    """Return rows (…, K, t, p) times a matrix (…, p, y), in one product."""
    flat = rows.reshape(*rows.shape[:-3], -1, rows.shape[-1])
    return np.asarray(flat @ matrix).reshape(*rows.shape[:-1], matrix.shape[-1])


def times_root(rows: Array, root: Array) -> Array:
    """Return rows (…, n) times an upper triangle (n, n)."""
    flat = rows.reshape(-1, len(root))
    return np.asarray(scipy.linalg.blas.dtrmm(1.0, root.T, flat.T, lower=1).T).reshape(rows.shape)


def explained(solution: Solution, at_stations: Array, of_sessions: Array) -> Array:
    """Return bᵀ C b (D, D), with the covariance C of all unknowns: what a fit explains of whitened rows z, if b = Xᵀ z.

    Parameters
    ----------
    at_stations : (M, d, D)
        b of the unknowns of each station.
    of_sessions : (S, q + 1 + m, D)
        b of the parameters of each session, gravity and the common parameters; it is overwritten.
    """
    equations, q, D = solution.equations, solution.local.shape[-1], at_stations.shape[-1]
    inverse, by_next = equations.inverses
    for b, part in zip(of_sessions, solution.problem.session_spans, strict=True):
        stations = part.stations
        b += np.tensordot(equations.sensitivity[stations, :, :-1], at_stations[stations], axes=((0, 1), (0, 1)))
    noise = np.swapaxes(inverse, 1, 2) @ adjoint(by_next, at_stations)
    local = np.swapaxes(solution.roots[:, :q, :q], 1, 2) @ of_sessions[:, :q]
    common = solution.roots[0, q:, q:].T @ of_sessions[:, q:].sum(axis=0)
    common += np.tensordot(solution.roots[:, :q, q:], of_sessions[:, :q], axes=((0, 1), (0, 1)))
    columns = np.concatenate([part.reshape(-1, D) for part in (noise, local, common)])
    return np.asarray(columns.T @ columns)


def adjoint(by_next: Array, values: Array) -> Array:
    """Return g (…, M, d, k) of the recursion g_{i+1} = v_{i+1} + A_iᵀ g_i that is adjoint to the back-substitution."""
    back, out = np.zeros(by_next.shape), np.ascontiguousarray(values[..., ::-1, :, :])
    back[..., :-1, :, :] = np.swapaxes(by_next[..., -2::-1, :, :], -1, -2)
    recur_backwards(back, out)
    return out[..., ::-1, :, :]


def session_mean_bias(equations: NormalEquations) -> tuple[Array, Array]:
    """Return derivatives of the mean in-run biases over the rests of a session (20).

    Returns
    -------
    by_shared : (n, q + 1 + m + 1)
        Derivatives by the shared unknowns, and minus the value where these are zero.
    by_noise : (N, n, d)
        Derivatives by the noise e of every rest, along the chain δ_i = A_i δ_{i+1} + B_i x + a_i + R_i⁻¹ e_i.
    """
    inverse, by_next = equations.inverses
    n = equations.noise.biases
    sigma, first = equations.noise.state_sigma[..., :n], equations.unknowns - equations.noise.states
    biases, (*stack, N, d, _) = slice(first, first + n), inverse.shape
    by_station = np.zeros((*stack, N, d, n))
    by_station[..., biases, :] = sigma[..., None, None, :] * np.eye(n) / N
    by_noise = np.swapaxes(adjoint(by_next, by_station), -1, -2) @ inverse
    along, rows = np.swapaxes(by_noise, -3, -2).reshape(*stack, n, -1), equations.rest_factors[..., 2 * d :]
    return -(along @ rows.reshape(*stack, N * d, -1)), by_noise


def mean_by_common(by_shared: Array, head: Array) -> tuple[Array, Array]:
    """Eliminate the parameters of the session from the derivatives `by_shared` of its mean biases, by its `head`.

    Returns the derivatives by gravity and the common parameters with minus the value where these are zero
    (n, 1 + m + 1), and those by the noise of the parameters of the session (n, q)."""
    q = len(head)
    if q == 0:
        return by_shared, by_shared[:, :0]
    by_local = by_shared[:, :q] @ inverse_of(head[:, :q])
    return by_shared[:, q:] - by_local @ head[:, q:], by_local
