"""Sway of a device that is held in the hand while it rests.

A body that sways by small angles α(t) about its mean attitude reads the specific force

    f̄ + f̄ × α + α̈ × r,        |mean f| = g (1 − ½ mean |û × α|²)

at a distance r from the point it sways about, û along f̄. Its gyros read α too, as the integral of the rate: the two
agree if the body moves, and are independent if sensors are noisy, whatever the colour of the noise. In stretches of a
second, let δ be the forces and p_j the m = 4 columns û × α and ω̇ × e_j, all as block means across û, less their mean
and slope. Without sway, the sums s_j = Σ p_j·δ of the n stretches have mean 0 (Hotelling's test): with t = Σ s and
W = tᵀ (Σ s sᵀ)⁻¹ t, (n − m) W / m (n − W) has Fisher's distribution with m and n − m degrees of freedom. The variance
of the tilt that both kinds of sensors show is the part of |δ|² that a fit by these columns explains.

The noise of the gyros apart from the sway is that of their samples, from differences of fourth order, in which the
motion of a hand is negligible. The noise of the mean of a rest is that of the forces less f̄ × α: turns go from mean
attitude to mean attitude, so that a rest with sway is as well determined as one without.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from tumble.reduction.blocks.motion_samples import MotionSamples
from tumble.reduction.blocks.reducer import FileBlocks, Reduction
from tumble.reduction.rests.segmentation import Stretch
from tumble.rotation import skew, unit_vector
from tumble.units import Array

FOURTH_DIFFERENCES = 70.0  # variance of the fourth differences, 1 −4 6 −4 1, of independent samples, over theirs
STRETCH = 10  # blocks of a stretch: 1 s
LONGEST = 200  # blocks of a rest that are tested: 20 s, as long as a hand holds still
SWAY_SIGNIFICANCE = 1e-5  # p-value of the sums below which there is sway
SINGULAR = 1e-12  # relative singular value of a normal matrix that counts as zero


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Sway:
    """Sway of a device in its rests.

    `angle`: root mean square per axis about the mean attitude of a rest, in the median rest, rad. `shortened`: relative
    decrease of the mean specific force of each rest (N,). `force`: effect of the sway on the specific force of each
    rest, block means (K, 3) in the body, m/s², of mean 0. `density`: density (3, 3) of the gyro noise in the body
    without sway, rad²/s."""

    angle: float
    shortened: Array
    force: tuple[Array, ...]
    density: Array


def sway_of(reduction: Reduction, spans: Sequence[Stretch]) -> Sway | None:
    """Return the sway of a device in its rests, None if it lies still, if gyro noise hides its sway, and without
    gyros."""
    if reduction.samples is None:
        return None
    samples, files = reduction.samples, [reduction.by_file[span.file] for span in spans]
    columns, across, densities = [], [], []
    for f, span in zip(files, spans, strict=True):
        rate, force, dt, path = _motion(samples, f, span.first, min(span.last, span.first + LONGEST))
        fourth = np.diff(rate * dt[:, None], n=4, axis=0)
        densities.append((fourth**2).sum(axis=0) / (FOURTH_DIFFERENCES * dt[4:].sum()))
        # mean angular acceleration in each block, from the rates at its edges
        padded = np.concatenate([2.0 * rate[:1] - rate[1:2], rate, 2.0 * rate[-1:] - rate[-2:-1]])
        acceleration = 0.5 * np.diff(padded[: -1 : f.size] + padded[1 :: f.size], axis=0) / (f.size * dt.mean())
        up = unit_vector(force.mean(axis=0))
        level = np.eye(3) - np.outer(up, up)
        by_tilt, by_levers = np.cross(up, _means(path, f))[..., None], level @ skew(acceleration)
        columns.append(_detrended(np.concatenate([by_tilt, by_levers], axis=2)))
        across.append(_detrended((_means(force, f) @ level)[..., None])[..., 0])
    p, δ = np.concatenate(columns), np.concatenate(across)
    s = np.einsum("ikcj,ikc->ij", p, δ)
    size = np.sqrt((p**2).sum(axis=(0, 1, 2)))
    if not (len(s) and size.all() and np.isfinite(s).all() and np.isfinite(size).all()):
        return None  # too short, or damaged
    s, p = s / size, p / size
    t, (n, m) = s.sum(axis=0), s.shape
    W = float(t @ np.linalg.lstsq(s.T @ s, t, rcond=SINGULAR)[0])
    if n <= m or scipy.special.fdtrc(m, n - m, (n - m) / m * W / max(n - W, SINGULAR)) > SWAY_SIGNIFICANCE:
        return None
    # variance of the tilt that both kinds of sensors show, and that of the integrated gyro noise in the median rest
    normal = np.einsum("ikcj,ikcl->jl", p, p)
    explained = float(t @ np.linalg.lstsq(normal, t, rcond=SINGULAR)[0] / (δ**2).sum()) * size[0] ** 2 / (δ.size / 3)
    density = np.median(densities, axis=0)
    if 0.5 * explained <= density.mean() * np.median([span.stop - span.start for span in spans]) / 3.0:
        return None
    angles, shortened, effects = [], [], []
    for f, span in zip(files, spans, strict=True):
        _, force, _, path = _motion(samples, f, span.first, span.last)
        squares, mean = path.T @ path / len(path), force.mean(axis=0)
        up = unit_vector(mean)
        angles.append(np.trace(squares) / 3.0)
        shortened.append(0.5 * (np.trace(squares) - up @ squares @ up))
        effects.append(np.cross(mean, _means(path, f)))
    return Sway(
        angle=float(np.sqrt(np.median(angles))),
        shortened=np.array(shortened),
        force=tuple(effects),
        density=np.diag(density),
    )


def _motion(samples: MotionSamples, f: FileBlocks, first: int, last: int) -> tuple[Array, Array, Array, Array]:
    """Return rates (m, 3), forces (m, 3), intervals (m,), and angles about the mean attitude (m, 3), rad, of the
    samples of blocks first … last − 1 of a file."""
    rate, force, dt = samples.read(f.sample_at(first), f.sample_at(last))
    path = np.cumsum((rate - rate.mean(axis=0)) * dt[:, None], axis=0)
    return rate, force, dt, path - path.mean(axis=0)


def _means(values: Array, f: FileBlocks) -> Array:
    """Return the block means (K, 3) of samples (m, 3)."""
    return np.asarray(values.reshape(-1, f.size, 3).mean(axis=1))


def _detrended(values: Array) -> Array:
    """Return block means (K, 3, m) in stretches (s, STRETCH, 3, m), less the mean and slope of each."""
    stretches = values[: len(values) // STRETCH * STRETCH].reshape(-1, STRETCH, *values.shape[1:])
    x = np.arange(STRETCH) - 0.5 * (STRETCH - 1)
    x /= np.linalg.norm(x)
    off = stretches - stretches.mean(axis=1, keepdims=True)
    return np.asarray(off - x[:, None, None] * np.einsum("k,skcm->scm", x, off)[:, None])
