"""Posterior of the parameters with the hyperparameters integrated out, by importance sampling.

Section 11 of docs/explanation/mathematics.md. φ has two parts. ψ are the hyperparameters of rows (components of
variance, in-run biases, factors of single sensors, sizes of session parameters): each point of ψ costs an elimination
of all rests. Sizes of groups, p, do not change the rows: the elimination at ψ_k leaves information Λ and h on the
groups c, into which many sizes S = λ s are folded by small matrices,

    B = 1 + S Λ S,   c = S B⁻¹ S h,   Cov c = S B⁻¹ S,   ln L = const + ½ hᵀ S B⁻¹ S h − ½ ln |B|

Groups on which the session has no information keep their usual sizes.

Proposal: a Gaussian copula, φ_i = F_i⁻¹(N(z_i)), where z has correlations from the second derivative of ℓ. Let r be the
residuals, V their covariance, P the inverse of V with all unknowns eliminated, D = ∂V/∂v for a variance v, and
ρ = v/v̂ its ratio to that at the maximum of ℓ, the logarithm of the posterior of φ. The density f_i of F_i is

    ln f = ln p(φ) − ½ ν ln(a + ρ) − ½ κ/(a + ρ)
    1/(a + 1) = v̂ rᵀPDPDPr/rᵀPDPr,   ν = v̂ tr PD (a + 1),   κ = v̂ rᵀPDPr (a + 1)²

which has the gradient and the average information of ℓ at the maximum. The likelihood in it is stretched about the
maximum by the root of the ratio of the standard deviations of φ_i with other elements free and held. For the size of an
in-run bias, v is its variance about the mean of the session at the correlation time of the point. For a correlation
time, at constant variance within the session, and for the size of a group the density is ℓ along it through the
maximum, mixed with the prior or, for p < 0, the prior alone.

The points z are two fixed low-discrepancy sequences, each transformed to have exactly the mean and covariance of the
normal distribution, so that a result is reproducible to the last digit. The weights w ∝ e^ℓ/q of the points of ψ, each
summed over its sizes, are Pareto smoothed (Vehtari et al. 2024). Mean and covariance are (33), coverage factors (34); u
is limited to half of the half width at 95.45 %, which few far points do not affect. The sampling error is half the
difference between the results of the two independent sequences, of a u or of a value divided by u, or, if larger, that
of a half width by the scatter of its probabilities at the points (`Draws.coverage`): where few points decide the tails,
both sequences may agree by chance.

If that error exceeds LARGEST_ERROR, or few points are effective, the proposal misses a part of the posterior: another
mode, or longer tails. Each sequence is then continued by adaptive multiple importance sampling (Cornuet et al. 2012).
Let n be z without its correlations, N(0, 1) in the copula. Each round draws n ~ N(μ, Σ), with the weighted mean and
covariance of all points so far, and all points are weighted by the mixture of their proposals,

    w ∝ (e^ℓ/q) N(n; 0, 1)/Σ_k (K_k/K) N(n; μ_k, Σ_k)

While few points are effective, μ and Σ are computed with tempered weights w^β, β < 1. Tempering concerns the next
proposal alone and Pareto smoothing the result alone: a result needs its weights unbiased, a proposal needs many points.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from typing import Self

import numpy as np
import scipy

from tumble.inference.elimination_kernels import fold_sizes, mean_covariance
from tumble.inference.estimate import Integral
from tumble.inference.hyperparameters import (
    Hyperparameter,
    Hyperparameters,
    quadratic_forms,
    scaled,
    solution_at,
)
from tumble.inference.linearisation import Linearisation
from tumble.inference.maximum import Maximum
from tumble.inference.noise import NoiseModel
from tumble.inference.normal_equations import (
    eliminate_rests,
    fold_sessions,
    inverse_of,
    mean_by_common,
    rests_deviance,
    session_mean_bias,
)
from tumble.inference.uncertainty_budget import contributions, scaled_to
from tumble.units import Array, IntArray

MOST_PARAMETERS = 200  # limit for integration: a point of a larger array costs a hundred times as much
FIRST_POINTS = 32  # points of ψ in the first round, of both sequences; twice as many without sizes of groups
SPARE_POINTS = 3  # least number of points of a sequence beyond the elements of ψ, for a covariance of full rank
ROUND_POINTS, GROWTH = 24, 1.0 / 3.0  # least number of points in a further round, relative to those so far
MOST_POINTS = 850  # points of a sequence after which no further round is drawn
SIZES = 16  # sizes of groups folded into the triangle of each point
LARGEST_ERROR = 0.1  # sampling error, in u, above which more points are taken, and finally reported
# Fewer points may agree by chance: least effective number of each sequence in the first round and of both together in
# further rounds, where the proposal depends on the points themselves, and largest reliable shape (Vehtari et al.).
FIRST_EFFECTIVE, ROUNDS_EFFECTIVE, LARGEST_SHAPE = 4.0, 24.0, 0.7
TEMPERED = 0.35  # largest effective share of points to which weights are tempered for the next proposal
# Covariance of the next proposal: share of its correlations that is used, variance added, in that of the copula, and
# factor on the sum, because a wide proposal costs less than a narrow one.
SHRINKAGE, ADDED_VARIANCE, INFLATION = 0.5, 0.05, 1.2
GRID = 241  # points of densities along elements of φ
KNOTS = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0])  # standard deviations of p where ℓ is computed
# Standard deviations of a correlation time from its centre where ℓ is computed: those of the prior or, if the curvature
# at the maximum gives less than INFORMED of one, TIME_STRETCH times as large as it gives and about the maximum.
TIMES = np.array([-3.0, -2.0, -1.4, -0.9, -0.4, 0.0, 0.4, 0.9, 1.4, 2.0, 3.0])
INFORMED, TIME_STRETCH = 0.2, 1.5
# Factor on the correlations of the second derivative for each of two elements: away from the maximum, where variances
# vanish, they are smaller. For p of λ = exp(max(p, 0)) it is the probability of p > 0: below, φ does not matter.
CORRELATED = 0.8
PRIOR_SHARE = 0.15  # share of the prior in the density along a correlation time
REACH = 8.0  # standard deviations to which densities along standard deviations extend
# Twice the sum of 1 − u²/s² over a group, below which the group keeps its usual size.
INFORMATIVE_GROUP = 0.2
MIXED = 256  # draws with sizes of groups from whose Gaussians coverage factors are computed
SHIFT = 0.6180339887498949  # offset between sequences of points in the unit cube: the golden ratio less 1
COVERAGE = 0.9545
MOST_DEGREES = 1e6
RESTS_AT_ONCE = 512  # rests of all points whose ℓ is computed together: their arrays fit into a processor cache


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Posterior:
    """Posterior of gravity and the parameters, integrated over the hyperparameters or at their maximum.

    Parameters
    ----------
    step, covariance : (1 + m,) and (1 + m, 1 + m)
        Mean step from the last linearisation, and covariance; biases are the means over the session.
    sources
        The covariance by source (`tumble.inference.uncertainty_budget`); empty if not requested.
    degrees : (m,)
        Degrees of freedom of Student's t with the same coverage factor.
    process_step, process_covariance : (n,) and (n, n)
        The same for the biases as means of their processes.
    integral
        Number and quality of the points.
    hyperparameters : (D, 3)
        Median and limits of the middle 68 % of every hyperparameter, SI.
    """

    step: Array
    covariance: Array
    sources: Mapping[str, Array]
    degrees: Array
    process_step: Array
    process_covariance: Array
    integral: Integral
    hyperparameters: Array


def posterior(fitted: Maximum, *, integrate: bool = True, by_source: bool = True) -> Posterior:
    """Return the posterior of gravity and the parameters.

    Parameters
    ----------
    fitted
        The maximum of ℓ(φ).
    integrate
        False for the posterior given the hyperparameters of the maximum.
    by_source
        False to leave out the covariance by source of the posterior at the maximum.
    """
    if not integrate or len(fitted.solution.parameters) > MOST_PARAMETERS:
        return _at_maximum(fitted, by_source)
    proposal = Proposal.at(fitted)
    if not (len(proposal.outer) or len(proposal.inner)):
        return _at_maximum(fitted, by_source)
    draws, error = _sampled(fitted, proposal)
    phi, weight = draws.phi.reshape(-1, len(fitted.phi)), draws.weight.ravel()
    parameters = len(fitted.solution.parameters)
    typical = weight @ phi  # root-mean-square standard deviations and geometric-mean times
    for i, h in enumerate(fitted.hyperparameters):
        if h.kind != "time":
            typical[i] = 0.5 * np.log(weight @ h.value(phi[:, i]) ** 2)
    solution = solution_at(fitted.linearisation, fitted.hyperparameters, typical)
    within, between = draws.moments
    p = slice(parameters)
    sources = scaled_to(contributions(solution), within[p, p]) | {"hyperparameters": between[p, p]}
    covariance = np.sum(list(sources.values()), axis=0)
    factor = draws.coverage[0][p]
    shorter = np.where(factor > 0.0, np.minimum(0.5 * factor, 1.0), 1.0)
    limit = np.outer(shorter, shorter)  # of u to half of the half width
    return Posterior(
        step=draws.mean[p],
        covariance=covariance * limit,
        sources={name: source * limit for name, source in sources.items()},
        degrees=degrees_of(factor[1:]),
        process_step=draws.mean[parameters:],
        process_covariance=(within + between)[parameters:, parameters:],
        integral=Integral(
            points=len(draws.phi), effective=draws.effective, pareto=draws.smoothed_weights[1], u_error=error
        ),
        hyperparameters=_summary(fitted, phi, weight),
    )


def _at_maximum(fitted: Maximum, by_source: bool) -> Posterior:
    """Return the posterior given the hyperparameters of the maximum."""
    solution, biases = fitted.solution, 1 + fitted.problem.biases
    root = solution.roots[0, len(fitted.problem.usual_local_u) :][biases]
    return Posterior(
        step=solution.session_step,
        covariance=solution.session_covariance,
        sources=contributions(solution) if by_source else {},
        degrees=np.full(len(solution.parameters) - 1, MOST_DEGREES),
        process_step=solution.parameters[biases],
        process_covariance=root @ root.T,
        integral=Integral(points=1, effective=1.0, pareto=0.0),
        hyperparameters=_summary(fitted, fitted.phi[None], np.ones(1)),
    )


def _sampled(fitted: Maximum, proposal: Proposal) -> tuple[Draws, float]:
    """Return the draws of both sequences, and their sampling error.

    Rounds of points are added until the error is below LARGEST_ERROR with enough effective points, or until the
    sequences end (`_rounds`)."""
    parameters, linear = len(fitted.solution.parameters), slice(1, 1 + fitted.problem.instrument.linear_count)
    count = max((1 if len(proposal.inner) else 2) * FIRST_POINTS // 2, len(proposal.outer) + SPARE_POINTS)
    for first, second in zip(*(_rounds(fitted, proposal, count, sequence) for sequence in (0, 1)), strict=True):
        both, u = Draws.joined((first, second)), np.maximum(first.u + second.u, 1e-300)
        difference = np.maximum(np.abs(first.u - second.u), np.abs(first.mean - second.mean)) / u
        error = float(np.max(difference[:parameters]))
        if len(first.phi) == count:  # first round
            enough = min(first.effective, second.effective) > FIRST_EFFECTIVE
        else:
            enough = both.effective > ROUNDS_EFFECTIVE and both.smoothed_weights[1] < LARGEST_SHAPE
        if enough and error < LARGEST_ERROR:
            error = max(error, float(both.coverage[1][linear].max()))
            if error < LARGEST_ERROR:
                break
    return both, error


def is_poorly_sampled(integral: Integral) -> bool:
    """Return True if the sampling error of an integral is large or few points are effective."""
    return integral.u_error > LARGEST_ERROR or (integral.points > 1 and integral.effective < 2.0 * FIRST_EFFECTIVE)


# -------------------- proposal --------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Density:
    """Density along an element of φ: its logarithm and the distribution function at points `phi` (GRID,).

    Both may be stacks (K, GRID) at the same points."""

    phi: Array
    log_density: Array
    cumulative: Array

    @staticmethod
    def of(phi: Array, log_density: Array) -> Density:
        """Return the density with this logarithm, up to a constant, at evenly spaced points."""
        density = np.exp(log_density - log_density.max(axis=-1, keepdims=True))
        cumulative = np.zeros_like(density)
        np.cumsum(0.5 * (density[..., 1:] + density[..., :-1]), axis=-1, out=cumulative[..., 1:])
        total = cumulative[..., -1:]
        log_density = np.log(np.maximum(density, 1e-300)) - np.log(total * (phi[1] - phi[0]))
        return Density(phi=phi, log_density=log_density, cumulative=cumulative / total)

    def quantiles(self, z: Array) -> tuple[Array, Array]:
        """Return the quantiles at normal deviates z (K,), and the logarithms of the ratios of both densities there."""
        probability = scipy.special.ndtr(z)
        if self.cumulative.ndim == 1:
            phi = np.interp(probability, self.cumulative, self.phi)
            return phi, np.interp(phi, self.phi, self.log_density) + 0.5 * z**2
        pairs = zip(probability, self.cumulative, strict=True)
        phi = np.array([np.interp(p, cumulative, self.phi) for p, cumulative in pairs])
        log_density = [np.interp(x, self.phi, row) for x, row in zip(phi, self.log_density, strict=True)]
        return phi, np.array(log_density) + 0.5 * z**2


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Proposal:
    """Gaussian copula of φ.

    Parameters
    ----------
    outer, inner
        Elements of ψ, and sizes of groups on which the session has information.
    densities
        Densities along the elements.
    in_run
        For sizes of in-run biases instead: the element of the correlation time, and the density as a function of the
        logarithm of the ratio of the standard deviation in the session, at a correlation time, to that at the maximum.
    spread
        Logarithm of the standard deviation in the session, relative to σ_b, as a function of ln τ_b.
    root
        Root of the correlations of ψ.
    """

    outer: IntArray
    inner: IntArray
    densities: dict[int, Density]
    in_run: dict[int, tuple[int, Callable[[Array], Density]]]
    spread: Callable[[Array], Array]
    root: Array

    @staticmethod
    def at(fitted: Maximum) -> Proposal:
        """Return the proposal from the derivatives of ℓ at a maximum."""
        hyperparameters, phi, D = fitted.hyperparameters, fitted.phi, len(fitted.hyperparameters)
        forms = quadratic_forms(hyperparameters, fitted.solution)
        sizes = [i for i, h in enumerate(hyperparameters) if h.kind == "group"]
        densities = _size_densities(fitted, sizes, forms[1]) if sizes else dict[int, Density]()
        inner, outer = list(densities), [i for i in range(D) if i not in sizes]

        # B by the standard deviations in the session in place of σ_b
        spread = partial(_spread_in_session, fitted.linearisation.noise)
        times, substitution = _times_of(hyperparameters), np.eye(D)
        for i, time in times.items():
            substitution[i, time] = (spread(phi[time] - 0.1) - spread(phi[time] + 0.1)) / 0.2
        B = substitution.T @ fitted.curvature @ substitution
        densities |= _time_densities(fitted, spread, np.maximum(B.diagonal(), 1e-12) ** -0.5)

        # correlations of B⁻¹, and by how much other elements widen each; p at its bound is independent
        free = [i for i in (*outer, *inner) if not (hyperparameters[i].bounded and phi[i] <= 0.0)]
        B = B[np.ix_(free, free)]
        size = np.sqrt(np.maximum(B.diagonal(), 1e-12))
        value, vectors = np.linalg.eigh(B / np.outer(size, size))
        covariance = (vectors / np.maximum(value, 0.1)) @ vectors.T
        marginal = np.sqrt(covariance.diagonal())
        correlations, stretch = np.eye(D), np.ones(D)
        correlations[np.ix_(free, free)] = covariance / np.outer(marginal, marginal)
        stretch[free] = np.sqrt(marginal)

        # densities of variances
        in_run = dict[int, tuple[int, Callable[[Array], Density]]]()
        for i in (element for element in outer if element not in densities):
            h = hyperparameters[i]
            density = partial(_variance_density, h, phi[i], tuple(forms[:, i]), fitted.information[i, i], stretch[i])
            if i in times:
                in_run[i] = times[i], density
            else:
                densities[i] = density()

        factor = np.full(D, CORRELATED)
        for i in (element for element in outer if hyperparameters[element].bounded):
            factor[i] = 1.0 - np.interp(0.0, densities[i].phi, densities[i].cumulative)
        correlations *= np.outer(factor, factor)
        np.fill_diagonal(correlations, 1.0)
        return Proposal(
            outer=np.array(outer, dtype=int),
            inner=np.array(inner, dtype=int),
            densities=densities,
            in_run=in_run,
            spread=spread,
            root=np.asarray(np.linalg.cholesky(correlations[np.ix_(outer, outer)])),
        )

    def points(self, best: Array, normal: Array) -> tuple[Array, Array]:
        """Return φ (K, D) with ψ at n (K, ·) and other elements as in `best`, and ln q (K,) up to a constant."""
        phi, log_q = np.tile(best, (len(normal), 1)), -0.5 * (normal**2).sum(axis=1)
        z = dict(zip(self.outer.tolist(), (normal @ self.root.T).T, strict=True))
        after_their_times = [i for i in z if i in self.in_run]  # sizes of in-run biases
        for i in (*(i for i in z if i not in self.in_run), *after_their_times):
            if i in self.in_run:
                time, density_at = self.in_run[i]
                density = density_at(self.spread(phi[:, time]) - self.spread(best[time]))
            else:
                density = self.densities[i]
            phi[:, i], log_density = density.quantiles(z[i])
            log_q += log_density
        return phi, log_q

    def with_sizes(self, phi: Array, sequence: int) -> tuple[Array, Array]:
        """Return φ (K, L, D) with L draws of the sizes of groups at each φ (K, D), and ln q (K, L) of these sizes."""
        count = SIZES if len(self.inner) else 1
        phi, log_q = np.repeat(phi[:, None], count, axis=1), np.zeros((len(phi), count))
        for i, z in zip(self.inner.tolist(), normal_points(log_q.size, len(self.inner), sequence).T, strict=True):
            values, log_density = self.densities[i].quantiles(z)
            phi[:, :, i] = values.reshape(log_q.shape)
            log_q += (log_density - 0.5 * z**2).reshape(log_q.shape)
        return phi, log_q


def _times_of(hyperparameters: Hyperparameters) -> dict[int, int]:
    """Return the element of the correlation time for each element of the size of in-run biases."""
    sizes, times = ([i for i, h in enumerate(hyperparameters) if h.kind == kind] for kind in ("process", "time"))
    return dict(zip(sizes, times, strict=True))


def _spread_in_session(noise: NoiseModel, log_time: Array) -> Array:
    """Return ln of the standard deviation of an in-run bias about its mean over a session of length T, relative to σ_b:
    ½ ln(1 − 2 (x − 1 + e^{−x})/x²), x = T/τ."""
    interval = noise.interval[:, 0]
    total, chains = interval[np.isfinite(interval)].sum(), max(np.isinf(interval).sum(), 1)  # T is the mean over chains
    x = np.maximum(np.exp(-log_time) * total / chains, 1e-3)
    return np.asarray(0.5 * np.log(1.0 - 2.0 * (x + np.expm1(-x)) / x**2))


def _variance_density(
    h: Hyperparameter,
    phi: float,
    forms: tuple[float, float],
    curvature: float,
    stretch: float,
    shift: float | Array = 0.0,
) -> Density:
    """Return the density along ln σ from the quadratic forms of σ² and minus the second derivative of ℓ at the maximum.

    The likelihood is stretched about the maximum. At a `shift` (or stack of them) the standard deviation in the session
    is exp(shift) times that at the maximum."""
    square, trace = max(forms[0], 1e-6), max(forms[1], 1e-6)
    informed = curvature - float(h.log_prior(np.array(phi))[2])
    share = float(np.clip(informed / (2.0 * square), 1e-3, 1.0 - 1e-6))  # 1/(a + 1)
    half = REACH * float(np.clip(stretch * curvature**-0.5, 0.5, 1.5))
    grid = np.linspace(min(-3.0 * h.within, phi - half) if h.bounded else phi - half, phi + half, GRID)
    above = np.maximum(grid, 0.0) - max(phi, 0.0) if h.bounded else grid - phi
    sum_of_a_and_rho = 1.0 / share - 1.0 + np.exp(2.0 * (above + np.asarray(shift)[..., None]) / stretch)
    likelihood = -0.5 * trace / share * np.log(sum_of_a_and_rho) - 0.5 * square / share**2 / sum_of_a_and_rho
    return Density.of(grid, h.log_prior(grid)[0] + likelihood)


def _time_densities(fitted: Maximum, spread: Callable[[Array], Array], deviations: Array) -> dict[int, Density]:
    """Return densities along correlation times, mixed with the prior, at constant standard deviation in the session;
    `deviations` (D,) are standard deviations with other elements of φ held."""
    hyperparameters, phi, out = fitted.hyperparameters, fitted.phi, dict[int, Density]()
    times = _times_of(hyperparameters)
    if not times:
        return out
    points, knots, scales = np.tile(phi, (len(times), 1 + len(TIMES), 1)), list[Array](), list[float]()
    for rows, (size, time) in zip(points, times.items(), strict=True):
        h, centre = hyperparameters[time], hyperparameters[time].centre
        scales.append(h.within)
        if deviations[time] < INFORMED * h.within:
            centre, scales[-1] = phi[time], TIME_STRETCH * deviations[time]
        knots.append(np.sort(np.append(centre + TIMES * scales[-1], phi[time])))
        rows[:, time] = knots[-1]
        rows[:, size] += spread(phi[time]) - spread(knots[-1])
    flat = points.reshape(-1, len(phi))
    log_posterior = np.concatenate(
        [
            solution_at(fitted.linearisation, hyperparameters, part).log_posterior
            for part in _in_parts(fitted.linearisation, flat)
        ]
    )
    likelihood = (log_posterior - hyperparameters.log_prior(flat)[0].sum(axis=-1)).reshape(points.shape[:2])
    for time, x, y, scale in zip(times.values(), knots, likelihood, scales, strict=True):
        grid = np.linspace(x[0] - scale, x[-1] + scale, GRID)
        log_prior = hyperparameters[time].log_prior(grid)[0]
        prior, density = np.exp(log_prior), np.exp(np.interp(grid, x, y - y.max()) + log_prior)
        mixture = (1.0 - PRIOR_SHARE) * density / density.sum() + PRIOR_SHARE * prior / prior.sum()
        out[time] = Density.of(grid, np.log(mixture + 1e-300))
    return out


# -------------------- sizes folded into triangles --------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Triangles:
    """Posterior at K points of ψ, with the sizes of some groups not yet folded in.

    Parameters
    ----------
    information, right : (K, g, g) and (K, g)
        Λ and h of the parameters c of these groups, relative to their prior means.
    deviance : (K,)
        −2 ln L at c = 0.
    alpha, gamma, omega : (K, y), (K, y, g) and (K, y, y)
        Given c, the step of y quantities is α + Γ c, with covariance Ω. These are gravity and the parameters (1 + m),
        biases being the means over the session, and then the biases (n) as means of their processes.
    """

    information: Array
    right: Array
    deviance: Array
    alpha: Array
    gamma: Array
    omega: Array

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return several sets of points as one."""
        if len(parts) == 1:
            return parts[0]
        return cls(**{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)})


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Folded:
    """Posterior of the parameters c of groups for L prior standard deviations `sizes` (L, g).

    `values` (L, g) of c, ln L (L,) relative to c = 0, and `factors` (L, g, g) of B."""

    sizes: Array
    values: Array
    log_likelihood: Array
    factors: Array

    @staticmethod
    def of(information: Array, right: Array, sizes: Array) -> Folded:
        """Fold priors of these sizes into Λ (g, g) and h (g,)."""
        factors = np.zeros((*sizes.shape, len(right)))
        values, log_likelihood = np.empty(sizes.shape), np.empty(len(sizes))
        fold_sizes(information, right, sizes, factors, values, log_likelihood)
        if not np.isfinite(log_likelihood.sum()):
            raise np.linalg.LinAlgError("Matrix is not positive definite")
        return Folded(sizes=sizes, values=values, log_likelihood=log_likelihood, factors=factors)

    def covariance(self, weight: Array) -> Array:
        """Return the mean (g, g) of the covariances of c with weights (L,) of the sizes."""
        out = np.empty(self.factors.shape[1:])
        mean_covariance(self.factors, self.sizes, weight, np.empty(out.shape), out)
        return out


def triangles(
    linearisation: Linearisation, hyperparameters: Hyperparameters, phi: Array, members: IntArray
) -> Triangles:
    """Return the triangles at φ (K, D) without the priors of the parameters `members` (g,)."""
    out = list[Triangles]()
    for part in _in_parts(linearisation, phi):
        problem, components = scaled(linearisation.problem, hyperparameters, part)
        open_u = problem.prior_u.copy()
        open_u[:, 1 + members] = np.inf
        here = linearisation.with_priors(problem.with_sizes(open_u, problem.local_u)).with_components(components)
        out.append(_triangles(here, 1 + members))
    return Triangles.joined(out)


def _in_parts(linearisation: Linearisation, phi: Array) -> Iterator[Array]:
    """Return the points φ (K, D) in parts that are computed together."""
    count = max(1, RESTS_AT_ONCE // len(linearisation.problem.chain))
    return (phi[first : first + count] for first in range(0, len(phi), count))


def _triangles(here: Linearisation, places: IntArray) -> Triangles:
    """Return the triangles at a stack of components of variance and priors; the parameters c at `places` have none.

    With o all other parameters, and c̄ the step to the prior mean of c, the triangle of all sessions is

        R_oo  R_oc | r_o
              R_cc | r_c        Λ = R_ccᵀ R_cc,   h = R_ccᵀ (r_c − R_cc c̄)
    """
    problem, point, equations = here.problem, here.point, eliminate_rests(here)
    K, p = len(equations.session_factors), here.prior.shape[-1] - 1
    exact = int(problem.prior_u[0, 0] == 0.0)  # 1 if gravity is exact
    others = np.setdiff1d(np.arange(exact, p), places)
    order, o, c = np.concatenate([others, places, [p]]), slice(len(others)), slice(len(others), -1)
    heads, R = list[list[Array]](), np.empty((K, len(order), len(order)))
    for k, factors in enumerate(equations.session_factors):
        triangle, session_heads = fold_sessions(here.prior[k], factors, problem.local_u[k], here.local_prior[k])
        heads.append(session_heads)
        R[k] = triangle[exact:, order]
    permuted = np.flatnonzero(order != np.arange(exact, p + 1))
    if len(permuted):
        first = permuted[0]
        R[:, first:, first:] = np.linalg.qr(R[:, first:, first:], mode="r")
    R_cc, inverse = R[:, c, c], np.array([inverse_of(R_oo) for R_oo in R[:, o, o]])
    mean = (problem.prior_mean - np.append(point.gravity, point.values))[places]  # c̄
    r = R[:, c, -1] - R_cc @ mean

    # step α + Γ c and covariance Ω of gravity and the parameters, and of the biases again
    alpha, gamma, omega = np.zeros((K, p)), np.zeros((K, p, len(places))), np.zeros((K, p, p))
    alpha[:, places], gamma[:, places, np.arange(len(places))] = mean, 1.0
    alpha[:, others] = (inverse @ (R[:, o, -1] - R[:, o, c] @ mean)[:, :, None])[:, :, 0]
    gamma[:, others] = -inverse @ R[:, o, c]
    omega[:, others[:, None], others] = inverse @ np.swapaxes(inverse, 1, 2)
    biases = 1 + problem.biases
    y = np.append(np.arange(p), biases)
    alpha, gamma, omega = alpha[:, y], gamma[:, y], omega[:, y[:, None], y]

    # biases as means over the session, b + D (step of all parameters) + noise
    if equations.wanders and len(problem.session_spans) == 1:
        by_shared, by_noise = session_mean_bias(equations)
        pairs = (mean_by_common(derivatives, head) for derivatives, (head,) in zip(by_shared, heads, strict=True))
        by_common, by_local = map(np.array, zip(*pairs, strict=True))
        D = by_common[:, :, :-1]
        alpha[:, biases] += (D @ alpha[:, :p, None])[:, :, 0] - by_common[:, :, -1]
        gamma[:, biases] += D @ gamma[:, :p]
        omega[:, biases] += D @ omega[:, :p]
        omega[:, :, biases] += omega[:, :, :p] @ np.swapaxes(D, 1, 2)
        noise = np.concatenate([np.swapaxes(by_noise, 1, 2).reshape(K, len(biases), -1), by_local], axis=2)
        omega[:, biases[:, None], biases] += noise @ np.swapaxes(noise, 1, 2)

    # −2 ln L (23), with the priors of groups and of the sessions
    sized = np.setdiff1d(np.arange(1 + problem.instrument.linear_count, p), places)
    sessions = len(problem.session_spans)
    log_sizes = np.log(problem.prior_u[:, sized]).sum(axis=1) + sessions * np.log(problem.local_u).sum(axis=1)
    pivots = np.log(np.abs(np.diagonal(R[:, o, o], axis1=1, axis2=2))).sum(axis=1)
    pivots += [sum(np.log(np.abs(head.diagonal())).sum() for head in session_heads) for session_heads in heads]
    return Triangles(
        information=np.swapaxes(R_cc, 1, 2) @ R_cc,
        right=(r[:, None] @ R_cc)[:, 0],
        deviance=rests_deviance(equations) + 2.0 * (pivots + log_sizes) + (r**2).sum(axis=1) + R[:, -1, -1] ** 2,
        alpha=alpha,
        gamma=gamma,
        omega=omega,
    )


def members_of(fitted: Maximum, elements: IntArray) -> tuple[IntArray, IntArray]:
    """Return the parameters (g,) of the groups of some elements of φ, and the element (g,) of each."""
    hyperparameters, places = fitted.hyperparameters, np.arange(len(fitted.problem.instrument.names))
    groups = [places[hyperparameters[i].members] for i in elements]
    empty = np.zeros(0, dtype=int)
    return np.concatenate([empty, *groups]), np.repeat(elements.astype(int), [len(group) for group in groups])


def _size_densities(fitted: Maximum, sizes: list[int], learned: Array) -> dict[int, Density]:
    """Return densities, through the maximum, along the sizes of groups on which the session has information.

    `learned` (D,) are v tr PD of `hyperparameters.quadratic_forms`."""
    hyperparameters, phi = fitted.hyperparameters, fitted.phi
    members, element = members_of(fitted, np.array(sizes))
    triangle, out = triangles(fitted.linearisation, hyperparameters, phi[None], members), dict[int, Density]()
    usual = fitted.problem.usual_u[1 + members]
    S = usual * np.exp(np.maximum(phi[element], 0.0))
    at_maximum = Folded.of(triangle.information[0], triangle.right[0], S[None])
    covariance, value = at_maximum.covariance(np.ones(1)), at_maximum.values[0]
    for i in sizes:
        h, at_bound, group = hyperparameters[i], phi[i] <= 0.0, np.flatnonzero(element == i)
        curvature = 2.0 * float(learned[i]) + h.within**-2 if at_bound else fitted.information[i, i]
        size = max(curvature, h.within**-2) ** -0.5
        p = max(phi[i], 0.0) + KNOTS * size if at_bound else np.linspace(0.0, phi[i] + KNOTS[-1] * size, 2 * len(KNOTS))
        precision = np.asarray(np.linalg.inv(covariance[np.ix_(group, group)]))  # with the priors of other groups
        sized = usual[group] * np.exp(p)[:, None]
        folded = Folded.of(precision - np.diag(S[group] ** -2), precision @ value[group], sized)
        one = int(np.argmin(np.abs(p - max(phi[i], 0.0) - size)))
        variance = np.diag(folded.covariance(np.eye(len(p))[one])) / sized[one] ** 2
        if 2.0 * np.clip(1.0 - variance, 0.0, 1.0).sum() <= INFORMATIVE_GROUP:
            continue
        grid = np.linspace(-3.0 * h.within, p[-1], GRID)
        likelihood = np.interp(grid, p, folded.log_likelihood - folded.log_likelihood[0])
        out[i] = Density.of(grid, likelihood + h.log_prior(grid)[0])
    return out


# -------------------- draws --------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Draws(Triangles):
    """K points of ψ, L draws of the sizes of groups at each, and the posterior there.

    Parameters
    ----------
    phi, log_weight : (K, L, D) and (K, L)
        φ, and the logarithms of the weights.
    sizes : (K, L, g)
        Prior standard deviations of the parameters c of the groups.
    value, within, between : (K, g), (K, g, g) and (K, g, g)
        Over the sizes at each point: the mean of c, the mean of its covariance, and the covariance of its mean.
    step, variance : (K, y)
        Over the sizes at each point: the mean step of the y quantities, and its variance.
    """

    phi: Array
    log_weight: Array
    sizes: Array
    value: Array
    within: Array
    between: Array
    step: Array
    variance: Array

    @cached_property
    def smoothed_weights(self) -> tuple[Array, float]:
        """Pareto-smoothed weights (K,) of the points, and the shape of the Pareto distribution."""
        return pareto_smoothed(np.logaddexp.reduce(self.log_weight, axis=1))

    @property
    def effective(self) -> float:
        """Effective number of points."""
        return float(1.0 / (self.smoothed_weights[0] ** 2).sum())

    @property
    def weight(self) -> Array:
        """Weights (K, L) of all draws."""
        return np.asarray(self.smoothed_weights[0][:, None] * scipy.special.softmax(self.log_weight, axis=1))

    @property
    def mean(self) -> Array:
        """Mean step (y,)."""
        return np.asarray(self.smoothed_weights[0] @ self.step)

    @property
    def u(self) -> Array:
        """Standard uncertainties (y,)."""
        weight = self.smoothed_weights[0]
        return np.asarray(np.sqrt(weight @ self.variance + weight @ (self.step - self.mean) ** 2))

    @cached_property
    def moments(self) -> tuple[Array, Array]:
        """The mean of the covariances (y, y), and the covariance (y, y) of the mean steps."""
        weight, gamma, deviation = self.smoothed_weights[0], self.gamma, self.step - self.mean

        def propagated(covariances: Array) -> Array:
            """Return Σ w Γ (…) Γᵀ."""
            left = np.swapaxes(weight[:, None, None] * (gamma @ covariances), 0, 1).reshape(gamma.shape[1], -1)
            return np.asarray(left @ np.swapaxes(gamma, 0, 1).reshape(gamma.shape[1], -1).T)

        within = np.tensordot(weight, self.omega, axes=1) + propagated(self.within)
        return within, (deviation.T * weight) @ deviation + propagated(self.between)

    @cached_property
    def coverage(self) -> tuple[Array, Array]:
        """Coverage factors (y,), and their relative sampling errors.

        With P_i the probability of the interval of a parameter at a point, its mean P has the variance Σ w² (P_i − P)²,
        and the half width of the interval that of P over the density at its ends."""
        within, between = self.moments
        mean, u, (means, deviations, weight, point) = self.mean, np.sqrt(np.diag(within + between)), self.mixture()
        factor = coverage_factors(means - mean, deviations, weight, u)
        probability, density = interval_probability(factor * u, means - mean, deviations)
        deviation = np.zeros((len(self.phi), len(u)))
        np.add.at(deviation, point, weight[:, None] * (probability - weight @ probability))
        width = weight @ density * u * factor
        error = np.sqrt((deviation**2).sum(axis=0))
        return factor, np.divide(error, width, out=np.zeros_like(u), where=width > 0.0)

    def mixture(self) -> tuple[Array, Array, Array, IntArray]:
        """Return means and standard deviations (·, y) of a mixture of Gaussians, weights (·,) and points (·,): all
        points or, of draws with sizes, MIXED of them."""
        means, variance, weight = self.alpha, np.diagonal(self.omega, axis1=1, axis2=2), self.weight.ravel()
        if self.sizes.shape[2] == 0:
            return means, np.sqrt(variance), weight, np.arange(len(means))
        chosen = np.searchsorted(np.cumsum(weight), (np.arange(MIXED) + 0.5) / MIXED)
        drawn, count = np.unique(np.minimum(chosen, len(weight) - 1), return_counts=True)
        point, size = np.divmod(drawn, self.sizes.shape[1])
        means, variance = means[point], variance[point]
        for k in np.unique(point):
            here, gamma = np.flatnonzero(point == k), self.gamma[k]
            sizes = self.sizes[k, size[here]]
            folded = Folded.of(self.information[k], self.right[k], sizes)
            means[here] += folded.values @ gamma.T
            for i, factor, sigma in zip(here, folded.factors, sizes, strict=True):
                along = scipy.linalg.blas.dtrsm(1.0, factor.T, (gamma * sigma).T, lower=1, overwrite_b=1)
                variance[i] += (along**2).sum(axis=0)
        return means, np.sqrt(variance), count / MIXED, point


def _draw(fitted: Maximum, proposal: Proposal, normal: Array, sequence: int) -> Draws:
    """Return draws at points n (K, ·), with sizes from a sequence, weighted as draws from the copula."""
    hyperparameters, (members, element) = fitted.hyperparameters, members_of(fitted, proposal.inner)
    phi, log_q = proposal.points(fitted.phi, normal)
    phi, log_q_sizes = proposal.with_sizes(phi, sequence)
    sizes = fitted.problem.usual_u[1 + members] * np.exp(np.maximum(phi[:, :, element], 0.0))
    at = triangles(fitted.linearisation, hyperparameters, phi[:, 0], members)
    log_q = log_q[:, None] + log_q_sizes
    log_weight = hyperparameters.log_prior(phi)[0].sum(axis=-1) - log_q - 0.5 * at.deviance[:, None]
    value, (within, between) = np.zeros_like(at.right), np.zeros((2, *at.information.shape))
    for k, point_sizes in enumerate(sizes if len(members) else ()):
        folded = Folded.of(at.information[k], at.right[k], point_sizes)
        log_weight[k] += folded.log_likelihood
        w = np.exp(log_weight[k] - log_weight[k].max())
        w /= w.sum()
        value[k], within[k] = w @ folded.values, folded.covariance(w)
        deviation = folded.values - value[k]
        between[k] = (deviation.T * w) @ deviation
    by_groups = ((at.gamma @ (within + between)) * at.gamma).sum(axis=2)
    return Draws(
        **{f.name: getattr(at, f.name) for f in fields(at)},
        phi=phi,
        log_weight=log_weight,
        sizes=sizes,
        value=value,
        within=within,
        between=between,
        step=at.alpha + (at.gamma @ value[:, :, None])[:, :, 0],
        variance=np.diagonal(at.omega, axis1=1, axis2=2) + by_groups,
    )


def _rounds(fitted: Maximum, proposal: Proposal, count: int, sequence: int) -> Iterator[Draws]:
    """Yield all draws of one sequence after each round: `count` points of the copula, then by GROWTH per round."""
    D = len(proposal.outer)
    components: list[tuple[Array, Array]] = [(np.zeros(D), np.eye(D))]  # mean of n and root of its covariance
    counts, normal, draws = [count], np.zeros((0, D)), list[Draws]()
    while len(normal) < MOST_POINTS:
        (mean, root), number = components[-1], sequence + 2 * len(draws)
        new = mean + normal_points(counts[-1], D, number) @ root.T
        normal = np.concatenate([normal, new])
        draws.append(_draw(fitted, proposal, new, number))
        joined = Draws.joined(draws)
        log_share = np.log(counts) - np.log(len(normal))
        mixture = np.array([_log_normal(normal, *component) for component in components]) + log_share[:, None]
        from_copula = -0.5 * (normal**2).sum(axis=1) - np.logaddexp.reduce(mixture, axis=0)
        joined = replace(joined, log_weight=joined.log_weight + from_copula[:, None])
        yield joined
        # w^β with the largest β ≤ 1 of a geometric sequence at which enough points are effective
        tempered, least = np.logaddexp.reduce(joined.log_weight, axis=1), min(2.0 * D, TEMPERED * len(normal))
        tempered -= tempered.max()
        while np.exp(tempered).sum() ** 2 < least * np.exp(2.0 * tempered).sum():
            tempered *= 0.85
        weight = scipy.special.softmax(tempered)
        mean = weight @ normal
        covariance = ((normal - mean).T * weight) @ (normal - mean)
        diagonal = (1.0 - SHRINKAGE) * covariance.diagonal() + ADDED_VARIANCE
        wider = INFLATION * (SHRINKAGE * covariance + np.diag(diagonal))
        components.append((mean, np.asarray(np.linalg.cholesky(wider))))
        counts.append(max(ROUND_POINTS, D + SPARE_POINTS, int(GROWTH * len(normal))))


def _log_normal(points: Array, mean: Array, root: Array) -> Array:
    """Return ln N(points; mean, root rootᵀ) (K,) at points (K, D), up to a constant."""
    z = scipy.linalg.solve_triangular(root, (points - mean).T, lower=True)
    return np.asarray(-0.5 * (z**2).sum(axis=0) - np.log(root.diagonal()).sum())


# -------------------- points and weights --------------------


def normal_points(points: int, dimensions: int, sequence: int = 0) -> Array:
    """Return points (points, D) with exactly the mean and covariance of the normal distribution N(0, 1).

    They are an additive recurrence of low discrepancy in the unit cube, by the root of x^{D+1} = x + 1, transformed
    linearly; each `sequence` has another offset."""
    root = 2.0
    for _ in range(60):
        root = (1.0 + root) ** (1.0 / (dimensions + 1.0))
    steps = root ** -np.arange(1.0, dimensions + 1.0)
    normal = scipy.special.ndtri((0.5 + SHIFT * sequence + np.outer(np.arange(1, points + 1), steps)) % 1.0)
    normal -= normal.mean(axis=0)
    return np.linalg.solve(np.linalg.cholesky(normal.T @ normal / points), normal.T).T


def pareto_smoothed(log_weight: Array) -> tuple[Array, float]:
    """Return weights with the largest replaced by quantiles of a Pareto distribution fitted to them, and its shape."""
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
    """Return shape and scale of a generalised Pareto distribution of ascending values (Zhang and Stephens 2009)."""
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
    """Return half widths at COVERAGE of mixtures of Gaussians (K, m), with weights (K,), divided by u (m,); 0 if u is
    0.

    By Newton's method, safeguarded by bisection."""
    low, high, k = np.zeros(len(u)), np.full(len(u), 20.0), np.full(len(u), 2.0)
    for _ in range(60):
        missing, density = (weight @ each for each in interval_probability(k * u, means, deviations))
        missing = COVERAGE - missing
        low, high = np.where(missing > 0.0, k, low), np.where(missing > 0.0, high, k)
        new = k + missing / np.maximum(density * u, 1e-300)
        new, before = np.where((new >= low) & (new <= high), new, 0.5 * (low + high)), k
        k = new
        if np.all(np.abs(k - before) <= 1e-12 * k):
            break
    return np.where(u > 0.0, k, 0.0)


def interval_probability(half_width: Array, means: Array, deviations: Array) -> tuple[Array, Array]:
    """Return the probabilities (K, m) of intervals ±`half_width` (m,) of Gaussians, and their densities at both ends
    together."""
    safe = np.where(deviations > 0.0, deviations, 1.0)
    above, below = (half_width - means) / safe, (-half_width - means) / safe
    density = (np.exp(-0.5 * above**2) + np.exp(-0.5 * below**2)) / (safe * np.sqrt(2.0 * np.pi))
    return scipy.special.ndtr(above) - scipy.special.ndtr(below), density


def degrees_of(factor: Array) -> Array:
    """Return the degrees of freedom (m,) of Student's t with these coverage factors at COVERAGE."""
    degrees = np.geomspace(1.0, MOST_DEGREES, 400)
    factors = scipy.special.stdtrit(degrees, 0.5 + 0.5 * COVERAGE)
    return np.asarray(np.interp(-factor, -factors, degrees))


def _summary(fitted: Maximum, phi: Array, weight: Array) -> Array:
    """Return median and limits of the middle 68 % of every hyperparameter (D, 3).

    For those that are not integrated over, the limits follow from the curvature at the maximum."""
    out, prior_curvature = np.empty((len(fitted.phi), 3)), fitted.hyperparameters.log_prior(fitted.phi)[2]
    for i, h in enumerate(fitted.hyperparameters):
        at, order = fitted.phi[i], np.argsort(phi[:, i])
        limits = at + np.array([0.0, -1.0, 1.0]) / np.sqrt(max(fitted.information[i, i], prior_curvature[i]))
        if np.ptp(phi[:, i]) > 0.0:
            share = np.cumsum(weight[order]) - 0.5 * weight[order]
            limits = np.interp([0.5, 0.16, 0.84], share, phi[order, i])
        out[i] = h.value(limits)
    return out
