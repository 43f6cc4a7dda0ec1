"""Units of logs and of results; inside tumble all quantities are in m, s, rad, K and their products.

`ACCEL_UNITS`, `GYRO_UNITS` and `TIME_UNITS` convert the numbers of a log; `engineering` and `rounded` format results.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

G_STANDARD = 9.80665
"""Standard acceleration of free fall, m/s², exact (CGPM 1901): the unit g, never the gravity of a site."""

DEGREE = math.pi / 180.0
ARCSEC = DEGREE / 3600.0
DEGREE_PER_HOUR = DEGREE / 3600.0

ZERO_CELSIUS = 273.15
"""0 °C in K, exact (ITS-90)."""

Kind = Literal["rate", "increment", "raw"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Unit:
    """Unit of a log's numbers: its `factor` in SI, and whether it is a rate (m/s², rad/s), an increment per sample
    (m/s, rad) or a raw number that needs a scale and an offset."""

    factor: float
    kind: Kind

    def per_second(self, rate: float) -> float:
        """Return the factor to the mean rate (m/s², rad/s) over a sample, at `rate` samples per second."""
        return self.factor * (rate if self.kind == "increment" else 1.0)


def _units(rates: Mapping[str, float], increments: Mapping[str, float]) -> dict[str, Unit]:
    """Return the units of a kind of sensors by name, from their factors in SI."""
    raw = {"count": 1.0, "V": 1.0}
    by_kind: Mapping[Kind, Mapping[str, float]] = {"rate": rates, "increment": increments, "raw": raw}
    return {name: Unit(factor=size, kind=kind) for kind, sizes in by_kind.items() for name, size in sizes.items()}


ACCEL_UNITS = _units(
    rates={"m/s^2": 1.0, "g": G_STANDARD, "mg": 1e-3 * G_STANDARD, "cm/s^2": 1e-2, "mm/s^2": 1e-3},
    increments={"m/s": 1.0},
)
GYRO_UNITS = _units(
    rates={"rad/s": 1.0, "deg/s": DEGREE, "mdeg/s": 1e-3 * DEGREE, "0.1 deg/s": 0.1 * DEGREE, "deg/h": DEGREE_PER_HOUR},
    increments={"rad": 1.0, "deg": DEGREE, "arcsec": ARCSEC},
)

UNIT_TOLERANCE = 0.25  # relative error of readings above which their unit is doubted; biases and scale errors are less


def is_near_one(ratios: npt.ArrayLike) -> bool:
    """Return True if all ratios are one, to UNIT_TOLERANCE."""
    return bool(np.all(np.abs(np.asarray(ratios) - 1.0) <= UNIT_TOLERANCE))


def fitting_units(read: npt.ArrayLike, sizes: Mapping[str, float]) -> list[str]:
    """Return the units, of `sizes` in SI, in which all readings of a quantity of 1 SI are 1, to UNIT_TOLERANCE.

    >>> fitting_units(1.02 / 9.81, {name: unit.factor for name, unit in ACCEL_UNITS.items()})
    ['g']
    """
    return [name for name, size in sizes.items() if is_near_one(np.asarray(read) * size)]


TESLA = {"nT": 1e-9, "uT": 1e-6, "gauss": 1e-4, "mgauss": 1e-7, "T": 1.0}
"""Units of a magnetic field, T."""
MAGNETIC_UNITS = tuple(TESLA)
"""Units of a magnetometer. They are not converted, because no other quantity has them."""

TEMPERATURE_UNITS = {"degC": (1.0, 0.0), "K": (1.0, -ZERO_CELSIUS), "degF": (5.0 / 9.0, -160.0 / 9.0)}
"""Gain and shift to °C: gain · number + shift."""

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}


_SHOWN: dict[str, tuple[tuple[float, str], ...]] = {
    # quantity: (one of the shown unit in SI, its name), the smallest first
    "m/s^2": ((1e-6 * G_STANDARD, "µg"), (1e-3 * G_STANDARD, "mg")),
    "1": ((1e-6, "ppm"),),
    "rad": ((ARCSEC, '"'), (1e-3, "mrad")),
    "rad/s": ((DEGREE_PER_HOUR, "°/h"), (DEGREE, "°/s")),
}


def engineering(unit: str, magnitude: float) -> tuple[float, str]:
    """Return the unit, as (size in SI, name), in which a quantity of this SI unit and magnitude is shown.

    It is µg or mg, ppm, arcsec or mrad, °/h or °/s: the larger one if the magnitude is at least one such unit (0.5 mrad
    for angles). SI units other than m/s^2, 1, rad and rad/s are kept."""
    return coarsest(_SHOWN.get(unit, ((1.0, unit),)), magnitude, limit=0.5 if unit == "rad" else 1.0)


def coarsest(candidates: Sequence[tuple[float, str]], magnitude: float, *, limit: float = 1.0) -> tuple[float, str]:
    """Return the largest of the `candidates`, (size in SI, name) in ascending order, in which the magnitude is at least
    `limit`; else the smallest."""
    fitting = [unit for unit in candidates if abs(magnitude) >= limit * unit[0]]
    return (candidates[0], *fitting)[-1]


READ: dict[str, dict[str, float]] = {
    "m/s^2": {"m/s^2": 1.0, "g": G_STANDARD, "mg": 1e-3 * G_STANDARD, "ug": 1e-6 * G_STANDARD},
    "1": {"ppm": 1e-6, "%": 1e-2},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": DEGREE, "arcsec": ARCSEC, '"': ARCSEC},
    "rad/s": {"rad/s": 1.0, "deg/s": DEGREE, "deg/h": DEGREE_PER_HOUR},
}
"""By SI unit, the units in which quantities may be typed."""


def quantity(text: str, units: Mapping[str, float]) -> float:
    """Return the SI value of a text such as "3.5ppm" or "20 µg/g²".

    Raises ValueError for any text but a number and one of the units, spelled as by `as_typed`."""
    number = re.match(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", text)
    unit = as_typed(text[number.end() :].strip()) if number else ""
    if number is None or unit not in units:
        raise ValueError(f"expected a number and one of {', '.join(units)}, found {text!r}")
    return float(number.group()) * units[unit]


def as_typed(unit: str) -> str:
    """Return a unit as it is typed: ug/g^2 for µg/g², deg/s/g for °/s/g, mg/K for mg/°C."""
    for shown, typed in (("/°C", "/K"), ("µ", "u"), ("²", "^2"), ("³", "^3"), ("°", "deg")):
        unit = unit.replace(shown, typed)
    return unit


def two_digits(value: float) -> str:
    """Return a positive number with exactly two significant digits (3.0, not 3), without an exponent."""
    return rounded(value, value)[1]


def rounded(value: float, u: float) -> tuple[str, str]:
    """Return a value and its uncertainty as text, to the second significant digit of the uncertainty."""
    if not (math.isfinite(u) and u > 0.0):
        return f"{value:.6g}", "0" if u == 0.0 else str(u)
    digits = 1 - math.floor(math.log10(u))
    if round(u * 10.0**digits) >= 100:
        digits -= 1
    shown = max(digits, 0)
    return f"{round(value, digits):z.{shown}f}", f"{round(u, digits):.{shown}f}"
