"""Sensor models in a pass of the methods of the turntable paper, for many units at once.

A pass takes readings that the previous model has compensated, y ↦ c, and gives a model of these, which is composed with
the previous one. With the nominal sensing axes D (n, 3) and the previous model K (n, 3), b (n,),

    c = T (y − b),   T = 1 + (D − K) K⁺      so that T K = D                                                     (a)
    K ← T⁻¹ K',   b ← b + T⁻¹ b'             for the model K', b' of c                                           (b)

where K⁺ is the left inverse. For three sensors T = D K⁻¹. More than three keep the part of their readings that no
vector in the body explains, which separates their errors. In blocks other than three sensors along the body axes, the
sensing axes are the nominal ones rotated by vectors that are linear in the axis angles (`tumble.sensors.model`).
"""

from __future__ import annotations

import numpy as np

from tumble.rotation import left_inverse, rotation_matrix
from tumble.sensors.model import ACCEL_ANGLES, Block, SensorModel, triad_model, triad_parameters
from tumble.units import Array

TRIAD = Block(kind="accel", axes=np.eye(3))  # three accelerometers along the body axes


def to_sensors(block: Block) -> Array:
    """Return the matrix (n, n) that readings (..., n) are multiplied with; it takes those of a triad to X, Y, Z."""
    return np.asarray(block.axes, dtype=float) if block.triad else np.eye(block.size)


def sensing_axes(block: Block) -> Array:
    """Return the nominal sensing axes (n, 3) of the readings of a pass."""
    return np.eye(3) if block.triad else np.asarray(block.axes, dtype=float)


def compensate(model: SensorModel, readings: Array, axes: Array) -> Array:
    """Return readings (..., N, n) as of perfect sensors along `axes` (n, 3), (a)."""
    bias = model.bias if model.bias.ndim == 1 else model.bias[..., None, :]
    return np.asarray((readings - bias) @ np.swapaxes(_compensation(model, axes), -1, -2))


def compose(model: SensorModel, inner: SensorModel, axes: Array) -> SensorModel:
    """Return the model of readings whose compensated values have the model `inner`, (b)."""
    T = _compensation(model, axes)
    bias = model.bias + np.linalg.solve(T, inner.bias[..., None])[..., 0]
    return SensorModel(matrix=np.asarray(np.linalg.solve(T, inner.matrix), dtype=float), bias=bias)


def _compensation(model: SensorModel, axes: Array) -> Array:
    """Return T (..., n, n) of (a)."""
    return np.asarray(np.eye(len(axes)) + (axes - model.matrix) @ model.inverse())


def model_of(block: Block, values: Array) -> SensorModel:
    """Return the model of the readings of a pass for parameters (..., m) in the order of `block.names`."""
    n = block.size
    bias, scale, angles = np.split(values, [n, 2 * n], axis=-1)
    if block.triad:
        return triad_model(block.axes.sum(axis=0) * bias, scale, angles)
    return SensorModel(matrix=(1.0 + scale)[..., None] * turned_axes(block, angles), bias=bias)


def parameters_of(block: Block, model: SensorModel) -> Array:
    """Return the parameters (..., m) of a model, the inverse of `model_of`."""
    if block.triad:
        bias, scale, angles = triad_parameters(model)
        angles = angles if block.kind == "gyro" else angles[..., ACCEL_ANGLES]
        return np.concatenate([block.axes.sum(axis=0) * bias, scale, angles], axis=-1)
    units = zip(model.matrix.reshape(-1, block.size, 3), model.bias.reshape(-1, block.size), strict=True)
    values = [block.parameters(SensorModel(matrix=matrix, bias=bias)) for matrix, bias in units]
    return np.reshape(values, (*model.bias.shape[:-1], len(block.names)))


def turned_axes(block: Block, angles: Array) -> Array:
    """Return the sensing axes (..., n, 3) of a block that is no triad for axis angles (..., a)."""
    vectors = np.einsum("...j,pkj->...pk", angles, axis_rotations(block))
    return np.asarray((rotation_matrix(vectors) @ block.axes[..., None])[..., 0])


def axis_rotations(block: Block) -> Array:
    """Return the rotation vectors (n, 3, a) of the sensing axes per unit of each axis angle."""
    moved = block.jacobian(np.zeros(len(block.names)))[:, :3, 2 * block.size :]
    return np.cross(block.axes[:, :, None], moved, axis=1)


def in_body(axes: Array, readings: Array) -> Array:
    """Return vectors (..., 3) in the body from readings (..., n) along sensing axes (n, 3)."""
    return np.asarray(readings @ left_inverse(axes).T)
