"""The posterior with the hyperparameters integrated out, by importance sampling: docs/explanation/mathematics.md,
section 11.

Integrated is over every element of φ but the sizes of groups of which the session shows nothing. The points z_i are of
a fixed low-discrepancy sequence, so that a result is the same to the last digit, moved so that their mean and their
covariance are exactly those of the normal distribution: of anything quadratic in z they give the mean without an error,
however many elements there are. The proposal q is a Gaussian copula: ℓ along every element through the maximum, by
cubics between KNOTS where it and its score are taken, is that element's own density, of which

    φ = F⁻¹(N(z)),   z normal with the correlations of the curvature of −ℓ

Of a size λ = exp(max(p, 0)) whose maximum is 1 half of the density is that of p < 0, by its prior. With the weights
w_i ∝ e^{ℓ(φ_i)}/q(φ_i), smoothed by the Pareto
distribution that fits the largest (Vehtari et al. 2024, Pareto smoothed importance sampling), and the step m_i and
covariance V_i at each

    x̄ = Σ w m,    C = Σ w (V + m mᵀ) − x̄ x̄ᵀ

and the coverage factor k of a parameter is the half width at 95.45 % of its mixture of Gaussians over its u, of which u
is half where a few points far out would make it more. Rows do
not change, so that each point costs one elimination. The effective number of points 1/Σ w² and the shape of the Pareto
distribution say how good the proposal was.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import scipy

from tumble.inference.hyperparameters import log_prior, restricted_likelihood, score
from tumble.inference.maximum import Maximum
from tumble.inference.normal_equations import NormalEquations, Solution, session_mean_bias
from tumble.inference.uncertainty_budget import contributions, scaled_to
from tumble.units import Array

POINTS = 64
MOST_PARAMETERS = 200
"""Of an array of more parameters the maximum alone is taken: priors and scatter matter least to it, and a point costs a
hundred times as much."""
POINTS_EACH = 2
"""Times the elements of φ: so many points at least."""
KNOTS, FURTHER = (-1.0, 1.0), (-5.0, -2.5, 2.0)
"""Where ℓ is looked at along an element of φ, in standard deviations by its curvature, and where else"""
BENT = 0.05
"""where it is so far or more from the parabola of its curvature at the first."""
RESTS_AT_ONCE = 512
"""ℓ is taken at so many points at once that they have together so many rests: what it takes fits into a processor's
cache."""
KEPT_MEMORY = 30_000_000
"""Bytes: a block of this size, taken and returned, makes the allocator of Linux keep what is returned later, up to
twice as much; by default every array of a stack is of new pages, which cost more to clear than to compute with."""
FINE = 241
"""Points of the densities along the elements."""
TAIL = 4.0
"""Standard deviations beyond the last knots that they reach."""
POOR, ENOUGH = 0.7, 10.0
"""Shape of the Pareto distribution of the weights from which on the integral is not to be relied on where fewer points
than this are effective: it is taken again with four times as many, but no more than"""
MOST_POINTS = 256
SHOWN = 0.2
"""Twice the members of a group of which the session learns something where it is as large as its prior allows for: of
less, its size is not shown at all, and stays that of the sheet."""
COVERAGE = 0.9545
MOST_DEGREES = 1e6


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Posterior:
    """What is known of gravity and the parameters with the hyperparameters integrated out: the mean step from the last
    linearisation (1 + m,) and the covariance (1 + m, 1 + m), biases being the means over the session, also by its
    `sources` (`tumble.inference.uncertainty_budget`); degrees of
    freedom (m,) of Student's t with the same coverage factor; `process_step` and `process_covariance` (n, n) of the
    biases as the means of their processes, what the next minute's or another day's are about; how many points there
    were, their effective number, and the Pareto shape of the weights; and median, lower and upper limit of the middle
    68 % of every hyperparameter (D, 3), SI."""

    step: Array
    covariance: Array
    sources: Mapping[str, Array]
    degrees: Array
    process_step: Array
    process_covariance: Array
    points: int
    effective: float
    pareto: float
    hyperparameters: Array


def posterior(fitted: Maximum, points: int = POINTS) -> Posterior:
    """The posterior about a maximum; with a single point that at the maximum itself."""
    best = fitted.solution
    np.empty(KEPT_MEMORY, dtype=np.uint8)
    points = 1 if len(best.parameters) > MOST_PARAMETERS else points
    axes, correlation = _axes(fitted) if points > 1 else ([], np.zeros((0, 0)))
    points = max(points, POINTS_EACH * len(axes)) if axes else 1
    phi, log_q = best.phi[None].repeat(points, axis=0), np.zeros(points)
    if axes:
        value, vectors = np.linalg.eigh(correlation)
        normal = normal_points(points, len(axes))
        z = normal @ (vectors * np.sqrt(value.clip(0.0))) @ vectors.T
        log_q -= 0.5 * (normal**2).sum(axis=1)
        for own, axis in zip(z.T, axes, strict=True):
            x = np.interp(scipy.special.ndtr(own), axis.cumulative, axis.phi)
            phi[:, axis.element] = x
            log_q += np.interp(x, axis.phi, axis.log_density) + 0.5 * own**2
    every = [conditional(here) for _, here in _at_once(fitted, phi)]

    def of_points(name: str) -> Array:
        return np.concatenate([getattr(each, name) for each in every])

    weight, pareto = smoothed(of_points("value") - log_q)
    effective = float(1.0 / (weight**2).sum())
    if rough(pareto, effective) and 1 < points < MOST_POINTS:
        return posterior(fitted, 4 * points)
    steps, process = of_points("step"), of_points("process_step")
    deviations = np.sqrt(np.diagonal(of_points("covariance"), axis1=1, axis2=2))
    mean, process_mean = weight @ steps, weight @ process
    sources = contributions(best)
    if points > 1:
        sources = scaled_to(sources, np.tensordot(weight, of_points("covariance"), axes=1))
        sources["hyperparameters"] = ((steps - mean).T * weight) @ (steps - mean)
    covariance = np.sum(list(sources.values()), axis=0)
    factor = coverage_factors(steps - mean, deviations, weight, np.sqrt(np.diag(covariance)))
    shorter = np.where(factor > 0.0, np.minimum(0.5 * factor, 1.0), 1.0)
    return Posterior(
        step=mean,
        covariance=covariance * np.outer(shorter, shorter),
        sources={name: each * np.outer(shorter, shorter) for name, each in sources.items()},
        degrees=degrees_of(factor[1:]),
        process_step=process_mean,
        process_covariance=np.tensordot(weight, of_points("process_covariance"), axes=1)
        + ((process - process_mean).T * weight) @ (process - process_mean),
        points=points,
        effective=effective,
        pareto=pareto,
        hyperparameters=_summary(fitted, phi, weight),
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Axis:
    """The posterior density of an element of φ along it through the maximum: at points `phi`, its logarithm and the
    distribution function."""

    element: int
    phi: Array
    log_density: Array
    cumulative: Array


def _at_once(fitted: Maximum, phi: Array, equations: NormalEquations | None = None) -> Iterator[tuple[slice, Solution]]:
    """ℓ at points (P, D), by stacks, and which these are."""
    many = max(1, RESTS_AT_ONCE // len(fitted.usual_problem.link))
    for some in (slice(first, first + many) for first in range(0, len(phi), many)):
        yield some, restricted_likelihood(fitted.linearisation, fitted.hyperparameters, phi[some], equations)


def _axes(fitted: Maximum) -> tuple[list[_Axis], Array]:
    """ℓ along the elements of φ of which the session shows something, and their correlations (k, k) by its
    curvature."""
    best, entries = fitted.solution, fitted.hyperparameters
    gradient, information = score(entries, best)
    prior_curvature = log_prior(entries, best.phi)[2]
    at_bound = np.array([h.bounded for h in entries], dtype=bool) & (best.phi <= 0.0)
    within = np.array([h.within for h in entries])
    bend = np.where(at_bound, information.diagonal(), fitted.curvature.diagonal())
    size = 1.0 / np.sqrt(np.maximum(bend, prior_curvature))
    there = [{0.0: (0.0, gradient, 0.0)} for _ in entries]

    def look(elements: Iterable[int], knots: tuple[float, ...]) -> None:
        for i in elements:
            for away in knots:
                if away > 0.0 or not at_bound[i]:
                    phi = best.phi.copy()
                    phi[i] += away * size[i]
                    here = restricted_likelihood(fitted.linearisation, entries, phi)
                    slopes, learned = score(entries, here)
                    there[i][away] = float(here.log_posterior - best.log_posterior), slopes, learned[i, i]

    every = range(len(entries))
    look(every, KNOTS)
    shown = [i for i in every if not at_bound[i] or there[i][1.0][2] - within[i] ** -2 > SHOWN]
    bent = [i for i in shown if at_bound[i] or any(abs(there[i][a][0] + 0.5 * a**2) >= BENT for a in KNOTS)]
    look(bent, FURTHER)
    axes, bends = list[_Axis](), list[Array]()
    for i in shown:
        along = [(away * size[i], value, slopes[i]) for away, (value, slopes, _) in sorted(there[i].items())]
        axes.append(_axis(i, best.phi[i], along, size[i], within[i] if at_bound[i] else 0.0))
        bends.append(0.0 * best.phi if at_bound[i] else (there[i][-1.0][1] - there[i][1.0][1]) / (2.0 * size[i]))
    elements = [axis.element for axis in axes]
    curvature = np.array(bends).reshape(len(axes), len(best.phi))[:, elements]
    curvature = 0.5 * (curvature + curvature.T)
    alone = at_bound[elements]
    curvature[alone], curvature[:, alone] = 0.0, 0.0
    diagonal = np.sqrt(np.maximum(curvature.diagonal(), 1e-12))
    scaled = curvature / np.outer(diagonal, diagonal)
    np.fill_diagonal(scaled, 1.0)
    value, vectors = np.linalg.eigh(scaled)
    return axes, np.asarray((vectors / np.maximum(value, 0.1)) @ vectors.T)


def _axis(element: int, centre: float, knots: list[tuple[float, float, float]], size: float, within: float) -> _Axis:
    """The density by values and slopes of its logarithm at knots, cubics between them and straight beyond; on the left
    of a bound that of the prior, normal with a standard deviation `within`."""
    x, y, slope = (np.array(each) for each in zip(*knots, strict=True))
    grid = np.linspace((-3.0 * within if within else x[0] - TAIL * size), x[-1] + TAIL * size, FINE)
    step, right = np.diff(x), np.clip(np.searchsorted(x, grid), 1, len(x) - 1)
    h, left = step[right - 1], right - 1
    t = np.clip((grid - x[left]) / h, 0.0, 1.0)
    log_density = (1 + 2 * t) * (1 - t) ** 2 * y[left] + t * (1 - t) ** 2 * h * slope[left]
    log_density += t * t * (3 - 2 * t) * y[right] - t * t * (1 - t) * h * slope[right]
    log_density += np.minimum(grid - x[0], 0.0) * max(slope[0], 0.3 / size)
    log_density += np.maximum(grid - x[-1], 0.0) * min(slope[-1], -0.3 / size)
    if within:
        log_density = np.where(grid < 0.0, -0.5 * (grid / within) ** 2, log_density)
    density = np.exp(log_density - log_density.max())
    cumulative = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    area = cumulative[-1] * (grid[1] - grid[0])
    log_density = np.log(np.maximum(density, 1e-300)) - np.log(area)
    return _Axis(element=element, phi=centre + grid, log_density=log_density, cumulative=cumulative / cumulative[-1])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Conditional:
    """ℓ at φ, and there the step of gravity and the parameters (1 + m,) and its covariance, both with the biases of the
    session, and the step and the covariance of the biases of the processes."""

    value: Array
    step: Array
    covariance: Array
    process_step: Array
    process_covariance: Array


def conditional(solution: Solution) -> Conditional:
    """The posterior at φ, or at a stack of them."""
    biases, problem = 1 + solution.problem.biases, solution.problem
    step, roots = solution.parameters.copy(), solution.roots[..., 0, :, :]
    root = roots[..., len(problem.usual_local_u) :, :].copy()
    process, by_noise = root[..., biases, :], None
    if solution.equations.wanders and len(problem.parts) == 1:
        by_shared, by_noise = session_mean_bias(solution.equations)
        step[..., biases] += (by_shared @ solution.shared[..., 0, :, None])[..., 0]
        root[..., biases, :] += by_shared[..., :-1] @ roots
    covariance = root @ np.swapaxes(root, -1, -2)
    if by_noise is not None:
        along = np.swapaxes(by_noise, -3, -2).reshape(*step.shape[:-1], len(biases), -1)
        covariance[..., biases[:, None], biases] += along @ np.swapaxes(along, -1, -2)
    return Conditional(
        value=solution.log_posterior,
        step=step,
        covariance=covariance,
        process_step=solution.parameters[..., biases],
        process_covariance=process @ np.swapaxes(process, -1, -2),
    )


def rough(pareto: float, effective: float) -> bool:
    """Whether an integral rests on a few points, by the shape of their weights and their effective number."""
    return pareto > POOR and effective < ENOUGH


def normal_points(points: int, dimensions: int) -> Array:
    """Points (points, D) of the normal distribution, of its mean and covariance: an additive recurrence of low
    discrepancy in the unit cube, by the root of x^{D+1} = x + 1, made so."""
    root = 2.0
    for _ in range(60):
        root = (1.0 + root) ** (1.0 / (dimensions + 1.0))
    steps = root ** -np.arange(1.0, dimensions + 1.0)
    normal = scipy.special.ndtri((0.5 + np.outer(np.arange(1, points + 1), steps)) % 1.0)
    normal -= normal.mean(axis=0)
    return np.linalg.solve(np.linalg.cholesky(normal.T @ normal / points), normal.T).T


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


def coverage_factors(means: Array, deviations: Array, weight: Array, u: Array) -> Array:
    """The half widths at COVERAGE of the mixtures of Gaussians (points, m) over their u (m,); 0 where u is. By Newton's
    method, and by halves where that leaves the bounds."""
    low, high, k = np.zeros(len(u)), np.full(len(u), 20.0), np.full(len(u), 2.0)
    safe = np.where(deviations > 0.0, deviations, 1.0)
    for _ in range(60):
        above, below = (k * u - means) / safe, (-k * u - means) / safe
        missing = COVERAGE - weight @ (scipy.special.ndtr(above) - scipy.special.ndtr(below))
        density = weight @ ((np.exp(-0.5 * above**2) + np.exp(-0.5 * below**2)) / safe) * u / np.sqrt(2.0 * np.pi)
        low, high = np.where(missing > 0.0, k, low), np.where(missing > 0.0, high, k)
        new = k + missing / np.maximum(density, 1e-300)
        new, before = np.where((new >= low) & (new <= high), new, 0.5 * (low + high)), k
        k = new
        if np.all(np.abs(k - before) <= 1e-12 * k):
            break
    return np.where(u > 0.0, k, 0.0)


def degrees_of(factor: Array) -> Array:
    """Degrees of freedom (m,) of the t that has these coverage factors at COVERAGE."""
    degrees = np.geomspace(1.0, MOST_DEGREES, 400)
    factors = scipy.special.stdtrit(degrees, 0.5 + 0.5 * COVERAGE)
    return np.asarray(np.interp(-factor, -factors, degrees))


def _summary(fitted: Maximum, phi: Array, weight: Array) -> Array:
    """Median and the limits of the middle 68 % of every hyperparameter (D, 3); of those that are not integrated over by
    the curvature at the maximum."""
    out, prior_curvature = np.empty((len(fitted.phi), 3)), log_prior(fitted.hyperparameters, fitted.phi)[2]
    for i, h in enumerate(fitted.hyperparameters):
        at, order = fitted.phi[i], np.argsort(phi[:, i])
        limits = at + np.array([0.0, -1.0, 1.0]) / np.sqrt(max(fitted.curvature[i, i], prior_curvature[i]))
        if np.ptp(phi[:, i]) > 0.0:
            share = np.cumsum(weight[order]) - 0.5 * weight[order]
            limits = np.interp([0.5, 0.16, 0.84], share, phi[order, i])
        out[i] = h.value(limits)
    return out
