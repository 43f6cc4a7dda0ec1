"""The linear sensor model: `reading = matrix @ true + bias`, matrix (n, 3).

For a triad along the body axes matrix = diag(1 + k) A(γ) with the exact axes matrix of Eq. (1). In a block with other
nominal axes, or more than three sensors, each sensor has a bias, a scale-factor error and rotations of its nominal axis
about two perpendiculars.

The accelerometers define the body frame: accelerometer 0 keeps its nominal direction, accelerometer 1 stays in the
nominal plane of 0 and 1. So a triad has three accelerometer angles (yx, zx, zy) and six gyro angles; a block of n has
2n − 3 and 2n.

Numbered sensors: the nominal axis d of sensor p is rotated by the rotation vector θ₁t₁ + θ₂t₂, where t₁ ∥ r × d,
t₂ = d × t₁, and r is the nominal axis of sensor 0 (for sensor 0 itself, and for sensors parallel to it, the body axis
with the smallest component in d). `accel.axis.3.1` is θ₁ of accelerometer 3.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from tumble.arguments import array_of
from tumble.errors import InputError
from tumble.rotation import axes_angles, axes_matrix, left_inverse, tangent_basis
from tumble.units import Array, IntArray

SensorKind = Literal["accel", "gyro", "mag"]
UNITS: Mapping[SensorKind, str] = {"accel": "m/s^2", "gyro": "rad/s"}
WORDS: Mapping[str, str] = {"accel": "accelerometers", "gyro": "gyros", "mag": "magnetometer"}

_ANGLE_PAIRS = ("xy", "xz", "yx", "yz", "zx", "zy")
_FREE_PAIRS: dict[SensorKind, tuple[str, ...]] = {
    "accel": ("yx", "zx", "zy"),
    "gyro": _ANGLE_PAIRS,
    "mag": _ANGLE_PAIRS,
}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SensorModel:
    """`reading = matrix @ true + bias` of one block: matrix (..., n, 3), bias (..., n) in m/s² or rad/s.

    Leading axes are units, each of which has N readings and true vectors (..., N, ·)."""

    matrix: Array
    bias: Array

    def inverse(self) -> Array:
        """Return the matrix (..., 3, n) from reading − bias to the true vector (least squares for n > 3)."""
        return left_inverse(self.matrix)

    def apply(self, readings: Array) -> Array:
        """Return true vectors (..., 3) from readings (..., n), both in SI and in the body frame."""
        readings = array_of("readings", readings)
        if readings.shape[-1:] != self.bias.shape[-1:]:
            raise InputError(f"readings: expected the shape (..., {self.bias.shape[-1]}), found {readings.shape}")
        return np.asarray((readings - self._offset) @ np.swapaxes(self.inverse(), -1, -2))

    def predict(self, true: Array) -> Array:
        """Return readings (..., n) of true vectors (..., 3)."""
        return np.asarray(true @ np.swapaxes(self.matrix, -1, -2) + self._offset)

    def composed(self, inner: SensorModel) -> SensorModel:
        """Return the model of the readings if `inner` is the model of the vectors that `apply` returns: S₁ (S₂ x + b₂)
        + b₁. It is exact, and keeps the accelerometer frame, since products of lower triangular matrices are lower
        triangular."""
        bias = (self.matrix @ inner.bias[..., None])[..., 0] + self.bias
        return SensorModel(matrix=self.matrix @ inner.matrix, bias=bias)

    @property
    def _offset(self) -> Array:
        return self.bias if self.bias.ndim == 1 else self.bias[..., None, :]


PERFECT_TRIAD = SensorModel(matrix=np.eye(3), bias=np.zeros(3))
ACCEL_ANGLES = (2, 4, 5)  # those of the six angles that the accelerometers of a triad have: yx, zx, zy


def triad_model(bias: Array, scale: Array, angles: Array) -> SensorModel:
    """Return S = diag(1 + k) A(γ), Eq. (1), and the bias of sensors along the body axes, from values (..., 3), (..., 3)
    and (..., 6) or, for accelerometers, (..., 3)."""
    if angles.shape[-1] == len(ACCEL_ANGLES):
        six = np.zeros((*angles.shape[:-1], 6))
        six[..., ACCEL_ANGLES] = angles
        angles = six
    axes = np.moveaxis(axes_matrix(*np.moveaxis(angles, -1, 0)), (0, 1), (-2, -1))
    return SensorModel(matrix=(1.0 + scale)[..., None] * axes, bias=np.asarray(bias, dtype=float))


def triad_parameters(model: SensorModel) -> tuple[Array, Array, Array]:
    """Return biases (..., 3), scale-factor errors (..., 3) and six angles (..., 6) of a model: inverse of
    `triad_model`."""
    norms = np.linalg.norm(model.matrix, axis=-1)
    axes = np.moveaxis(model.matrix / norms[..., None], (-2, -1), (0, 1))
    return model.bias, norms - 1.0, np.moveaxis(axes_angles(axes), 0, -1)


def thermometers_of(count: int, accel: int, gyro: int) -> tuple[int, ...] | None:
    """Return the thermometer of each accelerometer and gyro: one for all, two for accelerometers and gyros, or one
    each, accelerometers first. None for another number of thermometers."""
    if count == accel + gyro:
        return tuple(range(count))
    if count == 1 or (count == 2 and gyro):
        return accel * (0,) + gyro * (count - 1,)
    return None


@dataclass(frozen=True, kw_only=True, eq=False)
class Block:
    """n sensors of one kind with nominal sensing directions `axes` (n, 3) in the body frame.

    Parameter vectors of a block are in the order of `names`. `thermometers`: numbers of those of the channels; empty if
    all have the first."""

    kind: SensorKind
    axes: Array
    thermometers: tuple[int, ...] = ()

    @cached_property
    def size(self) -> int:
        """Number of sensors."""
        return len(self.axes)

    @cached_property
    def triad(self) -> bool:
        """Whether the sensors are three, each along a body axis (in any order and with either sign)."""
        sizes = np.sort(np.abs(self.axes), axis=1)
        return np.array_equal(sizes, [[0, 0, 1]] * 3) and bool(abs(np.linalg.det(self.axes)) > 0.5)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Parameter names as in the calibration file: biases, scale-factor errors, axis angles."""
        per_sensor = (f"{what}.{sensor}" for what in ("bias", "scale") for sensor in self.sensors)
        return tuple(f"{self.kind}.{part}" for part in (*per_sensor, *(f"axis.{angle}" for angle in self.angles)))

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors in names of parameters: x, y, z for a triad, else 0, 1, …"""
        return ("x", "y", "z") if self.triad else tuple(str(p) for p in range(self.size))

    @cached_property
    def angles(self) -> tuple[str, ...]:
        """Names of the axis angles in names of parameters."""
        return _FREE_PAIRS[self.kind] if self.triad else tuple(f"{p}.{1 + j}" for p, j in self._free)

    @cached_property
    def _free(self) -> list[tuple[int, int]]:
        """Sensor of every axis angle, in the order of `sensors`, and which of its two angles it is, 0 or 1."""
        if self.triad:
            return [divmod(_ANGLE_PAIRS.index(pair), 2) for pair in self.angles]
        pairs = [(p, j) for p in range(self.size) for j in (0, 1)]
        return pairs if self.kind == "gyro" else [(1, 0), *pairs[4:]]

    @cached_property
    def channels(self) -> IntArray:
        """Channel of each sensor (n,) in the order of `sensors`: for a triad, the one that senses body axis 0, 1, 2."""
        return np.argmax(np.abs(self.axes), axis=0) if self.triad else np.arange(self.size)

    @cached_property
    def thermometer(self) -> IntArray:
        """Thermometer of each channel (n,)."""
        return np.array(self.thermometers or self.size * (0,), dtype=np.int64)

    def nominal(self) -> SensorModel:
        """Return the model of perfect sensors."""
        return SensorModel(matrix=self.axes.copy(), bias=np.zeros(self.size))

    def model(self, values: Array) -> SensorModel:
        """Return the sensor model of parameter values in the order of `names`."""
        matrix_and_bias = self.linearised(values)[0]
        return SensorModel(matrix=matrix_and_bias[:, :3].copy(), bias=matrix_and_bias[:, 3].copy())

    def parameters(self, model: SensorModel) -> Array:
        """Return the parameter values of a sensor model in this block's frame: inverse of `model`."""
        norms = np.linalg.norm(model.matrix, axis=1)[self.channels]
        directions = model.matrix[self.channels] / norms[:, None]
        return np.concatenate([model.bias[self.channels], norms - 1.0, self._angles_of(directions)])

    def jacobian(self, values: Array) -> Array:
        """Return the derivative (n, 4, m) of the matrix (n, 3) and, as fourth column, of the bias by the parameters, so
        that d(reading) = jacobian · dθ applied to (true, 1); read-only."""
        return self.linearised(values)[1]

    def linearised(self, values: Array) -> tuple[Array, Array]:
        """Return [matrix | bias] (n, 4) of parameter values, and its `jacobian`; read-only."""
        return _linearised(self, np.asarray(values, dtype=float).tobytes())

    def _rotated(self, angles: Array) -> Array:
        """Return unit sensing axes (n, 3), in the order of `sensors`, for values of the free angles, real or
        complex."""
        both = np.zeros((self.size, 2), dtype=angles.dtype)
        for value, (sensor, which) in zip(angles, self._free, strict=True):
            both[sensor, which] = value
        if self.triad:
            return np.asarray(self._signs[:, None] * axes_matrix(*both.ravel()))
        t = self._perpendiculars
        square = (both**2).sum(axis=1)[:, None]
        angle = np.sqrt(np.where(square == 0, 1.0, square))
        cosine = np.where(square == 0, 1.0, np.cos(angle))
        ratio = np.where(square == 0, 1.0, np.sin(angle) / angle)
        across = both[:, :1] * np.cross(t[:, 0], self.axes) + both[:, 1:] * np.cross(t[:, 1], self.axes)
        return np.asarray(cosine * self.axes + ratio * across)

    def _angles_of(self, directions: Array) -> Array:
        """Return the free angles of unit sensing axes (n, 3): inverse of `_rotated`."""
        if self.triad:
            both = axes_angles(self._signs[:, None] * directions).reshape(3, 2)
        else:
            sine = np.cross(self.axes, directions)
            angle = np.arctan2(np.linalg.norm(sine, axis=1), (self.axes * directions).sum(axis=1))
            ratio = np.where(angle == 0.0, 1.0, angle / np.where(angle == 0.0, 1.0, np.sin(angle)))
            both = ratio[:, None] * np.einsum("pk,pjk->pj", sine, self._perpendiculars)
        return np.array([both[p, j] for p, j in self._free])

    @cached_property
    def _perpendiculars(self) -> Array:
        """Unit vectors t₁ and t₂ (n, 2, 3) about which the nominal axes rotate."""
        out = np.empty((self.size, 2, 3))
        for p, d in enumerate(self.axes):
            r = self.axes[0]
            if np.linalg.norm(np.cross(r, d)) < 1e-3:  # parallel
                r = np.eye(3)[np.argmin(np.abs(d))]
            out[p, 0] = np.cross(r, d) / np.linalg.norm(np.cross(r, d))
            out[p, 1] = np.cross(d, out[p, 0])
        return out

    @property
    def _signs(self) -> Array:
        """Sign (3,) of the direction of each sensor of a triad, in the order of `sensors`."""
        return np.asarray(self.axes[self.channels].sum(axis=1), dtype=float)


@lru_cache(maxsize=64)
def _linearised(block: Block, values: bytes) -> tuple[Array, Array]:
    """Return `Block.linearised`, cached: an estimate evaluates it repeatedly at one point."""
    n, channels, sensor_index = block.size, block.channels, np.arange(block.size)
    parameters = np.frombuffer(values)
    bias, scale, angles = np.split(parameters, [n, 2 * n])
    gain, rotated = (1.0 + scale)[:, None], block._rotated(angles)
    model = np.empty((n, 4))
    model[channels, :3] = gain * rotated
    model[channels, 3] = bias
    jacobian = np.zeros((n, 4, len(parameters)))
    jacobian[channels, 3, sensor_index] = 1.0
    jacobian[channels, :3, n + sensor_index] = rotated
    for which in (0, 1):  # a complex step, exact to rounding; an angle affects only its own sensor
        members = [i for i, free in enumerate(block._free) if free[1] == which]
        stepped = angles.astype(complex)
        stepped[members] += 1e-20j
        change = gain * block._rotated(stepped).imag / 1e-20
        for i in members:
            sensor = block._free[i][0]
            jacobian[channels[sensor], :3, 2 * n + i] = change[sensor]
    model.flags.writeable = jacobian.flags.writeable = False
    return model, jacobian


def to_accelerometer_frame(
    block: Block, accel: SensorModel, gyro: SensorModel | None
) -> tuple[SensorModel, SensorModel | None]:
    """Return the same sensors in the frame that the accelerometers (`block`) define: accelerometer 0 along its nominal
    axis, accelerometer 1 in the nominal plane of 0 and 1; for a triad, X along the X accelerometer and Y in the plane
    of X and Y."""
    order = block.channels
    signs = block._signs if block.triad else np.ones(block.size)
    actual = _frame_of(signs[:, None] * accel.matrix[order])
    nominal = _frame_of(signs[:, None] * block.axes[order])
    rotation = actual.T @ nominal
    moved = SensorModel(matrix=accel.matrix @ rotation, bias=accel.bias)
    return moved, None if gyro is None else SensorModel(matrix=gyro.matrix @ rotation, bias=gyro.bias)


def _frame_of(axes: Array) -> Array:
    """Return right-handed orthonormal rows: along axes[0], perpendicular in the plane of axes[0] and axes[1],
    normal."""
    first = axes[0] / np.linalg.norm(axes[0])
    third = np.cross(axes[0], axes[1])
    third = third / np.linalg.norm(third)
    return np.array([first, np.cross(third, first), third])


def left_null_space(matrix: Array) -> Array:
    """Return orthonormal rows (n − 3, n): the combinations of readings, for a sensitivity matrix (n, 3), that no vector
    affects."""
    return np.asarray(np.linalg.qr(matrix, mode="complete")[0][:, 3:].T)


def tilt_null_space(matrix: Array, direction: Array) -> Array:
    """Return orthonormal columns (N, n, n − 2): the combinations of readings, for a sensitivity matrix (n, 3) or (N, n,
    3), that no small rotation of vectors along `direction` (N, 3) affects; zero without a direction."""
    if matrix.shape[-2] == 3:
        reading = np.swapaxes(direction[:, None] @ left_inverse(matrix), -1, -2)
        length = np.linalg.norm(reading, axis=-2, keepdims=True)
        return np.asarray(reading / np.where(length > 0.0, length, 1.0))
    by_tilt = matrix @ np.swapaxes(tangent_basis(direction), -1, -2)
    return np.asarray(np.linalg.qr(by_tilt, mode="complete")[0][..., 2:])
