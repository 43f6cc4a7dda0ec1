"""The joint maximum of the likelihood over the unknowns x and the hyperparameters φ.

x are gravity, the parameters, what each session has beside, the attitudes and the states of the in-run biases: what
is linear, or nearly so, given φ (`tumble.inference.hyperparameters`). Maximised is

    ℓ(φ) = ln p(φ) − ½ [rᵀV⁻¹r + x̂ᵀP₀x̂ + ln |V| − ln |P₀| + 2 Σ ln |diag R|]

the logarithm of the posterior of φ with x integrated out, r being the residuals at x̂(φ)
(`tumble.inference.normal_equations`): docs/explanation/mathematics.md (23), (28) and (29).

    x   Gauss–Newton: x ← x + argmin over the rows linearised at x. Turns are integrated again about the current
        parameters wherever the second-order effect of the change since counts.
    φ   at fixed rows a trust region: s = B⁻¹γ, |s|∞ ≤ Δ, with the analytic score γ, and B, at first the average
        information, then by the updates of Broyden, Fletcher, Goldfarb and Shanno, and where these have settled the
        average information there, with which it goes on where φ has not. Sizes λ = exp(max(p, 0)) have p ≥ 0:
        below, p has nothing to do with the data.

It ends where a step of x is negligible beside u (CONVERGED) and ½ γᵀB⁻¹γ, what ℓ would still gain, below GAIN
for every element of φ (`Status.converged`); or it runs out, which is said and is no result.

A chain of turns whose heading the gyros hardly see (no better than UNSEEN) keeps it where it is: it is still an unknown
of every step, so that it takes nothing from the parameters. So does gravity of an unknown place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
import scipy

from tumble.inference.fits import (
    LEAST_WEIGHT,
    LEFT_OUT,
    STANDS_OUT,
    chi_square_falls,
    sigmas,
    student_weights,
    weighted,
)
from tumble.inference.hyperparameters import (
    LEAST_DEGREES,
    CorrelationTime,
    GroupSize,
    Hyperparameters,
    InRunSize,
    Scatter,
    average_information,
    hyperparameters_of,
    score,
    solution_at,
)
from tumble.inference.integrated_turns import IntegratedTurns
from tumble.inference.linearisation import Linearisation, linearise
from tumble.inference.noise import NO_COMPONENTS, REST_SCATTER, SCATTER, VarianceComponents
from tumble.inference.normal_equations import Solution, solve
from tumble.inference.problem import Point, Problem
from tumble.units import Array, BoolArray

MAX_ITERATIONS = 40
"""Linearisations at most."""
BEYOND = 3.0
"""Times the usual: scatter or a size for which another maximum is looked for."""
USELESS = {"turn": 0.3, "velocity": 3.0}
"""rad and m/s: the scatter of turns that say nothing."""
WIDE = 3.0
"""Standard deviations of p: the sizes of groups that are looked for from above."""
ANEW = 3.0
"""s: a correlation time of biases that are anew at every rest."""
STEPS = 12
"""Steps over φ at one linearisation at most."""
CONVERGED = 1e-3
"""Of the standard uncertainty: a step of x that is negligible."""
SETTLED = 0.05
"""A change of the weight of a row that is none."""
GAIN = 0.5 * 0.05**2
"""What ℓ would still gain by each element of φ where φ counts as settled: they are within 0.05 of their standard
deviations, root mean square."""
NEAR, FAR_STEPS = 1.0, 2
"""Of u: until x is so near, at most for so many linearisations, φ stays as it is, for residuals are of x then."""
SAME = 0.1
"""Of an element of φ: what ℓ may be below a maximum, and would be by its curvature, on the way there."""
FURTHEST = 2.0
"""Δ at first and at most."""
SQUARED = 10.0
"""Error after a step of Gauss–Newton, in units of the spreads, over the square of the step."""
UNSEEN = 0.2
"""rad: a heading that the gyros know to no better."""
TO_AND_FRO = 6
"""Linearisations after which a heading that still moves is one that the gyros do not know either, and weights of rows
go half the way."""
PLACE_UNKNOWN = 1e-3
"""Normal gravity is known to a third of that anywhere."""


class Status(Enum):
    """Why the iteration ended."""

    converged = "x and φ settled"
    ran_out = "the steps ran out before x and φ settled"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Maximum:
    """The joint maximum.

    Parameters
    ----------
    linearisation
        The rows it is of, with groups of usual size.
    hyperparameters
        The elements of φ.
    solution
        The solution and ℓ at the maximum, with priors of the size there.
    point
        The point after the last step.
    curvature : (D, D)
        B, the curvature of −ℓ by φ.
    increments
        The changes (m,) of the parameters by linearisation.
    status
        Why the iteration ended.
    """

    linearisation: Linearisation
    hyperparameters: Hyperparameters
    solution: Solution
    point: Point
    curvature: Array
    increments: tuple[Array, ...]
    status: Status

    @property
    def usual_problem(self) -> Problem:
        """The problem with groups of usual size."""
        return self.linearisation.problem

    @property
    def problem(self) -> Problem:
        """The problem with priors of the size at the maximum."""
        return self.solution.problem

    @property
    def phi(self) -> Array:
        """φ (D,) at the maximum."""
        return self.solution.phi

    @property
    def converged(self) -> bool:
        """Whether it is one."""
        return self.status is Status.converged

    @property
    def components(self) -> VarianceComponents:
        """The components of variance at the maximum."""
        return self.solution.components


def maximise(
    start: Linearisation,
    phi: Array | None = None,
    iterations: int = MAX_ITERATIONS,
    robust: bool = False,
    known: Maximum | None = None,
) -> Maximum:
    """The joint maximum of x and φ.

    Parameters
    ----------
    start
        The linearisation to begin from, with groups of usual size.
    phi : (D,)
        Where φ begins; at the most likely values by its prior where None, or where there are other elements.
    iterations
        Linearisations at most.
    robust
        Whether rows are Student-t (`tumble.inference.fits`).
    known
        A maximum that is returned where φ comes so close to it from below that it leads there again.
    """
    problem, linearisation = start.problem, start
    hyperparameters = hyperparameters_of(problem, start.noise, _seen(solve(start, NO_COMPONENTS)))
    if phi is None or len(phi) != len(hyperparameters):
        phi = hyperparameters.centre
    increments, near, phi_settled, B, radius = list[Array](), False, False, None, FURTHEST
    while True:
        solution = solution_at(linearisation, hyperparameters, phi)
        near = near or len(increments) >= FAR_STEPS or negligible(solution, NEAR)
        if near:
            solution, B, radius, phi_settled = maximise_phi(hyperparameters, solution, B, radius)
        phi = solution.phi
        if known is not None and near and len(phi) == len(known.phi):
            away, below = phi - known.phi, float(known.solution.log_posterior - solution.log_posterior)
            if max(below, 0.5 * float(away @ known.curvature @ away)) < SAME * len(phi) and below > 0.0:
                return known

        # x by a step of Gauss–Newton, to where rows are linearised next
        point, change = take_step(solution, keep=len(increments) >= TO_AND_FRO)
        increments.append(change)
        about, noise = reintegrated_turns(problem, point, linearisation.about), linearisation.noise
        weights = before = noise.weights
        if robust:
            weights = weighted(problem, noise, student_weights(chi_square_falls(solution))).weights
        weights_settled = all(np.all(np.abs(a**2 - b**2) < SETTLED) for a, b in zip(weights, before, strict=True))
        if len(increments) >= TO_AND_FRO:  # rows that have the blame by turns share it
            rest, turn, link = (np.sqrt(0.5 * (a**2 + b**2)) for a, b in zip(weights, before, strict=True))
            weights = rest, turn, link
        settled = negligible(solution) and about is linearisation.about and phi_settled and weights_settled
        if settled or len(increments) >= iterations:
            return Maximum(
                linearisation=linearisation,
                hyperparameters=hyperparameters,
                solution=solution,
                point=point,
                curvature=average_information(hyperparameters, solution) if B is None else B,
                increments=tuple(increments),
                status=Status.converged if settled else Status.ran_out,
            )
        linearisation = linearise(problem, point, about)
        linearisation = replace(linearisation, noise=linearisation.noise.weighted(*weights))


def maximise_phi(
    hyperparameters: Hyperparameters, solution: Solution, B: Array | None = None, radius: float = FURTHEST
) -> tuple[Solution, Array, float, bool]:
    """The likeliest φ at fixed rows, by a trust region of at most STEPS steps.

    Parameters
    ----------
    hyperparameters, solution
        The elements of φ, and a solution to begin from.
    B : (D, D)
        The curvature of −ℓ by φ, as far as it is known; that of the average information where None.
    radius
        Δ, the largest step.

    Returns
    -------
    solution, B, radius
        The last solution, with curvature and Δ. Where x has settled, too, B is the average information there.
    settled
        Whether ℓ would gain by B no more than GAIN by each element.
    """
    exact, linearisation, bounded = B is None, solution.linearisation, hyperparameters.bounded
    gradient, enough = score(hyperparameters, solution), GAIN * max(1, len(hyperparameters))
    if B is None:
        B = average_information(hyperparameters, solution)
    for _ in range(STEPS):
        free = np.flatnonzero(~(bounded & (solution.phi <= 0.0) & (gradient <= 0.0)))
        step = np.zeros(len(gradient))
        step[free] = np.linalg.solve(B[np.ix_(free, free)], gradient[free])
        gain = 0.5 * float(gradient @ step)
        if not np.isfinite(gain):
            raise np.linalg.LinAlgError("a step over what the model does not know of itself is not finite")
        if gain < enough and (exact or not negligible(solution)):
            break
        if gain < enough:  # settled as far as B tells: once more by the average information
            B, exact = average_information(hyperparameters, solution), True
            continue
        step *= min(1.0, radius / float(np.abs(step).max()))
        step = np.where(bounded, np.maximum(solution.phi + step, 0.0), solution.phi + step) - solution.phi
        tried = solution_at(linearisation, hyperparameters, solution.phi + step)
        tried_gradient = score(hyperparameters, tried)
        expected = float(gradient @ step - 0.5 * step @ B @ step)
        gained = float(tried.log_posterior - solution.log_posterior)
        B, exact = _updated(B, step, gradient - tried_gradient), False
        small = gained < 0.1 * expected or expected <= 0.0
        radius = 0.3 * float(np.abs(step).max()) if small else min(2.0 * radius, FURTHEST)
        if gained > 0.0:
            solution, gradient = tried, tried_gradient
    return solution, B, radius, gain < enough


def maximise_from_starts(start: Linearisation, iterations: int = MAX_ITERATIONS) -> Maximum:
    """The highest of the maxima that several starts of φ lead to.

    The usual φ is the first start. Where it leads to scatter or sizes far beyond the usual, others follow:

    * turns of large scatter: where turns are spoilt, parameters and accelerometers may have taken the blame;
    * groups far larger than usual: scatter may have taken what is theirs;
    * where rests scatter, biases that are anew at every rest, a turn having that of the rest before it or of the rest
      after it."""
    best = maximise(start, iterations=iterations)
    if start.problem.observations.turns is None:
        return best
    hyperparameters, starts = best.hyperparameters, list[tuple[float, Array]]()
    centre = np.array([h.centre for h in hyperparameters])
    sizes = {h.name: float(h.value(p)) for h, p in zip(hyperparameters, best.phi, strict=True)}
    far = [h for h in hyperparameters if sizes[h.name] > BEYOND * h.usual and not isinstance(h, CorrelationTime)]
    far = [h for h in far if h.name != "mag"]  # which takes no blame from others
    share = start.problem.bias_after
    if any(isinstance(h, (Scatter, GroupSize)) for h in far):
        useless = [np.log(USELESS[h.name]) if h.name in USELESS else h.centre for h in hyperparameters]
        starts.append((share, np.array(useless)))
    groups = np.array([isinstance(h, GroupSize) for h in hyperparameters], dtype=bool)
    if far and groups.any():
        starts.append((share, np.where(groups, [WIDE * h.within for h in hyperparameters], centre)))
    scatters = any(h.name in REST_SCATTER and sizes[h.name] > h.usual for h in hyperparameters)
    if scatters or any(isinstance(h, InRunSize) for h in far):
        anew = best.phi.copy()
        for i, h in enumerate(hyperparameters):
            if isinstance(h, CorrelationTime):
                anew[i] = np.log(ANEW)
            elif isinstance(h, InRunSize):
                anew[i] = np.log(np.hypot(sizes[h.name], sizes.get(h.name.removesuffix("_in_run"), 0.0)))
            elif h.name in REST_SCATTER:
                anew[i] = h.centre
        starts += [(0.0, anew), (1.0, anew)]
    for bias_after, phi in starts:
        problem = replace(start.problem, bias_after=bias_after)
        known = best if bias_after == best.linearisation.problem.bias_after else None
        other = maximise(replace(start, problem=problem), phi, iterations, known=known)
        if other.converged and other.solution.log_posterior > best.solution.log_posterior:
            best = other
    return best


def without_outliers(fitted: Maximum, iterations: int = MAX_ITERATIONS) -> Maximum:
    """The maximum without the rests and turns that do not fit; the same where all do."""
    every = np.concatenate(sigmas(fitted.solution)[: 3 if fitted.problem.magnetometer is None else 5])
    whole = all(np.all(each == 1.0) for each in fitted.linearisation.noise.weights)
    if whole and (not len(every) or 2.0 * scipy.special.ndtr(-every.max()) * len(every) > STANDS_OUT):
        return fitted
    robust = maximise(fitted.linearisation, fitted.phi, iterations, robust=True)
    dropped = [w < LEAST_WEIGHT for w in student_weights(chi_square_falls(robust.solution))]
    if whole and not any(each.any() for each in dropped):
        return fitted
    weights = [np.where(each, weight, 1.0) for each, weight in zip(dropped, LEFT_OUT, strict=True)]
    noise = weighted(fitted.usual_problem, robust.linearisation.noise, weights)
    return maximise(replace(robust.linearisation, noise=noise), robust.phi, iterations)


def _updated(B: Array, step: Array, change: Array) -> Array:
    """The update of Broyden, Fletcher, Goldfarb and Shanno of a curvature by the change of the gradient over a step,
    damped by Powell so that it stays positive; the same where there was no step."""
    along = B @ step
    square, seen = float(step @ along), float(step @ change)
    if square <= 0.0 or not np.isfinite(seen):
        return B
    share = 1.0 if seen >= 0.2 * square else 0.8 * square / (square - seen)
    mixed = share * change + (1.0 - share) * along
    return np.asarray(B - np.outer(along, along) / square + np.outer(mixed, mixed) / float(step @ mixed))


def _seen(solution: Solution) -> BoolArray:
    """Whether a fit leaves something of each component (c,) of scatter."""
    degrees = np.zeros(len(SCATTER))
    for W, (_, C), (Z, place) in solution.by_kind:
        WZ = W @ Z
        whole, left = (WZ**2).sum(axis=1), (WZ * (C @ WZ)).sum(axis=1)
        degrees += np.bincount(place, (left / np.where(whole > 0.0, whole, 1.0)).sum(axis=0), len(degrees))
    return np.asarray(degrees > LEAST_DEGREES)


def negligible(solution: Solution, share: float = CONVERGED) -> bool:
    """Whether what is left to do after a step is, as a share of u: Gauss–Newton squares the error, in units of the
    spreads."""
    change = np.abs(_with_gravity_kept(solution)[0][1:])
    u = np.sqrt(solution.covariance.diagonal()[1:])
    after = change * min(1.0, SQUARED * float(np.max(change / solution.problem.spread)))
    return bool(np.all(after <= share * u + 1e-15))


def take_step(solution: Solution, keep: bool = False) -> tuple[Point, Array]:
    """The point after the step of a solution, shortened so that no parameter moves by more than its spread, and the
    change of the parameters. Chains whose heading is hardly seen `keep` it, or all chains, unless a magnetometer sees
    it."""
    problem, equations = solution.problem, solution.equations
    parameters, angles, local = _with_gravity_kept(solution)
    share = 1.0 / max(1.0, float(np.max(np.abs(parameters[1:]) / problem.spread)))
    angles, chain = share * angles, problem.chain
    # chi-square after a step per row, 1 at least: so many times less is known than the noise has it. A heading by
    # residuals that are many times the Earth's rate would turn to and fro.
    every = equations.rest_rows, equations.turn_rows, equations.link_rows
    rows = sum(each.shape[0] * each.shape[1] for each in every)
    hidden = np.bincount(chain, heading_information(solution)) < UNSEEN**-2 * max(1.0, solution.square / rows)
    if (keep or hidden.any()) and problem.magnetometer is None:
        mean = np.bincount(chain, angles[:, 2]) / np.bincount(chain)
        angles[:, 2] -= np.where(hidden | keep, mean, 0.0)[chain]
    velocities = displacements = None
    if problem.moves:
        velocities = share * solution.unknowns[:, 3:6]
        displacements = solution.components.displacement * solution.states[:, -3:]
    point = solution.linearisation.point.moved(share * parameters, angles, share * local, velocities, displacements)
    return point, share * parameters[1:]


def _with_gravity_kept(solution: Solution) -> tuple[Array, Array, Array]:
    """The step of gravity and the parameters (1 + m,), of the angles (N, 3) and of what each session has beside.
    Gravity of an unknown place (u above PLACE_UNKNOWN of it) stays what it is: no reading tells it from the scale
    factors, and steps along both, whose product counts, would go to and fro. The step is that of everything else given
    gravity, δ − C_g δ_g / C_gg; what is not known of gravity stays in the covariance."""
    problem = solution.problem
    if float(problem.prior_u[0]) < PLACE_UNKNOWN * float(problem.prior_mean[0]):
        return solution.parameters, solution.angles, solution.local
    q, follow = len(problem.local_u), solution.equations.sensitivity
    by_gravity = solution.parameters[0] / solution.covariance[0, 0]
    with_gravity = zip(problem.parts, solution.session_covariances[:, :, q], strict=True)
    angles = [
        solution.angles[part.stations] - by_gravity * follow[part.stations, :3, :-1] @ along
        for part, along in with_gravity
    ]
    local = solution.local - by_gravity * solution.session_covariances[:, :q, q]
    return solution.parameters - by_gravity * solution.covariance[:, 0], np.concatenate(angles), local


def heading_information(solution: Solution) -> Array:
    """What the gyros of each station (M,) and of the turn or link after it say of the heading of both, rad⁻²."""
    equations, problem = solution.equations, solution.problem
    d, n, information = equations.unknowns, problem.observations.accel_block.size, np.zeros(len(problem.link))
    information[problem.station] = (equations.rest_rows[:, n:, 2] ** 2).sum(axis=1)
    for rows, before in ((equations.turn_rows, problem.before_turn), (equations.link_rows, problem.before_link)):
        information[before] += ((rows[:, :, 2] + rows[:, :, d + 2]) ** 2).sum(axis=1)
    return information


def reintegrated_turns(problem: Problem, point: Point, about: IntegratedTurns | None) -> IntegratedTurns | None:
    """The turns, integrated again if the parameters have moved too far since."""
    if about is None:
        return None
    changes = problem.coefficient_changes(point)
    gyros = slice(problem.instrument.accel.size, None)
    if changes is not None and about.small(changes[:, gyros], problem.noise_of_turns):
        changes = None
    gyro_changes = 0.0 if changes is None else changes[:, gyros]
    links_good = about.links is None or about.links.good_for(problem.instrument, point.values, problem.noise_of_parts)
    if links_good and about.good_for(problem.instrument, point.values, problem.noise_of_turns, gyro_changes):
        return about
    return IntegratedTurns.of(problem.observations, problem.instrument, point.values, changes)
