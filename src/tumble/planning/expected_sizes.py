"""Expected estimates of the noise and of the sizes of groups, before a session is recorded.

`joint` estimates hyperparameters (`tumble.inference.hyperparameters`) with the parameters, and integrates over them.
For a session with noise of standard deviation s, no scatter beside it and groups of the usual size, the posterior of
each hyperparameter alone is

    x = σ/s of a component of scatter with ν degrees of freedom     p(x) (1 + x²)^{−ν/2} e^{−χ²/2(1 + x²)}
    λ of a group observed with variances v, of the usual size s     p(λ) Π (λ²s² + v)^{−1/2} e^{−y²/2(λ²s² + v)}

with random χ² of ν degrees of freedom and y of variance s² + v. For scatter the root mean square of σ is taken, of the
median session. For a group, the width of the prior is that which gives a parameter its variance averaged over sessions,
as this is much larger in a few: the mean of 1/(1/λ²s² + 1/v), plus the variation of its value with λ. A group that the
session hardly determines (`INFORMATIVE_GROUP`) keeps its usual size, as in the integral. Each is found with the
expected sizes of all others. An in-run bias is a group with as many members as states, whose prior is log-normal about
the size of the set-up.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy

from tumble.inference.hyperparameters import (
    LEAST_DEGREES,
    hyperparameters_of,
    quadratic_forms,
)
from tumble.inference.integral import INFORMATIVE_GROUP
from tumble.inference.linearisation import Linearisation
from tumble.inference.noise import SCATTER, TURN_SCATTER
from tumble.inference.normal_equations import Solution, solve
from tumble.units import Array

POINTS = 400  # of an integral
ROUNDS = 2  # of the sizes of groups, each with those of the others
RANGE = 4.0  # of an integral, in standard deviations of the prior
QUANTILES = (np.arange(64) + 0.5) / 64  # sessions that are averaged


def with_expected_sizes(rows: Linearisation) -> Linearisation:
    """Return a linearised likelihood with the scatter and the sizes of groups that `joint` is expected to find.

    `rows` are at perfect sensors, with the noise of the set-up."""
    problem, components, solution = rows.problem, rows.components, solve(rows)
    usual, sizes_of_noise, products = problem.prior_u[1:], dict[str, Any](), _products(solution)
    hyperparameters = hyperparameters_of(problem, rows.noise, products > 0.0)
    for h, learned in zip(hyperparameters, quadratic_forms(hyperparameters, solution)[1].tolist(), strict=True):
        if h.kind == "scatter":
            degrees = float(products[SCATTER.index(h.name)]) * h.usual**4
            if degrees > LEAST_DEGREES:
                sizes_of_noise[h.name] = h.usual * _expected_scatter(degrees, of_turns=h.name in TURN_SCATTER)
        elif h.kind == "process" and solution.equations.wanders:
            ones = np.ones(len(np.arange(rows.noise.unknowns)[h.members]) * len(problem.chain))
            share = float(np.clip(learned / len(ones), 1e-6, 1.0 - 1e-6))
            factor = _expected_size(ones, (1.0 - share) * ones, h.within, two_sided=True)[0]
            sizes_of_noise[h.name] = getattr(components, h.name) * float(factor)
    components = replace(components, **sizes_of_noise)
    for _ in range(ROUNDS):
        sizes, variances = problem.prior_u.copy(), np.diag(solve(rows.with_priors(problem), components).covariance)
        for h in hyperparameters:
            if h.kind != "group":
                continue
            s, size, v = usual[h.members], sizes[1:][h.members], variances[1:][h.members]
            v = 1.0 / (1.0 / v - 1.0 / size**2 + 1.0 / s**2)  # with a prior of the usual size
            learned = np.clip(1.0 - v / s**2, 0.0, 1.0)
            larger = np.exp(2.0 * (2.0 * learned.sum() + h.within**-2) ** -0.5)
            information = 2.0 * (larger * learned / (larger * learned + 1.0 - learned)).sum()
            sizes[1:][h.members] = s * _expected_size(s, v, h.within) if information > INFORMATIVE_GROUP else s
        problem = replace(problem, prior_u=sizes)
    return replace(rows, problem=problem).with_components(components)


def _products(solution: Solution) -> Array:
    """Return tr (PD)² (c,) of the components of scatter, from the parts within a rest and within a turn."""
    out = np.zeros(len(SCATTER))
    for _, _, C, WZ, place in solution.scatter:
        squares = ((np.swapaxes(WZ, 1, 2) @ C @ WZ) ** 2).sum(axis=0)
        for number in np.unique(place):
            out[number] += squares[np.ix_(place == number, place == number)].sum()
    return out


def _expected_scatter(degrees: float, *, of_turns: bool = False) -> float:
    """Return the root mean square of x = σ/s in the median session for ν `degrees` of freedom.

    The prior is e^{−x}, that of turns (1 + x)⁻²."""
    x = np.linspace(0.0, 12.0, 4 * POINTS)
    square = scipy.special.gammaincinv(0.5 * degrees, QUANTILES)[:, None] * 2.0  # χ²
    log_density = -2.0 * np.log1p(x) if of_turns else -x
    log_density = log_density - 0.5 * (degrees * np.log1p(x**2) + square / (1.0 + x**2))
    density = np.exp(log_density - log_density.max(axis=1, keepdims=True))
    return float(np.sqrt(np.median(density @ x**2 / density.sum(axis=1))))


def _expected_size(usual: Array, variance: Array, within: float, *, two_sided: bool = False) -> Array:
    """Return the factor (k,) by which the priors of the parameters of a group are widened.

    `usual` (k,) are their usual sizes and `variance` (k,) their variances; with `two_sided` it may be less than 1."""
    s2 = usual**2
    observed = 1.0 / np.maximum(1.0 / variance - 1.0 / s2, 1e-9 / s2)
    p = np.linspace(-RANGE * within if two_sided else 0.0, RANGE * within, POINTS)
    size2 = np.exp(2.0 * p)[:, None] * s2
    drawn = (s2 + observed) * np.random.default_rng(0).standard_normal((len(QUANTILES), len(usual))) ** 2
    log_likelihood = -0.5 * (np.log(size2 + observed).sum(axis=1) + drawn @ (1.0 / (size2 + observed)).T)
    top = log_likelihood.max(axis=1, keepdims=True)
    density = np.exp(log_likelihood - top - 0.5 * (p / within) ** 2)
    if not two_sided:  # half of the prior is on the usual size
        density /= np.sqrt(0.5 * np.pi) * within / (p[1] - p[0])
        density[:, 0] += np.exp(log_likelihood - top)[:, 0]
    share, weight = size2 / (size2 + observed), density / density.sum(axis=1, keepdims=True)
    mean = weight @ share
    spread = weight @ share**2 - mean**2
    mean_variance = np.mean(mean * observed + spread * drawn, axis=0)
    larger = 1.0 / np.maximum(1.0 / mean_variance - 1.0 / observed, 1e-9 / s2) / s2
    return np.asarray(np.sqrt(np.clip(larger, 0.0 if two_sided else 1.0, np.mean(weight @ np.exp(2.0 * p)))))
