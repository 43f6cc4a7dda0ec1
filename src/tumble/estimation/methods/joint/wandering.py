"""Sensors whose bias wanders from rest to rest more than that of the others of their kind.

One component of scatter for all sensors of a kind takes them to be alike. Of many chips one or two may follow the
temperature beside them, or have a noise that the others do not have. They would be judged by a scatter that is too
small for them, and spoil what all others say by one that is too large. So they have a component of their own.

With the directions Z of a sensor, whitened, and what a fit leaves of the residuals, r of covariance C, |Zᵀ r|² is a sum
of squares with weights ZᵀCZ, where the sensor is like the others.

Of a triad a scatter of one is a third of that of all, and what it leaves of the others' residuals hides it. There the
restricted likelihoods of the session with a component of their own for each are compared.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy import special

from tumble.estimation.causes.chances import weighted_chance
from tumble.estimation.methods.joint.fit import Fitted, fit_of
from tumble.estimation.methods.joint.iteration import At
from tumble.estimation.methods.joint.leaving_out import MOST_LEFT_OUT, without_misfits
from tumble.units import Array

WANDERS = 1e-3
"""A sensor wanders where chance alone would make any of its kind differ from the others by as much less often."""
TOLD = 4.0
"""−2 log of the likelihoods with another one and with the one that wanders, at least."""
ROUNDS = 3
FEW = 3
"""Of so many sensors the others do not say what is usual: each is tried."""


def with_wandering(fitted: Fitted) -> Fitted:
    """The solution in which the sensors that wander more than the others have a scatter of their own."""
    for _ in range(ROUNDS):
        found = tuple(sorted({*fitted.problem.wandering, *_wandering(fitted)}))
        if found == fitted.problem.wandering:
            break
        fitted = _parted(fitted, found)
    return fitted


def _wandering(fitted: Fitted) -> Iterator[int]:
    """The channels that do, accelerometers before gyros."""
    rests = fitted.problem.observations.rests
    n = rests.accel.shape[1]
    last = n + rests.gyro.shape[1]
    squares, weights = _squares(fitted, last) if max(n, last - n) > FEW else (np.zeros((0, last)), np.zeros((0, last)))
    common = {range(n): fitted.scatter.accel, range(n, last): fitted.scatter.gyro}
    for channels in common:
        if len(channels) <= FEW:
            if common[channels] > 0.0 and not set(channels) & set(fitted.problem.wandering):
                yield from _likelier_apart(without_misfits(fitted, MOST_LEFT_OUT), channels)
            continue
        for channel in channels:
            chance = weighted_chance(float(squares[:, channel].sum()), weights[:, channel])
            if len(channels) * chance < WANDERS:
                yield channel


def _likelier_apart(fitted: Fitted, channels: range) -> Iterator[int]:
    """The one of a few channels with whose own scatter the session is likelier beyond chance: than with one for all,
    and than with that of any other. One bad rest is no scatter: the fit is without those that stand out."""
    deviances = [_parted(fitted, (*fitted.problem.wandering, channel)).evidence for channel in channels]
    best, *others = sorted(deviances)
    if len(channels) * 0.5 * special.chdtrc(1, max(fitted.evidence - best, 0.0)) < WANDERS and best + TOLD < others[0]:
        yield channels[deviances.index(best)]


def _parted(fitted: Fitted, wandering: tuple[int, ...]) -> Fitted:
    """The solution in which these channels have a scatter of their own."""
    parted = replace(fitted.problem, wandering=wandering)
    start = At.of(parted, fitted.solved.point, fitted.solved.last.about, fitted.out)
    return fit_of(parted, start, guess=fitted.scatter)


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
