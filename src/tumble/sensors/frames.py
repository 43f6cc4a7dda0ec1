"""Frames: one set of sensors in the frames of the accelerometers, the paper, the symmetric matrix and the case.

In every frame `reading = matrix @ true + bias`. A rotation of the frame changes only the matrix, and the same Q applies
to accelerometers and gyros, which stay in one common frame:

    M′ = M Q,   true′ = Qᵀ true

The definition of each frame, and the nine numbers of three accelerometers in it (rows and columns x, y, z):

    accelerometer   M = diag(1+k) A(γ), Eq. (1), with xy = xz = yz = 0: lower triangular; angles yx, zx, zy
    paper           M = diag(1+k) [[1, xy, xz], [0, 1, yz], [0, 0, 1]]: upper triangular; k is the diagonal, not the
                    sensitivity along the sensor's axis, and the angles are quotients, as in Eq. (5) of the ellipsoid
                    paper
    symmetric       M = Mᵀ, positive definite (the polar factor): k as in Eq. (1), angles xy, xz, yz of Eq. (1); the
                    other three follow from the symmetry
    case            the mounting faces: no element of M is zero, all six angles of Eq. (1): the three additional
                    parameters are the alignment of the accelerometers with the case, and as uncertain

For channels in another order or of the other sign, rows and columns are those of the body axes: M stands for Dᵀ M, D
the nominal axes. Gyros have all six angles of Eq. (1) in every frame. The frames `accelerometer` and `case` exist for
more than three sensors too; `paper` and `symmetric` are for triads.

The Jacobian of a change of frame: with δQ = Q [φ×] and D′ = ∂M′/∂θ′, which for accelerometers has three columns too few
for an arbitrary change of M′,

    D′ δθ′ = δM′ = δM Q + M′[φ×]

determines δθ′ and φ together; in the case, φ is that of the alignment, and for gyros D′ is square.

Source of Eq. (1): the turntable paper (docs/reference/equations.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from tumble.errors import InputError
from tumble.rotation import skew
from tumble.sensors.instrument import Instrument
from tumble.sensors.model import Block, SensorModel, to_accelerometer_frame
from tumble.sensors.parameters import units_of
from tumble.units import Array

Frame = Literal["accelerometer", "case", "paper", "symmetric"]
FRAMES: tuple[Frame, ...] = get_args(Frame)

_UPPER = ((0, 1), (0, 2), (1, 2))
_UPPER_INDEX = tuple(zip(*_UPPER, strict=True))
_UPPER_PAIRS = ("xy", "xz", "yz")


def frame_of(name: str) -> Frame:
    """Return the frame of this name in a calibration file. Raises InputError for an unknown name."""
    if name not in FRAMES:
        raise InputError(f"frame: expected one of {', '.join(FRAMES)}, found {name!r}")
    return name


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Alignment:
    """Alignment of the case with a frame b.

    `mat_cb` (3, 3): rotation b → case; the true one is exp([ψ×]) mat_cb. `covariance` (3, 3): of the error ψ, rad²,
    without the part that comes from the m parameters of the accelerometers. `by_parameters` (3, m): derivative of the
    rotation vector, resolved in the case, by these."""

    mat_cb: Array
    covariance: Array
    by_parameters: Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Framed:
    """Parameters of accelerometers, then gyros, in a frame, with covariance and sensor models.

    `jacobian` (m′, m): derivative of these parameters by those they were converted from. `rotation` (3, 3): the Q of
    M′ = M Q."""

    frame: Frame
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    covariance: Array | None
    accel: SensorModel
    gyro: SensorModel | None
    jacobian: Array
    rotation: Array


@dataclass(frozen=True, kw_only=True, slots=True)
class Convention:
    """Parameters of a block in a frame. Raises InputError if the block has no such frame."""

    frame: Frame
    block: Block

    def __post_init__(self) -> None:
        frame_of(self.frame)
        if self.frame in ("paper", "symmetric") and self.block.kind == "accel" and not self.block.triad:
            raise InputError(
                f"frame {self.frame!r}: expected three accelerometers along the body axes, found {self.block.size} "
                "sensors or other axes; use the frame 'accelerometer' or 'case'"
            )

    @property
    def names(self) -> tuple[str, ...]:
        """Parameter names as in the calibration file: biases, scale-factor errors, axis angles."""
        angles = _UPPER_PAIRS if self._as_block is None else self._as_block.angles
        return (*self.block.names[: 2 * self.block.size], *(f"{self.block.kind}.axis.{angle}" for angle in angles))

    def parameters(self, model: SensorModel) -> Array:
        """Return the parameter values of a sensor model in this frame, in the order of `names`."""
        if self._as_block is not None:
            return self._as_block.parameters(model)
        values = self._all_angles.parameters(model)
        if self.frame == "paper":
            rows = self.block.axes.T @ model.matrix
            return np.concatenate([values[:3], np.diag(rows) - 1.0, [rows[p, q] / rows[p, p] for p, q in _UPPER]])
        return np.array([*values[:6], *(values[6 + self._all_angles.angles.index(pair)] for pair in _UPPER_PAIRS)])

    def model(self, values: Array) -> SensorModel:
        """Return the sensor model of parameter values in the order of `names`."""
        if self._as_block is not None:
            return self._as_block.model(values)
        k, angles = 1.0 + values[3:6], values[6:]
        if self.frame == "paper":
            rows = np.eye(3, dtype=values.dtype)
            rows[_UPPER_INDEX] = angles
            rows *= k[:, None]
        else:  # the symmetric matrix whose rows have the lengths 1 + k and the angles xy, xz, yz of Eq. (1)
            xy, xz, yz = angles
            rows = np.zeros((3, 3), dtype=values.dtype)
            rows[_UPPER_INDEX] = k[0] * np.sin(xy), k[0] * np.cos(xy) * np.sin(xz), k[1] * np.sin(yz)
            rows += rows.T
            rows += np.diag(np.sqrt(k**2 - (rows**2).sum(axis=1)))
        bias = self.block.axes @ values[:3] * self.block.axes.sum(axis=1)
        return SensorModel(matrix=self.block.axes @ rows, bias=bias)

    def jacobian(self, values: Array) -> Array:
        """Return the derivative (n, 4, m) of the matrix (n, 3) and, as fourth column, of the bias by the parameters."""
        if self._as_block is not None:
            return self._as_block.jacobian(values)
        out = np.empty((3, 4, len(values)))
        for i in range(len(values)):  # a complex step, exact to rounding
            stepped = self.model(values + 1e-20j * (np.arange(len(values)) == i))
            out[:, :3, i], out[:, 3, i] = stepped.matrix.imag / 1e-20, stepped.bias.imag / 1e-20
        return out

    @property
    def _as_block(self) -> Block | None:
        """The sensors as a block with these parameters; None if a block has others."""
        if self.block.kind == "gyro" or self.frame == "accelerometer":
            return self.block
        return self._all_angles if self.frame == "case" else None

    @property
    def _all_angles(self) -> Block:
        """The same sensors with all axis angles as parameters."""
        return Block(kind="gyro", axes=self.block.axes)


def rotation_to(frame: Frame, block: Block, accel: SensorModel) -> Array:
    """Return Q (3, 3) of M′ = M Q from any frame of accelerometers to `accelerometer`, `paper` or `symmetric`.

    Raises InputError for the case, and for accelerometers of the other handedness."""
    from scipy.linalg import polar, rq

    Convention(frame=frame, block=block)
    if frame == "case":
        raise InputError(
            "frame 'case': expected the alignment with the case, found none; no reading fixes it: give --frame case to "
            "`tumble calibrate` for a session that stands on all six faces"
        )
    if frame == "accelerometer":
        moved = to_accelerometer_frame(block, accel, None)[0]
        return np.asarray(np.linalg.lstsq(accel.matrix, moved.matrix)[0], dtype=float)
    rows = block.axes.T @ accel.matrix
    if np.linalg.det(rows) <= 0.0:
        raise InputError(
            f"frame {frame!r}: expected the accelerometers right-handed as their nominal axes, found them left-handed; "
            "check the signs of the scale"
        )
    if frame == "symmetric":
        return np.asarray(polar(rows, side="left")[0].T)
    upper, orthogonal = rq(rows)
    return np.asarray(orthogonal.T * np.sign(np.diag(upper)))


def convert(
    accel: Block,
    gyro: Block | None,
    *,
    source: Frame,
    values: Array,
    covariance: Array | None,
    target: Frame,
    alignment: Alignment | None = None,
) -> Framed:
    """Convert parameters (m,) of the accelerometers, then of the gyros, SI, from one frame to another, with their
    covariance (m, m).

    `alignment` is that of the case with `source`, if `target` is the case. Raises InputError for a frame that these
    sensors do not have, and for the case without an alignment."""
    old, new = Convention(frame=source, block=accel), Convention(frame=target, block=accel)
    count = len(old.names)
    before = old.model(values[:count])
    if target == source:
        Q = np.eye(3)
    elif target == "case" and alignment is not None:
        Q = alignment.mat_cb.T
    else:
        Q = rotation_to(target, accel, before)
    after = _rotated(before, Q)
    framed_values, names = new.parameters(after), new.names
    # D′ δθ′ = δM Q + M′[φ×], with φ of the alignment or, in other frames, as unknowns
    derivative, phi_columns = new.jacobian(framed_values).reshape(4 * accel.size, -1), _rotation_columns(after)
    change = _rotated_change(old.jacobian(values[:count]), Q)
    if target == "case":
        phi = np.zeros((3, count)) if alignment is None or source == "case" else -alignment.by_parameters
        of_accel = np.linalg.solve(derivative, change + phi_columns @ phi)
    else:
        of_accel, phi = np.split(np.linalg.solve(np.hstack([derivative, -phi_columns]), change), [len(names)])
    jacobian = np.hstack([of_accel, np.zeros((len(of_accel), len(values) - count))])
    systems = [(derivative, phi_columns)]
    gyro_after = None
    if gyro is not None:
        gyro_after = _rotated(gyro.model(values[count:]), Q)
        gyro_values = gyro.parameters(gyro_after)
        framed_values, names = np.concatenate([framed_values, gyro_values]), (*names, *gyro.names)
        derivative, phi_columns = gyro.jacobian(gyro_values).reshape(4 * gyro.size, -1), _rotation_columns(gyro_after)
        change = np.hstack([phi_columns @ phi, _rotated_change(gyro.jacobian(values[count:]), Q)])
        jacobian = np.vstack([jacobian, np.linalg.solve(derivative, change)])
        systems.append((derivative, phi_columns))
    if covariance is not None:
        covariance = jacobian @ covariance @ jacobian.T
        if alignment is not None and target == "case" and source != "case":
            by_alignment = np.concatenate([np.linalg.solve(*system) for system in systems])
            covariance = covariance + by_alignment @ alignment.covariance @ by_alignment.T
    return Framed(
        frame=target,
        names=names,
        units=units_of(names),
        values=framed_values,
        covariance=covariance,
        accel=after,
        gyro=gyro_after,
        jacobian=jacobian,
        rotation=Q,
    )


def further_rotation(instrument: Instrument, Q: Array) -> Array:
    """Return the derivative (q, q) of the parameters beyond the linear model in a rotated frame, M′ = M Q, by the
    original ones.

    Rows of g-sensitivity rotate like those of M, lever arms like vectors. All others belong to single sensors."""
    out = np.eye(len(instrument.names) - instrument.linear_count)
    for name, members in instrument.members.items():
        if name in ("gyro.g_sensitivity", "accel.lever"):
            first = members.start - instrument.linear_count
            for row in range(first, members.stop - instrument.linear_count, 3):
                out[row : row + 3, row : row + 3] = Q.T
    return out


def _rotated(model: SensorModel, Q: Array) -> SensorModel:
    return SensorModel(matrix=model.matrix @ Q, bias=model.bias)


def _rotated_change(change: Array, Q: Array) -> Array:
    """Return δM Q of changes (n, 4, m) of matrix and bias, as (4n, m)."""
    out = np.array(change)
    out[:, :3] = np.einsum("pkm,kq->pqm", change[:, :3], Q)
    return out.reshape(4 * len(change), -1)


def _rotation_columns(model: SensorModel) -> Array:
    """Return the change M [φ×] of matrix and bias with φ, as (4n, 3)."""
    out = np.zeros((*model.matrix.shape[:1], 4, 3))
    out[:, :3] = np.einsum("pk,jkq->pqj", model.matrix, skew(np.eye(3)))
    return out.reshape(-1, 3)


def triad_axes(matrix: Array) -> Array:
    """Return the nominal axes (3, 3) of a triad with this matrix: the signed body axis nearest to each sensor.

    Raises InputError unless the sensors are three, one along each axis."""
    axes, nearest = np.zeros(matrix.shape), np.argmax(np.abs(matrix), axis=1)
    axes[np.arange(len(matrix)), nearest] = np.sign(matrix[np.arange(len(matrix)), nearest])
    if not Block(kind="accel", axes=axes).triad:
        raise InputError(
            f"expected three sensors, one along each body axis, found a matrix of {len(matrix)} rows that is not of "
            "such; give --frame to `tumble calibrate`, which knows the nominal axes"
        )
    return axes
