"""Links: motion from node to node, where a device does not lie still.

A node is an instant. What neighbouring nodes have in common are rotation C, velocity V and, beyond what a turn between
rests has, place: the increments of the samples between them, in the body at the first node,

    C = Π C_p,   V = Σ R V_p,   P = Σ (V_before T_p + R P_p),   R the rotation of what is before part p.

Each link is integrated in PARTS, whose sensitivities are those of short turns (`tumble.reduction.turns.moments`), and
put together: with [φ | V | P] the first-order change of a link, and those of a part with index p,

    φ ← φ + R φ_p,   δV ← δV + φ × R V_p + R δV_p,   δP ← δP + T_p δV + φ × R P_p + R δP_p,

δV on the right being that before the part. Within a part what an accelerometer's error adds to the velocity grows with
time, what a rotation adds, ½ φ_p × V_p in all, with its square, so that δP_p = T_p (½ δV_p − φ_p × V_p/12), to ω T_p/6 of itself. White noise
of the samples, of density N_g and N_a, follows the same recursion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tumble.rotation import rotation_matrix, skew
from tumble.units import Array

PARTS = 4
"""Parts of a link in which its sensitivities are integrated."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Increments:
    """Increments of K links: rotation `C` (K, 3, 3), body at the end → body at the start, velocity `V` (K, 3), m/s,
    and place `P` (K, 3), m, and `columns` (K, 9, m): what m quantities change in rotation, velocity and place, to first
    order, by the columns of the parts."""

    C: Array
    V: Array
    P: Array
    columns: Array


def joined_parts(rows: Array, C: Array, V: Array, P: Array, T: Array) -> Increments:
    """Put the parts of links together.

    Parameters
    ----------
    rows : (K, PARTS, 6, m + 1)
        Of every part what m quantities change in rotation and velocity, and in the last column both as they are about
        what the part was integrated with: a small rotation vector, and the velocity, m/s.
    C, V, P, T : (K, PARTS, 3, 3), (K, PARTS, 3), (K, PARTS, 3), (K, PARTS)
        Rotation, velocity (m/s), place (m) and duration (s) of the parts, as integrated.

    Returns
    -------
    Increments
    """
    K, parts, m = len(rows), rows.shape[1], rows.shape[3] - 1
    R, velocity, place = np.broadcast_to(np.eye(3), (K, 3, 3)), np.zeros((K, 3)), np.zeros((K, 3))
    columns = np.zeros((K, 9, m))
    by_rotation, by_velocity, by_place = columns[:, :3], columns[:, 3:6], columns[:, 6:]
    for p in range(parts):
        t = T[:, p, None]
        moved = rows[:, p, 3:, -1]
        gained = (R @ moved[..., None])[..., 0]
        turned = rows[:, p, :3, -1]
        own = P[:, p] + t * (0.5 * (moved - V[:, p]) - np.cross(turned, V[:, p]) / 12.0)
        passed = (R @ own[..., None])[..., 0]
        of_rotation, of_velocity = R @ rows[:, p, :3, :-1], R @ rows[:, p, 3:, :-1]
        of_place = 0.5 * of_velocity + skew(gained) @ of_rotation / 12.0
        by_place += t[..., None] * (by_velocity + of_place) - skew(passed) @ by_rotation
        by_velocity += of_velocity - skew(gained) @ by_rotation
        by_rotation += of_rotation
        place = place + t * velocity + passed
        velocity = velocity + gained
        R = R @ rotation_matrix(turned) @ C[:, p]
    return Increments(C=R, V=velocity, P=place, columns=columns)


def noise_of_links(C: Array, V: Array, P: Array, T: Array, N_g: Array, N_a: Array) -> tuple[Array, Array]:
    """Covariances (K, 9, 9) of rotation, velocity and place of links from white noise of gyros and of accelerometers.

    Parameters
    ----------
    C, V, P, T : (K, PARTS, …)
        As in `joined_parts`.
    N_g, N_a : (3, 3)
        Densities in the body, rad²/s and m²/s³.
    """
    K, parts = T.shape
    R, by_gyros, by_accels = np.broadcast_to(np.eye(3), (K, 3, 3)), np.zeros((K, 9, 9)), np.zeros((K, 9, 9))
    for p in range(parts):
        t = T[:, p, None, None]
        F = np.broadcast_to(np.eye(9), (K, 9, 9)).copy()
        F[:, 3:6, :3] = -skew((R @ V[:, p, :, None])[..., 0])
        F[:, 6:, :3] = -skew((R @ P[:, p, :, None])[..., 0])
        F[:, 6:, 3:6] = t * np.eye(3)
        # a rotation that arises evenly over the part has half of its effect on what the part gains, and a third
        G = np.concatenate([R, 0.5 * F[:, 3:6, :3] @ R, F[:, 6:, :3] @ R / 3.0], axis=1)
        by_gyros = F @ by_gyros @ np.swapaxes(F, 1, 2) + t * G @ N_g @ np.swapaxes(G, 1, 2)
        by_accels = F @ by_accels @ np.swapaxes(F, 1, 2)
        density = R @ N_a @ np.swapaxes(R, 1, 2)
        by_accels[:, 3:6, 3:6] += t * density
        by_accels[:, 3:6, 6:] += 0.5 * t**2 * density
        by_accels[:, 6:, 3:6] += 0.5 * t**2 * density
        by_accels[:, 6:, 6:] += t**3 / 3.0 * density
        R = R @ C[:, p]
    return by_gyros, by_accels
