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
sensor have usual sizes, c ~ N(0, S), and λ has the prior (1); or they are zero. The odds O(λ) of the first at a lag are
the ratio of the prior to the posterior density at c = 0 (Savage–Dickey), and its probability P that with the mean of
O over the prior; docs/explanation/mathematics.md (35) has λ̄ and the covariance of this mixture.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy

from tumble.inference.hyperparameters import solution_at
from tumble.inference.integral import coverage_factors
from tumble.inference.linearisation import Linearisation
from tumble.inference.maximum import Maximum, maximise, maximise_from_starts, maximise_phi
from tumble.inference.problem import Point, Problem
from tumble.sensors.parameters import THERMAL, sensor_kind, variable_of
from tumble.units import Array

LAGS = np.array([0.0, 5.0, 10.0, 25.0, 50.0, 100.0, 200.0, 400.0, 800.0, 1600.0])  # s: first grid
NEAR = 0.3  # largest distance of the most likely lag from the one held, in standard deviations
# Largest probability of a point of a resolved grid, half a standard deviation of a Gaussian from the next, and largest
# number of halvings of the steps.
RESOLVED, HALVINGS = 0.2, 10
LAG_ROUNDS = 3  # largest number of times the lags held are changed


class LagGrid(NamedTuple):
    """Posterior of the lag of one kind of sensor at lags (L,), s: their probabilities (L,), and covariances and values
    of the parameters at each (L, m, m + 1)."""

    lags: Array
    probability: Array
    solutions: Array


def maximum_with_lags(start: Linearisation, iterations: int) -> tuple[Maximum, Array]:
    """Find the maximum of ℓ(φ), with lags held at their means if there are any.

    The most likely lags are found first: the posterior of each lag is computed on a grid with the other held, and the
    maximum again with the most likely lags, until they no longer move or ℓ does not rise, or after LAG_ROUNDS rounds.

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
    m, lag_places = len(start.problem.instrument.names), start.problem.lag_places
    if not lag_places:
        return maximise_from_starts(start, iterations), np.zeros((m, m))
    fitted = maximise_from_starts(with_held_lags(start, start.point, start.point.values), iterations)
    for rounds_left in reversed(range(LAG_ROUNDS)):
        at_lags = {kind: SolutionsAtLags(fitted, kind) for kind in lag_places}
        grids = {kind: resolved(at_lags[kind], LAGS) for kind in lag_places}
        values, moved = fitted.point.values.copy(), False
        for kind, (lags, probability, _) in grids.items():
            place = lag_places[kind]
            values[place] = lags[np.argmax(probability / widths(lags))]
            u = np.sqrt(probability @ (lags - probability @ lags) ** 2)
            moved |= abs(values[place] - fitted.point.values[place]) > NEAR * u
        if not (rounds_left and moved):
            break
        at_most_likely = _maximum_at(fitted, values, iterations)
        if _log_posterior(at_most_likely) <= _log_posterior(fitted):
            break
        fitted = at_most_likely
    values, spread = _averaged(fitted, at_lags, grids)
    return _maximum_at(fitted, values, iterations), spread


def with_held_lags(linearisation: Linearisation, point: Point, values: Array) -> Linearisation:
    """Linearise again at the parameters `values` (m,) and the attitudes of a point, with the lags held there."""
    return linearisation.again(linearisation.problem.with_held_lags(values), replace(point, values=values))


def _maximum_at(fitted: Maximum, values: Array, iterations: int) -> Maximum:
    """Return the maximum with the lags held at those among the parameters `values` (m,)."""
    return maximise(with_held_lags(fitted.linearisation, fitted.point, values), fitted.phi, iterations)


def _prior_deviance(problem: Problem, kind: str, lags: Array) -> Array:
    """Return −2 ln of the prior of lags of a kind of sensor, Eq. (1)."""
    return np.asarray(-2.0 * np.log(prior_density(0.5 * lags / problem.observations.usual[f"{kind}.lag"])))


def _log_posterior(fitted: Maximum) -> float:
    """Return ln of the posterior of φ and the lags."""
    problem, values = fitted.problem, fitted.point.values
    deviances = [float(_prior_deviance(problem, kind, values[i])) for kind, i in problem.lag_places.items()]
    return float(fitted.solution.log_posterior) - 0.5 * sum(deviances)


class SolutionsAtLags:
    """Solutions with another lag of one kind of sensor, φ being maximised at each.

    φ starts from an interpolation between the lags computed before."""

    def __init__(self, fitted: Maximum, kind: str) -> None:
        self.fitted, self.kind, self.place = fitted, kind, fitted.problem.lag_places[kind]
        self.held = with_held_lags(fitted.linearisation, fitted.point, fitted.point.values)
        self.phi_at = {float(fitted.point.values[self.place]): fitted.phi}

    def __call__(self, lags: Array) -> tuple[Array, Array]:
        """Return −2 ln of the posterior of lags (L,), s, and the solutions of `LagGrid` there."""
        values, hyperparameters = self.fitted.point.values, self.fitted.hyperparameters
        deviance = _prior_deviance(self.fitted.problem, self.kind, lags)
        solutions = np.empty((len(lags), len(values), len(values) + 1))
        for k in np.argsort(np.abs(lags - values[self.place])):
            lag, with_lag = float(lags[k]), values.copy()
            with_lag[self.place] = lag
            there = self.held.with_lags(self.held.problem.with_held_lags(with_lag), with_lag)
            known_lags, known_phi = zip(*sorted(self.phi_at.items()), strict=True)
            phi = np.array([np.interp(lag, known_lags, element) for element in np.transpose(known_phi)])
            solution, *_ = maximise_phi(hyperparameters, solution_at(there, hyperparameters, phi))
            self.phi_at[lag] = solution.phi
            deviance[k] -= 2.0 * solution.log_posterior
            solutions[k, :, :-1] = solution.session_covariance[1:, 1:]
            solutions[k, :, -1] = values + solution.session_step[1:]
        return deviance, solutions


def _averaged(
    fitted: Maximum, at_lags: Mapping[str, SolutionsAtLags], grids: Mapping[str, LagGrid]
) -> tuple[Array, Array]:
    """Return the parameters (m,) with the mean lags λ̄, and the covariance (m, m) that the lags add, (35)."""
    problem, values = fitted.problem, fitted.point.values.copy()
    spread, prior_u = np.zeros((len(values), len(values))), problem.prior_u[1:]
    others = np.delete(np.arange(len(values)), list(problem.lag_places.values()))
    log_odds, marginals = dict[str, list[float]](), dict[str, tuple[Array, Array, float]]()
    for kind, (lags, probability, solutions) in grids.items():
        thermal, x = coefficients(problem, kind), 0.5 * lags / problem.observations.usual[f"{kind}.lag"]
        log_odds[kind] = [log_odds_of_change(each[thermal][:, [*thermal, -1]], prior_u[thermal]) for each in solutions]
        change = probability_of_change(log_odds[kind], prior_density(x) * widths(lags))
        marginals[kind] = x, probability, change
    for kind, place in problem.lag_places.items():
        (lags, probability, solutions), (x, _, _) = grids[kind], marginals[kind]
        # the prior of this lag given the posterior of the lag of the other kind
        prior = prior_density(x, *(marginal for other, marginal in marginals.items() if other != kind))
        probability = probability * prior / prior_density(x)
        probability /= probability.sum()
        change = probability_of_change(log_odds[kind], prior * widths(lags))
        values[place] = change * float(probability @ lags)
        spread[place, place] = probability @ (lags - values[place]) ** 2
        (at_mean,) = at_lags[kind](values[[place]])[1]
        unchanged = without(at_mean, coefficients(problem, kind))
        mixture = np.vstack([unchanged[None], solutions])[:, others][:, :, [*others, -1]]
        weight = np.append(1.0 - change, change * probability)
        spread[np.ix_(others, others)] += added_covariance(mixture, at_mean[others][:, [*others, -1]], weight)
    return values, spread


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


def resolved(at_lags: Callable[[Array], tuple[Array, Array]], lags: Array) -> LagGrid:
    """Refine a grid of ascending lags (L,) until none has a probability above RESOLVED, or HALVINGS times.

    `at_lags` returns −2 ln of the posterior of lags, and the solutions there (L, …)."""
    deviance, solutions = at_lags(lags)
    for halvings_left in reversed(range(HALVINGS + 1)):
        probability = np.exp(-0.5 * (deviance - deviance.min())) * widths(lags)
        probability /= probability.sum()
        if probability.max() < RESOLVED or not halvings_left:
            break
        likely = probability > 0.1 * RESOLVED
        between = np.flatnonzero(likely[1:] | likely[:-1])
        middle = 0.5 * (lags[between] + lags[between + 1])
        middle_deviance, middle_solutions = at_lags(middle)
        lags, deviance = np.insert(lags, between + 1, middle), np.insert(deviance, between + 1, middle_deviance)
        solutions = np.insert(solutions, between + 1, middle_solutions, axis=0)
    return LagGrid(lags, probability, solutions)
