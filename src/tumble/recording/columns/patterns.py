"""What a column is by its name: one table of patterns (names.toml), and one scorer."""

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
"""Times from the sample before, and what is no sensor that can be calibrated."""
SENSOR_KINDS = (ACCEL, GYRO, MAGNETOMETER)

LIKELY = 4.0

_TABLE: Mapping[str, Any] = tomllib.loads((Path(__file__).parent / "names.toml").read_text(encoding="utf-8"))


def _by_spelling(units: Mapping[str, list[str]]) -> dict[str, str]:
    return {text: unit for unit, spellings in units.items() for text in spellings}


_SPELLINGS: Mapping[str, Mapping[str, str]] = {kind: _by_spelling(units) for kind, units in _TABLE["units"].items()}
UNITS = {kind: _SPELLINGS[kind] for kind in (*SENSOR_KINDS, TIME_KIND)}
"""Units by kind and spelling."""
TIME_WORDS, TEMPERATURE_WORDS = _SPELLINGS["time_in_words"], _SPELLINGS["temperature"]
SENSOR_WORDS = {kind: re.compile(words, re.IGNORECASE) for kind, words in _TABLE["sensor_words"].items()}
"""Words for sensors in the names of files, and of rows."""
WITHOUT_GRAVITY = re.compile(r"lin|user|free|world|without|ohne|\bno[_ ]?g|_no_g", re.IGNORECASE)
"""Words for accelerations that a filter has taken gravity off, in the names of files and columns."""

ALL_UNITS = frozenset(text for units in UNITS.values() for text in units if text != "t")


@dataclass(frozen=True, kw_only=True, slots=True)
class Pattern:
    """A row of the table. Without `units` the unit does not matter; with an `axis` the pattern is that of one axis."""

    kind: str
    weight: float
    name: re.Pattern[str]
    units: Collection[str] | None = None
    axis: str = ""


_OF_ONE_KIND: Mapping[str, str] = {
    unit: kinds[0]
    for unit in frozenset(text for kind in SENSOR_KINDS for text in UNITS[kind])
    if len(kinds := [kind for kind in (*SENSOR_KINDS, TIME_KIND) if unit in UNITS[kind]]) == 1
}
"""The kind of sensors of a unit that no other kind has."""
_UNITS_OF_OTHERS = frozenset(_TABLE["units_of_others"])


def _patterns() -> Iterator[Pattern]:
    """The rows of the table, and what a unit alone tells."""
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
"""The one table of what columns are."""


def score(kind: str, name: str, unit: str = "", axis: str = "") -> float:
    """How much the words of a name, joined by _ and without its axis, and its unit say that a column is of a kind; 0
    where nothing says so, or the unit is that of another kind of sensors.

    >>> score(ACCEL, "acc"), score(ACCEL, "lin_acc"), score(GYRO, "turning", "dps"), score(TIME_KIND, "header_stamp")
    (8.0, 6.0, 7.0, 9.0)
    >>> score(ACCEL, "f", "ut")
    0.0
    """
    if kind in SENSOR_KINDS and _OF_ONE_KIND.get(unit, kind) != kind:
        return 0.0
    weights = [
        row.weight
        for row in PATTERNS
        if row.kind == kind and row.axis == axis and (row.units is None or unit in row.units) and row.name.search(name)
    ]
    largest = max((weight for weight in weights if weight >= LIKELY), default=0.0)
    return largest + sum(weight for weight in weights if weight < LIKELY) if largest else 0.0


def sensor_kind(name: str, unit: str) -> str | None:
    """The kind of sensors that a name and a unit say most of; None where they say nothing."""
    scores = {kind: score(kind, name, unit) for kind in SENSOR_KINDS}
    best = max(scores, key=lambda kind: scores[kind])
    return best if scores[best] else None


# -------------------- words of other languages, and of instruments --------------------

_LETTERS = r"[^\W\d_]*?(?=[xyz]?(?![^\W\d_]))"
_WORDS = [
    *((re.compile(pattern.replace("~", _LETTERS), re.IGNORECASE), word) for pattern, word in _TABLE["words"]),
    *((re.compile(pattern), unit) for pattern, unit in _TABLE["spelt"]),
]


def in_words_of_the_table(name: str) -> str:
    """A column's name with the words of other languages replaced, and units that are spelt in words, `deg_per_s`, in
    their short form, `degps`."""
    for pattern, word in _WORDS:
        name = pattern.sub(word, name)
    return name


# -------------------- units --------------------


def unit_spelling(text: str) -> str:
    """A unit as `UNITS` has it: `m·s⁻²`, `m/sec^2` and `m / s²` are ms-2, m/s2 and m/s2."""
    out = re.sub(
        r"(?<!arc)sec", "s", text.lower().replace("μ", "µ").replace("⁻", "-").replace("²", "2").replace("¹", "1")
    )
    return re.sub(r"[*^·⋅{} ]|\.(?=s)", "", out)


_NO_MEASURE = ("", "-", "1", "#", "°", "n/a", "na")


@lru_cache(maxsize=4096)
def is_unit(text: str) -> bool:
    """Whether a cell in a line of units is one, of sensors or of something else.

    >>> [is_unit(text) for text in ("m/s²", "рад/с", "seconds", "hPa", "-", "ax")]
    [True, True, True, True, True, False]
    """
    plain, unit = text.strip().lower(), unit_spelling(in_words_of_the_table(text.strip()))
    timed = plain in TIME_WORDS or plain in ("second", "sec", "с", "мс", "мкс")
    other = unit in TEMPERATURE_WORDS or ((len(unit) > 1 or unit == "%") and unit in _UNITS_OF_OTHERS)
    return timed or plain in _NO_MEASURE or unit in ALL_UNITS or other
