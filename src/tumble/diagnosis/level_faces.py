"""What six faces cannot check: that the faces on which an axis is level lean alike along it.

On the faces along an axis, the bias b of its sensor is what both directions have in common. On the other faces it reads
b + g t for a tilt t, which nothing states and an estimate without attitudes takes as it comes. Tilts that are chance
scatter about zero. Where they agree, with mean m, the device leans alike on every face, as a board with pins beneath it
does, or the sensor is not linear and b is off by g m; the accelerometer that points up there reads g cos m or g, so
that its scale factor is off by m²/2 in one of the two cases. Oblique positions tell them apart, as they tell the axis
angles. Where these are not observable, bias and scale factors have the difference in u.
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

CHANCE = 1e-2
"""Tilts agree where those of chance scatter about zero agree as well in less than this part of all devices."""
UPRIGHT = 0.9
"""Cosine of the tilt of a face, at least."""


def with_common_tilt(estimate: Estimate, observations: Observations) -> Estimate:
    """An estimate with the tilt that level faces have in common in its u, and a remark, where that is more than u; the
    same where oblique rests check it."""
    block, g = observations.accel_block, observations.site.gravity
    if not block.triad or not any(name.startswith("accel.axis") for name in estimate.unobservable):
        return estimate
    up = unit_vector(estimate.accel.apply(observations.rests.accel))
    face, place = np.abs(up).argmax(axis=1), {name: i for i, name in enumerate(estimate.names)}
    for axis, sensor in enumerate("xyz"):
        level = (np.abs(up).max(axis=1) > UPRIGHT) & (face != axis)
        tilts = up[level, axis]
        if len(tilts) < 3:
            continue
        mean, u = float(tilts.mean()), float(tilts.std(ddof=1) / np.sqrt(len(tilts)))
        bias = place[f"accel.bias.{sensor}"]
        far = abs(mean) > scipy.special.stdtrit(len(tilts) - 1, 1.0 - 0.5 * CHANCE) * u
        if not far or g * abs(mean) < estimate.u[bias]:
            continue
        off = np.zeros(len(estimate.names))
        off[bias] = g * mean
        for other in np.unique(face[level]).tolist():
            off[place[f"accel.scale.{'xyz'[other]}"]] = -0.5 * mean**2
        covariance, budget = estimate.covariance + np.outer(off, off), estimate.budget
        observable, linear = estimate.observable.copy(), np.flatnonzero(off)
        limits = limits_of([estimate.names[i] for i in linear])
        observable[linear] &= np.sqrt(np.diag(covariance)[linear]) < limits / DETERMINED
        size, unit = shown_in("accel.bias", "m/s^2", g * abs(mean))
        remark = (
            f"accelerometer {sensor} reads {g * abs(mean) / size:.3g} {unit} beside its bias on all faces on which it "
            f"is level: the device leans by {abs(mean) / DEGREE:.2g}° on each of them alike, or {sensor} is not "
            "linear, which faces do not tell apart; u has both, and oblique positions, such as edges, would tell"
        )
        estimate = replace(
            estimate,
            covariance=covariance,
            observable=observable,
            budget=None if budget is None else budget.with_source(source("tilt", abs(mean), "rad"), np.outer(off, off)),
            remarks=(*estimate.remarks, remark),
        )
    return estimate
