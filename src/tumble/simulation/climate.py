"""The temperature of a simulated session: what the thermometer reads, and what parameters change with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tumble.sensors.parameters import Variable
from tumble.units import Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Climate:
    """Temperatures, K, of the thermometer at times (·,), s, from the start of the session, straight between them; and
    the temperature, K, at which the true parameters have their values."""

    time: Array
    kelvin: Array
    reference: float

    def variables(self, time: Array) -> dict[Variable, Array]:
        """What parameters change with at times (N,), s."""
        warmer = self.thermometer(time) - self.reference
        return {"temperature": warmer, "temperature²": warmer**2}

    def thermometer(self, time: Array) -> Array:
        """Temperatures (N,), K, that the thermometer reads at times (N,), s."""
        return np.interp(time, self.time, self.kelvin)
