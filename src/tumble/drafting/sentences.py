"""Logs of sentences with a checksum, `$VNYMR,…*6D`, as VectorNav and many boards send them: a table of their values.

The names and units of VectorNav's fields are those of the maker's reference (VN-100, asynchronous output); other
sentences have columns without names. A line with another checksum or of another kind is no row.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

from tumble.drafting.spelling import LEAST_NUMBERS, Spelling, most_common

_MAG = tuple(f"Mag{axis} [gauss]" for axis in "XYZ")
_INERTIAL = (*(f"Accel{axis} [m/s^2]" for axis in "XYZ"), *(f"Gyro{axis} [rad/s]" for axis in "XYZ"))
_FIELDS = {
    "VNYMR": ("Yaw", "Pitch", "Roll", *_MAG, *_INERTIAL),
    "VNQMR": ("Qx", "Qy", "Qz", "Qw", *_MAG, *_INERTIAL),
    "VNIMU": (*_MAG, *_INERTIAL, "Temperature [degC]", "Pressure [kPa]"),
    "VNMAR": (*_MAG, *_INERTIAL),
}
"""Fields of the sentences with accelerometers and gyros."""


def sentences(lines: Sequence[str]) -> Spelling | None:
    """The sentences that most lines are; None where they are none."""
    common = most_common(map(_kind, lines), lines)
    if common is None:
        return None
    name, count = common
    names = _FIELDS.get(name, ())
    if names and len(names) != count:
        return None

    def values(line: str) -> list[str]:
        found = _parts(line)
        return found[1:] if found and (found[0], len(found) - 1) == common else []

    return Spelling(names=names, values=values, said=f"sentences ${name}")


def _kind(line: str) -> tuple[str, int] | None:
    """The name of a sentence and how many values it has; None where a line is none."""
    name, *values = _parts(line) or [""]
    return (name, len(values)) if len(values) >= LEAST_NUMBERS else None


def _parts(line: str) -> list[str]:
    """Name and values of a sentence; nothing where a line is none, or damaged."""
    body, _, check = line.strip().removeprefix("$").partition("*")
    whole = line.lstrip().startswith("$") and check.upper() == f"{reduce(lambda c, b: c ^ b, body.encode(), 0):02X}"
    return body.split(",") if whole else []
