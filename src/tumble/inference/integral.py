"""The posterior with the hyperparameters integrated out, by importance sampling: docs/explanation/mathematics.md,
section 11.

φ is in two parts. ψ, what concerns rows (scatter, in-run biases, sensors unlike others, what single sessions have
beside), costs an elimination of all rests at every point. Sizes of groups, p, never touch the rows: each ψ_k is
eliminated once to its triangle over gravity and the parameters, which leaves information Λ and h about the groups c
alone, and any number of sizes S = λ s is folded into it by small matrices,

    B = 1 + S Λ S,   c = S B⁻¹ S h,   Cov c = S B⁻¹ S,   ln L = const + ½ hᵀ S B⁻¹ S h − ½ ln |B|

Sizes of groups of which the session shows nothing stay as usual.

The proposal is a Gaussian copula, φ_i = F_i⁻¹(N(z_i)). Of a variance v the score has tr PD and rᵀPDPr at the maximum,
and the average information rᵀPDPDPr. F_i is of the density that has the same three,

    ln f = ln p(φ) − ½ ν ln(u + w) − ½ s/(u + w),   w = v/v̂
    1/(u + 1) = v̂ rᵀPDPDPr/rᵀPDPr,   ν = v̂ tr PD (u + 1),   s = v̂ rᵀPDPr (u + 1)²

Of a correlation time it is the density along it through the maximum, with a part of the prior, the in-run bias being as
large in the session as there: of a bias that changes slowly a session of length T shows but

    σ_b² (1 − 2 (x − 1 + e^{−x})/x²),   x = T/τ

about its mean, and the density along σ_b at a τ is that of as large a w. For the average information the geometric
mean of those along φ_i and of its marginal is taken. Of a size of a group it is the density along it through the
maximum; of a size λ = exp(max(p, 0)) half of it is that of p < 0, by the prior. z has the correlations of the average
information.
The points z are of two fixed low-discrepancy sequences, each moved so that its mean and covariance are exactly those of
the normal distribution, so that a result is the same to the last digit. The weights w ∝ e^ℓ/q of the ψ, each the sum
over its sizes, are smoothed by the Pareto distribution that fits the largest (Vehtari et al. 2024, Pareto smoothed
importance sampling). With the step m and covariance V at each draw

    x̄ = Σ w m,    C = Σ w (V + m mᵀ) − x̄ x̄ᵀ

and the coverage factor k of a parameter is the half width at 95.45 % of its mixture of Gaussians over its u, of which
u is half where a few points far out would make it more. The two sequences are independent: half the difference of what
each finds, for u or for a value in parts of u, is the error by the points.

Where that exceeds SETTLED, or few points count, the proposal misses a part of the posterior: another mode, or tails
that reach farther than its own. Each set then goes on by adaptive multiple importance sampling (Cornuet et al. 2012).
Let n be z without its correlations, N(0, 1) by the copula. A round draws n ~ N(μ, Σ), of the mean and covariance that
the weights of all points so far give, and all points are weighted anew by the mixture of what they were drawn from,

    w ∝ (e^ℓ/q) N(n; 0, 1)/Σ_k (K_k/K) N(n; μ_k, Σ_k)

As long as few points are effective, μ and Σ are by tempered weights w^β, β < 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial

import numpy as np
import scipy

from tumble.inference.elimination_kernels import fold_sizes, mean_covariance
from tumble.inference.estimate import Integral
from tumble.inference.hyperparameters import (
    CorrelationTime,
    GroupSize,
    Hyperparameter,
    Hyperparameters,
    InRunSize,
    quadratic_forms,
    scaled,
    solution_at,
)
from tumble.inference.linearisation import Linearisation
from tumble.inference.maximum import Maximum
from tumble.inference.noise import NoiseModel
from tumble.inference.normal_equations import (
    Solution,
    eliminate_rests,
    fold_sessions,
    inverse_of,
    mean_by_common,
    rests_deviance,
    session_mean_bias,
)
from tumble.inference.uncertainty_budget import contributions, scaled_to
from tumble.units import Array, IntArray

POINTS = 32
"""Points of ψ, at first; twice as many where there are no sizes of groups to be folded in."""
ROUNDS, OF_ROUND = 13, 64
"""Rounds at most, and points of each set in those after the first."""
SIZES = 16
"""Sizes of groups that are folded into the triangle of each point."""
SPARE = 3
"""Points of each sequence more than ψ has elements, at least: fewer have no covariance that could be made right."""
MOST_PARAMETERS = 200
"""Of an array of more parameters the maximum alone is taken: a point costs a hundred times as much."""
RESTS_AT_ONCE = 512
"""ℓ is taken at so many points at once that they have together so many rests: what it takes fits into a processor's
cache."""
KEPT_MEMORY = 30_000_000
"""Bytes: a block of this size, taken and returned, makes the allocator of Linux keep what is returned later, up to
twice as much; by default every array of a stack is of new pages, which cost more to clear than to compute with."""
FINE = 241
"""Points of the densities along the elements."""
KNOTS = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0])
"""Standard deviations beyond the usual size at which the density along a size of a group is taken."""
TIMES = np.array([-3.0, -2.0, -1.4, -0.9, -0.4, 0.0, 0.4, 0.9, 1.4, 2.0, 3.0])
"""Standard deviations of its prior, from its middle, at which the likelihood along a correlation time is taken."""
DEFENCE = 0.15
"""The part of the prior in the density along a correlation time."""
REACH = 8.0
"""Standard deviations that densities along standard deviations reach."""
SETTLED = 0.1
"""Of u, for the parameter of which it is largest: an error by the points above which there are more, and above which it
is said."""
FEW, MANY = 4.0, 32.0
"""Effective points of a set: two of fewer may agree by chance, those of the first round and those after it, whose
proposal is by the points themselves."""
TEMPERED = 0.35
"""Effective part of the points, at most, to which weights are tempered for the proposal of the next round."""
TRUSTED, LEAST, WIDER = 0.5, 0.05, 1.2
"""Of the covariance of the next round: the part of the correlations that few points give; the variance beside, of that
of the copula; and the factor of all, a proposal too wide costing less than one too narrow."""
INFORMATIVE_GROUP = 0.2
"""Twice the members of a group of which the session learns something where it is as large as its prior allows for: of
less, its size is not shown at all, and stays that of the sheet."""
MIXED = 128
"""Draws of the mixture of Gaussians of which coverage factors are taken."""
SHIFT = 0.6180339887498949
"""Of a sequence of points to the next, in the unit cube."""
COVERAGE = 0.9545
MOST_DEGREES = 1e6


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Posterior:
    """What is known of gravity and the parameters with the hyperparameters integrated out.

    Parameters
    ----------
    step, covariance : (1 + m,) and (1 + m, 1 + m)
        The mean step from the last linearisation, and the covariance, biases being the means over the session.
    sources
        The covariance by its sources (`tumble.inference.uncertainty_budget`); empty where they were not asked for.
    degrees : (m,)
        Degrees of freedom of Student's t with the same coverage factor.
    process_step, process_covariance : (n,) and (n, n)
        Of the biases as the means of their processes, what the next minute's or another day's are about.
    points, effective, pareto
        How many points there were, their effective number, and the Pareto shape of the weights.
    u_error
        The largest error by the points, of a u, relative, or of a value, in u; 0 of the maximum alone.
    hyperparameters : (D, 3)
        Median, lower and upper limit of the middle 68 % of every hyperparameter, SI.
    """

    step: Array
    covariance: Array
    sources: Mapping[str, Array]
    degrees: Array
    process_step: Array
    process_covariance: Array
    points: int
    effective: float
    pareto: float
    u_error: float
    hyperparameters: Array


def posterior(fitted: Maximum, *, integrate: bool = True, by_source: bool = True) -> Posterior:
    """The posterior about a maximum, integrated over the hyperparameters or at the maximum itself, there with its
    sources or without."""
    proposal = Proposal.about(fitted) if integrate and len(fitted.solution.parameters) <= MOST_PARAMETERS else None
    if proposal is None or not (len(proposal.outer) or len(proposal.inner)):
        return _at_maximum(fitted, contributions(fitted.solution) if by_source else {})
    np.empty(KEPT_MEMORY, dtype=np.uint8)
    count = max(POINTS if len(proposal.inner) else 2 * POINTS, 2 * (len(proposal.outer) + SPARE)) // 2
    for drawn in zip(*(_rounds(fitted, proposal, count, number) for number in (0, 1)), strict=True):
        error, least = _error(drawn), FEW if len(drawn[0].phi) == count else MANY
        if error < SETTLED and min(each.effective for each in drawn) > least:
            break
    both = Draws.joined(drawn)
    mean, within, between = both.moments()
    sources = scaled_to(contributions(_typical(fitted, both)), within) | {"hyperparameters": between}
    covariance = np.sum(list(sources.values()), axis=0)
    means, deviations, share = both.mixture()
    factor = coverage_factors(means - mean, deviations, share, np.sqrt(np.diag(covariance)))
    shorter = np.where(factor > 0.0, np.minimum(0.5 * factor, 1.0), 1.0)
    process_mean, process_within, process_between = both.moments(process=True)
    return Posterior(
        step=mean,
        covariance=covariance * np.outer(shorter, shorter),
        sources={name: each * np.outer(shorter, shorter) for name, each in sources.items()},
        degrees=degrees_of(factor[1:]),
        process_step=process_mean,
        process_covariance=process_within + process_between,
        points=len(both.triangles.right),
        effective=both.effective,
        pareto=both.smoothed[1],
        u_error=error,
        hyperparameters=_summary(fitted, both.phi.reshape(both.weight.size, -1), both.weight.ravel()),
    )


def _at_maximum(fitted: Maximum, sources: Mapping[str, Array]) -> Posterior:
    """The posterior at the hyperparameters of the maximum, of which the covariance has these sources."""
    here = conditional(fitted.solution)
    return Posterior(
        step=here.step,
        covariance=here.covariance,
        sources=sources,
        degrees=np.full(len(here.step) - 1, MOST_DEGREES),
        process_step=here.process_step,
        process_covariance=here.process_covariance,
        points=1,
        effective=1.0,
        pareto=0.0,
        u_error=0.0,
        hyperparameters=_summary(fitted, fitted.phi[None], np.ones(1)),
    )


# -------------------- points --------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Density:
    """A density along an element of φ: at points `phi` (FINE,) its logarithm, and the distribution function; or a stack
    of densities at the same points."""

    phi: Array
    log_density: Array
    cumulative: Array

    @staticmethod
    def of(phi: Array, log_density: Array) -> Density:
        """A density from its logarithm less any constant at evenly spaced points."""
        density = np.exp(log_density - log_density.max(axis=-1, keepdims=True))
        cumulative = np.zeros_like(density)
        np.cumsum(0.5 * (density[..., 1:] + density[..., :-1]), axis=-1, out=cumulative[..., 1:])
        whole = cumulative[..., -1:]
        log_density = np.log(np.maximum(density, 1e-300)) - np.log(whole * (phi[1] - phi[0]))
        return Density(phi=phi, log_density=log_density, cumulative=cumulative / whole)

    def drawn(self, z: Array) -> tuple[Array, Array]:
        """The values at normal z (P,), and the logarithms of the densities of their elements over that of z."""
        share = scipy.special.ndtr(z)
        if self.cumulative.ndim == 1:
            phi = np.interp(share, self.cumulative, self.phi)
            return phi, np.interp(phi, self.phi, self.log_density) + 0.5 * z**2
        rows = zip(share, self.cumulative, strict=True)
        phi = np.array([np.interp(each, cumulative, self.phi) for each, cumulative in rows])
        log_density = [np.interp(at, self.phi, each) for at, each in zip(phi, self.log_density, strict=True)]
        return phi, np.array(log_density) + 0.5 * z**2


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Proposal:
    """The Gaussian copula: which elements are of ψ (`outer`) and which are sizes of groups that are shown (`inner`),
    the densities along them, those along sizes of in-run biases that the data see exp(shift) times as large, each with
    the element of its correlation time, on which `spread` says how that depends, and a root of the correlations of ψ.
    """

    outer: IntArray
    inner: IntArray
    densities: dict[int, Density]
    in_run: dict[int, tuple[int, Callable[[Array], Density]]]
    spread: Callable[[Array], Array]
    root: Array

    @staticmethod
    def about(fitted: Maximum) -> Proposal:
        """The proposal by the score and the average information at the maximum."""
        hyperparameters, solution, phi, B = fitted.hyperparameters, fitted.solution, fitted.phi, fitted.curvature
        forms, densities = quadratic_forms(hyperparameters, solution), dict[int, Density]()
        sizes = [i for i, h in enumerate(hyperparameters) if isinstance(h, GroupSize)]
        if sizes:
            densities |= _densities_of_sizes(fitted, sizes)
        inner, outer = list(densities), [i for i in range(len(hyperparameters)) if i not in sizes]
        spread = partial(_spread_in_session, fitted.linearisation.noise)
        in_run = dict[int, tuple[int, Callable[[Array], Density]]]()
        along = np.eye(len(hyperparameters))
        times = _times_of(hyperparameters)
        for i, time in times.items():
            along[i, time] = (spread(phi[time] - 0.1) - spread(phi[time] + 0.1)) / 0.2
        free = [i for i in (*outer, *inner) if not (hyperparameters[i].bounded and phi[i] <= 0.0)]
        B = (along.T @ B @ along)[np.ix_(free, free)]
        size = np.sqrt(np.maximum(B.diagonal(), 1e-12))
        value, vectors = np.linalg.eigh(B / np.outer(size, size))
        correlations = (vectors / np.maximum(value, 0.1)) @ vectors.T
        longer = np.sqrt(correlations.diagonal())
        whole, curvature = np.eye(len(hyperparameters)), fitted.curvature.diagonal().copy()
        whole[np.ix_(free, free)] = correlations / np.outer(longer, longer)
        curvature[free] = size**2 / longer
        densities |= _densities_of_times(fitted, spread)
        for i in (each for each in outer if each not in densities):
            h = hyperparameters[i]
            density = partial(_size_density, h, phi[i], tuple(forms[:, i]), curvature[i])
            if i in times:
                in_run[i] = times[i], density
            else:
                densities[i] = density()
        return Proposal(
            outer=np.array(outer, dtype=int),
            inner=np.array(inner, dtype=int),
            densities=densities,
            in_run=in_run,
            spread=spread,
            root=np.asarray(np.linalg.cholesky(whole[np.ix_(outer, outer)])),
        )

    def points(self, best: Array, normal: Array) -> tuple[Array, Array]:
        """ψ in φ (K, D) by n (K, ·), all else as at `best`, and ln q (K,) at N(0, 1), less a constant."""
        phi, log_q = np.tile(best, (len(normal), 1)), -0.5 * (normal**2).sum(axis=1)
        along = dict(zip(self.outer.tolist(), (normal @ self.root.T).T, strict=True))
        for i in sorted(along, key=self.in_run.__contains__):
            density = self.densities.get(i)
            if i in self.in_run:
                time, of_shift = self.in_run[i]
                density = of_shift(self.spread(phi[:, time]) - self.spread(best[time]))
            assert density is not None
            phi[:, i], log_density = density.drawn(along[i])
            log_q += log_density
        return phi, log_q

    def with_sizes(self, phi: Array, sequence: int) -> tuple[Array, Array]:
        """Sizes of groups at each φ (K, D): φ (K, L, D), and ln q (K, L) of these sizes."""
        count = SIZES if len(self.inner) else 1
        phi, log_q = np.repeat(phi[:, None], count, axis=1), np.zeros((len(phi), count))
        for i, z in zip(self.inner.tolist(), normal_points(log_q.size, len(self.inner), sequence).T, strict=True):
            values, log_density = self.densities[i].drawn(z)
            phi[:, :, i] = values.reshape(log_q.shape)
            log_q += (log_density - 0.5 * z**2).reshape(log_q.shape)
        return phi, log_q


def _times_of(hyperparameters: Hyperparameters) -> dict[int, int]:
    """Of every size of in-run biases the element that is their correlation time."""
    sizes, times = (
        [i for i, h in enumerate(hyperparameters) if isinstance(h, kind)] for kind in (InRunSize, CorrelationTime)
    )
    return dict(zip(sizes, times, strict=True))


def _spread_in_session(noise: NoiseModel, log_time: Array) -> Array:
    """The logarithm of the standard deviation of an in-run bias about its mean over a session, in parts of its size, at
    logarithms of its correlation time: of a bias that changes slowly a session shows but that."""
    chains = np.isinf(noise.interval).sum()
    x = np.exp(-log_time) * noise.interval[np.isfinite(noise.interval)].sum() / max(chains, 1)
    x = np.maximum(x, 1e-3)
    return np.asarray(0.5 * np.log(1.0 - 2.0 * (x + np.expm1(-x)) / x**2))


def _size_density(
    h: Hyperparameter, phi: float, forms: tuple[float, float], curvature: float, shift: float | Array = 0.0
) -> Density:
    """The density along a standard deviation by the quadratic forms of its variance and the curvature of −ℓ at the
    maximum; a stack of them where the data see it exp(shift) times as large as there."""
    square, trace = max(forms[0], 1e-6), max(forms[1], 1e-6)
    informed = curvature - float(h.log_prior(np.array(phi))[2])
    share = float(np.clip(informed / (2.0 * square), 1e-3, 1.0 - 1e-6))  # 1/(u + 1)
    half = REACH * float(np.clip(curvature**-0.5, 0.5, 1.5))
    grid = np.linspace(min(-3.0 * h.within, phi - half) if h.bounded else phi - half, phi + half, FINE)
    above = np.maximum(grid, 0.0) - max(phi, 0.0) if h.bounded else grid - phi
    w = 1.0 / share - 1.0 + np.exp(2.0 * (above + np.asarray(shift)[..., None]))
    likelihood = -0.5 * trace / share * np.log(w) - 0.5 * square / share**2 / w
    return Density.of(grid, h.log_prior(grid)[0] + likelihood)


def _densities_of_times(fitted: Maximum, spread: Callable[[Array], Array]) -> dict[int, Density]:
    """The densities along correlation times through the maximum, in-run biases being as large in the session as there,
    and a part of the prior."""
    hyperparameters, phi, out = fitted.hyperparameters, fitted.phi, dict[int, Density]()
    times = _times_of(hyperparameters)
    if not times:
        return out
    every, knots = np.tile(phi, (len(times), 1 + len(TIMES), 1)), list[Array]()
    for rows, (size, time) in zip(every, times.items(), strict=True):
        h = hyperparameters[time]
        knots.append(np.sort(np.append(h.centre + TIMES * h.within, phi[time])))
        rows[:, time] = knots[-1]
        rows[:, size] += spread(phi[time]) - spread(knots[-1])
    flat = every.reshape(-1, len(phi))
    posterior = solution_at(fitted.linearisation, hyperparameters, flat).log_posterior
    likelihood = (posterior - hyperparameters.log_prior(flat)[0].sum(axis=-1)).reshape(every.shape[:2])
    for time, x, y in zip(times.values(), knots, likelihood, strict=True):
        h = hyperparameters[time]
        grid = np.linspace(x[0] - h.within, x[-1] + h.within, FINE)
        log_prior_there = h.log_prior(grid)[0]
        prior, density = (np.exp(each) for each in (log_prior_there, np.interp(grid, x, y - y.max()) + log_prior_there))
        mixed = (1.0 - DEFENCE) * density / density.sum() + DEFENCE * prior / prior.sum()
        out[time] = Density.of(grid, np.log(mixed + 1e-300))
    return out


# -------------------- sizes folded into triangles --------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Triangles:
    """What is known at K points of ψ, with the sizes of some groups yet to be folded in.

    Parameters
    ----------
    information, right : (K, g, g) and (K, g)
        Λ and h of the parameters c of these groups, about their expected values.
    deviance : (K,)
        −2 ln L where all of them are zero.
    alpha, gamma, omega : (K, 1 + m), (K, 1 + m, g) and (K, 1 + m, 1 + m)
        The step of gravity and the parameters, biases being the means over the session, is α + Γ c, of covariance Ω at
        given c.
    process_alpha, process_gamma, process_omega : (K, n), (K, n, g) and (K, n, n)
        The same of the biases as the means of their processes.
    """

    information: Array
    right: Array
    deviance: Array
    alpha: Array
    gamma: Array
    omega: Array
    process_alpha: Array
    process_gamma: Array
    process_omega: Array

    @staticmethod
    def joined(parts: Sequence[Triangles]) -> Triangles:
        """Several sets of points as one."""
        return Triangles(
            **{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Triangles)}
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Folded:
    """The parameters c of groups with priors of L standard deviations `sizes` (L, g) folded into what is known of them:
    their `values` (L, g), ln L (L,) less its value where they are zero, and `factors` of B (L, g, g)."""

    sizes: Array
    values: Array
    log_likelihood: Array
    factors: Array

    @staticmethod
    def of(information: Array, right: Array, sizes: Array) -> Folded:
        """Priors of these sizes folded into Λ (g, g) and h (g,)."""
        factors = np.empty((*sizes.shape, len(right)))
        values, log_likelihood = np.empty(sizes.shape), np.empty(len(sizes))
        fold_sizes(information, right, sizes, factors, values, log_likelihood)
        if not np.isfinite(log_likelihood.sum()):
            raise np.linalg.LinAlgError("Matrix is not positive definite")
        return Folded(sizes=sizes, values=values, log_likelihood=log_likelihood, factors=factors)

    def covariance(self, weight: Array) -> Array:
        """The mean (g, g) of the covariances of c, by weights (L,) of the sizes."""
        out = np.empty(self.factors.shape[1:])
        mean_covariance(self.factors, self.sizes, weight, np.empty(out.shape), out)
        return out


def triangles(
    linearisation: Linearisation, hyperparameters: Hyperparameters, phi: Array, members: IntArray
) -> Triangles:
    """The triangles at φ (K, D), whatever this has for the groups whose parameters are `members` (g,) of those of the
    instrument."""
    many, out = max(1, RESTS_AT_ONCE // len(linearisation.problem.link)), list[Triangles]()
    for first in range(0, len(phi), many):
        problem, components = scaled(linearisation.problem, hyperparameters, phi[first : first + many])
        open_u = problem.prior_u.copy()
        open_u[:, 1 + members] = np.inf
        here = linearisation.with_priors(problem.with_sizes(open_u, problem.local_u)).with_components(components)
        out.append(_triangles(here, 1 + members))
    return Triangles.joined(out)


def _triangles(here: Linearisation, places: IntArray) -> Triangles:
    """The triangles at a stack of components of variance and of priors, which parameters at some places have not."""
    problem, point, equations, p = here.problem, here.point, eliminate_rests(here), here.prior.shape[-1] - 1
    exact, deviance = int(problem.prior_u[0, 0] == 0.0), rests_deviance(equations)  # gravity
    others = np.setdiff1d(np.arange(exact, p), places)
    order, K, o = np.concatenate([others, places, [p]]), len(deviance), slice(len(others))
    heads, R, inverse = list[list[Array]](), np.empty((K, len(order), len(order))), np.empty((K, o.stop, o.stop))
    for k, factors in enumerate(equations.session_factors):
        triangle, of_sessions = fold_sessions(here.prior[k], factors, problem.local_u[k], here.local_prior[k])
        heads.append(of_sessions)
        R[k] = triangle[exact:, order]
    moved = np.flatnonzero(order != np.arange(exact, p + 1))
    if len(moved):
        R[:, moved[0] :, moved[0] :] = np.linalg.qr(R[:, moved[0] :, moved[0] :], mode="r")
    for k in range(K):
        inverse[k] = inverse_of(R[k, o, o])
    g, off = slice(o.stop, -1), (problem.prior_mean - np.append(point.gravity, point.values))[places]
    G = R[:, g, g]
    r = R[:, g, -1] - G @ off
    alpha, gamma, omega = np.zeros((K, p)), np.zeros((K, p, len(places))), np.zeros((K, p, p))
    alpha[:, places], gamma[:, places, np.arange(len(places))] = off, 1.0
    alpha[:, others] = (inverse @ (R[:, o, -1] - R[:, o, g] @ off)[:, :, None])[:, :, 0]
    gamma[:, others] = -inverse @ R[:, o, g]
    omega[:, others[:, None], others] = inverse @ np.swapaxes(inverse, 1, 2)
    kept = np.setdiff1d(np.arange(1 + problem.instrument.linear_count, p), places)
    sizes = np.log(problem.prior_u[:, kept]).sum(axis=1) + len(problem.parts) * np.log(problem.local_u).sum(axis=1)
    pivots = np.log(np.abs(np.diagonal(R[:, o, o], axis1=1, axis2=2))).sum(axis=1)
    pivots += [sum(np.log(np.abs(head.diagonal())).sum() for head in of_sessions) for of_sessions in heads]
    biases = 1 + problem.biases
    process = alpha[:, biases], gamma[:, biases], omega[:, biases[:, None], biases]
    if equations.wanders and len(problem.parts) == 1:
        by_shared, by_noise = session_mean_bias(equations)
        pairs = (mean_by_common(each, head) for each, (head,) in zip(by_shared, heads, strict=True))
        by_common, by_local = (np.array(each) for each in zip(*pairs, strict=True))
        by = by_common[:, :, :-1]
        alpha[:, biases] += (by @ alpha[:, :, None])[:, :, 0] - by_common[:, :, -1]
        gamma[:, biases] += by @ gamma
        omega[:, biases] += by @ omega
        omega[:, :, biases] += omega @ np.swapaxes(by, 1, 2)
        noise = np.concatenate([np.swapaxes(by_noise, 1, 2).reshape(K, len(biases), -1), by_local], axis=2)
        omega[:, biases[:, None], biases] += noise @ np.swapaxes(noise, 1, 2)
    return Triangles(
        information=np.swapaxes(G, 1, 2) @ G,
        right=(r[:, None] @ G)[:, 0],
        deviance=deviance + 2.0 * (pivots + sizes) + (r**2).sum(axis=1) + R[:, -1, -1] ** 2,
        alpha=alpha,
        gamma=gamma,
        omega=omega,
        process_alpha=process[0],
        process_gamma=process[1],
        process_omega=process[2],
    )


def members_of(fitted: Maximum, elements: IntArray) -> tuple[IntArray, IntArray]:
    """The parameters (g,) of the groups of some elements of φ, and the element (g,) of each."""
    hyperparameters, places = fitted.hyperparameters, np.arange(len(fitted.problem.instrument.names))
    every = [places[hyperparameters[i].members] for i in elements]
    number = [np.full(len(each), i) for i, each in zip(elements.tolist(), every, strict=True)]
    none = [np.zeros(0, dtype=int)]
    return np.concatenate(none + every), np.concatenate(none + number)


def _densities_of_sizes(fitted: Maximum, sizes: list[int]) -> dict[int, Density]:
    """The densities along those sizes of groups of which the session shows something, through the maximum."""
    hyperparameters, phi = fitted.hyperparameters, fitted.phi
    members, element = members_of(fitted, np.array(sizes))
    triangle, out = triangles(fitted.linearisation, hyperparameters, phi[None], members), dict[int, Density]()
    usual = fitted.usual_problem.usual_u[1 + members]
    S = usual * np.exp(np.maximum(phi[element], 0.0))
    every = Folded.of(triangle.information[0], triangle.right[0], S[None])
    covariance, value = every.covariance(np.ones(1)), every.values[0]
    learned, one = quadratic_forms(hyperparameters, fitted.solution)[1], int(np.argmin(np.abs(KNOTS - 1.0)))
    for i in sizes:
        h, at_bound, own = hyperparameters[i], phi[i] <= 0.0, np.flatnonzero(element == i)
        curvature = 2.0 * float(learned[i]) + h.within**-2 if at_bound else fitted.curvature[i, i]
        size = max(curvature, h.within**-2) ** -0.5
        p = max(phi[i], 0.0) + KNOTS * size if at_bound else np.linspace(0.0, phi[i] + KNOTS[-1] * size, 2 * len(KNOTS))
        inverse = np.asarray(
            np.linalg.inv(covariance[np.ix_(own, own)]), dtype=float
        )  # beside the priors of all others
        sized = usual[own] * np.exp(p)[:, None]
        folded = Folded.of(inverse - np.diag(S[own] ** -2), inverse @ value[own], sized)
        if at_bound:
            variance = np.diag(folded.covariance(np.eye(len(p))[one])) / sized[one] ** 2
            if 2.0 * np.clip(1.0 - variance, 0.0, 1.0).sum() <= INFORMATIVE_GROUP:
                continue
        grid = np.linspace(-3.0 * h.within, p[-1], FINE)
        likelihood = np.interp(grid, p, folded.log_likelihood - folded.log_likelihood[0])
        out[i] = Density.of(grid, likelihood + h.log_prior(grid)[0])
    return out


# -------------------- draws --------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Draws:
    """K points of ψ, L sizes of groups at each, and the posterior there.

    Parameters
    ----------
    phi, log_weight : (K, L, D) and (K, L)
        φ, and the logarithms of the weights.
    sizes : (K, L, g)
        Standard deviations of the priors of the parameters of the groups.
    triangles
        What is known at the points of ψ.
    value, within, between : (K, g), (K, g, g) and (K, g, g)
        At each point the mean of the parameters of the groups over the sizes, the mean of their covariances, and the
        covariance of their values.
    step, variance : (K, 1 + m)
        At each point the mean step of gravity and the parameters, and their variances.
    """

    phi: Array
    log_weight: Array
    sizes: Array
    triangles: Triangles
    value: Array
    within: Array
    between: Array
    step: Array
    variance: Array

    @staticmethod
    def joined(parts: Sequence[Draws]) -> Draws:
        """Several sets of points as one."""
        names = [each.name for each in fields(Draws) if each.name != "triangles"]
        arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        return Draws(triangles=Triangles.joined([part.triangles for part in parts]), **arrays)

    @cached_property
    def smoothed(self) -> tuple[Array, float]:
        """The weights (K,) of the points, and their shape."""
        return smoothed(scipy.special.logsumexp(self.log_weight, axis=1))

    @property
    def effective(self) -> float:
        """The effective number of points."""
        return float(1.0 / (self.smoothed[0] ** 2).sum())

    @property
    def weight(self) -> Array:
        """The weights (K, L) of all draws."""
        return np.asarray(self.smoothed[0][:, None] * scipy.special.softmax(self.log_weight, axis=1))

    @property
    def u(self) -> Array:
        """Standard uncertainties (1 + m,) of gravity and the parameters."""
        weight = self.smoothed[0]
        return np.asarray(np.sqrt(weight @ self.variance + weight @ (self.step - weight @ self.step) ** 2))

    def moments(self, *, process: bool = False) -> tuple[Array, Array, Array]:
        """The mean step (1 + m,), the mean of the covariances at the draws (1 + m, 1 + m), and the covariance of the
        steps; where `process`, of the biases (n,) as the means of their processes."""
        prefix, weight = "process_" if process else "", self.smoothed[0]
        alpha, gamma, omega = (getattr(self.triangles, prefix + name) for name in ("alpha", "gamma", "omega"))

        def carried(of_groups: Array) -> Array:
            """Σ w Γ (…) Γᵀ."""
            by = np.swapaxes(weight[:, None, None] * (gamma @ of_groups), 0, 1).reshape(gamma.shape[1], -1)
            return np.asarray(by @ np.swapaxes(gamma, 0, 1).reshape(gamma.shape[1], -1).T)

        steps = alpha + (gamma @ self.value[:, :, None])[:, :, 0]
        mean = weight @ steps
        off = steps - mean
        within = np.tensordot(weight, omega, axes=1) + carried(self.within)
        return mean, within, (off.T * weight) @ off + carried(self.between)

    def mixture(self) -> tuple[Array, Array, Array]:
        """Of the mixture of Gaussians, of which MIXED are drawn, their means and standard deviations (·, 1 + m), and
        their weights (·,)."""
        weight, every = np.cumsum(self.weight.ravel()), self.triangles
        drawn, count = np.unique(np.searchsorted(weight, (np.arange(MIXED) + 0.5) / MIXED), return_counts=True)
        point, size = np.divmod(np.minimum(drawn, len(weight) - 1), self.sizes.shape[1])
        means, variance = every.alpha[point], np.diagonal(every.omega, axis1=1, axis2=2)[point]
        for row, (k, of_point) in enumerate(zip(point.tolist(), self.sizes[point, size], strict=True)):
            gamma, folded = every.gamma[k], Folded.of(every.information[k], every.right[k], of_point[None])
            means[row] += gamma @ folded.values[0]
            variance[row] += ((gamma @ folded.covariance(np.ones(1))) * gamma).sum(axis=1)
        return means, np.sqrt(variance), count / MIXED


def _drawn(fitted: Maximum, proposal: Proposal, normal: Array, sequence: int) -> Draws:
    """Draws at points n (K, ·) of the copula, with sizes of a sequence at each, weighted as if drawn from N(0, 1)."""
    hyperparameters, (members, element) = fitted.hyperparameters, members_of(fitted, proposal.inner)
    phi, log_q = proposal.points(fitted.phi, normal)
    phi, log_q_sizes = proposal.with_sizes(phi, sequence)
    sizes = fitted.usual_problem.usual_u[1 + members] * np.exp(np.maximum(phi[:, :, element], 0.0))
    every = triangles(fitted.linearisation, hyperparameters, phi[:, 0], members)
    log_q = log_q[:, None] + log_q_sizes
    log_weight = hyperparameters.log_prior(phi)[0].sum(axis=-1) - log_q - 0.5 * every.deviance[:, None]
    value, (within, between) = np.zeros_like(every.right), np.zeros((2, *every.information.shape))
    for k, of_point in enumerate(sizes if len(members) else ()):
        folded = Folded.of(every.information[k], every.right[k], of_point)
        log_weight[k] += folded.log_likelihood
        w = scipy.special.softmax(log_weight[k])
        value[k], within[k] = w @ folded.values, folded.covariance(w)
        off = folded.values - value[k]
        between[k] = (off.T * w) @ off
    of_groups = ((every.gamma @ (within + between)) * every.gamma).sum(axis=2)
    return Draws(
        phi=phi,
        log_weight=log_weight,
        sizes=sizes,
        triangles=every,
        value=value,
        within=within,
        between=between,
        step=every.alpha + (every.gamma @ value[:, :, None])[:, :, 0],
        variance=np.diagonal(every.omega, axis1=1, axis2=2) + of_groups,
    )


def _error(drawn: Sequence[Draws]) -> float:
    """Half the difference of two sets of draws, of the parameter of which it is largest: that of u, relative, or that
    of the value, in u."""
    (first, second), (mean, other) = (each.u for each in drawn), (each.smoothed[0] @ each.step for each in drawn)
    difference = np.maximum(np.abs(first - second), np.abs(mean - other))
    return float(np.max(difference / np.maximum(first + second, 1e-300)))


def _rounds(fitted: Maximum, proposal: Proposal, count: int, sequence: int) -> Iterator[Draws]:
    """Draws of one set after each round of adaptive importance sampling: `count` points of the copula, then OF_ROUND
    more of a normal distribution of n by the weights of all before."""
    D = len(proposal.outer)
    components: list[tuple[Array, Array]] = [(np.zeros(D), np.eye(D))]  # mean and root of the covariance of n
    numbers, normal, parts = [count], np.zeros((0, D)), list[Draws]()
    for number in range(ROUNDS):
        mean, root = components[-1]
        new = mean + normal_points(numbers[-1], D, sequence + 2 * number) @ root.T
        normal = np.concatenate([normal, new])
        parts.append(_drawn(fitted, proposal, new, sequence + 2 * number))
        every = Draws.joined(parts)
        share = np.log(numbers) - np.log(len(normal))
        mixture = np.array([_log_normal(normal, *each) for each in components]) + share[:, None]
        from_copula = -0.5 * (normal**2).sum(axis=1) - scipy.special.logsumexp(mixture, axis=0)
        every = replace(every, log_weight=every.log_weight + from_copula[:, None])
        yield every
        weight = _tempered(scipy.special.logsumexp(every.log_weight, axis=1), min(2.0 * D, TEMPERED * len(normal)))
        mean = weight @ normal
        covariance = ((normal - mean).T * weight) @ (normal - mean)
        wider = WIDER * (TRUSTED * covariance + np.diag((1.0 - TRUSTED) * covariance.diagonal() + LEAST))
        components.append((mean, np.asarray(np.linalg.cholesky(wider), dtype=float)))
        numbers.append(OF_ROUND)


def _log_normal(points: Array, middle: Array, root: Array) -> Array:
    """ln of the normal density (K,) by mean and a root of the covariance at points (K, D), less a constant of D."""
    off = scipy.linalg.solve_triangular(root, (points - middle).T, lower=True)
    return np.asarray(-0.5 * (off**2).sum(axis=0) - np.log(root.diagonal()).sum())


def _tempered(log_weight: Array, enough: float) -> Array:
    """Weights w^β (K,) with the largest β ≤ 1 of a geometric sequence at which `enough` points are effective."""
    tempered = log_weight - log_weight.max()
    while np.exp(tempered).sum() ** 2 < enough * np.exp(2.0 * tempered).sum():
        tempered = 0.85 * tempered
    return np.asarray(scipy.special.softmax(tempered))


def _typical(fitted: Maximum, draws: Draws) -> Solution:
    """The solution with every standard deviation as its root mean square over the draws, and every time as the mean of
    its logarithm."""
    typical = fitted.phi.copy()
    for i, h in enumerate(fitted.hyperparameters):
        phi = draws.phi[..., i]
        if isinstance(h, CorrelationTime):
            typical[i] = (draws.weight * phi).sum()
        else:
            typical[i] = 0.5 * np.log((draws.weight * h.value(phi) ** 2).sum())
    return solution_at(fitted.linearisation, fitted.hyperparameters, typical)


# -------------------- at a maximum --------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Conditional:
    """ℓ at φ, and there the step of gravity and the parameters (1 + m,) and its covariance, both with the biases of the
    session, and the step and the covariance of the biases of the processes."""

    value: Array
    step: Array
    covariance: Array
    process_step: Array
    process_covariance: Array


def covariance_with_local(solution: Solution, some: slice) -> Array:
    """The covariance (k, 1 + m) of some of what a session has beside with gravity and the parameters, biases being
    those of the session."""
    return np.asarray(solution.roots[0, some] @ _session_root(solution)[0].T)


def _session_root(solution: Solution) -> tuple[Array, tuple[Array, Array] | None]:
    """A root of the covariance of gravity and the parameters as far as they are uncertain by what they have in common
    with the session, biases being those of the session, and the mean of these (`session_mean_bias`) where they
    wander."""
    roots = solution.roots[..., 0, :, :]
    root, mean = roots[..., len(solution.problem.usual_local_u) :, :].copy(), None
    if solution.equations.wanders and len(solution.problem.parts) == 1:
        mean = session_mean_bias(solution.equations)
        root[..., 1 + solution.problem.biases, :] += mean[0][..., :-1] @ roots
    return root, mean


def conditional(solution: Solution) -> Conditional:
    """The posterior at φ, or at a stack of them."""
    biases, problem = 1 + solution.problem.biases, solution.problem
    step, (root, mean) = solution.parameters.copy(), _session_root(solution)
    process, by_noise = solution.roots[..., 0, len(problem.usual_local_u) :, :][..., biases, :], None
    if mean is not None:
        by_shared, by_noise = mean
        step[..., biases] += (by_shared @ solution.shared[..., 0, :, None])[..., 0]
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


def is_poorly_sampled(integral: Integral) -> bool:
    """Whether an integral rests on a few points: by the error of u, or by their effective number."""
    return integral.u_error > SETTLED or (integral.points > 1 and integral.effective < 2.0 * FEW)


def normal_points(points: int, dimensions: int, sequence: int = 0) -> Array:
    """Points (points, D) of the normal distribution, of its mean and covariance: an additive recurrence of low
    discrepancy in the unit cube, by the root of x^{D+1} = x + 1, made so. Sequences of other numbers are shifted."""
    root = 2.0
    for _ in range(60):
        root = (1.0 + root) ** (1.0 / (dimensions + 1.0))
    steps = root ** -np.arange(1.0, dimensions + 1.0)
    normal = scipy.special.ndtri((0.5 + SHIFT * sequence + np.outer(np.arange(1, points + 1), steps)) % 1.0)
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
    out, prior_curvature = np.empty((len(fitted.phi), 3)), fitted.hyperparameters.log_prior(fitted.phi)[2]
    for i, h in enumerate(fitted.hyperparameters):
        at, order = fitted.phi[i], np.argsort(phi[:, i])
        limits = at + np.array([0.0, -1.0, 1.0]) / np.sqrt(max(fitted.curvature[i, i], prior_curvature[i]))
        if np.ptp(phi[:, i]) > 0.0:
            share = np.cumsum(weight[order]) - 0.5 * weight[order]
            limits = np.interp([0.5, 0.16, 0.84], share, phi[order, i])
        out[i] = h.value(limits)
    return out
