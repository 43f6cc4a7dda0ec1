"""Findings about a device that was calibrated in motion: what the motion does not determine, and whether it followed
the attitude.

Displacements that follow the attitude, as of a stand that sags, are among the unknowns of the estimate: SUPPORT_COLUMNS
numbers b ~ N(0, s²) (docs/explanation/mathematics.md (40)). Their posterior mean has over instruments at most the
variance s², so that Σ b²/s² is at most χ² with SUPPORT_COLUMNS degrees of freedom. Where it is larger, the
displacements are larger than the prior allows for, and scale factors and axes contain them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy

from tumble.diagnosis.findings import Finding
from tumble.diagnosis.projection import FALSE_ALARMS
from tumble.inference.estimate import Estimate
from tumble.inference.problem import LEVER_COLUMNS, SUPPORT_COLUMNS, SUPPORT_U
from tumble.reduction.observations import Observations

IN_MOTION = "calibrated in motion"
"""How the note begins that a result is from motion."""
MOST_NAMED = 4
LOOSE = 0.3
"""m: a device that is displaced by more does not stay in one place, as the model has it."""


def in_motion(estimate: Estimate, observations: Observations, missing: tuple[str, ...]) -> Iterator[Finding]:
    """Findings about an estimate from motion; `missing` are the linear parameters that it does not determine."""
    links, linearised = observations.links, estimate.linearised
    assert links is not None
    n = len(observations.rests)
    sentence = f"{n} rest{'s' * (n != 1)} and {float(links.duration.sum()):.0f} s of motion"
    advice = (
        "turn it for two minutes about a point that stays in place, a tripod head or a ball joint, through all "
        "attitudes, or put it down in nine or more positions (`tumble programme` shows them)"
    )
    if not estimate.converged or linearised is None:
        yield Finding(sentence=f"{sentence} do not fit the model; {advice}", refuses=True)
        return
    if missing:
        named = ", ".join(missing[:MOST_NAMED]) + (" and others" if len(missing) > MOST_NAMED else "")
        yield Finding(sentence=f"{sentence} say too little of {named}; {advice}", concerns=missing, refuses=True)
    given_way, displacement = linearised.point.local[0, -SUPPORT_COLUMNS:], float(linearised.components.displacement)
    square = float((given_way**2).sum()) / SUPPORT_U**2
    if scipy.special.chdtrc(SUPPORT_COLUMNS, square) < FALSE_ALARMS:
        size = 100.0 * float(np.abs(given_way).max())
        yield Finding(
            sentence=f"the device moved by {size:.1f} cm and more with its attitude: what held it gave way; hold it by "
            "something stiffer, or turn it in the hand without a rhythm",
            refuses=True,
        )
    elif displacement > LOOSE and not missing:
        yield Finding(
            sentence=f"the device moved by {displacement:.1f} m in motion: keep it in one place", refuses=True
        )


def motion_note(estimate: Estimate, observations: Observations) -> tuple[str, ...]:
    """A note that a result is from motion, with the point about which the device turned; none for rests and turns."""
    links, linearised = observations.links, estimate.linearised
    if links is None or linearised is None:
        return ()
    n, lever = len(observations.rests), linearised.point.local[0, -LEVER_COLUMNS - SUPPORT_COLUMNS : -SUPPORT_COLUMNS]
    place, size = ", ".join(f"{1e3 * x:.0f}" for x in lever), 1e3 * float(linearised.components.displacement)
    return (
        f"{IN_MOTION}, from {n} rest{'s' * (n != 1)} and {float(links.duration.sum()):.0f} s of it: "
        f"the device turned, to within {size:.2g} mm, about a point from which its accelerometers are at ({place}) mm",
    )
