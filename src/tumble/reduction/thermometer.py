"""The record of a thermometer, and the temperature of what follows it with a time constant.

Between two readings the record is straight. What follows it with the time constant λ, λ ẏ = T − y, is then exact:

    y₁ = a y₀ + (T₁ − a T₀) − s λ (1 − a),    a = e^{−h/λ},    s = (T₁ − T₀)/h

and as warm as the thermometer where a file begins. A negative λ is what the thermometer follows: 2 T − y(−λ).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tumble.reduction import kernels as _kernels
from tumble.units import Array, IntArray

STEP = 1.0
"""s between the temperatures that are kept of a record."""
MOVED = 0.5
"""K: a change of temperature by less has no direction."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Thermometer:
    """Temperatures, K, every STEP from a start, s, by file: (start, temperatures)."""

    files: Mapping[int, tuple[float, Array]]

    @staticmethod
    def of(records: Mapping[int, tuple[Array, Array]]) -> Thermometer:
        """The record of times (K,), s, and temperatures (K,), K, by file."""
        return Thermometer(files={file: _every_step(*record) for file, record in records.items()})

    def at(self, file: IntArray, time: Array, lag: float = 0.0) -> Array:
        """Temperatures (N,), K, at times (N,) of files (N,) of what follows the thermometer with a time constant, s."""
        out = np.empty(len(time))
        for number, (start, kelvin) in self.files.items():
            of = file == number
            out[of] = np.interp(time[of], start + STEP * np.arange(len(kelvin)), followed(kelvin, STEP, lag))
        return out

    def direction(self, file: IntArray, time: Array) -> Array:
        """Whether the temperature at times (N,) of files (N,) came from below, 1, or from above, −1; 0 where it was the
        same, to MOVED, since the file began."""
        out = np.zeros(len(time))
        for i, (number, when, now) in enumerate(zip(file, time, self.at(file, time), strict=True)):
            start, kelvin = self.files[int(number)]
            before = kelvin[: max(int((when - start) / STEP) + 1, 1)] - now
            apart = np.flatnonzero(np.abs(before) > MOVED)
            out[i] = -np.sign(before[apart[-1]]) if len(apart) else 0.0
        return out


def followed(kelvin: Array, step: float, lag: float, first: float | None = None) -> Array:
    """Temperatures (K,) of what follows temperatures (K,) every `step` s with a time constant `lag`, s; `first` is what
    it has with the first of them, the same where None."""
    if lag == 0.0 or len(kelvin) == 0:
        return kelvin
    if lag < 0.0:
        return np.asarray(2.0 * kelvin - followed(kelvin, step, -lag))
    a = float(np.exp(-step / lag))
    driven = np.empty(len(kelvin))
    driven[0] = kelvin[0] if first is None else first
    driven[1:] = kelvin[1:] - a * kelvin[:-1] - np.diff(kelvin) / step * lag * (1.0 - a)
    _kernels.follow(driven, a)
    return driven


def _every_step(time: Array, kelvin: Array) -> tuple[float, Array]:
    count = max(int(np.ceil((time[-1] - time[0]) / STEP)), 1) + 1
    return float(time[0]), np.interp(time[0] + STEP * np.arange(count), time, kelvin)
