"""Channels of a log that are dead, stuck, clipped or damaged, and accelerometers that do not read gravity at rest:
which unit, scale, offset or columns would make them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from tumble.recording.session import Channels, LogSpec, Session
from tumble.reduction.blocks.reducer import ChannelState, Reduction
from tumble.reduction.rests.segmentation import Stretch
from tumble.rotation import onto_body, unit_vector
from tumble.units import ACCEL_UNITS, DEGREE, G_STANDARD, UNIT_TOLERANCE, Array, fitting_units, is_near_one

REST_SHARE = 0.2  # at least this part of a recording is rest: there a sample of coarse resolution equals the one before

IMPOSSIBLE = 1e10  # SI: no sensor reads as much, in whatever unit its log is taken to be

CHANCE = 1e-9  # probability below which a row of equal samples is no accident

LEAPING = 0.3 * G_STANDARD
"""From one sample to the others of its 0.1 s, most of the time: no vibration that a device rests in is as large."""


def mixed_rows(reduction: Reduction, log: LogSpec) -> list[str]:
    """Accelerometers that leap from sample to sample all the time, as rows of several sensors do where they are read
    as those of one; their unit is right."""
    leaps = np.concatenate([each.accel.ends - each.accel.means for each in reduction.files])
    leap = float(np.median(np.linalg.norm(leaps, axis=1))) * np.sqrt(3 / leaps.shape[1])
    if leap < LEAPING:
        return []
    return [
        f"the accelerometers leap by {leap:.2g} m/s^2 from sample to sample, most of the time: columns "
        f"{', '.join(map(repr, log.accel.columns))} have rows of several sensors, or the device was shaken throughout; "
        "give each sensor its own columns, and let the device rest"
    ]


RADIAL, CONSTANT, LENGTHENS = 0.25, 1e-3, 1e-5
"""Accelerometers whose magnitude is constant to RADIAL of their noise across gravity and to CONSTANT of itself, in all
attitudes and on the way, have it from a driver: sensors have the same noise along gravity as across, and their errors
beside. A vibration v across gravity of raw ones lengthens them by v²/2g, which is told from LENGTHENS of g on."""
LEAST_FORCE = 1e-9  # m/s²: of a shorter vector no direction is known


def normalised(reduction: Reduction, rests: Sequence[Stretch], to_body: Array) -> list[str]:
    """Accelerometers that a driver has divided by their magnitude: it is constant to rounding in motion too, and tells
    nothing of their biases and scale factors. `to_body` (3, n) makes vectors of readings."""
    if not rests:
        return []
    length = np.linalg.norm(np.concatenate([each.accel.ends for each in reduction.files]) @ to_body.T, axis=1)
    magnitude, files = float(np.median(length)), reduction.by_file
    spread = float(np.sqrt(np.mean((length - magnitude) ** 2)))
    squares, lengthened = list[float](), list[float]()
    for rest in rests:
        samples = files[rest.file].accel.ends[rest.first : rest.last] @ to_body.T
        up = samples.mean(axis=0) / max(float(np.linalg.norm(samples.mean(axis=0))), LEAST_FORCE)
        off = samples - samples.mean(axis=0)
        square = ((off - np.outer(off @ up, up)) ** 2).sum(axis=1)
        squares.append(0.5 * float(square.mean()))
        lengthened.append(0.5 * float(square.std()) / max(magnitude, LEAST_FORCE))
    noise, longer = float(np.sqrt(np.median(squares))), float(np.median(lengthened))
    limit = CONSTANT * magnitude
    if longer > LENGTHENS * magnitude:
        steps = [channel.step for channel in reduction.accel_channels if np.isfinite(channel.step)]
        limit = min(limit, max([longer, *steps]))
    if spread >= min(RADIAL * noise, limit):
        return []
    return [
        f"the magnitude of the accelerometers is {magnitude:.6g} m/s^2 at rest and on the way, constant to "
        f"{spread:.1g} m/s^2, where their noise across it is {noise:.1g} m/s^2: a driver has normalised them, and "
        "their biases and scale factors are lost; record the raw specific force"
    ]


FEWEST_ZEROS, MORE_ZEROS = 5, 3.0
"""Zeros at rest, beyond this number and so many times the values at the most frequent other place, are no chance."""
PLACES, TIGHT, PULSES = 200.0, 20.0, 0.35
"""Pulses whose intervals jitter stay in one of PLACES between zero and the median of what is read otherwise. They are
such where so large a part of all is in one of TIGHT of these; of a smooth noise hardly two values are equal."""
FINE = 3.0
"""Steps of a channel: where what is read otherwise is mostly nearer to zero, coarse resolution makes the zeros."""


def dead_zones(reduction: Reduction, rests: Sequence[Stretch], channels: Channels) -> list[str]:
    """Gyros whose driver writes 0 for small rates: at rest they read exactly 0 more often than their resolution makes
    them, while all other values are at least some way from it."""
    files = reduction.by_file
    ends = [files[rest.file].gyro.ends[rest.first : rest.last] for rest in rests]
    at_rest = np.concatenate(ends) if ends else np.empty((0, len(channels.columns)))
    every = np.concatenate([each.gyro.ends for each in reduction.files])
    found = []
    for i, (column, state) in enumerate(zip(channels.columns, reduction.gyro_channels, strict=True)):
        sizes, step = np.abs(at_rest[:, i]), state.step if np.isfinite(state.step) else 0.0
        zeros, others = int((sizes == 0.0).sum()), sizes[sizes > 0.0]
        anywhere = np.abs(every[:, i])
        if zeros <= FEWEST_ZEROS or not anywhere.any():
            continue
        least = float(anywhere[anywhere > 0.0].min())
        usual, busiest = least, 0
        if len(others):
            usual = float(np.median(others))
            pulses = _most_alike(np.round(TIGHT * others / usual)) > PULSES * len(others)
            busiest = _most_alike(np.floor(PLACES * others / usual) if pulses else others)
        if usual >= FINE * step and zeros > FEWEST_ZEROS + MORE_ZEROS * busiest:
            found.append(
                f"column {column!r} reads exactly 0 in {100.0 * zeros / len(sizes):.3g} % of the samples at rest, and "
                f"never less than {least / DEGREE:.2g} °/s otherwise: a dead zone of the driver, in which biases and "
                "slow rates are lost; switch it off"
            )
    return found


def _most_alike(values: Array) -> int:
    """How often the most frequent of values is there."""
    return int(np.unique(values, return_counts=True)[1].max())


FADES, RETURNS, TILTED = 0.5, 0.3, 0.5
"""Part of the squares of what gyros read at rest that goes with the turns before; part of the angle that gyros read in
a turn that is left in the end, where its vertical was turned by more than TILTED, rad."""
FEWEST_TURNED = 5  # turns, in which chance shows neither


def high_passed(reduction: Reduction, rests: Sequence[Stretch]) -> list[str]:
    """Gyros behind a high-pass filter of time constant τ. After a turn by θ they read −θ/τ, which fades: what they read
    at the start of a rest beyond what they read at its end goes against the turn before. Of a turn that lasts longer
    than τ hardly anything is left in their integral, whatever the vertical was turned by."""
    files, starts, turns, left = reduction.by_file, list[Array](), list[Array](), list[float]()
    for before, rest in pairwise(rests):
        f = files[rest.file]
        if before.file != rest.file:
            continue
        half, between = max((rest.last - rest.first) // 2, 1), slice(before.last, rest.first)
        later = f.gyro.means[rest.last - half : rest.last].mean(axis=0)
        angles = np.diff(f.edges)[between, None] * (f.gyro.means[between] - later)
        starts.append(f.gyro.means[rest.first : rest.first + half].mean(axis=0) - later)
        turns.append(angles.sum(axis=0))
        ends = (f.accel.means[span.first : span.last].mean(axis=0) for span in (before, rest))
        if np.linalg.norm(np.subtract(*map(unit_vector, ends))) > TILTED and len(angles):
            path = float(np.linalg.norm(angles, axis=1).sum())
            left.append(float(np.linalg.norm(turns[-1])) / max(path, LEAST_FORCE))
    r, θ = np.array(starts), np.array(turns)
    along = float((r * θ).sum())
    if len(r) >= FEWEST_TURNED and along < 0.0 and along**2 > FADES * float((r**2).sum() * (θ**2).sum()):
        seen = "at rest the gyros read a rate against the turn before, which fades"
    elif len(left) >= FEWEST_TURNED and np.median(left) < RETURNS:
        seen = "in the integral of the gyros next to nothing is left of a turn once it is over"
    else:
        return []
    return [
        f"{seen}: a high-pass filter on the chip or in the driver, with which slow rates and biases are lost; "
        "switch it off"
    ]


def channel_faults(reduction: Reduction, log: LogSpec) -> list[str]:
    """Channels that are dead, stuck, clipped or damaged, in sentences."""
    accel, gyros = block_means(reduction)
    faults = list(_of_kind(reduction.accel_channels, accel, log.accel, reduction.rate, "use a larger range"))
    if log.gyro is not None:
        advice = "use a larger range or turn more slowly"
        faults += _of_kind(reduction.gyro_channels, gyros, log.gyro, reduction.rate, advice)
    return faults


def block_means(reduction: Reduction) -> tuple[Array, Array]:
    """Mean readings (K, n), SI, of the blocks of all files: of the accelerometers and, empty without any, of the
    gyros."""
    accel, gyro = ([getattr(each, kind).means for each in reduction.files] for kind in ("accel", "gyro"))
    return np.concatenate(accel), np.concatenate(gyro)


def _of_kind(
    states: tuple[ChannelState, ...], means: Array, channels: Channels, rate: float, advice: str
) -> Iterator[str]:
    """Faults of the channels of one kind of sensors; `means` (K, n) are those of blocks, in SI."""
    for i, (column, state) in enumerate(zip(channels.columns, states, strict=True)):
        if said := _damaged(state, channels, i, rate):
            yield f"column {column!r} is {said}"
        elif said := _clipped(state, means[:, i], channels.range):
            yield f"column {column!r} is clipped: {said}, up to {state.extreme_stop:.2f} s; {advice}"
        elif state.run >= rate and _no_accident(state, state.run, state.run):
            value = _logged(state.run_value, channels, i, rate)
            yield f"column {column!r} is stuck: {state.run} samples in a row are {value}, up to {state.run_stop:.2f} s"


def _damaged(state: ChannelState, channels: Channels, sensor: int, rate: float) -> str:
    """What makes a channel of no use whatever: numbers that no sensor reads, or one number only."""
    extreme = max(state.minimum, state.maximum, key=abs)
    if abs(extreme) > IMPOSSIBLE:
        read = _logged(extreme, channels, sensor, rate)
        return f"damaged: it reads {read}, which no sensor does; remove such rows or write nan in them"
    if state.minimum == state.maximum:
        return f"dead: all {state.samples} samples are {_logged(state.minimum, channels, sensor, rate)}"
    return ""


def _clipped(state: ChannelState, means: Array, full_scale: float | None) -> str:
    """How a channel shows that its range is too small; `means` (K,) are those of blocks."""
    at_end = np.isclose(means[:, None], [state.minimum, state.maximum], rtol=1e-12, atol=0.0).any(axis=1)
    saturated = max(state.extreme_run, round(float(at_end.mean()) * state.samples))
    if full_scale is not None and max(abs(state.minimum), abs(state.maximum)) >= 0.9999 * full_scale:
        return f"it reaches its range, {state.extreme_run or 1} samples in a row"
    if state.extreme_run >= 5 and _no_accident(state, state.extreme_run, saturated):
        return f"{state.extreme_run} samples in a row at its extreme value"
    return ""


def _logged(value: float, channels: Channels, sensor: int, rate: float) -> str:
    """A reading (SI) as the log has it."""
    number = value / channels.unit.per_second(rate) * channels.scale[sensor] + channels.offset[sensor]
    return f"{number:.6g} {channels.unit_name}"


def _no_accident(state: ChannelState, run: int, explained: int) -> bool:
    """Whether a row of `run` equal samples is beyond chance, given how often neighbours are equal elsewhere than in
    the `explained` samples; those may all be at rest, as they are where the resolution is coarse."""
    elsewhere = max(state.repeats - explained, 0) / (REST_SHARE * state.samples)
    return float(state.samples * min(max(elsewhere, 1e-6), 1.0) ** (run - 1)) < CHANCE


# ---- accelerometers that do not read gravity


def accelerometer_faults(reduction: Reduction, session: Session) -> list[str]:
    """Accelerometers that do not read gravity at the median: exchanged with gyros, or in a unit or with a scale or
    offset that cannot be right."""
    channels, gyro, g, rate = session.log.accel, session.log.gyro, session.site.gravity, reduction.rate
    accel, gyros = block_means(reduction)
    force = accel @ onto_body(channels.axes).T
    magnitude = float(np.median(np.linalg.norm(force, axis=1)))
    if is_near_one(magnitude / g):
        return []
    rates, increments = (
        {} if channels.raw else {name: u.per_second(rate) for name, u in ACCEL_UNITS.items() if u.kind == kind}
        for kind in ("rate", "increment")
    )
    of_g = channels.unit.per_second(rate) * g
    if gyro is not None:  # what the columns of the gyros would read as accelerometers, as vectors in SI
        n = min(gyros.shape[1], len(channels.columns))
        logged = gyros[:, :n] / gyro.unit.factor * gyro.scale[:n] + gyro.offset[:n]
        meant = (logged - channels.offset[:n]) / channels.scale[:n] * channels.unit.factor
        meant = meant @ onto_body(channels.axes[:n]).T
        of_gyros = float(np.median(np.linalg.norm(meant, axis=1)))
        like = _like_gravity(meant)
        in_a_unit = magnitude < 0.5 * g and bool(fitting_units(of_gyros / of_g, rates))
        if fitting_units(magnitude / of_g, rates):  # as a bias of gyros may: what has many directions is gravity
            in_a_unit = in_a_unit and like and not _like_gravity(force)
        if (is_near_one(of_gyros / g) and like) or in_a_unit:
            return [
                f"accelerometer and gyro columns are exchanged: the accelerometers read {magnitude:.3g} m/s^2 and the "
                f"gyro columns have the magnitude of gravity; exchange [log.accel] columns and [log.gyro] columns"
            ]
    read = f"the accelerometers read {magnitude:.4g} m/s^2 at the median, expected {g:.4g} m/s^2"
    if channels.raw:
        return [f"{read}: {_scale_or_offset(force, magnitude, channels, g)}"]
    units = fitting_units(magnitude / of_g, rates | (increments if _like_gravity(force) else {}))
    if units:
        fit = " or ".join(f'"{name}"' for name in units)
        return [f'{read}: the unit of [log.accel] is not "{channels.unit_name}"; {fit} would fit']
    if magnitude < UNIT_TOLERANCE * g:
        return [f"{read}: gravity has been removed from the log; record the raw specific force"]
    return [f'{read}: the unit "{channels.unit_name}" of [log.accel] is not right, and no other known unit fits']


def _scale_or_offset(force: Array, magnitude: float, channels: Channels, g: float) -> str:
    """What is wrong with raw accelerometers: the offset where gravity shows about the middle of the readings, else
    the scale."""
    middle = 0.5 * (force.min(axis=0) + force.max(axis=0))
    about = float(np.median(np.linalg.norm(force - middle, axis=1)))
    if np.linalg.norm(middle) > 2.0 * g and abs(about / g - 1.0) < 2.0 * UNIT_TOLERANCE:
        raw = channels.offset + channels.scale * (channels.axes @ middle) / channels.unit.factor
        return f"the offset of [log.accel] is wrong; about {', '.join(f'{v:.4g}' for v in raw)} would fit"
    per = {name: ACCEL_UNITS[name].factor for name in ("m/s^2", "g")}
    for name in fitting_units(magnitude / channels.unit.factor / g, per):
        return f'the scale of [log.accel] would fit with scale_per = "{name}"'
    return f"the nominal scale of [log.accel] is about {times_wrong(magnitude / g)}, or its offset is wrong"


def times_wrong(ratio: float) -> str:
    """How wrong a nominal scale is whose readings are `ratio` times what they should be."""
    return f"{ratio:.3g} times too small" if ratio > 1.0 else f"{1.0 / ratio:.3g} times too large"


def _like_gravity(force: Array) -> bool:
    """Whether vectors (K, 3) have one length and many directions: not what is left where gravity was removed."""
    length = np.linalg.norm(force, axis=1)
    low, median, high = np.quantile(length, [0.25, 0.5, 0.75])
    about = float(np.median(np.linalg.norm(force - np.median(force, axis=0), axis=1)))
    return bool(high - low < UNIT_TOLERANCE * median and about > UNIT_TOLERANCE * median)
