"""Identification of a table's columns by their names: times, sensors, temperatures, and their units.

A name such as `imu.acc_x [g]`, `linear_acceleration.y` or `gyrz_dps` is split into words and a unit. A single letter or
digit among the words, or at the end of one, is the axis; the patterns of names.toml give the kind of sensor for the
rest, the stem.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

ACCEL, GYRO, MAGNETOMETER, TIME_KIND = "accel", "gyro", "mag", "time"
INTERVAL, OTHER = "interval", "other"
"""Kinds of columns: times since the previous sample, and quantities that cannot be calibrated."""
SENSOR_KINDS = (ACCEL, GYRO, MAGNETOMETER)

IDENTIFYING_WEIGHT = 4.0
"""Least weight of a pattern that identifies a kind; lighter patterns only rank columns of one kind."""

_TABLE: Mapping[str, Any] = tomllib.loads((Path(__file__).parent / "names.toml").read_text(encoding="utf-8"))
_SPELLINGS: Mapping[str, Mapping[str, str]] = {
    kind: {text: unit for unit, spellings in units.items() for text in spellings}
    for kind, units in _TABLE["units"].items()
}
UNITS = {kind: _SPELLINGS[kind] for kind in (*SENSOR_KINDS, TIME_KIND)}
"""Units by kind and spelling."""
TIME_WORDS, TEMPERATURE_WORDS = _SPELLINGS["time_in_words"], _SPELLINGS["temperature"]
NAMED = {key: re.compile(words, re.IGNORECASE) for key, words in _TABLE["named"].items()}
"""Words in names of columns and files, by what they denote."""

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
"""Kind of sensor by unit, for units of only one kind."""
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
    """Return the weight of evidence that a column is of a kind; 0 without evidence or for a unit of another kind.

    `name` are the words of the column's name, joined by _, without axis and `unit`; `axis` is that of patterns of one
    axis.

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
    text = text.lower().replace("μ", "µ").replace("⁻", "-").replace("²", "2").replace("¹", "1")
    out = re.sub(r"(?<!arc)sec(onds?)?", "s", text)
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


# -------------------- columns by name --------------------

_AXIS_OF_WORD = {"x": "x", "y": "y", "z": "z", "0": "x", "1": "y", "2": "z"}
_WITH_AXIS = [re.compile(word) for word in (r"([a-z]+)([xyz])(\d)", "(.+)([xyz])()", "()([xyz])(.+)", "(.+)([123])()")]
"""Words that contain an axis: ax1 and gyroz2 of several devices, and AccX, xacc, acc1."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Sensors:
    """Columns of three sensors of one kind, and their unit as in session.toml, None if the first name has none."""

    columns: tuple[str, str, str]
    unit: str | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Columns:
    """Columns of a table by kind: time, a triad of each kind of sensor, and thermometers as in [log.temperature].

    `time_unit` is None if the name has no unit; `others` are further triads and thermometers, `times` all columns named
    as times. `ambiguous`: other columns are nearly as likely; `turning`: gyros that were identified by numbers turn the
    vector of the accelerometers."""

    time: str | None
    time_unit: str | None
    triads: Mapping[str, Sensors]
    temperatures: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    times: tuple[str, ...] = ()
    ambiguous: bool = False
    turning: bool = False

    @property
    def sensors(self) -> tuple[str, ...]:
        """Columns of all triads."""
        return tuple(column for triad in self.triads.values() for column in triad.columns)


def columns_by_name(names: Iterable[str], *, suffixed: bool = False) -> Columns:
    """Identify the columns of a table by their names.

    With `suffixed` a single letter for a kind may come first, as in the ax_front of one of several groups."""
    names = list(names)
    thermometers = {name: kind for name in names if (kind := thermometer(_words_and_unit(name)[0])) is not None}
    stems = _stems((name for name in names if name not in thermometers), suffixed=suffixed)

    def rank(item: tuple[tuple[str, str], Mapping[str, str]]) -> tuple[float, bool]:
        """Rank by score, and axes that are letters before numbers, as in acc_x_0 … acc_z_2 of three devices."""
        (kind, stem), by_axis = item
        are_numbers = len({re.sub(r"\d", "", name) for name in by_axis.values()}) == 1
        return -score(kind, stem, _words_and_unit(next(iter(by_axis.values())))[1]), are_numbers

    triads: dict[str, Sensors] = {}
    others: list[str] = []
    taken: set[str] = set()
    for (kind, stem), by_axis in sorted(stems.items(), key=rank):
        if taken & {*by_axis.values()}:
            continue
        taken |= {*by_axis.values()}
        if kind in triads:
            others.append(stem)
        else:
            triads[kind] = _triad(kind, [by_axis[axis] for axis in "xyz"])
    if ACCEL not in triads and GYRO in triads and all(map(NAMED["in_g"].fullmatch, triads[GYRO].columns)):
        triads[ACCEL] = Sensors(columns=triads.pop(GYRO).columns, unit="g")
    for kind in (ACCEL, GYRO):
        if kind not in triads and (directed := _by_direction(kind, names)) is not None:
            triads[kind] = _triad(kind, directed)
    sensors = {column for triad in triads.values() for column in triad.columns}
    times = [name for name in names if name not in ("", "T", *sensors) and _score(TIME_KIND, name)]
    time = max(times, key=lambda name: _score(TIME_KIND, name), default=None)
    thermometers = {name: kind for name, kind in thermometers.items() if name != time}
    first = {kind: name for name, kind in reversed(list(thermometers.items()))}
    pairs = ((ACCEL, GYRO), (GYRO, ACCEL))[: 1 + (GYRO in triads)]  # one thermometer for all sensors, or one per kind
    shared = (first.get(kind, first.get(other, first.get(""))) for kind, other in pairs)
    temperatures = tuple(dict.fromkeys(name for name in shared if name is not None))
    return Columns(
        time=time,
        time_unit=None if time is None else time_unit(time),
        triads=triads,
        temperatures=temperatures,
        others=(*others, *(name for name in thermometers if name not in temperatures)),
        times=tuple(times),
    )


def _by_direction(kind: str, names: Sequence[str]) -> list[str] | None:
    """Return the columns x, y, z of a kind if their names have directions, such as `RateRoll`; else None."""
    direction_first = {}  # roll_rate of `RateRoll`
    for name in names:
        words = re.sub(r"(roll|pitch|yaw)(?=rate|speed|vel)", r"\1_", "_".join(_words_and_unit(name)[0])).split("_")
        direction_first[name] = "_".join(sorted(words, key=lambda word: not NAMED["direction"].fullmatch(word)))
    columns = []
    for axis in "xyz":
        columns += [name for name in names if score(kind, direction_first[name], axis=axis)][:1]
    return columns if len(columns) == len("xyz") else None


def _stems(names: Iterable[str], *, suffixed: bool) -> dict[tuple[str, str], dict[str, str]]:
    """Return the columns of three axes by kind and stem, then by axis."""
    stems: dict[tuple[str, str], dict[str, str]] = {}
    for name in names:
        words, unit = _words_and_unit(name)
        for axis, stem in _axes(words) or _axis_alone(words):
            kind = sensor_kind(stem, unit)
            if kind is None and suffixed and stem[1:2] == "_":
                kind = sensor_kind(stem[0], unit)
            if kind is not None:
                stems.setdefault((kind, stem), {}).setdefault(axis, name)
    return {key: by_axis for key, by_axis in stems.items() if set(by_axis) == set("xyz")}


def groups_by_name(names: Sequence[str]) -> dict[str, list[str]]:
    """Return the columns of several groups of sensors by the words in which the names of one kind differ.

    A number behind the word for a kind is a word: the groups of ax1 and ax2 are 1 and 2. If gyros are in several
    groups, those of the accelerometers have the same words.

    >>> groups_by_name(["left_ax", "left_ay", "left_az", "right_ax", "right_ay", "right_az", "T_right"])["right"]
    ['right_ax', 'right_ay', 'right_az', 'T_right']
    """
    columns: dict[str, dict[str, list[str]]] = {kind: {} for kind in SENSOR_KINDS}
    stems = _stems(names, suffixed=True)
    for kind, of_kind in columns.items():
        words = {stem: _numbered_words(stem) for k, stem in stems if k == kind}
        common = set[str]().union(*words.values()).intersection(*words.values())
        for stem, listed in words.items():
            label = "_".join(word for word in listed if word not in common)
            of_kind.setdefault(label, []).extend(stems[kind, stem].values())
    accel, gyro = columns[ACCEL], columns[GYRO]
    labels = [label for label in accel if label and (label in gyro or len(gyro) < 2)]
    groups = {label: [c for of_kind in columns.values() for c in of_kind.get(label, ())] for label in labels}
    sensors = {column for group in groups.values() for column in group}
    for label, group in groups.items():  # thermometers and times
        group += [name for name in names if name not in sensors and {*label.split("_")} <= {*_numbered_words(name)}]
    return groups if len(groups) > 1 else {}


def _numbered_words(name: str) -> list[str]:
    """Return the words of a name, with numbers behind the word for a kind of sensor by themselves."""
    words = list[str]()
    for word in _words_and_unit(name)[0]:
        part = re.fullmatch(r"([a-z]+)(\d+)", word)
        is_kind = part is not None and (thermometer([part[1]]) is not None or sensor_kind(part[1], "") is not None)
        words += part.groups() if part is not None and is_kind else (word,)
    return words


def _triad(kind: str, columns: Sequence[str]) -> Sensors:
    x, y, z = columns
    return Sensors(columns=(x, y, z), unit=unit_of_name(kind, x))


def _score(kind: str, name: str) -> float:
    words, unit = _words_and_unit(name)
    return score(kind, "_".join(words), unit)


def time_unit(name: str) -> str | None:
    """Return the unit in the name of a time column: ms of `t [ms]`, us of `micros`; None if there is none."""
    words, unit = _words_and_unit(name)
    return UNITS[TIME_KIND].get(unit) or (TIME_WORDS.get(words[-1]) if words else None)


def unit_of_name(kind: str, name: str) -> str | None:
    """Return the unit in the name of a column of a kind of sensor: g of `ax [g]`; None if there is none.

    >>> unit_of_name("accel", "ax [mg]"), unit_of_name("gyro", "gyro_x")
    ('mg', None)
    """
    return UNITS[kind].get(_words_and_unit(name)[1])


def temperature_unit(name: str) -> str | None:
    """Return the unit in the name of a column of temperatures; None if there is none.

    >>> temperature_unit("Temp [K]"), temperature_unit("imu_temp_f"), temperature_unit("T")
    ('K', 'degF', None)
    """
    words, unit = _words_and_unit(name)
    return TEMPERATURE_WORDS.get(unit or words[-1])


def is_no_sensor(name: str) -> bool:
    """Return whether the name of a column excludes that it is an accelerometer or a gyro.

    >>> [is_no_sensor(name) for name in ("attitude_roll(radians)", "user_acc_x(G)", "RSSI (dB)", "ch3")]
    [True, True, True, False]
    """
    return bool(_score(OTHER, name)) or (name != "T" and bool(_score(TIME_KIND, name)))


def is_interval(name: str) -> bool:
    """Return whether a column has the times since the previous sample by its name.

    >>> [is_interval(name) for name in ("dt", "delta_t [us]", "t")]
    [True, True, False]
    """
    return bool(_score(INTERVAL, name))


def in_axis_order(names: Sequence[str]) -> tuple[str, str, str]:
    """Return three columns in the order x, y, z if their names differ by the axis, else as they are.

    >>> in_axis_order(["rate z", "rate x", "rate y"]), in_axis_order(["z", "y", "x"]), in_axis_order(["4", "5", "6"])
    (('rate x', 'rate y', 'rate z'), ('x', 'y', 'z'), ('4', '5', '6'))
    """
    readings = [next(iter(_axes(words) or _axis_alone(words)), ("", "")) for words, _ in map(_words_and_unit, names)]
    by_axis = dict(zip((axis for axis, _ in readings), names, strict=True))
    if set(by_axis) == set("xyz") and len({stem for _, stem in readings}) == 1:
        names = [by_axis[axis] for axis in "xyz"]
    x, y, z = names
    return x, y, z


def _axes(words: list[str]) -> list[tuple[str, str]]:
    """Return the possible pairs of axis and stem of a name, the likeliest first."""
    pairs = []
    for i in reversed(range(len(words))):
        word, before, after = words[i], words[:i], words[i + 1 :]
        if word in _AXIS_OF_WORD and before + after:
            pairs.append((_AXIS_OF_WORD[word], "_".join(before + after)))
        elif match := next(filter(None, (pattern.fullmatch(word) for pattern in _WITH_AXIS)), None):
            axis = {"1": "x", "2": "y", "3": "z"}.get(match[2], match[2])
            pairs.append((axis, "_".join([*before, match[1] + match[3], *after])))
    return pairs


def _axis_alone(words: list[str]) -> list[tuple[str, str]]:
    """Return the axis of a name that consists only of it."""
    return [(words[0], "")] if len(words) == 1 and words[0] in ("x", "y", "z") else []


@lru_cache(maxsize=4096)
def _words_and_unit(name: str) -> tuple[list[str], str]:
    """Split a name into words in small letters and a unit, "" for none.

    `AccX (m/s²)` gives acc, x and m/s²; `gyr_x_dps` gyr, x and dps; `TimeUS` time and us; `gyro[0]` gyro and 0."""
    name = translated_name(name)
    bracketed = re.search(r"[\[(]\s*(?![xyzXYZ]\s*[\])])([^\])]*[^\])\d\s][^\])]*?)\s*[\])]", name)
    if bracketed:
        return _words(name.replace(bracketed[0], " ")), unit_spelling(bracketed[1])
    separated = re.fullmatch(r"(.*\w)\s*(?:,\s*|\s/\s|\sin\s)([^,]+)", name)
    if separated and unit_spelling(separated[2]) in ALL_UNITS:
        return _words(separated[1]), unit_spelling(separated[2])
    words = _words(name)
    for count in (2, 1):
        unit, rest = "_".join(words[-count:]), words[:-count]
        # the remaining words must be a name by themselves: with an axis, a direction or a word for time
        is_name = _axes(rest) or any(map(NAMED["direction"].fullmatch, rest)) or score(TIME_KIND, "_".join(rest))
        is_name = is_name or any(score(GYRO, "_".join(rest), axis=axis) for axis in "xyz")
        if rest and unit in ALL_UNITS and is_name:
            return rest, unit
        inner = "_".join(words[-count - 1 : -1])
        if len(words) > count + 1 and inner in ALL_UNITS and len(inner) > 1 and words[-1] in _AXIS_OF_WORD:
            return [*words[: -count - 1], words[-1]], inner
    return words, ""


def _words(name: str) -> list[str]:
    """Return the words of a name: acc, x of `AccX`; time, us of `TimeUS`; acc, x of `acc x-axis`."""
    words: list[str] = []
    for token in re.split(r"[^A-Za-z0-9µ°²]+", name):
        words += [token] if token.lower() in ALL_UNITS else re.split(r"(?<=[a-z])(?=[A-Z])", token)
    words = [word.lower() for word in words if word]
    kept = [word for word in words if word != "axis"]
    kept = kept[:-1] if kept[-1:] == ["cal"] else kept  # mark of Shimmer for columns in a unit
    return kept if len(kept) > 1 else words


# -------------------- thermometers --------------------


def thermometer(words: Sequence[str]) -> str | None:
    """Return the kind of sensors of the thermometer that words denote, "" if not stated; None if they denote none.

    >>> thermometer(["temp", "gyro"]), thermometer(["t3"]), thermometer(["temperature", "setpoint"])
    ('gyro', '', None)
    """
    name = "_".join(words)
    if not NAMED["thermometer"].fullmatch(name):
        return None
    return next((kind for kind in (ACCEL, GYRO) if NAMED[f"thermometer_{kind}"].search(name)), "")
