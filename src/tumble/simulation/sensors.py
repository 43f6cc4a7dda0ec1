"""Simulated sensors at work: what a block reads, without its white noise, in forces and rates at times of a session.

In-run, a bias changes by a stationary Gauss–Markov process of standard deviation σ and correlation time τ, sampled in
the middles t_k of the rests,

    β_{k+1} = e^(−Δt/τ) β_k + σ √(1 − e^(−2Δt/τ)) z_{k+1},     β_0 = σ z_0,     Δt = t_{k+1} − t_k

with independent standard normal z. It stays so for the rest and goes straight to the next through the move, whose mean
is (β_k + β_{k+1})/2. With τ = 0 it is held through the move.
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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class InRunBias:
    """Changes (R, n), SI, of the biases of a block at rests (R, 2) from start to stop, s, each `held` until the next
    rest, or else going there linearly."""

    rests: Array
    values: Array
    held: bool

    def at(self, when: Array) -> Array:
        """Change (..., n) at times (...), s."""
        if self.held:
            return np.asarray(self.values[np.maximum(np.searchsorted(self.rests[:, 0], when, side="right") - 1, 0)])
        knots = self.rests.ravel()
        return np.stack([np.interp(when, knots, np.repeat(bias, 2)) for bias in self.values.T], axis=-1)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SimulatedBlock:
    """A block of sensors with true errors: coefficients K (n, 15) at the mean time of the rests, `middle`, and at the
    reference temperature; changes (n, 15) of K per second, and with what goes with the temperature of the `climate`;
    lever arms (n, 3), m; the density of the white noise, SI/√Hz; and the standard deviation of the in-run bias, SI,
    with its correlation time, s."""

    block: Block
    coefficients: Array
    changes: Mapping[Variable, Array]
    climate: Climate | None
    middle: float
    arms: Array
    white: float
    instability: float
    instability_time: float

    @staticmethod
    def of(block: Block, scenario: Scenario, middle: float) -> SimulatedBlock:
        """A block of a scenario."""
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
        """In-run change of the biases in a session by standard normal numbers (R, n), at rests (R, 2) from start to
        stop, s. A process that lasts is taken less its mean over the rests, which is the parameter."""
        values = self.instability * normal
        if self.instability_time > 0.0:
            ρ = np.exp(-np.diff(rests.mean(axis=1)) / self.instability_time)
            for k, alike in enumerate(ρ):
                values[k + 1] = alike * values[k] + np.sqrt(1.0 - alike**2) * values[k + 1]
            values -= values.mean(axis=0)
        return InRunBias(rests=rests, values=values, held=self.instability_time == 0.0)

    def read(self, force: Array, rate: Array, when: Array, seconds: Array | None = None) -> Array:
        """Readings (N, n) without white noise in specific forces (N, 3) of the body, or (N, n, 3) at each sensor, and
        rates (N, 3) of the body, at times (N,) from the start of the session, s, with the temperatures of these times,
        or means over intervals of so many `seconds` (N,) about them."""
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
