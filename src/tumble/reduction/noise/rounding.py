"""What the resolution of a channel does to its mean at rest and to its integral over a turn.

The values of a channel that was rounded lie on a grid of one step, the resolution L. White noise of standard deviation
σ before rounding makes the mean of many rounded samples follow the true value: the error that is left is a sawtooth of
the place x of the true value between two steps, smoothed by the noise,

    e(x) = (L/π) Σ_k (−1)^k exp(−2π²k²σ²/L²) sin(2πk x/L) / k,

of mean square B(σ) = (L²/2π²) Σ_k exp(−4π²k²σ²/L²)/k² over all x: L²/12 without noise, and nothing to speak of from
half a step of noise on. It does not fall with the length of a rest. Rests whose readings are many steps apart have
errors of their own; rests that read the same, as gyros do, all have the same error, and it passes for a bias. Their
scatter is that of one place x, next to none in the middle between two edges and half a step on an edge whatever the
noise, and says how large the error may be there. In a turn at a steady rate it lasts as long as the rate stays between
the same two steps.

Source: Widrow & Kollár, Quantization Noise, 2008, on the moments of a rounded Gaussian.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy

from tumble.reduction.blocks.reducer import ChannelState
from tumble.units import DEGREE_PER_HOUR, G_STANDARD, Array, BoolArray, IntArray

ON_GRID = 0.1
"""How far a difference may be from a whole number of steps, in steps, and still be on the grid."""
GRID_SHARE = 0.95
GRID_STEPS = 64
"""Differences of more steps than these say nothing about the grid."""
LEAST_DIFFERENCES, MOST = 3, 2000
MOST_SAMPLES = 2**13
"""Enough to show a grid as coarse as the noise."""
ENOUGH_NOISE = 0.5
"""Noise, in steps, from which on rounding is forgotten."""
ALIKE = 0.2
"""Standard deviation of the means of rests, in steps, up to which they read the same."""
RARE = 0.01
"""Of samples, beyond which a second value says something."""
LITTLE_NOISE = 0.1
"""Noise, in steps, below which a reading keeps to one step while the true value does."""
_TERMS = np.arange(1, 40)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rounding:
    """Resolution of n channels and what it does to their means, in the unit of the readings: the step (n,), 0 where the
    values are on no grid, the noise (n,) of a sample before rounding, the standard uncertainty (n,) of the mean of a
    rest whose reading is nothing special between two steps, and that of what is common to all rests."""

    step: Array
    noise: Array
    of_rest: Array
    common_u: Array

    @property
    def coarse(self) -> BoolArray:
        """The channels (n,) whose noise is too small for rounding to average out."""
        return np.asarray((self.step > 0.0) & (self.noise < ENOUGH_NOISE * self.step))

    def variance_of_integrals(self, readings: Array, intervals: Array) -> Array:
        """Variance (n,) from rounding of the integrals of m ≥ 1 samples (m, n) at intervals (m,), s. An error lasts as
        long as a reading keeps to one step, or, where noise takes it to and fro, to two: Σ T² of_rest² over such
        times T."""
        out = np.zeros(len(self.step))
        for i in np.flatnonzero(self.coarse):
            steps = np.round((readings[:, i] - readings[0, i]) / self.step[i]).astype(int)
            if self.noise[i] < LITTLE_NOISE * self.step[i]:
                squares = _squares(steps, intervals)
            else:
                squares = max(_squares(steps // 2, intervals), _squares((steps + 1) // 2, intervals))
            out[i] = squares * self.of_rest[i] ** 2
        return out


def _squares(values: IntArray, intervals: Array) -> float:
    """Σ T², s², over the times T in which integers (m,) do not change."""
    first = np.concatenate([[0], np.flatnonzero(np.diff(values)) + 1])
    return float((np.add.reduceat(intervals, first) ** 2).sum())


def rounding(samples: Array, rests: Sequence[Array], channels: Sequence[ChannelState]) -> Rounding:
    """The rounding of channels from samples (m, n) of all of a log, those (k, n) of each rest in the order of time,
    some 0.1 s apart, and the states of the channels."""
    some = samples[:: -(-len(samples) // MOST_SAMPLES) or 1]
    step = np.array([_step(values, channel) for values, channel in zip(some.T, channels, strict=True)])
    changes = np.concatenate([np.zeros((1, len(step))), *(np.diff(rest, axis=0) for rest in rests)])[1:]
    scatter = np.sqrt(0.5 * (changes**2).sum(axis=0) / max(1, len(changes)))
    noise = np.array([_noise(s, L) for s, L in zip(scatter, step, strict=True)])
    relative = np.divide(noise, step, out=np.full(len(step), np.inf), where=step > 0.0)
    amplitude = np.exp(-2.0 * np.pi**2 * relative**2) / np.pi
    common = np.where(relative < ENOUGH_NOISE, np.minimum(amplitude, 12.0**-0.5), 0.0)
    for i in np.flatnonzero(relative < ENOUGH_NOISE):
        if (of_rests := _alike([rest[:, i] / step[i] for rest in rests if len(rest)])) is not None:
            relative[i], common[i] = _of_one_place(of_rests)
            noise[i] = relative[i] * step[i]
    return Rounding(
        step=step,
        noise=noise,
        of_rest=step * np.sqrt(_mean_square(relative)),
        common_u=step * common,
    )


def _alike(rests: Sequence[Array]) -> Array | None:
    """The samples (m,) of all rests, in steps, less a whole number, where all rests read the same and not only one
    value is among them; else None."""
    if not rests or np.std([rest.mean() for rest in rests]) > ALIKE:
        return None
    values = np.concatenate(rests)
    whole = np.round(values - np.round(np.median(values)))
    return whole if np.mean(whole != 0.0) > RARE else None


def _of_one_place(values: Array) -> tuple[float, float]:
    """The noise σ before rounding and the standard uncertainty of the mean, both in steps, from samples (m,) about one
    place x between two steps. Of two values alone it is not seen how much of their variance is noise: each σ up to half
    a step has the x that gives the mean and counts as it gives the variance, x and σ being taken as even."""
    mean, variance = values.mean(), values.var()
    noise, x, means, variances = _rounded_gaussians()
    error, weight = np.empty(len(noise)), np.empty(len(noise))
    for i in range(len(noise)):
        low, place, high = np.interp([mean - 2e-3, mean, mean + 2e-3], means[i], x)
        off = (variance - np.interp(place, x, variances[i])) / (0.01 + variance * np.sqrt(2.0 / len(values)))
        error[i], weight[i] = mean - place, (high - low) * np.exp(-0.5 * off**2)
    if not weight.sum() > 0.0:
        return ENOUGH_NOISE, 0.0
    weight /= weight.sum()
    return float(weight @ noise), float(np.sqrt(weight @ error**2))


@cache
def _rounded_gaussians() -> tuple[Array, Array, Array, Array]:
    """Noise (s,) and places x (m,), and the means and variances (s, m) of samples that were rounded, all in steps."""
    noise, x, whole = np.linspace(0.0, ENOUGH_NOISE, 26)[1:], np.linspace(-1.0, 1.0, 201), np.arange(-4, 5)
    below = scipy.special.ndtr((np.append(whole, 5) - 0.5 - x[:, None]) / noise[:, None, None])
    share = np.diff(below, axis=2)
    means = share @ whole
    return noise, x, means, share @ whole**2 - means**2


def rounding_notes(rounded: Mapping[str, Rounding]) -> tuple[str, ...]:
    """Channels whose noise is too small for rounding to average out, in words; `rounded` by "accel" and "gyro"."""
    kinds = {"accel": ("accelerometer", 1e-6 * G_STANDARD, "µg"), "gyro": ("gyro", DEGREE_PER_HOUR, "°/h")}
    notes = []
    for kind, each in rounded.items():
        name, unit, shown = kinds[kind]
        for i in np.flatnonzero(each.common_u):
            notes.append(
                f"{name} {i + 1}: its noise is {each.noise[i] / each.step[i]:.2g} of its resolution of "
                f"{each.step[i] / unit:.3g} {shown}, so that rounding does not average out: standard uncertainty "
                f"{each.common_u[i] / unit:.2g} {shown}, common to all rests that read the same"
            )
    return tuple(notes)


def _mean_square(relative: Array) -> Array:
    """B(σ)/L² of the module docstring for σ/L (n,)."""
    return np.asarray((np.exp(-4.0 * np.pi**2 * np.outer(relative**2, _TERMS**2)) / _TERMS**2).sum(axis=1)) / (
        2.0 * np.pi**2
    )


def _noise(scatter: float, step: float) -> float:
    """σ before rounding from the scatter s of rounded samples, on average over x: s² = σ² + L²/12 − B(σ)."""
    if step == 0.0 or scatter > step:
        return float(np.sqrt(max(scatter**2 - step**2 / 12.0, 0.0)))
    sigma = np.linspace(0.0, 1.2, 1201)
    left = np.append([1.0 / 12.0], _mean_square(sigma[1:]))  # the sum converges slowly at 0
    return float(step * np.interp((scatter / step) ** 2, sigma**2 + 1.0 / 12.0 - left, sigma))


def _step(values: Array, channel: ChannelState) -> float:
    """The step of the grid of the values (m,); the smallest step seen where they are too few to show a grid, but more
    than half of all samples repeat the one before; 0 where there is none."""
    distinct = np.unique(values)
    differences = np.diff(distinct)
    differences = np.sort(differences[differences > 1e-12 * max(np.abs(distinct).max(initial=0.0), 1e-300)])[:MOST]
    if len(differences) >= LEAST_DIFFERENCES:
        candidates = [channel.step, *np.quantile(differences, [0.0, 0.05, 0.2, 0.5])]
        for candidate in sorted({float(c) for c in candidates if np.isfinite(c)}, reverse=True):
            step = candidate
            for steps in (1.5, 4.5, 16.5, GRID_STEPS + 0.5):  # fitted to differences of ever more steps
                near = differences[differences < steps * step]
                count = np.round(near / step)
                step = float(count @ near / (count @ count)) if count.any() else step
            count = differences[differences < (GRID_STEPS + 0.5) * step] / step
            on_grid = np.abs(count - np.round(count)) < ON_GRID
            smaller = float(np.mean(count < 0.5)) if len(count) else 1.0
            if len(count) >= LEAST_DIFFERENCES and float(np.mean(on_grid)) >= GRID_SHARE and smaller < 0.05:
                return step
    coarse = 2 * channel.repeats > channel.samples and np.isfinite(channel.step)
    return channel.step if coarse else 0.0
