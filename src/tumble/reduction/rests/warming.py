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
    count = np.array([len(s) for s in series])
    first = np.cumsum(count) - count
    by_rest = np.split(kelvin(0.0), first[1:])
    if max(map(warming_of, by_rest)) < WARMED:
        return list(series)

    def by_block(values: Array) -> Array:
        """Return values of the rests (·, N) at all their blocks (·, K)."""
        return np.repeat(values, count, axis=-1)

    readings = np.ascontiguousarray(np.concatenate(series).T)
    means = np.add.reduceat(readings, first, axis=1) / count
    off, scale = readings - by_block(means), by_block(means - means.mean(axis=1, keepdims=True))
    noise = np.concatenate([np.diff(s, axis=0) for s in series]).std(axis=0)
    noise[noise == 0.0] = 1.0

    def effect(lag: float) -> tuple[Array, float]:
        """Return the effect of the temperature (c, K) with a lag, s, and the decrease of the sum of squares by it, in
        units of the noise."""
        warm, fitted, explained = np.ascontiguousarray(kelvin(lag).T), np.empty_like(off), 0.0
        warm = warm - np.mean(np.add.reduceat(warm, first, axis=1) / count, axis=1, keepdims=True)
        powers = np.stack([warm, warm**2])
        powers -= by_block(np.add.reduceat(powers, first, axis=2) / count)
        for c, t in enumerate(thermometer.tolist()):
            columns = np.concatenate([powers[:, t], scale[c] * powers[:, t]])
            normal, along = columns @ columns.T, columns @ off[c]
            size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
            inverse = np.linalg.pinv(normal / np.outer(size, size), rcond=1e-12, hermitian=True)
            coefficients = inverse @ (along / size) / size
            fitted[c] = coefficients @ columns
            explained += float(coefficients @ along) / noise[c] ** 2
        return fitted, explained

    lags, best = np.zeros(1), 0
    if np.ptp([k.mean(axis=0) for k in by_rest], axis=0).max() >= OVER_TEMPERATURE:
        lags = LAGS
        for refinement in range(1 + REFINEMENTS):
            if refinement:
                lags = np.linspace(lags[max(best - 1, 0)], lags[min(best + 1, len(lags) - 1)], REFINED_LAGS)
            best = int(np.argmax([effect(lag)[1] for lag in lags.tolist()]))
    return np.split((readings - effect(float(lags[best]))[0]).T, first[1:])


def warming_of(kelvin: Array) -> float:
    """Return the largest change of temperatures (K, T) from the first to the last tenth."""
    tenth = max(len(kelvin) // 10, 1)
    return float(np.abs(kelvin[-tenth:].mean(axis=0) - kelvin[:tenth].mean(axis=0)).max())
