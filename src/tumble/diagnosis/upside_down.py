"""Whether up is up: accelerometers that all have the wrong sign."""

from __future__ import annotations

import numpy as np

from tumble.earth import EARTH_RATE
from tumble.programme.positions import from_attitudes, programme
from tumble.recording.session import Session
from tumble.reduction.observations import Observations
from tumble.rotation import unit_vector
from tumble.units import DEGREE, Array

UPRIGHT = 20.0 * DEGREE
"""How far a rest may be from its position of the programme to count as that position, or as it upside down."""

_SIGN = "an accelerometer at rest with its axis up must read +g"


def verticals(observations: Observations) -> Array:
    """Verticals (N, 3) in the body, from nominal accelerometers."""
    return unit_vector(specific_forces(observations))


def specific_forces(observations: Observations) -> Array:
    """Specific forces (N, 3) at rest, m/s^2, from nominal accelerometers."""
    return observations.accel_block.nominal().apply(observations.rests.accel)


def upside_down(observations: Observations, session: Session) -> list[str]:
    """Whether all accelerometers have the wrong sign, by the programme or the vertical part of the Earth's rate."""
    vertical = verticals(observations)
    expected = _programmed(session, len(vertical))
    if expected is not None and np.all(np.einsum("ij,ij->i", vertical, expected) < -np.cos(UPRIGHT)):
        return [f"all accelerometers have the wrong sign: every rest is the programme's upside down; {_SIGN}"]
    if _earth_reversed(observations, vertical):
        return [
            "the gyros see the vertical part of the Earth's rate with the wrong sign: all accelerometers have the "
            f"wrong sign, or site.latitude_deg has; {_SIGN}, and latitudes are positive in the north"
        ]
    return []


def _programmed(session: Session, rests: int) -> Array | None:
    """Verticals (N, 3) of the session's programme, where it has an order and as many positions as there are rests."""
    spec = session.programme
    if spec is None:
        return None
    listed = programme(spec.name) if spec.name is not None else from_attitudes([p.attitude for p in spec.positions])
    if not listed.ordered or len(listed.positions) != rests:
        return None
    return np.array([p.vertical_b for p in listed.positions])


def _earth_reversed(observations: Observations, vertical: Array) -> bool:
    """Whether ω = bias + s Ω sin B û at rest says s = −1 and nothing near +1. The horizontal part of the Earth's rate
    and gyros of lesser grades are noise to it."""
    block, latitude = observations.gyro_block, observations.site.latitude
    if block is None or latitude is None or len(vertical) < 4:
        return False
    rate = block.nominal().apply(observations.rests.gyro)
    rate, known = rate - rate.mean(axis=0), EARTH_RATE * np.sin(latitude) * (vertical - vertical.mean(axis=0))
    square = float((known**2).sum())
    if square == 0.0:
        return False
    slope = float((rate * known).sum()) / square
    u = float(np.sqrt(((rate - slope * known) ** 2).sum() / (3 * len(rate) - 4) / square))
    return slope + 6.0 * u < 0.0 and abs(slope + 1.0) < 3.0 * u + 0.1
