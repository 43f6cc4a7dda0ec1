"""Errors common to two calibrations of one device, which cancel in their difference.

These are the error of gravity, in the scale factors of accelerometers, if both used the same stated gravity with the
same uncertainty; that of the time base, in the scale factors of gyros, if both state the same uncertainty; and that of
the prior of a property of the device. An estimate with the covariance C follows the mean of a prior of variance s² by C
s⁻², so that one standard deviation of the prior changes it by C/s. Where s was estimated, the changes by the prior of a
group are scaled to its contribution in the uncertainty budget. Without a budget all s are widened by one factor, the
least for which all these changes together are within C: the largest eigenvalue of S⁻¹ C S⁻¹, S = diag(s), is then at
most 1. With g₁ and g₂ the changes of the two calibrations by one standard uncertainty of a shared error,

    C(first − second) = C₁ + C₂ − Σ (g₁ g₂ᵀ + g₂ g₁ᵀ)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tumble.inference.sources import clock_effects, clock_errors
from tumble.result.calibration import Calibration
from tumble.result.coverage import gravity_sensitivity, shared_gravity
from tumble.result.parts import Parameter, SourceContributions
from tumble.sensors.parameters import group_name, variable_of
from tumble.units import Array

GRAVITY, TIME_BASE, PRIORS = "gravity", "the time base", "parameters that only priors determine"


def shared_errors(first: Calibration, second: Calibration) -> dict[str, tuple[Array, Array]]:
    """Return, by source, the changes of the parameters of the first (m₁, k) and the second (m₂, k) calibration by one
    standard uncertainty of each of k shared errors."""
    both, changes_by_source = (first, second), {}
    if shared_gravity(first.provenance.site, second.provenance.site):
        changes_by_source[GRAVITY] = [
            gravity_sensitivity(each.parameters, each.covariance, each.provenance.site)[:, None] for each in both
        ]
    if first.serial == second.serial:
        if first.provenance.clock_u == second.provenance.clock_u > 0.0:
            changes_by_source[TIME_BASE] = [time_base_sensitivity(each)[:, None] for each in both]
        by_prior = [prior_sensitivities(each.parameters, each.covariance, each.evidence.budget) for each in both]
        names = [name for name in by_prior[0] if name in by_prior[1]]
        if names:
            changes_by_source[PRIORS] = [np.stack([each[name] for name in names], axis=1) for each in by_prior]
    return {source: (a, b) for source, (a, b) in changes_by_source.items() if a.any() and b.any()}


def prior_sensitivities(
    parameters: Sequence[Parameter], covariance: Array | None, budget: Sequence[SourceContributions] = ()
) -> dict[str, Array]:
    """Return the change (m,) of all parameters by one standard deviation of each prior of a property of the device.

    The keys are the names of the parameters with priors. With a budget the squares over a group sum to the
    contribution of its prior."""
    if covariance is None:
        return {}
    priors = {i: p.prior for i, p in enumerate(parameters) if p.prior is not None and is_device_property(p.name)}
    if not priors:
        return {}
    indices, s = list(priors), np.array(list(priors.values()))
    widening = np.sqrt(max(np.linalg.eigvalsh(covariance[np.ix_(indices, indices)] / np.outer(s, s))[-1], 1.0))
    changes = {parameters[i].name: covariance[:, i] / (widening * size) for i, size in priors.items()}
    contributions = {each.name.removeprefix("prior."): each.contributions for each in budget}
    for group in {group_name(name) for name in changes} & set(contributions):
        members = [name for name in changes if group_name(name) == group]
        size = np.linalg.norm([changes[name] for name in members], axis=0)
        stated = np.array([contributions[group].get(p.name, 0.0) for p in parameters])
        ratio = np.divide(stated, size, out=np.zeros_like(size), where=size > 0.0)
        changes |= {name: changes[name] * ratio for name in members}
    return changes


def is_device_property(parameter: str) -> bool:
    """Return True if a parameter or group is a property of the device, unlike drifts, which belong to one session."""
    return variable_of(parameter) != "time"


def time_base_sensitivity(calibration: Calibration) -> Array:
    """Return the change (m,) of the parameters of a calibration by one standard uncertainty of the time base."""
    increments = dict.fromkeys(("accel", "gyro"), False)
    increments |= {kind: readings.increments for kind, readings in calibration.provenance.readings.items()}
    return clock_errors(
        [p.name for p in calibration.parameters], clock_effects(calibration.provenance.clock_u, increments)
    )
