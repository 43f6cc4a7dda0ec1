"""The temperature of a simulated session: what the thermometer reads, and what the sensors have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tumble.reduction.thermometer import Thermometer, followed
from tumble.sensors.parameters import Variable
from tumble.units import Array, IntArray

FINE = 0.1  # s, of the temperatures of the sensors
NODES = 128
"""Temperatures of which the mean over a rest is taken."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Climate:
    """Temperatures, K, of the thermometer at times (·,), s, from the start of the session, straight between them; the
    temperature, K, at which the true parameters have their values; and the `lag` of the sensors, s. `span`, the middle
    and half the range, K, are those of a hysteresis."""

    time: Array
    kelvin: Array
    reference: float
    lag: float = 0.0
    span: tuple[float, float] = (0.0, 1.0)

    def variables(self, time: Array) -> dict[Variable, Array]:
        """What parameters change with at times (N,), s."""
        sensors = self.sensors(time)
        x = (sensors - self.span[0]) / self.span[1]
        warmer = sensors - self.reference
        came = self.record.direction(_first(time), time)
        hysteresis = came * np.maximum(1.0 - x**2, 0.0)
        return {"temperature": warmer, "temperature²": warmer**2, "hysteresis": hysteresis}

    def means(self, start: Array, stop: Array) -> dict[Variable, Array]:
        """The means of the same from start to stop (N,), s."""
        nodes = start[:, None] + (stop - start)[:, None] * (np.arange(NODES) + 0.5) / NODES
        every = self.variables(nodes.ravel())
        return {variable: values.reshape(nodes.shape).mean(axis=1) for variable, values in every.items()}

    def thermometer(self, time: Array) -> Array:
        """Temperatures (N,), K, that the thermometer reads at times (N,), s."""
        return np.interp(time, self.time, self.kelvin)

    def sensors(self, time: Array) -> Array:
        """Temperatures (N,), K, of the sensors at times (N,), s."""
        return np.interp(time, *self._sensors)

    @cached_property
    def _sensors(self) -> tuple[Array, Array]:
        """Times, s, and temperatures, K, of the sensors throughout."""
        fine = np.arange(self.time[0], self.time[-1] + FINE, FINE)
        return fine, followed(self.thermometer(fine), FINE, self.lag)

    @cached_property
    def record(self) -> Thermometer:
        """What the thermometer recorded."""
        records: Mapping[int, tuple[Array, Array]] = {0: (self.time, self.kelvin)}
        return Thermometer.of(records)


def _first(time: Array) -> IntArray:
    """The number of the file of every time: the first."""
    return np.zeros(len(time), dtype=np.int64)
