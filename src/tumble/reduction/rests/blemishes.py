"""Single bad samples, from a wrong bit or a misread packet, in rests and in turns.

In a rest, a block contains bad samples if the second before it and the second after it agree in every channel, and it
is off their mean by more than `block_beyond` standard deviations of their blocks. The bad samples must last no longer
than `brief` together, and the block without them must agree with its neighbours: the effect of a knock, or of a small
turn, lasts longer, and makes two rests with a turn between them. A block with bad samples has no weight in the mean of
the rest, and does not count as motion in the search for rests.

In a turn there is no mean to compare with. A sample is compared with the cubic through the two samples before and the
two after it (Hampel's test about a local fit), from which it is off by a sixth of its fourth difference. The band of a
channel is the largest such distance of other samples within a quarter of a second, with the suspect replaced, and at
least the noise of the rests. A bad sample is off by more, and its neighbours are not, since after a blow a sensor
responds through its filter and the body rings. It is off in one channel alone, or would change the velocity or the
attitude of the body by more than a hand can in one sample. In the channels in which it is off, its value is replaced by
that of the cubic. A blow, as of a device that is put down on a face, may still look like a bad sample: the closure of
the turn decides which suspects are replaced (`tumble.inference.mended_samples`).

The thresholds, with the probability that noise exceeds them, are in `Tuning`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from tumble.reduction.blocks.motion_samples import MotionSamples
from tumble.reduction.blocks.reducer import Blemish, FileBlocks, Reduction
from tumble.reduction.blocks.tuning import USUAL, Tuning
from tumble.reduction.rests.segmentation import Stretch, sliding_mean, sliding_variance
from tumble.units import Array, BoolArray, IntArray

BATCH_SAMPLES = 2**17  # samples of a turn in memory at a time


def without_blemishes(reduction: Reduction) -> Reduction:
    """Return a reduction whose blocks with bad samples have the mean of the seconds beside them and no weight. Without
    gyros, no samples are stored, and nothing is changed."""
    if reduction.samples is None:
        return reduction
    side = max(2, round(reduction.tuning.side / reduction.block_seconds))
    by_file = [list(_find_blemishes(reduction, reduction.samples, f, side)) for f in reduction.files]
    if not any(by_file):
        return reduction
    files = []
    for f, blemishes in zip(reduction.files, by_file, strict=True):
        repaired = []
        for series in (f.accel, f.gyro):
            means, ends, weights = series.means.copy(), series.ends.copy(), series.weights.copy()
            for b in blemishes:
                run = slice(b.first, b.last)
                beside = [*range(b.first - side, b.first), *range(b.last, b.last + side)]
                means[run], ends[run], weights[run] = series.means[beside].mean(axis=0), ends[b.first - 1], 0.0
            repaired.append(replace(series, means=means, ends=ends, weights=weights))
        files.append(replace(f, accel=repaired[0], gyro=repaired[1]))
    return replace(reduction, files=tuple(files), blemishes=tuple(b for blemishes in by_file for b in blemishes))


def _find_blemishes(reduction: Reduction, samples: MotionSamples, f: FileBlocks, side: int) -> Iterator[Blemish]:
    """Yield the blemishes of a file, the shortest first, by comparison with `side` blocks before and after each."""
    tuning, values = reduction.tuning, np.asfortranarray(np.hstack([f.accel.means, f.gyro.means]))
    if len(values) <= 2 * side:
        return
    steps = np.array([channel.step for channel in (*reduction.accel_channels, *reduction.gyro_channels)])
    resolution = np.where(np.isfinite(steps), steps, 0.0)
    mean = sliding_mean(values, side)
    variance = sliding_variance(values, mean, side) * (side / (side - 1.0))
    is_taken = np.zeros(len(values), dtype=bool)
    for length in range(1, int(tuning.longest_blemish / reduction.block_seconds * (1.0 + 1e-9)) + 1):
        count = len(values) - 2 * side - length + 1
        if count < 1:
            return
        before, after = slice(0, count), slice(side + length, side + length + count)
        scatter = np.sqrt(0.5 * (variance[before] + variance[after]))
        off = np.abs(
            sliding_mean(values[side : side + count + length - 1], length) - 0.5 * (mean[before] + mean[after])
        )
        at = np.flatnonzero((off > tuning.block_beyond * scatter + resolution).any(axis=1))
        tolerance = tuning.sides_agree * np.sqrt(2.0 / side) * scatter[at] + resolution
        agree = (np.abs(mean[after][at] - mean[before][at]) <= tolerance).all(axis=1)
        for first in (side + at[agree]).tolist():
            run = slice(first, first + length)
            bad = 0 if is_taken[run].any() else _bad_samples(samples, f, run, side, tuning)
            if bad:
                is_taken[run] = True
                yield Blemish(file=f.file, first=first, last=run.stop, start=float(f.edges[first]), samples=bad)


def _bad_samples(samples: MotionSamples, f: FileBlocks, blocks: slice, side: int, tuning: Tuning) -> int:
    """Return the number of samples in a run of blocks that are off those of the sides; 0 if they last too long, or if
    the other samples are off too."""
    rates, forces, dt = samples.read(f.sample_at(blocks.start - side), f.sample_at(blocks.stop + side))
    values, run = np.hstack([rates, forces]), slice(f.size * side, len(dt) - f.size * side)
    sides = np.concatenate([values[: run.start], values[run.stop :]])
    off, scatter = values[run] - sides.mean(axis=0), sides.std(axis=0)
    is_bad = (np.abs(off) > tuning.sample_beyond * scatter).any(axis=1)
    sound = off[~is_bad]
    if not is_bad.any() or float(dt[run][is_bad].sum()) > tuning.brief or not len(sound):
        return 0
    agrees = (np.abs(sound.mean(axis=0)) <= tuning.sides_agree * scatter / np.sqrt(len(sound))).all()
    return int(is_bad.sum()) if agrees else 0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class BadSamples:
    """Bad samples of turns: their indices `at` (m,) among the stored samples, ascending, the `turn` of each (m,), and
    the rates, rad/s, and forces, m/s², that replace them, `values` (m, 6)."""

    at: IntArray
    turn: IntArray
    values: Array


NO_BAD_SAMPLES = BadSamples(at=np.zeros(0, dtype=np.int64), turn=np.zeros(0, dtype=np.int64), values=np.zeros((0, 6)))


def bad_samples_of_turns(
    samples: MotionSamples,
    start: IntArray,
    stop: IntArray,
    within: tuple[IntArray, IntArray],
    rate: float,
    least: Array,
    tuning: Tuning = USUAL,
) -> BadSamples:
    """Find the bad samples of turns, samples start[k] … stop[k] − 1 in files that are `within` two samples (K,), at a
    sample rate, Hz. `least`: smallest distance of a bad sample (6,), rates in rad/s and forces in m/s²."""
    n_band, bad = max(tuning.band_samples, round(tuning.band * rate)), list[tuple[int, int, Array]]()
    for turn, (begin, end, low, high) in enumerate(zip(start, stop, *within, strict=True)):
        for first in range(int(begin), int(end), BATCH_SAMPLES):
            last = min(first + BATCH_SAMPLES, int(end))
            before = max(first - n_band - 2, int(low))
            rates, forces, dt = samples.read(before, min(last + n_band + 2, int(high)))
            for at, replacement in _find_bad(np.hstack([rates, forces]), dt, n_band, least, tuning):
                if first <= before + at < last:
                    bad.append((before + at, turn, replacement))
    return BadSamples(
        at=np.array([at for at, _, _ in bad], dtype=np.int64),
        turn=np.array([turn for _, turn, _ in bad], dtype=np.int64),
        values=np.array([values for _, _, values in bad]).reshape(-1, 6),
    )


def _find_bad(values: Array, dt: Array, n_band: int, least: Array, tuning: Tuning) -> Iterator[tuple[int, Array]]:
    """Yield ascending indices of bad samples among rates and forces (m, 6) at intervals (m,), with their replacements.

    The band is that of `n_band` samples on either side."""
    reach = tuning.longest_run + 2
    if len(values) < 2 * (tuning.band_samples + reach) + 1:
        return
    off = _off_cubic(values)
    largest = _sliding_maximum(off, n_band - reach)
    sides, gap = np.zeros_like(off), reach + (n_band - reach) // 2
    sides[gap:] = largest[:-gap]
    sides[:-gap] = np.maximum(sides[:-gap], largest[gap:])
    suspects = np.flatnonzero((off > np.maximum(tuning.band_beyond * sides, least)).any(axis=1))
    if not len(suspects):
        return
    values = values.copy()
    for group in np.split(suspects, np.flatnonzero(np.diff(suspects) > reach) + 1):
        among, bad = (int(group[0]), int(group[-1]) + 1), dict[int, Array]()
        # a run may hide another one; no sample is replaced twice, so that this ends
        while run := {at: row for at, row in _bad_run(values, dt, among, n_band, least, tuning) if at not in bad}:
            values[list(run)] = list(run.values())
            bad |= run
        yield from ((at, bad[at]) for at in sorted(bad))


def _sliding_maximum(values: Array, width: int) -> Array:
    """Return the maximum of `width` values ≥ 0 about each of (m, n), by windows of 1, 2, 4, … values."""
    largest, window = np.zeros((len(values) + width - 1, values.shape[1])), 1
    largest[width // 2 : width // 2 + len(values)] = values
    while window < width:
        step = min(window, width - window)
        largest, window = np.maximum(largest[:-step], largest[step:]), window + step
    return largest


def _off_cubic(values: Array) -> Array:
    """Return distances (m, n) of values from the cubic through the two before and the two after; 0 at the ends."""
    out = np.zeros_like(values)
    out[2:-2] = np.abs(np.diff(values, n=4, axis=0)) / 6.0
    return out


def _bad_run(
    values: Array, dt: Array, among: tuple[int, int], n_band: int, least: Array, tuning: Tuning
) -> Iterator[tuple[int, Array]]:
    """Yield the indices of the shortest run of bad samples `among` suspects, with their replacements."""
    for length in range(1, tuning.longest_run + 1):
        for first in range(max(among[0] - 1, 2), min(among[1] + 1, len(values) - length - 1)):
            run = slice(first, first + length)
            low, high = max(first - n_band - 2, 0), min(run.stop + n_band + 2, len(values))
            too_long = length > 1 and dt[run].sum() > tuning.brief
            if too_long or min(first - low, high - run.stop) < tuning.band_samples:
                continue
            near, inner = values[low:high].copy(), slice(first - low, run.stop - low)
            ends = values[[first - 2, first - 1, run.stop, run.stop + 1]]
            near[inner] = cubic = _cubic_weights(length) @ ends
            band = np.maximum(tuning.band_beyond * _off_cubic(near).max(axis=0), least)
            off = values[run] - cubic
            beyond = np.abs(off).max(axis=0) > band
            is_constant = np.all(np.ptp(values[run][:, beyond], axis=0) == 0.0)
            if not (beyond.any() and is_constant and _is_corrupt(off, dt[run], beyond, tuning)):
                continue
            about = slice(inner.start - 2, inner.stop + 2)
            others = _off_cubic(np.where(beyond, 0.0, near))
            far = np.delete(others, np.r_[about], axis=0).max(axis=0)
            disturbed = others[about].max(axis=0) > np.maximum(tuning.band_beyond * far, least)
            if not disturbed.any():  # otherwise the rate steps, and with it the forces of its lever arm
                yield from ((first + i, row) for i, row in enumerate(np.where(beyond, cubic, values[run])))
                return


@cache
def _cubic_weights(length: int) -> Array:
    """Return weights (length, 4) of the two samples before and the two after a run for the cubic within it."""
    nodes, inside = np.array([-2.0, -1.0, length, length + 1.0]), np.arange(float(length))
    return np.array([np.prod([(inside - b) / (a - b) for b in nodes if b != a], axis=0) for a in nodes]).T


def _is_corrupt(off: Array, dt: Array, beyond: BoolArray, tuning: Tuning) -> bool:
    """Return True if deviations (k, 6) at intervals (k,), in the channels `beyond` their bands (6,), cannot be
    motion."""
    size, kind = np.abs(off).max(axis=0), np.repeat([0, 1], 3)
    if np.any((off * np.sign(off[0])).min(axis=0)[beyond] < 0.5 * size[beyond]):
        return False  # a step from one sample to the next, as of a table that starts abruptly
    if beyond.sum() == 1:
        (channel,) = np.flatnonzero(beyond)
        others = (kind == kind[channel]) & ~beyond
        if size[channel] > tuning.alone * size[others].max():
            return True
    turned, moved = (float(np.linalg.norm(dt @ off[:, kind == k])) for k in (0, 1))
    return moved > tuning.violent_velocity or turned > tuning.violent_angle


def blemish_notes(reduction: Reduction, spans: Sequence[Stretch]) -> tuple[str, ...]:
    """Return a note that counts the bad samples left out of rests."""
    inside = [
        (number, b)
        for number, span in enumerate(spans, 1)
        for b in reduction.blemishes
        if b.file == span.file and span.first <= b.first < span.last
    ]
    if not inside:
        return ()
    count, rests = sum(b.samples for _, b in inside), sorted({number for number, _ in inside})
    left_out = _counted(count, "about", "left out of rest", [str(number) for number in rests])
    return (f"{left_out}, with a tenth of a second each; the first at {inside[0][1].start:.1f} s",)


def bad_sample_notes(bad: BadSamples, first: IntArray) -> tuple[str, ...]:
    """Return a note that counts the bad samples replaced in turns from rests `first` (K,)."""
    turns = [f"{i} to {i + 1}" for i in (np.unique(first[bad.turn]) + 1).tolist()]
    replaced = "replaced by what is between these in the turn"
    return (_counted(len(bad.at), "beside", replaced, turns),) if turns else ()


def _counted(count: int, where: str, what: str, names: list[str]) -> str:
    """Return, for example, "2 bad samples, far off those beside them, left out of rests 4, 6"."""
    bad, them = ("1 bad sample", "it") if count == 1 else (f"{count} bad samples", "them")
    plural, more = "s" if len(names) > 1 else "", f" and {len(names) - 5} more" if len(names) > 5 else ""
    return f"{bad}, far off those {where} {them}, {what}{plural} {', '.join(names[:5])}{more}"
