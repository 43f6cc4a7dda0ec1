"""Frames: one set of sensors seen in the frames of the accelerometers, the paper, the symmetric matrix and the case.

Whatever the frame, `reading = matrix @ true + bias`. A rotation of the frame changes the matrix alone, and the same Q
serves accelerometers and gyros, so that both stay in one common frame:

    M′ = M Q,   true′ = Qᵀ true

What fixes the frame, and what the nine numbers of three accelerometers are called in it (rows and columns x, y, z):

    accelerometer   M = diag(1+k) A(γ), Eq. (1), with xy = xz = yz = 0: lower triangular; angles yx, zx, zy
    paper           M = diag(1+k) [[1, xy, xz], [0, 1, yz], [0, 0, 1]]: upper triangular; k is the diagonal here,
                    not the sensitivity along the sensor's axis, and the angles are quotients, as its Eq. (5) has them
    symmetric       M = Mᵀ, positive definite (the polar factor): k as in Eq. (1), angles xy, xz, yz of Eq. (1); the
                    other three follow from the symmetry
    case            the mounting faces: nothing of M is zero, all six angles of Eq. (1): three more parameters, which
                    are the alignment of the accelerometers with the case and as uncertain

For channels in another order or of the other sign, rows and columns are those of the body axes: Dᵀ M is meant, D the
nominal axes. Gyros have all six angles of Eq. (1) in every frame. The parameters of `accelerometer` and `case` exist
for more than three sensors too; `paper` and `symmetric` are for triads.

The Jacobian of a change of frame: with δQ = Q [φ×] and the three conditions c(M′) = 0 that fix the frame,

    δM′ = δM Q + M′[φ×],   c(δM Q) + c(M′[φ×]) = 0   gives φ,   δθ′ = (∂θ′/∂M′) δM′.

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
from tumble.units import Array, IntArray

Frame = Literal["accelerometer", "case", "paper", "symmetric"]
FRAMES: tuple[Frame, ...] = get_args(Frame)

_UPPER = ((0, 1), (0, 2), (1, 2))
_UPPER_PAIRS = ("xy", "xz", "yz")
_EACH = np.arange(3)


def frame_of(name: str) -> Frame:
    """The frame of this name, as a calibration file has it. Raises InputError for any other."""
    if name not in FRAMES:
        raise InputError(f"frame: expected one of {', '.join(FRAMES)}, found {name!r}")
    return name


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Alignment:
    """The case seen from a frame b: `mat_cb` (3, 3), the covariance (3, 3), rad², of its error ψ (the true one is
    exp([ψ×]) mat_cb) that does not come from the accelerometer parameters, and `by_parameters` (3, m), the change of
    the rotation, likewise resolved in the case, with these."""

    mat_cb: Array
    covariance: Array
    by_parameters: Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Framed:
    """Parameters of accelerometers, then gyros, in a frame, with covariance, and the sensor models they make.
    `jacobian` is their derivative with respect to those they came from, `rotation` the Q of M′ = M Q."""

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
    """What the parameters of a block are in a frame. Raises InputError where the frame is none of this block."""

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
        if self._own:
            return self.block.names
        angles = (f"{self.block.kind}.axis.{angle}" for angle in self._angles)
        return (*self.block.names[: 2 * self.block.size], *angles)

    def parameters(self, model: SensorModel) -> Array:
        """Parameter values of a sensor model given in this frame, in the order of `names`."""
        if self._own:
            return self.block.parameters(model)
        if self.frame == "paper":
            rows = self._rows(model)
            angles = [rows[p, q] / rows[p, p] for p, q in _UPPER]
            return np.concatenate([self._free.parameters(model)[:3], np.diag(rows) - 1.0, angles])
        return np.asarray(self._free.parameters(model)[self._chosen])

    def model(self, values: Array) -> SensorModel:
        """The sensor model of parameter values given in the order of `names`."""
        if self._own:
            return self.block.model(values)
        if self.frame == "case":
            return self._free.model(values)
        k, angles = 1.0 + values[3:6], values[6:]
        if self.frame == "paper":
            rows = np.eye(3, dtype=values.dtype)
            rows[tuple(zip(*_UPPER, strict=True))] = angles
            rows *= k[:, None]
        else:  # the symmetric matrix whose rows have the lengths 1 + k and the angles xy, xz, yz of Eq. (1)
            (xy, xz, yz), rows = angles, np.zeros((3, 3), dtype=values.dtype)
            rows[0, 1], rows[0, 2], rows[1, 2] = k[0] * np.sin(xy), k[0] * np.cos(xy) * np.sin(xz), k[1] * np.sin(yz)
            rows += rows.T
            rows += np.diag(np.sqrt(k**2 - (rows**2).sum(axis=1)))
        bias = self.block.axes @ values[:3] * self.block.axes.sum(axis=1)
        return SensorModel(matrix=self.block.axes @ rows, bias=bias)

    def jacobian(self, values: Array) -> Array:
        """Derivative of the matrix (n, 3) and of the bias (as a fourth column) with respect to the parameters:
        shape (n, 4, m), as `Block.jacobian`."""
        if self._own:
            return self.block.jacobian(values)
        if self.frame == "case":
            return self._free.jacobian(values)
        out = np.empty((3, 4, len(values)))
        for i in range(len(values)):  # a complex step, exact to rounding
            stepped = self.model(values + 1e-20j * (np.arange(len(values)) == i))
            out[:, :3, i], out[:, 3, i] = stepped.matrix.imag / 1e-20, stepped.bias.imag / 1e-20
        return out

    def derivative(self, model: SensorModel) -> Array:
        """Derivative (m, 4n) of the parameters with respect to matrix and bias, (n, 4) row by row, of a model given
        in this frame."""
        free = self._free.jacobian(self._free.parameters(model))
        inverse = np.linalg.inv(free.reshape(4 * self.block.size, -1))
        if self.frame != "paper" or self.block.kind == "gyro":
            return np.asarray(inverse[self._chosen])
        rows, by_rows = self._rows(model), np.zeros((6, 3, 3))  # of k and angles, with the entries of the rows
        by_rows[_EACH, _EACH, _EACH] = 1.0
        for i, (p, q) in enumerate(_UPPER, start=3):
            by_rows[i, p, q], by_rows[i, p, p] = 1.0 / rows[p, p], -rows[p, q] / rows[p, p] ** 2
        return np.concatenate([inverse[:3], by_rows.reshape(6, 9) @ self._to_rows()])

    def conditions(self, model: SensorModel) -> Array:
        """The conditions (3, 4n) on a change of matrix and bias under which an accelerometer model stays in this
        frame; not of the case, which no reading fixes."""
        if self.frame == "accelerometer":
            free = self._free.jacobian(self._free.parameters(model))
            others = np.setdiff1d(np.arange(4 * self.block.size), self._chosen)
            return np.asarray(np.linalg.inv(free.reshape(4 * self.block.size, -1))[others])
        entries = self._to_rows().reshape(3, 3, -1)
        below = np.array([entries[q, p] for p, q in _UPPER])
        return below if self.frame == "paper" else below - np.array([entries[p, q] for p, q in _UPPER])

    @property
    def _own(self) -> bool:
        """Whether the parameters are those of the block itself."""
        return self.block.kind == "gyro" or self.frame == "accelerometer"

    @property
    def _free(self) -> Block:
        """The same sensors with every axis angle as a parameter."""
        return Block(kind="gyro", axes=self.block.axes)

    @property
    def _angles(self) -> tuple[str, ...]:
        """What the axis angles are called that are parameters here."""
        if self._own:
            return self.block.angles
        return self._free.angles if self.frame == "case" else _UPPER_PAIRS

    @property
    def _chosen(self) -> IntArray:
        """Which of the parameters of `_free` are parameters here."""
        n, own = 2 * self.block.size, self._angles
        angles = [i for i, angle in enumerate(self._free.angles, n) if angle in own]
        return np.array([*range(n), *angles])

    def _rows(self, model: SensorModel) -> Array:
        """Matrix of a triad with its rows in the order and with the signs of the body axes."""
        return np.asarray(self.block.axes.T @ model.matrix)

    def _to_rows(self) -> Array:
        """`_rows` as a linear map (9, 12) of matrix and bias."""
        identity = np.eye(12).reshape(12, 3, 4)[:, :, :3]
        return np.asarray((self.block.axes.T @ identity).reshape(12, 9).T)


def rotation_to(frame: Frame, block: Block, accel: SensorModel) -> Array:
    """Q (3, 3) of M′ = M Q that takes accelerometers from any frame to the one their own axes fix: `accelerometer`,
    `paper` or `symmetric`. Raises InputError for the case, and for accelerometers of the other handedness."""
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
    """Parameters of accelerometers and gyros (without gyros: of the accelerometers alone) taken from the frame
    `source` to `target`, with their covariance. The case needs its `alignment` with the frame `source`.

    Raises InputError for a frame these sensors do not have, and for the case without an alignment."""
    old, new = Convention(frame=source, block=accel), Convention(frame=target, block=accel)
    count = len(old.names)
    before = old.model(values[:count])
    gyro_before = None if gyro is None else gyro.model(values[count:])
    if target == source:
        Q = np.eye(3)
    else:
        Q = alignment.mat_cb.T if target == "case" and alignment is not None else rotation_to(target, accel, before)
    after = _turned(before, Q)
    gyro_after = None if gyro_before is None else _turned(gyro_before, Q)
    phi = np.zeros((3, len(values)))  # of δQ = Q [φ×], with the parameters
    change = _carried(old.jacobian(values[:count]), Q)
    if target not in (source, "case"):
        conditions = new.conditions(after)
        phi[:, :count] = -np.linalg.solve(conditions @ _turning(after), conditions @ change)
    elif alignment is not None and target != source:
        phi[:, :count] = -alignment.by_parameters
    blocks = [(new, after, slice(0, count), change)]
    if gyro is not None and gyro_after is not None:
        own = Convention(frame=target, block=gyro)
        blocks.append((own, gyro_after, slice(count, None), _carried(gyro.jacobian(values[count:]), Q)))
    by_turning = np.concatenate([convention.derivative(model) @ _turning(model) for convention, model, _, _ in blocks])
    jacobian = by_turning @ phi  # the change of the frame, and that of each block itself
    rows = 0
    for convention, model, part, change in blocks:
        own_rows = slice(rows, rows := rows + len(convention.names))
        jacobian[own_rows, part] += convention.derivative(model) @ change
    if covariance is not None:
        covariance = jacobian @ covariance @ jacobian.T
        if alignment is not None and target == "case" and source != "case":
            covariance = covariance + by_turning @ alignment.covariance @ by_turning.T
    names = tuple(name for convention, *_ in blocks for name in convention.names)
    return Framed(
        frame=target,
        names=names,
        units=units_of(names),
        values=np.concatenate([convention.parameters(model) for convention, model, *_ in blocks]),
        covariance=covariance,
        accel=after,
        gyro=gyro_after,
        jacobian=jacobian,
        rotation=Q,
    )


def carried_further(instrument: Instrument, Q: Array) -> Array:
    """Derivative (q, q) of the parameters beyond the linear model in a frame turned by Q, M′ = M Q, with those before:
    rows of g-sensitivity turn as those of M, lever arms as vectors. All others belong to the sensors alone."""
    out = np.eye(len(instrument.names) - instrument.linear_count)
    for name, members in instrument.members.items():
        if name in ("gyro.g_sensitivity", "accel.lever"):
            first = members.start - instrument.linear_count
            for row in range(first, members.stop - instrument.linear_count, 3):
                out[row : row + 3, row : row + 3] = Q.T
    return out


def _turned(model: SensorModel, Q: Array) -> SensorModel:
    return SensorModel(matrix=model.matrix @ Q, bias=model.bias)


def _carried(change: Array, Q: Array) -> Array:
    """δM Q of changes (n, 4, m) of matrix and bias, as (4n, m)."""
    out = np.array(change)
    out[:, :3] = np.einsum("pkm,kq->pqm", change[:, :3], Q)
    return out.reshape(4 * len(change), -1)


def _turning(model: SensorModel) -> Array:
    """The change M [φ×] of matrix and bias with φ, as (4n, 3)."""
    out = np.zeros((*model.matrix.shape[:1], 4, 3))
    out[:, :3] = np.einsum("pk,jkq->pqj", model.matrix, skew(np.eye(3)))
    return out.reshape(-1, 3)


def triad_axes(matrix: Array) -> Array:
    """The nominal axes (3, 3) of a triad whose matrix this is: the signed body axis nearest to each sensor.

    Raises InputError where the sensors are not three, one along each axis."""
    axes, nearest = np.zeros(matrix.shape), np.argmax(np.abs(matrix), axis=1)
    axes[np.arange(len(matrix)), nearest] = np.sign(matrix[np.arange(len(matrix)), nearest])
    if not Block(kind="accel", axes=axes).triad:
        raise InputError(
            f"expected three sensors, one along each body axis, found a matrix of {len(matrix)} rows that is not of "
            "such; give --frame to `tumble calibrate`, which knows the nominal axes"
        )
    return axes
