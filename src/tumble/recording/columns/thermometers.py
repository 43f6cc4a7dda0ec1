"""Which columns are thermometers by their names, and whose: `T`, `gyro_temp`, `temp_x`, `accel_temp_y`, `T0` … `T5`."""

from __future__ import annotations

import re
from collections.abc import Sequence

_WORD = re.compile(r"(t|temp|temperature)(\d?)")
_ACCEL = re.compile(r"(acc|accel|accelerometers?|a)([xyz]?)")
_GYRO = re.compile(r"(gyr|gyros?|gyroscopes?|g)([xyz]?)")
_AXIS = re.compile(r"[xyz0-9]")
_UNIT = re.compile(r"(deg_?)?[ckf]|deg|celsius|kelvin|fahrenheit|raw|counts?|lsb|adc")
_SENSOR = re.compile(r"imu|sensors?|chip|die")

Found = tuple[str, str]
"""Whose temperature a column has, "accel", "gyro" or "" where its name does not say, and its axis or number, or ""."""


def thermometer(words: Sequence[str]) -> Found | None:
    """What the words of a name say of a thermometer; None where it is none.

    >>> thermometer(["temp", "gyro", "x"]), thermometer(["t3"]), thermometer(["chamber", "temperature"])
    (('gyro', 'x'), ('', '3'), ('', ''))
    """
    at = next((i for i, word in enumerate(words) if _WORD.fullmatch(word)), None)
    if at is None:
        return None
    word = _WORD.fullmatch(words[at])
    assert word is not None
    kind, place, before, after = "", word[2], words[:at], words[at + 1 :]
    for other in (*before, *after):
        whose = next((k for k, p in (("accel", _ACCEL), ("gyro", _GYRO)) if _is_sensor(p, other)), "")
        if whose:
            kind, place = whose, place or other[-1] * (other[-1] in "xyz")
        elif _AXIS.fullmatch(other) and (word[1] != "t" or other.isdecimal()):
            place = other
        elif other in after and not (_UNIT.fullmatch(other) or _SENSOR.fullmatch(other)):
            return None
    return kind, place


def _is_sensor(pattern: re.Pattern[str], word: str) -> bool:
    """Whether a word is that of a kind of sensors; a letter alone is not."""
    return len(word) > 1 and pattern.fullmatch(word) is not None


def of_sensors(found: dict[str, Found], *, gyros: bool) -> tuple[str, ...]:
    """The columns of three accelerometers and, where there are, three gyros, as [log.temperature] has them: one for
    all, two for the accelerometers and the gyros, or one a sensor. A kind of sensors without one has that of the other
    kind, or that which names none."""
    if not found:
        return ()
    own = {kind: _of_kind(found, kind, gyros=gyros) for kind in ("accel", "gyro")}
    first, second = own["accel"] or own["gyro"], own["gyro"] or own["accel"]
    unnamed = [name for name, (kind, _) in found.items() if not kind]
    accel, gyro = (kinds or unnamed[:1] or list(found)[:1] for kinds in (first, second))
    if len(accel) == len(gyro) == 1:
        return tuple(dict.fromkeys([*accel, *gyro] if gyros else accel))
    every = (accel, gyro) if gyros else (accel,)
    return tuple(name for columns in every for name in (columns if len(columns) == 3 else 3 * columns))


def _of_kind(found: dict[str, Found], kind: str, *, gyros: bool) -> list[str]:
    """The three thermometers of the sensors of a kind, or the one that it has; none where it has none of its own."""
    for whose in (kind, ""):
        by_place = {place: name for name, (of, place) in found.items() if of == whose and place}
        numbered = sorted(place for place in by_place if place.isdecimal())
        if set("xyz") <= by_place.keys():
            return [by_place[axis] for axis in "xyz"]
        if "".join(numbered) in ("012", "123"):
            return [by_place[place] for place in numbered]
        if not whose and gyros and "".join(numbered) in ("012345", "123456"):
            return [by_place[place] for place in (numbered[:3] if kind == "accel" else numbered[3:])]
        alone = [name for name, (of, place) in found.items() if of == whose == kind and not place]
        if alone:
            return alone[:1]
    return []
