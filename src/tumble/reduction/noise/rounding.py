"""Effect of the resolution of a channel on its mean at rest and on its integral over a turn.

The values of a rounded channel lie on a grid with the step L, the resolution. With white noise of standard deviation σ
before rounding, the mean of many rounded samples follows the true value up to an error that is a sawtooth of the
position x of the true value between two steps, smoothed by the noise,

    e(x) = (L/π) Σ_k (−1)^k exp(−2π²k²σ²/L²) sin(2πk x/L) / k,

with the mean square B(σ) = (L²/2π²) Σ_k exp(−4π²k²σ²/L²)/k² over all x: L²/12 without noise, and negligible for noise
of more than half a step. It does not decrease with the length of a rest. Rests whose readings are many steps apart have
independent errors; rests with the same reading, as of gyros, have the same error, which appears as a bias. Their
scatter is that of a single position x (nearly zero in the middle between two edges, half a step on an edge, whatever
the noise), and shows how large the error may be. In a turn at a steady rate the error lasts as long as the rate stays
between two steps.

A log in decimals, such as 0.1 °/s, rounds a second time what a chip has rounded to a finer step f. The value at which a
reading changes then differs by up to f/2 from the middle between two decimals, and so does the error of the means that
cross it, however much noise they average. f is not visible in the log, but a chip whose noise shows has f ≤ σ, so that
the bound of the standard uncertainty is σ/√12. Over a width w of readings, of about L/w such edges, it decreases to

    u² = σ²/12 · L/(2√π w),    w ≥ L/(2√π).

Source: Widrow & Kollár, Quantization Noise, 2008, on the moments of a rounded Gaussian.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy

from tumble.reduction.blocks.reducer import ChannelState
from tumble.units import DEGREE, DEGREE_PER_HOUR, G_STANDARD, Array, BoolArray, IntArray

ON_GRID = 0.1  # steps: deviation of a difference on the grid from a whole number of steps
GRID_SHARE = 0.95  # least fraction of differences on the grid
GRID_STEPS = 64  # differences of more steps do not show the grid
MIN_DIFFERENCES, MAX_DIFFERENCES = 3, 2000
MAX_SAMPLES = 2**13  # enough to show a grid as coarse as the noise
SMOOTHING_NOISE = 0.5  # steps: noise from which rounding is negligible
SAME_READING = 0.2  # steps: standard deviation of the means of rests with the same reading
RARE = 0.01  # fraction of samples up to which a second value is not informative
IS_DECIMAL = 1e-4  # deviation of the logarithm to base 10 of a step from a whole number
DECIMAL_NOISE = 0.6  # steps: noise that may be found for SMOOTHING_NOISE, as the distance of two edges errs by σ/√6
DECIMAL_UNITS = 1.0, DEGREE, G_STANDARD  # of readings in a log, SI
LITTLE_NOISE = 0.1  # steps: noise below which a reading stays on one step while the true value does
_TERMS = np.arange(1, 40)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rounding:
    """Resolution of n channels and its effect on their means, in the unit of the readings.

    `step` (n,): resolution, 0 for values on no grid. `noise` (n,): of a sample before rounding. `rest_u` (n,): standard
    uncertainty of the mean of a rest whose position between two steps is random. `common_u` (n,): that of the error
    common to all rests. `decimal_u` (n,): the part of it by the finer step of a chip whose readings are in decimals."""

    step: Array
    noise: Array
    rest_u: Array
    common_u: Array
    decimal_u: Array | float = 0.0

    @property
    def coarse(self) -> BoolArray:
        """Channels (n,) whose noise is too small for rounding to average out."""
        return np.asarray((self.step > 0.0) & (self.noise < SMOOTHING_NOISE * self.step))

    def variance_of_integrals(self, readings: Array, intervals: Array) -> Array:
        """Return the variance (n,) from rounding of the integrals of m ≥ 1 samples (m, n) at intervals (m,), s: Σ T²
        rest_u².

        An error lasts for the time T in which a reading stays on one step, or on two if noise makes it alternate."""
        out = np.zeros(len(self.step))
        for i in np.flatnonzero(self.coarse):
            steps = np.round((readings[:, i] - readings[0, i]) / self.step[i]).astype(int)
            if self.noise[i] < LITTLE_NOISE * self.step[i]:
                squares = _squares(steps, intervals)
            else:
                squares = max(_squares(steps // 2, intervals), _squares((steps + 1) // 2, intervals))
            out[i] = squares * self.rest_u[i] ** 2
        return out


def _squares(values: IntArray, intervals: Array) -> float:
    """Return Σ T², s², over the times T in which integers (m,) do not change."""
    first = np.concatenate([[0], np.flatnonzero(np.diff(values)) + 1])
    return float((np.add.reduceat(intervals, first) ** 2).sum())


def rounding(samples: Array, rests: Sequence[Array], channels: Sequence[ChannelState]) -> Rounding:
    """Return the rounding of n channels from samples (m, n) of the whole log, those of each rest (k, n), in order of
    time and some 0.1 s apart, and the states of the channels."""
    subset = samples[:: -(-len(samples) // MAX_SAMPLES) or 1]
    step = np.array([_step(values, channel) for values, channel in zip(subset.T, channels, strict=True)])
    changes = np.concatenate([np.zeros((1, len(step))), *(np.diff(rest, axis=0) for rest in rests)])[1:]
    scatter = np.sqrt(0.5 * (changes**2).sum(axis=0) / max(1, len(changes)))
    noise = np.array([_noise_before_rounding(s, L) for s, L in zip(scatter, step, strict=True)])
    relative = np.divide(noise, step, out=np.full(len(step), np.inf), where=step > 0.0)
    amplitude = np.exp(-2.0 * np.pi**2 * relative**2) / np.pi
    common = np.where(relative < SMOOTHING_NOISE, np.minimum(amplitude, 12.0**-0.5), 0.0)
    for i in np.flatnonzero(relative < SMOOTHING_NOISE) if any(map(len, rests)) else ():
        by_rest = [rest[:, i] / step[i] for rest in rests if len(rest)]
        if np.std([values.mean() for values in by_rest]) > SAME_READING:
            continue
        values = np.concatenate(by_rest)
        whole = np.round(values - np.round(np.median(values)))  # samples of one reading, in steps
        if np.mean(whole != 0.0) > RARE:
            relative[i], common[i] = _at_one_position(whole)
            noise[i] = relative[i] * step[i]
    digits = np.log10(np.divide.outer(DECIMAL_UNITS, np.where(step > 0.0, step, 1.0)))
    decimal = (np.abs(digits - np.round(digits)) < IS_DECIMAL).any(axis=0)
    decimal_u = np.where(decimal & (relative < DECIMAL_NOISE), noise / np.sqrt(12.0), 0.0)
    return Rounding(
        step=step,
        noise=noise,
        rest_u=step * np.sqrt(_mean_square(relative)),
        common_u=np.hypot(step * common, decimal_u),
        decimal_u=decimal_u,
    )


def _at_one_position(values: Array) -> tuple[float, float]:
    """Return the noise σ before rounding and the standard uncertainty of the mean, in steps, from samples (m,) at one
    position x between two steps.

    Two values alone do not show how much of their variance is noise: each σ up to half a step is combined with the x
    that gives the mean, and weighted by how well it gives the variance, with uniform priors of x and σ."""
    mean, variance = values.mean(), values.var()
    noise, x, means, variances = _rounded_gaussians()
    error, weight = np.empty(len(noise)), np.empty(len(noise))
    for i in range(len(noise)):
        low, position, high = np.interp([mean - 2e-3, mean, mean + 2e-3], means[i], x)
        off = (variance - np.interp(position, x, variances[i])) / (0.01 + variance * np.sqrt(2.0 / len(values)))
        error[i], weight[i] = mean - position, (high - low) * np.exp(-0.5 * off**2)
    if not weight.sum() > 0.0:
        return SMOOTHING_NOISE, 0.0
    weight /= weight.sum()
    return float(weight @ noise), float(np.sqrt(weight @ error**2))


@cache
def _rounded_gaussians() -> tuple[Array, Array, Array, Array]:
    """Return noise (s,) and positions x (m,), and the means and variances (s, m) of rounded samples, all in steps."""
    noise, x, whole = np.linspace(0.0, SMOOTHING_NOISE, 26)[1:], np.linspace(-1.0, 1.0, 201), np.arange(-4, 5)
    below = scipy.special.ndtr((np.append(whole, 5) - 0.5 - x[:, None]) / noise[:, None, None])
    share = np.diff(below, axis=2)
    means = share @ whole
    return noise, x, means, share @ whole**2 - means**2


def rounding_notes(rounded: Mapping[str, Rounding]) -> tuple[str, ...]:
    """Return notes on channels, by "accel" and "gyro", whose noise is too small for rounding to average out."""
    kinds = {"accel": ("accelerometer", 1e-6 * G_STANDARD, "µg"), "gyro": ("gyro", DEGREE_PER_HOUR, "°/h")}
    notes = []
    for kind, r in rounded.items():
        name, unit, shown = kinds[kind]
        for i in np.flatnonzero(r.common_u):
            notes.append(
                f"{name} {i + 1}: its noise is {r.noise[i] / r.step[i]:.2g} of its resolution of "
                f"{r.step[i] / unit:.3g} {shown}, so that rounding does not average out: standard uncertainty "
                f"{r.common_u[i] / unit:.2g} {shown}, common to all rests that read the same"
            )
    return tuple(notes)


def _mean_square(relative: Array) -> Array:
    """Return B(σ)/L² for σ/L (n,)."""
    return np.asarray((np.exp(-4.0 * np.pi**2 * np.outer(relative**2, _TERMS**2)) / _TERMS**2).sum(axis=1)) / (
        2.0 * np.pi**2
    )


def _noise_before_rounding(scatter: float, step: float) -> float:
    """Return σ before rounding from the scatter s of rounded samples, on average over x: s² = σ² + L²/12 − B(σ)."""
    if step == 0.0 or scatter > step:
        return float(np.sqrt(max(scatter**2 - step**2 / 12.0, 0.0)))
    sigma = np.linspace(0.0, 1.2, 1201)
    mean_square = np.append([1.0 / 12.0], _mean_square(sigma[1:]))  # the sum converges slowly at 0
    return float(step * np.interp((scatter / step) ** 2, sigma**2 + 1.0 / 12.0 - mean_square, sigma))


def _step(values: Array, channel: ChannelState) -> float:
    """Return the step of the grid of the values (m,), 0 if there is none.

    For too few values it is the smallest step that occurred, if more than half of all samples repeat the one before."""
    distinct = np.unique(values)
    differences, smallest = np.diff(distinct), 1e-12 * max(np.abs(distinct).max(initial=0.0), 1e-300)
    differences = np.sort(differences[differences > smallest])[:MAX_DIFFERENCES]
    if len(differences) >= MIN_DIFFERENCES:
        candidates = [channel.step, *np.quantile(differences, [0.0, 0.05, 0.2, 0.5])]
        for candidate in sorted({float(c) for c in candidates if np.isfinite(c)}, reverse=True):
            step = candidate
            for steps in (1.5, 4.5, 16.5, GRID_STEPS + 0.5):  # fit to differences of more and more steps
                near = differences[differences < steps * step]
                count = np.round(near / step)
                step = float(count @ near / (count @ count)) if count.any() else step
            count = differences[differences < (GRID_STEPS + 0.5) * step] / step
            on_grid = np.abs(count - np.round(count)) < ON_GRID
            smaller = float(np.mean(count < 0.5)) if len(count) else 1.0
            if len(count) >= MIN_DIFFERENCES and float(np.mean(on_grid)) >= GRID_SHARE and smaller < 0.05:
                return step
    coarse = 2 * channel.repeats > channel.samples and np.isfinite(channel.step)
    return channel.step if coarse else 0.0
