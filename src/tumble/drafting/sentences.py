"""Sentences with a checksum, `$VNYMR,…*6D`, as VectorNav and many boards send them. A line with another checksum or of
another kind is no row.

The names and units of VectorNav's fields are those of the VN-100's reference (asynchronous output); other sentences
have columns without names.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

from tumble.drafting.spelling import LEAST_NUMBERS, Columns, Spelling, spelt_alike

_MAG = tuple(f"Mag{axis} [gauss]" for axis in "XYZ")
_INERTIAL = (*(f"Accel{axis} [m/s^2]" for axis in "XYZ"), *(f"Gyro{axis} [rad/s]" for axis in "XYZ"))
_FIELDS = {
    "VNYMR": ("Yaw", "Pitch", "Roll", *_MAG, *_INERTIAL),
    "VNQMR": ("Qx", "Qy", "Qz", "Qw", *_MAG, *_INERTIAL),
    "VNIMU": (*_MAG, *_INERTIAL, "Temperature [degC]", "Pressure [kPa]"),
    "VNMAR": (*_MAG, *_INERTIAL),
}


def sentences(lines: Sequence[str]) -> Spelling | None:
    """The spelling of lines most of which are sentences; None where they are not."""

    def row(line: str) -> tuple[tuple[str, int], list[str]] | None:
        body, _, check = line.strip().removeprefix("$").partition("*")
        whole = line.lstrip().startswith("$") and check.upper() == f"{reduce(lambda c, b: c ^ b, body.encode(), 0):02X}"
        name, *values = body.split(",") if whole else [""]
        return ((name, len(values)), values) if len(values) >= LEAST_NUMBERS else None

    def columns(kind: tuple[str, int]) -> Columns | None:
        names = _FIELDS.get(kind[0], ())
        return (names, f"sentences ${kind[0]}") if len(names) in (0, kind[1]) else None

    return spelt_alike(lines, row, columns)
