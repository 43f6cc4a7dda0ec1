"""Turns of a body in inertial space, as gyros record them, from its attitudes to the rotating Earth.

Moments of turns at a constant rate about an axis fixed in inertial space, as perfect sensors give them.

With v the rotation vector of a turn in the body at its start, ω = v/T, L₀ the attitude there and Ω the Earth's rate,

    C(t) = exp([ω×]t),   f(t) = g C(t)ᵀ L₀ᵀ exp([Ω×]t) e_U

Everything is smooth in t but |f_p|: Gauss–Legendre sums over the whole turn are exact to rounding for turns up to a
revolution, and right to some 1e-3 for |f_p|. The integrals ∫ Φ × dV of `tumble.reduction.turns.moments` are, in another
order,

    Ψ_jb = ∫ C_j β_b × (V(T) − V(t)) dt

and the velocity V(t) at the nodes comes from the integrals of the polynomials through them.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from tumble.earth import earth_rate
from tumble.planning.setup import Setup
from tumble.reduction.noise.coloured_noise import WHITE
from tumble.reduction.turns.moments import REGRESSORS, Moments, OwnAxes
from tumble.reduction.turns.turns import Turns
from tumble.rotation import rotation_matrix, rotation_vector_near, skew
from tumble.sensors.parameters import PAIRS
from tumble.units import Array, IntArray


def inertial_turns(start: Array, end: Array, moves: Array, seconds: Array, latitude: float) -> Array:
    """Rotation vectors (K, 3), rad, of the body in inertial space, in the body at the start, over moves from attitudes
    `start` to `end` (K, 3, 3), body → geographic, in so many seconds (K,): of the two ways round, that of the move,
    whose rotation vectors (K, 3) are geographic."""
    back = np.swapaxes(start, 1, 2)
    earth = rotation_matrix(seconds[:, None] * np.array(earth_rate(latitude)))
    return rotation_vector_near(back @ earth @ end, np.einsum("kij,kj->ki", back, moves))


def white_turns(
    first: IntArray, T: Array, covariance: Array, velocity_variance: Array, moments: Moments | None = None
) -> Turns:
    """Turns after the rests `first` (K,) in T (K,) s, with the covariances (K, 3, 3), rad², and variances (K,),
    (m/s)², of white noise; of these moments, or not yet integrated."""
    K = len(T)
    return Turns(
        first=first,
        last=first + 1,
        duration=T,
        C=np.broadcast_to(np.eye(3), (K, 3, 3)) if moments is None else moments.C,
        M=np.zeros((K, 3, 3, 3)) if moments is None else moments.Phi[..., 1:4],
        B=np.zeros((K, 3, 3)) if moments is None else moments.Phi[..., 0],
        covariance=covariance,
        arising=np.full(K, WHITE),
        velocity_covariance=velocity_variance[:, None, None] * np.eye(3),
        jumps=np.zeros(K),
        aliased=np.zeros(K),
    )


NODES = 24
_FIRST, _SECOND = np.array(PAIRS).T
_LINEAR = 7
"""Functions β that are no products."""


@cache
def _gauss() -> tuple[Array, Array, Array]:
    """Nodes and weights on 0…1, and the integrals (NODES, NODES) from each node to 1 of the polynomials that are 1
    at one node and 0 at the others."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    values = np.polynomial.legendre.legvander(nodes, NODES)
    coefficients = (values[:, :-1] * weights[:, None] * (np.arange(NODES) + 0.5)).T  # of each cardinal polynomial
    degree = np.arange(1, NODES)
    # ∫_x^1 P_n = (P_{n−1}(x) − P_{n+1}(x)) / (2n + 1),  ∫_x^1 P_0 = 1 − x
    to_end = np.empty((NODES, NODES))
    to_end[:, 0] = 1.0 - nodes
    to_end[:, 1:] = (values[:, degree - 1] - values[:, degree + 1]) / (2.0 * degree + 1.0)
    return 0.5 * (nodes + 1.0), 0.5 * weights, 0.5 * to_end @ coefficients


def steady_moments(
    vector: Array, T: Array, start: Array, setup: Setup, own: OwnAxes, still: Array
) -> tuple[Moments, tuple[Array, Array]]:
    """Moments of turns through rotation vectors (K, 3), body, inertial, in T (K,) s from attitudes (K, 3, 3); with
    `still` (K,) s before and after them in which nothing turns. And Φ and Ψ weighted with the time from the middle, as
    `tumble.reduction.turns.moments.growing_moments` has them."""
    K = len(T)
    at_once = not still.any()
    lasts = T[:, None] if at_once else np.stack([still, T, still], axis=1)
    nodes, weights, _ = _gauss()
    moves = np.ones((K, 1)) if at_once else np.broadcast_to([0.0, 1.0, 0.0], (K, 3))
    turned = (np.cumsum(moves, axis=1) - moves)[:, :, None] + moves[:, :, None] * nodes
    passed = (np.cumsum(lasts, axis=1) - lasts)[:, :, None] + lasts[:, :, None] * nodes
    C = rotation_matrix(turned.reshape(K, -1, 1) * vector[:, None])
    earth = np.array(earth_rate(setup.latitude))
    up = rotation_matrix(passed.reshape(K, -1, 1) * earth)[..., 1]
    force = setup.gravity * np.einsum("knij,kni->knj", C, np.einsum("kji,knj->kni", start, up))
    rate = np.repeat(moves[:, :, None] * (vector / T[:, None])[:, None], NODES, axis=1)
    felt = np.einsum("knij,knj->kni", C, force)
    dt = (lasts[:, :, None] * weights).reshape(K, -1)
    beta = np.concatenate([np.ones((*dt.shape, 1)), rate, force, force[..., _FIRST] * force[..., _SECOND]], axis=2)
    own_gyro, own_accel = _own(rate @ own.gyro.T), _own(force @ own.accel.T)
    squares = rate[..., _FIRST] * rate[..., _SECOND]
    crossed = -skew(_to_come(felt, lasts)) @ C
    V = np.einsum("kn,kni->ki", dt, felt)
    n, m = len(own.gyro), len(own.accel)
    time = passed.reshape(K, -1) - 0.5 * lasts.sum(axis=1)[:, None]
    growing = _sums(time * dt, C, beta), _sums(time * dt, crossed, beta[..., :_LINEAR])
    whole = Moments(
        C=rotation_matrix(vector),
        V=V,
        Phi=_sums(dt, C, beta),
        Psi=_sums(dt, crossed, beta[..., :_LINEAR]),
        W=_sums(dt, C, squares),
        sweep=_sums(dt, C @ skew(rate), force),
        Phi_gyro=_sums(dt, C, own_gyro).reshape(K, 3, 3, 2, n),
        Psi_gyro=_sums(dt, crossed, own_gyro).reshape(K, 3, 3, 2, n),
        Phi_accel=_sums(dt, C, own_accel).reshape(K, 3, 3, 2, m),
        body=np.einsum("kn,knb->kb", dt, beta).reshape(K, REGRESSORS),
        body_rates=np.einsum("kn,knb->kb", dt, squares),
        body_gyro=np.einsum("kn,knb->kb", dt, own_gyro).reshape(K, 2, n),
        jumps=np.zeros(K),
    )
    return whole, growing


def _to_come(felt: Array, lasts: Array) -> Array:
    """Velocities V(T) − V(t) (K, n, 3) at the nodes, m/s, of specific forces (K, n, 3) there in the body at the start;
    the pieces of each turn last `lasts` (K, p) s."""
    _, weights, to_end = _gauss()
    by_piece = felt.reshape(*lasts.shape, NODES, 3)
    within = lasts[:, :, None, None] * np.einsum("nm,kpmi->kpni", to_end, by_piece)
    pieces = lasts[:, :, None] * np.einsum("n,kpni->kpi", weights, by_piece)
    after = np.cumsum(pieces[:, ::-1], axis=1)[:, ::-1] - pieces
    return np.asarray((within + after[:, :, None]).reshape(felt.shape))


def _own(along: Array) -> Array:
    """|u|, then u³ (K, n, 2 m) of components u (K, n, m)."""
    return np.concatenate([np.abs(along), along**3], axis=2)


def _sums(dt: Array, matrices: Array, functions: Array) -> Array:
    """∫ M_ij β_b dt (K, 3, 3, R) of matrices (K, n, 3, 3) and functions (K, n, R) at the nodes."""
    flat = (matrices * dt[:, :, None, None]).reshape(*dt.shape, 9)
    return np.asarray((flat.swapaxes(1, 2) @ functions).reshape(len(dt), 3, 3, -1))
