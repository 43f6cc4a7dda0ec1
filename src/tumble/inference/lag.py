"""The lag of the sensors behind their thermometer, and the spread it leaves in all parameters.

Everything else is linear, or nearly so, once the lag is known, which multiplies the coefficients over temperature: the
likelihood has several minima over it, where the temperature hardly bends none that Gauss–Newton finds. So the estimate
holds the likeliest lag, and in the end its probability is summed over a grid: docs/explanation/mathematics.md (35).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tumble.inference.hyperparameters import components_of
from tumble.inference.likelihood import Point, Problem
from tumble.inference.maximum import At, Maximum, likeliest, maximum
from tumble.inference.noise_components import Components
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


def maximum_with_lag(problem: Problem, at: At, iterations: int) -> tuple[Maximum, Array]:
    """The maximum with the likeliest lag, which is held, and what is to be added to the covariance (m, m) of the
    parameters because the lag is not known: with the solutions θ(λ)

        C = C(λ) + E[(θ(λ) − E θ)(θ(λ) − E θ)ᵀ]                                                                   (35)

    Where a session hardly shows the lag, its likelihood is no parabola, and mean and spread are not those of the
    maximum. The lag that is held in the end is its mean."""
    lag, free = problem.lag, problem
    if lag is None:
        return likeliest(problem, at, iterations), np.zeros((len(problem.instrument.names),) * 2)
    expected, u = (float(values[1 + lag]) for values in problem.measured)

    def held(value: float, sizes: Problem, point: Point, near: At) -> tuple[Problem, At]:
        """The problem with this lag, which is known, and groups of these sizes, linearised at a point with it."""
        measured, values = (sizes.measured[0].copy(), sizes.measured[1].copy()), point.values.copy()
        measured[0][1 + lag], measured[1][1 + lag], values[lag] = value, LAG_HELD, value
        known = replace(free, measured=measured, own_known=sizes.own_known, lag_known=True)
        return known, At.of(known, replace(point, values=values), near.about, near.noise.kept)

    def again(value: float) -> Maximum:
        return maximum(*held(value, free, fitted.point, fitted.at), fitted.best.phi, iterations)

    def solutions(sizes: Problem, components: Components) -> Callable[[Array], tuple[Array, Array]]:
        def at_lags(lags: Array) -> tuple[Array, Array]:
            every = [held(value, sizes, fitted.point, fitted.at) for value in lags.tolist()]
            steps = [near.solved(known, components) for known, near in every]
            moved_by = np.array([step.parameters for step in steps])
            moved_by[:, 1 + lag] = lags
            return np.array([step.deviance for step in steps]) + ((lags - expected) / u) ** 2, moved_by

        return at_lags

    fitted = likeliest(*held(0.0, free, at.point, at), iterations)
    free = replace(free, bias_after=fitted.free.bias_after)
    tried = {0.0}
    for _ in range(LAG_ROUNDS):
        # by the φ that the lag before has led to, which may hide another one, and by the usual
        usual = components_of(fitted.entries, fitted.entries.centre)
        grids = solutions(fitted.problem, fitted.components), solutions(free, usual)
        every = [resolved(at_lags, np.array(LAGS))[:2] for at_lags in grids]
        likely = {float(lags[np.argmax(weight / np.gradient(lags))]) for lags, weight in every} - tried
        maxima = [fitted, *map(again, sorted(likely))]
        best = max(maxima, key=lambda each: each.best.value - 0.5 * ((each.point.values[lag] - expected) / u) ** 2)
        tried |= likely
        if best is fitted:
            break
        fitted = best
    at_lags = solutions(fitted.problem, fitted.components)
    lags, weight, moved_by = resolved(at_lags, fitted.point.values[lag] + LAGS_ABOUT)
    moved_by -= weight @ moved_by
    return again(float(weight @ lags)), ((moved_by.T * weight) @ moved_by)[1:, 1:]


def resolved(at_lags: Callable[[Array], tuple[Array, Array]], lags: Array) -> tuple[Array, Array, Array]:
    """Lags in ascending order, their probabilities, and what the solutions move gravity and the parameters by
    (L, 1 + m), of −2 ln likelihood and solutions `at_lags`: those of a first grid, and between them as many as resolve
    the likelihood, which may be narrow, and steep to one side."""
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
