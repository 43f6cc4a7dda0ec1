"""Ellipsoid method: accelerometers alone, from the rest means of a log in any attitudes, or from a table of readings.

The rest means lie on an ellipsoid (`tumble.methods.ellipsoid_fit`). They are weighted by their covariances, and a
scatter between rests is estimated. The fit starts from the algebraic one, not from nominal sensors, so that errors of
any size are found. A bad rest is left out and named; positions that do not determine all nine parameters are refused.
Gyros, turns, Earth's rate and programme are not used.

Rests alone hardly distinguish a quadratic term from a bias. Groups beyond the linear model of known usual size are
therefore in the result as zero, and in the covariance (`tumble.diagnosis.linear_model`). If `joint` finds a group that
is larger than usual in the session, its size is used.

For a table of readings the errors by omitted groups are estimated from the residuals (`with_groups`). The fit takes
groups φ of covariance Σ for its parameters. With the noise n of its rows, in units of their standard deviations,

    error  ΔX = A⁺ n + A⁺ B φ,      residuals  e = (1 − A A⁺) n + L φ,   L = (1 − A A⁺) B

where A and B are the columns of the linear parameters and of the groups. For given c and λ, n ~ N(0, c²) and
φ ~ N(0, λ² Σ) are Gaussian, and so is the error z = (ΔX, −φ) given the residuals:

    z | e ~ N(K e, c² (A⁺ A⁺ᵀ + K Kᵀ) + R λ² Σ Rᵀ),   K = T λ² Σ Lᵀ (L λ² Σ Lᵀ + c²)⁺,   R = T − K L,   T = (A⁺ B; −1)

The size of the noise, the sizes of the groups and, for a table of readings, the grade of the instrument are unknown.
The integral is over ln c by a grid, with Jeffreys' prior for given λ, the root of Σ (c²/d)² over the variances d of the
residuals; a constant prior would leave a large weight at c = 0, where groups alone explain the residuals. It is over
λ = exp(max(p, 0)), p ~ N(0, ln 3), of every group, of which half have the usual size, by a low-discrepancy sequence,
and over the possible grades, equally likely. The weights are the likelihood of the residuals,

    ln w = −½ [ln |L λ² Σ Lᵀ + c² (1 − A A⁺)| + eᵀ (…)⁺ e]

so that readings as good as those of a navigation instrument leave groups of its sizes, and no grade is guessed. For
known noise c = 1. The values of the fit are kept: u is about them, the root mean square of z.

Source: the closed form of `tumble.inference.integral` for rests alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tumble.diagnosis.linear_model import converged_joint, omitted_by_rests, omitted_sizes, with_omitted_groups
from tumble.diagnosis.observability import Refusal
from tumble.errors import InputError
from tumble.inference.estimate import Estimate, Fit
from tumble.inference.hyperparameters import STATED
from tumble.inference.integral import coverage_factors, degrees_of, normal_points
from tumble.inference.prediction import prediction
from tumble.inference.sources import UncertaintyBudget, fit_budget, source
from tumble.methods.ellipsoid_fit import EllipsoidFit, fit_ellipsoid
from tumble.reduction.observations import Observations
from tumble.rotation import unit_vector
from tumble.sensors.model import Block
from tumble.sensors.parameters import units_of
from tumble.units import Array

POINTS = 128  # of the sizes of the groups
NOISE_GRID = np.geomspace(1.0 / 30.0, 30.0, 25)  # relative to the noise that alone explains the residuals
LEAST_WEIGHT = 1e-5  # relative to the largest; smaller ones are dropped
RELATIVE_RANK = 1e-9  # of L


def ellipsoid(observations: Observations, *, intervals: bool = True) -> Estimate:
    """Estimate the accelerometer parameters of a session.

    With `intervals`, the sizes of groups are integrated by `joint`; otherwise they are at the maximum. If the positions
    do not determine the parameters, none is observable. Raises InputError for more than three accelerometers, and
    LinAlgError if the rests lie on no ellipsoid."""
    block, rests, site = observations.accel_block, observations.rests, observations.site
    if block.size != 3:
        raise InputError(
            f"method ellipsoid: expected three accelerometers, found {block.size}; take the method joint, which uses "
            "any number"
        )
    fit = fit_ellipsoid(
        rests.accel,
        modulus=site.gravity,
        modulus_u=site.gravity_u,
        covariance=rests.accel_covariance,
        block=block,
    )
    if not isinstance(fit, Refusal):
        by_rests, by_session = None, None
        if observations.usual and fit.converged:
            by_rests = converged_joint(observations.of_accelerometers(), intervals)
            by_session = by_rests if observations.turns is None else converged_joint(observations, intervals)
        return estimate_of(fit, observations, by_rests, by_session or by_rests)
    if not len(fit.null):
        raise np.linalg.LinAlgError(fit.reason)
    return _estimate(  # a part of the parameters would be as wrong as the missing part allows
        block,
        Fit(chi_square=0.0, degrees=0.0, scatter=0.0, unit="m/s^2"),
        values=np.zeros(9),
        covariance=np.zeros((9, 9)),
        null=fit.null,
        accel=block.nominal(),
        rest_residual=np.linalg.norm(block.nominal().apply(rests.accel), axis=1) - site.gravity,
        rest_sigmas=np.zeros(len(rests)),
        increments=(),
        converged=False,
        reasons=(fit.reason,),
    )


def _estimate(block: Block, fit: Fit, *, null: Array, **others: Any) -> Estimate:
    return Estimate(
        method="ellipsoid",
        names=block.names,
        units=units_of(block.names),
        observable=np.full(9, not len(null)),
        null=null,
        gyro=None,
        turn_sigmas=np.empty(0),
        fits={"accelerometers": fit},
        **others,
    )


def estimate_of(
    fit: EllipsoidFit,
    observations: Observations,
    by_rests: Estimate | None = None,
    by_session: Estimate | None = None,
) -> Estimate:
    """Return the estimate of a fit to the rests of observations; its covariance is zero if the fit has none.

    `by_rests` is an estimate by `joint` from the same rests, by which they are judged, `by_session` one from the whole
    session with its turns, which gives the sizes of groups of parameters."""
    block = observations.accel_block
    covariance = np.zeros((9, 9)) if fit.covariance is None else fit.covariance
    variance = np.diag(covariance)
    by_noise = variance - fit.by_modulus**2
    ratio = np.divide(variance, by_noise, out=np.full(9, np.inf), where=by_noise > 0.0)
    estimate = _estimate(
        block,
        fit.fit("m/s^2"),
        values=fit.values,
        covariance=covariance,
        null=np.empty((0, 9)),
        accel=fit.model,
        rest_residual=fit.residual,
        rest_sigmas=fit.sigmas,
        increments=fit.increments,
        converged=fit.converged,
        degrees=fit.noise_degrees * ratio**2,  # Welch, Satterthwaite
        budget=fit_budget(covariance, fit.by_modulus, observations.site.gravity_u, fit.noise_degrees),
    )
    if not observations.usual:
        return estimate
    estimate = replace(estimate, linearised=None if by_rests is None else by_rests.linearised)
    problem, shift, _ = omitted_by_rests(observations, fit.values, reading_sigmas(fit, observations))
    return with_omitted_groups(estimate, problem, shift, omitted_sizes(problem, by_session))


def reading_sigmas(fit: EllipsoidFit, observations: Observations) -> Array:
    """Return the standard deviations (N,) of the readings along the vertical, infinite where they are left out."""
    up = unit_vector(fit.model.apply(observations.rests.accel))
    variance = np.einsum("ip,ipq,iq->i", up, observations.rests.accel_covariance, up) + fit.scatter**2
    return np.where(fit.used, np.sqrt(variance), np.inf)


def with_groups(
    estimate: Estimate, fit: EllipsoidFit, observations: Observations, grades: Sequence[Mapping[str, float]]
) -> Estimate:
    """Add the omitted groups, at zero, to an estimate of the linear model by the method `ellipsoid` and its fit.

    Their part is added to covariance, degrees of freedom and budget. `grades` are the usual standard deviations by
    group, SI, for each possible grade of the instrument."""
    names = dict.fromkeys(name for sizes in grades for name in sizes)
    usual = {name: float(np.sqrt(np.mean([sizes.get(name, 0.0) ** 2 for sizes in grades]))) for name in names}
    sigma = reading_sigmas(fit, observations)
    problem, shift, L = omitted_by_rests(replace(observations, usual=usual), fit.values, sigma)  # shift is A⁺ B
    full = with_omitted_groups(estimate, problem, shift, omitted_sizes(problem, None))
    instrument, first, k = problem.instrument, len(fit.values), L.shape[1]

    # points of the sizes of the groups, for every grade
    groups = {group.name: instrument.members[group.name] for group in instrument.further}
    group_of_column = np.repeat(np.arange(len(groups)), [place.stop - place.start for place in groups.values()])
    λ = np.exp(np.maximum(normal_points(POINTS, len(groups)), 0.0) * np.log(STATED))
    by_grade = [λ * [sizes.get(name, 0.0) for name in groups] for sizes in grades]
    S = np.concatenate(by_grade)[:, group_of_column]  # (points, k): λ √Σ

    # residuals in the directions that groups reach, and the sum of squares of the others
    directions, s, _ = np.linalg.svd(L, full_matrices=False)
    directions = directions[:, s > RELATIVE_RANK * s[0]]
    # a residual of the fit is a length of the true vector; e is of the reading along the vertical
    force = fit.model.apply(observations.rests.accel)
    vertical = force / np.linalg.norm(force, axis=1)[:, None]
    e = fit.residual / np.linalg.norm(vertical @ fit.model.inverse(), axis=1) / sigma
    q = directions.T @ e
    other_squares, degrees = max(float(e @ e - q @ q), 0.0), fit.degrees - directions.shape[1]

    # weights over sizes and noise, by the variances d of the residuals along the eigenvectors V of L λ² Σ Lᵀ
    c = NOISE_GRID * np.sqrt(float(e @ e) / fit.degrees) if fit.scatter > 0.0 else np.ones(1)
    SL = S[:, :, None] * (directions.T @ L).T
    value, V = np.linalg.eigh(np.swapaxes(SL, 1, 2) @ SL)
    d = np.maximum(value, 0.0)[:, None] + c[:, None] ** 2  # (points, noise, directions)
    z = np.einsum("pij,i->pj", V, q)[:, None]
    log_weight = -0.5 * (np.log(d) + z**2 / d).sum(axis=2) - degrees * np.log(c) - 0.5 * other_squares / c**2
    if fit.scatter > 0.0:
        log_weight += 0.5 * np.log(((c[:, None] ** 2 / d) ** 2).sum(axis=2) + degrees)  # prior of ln c
    weight = np.exp(log_weight - log_weight.max())
    point, noise = np.nonzero(weight > LEAST_WEIGHT)
    weight = weight[point, noise] / weight[point, noise].sum()
    c, d, V, S, SL = c[noise], d[point, noise], V[point], S[point], SL[point]

    # mean of the error at each point, and its covariance by source
    T = np.vstack([shift, -np.eye(k)])
    K = (T * S[:, None]) @ SL @ (V / d[:, None]) @ np.swapaxes(V, 1, 2)
    mean = K @ q
    R = T * S[:, None] - K @ np.swapaxes(SL, 1, 2)  # (T − K L) λ √Σ
    by_modulus = np.zeros((first + k, first + k))
    by_modulus[:first, :first] = np.outer(fit.by_modulus, fit.by_modulus)
    by_fit = -by_modulus
    by_fit[:first, :first] += estimate.covariance
    sources = {"fit": (weight @ c**2) * by_fit + np.einsum("j,jmr,jnr->mn", weight * c**2, K, K)}
    for name, place in groups.items():
        by_group = R[:, :, place.start - first : place.stop - first]
        sources[f"prior.{name}"] = np.einsum("j,jmg,jng->mn", weight, by_group, by_group)

    # u about the mean of the errors, limited to half of the half width at 95.45 %; the values keep that mean as error
    centre = weight @ mean
    sources["hyperparameters"] = ((mean - centre).T * weight) @ (mean - centre)
    spread = np.sqrt(np.diag(sum(sources.values())))
    variance = c[:, None] ** 2 * (np.diag(by_fit) + (K**2).sum(axis=2)) + (R**2).sum(axis=2)
    factor = coverage_factors(mean - centre, np.sqrt(variance), weight, spread)
    shorter = np.where(factor > 0.0, np.minimum(0.5 * factor, 1.0), 1.0)
    sources = {name: covariance * np.outer(shorter, shorter) for name, covariance in sources.items()}
    sources["hyperparameters"] += np.outer(centre, centre)
    covariance = sum(sources.values()) + by_modulus
    sigmas = np.sqrt(variance + np.diag(by_modulus))
    factor = coverage_factors(mean, sigmas, weight, np.sqrt(np.diag(covariance)))
    sizes = {f"prior.{name}": (usual[name], instrument.units[place.start]) for name, place in groups.items()}
    budget = UncertaintyBudget(
        sources=tuple(source(name, *sizes.get(name, ())) for name in sources),
        covariances=np.array(list(sources.values())),
    )
    return replace(
        full,
        covariance=covariance,
        degrees=degrees_of(factor),
        budget=budget.with_source(source("gravity", observations.site.gravity_u, "m/s^2"), by_modulus),
        prediction=prediction(instrument, full.values, covariance, gravity=observations.site.gravity, rate=None),
    )
