"""Rests of a log that grows, as early as they can be told.

The search is that of `find_rests`, over the whole log so far, with windows of half a second and no margins: a rest is
found half a second after it has begun, and its end as soon as something moves. The result depends on the log alone, not
on the pieces in which it came. A calibration uses `find_rests` itself, with longer windows and without the ends of a
rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tumble.recording.session import Exclusion
from tumble.reduction.blocks.reducer import FileBlocks, Reduction
from tumble.reduction.noise.coloured_noise import fit_coloured_noise
from tumble.reduction.rests.blemishes import without_blemishes
from tumble.reduction.rests.matching import without_times
from tumble.reduction.rests.segmentation import RestSpan, find_rests
from tumble.sensors.model import Block

FEWEST_BLOCKS = 30
"""Of a log, in which rests are looked for."""
_NOISE_BLOCKS = 10
"""From which the noise of a rest is estimated, at least."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RestsSoFar:
    """Rests of a log that grows.

    Attributes
    ----------
    rests
        The rests that have ended and are as long as a calibration asks, and last the one that lasts, if one does.
    still
        Whether nothing moves at the end of the log.
    lasting
        Whether the last of the rests reaches the end of the log.
    scatter_limit
        Scatter of the specific force within half a second up to which nothing moves, m/s².
    """

    rests: tuple[RestSpan, ...]
    still: bool
    lasting: bool
    scatter_limit: float


def rests_so_far(
    reduction: Reduction, accel: Block, gyro: Block | None, excluded: tuple[Exclusion, ...] = ()
) -> RestsSoFar | None:
    """Find the rests of the log so far.

    Parameters
    ----------
    reduction
        The reduction of the log so far, `Reducer.now()`.
    accel, gyro
        Sensors of the session.
    excluded
        Stretches of time to leave out. The longest part of a rest remains.

    Returns
    -------
    RestsSoFar or None
        None while the log is shorter than three seconds.
    """
    if sum(map(len, reduction.files)) < FEWEST_BLOCKS:
        return None
    usual = reduction.tuning
    quick = replace(usual, window=usual.short_window, rest=usual.short_window, margin_least=0.0, margin_fraction=0.0)
    with np.errstate(over="ignore", invalid="ignore"):  # of damaged samples
        reduction = replace(without_blemishes(reduction), tuning=quick)
        found = find_rests(reduction, accel, gyro)
    file, shortest = reduction.files[-1], usual.rest + 2.0 * usual.margin_least
    kept = without_times(reduction, found, excluded).rests
    ended = tuple(span for span in kept if not _lasts(span, file) and span.stop - span.start >= shortest - 1e-9)
    lasting = tuple(span for span in kept[-1:] if _lasts(span, file))
    return RestsSoFar(
        rests=ended + lasting,
        still=any(_lasts(span, file) for span in found.rests[-1:]),
        lasting=bool(lasting),
        scatter_limit=found.scatter_limit,
    )


def _lasts(span: RestSpan, file: FileBlocks) -> bool:
    """Whether a rest reaches the end of the last file; a single block there may be off by chance."""
    return span.file == file.file and span.last >= len(file) - 1


@dataclass(frozen=True, kw_only=True, slots=True)
class MeanSoFar:
    """How well the mean of a rest is known, from the noise in this rest alone.

    Attributes
    ----------
    accel_u, gyro_u
        Standard uncertainty of the mean, m/s² and rad/s, the largest among the channels. None while the rest is shorter
        than a second, and without gyros.
    accel_twice, gyro_twice
        The same after twice the time.
    """

    accel_u: float | None
    gyro_u: float | None
    accel_twice: float | None
    gyro_twice: float | None


def mean_so_far(reduction: Reduction, first: int, last: int) -> MeanSoFar:
    """How well the mean over blocks first … last − 1 of the last file is known."""
    file, values = reduction.files[-1], list[float | None]()
    for series in (file.accel, file.gyro):
        means = series.means[first:last]
        if len(means) < _NOISE_BLOCKS or not means.shape[1]:
            values += [None, None]
            continue
        noise = fit_coloured_noise([means])
        values += [float(np.sqrt(np.diag(noise.covariance_of_mean(k * len(means))).max())) for k in (1.0, 2.0)]
    accel_u, accel_twice, gyro_u, gyro_twice = values
    return MeanSoFar(accel_u=accel_u, gyro_u=gyro_u, accel_twice=accel_twice, gyro_twice=gyro_twice)
