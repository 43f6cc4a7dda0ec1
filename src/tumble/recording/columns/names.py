"""What the columns of a table are, by their names: times, sensors, temperatures, and their units.

A name such as `imu.acc_x [g]`, `linear_acceleration.y` or `gyrz_dps` falls into words and a unit; a single letter or
number among the words, or at the end of one, is the axis, and `patterns` says which sensor the rest is.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from tumble.recording.columns.patterns import (
    ACCEL,
    ALL_UNITS,
    GYRO,
    INTERVAL,
    MAGNETOMETER,
    OTHER,
    SENSOR_WORDS,
    TEMPERATURE_WORDS,
    TIME_KIND,
    TIME_WORDS,
    UNITS,
    in_words_of_the_table,
    score,
    sensor_kind,
    unit_spelling,
)

__all__ = ["ACCEL", "GYRO", "MAGNETOMETER", "SENSOR_WORDS", "TIME_KIND", "Columns", "columns_by_name", "in_order"]

_LETTERS = {"x": "x", "y": "y", "z": "z", "0": "x", "1": "y", "2": "z"}
_WITH_AXIS = [re.compile(word) for word in (r"([a-z]+)([xyz])(\d)", "(.+)([xyz])()", "()([xyz])(.+)", "(.+)([123])()")]
"""Words with an axis and something else: that of several devices, ax1, gyroz2, and AccX, xacc, acc1."""
_THERMOMETER = re.compile(r"(t|temp|temperature)(\d?)")
_ACCEL_WORD = re.compile(r"(acc|accel|accelerometers?|a)([xyz]?)")
_GYRO_WORD = re.compile(r"(gyr|gyros?|gyroscopes?|g)([xyz]?)")
_AXIS_WORD = re.compile(r"[xyz0-9]")
_UNIT_WORD = re.compile(r"(deg_?)?[ckf]|deg|celsius|kelvin|fahrenheit|raw|counts?|lsb|adc")
_CHIP = re.compile(r"imu|sensors?|chip|die")

Place = tuple[str, str]
"""Whose temperature a column has, "accel", "gyro" or "" where its name does not say, and its axis or number, or ""."""
_DIRECTION = re.compile(
    r"roll|pitch|yaw|longitudinal|long|longit|forward|surge|lateral|lat|transverse|sway|vertical|vert|heave"
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Sensors:
    """Three columns of one kind of sensor, and their unit as session.toml names it; None where nothing says it."""

    columns: tuple[str, str, str]
    unit: str | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Columns:
    """The columns found in a table: the time with its unit (None where the name does not say), one triad of each kind,
    and the `temperatures` as [log.temperature] has them. `others` are the names of
    triads of the same kinds, and of thermometers, that were not taken, `times` those of all times, `interval` that of
    the times from sample to sample. `unsure`: whether by their numbers others are hardly less likely."""

    time: str | None
    time_unit: str | None
    triads: Mapping[str, Sensors]
    temperatures: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    times: tuple[str, ...] = ()
    interval: str | None = None
    unsure: bool = False


def columns_by_name(names: Iterable[str]) -> Columns:
    """What the columns of a table are."""
    names = list(names)
    warm = {name: place for name in names if (place := thermometer(_split(name)[0])) is not None}
    stems: dict[tuple[str, str], dict[str, str]] = {}  # columns by kind and name without the axis, and then by axis
    for name in names:
        words, unit = _split(name)
        for axis, stem in (_axes(words) or _alone(words)) if name not in warm else ():
            if (kind_told := sensor_kind(stem, unit)) is not None:
                stems.setdefault((kind_told, stem), {}).setdefault(axis, name)
                break

    def doubt(stem: tuple[tuple[str, str], Mapping[str, str]]) -> float:
        (kind, name), axes = stem
        return -score(kind, name, _split(next(iter(axes.values())))[1])

    triads: dict[str, Sensors] = {}
    others: list[str] = []
    for (kind, stem), axes in sorted(stems.items(), key=doubt):
        if set(axes) == set("xyz") and kind in triads:
            others.append(stem)
        elif set(axes) == set("xyz"):
            triads[kind] = _triad(kind, [axes[axis] for axis in "xyz"])
    directed = {}  # words with the direction, where there is one, before the others: roll_rate of `RateRoll`
    for name in names:
        words = re.sub(r"(roll|pitch|yaw)(?=rate|speed|vel)", r"\1_", "_".join(_split(name)[0])).split("_")
        directed[name] = "_".join(sorted(words, key=lambda word: not _DIRECTION.fullmatch(word)))
    for kind in (ACCEL, GYRO):
        along = [next((n for n in names if score(kind, directed[n], axis=axis)), None) for axis in "xyz"]
        if kind not in triads and None not in along:
            triads[kind] = _triad(kind, [name for name in along if name is not None])
    taken = {column for triad in triads.values() for column in triad.columns}
    free = [name for name in names if name and name not in taken]
    interval = _best(INTERVAL, free)
    times = [name for name in free if name not in ("T", interval) and _score(TIME_KIND, name)]
    time = _best(TIME_KIND, times)
    warm = {name: place for name, place in warm.items() if name not in (time, interval)}
    temperatures = _of_sensors(warm, gyros=GYRO in triads)
    return Columns(
        time=time,
        time_unit=None if time is None else time_unit(time),
        triads=triads,
        temperatures=temperatures,
        others=(*others, *(name for name in warm if name not in temperatures)),
        times=tuple(times),
        interval=interval,
    )


def _triad(kind: str, columns: Sequence[str]) -> Sensors:
    x, y, z = columns
    return Sensors(columns=(x, y, z), unit=unit_of_name(kind, x))


def _score(kind: str, name: str) -> float:
    words, unit = _split(name)
    return score(kind, "_".join(words), unit)


def _best(kind: str, names: Sequence[str]) -> str | None:
    """The first of the names that score most as one of a kind; None where none does."""
    best = max(names, key=lambda name: _score(kind, name), default=None)
    return best if best is not None and _score(kind, best) else None


def time_unit(name: str) -> str | None:
    """The unit that the name of a time says: `t [ms]` ms, `micros` us; None where it says none."""
    words, unit = _split(name)
    return UNITS[TIME_KIND].get(unit) or (TIME_WORDS.get(words[-1]) if words else None)


def unit_of_name(kind: str, name: str) -> str | None:
    """The unit that the name of a column of this kind says: `ax [g]` g, `gyro_x_dps` deg/s; None where it says none.

    >>> unit_of_name("accel", "ax [mg]"), unit_of_name("gyro", "gyro_x")
    ('mg', None)
    """
    return UNITS[kind].get(_split(name)[1])


def temperature_unit(name: str) -> str | None:
    """The unit that the name of a column of temperatures says; None where it says none.

    >>> temperature_unit("Temp [K]"), temperature_unit("imu_temp_f"), temperature_unit("T")
    ('K', 'degF', None)
    """
    words, unit = _split(name)
    return TEMPERATURE_WORDS.get(unit or words[-1])


def is_no_sensor(name: str) -> bool:
    """Whether the name of a column says that it is no accelerometer, and no gyro that a name does not tell already.

    >>> [is_no_sensor(name) for name in ("attitude_roll(radians)", "user_acc_x(G)", "RSSI (dB)", "ch3")]
    [True, True, True, False]
    """
    return bool(_score(OTHER, name)) or (name != "T" and bool(_score(TIME_KIND, name)))


def in_order(names: Sequence[str]) -> tuple[str, str, str]:
    """Three columns in the order of their axes, where their names differ by these: z, x and y are x, y and z.

    >>> in_order(["rate z", "rate x", "rate y"]), in_order(["z", "y", "x"]), in_order(["4", "5", "6"])
    (('rate x', 'rate y', 'rate z'), ('x', 'y', 'z'), ('4', '5', '6'))
    """
    first = [next(iter(_axes(words) or _alone(words)), ("", "")) for words, _ in map(_split, names)]
    of_axis = dict(zip((axis for axis, _ in first), names, strict=True))
    if set(of_axis) == set("xyz") and len({stem for _, stem in first}) == 1:
        names = [of_axis[axis] for axis in "xyz"]
    x, y, z = names
    return x, y, z


def _axes(words: list[str]) -> list[tuple[str, str]]:
    """Readings of a name's words as (axis, the rest), the likeliest first; none where it has no axis."""
    readings = []
    for at in reversed(range(len(words))):
        word, before, after = words[at], words[:at], words[at + 1 :]
        if word in _LETTERS and before + after:
            readings.append((_LETTERS[word], "_".join(before + after)))
        elif found := next(filter(None, (pattern.fullmatch(word) for pattern in _WITH_AXIS)), None):
            axis = {"1": "x", "2": "y", "3": "z"}.get(found[2], found[2])
            readings.append((axis, "_".join([*before, found[1] + found[3], *after])))
    return readings


def _alone(words: list[str]) -> list[tuple[str, str]]:
    """The reading of a name that is an axis and nothing else."""
    return [(words[0], "")] if len(words) == 1 and words[0] in ("x", "y", "z") else []


@lru_cache(maxsize=4096)
def _split(name: str) -> tuple[list[str], str]:
    """The words of a name in small letters and its unit, if it has one: `AccX (m/s²)` is acc, x and m/s²; `gyr_x_dps`
    gyr, x and dps; `TimeUS` time and us; `gyro[0]` gyro and 0."""
    name = in_words_of_the_table(name)
    bracketed = re.search(r"[\[(]\s*(?![xyzXYZ]\s*[\])])([^\])]*[^\])\d\s][^\])]*?)\s*[\])]", name)
    if bracketed:
        return _words(name.replace(bracketed[0], " ")), unit_spelling(bracketed[1])
    behind = re.fullmatch(r"(.*\w)\s*(?:,\s*|\s/\s|\sin\s)([^,]+)", name)
    if behind and unit_spelling(behind[2]) in ALL_UNITS:
        return _words(behind[1]), unit_spelling(behind[2])
    words = _words(name)
    for count in (2, 1):
        unit = "_".join(words[-count:])
        rest = words[:-count]  # which must have all that a name needs, an axis, a direction or the time
        is_name = _axes(rest) or any(map(_DIRECTION.fullmatch, rest)) or score(TIME_KIND, "_".join(rest))
        if rest and unit in ALL_UNITS and is_name:
            return rest, unit
        inner = "_".join(words[-count - 1 : -1])
        if len(words) > count + 1 and inner in ALL_UNITS and len(inner) > 1 and words[-1] in _LETTERS:
            return [*words[: -count - 1], words[-1]], inner
    return words, ""


def _words(name: str) -> list[str]:
    """`AccX`: acc, x; `TimeUS`: time, us; `mag_uT`: mag, ut; `acc x-axis`: acc, x."""
    words: list[str] = []
    for token in re.split(r"[^A-Za-z0-9µ°²]+", name):
        whole = token.lower() in ALL_UNITS
        words += [token] if whole else re.split(r"(?<=[a-z])(?=[A-Z])", token)
    words = [word.lower() for word in words if word]
    kept = [word for word in words if word != "axis"]
    kept = kept[:-1] if kept[-1:] == ["cal"] else kept  # of Shimmer: in a unit
    return kept if len(kept) > 1 else words


# -------------------- thermometers --------------------


def thermometer(words: Sequence[str]) -> Place | None:
    """What the words of a name say of a thermometer; None where it is none.

    >>> thermometer(["temp", "gyro", "x"]), thermometer(["t3"]), thermometer(["chamber", "temperature"])
    (('gyro', 'x'), ('', '3'), ('', ''))
    """
    at, word = next(((i, w) for i, text in enumerate(words) if (w := _THERMOMETER.fullmatch(text))), (0, None))
    if word is None:
        return None
    kind, place, before, after = "", word[2], words[:at], words[at + 1 :]
    for other in (*before, *after):
        kinds = ((ACCEL, _ACCEL_WORD), (GYRO, _GYRO_WORD))
        whose = next((k for k, pattern in kinds if len(other) > 1 and pattern.fullmatch(other)), "")
        if whose:
            kind, place = whose, place or other[-1] * (other[-1] in "xyz")
        elif _AXIS_WORD.fullmatch(other) and (word[1] != "t" or other.isdecimal()):
            place = other
        elif other in after and not (_UNIT_WORD.fullmatch(other) or _CHIP.fullmatch(other)):
            return None
    return kind, place


def _of_sensors(found: dict[str, Place], *, gyros: bool) -> tuple[str, ...]:
    """The columns of three accelerometers and, where there are, three gyros, as [log.temperature] has them: one for
    all, two for the accelerometers and the gyros, or one a sensor. A kind of sensors without one has that of the other
    kind, or that which names none."""
    if not found:
        return ()
    accel, gyro = _of_kind(found, ACCEL), _of_kind(found, GYRO)
    first, second = accel or gyro, gyro or accel
    unnamed = [name for name, (kind, _) in found.items() if not kind]
    accel, gyro = (kinds or unnamed[:1] or list(found)[:1] for kinds in (first, second))
    if len(accel) == len(gyro) == 1:
        return tuple(dict.fromkeys([*accel, *gyro] if gyros else accel))
    every = (accel, gyro) if gyros else (accel,)
    return tuple(name for columns in every for name in (columns if len(columns) == 3 else 3 * columns))


def _of_kind(found: dict[str, Place], kind: str) -> list[str]:
    """The three thermometers of the sensors of a kind, or the one that it has; none where it has none of its own."""
    for whose in (kind, ""):
        by_place = {place: name for name, (of, place) in found.items() if of == whose and place}
        if set("xyz") <= by_place.keys():
            return [by_place[axis] for axis in "xyz"]
        alone = [name for name, (of, place) in found.items() if of == whose == kind and not place]
        if alone:
            return alone[:1]
    return []
