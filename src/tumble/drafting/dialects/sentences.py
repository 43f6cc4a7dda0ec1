"""Sentences with a checksum: `$VNYMR,…*6D`, as VectorNav and many boards send them, and `%RAWIMUSXA,…*dd88585c` of
NovAtel's receivers. A line with another checksum or of another kind is no row.

Sources: the names and units of VectorNav's fields are those of the VN-100's reference (asynchronous output), other
sentences have columns without names. NovAtel's counts (OEM7 logs, RAWIMU) are increments of velocity and angle in the
order z, −y, x; what one is worth depends on the unit behind the receiver.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from functools import reduce

from tumble.drafting.dialects.spelling import LEAST_NUMBERS, Columns, Spelling, spelt_alike
from tumble.errors import InputError

_MAG = tuple(f"Mag{axis} [gauss]" for axis in "XYZ")
_INERTIAL = (*(f"Accel{axis} [m/s^2]" for axis in "XYZ"), *(f"Gyro{axis} [rad/s]" for axis in "XYZ"))
_FIELDS = {
    "VNYMR": ("Yaw", "Pitch", "Roll", *_MAG, *_INERTIAL),
    "VNQMR": ("Qx", "Qy", "Qz", "Qw", *_MAG, *_INERTIAL),
    "VNIMU": (*_MAG, *_INERTIAL, "Temperature [degC]", "Pressure [kPa]"),
    "VNMAR": (*_MAG, *_INERTIAL),
}
_COUNTS = ("Seconds [s]", *(f"Accel{axis} [counts]" for axis in "XYZ"), *(f"Gyro{axis} [counts]" for axis in "XYZ"))
_BEFORE = {"RAWIMUA": 1, "RAWIMUSA": 1, "RAWIMUXA": 3, "RAWIMUSXA": 3}
"""Fields of NovAtel's sentences before the seconds of the week, behind the header."""

_CORRECTED = ("CORRIMU", "IMURATECORRIMU")
_BEHIND = 8  # seconds, status, three accelerometers, three gyros
_LEAST_SHARE, _MOST = 0.1, 0.5


def sentences(lines: Sequence[str]) -> Spelling | None:
    """The sentences that most lines are; None where they are none. A damaged one is no row."""

    def row(line: str) -> tuple[tuple[str, int], list[str]] | None:
        body, _, check = line.strip().removeprefix("$").partition("*")
        whole = line.lstrip().startswith("$") and check.upper() == f"{reduce(lambda c, b: c ^ b, body.encode(), 0):02X}"
        name, *values = body.split(",") if whole else [""]
        return ((name, len(values)), values) if len(values) >= LEAST_NUMBERS else None

    def columns(kind: tuple[str, int]) -> Columns | None:
        names = _FIELDS.get(kind[0], ())
        return (names, f"sentences ${kind[0]}") if len(names) in (0, kind[1]) else None

    return spelt_alike(lines, row, columns)


def novatel(lines: Sequence[str]) -> Spelling | None:
    """The spelling of lines of which some are raw sentences of NovAtel; None where they are none. Raises InputError for
    those that have corrected readings, or a solution, alone."""
    read = [parts for line in lines if (parts := _novatel_parts(line)) is not None]
    raw = sum(name in _BEFORE for name, _ in read)
    if raw >= max(2.0, _LEAST_SHARE * len(lines)):
        return Spelling(names=_COUNTS, values=_novatel_values, said="sentences RAWIMU of NovAtel")
    corrected = next((name for name, _ in read if name.startswith(_CORRECTED)), None)
    if corrected is not None and not raw:
        raise InputError(
            f"expected raw readings, found {corrected}, of which gravity and the receiver's own corrections are taken "
            "off; log RAWIMUSX"
        )
    if not raw and len(read) >= max(2.0, _MOST * len(lines)):
        raise InputError(f"expected readings of the sensors, found {read[0][0]} of NovAtel, a solution; log RAWIMUSX")
    return None


def _novatel_parts(line: str) -> tuple[str, list[str]] | None:
    """Name and fields of a sentence whose checksum is right: CRC-32 that begins with zeros and is not inverted."""
    body, mark, check = line.strip().partition("*")
    checksum = zlib.crc32(body[1:].encode(), 0xFFFFFFFF) ^ 0xFFFFFFFF
    if not mark or body[:1] not in ("%", "#") or check.lower() != f"{checksum:08x}":
        return None
    return body[1:].partition(",")[0], body.partition(";")[2].split(",")


def _novatel_values(line: str) -> list[str] | None:
    """Seconds, and counts about x, y and z; None for other sentences, which are left out."""
    name, fields = _novatel_parts(line) or ("", [])
    if name not in _BEFORE or len(fields) != _BEFORE[name] + _BEHIND:
        return None
    seconds, _, az, ay, ax, gz, gy, gx = fields[_BEFORE[name] :]
    negative_ay, negative_gy = (y[1:] if y.startswith("-") else f"-{y}" for y in (ay, gy))
    return [seconds, ax, negative_ay, az, gx, negative_gy, gz]
