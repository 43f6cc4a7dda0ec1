"""Faulty channels of a log: dead, stuck, clipped, damaged or filtered ones, and accelerometers that do not read gravity
at rest, with the unit, scale, offset or columns that would explain it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tumble.advice import Advised
from tumble.recording.session import Channels, LogSpec, Session
from tumble.reduction.blocks.reducer import ChannelState, Reduction
from tumble.reduction.rests.segmentation import Stretch
from tumble.rotation import onto_body, unit_vector
from tumble.units import ACCEL_UNITS, DEGREE, G_STANDARD, UNIT_TOLERANCE, Array, fitting_units, is_near_one

LEAST_REST_SHARE = 0.2  # least part of a recording at rest, where samples of coarse resolution repeat
LARGEST_READING = 1e10  # SI: no sensor reads more, in whatever unit of its log
HELD_END = 2.5  # samples between the ends of a run of a channel and of the run of rows that it is part of
RUN_PROBABILITY = 1e-9  # below it, a run of equal samples is a fault
LEAST_LENGTH = 1e-9  # m/s² or rad: shorter vectors have no direction
LEAP = 0.3 * G_STANDARD  # within 0.1 s, at the median: larger than the vibration of a device at rest


def mixed_rows(reduction: Reduction, log: LogSpec) -> Iterator[str]:
    """Yield a fault if accelerometers leap all the time, as when rows of several sensors are mixed."""
    leaps = np.concatenate([each.accel.ends - each.accel.means for each in reduction.files])
    leap = float(np.median(np.linalg.norm(leaps, axis=1))) * np.sqrt(3 / leaps.shape[1])
    if leap >= LEAP:
        yield (
            f"the accelerometers leap by {leap:.2g} m/s^2 from sample to sample, most of the time: columns "
            f"{', '.join(map(repr, log.accel.columns))} have rows of several sensors, or the device was shaken "
            "throughout; give each sensor its own columns, and let the device rest"
        )


RADIAL_NOISE, CONSTANT_MAGNITUDE = 0.25, 1e-3
"""Spread of the magnitude, relative to the noise across gravity and to itself, below which it was normalised: raw
sensors have the same noise along gravity as across, and errors beside."""
VIBRATION_LENGTHENS = 1e-5
"""In g: a vibration v across gravity lengthens raw readings by v²/2g, which is visible from this size on."""


def normalised(reduction: Reduction, rests: Sequence[Stretch], to_body: Array) -> Iterator[str]:
    """Yield a fault if the magnitude of the accelerometers is constant also in motion, as a driver has divided by it.

    `to_body` (3, n) converts readings to vectors."""
    length = np.linalg.norm(np.concatenate([each.accel.ends for each in reduction.files]) @ to_body.T, axis=1)
    magnitude, files = float(np.median(length)), reduction.by_file
    spread = float(np.sqrt(np.mean((length - magnitude) ** 2)))
    squares, lengthened = list[float](), list[float]()
    for rest in rests:
        samples = files[rest.file].accel.ends[rest.first : rest.last] @ to_body.T
        up = samples.mean(axis=0) / max(float(np.linalg.norm(samples.mean(axis=0))), LEAST_LENGTH)
        square = (np.cross(samples - samples.mean(axis=0), up) ** 2).sum(axis=1)
        squares.append(0.5 * float(square.mean()))
        lengthened.append(0.5 * float(square.std()) / max(magnitude, LEAST_LENGTH))
    if not squares:
        return
    noise, by_vibration = float(np.sqrt(np.median(squares))), float(np.median(lengthened))
    limit = CONSTANT_MAGNITUDE * magnitude
    if by_vibration > VIBRATION_LENGTHENS * magnitude:
        steps = [channel.step for channel in reduction.accel_channels if np.isfinite(channel.step)]
        limit = min(limit, max([by_vibration, *steps]))
    if spread < min(RADIAL_NOISE * noise, limit):
        yield Advised(
            f"the magnitude of the accelerometers is {magnitude:.6g} m/s^2 at rest and on the way, constant to "
            f"{spread:.1g} m/s^2, where their noise across it is {noise:.1g} m/s^2: a driver has normalised them, and "
            "their biases and scale factors are lost",
            "record the raw specific force",
        )


FEWEST_ZEROS, ZEROS_RATIO = 5, 3.0
"""Zeros at rest are a dead zone if there are more than this number and, beyond it, this many times the values at the
most frequent other place."""
PULSE_PLACES, PULSE_WIDTHS, PULSE_SHARE = 200.0, 20.0, 0.35
"""Pulses with jittering intervals: values within one of PULSE_PLACES between zero and the median are taken as one. They
are pulses if more than this share is in one of PULSE_WIDTHS; hardly two values of smooth noise are equal."""
FINE_STEPS = 3.0  # steps of a channel; if other values are mostly closer to zero, coarse resolution makes the zeros


def dead_zones(reduction: Reduction, rests: Sequence[Stretch], channels: Channels) -> Iterator[str]:
    """Yield gyros whose driver writes 0 for small rates.

    At rest they read 0 more often than their resolution explains, and no other small values."""
    files = reduction.by_file
    samples = np.abs(np.concatenate([each.gyro.ends for each in reduction.files]))
    at_rest = [np.abs(files[rest.file].gyro.ends[rest.first : rest.last]) for rest in rests]
    sizes_at_rest = np.concatenate([samples[:0], *at_rest])

    def most_equal(values: Array) -> int:
        return int(np.unique(values, return_counts=True)[1].max())

    for column, state, sizes, anywhere in zip(
        channels.columns, reduction.gyro_channels, sizes_at_rest.T, samples.T, strict=True
    ):
        zeros, others = int((sizes == 0.0).sum()), sizes[sizes > 0.0]
        if zeros <= FEWEST_ZEROS or not anywhere.any():
            continue
        least = typical = float(anywhere[anywhere > 0.0].min())
        busiest = 0
        if len(others):
            typical = float(np.median(others))
            pulses = most_equal(np.round(PULSE_WIDTHS * others / typical)) > PULSE_SHARE * len(others)
            busiest = most_equal(np.floor(PULSE_PLACES * others / typical) if pulses else others)
        resolved = not np.isfinite(state.step) or typical >= FINE_STEPS * state.step
        if resolved and zeros > FEWEST_ZEROS + ZEROS_RATIO * busiest:
            yield Advised(
                f"column {column!r} reads exactly 0 in {100.0 * zeros / len(sizes):.3g} % of the samples at rest, "
                f"and never less than {least / DEGREE:.2g} °/s otherwise: a dead zone of the driver, in which "
                "biases and slow rates are lost",
                "switch it off",
            )


DECAY_CORRELATION = 0.5  # squared correlation of the readings at the start of a rest with the turn before
REMAINING_ANGLE, TILTED = 0.3, 0.5
"""Part of the angle of a turn that remains in the integral of the gyros, and least change of the vertical, rad."""
FEWEST_TURNS = 5


def high_passed(reduction: Reduction, rests: Sequence[Stretch]) -> Iterator[str]:
    """Yield a fault if the gyros are behind a high-pass filter.

    With a time constant τ, they read −θ/τ after a turn by θ, which decays: readings at the start of a rest, less those
    at its end, are opposite to the turn before. Little of a turn that lasts longer than τ remains in their integral,
    whatever the change of the vertical."""
    files, starts, turns, remaining = reduction.by_file, list[Array](), list[Array](), list[float]()
    for before, rest in pairwise(rests):
        f = files[rest.file]
        if before.file != rest.file:
            continue
        half, between = max((rest.last - rest.first) // 2, 1), slice(before.last, rest.first)
        later = f.gyro.means[rest.last - half : rest.last].mean(axis=0)
        angles = np.diff(f.edges)[between, None] * (f.gyro.means[between] - later)
        starts.append(f.gyro.means[rest.first : rest.first + half].mean(axis=0) - later)
        turns.append(angles.sum(axis=0))
        verticals = (unit_vector(f.accel.means[span.first : span.last].mean(axis=0)) for span in (before, rest))
        if np.linalg.norm(np.subtract(*verticals)) > TILTED and len(angles):
            path = float(np.linalg.norm(angles, axis=1).sum())
            remaining.append(float(np.linalg.norm(turns[-1])) / max(path, LEAST_LENGTH))
    r, θ = np.array(starts), np.array(turns)
    along, evidence = float((r * θ).sum()), ""
    limit = DECAY_CORRELATION * float((r**2).sum() * (θ**2).sum())
    if len(r) >= FEWEST_TURNS and along < 0.0 and along**2 > limit:
        evidence = "at rest the gyros read a rate against the turn before, which fades"
    elif len(remaining) >= FEWEST_TURNS and np.median(remaining) < REMAINING_ANGLE:
        evidence = "in the integral of the gyros next to nothing is left of a turn once it is over"
    if evidence:
        lost = "a high-pass filter on the chip or in the driver, with which slow rates and biases are lost"
        yield Advised(f"{evidence}: {lost}", "switch it off")


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelFault:
    """A fault of a sensor, by its number among those of its kind."""

    sensor: int
    sentence: str
    clipped: bool = False  # the sensor is sound within its range


def channel_faults(reduction: Reduction, log: LogSpec) -> tuple[list[ChannelFault], list[ChannelFault]]:
    """Return the accelerometers and the gyros that are dead, stuck, clipped or damaged.

    A channel is not stuck where all are: then the log held its last row, which is a gap (`Reduction.held_runs`)."""
    accel, gyros = block_means(reduction)
    rate, held = reduction.rate, [gap.stop for gap in reduction.held_runs if gap.stop is not None]
    of_accel = list(_faults_of_kind(reduction.accel_channels, accel, log.accel, rate, "use a larger range", held))
    if log.gyro is None:
        return of_accel, []
    advice = "use a larger range or turn more slowly"
    return of_accel, list(_faults_of_kind(reduction.gyro_channels, gyros, log.gyro, rate, advice, held))


def block_means(reduction: Reduction) -> tuple[Array, Array]:
    """Return the mean readings (K, n), SI, of the blocks of all files, of the accelerometers and of the gyros."""
    accel, gyro = ([getattr(each, kind).means for each in reduction.files] for kind in ("accel", "gyro"))
    return np.concatenate(accel), np.concatenate(gyro)


def _faults_of_kind(
    states: tuple[ChannelState, ...],
    means: Array,
    channels: Channels,
    rate: float,
    advice: str,
    held: Sequence[float],
) -> Iterator[ChannelFault]:
    """Yield the faults of the channels of one kind of sensor; `means` (K, n) are those of blocks, SI, and `held` the
    ends, s, of runs of rows that the log held."""

    def logged(value: float, sensor: int) -> str:
        """Return a reading (SI) as in the log."""
        number = value / channels.unit.per_second(rate) * channels.scale[sensor] + channels.offset[sensor]
        return f"{number:.6g} {channels.unit_name}"

    for i, (column, state) in enumerate(zip(channels.columns, states, strict=True)):
        extreme = max(state.minimum, state.maximum, key=abs)
        if abs(extreme) > LARGEST_READING:
            sentence: str = Advised(
                f"column {column!r} is damaged: it reads {logged(extreme, i)}, which no sensor does",
                "remove such rows or write nan in them",
            )
            yield ChannelFault(sensor=i, sentence=sentence)
        elif state.minimum == state.maximum:
            dead = f"column {column!r} is dead: all {state.samples} samples are {logged(state.minimum, i)}"
            yield ChannelFault(sensor=i, sentence=dead)
        elif clipped := _clipped(state, means[:, i], channels.range):
            sentence = Advised(f"column {column!r} is clipped: {clipped}, up to {state.extreme_stop:.2f} s", advice)
            yield ChannelFault(sensor=i, sentence=sentence, clipped=True)
        elif any(abs(state.run_stop - stop) < HELD_END / rate for stop in held):
            continue
        elif state.run >= rate and _is_fault(state, state.run, state.run):
            stuck = f"{state.run} samples in a row are {logged(state.run_value, i)}, up to {state.run_stop:.2f} s"
            yield ChannelFault(sensor=i, sentence=f"column {column!r} is stuck: {stuck}")


def _clipped(state: ChannelState, means: Array, full_scale: float | None) -> str:
    """Return how a channel shows that its range is too small; `means` (K,) are those of blocks."""
    if full_scale is not None and max(abs(state.minimum), abs(state.maximum)) >= 0.9999 * full_scale:
        return f"it reaches its range, {state.extreme_run or 1} samples in a row"
    if state.extreme_run < 5:
        return ""
    at_end = np.isclose(means[:, None], [state.minimum, state.maximum], rtol=1e-12, atol=0.0).any(axis=1)
    saturated = max(state.extreme_run, round(float(at_end.mean()) * state.samples))
    is_clipped = _is_fault(state, state.extreme_run, saturated)
    return f"{state.extreme_run} samples in a row at its extreme value" if is_clipped else ""


def _is_fault(state: ChannelState, run: int, explained: int) -> bool:
    """Return True if a run of equal samples is too unlikely, given how often neighbours are equal outside the
    `explained` samples; all those may be at rest, as with a coarse resolution."""
    equal = max(state.repeats - explained, 0) / (LEAST_REST_SHARE * state.samples)
    return float(state.samples * min(max(equal, 1e-6), 1.0) ** (run - 1)) < RUN_PROBABILITY


# ---- accelerometers that do not read gravity


def accelerometer_faults(reduction: Reduction, session: Session) -> Iterator[str]:
    """Yield why the accelerometers do not read gravity at the median: they are exchanged with the gyros, or in another
    unit, or their scale or offset is wrong."""
    channels, gyro, g, rate = session.log.accel, session.log.gyro, session.site.gravity, reduction.rate
    accel, gyros = block_means(reduction)
    force = accel @ onto_body(channels.axes).T
    magnitude = float(np.median(np.linalg.norm(force, axis=1)))
    if is_near_one(magnitude / g):
        return
    rates, increments = (
        {} if channels.raw else {name: u.per_second(rate) for name, u in ACCEL_UNITS.items() if u.kind == kind}
        for kind in ("rate", "increment")
    )
    unit_of_g = channels.unit.per_second(rate) * g
    if gyro is not None:  # what the columns of the gyros would read as accelerometers, as vectors in SI
        n = min(gyros.shape[1], len(channels.columns))
        logged = gyros[:, :n] / gyro.unit.factor * gyro.scale[:n] + gyro.offset[:n]
        by_gyros = (logged - channels.offset[:n]) / channels.scale[:n] * channels.unit.factor
        by_gyros = by_gyros @ onto_body(channels.axes[:n]).T
        gyro_magnitude = float(np.median(np.linalg.norm(by_gyros, axis=1)))
        gyros_like_gravity = like_gravity(by_gyros)
        in_a_unit = magnitude < 0.5 * g and bool(fitting_units(gyro_magnitude / unit_of_g, rates))
        if fitting_units(magnitude / unit_of_g, rates):  # a gyro bias may be near g; gravity has many directions
            in_a_unit = in_a_unit and gyros_like_gravity and not like_gravity(force)
        if (is_near_one(gyro_magnitude / g) and gyros_like_gravity) or in_a_unit:
            yield Advised(
                f"accelerometer and gyro columns are exchanged: the accelerometers read {magnitude:.3g} m/s^2 and "
                "the gyro columns have the magnitude of gravity",
                "exchange [log.accel] columns and [log.gyro] columns",
            )
            return
    read = f"the accelerometers read {magnitude:.4g} m/s^2 at the median, expected {g:.4g} m/s^2"
    units = fitting_units(magnitude / unit_of_g, rates | (increments if like_gravity(force) else {}))
    if channels.raw:
        yield f"{read}: {_scale_or_offset(force, magnitude, channels, g)}"
    elif units:
        fit = " or ".join(f'"{name}"' for name in units)
        yield f'{read}: the unit of [log.accel] is not "{channels.unit_name}"; {fit} would fit'
    elif magnitude < UNIT_TOLERANCE * g:
        yield Advised(f"{read}: gravity has been removed from the log", "record the raw specific force")
    else:
        yield f'{read}: the unit "{channels.unit_name}" of [log.accel] is not right, and no other known unit fits'


def _scale_or_offset(force: Array, magnitude: float, channels: Channels, g: float) -> str:
    """Return what is wrong with raw accelerometers: the offset if readings have the radius g about their middle, else
    the scale."""
    middle = 0.5 * (force.min(axis=0) + force.max(axis=0))
    radius = float(np.median(np.linalg.norm(force - middle, axis=1)))
    if np.linalg.norm(middle) > 2.0 * g and abs(radius / g - 1.0) < 2.0 * UNIT_TOLERANCE:
        raw = channels.offset + channels.scale * (channels.axes @ middle) / channels.unit.factor
        return f"the offset of [log.accel] is wrong; about {', '.join(f'{v:.4g}' for v in raw)} would fit"
    per = {name: ACCEL_UNITS[name].factor for name in ("m/s^2", "g")}
    for name in fitting_units(magnitude / channels.unit.factor / g, per):
        return f'the scale of [log.accel] would fit with scale_per = "{name}"'
    return f"the nominal scale of [log.accel] is about {scale_error(magnitude / g)}, or its offset is wrong"


def scale_error(ratio: float) -> str:
    """Return the error of a nominal scale whose readings are `ratio` times too large."""
    return f"{ratio:.3g} times too small" if ratio > 1.0 else f"{1.0 / max(ratio, 1e-300):.3g} times too large"


def like_gravity(force: Array) -> bool:
    """Return True if vectors (K, 3) have one length and many directions, unlike those without gravity."""
    length = np.linalg.norm(force, axis=1)
    low, median, high = np.quantile(length, [0.25, 0.5, 0.75])
    spread = float(np.median(np.linalg.norm(force - np.median(force, axis=0), axis=1)))
    return bool(high - low < UNIT_TOLERANCE * median and spread > UNIT_TOLERANCE * median)
