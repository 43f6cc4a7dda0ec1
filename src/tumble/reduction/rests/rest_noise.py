"""How uncertain the mean readings of rests are, from what the rests themselves show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from tumble.reduction.blocks.reducer import ChannelState, Reduction
from tumble.reduction.noise.coloured_noise import fit_coloured_noise
from tumble.reduction.noise.rounding import Rounding, rounding
from tumble.reduction.rests.segmentation import RestSpan
from tumble.rotation import tangent_basis
from tumble.sensors.model import Block
from tumble.units import Array


def accel_covariance(series: list[Array], block: Block) -> Array:
    """Covariance (N, n, n) of the mean accelerometer readings.

    A rest in which the body slowly tilts shows it in the horizontal directions, where it would pass for sensor
    noise; the vertical, and for n > 3 the directions that no specific force explains, are free of it to first
    order. The two kinds of direction therefore have noises of their own. Channels are first divided by their
    noise from block to block; a rough bias is taken off first, lest it should turn the directions."""
    size = np.sqrt(np.median([np.diff(s, axis=0).var(axis=0) for s in series], axis=0))
    size = np.where(size > 0.0, size, 1.0)
    mean = np.array([s.mean(axis=0) for s in series])
    force = mean @ np.linalg.pinv(block.axes).T
    force = force - _rough_bias(force)
    tilted = np.einsum("pk,ijk->ipj", block.axes, tangent_basis(force / np.linalg.norm(force, axis=1, keepdims=True)))
    basis, _ = np.linalg.qr(tilted / size[:, None], mode="complete")
    rotated = [s / size @ q for s, q in zip(series, basis, strict=True)]
    variance = np.empty_like(mean)
    for group in (slice(0, 2), slice(2, None)):
        columns = [r[:, group][:, [c]] for r in rotated for c in range(r[:, group].shape[1])]
        fit = fit_coloured_noise(columns)
        each = [fit.covariance_of_mean(len(x), i)[0, 0] for i, x in enumerate(columns)]
        variance[:, group] = np.array(each).reshape(len(series), -1).mean(axis=1, keepdims=True)
    scaled = basis * size[:, None]
    covariance = scaled * variance[:, None, :] @ np.swapaxes(scaled, 1, 2)
    return np.asarray(covariance)


def _rough_bias(force: Array) -> Array:
    """The centre (3,) of the sphere through specific forces (N, 3) at rest; zero where they do not tell."""
    rows = np.column_stack([2.0 * force, np.ones(len(force))])
    solution, _, rank, singular = np.linalg.lstsq(rows, (force**2).sum(axis=1))
    size = float(np.linalg.norm(force, axis=1).mean())
    seen = rank == 4 and len(force) >= 6 and singular[-1] > 0.1
    return np.asarray(solution[:3]) if seen and float(np.linalg.norm(solution[:3])) < 0.5 * size else np.zeros(3)


def density(covariance: Array, seconds: Array) -> Array:
    """Noise density (N, n), unit/√Hz, behind the covariance of the means."""
    return np.sqrt(np.diagonal(covariance, axis1=1, axis2=2) * seconds[:, None])


def drift(series: list[Array]) -> Array:
    """Change of the readings over each rest: least-squares slope times duration."""
    out = []
    for s in series:
        x = np.arange(len(s)) - 0.5 * (len(s) - 1)
        out.append(x @ s / (x @ x) * len(s))
    return np.array(out)


def channel_rounding(
    reduction: Reduction, spans: tuple[RestSpan, ...], kind: Literal["accel", "gyro", "magnetometer"]
) -> Rounding:
    """The rounding of one kind of channels."""
    channels: Sequence[ChannelState] = getattr(reduction, f"{kind}_channels")
    ends = {f.file: getattr(f, kind).ends for f in reduction.files}
    rests = [ends[s.file][s.first : s.last] for s in spans]
    every = list(ends.values())
    return rounding(every[0] if len(every) == 1 else np.concatenate(every), rests, channels)
