"""Turns: rotation and velocity from rest to rest, their sensitivities, covariances from the noise of the rests, and the
samples they are integrated from.

Turns whose end the gyros do not determine are left out, with a note. The numbers of a converter end at 2^k − 1 and
−2^k: a gyro with such a reading turned faster than it can measure. Turns of gyros in physical units, whose converter is
not known, are judged by their residuals. A reading of more than half a turn from sample to sample is ambiguous: it may
be a turn by less the other way round.

A device that sways in the hand leaves a rest from another attitude than the mean one that its accelerometers read, and
arrives at another one. Its turns are therefore taken from mean to mean: the samples of a rest from t₀ to t₁ count with
the weight w = (t − t₀)/(t₁ − t₀) in the turn that follows and with 1 − w in the one before, since

    α(t₁) − mean α = ∫ w α̇ dt,    mean v(after) − mean v(before) = ∫ w v̇ dt                            (w = 1 between)

to first order in the sway α. Of a device that lies still that would only add the noise of the rests.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
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
from tumble.reduction.rests.segmentation import Stretch, gap_between
from tumble.reduction.rests.sway import FOURTH_DIFFERENCES, Sway
from tumble.reduction.turns.array_motion import read_by
from tumble.reduction.turns.moments import BlockCompensation, Compensation, Pieces, integrate_in_parts
from tumble.rotation import onto_body
from tumble.sensors.model import Block, SensorKind, SensorModel
from tumble.units import G_STANDARD, Array, IntArray

PATH_STEPS = 32
"""Steps of a turn in which the noise of its gyros is carried to its start."""
VELOCITY_FLOOR = 1e-8  # m/s
VELOCITY_STEP = 0.02  # of the velocity times the cube of the angle of a step: the error of the integration
BEYOND_NOISE = 9.0
"""Times the variance by noise that independent samples would have to exceed to be taken for such."""
TURN_FLOOR = 1e-10  # rad: no mean and no turn is taken to be better known, a simulation without noise included
BATCH_SAMPLES = 2**17
"""Of turns, that are in memory at a time: 7 MB."""
KEPT_SAMPLES = 2**19
"""So few of turns are gathered once and stay in memory: 29 MB."""
BLOW = 2.0 * G_STANDARD
"""m/s²: the smallest full scale of accelerometers. Beyond it a sample may hide that a sensor was at its end."""
AHEAD = 2
"""Samples kept ahead of every piece of a turn, which the first step wants."""
CONVERTERS = 2.0 ** np.arange(11, 32)
"""2^k of converters of 12 to 32 bits."""
EXACT, AT_END = 1e-6, 1e-3
"""Of a reading, and of a count: two readings that are the same, and a reading that is the end of a converter."""
HALF_TURN = math.pi


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Turns:
    """K turns, resolved in the non-rotating frame that is the body at the start of each.

    `first`, `last`: the rests (K,) before and after. `duration`: durations (K,), s. `C`, `M`, `B`: rotations
    (K, 3, 3) and their sensitivities (K, 3, 3, 3), rad, and (K, 3, 3), s. `covariance`, `arising`: covariances
    (K, 3, 3) of the rotations from gyro noise, rad², and the time in the turn at which the noise arose (K,), see
    `ColouredNoise.arising`. `velocity_covariance`: covariances (K, 3, 3) of the velocity increments from
    accelerometer noise, m²/s². `jumps`: sums (K,) of the squares of the jumps of the force from sample to sample
    times the interval, m²/s², docs/explanation/mathematics.md (18). `aliased`: variances of the rotations (K,),
    rad², if changes of the rate from sample to sample were independent, as in samples that are no means."""

    json_fields: ClassVar = ("first", "last", "duration", "C", "covariance")

    first: IntArray
    last: IntArray
    duration: Array
    C: Array
    M: Array
    B: Array
    covariance: Array
    arising: Array
    velocity_covariance: Array
    jumps: Array
    aliased: Array

    def __len__(self) -> int:
        return len(self.duration)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TurnReadings:
    """Integrals (K, n) of the readings of redundant gyros over the turns, rad, and their covariances (K, n, n) from
    noise."""

    integral: Array
    covariance: Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TurnSamples:
    """The samples of the turns.

    `samples`, `start`, `stop`: turn k is samples start[k] … stop[k] − 1 of the stored `samples`. `bad`: bad samples
    among them, which are replaced. `others`: samples of further sessions, with the number of turns before each.
    `ramps`: of a device that sways, the numbers (K, 2) of samples over which their weight rises and falls."""

    samples: MotionSamples
    start: IntArray
    stop: IntArray
    bad: BadSamples = NO_BAD_SAMPLES
    others: tuple[tuple[int, TurnSamples], ...] = ()
    ramps: IntArray | None = None
    _kept: list[Pieces] = field(default_factory=list, repr=False)

    @property
    def lengths(self) -> IntArray:
        """The numbers of samples (K,) of the turns."""
        return np.concatenate([self.stop - self.start, *(other.lengths for _, other in self.others)])

    def with_bad(self, bad: BadSamples) -> TurnSamples:
        """The same samples, of which these are replaced."""
        return replace(self, bad=bad, _kept=[])

    def pieces(self) -> Iterator[Pieces]:
        """Batches of turns or parts of turns, each with one piece of a turn at most."""
        if not self._kept and int(np.sum(self.stop - self.start)) < KEPT_SAMPLES:
            self._kept.extend(self._gathered())
        yield from self._kept or self._gathered()
        for before, other in self.others:
            yield from (replace(pieces, turn=pieces.turn + before) for pieces in other.pieces())

    def _gathered(self) -> Iterator[Pieces]:
        """The batches of these samples, without those of `others`."""
        parts: list[tuple[int, int, int, int]] = []
        count = 0
        for turn, (start, stop) in enumerate(zip(self.start, self.stop, strict=True)):
            for at in range(int(start), int(stop), BATCH_SAMPLES):
                end, ahead = min(at + BATCH_SAMPLES, int(stop)), min(AHEAD, at)
                parts.append((turn, at - ahead, at, end))
                count += end - at + ahead
                if count >= BATCH_SAMPLES:
                    yield self._pieces(parts, count)
                    parts, count = [], 0
        if parts:
            yield self._pieces(parts, count)

    def _pieces(self, parts: list[tuple[int, int, int, int]], count: int) -> Pieces:
        """A batch of `count` samples in parts of turns: turn, first sample to read, first of the part, and its end."""
        rates, forces, intervals = np.empty((count, 3)), np.empty((count, 3)), np.empty(count)
        pieces, done = [], 0
        for turn, first, at, end in parts:
            into = slice(done, done + end - first)
            rates[into], forces[into], intervals[into] = self.samples.read(first, end)
            if self.ramps is not None:
                rise, fall = np.maximum(self.ramps[turn], 1)
                at_sample = np.arange(at, end) + 0.5
                weight = np.minimum((at_sample - self.start[turn]) / rise, (self.stop[turn] - at_sample) / fall)
                intervals[done + at - first : done + end - first] *= np.minimum(weight, 1.0)
            bad = slice(*np.searchsorted(self.bad.at, [first, end]))
            places = done + self.bad.at[bad] - first
            rates[places], forces[places] = np.hsplit(self.bad.values[bad], 2)
            pieces.append((turn, done + at - first, done + end - first))
            done += end - first
        turns, start, stop = np.array(pieces).T
        return Pieces(rates=rates, forces=forces, intervals=intervals, turn=turns, start=start, stop=stop)


def linear_compensation(gyro: Block, gyro_model: SensorModel, accel: Block, accel_model: SensorModel) -> Compensation:
    """The compensation of samples by linear models."""
    of_gyro, of_accel = BlockCompensation.of(gyro.axes, gyro_model), BlockCompensation.of(accel.axes, accel_model)
    return Compensation(gyro=of_gyro, accel=of_accel, g_sensitivity=np.zeros((3, 3)), delay=0.0)


def reduced_turns(
    reduction: Reduction,
    stored: MotionSamples,
    spans: tuple[Stretch, ...],
    rests: Rests,
    accel_noise: tuple[Block, ColouredNoise],
    gyro_noise: tuple[Block, ColouredNoise],
    rounded: Mapping[str, Rounding],
    sway: Sway | None = None,
) -> tuple[Turns, TurnSamples]:
    """Integrate the turns between consecutive rests that were recorded as a whole, with nominal gyros.

    Parameters
    ----------
    reduction : Reduction
        The blocks of the log.
    stored : MotionSamples
        Its samples.
    spans, rests
        The rests as stretches of blocks, and their means.
    accel_noise, gyro_noise
        The sensors of each kind, and the noise of the means of their blocks.
    rounded : mapping of str to Rounding
        The resolution of "accel" and "gyro".
    sway : Sway, optional
        Of a device that sways: then turns are from mean attitude to mean attitude.

    Returns
    -------
    Turns
        The K turns.
    TurnSamples
        Their samples.
    """
    pairs = [
        (i, reduction.by_file[before.file], before, after)
        for i, (before, after) in enumerate(pairwise(spans))
        if before.file == after.file and _tear(before, after, reduction.gaps) is None
    ]
    edges = [
        [f.sample_at(block) for block in (0, before.first, before.last, after.first, after.last, len(f))]
        for _, f, before, after in pairs
    ]
    file_start, rest_start, start, stop, rest_stop, file_stop = np.array(edges, dtype=int).reshape(-1, 6).T
    first, block_seconds = np.array([i for i, *_ in pairs], dtype=int), reduction.block_seconds
    duration = reduction.clock_rate * np.array([after.start - before.stop for *_, before, after in pairs])
    (accel, noise_of_forces), (gyro, noise_of_rates) = accel_noise, gyro_noise
    densities = float(np.median(rests.gyro_noise)) ** 2, float(np.median(rests.accel_noise)) ** 2
    least = smallest_distances(reduction, densities)
    bad = bad_samples_of_turns(stored, start, stop, (file_start, file_stop), reduction.rate, least, reduction.tuning)
    samples = TurnSamples(samples=stored, start=start, stop=stop, bad=bad)
    if sway is not None:
        ramps = np.column_stack([start - rest_start, rest_stop - stop])
        ramps *= (duration > 0.0)[:, None]  # not between the parts of a rest
        duration = duration + 0.5 * (ramps / reduction.rate).sum(axis=1)
        samples = replace(samples, start=start - ramps[:, 0], stop=stop + ramps[:, 1], ramps=ramps)
    nominal = linear_compensation(gyro, gyro.nominal(), accel, accel.nominal())
    moments, C, V = integrate_in_parts(samples.pieces(), samples.lengths, PATH_STEPS, nominal)
    seconds = moments.T.reshape(-1, PATH_STEPS)
    Phi = np.einsum("kpij,kpj...->ki...", C[:, :-1], moments.Phi[..., :4].reshape(-1, PATH_STEPS, 3, 3, 4))
    long = np.maximum(duration, block_seconds)

    def by_noise_and_rounding(block: Block, noise: ColouredNoise) -> tuple[Array, Array]:
        """Covariances (K, 3, 3), in the body, of the integrals of the readings over the turns."""
        to_body, by_rounding = onto_body(block.axes), _by_rounding(samples, block, rounded[block.kind])
        by_noise = np.array([T**2 * noise.covariance_of_mean(T / block_seconds) for T in long])
        return to_body @ by_noise.reshape(by_rounding.shape) @ to_body.T, to_body @ by_rounding @ to_body.T

    velocity = np.trace(sum(by_noise_and_rounding(accel, noise_of_forces)), axis1=1, axis2=2) / 3.0
    by_noise, by_rounding = by_noise_and_rounding(gyro, noise_of_rates)
    density = by_noise / long[:, None, None] if sway is None else sway.density
    density = density + by_rounding / long[:, None, None]
    # rounding, and the integration, of third order in the angle of a step (docs/explanation/mathematics.md (6))
    squares = moments.body_rates[:, [0, 3, 5]].reshape(-1, PATH_STEPS, 3).sum(axis=(1, 2))
    angle = np.sqrt(squares * seconds.sum(axis=1)) / np.maximum(stop - start, 1)
    floor = VELOCITY_FLOOR + VELOCITY_STEP * np.linalg.norm(V[:, -1], axis=1) * angle**3
    # ∫ C N Cᵀ w dt by the trapezoidal rule; w in place of w² lets neighbouring turns of a device that sways be
    # independent, which have the noise of the rest between them in common
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
        arising=np.array([noise_of_rates.arising(T / block_seconds) for T in long]),
        velocity_covariance=(velocity + floor**2)[:, None, None] * np.eye(3),
        jumps=moments.jumps.reshape(-1, PATH_STEPS).sum(axis=1),
        aliased=aliased_rotations(samples, covariance),
    )
    return turns, samples


def no_turns(stored: MotionSamples) -> tuple[Turns, TurnSamples]:
    """The turns of a recording without rests."""
    none, places = np.zeros(0), np.zeros(0, dtype=np.int64)
    square, wide = np.zeros((0, 3, 3)), np.zeros((0, 3, 3, 3))
    turns = Turns(
        first=places, last=places, duration=none, C=square, M=wide, B=square, covariance=square, arising=none,
        velocity_covariance=square, jumps=none, aliased=none,
    )  # fmt: skip
    return turns, TurnSamples(samples=stored, start=places, stop=places)


def smallest_distances(reduction: Reduction, densities: tuple[float, float]) -> Array:
    """The smallest distances (6,) of bad samples, rates, rad/s, and forces, m/s², in the body, by the densities of the
    noise, rad²/s and m²/s³, and the resolution. Samples of more than three gyros are not tested."""
    least, tuning = np.empty(6), reduction.tuning
    kinds = (reduction.gyro_channels, densities[0]), (reduction.accel_channels, densities[1])
    for part, (channels, density) in zip((slice(3), slice(3, 6)), kinds, strict=True):
        steps = [channel.step for channel in channels if np.isfinite(channel.step)]
        noise_of_sample = np.sqrt(density * reduction.rate)
        least[part] = max(tuning.noise_beyond * noise_of_sample, tuning.steps_beyond * max(steps, default=0.0))
    if len(reduction.gyro_channels) > 3:
        least[:3] = np.inf
    return least


def _by_rounding(samples: TurnSamples, block: Block, rounded: Rounding) -> Array:
    """Covariances (K, n, n), diagonal, of the integrals of the readings of n sensors over the turns from rounding."""
    out = np.zeros((len(samples.lengths), block.size))
    for pieces in samples.pieces() if rounded.coarse.any() else ():
        readings = (pieces.rates if block.kind == "gyro" else pieces.forces) @ block.axes.T
        for turn, start, stop in zip(pieces.turn, pieces.start, pieces.stop, strict=True):
            out[turn] += rounded.of_integrals(readings[start:stop], pieces.intervals[start:stop])
    return out[:, :, None] * np.eye(block.size)


def variances_of_independent(samples: TurnSamples, kind: SensorKind = "gyro") -> Array:
    """Variance an axis (K,) of the integrals of rates, rad², or of forces, m²/s², over the turns if what they change by
    from sample to sample were independent: Σ |Δ⁴x Δt|² / (3 · 70). A motion that its samples follow has next to no
    differences of fourth order."""
    out = np.zeros(len(samples.lengths))
    for pieces in samples.pieces():
        values = pieces.rates if kind == "gyro" else pieces.forces
        for turn, start, stop in zip(pieces.turn, pieces.start, pieces.stop, strict=True):
            steps = values[start:stop] * pieces.intervals[start:stop, None]
            out[turn] += (np.diff(steps, n=4, axis=0) ** 2).sum() / (3.0 * FOURTH_DIFFERENCES)
    return out


def aliased_rotations(samples: TurnSamples, covariance: Array) -> Array:
    """The same if for most turns it is far beyond their noise, of `covariance` (K, 3, 3), which shows how the log is
    sampled; else 0: in a single turn samples may be missing."""
    variance, noise = variances_of_independent(samples), np.trace(covariance, axis1=1, axis2=2) / 3.0
    aliased = len(noise) > 0 and np.median(variance / noise) > BEYOND_NOISE
    return variance if aliased else np.zeros_like(variance)


def unread_velocities(samples: TurnSamples) -> Array:
    """Variance an axis (K,), m²/s², of the velocities by blows: (∫ (|f| − BLOW) dt)² over samples beyond BLOW.

    A device that is put down hard stops within a sample or two. In these a sensor may be at the end of its range, which
    a mean over a sample does not show, and its nonlinearity at 10 g is not that at 1 g: a blow does not determine the
    quadratic and cubic terms at rest."""
    out = np.zeros(len(samples.lengths))
    for pieces in samples.pieces():
        beyond = np.maximum(np.linalg.norm(pieces.forces, axis=1) - BLOW, 0.0) * pieces.intervals
        for turn, start, stop in zip(pieces.turn, pieces.start, pieces.stop, strict=True):
            out[turn] += beyond[start:stop].sum()
    return out**2


def turn_readings(
    reduction: Reduction,
    spans: tuple[Stretch, ...],
    turned: tuple[Turns, TurnSamples],
    gyro_noise: tuple[Block, ColouredNoise],
    rounded: Rounding,
) -> TurnReadings:
    """The readings of every gyro between the rests, from the blocks."""
    (turns, samples), (gyro, noise) = turned, gyro_noise
    integral, covariance = np.zeros((len(turns), gyro.size)), _by_rounding(samples, gyro, rounded)
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


# Turns that are left out


def torn_turns(spans: tuple[Stretch, ...], gaps: tuple[Gap, ...]) -> tuple[str, ...]:
    """Notes on the turns that were not recorded as a whole, with the reason."""
    torn = [(i, _tear(before, after, gaps)) for i, (before, after) in enumerate(pairwise(spans), 1)]
    return tuple(
        f"turn from rest {i} to rest {i + 1} is left out: {gap.why}" for i, gap in torn if gap is not None and gap.why
    )


def _tear(before: Stretch, after: Stretch, gaps: tuple[Gap, ...]) -> Gap | None:
    """The last gap between two rests of a file over which the gyros cannot be integrated."""
    for gap in reversed(gaps):
        in_file = gap.file == before.file == after.file
        if in_file and not gap.integrable and gap.time < after.start and gap.stop > before.stop:
            return gap
    return None


def without_unknown_turns(
    reduction: Reduction, rests: tuple[Stretch, ...], gyro: Block, channels: Channels
) -> Reduction:
    """A reduction with gaps for the turns between these rests in which gyros are clipped, or read more than half a turn
    from sample to sample."""
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
                clipped[k] = gap_between(before, after, count, "no rotation", why)
        count = int((np.linalg.norm(rates, axis=1) * intervals > HALF_TURN).sum()) if may_be_fast else 0
        if count:
            why = f"gyros read more than half a turn from sample to sample, in {count} of its samples"
            fast[k] = gap_between(before, after, count, "no rotation", why)
    if 2 * len(fast) > len(turns):
        fast = {}  # then it is the unit or the rate that is wrong, which is said elsewhere
    gaps = {**fast, **clipped}
    return replace(reduction, gaps=(*reduction.gaps, *gaps.values())) if gaps else reduction


def _limits(reduction: Reduction, channels: Channels) -> Array:
    """The smallest and largest readings (2, n) of gyros, SI, that are the ends of a converter, in counts or in steps of
    the resolution; else infinite."""
    read, steps = extremes(reduction.gyro_channels), np.array([state.step for state in reduction.gyro_channels])
    raw = read / np.where(steps > 0.0, steps, np.inf)
    if channels.unit_name == "count":
        raw = read / channels.unit.factor * channels.scale + channels.offset
    ends = np.array([-CONVERTERS, CONVERTERS - 1.0])
    at_end = (np.abs(raw[:, :, None] - ends[:, None]) < AT_END).any(axis=2)
    return np.where(at_end, read, np.array([[-np.inf], [np.inf]]))
