"""Lags of the sensor temperatures behind their thermometers, and the covariance that they add to all parameters.

Accelerometers and gyros have one lag each, because they may be separate chips. Given the lags the problem is linear, or
nearly so, in everything else; they multiply the temperature coefficients, so that the likelihood has several maxima
over a lag, or none that Gauss–Newton finds if the temperature is almost linear in time. The estimate therefore holds
the most likely lags, and the posterior of each lag λ is integrated on a grid, with the hyperparameters maximised at
each lag.

A lag is not negative. A die follows a thermometer on it within a second, one in the package or on the board within
seconds to some tens of seconds, and an instrument follows one in its housing within minutes. No file states which it
is, but both kinds of sensors are in one housing. Each lag is therefore exponential with a rate r that both share, which
has a gamma distribution of shape 3 and mean 3/2s. With x = λ/2s, and x′ of the other kind, the prior is

    p(x) = 3 (1 + x)⁻⁴,    p(x | x′) = 4 (1 + x′)⁴ (1 + x + x′)⁻⁵,    λ ≥ 0                                          (1)

with mean λ = s, a tenth of it beyond 2.3 s and a hundredth beyond 7.3 s: lags of minutes are accepted if the data of a
kind support them, or those of the other. Where the data of the other kind say nothing, p(x | x′) averages to p(x).

A lag matters only if something changes with temperature. If nothing does, every lag fits, and large ones best: the
sensors have then hardly warmed up, and parameters at the temperature of the thermometer are extrapolated far from the
observations. Hence there are two hypotheses of equal prior probability: the temperature coefficients c of a kind of
sensor have usual sizes, c ~ N(0, S), and λ has the prior (1); or they are zero. With the solution θ(λ) of covariance
C(λ), the odds of the first at a lag are the ratio of the prior to the posterior density at c = 0 (Savage–Dickey),

    O(λ) = (|C_c|/|S|)^½ exp(½ cᵀ C_c⁻¹ c),    P = ∫ p(λ) O(λ) dλ / (1 + ∫ p(λ) O(λ) dλ)

and with λ̄ = P E λ, θ₀ and C₀ of the second hypothesis, and E the mean over the lags of the first,

    C = (1 − P) [C₀ + (θ₀ − θ(λ̄))(θ₀ − θ(λ̄))ᵀ] + P E[C(λ) + (θ(λ) − θ(λ̄))(θ(λ) − θ(λ̄))ᵀ]

but not less than C(λ̄), docs/explanation/mathematics.md (35).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy

from tumble.inference.hyperparameters import solution_at
from tumble.inference.integral import coverage_factors
from tumble.inference.linearisation import Linearisation
from tumble.inference.maximum import Maximum, maximise, maximise_from_starts, maximise_phi
from tumble.inference.problem import Problem
from tumble.sensors.parameters import THERMAL, sensor_kind, variable_of
from tumble.units import Array

LAGS = np.array([0.0, 5.0, 10.0, 25.0, 50.0, 100.0, 200.0, 400.0, 800.0, 1600.0])  # s: first grid
NEAR = 0.3  # largest distance of the most likely lag from the one held, in standard deviations
# Largest probability of a point of a resolved grid, half a standard deviation of a Gaussian from the next, and largest
# number of halvings of the steps.
RESOLVED, HALVINGS = 0.2, 10
LAG_ROUNDS = 3  # largest number of times the lags held are changed


def maximum_with_lags(start: Linearisation, iterations: int) -> tuple[Maximum, Array]:
    """Find the maximum of ℓ(φ), with lags held at their means if there are any.

    Parameters
    ----------
    start
        First linearisation, of a session with or without lags among its parameters.
    iterations
        Largest number of linearisations.

    Returns
    -------
    maximum
        Maximum at the lags λ̄.
    spread : (m, m)
        Covariance of the parameters added by the uncertainty of the lags.
    """
    lags, spread = start.problem.lag_places, np.zeros((len(start.problem.instrument.names),) * 2)
    if not lags:
        return maximise_from_starts(start, iterations), spread
    usual = {kind: start.problem.observations.usual[f"{kind}.lag"] for kind in lags}

    def held(values: Array, near: Linearisation) -> Linearisation:
        """Return the linearisation with lags held at those among values (m,)."""
        return near.again(near.problem.with_held_lags(values), replace(near.point, values=values))

    def again(values: Array) -> Maximum:
        return maximise(held(values, replace(fitted.linearisation, point=fitted.point)), fitted.phi, iterations)

    def penalty(kind: str, lag: Array) -> Array:
        """Return −2 ln of the prior of a lag, Eq. (1)."""
        return np.asarray(-2.0 * np.log(prior_density(0.5 * lag / usual[kind])))

    def solutions(kind: str) -> Callable[[Array], tuple[Array, Array]]:
        """Return a function of lags (L,) that returns −2 ln of their posterior, and the solutions (L, m, m + 1) there:
        covariances and values of the parameters. φ starts from an interpolation between the lags computed before."""
        values, i = fitted.point.values, lags[kind]
        here = held(values, replace(fitted.linearisation, point=fitted.point))
        phi_at = {float(values[i]): fitted.phi}

        def at(grid: Array) -> tuple[Array, Array]:
            deviance, out = penalty(kind, grid), np.empty((len(grid), len(values), len(values) + 1))
            for k in np.argsort(np.abs(grid - values[i])):
                lag, at_lag = float(grid[k]), values.copy()
                at_lag[i] = lag
                there = here.with_lags(here.problem.with_held_lags(at_lag), at_lag)
                known_lags, known_phi = zip(*sorted(phi_at.items()), strict=True)
                phi = np.array([np.interp(lag, known_lags, element) for element in np.transpose(known_phi)])
                solution = solution_at(there, fitted.hyperparameters, phi)
                solution, *_ = maximise_phi(fitted.hyperparameters, solution)
                phi_at[lag] = solution.phi
                deviance[k] -= 2.0 * solution.log_posterior
                out[k, :, :-1] = solution.session_covariance[1:, 1:]
                out[k, :, -1] = values + solution.session_step[1:]
            return deviance, out

        return at

    def log_posterior(fit: Maximum) -> float:
        """Return ln of the posterior of φ and the lags."""
        penalties = [float(penalty(kind, fit.point.values[i])) for kind, i in lags.items()]
        return float(fit.solution.log_posterior) - 0.5 * sum(penalties)

    fitted = maximise_from_starts(held(start.point.values, start), iterations)
    for rounds_left in reversed(range(LAG_ROUNDS)):
        at_lags = {kind: solutions(kind) for kind in lags}
        grids = {kind: resolved(at_lags[kind], LAGS) for kind in lags}
        values, moved = fitted.point.values.copy(), False
        for kind, (grid, weight, _) in grids.items():
            values[lags[kind]] = grid[np.argmax(weight / widths(grid))]
            u = np.sqrt(weight @ (grid - weight @ grid) ** 2)
            moved |= abs(values[lags[kind]] - fitted.point.values[lags[kind]]) > NEAR * u
        if not (rounds_left and moved):
            break
        moved_fit = again(values)
        if log_posterior(moved_fit) <= log_posterior(fitted):
            break
        fitted = moved_fit
    means, prior_u = fitted.point.values.copy(), fitted.problem.prior_u[1:]
    others = np.delete(np.arange(len(means)), list(lags.values()))
    log_odds, alone = dict[str, list[float]](), dict[str, tuple[Array, Array, float]]()
    for kind, (grid, weight, at_grid) in grids.items():
        thermal, x = coefficients(fitted.problem, kind), 0.5 * grid / usual[kind]
        log_odds[kind] = [log_odds_of_change(found[thermal][:, [*thermal, -1]], prior_u[thermal]) for found in at_grid]
        alone[kind] = x, weight, probability_of_change(log_odds[kind], prior_density(x) * widths(grid))
    for kind, i in lags.items():
        (grid, weight, at_grid), thermal, x = grids[kind], coefficients(fitted.problem, kind), alone[kind][0]
        prior = prior_density(x, *(found for other, found in alone.items() if other != kind))
        weight = weight * prior / prior_density(x)
        weight /= weight.sum()
        change = probability_of_change(log_odds[kind], prior * widths(grid))
        means[i] = change * float(weight @ grid)
        spread[i, i] = weight @ (grid - means[i]) ** 2
        (at_mean,) = at_lags[kind](means[[i]])[1]
        mixture = np.vstack([without(at_mean, thermal)[None], at_grid])[:, others][:, :, [*others, -1]]
        probability = np.append(1.0 - change, change * weight)
        added = added_covariance(mixture, at_mean[others][:, [*others, -1]], probability)
        spread[np.ix_(others, others)] += added
    return again(means), spread


def without(solution: Array, places: list[int]) -> Array:
    """Return a solution (m, m + 1), covariance and values, given that the parameters at `places` are zero."""
    return solution - solution[:, places] @ np.linalg.solve(solution[np.ix_(places, places)], solution[places])


def added_covariance(solutions: Array, held: Array, weight: Array) -> Array:
    """Return the covariance (m, m) of a mixture of solutions less that of the solution with the lag held.

    `solutions` (L, m, m + 1) and `held` (m, m + 1) are covariances and values, `weight` (L,) probabilities. u of the
    mixture is limited to half its half width at 95.45 %, as in the integral, and is not less than that of `held`."""
    offset, before = (solutions - held)[:, :, -1], np.diag(held)
    more = np.tensordot(weight, solutions[:, :, :-1] - held[:, :-1], axes=1) + (offset.T * weight) @ offset
    size = np.sqrt(np.abs(np.diag(more)))
    size[size == 0.0] = 1.0
    value, vectors = np.linalg.eigh(more / np.outer(size, size))
    more = (vectors * np.maximum(value, 0.0)) @ vectors.T * np.outer(size, size)
    after = before + np.diag(more)
    u = np.sqrt(np.maximum(np.diagonal(solutions, axis1=1, axis2=2), 1e-6 * before))
    after *= np.minimum(0.5 * coverage_factors(offset, u, weight, np.sqrt(after)), 1.0) ** 2
    share = np.sqrt(np.maximum(after - before, 0.0) / np.maximum(np.diag(more), 1e-300))
    return np.asarray(more * np.outer(share, share))


def coefficients(problem: Problem, kind: str) -> list[int]:
    """Return the places of the temperature coefficients of a kind of sensor among the parameters."""
    names = problem.instrument.names
    return [i for i, name in enumerate(names) if sensor_kind(name) == kind and variable_of(name) in THERMAL]


def log_odds_of_change(solution: Array, sizes: Array) -> float:
    """Return ln of the Savage–Dickey odds that coefficients have usual `sizes` (k,) rather than being zero.

    `solution` (k, k + 1) are their covariance and values; both hypotheses have equal prior probability."""
    covariance, values = solution[:, :-1] / np.outer(sizes, sizes), solution[:, -1] / sizes
    return 0.5 * float(values @ np.linalg.solve(covariance, values) + np.linalg.slogdet(covariance)[1])


def probability_of_change(log_odds: list[float], prior: Array) -> float:
    """Return P from the odds O (L,) of a change at lags of relative `prior` probabilities (L,)."""
    return float(scipy.special.expit(scipy.special.logsumexp(log_odds, b=prior / prior.sum())))


def prior_density(x: Array, *others: tuple[Array, Array, float]) -> Array:
    """Return the prior density of lags x (L,), in units of 2s, given the posteriors of those of other kinds, Eq. (1).

    Each posterior is lags (M,) with their probabilities (M,) and the probability P that the kind changes at all."""
    density = np.asarray(3.0 * (1.0 + x) ** -4)
    for other, weight, change in others:
        given = 4.0 * (1.0 + other) ** 4 * (1.0 + other + x[:, None]) ** -5
        density = (1.0 - change) * density + change * (given @ weight)
    return density


def widths(lags: Array) -> Array:
    """Return the weights (L,) of the trapezoidal rule for ascending lags."""
    step = np.diff(lags)
    return np.asarray(0.5 * (np.append(step, 0.0) + np.append(0.0, step)))


def resolved(at_lags: Callable[[Array], tuple[Array, Array]], lags: Array) -> tuple[Array, Array, Array]:
    """Refine a grid of lags until none has a probability above RESOLVED, or HALVINGS times.

    `at_lags` returns −2 ln of the likelihood of lags (L,) and the solutions there (L, …). Returns the lags in ascending
    order, their probabilities, and their solutions."""
    deviance, solutions = at_lags(lags)
    for halved in range(HALVINGS + 1):
        weight = np.exp(-0.5 * (deviance - deviance.min())) * widths(lags)
        weight /= weight.sum()
        if weight.max() < RESOLVED or halved == HALVINGS:
            break
        heavy = weight > 0.1 * RESOLVED
        between = np.flatnonzero(heavy[1:] | heavy[:-1])
        middle = 0.5 * (lags[between] + lags[between + 1])
        middle_deviance, middle_solutions = at_lags(middle)
        lags, deviance = np.insert(lags, between + 1, middle), np.insert(deviance, between + 1, middle_deviance)
        solutions = np.insert(solutions, between + 1, middle_solutions, axis=0)
    return lags, weight, solutions
