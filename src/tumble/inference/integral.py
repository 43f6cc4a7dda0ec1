"""The posterior with the hyperparameters integrated out, by importance sampling.

Points φ_i are of a fixed low-discrepancy sequence, so that a result is the same to the last digit, through a proposal q
about the maximum: along the eigenvectors of the curvature of −ℓ, Student-t of NU degrees each. A size λ whose maximum is
1 has a proposal of its own: half of its prior is exactly λ = 1, whatever p < 0 is, the other half falls with the slope
and curvature of ℓ there. With the weights w_i ∝ e^{ℓ(φ_i)}/q(φ_i), smoothed by the Pareto distribution that fits the
largest (Vehtari et al. 2024, Pareto smoothed importance sampling), and the step m_i and covariance V_i at each

    x̄ = Σ w m,    C = Σ w (V + m mᵀ) − x̄ x̄ᵀ

and the coverage factor k of a parameter is the half width at 95.45 % of its mixture of Gaussians over its u. Rows do not
change, so that each point costs one elimination. The effective number of points 1/Σ w² and the shape of the Pareto
distribution say how good the proposal was; it is centred and scaled once more by the first round's weights where the
effective number is below LEAST_EFFECTIVE.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from tumble.inference.hyperparameters import Hyperparameter, components_of, sized
from tumble.inference.in_run import of_session
from tumble.inference.maximum import Maximum
from tumble.units import Array, BoolArray

POINTS = 128
NU = 7.0
"""Degrees of freedom of the proposal."""
LEAST_EFFECTIVE = 32.0
POOR = 0.7
"""Shape of the Pareto distribution of the weights from which on the integral is not to be relied on."""
COVERAGE = 0.9545
SOFTENED = 0.5
"""Power of the weights by which a proposal is centred and scaled once more."""
LEAST_CURVATURE = 0.05
"""Of ℓ, along any direction of φ: no proposal is wider."""
MOST_DEGREES = 1e6


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Posterior:
    """What is known of gravity and the parameters with the hyperparameters integrated out: the mean step from the last
    linearisation (1 + m,) and the covariance (1 + m, 1 + m), biases being the means over the session; degrees of
    freedom (m,) of Student's t with the same coverage factor; `process_step` and `process_covariance` (n, n) of the
    biases as the means of their processes, what the next minute's or another day's are about; how many points there
    were, their effective number, and the Pareto shape of the weights; and median, lower and upper limit of the middle
    68 % of every hyperparameter (D, 3), SI."""

    step: Array
    covariance: Array
    degrees: Array
    process_step: Array
    process_covariance: Array
    points: int
    effective: float
    pareto: float
    hyperparameters: Array


def posterior(fitted: Maximum, points: int = POINTS) -> Posterior:
    """The posterior about a maximum; with a single point that at the maximum itself."""
    entries, best = fitted.entries, fitted.best
    at_bound = np.array([h.bounded for h in entries], dtype=bool) & (best.phi <= 0.0)
    free, bound = np.flatnonzero(~at_bound), np.flatnonzero(at_bound)
    curvature = fitted.curvature[np.ix_(free, free)]
    value, vectors = np.linalg.eigh(curvature)
    root, centre = vectors / np.sqrt(np.maximum(value, LEAST_CURVATURE)), best.phi[free]
    grid, adapted = _sequence(points, len(entries)), False
    while True:
        phi, log_q = np.zeros((points, len(entries))), np.zeros(points)
        t = special.stdtrit(NU, grid[:, : len(free)]) if points > 1 else np.zeros((1, len(free)))
        phi[:, free] = centre + t @ root.T
        log_q -= 0.5 * (NU + 1.0) * np.log1p(t**2 / NU).sum(axis=1)
        for column, i in enumerate(bound.tolist(), start=len(free)):
            if points > 1:
                phi[:, i], own = _above_the_sheet(entries[i], best.gradient[i], best.information[i, i], grid[:, column])
                log_q += own
        every = [_at(fitted, at_bound, own) for own in phi]
        log_weight = np.array([value for value, *_ in every]) - log_q
        weight, pareto = smoothed(log_weight)
        effective = float(1.0 / (weight**2).sum())
        if adapted or effective >= LEAST_EFFECTIVE or points < 2:
            break
        softer = np.exp((log_weight - log_weight.max()) * SOFTENED)
        softer /= softer.sum()
        centre = softer @ phi[:, free]
        off = phi[:, free] - centre
        size, vectors = np.linalg.eigh((off.T * softer) @ off + 0.2 * root @ root.T)
        root, adapted = vectors * np.sqrt(size), True
    steps, covariances = np.array([each[1] for each in every]), np.array([each[2] for each in every])
    mean = weight @ steps
    covariance = np.einsum("k,kab->ab", weight, covariances) + ((steps - mean).T * weight) @ (steps - mean)
    process, own = np.array([each[3] for each in every]), np.array([each[4] for each in every])
    of_process = weight @ process
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    u = np.sqrt(np.diag(covariance))
    return Posterior(
        step=mean,
        covariance=covariance,
        degrees=_degrees((steps - mean)[:, 1:], np.sqrt(variances)[:, 1:], weight, u[1:]),
        process_step=of_process,
        process_covariance=np.einsum("k,kab->ab", weight, own)
        + ((process - of_process).T * weight) @ (process - of_process),
        points=points,
        effective=effective,
        pareto=pareto,
        hyperparameters=_summary(entries, phi, weight),
    )


def _at(fitted: Maximum, at_bound: BoolArray, phi: Array) -> tuple[float, Array, Array, Array, Array]:
    """ℓ at φ, and there the step of gravity and the parameters, its covariance, both with the biases of the session,
    and the step and covariance of the biases of the processes."""
    entries, free = fitted.entries, fitted.best.problem
    components = components_of(entries, phi, free.sensors)
    problem = sized(free, entries, phi)
    step = fitted.at.solved(problem, components)
    value = -0.5 * step.deviance + sum(h.prior(p)[0] for h, p in zip(entries, phi.tolist(), strict=True))
    for i in np.flatnonzero(at_bound):  # where λ may be 1 exactly
        value += np.log(0.5) if phi[i] <= 0.0 else -np.log(entries[i].within * np.sqrt(2.0 * np.pi))
    change, covariance, n = step.parameters.copy(), step.covariance, free.sensors
    biases = 1 + free.biases
    process = change[biases], covariance[np.ix_(biases, biases)]
    if step.told.process is not None:
        more, by, apart = of_session(problem, step, step.told.process)
        to_session = np.eye(len(change))
        to_session[biases] += by
        change[biases] += more
        covariance = to_session @ covariance @ to_session.T
        covariance[np.ix_(biases, biases)] += apart
    assert len(biases) == n
    return float(value), change, covariance, *process


def _above_the_sheet(h: Hyperparameter, slope: float, information: float, grid: Array) -> tuple[Array, Array]:
    """Points p of a size λ = exp(max(p, 0)) whose maximum is 1, by uniform numbers, and the logarithms of their
    proposal: λ = 1 with the probability that ℓ gives it, and above half a normal distribution that falls as ℓ does."""
    width = 1.0 / np.sqrt(max(information, h.within**-2) + (min(slope, 0.0)) ** 2)
    above = np.sqrt(0.5 * np.pi) * width / (h.within * np.sqrt(2.0 * np.pi))
    chance = max(0.5 / (0.5 + above), 0.3)
    p = np.where(grid < chance, 0.0, width * special.ndtri(0.5 + 0.5 * np.clip((grid - chance) / (1.0 - chance), 0, 1 - 1e-12)))
    beyond = np.log((1.0 - chance) * 2.0 / (width * np.sqrt(2.0 * np.pi))) - 0.5 * (p / width) ** 2
    return p, np.where(p <= 0.0, np.log(chance), beyond)


def _sequence(points: int, dimensions: int) -> Array:
    """Additive recurrence: points (points, D) of low discrepancy in the unit cube, by the root of x^{D+1} = x + 1."""
    root = 2.0
    for _ in range(60):
        root = (1.0 + root) ** (1.0 / (dimensions + 1.0))
    steps = root ** -np.arange(1.0, dimensions + 1.0)
    return np.asarray((0.5 + np.outer(np.arange(1, points + 1), steps)) % 1.0)


def smoothed(log_weight: Array) -> tuple[Array, float]:
    """Weights whose largest are those that a Pareto distribution fitted to them expects, and its shape."""
    count, order = len(log_weight), np.argsort(log_weight)
    weight = np.exp(log_weight - log_weight.max())
    tail = int(min(0.2 * count, 3.0 * np.sqrt(count)))
    if tail < 5:
        return np.asarray(weight / weight.sum()), 0.0
    largest, least = order[-tail:], weight[order[-tail - 1]]
    above = weight[largest] - least
    if above[0] <= 0.0 or above[-1] <= 0.0:
        return np.asarray(weight / weight.sum()), 0.0
    shape, scale = _pareto(above)
    rank = (np.arange(tail) + 0.5) / tail
    expected = scale * np.expm1(-shape * np.log1p(-rank)) / shape if abs(shape) > 1e-9 else -scale * np.log1p(-rank)
    weight[largest] = np.minimum(least + expected, 1.0)
    return np.asarray(weight / weight.sum()), shape


def _pareto(above: Array) -> tuple[float, float]:
    """Shape and scale of the generalised Pareto distribution of values in ascending order (Zhang and Stephens 2009)."""
    n, quarter = len(above), above[int(len(above) / 4 + 0.5) - 1]
    m = 30 + int(np.sqrt(n))
    b = 1.0 / above[-1] + (1.0 - np.sqrt(m / (np.arange(1, m + 1) - 0.5))) / (3.0 * max(quarter, 1e-300))
    k = np.log1p(-b[:, None] * above).mean(axis=1)
    level = n * (np.log(-b / k) - k - 1.0)
    chance = np.exp(level - level.max())
    chosen = float(b @ chance / chance.sum())
    shape = float(np.log1p(-chosen * above).mean())
    return (n * shape + 5.0) / (n + 10.0), -shape / chosen


def _degrees(means: Array, deviations: Array, weight: Array, u: Array) -> Array:
    """Degrees of freedom (m,) of the t whose coverage factor at COVERAGE is the half width of the mixtures of Gaussians
    (points, m) over their u (m,)."""
    low, high = np.zeros(len(u)), np.full(len(u), 20.0)
    safe, known = np.where(deviations > 0.0, deviations, 1.0), u > 0.0
    for _ in range(40):
        k = 0.5 * (low + high)
        inside = special.ndtr((k * u - means) / safe) - special.ndtr((-k * u - means) / safe)
        small = weight @ inside < COVERAGE
        low, high = np.where(small, k, low), np.where(small, high, k)
    factor = np.where(known, 0.5 * (low + high), 0.0)
    degrees = np.geomspace(1.0, MOST_DEGREES, 400)
    factors = special.stdtrit(degrees, 0.5 + 0.5 * COVERAGE)
    return np.asarray(np.interp(-factor, -factors, degrees))


def _summary(entries: tuple[Hyperparameter, ...], phi: Array, weight: Array) -> Array:
    """Median and the limits of the middle 68 % of every hyperparameter (D, 3)."""
    out = np.empty((len(entries), 3))
    for i, h in enumerate(entries):
        order = np.argsort(phi[:, i])
        share = np.cumsum(weight[order]) - 0.5 * weight[order]
        out[i] = [h.value(float(p)) for p in np.interp([0.5, 0.16, 0.84], share, phi[order, i])]
    return out
