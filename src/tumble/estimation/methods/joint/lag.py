"""The lag of the sensors behind their thermometer, and the spread it leaves in all parameters.

Everything else is linear, or nearly so, once the lag is known, which multiplies the coefficients over temperature: the
likelihood has several minima over it, where the temperature hardly bends none that Gauss–Newton finds. So the estimate
holds the likeliest lag, and in the end its probability is summed over a grid.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tumble.estimation.components import Scatter
from tumble.estimation.likelihood import Point, Problem
from tumble.estimation.methods.joint.fit import Fitted, fit_of
from tumble.estimation.methods.joint.iteration import At, iterate
from tumble.estimation.step import Step, left
from tumble.units import Array

LAGS = (-100.0, -25.0, 0.0, 10.0, 25.0, 50.0, 100.0, 200.0, 400.0, 800.0)
"""s: time constants of the sensors behind the thermometer from which the best is sought."""
LAG_HELD = 1e-3  # s
_APART = np.concatenate([[0.5], 2.0 ** np.arange(0.0, 10.5)])
LAGS_ABOUT = np.concatenate([-_APART[::-1], [0.0], _APART])
"""s: from the lag that is held, where its likelihood is taken at first."""
RESOLVED, HALVINGS = 0.2, 10
"""Largest probability of one lag of a grid that resolves the likelihood, half a standard deviation of a Gaussian from
the next, and how often steps beside likelier ones are halved at most."""
LESS_LIKELY = 6.0
"""−2 log of the likelihoods of two lags: the first is taken for a wrong one."""
LAG_ROUNDS = 3
"""Solutions with a lag of which each shows the one before to be wrong, at most."""
KEPT = 1e-3  # learned fraction of a group that the session says anything of


def with_lag(problem: Problem, at: At) -> tuple[Problem, At]:
    """The problem with the likeliest lag, which is held, and the start there: everything else is found at none, and
    from there that of each lag in one step."""
    if problem.lag is None:
        return problem, at
    solved = iterate(_held(problem, 0.0), at, Scatter())
    at = At.of(problem, solved.point, solved.last.about, at.out)
    lag = _likeliest(problem, problem, at, Scatter())
    step = _at_lag(problem, at, lag, Scatter())
    point = _point_of(solved.point.moved(step.parameters, step.angles, step.own), problem.lag, lag)
    held = _held(problem, lag)
    return held, At.of(held, point, solved.last.about, at.out)


def fit_with_lag(free: Problem, held: Problem, start: At, most: int) -> Fitted:
    """The solution with the scatter that it shows and the lag that is `held`; with the likeliest one where that is much
    less likely by this scatter, and the priors that go with it. In the problem `free` the lag is an unknown."""
    fitted = fit_of(held, start, most)
    for _ in range(LAG_ROUNDS if free.lag is not None else 0):
        at = At.of(fitted.problem, fitted.solved.point, fitted.solved.last.about, fitted.out)
        lag = float(at.point.values[free.lag])
        tried = np.unique([*LAGS, lag])
        deviance, _ = _about(fitted.problem, free, at, fitted.scatter, tried)
        if deviance[tried == lag][0] < deviance.min() + LESS_LIKELY:
            break
        fitted = fit_of(_held(free, _likeliest(fitted.problem, free, at, fitted.scatter)), start, most)
    return fitted


def _likeliest(problem: Problem, free: Problem, at: At, scatter: Scatter) -> float:
    """The likeliest lag, of a grid between LAGS."""
    lags, weight, _ = _resolved(problem, free, at, scatter, np.array(LAGS))
    return float(lags[np.argmax(weight / np.gradient(lags))])


def _prior_of_lag(problem: Problem, lag: float) -> float:
    """What the prior adds to the sum of squares."""
    assert problem.lag is not None
    expected, u = (values[1 + problem.lag] for values in problem.measured)
    return float(((lag - expected) / u) ** 2)


def _held(problem: Problem, lag: float) -> Problem:
    """The problem with a lag that is known."""
    assert problem.lag is not None
    expected, u = (values.copy() for values in problem.measured)
    expected[1 + problem.lag], u[1 + problem.lag] = lag, LAG_HELD
    return replace(problem, measured=(expected, u), lag_known=True)


def _point_of(point: Point, where: int, lag: float) -> Point:
    """A point with another lag."""
    values = point.values.copy()
    values[where] = lag
    return replace(point, values=values)


def _at_lag(problem: Problem, at: At, lag: float, scatter: Scatter) -> Step:
    """The step from a point to the solution with a lag."""
    assert problem.lag is not None
    held = _held(problem, lag)
    return At.of(held, _point_of(at.point, problem.lag, lag), at.about, at.out).solved(held, scatter)


def with_posterior(fitted: Fitted, free: Problem) -> Fitted:
    """The fit with the lag at the mean of what is known of it, and its spread in all uncertainties: with the
    solutions θ(λ), of spread C(λ),

        C = C(λ) + E[(θ(λ) − E θ)(θ(λ) − E θ)ᵀ]                                                                   (A5)

    Where a session hardly shows the lag, its likelihood is no parabola, and mean and spread are not those of the
    maximum. In the problem `free` the lag is an unknown."""
    solved = fitted.solved
    if free.lag is None:
        return fitted
    at = At.of(fitted.problem, solved.point, solved.last.about, fitted.out)
    about = solved.point.values[free.lag] + LAGS_ABOUT
    lags, weight, moved_by = _resolved(fitted.problem, free, at, fitted.scatter, about)
    mean = float(weight @ lags)
    moved_by -= weight @ moved_by
    held = _held(fitted.problem, mean)
    start = At.of(held, _point_of(solved.point, free.lag, mean), solved.last.about, fitted.out)
    there = iterate(held, start, fitted.scatter)
    step = replace(there.step, covariance=there.step.covariance + (moved_by.T * weight) @ moved_by)
    after = left(held, there.step), there.step.told.weights
    problem = replace(fitted.problem, measured=_lag_freed(fitted.problem, free), lag_known=False)
    return replace(fitted, problem=problem, solved=replace(there, step=step), left=after)


def _resolved(problem: Problem, free: Problem, at: At, scatter: Scatter, lags: Array) -> tuple[Array, Array, Array]:
    """Lags, their probabilities, and what the solutions move gravity and the parameters by (L, 1 + m): those of a first
    grid, and between them as many as resolve the likelihood, which may be narrow, and steep to one side."""
    deviance, moved_by = _about(problem, free, at, scatter, lags)
    for _ in range(HALVINGS):
        weight = _probabilities(lags, deviance)
        if weight.max() < RESOLVED:
            break
        heavy = weight > 0.1 * RESOLVED
        between = np.flatnonzero(heavy[1:] | heavy[:-1])
        more = 0.5 * (lags[between] + lags[between + 1])
        others, moved_others = _about(problem, free, at, scatter, more)
        lags, deviance = np.insert(lags, between + 1, more), np.insert(deviance, between + 1, others)
        moved_by = np.insert(moved_by, between + 1, moved_others, axis=0)
    return lags, _probabilities(lags, deviance), moved_by


def _about(problem: Problem, free: Problem, at: At, scatter: Scatter, lags: Array) -> tuple[Array, Array]:
    """−2 log of the likelihoods (L,) of lags, with the prior, and what their solutions move gravity and the parameters
    by (L, 1 + m)."""
    assert free.lag is not None
    steps = [_at_lag(problem, at, lag, scatter) for lag in lags.tolist()]
    deviance = [step.deviance + _prior_of_lag(free, lag) for step, lag in zip(steps, lags.tolist(), strict=True)]
    moved_by = np.array([step.parameters for step in steps])
    moved_by[:, 1 + free.lag] = lags
    return np.array(deviance), moved_by


def _probabilities(lags: Array, deviance: Array) -> Array:
    """Of lags of these −2 log likelihoods, in ascending order."""
    weight = np.exp(-0.5 * (deviance - deviance.min())) * np.gradient(lags)
    return np.asarray(weight / weight.sum())


def _lag_freed(problem: Problem, free: Problem) -> tuple[Array, Array]:
    """What was known before of gravity and the parameters, of the lag as in the problem in which it is free."""
    assert free.lag is not None
    out = problem.measured[0].copy(), problem.measured[1].copy()
    for values, others in zip(out, free.measured, strict=True):
        values[1 + free.lag] = others[1 + free.lag]
    return out
