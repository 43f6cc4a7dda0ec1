"""Inverse of the instrument model: specific force and rate of the body from readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from tumble.rotation import left_inverse
from tumble.sensors.fixed_point import (
    ACROSS,
    ALONG,
    AXIS,
    CHANGES,
    INVERSE,
    LEVER,
    REFERENCE,
    SENSITIVITY,
    WIDTH,
    fixed_point,
)
from tumble.sensors.instrument import Instrument, is_linear, measured_by
from tumble.sensors.model import Block, SensorModel
from tumble.sensors.parameters import (
    CONSTANT,
    FORCE,
    FUNCTIONS,
    OVER_TEMPERATURE,
    OWN_CUBE,
    OWN_SIZE,
    PRODUCTS,
    RATE,
    THERMAL,
    group_name,
)
from tumble.units import Array

FIXED_POINT_STEPS = 5  # after the linear one; each reduces the error by 1e-3 to 1e-2, the relative nonlinearity


def specific_force(instrument: Instrument, values: Array, readings: Array) -> Array:
    """Return the specific force (N, 3), m/s², in the body from accelerometer readings (N, n), SI."""
    return Solver.of(instrument.accel, instrument.coefficients(instrument.accel, values)).solved(readings)


def angular_rate(instrument: Instrument, values: Array, readings: Array, force: Array) -> Array:
    """Return the angular rate (N, 3), rad/s, in the body from gyro readings (N, n), SI, and the specific force (N,
    3)."""
    assert instrument.gyro is not None
    return Solver.of(instrument.gyro, instrument.coefficients(instrument.gyro, values)).solved(readings, force)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Solver:
    """A block of sensors in the form of the compiled loops.

    `sheet` (n, WIDTH): coefficients of its sensors, in the columns that fixed_point.pyx describes. `steps`: number of
    iterations x ← S⁻¹ ((ŷ − b − nonlinear terms) / s), one for linear sensors. `of_force`: whether the measured vector
    x is the specific force. `feels`: whether the sensors also respond to the other vector, rate or specific force."""

    sheet: Array
    steps: int
    of_force: bool
    feels: bool

    @staticmethod
    def of(block: Block, K: Array, thermal: Array | None = None, levers: Array | None = None) -> Solver:
        """Return the solver of a block with coefficients K (n, 15).

        `thermal` (n, 7): reference temperatures, °C, and changes of biases and of scale factors per K, K² and K³.
        `levers` (n, 3): lever arms, m."""
        of_force = block.kind == "accel"
        sensitivity = K[:, measured_by(block)]
        sheet = np.zeros((block.size, WIDTH))
        sheet[:, :FUNCTIONS] = K
        sheet[:, measured_by(block)] = 0.0  # what remains of K is subtracted from readings
        sheet[:, INVERSE:AXIS] = left_inverse(sensitivity).T
        sheet[:, AXIS:REFERENCE] = block.axes
        if thermal is not None:
            sheet[:, REFERENCE:LEVER] = thermal
            sheet[:, CHANGES + len(THERMAL) : LEVER] /= np.linalg.norm(sensitivity, axis=1)[:, None]
        if levers is not None:
            sheet[:, LEVER:SENSITIVITY] = levers
            sheet[:, SENSITIVITY:ACROSS] = sensitivity
            sheet[:, ACROSS:ALONG] = np.cross(levers, sensitivity)
            sheet[:, ALONG] = np.sum(levers * sensitivity, axis=1)
        along_axes = bool(np.any(sheet[:, OWN_SIZE : OWN_CUBE + 1]))
        products = bool(np.any(sheet[:, PRODUCTS]))
        feels = bool(np.any(sheet[:, RATE if of_force else FORCE])) or (products and not of_force)
        linear = not along_axes and not (products and of_force)
        return Solver(sheet=sheet, steps=1 if linear else 1 + FIXED_POINT_STEPS, of_force=of_force, feels=feels)

    def solved(self, readings: Array, other: Array | None = None, temperature: Array | None = None) -> Array:
        """Return the measured vector (N, 3) from readings (N, n), the other vector, (N, 3) or (3,), by default zero,
        and temperatures, (N, n) or (N, 1), °C, by default the reference."""
        sheet = self.sheet
        count, n = readings.shape
        if temperature is None and self.steps == 1 and not self.feels:
            return np.asarray((readings - sheet[:, CONSTANT]) @ sheet[:, INVERSE:AXIS])
        celsius = sheet[:, REFERENCE] if temperature is None else temperature
        celsius = np.broadcast_to(celsius, (count, n))
        other_vector = np.broadcast_to(np.zeros(3) if other is None else other, (count, 3))
        return fixed_point(
            readings, celsius, np.arange(n), other_vector, sheet, self.steps, of_force=self.of_force, feels=self.feels
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Compensator:
    """An instrument as a corrector of its readings.

    `accel_coefficients`, `gyro_coefficients`: K (n, 15) of each block. `polynomials`: changes (n, 3) of "accel.bias",
    "gyro.scale" and so on per K, K² and K³ of temperature, about the `references` (n,), °C, by kind; empty without any.
    `lags`: time constants, s, with which the sensors of a kind follow their thermometers. `levers` (n, 3), m, need the
    motion: `tumble.use.corrector`. `delays`: of the accelerometers (n,), s, which are not corrected."""

    accel: Block
    gyro: Block | None
    accel_coefficients: Array
    gyro_coefficients: Array
    polynomials: Mapping[str, Array]
    levers: Array
    delays: Array
    references: Mapping[str, Array] = field(default_factory=dict)
    lags: Mapping[str, float] = field(default_factory=dict)

    @staticmethod
    def of(
        blocks: tuple[Block, Block | None],
        models: tuple[SensorModel, SensorModel | None],
        values: Mapping[str, float],
        references: Mapping[str, Array],
    ) -> Compensator:
        """Return the compensator of the models of accelerometers and gyros, and of further parameters by name."""
        accel, gyro = blocks
        instrument = Instrument.of(accel, gyro, {group_name(name) for name in values}, variables=())
        further = np.array([values.get(name, 0.0) for name in instrument.names])
        further[: instrument.linear_count] = 0.0
        coefficients = []
        for block, model in zip(blocks, models, strict=True):
            K = np.zeros((0, FUNCTIONS))
            if block is not None and model is not None:
                K = instrument.coefficients(block, further).copy()
                K[:, measured_by(block)] = model.matrix
                K[:, CONSTANT] += model.bias
            coefficients.append(K)
        return Compensator(
            accel=accel,
            gyro=gyro if models[1] is not None else None,
            accel_coefficients=coefficients[0],
            gyro_coefficients=coefficients[1],
            polynomials=_changes(blocks, values),
            levers=instrument.levers(further),
            delays=instrument.delays(further),
            references=references,
            lags={kind: values[f"{kind}.lag"] for kind in ("accel", "gyro") if f"{kind}.lag" in values},
        )

    @property
    def linear(self) -> bool:
        """Whether matrix and bias of each kind are the whole model, at any temperature."""
        return not self.warm and all(
            block is None or is_linear(block, K) for block, K in map(self.sensors, ("accel", "gyro"))
        )

    @property
    def warm(self) -> bool:
        """Whether anything changes with temperature."""
        return bool(self.polynomials)

    @property
    def several_thermometers(self) -> bool:
        """Whether the sensors have different thermometers."""
        blocks = (self.accel, self.gyro)
        return len({int(t) for block in blocks if block is not None for t in block.thermometer}) > 1

    def sensors(self, kind: str) -> tuple[Block | None, Array]:
        """Return the sensors of a kind, None without any, and their coefficients (n, 15)."""
        return (self.accel, self.accel_coefficients) if kind == "accel" else (self.gyro, self.gyro_coefficients)

    def model(self, kind: str, celsius: float | None = None) -> SensorModel:
        """Return matrix and bias of a kind of sensors at a temperature of all its thermometers, °C, by default the
        reference. A change of scale factor changes the length of its row."""
        block, K = self.sensors(kind)
        assert block is not None
        matrix, bias = K[:, measured_by(block)], K[:, CONSTANT]
        if celsius is None:
            return SensorModel(matrix=matrix, bias=bias)
        warmer = celsius - self.reference(kind)
        powers = np.column_stack([warmer, warmer**2, warmer**3])
        bias_change, scale_change = ((self.changes(kind, what) * powers).sum(axis=1) for what in ("bias", "scale"))
        longer = 1.0 + scale_change / np.linalg.norm(matrix, axis=1)
        return SensorModel(matrix=longer[:, None] * matrix, bias=bias + bias_change)

    def reference(self, kind: str) -> Array:
        """Return the reference temperatures (n,), °C, of a kind of sensors; zero if nothing changes with
        temperature."""
        return np.asarray(self.references.get(kind, np.zeros(len(self.sensors(kind)[1]))))

    def changes(self, kind: str, what: str) -> Array:
        """Return the changes (n, 3) of "bias" or "scale" of a kind of sensors, per K, K² and K³."""
        nothing = np.zeros((len(self.sensors(kind)[1]), len(OVER_TEMPERATURE)))
        return np.asarray(self.polynomials.get(f"{kind}.{what}", nothing))

    @cached_property
    def solvers(self) -> dict[str, Solver]:
        """Solver of each kind of sensors, for the specific force or for the rate."""
        out: dict[str, Solver] = {}
        for block, K in map(self.sensors, ("accel", "gyro")):
            if block is not None:
                changes = (self.changes(block.kind, what) for what in ("bias", "scale"))
                thermal = np.column_stack([self.reference(block.kind), *changes]) if self._is_thermal(block) else None
                out[block.kind] = Solver.of(block, K, thermal, self.levers if block.kind == "accel" else None)
        return out

    def force(self, readings: Array, temperature: Array | None = None) -> Array:
        """Return the specific force (N, 3), m/s², from readings (N, n), SI, at temperatures (N, n) or (N, 1), °C, which
        may be missing if they have no effect."""
        return self.solvers["accel"].solved(readings, None, temperature if self._is_thermal(self.accel) else None)

    def rate(self, readings: Array, force: Array, temperature: Array | None = None) -> Array:
        """Return the rate (N, 3), rad/s, from readings (N, n), SI, in a specific force (N, 3), at temperatures
        likewise."""
        assert self.gyro is not None
        return self.solvers["gyro"].solved(readings, force, temperature if self._is_thermal(self.gyro) else None)

    def _is_thermal(self, block: Block) -> bool:
        """Whether readings of these sensors change with temperature."""
        return self.warm and block.kind in self.references


def _changes(blocks: tuple[Block, Block | None], values: Mapping[str, float]) -> dict[str, Array]:
    """Return the changes (n, 3) by channel of biases and scale factors per K, K² and K³, empty without any."""
    out = {}
    for block in filter(None, blocks):
        for what in ("bias", "scale"):
            out[f"{block.kind}.{what}"] = change = np.zeros((block.size, len(OVER_TEMPERATURE)))
            change[block.channels] = [
                [values.get(f"{block.kind}.{what}.{s}.{ending}", 0.0) for ending in OVER_TEMPERATURE]
                for s in block.sensors
            ]
    return out if any(np.any(change) for change in out.values()) else {}
