"""Thermometers whose readings have steps or noise: smooth temperatures and their errors.

A thermometer with whole degrees shows when the temperature crossed a level n + ½ between two readings, to within the
interval of its readings. All readings are therefore used if they have steps, and the record of one per second
otherwise. A smooth monotone curve goes through the times and levels (t_i, T_i), and is continued at both ends as long
as the next level is not reached. With r_i the difference of a level from the straight line through its neighbours, the
error σ of a level follows from the changes of r_i along the record,

    d_i = r_i − (r_{i−1} + r_{i+1})/2,   σ = median |d_i| / (0.6745 √4.375)                                          (1)

4.375 being the sum of the squared coefficients of d_i in T. Between two levels the bend of the curve, B away from the
straight line, is unknown: it may be anything from 0 to 2 B, with standard deviation B/√3. A mean over a part of the
record in which m levels are crossed (m < 1 if the part is shorter than the time between two) has the variance
u² = (σ² + B²/3)/m. This error affects the readings of all sensors by their temperature slopes s, which follow from the
changes from part to part, so that the covariance of the means of a part increases by u² s sᵀ.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tumble.reduction.observations import Observations
from tumble.reduction.rests.segmentation import NORMAL_MEDIAN
from tumble.reduction.rests.thermometer import STEP, Thermometers
from tumble.units import Array

SQUARED_WEIGHTS = 4.375  # variance of d_i of Eq. (1) over that of a level
LEAST_STEP = 0.9  # of a step, by rounding
MAX_PARABOLA, PARABOLA_ERRORS = 10, 1.5
"""Most levels that a parabola is fitted to, and its largest rms deviation from them, in errors of a level."""


def with_thermometer_errors(observations: Observations, readings: Mapping[int, tuple[Array, Array]]) -> Observations:
    """Return observations with smooth temperatures, and their errors in the covariances of the rests.

    `readings` are, by file, times (K,), s, and temperatures (K, T), K, of the thermometers, closer than the records of
    one per second, which are used if the readings have no steps."""
    thermometers, rests = observations.thermometers, observations.rests
    assert thermometers is not None
    files = dict[int, tuple[float, Array]]()
    variance, kelvin = np.zeros((2, len(rests), thermometers.count))
    for file, (start, record) in thermometers.files.items():
        smooth, seconds = record.copy(), np.asarray(start + STEP * np.arange(len(record)))
        in_file = rests.file == file
        rest_start, rest_stop = rests.start[in_file], rests.stop[in_file]
        middle = 0.5 * (rest_start + rest_stop)
        close_time, close = readings[file]
        for t, column in enumerate(record.T):
            by_steps = has_steps(close[:, t])
            time, level = level_crossings(close_time, close[:, t]) if by_steps else level_crossings(seconds, column)
            smooth[:, t] = curve_through(time, level, seconds, column)
            # m: levels crossed in a rest, or its part of the time between the two crossings about its middle
            crossed = np.searchsorted(time, rest_stop) - np.searchsorted(time, rest_start)
            ends, after = np.concatenate([seconds[:1], time, seconds[-1:]]), np.searchsorted(time, middle)
            m = np.maximum(crossed, (rest_stop - rest_start) / (ends[after + 1] - ends[after]))
            straight = np.interp(seconds, time, level) if len(time) else column
            B = np.interp(middle, seconds, smooth[:, t] - straight)
            variance[in_file, t] = (level_error(time, level) ** 2 + B**2 / 3.0) / m
            kelvin[in_file, t] = np.interp(middle, seconds, smooth[:, t])
        files[file] = start, smooth
    same_file = np.diff(rests.file) == 0
    covariances = {}
    for block, means in ((observations.accel_block, rests.accel), (observations.gyro_block, rests.gyro)):
        if block is None:
            continue
        warming = np.diff(kelvin, axis=0)[same_file][:, block.thermometer]
        change = np.diff(means, axis=0)[same_file]
        slope = (warming * change).sum(axis=0) / np.maximum((warming**2).sum(axis=0), 1e-300)
        error = slope * np.sqrt(variance[:, block.thermometer])
        shared = block.thermometer[:, None] == block.thermometer
        name = f"{block.kind}_covariance"
        covariances[name] = getattr(rests, name) + shared * error[:, :, None] * error[:, None]
    return replace(observations, rests=replace(rests, **covariances), thermometers=Thermometers(files=files))


def has_steps(readings: Array) -> bool:
    """Return True if most of the readings (K,) repeat the one before."""
    return 2 * int((np.diff(readings) == 0.0).sum()) > len(readings)


def level_crossings(time: Array, readings: Array) -> tuple[Array, Array]:
    """Return times and levels (k,) at which readings (K,) at times (K,) go from one value to the next.

    A reading that alternates crosses a level once, at the mean of the times; one that returns for good crosses it
    twice. If readings have steps, values that are less than a step from the readings beside them were interpolated and
    are no level."""
    if has_steps(readings):
        changes = np.abs(np.diff(readings))
        repeated = np.unique(readings[1:][changes == 0.0])
        is_step = changes > LEAST_STEP * np.diff(repeated).min(initial=np.inf)
        is_level = np.isin(readings, repeated) | (np.append(True, is_step) & np.append(is_step, True))
        time, readings = time[is_level], readings[is_level]
    at = np.flatnonzero(np.diff(readings))
    if not len(at):
        return np.zeros(0), np.zeros(0)
    level, middle = (0.5 * (x[at] + x[at + 1]) for x in (readings, time))
    starts = np.append(0, np.flatnonzero(np.diff(level)) + 1)
    count = np.diff(np.append(starts, len(at)))
    returns = [
        i + 1 + int(np.argmax(np.diff(middle[i : i + n]))) for i, n in zip(starts, count, strict=True) if n % 2 == 0
    ]
    starts = np.sort(np.append(starts, returns).astype(np.int64))
    return np.add.reduceat(middle, starts) / np.diff(np.append(starts, len(at))), level[starts]


def curve_through(time: Array, level: Array, seconds: Array, record: Array) -> Array:
    """Return the temperatures (K,) at times `seconds` (K,) of a record that crossed levels (k,) at times (k,); the
    record itself if it crossed fewer than two."""
    from scipy.interpolate import PchipInterpolator  # slow to import

    if len(time) < 2:
        return record
    late, early, step = seconds > time[-1], seconds < time[0], float(np.abs(np.diff(level)).max())
    out = np.asarray(PchipInterpolator(time, level)(np.clip(seconds, time[0], time[-1])))
    out[late] += _after_last(time[-3:], level[-3:], seconds[late])
    out[early] += _before_first(time, level, seconds[early])
    for beyond, reading in ((late, record[-1]), (early, record[0])):
        out[beyond] = np.clip(out[beyond], reading - 0.5 * step, reading + 0.5 * step)
    return out


def _before_first(time: Array, level: Array, earlier: Array) -> Array:
    """Return differences of the temperature at `earlier` times from the first of the levels (k,), crossed at times
    (k,).

    They follow a parabola through as many levels, from 3 to MAX_PARABOLA, as it fits to within their error, or a
    straight line for two levels."""
    limit = PARABOLA_ERRORS * level_error(time, level)
    for n in range(min(len(time), MAX_PARABOLA), 2, -1):
        fit = np.polyfit(time[:n] - time[0], level[:n] - level[0], 2)
        off = np.polyval(fit, time[:n] - time[0]) - level[:n] + level[0]
        if n == 3 or off @ off <= limit**2 * (n - 3):
            return np.asarray(np.polyval(fit, earlier - time[0]))
    return np.asarray((level[1] - level[0]) / (time[1] - time[0]) * (earlier - time[0]))


def _after_last(t: Array, level: Array, later: Array) -> Array:
    """Return differences of the temperature at `later` times from the last of two or three levels, crossed at times t.

    They follow an exponential through three levels if the change slows down, else a straight line."""
    slope, x = np.diff(level) / np.diff(t), later - t[-1]
    if len(slope) == 1 or slope[0] == 0.0 or not 0.0 < slope[1] / slope[0] < 1.0:
        return np.asarray(slope[-1] * x)
    constant = 0.5 * (t[2] - t[0]) / np.log(slope[0] / slope[1])
    last = slope[1] * np.exp(-0.5 * (t[2] - t[1]) / constant)
    return np.asarray(-last * constant * np.expm1(-x / constant))


def level_error(time: Array, level: Array) -> float:
    """Return the standard deviation of levels (k,) crossed at times (k,), Eq. (1); 0 for fewer than five."""
    if len(time) < 5:
        return 0.0
    share = (time[1:-1] - time[:-2]) / (time[2:] - time[:-2])
    r = level[1:-1] - (1.0 - share) * level[:-2] - share * level[2:]
    d = r[1:-1] - 0.5 * (r[:-2] + r[2:])
    return float(np.median(np.abs(d)) / (NORMAL_MEDIAN * np.sqrt(SQUARED_WEIGHTS)))
