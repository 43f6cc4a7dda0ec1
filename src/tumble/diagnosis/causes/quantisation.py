"""Steps of the readings that the noise does not cover."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tumble.diagnosis.causes.cause import UNITS, WORDS, Cause
from tumble.diagnosis.causes.linearised_session import LinearisedSession, kinds

COARSE = 0.5
"""What rounding does to the mean of a rest, in parts of its noise, from which on it is a cause."""


def quantisation(session: LinearisedSession, s: int) -> Iterator[Cause]:
    """Channels of session s whose steps the noise does not cover, where what rounding does to a mean is not small
    beside its noise."""
    own = session.problem.parts[s].rests
    for kind, _ in kinds(session):
        found = session.observations.rounding.get(kind)
        if found is None or not found.common_u.any():
            continue
        covariance = getattr(session.observations.rests, f"{kind}_covariance")[own]
        variance = np.median(np.diagonal(covariance, axis1=1, axis2=2), axis=0) - found.of_rest**2
        coarse = found.common_u > COARSE * np.sqrt(np.maximum(variance, 0.0))
        if coarse.any():
            worst = int(np.argmax(np.where(coarse, found.common_u, 0.0)))
            step, error = float(found.step[worst]), float(found.common_u[worst])
            scale, unit = UNITS[kind]
            yield Cause(
                name="quantisation",
                concerns=kind,
                probability=0.0,
                damage=0.0,
                sentence=f"steps of the {WORDS[kind]} of {step / scale:.2g} {unit} that the noise does not cover, "
                f"{found.noise[worst] / step:.2g} of one: the mean of a rest errs by up to {error / scale:.2g} {unit}; "
                "log with more digits, or use a smaller range",
            )
