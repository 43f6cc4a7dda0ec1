"""What readings show by themselves: the unit of gyros that name none, and numbers of 16 bits without their sign.

No gyro reads 4200 °/s, and the step between its readings is that of a data sheet in the unit in which its counts were
written down.
"""

from __future__ import annotations

import numpy as np

from tumble.recording.columns.scales import GYRO_COUNTS, GYRO_RANGES
from tumble.units import DEGREE, Array

_FASTEST = 4200.0 * DEGREE
"""rad/s: beyond the widest range of data sheets, 4000 °/s."""
_STEPS = (*(full / 32768.0 for full in GYRO_RANGES), *(round(1.0 / counts, 12) for counts in GYRO_COUNTS))
"""°/s per count."""
_DECIMALS = range(9)
_ROUNDED, _FEWEST, _SHARE = 0.2, 20, 0.99
_SINGLE = 1e-6  # of the largest: what numbers of 32 bits are rounded to
_DIGITS = 6  # that programs write of a number, unless they are told otherwise


def too_fast_for_rad_s(read: Array) -> bool:
    """Whether readings (N, 3), some single ones aside, are more than gyros read in rad/s."""
    size = np.abs(read[np.isfinite(read).all(axis=1)])
    return bool(len(size)) and float(np.quantile(size.max(axis=1), 0.99)) > _FASTEST


def step_in_deg_s(read: Array) -> float | None:
    """The step, °/s, of a data sheet of which the readings (N, 3) are multiples; None where they are of none, or
    rounded to more than a fifth of it."""
    values = [np.unique(column[np.isfinite(column)]) for column in read.T]
    if min(map(len, values)) < _FEWEST:
        return None
    whole = np.concatenate(values)
    decimals = (d for d in _DECIMALS if np.abs(whole - whole.round(d)).max() < 1e-3 * 10.0**-d)
    rounding = max(10.0 ** -next(decimals, 9), _SINGLE * float(np.abs(whole).max()), _last_digit(whole))
    apart = [column[1:] - column[0] for column in values]
    for step in sorted(_STEPS, reverse=True):
        counts = (a / step for a in apart)
        if rounding < _ROUNDED * step and all(
            np.mean(np.abs(count - count.round()) <= rounding / step) >= _SHARE for count in counts
        ):
            return step
    return None


def _last_digit(numbers: Array) -> float:
    """What the last of six digits of the largest number counts, if all have no more; 0 else."""
    last = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(numbers), 1e-300))) + 1 - _DIGITS)
    digits = numbers / last
    return float(last.max()) if np.abs(digits - np.rint(digits)).max() < 1e-3 else 0.0


def wrapped(columns: Array) -> bool:
    """Whether integers (m, n) are numbers of 16 bits with a sign that were read without it: from 0 to 65535, and hardly
    any in the middle, while they are on both sides."""
    if not np.isfinite(columns).any():
        return False
    low, high = np.nanmin(columns), np.nanmax(columns)
    if low < 0.0 or not 49152.0 < high < 65536.0 or not np.array_equal(columns, np.floor(columns), equal_nan=True):
        return False
    middle = (columns > 24576.0) & (columns < 40960.0)
    return bool(middle.mean() < 0.02 and (columns < 24576.0).any() and (columns > 40960.0).mean() > 1e-3)


def unwrapped(columns: Array) -> Array:
    """What numbers of 16 bits read without their sign were."""
    return np.where(columns >= 32768.0, columns - 65536.0, columns)
