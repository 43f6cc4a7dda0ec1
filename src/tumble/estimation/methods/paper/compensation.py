"""Sensor models of triads along the body axes, for any number of launches at once, and how they compose.

Here the arrays of a `SensorModel` may have leading axes: matrix (..., 3, 3), bias (..., 3). A pass of the method
estimates the errors left in readings that the passes before have compensated, so that models compose: if
reading = S₁ x + b₁ and the compensated x = S₂ w + b₂, then reading = S₁ S₂ w + (S₁ b₂ + b₁). The product is exact,
and stays in the frame of the accelerometers: with γ_xy = γ_xz = γ_yz = 0 matrices are lower triangular.
"""

from __future__ import annotations

import numpy as np

from tumble.rotation import axes_angles, axes_matrix
from tumble.sensors.model import SensorModel
from tumble.units import Array

ACCEL_ANGLES = (2, 4, 5)
"""Which of the six angles xy, xz, yx, yz, zx, zy the accelerometers have: yx, zx, zy."""


def triad_model(bias: Array, scale: Array, angles: Array) -> SensorModel:
    """S = diag(1 + k) A(γ), Eq. (1), and the bias, of values (..., 3), (..., 3) and (..., 6) or, for accelerometers,
    (..., 3). The matrix is not linearised, as it is in the paper's error budget."""
    if angles.shape[-1] == len(ACCEL_ANGLES):
        six = np.zeros((*angles.shape[:-1], 6))
        six[..., ACCEL_ANGLES] = angles
        angles = six
    axes = np.moveaxis(axes_matrix(*np.moveaxis(angles, -1, 0)), (0, 1), (-2, -1))
    return SensorModel(matrix=(1.0 + scale)[..., None] * axes, bias=np.asarray(bias, dtype=float))


def triad_parameters(model: SensorModel) -> tuple[Array, Array, Array]:
    """Biases (..., 3), scale-factor errors (..., 3) and the six angles (..., 6) of a model: `triad_model` inverted."""
    norms = np.linalg.norm(model.matrix, axis=-1)
    axes = np.moveaxis(model.matrix / norms[..., None], (-2, -1), (0, 1))
    return model.bias, norms - 1.0, np.moveaxis(axes_angles(axes), 0, -1)


def perfect() -> SensorModel:
    """The model of sensors without errors."""
    return SensorModel(matrix=np.eye(3), bias=np.zeros(3))


def compensated(model: SensorModel, readings: Array) -> Array:
    """True vectors (..., N, 3) of readings (..., N, 3): S⁻¹ (ŵ − b)."""
    columns = np.swapaxes(readings - model.bias[..., None, :], -1, -2)
    return np.asarray(np.swapaxes(np.linalg.solve(model.matrix, columns), -1, -2))


def composed(outer: SensorModel, inner: SensorModel) -> SensorModel:
    """The model of the readings, when `inner` is the model of readings compensated by `outer`."""
    bias = (outer.matrix @ inner.bias[..., None])[..., 0] + outer.bias
    return SensorModel(matrix=outer.matrix @ inner.matrix, bias=bias)


def remaining(model: SensorModel, about: SensorModel) -> tuple[Array, Array]:
    """E (..., 3, 3) and δ (..., 3) of `model` about another: rates compensated by `about` are (I + E) ω + δ."""
    E = np.linalg.solve(about.matrix, model.matrix) - np.eye(3)
    δ = np.linalg.solve(about.matrix, (model.bias - about.bias)[..., None])[..., 0]
    return np.asarray(E), np.asarray(δ)
