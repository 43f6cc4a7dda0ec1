"""The variance of the mean of a stretch of coloured noise.

The means of short blocks are averaged to about BATCHES batches per rest (so that a correlation time of a twentieth of
the rest spans several of them). Less the mean of the rest, they are modelled channel by channel as an autoregressive
process, from the autocovariances pooled over all rests. All channels have one order, which minimises the sum of their
Akaike criteria with the correction for few samples (Hurvich and Tsai 1989): different orders would make white noise
twice as uncertain. The variance of a mean over K blocks is then

    v(K) = (1/K) [γ₀ + 2 Σ_{j<K} (1 − j/K) γ_j]

with γ_j continued by the recursion. Subtracting the mean of a rest lowers every autocovariance by about v(K), which is
added again, and the fit is iterated until it converges; without it, a correlation time of a twentieth of the rest would
be underestimated by a third. A rest that is significantly noisier or quieter than the others has its own level.
Correlation between channels is that of the innovations.

A rest more than LONG_RATIO times as long as most, such as the first one by hand, contains drift that the others are too
short to show, and that would count as their noise. In the fit of the others it is divided into pieces of their length,
of which a noisier one has its own level; the long rests have a noise that is fitted to them alone.

A linear drift does not change the mean of a rest, but would count as noise of so long a memory that averaging does not
remove it. If the rests bend less than such noise would, the line of each rest is subtracted like its mean.
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
MAX_ORDER = 32  # of the autoregressive process: a memory of a quarter of the batches of a rest
LEVEL_SIGMAS = 5.0  # standard deviations of the variance of a rest beyond which it has its own level: 6e-7 by chance
LONG_RATIO = 2.0
STRAIGHT_SIGMAS = 2.3  # standard deviations by which rests have to be straighter than their noise: 1 % by chance
WHITE = 4.0 / 3.0  # `ColouredNoise.moment_ratio` of white noise
MIN_VARIANCE_RATIO = 1e-3  # to that of white noise: quantisation gives more, rounding errors may give less
NEGLIGIBLE = 1e-9  # relative autocovariance below which it counts as zero


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ColouredNoise:
    """Noise of the block means of c channels in r rests.

    `batch`: blocks of a batch. `autocovariance`: of batches, from lag 0 (c, L). `correlation`: between channels (c, c).
    `level`: factor on the variance of each rest (r, c). `long_rests`: for rests that are much longer than most, by
    their number, their noise and their index in it."""

    batch: int
    autocovariance: Array
    correlation: Array
    level: Array
    long_rests: Mapping[int, tuple[ColouredNoise, int]] = field(default_factory=dict)

    def variance_of_mean(self, blocks: float) -> Array:
        """Return the variance (c,) of a mean over blocks, at level 1."""
        return _variance_of_mean(self.autocovariance, np.array([blocks / self.batch]))[:, 0]

    def moment_ratio(self, blocks: float) -> float:
        """Return the variance of ∫ (T − t) n dt over T²/4 times that of ∫ n dt, T = `blocks`, over all channels.

        By this factor errors of rate n add more to the velocity of a turn than a constant one with the same rotation:
        4/3 for white noise, 1 for constant noise."""
        r, K = self.autocovariance.sum(axis=0), blocks / self.batch  # noise is white within batches
        lags = np.arange(1, min(len(r), int(K)))
        k, later = K - lags, r[lags]
        # Σ_ij (i + ½)(j + ½) r_|i−j| over K²/4 Σ_ij r_|i−j|
        moments = r[0] * K**3 / 3.0 + 2.0 * later @ (k * (4.0 * k**2 - 1.0) / 12.0 + 0.5 * lags * k**2)
        sums = r[0] * K + 2.0 * later @ k
        return float(4.0 * moments / (K**2 * sums)) if sums > MIN_VARIANCE_RATIO * r[0] * K else WHITE

    def covariance_of_mean(self, blocks: float, rest: int | None = None) -> Array:
        """Return the covariance (c, c) of a mean over blocks, at the level of a rest or at level 1."""
        if rest is not None and rest in self.long_rests:
            noise, index = self.long_rests[rest]
            return noise.covariance_of_mean(blocks, index)
        variance = self.variance_of_mean(blocks) * (1.0 if rest is None else self.level[rest])
        return np.asarray(self.correlation * np.sqrt(np.outer(variance, variance)))


def fit_coloured_noise(rests: Sequence[Array]) -> ColouredNoise:
    """Fit the noise of the block means (K, c) of several rests, at least half of them with K ≥ 8."""
    typical = float(np.median([len(rest) for rest in rests]))
    long = [i for i, rest in enumerate(rests) if len(rest) > LONG_RATIO * typical]
    if not long:
        return _fit(rests)
    ordinary = [i for i, rest in enumerate(rests) if len(rest) <= LONG_RATIO * typical]
    pieces = [piece for i in long for piece in np.array_split(rests[i], math.ceil(len(rests[i]) / typical))]
    noise, long_noise = _fit([rests[i] for i in ordinary] + pieces), fit_coloured_noise([rests[i] for i in long])
    level = np.empty((len(rests), rests[0].shape[1]))
    level[ordinary], level[long] = noise.level[: len(ordinary)], long_noise.level
    return replace(noise, level=level, long_rests={rest: (long_noise, index) for index, rest in enumerate(long)})


def _centred(rests: Sequence[Array], batch: int) -> list[Array]:
    """Return the means of every `batch` blocks of each rest, less their mean."""
    batched = [rest[: len(rest) // batch * batch].reshape(-1, batch, rest.shape[1]).mean(axis=1) for rest in rests]
    return [rest - rest.sum(axis=0) / max(1, len(rest)) for rest in batched]


def _fit(rests: Sequence[Array]) -> ColouredNoise:
    """Fit the noise of rests of about the same length."""
    batch = max(1, round(float(np.median([len(rest) for rest in rests])) / BATCHES))
    centred = _centred(rests, batch)
    longest, channels = max(len(c) for c in centred), centred[0].shape[1]
    series = [[x[:, c] for x in centred] for c in range(channels)]  # of every channel, by rests
    level, is_sloping = np.ones((len(centred), channels)), np.zeros(channels, dtype=bool)
    for _ in range(5):  # until no further channel is sloping, and no further rest has its own level
        scaled = [[x / s for x, s in zip(series[c], np.sqrt(level[:, c]), strict=True)] for c in range(channels)]
        filters, autocovariance = _fit_channels(scaled, longest, is_sloping)
        straight = [c for c in range(channels) if not is_sloping[c] and _is_straight(scaled[c], autocovariance[c])]
        if straight:
            is_sloping[straight] = True
            for c in straight:
                series[c] = [x - (_line(len(x)) @ x) * _line(len(x)) for x in series[c]]
            continue
        levels = np.column_stack([_levels(x, r) for x, r in zip(series, autocovariance, strict=True)])
        if np.array_equal(levels == 1.0, level == 1.0):
            break
        level = levels
    innovations = np.array(
        [
            np.concatenate([x[:0] if len(x) < len(f) else np.convolve(x, f, mode="valid") for x in rests_of_channel])
            for rests_of_channel, f in zip(scaled, filters, strict=True)
        ]
    )
    moments = innovations @ innovations.T
    scale = np.sqrt(np.diag(moments))
    scale[scale == 0.0] = np.inf  # channels without noise are uncorrelated
    correlation = np.where(np.eye(channels) > 0, 1.0, moments / np.outer(scale, scale))
    return ColouredNoise(batch=batch, autocovariance=autocovariance, correlation=correlation, level=level)


def _variance_of_mean(autocovariance: Array, batches: Array) -> Array:
    """Return v(K) (c, n) for autocovariances (c, L) and numbers K of batches (n,)."""
    out, sums = np.empty((len(autocovariance), len(batches))), np.empty((2, autocovariance.shape[1]))
    _kernels.mean_variances(autocovariance, batches.astype(float), MIN_VARIANCE_RATIO, sums, out)
    return out


@lru_cache(maxsize=256)
def _line(n: int) -> Array:
    """Return the linear function over n samples of mean 0 and length 1."""
    x = np.arange(n) - 0.5 * (n - 1)
    return np.asarray(x / max(float(np.linalg.norm(x)), 1e-300))


@lru_cache(maxsize=256)
def _bend(third: int) -> tuple[Array, Array]:
    """Return weights w of means of thirds, first − 2 second + third, and their autocorrelation (3 third,)."""
    w = np.repeat([1.0, -2.0, 1.0], third) / third
    return w, np.correlate(w, w, "full")[len(w) - 1 :]


def _is_straight(series: list[Array], autocovariance: Array) -> bool:
    """Return True if the rests bend less than noise of this autocovariance would.

    The bends, first − 2 second + third of the means of thirds, do not depend on the slope. They are tested as a
    chi-square at STRAIGHT_SIGMAS (Wilson and Hilferty)."""
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


def _fit_channels(channels: list[list[Array]], longest: int, is_sloping: BoolArray) -> tuple[Array, Array]:
    """Return prediction-error filters 1, −a₁, … −a_p (c, p + 1), and autocovariances (c, longest), of channels.

    The series of a channel are lists by rests, less the mean of each rest, and less its line if `is_sloping`."""
    lengths = np.array([len(x) for x in channels[0]])
    middle, total = int(np.median(lengths)), int(lengths.sum())
    order_limit = min(MAX_ORDER, middle // 4)
    raw = np.array([_products(series, order_limit) for series in channels])
    pairs = np.maximum(lengths - np.arange(order_limit + 1)[:, None], 0)
    raw /= pairs.sum(axis=1)  # another divisor shortens the memory
    noisy = np.flatnonzero(raw[:, 0] > 0.0)
    filters, autocovariance = np.ones((len(channels), 1)), np.zeros((len(channels), longest))
    distinct, counts = np.unique(lengths[lengths > 0], return_counts=True)
    shares = distinct * counts / total
    # what the autocovariances lose by subtracting the means and the lines, iterated until it converges
    mean_loss, line_loss = np.zeros(len(channels)), np.zeros(raw.shape)
    n_parameters = np.arange(order_limit + 1) + 1.0
    penalty = 2.0 * len(noisy) * n_parameters * total / (total - n_parameters - 1.0)
    for _ in range(50 if len(noisy) else 0):
        corrected = raw + mean_loss[:, None] + line_loss
        fits = []  # filters, one per row, and innovation variances, as long as the autocovariances are admissible
        for c in noisy:
            order_filters, powers = np.zeros((order_limit + 1,) * 2), np.zeros(order_limit + 1)
            count = _kernels.levinson(corrected[c], order_filters, powers)
            fits.append((order_filters[:count], powers[:count]))
        orders = min(len(powers) for _, powers in fits)
        deviance = total * sum(np.log(powers[:orders]) for _, powers in fits)
        best = int(np.argmin(deviance + penalty[:orders]))
        new_loss, filters = np.zeros(len(channels)), np.zeros((len(channels), best + 1))
        for c, (order_filters, _) in zip(noisy, fits, strict=True):
            filters[c] = order_filters[best, : best + 1]
            autocovariance[c], autocovariance[c, : best + 1] = 0.0, corrected[c, : best + 1]
            if best:
                _kernels.continue_autocovariance(autocovariance[c], filters[c], NEGLIGIBLE)
        new_loss[noisy] = _variance_of_mean(autocovariance[noisy], distinct) @ shares
        if np.all(np.abs(new_loss - mean_loss) <= 1e-4 * new_loss):
            break
        mean_loss = new_loss
        for c in np.flatnonzero(is_sloping):
            # subtracting a line q of variance λ lowers the autocovariances of a rest by λ Σ q_t q_{t+j} / (n − j)
            q = np.correlate(_line(middle), _line(middle), "full")[middle - 1 :]
            variance = q[0] * autocovariance[c, 0] + 2.0 * (q[1:] @ autocovariance[c, 1:middle])
            line_loss[c] = max(variance, 0.0) * q[: order_limit + 1] / (middle - np.arange(order_limit + 1))
    return filters, autocovariance


def _products(series: list[Array], most: int) -> Array:
    """Return the sums of the products of samples of a rest that are 0 … `most` samples apart."""
    padded = np.concatenate([part for x in series for part in (x, np.zeros(most))])
    return np.array([padded[: len(padded) - lag] @ padded[lag:] for lag in range(most + 1)])


def _levels(series: list[Array], autocovariance: Array) -> Array:
    """Return the variance of each rest relative to the median one if it differs significantly, else 1.

    The loss by subtracting the mean of a rest is corrected; the ratio is tested as a chi-square (Wilson and
    Hilferty)."""
    level = np.ones(len(series))
    long = [i for i, x in enumerate(series) if len(x) > 1]
    if autocovariance[0] <= 0.0:
        return level
    lengths = np.array([len(series[i]) for i in long])
    distinct, which = np.unique(lengths, return_inverse=True)
    expected = autocovariance[0] - _variance_of_mean(autocovariance[None], distinct)[0, which]
    power = np.array([series[i] @ series[i] for i in long]) / lengths / np.maximum(expected, 1e-12 * autocovariance[0])
    if np.median(power) == 0.0:
        return level
    power /= np.median(power)
    squares = np.cumsum((autocovariance / autocovariance[0]) ** 2)
    degrees = np.maximum((lengths - 1.0) / (2.0 * squares[lengths - 1] - 1.0), 1.0)
    sigma = np.sqrt(2.0 / (9.0 * degrees))
    differs = np.abs(np.cbrt(power) - 1.0 + sigma**2) > LEVEL_SIGMAS * sigma
    level[long] = np.where(differs, np.maximum(power, 1e-6), 1.0)
    return level
