"""Single bad samples in what is otherwise a rest: a bit that fell over, a packet that was misread.

A block stands out where the second before it and the second after it agree, in every channel, and it is off their mean
by more than BEYOND times the scatter within them. What is off in it must be samples of no longer than BRIEF together,
without which the block is like its neighbours: a device that was knocked, or turned a little, shows that for longer,
and goes on being two rests with a turn between. A block with bad samples is left out of the mean of the rest, as if it
had not been recorded, and stands for no movement where rests are looked for.

In a turn, where there is no mean to compare with, a sample is compared with the cubic through the two before and the
two after it: it is off by a sixth of its fourth difference. The band of a channel is the most that others are off in
a quarter of a second, once what is judged is replaced, and at least the noise of the rests. What is bad is beyond
that, and its neighbours are not: a sensor follows a blow through its filter and the body rings after it. A blow may
still be over within a sample. But it is felt by several sensors, along the axis of one only by an unlikely chance, and
it leaves a velocity. So samples are bad where one channel alone stands out, or where the body would have to change its
velocity or its attitude by what nobody's hand does in a sample. They have the value of the cubic then, in the channels
that stand out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tumble.reduction.blocks import Blemish, FileBlocks, Reduction
from tumble.reduction.motion_samples import MotionSamples
from tumble.reduction.segmentation import RestSpan, inner_mean, inner_variance
from tumble.units import Array, BoolArray, IntArray

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
BAND_SECONDS = 0.25
BAND_SAMPLES = 12
"""At least, on either side: of 24 samples of noise the largest is some two standard deviations off."""
BEYOND_BAND = 4.0
"""Times the band: what independent Gaussian samples exceed once in 1e12, and"""
BEYOND_REST = 9.0
"""times the standard deviation of a sample at rest, and"""
BEYOND_STEP = 3.0
"""times the resolution."""
ALONE = 30.0
"""Times what other channels of its kind show: a blow along an axis to 1/30 rad is one of 600 in any direction."""
VIOLENT = 0.5, 0.1
"""m/s and rad: changes of velocity and attitude in a sample that no hand makes, nor a table."""
LONGEST_RUN = 3
"""Times that a bad sample is held at most, within BRIEF: others in a row may be a blow."""
AT_A_TIME = 2**17
"""Samples of a turn that are looked at."""


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


# Turns


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class BadSamples:
    """Bad samples of turns, by their place (m,) among the stored ones, ascending, with the turn (m,) they are of, and
    rates, rad/s, and forces, m/s² (m, 6), to have in their place."""

    at: IntArray
    turn: IntArray
    values: Array

    def note(self, first: IntArray) -> tuple[str, ...]:
        """What there is to say of them, where turns begin at rests `first` (K,)."""
        if not len(self.at):
            return ()
        turns = np.unique(first[self.turn]) + 1
        named = ", ".join(f"{i} to {i + 1}" for i in turns[:5].tolist())
        named += f" and {len(turns) - 5} more" if len(turns) > 5 else ""
        count = len(self.at)
        what = (
            "1 bad sample, far off those beside it,"
            if count == 1
            else f"{count} bad samples, far off those beside them,"
        )
        return (f"{what} replaced by what is between these in the turn{'' if len(turns) == 1 else 's'} {named}",)


NO_BAD_SAMPLES = BadSamples(at=np.zeros(0, dtype=np.int64), turn=np.zeros(0, dtype=np.int64), values=np.zeros((0, 6)))


def bad_samples_of_turns(
    samples: MotionSamples,
    start: IntArray,
    stop: IntArray,
    within: tuple[IntArray, IntArray],
    rate: float,
    least: Array,
) -> BadSamples:
    """The bad samples of turns from `start` to `stop` (K,) in files that are `within` these samples (K,) each, at a
    sample rate, Hz; `least` (6,) is what rates, rad/s, and forces, m/s², have to be off by."""
    beside, found = max(BAND_SAMPLES, round(BAND_SECONDS * rate)), list[tuple[int, int, Array]]()
    for turn, (begin, end, low, high) in enumerate(zip(start, stop, *within, strict=True)):
        for first in range(int(begin), int(end), AT_A_TIME):
            last = min(first + AT_A_TIME, int(end))
            before = max(first - beside - 2, int(low))
            rates, forces, dt = samples.read(before, min(last + beside + 2, int(high)))
            values = np.hstack([rates, forces])
            for at, mended in _bad_in(values, dt, beside, least):
                if first <= before + at < last:
                    found.append((before + at, turn, mended))
    return BadSamples(
        at=np.array([at for at, _, _ in found], dtype=np.int64),
        turn=np.array([turn for _, turn, _ in found], dtype=np.int64),
        values=np.array([values for _, _, values in found]).reshape(-1, 6),
    )


def _bad_in(values: Array, dt: Array, beside: int, least: Array) -> Iterator[tuple[int, Array]]:
    """The places of bad samples among rates and forces (m, 6) at intervals (m,), and what to have there; a band is
    that of so many samples `beside` them."""
    from scipy.ndimage import maximum_filter1d

    reach = LONGEST_RUN + 2
    if len(values) < 2 * (BAND_SAMPLES + reach) + 1:
        return
    off = np.abs(_off_cubic(values))
    wide = beside - reach
    of_side = maximum_filter1d(off, wide, axis=0, mode="constant")
    sides = np.zeros_like(off)
    gap = reach + wide // 2
    sides[gap:] = of_side[:-gap]
    sides[:-gap] = np.maximum(sides[:-gap], of_side[gap:])
    suspect = np.flatnonzero((off > np.maximum(BEYOND_BAND * sides, least)).any(axis=1))
    for group in np.split(suspect, np.flatnonzero(np.diff(suspect) > reach) + 1) if len(suspect) else ():
        run = _bad_run(values, dt, (int(group[0]), int(group[-1]) + 1), beside, least)
        if run is not None:
            first, mended = run
            yield from ((first + i, row) for i, row in enumerate(mended))


def _off_cubic(values: Array) -> Array:
    """By how much values (m, n) are off the cubic through the two before and the two after; 0 at the ends."""
    out = np.zeros_like(values)
    out[2:-2] = np.diff(values, n=4, axis=0) / 6.0
    return out


def _bad_run(values: Array, dt: Array, among: tuple[int, int], beside: int, least: Array) -> tuple[int, Array] | None:
    """The shortest run of bad samples `among` suspects, as its first and what to have in its place; None where there is
    none."""
    for length in range(1, LONGEST_RUN + 1):
        for first in range(max(among[0] - 1, 2), min(among[1] + 1, len(values) - length - 1)):
            run = slice(first, first + length)
            if length > 1 and dt[run].sum() > BRIEF:
                continue
            low, high = max(first - beside - 2, 0), min(run.stop + beside + 2, len(values))
            if min(first - low, high - run.stop) < BAND_SAMPLES:
                continue
            near, inner = values[low:high].copy(), slice(first - low, run.stop - low)
            near[inner] = mended = _between(values, run)
            band = np.maximum(BEYOND_BAND * np.abs(_off_cubic(near)).max(axis=0), least)
            off = values[run] - mended
            beyond = np.abs(off).max(axis=0) > band
            about = slice(inner.start - 2, inner.stop + 2)
            others = np.abs(_off_cubic(np.where(beyond, 0.0, near)))
            far = np.delete(others, np.r_[about], axis=0).max(axis=0)
            stirred = others[about].max(axis=0) > np.maximum(BEYOND_BAND * far, least)
            if stirred.any():
                continue  # a lever arm feels a rate that steps
            held = np.all(np.ptp(values[run][:, beyond], axis=0) == 0.0)
            if beyond.any() and held and _corrupt(off, dt[run], beyond):
                return first, np.where(beyond, mended, values[run])
    return None


def _between(values: Array, run: slice) -> Array:
    """What the cubic through the two samples before and the two after a run has in it."""
    length = run.stop - run.start
    nodes, inside = np.array([-2.0, -1.0, length, length + 1.0]), np.arange(float(length))
    weights = np.array([
        np.prod([(inside - b) / (a - b) for b in nodes if b != a], axis=0) for a in nodes
    ])  # fmt: skip
    return np.asarray(weights.T @ values[[run.start - 2, run.start - 1, run.stop, run.stop + 1]])


def _corrupt(off: Array, dt: Array, beyond: BoolArray) -> bool:
    """Whether rates and forces (k, 6) that are off by so much at intervals (k,), `beyond` their bands (6,), are of no
    motion."""
    size, kind = np.abs(off).max(axis=0), np.repeat([0, 1], 3)
    if np.any((off * np.sign(off[0])).min(axis=0)[beyond] < 0.5 * size[beyond]):
        return False  # a step from one sample to the next, as of a table that starts at once
    if beyond.sum() == 1:
        (one,) = np.flatnonzero(beyond)
        others = (kind == kind[one]) & ~beyond
        if size[one] > ALONE * size[others].max():
            return True
    turned, moved = (float(np.linalg.norm(dt @ off[:, kind == k])) for k in (0, 1))
    return moved > VIOLENT[0] or turned > VIOLENT[1]
