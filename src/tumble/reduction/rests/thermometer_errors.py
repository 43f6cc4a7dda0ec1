"""Thermometers whose readings have steps or noise: their temperatures as they went, and how well these are known.

A thermometer of whole degrees says when the temperature crossed a level between two readings, n + ½, to within the
interval of its readings. So all readings are taken where they have steps, and the record of one a second otherwise. A
smooth monotone curve goes through the times and levels (t_i, T_i), and is continued at both ends as long as the next
level is not reached. With r_i the difference of a level from the straight line through its neighbours, the error σ of a
level is by the changes of r_i along the record,

    d_i = r_i − (r_{i−1} + r_{i+1})/2,   σ = median |d_i| / (0.6745 √4.375)                                          (1)

4.375 being the sum of the squared coefficients of d_i in T. Between two levels nothing tells by how much the curve, B
away from the straight line, bends: it may be anything from 0 to 2 B, of standard deviation B/√3. A mean over a part of
the record in which m levels are crossed (m < 1 where the part is shorter than the time between two) has the variance
u² = (σ² + B²/3)/m. This error moves the readings of all sensors together by their slopes s over temperature, which are
by the changes from part to part, so that the covariance of the means of a part is greater by u² s sᵀ.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tumble.reduction.observations import Observations
from tumble.reduction.rests.thermometer import STEP, Thermometers
from tumble.units import Array

CHANGED_BY = 4.375
"""Variance of d_i of Eq. (1) in parts of that of a level."""
MEDIAN = 0.6745
"""Of the size of a standard normal number."""
BENT, ALIKE = 10, 1.5
"""Levels at most through which a parabola is laid, and how many errors of a level these may be off it."""


def with_thermometer_errors(observations: Observations, readings: Mapping[int, tuple[Array, Array]]) -> Observations:
    """Observations with curves of temperature in place of its records, and their errors in the covariances of rests.

    `readings` are by file the times (K,), s, and temperatures (K, T), K, of the thermometers. They stand closer than
    the records of one a second, which are taken where the readings have no steps."""
    thermometers, rests = observations.thermometers, observations.rests
    assert thermometers is not None
    middle, files = 0.5 * (rests.start + rests.stop), dict[int, tuple[float, Array]]()
    variance, kelvin = np.zeros((len(rests), thermometers.count)), np.zeros((len(rests), thermometers.count))
    for file, (start, record) in thermometers.files.items():
        smooth, in_file, seconds = record.copy(), rests.file == file, np.asarray(start + STEP * np.arange(len(record)))
        for t, column in enumerate(record.T):
            close = readings[file][1][:, t]
            crossings = (
                level_crossings(readings[file][0], close) if has_steps(close) else level_crossings(seconds, column)
            )
            time, level = crossings
            smooth[:, t] = curve_through(time, level, seconds, column)
            crossed = np.searchsorted(time, rests.stop[in_file]) - np.searchsorted(time, rests.start[in_file])
            ends, after = np.concatenate([seconds[:1], time, seconds[-1:]]), np.searchsorted(time, middle[in_file])
            levels = np.maximum(crossed, (rests.stop - rests.start)[in_file] / (ends[after + 1] - ends[after]))
            straight = np.interp(seconds, time, level) if len(time) else column
            bend = np.interp(middle[in_file], seconds, smooth[:, t] - straight)
            variance[in_file, t] = (level_error(time, level) ** 2 + bend**2 / 3.0) / levels
            kelvin[in_file, t] = np.interp(middle[in_file], seconds, smooth[:, t])
        files[file] = start, smooth
    same = np.diff(rests.file) == 0
    both = (observations.accel_block, rests.accel, "accel"), (observations.gyro_block, rests.gyro, "gyro")
    covariances = {}
    for block, means, kind in both:
        if block is None:
            continue
        warmed, moved = np.diff(kelvin, axis=0)[same][:, block.thermometer], np.diff(means, axis=0)[same]
        slope = (warmed * moved).sum(axis=0) / np.maximum((warmed**2).sum(axis=0), 1e-300)
        error = slope * np.sqrt(variance[:, block.thermometer])
        alike = block.thermometer[:, None] == block.thermometer
        covariances[f"{kind}_covariance"] = (
            getattr(rests, f"{kind}_covariance") + alike * error[:, :, None] * error[:, None]
        )
    return replace(observations, rests=replace(rests, **covariances), thermometers=Thermometers(files=files))


def has_steps(readings: Array) -> bool:
    """Whether most of the readings (K,) repeat the one before."""
    return 2 * int((np.diff(readings) == 0.0).sum()) > len(readings)


def level_crossings(time: Array, readings: Array) -> tuple[Array, Array]:
    """Times and levels (k,) at which readings (K,) at times (K,) go from one value to the next.

    A reading that goes to and fro crosses a level once, at the mean of these times; one that comes back for good
    crosses it twice. Where readings have steps, values between two of them were interpolated and are no level."""
    if has_steps(readings):
        shown = np.isin(readings, readings[1:][np.diff(readings) == 0.0])
        time, readings = time[shown], readings[shown]
    at = np.flatnonzero(np.diff(readings))
    if not len(at):
        return np.zeros(0), np.zeros(0)
    level, middle = (0.5 * (each[at] + each[at + 1]) for each in (readings, time))
    starts = np.append(0, np.flatnonzero(np.diff(level)) + 1)
    count = np.diff(np.append(starts, len(at)))
    back = [
        i + 1 + int(np.argmax(np.diff(middle[i : i + n]))) for i, n in zip(starts, count, strict=True) if n % 2 == 0
    ]
    starts = np.sort(np.append(starts, back).astype(np.int64))
    return np.add.reduceat(middle, starts) / np.diff(np.append(starts, len(at))), level[starts]


def curve_through(time: Array, level: Array, every: Array, record: Array) -> Array:
    """Temperatures (K,) at the times `every` (K,) of a record that crossed levels (k,) at times (k,); the record itself
    where it crossed fewer than two."""
    from scipy.interpolate import PchipInterpolator  # slow to import

    if len(time) < 2:
        return record
    late, early, step = every > time[-1], every < time[0], float(np.abs(np.diff(level)).max())
    out = np.asarray(PchipInterpolator(time, level)(np.clip(every, time[0], time[-1])))
    out[late] += _after_last(time[-3:], level[-3:], every[late])
    out[early] += _before_first(time, level, every[early])
    for beyond, shown in ((late, record[-1]), (early, record[0])):
        out[beyond] = np.clip(out[beyond], shown - 0.5 * step, shown + 0.5 * step)
    return out


def _before_first(time: Array, level: Array, earlier: Array) -> Array:
    """Differences of the temperature at `earlier` times from the first of the levels (k,), which were crossed at times
    (k,). They are by a parabola through as many levels, BENT at most, as it fits to within their error, three at least;
    by a straight line where there are two."""
    limit = ALIKE * level_error(time, level)
    for many in range(min(len(time), BENT), 2, -1):
        fit = np.polyfit(time[:many] - time[0], level[:many] - level[0], 2)
        off = np.polyval(fit, time[:many] - time[0]) - level[:many] + level[0]
        if many == 3 or off @ off <= limit**2 * (many - 3):
            return np.asarray(np.polyval(fit, earlier - time[0]))
    return np.asarray((level[1] - level[0]) / (time[1] - time[0]) * (earlier - time[0]))


def _after_last(t: Array, level: Array, later: Array) -> Array:
    """Differences of the temperature at `later` times from the last of two or three levels, crossed at times t: by an
    exponential through three where it slows down, by a straight line otherwise."""
    slope, x = np.diff(level) / np.diff(t), later - t[-1]
    if len(slope) == 1 or slope[0] == 0.0 or not 0.0 < slope[1] / slope[0] < 1.0:
        return np.asarray(slope[-1] * x)
    constant = 0.5 * (t[2] - t[0]) / np.log(slope[0] / slope[1])
    last = slope[1] * np.exp(-0.5 * (t[2] - t[1]) / constant)
    return np.asarray(-last * constant * np.expm1(-x / constant))


def level_error(time: Array, level: Array) -> float:
    """Standard deviation of levels (k,) that were crossed at times (k,), Eq. (1); zero for fewer than five."""
    if len(time) < 5:
        return 0.0
    share = (time[1:-1] - time[:-2]) / (time[2:] - time[:-2])
    r = level[1:-1] - (1.0 - share) * level[:-2] - share * level[2:]
    d = r[1:-1] - 0.5 * (r[:-2] + r[2:])
    return float(np.median(np.abs(d)) / (MEDIAN * np.sqrt(CHANGED_BY)))
