"""What accelerometers read for one g and gyros for one °/s: the units in which programs write, and the counts of data
sheets, with how often each is met in logs whose columns do not say it (scales.toml). Every guess at a unit or a scale
is one of these.
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

NEAR = 0.06
"""Logarithm of what is found over what a candidate reads: scale errors of small sensors, and what a few rests leave."""

GYRO_RANGES = (125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0)
"""°/s that 16 bits reach."""

FASTEST = 4200.0 * DEGREE
"""rad/s: beyond the widest range of data sheets, 4000 °/s."""

PER = {ACCEL: "g", GYRO: "deg/s"}
ONE = {ACCEL: G_STANDARD, GYRO: DEGREE}
"""What counts are per, and that in SI."""


@dataclass(frozen=True, kw_only=True, slots=True)
class KnownScale:
    """What sensors read for one g or one °/s, of increments for that times a second: in a unit, or in counts where that
    is None; its share of logs with fractions and of those with whole numbers alone, whether it is in the table, and
    whether it is one of the common ones there."""

    value: float
    unit: str | None = None
    shares: tuple[float, float]
    increment: bool = False
    known: bool = True
    common: bool = True

    def reads(self, rate: float) -> float:
        """The same of a mean over a sample, at a rate, Hz."""
        return self.value / rate if self.increment else self.value

    @property
    def label(self) -> str:
        return self.unit or (f"{self.value:.6g} counts" if self.value != 1.0 else "counts")


MET: Mapping[str, Any] = tomllib.loads((Path(__file__).parent / "scales.toml").read_text(encoding="utf-8"))


def _counts(kind: str, met: str) -> list[float]:
    """Counts per g or per °/s that are met so often, "common" or "rare"."""
    table = MET["counts"][kind]
    return [*table[met], *(1e3 / milli for milli in table[f"{met}_milli"])]


_COUNTS = 0.03, 0.75
"""Share of logs in counts of data sheets; a common one is three times as frequent as a rare one."""
ON_NO_SHEET = KnownScale(value=1.0, shares=(0.005, 0.05), known=False)
"""Counts that no data sheet has."""


def _candidates(kind: str, units: Mapping[str, Unit]) -> tuple[KnownScale, ...]:
    named = [
        KnownScale(
            value=ONE[kind] / units[name].factor,
            unit=name,
            shares=(fractions, whole),
            increment=units[name].kind == "increment",
        )
        for name, (fractions, whole) in MET["units"][kind].items()
    ]
    rates = [c.value for c in named if not c.increment]
    weights = dict.fromkeys(_counts(kind, "common"), 3.0) | dict.fromkeys(_counts(kind, "rare"), 1.0)
    weights = {value: weight for value, weight in weights.items() if not np.isclose(value, rates).any()}
    part = 1.0 / sum(weights.values())
    counts = (
        KnownScale(value=v, shares=(_COUNTS[0] * w * part, _COUNTS[1] * w * part), common=w > 1.0)
        for v, w in weights.items()
    )
    return (*named, *counts)


CANDIDATES: Mapping[str, tuple[KnownScale, ...]] = {
    ACCEL: _candidates(ACCEL, ACCEL_UNITS),
    GYRO: _candidates(GYRO, GYRO_UNITS),
}
"""The one table of units and scales that are tried."""


def off_table(kind: str, found: float) -> float:
    """How far, as a logarithm, the nearest scale of the table is from what was found for one g or one °/s."""
    return float(min(abs(np.log(found / c.value)) for c in CANDIDATES[kind] if not c.increment))


_STEPS = (
    *(full / 32768.0 for full in GYRO_RANGES),
    *(round(1.0 / counts, 12) for counts in (*_counts(GYRO, "common"), *_counts(GYRO, "rare"))),
)
"""°/s per count."""
_DECIMALS = range(9)
_ROUNDED, _SHARE = 0.2, 0.99
_BY_CHANCE = 20.0  # −ln of how often numbers would be multiples of a step by chance, at least
_SINGLE = 1e-6  # of the largest: what numbers of 32 bits are rounded to
_DIGITS = 6  # that programs write of a number, unless they are told otherwise


def step_in_deg_s(read: Array) -> float | None:
    """The step, °/s, of a data sheet of which the readings (N, 3) are multiples, as counts written in °/s are;
    None where they are of none, or rounded to more than a fifth of it."""
    values = [np.unique(column[np.isfinite(column)]) for column in read.T]
    if min(map(len, values)) < 2:
        return None
    whole = np.concatenate(values)
    decimals = (d for d in _DECIMALS if np.abs(whole - whole.round(d)).max() < 1e-3 * 10.0**-d)
    last = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(whole), 1e-300))) + 1 - _DIGITS)
    six_digits = np.abs(whole / last - np.rint(whole / last)).max() < 1e-3
    rounding = max(10.0 ** -next(decimals, 9), _SINGLE * float(np.abs(whole).max()), six_digits * float(last.max()))
    apart = [column[1:] - column[0] for column in values]
    for step in sorted(_STEPS, reverse=True):
        counts = (a / step for a in apart)
        unlikely = sum(map(len, apart)) * np.log(step / (2.0 * rounding))
        if (
            rounding < _ROUNDED * step
            and unlikely > _BY_CHANCE
            and all(np.mean(np.abs(count - count.round()) <= rounding / step) >= _SHARE for count in counts)
        ):
            return step
    return None
