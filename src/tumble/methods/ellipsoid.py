"""Ellipsoid method: accelerometers alone, from the rest means of a log in any attitudes, or from a table of readings.

The rest means lie on an ellipsoid (`tumble.methods.ellipsoid_fit`). They are weighted by their covariances, and a
scatter between rests is estimated. The fit starts from the algebraic one, not from nominal sensors, so that errors of
any size are found. A bad rest is left out and named; positions that do not determine all nine parameters are refused.
Gyros, turns, Earth's rate and programme are not used.

Rests alone hardly distinguish a quadratic term from a bias. Groups beyond the linear model of known usual size are
therefore in the result as zero, and in the covariance (`tumble.diagnosis.linear_model`). If `joint` finds a group that
is larger than usual in the session, its size is used.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tumble.diagnosis.linear_model import converged_joint, omitted_by_rests, omitted_sizes, with_omitted_groups
from tumble.diagnosis.observability import Refusal
from tumble.errors import InputError
from tumble.inference.estimate import Estimate, Fit
from tumble.inference.sources import fit_budget
from tumble.methods.ellipsoid_fit import EllipsoidFit, fit_ellipsoid
from tumble.reduction.observations import Observations
from tumble.rotation import unit_vector
from tumble.sensors.parameters import units_of
from tumble.units import Array


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
    model = block.nominal()
    return Estimate(  # a part of the parameters would be as wrong as the missing part allows
        method="ellipsoid",
        names=block.names,
        units=units_of(block.names),
        values=np.zeros(9),
        covariance=np.zeros((9, 9)),
        observable=np.zeros(9, dtype=bool),
        null=fit.null,
        accel=model,
        gyro=None,
        rest_residual=np.linalg.norm(model.apply(rests.accel), axis=1) - site.gravity,
        rest_sigmas=np.zeros(len(rests)),
        turn_sigmas=np.empty(0),
        increments=(),
        fits={"accelerometers": Fit(chi_square=0.0, degrees=0.0, scatter=0.0, unit="m/s^2")},
        converged=False,
        reasons=(fit.reason,),
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
    estimate = Estimate(
        method="ellipsoid",
        names=block.names,
        units=units_of(block.names),
        values=fit.values,
        covariance=covariance,
        observable=np.ones(9, dtype=bool),
        null=np.empty((0, 9)),
        accel=fit.model,
        gyro=None,
        rest_residual=fit.residual,
        rest_sigmas=fit.sigmas,
        turn_sigmas=np.empty(0),
        increments=fit.increments,
        fits={"accelerometers": fit.fit("m/s^2")},
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
