"""A latitude that the gyros contradict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tumble.diagnosis.causes.cause import Candidate
from tumble.diagnosis.causes.linearised_session import LinearisedSession
from tumble.earth import earth_rate
from tumble.inference.linearisation import linearise
from tumble.units import DEGREE

LATITUDE_KNOWN = 0.01
"""rad: gyros that know the latitude to no better hardly see the Earth's rate, nor the headings, and these are not
linear then."""


def latitude_error(session: LinearisedSession) -> Candidate:
    """An error of the latitude of the site, rad, by a difference."""
    step, latitude = 1e-4, session.observations.site.latitude
    assert latitude is not None
    moved = replace(session.problem, earth=np.array(earth_rate(latitude + step)))
    rows, there = session.linearised.rows, linearise(moved, session.linearised.point, session.linearised.about)
    rest, turn = ((a - b)[..., None] / step for a, b in zip(rows.residuals, there.residuals, strict=True))
    return Candidate(
        name="latitude",
        concerns="both",
        rest=rest,
        turn=turn,
        unit=(DEGREE, "°"),
        sentences=("a latitude that the gyros contradict by {size}: look at latitude_deg in [site], and its sign",),
        known=LATITUDE_KNOWN,
    )
