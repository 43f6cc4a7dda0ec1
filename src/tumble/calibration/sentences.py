"""Logs of sentences as VectorNav sends them, `$VNYMR,…*6D`: a table of their numbers.

The names and units of the fields are those of the maker's reference (VN-100, asynchronous output). A line with another
checksum or of another kind is no row.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import reduce

_MAG = tuple(f"Mag{axis} [gauss]" for axis in "XYZ")
_INERTIAL = (*(f"Accel{axis} [m/s^2]" for axis in "XYZ"), *(f"Gyro{axis} [rad/s]" for axis in "XYZ"))
FIELDS = {
    "VNYMR": ("Yaw", "Pitch", "Roll", *_MAG, *_INERTIAL),
    "VNQMR": ("Qx", "Qy", "Qz", "Qw", *_MAG, *_INERTIAL),
    "VNIMU": (*_MAG, *_INERTIAL, "Temperature [degC]", "Pressure [kPa]"),
    "VNMAR": (*_MAG, *_INERTIAL),
}
"""Fields of the sentences with accelerometers and gyros."""

_SHARE = 0.5


def sentence_of(lines: Sequence[str]) -> str | None:
    """The kind of sentence that most lines are; None where they are none, or none with sensors."""
    kinds = Counter(kind for line in lines if (kind := line[1:].partition(",")[0]) in FIELDS and values_of(line, kind))
    if not kinds:
        return None
    kind, count = kinds.most_common(1)[0]
    return kind if count > _SHARE * sum(bool(line.strip()) for line in lines) else None


def values_of(line: str, kind: str) -> list[str]:
    """The values of a sentence of a kind; none where it is another, or damaged."""
    body, _, check = line.strip().removeprefix("$").partition("*")
    name, *values = body.split(",")
    whole = line.lstrip().startswith("$") and check.upper() == f"{reduce(lambda c, b: c ^ b, body.encode(), 0):02X}"
    return values if whole and name == kind and len(values) == len(FIELDS[kind]) else []
