"""allan_variance_ros (github.com/ori-drs/allan_variance_ros, AllanVarianceComputor.cpp, analysis.py): noise of a record
at rest from its Allan deviation. It gives no calibration and is no `Program`.

Averages over bins side by side, of 0.1 s and its multiples up to 1000 s; σ²(τ) is half the mean square of the
differences of neighbours. White noise N: the line of slope −½ through log σ over log τ below 10 s, at 1 s. Bias
instability: the least σ, not divided by 0.664. Rate random walk K: the line of slope +½ through all points, at 3 s;
since white noise is in those too, it is an upper bound where the record is short. No uncertainties.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evidence.case import Array

STEP, LONGEST, WHITE_BELOW = 0.1, 1000.0, 10.0  # s
FEWEST = 3
"""Bins."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Noise:
    """Of one channel in the unit of its readings: `white` per √Hz, `instability`, `walk` per s √Hz."""

    white: float
    instability: float
    walk: float


def deviation(readings: Array, rate: float) -> tuple[Array, Array]:
    """τ (n,), s, and σ (n,) of readings (N,)."""
    sums = np.concatenate([[0.0], np.cumsum(readings - readings.mean())])
    periods, sigmas = [], []
    for number in range(1, int(LONGEST / STEP)):
        size = int(number * STEP * rate)
        bins = (len(readings) - 1) // size if size else 0
        if not size or bins < FEWEST:
            continue
        means = np.diff(sums[: bins * size + 1 : size]) / size
        periods.append(number * STEP)
        sigmas.append(np.sqrt(0.5 * np.mean(np.diff(means) ** 2)))
    return np.array(periods), np.array(sigmas)


def line_at(periods: Array, sigmas: Array, slope: float, at: float) -> float:
    """The line of a given slope through log σ over log τ, at one τ."""
    return float(np.exp(np.mean(np.log(sigmas) - slope * np.log(periods)) + slope * np.log(at)))


def noise(readings: Array, rate: float) -> Noise:
    """The three coefficients of readings (N,) at rest."""
    periods, sigmas = deviation(readings, rate)
    short = periods < WHITE_BELOW
    return Noise(
        white=line_at(periods[short], sigmas[short], -0.5, 1.0),
        instability=float(sigmas.min()),
        walk=line_at(periods, sigmas, 0.5, 3.0),
    )
