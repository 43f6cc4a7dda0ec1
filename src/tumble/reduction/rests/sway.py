"""Sway of a device that is held in the hand while it rests: what it moves by, and whether it does.

A body that sways by small angles α(t) about its mean attitude reads the specific force

    f̄ + f̄ × α + α̈ × r,        |mean f| = g (1 − ½ mean |û × α|²)

at a distance r from the point it sways about, û along f̄. Its gyros read α too, as the integral of the rate, so that the
two agree where the body moves, and are independent where sensors are noisy, whatever the colour of the noise. In
stretches of a second, with what is across û as block means less its mean and slope, let δ be the forces and p_j the
m = 4 columns û × α and ω̇ × e_j. Without sway the sums s_j = Σ p_j·δ of the n stretches have the mean 0 (Hotelling's
test): with t = Σ s and W = tᵀ (Σ s sᵀ)⁻¹ t, (n − m) W / m (n − W) has Fisher's distribution of m and n − m degrees of
freedom. Both see the part of |û × α|² that a fit of δ by these columns explains of |δ|².

The noise of the gyros beside the sway is that of their samples, by differences of fourth order, in which there is next
to nothing of a hand. The noise of the mean of a rest is that of the forces less f̄ × α: turns go from mean attitude to
mean attitude, so that a rest which sways is known as well as one that does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from tumble.reduction.blocks.reducer import Reduction
from tumble.reduction.rests.segmentation import Stretch
from tumble.rotation import unit_vector
from tumble.units import DEGREE, Array

FOURTH_DIFFERENCES = 70.0
"""Variance of the fourth differences, 1 −4 6 −4 1, of independent samples, in parts of theirs."""
STRETCH = 10
"""Blocks, 1 s, of a stretch."""
LONGEST = 1000
"""Blocks, 100 s, of a rest that are looked at."""
CHANCE = 1e-5
"""Probability of sums that are as large without sway, below which there is sway."""
LEAST = 1e-12
"""Of a normal matrix, below which a direction in it is none."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Sway:
    """Sway of a device in its rests.

    Attributes
    ----------
    angle
        Root mean square an axis about the mean attitude of a rest, of the median rest, rad.
    shortened
        Part (N,) by which the mean specific force of each rest is shortened.
    force
        What sway adds to the specific force of each rest, means of blocks (K, 3) in the body, m/s², of mean 0.
    density
        Density (3, 3) of the noise of the gyros in the body without sway, rad²/s.
    """

    angle: float
    shortened: Array
    force: tuple[Array, ...]
    density: Array


def sway_of(reduction: Reduction, spans: Sequence[Stretch]) -> Sway | None:
    """Find out whether a device sways in its rests by more than the noise of its gyros adds up to in one.

    Parameters
    ----------
    reduction
        The reduction of a log.
    spans
        The rests.

    Returns
    -------
    Sway or None
        None where the device lies still, where the noise of the gyros hides what it does, and without gyros.
    """
    if reduction.samples is None:
        return None
    columns, forces, tilts, angles, variances = [], list[Array](), list[float](), list[float](), list[Array]()
    added = list[Array]()
    for span in spans:
        f = reduction.by_file[span.file]
        last = min(span.last, span.first + LONGEST)
        rate, force, dt = reduction.samples.read(f.sample_at(span.first), f.sample_at(last))
        path, up = np.cumsum((rate - rate.mean(axis=0)) * dt[:, None], axis=0), unit_vector(force.mean(axis=0))
        path -= path.mean(axis=0)
        tilt, change = np.cross(up, path), np.gradient(rate, axis=0) / dt.mean()
        across = [tilt, *(each - (each @ up)[:, None] * up for each in (np.cross(change, e) for e in np.eye(3)))]
        columns.append(np.stack([_level(each, f.size) for each in across], axis=-1))
        forces.append(_level(force - (force @ up)[:, None] * up, f.size))
        added.append(np.zeros((span.last - span.first, 3)))
        added[-1][: last - span.first] = np.cross(force.mean(axis=0), path.reshape(-1, f.size, 3).mean(axis=1))
        tilts.append(float((tilt**2).sum(axis=1).mean()))
        angles.append(float(np.sqrt((path**2).mean())))
        differences = np.diff(rate * dt[:, None], n=4, axis=0)
        variances.append((differences**2).sum(axis=0) / (FOURTH_DIFFERENCES * dt[4:].sum()))
    p, δ = np.concatenate(columns), np.concatenate(forces)
    s, size = np.einsum("ikcj,ikc->ij", p, δ), np.sqrt((p**2).sum(axis=(0, 1, 2)))
    if not (len(s) and size.all() and np.isfinite(s).all() and np.isfinite(size).all()):
        return None  # too short, or damaged
    s, p = s / size, p / size
    t, normal, (n, m) = s.sum(axis=0), np.einsum("ikcj,ikcl->jl", p, p), s.shape
    W = float(t @ np.linalg.lstsq(s.T @ s, t, rcond=LEAST)[0])
    if n <= m or scipy.special.fdtrc(m, n - m, (n - m) / m * W / max(n - W, LEAST)) > CHANCE:
        return None
    explained = float(t @ np.linalg.lstsq(normal, t, rcond=LEAST)[0] / (δ**2).sum())
    density, longest = np.median(variances, axis=0), float(np.median([span.stop - span.start for span in spans]))
    if 0.5 * explained * size[0] ** 2 / (δ.size / 3) <= density.mean() * longest / 3.0:
        return None
    return Sway(
        angle=float(np.median(angles)), shortened=0.5 * np.array(tilts), force=tuple(added), density=np.diag(density)
    )


def _level(values: Array, size: int) -> Array:
    """Means of blocks of so many of the values (m, 3) in stretches (s, STRETCH, 3), less the mean and the slope of
    each."""
    whole = len(values) // (STRETCH * size) * STRETCH * size
    stretches = values[:whole].reshape(-1, STRETCH, size, 3).mean(axis=2)
    x = np.arange(STRETCH) - 0.5 * (STRETCH - 1)
    x /= np.linalg.norm(x)
    off = stretches - stretches.mean(axis=1, keepdims=True)
    return np.asarray(off - x[:, None] * np.einsum("k,skc->sc", x, off)[:, None])


def sway_notes(sway: Sway | None) -> tuple[str, ...]:
    """That a device sways, and what to do about it, as notes."""
    if sway is None:
        return ()
    return (
        f"the device sways by {sway.angle / DEGREE:.2g}° in its rests, as in the hand; the gyros follow it, so that "
        "turns are taken from mean attitude to mean attitude; put it down on something firm in each position: "
        "everything is known better, the biases of the gyros most of all",
    )
