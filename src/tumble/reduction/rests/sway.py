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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Motion:
    """Motion of a body in a rest.

    `up`, `size`: direction (3,) of the mean specific force in the body, and its magnitude, m/s². `path`,
    `acceleration`, `force`: means of the K blocks (K, 3) of the angle about the mean attitude, rad, the angular
    acceleration, rad/s², and the specific force, m/s². `angle`, `tilt`: variances of the angle per axis, and of the
    angle about both horizontal axes, rad². `density`: of the gyro noise (3,), rad²/s."""

    up: Array
    size: float
    path: Array
    acceleration: Array
    force: Array
    angle: float
    tilt: float
    density: Array

    @staticmethod
    def of(samples: MotionSamples, f: FileBlocks, first: int, last: int) -> _Motion:
        """Return the motion in blocks first … last − 1 of a file."""
        rate, force, dt = samples.read(f.sample_at(first), f.sample_at(last))
        path = np.cumsum((rate - rate.mean(axis=0)) * dt[:, None], axis=0)
        path -= path.mean(axis=0)
        squares, mean = path.T @ path / len(path), force.mean(axis=0)
        up, fourth = unit_vector(mean), np.diff(rate * dt[:, None], n=4, axis=0)
        padded = np.concatenate([2.0 * rate[:1] - rate[1:2], rate, 2.0 * rate[-1:] - rate[-2:-1]])
        return _Motion(
            up=up,
            size=float(np.linalg.norm(mean)),
            path=path.reshape(-1, f.size, 3).mean(axis=1),
            acceleration=0.5 * np.diff(padded[: -1 : f.size] + padded[1 :: f.size], axis=0) / (f.size * dt.mean()),
            force=force.reshape(-1, f.size, 3).mean(axis=1),
            angle=float(np.trace(squares)) / 3.0,
            tilt=float(np.trace(squares) - up @ squares @ up),
            density=(fourth**2).sum(axis=0) / (FOURTH_DIFFERENCES * dt[4:].sum()),
        )

    @property
    def columns(self) -> Array:
        """Regressors û × α and ω̇ × e_j of the forces across the vertical (s, STRETCH, 3, 4)."""
        levers = skew(self.acceleration)
        levers = levers - self.up[:, None] * (self.up @ levers)[:, None]
        return _detrended(np.concatenate([np.cross(self.up, self.path)[..., None], levers], axis=2))

    @property
    def across(self) -> Array:
        """Forces across the vertical (s, STRETCH, 3)."""
        return _detrended((self.force - (self.force @ self.up)[:, None] * self.up)[..., None])[..., 0]


def sway_of(reduction: Reduction, spans: Sequence[Stretch]) -> Sway | None:
    """Return the sway of a device in its rests, None if it lies still, if gyro noise hides its sway, and without
    gyros."""
    if reduction.samples is None:
        return None
    files, samples = [reduction.by_file[span.file] for span in spans], reduction.samples
    ends = [(span.first, span.last) for span in spans]
    motions = [
        _Motion.of(samples, f, first, min(last, first + LONGEST)) for f, (first, last) in zip(files, ends, strict=True)
    ]
    p, δ = np.concatenate([m.columns for m in motions]), np.concatenate([m.across for m in motions])
    s, size = np.einsum("ikcj,ikc->ij", p, δ), np.sqrt((p**2).sum(axis=(0, 1, 2)))
    if not (len(s) and size.all() and np.isfinite(s).all() and np.isfinite(size).all()):
        return None  # too short, or damaged
    s, p = s / size, p / size
    t, normal, (n, m) = s.sum(axis=0), np.einsum("ikcj,ikcl->jl", p, p), s.shape
    W = float(t @ np.linalg.lstsq(s.T @ s, t, rcond=SINGULAR)[0])
    if n <= m or scipy.special.fdtrc(m, n - m, (n - m) / m * W / max(n - W, SINGULAR)) > SWAY_SIGNIFICANCE:
        return None
    # variance of the tilt that both kinds of sensors show, and that of the integrated gyro noise in the median rest
    explained = float(t @ np.linalg.lstsq(normal, t, rcond=SINGULAR)[0] / (δ**2).sum()) * size[0] ** 2 / (δ.size / 3)
    density, longest = np.median([m.density for m in motions], axis=0), np.median([r.stop - r.start for r in spans])
    if 0.5 * explained <= density.mean() * longest / 3.0:
        return None
    whole = [_Motion.of(samples, f, *blocks) for f, blocks in zip(files, ends, strict=True)]
    return Sway(
        angle=float(np.sqrt(np.median([motion.angle for motion in whole]))),
        shortened=0.5 * np.array([motion.tilt for motion in whole]),
        force=tuple(motion.size * np.cross(motion.up, motion.path) for motion in whole),
        density=np.diag(density),
    )


def _detrended(values: Array) -> Array:
    """Return block means (K, 3, m) in stretches (s, STRETCH, 3, m), less the mean and slope of each."""
    stretches = values[: len(values) // STRETCH * STRETCH].reshape(-1, STRETCH, *values.shape[1:])
    x = np.arange(STRETCH) - 0.5 * (STRETCH - 1)
    x /= np.linalg.norm(x)
    off = stretches - stretches.mean(axis=1, keepdims=True)
    return np.asarray(off - x[:, None, None] * np.einsum("k,skcm->scm", x, off)[:, None])
