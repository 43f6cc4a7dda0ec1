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
from tumble.reduction.blocks import ChannelState, FileBlocks, GyroSamples, Reduction
from tumble.reduction.coloured_noise import ColouredNoise, fit_coloured_noise
from tumble.reduction.matching import Match
from tumble.reduction.segmentation import RestSpan
from tumble.rotation import tangent_basis
from tumble.sensors.model import Block, SensorModel
from tumble.units import Array, IntArray

BATCH_SAMPLES = 2**20
ACCEL_FLOOR = 1e-9  # m/s²
GYRO_FLOOR = 1e-11  # rad/s
PATH_STEPS = 32
TURN_FLOOR = 1e-10  # rad: no mean and no turn is taken to be better known, a simulation without noise included


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
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


Batch = tuple[Array, Array, IntArray, IntArray, IntArray]
"""Increments, intervals, the turn of each piece, and the range of each piece among them; the sample before every
piece is kept ahead of it."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TurnSamples:
    """Where the samples of the turns are: turn k is samples start[k] … stop[k] − 1 of `samples`."""

    samples: GyroSamples
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
        increments: list[Array] = []
        intervals: list[Array] = []
        pieces: list[tuple[int, int, int]] = []
        count = 0
        for turn, (start, stop) in enumerate(zip(self.start, self.stop, strict=True)):
            for at in range(int(start), int(stop), BATCH_SAMPLES):
                end = min(at + BATCH_SAMPLES, int(stop))
                increment, interval = self.samples.read(at - 1, end)
                increments.append(increment)
                intervals.append(interval)
                pieces.append((turn, count + 1, count + 1 + end - at))
                count += len(interval)
                if count >= BATCH_SAMPLES:
                    yield _batch(increments, intervals, pieces)
                    increments, intervals, pieces, count = [], [], [], 0
        if pieces:
            yield _batch(increments, intervals, pieces)


def _batch(increments: list[Array], intervals: list[Array], pieces: list[tuple[int, int, int]]) -> Batch:
    turn, start, stop = np.array(pieces).T
    return np.concatenate(increments), np.concatenate(intervals), turn, start, stop


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TurnReadings:
    """Integrals (K, n) of the gyro readings over the turns, rad, and their covariance (K, n, n) from noise: what a
    redundant block says beyond the rotation of the body."""

    integral: Array
    covariance: Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
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
    for increments, intervals, turn, start, stop in samples.pieces():
        pieces = _kernels.preintegrate(increments, intervals, start, stop, transform, offset)
        piece_C, piece_M, piece_B = pieces  # no turn has two pieces in a batch
        M[turn] += (C[turn] @ piece_M.reshape(-1, 3, 9)).reshape(-1, 3, 3, 3)
        B[turn] += C[turn] @ piece_B
        C[turn] = C[turn] @ piece_C
    return C, M, B


def observe(reduction: Reduction, match: Match, accel: Block, gyro: Block | None, site: Site) -> Observations:
    """Reduce the rests and turns of a log to observations. At least one rest is needed."""
    spans = match.rests
    by_file = {f.file: f for f in reduction.files}
    blocks = [by_file[s.file] for s in spans]
    durations = np.array([s.stop - s.start for s in spans])
    accel_series = [f.accel[s.first : s.last] for f, s in zip(blocks, spans, strict=True)]
    gyro_series = [_gyro_of(f)[s.first : s.last] for f, s in zip(blocks, spans, strict=True)]
    block_seconds = reduction.files[0].size / reduction.rate
    accel_mean = np.array([f.accel_mean(s.first, s.last) for f, s in zip(blocks, spans, strict=True)])
    gyro_mean = np.array([f.gyro_mean(s.first, s.last) for f, s in zip(blocks, spans, strict=True)])
    accel_covariance = _accel_covariance(accel_series, accel) + _unresolved(reduction.accel_channels)
    gyro_fit = fit_coloured_noise(gyro_series) if gyro is not None else None
    gyro_covariance = _gyro_covariance(gyro_series, gyro_fit) + _unresolved(reduction.gyro_channels)
    temperatures = [
        f.temperature[s.first : s.last].mean() for f, s in zip(blocks, spans, strict=True) if f.temperature is not None
    ]
    magnetometer, magnetometer_covariance = _magnetometer(reduction, blocks, spans)
    rests = Rests(
        file=np.array([s.file for s in spans]),
        start=np.array([s.start for s in spans]),
        stop=np.array([s.stop for s in spans]),
        accel=accel_mean,
        accel_covariance=accel_covariance,
        accel_drift=_drift(accel_series),
        accel_noise=_density(accel_covariance, durations),
        gyro=gyro_mean,
        gyro_covariance=gyro_covariance,
        gyro_drift=_drift(gyro_series),
        gyro_noise=_density(gyro_covariance, durations),
        temperature=np.array(temperatures) if temperatures else None,
        magnetometer=magnetometer,
        magnetometer_covariance=magnetometer_covariance,
    )
    turns, samples, readings = None, None, None
    if gyro is not None and gyro_fit is not None and reduction.samples is not None:
        turns, samples = _turns(reduction.samples, by_file, spans, gyro, gyro_fit, block_seconds)
        readings = _turn_readings(by_file, spans, turns, gyro_fit, block_seconds) if gyro.size > 3 else None
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
    )


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
    return mean, covariance + _unresolved(reduction.magnetometer_channels)


def _accel_covariance(series: list[Array], block: Block) -> Array:
    """Covariance (N, n, n) of the mean accelerometer readings.

    A rest in which the body slowly tilts shows it in the horizontal directions, where it would pass for sensor
    noise; the vertical, and for n > 3 the directions that no specific force explains, are free of it to first
    order. The two kinds of direction therefore have noises of their own. Channels are first divided by their
    noise from block to block; a rough bias is taken off first, lest it should turn the directions."""
    size = np.sqrt(np.median([np.diff(s, axis=0).var(axis=0) for s in series], axis=0))
    size = np.where(size > 0.0, size, 1.0)
    mean = np.array([s.mean(axis=0) for s in series])
    force = mean @ np.linalg.pinv(block.axes).T
    force = force - _rough_bias(force)
    tilted = np.einsum("pk,ijk->ipj", block.axes, tangent_basis(force / np.linalg.norm(force, axis=1, keepdims=True)))
    basis, _ = np.linalg.qr(tilted / size[:, None], mode="complete")
    rotated = [s / size @ q for s, q in zip(series, basis, strict=True)]
    variance = np.empty_like(mean)
    for group in (slice(0, 2), slice(2, None)):
        columns = [r[:, group][:, [c]] for r in rotated for c in range(r[:, group].shape[1])]
        fit = fit_coloured_noise(columns)
        each = [fit.covariance_of_mean(len(x), i)[0, 0] for i, x in enumerate(columns)]
        variance[:, group] = np.array(each).reshape(len(series), -1).mean(axis=1, keepdims=True)
    scaled = basis * size[:, None]
    covariance = scaled * variance[:, None, :] @ np.swapaxes(scaled, 1, 2)
    return np.asarray(covariance + ACCEL_FLOOR**2 * np.eye(mean.shape[1]))


def _rough_bias(force: Array) -> Array:
    """The centre (3,) of the sphere through specific forces (N, 3) at rest; zero where they do not tell."""
    rows = np.column_stack([2.0 * force, np.ones(len(force))])
    solution, _, rank, singular = np.linalg.lstsq(rows, (force**2).sum(axis=1))
    size = float(np.linalg.norm(force, axis=1).mean())
    seen = rank == 4 and len(force) >= 6 and singular[-1] > 0.1
    return np.asarray(solution[:3]) if seen and float(np.linalg.norm(solution[:3])) < 0.5 * size else np.zeros(3)


def _gyro_covariance(series: list[Array], fit: ColouredNoise | None) -> Array:
    """Covariance (N, n, n) of the mean gyro readings."""
    if fit is None:
        return np.empty((len(series), 0, 0))
    floor = GYRO_FLOOR**2 * np.eye(series[0].shape[1])
    return np.array([fit.covariance_of_mean(len(s), i) for i, s in enumerate(series)]) + floor


def _unresolved(channels: tuple[ChannelState, ...]) -> Array:
    """Variance (n, n) of a mean from the resolution of its channel."""
    return np.diag([channel.unresolved**2 for channel in channels])


def _density(covariance: Array, seconds: Array) -> Array:
    """Noise density (N, n), unit/√Hz, behind the covariance of the means."""
    return np.sqrt(np.diagonal(covariance, axis1=1, axis2=2) * seconds[:, None])


def _drift(series: list[Array]) -> Array:
    """Change of the readings over each rest: least-squares slope times duration."""
    out = []
    for s in series:
        x = np.arange(len(s)) - 0.5 * (len(s) - 1)
        out.append(x @ s / (x @ x) * len(s))
    return np.array(out)


def _turns(
    stored: GyroSamples,
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
    for increments, intervals, turn, start, stop in samples.pieces():
        passed = np.concatenate([[0.0], np.cumsum(intervals)])
        for k, a, b in zip(turn, start, stop, strict=True):
            edges = np.unique(np.linspace(a, b, PATH_STEPS + 1).astype(np.int64))
            steps, _, _ = _kernels.preintegrate(increments, intervals, edges[:-1], edges[1:], np.eye(3), np.zeros(3))
            path = np.array(list(accumulate(steps, np.matmul, initial=C[k])))
            rotated = path @ density[k] @ np.swapaxes(path, 1, 2)
            out[k] += 0.5 * np.tensordot(np.diff(passed[edges]), rotated[1:] + rotated[:-1], axes=1)
            C[k] = path[-1]
    return out
