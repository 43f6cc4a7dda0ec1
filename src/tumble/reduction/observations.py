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
from dataclasses import dataclass, field, replace
from itertools import accumulate, pairwise

import numpy as np

from tumble.programme.positions import Programme
from tumble.recording.gaps import Gap
from tumble.recording.session import Site
from tumble.reduction.blocks import ChannelState, FileBlocks, Reduction
from tumble.reduction.coloured_noise import ColouredNoise, fit_coloured_noise
from tumble.reduction.matching import Match
from tumble.reduction.moments import (
    NO_OWN_AXES,
    BlockCompensation,
    Compensation,
    Moments,
    OwnAxes,
    Pieces,
    integrate,
    moments_of,
)
from tumble.reduction.motion_samples import MotionSamples
from tumble.reduction.segmentation import RestSpan
from tumble.rotation import tangent_basis
from tumble.sensors.model import Block, SensorModel
from tumble.units import Array, IntArray

BATCH_SAMPLES = 2**20
AHEAD = 2
"""Samples kept ahead of every piece of a turn, which the first step wants."""
ACCEL_FLOOR = 1e-9  # m/s²
GYRO_FLOOR = 1e-11  # rad/s
PATH_STEPS = 32
VELOCITY_FLOOR = 1e-8  # m/s
VELOCITY_STEP = 0.02  # of the velocity times the cube of the angle of a step: what the integration errs by
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
    M (K, 3, 3, 3) rad and B (K, 3, 3) s, and the covariance (K, 3, 3) of the rotation from gyro noise, rad²; the
    velocity increment (K, 3), m/s, its covariance (K, 3, 3) from accelerometer noise, and `jumps` (K,), m²/s², the sum
    of the squares of what the force jumps by from sample to sample times the interval (A3). All are resolved in the
    non-rotating frame that is the body at the start of the turn."""

    first: IntArray
    last: IntArray
    duration: Array
    C: Array
    M: Array
    B: Array
    covariance: Array
    velocity: Array
    velocity_covariance: Array
    jumps: Array

    def __len__(self) -> int:
        return len(self.duration)


@dataclass(frozen=True, kw_only=True, slots=True)
class TurnSamples:
    """Where the samples of the turns are: turn k is samples start[k] … stop[k] − 1 of `samples`."""

    samples: MotionSamples
    start: IntArray
    stop: IntArray
    _only_batch: list[Pieces] = field(default_factory=list, repr=False)

    def pieces(self) -> Iterator[Pieces]:
        """Batches of whole or cut turns, of no turn two pieces. Turns that fill one batch at most are gathered once."""
        if self._only_batch:
            return iter(self._only_batch)
        if int(np.sum(self.stop - self.start)) < BATCH_SAMPLES:
            self._only_batch.extend(self._gathered())
            return iter(self._only_batch)
        return self._gathered()

    def _gathered(self) -> Iterator[Pieces]:
        parts: list[tuple[Array, Array, Array]] = []
        pieces: list[tuple[int, int, int]] = []
        count = 0
        for turn, (start, stop) in enumerate(zip(self.start, self.stop, strict=True)):
            for at in range(int(start), int(stop), BATCH_SAMPLES):
                end, ahead = min(at + BATCH_SAMPLES, int(stop)), min(AHEAD, at)
                parts.append(self.samples.read(at - ahead, end))
                pieces.append((turn, count + ahead, count + ahead + end - at))
                count += end - at + ahead
                if count >= BATCH_SAMPLES:
                    yield _pieces(parts, pieces)
                    parts, pieces, count = [], [], 0
        if pieces:
            yield _pieces(parts, pieces)


def _pieces(parts: list[tuple[Array, Array, Array]], pieces: list[tuple[int, int, int]]) -> Pieces:
    rates, forces, intervals = (np.concatenate(part) for part in zip(*parts, strict=True))
    turn, start, stop = np.array(pieces).T
    return Pieces(rates=rates, forces=forces, intervals=intervals, turn=turn, start=start, stop=stop)


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
    usual: Mapping[str, float] = field(default_factory=dict)
    """Standard deviations, SI, of the groups of parameters beyond the linear model over instruments like this one."""

    def start_values(self, block: Block) -> Array:
        """Start values of a block's parameters, in their order."""
        return np.array([self.start.get(name, 0.0) for name in block.names])

    def moments_about(self, compensation: Compensation, own: OwnAxes = NO_OWN_AXES) -> Moments:
        """The moments of the turns with samples compensated in this way."""
        if self.turns is None or self.turn_samples is None:
            raise ValueError("moments_about: expected observations of a log with gyros and turns, found none")
        return integrate(self.turn_samples.pieces(), len(self.turns), compensation, own)

    def turns_about(self, gyro: SensorModel) -> Turns:
        """The turns integrated about a gyro model: its effect on the rotation is exact, and M and B are the
        sensitivities at this model."""
        if self.turns is None or self.gyro_block is None:
            raise ValueError("turns_about: expected observations of a log with gyros and turns, found none")
        accel = self.accel_block
        moments = self.moments_about(_linear(self.gyro_block, gyro, accel, accel.nominal()))
        return replace(
            self.turns,
            C=moments.C,
            M=moments.Phi[..., 1:4],
            B=moments.Phi[..., 0],
            velocity=moments.V,
            jumps=moments.jumps,
        )


def _linear(gyro: Block, gyro_model: SensorModel, accel: Block, accel_model: SensorModel) -> Compensation:
    """Compensation by the linear models."""
    return Compensation(
        gyro=BlockCompensation.of(gyro.axes, gyro_model),
        accel=BlockCompensation.of(accel.axes, accel_model),
        g_sensitivity=np.zeros((3, 3)),
        delay=0.0,
    )


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
        accel_fit = fit_coloured_noise(accel_series)
        whole = _recorded_turns(spans, reduction.gaps)
        noises = (accel, accel_fit), (gyro, gyro_fit)
        turns, samples = _turns(reduction.samples, by_file, spans, whole, *noises, block_seconds)
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


def _recorded_turns(spans: tuple[RestSpan, ...], gaps: tuple[Gap, ...]) -> list[tuple[int, int]]:
    """The rests before and after each turn that was recorded as a whole, in one file."""
    broken = [gap for gap in gaps if not gap.integrable]
    return [
        (i, i + 1)
        for i, (before, after) in enumerate(pairwise(spans))
        if before.file == after.file
        and not any(g.file == before.file and g.time < after.start and g.stop > before.stop for g in broken)
    ]


def _turns(
    stored: MotionSamples,
    by_file: dict[int, FileBlocks],
    spans: tuple[RestSpan, ...],
    pairs: list[tuple[int, int]],
    accel_noise: tuple[Block, ColouredNoise],
    gyro_noise: tuple[Block, ColouredNoise],
    block_seconds: float,
) -> tuple[Turns, TurnSamples]:
    """The turns between consecutive rests `pairs` of a file, integrated with nominal gyros."""
    first, last = np.array(pairs, dtype=int).reshape(-1, 2).T
    sample = {f: (by_file[f].first_sample, by_file[f].size) for f in by_file}
    start = np.array([sample[spans[i].file][0] + sample[spans[i].file][1] * spans[i].last for i in first], dtype=int)
    stop = np.array([sample[spans[j].file][0] + sample[spans[j].file][1] * spans[j].first for j in last], dtype=int)
    duration = np.array([spans[j].start - spans[i].stop for i, j in pairs])
    samples = TurnSamples(samples=stored, start=start, stop=stop)
    (accel, of_accel), (gyro, of_gyro) = accel_noise, gyro_noise
    linear = _linear(gyro, gyro.nominal(), accel, accel.nominal())
    moments = integrate(samples.pieces(), len(pairs), linear)
    long = np.maximum(duration, block_seconds)
    density = np.array([T * _of_mean(gyro, of_gyro, T / block_seconds) for T in long]).reshape(-1, 3, 3)
    velocity = np.array([T**2 * np.trace(_of_mean(accel, of_accel, T / block_seconds)) / 3.0 for T in long])
    turns = Turns(
        first=first,
        last=last,
        duration=duration,
        C=moments.C,
        M=moments.Phi[..., 1:4],
        B=moments.Phi[..., 0],
        covariance=_carried(samples, density) + TURN_FLOOR**2 * np.eye(3),
        velocity=moments.V,
        velocity_covariance=(velocity + velocity_floor(moments, stop - start) ** 2)[:, None, None] * np.eye(3),
        jumps=moments.jumps,
    )
    return turns, samples


_BODY = Block(kind="gyro", axes=np.eye(3))


def velocity_floor(moments: Moments, samples: IntArray) -> Array:
    """Standard deviation (K,), m/s, of the velocities of turns of so many samples (K,) from rounding and from the error
    of the integration, which is of third order in the angle of a step (A1)."""
    mean_square = (moments.body_rates[:, [0, 3, 5]]).sum(axis=1) * moments.T
    step = np.sqrt(mean_square) / np.maximum(samples, 1)
    return np.asarray(VELOCITY_FLOOR + VELOCITY_STEP * np.linalg.norm(moments.V, axis=1) * step**3)


def _of_mean(block: Block, noise: ColouredNoise, blocks: float) -> Array:
    """Covariance (3, 3) of a mean over so many blocks, in the body."""
    to_body = np.linalg.pinv(block.axes)
    return np.asarray(to_body @ noise.covariance_of_mean(blocks) @ to_body.T)


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
    nominal = _linear(_BODY, _BODY.nominal(), _BODY, _BODY.nominal())
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
