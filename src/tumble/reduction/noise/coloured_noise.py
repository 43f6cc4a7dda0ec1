"""The variance of the mean of a stretch of coloured noise.

The means of short blocks are averaged to about BATCHES batches a rest (so that a correlation time of a twentieth of the
rest spans several of them), and these, about the mean of the rest, are modelled channel by channel as an autoregressive
process, from the autocovariances pooled over all rests. All channels have one order, by the sum of their Akaike
criteria, corrected for few samples (Hurvich and Tsai 1989): orders chosen channel by channel would make white noise
twice as uncertain. The variance of a mean over K blocks is then

    v(K) = (1/K) [γ₀ + 2 Σ_{j<K} (1 − j/K) γ_j]

with γ_j continued by the recursion. Subtracting the mean of a rest lowers every autocovariance by about v(K); this is
added again and the fit repeated until it no longer changes, without which a correlation time of a twentieth of the rest
would be underestimated by a third. A rest that is evidently noisier or quieter than the others has another level.
Correlation between channels is that of the innovations.

A rest more than LONG times as long as most, such as the first one by hand, contains drift that the others are too short
for, and which would pass for their noise. In their fit it is divided into pieces as long as they are, without those
that are evidently noisier; the long rests have a noise that is fitted to them alone.

A linear drift does not move the mean of a rest, but would pass for noise of so long a memory that averaging does not
remove it. Where the rests bend less than such noise would, the line of each rest is subtracted like its mean.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from tumble.reduction import kernels as _kernels
from tumble.units import Array, BoolArray

BATCHES = 120
MAX_ORDER = 32
"""Largest order of the autoregressive process: a memory of a quarter of the batches of a rest."""
LEVEL_SIGMAS = 5.0
"""Standard deviations of the variance of a rest beyond which it has another level: 6e-7 by chance."""
LONG = 2.0
STRAIGHT_SIGMAS = 2.3
"""Standard deviations by which the rests have to be straighter than their noise: 1 % by chance."""
WHITE = 4.0 / 3.0
"""`ColouredNoise.arising` of white noise."""
LEAST = 1e-3  # of what white noise of the same variance would give: quantisation gives more, rounding may give less
NEGLIGIBLE = 1e-9  # of the variance: autocovariances below are zero


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ColouredNoise:
    """Noise of the block means of c channels in r rests.

    `batch`: blocks of a batch. `autocovariance`: autocovariances (c, L) of batches from lag 0. `correlation`:
    correlation (c, c) between channels. `level`: factor (r, c) on the variance of each rest. `apart`: for rests
    that are much longer than most, by their number, their noise and their index in it."""

    batch: int
    autocovariance: Array
    correlation: Array
    level: Array
    apart: Mapping[int, tuple[ColouredNoise, int]] = field(default_factory=dict)

    def variance_of_mean(self, blocks: float) -> Array:
        """Variance (c,) of a mean over blocks, at level 1."""
        return _variance_of_mean(self.autocovariance, np.array([blocks / self.batch]))[:, 0]

    def arising(self, blocks: float) -> float:
        """The time at which the noise of an integral over T, so many blocks, arises: the variance of ∫ (T − t) n dt in
        parts of T²/4 times that of ∫ n dt, over all channels; 4/3 for white noise, 1 for constant noise."""
        r, K = self.autocovariance.sum(axis=0), blocks / self.batch  # white within batches
        lags = np.arange(1, min(len(r), int(K)))
        k, later = K - lags, r[lags]
        # Σ_ij (i + ½)(j + ½) r_|i−j| in parts of K²/4 Σ_ij r_|i−j|
        moments = r[0] * K**3 / 3.0 + 2.0 * later @ (k * (4.0 * k**2 - 1.0) / 12.0 + 0.5 * lags * k**2)
        sums = r[0] * K + 2.0 * later @ k
        return float(4.0 * moments / (K**2 * sums)) if sums > LEAST * r[0] * K else WHITE

    def covariance_of_mean(self, blocks: float, rest: int | None = None) -> Array:
        """Covariance (c, c) of a mean over blocks, at the level of a rest or at level 1."""
        if rest is not None and rest in self.apart:
            noise, index = self.apart[rest]
            return noise.covariance_of_mean(blocks, index)
        variance = self.variance_of_mean(blocks) * (1.0 if rest is None else self.level[rest])
        return np.asarray(self.correlation * np.sqrt(np.outer(variance, variance)))


def fit_coloured_noise(rests: Sequence[Array]) -> ColouredNoise:
    """Fit the noise of the block means (K, c) of several rests, half of them with K ≥ 8."""
    typical = float(np.median([len(rest) for rest in rests]))
    long = [i for i, rest in enumerate(rests) if len(rest) > LONG * typical]
    if not long:
        return _fit(rests)
    ordinary = [i for i, rest in enumerate(rests) if len(rest) <= LONG * typical]
    pieces = [piece for i in long for piece in np.array_split(rests[i], math.ceil(len(rests[i]) / typical))]
    alike = _alike([rests[i] for i in ordinary], pieces)
    noise, noise_of_long = _fit([rests[i] for i in ordinary] + alike), fit_coloured_noise([rests[i] for i in long])
    level = np.empty((len(rests), rests[0].shape[1]))
    level[ordinary], level[long] = noise.level[: len(ordinary)], noise_of_long.level
    return replace(noise, level=level, apart={rest: (noise_of_long, index) for index, rest in enumerate(long)})


def _alike(rests: list[Array], pieces: list[Array]) -> list[Array]:
    """The pieces that are not evidently noisier than the rests."""
    noise = _fit(rests)
    centred = _centred(rests + pieces, noise.batch)
    levels = [_levels([x[:, c] for x in centred], a) for c, a in enumerate(noise.autocovariance)]
    louder = np.max(levels, axis=0)[len(rests) :] > 1.0
    return [piece for piece, loud in zip(pieces, louder, strict=True) if not loud]


def _centred(rests: Sequence[Array], batch: int) -> list[Array]:
    """Means of every `batch` blocks of each rest, about their mean."""
    batched = [rest[: len(rest) // batch * batch].reshape(-1, batch, rest.shape[1]).mean(axis=1) for rest in rests]
    return [rest - rest.sum(axis=0) / max(1, len(rest)) for rest in batched]


def _fit(rests: Sequence[Array]) -> ColouredNoise:
    """Fit the noise of rests of about the same length."""
    batch = max(1, round(float(np.median([len(rest) for rest in rests])) / BATCHES))
    centred = _centred(rests, batch)
    longest, channels = max(len(c) for c in centred), centred[0].shape[1]
    series = [[x[:, c] for x in centred] for c in range(channels)]
    level, sloping = np.ones((len(centred), channels)), np.zeros(channels, dtype=bool)
    for _ in range(5):  # rests at their levels, until no other rest stands out
        scaled = [[x / s for x, s in zip(each, np.sqrt(level[:, c]), strict=True)] for c, each in enumerate(series)]
        filters, autocovariance = _fit_channels(scaled, longest, sloping)
        straight = np.array([_straight(x, r) for x, r in zip(scaled, autocovariance, strict=True)]) & ~sloping
        if straight.any():
            sloping |= straight
            for c in np.flatnonzero(straight):
                slopes = [_slope(len(x)) for x in series[c]]
                series[c] = [x - (slope @ x) * slope for x, slope in zip(series[c], slopes, strict=True)]
            continue
        levels = np.column_stack([_levels(x, r) for x, r in zip(series, autocovariance, strict=True)])
        if np.array_equal(levels == 1.0, level == 1.0):
            break
        level = levels
    innovations = [  # from the first sample that has enough before it
        [np.convolve(x, f, mode="valid") if len(x) >= len(f) else x[:0] for x in each]
        for each, f in zip(scaled, filters, strict=True)
    ]
    # those of filters of different order end together; channels without noise are uncorrelated
    moments = np.zeros((channels, channels))
    for together in zip(*innovations, strict=True):
        shortest = min(len(x) for x in together)
        stacked = np.array([x[len(x) - shortest :] for x in together])
        moments += stacked @ stacked.T
    scale = np.sqrt(np.diag(moments))
    scale[scale == 0.0] = np.inf
    correlation = np.where(np.eye(channels) > 0, 1.0, moments / np.outer(scale, scale))
    return ColouredNoise(batch=batch, autocovariance=autocovariance, correlation=correlation, level=level)


def _variance_of_mean(autocovariance: Array, batches: Array) -> Array:
    """v(K) (c, n) of the module docstring for autocovariances (c, L) and numbers K (n,) of batches."""
    out = np.empty((len(autocovariance), len(batches)))
    _kernels.mean_variances(autocovariance, batches.astype(float), LEAST, np.empty((2, autocovariance.shape[1])), out)
    return out


@lru_cache(maxsize=256)
def _slope(n: int) -> Array:
    """The linear function over n samples, of mean 0 and length 1."""
    x = np.arange(n) - 0.5 * (n - 1)
    return np.asarray(x / max(float(np.linalg.norm(x)), 1e-300))


@lru_cache(maxsize=256)
def _bend(third: int) -> tuple[Array, Array]:
    """Weights w (3 n,) of means of thirds, first − 2 second + third, and their autocorrelation (3 n,)."""
    w = np.repeat([1.0, -2.0, 1.0], third) / third
    return w, np.correlate(w, w, "full")[len(w) - 1 :]


def _straight(series: list[Array], autocovariance: Array) -> bool:
    """Whether the rests bend less than noise of this autocovariance would: the means of their thirds, first − 2 second
    + third, which do not depend on the slope, tested as a chi-square at STRAIGHT_SIGMAS (Wilson and Hilferty)."""
    if autocovariance[0] <= 0.0:
        return False
    ratio = []
    for x in series:
        if len(x) >= 9:
            w, r = _bend(len(x) // 3)
            expected = r[0] * autocovariance[0] + 2.0 * (r[1:] @ autocovariance[1 : len(r)])
            ratio.append((w @ x[: len(w)]) ** 2 / max(expected, 1e-12 * autocovariance[0]))
    sigma = np.sqrt(2.0 / (9.0 * len(ratio))) if ratio else np.inf
    return len(ratio) > 0 and float(np.cbrt(np.mean(ratio))) < 1.0 - sigma**2 - STRAIGHT_SIGMAS * sigma


def _fit_channels(channels: list[list[Array]], longest: int, sloping: BoolArray) -> tuple[list[Array], Array]:
    """Prediction-error filters (1, −a₁, … −a_p) of one order and autocovariances (c, longest) of channels, each a list
    by rests. From the series of `sloping` channels the slope was subtracted, from all the mean."""
    lengths = np.array([len(x) for x in channels[0]])
    order_limit, total = min(MAX_ORDER, int(np.median(lengths)) // 4), int(lengths.sum())
    raw = np.array([_products(series, order_limit) for series in channels])
    raw /= [np.maximum(lengths - lag, 0).sum() for lag in range(order_limit + 1)]  # another would shorten the memory
    noisy = np.flatnonzero(raw[:, 0] > 0.0)
    filters, autocovariance = [np.array([1.0])] * len(channels), np.zeros((len(channels), longest))
    different, often = np.unique(lengths[lengths > 0], return_counts=True)
    shares, middle = different * often / total, int(np.median(lengths))
    lost, bent = np.zeros(len(channels)), np.zeros(raw.shape)
    for _ in range(50 if len(noisy) else 0):
        corrected = raw + lost[:, None] + bent
        fits = []  # filters, a row each, and innovation variances, up to where no process has the autocovariances
        for c in noisy:
            order_filters, powers = np.zeros((order_limit + 1,) * 2), np.zeros(order_limit + 1)
            count = _kernels.levinson(corrected[c], order_filters, powers)
            fits.append((order_filters[:count], powers[:count]))
        orders = min(len(powers) for _, powers in fits)
        surprise = total * sum(np.log(powers[:orders]) for _, powers in fits)
        fitted = np.arange(orders) + 1.0
        best = int(np.argmin(surprise + 2.0 * len(noisy) * fitted * total / (total - fitted - 1.0)))
        now = np.zeros(len(channels))
        for c, (order_filters, _) in zip(noisy, fits, strict=True):
            filters[c] = order_filters[best, : best + 1]
            autocovariance[c], autocovariance[c, : best + 1] = 0.0, corrected[c, : best + 1]
            if best:
                _kernels.continue_autocovariance(autocovariance[c], filters[c], NEGLIGIBLE)
        now[noisy] = _variance_of_mean(autocovariance[noisy], different) @ shares
        if np.all(np.abs(now - lost) <= 1e-4 * now):
            break
        lost = now
        for c in np.flatnonzero(sloping):
            # subtracting a slope q of variance λ lowers the autocovariances of a rest by λ Σ q_t q_{t+j} / (n − j)
            q = np.correlate(_slope(middle), _slope(middle), "full")[middle - 1 :]
            variance = q[0] * autocovariance[c, 0] + 2.0 * (q[1:] @ autocovariance[c, 1:middle])
            bent[c] = max(variance, 0.0) * q[: order_limit + 1] / (middle - np.arange(order_limit + 1))
    return filters, autocovariance


def _products(series: list[Array], most: int) -> Array:
    """Sums of the products of samples of a rest that are 0 … `most` apart."""
    apart = np.concatenate([part for x in series for part in (x, np.zeros(most))])
    return np.array([apart[: len(apart) - lag] @ apart[lag:] for lag in range(most + 1)])


def _levels(series: list[Array], autocovariance: Array) -> Array:
    """Variance of each rest in parts of the median one, where it differs evidently, else 1. The loss by subtracting the
    mean of a rest is corrected, and the ratio tested as a chi-square (Wilson and Hilferty)."""
    level = np.ones(len(series))
    long = [i for i, x in enumerate(series) if len(x) > 1]
    if autocovariance[0] <= 0.0:
        return level
    lengths = np.array([len(series[i]) for i in long])
    different, which = np.unique(lengths, return_inverse=True)
    expected = autocovariance[0] - _variance_of_mean(autocovariance[None], different)[0, which]
    power = np.array([series[i] @ series[i] for i in long]) / lengths / np.maximum(expected, 1e-12 * autocovariance[0])
    if np.median(power) == 0.0:
        return level
    power /= np.median(power)
    squares = np.cumsum((autocovariance / autocovariance[0]) ** 2)
    degrees = np.maximum((lengths - 1.0) / (2.0 * squares[lengths - 1] - 1.0), 1.0)
    sigma = np.sqrt(2.0 / (9.0 * degrees))
    beyond = np.abs(np.cbrt(power) - 1.0 + sigma**2) > LEVEL_SIGMAS * sigma
    level[long] = np.where(beyond, np.maximum(power, 1e-6), 1.0)
    return level
