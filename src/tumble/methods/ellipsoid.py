"""Ellipsoid method: the accelerometers alone, from the rest means of any log in any orientation, or a table of them.

The rest means lie on an ellipsoid (`tumble.methods.ellipsoid_fit`); their covariances are the weights, and a scatter
between rests is estimated on top. The fit starts from the algebraic one, not from nominal sensors, so that errors of
any size are found; a bad rest is left out of the fit, and named, instead of bending it; positions that cannot
determine all nine parameters are refused as a whole. Gyros, turns, Earth's rate and programme are not used.

Rests alone hardly tell a quadratic term from a bias. So groups beyond the linear model whose usual size is known are
in the result as nothing within that size, and in the covariance (`tumble.diagnosis.linear_model`); the values of bias,
scale factors and axis angles are those of the method. Where the rests of a session show that a group is larger than is
usual, its size is the one that the method `joint` finds in them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tumble.diagnosis.linear_model import by_joint, left_out_by_rests, left_out_sizes, with_left_out
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
    """The accelerometer parameters of a session with covariance. How large groups are is the maximum of `joint`, with
    `intervals` integrated.

    Raises InputError for more than three accelerometers, and LinAlgError where the rests lie on no ellipsoid."""
    block, rests, site = observations.accel_block, observations.rests, observations.site
    if block.size != 3:
        raise InputError(
            f"method ellipsoid: expected three accelerometers, found {block.size}; take the method joint, which also "
            "uses what they say of each other"
        )
    found = fit_ellipsoid(
        rests.accel,
        modulus=site.gravity,
        modulus_u=site.gravity_u,
        covariance=rests.accel_covariance,
        block=block,
    )
    if not isinstance(found, Refusal):
        beside, sizes = None, None
        if observations.usual and found.converged:
            beside = by_joint(observations.of_accelerometers(), intervals)
            sizes = beside if observations.turns is None else by_joint(observations, intervals)
        return estimate_of(found, observations, beside, sizes or beside)
    if not len(found.null):
        raise np.linalg.LinAlgError(found.reason)
    model = block.nominal()
    return Estimate(  # no parameter is determined: a part of them would be as wrong as the missing part allows
        method="ellipsoid",
        names=block.names,
        units=units_of(block.names),
        values=np.zeros(9),
        covariance=np.zeros((9, 9)),
        observable=np.zeros(9, dtype=bool),
        null=found.null,
        accel=model,
        gyro=None,
        rest_residual=np.linalg.norm(model.apply(rests.accel), axis=1) - site.gravity,
        rest_sigmas=np.zeros(len(rests)),
        turn_sigmas=np.empty(0),
        increments=(),
        fits={"accelerometers": Fit(chi_square=0.0, degrees=0.0, scatter=0.0, unit="m/s^2")},
        converged=False,
        reasons=(found.reason,),
    )


def estimate_of(
    found: EllipsoidFit,
    observations: Observations,
    beside: Estimate | None = None,
    sizes: Estimate | None = None,
) -> Estimate:
    """The estimate of a fit to the rests of observations, its covariance zero where the fit has none. Rests are judged
    by the estimate of the method joint `beside` it, of the same rests; how large groups of parameters are is told by
    that of everything the session has, its turns included (`sizes`)."""
    block = observations.accel_block
    covariance = np.zeros((9, 9)) if found.covariance is None else found.covariance
    variance = np.diag(covariance)
    by_noise = variance - found.by_modulus**2
    parts = np.divide(variance, by_noise, out=np.full(9, np.inf), where=by_noise > 0.0)
    estimate = Estimate(
        method="ellipsoid",
        names=block.names,
        units=units_of(block.names),
        values=found.values,
        covariance=covariance,
        observable=np.ones(9, dtype=bool),
        null=np.empty((0, 9)),
        accel=found.model,
        gyro=None,
        rest_residual=found.residual,
        rest_sigmas=found.sigmas,
        turn_sigmas=np.empty(0),
        increments=found.increments,
        fits={"accelerometers": found.fit("m/s^2")},
        converged=found.converged,
        degrees=found.noise_degrees * parts**2,  # Welch, Satterthwaite
        budget=fit_budget(covariance, found.by_modulus, observations.site.gravity_u, found.noise_degrees),
    )
    if not observations.usual:
        return estimate
    estimate = replace(estimate, linearised=None if beside is None else beside.linearised)
    problem, moves, _ = left_out_by_rests(observations, found.values, deviations(found, observations))
    return with_left_out(estimate, problem, moves, left_out_sizes(problem, sizes))


def deviations(found: EllipsoidFit, observations: Observations) -> Array:
    """Standard deviations (N,) of the readings at rest along the vertical that a fit has, infinite where it leaves them
    out."""
    up = unit_vector(found.model.apply(observations.rests.accel))
    variance = np.einsum("ip,ipq,iq->i", up, observations.rests.accel_covariance, up) + found.scatter**2
    return np.where(found.used, np.sqrt(variance), np.inf)
