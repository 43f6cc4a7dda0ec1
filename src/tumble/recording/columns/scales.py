"""Nominal scales of accelerometers and gyros: units that programs write and counts of data sheets, with their
frequencies in logs whose columns have no unit (guesses.toml). Guesses at a unit or a scale choose from this table.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tumble.recording.columns.names import ACCEL, GYRO
from tumble.units import ACCEL_UNITS, DEGREE, G_STANDARD, GYRO_UNITS, Array, Unit

SCALE_TOLERANCE = 0.06
"""Standard deviation of ln(measured scale / nominal scale), by scale errors of small sensors and errors of few
rests."""

FASTEST = 4200.0 * DEGREE
"""rad/s, beyond the widest range of data sheets, 4000 °/s."""

COUNTS_PER = {ACCEL: "g", GYRO: "deg/s"}
COUNTS_PER_SI = {ACCEL: G_STANDARD, GYRO: DEGREE}
"""Unit of the input in a scale of counts, and its size in SI."""

PRIORS: Mapping[str, Any] = tomllib.loads((Path(__file__).parent / "guesses.toml").read_text(encoding="utf-8"))
_LISTED_COUNTS_SHARES = 0.03, 0.75
"""Shares of logs in counts of data sheets; a common scale is three times as frequent as a rare one."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SensorScale:
    """Reading of a sensor for an input of one g or one °/s.

    `value` is the reading, or its sum over one second; `unit` is None for counts; `shares` are the frequencies among
    logs with fractions and among logs of whole numbers; `listed` and `common` describe the entry in the table."""

    value: float
    unit: str | None = None
    shares: tuple[float, float]
    increment: bool = False
    listed: bool = True
    common: bool = True

    def reading(self, rate: float) -> float:
        """Return the reading of one sample at a sample rate in Hz."""
        return self.value / rate if self.increment else self.value

    @property
    def label(self) -> str:
        return self.unit or (f"{self.value:.6g} counts" if self.value != 1.0 else "counts")


UNLISTED_COUNTS = SensorScale(value=1.0, shares=(0.005, 0.05), listed=False)
"""Counts that are on no data sheet."""


def _counts(kind: str, frequency: str) -> list[float]:
    """Return the counts per g or per °/s that are "common" or "rare"."""
    table = PRIORS["counts"][kind]
    return [*table[frequency], *(1e3 / milli for milli in table[f"{frequency}_milli"])]


def _candidates(kind: str, units: Mapping[str, Unit]) -> tuple[SensorScale, ...]:
    named = [
        SensorScale(
            value=COUNTS_PER_SI[kind] / units[name].factor,
            unit=name,
            shares=(fractions, whole),
            increment=units[name].kind == "increment",
        )
        for name, (fractions, whole) in PRIORS["units"][kind].items()
    ]
    rates = [scale.value for scale in named if not scale.increment]
    weights = dict.fromkeys(_counts(kind, "common"), 3.0) | dict.fromkeys(_counts(kind, "rare"), 1.0)
    weights = {value: weight for value, weight in weights.items() if not np.isclose(value, rates).any()}
    part, (fractions, whole) = 1.0 / sum(weights.values()), _LISTED_COUNTS_SHARES
    counts = (
        SensorScale(value=value, shares=(fractions * weight * part, whole * weight * part), common=weight > 1.0)
        for value, weight in weights.items()
    )
    return (*named, *counts)


CANDIDATES: Mapping[str, tuple[SensorScale, ...]] = {
    ACCEL: _candidates(ACCEL, ACCEL_UNITS),
    GYRO: _candidates(GYRO, GYRO_UNITS),
}


_STEPS = (
    *(full / 32768.0 for full in PRIORS["numbers"]["gyro_ranges"]),
    *(round(1.0 / counts, 12) for counts in (*_counts(GYRO, "common"), *_counts(GYRO, "rare"))),
)
"""Resolutions of data sheets, °/s per count."""
_MOST_DECIMALS = 9
_ROUNDING_LIMIT = 0.2  # of a step; in readings rounded more coarsely it cannot be recognised
_MULTIPLES_SHARE = 0.99  # of the readings
_CHANCE_LIMIT = 20.0  # −ln of the probability that the readings are multiples by chance, at least
_SINGLE_PRECISION = 1e-6  # of the largest reading
_WRITTEN_DIGITS = 6  # significant digits that programs write by default


def resolution_in_deg_s(readings: Array) -> float | None:
    """Return the resolution of a data sheet, °/s, of which the readings (N, 3) are multiples; None without one."""
    values = [np.unique(column[np.isfinite(column)]) for column in readings.T]
    if min(map(len, values)) < 2:
        return None
    merged = np.concatenate(values)
    decimals = (d for d in range(_MOST_DECIMALS) if np.abs(merged - merged.round(d)).max() < 1e-3 * 10.0**-d)
    last = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(merged), 1e-300))) + 1 - _WRITTEN_DIGITS)
    six_digits = np.abs(merged / last - np.rint(merged / last)).max() < 1e-3
    largest = float(np.abs(merged).max())
    rounding = max(10.0 ** -next(decimals, 9), _SINGLE_PRECISION * largest, six_digits * float(last.max()))
    differences = [column[1:] - column[0] for column in values]
    for step in sorted(_STEPS, reverse=True):
        counts = (difference / step for difference in differences)
        chance = sum(map(len, differences)) * np.log(step / (2.0 * rounding))
        if (
            rounding < _ROUNDING_LIMIT * step
            and chance > _CHANCE_LIMIT
            and all(np.mean(np.abs(count - count.round()) <= rounding / step) >= _MULTIPLES_SHARE for count in counts)
        ):
            return float(step)
    return None
