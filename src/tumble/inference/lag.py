"""The lags of the sensors behind their thermometers, and the spread they leave in all parameters.

Accelerometers and gyros have a lag each: they may be chips apart from the thermometer and from each other. Everything
else is linear, or nearly so, once the lags are known, which multiply the coefficients over temperature: the likelihood
has several minima over a lag, where the temperature hardly bends none that Gauss–Newton finds. So the estimate holds
the likeliest lags, and in the end the probability of each lag λ is summed over a grid.

A lag matters as far as anything changes with temperature. Where nothing does, any lag fits, and a large one best: with
it the sensors have hardly become warmer, and parameters at the temperature of the thermometer would be far from all
that was observed. So there are two hypotheses, as likely beforehand: the coefficients c over temperature of a kind of
sensor are of usual size, c ~ N(0, S) and λ ~ N(0, s²), or they are zero. With the solution θ(λ), of covariance C(λ),
the odds of the first with a lag are those of the density of c = 0 before and after (Savage and Dickey),

    O(λ) = (|C_c|/|S|)^½ exp(½ cᵀ C_c⁻¹ c),    P = ∫ p(λ) O(λ) dλ / (1 + ∫ p(λ) O(λ) dλ)

and with λ̄ = P E λ, θ₀ and C₀ of the second hypothesis, and the mean over the lags of the first

    C = (1 − P) [C₀ + (θ₀ − θ(λ̄))(θ₀ − θ(λ̄))ᵀ] + P E[C(λ) + (θ(λ) − θ(λ̄))(θ(λ) − θ(λ̄))ᵀ]

but no less than C(λ̄): docs/explanation/mathematics.md (35).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy

from tumble.inference.hyperparameters import restricted_likelihood
from tumble.inference.integral import conditional, coverage_factors
from tumble.inference.linearisation import Linearisation, linearise
from tumble.inference.maximum import Maximum, likeliest, maximum
from tumble.inference.normal_equations import Solution
from tumble.inference.problem import Problem
from tumble.sensors.parameters import THERMAL, sensor_kind, variable_of
from tumble.units import Array

LAGS = (-100.0, -25.0, 0.0, 10.0, 25.0, 50.0, 100.0, 200.0, 400.0, 800.0)
"""s: time constants of the sensors behind the thermometer from which the best is sought."""
_APART = np.concatenate([[0.5], 2.0 ** np.arange(0.0, 10.5)])
LAGS_ABOUT = np.concatenate([-_APART[::-1], [0.0], _APART])
"""s: from the lag that is held, where its likelihood is taken at first."""
RESOLVED, HALVINGS = 0.2, 10
"""Largest probability of one lag of a grid that resolves the likelihood, half a standard deviation of a Gaussian from
the next, and how often steps beside likelier ones are halved at most."""
LAG_ROUNDS = 3
"""Solutions with lags of which each shows the one before to be wrong, at most."""


def maximum_with_lags(start: Linearisation, iterations: int) -> tuple[Maximum, Array]:
    """The maximum with the likeliest lags, which are held, and the covariance (m, m) that they leave.

    Parameters
    ----------
    start
        The linearisation to begin from, of a session with or without lags among its parameters.
    iterations
        Linearisations at most.

    Returns
    -------
    maximum
        That with the lags λ̄.
    spread
        By how much the covariance (m, m) of the parameters is greater because the lags are not known.
    """
    problem = start.problem
    lags, spread = problem.lags, np.zeros((len(problem.instrument.names),) * 2)
    if not lags:
        return likeliest(start, iterations), spread
    usual = {kind: problem.observations.usual[f"{kind}.lag"] for kind in lags}

    def held(values: Array, near: Linearisation) -> Linearisation:
        """The linearisation where the lags are known to be those among values (m,)."""
        there = linearise(free.with_lags(values), replace(near.point, values=values), near.about)
        return replace(there, noise=there.noise.weighted(*near.noise.weights))

    def with_lag(values: Array, kind: str, lag: float) -> Array:
        out = values.copy()
        out[lags[kind]] = lag
        return out

    def penalty(kind: str, lag: Array) -> Array:
        """−2 ln of the prior of a lag."""
        return np.asarray((lag / usual[kind]) ** 2)

    def again(values: Array) -> Maximum:
        return maximum(held(values, replace(fitted.linearisation, point=fitted.point)), fitted.phi, iterations)

    def with_lags(phi: Array, kind: str, tried: Array) -> list[Solution]:
        """The solutions at φ with lags of a kind."""
        near = replace(fitted.linearisation, point=fitted.point)
        every = (held(with_lag(fitted.point.values, kind, lag), near) for lag in tried.tolist())
        return [restricted_likelihood(there, fitted.hyperparameters, phi) for there in every]

    def likelihood(phi: Array, kind: str) -> Callable[[Array], tuple[Array, Array]]:
        """−2 ln of the posterior of lags."""

        def at_lags(tried: Array) -> tuple[Array, Array]:
            value = np.array([each.log_posterior for each in with_lags(phi, kind, tried)])
            return penalty(kind, tried) - 2.0 * value, tried

        return at_lags

    def solutions(kind: str) -> Callable[[Array], tuple[Array, Array]]:
        """The same at the φ of the maximum, with covariances and values (L, m, m + 1) of the parameters."""

        def at_lags(tried: Array) -> tuple[Array, Array]:
            every = [conditional(each) for each in with_lags(fitted.phi, kind, tried)]
            value = np.array([each.value for each in every])
            values = fitted.point.values
            both = np.array([np.column_stack([each.covariance[1:, 1:], values + each.step[1:]]) for each in every])
            return penalty(kind, tried) - 2.0 * value, both

        return at_lags

    def goodness(fit: Maximum) -> float:
        """ln of the posterior of φ and the lags."""
        return float(fit.solution.log_posterior) - 0.5 * sum(
            float(penalty(kind, fit.point.values[i])) for kind, i in lags.items()
        )

    free = problem
    fitted = likeliest(held(start.point.values, start), iterations)
    free = replace(problem, bias_after=fitted.problem.bias_after)
    tried = {tuple(fitted.point.values[list(lags.values())])}
    centre = np.array([h.centre for h in fitted.hyperparameters])
    for _ in range(LAG_ROUNDS):
        candidates = []
        for phi in (fitted.phi, centre):  # the first may hide another maximum
            values = fitted.point.values
            for kind in lags:
                grid, weight, _ = resolved(likelihood(phi, kind), np.array(LAGS))
                values = with_lag(values, kind, float(grid[np.argmax(weight / np.gradient(grid))]))
            key = tuple(values[list(lags.values())])
            if key not in tried:
                tried.add(key)
                candidates.append(values)
        best = max([fitted, *map(again, candidates)], key=goodness)
        if best is fitted:
            break
        fitted = best
    means, prior_u = fitted.point.values.copy(), fitted.problem.prior_u[1:]
    others = np.delete(np.arange(len(means)), list(lags.values()))
    for kind, i in lags.items():
        at_lags, own = solutions(kind), coefficients(fitted.problem, kind)
        grid, weight, found = resolved(at_lags, fitted.point.values[i] + LAGS_ABOUT)
        prior = np.exp(-0.5 * penalty(kind, grid)) * np.gradient(grid)
        log_odds = [log_odds_of_change(each[own][:, [*own, -1]], prior_u[own]) for each in found]
        change = float(scipy.special.expit(scipy.special.logsumexp(log_odds, b=prior / prior.sum())))
        means[i] = change * float(weight @ grid)
        spread[i, i] = weight @ (grid - means[i]) ** 2
        (held_one,) = at_lags(means[[i]])[1]
        every = np.vstack([without(held_one, own)[None], found])[:, others][:, :, [*others, -1]]
        more = greater_by(every, held_one[others][:, [*others, -1]], np.append(1.0 - change, change * weight))
        spread[np.ix_(others, others)] += more
    return again(means), spread


def without(solution: Array, own: list[int]) -> Array:
    """A solution, its covariance and its values (m, m + 1), where the parameters at `own` are zero."""
    return solution - solution[:, own] @ np.linalg.solve(solution[np.ix_(own, own)], solution[own])


def greater_by(every: Array, held: Array, weight: Array) -> Array:
    """By how much the covariance (m, m) of a mixture of solutions is greater than that of the one which is held: of
    each the covariance and the values, (L, m, m + 1) and (m, m + 1), and the probability (L,). u is half the half width
    of the mixture at 95.45 % where that is less than its standard deviation, as in the integral, and not less than that
    of the one that is held."""
    off, before = (every - held)[:, :, -1], np.diag(held)
    more = np.tensordot(weight, every[:, :, :-1] - held[:, :-1], axes=1) + (off.T * weight) @ off
    size = np.sqrt(np.abs(np.diag(more)))
    size[size == 0.0] = 1.0
    value, vectors = np.linalg.eigh(more / np.outer(size, size))
    more = (vectors * np.maximum(value, 0.0)) @ vectors.T * np.outer(size, size)
    after = before + np.diag(more)
    u = np.sqrt(np.maximum(np.diagonal(every, axis1=1, axis2=2), 1e-6 * before))
    after *= np.minimum(0.5 * coverage_factors(off, u, weight, np.sqrt(after)), 1.0) ** 2
    share = np.sqrt(np.maximum(after - before, 0.0) / np.maximum(np.diag(more), 1e-300))
    return np.asarray(more * np.outer(share, share))


def coefficients(problem: Problem, kind: str) -> list[int]:
    """Where the coefficients over temperature of a kind of sensor stand among the parameters."""
    names = problem.instrument.names
    return [i for i, name in enumerate(names) if sensor_kind(name) == kind and variable_of(name) in THERMAL]


def log_odds_of_change(found: Array, sizes: Array) -> float:
    """ln of the odds that coefficients are as large as is usual rather than zero, where both were as likely beforehand:
    the density of zero by the prior, of standard deviations `sizes` (k,), over that afterwards, by covariance and
    values (k, k + 1) (Savage and Dickey)."""
    covariance, values = found[:, :-1] / np.outer(sizes, sizes), found[:, -1] / sizes
    return 0.5 * float(values @ np.linalg.solve(covariance, values) + np.linalg.slogdet(covariance)[1])


def resolved(at_lags: Callable[[Array], tuple[Array, Array]], lags: Array) -> tuple[Array, Array, Array]:
    """Lags in ascending order, their probabilities, and the solutions with them
    (L, …), of −2 ln likelihood and solutions `at_lags`: those of a first grid, and between them as many as resolve the
    likelihood, which may be narrow, and steep to one side."""
    deviance, moved_by = at_lags(lags)
    for halved in range(HALVINGS + 1):
        weight = np.exp(-0.5 * (deviance - deviance.min())) * np.gradient(lags)
        weight /= weight.sum()
        if weight.max() < RESOLVED or halved == HALVINGS:
            break
        heavy = weight > 0.1 * RESOLVED
        between = np.flatnonzero(heavy[1:] | heavy[:-1])
        more = 0.5 * (lags[between] + lags[between + 1])
        others, moved_others = at_lags(more)
        lags, deviance = np.insert(lags, between + 1, more), np.insert(deviance, between + 1, others)
        moved_by = np.insert(moved_by, between + 1, moved_others, axis=0)
    return lags, weight, moved_by
