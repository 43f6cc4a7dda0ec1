"""What two calibrations of one device err by alike, so that it is no part of a difference between them.

The uncertainty of gravity, where both used the same stated gravity with the same uncertainty, is in the scale factors
of the accelerometers; that of the time base, where both of one device state the same one, in those of the gyros. Where
both know a property of the device by a prior alone, or in part, they err alike by what it truly is: an estimate with
the covariance C follows the mean of a prior of variance s² by C s⁻², of which one standard deviation changes it by C/s.
Where s was found with the estimate, what the prior of a group changes is as large as the uncertainty budget says.
Without a budget all s are larger by one factor, the least with which all these changes together are within C: the
largest eigenvalue of S⁻¹ C S⁻¹ over the parameters with priors, S = diag(s), is at most 1.
With g₁ and g₂ what one standard uncertainty of such a source changes in either,

    C(first − second) = C₁ + C₂ − Σ (g₁ g₂ᵀ + g₂ g₁ᵀ)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tumble.inference.sources import clock_effects, clock_errors
from tumble.result.calibration import Calibration
from tumble.result.coverage import by_gravity, shared_gravity
from tumble.result.parts import Parameter, SourceContributions
from tumble.sensors.parameters import group_name, variable_of
from tumble.units import Array

GRAVITY, TIME_BASE, PRIORS = "gravity", "the time base", "what only priors say"


def shared_errors(first: Calibration, second: Calibration) -> dict[str, tuple[Array, Array]]:
    """For every source whose errors both share, what one standard uncertainty of each error changes in all parameters
    of the first (m₁, k) and of the second (m₂, k)."""
    changes_by_source = {}
    if shared_gravity(first.provenance.site, second.provenance.site):
        ours, theirs = (
            by_gravity(each.parameters, each.covariance, each.provenance.site)[:, None] for each in (first, second)
        )
        changes_by_source[GRAVITY] = (ours, theirs)
    if first.serial == second.serial:
        if first.provenance.clock_u == second.provenance.clock_u > 0.0:
            changes_by_source[TIME_BASE] = (of_time_base(first)[:, None], of_time_base(second)[:, None])
        by_ours, by_theirs = (
            by_priors(each.parameters, each.covariance, each.evidence.budget) for each in (first, second)
        )
        names = [name for name in by_ours if name in by_theirs]
        if names:
            ours, theirs = (np.stack([each[name] for name in names], axis=1) for each in (by_ours, by_theirs))
            changes_by_source[PRIORS] = (ours, theirs)
    return {source: changes for source, changes in changes_by_source.items() if changes[0].any() and changes[1].any()}


def by_priors(
    parameters: Sequence[Parameter], covariance: Array | None, budget: Sequence[SourceContributions] = ()
) -> dict[str, Array]:
    """Change (m,) of parameters, as far as their covariance (m, m) has it, where what a prior is of is one standard
    deviation of it off its mean: by the name of the parameter that has this prior, if it is a property of the device.
    The squares over a group are together what its prior contributes by the uncertainty budget, where there is one."""
    if covariance is None:
        return {}
    priors = {i: p.prior for i, p in enumerate(parameters) if p.prior is not None and is_of_device(p.name)}
    if not priors:
        return {}
    places, s = list(priors), np.array(list(priors.values()))
    widened = np.sqrt(max(np.linalg.eigvalsh(covariance[np.ix_(places, places)] / np.outer(s, s))[-1], 1.0))
    changes = {parameters[i].name: covariance[:, i] / (widened * size) for i, size in priors.items()}
    contributions = {each.name.removeprefix("prior."): each.contributions for each in budget}
    for group in {group_name(name) for name in changes} & set(contributions):
        members = [name for name in changes if group_name(name) == group]
        size = np.linalg.norm([changes[name] for name in members], axis=0)
        stated = np.array([contributions[group].get(p.name, 0.0) for p in parameters])
        ratio = np.divide(stated, size, out=np.zeros_like(size), where=size > 0.0)
        changes |= {name: changes[name] * ratio for name in members}
    return changes


def is_of_device(parameter: str) -> bool:
    """Whether a parameter or group is a property of the device and not of one session."""
    return variable_of(parameter) != "time"  # which is another in every session


def of_time_base(calibration: Calibration) -> Array:
    """What one standard uncertainty of the time base changes in the parameters (m,) of a calibration."""
    increments = dict.fromkeys(("accel", "gyro"), False)
    increments |= {kind: readings.increments for kind, readings in calibration.provenance.readings.items()}
    return clock_errors(
        [p.name for p in calibration.parameters], clock_effects(calibration.provenance.clock_u, increments)
    )
