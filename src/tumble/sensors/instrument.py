"""An instrument: its blocks of sensors and the groups of parameters that it has, as one vector of values.

The vector holds bias, scale-factor error and axis angles of the accelerometers, then of the gyros, then the further
groups in the order of the table (`tumble.sensors.parameters`). `coefficients` makes of it the arrays K of both blocks,
with which a reading is y_p = Σ_b K_pb β_pb(f, ω); `derivatives` their derivatives. Lever arms and delays are in
neither.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

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
    """Accelerometers and gyros (None where there are none) with the `further` groups of parameters they have."""

    accel: Block
    gyro: Block | None
    further: tuple[ParameterGroup, ...] = ()

    @staticmethod
    def of(
        accel: Block, gyro: Block | None, names: Container[str] | None = None, variables: Container[str] = ("time",)
    ) -> Instrument:
        """The instrument with the further groups of these names, all of the table that fit its sensors where None;
        changes only with `variables` that are known."""
        blocks = {"accel": accel} | ({} if gyro is None else {"gyro": gyro})
        chosen = [
            group
            for group in groups()
            if not group.linear
            and group.kind in blocks
            and (names is None or group.name in names)
            and (gyro is not None or group.motion is None)
            and (group.variable is None or group.variable in variables)
        ]
        return Instrument(accel=accel, gyro=gyro, further=tuple(chosen))

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
        """The number of the thermometer (m,) that each parameter goes with, where it is the change of another with
        temperature."""
        out = np.zeros(len(self.names), dtype=np.int64)
        for group in self.further:
            out[self.members[group.name]] = group.thermometers(self.block(group))
        return out

    def block(self, group: ParameterGroup) -> Block:
        """The sensors that have a group."""
        block = self.accel if group.kind == "accel" else self.gyro
        assert block is not None
        return block

    @cached_property
    def linear_count(self) -> int:
        """How many parameters belong to the linear model."""
        return sum(len(block.names) for block in self.blocks)

    @cached_property
    def members(self) -> dict[str, slice]:
        """Where the parameters of each further group stand, by its name."""
        out, first = {}, self.linear_count
        for group in self.further:
            out[group.name] = slice(first, first := first + len(group.names(self.block(group))))
        return out

    def own(self, block: Block) -> slice:
        """Where the linear parameters of a block stand."""
        n = len(self.accel.names)
        return slice(0, n) if block.kind == "accel" else slice(n, n + len(block.names))

    def turn_only(self, motion: Motion) -> slice | None:
        """Where the parameters stand that a turn alone sees in this way."""
        return next((self.members[g.name] for g in self.further if g.motion == motion), None)

    @cached_property
    def changes(self) -> list[tuple[slice, slice, Variable]]:
        """Where the parameters stand that are changes of others, where these stand, and what they go with."""
        return [
            (self.members[group.name], self.group_columns[group.base], group.variable)
            for group in self.further
            if group.base is not None and group.variable is not None
        ]

    @cached_property
    def group_columns(self) -> dict[str, slice]:
        """Where the parameters of each group stand, by its name."""
        return {name: slice(own[0], own[-1] + 1) for name, own in positions_by_group(self.names).items()} | self.members

    def change(self, block: Block, values: Array, variable: Variable) -> Array:
        """∂K (n, 15) of a block by a variable, from the parameters that change with it: by time, 1/s."""
        out = np.zeros((block.size, FUNCTIONS))
        for own, base, each in self.changes:
            if each == variable:
                out += self.derivative(block, values)[:, :, base] @ values[own]
        return out

    @cached_property
    def in_velocities(self) -> bool:
        """Whether the velocities of turns can be predicted: lever arms and delays enter them as much as all else."""
        return self.gyro is not None and None not in (self.turn_only("lever"), self.turn_only("delay"))

    def levers(self, values: Array) -> Array:
        """Lever arms (n, 3), m, of the accelerometers by channel; zero where there are none."""
        out, where = np.zeros((self.accel.size, 3)), self.turn_only("lever")
        if where is not None:
            out[self.accel.channels[:-1]] = values[where].reshape(-1, 3)
        return out

    def delay(self, values: Array) -> float:
        """By how much the last accelerometer is late, s; zero where they have no delay."""
        where = self.turn_only("delay")
        return 0.0 if where is None else float(values[where][0])

    def delays(self, values: Array) -> Array:
        """By how much the accelerometers (n,) are late, s, by channel."""
        out, where = np.full(self.accel.size, self.delay(values)), self.turn_only("single delay")
        if where is not None:
            out[self.accel.channels[:-1]] += values[where]
        return out

    @property
    def blocks(self) -> tuple[Block, ...]:
        """Accelerometers, and gyros where there are some."""
        return (self.accel,) if self.gyro is None else (self.accel, self.gyro)

    def model(self, block: Block, values: Array) -> SensorModel:
        """Sensitivity matrix and bias of a block."""
        return block.model(values[self.own(block)])

    def coefficients(self, block: Block, values: Array) -> Array:
        """K (n, 15) of a block; not to be written to."""
        return self.all_coefficients(values)[self.rows(block)]

    def all_coefficients(self, values: Array) -> Array:
        """K (n, 15) of accelerometers and gyros; not to be written to."""
        return self.linearised(values)[0]

    def derivative(self, block: Block, values: Array) -> Array:
        """∂K/∂θ (n, 15, m) of a block with respect to all parameters; not to be written to."""
        return self.linearised(values)[1][self.rows(block)]

    def linearised(self, values: Array) -> tuple[Array, Array]:
        """K (n, 15) and ∂K/∂θ (n, 15, m) of accelerometers and gyros; not to be written to."""
        return _linearised(self, np.asarray(values, dtype=float).tobytes())

    def _linearised(self, values: Array) -> tuple[Array, Array]:
        K, D = self._constant @ values, self._constant.copy()
        for block in self.blocks:
            rows, own, measured = self.rows(block), self.own(block), measured_by(block)
            model, jacobian = block.linearised(values[own])
            K[rows, measured], K[rows, CONSTANT] = model[:, :3], model[:, 3]
            D[rows, measured, own], D[rows, CONSTANT, own] = jacobian[:, :3], jacobian[:, 3]
        return K, D

    def rows(self, block: Block) -> slice:
        """Where the sensors of a block stand among all, accelerometers before gyros."""
        return slice(self.accel.size) if block.kind == "accel" else slice(self.accel.size, None)

    @cached_property
    def _constant(self) -> Array:
        """∂K/∂θ for the parameters that K is linear in, others 0."""
        out = np.zeros((sum(block.size for block in self.blocks), FUNCTIONS, len(self.names)))
        for group in self.further:
            if group.regressors is not None:
                block = self.block(group)
                out[self.rows(block), :, self.members[group.name]] = group.regressors(block)
        return out

    @cached_property
    def used(self) -> dict[str, IntArray]:
        """Which functions the readings of each block may contain."""
        out: dict[str, IntArray] = {}
        for block in self.blocks:
            nonzero = np.any(self._constant[self.rows(block)] != 0.0, axis=(0, 2))
            nonzero[CONSTANT], nonzero[measured_by(block)] = True, True
            out[block.kind] = np.flatnonzero(nonzero)
        return out


@lru_cache(maxsize=4)
def _linearised(instrument: Instrument, values: bytes) -> tuple[Array, Array]:
    """`Instrument.linearised`: an estimate asks for that of one point again and again."""
    out = instrument._linearised(np.frombuffer(values))
    for each in out:
        each.flags.writeable = False
    return out


def measured_by(block: Block) -> slice:
    """Where the functions stand that the sensors of a block measure: the specific force or the rate."""
    return FORCE if block.kind == "accel" else RATE


def functions(block: Block, force: Array, rate: Array) -> Array:
    """β (N, n, 15) of the sensors of a block for specific forces and rates (N, 3) in the body."""
    own = (force if block.kind == "accel" else rate) @ block.axes.T
    out = np.empty((len(force), block.size, FUNCTIONS))
    out[:, :, CONSTANT] = 1.0
    out[:, :, RATE], out[:, :, FORCE] = rate[:, None], force[:, None]
    out[:, :, PRODUCTS] = (force[:, _FIRST] * force[:, _SECOND])[:, None]
    out[:, :, OWN_SIZE], out[:, :, OWN_CUBE] = np.abs(own), own**3
    return out


def readings(block: Block, K: Array, force: Array, rate: Array) -> Array:
    """Readings Σ_b K_pb β_pb (N, n) of a block in specific forces, (N, 3), or (N, n, 3) where those at each sensor are
    others, and rates (N, 3) of the body."""
    measured, other = (force, rate) if block.kind == "accel" else (rate, force)
    linear = measured_by(block)
    out = _along(measured, K[:, linear]) + K[:, CONSTANT]
    if is_linear(block, K):
        return out
    own = _along(measured, block.axes)
    out += _along(other, K[:, RATE if linear == FORCE else FORCE])
    if np.any(K[:, PRODUCTS]):
        out += _along(force[..., _FIRST] * force[..., _SECOND], K[:, PRODUCTS])
    return np.asarray(out + np.abs(own) * K[:, OWN_SIZE] + own * own * own * K[:, OWN_CUBE])


def _along(vectors: Array, axes: Array) -> Array:
    """Σ_k a_pk v_k (N, n) along axes (n, k) of vectors, (N, k), or (N, n, k) with one for each axis."""
    return np.asarray(vectors @ axes.T if vectors.ndim == 2 else np.einsum("npk,pk->np", vectors, axes))


def is_linear(block: Block, K: Array) -> bool:
    """Whether the readings of a block are linear in what it measures, and of nothing else."""
    return not np.any(np.delete(K, np.r_[CONSTANT, measured_by(block)], axis=1))
