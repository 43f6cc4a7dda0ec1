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

from tumble.diagnosis.carried_vertical import signed_permutations
from tumble.inference.sources import UncertaintyBudget, source
from tumble.methods.magnetometer import NAMES as MAGNETOMETER_NAMES
from tumble.methods.magnetometer import magnetometer
from tumble.recording.session import Channels, Session
from tumble.reduction.observations import Observations
from tumble.result.calibration import Calibration
from tumble.result.parts import Parameter
from tumble.result.uncertainty_budget import contributions_of
from tumble.rotation import unit_vector
from tumble.sensors.model import SensorModel
from tumble.units import DEGREE, Array

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
    readings = observations.rests.magnetometer
    if accel is None or mag is None or readings is None or len(accel.bias) != 3:
        return ()
    vertical = unit_vector(accel.apply(observations.rests.accel))
    field = unit_vector(mag.apply(readings))
    sine = np.array([np.einsum("ip,pq,iq->i", vertical, P, field) for P in _ORDERS])
    scatter = sine.std(axis=1)
    order = np.argsort(scatter)
    best, plain = scatter[order[0]], scatter[_plain()]
    if best > FITS or min(plain, scatter[order[2]]) < CONTRADICTS * best:
        return ()  # order[1] is the best with all signs changed
    named = [_named(_ORDERS[i], spec.columns) for i in _possible(order[:2].tolist(), sine, observations.site.latitude)]
    return (
        f"magnetometer: the dip angle of the rests scatters by {_degrees(plain)} with the columns as they are, and by "
        f"{_degrees(best)} with {' or '.join(named)} in place of ({', '.join(spec.columns)}): columns are exchanged or "
        "mirrored, or its axes are not those of the accelerometers",
    )


def _plain() -> int:
    return next(i for i, P in enumerate(_ORDERS) if np.array_equal(P, np.eye(3)))


def _possible(pair: list[int], sine: Array, latitude: float | None) -> list[int]:
    """Which of an order and the one with all signs changed it can be."""
    if latitude is None or abs(latitude) < TELLING_LATITUDE:
        return sorted(pair, key=lambda i: int((_ORDERS[i] < 0.0).sum()))
    return [i for i in pair if np.sign(sine[i].mean()) == -np.sign(latitude)]


def _named(order: Array, columns: tuple[str, ...]) -> str:
    """The columns as an order takes them: "(my, mx, −mz)"."""
    taken = [("−" if row.sum() < 0.0 else "") + columns[int(np.argmax(np.abs(row)))] for row in order]
    return f"({', '.join(taken)})"


def _degrees(scatter: float) -> str:
    return f"{scatter / DEGREE:.1f}°"


def with_magnetometer(calibration: Calibration, session: Session, observations: Observations) -> Calibration:
    """A calibration with the parameters of the session's magnetometer, where it has one; where that cannot be
    calibrated, without them, and a note says why."""
    spec, covariance = session.log.magnetometer, calibration.covariance
    if spec is None:
        return calibration
    found = magnetometer(observations, spec.unit_name)
    if found.reasons or found.values is None or found.covariance is None or covariance is None:
        why = "; ".join(found.reasons) or "magnetometer: nothing says how well it is known"
        said = (f"{why}; the rest of the session is calibrated without it",)
        missing = replace(calibration.outcome, unobservable=calibration.outcome.unobservable + MAGNETOMETER_NAMES)
        return replace(calibration, outcome=missing, notes=calibration.notes + said)
    u, units = np.sqrt(np.diag(found.covariance)), (spec.unit_name,) * 3 + ("1",) * 3 + ("rad",) * 3
    parameters = tuple(
        Parameter(name=name, value=float(value), u=float(each), unit=unit)
        for name, value, each, unit in zip(MAGNETOMETER_NAMES, found.values, u, units, strict=True)
    )
    apart = np.zeros((len(covariance), 9))
    by_magnetometer = UncertaintyBudget(sources=(source("mag.fit"),), covariances=found.covariance[None])
    return replace(
        calibration,
        parameters=calibration.parameters + parameters,
        covariance=np.block([[covariance, apart], [apart.T, found.covariance]]),
        mag=found.model,
        fits=dict(calibration.fits) | found.fits,
        budget=(*calibration.budget, *contributions_of(by_magnetometer, MAGNETOMETER_NAMES)),
        notes=calibration.notes + found.notes + exchanged_columns(calibration.accel, found.model, observations, spec),
    )
