"""Plain twin of `tumble.reduction.turns.moments.integrate`: one sample after another, the equations as printed."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from scipy.spatial.transform import Rotation

from tumble.reduction.turns.moments import (
    NO_OWN_AXES,
    BlockCompensation,
    Compensation,
    Moments,
    OwnAxes,
    Pieces,
)
from tumble.units import Array

PAIRS = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]


def moments_of(pieces: Pieces, compensation: Compensation, own: OwnAxes = NO_OWN_AXES) -> Moments:
    """Moments of every piece."""
    each = [
        _moments(pieces, int(start), int(stop), compensation, own)
        for start, stop in zip(pieces.start, pieces.stop, strict=True)
    ]
    return Moments(**{f.name: np.array([piece[f.name] for piece in each]) for f in fields(Moments)})


def _moments(
    pieces: Pieces, start: int, stop: int, compensation: Compensation, own: OwnAxes
) -> dict[str, Array | float]:
    n, m = len(own.gyro), len(own.accel)
    C, V, P = Rotation.identity(), np.zeros(3), np.zeros(3)
    Phi, Psi, W, sweep = np.zeros((3, 3, 13)), np.zeros((3, 3, 7)), np.zeros((3, 3, 6)), np.zeros((3, 3, 3))
    Phi_gyro, Psi_gyro, Phi_accel = np.zeros((3, 3, 2, n)), np.zeros((3, 3, 2, n)), np.zeros((3, 3, 2, m))
    body, body_rates, body_gyro = np.zeros(13), np.zeros(6), np.zeros((2, n))
    jumps = 0.0
    for k in range(start, stop):
        before, dt = max(k - 1, 0), pieces.intervals[k]
        omega, f = compensated(pieces, k, compensation)
        omega_before, f_before = compensated(pieces, before, compensation)
        dt_before = pieces.intervals[before] if k > 0 else 0.0
        angle, velocity = omega * dt, f * dt
        angle_before, velocity_before = omega_before * dt_before, f_before * dt_before
        phi = angle + np.cross(angle_before, angle) / 12
        middle = (C * Rotation.from_rotvec(phi / 2)).as_matrix()
        step = middle @ (
            velocity
            + np.cross(phi, np.cross(phi, velocity)) / 24
            + (np.cross(angle_before, velocity) + np.cross(velocity_before, angle)) / 12
        )
        beta = np.array([1.0, *omega, *f, *(f[a] * f[b] for a, b in PAIRS)])
        rates = np.array([omega[a] * omega[b] for a, b in PAIRS])
        own_gyro = np.array([np.abs(own.gyro @ omega), (own.gyro @ omega) ** 3])
        own_accel = np.array([np.abs(own.accel @ f), (own.accel @ f) ** 3])
        increment = np.multiply.outer(middle, beta) * dt
        own_increment = np.multiply.outer(middle, own_gyro) * dt
        Psi += np.cross(Phi[..., :7] + increment[..., :7] / 2, step[:, None, None], axis=0)
        Psi_gyro += np.cross(Phi_gyro + own_increment / 2, step[:, None, None], axis=0)
        Phi += increment
        Phi_gyro += own_increment
        Phi_accel += np.multiply.outer(middle, own_accel) * dt
        W += np.multiply.outer(middle, rates) * dt
        sweep += np.multiply.outer(middle @ np.cross(omega, np.eye(3)).T, f) * dt
        body, body_rates = body + beta * dt, body_rates + rates * dt
        body_gyro = body_gyro + own_gyro * dt
        jumps += dt**2 * np.sum((f - f_before) ** 2)
        C, V, P = C * Rotation.from_rotvec(phi), V + step, P + dt * (V + step / 2)
    return {
        "C": C.as_matrix(),
        "V": V,
        "P": P,
        "Phi": Phi,
        "Psi": Psi,
        "W": W,
        "sweep": sweep,
        "Phi_gyro": Phi_gyro,
        "Psi_gyro": Psi_gyro,
        "Phi_accel": Phi_accel,
        "body": body,
        "body_rates": body_rates,
        "body_gyro": body_gyro,
        "jumps": jumps,
    }


def compensated(pieces: Pieces, k: int, compensation: Compensation) -> tuple[Array, Array]:
    """Rate and specific force of sample k, in the order of A1."""
    accel, delay = compensation.accel, compensation.delay
    f = _force(pieces, k, accel)
    omega = _rate(pieces, k, compensation, f)
    if k > 0:
        before = _rate(pieces, k - 1, compensation, _force(pieces, k - 1, accel))
        rate_of_change = (omega - before) / ((pieces.intervals[k] + pieces.intervals[k - 1]) / 2)
        omega = omega - delay / 2 * rate_of_change
    f = f - delay * np.cross(omega, f) + delay**2 / 2 * np.cross(omega, np.cross(omega, f))
    return _rate(pieces, k, compensation, f), f


def _force(pieces: Pieces, k: int, accel: BlockCompensation) -> Array:
    return _solved(accel, accel.matrix @ (pieces.forces[k] - accel.bias))


def _rate(pieces: Pieces, k: int, compensation: Compensation, f: Array) -> Array:
    gyro = compensation.gyro
    return _solved(gyro, gyro.matrix @ (pieces.rates[k] - gyro.bias - compensation.g_sensitivity @ f))


def _solved(block: BlockCompensation, linear: Array) -> Array:
    """Two fixed-point steps of x + s (K₂ u² + K₃ u³ + κ |u|) = linear, u = a x."""
    square, cube, asymmetry = block.terms.T
    x = linear
    for _ in range(2):
        u = block.axes @ x
        x = linear - block.left_inverse @ (square * u**2 + cube * u**3 + asymmetry * np.abs(u))
    return x
