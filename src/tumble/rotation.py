"""Rotations as matrices: `mat_ab` takes coordinates in frame b to frame a.

Frames: b body X, Y, Z; n geographic N (north), U (up), E (east), right-handed in the order N, U, E.
"""

from __future__ import annotations

import math
from itertools import permutations, product

import numpy as np

from tumble.units import Array

UP = np.array([0.0, 1.0, 0.0])
"""Unit vertical in geographic axes N, U, E."""


def unit_vector(vectors: Array) -> Array:
    """Return vectors (..., 3) divided by their lengths."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def onto_body(axes: Array) -> Array:
    """Return the matrix (3, n) that converts readings along n sensing axes (n, 3) to the vector, by least squares."""
    return left_inverse(np.asarray(axes, dtype=float))


def left_inverse(matrix: Array) -> Array:
    """Return the matrix (..., 3, n) that converts readings to the vector by least squares, from sensitivities (..., n,
    3).

    Raises LinAlgError if the sensitivities of a triad are in one plane."""
    square = matrix.shape[-2] == matrix.shape[-1]
    return np.asarray(np.linalg.inv(matrix) if square else np.linalg.pinv(matrix), dtype=float)


def skew(vector: Array) -> Array:
    """Return [v×], shape (..., 3, 3): skew(v) @ w = v × w."""
    v = np.asarray(vector, dtype=float)
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 2, 1] = v[..., 0]
    out[..., 0, 2] = v[..., 1]
    out[..., 1, 0] = v[..., 2]
    return out - np.swapaxes(out, -1, -2)


def rotation_matrix(vector: Array) -> Array:
    """Return exp([v×]), shape (..., 3, 3), of a rotation vector in rad (Rodrigues), exact at zero."""
    v = np.asarray(vector, dtype=float)
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    K = skew(v)
    sine_ratio = np.sinc(angle / np.pi)  # sin a / a
    cosine_ratio = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2  # (1 - cos a) / a²
    return np.asarray(np.eye(3) + sine_ratio * K + cosine_ratio * (K @ K))


def rotation_vector(matrix: Array) -> Array:
    """Return the rotation vectors (..., 3), rad, up to π, of rotation matrices (..., 3, 3).

    They are accurate everywhere, by way of the quaternion from the largest column of 4qqᵀ."""
    R = np.asarray(matrix, dtype=float)
    trace = np.trace(R, axis1=-2, axis2=-1)[..., None, None]
    vee = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    outer = np.empty((*R.shape[:-2], 4, 4))
    outer[..., 0, 0] = 1.0 + trace[..., 0, 0]
    outer[..., 0, 1:] = outer[..., 1:, 0] = vee
    outer[..., 1:, 1:] = R + np.swapaxes(R, -1, -2) + (1.0 - trace) * np.eye(3)
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    column = np.take_along_axis(outer, largest[..., None, None], axis=-2)[..., 0, :]
    q = column / np.linalg.norm(column, axis=-1, keepdims=True)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, np.abs(q[..., :1]))
    ratio = np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 2.0)
    return np.asarray(np.where(q[..., :1] >= 0.0, ratio, -ratio) * q[..., 1:])


def rotation_vector_near(matrix: Array, nominal: Array) -> Array:
    """Return the rotation vectors (..., 3), rad, up to 2π, that are nearest to nominal ones (..., 3)."""
    v = rotation_vector(matrix)
    angle = np.linalg.norm(v, axis=-1, keepdims=True)
    other = v * (1.0 - 2.0 * np.pi / np.where(angle > 0.0, angle, np.inf))
    nearer = np.linalg.norm(v - nominal, axis=-1) <= np.linalg.norm(other - nominal, axis=-1)
    return np.where(nearer[..., None], v, other)


def axes_matrix(xy: float, xz: float, yx: float, yz: float, zx: float, zy: float) -> Array:
    """Return three nearly orthogonal sensing axes in the body frame as unit rows, Eq. (1).

    The angle γ_pq (rad) is that by which the axis of sensor p leans towards body axis q. Angles of the shape (...) give
    (3, 3, ...)."""
    cos, sin = (math.cos, math.sin) if isinstance(xy, float) else (np.cos, np.sin)
    return np.array(
        [
            [cos(xy) * cos(xz), sin(xy), cos(xy) * sin(xz)],
            [cos(yz) * sin(yx), cos(yz) * cos(yx), sin(yz)],
            [sin(zx), cos(zx) * sin(zy), cos(zx) * cos(zy)],
        ]
    )


def axes_angles(axes: Array) -> Array:
    """Return the six angles (xy, xz, yx, yz, zx, zy), rad, of three sensing axes given as unit rows: Eq. (1)
    inverted."""
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
    """Return two unit vectors (..., 2, 3) orthogonal to each unit vector (..., 3) and to each other."""
    u = np.asarray(unit, dtype=float)
    across = skew(u)  # its columns are u × e_k
    first = np.take_along_axis(across, np.argmin(np.abs(u), axis=-1)[..., None, None], axis=-1)
    first /= np.linalg.norm(first, axis=-2, keepdims=True)
    return np.swapaxes(np.concatenate([first, across @ first], axis=-1), -1, -2)


def signed_permutations() -> Array:
    """Return all permutations of the axes with all signs (48, 3, 3)."""
    orders, signs = permutations(range(3)), list(product((1.0, -1.0), repeat=3))
    return np.array([np.array(sign)[:, None] * np.eye(3)[list(order)] for order in orders for sign in signs])
