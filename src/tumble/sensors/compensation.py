"""The inverse of the model: true specific force and rate of the body from the readings of an instrument."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from tumble.rotation import left_inverse
from tumble.sensors.fixed_point import fixed_point, moved
from tumble.sensors.instrument import Instrument, is_linear, measured_by
from tumble.sensors.model import Block, SensorModel
from tumble.sensors.parameters import CONSTANT, FORCE, FUNCTIONS, RATE, group_name
from tumble.units import Array

FIXED_POINT_STEPS = 5
"""Steps after the linear one: each leaves the part of 1e-3 to 1e-2 that the nonlinear terms are of the reading."""


def specific_force(instrument: Instrument, values: Array, readings: Array) -> Array:
    """Specific force (N, 3), m/s², in the body from readings (N, n) of the accelerometers, SI."""
    K = instrument.coefficients(instrument.accel, values)
    return _solved(instrument.accel, K, FORCE, readings, np.zeros(3))


def angular_rate(instrument: Instrument, values: Array, readings: Array, force: Array) -> Array:
    """Angular rate (N, 3), rad/s, in the body from readings (N, n) of the gyros, SI, and the specific force (N, 3)."""
    assert instrument.gyro is not None
    K = instrument.coefficients(instrument.gyro, values)
    return _solved(instrument.gyro, K, RATE, readings, force)


def _solved(
    block: Block, K: Array, measured: slice, readings: Array, force: Array, change: tuple[Array, Array] | None = None
) -> Array:
    """The measured vector (N, 3), by fixed-point steps: x ← S⁻¹ ((ŷ − b − what is not linear in x) / s); where
    parameters change with temperature, `change` is that of the bias, and s, both (N, n)."""
    inverse = left_inverse(K[:, measured])
    rest = K.copy()
    rest[:, measured], rest[:, CONSTANT] = 0.0, 0.0
    warmer, gain = change if change is not None else (np.zeros(1), np.ones(1))
    offset = K[:, CONSTANT] + warmer
    if not np.any(rest):
        return np.asarray(((readings - offset) / gain) @ inverse.T)
    if not np.any(rest[:, FORCE]):
        force = np.zeros(3)  # what does not count may be lost
    return fixed_point(
        readings,
        (np.broadcast_to(offset, readings.shape), np.broadcast_to(gain, readings.shape)),
        np.broadcast_to(force, (len(readings), 3)),
        (inverse, block.axes, rest),
        1 + FIXED_POINT_STEPS,
        of_force=measured == FORCE,
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Compensator:
    """An instrument as what corrects its readings: blocks of sensors and the coefficients K (n, 15) of each, and what
    biases and scale factors change by per K of temperature (n,), `slopes`, and per K², `curvatures`, about the
    `references` (n,), °C, by kind, where there are such; the sensors follow their thermometers with the time constant
    `lag`, s. Lever arms (n, 3), m, need the motion: `at_one_point`. The `delays` (n,) of the accelerometers, s, are
    not undone."""

    accel: Block
    gyro: Block | None
    accel_coefficients: Array
    gyro_coefficients: Array
    slopes: Mapping[str, Array]
    curvatures: Mapping[str, Array]
    levers: Array
    delays: Array
    references: Mapping[str, Array] = field(default_factory=dict)
    lag: float = 0.0

    @staticmethod
    def of(
        blocks: tuple[Block, Block | None],
        models: tuple[SensorModel, SensorModel | None],
        values: Mapping[str, float],
        references: Mapping[str, Array],
    ) -> Compensator:
        """The compensator of the models of accelerometers and gyros and of further parameters by name."""
        accel, gyro = blocks
        instrument = Instrument.of(accel, gyro, {group_name(name) for name in values}, variables=())
        further = np.array([values.get(name, 0.0) for name in instrument.names])
        further[: instrument.linear_count] = 0.0
        coefficients = []
        for block, model in zip(blocks, models, strict=True):
            K = np.zeros((0, FUNCTIONS))
            if block is not None and model is not None:
                K = instrument.coefficients(block, further).copy()
                K[:, measured_by(block)], K[:, CONSTANT] = model.matrix, K[:, CONSTANT] + model.bias
            coefficients.append(K)
        return Compensator(
            accel=accel,
            gyro=gyro if models[1] is not None else None,
            accel_coefficients=coefficients[0],
            gyro_coefficients=coefficients[1],
            slopes=_changes(blocks, values, "t1"),
            curvatures=_changes(blocks, values, "t2"),
            levers=instrument.levers(further),
            delays=instrument.delays(further),
            references=references,
            lag=values.get("temperature.lag", 0.0),
        )

    @property
    def linear(self) -> bool:
        """Whether matrix and bias of each kind are all there is, whatever the temperature."""
        kinds = ((self.accel, self.accel_coefficients), (self.gyro, self.gyro_coefficients))
        return not self.warm and all(block is None or is_linear(block, K) for block, K in kinds)

    @property
    def warm(self) -> bool:
        """Whether anything changes with temperature."""
        return bool(self.slopes or self.curvatures)

    @property
    def several_thermometers(self) -> bool:
        """Whether not all sensors have the same thermometer."""
        blocks = (self.accel, self.gyro)
        return len({int(t) for block in blocks if block is not None for t in block.thermometer}) > 1

    def model(self, kind: str) -> SensorModel:
        """Matrix and bias of a kind of sensors, without what is beyond them."""
        block, K = (self.accel, self.accel_coefficients) if kind == "accel" else (self.gyro, self.gyro_coefficients)
        assert block is not None
        return SensorModel(matrix=K[:, measured_by(block)], bias=K[:, CONSTANT])

    def at_one_point(self, readings: Array, rate: Array, acceleration: Array) -> Array:
        """Readings (N, n), SI, as all accelerometers would have them where the last one is, in motion with a rate and
        an angular acceleration (N, 3), rad/s and rad/s²; where these are not known, the readings as they are."""
        return moved(readings, rate, acceleration, self.levers, self.accel_coefficients[:, FORCE])

    def force(self, readings: Array, temperature: Array | None = None) -> Array:
        """Specific force (N, 3), m/s², of readings (N, n), SI, at temperatures (N, n) or (N, 1), °C, of the sensors."""
        change = self._change(self.accel, self.accel_coefficients, temperature)
        return _solved(self.accel, self.accel_coefficients, FORCE, readings, np.zeros(3), change)

    def rate(self, readings: Array, force: Array, temperature: Array | None = None) -> Array:
        """Angular rate (N, 3), rad/s, of readings (N, n), SI, in a specific force (N, 3), at temperatures likewise."""
        assert self.gyro is not None
        change = self._change(self.gyro, self.gyro_coefficients, temperature)
        return _solved(self.gyro, self.gyro_coefficients, RATE, readings, force, change)

    def _change(self, block: Block, K: Array, temperature: Array | None) -> tuple[Array, Array] | None:
        """Changes (N, n) of the biases from the reference temperature, and factors (N, n) of the sensitivities."""
        if temperature is None or block.kind not in self.references or not self.warm:
            return None
        warmer = temperature - self.references[block.kind]
        powers = (warmer, self.slopes), (warmer**2, self.curvatures)
        bias, scale = (
            sum(by.get(f"{block.kind}.{what}", 0.0) * power for power, by in powers) for what in ("bias", "scale")
        )
        return np.asarray(bias), 1.0 + np.asarray(scale) / np.linalg.norm(K[:, measured_by(block)], axis=1)


def _changes(blocks: tuple[Block, Block | None], values: Mapping[str, float], ending: str) -> dict[str, Array]:
    """Changes (n,) by channel of biases and scale factors, per K for `t1` and per K² for `t2`, where the values have
    some."""
    out = {}
    for block in filter(None, blocks):
        for what in ("bias", "scale"):
            out[f"{block.kind}.{what}"] = change = np.zeros(block.size)
            change[block.channels] = [values.get(f"{block.kind}.{what}.{s}.{ending}", 0.0) for s in block.sensors]
    return out if any(np.any(change) for change in out.values()) else {}
