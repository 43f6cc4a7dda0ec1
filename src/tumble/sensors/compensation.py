"""The inverse of the model: true specific force and rate of the body from the readings of an instrument."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tumble.sensors.instrument import Instrument, functions
from tumble.sensors.model import Block, SensorModel
from tumble.sensors.parameters import CONSTANT, FORCE, FUNCTIONS, RATE, group_name
from tumble.units import Array

FIXED_POINT_STEPS = 3
"""Steps for what is not linear: each leaves the part of 1e-3 or less that the nonlinear terms are of the reading."""


def specific_force(instrument: Instrument, values: Array, readings: Array) -> Array:
    """Specific force (N, 3), m/s², in the body from readings (N, n) of the accelerometers, SI."""
    K = instrument.coefficients(instrument.accel, values)
    return _solved(instrument.accel, K, FORCE, readings, np.zeros((len(readings), 3)))


def angular_rate(instrument: Instrument, values: Array, readings: Array, force: Array) -> Array:
    """Angular rate (N, 3), rad/s, in the body from readings (N, n) of the gyros, SI, and the specific force (N, 3)."""
    assert instrument.gyro is not None
    K = instrument.coefficients(instrument.gyro, values)
    return _solved(instrument.gyro, K, RATE, readings, force)


def _solved(block: Block, K: Array, measured: slice, readings: Array, force: Array) -> Array:
    """The measured vector (N, 3), by fixed-point steps: x ← S⁻¹ (ŷ − b − what is not linear in x)."""
    inverse = np.linalg.pinv(K[:, measured])
    rest = K.copy()
    rest[:, measured], rest[:, CONSTANT] = 0.0, 0.0
    reading = readings - K[:, CONSTANT]
    x = reading @ inverse.T
    if not np.any(rest):
        return np.asarray(x)
    for _ in range(FIXED_POINT_STEPS):
        beta = functions(block, x, np.zeros_like(x)) if measured == FORCE else functions(block, force, x)
        x = (reading - np.einsum("npb,pb->np", beta, rest)) @ inverse.T
    return np.asarray(x)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Compensator:
    """An instrument as what corrects its readings: blocks of sensors and the coefficients K (n, 15) of each, and what
    biases and scale factors change by per K of temperature (n,), about a reference, °C, where there is one. Lever arms
    and delays, which need the motion, are not in it."""

    accel: Block
    gyro: Block | None
    accel_coefficients: Array
    gyro_coefficients: Array
    slopes: Mapping[str, Array]
    reference: float | None = None

    @staticmethod
    def of(
        blocks: tuple[Block, Block | None],
        models: tuple[SensorModel, SensorModel | None],
        values: Mapping[str, float],
        reference: float | None = None,
    ) -> Compensator:
        """The compensator of the models of accelerometers and gyros and of further parameters by name."""
        accel, gyro = blocks
        instrument = Instrument.of(accel, gyro, {group_name(name) for name in values}, variables=())
        further = np.array([values.get(name, 0.0) for name in instrument.names])
        further[: instrument.linear_count] = 0.0
        coefficients = []
        for block, model in zip(blocks, models, strict=True):
            if block is None or model is None:
                coefficients.append(np.zeros((0, FUNCTIONS)))
                continue
            K = instrument.coefficients(block, further)
            K[:, _measured(block)], K[:, CONSTANT] = model.matrix, K[:, CONSTANT] + model.bias
            coefficients.append(K)
        return Compensator(
            accel=accel,
            gyro=gyro if models[1] is not None else None,
            accel_coefficients=coefficients[0],
            gyro_coefficients=coefficients[1],
            slopes=_slopes(blocks, values),
            reference=reference,
        )

    def force(self, readings: Array, temperature: Array | None = None) -> Array:
        """Specific force (N, 3), m/s², of readings (N, n), SI, at temperatures (N,), °C."""
        readings = self._at_reference(self.accel, self.accel_coefficients, readings, temperature)
        return _solved(self.accel, self.accel_coefficients, FORCE, readings, np.zeros((len(readings), 3)))

    def rate(self, readings: Array, force: Array, temperature: Array | None = None) -> Array:
        """Angular rate (N, 3), rad/s, of readings (N, n), SI, in a specific force (N, 3), at temperatures (N,), °C."""
        assert self.gyro is not None
        readings = self._at_reference(self.gyro, self.gyro_coefficients, readings, temperature)
        return _solved(self.gyro, self.gyro_coefficients, RATE, readings, force)

    def _at_reference(self, block: Block, K: Array, readings: Array, temperature: Array | None) -> Array:
        """Readings as they would be at the reference temperature."""
        bias, scale = self.slopes.get(f"{block.kind}.bias"), self.slopes.get(f"{block.kind}.scale")
        if temperature is None or self.reference is None or bias is None or scale is None:
            return readings
        change = (temperature - self.reference)[:, None]
        size = np.linalg.norm(K[:, _measured(block)], axis=1)
        offset = K[:, CONSTANT]
        return np.asarray(offset + (readings - offset - bias * change) / (1.0 + scale * change / size))


def _slopes(blocks: tuple[Block, Block | None], values: Mapping[str, float]) -> dict[str, Array]:
    """Changes per K (n,) by channel of biases and scale factors, where the values have some."""
    out = {}
    for block in blocks:
        for what in ("bias", "scale"):
            if block is None:
                continue
            out[f"{block.kind}.{what}"] = np.zeros(block.size)
            by_sensor = [values.get(f"{block.kind}.{what}.{sensor}.t1", 0.0) for sensor in block.sensors]
            out[f"{block.kind}.{what}"][block.channels] = by_sensor
    return out if any(np.any(slope) for slope in out.values()) else {}


def _measured(block: Block) -> slice:
    return FORCE if block.kind == "accel" else RATE
