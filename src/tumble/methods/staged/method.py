"""Staged method: accelerometers by the scalar method on all rests, then gyros from rests and turns.

Stage 1 is `staged_accelerometers`, stage 2 `staged_gyros`. The uncertainty of stage 2 includes what stage 1 leaves, and
the covariance of the estimate what both have in common.
"""

from __future__ import annotations

import numpy as np

from tumble.inference.estimate import Estimate
from tumble.methods.gauss_newton import negligible
from tumble.methods.staged.accelerometers import Accelerometers, estimate_accelerometers
from tumble.methods.staged.gyros import Gyros, estimate_gyros
from tumble.reduction.observations import Observations
from tumble.units import Array


def staged(observations: Observations) -> Estimate:
    """All parameters of a session by stages, with covariance and outcome."""
    accel = estimate_accelerometers(observations)
    residual = np.linalg.norm(accel.model.apply(observations.rests.accel), axis=1) - observations.site.gravity
    if observations.gyro_block is None:
        return _estimate(observations, accel, residual, None)
    return _estimate(observations, accel, residual, estimate_gyros(observations, accel))


def _estimate(observations: Observations, accel: Accelerometers, residual: Array, gyro: Gyros | None) -> Estimate:
    block, gyro_block = observations.accel_block, observations.gyro_block
    m = len(accel.values)
    values, covariance = accel.values, accel.covariance
    names, units, observable, null = block.names, block.units, accel.solution.observable, accel.solution.null
    converged = negligible(accel.solution)
    increments = accel.increments
    fits = {"accelerometers": accel.fit}
    rest_sigmas, turn_sigmas = accel.sigmas, np.empty(0)
    if gyro is not None and gyro_block is not None:
        values = np.concatenate([values, gyro.values])
        covariance = np.block([[covariance, gyro.by_accel.T], [gyro.by_accel, gyro.covariance]])
        names, units = names + gyro_block.names, units + gyro_block.units
        observable = np.concatenate([observable, gyro.solution.observable])
        null = np.vstack([np.pad(null, ((0, 0), (0, len(gyro.values)))), np.pad(gyro.solution.null, ((0, 0), (m, 0)))])
        converged = converged and negligible(gyro.solution)
        increments = tuple(np.append(step, np.zeros(len(gyro.values))) for step in increments) + tuple(
            np.append(np.zeros(m), step) for step in gyro.increments
        )
        fits |= gyro.fits
        rest_sigmas = np.maximum(rest_sigmas, gyro.rest_sigmas)
        turn_sigmas = gyro.turn_sigmas
    return Estimate(
        method="staged",
        names=names,
        units=units,
        values=values,
        covariance=covariance,
        observable=observable,
        null=null,
        accel=accel.model,
        gyro=None if gyro is None else gyro.model,
        rest_residual=residual,
        rest_sigmas=rest_sigmas,
        turn_sigmas=turn_sigmas,
        gyro_rest_sigmas=np.empty(0) if gyro is None else gyro.rest_sigmas,
        increments=increments,
        fits=fits,
        converged=converged,
    )
