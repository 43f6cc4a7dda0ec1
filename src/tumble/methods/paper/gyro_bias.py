"""Alignment of a body at rest, and gyro biases from rests, stage 3: three ways to compare what gyros read with the
Earth's rate.

All of them take any leading axes: rates ω̂ and specific forces (..., N, 3) of N rests in the body frame,
`earth_rate` (3,) Ω in N, U, E. Bias is the reading minus the true rate.

    vector          ω̂ − L̂ᵀΩ, L̂ by TRIAD                  Eq. (16); at the pole (17), vertical (18)
    scalar          (ω̂² − Ω²)/2Ω = û^Ω·δω                 after (12), (13)
    dot product     û·ω̂ − Ω sin B = û·δω                  not in the paper

What levels them is the accelerometers: an error δw of theirs leaves Ω cos B δw/g in every one.
"""

from __future__ import annotations

import numpy as np

from tumble.methods.paper.accuracy_formulas import applied, solved, transposed
from tumble.rotation import rotation_matrix, unit_vector
from tumble.units import Array

STANDING = 1e-6
"""Cosine deficit at which a nominal axis still counts as vertical."""


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


def vector_bias(rate: Array, force: Array, earth_rate: Array) -> Array:
    """Bias (..., N, 3), rad/s, that every gyro shows in every rest: ω̂ − L̂ᵀΩ with L̂ by TRIAD, Eq. (16).

    To be believed along the polar axis, where sensor errors enter times deviations from the programme, Eq. (17),
    and along the vertical, Eq. (18). TRIAD's azimuth is not linear in the bias: at the polar axis −δω_E²/2Ω is
    left, which the paper does not have (1.8 % of 0.3 °/h)."""
    return np.asarray(rate - applied(transposed(triad(force, rate)), earth_rate))


def vertical_bias(rate: Array, force: Array, earth_rate: Array, nominal: Array) -> Array:
    """Bias (..., 3) by the vector method where each gyro is vertical, Eq. (18): mean over the rests in which the
    nominal vertical (N, 3) is along its axis."""
    shown = vector_bias(rate, force, earth_rate)
    standing = np.abs(nominal) > 1.0 - STANDING
    return np.stack([shown[..., standing[:, q], q].mean(axis=-1) for q in range(3)], axis=-1)


def scalar_bias(rate: Array, force: Array, earth_rate: Array) -> Array:
    """Bias (..., 3) by the scalar method: least squares of (ω̂² − Ω²)/2Ω = û^Ω·δω, û^Ω = L̂ᵀΩ/Ω, the analogue of
    Eqs. (12), (13) with the estimated orientation.

    Every rest is left with (δω_N² + δω_U² − δω_E²)/2Ω, which cancels over a programme in which the sensors stand
    both ways."""
    Ω = float(np.linalg.norm(earth_rate))
    polar = applied(transposed(triad(force, rate)), earth_rate) / Ω
    return solved(polar, ((rate**2).sum(axis=-1) - Ω**2) / (2.0 * Ω))


def invariant_bias(rate: Array, force: Array, earth_rate: Array) -> Array:
    """Bias (..., 3) from the dot-product invariant û·ω̂ − Ω sin B = û·δω by least squares: linear in the bias, and
    without an azimuth. Not in the paper, where the scalar method has to take its place."""
    u = unit_vector(force)
    return solved(u, (u * rate).sum(axis=-1) - earth_rate[1])
