"""Rotations as matrices: `mat_ab` takes coordinates in frame b to frame a.

Frames: b body X, Y, Z; n geographic N (north), U (up), E (east), right-handed in the order N, U, E.
"""

from __future__ import annotations

import numpy as np

from tumble.units import Array


def skew(vector: Array) -> Array:
    """[v×], shape (..., 3, 3): skew(v) @ w = v × w."""
    v = np.asarray(vector, dtype=float)
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 2, 1] = v[..., 0]
    out[..., 0, 2] = v[..., 1]
    out[..., 1, 0] = v[..., 2]
    return out - np.swapaxes(out, -1, -2)


def rotation_matrix(vector: Array) -> Array:
    """exp([v×]), shape (..., 3, 3), of a rotation vector in rad (Rodrigues), exact at zero."""
    v = np.asarray(vector, dtype=float)
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    K = skew(v)
    sine_ratio = np.sinc(angle / np.pi)  # sin a / a
    cosine_ratio = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2  # (1 - cos a) / a²
    return np.asarray(np.eye(3) + sine_ratio * K + cosine_ratio * (K @ K))


def axes_matrix(xy: float, xz: float, yx: float, yz: float, zx: float, zy: float) -> Array:
    """Directions of three nearly orthogonal sensing axes in the body frame as unit rows, Eq. (1).

    Each angle γ_pq (rad) is how far the axis of sensor p leans towards body axis q."""
    return np.array(
        [
            [np.cos(xy) * np.cos(xz), np.sin(xy), np.cos(xy) * np.sin(xz)],
            [np.cos(yz) * np.sin(yx), np.cos(yz) * np.cos(yx), np.sin(yz)],
            [np.sin(zx), np.cos(zx) * np.sin(zy), np.cos(zx) * np.cos(zy)],
        ]
    )


def axes_angles(axes: Array) -> Array:
    """The six angles (xy, xz, yx, yz, zx, zy), rad, of three sensing axes given as unit rows: Eq. (1) inverted."""
    a = axes
    return np.array(
        [
            np.arcsin(a[0, 1]),
            np.arctan2(a[0, 2], a[0, 0]),
            np.arctan2(a[1, 0], a[1, 1]),
            np.arcsin(a[1, 2]),
            np.arcsin(a[2, 0]),
            np.arctan2(a[2, 1], a[2, 2]),
        ]
    )


def tangent_basis(unit: Array) -> Array:
    """Two unit vectors orthogonal to each unit vector and to each other, shape (..., 2, 3)."""
    u = np.asarray(unit, dtype=float)
    helper = np.eye(3)[np.argmin(np.abs(u), axis=-1)]
    first = np.cross(u, helper)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(u, first)], axis=-2)
