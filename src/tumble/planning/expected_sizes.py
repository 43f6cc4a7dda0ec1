"""What a session will say about its own noise and about the sizes of groups, before it is recorded.

`joint` estimates hyperparameters (`tumble.inference.hyperparameters`) with the parameters, and integrates over them.
Let a session be as its set-up says: noise of standard deviation s without scatter beside it, and groups of the usual
size. On the average over such sessions the posterior of each hyperparameter by itself is

    x = σ/s of a component of scatter with ν degrees of freedom     e^{−x} [(1 + x²) e^{1/(1 + x²)}]^{−ν/2}
    λ of a group seen with variances v, of the usual size s         p(λ) Π [(λ²s² + v) e^{(s² + v)/(λ²s² + v)}]^{−1/2}

where the logarithm of the likelihood is replaced by its expectation. The size that counts is the root mean square of σ,
and the size of the prior with which a parameter has the mean of its variances 1/(1/λ²s² + 1/v). A group about which the
session says nothing (`SHOWN`) keeps its usual size, as in the integral. In-run biases have the size of the set-up: the
rests show it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tumble.inference.hyperparameters import table
from tumble.inference.integral import SHOWN
from tumble.inference.likelihood import Linearised
from tumble.inference.maximum import LEAST_DEGREES
from tumble.inference.noise_components import SCATTER
from tumble.inference.step import left, scatter_score, solve
from tumble.units import Array

FINE = 400
"""Points of an integral."""
FARTHEST = 4.0
"""Range of an integral, in standard deviations of the prior."""


def expected(seen: Linearised) -> Linearised:
    """A linearised likelihood with the scatter and the sizes of groups that `joint` will find on the average, from one
    at perfect sensors with the noise of the set-up."""
    problem, noise = seen.problem, seen.noise
    step = solve(problem, seen.rows, noise.weights(seen.components))
    information = scatter_score(noise, step, left(problem, step))[1].diagonal()
    sizes, scatter = problem.measured[1].copy(), dict[str, Any]()
    size, variances = sizes[1:], np.diag(step.covariance)[1:]
    for h in table(problem, noise, information > 0.0):
        if h.place == "scatter":
            degrees = 2.0 * float(information[SCATTER.index(h.name)]) * h.usual**4
            if degrees > LEAST_DEGREES:
                scatter[h.name] = h.usual * _expected_scatter(degrees)
        elif h.place == "group":
            usual, v = size[h.members], variances[h.members]
            learned = np.clip(1.0 - v / usual**2, 0.0, 1.0)
            larger = np.exp(2.0 * (2.0 * learned.sum() + h.within**-2) ** -0.5)
            if 2.0 * (larger * learned / (larger * learned + 1.0 - learned)).sum() > SHOWN:
                size[h.members] *= _expected_size(usual, v, h.within)
    wider = replace(problem, measured=(problem.measured[0], sizes))
    return replace(seen, problem=wider, components=replace(seen.components, **scatter))


def _expected_scatter(degrees: float) -> float:
    """Root mean square of x = σ/s with so many degrees of freedom."""
    x = np.linspace(0.0, 12.0, 4 * FINE)
    log_density = -x - 0.5 * degrees * (np.log1p(x**2) + 1.0 / (1.0 + x**2))
    density = np.exp(log_density - log_density.max())
    return float(np.sqrt(density @ x**2 / density.sum()))


def _expected_size(usual: Array, variance: Array, within: float) -> Array:
    """Factor (k,) by which the priors of the parameters of a group are widened, whose usual sizes are `usual` (k,) and
    whose variances in the session are `variance` (k,)."""
    s2 = usual**2
    seen = 1.0 / np.maximum(1.0 / variance - 1.0 / s2, 1e-9 / s2)
    p = np.linspace(0.0, FARTHEST * within, FINE)
    size2 = np.exp(2.0 * p)[:, None] * s2
    log_likelihood = -0.5 * (np.log(size2 + seen) + (s2 + seen) / (size2 + seen)).sum(axis=1)
    density = np.exp(log_likelihood - log_likelihood.max() - 0.5 * (p / within) ** 2)
    density /= np.sqrt(0.5 * np.pi) * within / (p[1] - p[0])
    density[0] += np.exp(log_likelihood[0] - log_likelihood.max())  # half of the prior is on the usual size
    share, weight = size2 / (size2 + seen), density / density.sum()
    mean = weight @ share
    apart = weight @ (share - mean) ** 2
    larger = 1.0 / np.maximum(1.0 / (mean * seen + apart * (s2 + seen)) - 1.0 / seen, 1e-9 / s2) / s2
    return np.asarray(np.sqrt(np.minimum(larger, weight @ np.exp(2.0 * p))))
