"""Maximum of the posterior ℓ(φ) of the hyperparameters, with the unknowns x integrated out.

x are gravity, the parameters, those of each session, the attitudes and the states of the in-run biases: the problem is
linear, or nearly so, in x given φ (`tumble.inference.hyperparameters`). ℓ(φ) is the logarithm of the posterior of φ
with x integrated out, docs/explanation/mathematics.md (23), (28) and (29).

    x   Gauss–Newton: x ← x + argmin of the residuals linearised at x. Turns are integrated again about the current
        parameters wherever the second-order effect of the change since the last integration matters.
    φ   at fixed residuals Newton's method in a trust region: s = B⁻¹γ, |s|∞ ≤ Δ, with the gradient γ and B, minus the
        second derivative of ℓ (`hyperparameters.derivatives`). Sizes λ = exp(max(p, 0)) keep p ≥ 0, because the data
        do not depend on p below.

The iteration ends when a step of x is negligible relative to u (CONVERGED) and ½ γᵀB⁻¹γ, the expected gain of ℓ, is
below GAIN per element of φ (`Maximum.converged`), or when it runs out of steps, which is no result.

The mean heading of a chain of turns that the gyros hardly observe (worse than UNOBSERVED) is not changed. It stays an
unknown of every step, so that it takes no information from the parameters. The same holds for the gravity of an unknown
place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from tumble.inference.fits import (
    LEAST_WEIGHT,
    OUTLIER_PROBABILITY,
    chi_square_falls,
    left_out,
    outlier_weights,
    sigmas,
    student_weights,
)
from tumble.inference.hyperparameters import (
    LEAST_DEGREES,
    Hyperparameters,
    derivatives,
    hyperparameters_of,
    solution_at,
)
from tumble.inference.integrated_turns import IntegratedTurns
from tumble.inference.linearisation import Linearisation, linearise
from tumble.inference.noise import NO_COMPONENTS, REST_SCATTER, SCATTER, STATIONS, VarianceComponents
from tumble.inference.normal_equations import Solution, solve
from tumble.inference.problem import Point, Problem
from tumble.units import Array, BoolArray

MAX_ITERATIONS = 40  # linearisations
STEPS = 12  # steps of φ per linearisation
CONVERGED = 1e-3  # step of x, in u, that is negligible
# Expected gain of ℓ per element at which φ has settled: within 0.05 of its standard deviations, root mean square.
GAIN = 0.5 * 0.05**2
WEIGHT_CHANGE = 0.05  # change of the weight of a row that is negligible
# φ is not moved until a step of x is below NEAR u, for at most FAR_STEPS linearisations: until then residuals are far
# off.
NEAR, FAR_STEPS = 1.0, 2
SAME_MAXIMUM = 0.1  # distance in ℓ below a known maximum, per element of φ, from which an iteration leads there
LARGEST_RADIUS = 2.0  # Δ at first, and its upper limit
SECOND_ORDER = 10.0  # error after a step of Gauss–Newton over the square of the step, in units of the spreads
UNOBSERVED = 0.2  # rad: standard deviation above which a heading is not observed by the gyros
# Linearisations after which a heading that still moves is not observed, and weights of rows go half of the way.
DAMPED_FROM = 6
PLACE_UNKNOWN = 1e-3  # relative u of gravity of an unknown place, three times that of normal gravity anywhere
UNUSUAL = 3.0  # ratio of scatter or a size to the usual from which `maximise_from_starts` tries other starts
NOT_ABSORBING = "mag", "displacement", "displacement_time"  # elements of φ that do not absorb errors of sensors
ROUNDS = 3  # of readmitting outliers that others, now left out, have made
USELESS = {"turn": 0.3, "velocity": 3.0}  # rad and m/s: turns of such scatter have no information
WIDE_SIZES = 3.0  # prior standard deviations of p from which sizes of groups start
CHANGING_TIME = 3.0  # s: correlation time of biases that change at every rest


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Maximum:
    """Joint maximum of ℓ, or where the iteration ran out.

    Parameters
    ----------
    linearisation
        Last linearisation, with groups of usual size.
    hyperparameters
        Elements of φ.
    solution
        Solution and ℓ at the maximum, with priors of the sizes there.
    point
        Point after the last step.
    information, curvature : (D, D)
        Average information of ℓ, and B, minus its second derivative.
    increments
        Step of the parameters (m,) in each iteration.
    converged
        True if x and φ have settled, False if the steps ran out before.
    """

    linearisation: Linearisation
    hyperparameters: Hyperparameters
    solution: Solution
    point: Point
    information: Array
    curvature: Array
    increments: tuple[Array, ...]
    converged: bool

    @property
    def problem(self) -> Problem:
        """Problem with groups of the sizes at the maximum."""
        return self.solution.problem

    @property
    def phi(self) -> Array:
        """Hyperparameters (D,) at the maximum."""
        return self.solution.phi

    @property
    def components(self) -> VarianceComponents:
        """Components of variance at the maximum."""
        return self.solution.components


def maximise(
    start: Linearisation,
    phi: Array | None = None,
    iterations: int = MAX_ITERATIONS,
    robust: bool = False,
    known: Maximum | None = None,
) -> Maximum:
    """Find the φ that maximises ℓ(φ), linearising again until x and φ settle.

    Parameters
    ----------
    start
        First linearisation, with groups of usual size.
    phi : (D,)
        First φ; the centre of its prior if None, or if the problem has other elements.
    iterations
        Largest number of linearisations.
    robust
        True for residuals with a Student-t distribution (`tumble.inference.fits`).
    known
        An earlier maximum, returned as soon as the iteration approaches it from below to within SAME_MAXIMUM.
    """
    problem, linearisation = start.problem, start
    hyperparameters = hyperparameters_of(problem, start.noise, _estimable(solve(start, NO_COMPONENTS)))
    if phi is None or len(phi) != len(hyperparameters):
        phi = hyperparameters.centre
    increments, near, phi_settled, radius = list[Array](), False, False, LARGEST_RADIUS
    while True:
        solution = solution_at(linearisation, hyperparameters, phi)
        near = near or len(increments) >= FAR_STEPS or negligible(solution, NEAR)
        if near:
            solution, curvatures, radius, phi_settled = maximise_phi(hyperparameters, solution, radius)
        phi = solution.phi
        if known is not None and near and len(phi) == len(known.phi):
            offset, below = phi - known.phi, float(known.solution.log_posterior - solution.log_posterior)
            if max(below, 0.5 * float(offset @ known.information @ offset)) < SAME_MAXIMUM * len(phi) and below > 0.0:
                return known

        # Gauss–Newton step of x, to the point of the next linearisation
        point, change = take_step(solution, keep_headings=len(increments) >= DAMPED_FROM)
        increments.append(change)
        integrated, noise = reintegrated_turns(problem, point, linearisation.integrated), linearisation.noise
        weights = before = noise.weights
        if robust:
            of_rows, outliers = student_weights(chi_square_falls(solution)), left_out(start.noise.weights)
            least = outlier_weights(outliers)  # the scale of a Student-t distribution follows a fifth of the rows
            weights = before | {
                kind: np.where(outliers[kind] & (w < LEAST_WEIGHT), least[kind], w) for kind, w in of_rows.items()
            }
        weights_settled = all(np.all(np.abs(weights[kind] - w) < WEIGHT_CHANGE) for kind, w in before.items())
        if len(increments) >= DAMPED_FROM:  # so that two rows do not get the low weight alternately
            weights = {kind: 0.5 * (weights[kind] + w) for kind, w in before.items()}
        settled = negligible(solution) and integrated is linearisation.integrated and phi_settled and weights_settled
        if settled or len(increments) >= iterations:
            information, B = curvatures if near else derivatives(hyperparameters, solution)[1:]
            return Maximum(
                linearisation=linearisation,
                hyperparameters=hyperparameters,
                solution=solution,
                point=point,
                information=information,
                curvature=B,
                increments=tuple(increments),
                converged=settled,
            )
        linearisation = linearise(problem, point, integrated)
        linearisation = replace(linearisation, noise=linearisation.noise.weighted(weights))


def maximise_phi(
    hyperparameters: Hyperparameters, solution: Solution, radius: float = LARGEST_RADIUS
) -> tuple[Solution, tuple[Array, Array], float, bool]:
    """Maximise ℓ over φ at fixed residuals, by at most STEPS steps of a trust region.

    Parameters
    ----------
    hyperparameters, solution
        Elements of φ, and the first solution.
    radius
        Δ, the largest step.

    Returns
    -------
    solution, (information, B), radius
        Last solution, average information and minus the second derivative of ℓ there, and Δ.
    settled
        True if the expected gain of ℓ is below GAIN per element.
    """
    bounded, enough = hyperparameters.bounded, GAIN * max(1, len(hyperparameters))
    gradient, information, B = derivatives(hyperparameters, solution)
    for _ in range(STEPS):
        free = np.flatnonzero(~(bounded & (solution.phi <= 0.0) & (gradient <= 0.0)))
        step = np.zeros(len(gradient))
        step[free] = np.linalg.solve(B[np.ix_(free, free)], gradient[free])
        gain = 0.5 * float(gradient @ step)
        if not np.isfinite(gain):
            raise np.linalg.LinAlgError("a step of the hyperparameters is not finite")
        if gain < enough:
            break
        step *= min(1.0, radius / float(np.abs(step).max()))
        step = np.where(bounded, np.maximum(solution.phi + step, 0.0), solution.phi + step) - solution.phi
        expected = float(gradient @ step - 0.5 * step @ B @ step)
        tried = solution_at(solution.linearisation, hyperparameters, solution.phi + step)
        gained = float(tried.log_posterior - solution.log_posterior)
        poor = gained < 0.1 * expected or expected <= 0.0
        radius = 0.3 * float(np.abs(step).max()) if poor else min(2.0 * radius, LARGEST_RADIUS)
        if gained > 0.0:
            solution = tried
            gradient, information, B = derivatives(hyperparameters, solution)
    return solution, (information, B), radius, gain < enough


def maximise_from_starts(start: Linearisation, iterations: int = MAX_ITERATIONS) -> Maximum:
    """Return the highest of the maxima from several starts of φ.

    The first start is the centre of the prior. If it leads to scatter or sizes far beyond the usual, others follow:

    * turns of large scatter, because parameters and accelerometers may be blamed for spoilt turns;
    * groups far larger than usual, because scatter may have absorbed their effect;
    * if rests scatter, biases that change at every rest, with the bias of a turn that of the rest before or after."""
    best = maximise(start, iterations=iterations)
    if start.problem.observations.turns is None:
        return best
    hyperparameters, bias_after = best.hyperparameters, start.problem.bias_after
    sizes = {h.name: float(h.value(p)) for h, p in zip(hyperparameters, best.phi, strict=True)}
    absorbing = [h for h in hyperparameters if not (h.kind == "time" or h.name in NOT_ABSORBING)]
    far = [h for h in absorbing if sizes[h.name] > UNUSUAL * h.usual]
    starts = list[tuple[float, Array]]()  # `Problem.bias_after` and φ
    if any(h.kind in {"scatter", "group"} for h in far):
        useless_turns = [np.log(USELESS[h.name]) if h.name in USELESS else h.centre for h in hyperparameters]
        starts.append((bias_after, np.array(useless_turns)))
    groups = np.array([h.kind == "group" for h in hyperparameters], dtype=bool)
    if far and groups.any():
        wide_groups = np.where(groups, [WIDE_SIZES * h.within for h in hyperparameters], hyperparameters.centre)
        starts.append((bias_after, wide_groups))
    rests_scatter = any(h.name in REST_SCATTER and sizes[h.name] > h.usual for h in hyperparameters)
    if rests_scatter or any(h.kind == "process" for h in far):
        changing_biases = best.phi.copy()  # the scatter at rest is in their size
        for i, h in enumerate(hyperparameters):
            if h.name in NOT_ABSORBING:
                continue
            if h.kind == "time":
                changing_biases[i] = np.log(CHANGING_TIME)
            elif h.kind == "process":
                changing_biases[i] = np.log(np.hypot(sizes[h.name], sizes.get(h.name.removesuffix("_in_run"), 0.0)))
            elif h.name in REST_SCATTER:
                changing_biases[i] = h.centre
        shares = (0.0, 1.0) if len(start.problem.before_turn) else (bias_after,)
        starts += [(share, changing_biases) for share in shares]
    for share, phi in starts:
        known = best if share == best.linearisation.problem.bias_after else None
        first = start.again(replace(start.problem, bias_after=share), start.point)
        other = maximise(first, phi, iterations, known=known)
        if other.converged and other.solution.log_posterior > best.solution.log_posterior:
            best = other
    return best


def without_outliers(fitted: Maximum, iterations: int = MAX_ITERATIONS) -> Maximum:
    """Return the maximum without rests and turns that are outliers; `fitted` itself if there are none.

    If the largest distance is improbable, outliers are those of a robust maximum. The maximum without them is computed
    until all of them are outliers with respect to it, at most ROUNDS times."""
    before, outliers = left_out(fitted.linearisation.noise.weights), _outliers(fitted.solution)
    distances = np.concatenate([distance[~before[kind]] for kind, distance in sigmas(fitted.solution).items()])
    p_value = 2.0 * scipy.special.ndtr(-distances.max(initial=0.0)) * len(distances)
    confirmed = fitted.linearisation.noise.whole or _same(outliers, before)
    if confirmed and (not len(distances) or p_value > OUTLIER_PROBABILITY):
        return fitted
    robust = maximise(fitted.linearisation, fitted.phi, iterations, robust=True)
    outliers = _outliers(robust.solution)
    if confirmed and _same(outliers, before):
        return fitted
    for _ in range(ROUNDS):
        noise = robust.linearisation.noise.weighted(outlier_weights(outliers))
        robust = maximise(replace(robust.linearisation, noise=noise), robust.phi, iterations)
        still = {kind: outliers[kind] & out for kind, out in _outliers(robust.solution).items()}
        if _same(outliers, still):
            break
        outliers = still
    return robust


def _outliers(solution: Solution) -> dict[str, BoolArray]:
    """Return True, by kind of rows, for blocks (K,) so far from the fit that they are left out."""
    return left_out(student_weights(chi_square_falls(solution)))


def _same(outliers: dict[str, BoolArray], others: dict[str, BoolArray]) -> bool:
    return all(np.array_equal(out, others[kind]) for kind, out in outliers.items())


def _estimable(solution: Solution) -> BoolArray:
    """Return for each component (c,) of variance whether the fit leaves enough degrees of freedom to estimate it."""
    degrees = np.zeros(len(SCATTER))
    for _, _, C, WZ, component in solution.scatter:
        total, free = (WZ**2).sum(axis=1), (WZ * (C @ WZ)).sum(axis=1)
        degrees += np.bincount(component, (free / np.where(total > 0.0, total, 1.0)).sum(axis=0), len(degrees))
    return np.asarray(degrees > LEAST_DEGREES)


def negligible(solution: Solution, share: float = CONVERGED) -> bool:
    """Return True if the error expected after this step is below a `share` of u: Gauss–Newton squares it."""
    change = np.abs(_with_gravity_kept(solution)[0][1:])
    u = np.sqrt(solution.covariance.diagonal()[1:])
    after = change * min(1.0, SECOND_ORDER * float(np.max(change / solution.problem.spread)))
    return bool(np.all(after <= share * u + 1e-15))


def take_step(solution: Solution, keep_headings: bool = False) -> tuple[Point, Array]:
    """Return the point after the step of a solution, and the step of the parameters.

    The step is shortened so that no parameter moves by more than its spread. Without a magnetometer the mean heading of
    chains that the gyros hardly observe is kept, or of all chains with `keep_headings`."""
    problem, equations = solution.problem, solution.equations
    parameters, angles, local = _with_gravity_kept(solution)
    share = 1.0 / max(1.0, float(np.max(np.abs(parameters[1:]) / problem.spread)))
    angles, chain = share * angles, problem.chain
    # scaled by chi-square per row: a heading from residuals far above the Earth's rate would oscillate
    count = sum(rows.shape[0] * rows.shape[1] for rows in equations.rows.values())
    unobserved = np.bincount(chain, heading_information(solution)) < UNOBSERVED**-2 * max(1.0, solution.square / count)
    if (keep_headings or unobserved.any()) and problem.magnetometer is None:
        mean = np.bincount(chain, angles[:, 2]) / np.bincount(chain)
        angles[:, 2] -= np.where(unobserved | keep_headings, mean, 0.0)[chain]
    velocities = displacements = None
    if problem.moves:
        velocities = share * solution.unknowns[:, 3:6]
        displacements = solution.components.displacement * solution.states[:, -3:]
    point = solution.linearisation.point.moved(share * parameters, angles, share * local, velocities, displacements)
    return point, share * parameters[1:]


def _with_gravity_kept(solution: Solution) -> tuple[Array, Array, Array]:
    """Return the steps of gravity and the parameters (1 + m,), of the angles (N, 3) and of the session parameters.

    The gravity of an unknown place (u above PLACE_UNKNOWN) is not moved: readings determine only its product with the
    scale factors, along which steps would oscillate. Then the steps are those given gravity, δ − C_g δ_g / C_gg; the
    uncertainty of gravity stays in the covariance."""
    problem = solution.problem
    if float(problem.prior_u[0]) < PLACE_UNKNOWN * float(problem.prior_mean[0]):
        return solution.parameters, solution.angles, solution.local
    q, sensitivity = len(problem.local_u), solution.equations.sensitivity
    by_gravity = solution.parameters[0] / solution.covariance[0, 0]
    angles = [
        solution.angles[part.stations] - by_gravity * sensitivity[part.stations, :3, :-1] @ along
        for part, along in zip(problem.session_spans, solution.session_covariances[:, :, q], strict=True)
    ]
    local = solution.local - by_gravity * solution.session_covariances[:, :q, q]
    return solution.parameters - by_gravity * solution.covariance[:, 0], np.concatenate(angles), local


def heading_information(solution: Solution) -> Array:
    """Return the heading information (M,), rad⁻², of the gyros at each station and in the turn or link after it.

    A turn has information only on the common heading of both its stations."""
    equations, problem = solution.equations, solution.problem
    d, information = equations.unknowns, np.zeros(len(problem.chain))
    for kind, rows in equations.rows.items():
        by_heading = rows[:, :, 2] if STATIONS[kind] == 1 else rows[:, :, 2] + rows[:, :, d + 2]
        information[problem.first_station[kind]] += (by_heading**2).sum(axis=1)
    return information


def reintegrated_turns(problem: Problem, point: Point, integrated: IntegratedTurns | None) -> IntegratedTurns | None:
    """Return the turns, integrated again if parameters have moved too far since the last integration."""
    if integrated is None:
        return None
    changes = problem.coefficient_changes(point)
    gyros = slice(problem.instrument.accel.size, None)
    if changes is not None and integrated.are_small(changes[:, gyros], problem.noise_of_turns):
        changes = None
    gyro_changes = 0.0 if changes is None else changes[:, gyros]
    links_good = integrated.links is None or integrated.links.valid_at(
        problem.instrument, point.values, problem.noise_of_parts
    )
    if links_good and integrated.valid_at(problem.instrument, point.values, problem.noise_of_turns, gyro_changes):
        return integrated
    return IntegratedTurns.of(problem.observations, problem.instrument, point.values, changes)
