"""Turns of which the gyros do not say where they have led, left out and named: gyros were clipped, or read more than
half a turn from sample to sample.

Numbers of a converter end at 2^k − 1 and −2^k. A gyro that reads this in a turn turned faster than it can say, so that
nobody knows where the turn has led. Turns of gyros in physical units, whose converter is not known, are judged by
whether they fit.

A reading of more than half a turn from sample to sample is no reading: what a turn by more is cannot be told from one
the other way round.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from tumble.recording.rows.gaps import Gap
from tumble.recording.session import Channels
from tumble.reduction.blocks.reducer import Reduction, extremes
from tumble.reduction.rests.segmentation import RestSpan, unrecorded
from tumble.reduction.turns.array_motion import read_by
from tumble.sensors.model import Block
from tumble.units import Array

CONVERTERS = 2.0 ** np.arange(11, 32)
"""2^k of converters of 12 to 32 bits."""
EXACT = 1e-6
HALF_TURN = math.pi


def without_unknown_turns(
    reduction: Reduction, rests: tuple[RestSpan, ...], gyro: Block, channels: Channels
) -> Reduction:
    """A reduction in which turns between these rests with clipped gyros, or with readings of more than half a turn from
    sample to sample, were not recorded."""
    clipped, fast = dict[int, Gap](), dict[int, Gap]()
    limits, turns, beyond = _limits(reduction, channels), list(pairwise(rests)), gyro.size - 3
    may_clip = np.isfinite(limits).any()
    may_be_fast = 2.0 * np.abs(extremes(reduction.gyro_channels)).max() > HALF_TURN * reduction.rate
    for k, (before, after) in enumerate(turns if may_clip or may_be_fast else ()):
        if before.file != after.file or reduction.samples is None:
            continue
        f = reduction.by_file[before.file]
        start, stop = f.sample_at(before.last), f.sample_at(after.first)
        rates, _, intervals, spare = reduction.samples.read_with_spare(start, stop)
        of_gyros = spare[:, max(spare.shape[1] - beyond, 0) :]
        if may_clip and of_gyros.shape[1] == beyond:  # else more than three gyros, and of their samples the rate alone
            least, most = limits * (1.0 - EXACT)
            readings = read_by(gyro, rates, of_gyros)
            count = int(((readings <= least) | (readings >= most)).any(axis=1).sum())
            if count >= reduction.tuning.fewest_clipped:
                why = f"gyros are clipped in {count} of its samples"
                clipped[k] = unrecorded(before, after, count, "no rotation", why)
        count = int((np.linalg.norm(rates, axis=1) * intervals > HALF_TURN).sum()) if may_be_fast else 0
        if count:
            why = f"gyros read more than half a turn from sample to sample, in {count} of its samples"
            fast[k] = unrecorded(before, after, count, "no rotation", why)
    if 2 * len(fast) > len(turns):
        fast = {}  # then it is the unit or the rate that is wrong, which is said elsewhere
    gaps = {**fast, **clipped}
    return replace(reduction, gaps=(*reduction.gaps, *gaps.values())) if gaps else reduction


def _limits(reduction: Reduction, channels: Channels) -> Array:
    """The least and the most (2, n) that gyros read, SI, where that is where a converter ends; else infinite."""
    if channels.unit_name != "count":
        return np.full((2, len(reduction.gyro_channels)), np.inf)
    read = extremes(reduction.gyro_channels)
    raw = read / channels.unit.factor * channels.scale + channels.offset
    ends = np.array([-CONVERTERS, CONVERTERS - 1.0])
    at_end = (np.abs(raw[:, :, None] - ends[:, None]) < EXACT).any(axis=2)
    return np.where(at_end, read, np.array([[-np.inf], [np.inf]]))
