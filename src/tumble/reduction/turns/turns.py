"""Turns: rotation and velocity increment from rest to rest, their sensitivities, covariances and samples.

A device that sways in the hand leaves a rest from another attitude than the mean one that its accelerometers read, and
arrives at another one. Its turns are therefore taken from mean to mean attitude: the samples of a rest from t₀ to t₁
have the weight w = (t − t₀)/(t₁ − t₀) in the turn that follows and 1 − w in the turn before, because

    α(t₁) − mean α = ∫ w α̇ dt,    mean v(after) − mean v(before) = ∫ w v̇ dt                            (w = 1 between)

to first order in the sway α. For a device that lies still this would only add the noise of the rests.

Turns whose end attitude the gyros do not determine are left out, with a note: those in which a gyro reads the end of
its converter, 2^k − 1 or −2^k, and those with a reading of more than half a turn per sample, which is ambiguous. Gyros
in physical units, whose converter is unknown, are judged by the residuals of their turns.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import ClassVar

import numpy as np

from tumble.recording.rows.gaps import Gap
from tumble.recording.session import Channels
from tumble.reduction.blocks.motion_samples import MotionSamples
from tumble.reduction.blocks.reducer import Reduction, extremes
from tumble.reduction.noise.coloured_noise import ColouredNoise
from tumble.reduction.noise.rounding import Rounding
from tumble.reduction.rests.blemishes import NO_BAD_SAMPLES, BadSamples, bad_samples_of_turns
from tumble.reduction.rests.rests import Rests
from tumble.reduction.rests.segmentation import Stretch, breaking_gap, gap_between
from tumble.reduction.rests.sway import FOURTH_DIFFERENCES, Sway
from tumble.reduction.turns.array_motion import sensor_readings
from tumble.reduction.turns.moments import BlockCompensation, Compensation, Pieces, integrate_in_parts
from tumble.rotation import onto_body
from tumble.sensors.model import Block, SensorKind, SensorModel
from tumble.units import Array, IntArray

PATH_STEPS = 32  # steps of a turn in which the noise of its gyros is rotated to its start
VELOCITY_FLOOR = 1e-8  # m/s
VELOCITY_STEP = 0.02  # integration error per velocity and cube of the angle of a step
ALIASING_RATIO = 9.0  # variance by independent samples over that by noise, from which sampling counts as aliased
TURN_FLOOR = 1e-10  # rad: smallest standard uncertainty of a turn, even in a simulation without noise
BATCH_SAMPLES = 2**17  # samples of turns in memory at a time: 7 MB
MAX_CACHED_SAMPLES = 2**19  # samples of turns that may stay in memory, gathered once: 29 MB
AHEAD = 2  # samples kept before every piece of a turn, for its first step
CONVERTER_ENDS = 2.0 ** np.arange(11, 32)  # 2^k of converters of 12 to 32 bits
EQUAL_READINGS = 1e-6  # relative difference of equal readings
AT_RANGE = 1e-4  # relative difference of the ends of one range
AT_CONVERTER_END = 1e-3  # counts: distance of a reading at the end of a converter
HALF_TURN = math.pi


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Turns:
    """K turns, resolved in the non-rotating frame that is the body frame at the start of each.

    `first`, `last`: rests (K,) before and after. `duration` (K,), s. `C`, `M`, `B`: rotations (K, 3, 3) and their
    sensitivities to the gyro matrix (K, 3, 3, 3), rad, and bias (K, 3, 3), s. `covariance`: of the rotations (K, 3, 3)
    from gyro noise, rad². `moment_ratio`: that of this noise (K,), see `ColouredNoise.moment_ratio`.
    `velocity_covariance`: of the velocity increments (K, 3, 3) from accelerometer noise, m²/s². `jumps`: sums (K,) of
    the squared changes of force from sample to sample times interval, m²/s², docs/explanation/mathematics.md (18).
    `aliased`: variances of the rotations (K,), rad², of a log whose samples are aliased, so that rates change
    independently from sample to sample (`aliased_rotations`); 0 for any other log."""

    json_fields: ClassVar = ("first", "last", "duration", "C", "covariance")

    first: IntArray
    last: IntArray
    duration: Array
    C: Array
    M: Array
    B: Array
    covariance: Array
    moment_ratio: Array
    velocity_covariance: Array
    jumps: Array
    aliased: Array

    def __len__(self) -> int:
        return len(self.duration)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TurnReadings:
    """Integrals (K, n) of the readings of redundant gyros over the turns, rad, with covariances (K, n, n)."""

    integral: Array
    covariance: Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TurnSamples:
    """Samples of the turns: start[k] … stop[k] − 1 of the stored `samples` for turn k.

    `bad`: bad samples, which are replaced. `others`: samples of further sessions, with the number of turns before each.
    `ramps`: numbers (K, 2) of samples over which the weight rises and falls, for a device that sways."""

    samples: MotionSamples
    start: IntArray
    stop: IntArray
    bad: BadSamples = NO_BAD_SAMPLES
    others: tuple[tuple[int, TurnSamples], ...] = ()
    ramps: IntArray | None = None
    _cache: list[Pieces] = field(default_factory=list, init=False, repr=False)

    @property
    def lengths(self) -> IntArray:
        """Number of samples of each turn (K,)."""
        return np.concatenate([self.stop - self.start, *(other.lengths for _, other in self.others)])

    def pieces(self) -> Iterator[Pieces]:
        """Yield batches of turns or parts of turns, each with at most one piece of a turn."""
        if not self._cache and int(np.sum(self.stop - self.start)) < MAX_CACHED_SAMPLES:
            self._cache.extend(self._gathered())
        yield from self._cache or self._gathered()
        for before, other in self.others:
            yield from (replace(pieces, turn=pieces.turn + before) for pieces in other.pieces())

    def by_piece(self) -> Iterator[tuple[int, Array, Array, Array]]:
        """Yield turn, rates (m, 3), forces (m, 3) and intervals (m,) of every piece of a turn."""
        for pieces in self.pieces():
            for turn, start, stop in zip(pieces.turn.tolist(), pieces.start, pieces.stop, strict=True):
                piece = slice(start, stop)
                yield turn, pieces.rates[piece], pieces.forces[piece], pieces.intervals[piece]

    def _gathered(self) -> Iterator[Pieces]:
        """Yield the batches of these samples, without those of `others`."""
        spans = [
            (turn, at, min(at + BATCH_SAMPLES, int(stop)))
            for turn, (start, stop) in enumerate(zip(self.start, self.stop, strict=True))
            for at in range(int(start), int(stop), BATCH_SAMPLES)
        ]
        table = np.array(spans, dtype=np.int64).reshape(-1, 3)
        counts = table[:, 2] - table[:, 1]
        batch = (np.cumsum(counts) - counts) // BATCH_SAMPLES
        for number in np.unique(batch):
            turn, at, end = table[batch == number].T
            rates, forces, intervals = zip(*map(self._read, turn, at, end), strict=True)
            stop = np.cumsum([len(each) for each in intervals])
            yield Pieces(
                rates=np.concatenate(rates),
                forces=np.concatenate(forces),
                intervals=np.concatenate(intervals),
                turn=turn,
                start=stop - (end - at),
                stop=stop,
            )

    def _read(self, turn: int, at: int, end: int) -> tuple[Array, Array, Array]:
        """Return rates (m, 3), forces (m, 3) and weighted intervals (m,) of samples at … end − 1 of a turn, with up to
        AHEAD samples before them."""
        first = max(at - AHEAD, 0)
        rates, forces, intervals = self.samples.read(first, end)
        if self.ramps is not None:
            rise, fall = np.maximum(self.ramps[turn], 1)
            middle = np.arange(at, end) + 0.5
            weight = np.minimum((middle - self.start[turn]) / rise, (self.stop[turn] - middle) / fall)
            intervals[at - first :] *= np.minimum(weight, 1.0)
        bad = slice(*np.searchsorted(self.bad.at, [first, end]))
        rates[self.bad.at[bad] - first], forces[self.bad.at[bad] - first] = np.hsplit(self.bad.values[bad], 2)
        return rates, forces, intervals


def linear_compensation(gyro: Block, gyro_model: SensorModel, accel: Block, accel_model: SensorModel) -> Compensation:
    """Return the compensation of samples by linear models."""
    return Compensation(
        gyro=BlockCompensation.of(gyro.axes, gyro_model),
        accel=BlockCompensation.of(accel.axes, accel_model),
        g_sensitivity=np.zeros((3, 3)),
        delay=0.0,
    )


def reduced_turns(
    reduction: Reduction,
    stored: MotionSamples,
    spans: tuple[Stretch, ...],
    rests: Rests,
    blocks: tuple[Block, Block],
    noise: Mapping[str, ColouredNoise],
    rounded: Mapping[str, Rounding],
    sway: Sway | None = None,
) -> tuple[Turns, TurnSamples]:
    """Integrate the completely recorded turns between consecutive rests, with nominal gyros.

    `spans`, `rests`: the rests as stretches of blocks, and their means. `blocks`: accelerometers and gyros. `noise`,
    `rounded`: of their block means, and their resolution, for "accel" and "gyro". `sway`: of a device that sways, whose
    turns are then from mean attitude to mean attitude."""
    pairs = [
        (i, reduction.by_file[before.file], before, after)
        for i, (before, after) in enumerate(pairwise(spans))
        if before.file == after.file and breaking_gap(before, after, reduction.gaps) is None
    ]
    edges = [
        [f.sample_at(block) for block in (0, before.first, before.last, after.first, after.last, len(f))]
        for _, f, before, after in pairs
    ]
    file_start, rest_start, start, stop, rest_stop, file_stop = np.array(edges, dtype=int).reshape(-1, 6).T
    first = np.array([i for i, *_ in pairs], dtype=int)
    block_seconds = reduction.block_seconds
    duration = reduction.clock_rate * np.array([after.start - before.stop for *_, before, after in pairs])
    densities = float(np.median(rests.gyro_noise)) ** 2, float(np.median(rests.accel_noise)) ** 2
    least = smallest_distances(reduction, densities)
    bad = bad_samples_of_turns(stored, start, stop, (file_start, file_stop), reduction.rate, least, reduction.tuning)
    samples = TurnSamples(samples=stored, start=start, stop=stop, bad=bad)
    if sway is not None:
        ramps = np.column_stack([start - rest_start, rest_stop - stop])
        ramps *= (duration > 0.0)[:, None]  # not between the parts of a rest
        duration = duration + 0.5 * (ramps / reduction.rate).sum(axis=1)
        samples = replace(samples, start=start - ramps[:, 0], stop=stop + ramps[:, 1], ramps=ramps)
    accel, gyro = blocks
    nominal = linear_compensation(gyro, gyro.nominal(), accel, accel.nominal())
    moments, C, V = integrate_in_parts(samples.pieces(), samples.lengths, PATH_STEPS, nominal)
    seconds = moments.T.reshape(-1, PATH_STEPS)
    Phi = np.einsum("kpij,kpj...->ki...", C[:, :-1], moments.Phi[..., :4].reshape(-1, PATH_STEPS, 3, 3, 4))
    noise_time = np.maximum(duration, block_seconds)

    def integral_covariances(block: Block) -> tuple[Array, Array]:
        """Return covariances (K, 3, 3), in the body, of the integrals over the turns, from noise and from rounding."""
        to_body, from_rounding = onto_body(block.axes), _rounding_covariance(samples, block, rounded[block.kind])
        from_noise = np.array([T**2 * noise[block.kind].covariance_of_mean(T / block_seconds) for T in noise_time])
        return to_body @ from_noise.reshape(from_rounding.shape) @ to_body.T, to_body @ from_rounding @ to_body.T

    velocity = np.trace(sum(integral_covariances(accel)), axis1=1, axis2=2) / 3.0
    from_noise, from_rounding = integral_covariances(gyro)
    density = from_noise / noise_time[:, None, None] if sway is None else sway.density
    density = density + from_rounding / noise_time[:, None, None]
    # error of the integration, of third order in the angle of a step (docs/explanation/mathematics.md (6)), and floor
    squares = moments.body_rates[:, [0, 3, 5]].reshape(-1, PATH_STEPS, 3).sum(axis=(1, 2))
    angle = np.sqrt(squares * seconds.sum(axis=1)) / np.maximum(stop - start, 1)
    floor = VELOCITY_FLOOR + VELOCITY_STEP * np.linalg.norm(V[:, -1], axis=1) * angle**3
    # ∫ C N Cᵀ w dt by the trapezoidal rule; w in place of w² makes neighbouring turns of a device that sways, which
    # share the noise of the rest between them, independent
    rotated = C @ density[:, None] @ np.swapaxes(C, 2, 3)
    covariance = 0.5 * np.einsum("kp,kpij->kij", seconds, rotated[:, 1:] + rotated[:, :-1]) + TURN_FLOOR**2 * np.eye(3)
    turns = Turns(
        first=first,
        last=first + 1,
        duration=duration,
        C=C[:, -1],
        M=Phi[..., 1:],
        B=Phi[..., 0],
        covariance=covariance,
        moment_ratio=np.array([noise["gyro"].moment_ratio(T / block_seconds) for T in noise_time]),
        velocity_covariance=(velocity + floor**2)[:, None, None] * np.eye(3),
        jumps=moments.jumps.reshape(-1, PATH_STEPS).sum(axis=1),
        aliased=aliased_rotations(samples, covariance),
    )
    return turns, samples


def smallest_distances(reduction: Reduction, densities: tuple[float, float]) -> Array:
    """Return the smallest distances of bad samples from their neighbours, for rates, rad/s, and forces, m/s² (6,).

    They follow from the noise densities of gyros and accelerometers, rad²/s and m²/s³, and from the resolution. They
    are infinite for more than three gyros, whose single samples are not tested."""
    least, tuning = np.empty(6), reduction.tuning
    kinds = (reduction.gyro_channels, densities[0]), (reduction.accel_channels, densities[1])
    for part, (channels, density) in zip((slice(3), slice(3, 6)), kinds, strict=True):
        steps = [channel.step for channel in channels if np.isfinite(channel.step)]
        sample_noise = np.sqrt(density * reduction.rate)
        least[part] = max(tuning.noise_beyond * sample_noise, tuning.steps_beyond * max(steps, default=0.0))
    if len(reduction.gyro_channels) > 3:
        least[:3] = np.inf
    return least


def _rounding_covariance(samples: TurnSamples, block: Block, rounded: Rounding) -> Array:
    """Return diagonal covariances (K, n, n), from rounding, of the integrals of n readings over the turns."""
    out = np.zeros((len(samples.lengths), block.size))
    for turn, rates, forces, intervals in samples.by_piece() if rounded.coarse.any() else ():
        readings = (rates if block.kind == "gyro" else forces) @ block.axes.T
        out[turn] += rounded.variance_of_integrals(readings, intervals)
    return out[:, :, None] * np.eye(block.size)


def independent_sample_variances(samples: TurnSamples, kind: SensorKind = "gyro") -> Array:
    """Return the variances per axis (K,) of integrals of rates, rad², or forces, m²/s², over the turns if changes from
    sample to sample were independent: Σ |Δ⁴x Δt|² / (3 · 70).

    The fourth differences of a motion that its samples resolve are nearly zero."""
    out = np.zeros(len(samples.lengths))
    for turn, rates, forces, intervals in samples.by_piece():
        steps = (rates if kind == "gyro" else forces) * intervals[:, None]
        out[turn] += (np.diff(steps, n=4, axis=0) ** 2).sum() / (3.0 * FOURTH_DIFFERENCES)
    return out


def aliased_rotations(samples: TurnSamples, covariance: Array) -> Array:
    """Return the `independent_sample_variances` (K,) of the rotations if most of them far exceed the noise, else zeros.

    Most turns show how a log is sampled; a single one may have lost samples. `covariance` (K, 3, 3), rad², is that of
    the noise."""
    variance, noise = independent_sample_variances(samples), np.trace(covariance, axis1=1, axis2=2) / 3.0
    aliased = len(noise) > 0 and np.median(variance / noise) > ALIASING_RATIO
    return variance if aliased else np.zeros_like(variance)


def turn_readings(
    reduction: Reduction,
    spans: tuple[Stretch, ...],
    turned: tuple[Turns, TurnSamples],
    gyro: Block,
    noise: ColouredNoise,
    rounded: Rounding,
) -> TurnReadings:
    """Integrate the readings of every gyro between the rests, from the blocks."""
    turns, samples = turned
    integral, covariance = np.zeros((len(turns), gyro.size)), _rounding_covariance(samples, gyro, rounded)
    for k, (i, j, T) in enumerate(zip(turns.first, turns.last, turns.duration, strict=True)):
        blocks, between = reduction.by_file[spans[i].file], slice(spans[i].last, spans[j].first)
        seconds = reduction.clock_rate * np.diff(blocks.edges)
        if samples.ramps is not None and samples.ramps[k].any():
            between, ends = slice(spans[i].first, spans[j].last), [spans[i].start, spans[i].stop]
            middle = 0.5 * (blocks.edges[1:] + blocks.edges[:-1])
            seconds *= np.interp(middle, [*ends, spans[j].start, spans[j].stop], [0.0, 1.0, 1.0, 0.0])
        integral[k] = seconds[between] @ blocks.gyro.means[between]
        covariance[k] += T**2 * noise.covariance_of_mean(max(T / reduction.block_seconds, 1.0))
    return TurnReadings(integral=integral, covariance=covariance + TURN_FLOOR**2 * np.eye(gyro.size))


def torn_turns(spans: tuple[Stretch, ...], gaps: tuple[Gap, ...]) -> tuple[str, ...]:
    """Return notes on the turns between these rests that gaps break, with the reason."""
    torn = [(i, breaking_gap(before, after, gaps)) for i, (before, after) in enumerate(pairwise(spans), 1)]
    return tuple(
        f"turn from rest {i} to rest {i + 1} is left out: {gap.why}" for i, gap in torn if gap is not None and gap.why
    )


def without_ambiguous_turns(
    reduction: Reduction, rests: tuple[Stretch, ...], gyro: Block, channels: Channels, clipped_gyros: Sequence[int] = ()
) -> Reduction:
    """Return a reduction with gaps for the turns between these rests in which gyros are clipped, or read more than half
    a turn from sample to sample (unless most turns do, which shows a wrong unit or rate).

    Gyros are clipped at the end of a converter, and `clipped_gyros`, by number, at their extreme readings."""
    clipped, fast = dict[int, Gap](), dict[int, Gap]()
    limits, turns, redundant = _converter_limits(reduction, channels), list(pairwise(rests)), gyro.size - 3
    limits = np.where(np.isfinite(limits), limits, clipping_limits(reduction, clipped_gyros))
    may_clip = np.isfinite(limits).any()
    may_be_fast = 2.0 * np.abs(extremes(reduction.gyro_channels)).max() > HALF_TURN * reduction.rate
    for k, (before, after) in enumerate(turns if may_clip or may_be_fast else ()):
        if before.file != after.file or reduction.samples is None:
            continue
        f = reduction.by_file[before.file]
        start, stop = f.sample_at(before.last), f.sample_at(after.first)
        rates, _, intervals, spare = reduction.samples.read_with_spare(start, stop)
        gyro_spare = spare[:, max(spare.shape[1] - redundant, 0) :]
        if may_clip and gyro_spare.shape[1] == redundant:  # else only the rate of redundant gyros is stored
            least, most = limits * (1.0 - EQUAL_READINGS)
            readings = sensor_readings(gyro, rates, gyro_spare)
            count = int(((readings <= least) | (readings >= most)).any(axis=1).sum())
            if count >= reduction.tuning.fewest_clipped:
                why = f"gyros are clipped in {count} of its samples"
                clipped[k] = gap_between(before, after, count, "no rotation", why)
        count = int((np.linalg.norm(rates, axis=1) * intervals > HALF_TURN).sum()) if may_be_fast else 0
        if count:
            why = f"gyros read more than half a turn from sample to sample, in {count} of its samples"
            fast[k] = gap_between(before, after, count, "no rotation", why)
    if 2 * len(fast) > len(turns):
        fast = {}
    gaps = {**fast, **clipped}
    return replace(reduction, gaps=(*reduction.gaps, *gaps.values())) if gaps else reduction


def clipping_limits(reduction: Reduction, clipped: Sequence[int]) -> Array:
    """Return the extreme gyro readings (2, n), SI, at the end of the range of a `clipped` gyro; else infinite.

    Gyros of one chip have one range: an extreme of any of them that is as large is at its end, too."""
    read = extremes(reduction.gyro_channels)
    ends = np.abs(read[:, list(clipped)]).max(axis=0)
    at_end = np.isclose(np.abs(read)[..., None], ends, rtol=AT_RANGE, atol=0.0).any(axis=2)
    return np.where(at_end, read, np.array([[-np.inf], [np.inf]]))


def _converter_limits(reduction: Reduction, channels: Channels) -> Array:
    """Return the extreme gyro readings (2, n), SI, that are ends of a converter, in counts or steps; else infinite."""
    read, steps = extremes(reduction.gyro_channels), np.array([state.step for state in reduction.gyro_channels])
    raw = read / np.where(steps > 0.0, steps, np.inf)
    if channels.unit_name == "count":
        raw = read / channels.unit.factor * channels.scale + channels.offset
    ends = np.array([-CONVERTER_ENDS, CONVERTER_ENDS - 1.0])
    at_end = (np.abs(raw[:, :, None] - ends[:, None]) < AT_CONVERTER_END).any(axis=2)
    return np.where(at_end, read, np.array([[-np.inf], [np.inf]]))
