"""An instrument: its blocks of sensors and its groups of parameters, with one vector of values.

The vector holds bias, scale-factor error and axis angles of the accelerometers, then of the gyros, then the further
groups in the order of the table (`tumble.sensors.parameters`). `coefficients` are the arrays K of both blocks for such
values, with which a reading is y_p = Σ_b K_pb β_pb(f, ω); `derivative` is ∂K/∂θ. Lever arms and delays are in neither.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from tumble.errors import InputError
from tumble.sensors.model import Block, SensorModel
from tumble.sensors.parameters import (
    CONSTANT,
    FORCE,
    FUNCTIONS,
    OWN_CUBE,
    OWN_SIZE,
    PAIRS,
    PRODUCTS,
    RATE,
    Motion,
    ParameterGroup,
    Variable,
    groups,
    positions_by_group,
    units_of,
)
from tumble.units import Array, IntArray

_FIRST, _SECOND = np.array(PAIRS).T


@dataclass(frozen=True, kw_only=True, eq=False)
class Instrument:
    """Accelerometers and gyros (None without any) with their `further` groups of parameters."""

    accel: Block
    gyro: Block | None
    further: tuple[ParameterGroup, ...] = ()

    @staticmethod
    def of(
        accel: Block, gyro: Block | None, names: Container[str] | None = None, variables: Container[str] = ("time",)
    ) -> Instrument:
        """Return the instrument with the further groups of these names (None: all that fit its sensors), and changes
        with these `variables` only."""
        blocks = {"accel": accel} | ({} if gyro is None else {"gyro": gyro})
        further = tuple(
            group
            for group in groups()
            if not group.linear
            and group.kind in blocks
            and (names is None or group.name in names)
            and (gyro is not None or group.motion is None)
            and (group.variable is None or group.variable in variables)
        )
        return Instrument(accel=accel, gyro=gyro, further=further)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters."""
        linear = (name for block in self.blocks for name in block.names)
        return (*linear, *(name for group in self.further for name in group.names(self.block(group))))

    @cached_property
    def units(self) -> tuple[str, ...]:
        """SI units of all parameters."""
        return units_of(self.names)

    @cached_property
    def thermometers(self) -> IntArray:
        """Thermometer (m,) of each parameter that is a change with temperature."""
        out = np.zeros(len(self.names), dtype=np.int64)
        for group in self.further:
            out[self.members[group.name]] = group.thermometers(self.block(group))
        return out

    def block(self, group: ParameterGroup) -> Block:
        """Return the sensors that have a group."""
        block = self.accel if group.kind == "accel" else self.gyro
        assert block is not None
        return block

    @cached_property
    def linear_count(self) -> int:
        """Number of parameters of the linear model."""
        return sum(len(block.names) for block in self.blocks)

    @cached_property
    def members(self) -> dict[str, slice]:
        """Positions of the parameters of each further group, by name."""
        out, first = {}, self.linear_count
        for group in self.further:
            out[group.name] = slice(first, first := first + len(group.names(self.block(group))))
        return out

    def own(self, block: Block) -> slice:
        """Return the positions of the linear parameters of a block."""
        n = len(self.accel.names)
        return slice(0, n) if block.kind == "accel" else slice(n, n + len(block.names))

    def turn_only(self, motion: Motion) -> slice | None:
        """Return the positions of the parameters with this effect on turns, None if there are none."""
        return next((self.members[g.name] for g in self.further if g.motion == motion), None)

    @cached_property
    def changes(self) -> list[tuple[slice, slice, Variable]]:
        """Positions of parameters that are changes of others, positions of these, and the variable."""
        return [
            (self.members[group.name], self.group_columns[group.base], group.variable)
            for group in self.further
            if group.base is not None and group.variable is not None
        ]

    @cached_property
    def group_columns(self) -> dict[str, slice]:
        """Positions of the parameters of each group, by name."""
        return {name: slice(at[0], at[-1] + 1) for name, at in positions_by_group(self.names).items()} | self.members

    def change(self, block: Block, values: Array, variable: Variable) -> Array:
        """Return ∂K (n, 15) of a block by a variable, from the parameters proportional to it: by time, 1/s."""
        out = np.zeros((block.size, FUNCTIONS))
        for members, base, changes_with in self.changes:
            if changes_with == variable:
                out += self.derivative(block, values)[:, :, base] @ values[members]
        return out

    @cached_property
    def in_velocities(self) -> bool:
        """Whether the velocities of turns can be predicted, which requires lever arms and delays."""
        return self.gyro is not None and None not in (self.turn_only("lever"), self.turn_only("delay"))

    def levers(self, values: Array) -> Array:
        """Return the lever arms (n, 3), m, of the accelerometers by channel; zero without this group."""
        out, at = np.zeros((self.accel.size, 3)), self.turn_only("lever")
        if at is not None:
            out[self.accel.channels[:-1]] = values[at].reshape(-1, 3)
        return out

    def delay(self, values: Array) -> float:
        """Return the delay of the last accelerometer, s; zero without this group."""
        at = self.turn_only("delay")
        return 0.0 if at is None else float(values[at][0])

    def delays(self, values: Array) -> Array:
        """Return the delays of the accelerometers (n,), s, by channel."""
        out, at = np.full(self.accel.size, self.delay(values)), self.turn_only("single delay")
        if at is not None:
            out[self.accel.channels[:-1]] += values[at]
        return out

    @property
    def blocks(self) -> tuple[Block, ...]:
        """Accelerometers, and gyros if there are any."""
        return (self.accel,) if self.gyro is None else (self.accel, self.gyro)

    def model(self, block: Block, values: Array) -> SensorModel:
        """Return the sensitivity matrix and bias of a block."""
        return block.model(values[self.own(block)])

    def coefficients(self, block: Block, values: Array) -> Array:
        """Return K (n, 15) of a block, read-only."""
        return self.linearised(values)[0][self.rows(block)]

    def derivative(self, block: Block, values: Array) -> Array:
        """Return ∂K/∂θ (n, 15, m) of a block by all parameters, read-only."""
        return self.linearised(values)[1][self.rows(block)]

    def linearised(self, values: Array) -> tuple[Array, Array]:
        """Return K (n, 15) and ∂K/∂θ (n, 15, m) of accelerometers and gyros, read-only."""
        return _linearised(self, np.asarray(values, dtype=float).tobytes())

    def rows(self, block: Block) -> slice:
        """Return the positions of the sensors of a block among all, accelerometers before gyros."""
        return slice(self.accel.size) if block.kind == "accel" else slice(self.accel.size, None)

    @cached_property
    def _constant(self) -> Array:
        """∂K/∂θ for the parameters that K is linear in, 0 for the others."""
        out = np.zeros((sum(block.size for block in self.blocks), FUNCTIONS, len(self.names)))
        for group in self.further:
            if group.regressors is not None:
                block = self.block(group)
                regressors = group.regressors(block)
                if group.kind == "accel" and np.any(regressors[:, RATE]):  # a correction has the force before the rate
                    expected = "expected no terms in the rate, which no correction of accelerometers removes"
                    raise InputError(f"{group.name}: {expected}, found some; leave them out in its package")
                out[self.rows(block), :, self.members[group.name]] = regressors
        return out

    @cached_property
    def used(self) -> dict[str, IntArray]:
        """Functions that the readings of each block may contain."""
        out: dict[str, IntArray] = {}
        for block in self.blocks:
            nonzero = np.any(self._constant[self.rows(block)] != 0.0, axis=(0, 2))
            nonzero[CONSTANT], nonzero[measured_by(block)] = True, True
            out[block.kind] = np.flatnonzero(nonzero)
        return out


@lru_cache(maxsize=4)
def _linearised(instrument: Instrument, values: bytes) -> tuple[Array, Array]:
    """Return `Instrument.linearised`, cached: an estimate evaluates it repeatedly at one point."""
    point = np.frombuffer(values)
    K = instrument._constant @ point
    D = instrument._constant.copy()
    for block in instrument.blocks:
        rows, columns, measured = instrument.rows(block), instrument.own(block), measured_by(block)
        model, jacobian = block.linearised(point[columns])
        K[rows, measured] = model[:, :3]
        K[rows, CONSTANT] = model[:, 3]
        D[rows, measured, columns] = jacobian[:, :3]
        D[rows, CONSTANT, columns] = jacobian[:, 3]
    K.flags.writeable = D.flags.writeable = False
    return K, D


def measured_by(block: Block) -> slice:
    """Return the indices of the functions that the sensors of a block measure: specific force or rate."""
    return FORCE if block.kind == "accel" else RATE


def functions(block: Block, force: Array, rate: Array) -> Array:
    """Return β (N, n, 15) of the sensors of a block for specific forces and rates (N, 3) in the body."""
    along = (force if block.kind == "accel" else rate) @ block.axes.T
    out = np.empty((len(force), block.size, FUNCTIONS))
    out[:, :, CONSTANT] = 1.0
    out[:, :, RATE], out[:, :, FORCE] = rate[:, None], force[:, None]
    out[:, :, PRODUCTS] = (force[:, _FIRST] * force[:, _SECOND])[:, None]
    out[:, :, OWN_SIZE], out[:, :, OWN_CUBE] = np.abs(along), along**3
    return out


def readings(block: Block, K: Array, force: Array, rate: Array) -> Array:
    """Return the readings Σ_b K_pb β_pb (N, n) of a block for specific forces, (N, 3) or at each sensor (N, n, 3), and
    rates (N, 3) of the body."""
    measured, other = (force, rate) if block.kind == "accel" else (rate, force)
    linear = measured_by(block)
    out = _along(measured, K[:, linear]) + K[:, CONSTANT]
    if is_linear(block, K):
        return out
    along = _along(measured, block.axes)
    out += _along(other, K[:, RATE if linear == FORCE else FORCE])
    if np.any(K[:, PRODUCTS]):
        out += _along(force[..., _FIRST] * force[..., _SECOND], K[:, PRODUCTS])
    return np.asarray(out + np.abs(along) * K[:, OWN_SIZE] + along * along * along * K[:, OWN_CUBE])


def _along(vectors: Array, axes: Array) -> Array:
    """Return Σ_k a_pk v_k (N, n) along axes (n, k) of vectors, (N, k), or (N, n, k) with one for each axis."""
    return np.asarray(vectors @ axes.T if vectors.ndim == 2 else np.einsum("npk,pk->np", vectors, axes))


def is_linear(block: Block, K: Array) -> bool:
    """Return True if the readings of a block depend only on the vector it measures, linearly."""
    return not np.any(np.delete(K, np.r_[CONSTANT, measured_by(block)], axis=1))
