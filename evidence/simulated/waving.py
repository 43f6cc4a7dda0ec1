"""A device that never lies still, on a pivot or in the hand, and one that is never moved.

Attitudes are rhythmic, three turns one in the other,

    q(t) = q₀ exp(α₁(t) up) exp(α₂(t) e₁) exp(α₃(t) e₂),      α(t) = A sin(2π f t + φ)

or jerky: from one attitude to the next by a quintic, with hardly a pause. The place is that of a pivot or a hand, which
sways by harmonics and may drift, and of a lever L from there to the device, which changes where it is gripped anew:

    p(t) = s(t) + d(t) + q(t) L(t) q(t)*
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from evidence.simulated.motion import (
    DEG,
    UP,
    Array,
    Course,
    Handling,
    conjugate,
    exponential,
    into_body,
    normal_gravity,
    product,
    smooth,
    unit,
)

HARMONICS = 5
REGRIP = 2.0
"""s that it takes to grip the device anew."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Waving:
    """How a device is moved."""

    style: Literal["rhythmic", "jerky", "still"] = "rhythmic"
    seconds: float = 120.0
    lever: float = 0.1
    """m, from the pivot or the wrist to the device."""
    sway: float = 1e-3
    """m, root mean square along each axis, of the pivot or the hand, at 0.3 to 1.5 Hz."""
    drift: float = 0.0
    """m, by which the hand goes to and fro within minutes."""
    grips: int = 1
    """How often the device is gripped, each time at another place."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Waved(Course):
    """A course of this kind: amplitudes, frequencies and phases of the three turns (3, 3), of the harmonics of the
    place (3, HARMONICS, 3) and of its drift (3, 3); levers (G, 3) and when the grip changes (G − 1,)."""

    waving: Waving
    swings: Array
    sways: Array
    drifts: Array
    levers: Array
    regrips: Array

    def still(self, t: Array) -> NDArray[np.bool_]:
        """Whether nothing moves at times (N,)."""
        return np.full(len(t), self.waving.style == "still")

    def pose(self, t: Array) -> tuple[Array, Array]:
        """Quaternions (N, 4) and places (N, 3) at times (N,)."""
        if self.waving.style == "jerky":
            q = Course.pose(self, t)[0]
        else:
            size, frequency, phase = self.swings
            angles = size * np.sin(2.0 * np.pi * frequency * t[:, None] + phase)
            q = np.broadcast_to(self.attitudes[0], (len(t), 4))
            for axis, angle in zip((UP, np.eye(3)[0], np.eye(3)[1]), angles.T, strict=True):
                q = product(q, exponential(angle[:, None] * axis))
        lever = np.broadcast_to(self.levers[0], (len(t), 3))
        for at, change in zip(self.regrips, np.diff(self.levers, axis=0), strict=True):
            lever = lever + smooth((t - at) / REGRIP)[:, None] * change
        size, frequency, phase = self.sways
        hand = (size * np.sin(2.0 * np.pi * frequency * t[:, None, None] + phase)).sum(axis=1)
        size, frequency, phase = self.drifts
        return q, into_body(conjugate(q), lever) + hand + size * np.sin(2.0 * np.pi * frequency * t[:, None] + phase)


def waved(waving: Waving, rng: np.random.Generator) -> Waved:
    """A course of this kind, drawn anew, at a place on Earth drawn anew."""
    count = 1 if waving.style != "jerky" else int(2.0 * waving.seconds)
    attitudes, vectors = unit(rng.normal(size=(1, 4))), rng.uniform(30.0, 150.0, (count - 1, 1)) * DEG
    lasts = vectors[:, 0] / (rng.uniform(100.0, 180.0, count - 1) * DEG)
    vectors = vectors * unit(rng.normal(size=(count - 1, 3)))
    attitudes = np.concatenate([attitudes, np.empty((count - 1, 4))])
    for k, vector in enumerate(vectors):
        attitudes[k + 1] = product(attitudes[k], exponential(vector))
    begin = np.cumsum(np.r_[0.0, lasts + rng.uniform(0.0, 0.3, count - 1)])[:-1]
    latitude = float(rng.choice([-1.0, 1.0]) * rng.uniform(20.0, 60.0) * DEG)
    turning = np.array([2.5, 1.2, 2.5]) * float(waving.style == "rhythmic")

    def waves(size: Array, slowest: float, fastest: float) -> Array:
        """Amplitudes, frequencies, Hz, and phases, of these shapes."""
        parts = size * rng.uniform(0.7, 1.3, size.shape), rng.uniform(slowest, fastest, size.shape)
        return np.stack([*parts, rng.uniform(0.0, 2.0 * np.pi, size.shape)])

    return Waved(
        waving=waving,
        swings=waves(turning, 0.06, 0.12),
        sways=waves(np.full((HARMONICS, 3), waving.sway * np.sqrt(2.0 / HARMONICS)), 0.3, 1.5),
        drifts=waves(np.full(3, waving.drift), 0.005, 0.02),
        levers=waving.lever * unit(rng.normal(size=(waving.grips, 3))),
        regrips=waving.seconds * np.arange(1.0, waving.grips) / waving.grips,
        handling=Handling(),
        attitudes=attitudes,
        places=np.zeros((count, 3)),
        vectors=vectors,
        begin=begin,
        lasts=lasts,
        rests=np.array([[0.0, waving.seconds]]),
        tremor=(np.zeros((1, 3, 3)),) * 3,
        ringing=np.zeros((1, 3)),
        knocks=(np.zeros(0), np.zeros((0, 3))),
        faces=(),
        latitude=latitude,
        gravity=normal_gravity(latitude) + 3e-4 * rng.normal(),
    )
