"""What a session will say about its own noise and about the sizes of groups, before it is recorded.

`joint` estimates hyperparameters (`tumble.inference.hyperparameters`) with the parameters, and integrates over them.
Let a session be as its set-up says: noise of standard deviation s without scatter beside it, and groups of the usual
size. The posterior of each hyperparameter by itself is

    x = σ/s of a component of scatter with ν degrees of freedom     p(x) (1 + x²)^{−ν/2} e^{−χ²/2(1 + x²)}
    λ of a group seen with variances v, of the usual size s         p(λ) Π (λ²s² + v)^{−1/2} e^{−y²/2(λ²s² + v)}

with χ² of ν degrees of freedom and y of the variance s² + v, as chance has them in sessions. The size that counts is
the root mean square of σ, and the size of the prior with which a parameter has its variance, the mean of 1/(1/λ²s² +
1/v) and what its value differs by with λ; the first of the median session, the second, which few sessions make much
larger than most, as the mean over sessions. A group about which the session says nothing (`INFORMATIVE_GROUP`) keeps
its usual size, as in the integral; each is beside what is expected of all others. An in-run bias is a group of as many
members as it has states, whose prior is log-normal about the size of the set-up.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy

from tumble.inference.hyperparameters import (
    LEAST_DEGREES,
    GroupSize,
    InRunSize,
    Scatter,
    hyperparameters_of,
    quadratic_forms,
)
from tumble.inference.integral import INFORMATIVE_GROUP
from tumble.inference.linearisation import Linearisation
from tumble.inference.noise import SCATTER, TURN_SCATTER
from tumble.inference.normal_equations import Solution, solve
from tumble.units import Array

FINE = 400
"""Points of an integral."""
ROUNDS = 2
FARTHEST = 4.0
"""Range of an integral, in standard deviations of the prior."""
CHANCES = (np.arange(64) + 0.5) / 64
"""Of what sessions show, over which is averaged."""


def expected(seen: Linearisation) -> Linearisation:
    """A linearised likelihood with the scatter and the sizes of groups that `joint` will find in the median session,
    from one at perfect sensors with the noise of the set-up."""
    problem, components, solution = seen.problem, seen.components, solve(seen)
    usual, found, products = problem.prior_u[1:], dict[str, Any](), _products(solution)
    hyperparameters = hyperparameters_of(problem, seen.noise, products > 0.0)
    for h, learned in zip(hyperparameters, quadratic_forms(hyperparameters, solution)[1].tolist(), strict=True):
        if isinstance(h, Scatter):
            degrees = float(products[SCATTER.index(h.name)]) * h.usual**4
            if degrees > LEAST_DEGREES:
                found[h.name] = h.usual * _expected_scatter(degrees, of_turns=h.name in TURN_SCATTER)
        elif isinstance(h, InRunSize) and solution.equations.wanders:
            every = np.ones(len(np.arange(seen.noise.unknowns)[h.members]) * len(problem.link))
            share = float(np.clip(learned / len(every), 1e-6, 1.0 - 1e-6))
            factor = _expected_size(every, (1.0 - share) * every, h.within, two_sided=True)[0]
            found[h.name] = getattr(components, h.name) * float(factor)
    components = replace(components, **found)
    for _ in range(ROUNDS):  # each group is beside what is expected of all others
        sizes, variances = problem.prior_u.copy(), np.diag(solve(seen.with_priors(problem), components).covariance)
        for h in hyperparameters:
            if not isinstance(h, GroupSize):
                continue
            s, size, v = usual[h.members], sizes[1:][h.members], variances[1:][h.members]
            v = 1.0 / (1.0 / v - 1.0 / size**2 + 1.0 / s**2)  # beside a prior of the usual size
            learned = np.clip(1.0 - v / s**2, 0.0, 1.0)
            larger = np.exp(2.0 * (2.0 * learned.sum() + h.within**-2) ** -0.5)
            shown = 2.0 * (larger * learned / (larger * learned + 1.0 - learned)).sum() > INFORMATIVE_GROUP
            sizes[1:][h.members] = s * _expected_size(s, v, h.within) if shown else s
        problem = replace(problem, prior_u=sizes)
    return replace(seen, problem=problem).with_components(components)


def _products(solution: Solution) -> Array:
    """tr (PD)² (c,) of the components of scatter, by the parts within a rest and within a turn."""
    out = np.zeros(len(SCATTER))
    for W, (_, C), (Z, place) in solution.by_kind:
        WZ = W @ Z
        squares = ((np.swapaxes(WZ, 1, 2) @ C @ WZ) ** 2).sum(axis=0)
        for number in np.unique(place):
            out[number] += squares[np.ix_(place == number, place == number)].sum()
    return out


def _expected_scatter(degrees: float, *, of_turns: bool = False) -> float:
    """Root mean square of x = σ/s in the median session with so many degrees of freedom; its prior is e^{−x}, that of
    turns (1 + x)⁻²."""
    x = np.linspace(0.0, 12.0, 4 * FINE)
    square = scipy.special.gammaincinv(0.5 * degrees, CHANCES)[:, None] * 2.0  # χ²
    log_density = -2.0 * np.log1p(x) if of_turns else -x
    log_density = log_density - 0.5 * (degrees * np.log1p(x**2) + square / (1.0 + x**2))
    density = np.exp(log_density - log_density.max(axis=1, keepdims=True))
    return float(np.sqrt(np.median(density @ x**2 / density.sum(axis=1))))


def _expected_size(usual: Array, variance: Array, within: float, *, two_sided: bool = False) -> Array:
    """Factor (k,) by which the priors of the parameters of a group are widened, whose usual sizes are `usual` (k,) and
    whose variances in the session are `variance` (k,); `two_sided` where it may be less than 1."""
    s2 = usual**2
    seen = 1.0 / np.maximum(1.0 / variance - 1.0 / s2, 1e-9 / s2)
    p = np.linspace(-FARTHEST * within if two_sided else 0.0, FARTHEST * within, FINE)
    size2 = np.exp(2.0 * p)[:, None] * s2
    drawn = (s2 + seen) * np.random.default_rng(0).standard_normal((len(CHANCES), len(usual))) ** 2
    log_likelihood = -0.5 * (np.log(size2 + seen).sum(axis=1) + drawn @ (1.0 / (size2 + seen)).T)
    top = log_likelihood.max(axis=1, keepdims=True)
    density = np.exp(log_likelihood - top - 0.5 * (p / within) ** 2)
    if not two_sided:  # half of the prior is on the usual size
        density /= np.sqrt(0.5 * np.pi) * within / (p[1] - p[0])
        density[:, 0] += np.exp(log_likelihood - top)[:, 0]
    share, weight = size2 / (size2 + seen), density / density.sum(axis=1, keepdims=True)
    mean = weight @ share
    apart = weight @ share**2 - mean**2
    known = np.mean(mean * seen + apart * drawn, axis=0)
    larger = 1.0 / np.maximum(1.0 / known - 1.0 / seen, 1e-9 / s2) / s2
    return np.asarray(np.sqrt(np.clip(larger, 0.0 if two_sided else 1.0, np.mean(weight @ np.exp(2.0 * p)))))
