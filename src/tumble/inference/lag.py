"""The lag of the sensors behind their thermometer, and the spread it leaves in all parameters.

Everything else is linear, or nearly so, once the lag is known, which multiplies the coefficients over temperature: the
likelihood has several minima over it, where the temperature hardly bends none that Gauss–Newton finds. So the estimate
holds the likeliest lag, and in the end its probability is summed over a grid: docs/explanation/mathematics.md (35).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tumble.inference.hyperparameters import Components, components_of
from tumble.inference.likelihood import Point, Problem
from tumble.inference.maximum import At, Maximum, likeliest, maximum
from tumble.inference.step import Step
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
LAG_ROUNDS = 3
"""Solutions with a lag of which each shows the one before to be wrong, at most."""
KEPT = 1e-3  # learned fraction of a group that the session says anything of


def maximum_with_lag(problem: Problem, at: At, iterations: int) -> tuple[Maximum, Array]:
    """The maximum with the likeliest lag, which is held, and what is to be added to the
    covariance (m, m) of the parameters because the lag is not known: with the solutions θ(λ)

        C = C(λ) + E[(θ(λ) − E θ)(θ(λ) − E θ)ᵀ]                                                                   (35)

    Where a session hardly shows the lag, its likelihood is no parabola, and mean and spread are not those of the
    maximum. The lag that is held in the end is its mean."""
    none = np.zeros((len(problem.instrument.names),) * 2)
    if problem.lag is None:
        return likeliest(problem, at, iterations), none
    held = _held(problem, 0.0)
    fitted = likeliest(held, At.of(held, at.point, at.about), iterations)
    problem = replace(problem, bias_after=fitted.free.bias_after)
    tried = {0.0}
    for _ in range(LAG_ROUNDS):
        # by the φ that the lag before has led to, which may hide another one, and by the usual
        found = {_likeliest_lag(fitted, problem, sized) for sized in (True, False)} - tried
        maxima = [fitted, *(_again(fitted, problem, lag, iterations) for lag in sorted(found))]
        best = max(maxima, key=lambda each: each.best.value - 0.5 * _prior_of_lag(problem, _lag_of(each, problem)))
        tried |= found
        if best is fitted:
            break
        fitted = best
    lags, weight, moved_by = _resolved(fitted, problem, _lag_of(fitted, problem) + LAGS_ABOUT)
    moved_by -= weight @ moved_by
    fitted = _again(fitted, problem, float(weight @ lags), iterations)
    return fitted, ((moved_by.T * weight) @ moved_by)[1:, 1:]


def _lag_of(fitted: Maximum, free: Problem) -> float:
    """The lag that a maximum holds."""
    assert free.lag is not None
    return float(fitted.point.values[free.lag])


def _likeliest_lag(fitted: Maximum, free: Problem, sized: bool) -> float:
    """The likeliest lag about a maximum, with its φ or with the usual one."""
    best = fitted.best
    usual = np.array([h.centre for h in fitted.entries])
    components = fitted.components if sized else components_of(fitted.entries, usual, free.sensors)
    about = fitted if sized else replace(fitted, best=replace(best, problem=free))
    lags, weight, _ = _resolved(about, free, np.array(LAGS), components)
    return float(lags[np.argmax(weight / np.gradient(lags))])


def _again(fitted: Maximum, free: Problem, lag: float, iterations: int) -> Maximum:
    """The maximum with another lag."""
    assert free.lag is not None
    held, phi = _held(free, lag), fitted.best.phi
    start = At.of(held, _point_of(fitted.point, free.lag, lag), fitted.at.about, fitted.at.noise.kept)
    return maximum(held, start, phi, iterations)


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


def _at_lag(fitted: Maximum, free: Problem, lag: float, components: Components) -> Step:
    """The step from the point of a maximum to the solution with a lag, φ being that of the maximum."""
    assert free.lag is not None
    held, wide = _held(free, lag), fitted.problem.measured
    u = held.measured[1].copy()
    others = np.arange(len(u)) != 1 + free.lag
    u[others] = wide[1][others]
    held = replace(held, measured=(held.measured[0], u), own_known=fitted.problem.own_known)
    at = At.of(held, _point_of(fitted.point, free.lag, lag), fitted.at.about, fitted.at.noise.kept)
    return at.solved(held, components)


def _resolved(
    fitted: Maximum, free: Problem, lags: Array, components: Components | None = None
) -> tuple[Array, Array, Array]:
    """Lags, their probabilities, and what the solutions move gravity and the parameters by (L, 1 + m): those of a first
    grid, and between them as many as resolve the likelihood, which may be narrow, and steep to one side."""
    deviance, moved_by = _about(fitted, free, lags, components)
    for _ in range(HALVINGS):
        weight = _probabilities(lags, deviance)
        if weight.max() < RESOLVED:
            break
        heavy = weight > 0.1 * RESOLVED
        between = np.flatnonzero(heavy[1:] | heavy[:-1])
        more = 0.5 * (lags[between] + lags[between + 1])
        others, moved_others = _about(fitted, free, more, components)
        lags, deviance = np.insert(lags, between + 1, more), np.insert(deviance, between + 1, others)
        moved_by = np.insert(moved_by, between + 1, moved_others, axis=0)
    return lags, _probabilities(lags, deviance), moved_by


def _about(fitted: Maximum, free: Problem, lags: Array, components: Components | None) -> tuple[Array, Array]:
    """−2 log of the likelihoods (L,) of lags, with the prior, and what their solutions move gravity and the parameters
    by (L, 1 + m)."""
    assert free.lag is not None
    steps = [_at_lag(fitted, free, lag, components or fitted.components) for lag in lags.tolist()]
    deviance = [step.deviance + _prior_of_lag(free, lag) for step, lag in zip(steps, lags.tolist(), strict=True)]
    moved_by = np.array([step.parameters for step in steps])
    moved_by[:, 1 + free.lag] = lags
    return np.array(deviance), moved_by


def _probabilities(lags: Array, deviance: Array) -> Array:
    """Of lags of these −2 log likelihoods, in ascending order."""
    weight = np.exp(-0.5 * (deviance - deviance.min())) * np.gradient(lags)
    return np.asarray(weight / weight.sum())
