"""Readings at rest without the effect of temperature changes within each rest.

A sensor that warms up drifts, and the drift would count as noise with a long memory. In the estimate, parameters follow
the temperature. The temperature dependence common to all rests is therefore subtracted from the blocks,

    y − ȳ = (a + c m)(T − T̄) + (b + d m)((T − T₀)² − mean),    m = ȳ less its mean over the rests,

with a and b for biases, c and d for scale factors: four numbers per channel, so that slow noise of the rests remains.
If the rests span a range of temperatures, T is that of the sensors, which follow the thermometer with the lag of the
least residual: at the ends of a ramp they lag behind it, which is no noise either.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tumble.units import Array, IntArray

WARMED = 0.1  # K: if no rest changes by more, nothing is subtracted
OVER_TEMPERATURE = 10.0  # K: if the rests span less, no lag is fitted
LEAST_CHANGE = 1.0  # K: over less, a drift in time looks like a slope over temperature
LAGS = np.array([-200.0, -100.0, -50.0, -25.0, 0.0, 25.0, 50.0, 100.0, 200.0, 400.0, 800.0])  # s
REFINEMENTS, REFINED_LAGS = 4, 7  # number of refinements of the best lag, and of lags tried in each

KelvinAtLag = Callable[[float], Array]
"""Temperatures (K, T), K, at the blocks of all rests, of bodies that follow the thermometers with a lag, s."""


def without_warming(series: Sequence[Array], kelvin: KelvinAtLag | None, thermometer: IntArray) -> list[Array]:
    """Subtract from the block means (K, c) of every rest the effect of the temperature within it; `kelvin` is None
    without thermometers, `thermometer` (c,) that of each channel."""
    if kelvin is None or not len(thermometer):
        return list(series)
    by_rest = np.split(kelvin(0.0), np.cumsum([len(s) for s in series])[:-1])
    if max(map(warming_of, by_rest)) < WARMED:
        return list(series)
    fits = {t: _WarmingFit.of([s[:, thermometer == t] for s in series]) for t in np.unique(thermometer).tolist()}

    def explained(lag: float) -> float:
        """Return the decrease of the sum of squares with a lag, s."""
        warm = kelvin(lag)
        return sum(fit.explained(warm[:, t]) for t, fit in fits.items())

    fit_lag = np.ptp([k.mean(axis=0) for k in by_rest], axis=0).max() >= OVER_TEMPERATURE
    lags, best = (LAGS, 0) if fit_lag else (np.zeros(1), 0)
    for refinement in range(1 + REFINEMENTS if fit_lag else 0):
        if refinement:
            lags = np.linspace(lags[max(best - 1, 0)], lags[min(best + 1, len(lags) - 1)], REFINED_LAGS)
        best = int(np.argmax([explained(lag) for lag in lags.tolist()]))
    warm = kelvin(float(lags[best]))
    out = [np.empty_like(s) for s in series]
    for t, fit in fits.items():
        for whole, quiet in zip(out, fit.without(warm[:, t]), strict=True):
            whole[:, thermometer == t] = quiet
    return out


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _WarmingFit:
    """Fit of the temperature dependence of the block means of N rests, of the c channels of one thermometer.

    `means`, `off`: means of the rests (c, N), and differences of the blocks from these (c, K). `first`, `count`: first
    block and number of blocks of each rest (N,). `noise`: standard deviation of the differences from block to block
    (c,)."""

    means: Array
    off: Array
    first: IntArray
    count: IntArray
    noise: Array

    @staticmethod
    def of(series: Sequence[Array]) -> _WarmingFit:
        means, count = np.array([s.mean(axis=0) for s in series]), np.array([len(s) for s in series])
        off = np.concatenate([s - mean for s, mean in zip(series, means, strict=True)])
        noise = np.concatenate([np.diff(s, axis=0) for s in series]).std(axis=0)
        return _WarmingFit(
            means=means.T,
            off=np.ascontiguousarray(off.T),
            first=np.cumsum(count) - count,
            count=count,
            noise=np.where(noise > 0.0, noise, 1.0),
        )

    def explained(self, kelvin: Array) -> float:
        """Return the decrease of the sum of squares, in units of the noise."""
        _, coefficients, along = self._fitted(kelvin)
        return float(((coefficients * along).sum(axis=1) / self.noise**2).sum())

    def without(self, kelvin: Array) -> list[Array]:
        """Return block means (K, c) of the rests without the part that depends on the temperature."""
        columns, coefficients, _ = self._fitted(kelvin)
        bias_slopes, scale_slopes = coefficients[:, :2, None], coefficients[:, 2:, None]
        slopes = np.repeat(bias_slopes + self._offsets[:, None] * scale_slopes, self.count, axis=2)
        quiet = self.off - np.einsum("jk,cjk->ck", columns, slopes) + np.repeat(self.means, self.count, axis=1)
        return np.split(quiet.T, self.first[1:])

    def _fitted(self, kelvin: Array) -> tuple[Array, Array, Array]:
        """Solve the normal equations, with columns scaled to length 1. Return T and its square (2, K) about their means
        in each rest, their coefficients (c, 4), and the products of the columns with the readings (c, 4)."""
        warmer = kelvin - self._mean(kelvin).mean()
        columns = np.stack([warmer, warmer**2])
        columns -= np.repeat(self._mean(columns), self.count, axis=1)
        square = np.add.reduceat(columns[:, None] * columns, self.first, axis=2)
        products = np.add.reduceat(columns[:, None] * self.off, self.first, axis=2)
        powers = self._offsets ** np.arange(3)[:, None, None]
        zeroth, first, second = np.einsum("dcn,ijn->dcij", powers, square)
        normal = np.block([[zeroth, first], [first, second]])
        along = np.einsum("dcn,icn->cdi", powers[:2], products).reshape(-1, 4)
        size = np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2), 1e-300))
        inverse = np.linalg.pinv(normal / (size[:, :, None] * size[:, None, :]), rcond=1e-12, hermitian=True)
        return columns, np.einsum("cij,cj->ci", inverse, along / size) / size, along

    @property
    def _offsets(self) -> Array:
        """Means of the rests less their mean (c, N)."""
        return np.asarray(self.means - self.means.mean(axis=1, keepdims=True))

    def _mean(self, values: Array) -> Array:
        """Return the means over the rests (·, N) of values (·, K)."""
        return np.asarray(np.add.reduceat(values, self.first, axis=-1) / self.count)


def warming_of(kelvin: Array) -> float:
    """Return the largest change of temperatures (K, T) from the first to the last tenth."""
    tenth = max(len(kelvin) // 10, 1)
    return float(np.abs(kelvin[-tenth:].mean(axis=0) - kelvin[:tenth].mean(axis=0)).max())
