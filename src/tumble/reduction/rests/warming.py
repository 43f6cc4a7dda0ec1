"""Readings at rest without the change of temperature within each rest.

A sensor that gets warmer drifts, and the drift would pass for noise of a long memory. It is none in the estimate, where
parameters follow the temperature. So the part that depends on the temperature alike in all rests is subtracted, block
by block,

    y − ȳ = (a + c m)(T − T̄) + (b + d m)((T − T₀)² − mean),    m = ȳ less its mean over the rests,

with a and b of biases, c and d of scale factors: four numbers a channel, so that slow noise of the rests remains. Over
a range of temperatures T is that of the sensors, which follow the thermometer with the lag of the least residual: where
a ramp begins or bends they fall behind it, which is no noise either.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tumble.units import Array, IntArray

WARMED = 0.1
"""K: where no rest warms or cools by more, nothing is subtracted."""
OVER_TEMPERATURE = 10.0
"""K: where the rests span less, no lag is sought."""
LAGS = np.array([-200.0, -100.0, -50.0, -25.0, 0.0, 25.0, 50.0, 100.0, 200.0, 400.0, 800.0])
CLOSER, BETWEEN = 4, 7
"""The best of LAGS, s, is refined CLOSER times, each time among BETWEEN values between its neighbours."""

KelvinAtLag = Callable[[float], Array]
"""From a lag, s, to the temperatures (K, T), K, at the blocks of all rests of bodies that follow the thermometers."""


def without_warming(series: Sequence[Array], kelvin: KelvinAtLag | None, thermometer: IntArray) -> list[Array]:
    """Subtract from the block means (K, c) of every rest what depends on the temperature within it. `kelvin` is
    None without thermometers; `thermometer` (c,) is that of each channel."""
    if kelvin is None or not len(thermometer):
        return list(series)
    read = np.split(kelvin(0.0), np.cumsum([len(each) for each in series])[:-1])
    if max(warming_of(of_rest) for of_rest in read) < WARMED:
        return list(series)
    with_one = {t: _Rests.of([each[:, thermometer == t] for each in series]) for t in np.unique(thermometer).tolist()}

    def explained(lag: float) -> float:
        """The fall of the sum of squares with a lag, s."""
        warm = kelvin(lag)
        return sum(rests.explained(warm[:, t]) for t, rests in with_one.items())

    sought = np.ptp([each.mean(axis=0) for each in read], axis=0).max() >= OVER_TEMPERATURE
    lags, best = (LAGS, 0) if sought else (np.zeros(1), 0)
    for closer in range(1 + CLOSER if sought else 0):
        if closer:
            lags = np.linspace(lags[max(best - 1, 0)], lags[min(best + 1, len(lags) - 1)], BETWEEN)
        best = int(np.argmax([explained(lag) for lag in lags.tolist()]))
    warm = kelvin(float(lags[best]))
    out = [np.empty_like(each) for each in series]
    for t, rests in with_one.items():
        for whole, quiet in zip(out, rests.without(warm[:, t]), strict=True):
            whole[:, thermometer == t] = quiet
    return out


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Rests:
    """Block means of N rests, of the c channels of one thermometer.

    `means`, `off`: means of the rests (c, N), and the differences (c, K) of the blocks from these. `first`,
    `count`: first block and number of blocks (N,) of each rest. `noise`: standard deviation (c,) of the differences
    from block to block."""

    means: Array
    off: Array
    first: IntArray
    count: IntArray
    noise: Array

    @staticmethod
    def of(series: Sequence[Array]) -> _Rests:
        means, count = np.array([each.mean(axis=0) for each in series]), np.array([len(each) for each in series])
        off = np.concatenate([each - mean for each, mean in zip(series, means, strict=True)])
        noise = np.concatenate([np.diff(each, axis=0) for each in series]).std(axis=0)
        return _Rests(
            means=means.T,
            off=np.ascontiguousarray(off.T),
            first=np.cumsum(count) - count,
            count=count,
            noise=np.where(noise > 0.0, noise, 1.0),
        )

    def explained(self, kelvin: Array) -> float:
        """The fall of the sum of squares, in units of the noise."""
        _, coefficients, along = self._fitted(kelvin)
        return float(((coefficients * along).sum(axis=1) / self.noise**2).sum())

    def without(self, kelvin: Array) -> list[Array]:
        """Block means (K, c) of the rests without the part that depends on the temperature."""
        columns, coefficients, _ = self._fitted(kelvin)
        of_bias, of_scale = coefficients[:, :2, None], coefficients[:, 2:, None]
        slopes = np.repeat(of_bias + self._apart[:, None] * of_scale, self.count, axis=2)
        quiet = self.off - np.einsum("jk,cjk->ck", columns, slopes) + np.repeat(self.means, self.count, axis=1)
        return np.split(quiet.T, self.first[1:])

    def _fitted(self, kelvin: Array) -> tuple[Array, Array, Array]:
        """Solve the normal equations, their columns scaled to length 1: T and its square (2, K) about their means in
        each rest, their coefficients (c, 4), and the products of the columns with the readings (c, 4)."""
        warmer = kelvin - self._mean(kelvin).mean()
        columns = np.stack([warmer, warmer**2])
        columns -= np.repeat(self._mean(columns), self.count, axis=1)
        square = np.add.reduceat(columns[:, None] * columns, self.first, axis=2)
        with_read = np.add.reduceat(columns[:, None] * self.off, self.first, axis=2)
        powers = self._apart ** np.arange(3)[:, None, None]
        one, first, second = np.einsum("dcn,ijn->dcij", powers, square)
        normal = np.concatenate([np.concatenate([one, first], axis=2), np.concatenate([first, second], axis=2)], axis=1)
        along = np.einsum("dcn,icn->cdi", powers[:2], with_read).reshape(-1, 4)
        size = np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2), 1e-300))
        inverse = np.linalg.pinv(normal / (size[:, :, None] * size[:, None, :]), rcond=1e-12, hermitian=True)
        return columns, np.einsum("cij,cj->ci", inverse, along / size) / size, along

    @property
    def _apart(self) -> Array:
        """The means (c, N) about their mean over the rests."""
        return np.asarray(self.means - self.means.mean(axis=1, keepdims=True))

    def _mean(self, values: Array) -> Array:
        """Means (·, N) over the rests of values (·, K)."""
        return np.asarray(np.add.reduceat(values, self.first, axis=-1) / self.count)


def warming_of(kelvin: Array) -> float:
    """The largest change of temperatures (K, T) from the first to the last tenth."""
    tenth = max(len(kelvin) // 10, 1)
    return float(np.abs(kelvin[-tenth:].mean(axis=0) - kelvin[:tenth].mean(axis=0)).max())
