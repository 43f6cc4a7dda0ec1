"""Observations: what is left of a log after one reduction, and all that a method sees.

A rest is its mean reading with covariance; a turn is its preintegrated rotation with its sensitivities to the
gyro parameters, in the non-rotating frame of the body at the turn's start, so that attitude, site and Earth's
rate stay out of it. With E the relative error of the gyro matrix and δ of the gyro bias, both about the model
the turn was integrated with,

    C(E, δ) = exp([−(M : E + B δ)×]) C,      M[i,p,q] = ∫ C_ip ω_q dt,   B = ∫ C dt.

The effect of a large update is of second order in it, so turns are integrated again about the updated model
(`Observations.turns_about`); rests are never touched again.

Source: the rotation part of the preintegration of velocity and rotation increments (Lupton & Sukkarieh 2012,
Forster et al. 2017) with body-frame sensors and the two-sample coning term.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import accumulate

import numpy as np

from tumble.programme.positions import Programme
from tumble.recording.session import Site
from tumble.reduction import kernels as _kernels
from tumble.reduction.blocks import FileBlocks, Reduction
from tumble.reduction.coloured_noise import ColouredNoise, fit_coloured_noise
from tumble.reduction.matching import Match
from tumble.reduction.motion_samples import MotionSamples
from tumble.reduction.rest_noise import accel_covariance, channel_rounding, density, drift
from tumble.reduction.rounding import Rounding, rounding_notes
from tumble.reduction.segmentation import RestSpan
from tumble.sensors.model import Block, SensorModel
from tumble.units import Array, IntArray

BATCH_SAMPLES = 2**20
ACCEL_FLOOR = 1e-9  # m/s²
GYRO_FLOOR = 1e-11  # rad/s
PATH_STEPS = 32
TURN_FLOOR = 1e-10  # rad: no mean and no turn is taken to be better known, a simulation without noise included


@dataclass(frozen=True, kw_only=True, slots=True)
class Rests:
    """N rests: file, start and stop (s), mean readings and their covariances in SI; drift is the change of a
    reading over the rest (slope times duration) and noise its density, unit/√Hz. The gyro arrays are empty
    (N, 0) where there are no gyros; the magnetometer's mean readings and their covariances are in its unit, None where
    there is none."""

    file: IntArray
    start: Array
    stop: Array
    accel: Array
    accel_covariance: Array
    accel_drift: Array
    accel_noise: Array
    gyro: Array
    gyro_covariance: Array
    gyro_drift: Array
    gyro_noise: Array
    temperature: Array | None
    magnetometer: Array | None = None
    magnetometer_covariance: Array | None = None

    def __len__(self) -> int:
        return len(self.start)


@dataclass(frozen=True, kw_only=True, slots=True)
class Turns:
    """K turns from rest `first` to rest `last` (K,) of `duration` (s): rotation C (K, 3, 3), its sensitivities
    M (K, 3, 3, 3) rad and B (K, 3, 3) s, and the covariance (K, 3, 3) of the rotation from gyro noise, rad²,
    resolved in the body at the start of the turn."""

    first: IntArray
    last: IntArray
    duration: Array
    C: Array
    M: Array
    B: Array
    covariance: Array

    def __len__(self) -> int:
        return len(self.duration)


Batch = tuple[Array, Array, Array, IntArray, IntArray, IntArray]
"""Rates (m, 3) and forces (m, 3) of nominal sensors in the body, intervals (m,), the turn of each piece, and the range
of each piece among them; the sample before every piece is kept ahead of it."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TurnSamples:
    """Where the samples of the turns are: turn k is samples start[k] … stop[k] − 1 of `samples`."""

    samples: MotionSamples
    start: IntArray
    stop: IntArray
    _only_batch: list[Batch] = field(default_factory=list, repr=False)

    def pieces(self) -> Iterator[Batch]:
        """Batches of whole or cut turns. Turns that fill one batch at most are gathered once."""
        if self._only_batch:
            return iter(self._only_batch)
        if int(np.sum(self.stop - self.start)) < BATCH_SAMPLES:
            self._only_batch.extend(self._gathered())
            return iter(self._only_batch)
        return self._gathered()

    def _gathered(self) -> Iterator[Batch]:
        parts: list[tuple[Array, Array, Array]] = []
        pieces: list[tuple[int, int, int]] = []
        count = 0
        for turn, (start, stop) in enumerate(zip(self.start, self.stop, strict=True)):
            for at in range(int(start), int(stop), BATCH_SAMPLES):
                end = min(at + BATCH_SAMPLES, int(stop))
                parts.append(self.samples.read(at - 1, end))
                pieces.append((turn, count + 1, count + 1 + end - at))
                count += end - at + 1
                if count >= BATCH_SAMPLES:
                    yield _batch(parts, pieces)
                    parts, pieces, count = [], [], 0
        if pieces:
            yield _batch(parts, pieces)


def _batch(parts: list[tuple[Array, Array, Array]], pieces: list[tuple[int, int, int]]) -> Batch:
    rates, forces, intervals = (np.concatenate(part) for part in zip(*parts, strict=True))
    turn, start, stop = np.array(pieces).T
    return rates, forces, intervals, turn, start, stop


@dataclass(frozen=True, kw_only=True, slots=True)
class TurnReadings:
    """Integrals (K, n) of the gyro readings over the turns, rad, and their covariance (K, n, n) from noise: what a
    redundant block says beyond the rotation of the body."""

    integral: Array
    covariance: Array


@dataclass(frozen=True, kw_only=True, slots=True)
class Observations:
    """All that a method sees of a session. `position` (N,) is the index in the programme of each rest's position,
    where there is one."""

    accel_block: Block
    gyro_block: Block | None
    site: Site
    rests: Rests
    turns: Turns | None
    turn_samples: TurnSamples | None
    programme: Programme | None
    position: IntArray | None
    start: Mapping[str, float] = field(default_factory=dict)
    """Parameter values to start from, by name; zero where there is none."""
    turn_readings: TurnReadings | None = None
    """Only where there are more than three gyros."""
    rounding: Mapping[str, Rounding] = field(default_factory=dict)
    """Resolution of the accelerometers, "accel", and of the gyros, "gyro", and what it does to their means."""
    notes: tuple[str, ...] = ()
    """What is remarkable in the log, in words."""

    def start_values(self, block: Block) -> Array:
        """Start values of a block's parameters, in their order."""
        return np.array([self.start.get(name, 0.0) for name in block.names])

    def turns_about(self, gyro: SensorModel) -> Turns:
        """The turns integrated about a gyro model: its effect on the rotation is exact, and M and B are the
        sensitivities at this model."""
        if self.turns is None or self.turn_samples is None or self.gyro_block is None:
            raise ValueError("turns_about: expected observations of a log with gyros and turns, found none")
        transform, offset = _compensation(self.gyro_block, gyro)
        C, M, B = _integrate(self.turn_samples, len(self.turns), transform, offset)
        return Turns(
            first=self.turns.first,
            last=self.turns.last,
            duration=self.turns.duration,
            C=C,
            M=M,
            B=B,
            covariance=self.turns.covariance,
        )


def _compensation(block: Block, gyro: SensorModel) -> tuple[Array, Array]:
    """A and c of ω = A y + c, where y are body rates from nominal sensors."""
    to_body = np.linalg.pinv(block.axes)
    transform = np.asarray(np.linalg.inv(to_body @ gyro.matrix), dtype=float)
    return transform, -transform @ (to_body @ gyro.bias)


def _integrate(samples: TurnSamples, turns: int, transform: Array, offset: Array) -> tuple[Array, Array, Array]:
    """C, M and B of every turn; pieces of long turns are joined exactly."""
    C = np.broadcast_to(np.eye(3), (turns, 3, 3)).copy()
    M, B = np.zeros((turns, 3, 3, 3)), np.zeros((turns, 3, 3))
    for rates, _, intervals, turn, start, stop in samples.pieces():
        pieces = _kernels.preintegrate(rates * intervals[:, None], intervals, start, stop, transform, offset)
        piece_C, piece_M, piece_B = pieces  # no turn has two pieces in a batch
        M[turn] += (C[turn] @ piece_M.reshape(-1, 3, 9)).reshape(-1, 3, 3, 3)
        B[turn] += C[turn] @ piece_B
        C[turn] = C[turn] @ piece_C
    return C, M, B


def reduced_rests(
    reduction: Reduction, spans: tuple[RestSpan, ...], accel: Block, gyro: Block | None
) -> tuple[Rests, ColouredNoise | None, dict[str, Rounding]]:
    """The rests at these spans, at least one, the noise of the gyros and the rounding by kind of channel."""
    by_file = {f.file: f for f in reduction.files}
    blocks = [by_file[s.file] for s in spans]
    durations = np.array([s.stop - s.start for s in spans])
    accel_series = [f.accel[s.first : s.last] for f, s in zip(blocks, spans, strict=True)]
    gyro_series = [_gyro_of(f)[s.first : s.last] for f, s in zip(blocks, spans, strict=True)]
    rounded = {"accel": channel_rounding(reduction, spans, "accel")}
    accel_spread = accel_covariance(accel_series, accel) + np.diag(ACCEL_FLOOR**2 + rounded["accel"].of_rest ** 2)
    gyro_noise, gyro_spread = None, np.empty((len(spans), 0, 0))
    if gyro is not None:
        gyro_noise, rounded["gyro"] = fit_coloured_noise(gyro_series), channel_rounding(reduction, spans, "gyro")
        gyro_spread = np.array([gyro_noise.covariance_of_mean(len(s), i) for i, s in enumerate(gyro_series)])
        gyro_spread += np.diag(GYRO_FLOOR**2 + rounded["gyro"].of_rest ** 2)
    temperatures = [
        f.temperature[s.first : s.last].mean() for f, s in zip(blocks, spans, strict=True) if f.temperature is not None
    ]
    magnetometer, magnetometer_covariance = _magnetometer(reduction, blocks, spans)
    rests = Rests(
        file=np.array([s.file for s in spans]),
        start=np.array([s.start for s in spans]),
        stop=np.array([s.stop for s in spans]),
        accel=np.array([f.accel_mean(s.first, s.last) for f, s in zip(blocks, spans, strict=True)]),
        accel_covariance=accel_spread,
        accel_drift=drift(accel_series),
        accel_noise=density(accel_spread, durations),
        gyro=np.array([f.gyro_mean(s.first, s.last) for f, s in zip(blocks, spans, strict=True)]),
        gyro_covariance=gyro_spread,
        gyro_drift=drift(gyro_series),
        gyro_noise=density(gyro_spread, durations),
        temperature=np.array(temperatures) if temperatures else None,
        magnetometer=magnetometer,
        magnetometer_covariance=magnetometer_covariance,
    )
    return rests, gyro_noise, rounded


def observe(reduction: Reduction, match: Match, accel: Block, gyro: Block | None, site: Site) -> Observations:
    """Reduce the rests and turns of a log to observations. At least one rest is needed."""
    spans = match.rests
    rests, gyro_noise, rounded = reduced_rests(reduction, spans, accel, gyro)
    turns, samples, readings = None, None, None
    if gyro is not None and gyro_noise is not None and reduction.samples is not None:
        by_file, block_seconds = {f.file: f for f in reduction.files}, reduction.files[0].size / reduction.rate
        turns, samples = _turns(reduction.samples, by_file, spans, gyro, gyro_noise, block_seconds)
        readings = _turn_readings(by_file, spans, turns, gyro_noise, block_seconds) if gyro.size > 3 else None
    return Observations(
        accel_block=accel,
        gyro_block=gyro,
        site=site,
        rests=rests,
        turns=turns,
        turn_samples=samples,
        programme=match.programme,
        position=match.position,
        turn_readings=readings,
        rounding=rounded,
        notes=(*_copies(reduction), *rounding_notes(rounded)),
    )


def _copies(reduction: Reduction) -> tuple[str, ...]:
    """What there is to say of copied and lost samples."""
    samples = reduction.accel_channels[0].samples
    said = []
    if reduction.held:
        said.append(
            f"{reduction.held} of {samples} samples ({100.0 * reduction.held / samples:.2g} %) repeat the one before "
            "in every channel: they were held, or sent twice"
        )
    if reduction.lost:
        said.append(f"long intervals leave room for {reduction.lost} lost samples among {samples}")
    return tuple(said)


def _gyro_of(f: FileBlocks) -> Array:
    """Gyro block means of a file, (K, 0) without gyros."""
    return f.gyro if f.gyro is not None else np.empty((len(f.accel), 0))


def _magnetometer(
    reduction: Reduction, blocks: list[FileBlocks], spans: tuple[RestSpan, ...]
) -> tuple[Array, Array] | tuple[None, None]:
    """Mean readings (N, 3) of the magnetometer in the rests and their covariances (N, 3, 3), in its unit."""
    series = [
        f.magnetometer[s.first : s.last] for f, s in zip(blocks, spans, strict=True) if f.magnetometer is not None
    ]
    if not series:
        return None, None
    mean = np.array([f.magnetometer_mean(s.first, s.last) for f, s in zip(blocks, spans, strict=True)])
    noise = fit_coloured_noise(series)
    covariance = np.array([noise.covariance_of_mean(len(s), i) for i, s in enumerate(series)])
    return mean, covariance + np.diag(channel_rounding(reduction, spans, "magnetometer").of_rest ** 2)


def _turns(
    stored: MotionSamples,
    by_file: dict[int, FileBlocks],
    spans: tuple[RestSpan, ...],
    gyro: Block,
    noise: ColouredNoise,
    block_seconds: float,
) -> tuple[Turns, TurnSamples]:
    """The turns between consecutive rests of a file, integrated with nominal gyros."""
    pairs = [(i, i + 1) for i in range(len(spans) - 1) if spans[i].file == spans[i + 1].file]
    first, last = np.array(pairs, dtype=int).reshape(-1, 2).T
    sample = {f: (by_file[f].first_sample, by_file[f].size) for f in by_file}
    start = np.array([sample[spans[i].file][0] + sample[spans[i].file][1] * spans[i].last for i in first], dtype=int)
    stop = np.array([sample[spans[j].file][0] + sample[spans[j].file][1] * spans[j].first for j in last], dtype=int)
    duration = np.array([spans[j].start - spans[i].stop for i, j in pairs])
    samples = TurnSamples(samples=stored, start=start, stop=stop)
    C, M, B = _integrate(samples, len(pairs), *_compensation(gyro, gyro.nominal()))
    to_body = np.linalg.pinv(gyro.axes)
    long = np.maximum(duration, block_seconds)
    density = [T * to_body @ noise.covariance_of_mean(T / block_seconds) @ to_body.T for T in long]
    covariance = _carried(samples, np.array(density).reshape(-1, 3, 3)) + TURN_FLOOR**2 * np.eye(3)
    turns = Turns(first=first, last=last, duration=duration, C=C, M=M, B=B, covariance=covariance)
    return turns, samples


def _turn_readings(
    by_file: dict[int, FileBlocks],
    spans: tuple[RestSpan, ...],
    turns: Turns,
    noise: ColouredNoise,
    block_seconds: float,
) -> TurnReadings:
    """The readings of every gyro between the rests, from the blocks."""
    channels = noise.autocovariance.shape[0]
    integral, covariance = np.zeros((len(turns), channels)), np.zeros((len(turns), channels, channels))
    for k, (i, j, T) in enumerate(zip(turns.first, turns.last, turns.duration, strict=True)):
        blocks, between = by_file[spans[i].file], slice(spans[i].last, spans[j].first)
        integral[k] = np.diff(blocks.edges)[between] @ _gyro_of(blocks)[between]
        covariance[k] = T**2 * noise.covariance_of_mean(max(T / block_seconds, 1.0))
    return TurnReadings(integral=integral, covariance=covariance + TURN_FLOOR**2 * np.eye(channels))


def _carried(samples: TurnSamples, density: Array) -> Array:
    """∫ C N Cᵀ dt (K, 3, 3), rad², of the turns and the density N (K, 3, 3), rad²/s, of their gyro noise, by the
    trapezoidal rule over PATH_STEPS steps a piece."""
    C = np.broadcast_to(np.eye(3), density.shape).copy()
    out = np.zeros_like(density)
    for rates, _, intervals, turn, start, stop in samples.pieces():
        increments = rates * intervals[:, None]
        passed = np.concatenate([[0.0], np.cumsum(intervals)])
        for k, a, b in zip(turn, start, stop, strict=True):
            edges = np.unique(np.linspace(a, b, PATH_STEPS + 1).astype(np.int64))
            steps, _, _ = _kernels.preintegrate(increments, intervals, edges[:-1], edges[1:], np.eye(3), np.zeros(3))
            path = np.array(list(accumulate(steps, np.matmul, initial=C[k])))
            rotated = path @ density[k] @ np.swapaxes(path, 1, 2)
            out[k] += 0.5 * np.tensordot(np.diff(passed[edges]), rotated[1:] + rotated[:-1], axes=1)
            C[k] = path[-1]
    return out
