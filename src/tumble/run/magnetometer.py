"""The magnetometer of a session, by the ellipsoid method: its rest means lie on an ellipsoid as those of the
accelerometers do, with the modulus of the Earth's field in place of g.

The parameters are in a frame of its own, fixed as that of the accelerometers: X along the X channel, Y in the plane of
X and Y. In the words of its users, the bias is the hard iron (the constant field that turns with the device), and
scale-factor errors and axis angles together are the soft iron (fields induced in the device, and the errors of the
channels, which cannot be told from them).

Where the field is not known, its modulus is taken so that the scale-factor errors vanish in the mean; their ratios, the
angles and the bias are the same for any.

Whether its channels are along the axes of the accelerometers the dip angle tells. At one place the angle between the
vertical and the field of the Earth is the same in every attitude,

    uᵢᵀ P mᵢ = sin(dip) for all rests i,

with the vertical u and the direction of the field m in the body from the corrected readings, and P = 1 where the
channels are in order. Where two are exchanged or one is mirrored, another signed permutation P makes it so. P and −P do
so alike; which of the two it is the hemisphere tells, where the latitude is known: the field points down in the north.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tumble.diagnosis.observability import Refusal
from tumble.diagnosis.turn_likelihood import signed_permutations
from tumble.inference.estimate import Fit
from tumble.inference.sources import UncertaintyBudget, source
from tumble.methods.ellipsoid_fit import TRIAD, EllipsoidFit, fit_ellipsoid
from tumble.methods.quadric import fit_many
from tumble.recording.session import Channels
from tumble.reduction.observations import Observations
from tumble.result.calibration import Calibration
from tumble.result.parts import Parameter
from tumble.result.uncertainty_budget import contributions_of
from tumble.rotation import unit_vector
from tumble.sensors.model import SensorModel
from tumble.units import DEGREE, Array

NAMES = tuple(f"mag.{name.partition('.')[2]}" for name in TRIAD.names)

SCATTER_LIMIT = 2e-2
"""Scatter of the rests, in parts of the field, above which a magnetometer is refused. Near steel the field is not the
same in every rest."""
FITS = 5.0 * DEGREE
"""Scatter of the dip angle below which an order of the channels explains the rests."""

CONTRADICTS = 3.0
"""How many times the scatter must be larger in the order of the session and in every other one."""

TELLING_LATITUDE = 20.0 * DEGREE
"""Nearer the equator the field may point either way."""

_ORDERS = signed_permutations()


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MagnetometerEstimate:
    """Values (9,) of the parameters NAMES, biases in the magnetometer's unit, with covariance (9, 9), and the model
    they make; None where the rests do not determine them. `reasons` against the result, and `notes` about it."""

    values: Array | None
    covariance: Array | None
    model: SensorModel | None
    fits: dict[str, Fit]
    reasons: tuple[str, ...]
    notes: tuple[str, ...]


def magnetometer(observations: Observations, unit: str) -> MagnetometerEstimate:
    """The parameters of a session's magnetometer, which reads in `unit`."""
    readings, site = observations.rests.magnetometer, observations.site
    assert readings is not None
    field = site.field
    if field is None:  # with which the sensitivities are 1 in the geometric mean; 1 where there is no ellipsoid
        algebraic = fit_many(readings[None])
        field = float(np.cbrt(np.linalg.det(algebraic.models().matrix[0]))) if algebraic.found[0] else 1.0
    fit = fit_ellipsoid(readings, modulus=field, covariance=observations.rests.magnetometer_covariance)
    if isinstance(fit, Refusal):
        reason = f"magnetometer: {fit.reason}; or leave [log.magnetometer] out"
        return MagnetometerEstimate(values=None, covariance=None, model=None, fits={}, reasons=(reason,), notes=())
    scattering = (
        f"magnetometer: the rests scatter by {fit.scatter:.3g} {unit}, more than {100 * SCATTER_LIMIT:g} % of "
        "the field: the field is not the same in all of them; record away from steel, or leave [log.magnetometer] out"
    )
    return MagnetometerEstimate(
        values=fit.values,
        covariance=fit.covariance,
        model=fit.model,
        fits={"magnetometer": fit.fit(unit)},
        reasons=(scattering,) if fit.scatter > SCATTER_LIMIT * field else (),
        notes=_notes(fit, observations, field, unit),
    )


def _notes(fit: EllipsoidFit, observations: Observations, field: float, unit: str) -> tuple[str, ...]:
    """The result in the words of its users, rests that were left out, and what is not known."""
    hard = ", ".join(f"{b:.4g}" for b in fit.model.bias)
    soft = np.linalg.svd(fit.model.matrix, compute_uv=False)
    notes = [
        f"magnetometer: hard iron ({hard}) {unit}, to be subtracted; soft iron: the field is read {soft[2]:.4f} to "
        f"{soft[0]:.4f} times its size, depending on its direction, which matrix⁻¹ undoes"
    ]
    if observations.site.field is None:
        notes.append(
            f"magnetometer: the field is not known (site.field) and was taken as {field:.5g} {unit}, so that mag.scale "
            "is relative to the mean of the three; mag.bias and mag.axis do not depend on it"
        )
    rests = observations.rests
    notes += [
        f"magnetometer: rest {i + 1} ({rests.start[i]:z.1f}–{rests.stop[i]:z.1f} s) was left out: "
        f"{fit.sigmas[i]:.1f} sigma, the field is {fit.residual[i]:+.3g} {unit} off"
        for i in np.flatnonzero(~fit.used)
    ]
    if fit.doubtful:
        which = " or ".join(str(i + 1) for i in sorted(fit.doubtful))
        notes.append(
            f"magnetometer: rest {which} does not fit: {fit.sigmas[fit.doubtful[0]]:.1f} sigma; it was left in"
        )
    return tuple(notes)


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
    from scipy.linalg import block_diag

    covariance = calibration.covariance
    fit = magnetometer(observations, spec.unit_name)
    if fit.reasons or fit.values is None or fit.covariance is None or covariance is None:
        why = "; ".join(fit.reasons) or "magnetometer: nothing says how well it is known"
        note = f"{why}; the rest of the session is calibrated without it"
        missing = replace(calibration.outcome, unobservable=calibration.outcome.unobservable + NAMES)
        provenance = replace(calibration.provenance, notes=(*calibration.provenance.notes, note))
        return replace(calibration, outcome=missing, provenance=provenance)
    numbers = zip(fit.values.tolist(), np.sqrt(np.diag(fit.covariance)).tolist(), strict=True)
    units = (spec.unit_name,) * 3 + ("1",) * 3 + ("rad",) * 3
    by_fit = UncertaintyBudget(sources=(source("mag.fit"),), covariances=fit.covariance[None])
    return replace(
        calibration,
        parameters=calibration.parameters
        + tuple(
            Parameter(name=name, value=value, u=u, unit=unit)
            for name, (value, u), unit in zip(NAMES, numbers, units, strict=True)
        ),
        covariance=block_diag(covariance, fit.covariance),
        mag=fit.model,
        evidence=replace(
            calibration.evidence,
            fits=dict(calibration.evidence.fits) | fit.fits,
            budget=(*calibration.evidence.budget, *contributions_of(by_fit, NAMES)),
        ),
        provenance=replace(
            calibration.provenance,
            notes=calibration.provenance.notes
            + fit.notes
            + exchanged_columns(calibration.accel, fit.model, observations, spec),
        ),
    )
