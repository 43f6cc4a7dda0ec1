"""Values of parameters as they are typed, in the units that the table shows: "20 ug/g^2" or "-3 deg/h"."""

from __future__ import annotations

import re

from tumble.sensors.parameters import FURTHER, ParameterGroup, groups
from tumble.units import quantity

LEAST, LARGEST = 1e-60, 1e60
"""SI: standard deviations between which squares and their inverses are numbers."""


def prior_of(key: str, text: str) -> tuple[str, float]:
    """The group of a key of [device.prior], such as "accel_quadratic" or "accel_temperature.bias", and the standard
    deviation, SI, of a text such as "20 ug/g^2". Raises ValueError, one line, for a group or a unit that is none."""
    stem, _, of = key.partition(".")
    kind, _, what = stem.partition("_")
    ending = {"temperature": "t1", "curvature": "t2"}.get(what, what)
    name = f"{kind}.{of}.{ending}" if of else f"{kind}.{what}"
    group = next((group for group in groups() if group.name == name and not group.linear), None)
    if group is None:
        known = ", ".join(g.name.replace(".", "_") for g in FURTHER if g.variable is None)
        raise ValueError(
            f"{key}: expected one of {known}, or accel_temperature, gyro_temperature, accel_curvature, gyro_curvature, "
            "accel_hysteresis, gyro_hysteresis, accel_drift, gyro_drift, "
            "accel_launch, gyro_launch, temperature_lag"
        )
    found = _quantity(group, text)
    if found is None or not LEAST <= found <= LARGEST:
        units = ", ".join(_typed_units(group))
        raise ValueError(f"{key}: expected a positive number and one of {units}, found {text!r}")
    return group.name, found


def quantity_of(group: ParameterGroup, text: str) -> float:
    """The SI value of a text such as "-3 ug/g^2" for a parameter of a group. Raises ValueError, one line."""
    if group.linear:
        return quantity(text, group.unit)
    found = _quantity(group, text)
    if found is None:
        raise ValueError(f"expected a number and one of {', '.join(_typed_units(group))}, found {text!r}")
    return found


def _quantity(group: ParameterGroup, text: str) -> float | None:
    number = re.match(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", text)
    unit = _plain(text[number.end() :].strip()) if number else ""
    units = _typed_units(group)
    return float(number.group()) * units[unit] if number is not None and unit in units else None


def _typed_units(group: ParameterGroup) -> dict[str, float]:
    """What the units are worth that values of a group are given in, SI."""
    return {_plain(shown): size for size, shown in group.shown} | {group.unit: 1.0}


def _plain(unit: str) -> str:
    """A unit as it is typed: ug/g^2 for µg/g², deg/s/g for °/s/g, mg/K for mg/°C."""
    for shown, typed in (("/°C", "/K"), ("µ", "u"), ("²", "^2"), ("³", "^3"), ("°", "deg")):
        unit = unit.replace(shown, typed)
    return unit
