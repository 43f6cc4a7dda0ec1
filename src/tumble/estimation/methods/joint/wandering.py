"""Sensors of an array whose bias wanders from rest to rest more than that of the others of their kind.

One component of scatter for all sensors of a kind takes them to be alike. Of many chips one or two may follow the
temperature beside them, or have a noise that the others do not have. They would be judged by a scatter that is too
small for them, and spoil what all others say by one that is too large. So they have a component of their own.

With the directions Z of a sensor, whitened, and what a fit leaves of the residuals, r of covariance C, |Zᵀ r|² is a sum
of squares with weights ZᵀCZ, where the sensor is like the others.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tumble.estimation.causes.chances import weighted_chance
from tumble.estimation.methods.joint.fit import Fitted, fit_of
from tumble.estimation.methods.joint.iteration import At
from tumble.units import Array

WANDERS = 1e-3
"""A sensor wanders where chance alone would make any of its kind differ from the others by as much less often."""
ROUNDS = 3
FEW = 3
"""Of so many sensors none is told from the others."""


def with_wandering(fitted: Fitted) -> Fitted:
    """The solution in which the sensors that wander more than the others have a scatter of their own."""
    for _ in range(ROUNDS):
        found = tuple(sorted({*fitted.problem.wandering, *_wandering(fitted)}))
        if found == fitted.problem.wandering:
            break
        parted = replace(fitted.problem, wandering=found)
        start = At.of(parted, fitted.solved.point, fitted.solved.last.about, fitted.out)
        fitted = fit_of(parted, start, guess=fitted.scatter)
    return fitted


def _wandering(fitted: Fitted) -> Iterator[int]:
    """The channels that do, accelerometers before gyros."""
    rests = fitted.problem.observations.rests
    n = rests.accel.shape[1]
    last = n + rests.gyro.shape[1]
    if max(n, last - n) <= FEW:
        return
    squares, weights = _squares(fitted, last)
    for channels in (range(n), range(n, last)):
        for channel in channels if len(channels) > FEW else ():
            chance = weighted_chance(float(squares[:, channel].sum()), weights[:, channel])
            if len(channels) * chance < WANDERS:
                yield channel


def _squares(fitted: Fitted, sensors: int) -> tuple[Array, Array]:
    """Squares of the residuals along every channel (M, n) by rest, with its turn where one follows, and their
    expectations."""
    (after, weight), noise, last = fitted.left, fitted.solved.last.noise, fitted.problem.unlinked
    found = []
    for W, Z, (residual, covariance) in (
        (weight.rest[last], noise.rest_directions[0][last], (after.rest[0][last], after.rest[1][last])),
        (weight.merged, noise.merged_directions[0], after.merged),
    ):
        along = W @ Z[:, :, :sensors]
        expected = np.einsum("mrk,mrk->mk", along, covariance @ along)
        found.append((np.einsum("mrk,mr->mk", along, residual) ** 2, expected))
    squares, weights = (np.concatenate(each) for each in zip(*found, strict=True))
    return squares, weights
