"""The unit of gyros that name none, by the readings themselves: no gyro reads 4200 °/s, and the step between them is
that of a data sheet in the unit in which its counts were written down."""

from __future__ import annotations

import numpy as np

from tumble.recording.formats.scales import GYRO_COUNTS, GYRO_RANGES
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
    fits = (step for step in sorted(_STEPS, reverse=True) if rounding < _ROUNDED * step)
    return next((step for step in fits if all(_share(a / step, rounding / step) >= _SHARE for a in apart)), None)


def _last_digit(numbers: Array) -> float:
    """What the last of six digits of the largest number counts, if all have no more; 0 else."""
    last = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(numbers), 1e-300))) + 1 - _DIGITS)
    digits = numbers / last
    return float(last.max()) if np.abs(digits - np.rint(digits)).max() < 1e-3 else 0.0


def _share(counts: Array, rounding: float) -> float:
    """The share of numbers that are whole within a rounding."""
    return float(np.mean(np.abs(counts - counts.round()) <= rounding))
