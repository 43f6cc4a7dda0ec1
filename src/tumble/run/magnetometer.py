"""The magnetometer beside a calibration: its parameters, and whether its channels are along the axes of the
accelerometers, by the dip angle.

At one place the angle between the vertical and the field of the Earth is the same in every attitude,

    uᵢᵀ P mᵢ = sin(dip) for all rests i,

with the vertical u and the direction of the field m in the body from the corrected readings, and P = 1 where the
channels are in order. Where two are exchanged or one is mirrored, another signed permutation P makes it so. P and −P do
so alike; which of the two it is the hemisphere tells, where the latitude is known: the field points down in the north.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from tumble.diagnosis.turn_likelihood import signed_permutations
from tumble.inference.sources import UncertaintyBudget, source
from tumble.methods.magnetometer import NAMES as MAGNETOMETER_NAMES
from tumble.methods.magnetometer import magnetometer
from tumble.recording.session import Channels
from tumble.reduction.observations import Observations
from tumble.result.calibration import Calibration
from tumble.result.parts import Parameter
from tumble.result.uncertainty_budget import contributions_of
from tumble.rotation import unit_vector
from tumble.sensors.model import SensorModel
from tumble.units import DEGREE

FITS = 5.0 * DEGREE
"""Scatter of the dip angle below which an order of the channels explains the rests."""

CONTRADICTS = 3.0
"""How many times the scatter must be larger in the order of the session and in every other one."""

TELLING_LATITUDE = 20.0 * DEGREE
"""Nearer the equator the field may point either way."""

_ORDERS = signed_permutations()


def exchanged_columns(
    accel: SensorModel | None, mag: SensorModel | None, observations: Observations, spec: Channels
) -> tuple[str, ...]:
    """That another order or polarity of the magnetometer's columns gives one dip angle in all rests, where that of the
    session does not, as a note; none where the columns are in order or the rests do not tell."""
    readings, latitude = observations.rests.magnetometer, observations.site.latitude
    if accel is None or mag is None or readings is None or len(accel.bias) != 3:
        return ()
    vertical, field = unit_vector(accel.apply(observations.rests.accel)), unit_vector(mag.apply(readings))
    sine = np.array([np.einsum("ip,pq,iq->i", vertical, P, field) for P in _ORDERS])
    scatter = sine.std(axis=1)
    best, opposite, second = np.argsort(scatter)[:3].tolist()  # the best, and the same with all signs changed
    plain = scatter[next(i for i, P in enumerate(_ORDERS) if np.array_equal(P, np.eye(3)))]
    if scatter[best] > FITS or min(plain, scatter[second]) < CONTRADICTS * scatter[best]:
        return ()
    if latitude is None or abs(latitude) < TELLING_LATITUDE:
        possible = sorted((best, opposite), key=lambda i: int((_ORDERS[i] < 0.0).sum()))
    else:
        possible = [i for i in (best, opposite) if np.sign(sine[i].mean()) == -np.sign(latitude)]
    orders = [  # such as "(my, mx, −mz)"
        ", ".join(("−" if row.sum() < 0.0 else "") + spec.columns[int(np.argmax(np.abs(row)))] for row in _ORDERS[i])
        for i in possible
    ]
    return (
        f"magnetometer: the dip angle of the rests scatters by {plain / DEGREE:.1f}° with the columns as they are, and "
        f"by {scatter[best] / DEGREE:.1f}° with {' or '.join(f'({order})' for order in orders)} in place of "
        f"({', '.join(spec.columns)}): columns are exchanged or mirrored, or its axes are not those of the "
        "accelerometers",
    )


def with_magnetometer(calibration: Calibration, spec: Channels, observations: Observations) -> Calibration:
    """A calibration with the parameters of the session's magnetometer; where that cannot be calibrated, without them,
    and a note says why."""
    covariance = calibration.covariance
    fit = magnetometer(observations, spec.unit_name)
    if fit.reasons or fit.values is None or fit.covariance is None or covariance is None:
        why = "; ".join(fit.reasons) or "magnetometer: nothing says how well it is known"
        note = f"{why}; the rest of the session is calibrated without it"
        missing = replace(calibration.outcome, unobservable=calibration.outcome.unobservable + MAGNETOMETER_NAMES)
        return replace(calibration, outcome=missing, notes=(*calibration.notes, note))
    numbers = zip(fit.values.tolist(), np.sqrt(np.diag(fit.covariance)).tolist(), strict=True)
    units = (spec.unit_name,) * 3 + ("1",) * 3 + ("rad",) * 3
    by_fit = UncertaintyBudget(sources=(source("mag.fit"),), covariances=fit.covariance[None])
    return replace(
        calibration,
        parameters=calibration.parameters
        + tuple(
            Parameter(name=name, value=value, u=u, unit=unit)
            for name, (value, u), unit in zip(MAGNETOMETER_NAMES, numbers, units, strict=True)
        ),
        covariance=block_diag(covariance, fit.covariance),
        mag=fit.model,
        fits=dict(calibration.fits) | fit.fits,
        budget=(*calibration.budget, *contributions_of(by_fit, MAGNETOMETER_NAMES)),
        notes=calibration.notes + fit.notes + exchanged_columns(calibration.accel, fit.model, observations, spec),
    )
