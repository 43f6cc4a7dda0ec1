"""Readings of simulated sensors without white noise, for given forces and rates at times of a session.

The in-run bias is a stationary Gauss–Markov process of standard deviation σ and correlation time τ, sampled in
the middles t_k of the rests,

    β_{k+1} = e^(−Δt/τ) β_k + σ √(1 − e^(−2Δt/τ)) z_{k+1},     β_0 = σ z_0,     Δt = t_{k+1} − t_k

with independent standard normal z. It is constant during a rest and linear during a move, with the mean
(β_k + β_{k+1})/2. With τ = 0 it is held during the move.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tumble.sensors.instrument import readings
from tumble.sensors.model import Block
from tumble.sensors.parameters import Variable
from tumble.simulation.scenario import Scenario
from tumble.simulation.temperature_profile import Climate
from tumble.units import Array

_LEGENDRE = np.polynomial.legendre.leggauss(6)
NODES, WEIGHTS = 0.5 * (_LEGENDRE[0] + 1.0), 0.5 * _LEGENDRE[1]
"""Nodes and weights of Gauss–Legendre sums on 0…1, for means over a sample."""


def harmonics(angle: Array) -> Array:
    """Return 1, cos θ and sin θ (..., 3) of angles (...), rad."""
    return np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)], axis=-1)


def harmonic_coefficients(n: Array, vector: Array) -> Array:
    """Return rows a, b, c (..., 3, 3) with Rᵀ v = a + b cos θ + c sin θ, for the rotation R by θ about a unit vector n
    and a `vector` v: the harmonics of θ times these."""
    along = n * np.sum(n * vector, axis=-1, keepdims=True)
    return np.stack([along, vector - along, -np.cross(n, vector)], axis=-2)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class InRunBias:
    """In-run biases of a block."""

    rests: Array  # (R, 2): start and stop, s
    values: Array  # (R, n), SI
    held: bool  # until the next rest; otherwise linear between rests

    def at(self, when: Array) -> Array:
        """Return the biases (..., n) at times (...), s."""
        if self.held:
            return np.asarray(self.values[np.maximum(np.searchsorted(self.rests[:, 0], when, side="right") - 1, 0)])
        knots = self.rests.ravel()
        return np.stack([np.interp(when, knots, np.repeat(bias, 2)) for bias in self.values.T], axis=-1)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SimulatedBlock:
    """A block of sensors with true errors."""

    block: Block
    coefficients: Array  # K (n, 15), at the mean time of the rests and at the reference temperature
    changes: Mapping[Variable, Array]  # (n, 15): changes of K per unit of time and of functions of temperature
    climate: Climate | None
    middle: float  # mean time of the rests, s
    arms: Array  # (n, 3): lever arms, m
    white: float  # density of the white noise, SI/√Hz
    instability: float  # standard deviation of the in-run bias, SI
    instability_time: float  # its correlation time, s

    @staticmethod
    def of(block: Block, scenario: Scenario, middle: float) -> SimulatedBlock:
        """Return a block of a scenario; `middle` is the mean time of the rests, s."""
        noise, instrument, values = scenario.setup.noise, scenario.instrument, scenario.values
        accel = block.kind == "accel"
        changes = {variable: instrument.change(block, values, variable) for _, _, variable in instrument.changes}
        return SimulatedBlock(
            block=block,
            coefficients=instrument.coefficients(block, values),
            changes={variable: change for variable, change in changes.items() if np.any(change)},
            climate=scenario.climate,
            middle=middle,
            arms=instrument.levers(values) if accel else np.zeros((block.size, 3)),
            white=noise.accel_white if accel else noise.gyro_white,
            instability=noise.accel_instability if accel else noise.gyro_instability,
            instability_time=noise.instability_time,
        )

    def bias(self, normal: Array, rests: Array) -> InRunBias:
        """Return the in-run biases at rests (R, 2) from standard normal numbers (R, n).

        With a correlation time, they are about their mean over the rests, which is the parameter."""
        values = self.instability * normal
        if self.instability_time > 0.0:
            ρ = np.exp(-np.diff(rests.mean(axis=1)) / self.instability_time)
            for k, ρ_k in enumerate(ρ):
                values[k + 1] = ρ_k * values[k] + np.sqrt(1.0 - ρ_k**2) * values[k + 1]
            values -= values.mean(axis=0)
        return InRunBias(rests=rests, values=values, held=self.instability_time == 0.0)

    def read(self, force: Array, rate: Array, when: Array, seconds: Array | None = None) -> Array:
        """Return readings (N, n) without white noise.

        They are for specific forces (N, 3) of the body, or (N, n, 3) at each sensor, and rates (N, 3) of the body, at
        times `when` (N,), s, or as means over intervals of `seconds` (N,) about these."""
        out = readings(self.block, self.coefficients, force, rate)
        if not self.changes:
            return out
        now: dict[Variable, Array] = {"time": (when - self.middle)[:, None]}
        if self.climate is not None and seconds is None:
            now |= self.climate.variables(when, self.block)
        elif self.climate is not None and seconds is not None:
            now |= self.climate.means(when - 0.5 * seconds, when + 0.5 * seconds, self.block)
        for variable, change in self.changes.items():
            out = out + now[variable] * readings(self.block, change, force, rate)
        return out
