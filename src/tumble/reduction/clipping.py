"""Turns in which gyros were clipped: their readings end where those of their converter do.

Numbers of a converter end at 2^k − 1 and −2^k. A gyro that reads this in a turn turned faster than it can say, so that
nobody knows where the turn has led; such a turn is left out and named. Turns of gyros in physical units, whose
converter is not known, are judged by whether they fit.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from tumble.recording.gaps import Gap
from tumble.recording.session import Channels
from tumble.reduction.array_motion import read_by
from tumble.reduction.blocks import Reduction, extremes
from tumble.reduction.matching import Match
from tumble.sensors.model import Block
from tumble.units import Array, BoolArray

CONVERTERS = 2.0 ** np.arange(11, 32)
"""2^k of converters of 12 to 32 bits."""
EXACT = 1e-6
FEWEST = 2
"""Samples of a turn: a single one at the end of the range may just have reached it."""


def without_clipped_turns(reduction: Reduction, match: Match, gyro: Block, channels: Channels) -> Reduction:
    """A reduction in which turns with clipped gyros were not recorded."""
    limits, samples = _limits(reduction, channels), reduction.samples
    if samples is None or not np.isfinite(limits).any():
        return reduction
    files, gaps = reduction.by_file, list[Gap]()
    for before, after in pairwise(match.rests):
        if before.file != after.file:
            continue
        of = files[before.file]
        start, stop = of.sample_at(before.last), of.sample_at(after.first)
        rates, _, _, spare = samples.read_with_spare(start, stop)
        of_gyros = spare[:, max(spare.shape[1] - (gyro.size - 3), 0) :]
        if of_gyros.shape[1] < gyro.size - 3:
            continue  # more than three gyros, and of their samples the rate alone
        count = int(_clipped(read_by(gyro, rates, of_gyros), limits).sum())
        if count < FEWEST:
            continue
        gap = Gap(
            file=before.file,
            row=0,
            time=before.stop,
            samples=count,
            what="clipped",
            stop=after.start,
            integrable=False,
            why=f"gyros are clipped in {count} of its samples",
        )
        gaps.append(gap)
    return replace(reduction, gaps=(*reduction.gaps, *gaps)) if gaps else reduction


def _limits(reduction: Reduction, channels: Channels) -> Array:
    """The least and the most (2, n) that gyros read, SI, where that is where a converter ends; else infinite."""
    if channels.unit_name != "count":
        return np.full((2, len(reduction.gyro_channels)), np.inf)
    read = extremes(reduction.gyro_channels)
    raw = read / channels.unit.factor * channels.scale + channels.offset
    ends = np.array([-CONVERTERS, CONVERTERS - 1.0])
    at_end = (np.abs(raw[:, :, None] - ends[:, None]) < EXACT).any(axis=2)
    return np.where(at_end, read, np.array([[-np.inf], [np.inf]]))


def _clipped(readings: Array, limits: Array) -> BoolArray:
    """Samples (m,) of readings (m, n) in which a gyro is at a limit."""
    least, most = limits * (1.0 - EXACT)
    return np.asarray(((readings <= least) | (readings >= most)).any(axis=1))
