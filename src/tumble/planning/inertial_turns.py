"""Turns of a body in inertial space, as gyros record them, from its attitudes to the rotating Earth."""

from __future__ import annotations

import numpy as np

from tumble.earth import earth_rate
from tumble.rotation import rotation_matrix, rotation_vector_near
from tumble.units import Array


def inertial_turns(start: Array, end: Array, moves: Array, seconds: Array, latitude: float) -> Array:
    """Rotation vectors (K, 3), rad, of the body in inertial space, in the body at the start, over moves from attitudes
    `start` to `end` (K, 3, 3), body → geographic, in so many seconds (K,): of the two ways round, that of the move,
    whose rotation vectors (K, 3) are geographic."""
    back = np.swapaxes(start, 1, 2)
    earth = rotation_matrix(seconds[:, None] * np.array(earth_rate(latitude)))
    return rotation_vector_near(back @ earth @ end, np.einsum("kij,kj->ki", back, moves))
