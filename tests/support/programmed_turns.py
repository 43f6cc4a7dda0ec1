"""Simulated observations without the turns that the programme does not prescribe, as if the log had been stopped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tumble.reduction.observations import Observations
from tumble.reduction.rests.rests import rows_of


def with_programmed_turns(observations: Observations) -> Observations:
    """The observations of one simulated session on a table with the turns of its programme alone."""
    programme, samples, readings = observations.programme, observations.turn_samples, observations.turn_readings
    assert programme is not None
    assert observations.turns is not None
    assert samples is not None
    kept = np.array([move.axis is not None for move in programme.moves])
    return replace(
        observations,
        turns=rows_of(observations.turns, kept),  # type: ignore[arg-type]  # of a mask
        turn_samples=replace(samples, start=samples.start[kept], stop=samples.stop[kept], _kept=[]),
        turn_readings=None if readings is None else rows_of(readings, kept),  # type: ignore[arg-type]
    )
