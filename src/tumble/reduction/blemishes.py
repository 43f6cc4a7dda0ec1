"""Single bad samples in what is otherwise a rest: a bit that fell over, a packet that was misread.

A block stands out where the second before it and the second after it agree, in every channel, and it is off their mean
by more than BEYOND times the scatter within them. What is off in it must be samples of no longer than BRIEF together,
without which the block is like its neighbours: a device that was knocked, or turned a little, shows that for longer,
and goes on being two rests with a turn between. A block with bad samples is left out of the mean of the rest, as if it
had not been recorded, and stands for no movement where rests are looked for. The samples of turns stay as they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tumble.reduction.blocks import Blemish, FileBlocks, Reduction
from tumble.reduction.segmentation import RestSpan, inner_mean, inner_variance
from tumble.units import Array, IntArray

SIDE_SECONDS = 1.0
LONGEST_SECONDS = 0.3
"""Of blocks in a row with bad samples: with sides of SIDE_SECONDS most of what is seen is sound."""
BEYOND = 12.0
"""Times the scatter of blocks; from 20 of them it is uncertain by 16 %, so that an hour has a false alarm once in
thousands."""
AGREE = 4.0
"""Times its standard error: how far the means of the two sides may differ."""
SAMPLE_BEYOND = 6.0
"""Times the scatter of samples: what is a bad one in a block that stands out."""
BRIEF = 0.03
"""s: a body does not turn and come to rest again in so short a time by an angle that anybody would notice."""


def without_blemishes(reduction: Reduction) -> Reduction:
    """A reduction whose blocks with bad samples have the mean of the seconds beside them and no weight. That of a log
    without gyros, of which no samples are kept, stays as it is."""
    if reduction.samples is None:
        return reduction
    found = [list(_blemishes(reduction, f)) for f in reduction.files]
    if not any(found):
        return reduction
    files = tuple(_mended(f, each, reduction) if each else f for f, each in zip(reduction.files, found, strict=True))
    return replace(reduction, files=files, blemishes=tuple(one for each in found for one in each))


def blemish_notes(reduction: Reduction, spans: Sequence[RestSpan]) -> tuple[str, ...]:
    """The bad samples that were left out of rests, counted, in words."""
    inside = [
        (number + 1, one)
        for number, span in enumerate(spans)
        for one in reduction.blemishes
        if one.file == span.file and span.first <= one.first < span.last
    ]
    if not inside:
        return ()
    rests, count = sorted({number for number, _ in inside}), sum(one.samples for _, one in inside)
    named = ", ".join(map(str, rests[:5])) + (f" and {len(rests) - 5} more" if len(rests) > 5 else "")
    what = "1 bad sample, far off those about it," if count == 1 else f"{count} bad samples, far off those about them,"
    where = f"rest{'' if len(rests) == 1 else 's'} {named}"
    return (f"{what} left out of {where}, with a tenth of a second each; the first at {inside[0][1].start:.1f} s",)


def _side(reduction: Reduction) -> int:
    """Blocks in a side."""
    return max(2, round(SIDE_SECONDS / reduction.block_seconds))


def _blemishes(reduction: Reduction, f: FileBlocks) -> Iterator[Blemish]:
    """The blemishes of a file, the shortest first."""
    assert f.gyro is not None
    side = _side(reduction)
    if len(f.accel) <= 2 * side:
        return
    values = np.hstack([f.accel, f.gyro])
    steps = np.array([channel.step for channel in (*reduction.accel_channels, *reduction.gyro_channels)])
    sides = _Sides.of(values, np.where(np.isfinite(steps), steps, 0.0), side)
    taken = np.zeros(len(values), dtype=bool)
    for length in range(1, int(LONGEST_SECONDS / reduction.block_seconds * (1.0 + 1e-9)) + 1):
        for first in sides.standing_out(values, length).tolist():
            run = slice(first, first + length)
            samples = 0 if taken[run].any() else _bad_samples(reduction, f, first, length)
            if samples:
                taken[run] = True
                yield Blemish(file=f.file, first=first, last=run.stop, start=float(f.edges[first]), samples=samples)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Sides:
    """The means and variances (·, n) of every `side` blocks in a row, and the resolution (n,) of the channels."""

    side: int
    mean: Array
    variance: Array
    coarse: Array

    @staticmethod
    def of(values: Array, coarse: Array, side: int) -> _Sides:
        mean = inner_mean(values, side)
        variance = inner_variance(values, mean, side) * (side / (side - 1.0))
        return _Sides(side=side, mean=mean, variance=variance, coarse=coarse)

    def standing_out(self, values: Array, length: int) -> IntArray:
        """The first blocks of runs of a length whose mean stands out from the sides before and after them."""
        side, mean = self.side, self.mean
        count = len(values) - 2 * side - length + 1
        if count < 1:
            return np.zeros(0, dtype=np.int64)
        before, after = slice(0, count), slice(side + length, side + length + count)
        scatter = np.sqrt(0.5 * (self.variance[before] + self.variance[after]))
        off = np.abs(inner_mean(values[side : side + count + length - 1], length) - 0.5 * (mean[before] + mean[after]))
        beyond = (off > BEYOND * scatter + self.coarse).any(axis=1)
        agree = np.abs(mean[after] - mean[before]) <= AGREE * np.sqrt(2.0 / side) * scatter + self.coarse
        return np.asarray(side + np.flatnonzero(beyond & agree.all(axis=1)))


def _bad_samples(reduction: Reduction, f: FileBlocks, first: int, length: int) -> int:
    """How many samples of a run of blocks are off those of the sides; 0 where they last too long, or the others are off
    too."""
    assert reduction.samples is not None
    side = _side(reduction)
    rates, forces, dt = reduction.samples.read(f.sample_at(first - side), f.sample_at(first + length + side))
    values, run = np.hstack([rates, forces]), slice(f.size * side, f.size * (side + length))
    sides = np.concatenate([values[: run.start], values[run.stop :]])
    off, scatter = values[run] - sides.mean(axis=0), sides.std(axis=0)
    bad = (np.abs(off) > SAMPLE_BEYOND * scatter).any(axis=1)
    sound = off[~bad]
    if not bad.any() or float(dt[run][bad].sum()) > BRIEF or not len(sound):
        return 0
    alike = (np.abs(sound.mean(axis=0)) <= AGREE * scatter / np.sqrt(len(sound))).all()
    return int(bad.sum()) if alike else 0


def _mended(f: FileBlocks, found: Sequence[Blemish], reduction: Reduction) -> FileBlocks:
    """A file's blocks with those of blemishes like their neighbours, and without weight in a mean."""
    assert f.gyro is not None
    assert f.gyro_end is not None
    assert f.gyro_tail is not None
    accel, gyro, ends = f.accel.copy(), f.gyro.copy(), (f.accel_end.copy(), f.gyro_end.copy())
    sound, side = np.ones(len(f.accel)), _side(reduction)
    for one in found:
        run = slice(one.first, one.last)
        beside = [*range(one.first - side, one.first), *range(one.last, one.last + side)]
        accel[run], gyro[run] = f.accel[beside].mean(axis=0), f.gyro[beside].mean(axis=0)
        for end in ends:
            end[run] = end[one.first - 1]
        sound[run] = 0.0
    tails = [replace(tail, blocks=tail.blocks * sound) for tail in (f.accel_tail, f.gyro_tail)]
    return replace(
        f, accel=accel, gyro=gyro, accel_end=ends[0], gyro_end=ends[1], accel_tail=tails[0], gyro_tail=tails[1]
    )
