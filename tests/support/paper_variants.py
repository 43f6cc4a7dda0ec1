"""Variants of the paper's methods that published figures are checked with, and that no command uses: the indirect
method with the logged Jacobian (§6.6 of the turntable method), and gyro biases from two positions and from the dot
product."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tumble.methods.least_squares import solve_least_squares
from tumble.methods.paper.gyros import (
    _LEVEL,
    Series,
    carried,
)
from tumble.reduction.turns.turns import Turns
from tumble.rotation import rotation_matrix, unit_vector
from tumble.units import Array

_GYRO_ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))
_ACCEL_ENTRIES = ((0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1))
"""Where the columns are in the error matrices E and M."""
_TILT = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def gyro_errors(rate: Array) -> Array:
    """Columns E ω (..., 3, 9) of the error of a rate ω (..., 3) in the body."""
    return _entries(rate, _GYRO_ENTRIES)


def accelerometer_errors(u: Array) -> Array:
    """Columns b + M u (..., 3, 9) of the error of the specific force, in g, with the vertical u (..., 3) in the
    body."""
    bias = np.broadcast_to(np.eye(3), (*u.shape[:-1], 3, 3))
    return np.concatenate([bias, _entries(u, _ACCEL_ENTRIES)], axis=-1)


def _entries(vector: Array, entries: Sequence[tuple[int, int]]) -> Array:
    columns = np.zeros((*vector.shape[:-1], 3, len(entries)))
    for j, (p, q) in enumerate(entries):
        columns[..., p, j] = vector[..., q]
    return columns


def logged_jacobian(
    course: Sequence[Series], attitude: Array, force: Array, rate: Array, turns: Turns, earth_rate: Array
) -> Array:
    """Derivatives (..., 2T, 21) of y with respect to b (rad), k, γ of the accelerometers and δω, k, γ of the gyros,
    from the logged rate, §6.6: the sensitivities M and B of the turns as they were, with what the errors do to
    the start of the series by TRIAD. `turns` may have leading axes before the turns.

    It uses measured quantities, so that one pass errs in second order of the sensor errors, whatever the table did."""
    rows = []
    u = unit_vector(force)
    accel = accelerometer_errors(u)
    for series in course:
        start = series[0].first
        L = [attitude[..., start, :, :]]
        for t in series:
            L.append(carried(L[-1], turns.C[..., t.turn, :, :], earth_rate, float(turns.duration[t.turn])))
        Ψ = _start_errors(L[0], accel[..., start, :, :], rate[..., start, :], earth_rate)
        for j, t in enumerate(series):
            turned = L[j] @ _turn_errors(turns, t.turn)
            Φ = rotation_matrix(-earth_rate * float(turns.duration[t.turn]))
            after = Φ @ (Ψ + turned)
            if t.counts:
                change = _TILT @ (after - Ψ)
                change[..., :9] += _LEVEL @ (L[j + 1] @ accel[..., t.last, :, :] - L[j] @ accel[..., t.first, :, :])
                rows.append(change)
            Ψ = after
    return np.concatenate(rows, axis=-2)


def _start_errors(L: Array, accel: Array, rate: Array, earth_rate: Array) -> Array:
    """Ψ (..., 3, 21) of TRIAD: ψ_N = −α_E, ψ_E = α_N, ψ_U = (L δω)_E/Ω_N − α_E tan B."""
    Ω_N, Ω_U, _ = earth_rate
    bias = np.broadcast_to(np.eye(3), (*rate.shape[:-1], 3, 3))
    α = L @ accel
    ω = L @ np.concatenate([bias, gyro_errors(rate)], axis=-1)
    by_accel = np.stack([-α[..., 2, :], -α[..., 2, :] * Ω_U / Ω_N, α[..., 0, :]], axis=-2)
    by_gyro = np.stack([np.zeros_like(ω[..., 2, :]), ω[..., 2, :] / Ω_N, np.zeros_like(ω[..., 2, :])], axis=-2)
    return np.concatenate([by_accel, by_gyro], axis=-1)


def _turn_errors(turns: Turns, k: int) -> Array:
    """∫ C (E ω + δω) dt (..., 3, 21) in the body at the start of turn k: none from the accelerometers, then B for the
    bias, then columns of M."""
    B, M = turns.B[..., k, :, :], turns.M[..., k, :, :, :]
    by_matrix = np.stack([M[..., :, p, q] for p, q in _GYRO_ENTRIES], axis=-1)
    return np.concatenate([np.zeros_like(by_matrix), B, by_matrix], axis=-1)


def two_position_bias(rates: Array, forces: Array, earth_rate: Array) -> Array:
    """Bias (..., 3) by two-position gyrocompassing: half the sum of the rates (..., 2, 3) before and after a turn by
    exactly 180° about the vertical, less Ω sin B times the levelled vertical. It holds for the horizontal gyros; a
    turn by 180° + Δ leaves them ±½ Ω cos B Δ, which on a rough table is as large as the bias."""
    return np.asarray(rates.mean(axis=-2) - earth_rate[1] * unit_vector(forces).mean(axis=-2))


def invariant_bias(rate: Array, force: Array, earth_rate: Array) -> Array:
    """Bias (..., 3) from the dot-product invariant û·ω̂ − Ω sin B = û·δω by least squares: linear in the bias, and
    without an azimuth. Not in the paper, where the scalar method has to take its place."""
    u = unit_vector(force)
    return solve_least_squares(u, (u * rate).sum(axis=-1) - earth_rate[1])
