"""What accelerometers read for one g and gyros for one °/s: the units in which programs write, and the counts of data
sheets. Every guess at a unit or a scale is one of these, and the next one is its rival."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tumble.recording.columns.names import ACCEL, GYRO
from tumble.units import ACCEL_UNITS, DEGREE, G_STANDARD, GYRO_UNITS, Array, Unit

NEAR = 0.06
"""Logarithm of what is found over what a candidate reads: scale errors of small sensors, and what a few rests leave."""

ACCEL_COUNTS: tuple[float, ...] = tuple(sorted([*(float(2**k) for k in range(5, 18)), 800.0, 1200.0, 1e3 / 0.732, 1e6]))
"""Counts per g of data sheets: powers of two (which 0.061, 0.122 … mg per count are too), and others."""

GYRO_RANGES = (125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0)
"""°/s that 16 bits reach."""

GYRO_COUNTS: tuple[float, ...] = tuple(
    sorted(
        [
            *(262.1, 131.0, 65.5, 32.8, 16.4, 8.2),
            *(1e3 / s for s in (4.375, 8.75, 17.5, 35.0, 70.0)),
            *(16.0, 14.375, 10.0, 25.0, 40.0, 160.0, 100.0, 1e3, 1e6),
        ]
    )
)
"""Counts per °/s of data sheets: of the ranges of 16 bits, of other makers' mdps per count, of the BNO055 (16)."""


FASTEST = 4200.0 * DEGREE
"""rad/s: beyond the widest range of data sheets, 4000 °/s."""

_STEPS = (*(full / 32768.0 for full in GYRO_RANGES), *(round(1.0 / counts, 12) for counts in GYRO_COUNTS))
"""°/s per count."""
_DECIMALS = range(9)
_ROUNDED, _FEWEST, _SHARE = 0.2, 20, 0.99
_SINGLE = 1e-6  # of the largest: what numbers of 32 bits are rounded to
_DIGITS = 6  # that programs write of a number, unless they are told otherwise


@dataclass(frozen=True, kw_only=True, slots=True)
class KnownScale:
    """What sensors read for one g or one °/s: in a unit, or in counts where that is None."""

    value: float
    unit: str | None = None

    @property
    def said(self) -> str:
        return self.unit or f"{self.value:.6g} counts"


def _candidates(units: Mapping[str, Unit], one: float, counts: Sequence[float]) -> tuple[KnownScale, ...]:
    rates = {name: one / unit.factor for name, unit in units.items() if unit.kind == "rate"}
    named = [KnownScale(value=value, unit=name) for name, value in rates.items()]
    return (*named, *(KnownScale(value=value) for value in counts if not np.isclose(value, list(rates.values())).any()))


CANDIDATES: Mapping[str, tuple[KnownScale, ...]] = {
    ACCEL: _candidates(ACCEL_UNITS, G_STANDARD, ACCEL_COUNTS),
    GYRO: _candidates(GYRO_UNITS, DEGREE, GYRO_COUNTS),
}
"""The one table of units and scales that are tried."""

PER = {ACCEL: "g", GYRO: "deg/s"}


@dataclass(frozen=True, kw_only=True, slots=True)
class ScaleMatch:
    """What `found` numbers per g or °/s are: the nearest candidate, and the one after it; and that in words."""

    kind: str
    found: float
    nearest: KnownScale
    rival: KnownScale

    @property
    def known(self) -> bool:
        """Whether the nearest candidate is near."""
        return abs(self.off(self.nearest)) <= NEAR

    @property
    def doubted(self) -> bool:
        """Whether the second candidate is near too."""
        return abs(self.off(self.rival)) <= NEAR

    @property
    def value(self) -> float:
        """Numbers per g or °/s: of the nearest candidate, as found where none is near."""
        return float(f"{self.nearest.value:.6g}") if self.known else float(f"{self.found:.4g}")

    @property
    def unit(self) -> str | None:
        """The unit, None of counts."""
        return self.nearest.unit if self.known else None

    def off(self, candidate: KnownScale) -> float:
        """Logarithm of what was found over what a candidate reads."""
        return float(np.log(self.found / candidate.value))

    @property
    def said(self) -> str:
        per, rival = PER[self.kind], f"{self.rival.said} would fit too ({np.expm1(self.off(self.rival)):+.1%})"
        if not self.known:
            return (
                f"{self.found:.4g} counts per {per} found, and no data sheet has a value near it (next is "
                f"{self.nearest.said}, {np.expm1(self.off(self.nearest)):+.0%})"
            )
        off = f"({np.expm1(self.off(self.nearest)):+.1%})" + (f"; {rival}" if self.doubted else "")
        if self.unit is None:
            return f"{self.value:g} counts per {per} as in data sheets, {self.found:.4g} found {off}"
        return f"one {per} reads {self.found:.4g} {off}"


def matched(kind: str, found: float, *, whole: bool) -> ScaleMatch:
    """What sensors of a kind are that read `found` for one g or °/s; `whole`: their readings are whole numbers. Others
    are counts only where no unit is near."""
    ranked = sorted(CANDIDATES[kind], key=lambda c: abs(np.log(found / c.value)))
    units = [c for c in ranked if c.unit is not None and abs(np.log(found / c.value)) <= NEAR]
    nearest = units[0] if units and not whole else ranked[0]
    return ScaleMatch(kind=kind, found=found, nearest=nearest, rival=next(c for c in ranked if c is not nearest))


def step_in_deg_s(read: Array) -> float | None:
    """The step, °/s, of a data sheet of which the readings (N, 3) are multiples, as counts written in °/s are;
    None where they are of none, or rounded to more than a fifth of it."""
    values = [np.unique(column[np.isfinite(column)]) for column in read.T]
    if min(map(len, values)) < _FEWEST:
        return None
    whole = np.concatenate(values)
    decimals = (d for d in _DECIMALS if np.abs(whole - whole.round(d)).max() < 1e-3 * 10.0**-d)
    last = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(whole), 1e-300))) + 1 - _DIGITS)
    six_digits = np.abs(whole / last - np.rint(whole / last)).max() < 1e-3
    rounding = max(10.0 ** -next(decimals, 9), _SINGLE * float(np.abs(whole).max()), six_digits * float(last.max()))
    apart = [column[1:] - column[0] for column in values]
    for step in sorted(_STEPS, reverse=True):
        counts = (a / step for a in apart)
        if rounding < _ROUNDED * step and all(
            np.mean(np.abs(count - count.round()) <= rounding / step) >= _SHARE for count in counts
        ):
            return step
    return None
