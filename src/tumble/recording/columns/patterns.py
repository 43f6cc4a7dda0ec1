"""Kinds of columns by their names: the table of patterns in names.toml, and the score of a name."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

ACCEL, GYRO, MAGNETOMETER, TIME_KIND = "accel", "gyro", "mag", "time"
INTERVAL, OTHER = "interval", "other"
"""Times since the previous sample, and quantities that are no readings of a sensor that can be calibrated."""
SENSOR_KINDS = (ACCEL, GYRO, MAGNETOMETER)

IDENTIFYING_WEIGHT = 4.0
"""Patterns of this weight or more identify a kind; lighter ones only rank several columns of one kind."""

_TABLE: Mapping[str, Any] = tomllib.loads((Path(__file__).parent / "names.toml").read_text(encoding="utf-8"))
_SPELLINGS: Mapping[str, Mapping[str, str]] = {
    kind: {text: unit for unit, spellings in units.items() for text in spellings}
    for kind, units in _TABLE["units"].items()
}
UNITS = {kind: _SPELLINGS[kind] for kind in (*SENSOR_KINDS, TIME_KIND)}
"""Units by kind and spelling."""
TIME_WORDS, TEMPERATURE_WORDS = _SPELLINGS["time_in_words"], _SPELLINGS["temperature"]
SENSOR_WORDS = {kind: re.compile(words, re.IGNORECASE) for kind, words in _TABLE["sensor_words"].items()}
"""Words for sensors in names of files and in labels of rows."""
WITHOUT_GRAVITY = re.compile(r"lin|user|free|world|without|ohne|\bno[_ ]?g|_no_g", re.IGNORECASE)
"""Words for accelerations without gravity, in names of files and columns."""

ALL_UNITS = frozenset(text for units in UNITS.values() for text in units if text != "t")


@dataclass(frozen=True, kw_only=True, slots=True)
class Pattern:
    """A row of the table; `units` None for any unit, `axis` "" unless the pattern is that of one axis."""

    kind: str
    weight: float
    name: re.Pattern[str]
    units: Collection[str] | None = None
    axis: str = ""


_KIND_OF_UNIT: Mapping[str, str] = {
    unit: kinds[0]
    for unit in frozenset(text for kind in SENSOR_KINDS for text in UNITS[kind])
    if len(kinds := [kind for kind in (*SENSOR_KINDS, TIME_KIND) if unit in UNITS[kind]]) == 1
}
"""The kind of sensor for units that only one kind has."""
_UNITS_OF_OTHERS = frozenset(_TABLE["units_of_others"])


def _patterns() -> Iterator[Pattern]:
    """Yield the rows of the table, and patterns that consist of a unit alone."""
    for row in _TABLE["column"]:
        for kind, (axis, words) in product(row["kind"], row.get("axes", {"": ""}).items()):
            name = re.compile(row["name"].replace("{}", words) if axis else row["name"])
            yield Pattern(kind=kind, weight=row["weight"], name=name, axis=axis)
    rates = {ACCEL: ("m/s^2", "g", "mg", "cm/s^2", "mm/s^2"), GYRO: ("rad/s", "deg/s", "mdeg/s", "0.1 deg/s", "deg/h")}
    accel, gyro = ({text for text, unit in UNITS[kind].items() if unit in rates[kind]} for kind in (ACCEL, GYRO))
    field = UNITS[MAGNETOMETER].keys() - UNITS[ACCEL].keys()
    any_name = re.compile("")
    yield Pattern(kind=GYRO, weight=7.0, name=any_name, units=gyro)
    yield Pattern(kind=MAGNETOMETER, weight=7.0, name=any_name, units=field - {"t"})
    yield Pattern(kind=ACCEL, weight=7.0, name=re.compile("^$"), units=accel)
    yield Pattern(kind=OTHER, weight=7.0, name=any_name, units=gyro | field | _UNITS_OF_OTHERS)  # gyros come before


PATTERNS = tuple(_patterns())


def score(kind: str, name: str, unit: str = "", axis: str = "") -> float:
    """Return the weight of evidence that a column is of a kind; 0 for none, and for a unit of another kind of sensor.

    Parameters
    ----------
    kind
        One of the kinds of columns.
    name
        Words of the column's name, joined by _, without axis and unit.
    unit
        Spelling of the unit, "" for none.
    axis
        "x", "y" or "z" for patterns of one axis.

    >>> score(ACCEL, "acc"), score(ACCEL, "lin_acc"), score(GYRO, "turning", "dps"), score(TIME_KIND, "header_stamp")
    (8.0, 6.0, 7.0, 9.0)
    >>> score(ACCEL, "f", "ut")
    0.0
    """
    if kind in SENSOR_KINDS and _KIND_OF_UNIT.get(unit, kind) != kind:
        return 0.0
    weights = [
        row.weight
        for row in PATTERNS
        if row.kind == kind and row.axis == axis and (row.units is None or unit in row.units) and row.name.search(name)
    ]
    largest = max((weight for weight in weights if weight >= IDENTIFYING_WEIGHT), default=0.0)
    return largest + sum(weight for weight in weights if weight < IDENTIFYING_WEIGHT) if largest else 0.0


def sensor_kind(name: str, unit: str) -> str | None:
    """Return the kind of sensor with the largest score for a name and a unit; None if all scores are 0."""
    scores = {kind: score(kind, name, unit) for kind in SENSOR_KINDS}
    best = max(scores, key=lambda kind: scores[kind])
    return best if scores[best] else None


# -------------------- words of other languages, and units --------------------

_LETTERS = r"[^\W\d_]*?(?=[xyz]?(?![^\W\d_]))"
_TRANSLATIONS = [
    *((re.compile(pattern.replace("~", _LETTERS), re.IGNORECASE), word) for pattern, word in _TABLE["words"]),
    *((re.compile(pattern), unit) for pattern, unit in _TABLE["spelt"]),
]


def translated_name(name: str) -> str:
    """Return a column's name with the words of other languages in English and units in their short form."""
    for pattern, word in _TRANSLATIONS:
        name = pattern.sub(word, name)
    return name


def unit_spelling(text: str) -> str:
    """Return a unit as `UNITS` spells it: `m·s⁻²`, `m/sec^2` and `m / s²` become ms-2, m/s2 and m/s2."""
    out = re.sub(
        r"(?<!arc)sec", "s", text.lower().replace("μ", "µ").replace("⁻", "-").replace("²", "2").replace("¹", "1")
    )
    return re.sub(r"[*^·⋅{} ]|\.(?=s)", "", out)


_DIMENSIONLESS = ("", "-", "1", "#", "°", "n/a", "na")


@lru_cache(maxsize=4096)
def is_unit(text: str) -> bool:
    """Return whether a cell in a line of units is a unit, of sensors or of something else.

    >>> [is_unit(text) for text in ("m/s²", "рад/с", "seconds", "hPa", "-", "ax")]
    [True, True, True, True, True, False]
    """
    plain, unit = text.strip().lower(), unit_spelling(translated_name(text.strip()))
    is_time = plain in TIME_WORDS or plain in ("second", "sec", "с", "мс", "мкс")
    is_other = unit in TEMPERATURE_WORDS or ((len(unit) > 1 or unit == "%") and unit in _UNITS_OF_OTHERS)
    return is_time or plain in _DIMENSIONLESS or unit in ALL_UNITS or is_other
