"""Records of thermometers, and the temperatures of bodies that follow them with a time constant.

The record is linear between two readings. A body that follows it with the time constant λ, λ ẏ = T − y, then has
exactly

    y₁ = a y₀ + (T₁ − a T₀) − s λ (1 − a),    a = e^{−h/λ},    s = (T₁ − T₀)/h

and has the temperature of the thermometer when a file begins. With a negative λ the thermometer follows the body, whose
temperature is approximated by 2 T − y(−λ).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from tumble.reduction import kernels as _kernels
from tumble.units import Array, IntArray

STEP = 1.0  # s between the temperatures of a stored record
MOVED = 0.5  # K: a smaller change of temperature has no direction


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Warmth:
    """Temperatures of T thermometers over N time spans.

    `kelvin`, `variance`: means (N, T), K, and variances (N, T), K². `hysteresis`: means (N, T) of sgn(Ṫ)(1 − x²), to
    which a hysteresis is proportional, with x from −1 to 1 over the range of the thermometer in the file."""

    kelvin: Array
    variance: Array
    hysteresis: Array

    def __getitem__(self, some: slice) -> Warmth:
        return Warmth(kelvin=self.kelvin[some], variance=self.variance[some], hysteresis=self.hysteresis[some])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Thermometers:
    """Records of T thermometers: by file, the start, s, and the temperatures (K, T), K, every STEP from it."""

    files: Mapping[int, tuple[float, Array]]

    _directions: dict[int, Array] = field(default_factory=dict, repr=False)
    """Directions (K, T) at every step, by file, computed on demand."""

    @staticmethod
    def of(records: Mapping[int, tuple[Array, Array]]) -> Thermometers:
        """Return records from times (K,), s, and temperatures (K, T), K, by file."""
        files = {}
        for file, (time, kelvin) in records.items():
            steps = time[0] + STEP * np.arange(max(int(np.ceil((time[-1] - time[0]) / STEP)), 1) + 1)
            files[file] = float(time[0]), np.column_stack([np.interp(steps, time, record) for record in kelvin.T])
        return Thermometers(files=files)

    @property
    def count(self) -> int:
        """Number of thermometers."""
        _, kelvin = next(iter(self.files.values()))
        return int(kelvin.shape[1])

    def means(self, file: IntArray, start: Array, stop: Array, lag: float = 0.0) -> Warmth:
        """Return the temperatures, from start to stop (N,), s, in files (N,), of bodies that follow the thermometers
        with a time constant `lag`, s. Spans shorter than STEP are extended about their middle."""
        half = 0.5 * np.maximum(stop - start, STEP)
        early, late = 0.5 * (start + stop) - half, 0.5 * (start + stop) + half
        out, middle = np.empty((3, self.count, len(start))), np.empty((self.count, len(start)))
        for number, (begin, kelvin) in self.files.items():
            in_file = file == number
            for t, record in enumerate(kelvin.T):
                reach = 0.5 * float(np.ptp(record))
                middle[t, in_file] = here = 0.5 * float(record.min() + record.max())
                off = followed(record, STEP, lag) - here
                inner = np.maximum(1.0 - (off / max(reach, MOVED)) ** 2, 0.0)
                series = np.stack([off, off**2, self._direction(number)[:, t] * inner])
                integral = _integral(series, late[in_file] - begin) - _integral(series, early[in_file] - begin)
                out[:, t, in_file] = integral / (2.0 * half[in_file])
        mean, square, hysteresis = np.swapaxes(out, 1, 2)
        return Warmth(kelvin=mean + middle.T, variance=np.maximum(square - mean**2, 0.0), hysteresis=hysteresis)

    def _direction(self, file: int) -> Array:
        """Return the directions (K, T), 1, −1 or 0, at every step of a file, which change when the temperature has
        returned by more than MOVED from its extreme."""
        if file not in self._directions:
            self._directions[file] = out = np.zeros(self.files[file][1].shape)
            for t, record in enumerate(self.files[file][1].T.tolist()):
                low, high, direction = record[0], record[0], 0.0
                for i, now in enumerate(record):
                    low, high = min(low, now), max(high, now)
                    if direction <= 0.0 and now > low + MOVED:
                        direction, high = 1.0, now
                    elif direction >= 0.0 and now < high - MOVED:
                        direction, low = -1.0, now
                    out[i, t] = direction
        return self._directions[file]

    def direction(self, file: IntArray, time: Array) -> Array:
        """Return whether the temperatures (N, T) at times (N,) of files (N,) came from below, 1, or above, −1; 0 before
        a change by MOVED."""
        out = np.zeros((len(time), self.count))
        for number, (start, kelvin) in self.files.items():
            in_file = file == number
            steps = np.clip((time[in_file] - start) / STEP, 0, len(kelvin) - 1).astype(np.int64)
            out[in_file] = self._direction(number)[steps]
        return out


def _integral(series: Array, at: Array) -> Array:
    """Return the integrals (q, N) up to times (N,), s after the first value, of series (q, K) every STEP, which are
    linear between values and constant beyond the ends."""
    whole = np.zeros_like(series)
    np.cumsum(0.5 * STEP * (series[:, 1:] + series[:, :-1]), axis=1, out=whole[:, 1:])
    inside = np.clip(at, 0.0, STEP * (series.shape[1] - 1))
    step = np.minimum((inside / STEP).astype(np.int64), series.shape[1] - 2)
    into, here = inside - STEP * step, series[:, step]
    there = here + into / STEP * (series[:, step + 1] - here)
    return np.asarray(whole[:, step] + 0.5 * into * (here + there) + (at - inside) * there)


def followed(kelvin: Array, step: float, lag: float, first: float | None = None) -> Array:
    """Return the temperatures (K,) of a body that follows temperatures (K,), every `step` s, with a time constant
    `lag`, s, from a `first` temperature on, by default that of the thermometer."""
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
