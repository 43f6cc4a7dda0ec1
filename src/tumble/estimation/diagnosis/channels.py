"""Channels of a log that are dead, stuck, clipped or damaged."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tumble.recording.session import Channels, LogSpec
from tumble.reduction.blocks import ChannelState, Reduction
from tumble.units import G_STANDARD, Array

REST_SHARE = 0.2
"""At least this part of a recording is rest: there a sample of coarse resolution equals the one before."""

IMPOSSIBLE = 1e10
"""SI: no sensor reads as much, in whatever unit its log is taken to be."""

CHANCE = 1e-9
"""Probability below which a row of equal samples is no accident."""

LEAPING = 0.3 * G_STANDARD
"""From one sample to the others of its 0.1 s, most of the time: no vibration that a device rests in is as large."""


def mixed_rows(reduction: Reduction, log: LogSpec) -> list[str]:
    """Accelerometers that leap from sample to sample all the time, as rows of several sensors do where they are read
    as those of one; their unit is right."""
    leaps = np.concatenate([each.accel_end - each.accel for each in reduction.files])
    leap = float(np.median(np.linalg.norm(leaps, axis=1))) * np.sqrt(3 / leaps.shape[1])
    if leap < LEAPING:
        return []
    return [
        f"the accelerometers leap by {leap:.2g} m/s^2 from sample to sample, most of the time: columns "
        f"{', '.join(map(repr, log.accel.columns))} have rows of several sensors, or the device was shaken throughout; "
        "give each sensor its own columns, and let the device rest"
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
    gyros = [each.gyro for each in reduction.files if each.gyro is not None] or [np.empty((0, 0))]
    return np.concatenate([each.accel for each in reduction.files]), np.concatenate(gyros)


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
