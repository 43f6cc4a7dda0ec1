"""Raw sentences of NovAtel receivers, `%RAWIMUSXA,2075,507495.165;…*dd88585c`: a table of their counts.

Counts are increments of velocity and angle, in an order and with a sign of the maker's (OEM7 logs, RAWIMU):
z, −y, x. What one is worth depends on the unit behind the receiver. Other sentences between them are left aside.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence

from tumble.drafting.spelling import Spelling
from tumble.errors import InputError

_NAMES = ("Seconds [s]", *(f"Accel{axis} [counts]" for axis in "XYZ"), *(f"Gyro{axis} [counts]" for axis in "XYZ"))
_BEFORE = {"RAWIMUA": 1, "RAWIMUSA": 1, "RAWIMUXA": 3, "RAWIMUSXA": 3}
"""Fields before the seconds of the week, behind the header."""

_CORRECTED = ("CORRIMU", "IMURATECORRIMU")
_BEHIND = 8  # seconds, status, three accelerometers, three gyros
_LEAST_SHARE, _MOST = 0.1, 0.5


def novatel(lines: Sequence[str]) -> Spelling | None:
    """The spelling of lines of which some are raw sentences; None where they are none. Raises InputError for those that
    have corrected readings, or a solution, alone."""
    found = [parts for line in lines if (parts := _parts(line)) is not None]
    raw = sum(name in _BEFORE for name, _ in found)
    if raw >= max(2.0, _LEAST_SHARE * len(lines)):
        return Spelling(names=_NAMES, values=_values, said="sentences RAWIMU of NovAtel")
    corrected = next((name for name, _ in found if name.startswith(_CORRECTED)), None)
    if corrected is not None and not raw:
        raise InputError(
            f"expected raw readings, found {corrected}, of which gravity and the receiver's own corrections are taken "
            "off; log RAWIMUSX"
        )
    if not raw and len(found) >= max(2.0, _MOST * len(lines)):
        raise InputError(f"expected readings of the sensors, found {found[0][0]} of NovAtel, a solution; log RAWIMUSX")
    return None


def _parts(line: str) -> tuple[str, list[str]] | None:
    """Name and fields of a sentence whose checksum is right."""
    body, mark, check = line.strip().partition("*")
    name = body[1:].partition(",")[0]
    if not mark or body[:1] not in ("%", "#") or check.lower() != f"{_checksum(body[1:].encode()):08x}":
        return None
    return name, body.partition(";")[2].split(",")


def _checksum(body: bytes) -> int:
    """CRC-32 that begins with zeros and is not inverted."""
    return zlib.crc32(body, 0xFFFFFFFF) ^ 0xFFFFFFFF


def _values(line: str) -> list[str] | None:
    """Seconds, and counts about x, y and z; None for other sentences, which are left out."""
    name, fields = _parts(line) or ("", [])
    if name not in _BEFORE or len(fields) != _BEFORE[name] + _BEHIND:
        return None
    seconds, _, *read = fields[_BEFORE[name] :]
    az, ay, ax, gz, gy, gx = read
    return [seconds, ax, _negative(ay), az, gx, _negative(gy), gz]


def _negative(count: str) -> str:
    return count[1:] if count.startswith("-") else f"-{count}"
