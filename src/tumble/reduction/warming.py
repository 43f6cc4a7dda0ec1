"""Readings at rest as they would be without the change of temperature within each rest.

A sensor that gets warmer drifts, and the drift would pass for noise of a long memory, of which the mean of a rest is
not to know: parameters follow the temperature in the estimate. What is taken off is what goes with the temperature
through all rests alike, block by block,

    y − ȳ = (a + c m)(T − T̄) + (b + d m)((T − T₀)² − mean),    m = ȳ less its mean over the rests,

a and b of biases, c and d of scale factors: four numbers a channel, so that slow noise of the rests stays.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tumble.units import Array, IntArray

WARMED = 0.1
"""K: where no rest warms or cools by more, nothing is taken off."""


def without_warming(series: Sequence[Array], kelvin: Sequence[Array] | None, thermometer: IntArray) -> list[Array]:
    """Block means (K, c) of every rest less what goes with their temperatures (K, T), K, about those of the rest; each
    channel has a `thermometer` (c,)."""
    if kelvin is None or max(_change(each) for each in kelvin) < WARMED:
        return list(series)
    means = np.array([each.mean(axis=0) for each in series])
    apart, lengths = means - means.mean(axis=0), [len(each) for each in series]
    reference = np.mean([each.mean(axis=0) for each in kelvin], axis=0)
    warmer = np.concatenate([_centred(each) for each in kelvin])
    squared = np.concatenate([_centred((each - reference) ** 2) for each in kelvin])
    out = np.concatenate([each - mean for each, mean in zip(series, means, strict=True)])
    for c, t in enumerate(thermometer.tolist()):
        common = np.column_stack([warmer[:, t], squared[:, t]])
        columns = np.column_stack([common, np.repeat(apart[:, c], lengths)[:, None] * common])
        size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        out[:, c] -= columns @ (np.linalg.lstsq(columns / size, out[:, c])[0] / size)
    return [each + mean for each, mean in zip(np.split(out, np.cumsum(lengths)[:-1]), means, strict=True)]


def _change(kelvin: Array) -> float:
    """The most that temperatures (K, T) change by from the first to the last tenth."""
    tenth = max(len(kelvin) // 10, 1)
    return float(np.abs(kelvin[-tenth:].mean(axis=0) - kelvin[:tenth].mean(axis=0)).max())


def _centred(values: Array) -> Array:
    return np.asarray(values - values.mean(axis=0))
