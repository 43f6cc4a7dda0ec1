"""Prior knowledge of the parameters of a device, such as from other units of its type.

A prior is a normal distribution N(m, S) of some parameters, in place of their usual sizes in the grade. With
the information Λ and h of the recording, and of the usual sizes of other parameters, the estimate becomes

    C = (Λ + S⁻¹)⁻¹,   x = C (h + S⁻¹ m)                                                                        (1)

If the prior is right, x_j − m_j has the variance S_jj − C_jj. A parameter whose deviation would occur by chance in less
than one of a hundred devices (Student's t with Holm's rule over all parameters) is named, and its prior is not used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from tumble.brief import Brief
from tumble.inference.estimate import Estimate
from tumble.inference.prediction import prediction
from tumble.inference.sources import UncertaintyBudget, source
from tumble.reduction.observations import Observations
from tumble.sensors.parameters import group_name, positions_by_group, to_temperature
from tumble.units import Array

UNLIKE = 0.01  # probability, over all parameters of a device, of rejecting a prior that is right


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class DevicePrior(Brief):
    """Prior knowledge of a device.

    Parameters
    ----------
    words
        Source of the knowledge, such as "3 other units of the type 'M-1'".
    names, mean, covariance
        Names (m,), mean (m,) and covariance (m, m) of the parameters, SI.
    degrees
        Degrees of freedom (m,) of the variances.
    reference
        Temperature in °C to which the parameters refer; None if unknown.
    in_run
        Usual standard deviation of the in-run biases of "accel" and "gyro", SI.
    """

    words: str
    names: tuple[str, ...]
    mean: Array
    covariance: Array
    degrees: Array
    reference: float | None = None
    in_run: Mapping[str, float] = field(default_factory=dict)

    def at(self, reference: float | None) -> DevicePrior:
        """Return the prior at another temperature in °C, by its own temperature coefficients."""
        if reference is None or self.reference is None:
            return self
        move = to_temperature(self.names, reference - self.reference)
        return replace(self, mean=move @ self.mean, covariance=move @ self.covariance @ move.T, reference=reference)

    def places(self, names: Sequence[str]) -> dict[int, int]:
        """Return positions among `names`, with those in the prior, of groups that are complete in the prior."""
        groups = positions_by_group(names).values()
        complete = [i for members in groups if all(names[j] in self.names for j in members) for i in members]
        return {i: self.names.index(names[i]) for i in sorted(complete)}


def with_prior(
    estimate: Estimate, observations: Observations, prior: DevicePrior, reference: float | None = None
) -> tuple[Estimate, tuple[str, ...]]:
    """Combine an estimate of the method joint with prior knowledge of its device, in place of the usual sizes.

    Return the combined estimate (the same if the prior has none of its parameters), and sentences on the prior used and
    on parameters that contradict it. `reference` is the temperature of the estimate in °C."""
    prior, names = prior.at(reference), estimate.names
    places = prior.places(names)
    if not places or estimate.budget is None or estimate.linearised is None:
        return estimate, (f"no prior by {prior.words}",)
    information, shift = _without_usual_sizes(estimate, observations, places)
    unlike: list[str] = []
    while True:
        values, covariance, by_prior = _combined(information, shift, prior, places)
        z = {
            i: (values[i] - prior.mean[k]) / np.sqrt(max(prior.covariance[k, k] - covariance[i, i], 1e-300))
            for i, k in places.items()
        }
        chance = {i: 2.0 * float(scipy.special.stdtr(prior.degrees[k], -abs(z[i]))) for i, k in places.items()}
        worst = min(chance, key=lambda i: chance[i])
        if chance[worst] * len(places) >= UNLIKE:
            break
        unlike.append(
            f"unlike its type: {names[worst]} is {abs(z[worst]):.1f} standard deviations off the mean of {prior.words} "
            f"(by chance with probability {chance[worst]:.1g}); the prior is not used for it"
        )
        del places[worst]
        if not places:
            return estimate, tuple(unlike)

    # the covariance by source
    further = {group.name for group in estimate.groups}
    replaced = {group_name(names[i]) for i in places} & further
    sources = estimate.budget.sources
    kept = np.array([part.name.removeprefix("prior.") not in replaced for part in sources])
    change = covariance @ symmetric_inverse(estimate.covariance)
    budget = UncertaintyBudget(
        sources=tuple(part for part, keep in zip(sources, kept, strict=True) if keep),
        covariances=change @ estimate.budget.covariances[kept] @ change.T,
    ).with_source(source("type"), covariance @ by_prior @ covariance)
    problem, before = estimate.linearised.problem, estimate.prediction
    observable = estimate.observable.copy()
    observable[[i for i in places if group_name(names[i]) in further]] = True
    instrument, gravity = problem.instrument, observations.site.gravity
    replacing = ", in the place of what is usual of the grade" if replaced else ""
    combined = replace(
        estimate,
        values=values,
        covariance=budget.covariances.sum(axis=0),
        observable=observable,
        accel=problem.accel_model(values),
        gyro=None if estimate.gyro is None else problem.gyro_model(values),
        prediction=prediction(
            instrument, values, covariance, gravity=gravity, rate=None if before is None else before.at_rate
        ),
        budget=budget,
        of_type={names[i]: float(np.sqrt(prior.covariance[k, k])) for i, k in places.items()},
    )
    return combined, (f"{prior.words} are a prior of {len(places)} parameters{replacing}", *unlike)


def _without_usual_sizes(
    estimate: Estimate, observations: Observations, places: Mapping[int, int]
) -> tuple[Array, Array]:
    """Return information Λ (m, m) and h (m,) of an estimate without the usual sizes that a prior replaces."""
    budget, names = estimate.budget, estimate.names
    assert budget is not None
    replaced = {group_name(names[i]) for i in places} & {group.name for group in estimate.groups}
    kept = np.array([part.name.removeprefix("prior.") not in replaced for part in budget.sources])
    precision = symmetric_inverse(estimate.covariance)
    information = precision @ budget.covariances[kept].sum(axis=0) @ precision
    start = np.array([observations.start.get(name, 0.0) for name in names])
    from_start = np.where([group_name(name) in replaced for name in names], estimate.values - start, 0.0)
    return information, information @ estimate.values + (precision - information) @ from_start


def _combined(
    information: Array, shift: Array, prior: DevicePrior, places: Mapping[int, int]
) -> tuple[Array, Array, Array]:
    """Return values (m,) and covariance (m, m) by Eq. (1), and S⁻¹ (m, m)."""
    at, in_prior = list(places), list(places.values())
    by_prior, mean = np.zeros_like(information), np.zeros(len(shift))
    by_prior[np.ix_(at, at)] = symmetric_inverse(prior.covariance[np.ix_(in_prior, in_prior)])
    mean[at] = prior.mean[in_prior]
    covariance = symmetric_inverse(information + by_prior)
    return covariance @ (shift + by_prior @ mean), covariance, by_prior


def symmetric_inverse(matrix: Array) -> Array:
    """Return the inverse of a symmetric matrix, scaled because its rows may differ by orders of magnitude."""
    size = np.sqrt(np.diag(matrix))
    inverse = np.linalg.inv(matrix / np.outer(size, size)) / np.outer(size, size)
    return np.asarray(0.5 * (inverse + inverse.T))
