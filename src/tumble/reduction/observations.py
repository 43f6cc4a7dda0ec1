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

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate, pairwise

import numpy as np

from tumble.programme.positions import Programme
from tumble.recording.gaps import Gap
from tumble.recording.session import Site
from tumble.reduction.array_motion import ArrayMoments, MovedArray, array_moments
from tumble.reduction.blocks import FileBlocks, Reduction, extremes
from tumble.reduction.coloured_noise import ColouredNoise, fit_coloured_noise
from tumble.reduction.matching import Match
from tumble.reduction.moments import (
    NO_OWN_AXES,
    BlockCompensation,
    Compensation,
    Moments,
    OwnAxes,
    Pieces,
    growing_moments,
    integrate,
    integrate_each,
    moments_of,
)
from tumble.reduction.motion_samples import MotionSamples
from tumble.reduction.rest_noise import accel_covariance, channel_rounding, density, drift
from tumble.reduction.rounding import Rounding, rounding_notes
from tumble.reduction.segmentation import RestSpan
from tumble.reduction.thermometer import Thermometers
from tumble.reduction.warming import KelvinAtLag, without_warming
from tumble.sensors.model import Block, SensorModel
from tumble.units import Array, IntArray

BATCH_SAMPLES = 2**17
"""Of turns, that are in memory at a time: 7 MB."""
AHEAD = 2
"""Samples kept ahead of every piece of a turn, which the first step wants."""
ACCEL_FLOOR = 1e-9  # m/s²
GYRO_FLOOR = 1e-11  # rad/s
PATH_STEPS = 32
VELOCITY_FLOOR = 1e-8  # m/s
VELOCITY_STEP = 0.02  # of the velocity times the cube of the angle of a step: what the integration errs by
TURN_FLOOR = 1e-10  # rad: no mean and no turn is taken to be better known, a simulation without noise included


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rests:
    """N rests: file, start and stop (s), mean readings and their covariances in SI; drift is the change of a
    reading over the rest (slope times duration) and noise its density, unit/√Hz. The gyro arrays are empty
    (N, 0) where there are no gyros; the mean `temperatures` are those of the thermometers (N, T), K; the magnetometer's
    mean readings and their covariances are in its unit. None where there are none."""

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
    temperatures: Array | None
    magnetometer: Array | None = None
    magnetometer_covariance: Array | None = None

    def __len__(self) -> int:
        return len(self.start)

    @property
    def temperature(self) -> Array | None:
        """The mean over the thermometers (N,), K."""
        return None if self.temperatures is None else np.asarray(self.temperatures.mean(axis=1))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TurnSamples:
    """Where the samples of the turns are: turn k is samples start[k] … stop[k] − 1 of `samples`; those of further
    sessions are `others`, after so many turns."""

    samples: MotionSamples
    start: IntArray
    stop: IntArray
    others: tuple[tuple[int, TurnSamples], ...] = ()
    _only_batch: list[Pieces] = field(default_factory=list, repr=False)

    @property
    def lengths(self) -> IntArray:
        """How many samples the turns have (K,)."""
        return np.concatenate([self.stop - self.start, *(other.lengths for _, other in self.others)])

    def pieces(self) -> Iterator[Pieces]:
        """Batches of whole or cut turns, of no turn two pieces."""
        yield from self._own_pieces()
        for before, other in self.others:
            yield from (replace(pieces, turn=pieces.turn + before) for pieces in other.pieces())

    def _own_pieces(self) -> Iterator[Pieces]:
        """Those of these samples. Turns that fill one batch at most are gathered once."""
        if self._only_batch:
            return iter(self._only_batch)
        if int(np.sum(self.stop - self.start)) < BATCH_SAMPLES:
            self._only_batch.extend(self._gathered())
            return iter(self._only_batch)
        return self._gathered()

    def _gathered(self) -> Iterator[Pieces]:
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
        """So many samples in parts of turns: turn, first sample to be read, first of the part, and its end."""
        rates, forces, intervals = np.empty((count, 3)), np.empty((count, 3)), np.empty(count)
        pieces, done = [], 0
        for turn, first, at, end in parts:
            into = slice(done, done + end - first)
            rates[into], forces[into], intervals[into] = self.samples.read(first, end)
            pieces.append((turn, done + at - first, done + end - first))
            done += end - first
        turns, start, stop = np.array(pieces).T
        return Pieces(rates=rates, forces=forces, intervals=intervals, turn=turns, start=start, stop=stop)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TurnReadings:
    """Integrals (K, n) of the gyro readings over the turns, rad, and their covariance (K, n, n) from noise: what a
    redundant block says beyond the rotation of the body."""

    integral: Array
    covariance: Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Together:
    """Several sessions in one: their names, which of them every rest (N,) is of, in order, and the number of the rest
    in it (N,); parts of a rest have the same."""

    names: tuple[str, ...]
    session: IntArray
    number: IntArray


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
    rounding: Mapping[str, Rounding] = field(default_factory=dict)
    """Resolution of the accelerometers, "accel", and of the gyros, "gyro", and what it does to their means."""
    notes: tuple[str, ...] = ()
    """What is remarkable in the log, in words."""
    thermometers: Thermometers | None = None
    """The course of the temperatures, where there are thermometers."""
    together: Together | None = None
    """Where these are several sessions."""
    arrays: tuple[ArrayMoments, ...] = ()
    """Of every session, what the accelerometers of an array read in motion, where there are enough of them."""
    clock_u: float = 0.0
    """Relative standard uncertainty of the time base, where the gyros were logged as rates."""
    unstamped: bool = False
    """Whether no time in the log says that samples are missing."""
    usual: Mapping[str, float] = field(default_factory=dict)
    """Standard deviations, SI, of the groups of parameters beyond the linear model over instruments like this one."""
    warm_up: float | None = None
    """Time constant, s, in which biases settle after the start, where they do."""

    @property
    def session(self) -> IntArray | None:
        """Which session each rest (N,) is of, where there are several."""
        return None if self.together is None else self.together.session

    def rest_named(self, i: int) -> str:
        """What rest i is called: by its number, of several sessions with the name of its own."""
        if self.together is None:
            return f"rest {i + 1}"
        return f"{self.together.names[self.together.session[i]]}: rest {self.together.number[i] + 1}"

    def turn_named(self, k: int) -> str:
        """What turn k is called: by the rests at its ends and its times."""
        turns, rests = self.turns, self.rests
        assert turns is not None
        a, b = int(turns.first[k]), int(turns.last[k])
        before, after = self.rest_named(a), self.rest_named(b).rpartition(": ")[2]
        return f"the turn from {before} to {after} ({rests.stop[a]:.1f}–{rests.start[b]:.1f} s)"

    def start_values(self, block: Block) -> Array:
        """Start values of a block's parameters, in their order."""
        return np.array([self.start.get(name, 0.0) for name in block.names])

    def moments_about(self, compensation: Compensation, own: OwnAxes = NO_OWN_AXES) -> Moments:
        """The moments of the turns with samples compensated in this way."""
        if self.turns is None or self.turn_samples is None:
            raise ValueError("moments_about: expected observations of a log with gyros and turns, found none")
        return integrate(self.turn_samples.pieces(), len(self.turns), compensation, own)

    def moments_about_each(self, compensations: Sequence[Compensation], own: OwnAxes = NO_OWN_AXES) -> Moments:
        """The same with samples of each turn compensated in a way of its own."""
        if self.turns is None or self.turn_samples is None:
            raise ValueError("moments_about_each: expected observations of a log with gyros and turns, found none")
        return integrate_each(self.turn_samples.pieces(), compensations, own)

    def growing_moments_about(self, compensation: Compensation) -> tuple[Array, Array]:
        """Φ and Ψ of the same turns, weighted with the time from the middle of each, see `growing_moments`."""
        if self.turns is None or self.turn_samples is None:
            raise ValueError("growing_moments_about: expected observations of a log with gyros and turns, found none")
        return growing_moments(self.turn_samples.pieces(), self.turn_samples.lengths, compensation)

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


def reduced_rests(
    reduction: Reduction, spans: tuple[RestSpan, ...], accel: Block, gyro: Block | None
) -> tuple[Rests, list[Array], ColouredNoise | None, dict[str, Rounding]]:
    """The rests at these spans, at least one, what their noise is fitted to of the accelerometers, the noise of the
    gyros and the rounding by kind of channel."""
    by_file = {f.file: f for f in reduction.files}
    blocks = [by_file[s.file] for s in spans]
    durations = np.array([s.stop - s.start for s in spans])
    accel_series, gyro_series, temperatures = _series(blocks, spans)
    warmth = _warmth(reduction, blocks, spans, temperatures)
    accel_quiet = without_warming(accel_series, warmth, accel.thermometer)
    rounded = {"accel": channel_rounding(reduction, spans, "accel")}
    accel_spread = accel_covariance(accel_quiet, accel) + np.diag(ACCEL_FLOOR**2 + rounded["accel"].of_rest ** 2)
    gyro_noise, gyro_spread = None, np.empty((len(spans), 0, 0))
    if gyro is not None:
        gyro_noise = fit_coloured_noise(without_warming(gyro_series, warmth, gyro.thermometer))
        rounded["gyro"] = channel_rounding(reduction, spans, "gyro")
        gyro_spread = np.array([gyro_noise.covariance_of_mean(len(s), i) for i, s in enumerate(gyro_series)])
        gyro_spread += np.diag(GYRO_FLOOR**2 + rounded["gyro"].of_rest ** 2)
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
        temperatures=None if temperatures is None else np.array([each.mean(axis=0) for each in temperatures]),
        magnetometer=magnetometer,
        magnetometer_covariance=magnetometer_covariance,
    )
    return rests, accel_quiet, gyro_noise, rounded


def _series(
    blocks: Sequence[FileBlocks], spans: tuple[RestSpan, ...]
) -> tuple[list[Array], list[Array], list[Array] | None]:
    """Block means of the accelerometers and of the gyros in the rests at these spans, and their temperatures
    (K, T), K, where all rests have some."""
    pairs = list(zip(blocks, spans, strict=True))
    accel, gyro = [f.accel[s.first : s.last] for f, s in pairs], [_gyro_of(f)[s.first : s.last] for f, s in pairs]
    kelvin = [f.temperature[s.first : s.last] for f, s in pairs if f.temperature is not None]
    return accel, gyro, kelvin if len(kelvin) == len(pairs) else None


def _warmth(
    reduction: Reduction, blocks: Sequence[FileBlocks], spans: tuple[RestSpan, ...], kelvin: list[Array] | None
) -> KelvinAtLag | None:
    """From a lag to the temperatures, K, of what follows each thermometer in the rests at these spans, where it has
    itself `kelvin`; None where there are none."""
    if kelvin is None:
        return None
    thermometers, file = _thermometers(reduction), np.repeat([s.file for s in spans], [len(each) for each in kelvin])
    read = np.concatenate(kelvin)
    time = np.concatenate([f.edges[1:][s.first : s.last] for f, s in zip(blocks, spans, strict=True)])
    return lambda lag: read if lag == 0.0 else thermometers.means(file, time, time, lag).kelvin


def observe(
    reduction: Reduction,
    match: Match,
    accel: Block,
    gyro: Block | None,
    site: Site,
    arrays: tuple[ArrayMoments, ...] | None = None,
) -> Observations:
    """Reduce the rests and turns of a log to observations. At least one rest is needed. What an array reads in motion
    does not depend on the rests: it is made unless it is given, of the same log with other rests."""
    spans = match.rests
    rests, accel_quiet, gyro_noise, rounded = reduced_rests(reduction, spans, accel, gyro)
    turns, samples, readings = None, None, None
    if gyro is not None and gyro_noise is not None and reduction.samples is not None:
        by_file, block_seconds = {f.file: f for f in reduction.files}, reduction.files[0].size / reduction.rate
        whole = _recorded_turns(spans, reduction.gaps)
        noises = (accel, fit_coloured_noise(accel_quiet)), (gyro, gyro_noise)
        turns, samples = _turns(reduction.samples, by_file, spans, whole, *noises, block_seconds)
        readings = _turn_readings(by_file, spans, turns, gyro_noise, block_seconds) if gyro.size > 3 else None
        arrays = _arrays(reduction, rests, accel, gyro) if arrays is None else arrays
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
        arrays=arrays or (),
        rounding=rounded,
        notes=(*_copies(reduction), *rounding_notes(rounded)),
        thermometers=None if rests.temperatures is None else _thermometers(reduction),
    )


def _arrays(reduction: Reduction, rests: Rests, accel: Block, gyro: Block) -> tuple[ArrayMoments, ...]:
    """What the accelerometers of an array read in motion, that in turns which are left out included."""
    if reduction.samples is None:
        return ()
    parts = [(f.first_sample, f.first_sample + f.size * len(f.accel)) for f in reduction.files]
    array = MovedArray(
        accel=accel,
        gyro=gyro,
        accel_extremes=extremes(reduction.accel_channels),
        gyro_extremes=extremes(reduction.gyro_channels),
        at_rest=np.linalg.pinv(gyro.axes) @ rests.gyro.mean(axis=0),
    )
    found = array_moments(reduction.samples, parts, array)
    return () if found is None else (found,)


def _thermometers(reduction: Reduction) -> Thermometers:
    """The records of the thermometers: a temperature is that at the end of a block."""
    return Thermometers.of({f.file: (f.edges[1:], f.temperature) for f in reduction.files if f.temperature is not None})


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


def _recorded_turns(spans: tuple[RestSpan, ...], gaps: tuple[Gap, ...]) -> list[tuple[int, int]]:
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
