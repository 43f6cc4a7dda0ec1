"""How far groups beyond the linear model may have put an ellipsoid fit off, by its residuals.

The fit of bias, scale factor and axis angles to N positions takes groups φ of sizes Σ for parameters. With noise n of
its rows, in units of the standard deviations that it has,

    error  ΔX = A⁺ n + A⁺ B φ,      residuals  e = (1 − A A⁺) n + L φ,   L = (1 − A A⁺) B

A and B being the columns of the linear parameters and of the groups. At given c and λ, n ~ N(0, c²) and φ ~ N(0, λ² Σ)
are Gaussian, and so is the error z = (ΔX, −φ) of an estimate that has the groups as nothing, given the residuals:

    z | e ~ N(K e, c² (A⁺ A⁺ᵀ + K Kᵀ) + R λ² Σ Rᵀ),   K = T λ² Σ Lᵀ (L λ² Σ Lᵀ + c²)⁺,   R = T − K L,   T = (A⁺ B; −1)

How large the noise is and how many times a group is larger than usual nobody knows beforehand, nor from a table of
readings the grade of its instrument. Integrated is over all of it: ln c, of which nothing is known, by a grid; the
λ = exp(max(p, 0)), p ~ N(0, ln 3), of every group, half of which hold the usual size, by points of a low-discrepancy
sequence; and the grades that there may be, each as likely as the others. Weights are the likelihood of the residuals,

    ln w = −½ [ln |L λ² Σ Lᵀ + c² (1 − A A⁺)| + eᵀ (…)⁺ e]

so that readings as good as those of a navigation instrument leave the sizes of one, and none is guessed. Noise known
beforehand has c = 1. The values of the fit stay as they are: u is about them, the root of the mean square of z.

Source: `tumble.inference.integral`, of which this is the closed form for rests alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tumble.diagnosis.linear_model import left_out_by_rests, left_out_sizes, with_left_out
from tumble.inference.estimate import Estimate
from tumble.inference.hyperparameters import STATED
from tumble.inference.integral import coverage_factors, degrees_of, normal_points
from tumble.inference.prediction import prediction
from tumble.inference.sources import UncertaintyBudget, source
from tumble.methods.ellipsoid import deviations
from tumble.methods.ellipsoid_fit import EllipsoidFit
from tumble.reduction.observations import Observations

POINTS = 128
"""Points of the sizes of the groups."""
NOISE = np.geomspace(1.0 / 30.0, 30.0, 25)
"""The noise, in parts of that which the residuals have where it alone explains them."""
LEAST = 1e-5
"""Of the largest weight: less is none."""


def with_groups(
    estimate: Estimate,
    fit: EllipsoidFit,
    observations: Observations,
    grades: Sequence[Mapping[str, float]],
) -> Estimate:
    """An estimate of the linear model with the groups that it has as nothing, and their part in its covariance.

    Parameters
    ----------
    estimate
        The estimate, whose method is `ellipsoid`.
    fit
        The fit that it is of.
    observations
        The rests that the fit was made from.
    grades
        Of each grade that the instrument may be of, usual standard deviations, SI, by group.

    Returns
    -------
    Estimate
        The same values, groups at zero, with covariance, degrees of freedom and budget.
    """
    names = dict.fromkeys(name for sizes in grades for name in sizes)
    usual = {name: float(np.sqrt(np.mean([sizes.get(name, 0.0) ** 2 for sizes in grades]))) for name in names}
    rests, sigma = replace(observations, usual=usual), deviations(fit, observations)
    problem, moves, L = left_out_by_rests(rests, fit.values, sigma)
    made = with_left_out(estimate, problem, moves, left_out_sizes(problem, None))
    instrument, first, k = problem.instrument, len(fit.values), L.shape[1]
    groups = {group.name: instrument.members[group.name] for group in instrument.further}
    number = np.repeat(np.arange(len(groups)), [members.stop - members.start for members in groups.values()])
    times = np.exp(np.maximum(normal_points(POINTS, len(groups)), 0.0) * np.log(STATED))
    S = np.concatenate([times * [sizes.get(name, 0.0) for name in groups] for sizes in grades])[:, number]

    # residuals in the directions that groups reach, z in those of each point, and what is left of them
    along, s, _ = np.linalg.svd(L, full_matrices=False)
    along = along[:, s > 1e-9 * s[0]]
    # of a reading along the vertical, of which a residual is the length in the true vector
    normal = np.linalg.norm(fit.model.apply(observations.rests.accel), axis=1)
    direction = fit.model.apply(observations.rests.accel) / normal[:, None]
    e = fit.residual / np.linalg.norm(direction @ fit.model.inverse(), axis=1) / sigma
    q, reach = along.T @ e, along.T @ L
    rest, degrees = max(float(e @ e - q @ q), 0.0), fit.degrees - along.shape[1]
    c = NOISE * np.sqrt(float(e @ e) / fit.degrees) if fit.scatter > 0.0 else np.ones(1)
    SL = S[:, :, None] * reach.T
    value, V = np.linalg.eigh(np.swapaxes(SL, 1, 2) @ SL)
    d = np.maximum(value, 0.0)[:, None] + c[:, None] ** 2  # (points, noise, directions)
    z = np.einsum("pij,i->pj", V, q)[:, None]
    log_weight = -0.5 * (np.log(d) + z**2 / d).sum(axis=2) - degrees * np.log(c) - 0.5 * rest / c**2
    weight = np.exp(log_weight - log_weight.max())
    point, noise = np.nonzero(weight > LEAST)
    weight = weight[point, noise] / weight[point, noise].sum()
    c, d, V, S, SL = c[noise], d[point, noise], V[point], S[point], SL[point]

    # mean and covariance of the error at each point, and by source
    T = np.vstack([moves, -np.eye(k)])
    K = (T * S[:, None]) @ SL @ (V / d[:, None]) @ np.swapaxes(V, 1, 2)
    mean, R = K @ q, T * S[:, None] - K @ np.swapaxes(SL, 1, 2)
    of_modulus = np.zeros((first + k, first + k))
    of_modulus[:first, :first] = np.outer(fit.by_modulus, fit.by_modulus)
    of_fit = -of_modulus
    of_fit[:first, :first] += estimate.covariance
    of_noise = (weight @ c**2) * of_fit + np.einsum("j,jmr,jnr->mn", weight * c**2, K, K)
    sources = {"fit": of_noise}
    for name, members in groups.items():
        own = R[:, :, members.start - first : members.stop - first]
        sources[f"prior.{name}"] = np.einsum("j,jmg,jng->mn", weight, own, own)
    middle = weight @ mean
    sources["hyperparameters"] = ((mean - middle).T * weight) @ (mean - middle)
    spread = np.sqrt(np.diag(sum(sources.values())))
    each = c[:, None] ** 2 * (np.diag(of_fit) + (K**2).sum(axis=2)) + (R**2).sum(axis=2)
    factor = coverage_factors(mean - middle, np.sqrt(each), weight, spread)
    shorter = np.where(factor > 0.0, np.minimum(0.5 * factor, 1.0), 1.0)
    sources = {name: covariance * np.outer(shorter, shorter) for name, covariance in sources.items()}
    sources["hyperparameters"] += np.outer(middle, middle)
    covariance = sum(sources.values()) + of_modulus
    each = np.sqrt(each + np.diag(of_modulus))
    factor = coverage_factors(mean, each, weight, np.sqrt(np.diag(covariance)))
    by_name = {f"prior.{name}": (usual[name], instrument.units[members.start]) for name, members in groups.items()}
    budget = UncertaintyBudget(
        sources=tuple(source(name, *by_name.get(name, ())) for name in sources),
        covariances=np.array(list(sources.values())),
    )
    return replace(
        made,
        covariance=covariance,
        degrees=degrees_of(factor),
        budget=budget.with_source(source("gravity", observations.site.gravity_u, "m/s^2"), of_modulus),
        prediction=prediction(instrument, made.values, covariance, gravity=observations.site.gravity, rate=None),
    )
