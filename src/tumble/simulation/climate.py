"""The temperatures of a simulated session: what the thermometers read, and what the sensors have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tumble.reduction.rests.thermometer import Thermometers, followed
from tumble.sensors.parameters import Variable
from tumble.units import Array, IntArray

FINE = 0.1  # s, of the temperatures of the sensors
NODES = 128
"""Temperatures of which the mean over a rest is taken."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Climate:
    """Temperatures (·, T), K, of the thermometers at times (·,), s, from the start of the session, straight between
    them; the temperature, K, at which the true parameters have their values; and the `lag` of the sensors behind their
    thermometers, s. `span`, the middle and half the range, K, (T,) or of all, are those of a hysteresis."""

    time: Array
    kelvin: Array
    reference: float
    lag: float = 0.0
    span: tuple[float | Array, float | Array] = (0.0, 1.0)

    def variables(self, time: Array, thermometer: IntArray) -> dict[Variable, Array]:
        """What parameters of sensors with these thermometers (n,) change with at times (N,), s: (N, n)."""
        sensors = self.sensors(time)
        x = (sensors - self.span[0]) / self.span[1]
        warmer = sensors - self.reference
        came = self.record.direction(_first(time), time)
        hysteresis = came * np.maximum(1.0 - x**2, 0.0)
        every: dict[Variable, Array] = {"temperature": warmer, "temperature²": warmer**2, "hysteresis": hysteresis}
        return {variable: values[:, thermometer] for variable, values in every.items()}

    def means(self, start: Array, stop: Array, thermometer: IntArray) -> dict[Variable, Array]:
        """The means of the same from start to stop (N,), s."""
        nodes = start[:, None] + (stop - start)[:, None] * (np.arange(NODES) + 0.5) / NODES
        every = self.variables(nodes.ravel(), thermometer)
        return {variable: values.reshape(*nodes.shape, -1).mean(axis=1) for variable, values in every.items()}

    def thermometers(self, time: Array) -> Array:
        """Temperatures (N, T), K, that the thermometers read at times (N,), s."""
        return np.column_stack([np.interp(time, self.time, kelvin) for kelvin in self.kelvin.T])

    def sensors(self, time: Array) -> Array:
        """Temperatures (N, T), K, of the sensors with each thermometer at times (N,), s."""
        fine, kelvin = self._sensors
        return np.column_stack([np.interp(time, fine, each) for each in kelvin])

    @cached_property
    def _sensors(self) -> tuple[Array, Array]:
        """Times, s, and temperatures (T, ·), K, of the sensors throughout."""
        fine = np.arange(self.time[0], self.time[-1] + FINE, FINE)
        return fine, np.array([followed(kelvin, FINE, self.lag) for kelvin in self.thermometers(fine).T])

    @cached_property
    def record(self) -> Thermometers:
        """What the thermometers recorded."""
        records: Mapping[int, tuple[Array, Array]] = {0: (self.time, self.kelvin)}
        return Thermometers.of(records)


def _first(time: Array) -> IntArray:
    """The number of the file of every time: the first."""
    return np.zeros(len(time), dtype=np.int64)
