"""Findings about a device that was calibrated in motion.

Displacements that follow the attitude, as of a stand that gives way, are SUPPORT_COLUMNS unknowns b ~ N(0, s²) of the
estimate (docs/explanation/mathematics.md (40)). The variance of their posterior mean over instruments is at most s², so
Σ b²/s² is at most χ² with SUPPORT_COLUMNS degrees of freedom. If it is larger, the displacements exceed the prior, and
scale factors and axes contain them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy

from tumble.advice import Advised
from tumble.diagnosis.findings import Finding, refusal
from tumble.diagnosis.misfit import unusual_groups
from tumble.diagnosis.projection import FALSE_ALARMS
from tumble.diagnosis.undetermined import linear_names
from tumble.inference.estimate import Estimate
from tumble.inference.problem import LEVER_COLUMNS, SUPPORT_COLUMNS, SUPPORT_U
from tumble.reduction.observations import Observations
from tumble.sensors.parameters import group_name, within_kind

IN_MOTION = "calibrated in motion"  # start of the note on a result from motion
MOST_NAMED = 4
LEAST_GAIN = 0.8  # ratio of u with motion to that without, geometric mean; two minutes in one place reach 0.05 to 0.5
LARGEST_DISPLACEMENT = 0.3  # m: a larger one contradicts the model of a device that stays in one place


def in_motion(estimate: Estimate, observations: Observations, missing: tuple[str, ...]) -> Iterator[Finding]:
    """Yield findings about an estimate from motion; `missing` are linear parameters that it does not determine."""
    links, linearised = observations.links, estimate.linearised
    assert links is not None
    n = len(observations.rests)
    sentence = f"{n} rest{'s' * (n != 1)} and {float(links.duration.sum()):.0f} s of motion"
    advice = (
        "turn it for two minutes about a point that stays in place, a tripod head or a ball joint, through all "
        "attitudes, or put it down in nine or more positions (`tumble programme` shows them)"
    )
    if not estimate.converged or linearised is None:
        yield refusal(Advised(f"{sentence} do not fit the model", advice))
        return
    if missing:
        named = ", ".join(missing[:MOST_NAMED]) + (" and others" if len(missing) > MOST_NAMED else "")
        yield refusal(Advised(f"{sentence} do not determine {named} well enough", advice), *missing)
    support, displacement = linearised.point.local[0, -SUPPORT_COLUMNS:], float(linearised.components.displacement)
    if scipy.special.chdtrc(SUPPORT_COLUMNS, float((support**2).sum()) / SUPPORT_U**2) < FALSE_ALARMS:
        yield refusal(
            Advised(
                f"the device moved by {100.0 * float(np.abs(support).max()):.1f} cm and more with its attitude: what "
                "held it gave way",
                "hold it by something stiffer, or turn it in the hand without a rhythm",
            )
        )
    elif displacement > LARGEST_DISPLACEMENT and not missing:
        yield refusal(Advised(f"the device moved by {displacement:.1f} m in motion", "keep it in one place"))
    yield from unusual_groups(estimate)


def improves(moving: Estimate, at_rest: Estimate) -> bool:
    """Return True if an estimate from motion is to be preferred to that from the rests and turns of its recording.

    Motion adds that the device stays in one place. If it was laid by hand from face to face, the unknowns of its
    support and the sizes of groups follow its way instead. Rests and turns do not depend on the place: if the device
    stays there, the scale factors and angles that they determine differ by Δ ~ N(0, C_r − C_m), and Δᵀ C_r⁻¹ Δ is at
    most χ² with as many degrees of freedom as there are values (Hausman 1978, Econometrica 46, 1251-1271). Biases are
    means over other times. Where rests and turns determine all linear parameters, motion must also reduce u."""
    linear = linear_names(at_rest.names)
    n, is_bias = len(linear), np.array([within_kind(group_name(name)) == "bias" for name in linear], dtype=bool)
    known = np.flatnonzero(at_rest.observable[:n] & ~is_bias)
    change = moving.values[known] - at_rest.values[known]
    square = float(change @ np.linalg.solve(at_rest.covariance[np.ix_(known, known)], change))
    if len(known) and scipy.special.chdtrc(len(known), square) < FALSE_ALARMS:
        return False
    gain = float(np.exp(np.log(moving.u[:n] / at_rest.u[:n]).mean()))
    complete = moving.converged and not linear_names(moving.unobservable)
    return bool(linear_names(at_rest.unobservable)) or (complete and gain < LEAST_GAIN)


def motion_note(estimate: Estimate, observations: Observations) -> tuple[str, ...]:
    """Return a note on a result from motion, with the point about which the device turned; none for rests and turns."""
    links, linearised = observations.links, estimate.linearised
    if links is None or linearised is None:
        return ()
    n, lever = len(observations.rests), linearised.point.local[0, -LEVER_COLUMNS - SUPPORT_COLUMNS : -SUPPORT_COLUMNS]
    place, size = ", ".join(f"{1e3 * x:.0f}" for x in lever), 1e3 * float(linearised.components.displacement)
    return (
        f"{IN_MOTION}, from {n} rest{'s' * (n != 1)} and {float(links.duration.sum()):.0f} s of it: "
        f"the device turned, to within {size:.2g} mm, about a point from which its accelerometers are at ({place}) mm",
    )
