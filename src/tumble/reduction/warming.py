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

from tumble.units import Array

WARMED = 0.1
"""K: where no rest warms or cools by more, nothing is taken off."""


def without_warming(series: Sequence[Array], kelvin: Sequence[Array] | None) -> list[Array]:
    """Block means (K, c) of every rest less what goes with their temperatures (K,), K, about those of the rest."""
    if kelvin is None or max(_change(each) for each in kelvin) < WARMED:
        return list(series)
    means = np.array([each.mean(axis=0) for each in series])
    apart, lengths = means - means.mean(axis=0), [len(each) for each in series]
    reference = float(np.mean([each.mean() for each in kelvin]))
    warmer = [_centred(each) for each in kelvin]
    squared = [_centred((each - reference) ** 2) for each in kelvin]
    common = np.column_stack([np.concatenate(warmer), np.concatenate(squared)])
    out = np.concatenate([each - mean for each, mean in zip(series, means, strict=True)])
    for c in range(out.shape[1]):
        columns = np.column_stack([common, np.repeat(apart[:, c], lengths)[:, None] * common])
        size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        out[:, c] -= columns @ (np.linalg.lstsq(columns / size, out[:, c])[0] / size)
    return [each + mean for each, mean in zip(np.split(out, np.cumsum(lengths)[:-1]), means, strict=True)]


def _change(kelvin: Array) -> float:
    """By how much temperatures (K,) change from the first to the last tenth."""
    tenth = max(len(kelvin) // 10, 1)
    return abs(float(kelvin[-tenth:].mean() - kelvin[:tenth].mean()))


def _centred(values: Array) -> Array:
    return np.asarray(values - values.mean())
