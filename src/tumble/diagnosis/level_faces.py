"""Common tilt of the faces on which an axis is level, which six faces cannot distinguish from a nonlinear sensor.

On the two faces along an axis, the bias b of its sensor is what both readings have in common. On the other faces it
reads b + g t with a tilt t, which an estimate without attitudes leaves free. Random tilts scatter about zero. If they
agree, with mean m, either the device leans alike on every face, as a board with pins beneath it does, or the sensor is
not linear and b is off by g m. The accelerometer that points up there reads g cos m or g, so its scale factor is off by
m²/2 in one of the two cases. Oblique positions distinguish the cases, as they determine the axis angles. If these are
not observable, the difference is added to u of bias and scale factors.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from tumble.inference.estimate import DETERMINED, Estimate
from tumble.inference.sources import source
from tumble.reduction.observations import Observations
from tumble.rotation import unit_vector
from tumble.sensors.parameters import limits_of, shown_in
from tumble.units import DEGREE

TILT_P_VALUE = 1e-2  # probability with which random tilts agree as well
UPRIGHT = 0.9  # least cosine of the tilt of a face


def with_common_tilt(estimate: Estimate, observations: Observations) -> Estimate:
    """Add the common tilt of level faces to covariance and budget, with a remark, if it exceeds u and no oblique rests
    check it."""
    block, g = observations.accel_block, observations.site.gravity
    if not block.triad or not any(name.startswith("accel.axis") for name in estimate.unobservable):
        return estimate
    up = unit_vector(estimate.accel.apply(observations.rests.accel))
    face, index = np.abs(up).argmax(axis=1), {name: i for i, name in enumerate(estimate.names)}
    for axis, sensor in enumerate("xyz"):
        level = (np.abs(up).max(axis=1) > UPRIGHT) & (face != axis)
        tilts = up[level, axis]
        if len(tilts) < 3:
            continue
        mean, u = float(tilts.mean()), float(tilts.std(ddof=1) / np.sqrt(len(tilts)))
        bias = index[f"accel.bias.{sensor}"]
        common = abs(mean) > scipy.special.stdtrit(len(tilts) - 1, 1.0 - 0.5 * TILT_P_VALUE) * u
        if not common or g * abs(mean) < estimate.u[bias]:
            continue
        error = np.zeros(len(estimate.names))
        error[bias] = g * mean
        for other in np.unique(face[level]).tolist():
            error[index[f"accel.scale.{'xyz'[other]}"]] = -0.5 * mean**2
        covariance, budget = estimate.covariance + np.outer(error, error), estimate.budget
        observable, changed = estimate.observable.copy(), np.flatnonzero(error)
        limits = limits_of([estimate.names[i] for i in changed])
        observable[changed] &= np.sqrt(np.diag(covariance)[changed]) < limits / DETERMINED
        size, unit = shown_in("accel.bias", "m/s^2", g * abs(mean))
        remark = (
            f"accelerometer {sensor} reads {g * abs(mean) / size:.3g} {unit} beside its bias on all faces on which it "
            f"is level: the device leans by {abs(mean) / DEGREE:.2g}° on each of them alike, or {sensor} is not "
            "linear, indistinguishable on faces; u includes both, and oblique positions, such as edges, would show it"
        )
        if budget is not None:
            budget = budget.with_source(source("tilt", abs(mean), "rad"), np.outer(error, error))
        remarks = (*estimate.remarks, remark)
        estimate = replace(estimate, covariance=covariance, observable=observable, budget=budget, remarks=remarks)
    return estimate
