"""What a session will say of what its model does not know about itself, before it is recorded.

`joint` estimates the hyperparameters (`tumble.inference.hyperparameters`) with the parameters, and integrates over what
it does not know of them. On the average over sessions that are as their set-up says, with noise s and no scatter beside
it, with groups of the usual size, the posterior of each by itself is

    x = σ/s of a component of scatter, of which ν values are left    e^{−x} [(1 + x²) e^{1/(1 + x²)}]^{−ν/2}
    λ of a group, told c ± √v apart from its prior s                 p(λ) Π [(λ²s² + v) e^{(s² + v)/(λ²s² + v)}]^{−1/2}

the logarithm of the likelihood being that which is expected. What counts of them is the mean of σ², and the size of the
prior with which a parameter has the mean of its variances 1/(1/λ²s² + 1/v); a group of which the session shows nothing
(`SHOWN`) is left as it is, as the integral leaves it. Of in-run biases the size is that of the set-up: rests tell it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tumble.inference.hyperparameters import SCATTER, table
from tumble.inference.integral import SHOWN
from tumble.inference.likelihood import Linearised
from tumble.inference.maximum import LEAST_DEGREES
from tumble.inference.step import left, scatter_score, solve
from tumble.units import Array

FINE = 400
"""Points of an integral."""
FARTHEST = 4.0
"""Standard deviations of a prior that it reaches."""


def expected(seen: Linearised) -> Linearised:
    """The same with groups, and components of variance with scatter, as large as `joint` will take them for on the
    average, from the rows at perfect sensors with the noise that there is."""
    problem, noise = seen.problem, seen.noise
    step = solve(problem, seen.rows, noise.weights(seen.components))
    information = scatter_score(noise, step, left(problem, step))[1].diagonal()
    known, own, scatter = problem.measured[1][1:].copy(), problem.own_known.copy(), dict[str, Any]()
    variances = np.diagonal(step.own_covariance, axis1=1, axis2=2)
    for h in table(problem, noise, information > 0.0):
        if h.place == "scatter":
            degrees = 2.0 * float(information[SCATTER.index(h.name)]) * h.usual**4
            if degrees > LEAST_DEGREES:
                scatter[h.name] = h.usual * _expected_scatter(degrees)
        elif h.place in ("group", "own group"):
            of, variance = (known, variances[:1, len(own) + 1 :]) if h.place == "group" else (own, variances)
            usual, v = of[h.members], variance[:, h.members]
            learned = np.clip(1.0 - v / usual**2, 0.0, 1.0)
            larger = np.exp(2.0 * (2.0 * learned.sum() + h.within**-2) ** -0.5)
            if 2.0 * (larger * learned / (larger * learned + 1.0 - learned)).sum() > SHOWN:
                of[h.members] *= _expected_size(usual, v, h.within)
    sizes = np.append(problem.measured[1][0], known)
    wider = replace(problem, measured=(problem.measured[0], sizes), own_known=own)
    return replace(seen, problem=wider, components=replace(seen.components, **scatter))


def _expected_scatter(degrees: float) -> float:
    """The root of the mean square of x = σ/s with so many degrees of freedom."""
    x = np.linspace(0.0, 12.0, 4 * FINE)
    log_density = -x - 0.5 * degrees * (np.log1p(x**2) + 1.0 / (1.0 + x**2))
    density = np.exp(log_density - log_density.max())
    return float(np.sqrt(density @ x**2 / density.sum()))


def _expected_size(usual: Array, variance: Array, within: float) -> Array:
    """By how many times (k,) the prior of the parameters of a group, of the usual size (k,), is larger, whose variances
    (S, k) it has in each of several sessions."""
    s2 = usual**2
    told = 1.0 / np.maximum(1.0 / variance - 1.0 / s2, 1e-9 / s2)
    p = np.linspace(0.0, FARTHEST * within, FINE)
    size2 = np.exp(2.0 * p)[:, None, None] * s2
    log_likelihood = -0.5 * (np.log(size2 + told) + (s2 + told) / (size2 + told)).sum(axis=(1, 2))
    density = np.exp(log_likelihood - log_likelihood.max() - 0.5 * (p / within) ** 2)
    density /= np.sqrt(0.5 * np.pi) * within / (p[1] - p[0])
    density[0] += np.exp(log_likelihood[0] - log_likelihood.max())  # half of the prior is on the usual size
    share, weight = size2 / (size2 + told), density / density.sum()
    mean = np.einsum("i,isk->sk", weight, share)
    apart = np.einsum("i,isk->sk", weight, (share - mean) ** 2)
    variance = mean * told + apart * (s2 + told)
    larger = 1.0 / np.maximum(1.0 / variance - 1.0 / told, 1e-9 / s2) / s2
    return np.asarray(np.sqrt(np.minimum(larger, weight @ np.exp(2.0 * p)).mean(axis=0)))
