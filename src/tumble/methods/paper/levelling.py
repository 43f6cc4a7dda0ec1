"""Analytic alignment of a body at rest: the vertical from the specific force, the azimuth from the Earth's rate.

Every function takes any leading axes: (..., N, 3) are N rests of any number of launches. Source: §1 and §5 of the
turntable method (Vodicheva & Parysheva 2019), TRIAD with the vertical as base vector.
"""

from __future__ import annotations

import numpy as np

from tumble.rotation import rotation_matrix, unit_vector
from tumble.units import Array


def triad(force: Array, rate: Array) -> Array:
    """Attitude body → geographic N, U, E (..., 3, 3) from the specific force and the Earth's rate measured at rest:
    e_U ∥ ŵ, e_E ∥ ω̂ × e_U, e_N = e_U × e_E."""
    up = unit_vector(force)
    east = unit_vector(np.cross(rate, up))
    return np.stack([np.cross(up, east), up, east], axis=-2)


def carried(attitude: Array, C: Array, earth_rate: Array, seconds: Array | float) -> Array:
    """Attitude (..., 3, 3) after a move that turned the body by C (body at the end → body at the start, in the
    non-rotating frame) and took `seconds`, in which the geographic frame turned by Ω T: exp(−[Ω T×]) L C."""
    return np.asarray(rotation_matrix(-earth_rate * seconds) @ attitude @ C)
