"""Turns: rotation and velocity from rest to rest, their sensitivities, and covariances from the noise of the rests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise

import numpy as np

from tumble.recording.rows.gaps import Gap
from tumble.reduction.blocks.motion_samples import MotionSamples
from tumble.reduction.blocks.reducer import Reduction
from tumble.reduction.noise.coloured_noise import ColouredNoise
from tumble.reduction.noise.rounding import Rounding
from tumble.reduction.rests.blemishes import bad_samples_of_turns
from tumble.reduction.rests.rests import Rests
from tumble.reduction.rests.segmentation import RestSpan
from tumble.reduction.turns.moments import (
    BlockCompensation,
    Compensation,
    Moments,
    integrate,
    moments_of,
)
from tumble.reduction.turns.turn_samples import TurnSamples
from tumble.sensors.model import Block, SensorModel
from tumble.units import Array, IntArray

PATH_STEPS = 32
VELOCITY_FLOOR = 1e-8  # m/s
VELOCITY_STEP = 0.02  # of the velocity times the cube of the angle of a step: what the integration errs by
FOURTH_DIFFERENCES = 70.0
"""Variance of the fourth differences, 1 −4 6 −4 1, of independent samples, in parts of theirs."""
BEYOND_NOISE = 9.0
"""Times the variance by noise: where independent samples would make no more, nothing is said of them."""
TURN_FLOOR = 1e-10  # rad: no mean and no turn is taken to be better known, a simulation without noise included

_BODY = Block(kind="gyro", axes=np.eye(3))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Turns:
    """K turns from rest `first` to rest `last` (K,) of `duration` (s): rotation C (K, 3, 3), its sensitivities
    M (K, 3, 3, 3) rad and B (K, 3, 3) s, the covariance (K, 3, 3) of the rotation from gyro noise, rad², and
    `arising` (K,), when in the turn it arose: `ColouredNoise.arising`; the covariance (K, 3, 3) of the velocity
    increment from accelerometer noise, m²/s², and `jumps` (K,), m²/s², the sum of the squares of what the force jumps
    by from sample to sample times the interval, docs/explanation/mathematics.md (18). All are resolved in the
    non-rotating frame that is the body at the start of the turn. `aliased` (K,), rad², is the variance of the rotation
    if what changes in the rate from sample to sample were independent, which it is in samples that are no means."""

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
    """Integrals (K, n) of the gyro readings over the turns, rad, and their covariance (K, n, n) from noise: what a
    redundant block says beyond the rotation of the body."""

    integral: Array
    covariance: Array


def linear_compensation(gyro: Block, gyro_model: SensorModel, accel: Block, accel_model: SensorModel) -> Compensation:
    """Compensation by the linear models."""
    return Compensation(
        gyro=BlockCompensation.of(gyro.axes, gyro_model),
        accel=BlockCompensation.of(accel.axes, accel_model),
        g_sensitivity=np.zeros((3, 3)),
        delay=0.0,
    )


def reduced_turns(
    reduction: Reduction,
    stored: MotionSamples,
    spans: tuple[RestSpan, ...],
    rests: Rests,
    accel_noise: tuple[Block, ColouredNoise],
    gyro_noise: tuple[Block, ColouredNoise],
    rounded: Mapping[str, Rounding],
) -> tuple[Turns, TurnSamples]:
    """The turns between consecutive rests, those that were recorded as a whole, integrated with nominal gyros. Samples
    that are `rounded` err as `Rounding.of_integrals` has it."""
    first, last = np.array(_recorded(spans, reduction.gaps), dtype=int).reshape(-1, 2).T
    by_file, block_seconds = reduction.by_file, reduction.block_seconds
    start = np.array([by_file[spans[i].file].sample_at(spans[i].last) for i in first], dtype=int)
    stop = np.array([by_file[spans[j].file].sample_at(spans[j].first) for j in last], dtype=int)
    duration = np.array([spans[j].start - spans[i].stop for i, j in zip(first, last, strict=True)])
    (accel, of_accel), (gyro, of_gyro) = accel_noise, gyro_noise
    files = [by_file[spans[i].file] for i in first]
    within = tuple(np.array([f.sample_at(k * len(f)) for f in files], dtype=int) for k in (0, 1))
    least = _least_off(reduction, rests)
    bad = bad_samples_of_turns(stored, start, stop, (within[0], within[1]), reduction.rate, least, reduction.tuning)
    samples = TurnSamples(samples=stored, start=start, stop=stop, bad=bad)
    moments = integrate(samples.pieces(), len(first), linear_compensation(gyro, gyro.nominal(), accel, accel.nominal()))
    long = np.maximum(duration, block_seconds)
    of_forces, of_rates = (
        _in_body(block, _by_rounding(samples, block, rounded[block.kind])) for block in (accel, gyro)
    )
    density = np.array([T * _of_mean(gyro, of_gyro, T / block_seconds) for T in long]).reshape(-1, 3, 3)
    density += of_rates / long[:, None, None]
    velocity = np.array([T**2 * np.trace(_of_mean(accel, of_accel, T / block_seconds)) / 3.0 for T in long])
    velocity += np.trace(of_forces, axis1=1, axis2=2) / 3.0
    covariance = _carried(samples, density) + TURN_FLOOR**2 * np.eye(3)
    turns = Turns(
        first=first,
        last=last,
        duration=duration,
        C=moments.C,
        M=moments.Phi[..., 1:4],
        B=moments.Phi[..., 0],
        covariance=covariance,
        arising=np.array([of_gyro.arising(T / block_seconds) for T in long]),
        velocity_covariance=(velocity + velocity_floor(moments, stop - start) ** 2)[:, None, None] * np.eye(3),
        jumps=moments.jumps,
        aliased=aliased_rotations(samples, covariance),
    )
    return turns, samples


def _least_off(reduction: Reduction, rests: Rests) -> Array:
    """What the samples (6,) of rates and forces in the body are off by at least where they are bad, by what they do at
    rest and their resolution. More than three gyros are not judged: their readings go another way too."""
    least, tuning = np.empty(6), reduction.tuning
    kinds = (reduction.gyro_channels, rests.gyro_noise), (reduction.accel_channels, rests.accel_noise)
    for part, (channels, noise) in zip((slice(3), slice(3, 6)), kinds, strict=True):
        steps = [channel.step for channel in channels if np.isfinite(channel.step)]
        of_sample = float(np.median(noise)) * np.sqrt(reduction.rate)
        least[part] = max(tuning.noise_beyond * of_sample, tuning.steps_beyond * max(steps, default=0.0))
    if rests.gyro.shape[1] > 3:
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


def rotations_of_independent(samples: TurnSamples) -> Array:
    """Variance an axis (K,), rad², of the rotations if what rates change by from sample to sample were independent:
    Σ |Δ⁴ω Δt|² / (3 · 70). A motion that its samples follow has next to no differences of fourth order."""
    out = np.zeros(len(samples.lengths))
    for pieces in samples.pieces():
        for turn, start, stop in zip(pieces.turn, pieces.start, pieces.stop, strict=True):
            steps = pieces.rates[start:stop] * pieces.intervals[start:stop, None]
            out[turn] += (np.diff(steps, n=4, axis=0) ** 2).sum() / (3.0 * FOURTH_DIFFERENCES)
    return out


def aliased_rotations(samples: TurnSamples, covariance: Array) -> Array:
    """The same where for most turns it is far beyond their noise, of `covariance` (K, 3, 3), for that is how a log is
    sampled; else 0: of a single turn it may be that samples are missing."""
    variance, noise = rotations_of_independent(samples), np.trace(covariance, axis1=1, axis2=2) / 3.0
    aliased = len(noise) > 0 and np.median(variance / noise) > BEYOND_NOISE
    return variance if aliased else np.zeros_like(variance)


def _recorded(spans: tuple[RestSpan, ...], gaps: tuple[Gap, ...]) -> list[tuple[int, int]]:
    """The rests before and after each turn that was recorded as a whole, in one file."""
    return [
        (i, i + 1)
        for i, (before, after) in enumerate(pairwise(spans))
        if before.file == after.file and _tear(before, after, gaps) is None
    ]


def torn_turns(spans: tuple[RestSpan, ...], gaps: tuple[Gap, ...]) -> tuple[str, ...]:
    """The turns that were not recorded as a whole, and why, as notes."""
    torn = [(i, _tear(before, after, gaps)) for i, (before, after) in enumerate(pairwise(spans), 1)]
    return tuple(
        f"turn from rest {i} to rest {i + 1} is left out: {gap.why}" for i, gap in torn if gap is not None and gap.why
    )


def _tear(before: RestSpan, after: RestSpan, gaps: tuple[Gap, ...]) -> Gap | None:
    """The last gap between two rests of a file across which no turn is known."""
    return next(
        (
            gap
            for gap in reversed(gaps)
            if not gap.integrable
            and gap.file == before.file == after.file
            and gap.time < after.start
            and gap.stop > before.stop
        ),
        None,
    )


def velocity_floor(moments: Moments, samples: IntArray) -> Array:
    """Standard deviation (K,), m/s, of the velocities of turns of so many samples (K,) from rounding and from the error
    of the integration, which is of third order in the angle of a step (docs/explanation/mathematics.md (6))."""
    mean_square = (moments.body_rates[:, [0, 3, 5]]).sum(axis=1) * moments.T
    step = np.sqrt(mean_square) / np.maximum(samples, 1)
    return np.asarray(VELOCITY_FLOOR + VELOCITY_STEP * np.linalg.norm(moments.V, axis=1) * step**3)


def _of_mean(block: Block, noise: ColouredNoise, blocks: float) -> Array:
    """Covariance (3, 3) of a mean over so many blocks, in the body."""
    return _in_body(block, noise.covariance_of_mean(blocks))


def _in_body(block: Block, covariance: Array) -> Array:
    """The covariance (..., 3, 3) in the body of what has this one (..., n, n) in the sensors of a block."""
    to_body = np.linalg.pinv(block.axes)
    return np.asarray(to_body @ covariance @ to_body.T)


def turn_readings(
    reduction: Reduction,
    spans: tuple[RestSpan, ...],
    turned: tuple[Turns, TurnSamples],
    gyro_noise: tuple[Block, ColouredNoise],
    rounded: Rounding,
) -> TurnReadings:
    """The readings of every gyro between the rests, from the blocks."""
    (turns, samples), (gyro, noise) = turned, gyro_noise
    channels, by_file, block_seconds = gyro.size, reduction.by_file, reduction.block_seconds
    integral, covariance = np.zeros((len(turns), channels)), np.zeros((len(turns), channels, channels))
    for k, (i, j, T) in enumerate(zip(turns.first, turns.last, turns.duration, strict=True)):
        blocks, between = by_file[spans[i].file], slice(spans[i].last, spans[j].first)
        integral[k] = np.diff(blocks.edges)[between] @ blocks.gyro.means[between]
        covariance[k] = T**2 * noise.covariance_of_mean(max(T / block_seconds, 1.0))
    by_rounding = _by_rounding(samples, gyro, rounded)
    return TurnReadings(integral=integral, covariance=covariance + by_rounding + TURN_FLOOR**2 * np.eye(channels))


def _carried(samples: TurnSamples, density: Array) -> Array:
    """∫ C N Cᵀ dt (K, 3, 3), rad², of the turns and the density N (K, 3, 3), rad²/s, of their gyro noise, by the
    trapezoidal rule over PATH_STEPS steps a piece."""
    C = np.broadcast_to(np.eye(3), density.shape).copy()
    out = np.zeros_like(density)
    nominal = linear_compensation(_BODY, _BODY.nominal(), _BODY, _BODY.nominal())
    for pieces in samples.pieces():
        passed = np.concatenate([[0.0], np.cumsum(pieces.intervals)])
        cuts = [
            np.unique(np.linspace(a, b, PATH_STEPS + 1).astype(np.int64))
            for a, b in zip(pieces.start, pieces.stop, strict=True)
        ]
        steps = moments_of(
            replace(pieces, start=np.concatenate([c[:-1] for c in cuts]), stop=np.concatenate([c[1:] for c in cuts])),
            nominal,
        ).C
        at = 0
        for k, edges in zip(pieces.turn, cuts, strict=True):
            path = np.array(list(accumulate(steps[at : at + len(edges) - 1], np.matmul, initial=C[k])))
            at += len(edges) - 1
            rotated = path @ density[k] @ np.swapaxes(path, 1, 2)
            out[k] += 0.5 * np.tensordot(np.diff(passed[edges]), rotated[1:] + rotated[:-1], axes=1)
            C[k] = path[-1]
    return out
