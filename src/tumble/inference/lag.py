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

and with λ̄ = P E λ and the mean over the lags of the first hypothesis (docs/explanation/mathematics.md (35))

    C = (1 − P) C(λ̄) + P E[C(λ) + (θ(λ) − θ(λ̄))(θ(λ) − θ(λ̄))ᵀ]
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy

from tumble.inference.hyperparameters import components_of
from tumble.inference.integral import coverage_factors
from tumble.inference.likelihood import Problem
from tumble.inference.maximum import At, Maximum, likeliest, maximum
from tumble.inference.noise_components import Components
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


def maximum_with_lags(problem: Problem, at: At, iterations: int) -> tuple[Maximum, Array]:
    """The maximum with the likeliest lags, which are held, and the covariance (m, m) that they leave.

    Parameters
    ----------
    problem
        The session, with or without lags among its parameters.
    at
        The linearisation to begin from.
    iterations
        Linearisations at most.

    Returns
    -------
    maximum
        That with the lags λ̄.
    spread
        By how much the covariance (m, m) of the parameters is greater because the lags are not known.
    """
    lags, spread = problem.lags, np.zeros((len(problem.instrument.names),) * 2)
    if not lags:
        return likeliest(problem, at, iterations), spread
    usual = {kind: problem.observations.usual[f"{kind}.lag"] for kind in lags}

    def held(values: Array, sizes: Problem, near: At) -> tuple[Problem, At]:
        """The problem with the lags among values (m,), and the linearisation there."""
        known = sizes.with_lags(values)
        return known, At.of(known, replace(near.point, values=values), near.about, near.noise.kept)

    def with_lag(values: Array, kind: str, lag: float) -> Array:
        out = values.copy()
        out[lags[kind]] = lag
        return out

    def penalty(kind: str, lag: Array) -> Array:
        """−2 ln of the prior of a lag."""
        return np.asarray((lag / usual[kind]) ** 2)

    def again(values: Array) -> Maximum:
        near = replace(fitted.at, point=fitted.point)
        return maximum(*held(values, free, near), fitted.best.phi, iterations)

    def solutions(sizes: Problem, components: Components, kind: str) -> Callable[[Array], tuple[Array, Array]]:
        def at_lags(tried: Array) -> tuple[Array, Array]:
            near = replace(fitted.at, point=fitted.point)
            every = [held(with_lag(fitted.point.values, kind, lag), sizes, near) for lag in tried.tolist()]
            steps = [there.solved(known, components) for known, there in every]
            found = np.array([np.column_stack([step.covariance, step.parameters]) for step in steps])[:, 1:, 1:]
            found[:, :, -1] += fitted.point.values
            found[:, lags[kind], -1] = tried
            return np.array([step.deviance for step in steps]) + penalty(kind, tried), found

        return at_lags

    def goodness(fit: Maximum) -> float:
        """ln of the posterior of φ and the lags."""
        return float(fit.best.value) - 0.5 * sum(float(penalty(kind, fit.point.values[i])) for kind, i in lags.items())

    fitted = likeliest(*held(at.point.values, problem, at), iterations)
    free = replace(problem, bias_after=fitted.free.bias_after)
    tried = {tuple(fitted.point.values[list(lags.values())])}
    for _ in range(LAG_ROUNDS):
        # by the φ that the lags before have led to, which may hide others, and by the usual
        expected = components_of(fitted.entries, fitted.entries.centre)
        candidates = []
        for sizes, components in ((fitted.problem, fitted.components), (free, expected)):
            values = fitted.point.values
            for kind in lags:
                grid, weight, _ = resolved(solutions(sizes, components, kind), np.array(LAGS))
                values = with_lag(values, kind, float(grid[np.argmax(weight / np.gradient(grid))]))
            key = tuple(values[list(lags.values())])
            if key not in tried:
                tried.add(key)
                candidates.append(values)
        best = max([fitted, *map(again, candidates)], key=goodness)
        if best is fitted:
            break
        fitted = best
    means, prior_u = fitted.point.values.copy(), fitted.problem.measured[1][1:]
    others = np.delete(np.arange(len(means)), list(lags.values()))
    for kind, i in lags.items():
        at_lags, own = solutions(fitted.problem, fitted.components, kind), coefficients(fitted.problem, kind)
        grid, weight, found = resolved(at_lags, fitted.point.values[i] + LAGS_ABOUT)
        prior = np.exp(-0.5 * penalty(kind, grid)) * np.gradient(grid)
        log_odds = [log_odds_of_change(each[own][:, [*own, -1]], prior_u[own]) for each in found]
        change = float(scipy.special.expit(scipy.special.logsumexp(log_odds, b=prior / prior.sum())))
        means[i] = change * float(weight @ grid)
        spread[i, i] = weight @ (grid - means[i]) ** 2
        every, mean = (each[..., others, :][..., [*others, -1]] for each in (found, at_lags(means[[i]])[1][0]))
        spread[np.ix_(others, others)] += beside(every, mean, change * weight)
    return again(means), spread


def beside(found: Array, held: Array, weight: Array) -> Array:
    """What a covariance is to be greater by (m, m) where, beside the solution that is held, others have the
    probabilities `weight` (L,); of each the covariance and the values, (m, m + 1) and (L, m, m + 1). u is half the half
    width at 95.45 % of the mixture where that is less than its standard deviation, as in the integral."""
    off, u = (found - held)[:, :, -1], np.sqrt(np.diagonal(found, axis1=1, axis2=2))
    more = np.tensordot(weight, found[:, :, :-1] - held[:, :-1], axes=1) + (off.T * weight) @ off
    size = np.sqrt(np.abs(np.diag(more)))
    value, vectors = np.linalg.eigh(more / np.outer(size, size))
    more = (vectors * np.maximum(value, 0.0)) @ vectors.T * np.outer(size, size)
    before, after = np.diag(held), np.diag(held) + np.diag(more)
    mixed = np.vstack([0.0 * off[0], off]), np.vstack([np.sqrt(before), u])
    factor = coverage_factors(*mixed, np.append(1.0 - weight.sum(), weight), np.sqrt(after))
    after = np.minimum(0.5 * factor, 1.0) ** 2 * after
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
