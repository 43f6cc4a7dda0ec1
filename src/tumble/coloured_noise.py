"""How uncertain the mean of a stretch of coloured noise is.

The means of short blocks of a rest are joined to about BATCHES batches a rest (so that a correlation time of a
twentieth of the rest spans several of them), and these, less the mean of the rest, are modelled channel by channel as an
autoregressive process whose order is chosen by Akaike's criterion, from the autocovariances pooled over all
rests. The variance of a mean over K blocks is then

    v(K) = (1/K) [γ₀ + 2 Σ_{j<K} (1 − j/K) γ_j]

with γ_j continued by the recursion. Subtracting the mean of a rest lowers every autocovariance by about v(K);
that is put back and the fit repeated until it no longer changes, without which a correlation time of a twentieth
of the rest would be underestimated by a third. A rest that is evidently noisier or quieter than the others has
its own level. Correlation between channels is that of the innovations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tumble.units import Array

BATCHES = 120
MAX_ORDER = 32
LEVEL_SIGMAS = 5.0
NEGLIGIBLE = 1e-9  # of the variance: autocovariances below are zero


@dataclass(frozen=True, kw_only=True, slots=True)
class ColouredNoise:
    """Noise of block means: autocovariances (c, L) of batches of `batch` blocks from lag 0, correlation (c, c)
    between channels, and the level (r, c) of each rest as a factor on the variance."""

    batch: int
    autocovariance: Array
    correlation: Array
    level: Array

    def variance_of_mean(self, blocks: float) -> Array:
        """Variance (c,) of the mean over so many blocks, at level 1."""
        return _variance_of_mean(self.autocovariance, blocks / self.batch)

    def covariance_of_mean(self, blocks: float, rest: int | None = None) -> Array:
        """Covariance (c, c) of the mean over so many blocks, at the level of a rest or at level 1."""
        variance = self.variance_of_mean(blocks) * (1.0 if rest is None else self.level[rest])
        return np.asarray(self.correlation * np.sqrt(np.outer(variance, variance)))


def fit_coloured_noise(rests: Sequence[Array]) -> ColouredNoise:
    """The noise of the block means of several rests, each (K, c) with K ≥ 8."""
    batch = max(1, round(float(np.median([len(rest) for rest in rests])) / BATCHES))
    batched = [rest[: len(rest) // batch * batch].reshape(-1, batch, rest.shape[1]).mean(axis=1) for rest in rests]
    centred = [rest - rest.mean(axis=0) for rest in batched]
    longest, channels = max(len(c) for c in centred), centred[0].shape[1]
    level = np.ones((len(centred), channels))
    autocovariance = np.zeros((channels, longest))
    innovations: list[Array] = []
    for c in range(channels):
        series = [x[:, c] for x in centred]
        for _ in range(5):  # rests at their levels, until no other rest stands out
            scaled = [x / np.sqrt(s) for x, s in zip(series, level[:, c], strict=True)]
            coefficients, autocovariance[c] = _fit_channel(scaled, longest)
            levels = _levels(series, autocovariance[c])
            if np.array_equal(levels == 1.0, level[:, c] == 1.0):
                break
            level[:, c] = levels
        innovations.append(np.concatenate([np.convolve(x, coefficients, mode="valid") for x in scaled]))
    return ColouredNoise(batch=batch, autocovariance=autocovariance, correlation=_correlation(innovations), level=level)


def _variance_of_mean(autocovariance: Array, batches: float) -> Array:
    """v(K) of the module docstring from autocovariances (..., L)."""
    lags = min(max(1, int(batches)), autocovariance.shape[-1])
    weights = 2.0 * (1.0 - np.arange(lags) / batches)
    weights[0] = 1.0
    return np.asarray(autocovariance[..., :lags] @ weights / batches)


def _fit_channel(series: list[Array], longest: int) -> tuple[Array, Array]:
    """Prediction-error filter (1, −a₁, … −a_p) and autocovariance (longest,) of one channel."""
    shortest = min(len(x) for x in series)
    order_limit = min(MAX_ORDER, shortest // 4)
    total = sum(len(x) for x in series)
    raw = np.zeros(order_limit + 1)
    for x in series:
        for lag in range(order_limit + 1):
            raw[lag] += x[: len(x) - lag] @ x[lag:]
    raw /= total - len(series) * np.arange(order_limit + 1)  # the number of pairs: any other divisor shortens the memory
    if raw[0] <= 0.0:
        return np.array([1.0]), np.zeros(longest)
    lost = 0.0
    for _ in range(50):
        corrected = raw + lost
        filters, powers = _levinson(corrected)
        best = int(np.argmin(total * np.log(powers) + 2.0 * np.arange(len(powers))))
        autocovariance = _continued(corrected, filters[best], longest)
        now = float(sum(len(x) * _variance_of_mean(autocovariance, len(x)) for x in series) / total)
        if abs(now - lost) <= 1e-4 * now:
            break
        lost = now
    return filters[best], autocovariance


def _levinson(autocovariance: Array) -> tuple[list[Array], Array]:
    """Prediction-error filters and innovation variances of every order from 0 (Levinson's recursion), up to where the
    estimated autocovariances stop being those of a process."""
    filters, powers = [np.array([1.0])], [autocovariance[0]]
    for order in range(1, len(autocovariance)):
        previous = filters[-1]
        reflection = -(previous @ autocovariance[order:0:-1]) / powers[-1]
        if reflection**2 > 1.0 - 1e-9:
            break
        padded = np.append(previous, 0.0)
        filters.append(padded + reflection * padded[::-1])
        powers.append(powers[-1] * (1.0 - reflection**2))
    return filters, np.array(powers)


def _continued(autocovariance: Array, prediction_filter: Array, length: int) -> Array:
    """Autocovariances of the autoregressive process up to `length` lags."""
    order = len(prediction_filter) - 1
    out = np.zeros(max(length, order + 1))
    out[: order + 1] = autocovariance[: order + 1]
    weights = -prediction_filter[:0:-1]
    for lag in range(order + 1, length if order else 0):
        out[lag] = weights @ out[lag - order : lag]
        if lag % 64 == 0 and np.abs(out[lag - order : lag + 1]).max() < NEGLIGIBLE * out[0]:
            break
    return out[:length]


def _levels(series: list[Array], autocovariance: Array) -> Array:
    """Variance of each rest over the median one, where it differs beyond doubt, else 1."""
    power = np.array([x @ x / len(x) for x in series])
    typical = float(np.median(power))
    if typical <= 0.0 or autocovariance[0] <= 0.0:
        return np.ones(len(series))
    correlation = autocovariance / autocovariance[0]
    independent = np.array([len(x) / (1.0 + 2.0 * (correlation[1 : len(x)] ** 2).sum()) for x in series])
    deviation = np.sqrt(2.0 / np.maximum(independent, 1.0))
    beyond = np.abs(np.log(np.maximum(power, 1e-300) / typical)) > LEVEL_SIGMAS * deviation
    return np.asarray(np.where(beyond, np.maximum(power / typical, 1e-6), 1.0))


def _correlation(innovations: list[Array]) -> Array:
    """Correlation matrix of the innovations of the channels (channels without noise are uncorrelated)."""
    shortest = min(len(x) for x in innovations)
    stacked = np.array([x[-shortest:] for x in innovations])
    moments = stacked @ stacked.T
    scale = np.sqrt(np.diag(moments))
    scale[scale == 0.0] = np.inf
    return np.asarray(np.where(np.eye(len(stacked)) > 0, 1.0, moments / np.outer(scale, scale)))
