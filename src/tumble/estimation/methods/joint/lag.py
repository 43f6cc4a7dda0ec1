"""The lag of the sensors behind their thermometer: the best of some, and the spread it leaves in all parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tumble.estimation.components import Scatter
from tumble.estimation.likelihood import Point, Problem
from tumble.estimation.methods.joint.fit import Fitted, fit_of
from tumble.estimation.methods.joint.iteration import At, iterate
from tumble.estimation.step import Step, left
from tumble.units import Array

LAGS = (0.0, 10.0, 25.0, 50.0, 100.0, 200.0, 400.0, 800.0, -25.0, -100.0)
"""s: time constants of the sensors behind the thermometer from which the best is sought."""
LAG_HELD = 1e-3  # s
LAG_GRID = np.linspace(-5.0, 8.0, 20)
"""Lags at which the likelihood is taken, in units of u from the maximum: of a Gaussian, sums in steps of one u have its
mean and spread to 1e-8."""
_APART = np.concatenate([[0.5], 2.0 ** np.arange(0.0, 9.5, 0.5)])
LAGS_ABOUT = np.concatenate([-_APART[::-1], [0.0], _APART])
"""s: the same from a lag of which Gauss–Newton does not say how well it is known."""
RESOLVED, HALVINGS = 0.3, 10
"""Largest probability of one lag of a grid that resolves the likelihood (0.27 of the first one where that is a
Gaussian), and how often steps beside likelier ones are halved at most."""
LESS_LIKELY = 6.0
"""−2 log of the likelihoods of two lags: the first is taken for a wrong one."""
KEPT = 1e-3  # learned fraction of a group that the session says anything of


def with_lag(problem: Problem, at: At) -> At:
    """The start with the best of LAGS. The sum of squares over the lag, which multiplies the coefficients over
    temperature, has several minima: everything else is found at none, and from there that of each in one step."""
    if problem.lag is None:
        return at
    solved = iterate(_held(problem, 0.0), at, Scatter())
    at = At.of(problem, solved.point, solved.last.about, at.out)
    tried = [_at_lag(problem, at, lag, Scatter()) for lag in LAGS]
    best = min(range(len(LAGS)), key=lambda i: tried[i].square + _prior_of_lag(problem, LAGS[i]))
    step = tried[best]
    point = _point_of(solved.point.moved(step.parameters, step.angles, step.own), problem.lag, LAGS[best])
    return At.of(problem, point, solved.last.about, at.out)


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


def fit_with_lag(problem: Problem, start: At, most: int) -> Fitted:
    """The solution with the scatter that it shows; with the likeliest of LAGS and that of the start where Gauss–Newton
    has ended at one that is much less likely. In an exponential warm-up the lag shows by its square alone: the steps do
    not know it."""
    fitted = fit_of(problem, start, most)
    if problem.lag is None:
        return fitted
    at = At.of(fitted.problem, fitted.solved.point, fitted.solved.last.about, fitted.out)

    def deviance(lag: float) -> float:
        return _at_lag(fitted.problem, at, lag, fitted.scatter).deviance + _prior_of_lag(problem, lag)

    tried = {lag: deviance(lag) for lag in (*LAGS, float(start.point.values[problem.lag]))}
    likeliest = min(tried, key=lambda lag: tried[lag])
    if deviance(float(fitted.solved.point.values[problem.lag])) < tried[likeliest] + LESS_LIKELY:
        return fitted
    return fit_of(_held(problem, likeliest), start, most)


def with_posterior(fitted: Fitted, free: Problem) -> Fitted:
    """The fit with the lag at the mean of what is known of it, and its spread in all uncertainties: with the
    solutions θ(λ), of spread C(λ),

        C = C(λ) + E[(θ(λ) − E θ)(θ(λ) − E θ)ᵀ]                                                                   (A5)

    Where a session hardly shows the lag, its likelihood is no parabola, and mean and spread are not those of the
    maximum. A lag that the session says nothing of stays what it is. In the problem `free` the lag is an unknown."""
    solved = fitted.solved
    if free.lag is None:
        return fitted
    where, expected = 1 + free.lag, free.measured[1]
    u = float(np.sqrt(solved.step.covariance[where, where]))
    if not fitted.problem.lag_known and 1.0 - (u / expected[where]) ** 2 < KEPT:
        return fitted
    grid = LAGS_ABOUT if fitted.problem.lag_known else u * LAG_GRID
    lags, weight, moved_by = _resolved(fitted, free, np.union1d(solved.point.values[free.lag] + grid, LAGS))
    mean = float(weight @ lags)
    moved_by -= weight @ moved_by
    held = _held(fitted.problem, mean)
    start = At.of(held, _point_of(solved.point, free.lag, mean), solved.last.about, fitted.out)
    there = iterate(held, start, fitted.scatter)
    step = replace(there.step, covariance=there.step.covariance + (moved_by.T * weight) @ moved_by)
    after = left(held, there.step), there.step.told.weights
    problem = replace(fitted.problem, measured=_lag_freed(fitted.problem, free), lag_known=False)
    return replace(fitted, problem=problem, solved=replace(there, step=step), left=after)


def _resolved(fitted: Fitted, free: Problem, lags: Array) -> tuple[Array, Array, Array]:
    """Lags, their probabilities, and what the solutions move gravity and the parameters by (L, 1 + m): those of a first
    grid, and between them as many as resolve the likelihood, which may be much narrower than where the steps of the
    estimate end, and steep to one side."""
    at = At.of(fitted.problem, fitted.solved.point, fitted.solved.last.about, fitted.out)
    deviance, moved_by = _about(fitted, free, at, lags)
    for _ in range(HALVINGS):
        weight = _probabilities(lags, deviance)
        if weight.max() < RESOLVED:
            break
        heavy = weight > 0.1 * RESOLVED
        between = np.flatnonzero(heavy[1:] | heavy[:-1])
        more = 0.5 * (lags[between] + lags[between + 1])
        others, moved_others = _about(fitted, free, at, more)
        lags, deviance = np.insert(lags, between + 1, more), np.insert(deviance, between + 1, others)
        moved_by = np.insert(moved_by, between + 1, moved_others, axis=0)
    return lags, _probabilities(lags, deviance), moved_by


def _about(fitted: Fitted, free: Problem, at: At, lags: Array) -> tuple[Array, Array]:
    """−2 log of the likelihoods (L,) of lags, with the prior, and what their solutions move gravity and the parameters
    by (L, 1 + m)."""
    assert free.lag is not None
    steps = [_at_lag(fitted.problem, at, lag, fitted.scatter) for lag in lags.tolist()]
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
