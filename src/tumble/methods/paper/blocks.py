"""Models of blocks of sensors in a pass of the paper's methods, of many units at once.

A pass takes readings that the model before has compensated, y ↦ c, and leaves a model of these, which is then composed
with the one before. With D (n, 3) the nominal sensing axes, and K (n, 3) and b (n,) the model before,

    c = T (y − b),   T = 1 + (D − K) K⁺      so that T K = D                                                     (a)
    K ← T⁻¹ K',   b ← b + T⁻¹ b'             of a model K', b' of c                                              (b)

K⁺ is the left inverse. For three sensors T = D K⁻¹; more than three keep what no vector in the body explains, which
tells their errors apart. In a block of other than three sensors along the body axes, the sensing axes are the nominal
ones turned by a rotation vector that is linear in the axis angles (`tumble.sensors.model`).
"""

from __future__ import annotations

import numpy as np

from tumble.rotation import left_inverse, rotation_matrix
from tumble.sensors.model import ACCEL_ANGLES, Block, SensorModel, triad_model, triad_parameters
from tumble.units import Array

TRIAD = Block(kind="accel", axes=np.eye(3))
"""Three accelerometers along the body axes."""


def to_sensors(block: Block) -> Array:
    """Matrix (n, n) by which readings (..., n) are multiplied: those of a triad become readings along X, Y, Z."""
    return np.asarray(block.axes, dtype=float) if block.triad else np.eye(block.size)


def sensing_axes(block: Block) -> Array:
    """Nominal sensing axes (n, 3) of the readings that a pass takes."""
    return np.eye(3) if block.triad else np.asarray(block.axes, dtype=float)


def compensated(model: SensorModel, readings: Array, axes: Array) -> Array:
    """Readings (..., N, n) as perfect sensors along `axes` (n, 3) would have them by a model, formula (a)."""
    return np.asarray((readings - _row(model.bias)) @ np.swapaxes(_compensation(model, axes), -1, -2))


def composed(model: SensorModel, inner: SensorModel, axes: Array) -> SensorModel:
    """The model of the readings where `inner` is that of the compensated ones, formula (b) of the module."""
    T = _compensation(model, axes)
    bias = model.bias + np.linalg.solve(T, inner.bias[..., None])[..., 0]
    return SensorModel(matrix=np.asarray(np.linalg.solve(T, inner.matrix), dtype=float), bias=bias)


def _compensation(model: SensorModel, axes: Array) -> Array:
    """T (..., n, n) of formula (a)."""
    return np.asarray(np.eye(len(axes)) + (axes - model.matrix) @ model.inverse())


def _row(bias: Array) -> Array:
    return bias if bias.ndim == 1 else bias[..., None, :]


def model_of(block: Block, values: Array) -> SensorModel:
    """Model of the readings that a pass takes, of parameters (..., m) in the order of `block.names`."""
    n = block.size
    bias, scale, angles = np.split(values, [n, 2 * n], axis=-1)
    if block.triad:
        return triad_model(block.axes.sum(axis=0) * bias, scale, angles)
    return SensorModel(matrix=(1.0 + scale)[..., None] * turned_axes(block, angles), bias=bias)


def parameters_of(block: Block, model: SensorModel) -> Array:
    """Parameters (..., m) of a model: `model_of` inverted."""
    if block.triad:
        bias, scale, angles = triad_parameters(model)
        angles = angles if block.kind == "gyro" else angles[..., ACCEL_ANGLES]
        return np.concatenate([block.axes.sum(axis=0) * bias, scale, angles], axis=-1)
    gain = np.linalg.norm(model.matrix, axis=-1)
    across = np.cross(block.axes, model.matrix / gain[..., None])
    sine = np.linalg.norm(across, axis=-1, keepdims=True)
    angle = np.arcsin(np.minimum(sine, 1.0)) / np.where(sine > 0.0, sine, 1.0)
    angles = np.einsum("...pk,pkj->...j", np.where(sine > 0.0, angle, 1.0) * across, turning(block))
    return np.concatenate([model.bias, gain - 1.0, angles], axis=-1)


def turned_axes(block: Block, angles: Array) -> Array:
    """Sensing axes (..., n, 3) of a block with numbered sensors, of its axis angles (..., a)."""
    vectors = np.einsum("...j,pkj->...pk", angles, turning(block))
    return np.asarray((rotation_matrix(vectors) @ block.axes[..., None])[..., 0])


def turning(block: Block) -> Array:
    """Rotation vectors (n, 3, a) of the sensing axes per unit of each axis angle."""
    moved = block.jacobian(np.zeros(len(block.names)))[:, :3, 2 * block.size :]
    return np.cross(block.axes[:, :, None], moved, axis=1)


def in_body(axes: Array, readings: Array) -> Array:
    """Vectors (..., 3) in the body of readings (..., n) along sensing axes (n, 3)."""
    return np.asarray(readings @ left_inverse(axes).T)
