"""The magnetometer of a session, by the ellipsoid method: its rest means lie on an ellipsoid as those of the
accelerometers do, with the modulus of the Earth's field in place of g.

The parameters are in a frame of its own, fixed as that of the accelerometers: X along the X channel, Y in the plane of
X and Y. In the words of its users, the bias is the hard iron (the constant field that turns with the device), and
scale-factor errors and axis angles together are the soft iron (fields induced in the device, and the errors of the
channels, which cannot be told from them).

Where the field is not known, its modulus is taken so that the scale-factor errors vanish in the mean; their ratios, the
angles and the bias are the same for any.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tumble.diagnosis.observability import Refusal
from tumble.inference.estimate import Fit
from tumble.methods.ellipsoid_fit import TRIAD, EllipsoidFit, fit_ellipsoid
from tumble.methods.quadric import fit_many
from tumble.reduction.observations import Observations
from tumble.sensors.model import SensorModel
from tumble.units import Array

NAMES = tuple(f"mag.{name.partition('.')[2]}" for name in TRIAD.names)

SCATTER_LIMIT = 2e-2
"""Scatter of the rests, in parts of the field, above which a magnetometer is refused. Near steel the field is not the
same in every rest."""


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
    found = fit_ellipsoid(readings, modulus=field, covariance=observations.rests.magnetometer_covariance)
    if isinstance(found, Refusal):
        reason = f"magnetometer: {found.reason}; or leave [log.magnetometer] out"
        return MagnetometerEstimate(values=None, covariance=None, model=None, fits={}, reasons=(reason,), notes=())
    scattering = (
        f"magnetometer: the rests scatter by {found.scatter:.3g} {unit}, more than {100 * SCATTER_LIMIT:g} % of "
        "the field: the field is not the same in all of them; record away from steel, or leave [log.magnetometer] out"
    )
    return MagnetometerEstimate(
        values=found.values,
        covariance=found.covariance,
        model=found.model,
        fits={"magnetometer": found.fit(unit)},
        reasons=(scattering,) if found.scatter > SCATTER_LIMIT * field else (),
        notes=_notes(found, observations, field, unit),
    )


def _notes(found: EllipsoidFit, observations: Observations, field: float, unit: str) -> tuple[str, ...]:
    """The result in the words of its users, rests that were left out, and what is not known."""
    hard = ", ".join(f"{b:.4g}" for b in found.model.bias)
    soft = np.linalg.svd(found.model.matrix, compute_uv=False)
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
        f"{found.sigmas[i]:.1f} sigma, the field is {found.residual[i]:+.3g} {unit} off"
        for i in np.flatnonzero(~found.used)
    ]
    if found.doubtful:
        which = " or ".join(str(i + 1) for i in sorted(found.doubtful))
        notes.append(
            f"magnetometer: rest {which} does not fit: {found.sigmas[found.doubtful[0]]:.1f} sigma; it was left in"
        )
    return tuple(notes)
