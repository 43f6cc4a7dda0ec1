"""The lags of the sensors behind their thermometers, and the spread they leave in all parameters.

Accelerometers and gyros have a lag each: they may be chips apart from the thermometer and from each other. Everything
else is linear, or nearly so, once the lags are known, which multiply the coefficients over temperature: the likelihood
has several minima over a lag, where the temperature hardly bends none that Gauss–Newton finds. So the estimate holds
the likeliest lags, and in the end the probability of each lag λ is summed over a grid, with the hyperparameters that
are likeliest with it.

Sensors follow: a lag is not negative. One of the die is behind a thermometer on it by less than a second, behind one in
the package or on the board by seconds to some tens of seconds, and an instrument behind one in its housing by minutes.
Which it is no file says, so that its prior falls by a power,

    p(λ) = (3/2s)(1 + λ/2s)⁻⁴,    λ ≥ 0                                                                            (1)

of mean s, a tenth of it beyond 2.3 s and a hundredth beyond 7.3 s: minutes are believed as soon as data show them.

A lag matters as far as anything changes with temperature. Where nothing does, any lag fits, and a large one best: with
it the sensors have hardly become warmer, and parameters at the temperature of the thermometer would be far from all
that was observed. So there are two hypotheses, as likely beforehand: the coefficients c over temperature of a kind of
sensor are of usual size, c ~ N(0, S) and λ is of (1), or they are zero. With the solution θ(λ), of covariance C(λ), the
odds of the first with a lag are those of the density of c = 0 before and after (Savage and Dickey),

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

from tumble.inference.hyperparameters import solution_at
from tumble.inference.integral import coverage_factors
from tumble.inference.linearisation import Linearisation, linearise
from tumble.inference.maximum import Maximum, maximise, maximise_from_starts, maximise_phi
from tumble.inference.problem import Problem
from tumble.sensors.parameters import THERMAL, sensor_kind, variable_of
from tumble.units import Array

LAGS = np.array([0.0, 5.0, 10.0, 25.0, 50.0, 100.0, 200.0, 400.0, 800.0, 1600.0])
"""s: lags at which the likelihood is taken at first."""
NEAR = 0.3
"""Standard deviations by which the likeliest lag may be apart from the one that is held."""
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
    lags, spread = start.problem.lags, np.zeros((len(start.problem.instrument.names),) * 2)
    if not lags:
        return maximise_from_starts(start, iterations), spread
    usual = {kind: start.problem.observations.usual[f"{kind}.lag"] for kind in lags}

    def held(values: Array, near: Linearisation) -> Linearisation:
        """The linearisation where the lags are known to be those among values (m,)."""
        there = linearise(near.problem.with_lags(values), replace(near.point, values=values), near.about)
        return replace(there, noise=there.noise.weighted(*near.noise.weights))

    def again(values: Array) -> Maximum:
        return maximise(held(values, replace(fitted.linearisation, point=fitted.point)), fitted.phi, iterations)

    def penalty(kind: str, lag: Array) -> Array:
        """−2 ln of the prior of a lag, Eq. (1)."""
        return np.asarray(8.0 * np.log1p(0.5 * lag / usual[kind]))

    def solutions(kind: str) -> Callable[[Array], tuple[Array, Array]]:
        """−2 ln of the posterior of lags of a kind, and with them covariances and values (L, m, m + 1) of the
        parameters. Each begins with φ between those of the lags about it."""
        values, i = fitted.point.values, lags[kind]
        here = held(values, replace(fitted.linearisation, point=fitted.point))
        known, B = {float(values[i]): fitted.phi}, fitted.curvature

        def at(tried: Array) -> tuple[Array, Array]:
            nonlocal B
            deviance, both = penalty(kind, tried), np.empty((len(tried), len(values), len(values) + 1))
            for k in np.argsort(np.abs(tried - values[i])):
                lag, other = float(tried[k]), values.copy()
                other[i] = lag
                there = here.at_lags(here.problem.with_lags(other), other)
                before, every = zip(*sorted(known.items()), strict=True)
                phi = np.array([np.interp(lag, before, element) for element in np.transpose(every)])
                solution = solution_at(there, fitted.hyperparameters, phi)
                solution, B, *_ = maximise_phi(fitted.hyperparameters, solution, B)
                known[lag] = solution.phi
                deviance[k] -= 2.0 * solution.log_posterior
                both[k, :, :-1] = solution.session_covariance[1:, 1:]
                both[k, :, -1] = values + solution.session_step[1:]
            return deviance, both

        return at

    def goodness(fit: Maximum) -> float:
        """ln of the posterior of φ and the lags."""
        of_lags = [float(penalty(kind, fit.point.values[i])) for kind, i in lags.items()]
        return float(fit.solution.log_posterior) - 0.5 * sum(of_lags)

    fitted = maximise_from_starts(held(start.point.values, start), iterations)
    for left in reversed(range(LAG_ROUNDS)):
        at_lags = {kind: solutions(kind) for kind in lags}
        grids = {kind: resolved(at_lags[kind], LAGS) for kind in lags}
        values, moved = fitted.point.values.copy(), False
        for kind, (grid, weight, _) in grids.items():
            values[lags[kind]] = grid[np.argmax(weight / widths(grid))]
            u = np.sqrt(weight @ (grid - weight @ grid) ** 2)
            moved |= abs(values[lags[kind]] - fitted.point.values[lags[kind]]) > NEAR * u
        if not (left and moved):
            break
        other = again(values)
        if goodness(other) <= goodness(fitted):
            break
        fitted = other
    means, prior_u = fitted.point.values.copy(), fitted.problem.prior_u[1:]
    others = np.delete(np.arange(len(means)), list(lags.values()))
    for kind, i in lags.items():
        (grid, weight, at_grid), own = grids[kind], coefficients(fitted.problem, kind)
        prior = np.exp(-0.5 * penalty(kind, grid)) * widths(grid)
        log_odds = [log_odds_of_change(each[own][:, [*own, -1]], prior_u[own]) for each in at_grid]
        change = float(scipy.special.expit(scipy.special.logsumexp(log_odds, b=prior / prior.sum())))
        means[i] = change * float(weight @ grid)
        spread[i, i] = weight @ (grid - means[i]) ** 2
        (held_one,) = at_lags[kind](means[[i]])[1]
        every = np.vstack([without(held_one, own)[None], at_grid])[:, others][:, :, [*others, -1]]
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


def widths(lags: Array) -> Array:
    """Widths (L,) of lags in ascending order, by which sums over them are integrals."""
    step = np.diff(lags)
    return np.asarray(0.5 * (np.append(step, 0.0) + np.append(0.0, step)))


def resolved(at_lags: Callable[[Array], tuple[Array, Array]], lags: Array) -> tuple[Array, Array, Array]:
    """Refine a grid of lags until none has a probability above RESOLVED, or HALVINGS times.

    `at_lags` gives −2 ln of the likelihood of lags (L,) and the solutions with them (L, …). Returned are the lags in
    ascending order, their probabilities, and their solutions."""
    deviance, solutions = at_lags(lags)
    for halved in range(HALVINGS + 1):
        weight = np.exp(-0.5 * (deviance - deviance.min())) * widths(lags)
        weight /= weight.sum()
        if weight.max() < RESOLVED or halved == HALVINGS:
            break
        heavy = weight > 0.1 * RESOLVED
        between = np.flatnonzero(heavy[1:] | heavy[:-1])
        more = 0.5 * (lags[between] + lags[between + 1])
        others, moved_others = at_lags(more)
        lags, deviance = np.insert(lags, between + 1, more), np.insert(deviance, between + 1, others)
        solutions = np.insert(solutions, between + 1, moved_others, axis=0)
    return lags, weight, solutions
