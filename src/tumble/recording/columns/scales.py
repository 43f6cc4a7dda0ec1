"""What accelerometers read for one g and gyros for one °/s: the units in which programs write, and the counts of data
sheets, with how often each is met in logs whose columns do not say it: judged, not counted, and good to a factor of
three, which is 2 of a cost in which 6 are 1 : 20. Every guess at a unit or a scale is one of these.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

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


_SHARES: Mapping[str, Mapping[str, tuple[float, float]]] = {
    ACCEL: {
        "m/s^2": (0.45, 0.02), "g": (0.3, 0.01), "mg": (0.04, 0.08), "cm/s^2": (0.03, 0.05), "mm/s^2": (0.01, 0.03),
        "m/s": (0.02, 1e-3),
    },
    GYRO: {
        "rad/s": (0.4, 0.005), "deg/s": (0.4, 0.03), "mdeg/s": (0.03, 0.06), "0.1 deg/s": (0.01, 0.03),
        "deg/h": (0.02, 0.01), "rad": (0.02, 1e-3), "deg": (0.01, 1e-3), "arcsec": (0.01, 5e-3),
    },
}  # fmt: skip
_COMMON: Mapping[str, tuple[float, ...]] = {
    ACCEL: (16384.0, 8192.0, 4096.0, 2048.0, 1024.0, 256.0, 1e3 / 0.732),
    GYRO: (131.0, 65.5, 32.8, 16.4, 16.0, *(1e3 / s for s in (8.75, 17.5, 35.0, 70.0))),
}
"""Of ranges of 16 bits; of other makers' mg and mdps per count; of the BNO055 (16). Powers of two are 0.061, 0.122 … mg
per count too."""
_RARE: Mapping[str, tuple[float, ...]] = {
    ACCEL: (*(2.0**k for k in (5, 6, 7, 9, 15, 16, 17)), 800.0, 1200.0, 1e6),
    GYRO: (262.1, 8.2, 1e3 / 4.375, 14.375, 10.0, 25.0, 40.0, 160.0, 100.0, 1e3, 1e6),
}
_COUNTS = 0.03, 0.75
"""Share of logs in counts of data sheets; a common one is three times as frequent as a rare one."""
ON_NO_SHEET = KnownScale(value=1.0, shares=(0.005, 0.05), known=False)
"""Counts that no data sheet has."""


def _candidates(kind: str, units: Mapping[str, Unit]) -> tuple[KnownScale, ...]:
    named = [
        KnownScale(value=ONE[kind] / units[name].factor, unit=name, shares=s, increment=units[name].kind == "increment")
        for name, s in _SHARES[kind].items()
    ]
    rates = [c.value for c in named if not c.increment]
    weights = dict.fromkeys(_COMMON[kind], 3.0) | dict.fromkeys(_RARE[kind], 1.0)
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
    *(round(1.0 / counts, 12) for counts in (*_COMMON[GYRO], *_RARE[GYRO])),
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
