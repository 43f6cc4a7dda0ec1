"""What a column is by its name: one table of patterns, and one scorer.

A row of the table is a kind, a weight, a pattern of the name without its axis and unit, and units; it counts where the
pattern is found and the unit is one of these. Rows of `LIKELY` and more say what a column is, and the greatest counts;
smaller ones say which of several is meant, and add up. Units are spelt as `UNITS` has them; words of other
languages and of instruments are put into those of the table before.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import lru_cache

ACCEL, GYRO, MAGNETOMETER, TIME_KIND = "accel", "gyro", "mag", "time"
INTERVAL, OTHER = "interval", "other"
"""Times from the sample before, and what is no sensor that can be calibrated."""
SENSOR_KINDS = (ACCEL, GYRO, MAGNETOMETER)

LIKELY = 4.0

UNITS: Mapping[str, Mapping[str, str]] = {
    ACCEL: {
        "m/s2": "m/s^2", "ms-2": "m/s^2", "m/s/s": "m/s^2", "mps2": "m/s^2", "ms2": "m/s^2", "m_s2": "m/s^2",
        "cm/s2": "cm/s^2", "cms-2": "cm/s^2", "mm/s2": "mm/s^2", "mms-2": "mm/s^2",
        "g": "g", "mg": "mg", "m/s": "m/s", "count": "count", "counts": "count", "lsb": "count", "raw": "count",
        "adc": "count", "v": "V",
    },
    GYRO: {
        "rad/s": "rad/s", "rads-1": "rad/s", "rads": "rad/s", "rad_s": "rad/s", "radps": "rad/s", "rps": "rad/s",
        "deg/s": "deg/s", "°/s": "deg/s", "degs-1": "deg/s", "degree/s": "deg/s", "degrees/s": "deg/s", "dps": "deg/s",
        "radians/s": "rad/s", "radian/s": "rad/s",
        "deg_s": "deg/s", "degs": "deg/s", "degps": "deg/s", "deg/h": "deg/h", "°/h": "deg/h", "dph": "deg/h",
        "mdps": "mdeg/s", "mdeg/s": "mdeg/s", "0.1deg/s": "0.1 deg/s", "0.1dps": "0.1 deg/s",
        "rad": "rad", "deg": "deg", "arcsec": "arcsec", "count": "count",
        "counts": "count", "lsb": "count", "raw": "count", "adc": "count", "v": "V",
    },
    MAGNETOMETER: {
        "nt": "nT", "ut": "uT", "µt": "uT", "microteslas": "uT", "gauss": "gauss", "ga": "gauss",
        "t": "T", "tesla": "T", "mgauss": "mgauss", "mg": "mgauss", "g": "gauss",
    },
    TIME_KIND: {
        "s": "s", "sec": "s", "ms": "ms", "us": "us", "µs": "us", "ns": "ns",
        "min": "min", "minutes": "min", "h": "h", "hours": "h",
    },
}  # fmt: skip
TIME_WORDS = {
    "seconds": "s", "secs": "s",
    "ms": "ms", "millis": "ms", "milliseconds": "ms",
    "us": "us", "micros": "us", "microseconds": "us",
    "ns": "ns", "nanos": "ns", "nanoseconds": "ns",
    "minutes": "min", "hours": "h",
}  # fmt: skip
TEMPERATURE_WORDS = {
    "c": "degC", "°c": "degC", "degc": "degC", "celsius": "degC", "k": "K", "kelvin": "K", "degk": "K",
    "f": "degF", "°f": "degF", "degf": "degF", "fahrenheit": "degF",
    "raw": "raw", "count": "raw", "counts": "raw", "lsb": "raw", "adc": "raw",
}  # fmt: skip
SENSOR_WORDS: Mapping[str, re.Pattern[str]] = {
    ACCEL: re.compile(r"acc|beschl|ускор|加速度", re.IGNORECASE),
    GYRO: re.compile(r"gyr|angular|dreh|гиро|角速度|陀螺", re.IGNORECASE),
}
"""Words for sensors in the names of files, and of rows."""
WITHOUT_GRAVITY = re.compile(r"lin|user|free|world|without|ohne|\bno[_ ]?g|_no_g", re.IGNORECASE)
"""Words for accelerations that a filter has taken gravity off, in the names of files and columns."""

ALL_UNITS = frozenset(text for units in UNITS.values() for text in units if text != "t")


@dataclass(frozen=True, kw_only=False, slots=True)
class Pattern:
    """A row of the table. Without `units` the unit does not matter; with an `axis` the pattern is that of one axis."""

    kind: str
    weight: float
    name: re.Pattern[str]
    units: frozenset[str] | None = None
    axis: str = ""


def _row(kind: str, weight: float, name: str, units: Collection[str] | None = None, axis: str = "") -> Pattern:
    return Pattern(kind, weight, re.compile(name), None if units is None else frozenset(units), axis)


def _spelt(kind: str, *units: str) -> list[str]:
    """The spellings of units."""
    return [text for text, unit in UNITS[kind].items() if unit in units]


_OF_ONE_KIND: Mapping[str, str] = {
    unit: kinds[0]
    for unit in frozenset(text for kind in SENSOR_KINDS for text in UNITS[kind])
    if len(kinds := [kind for kind in (*SENSOR_KINDS, TIME_KIND) if unit in UNITS[kind]]) == 1
}
"""The kind of sensors of a unit that no other kind has."""
_ACCEL_ONLY = _spelt(ACCEL, "m/s^2", "g", "mg", "cm/s^2", "mm/s^2")
_GYRO_ONLY = _spelt(GYRO, "rad/s", "deg/s", "mdeg/s", "0.1 deg/s", "deg/h")

_UNITS_OF_OTHERS = frozenset((
    "a", "ah", "ma", "mah", "w", "mw", "m", "km", "cm", "mm", "ft", "km/h", "kmh", "kph", "kts", "mph", "pa", "hpa",
    "kpa", "bar", "mbar", "lux", "lx", "hz", "bpm", "ppm", "kg", "db", "dbm", "%",
))  # fmt: skip
"""Units that no sensor here has."""

PATTERNS: tuple[Pattern, ...] = (
    _row(
        ACCEL, 8.0,
        r"^(?!.*(angular|(?<!including_)grav|free|user|bias|variance|(^|_)lacc)).*(acc|force|delta_?vel)|"
        r"(^|_)(a|fb?|la|d(el(ta)?_?)?v|a_rs_s)\d*$",
    ),
    _row(
        GYRO, 8.0,
        r"^(?!.*(bias|drift|variance)).*(gyr|angular_?vel|angl?_?vel|ang(ular)?_?rate|rate_of_(rotation|turn)|omega|"
        r"delta_?ang|dtheta)|"
        r"(^|_)(wb?|gy?|av|as|rate|angular|d(el(ta)?_?)?th(eta)?|w_rs_s)\d*$",
    ),
    _row(MAGNETOMETER, 8.0, r"mag|compass|(^|_)(m|h|b)$"),
    # what a unit alone tells
    _row(GYRO, 7.0, "", _GYRO_ONLY),
    _row(MAGNETOMETER, 7.0, "", UNITS[MAGNETOMETER].keys() - UNITS[ACCEL].keys() - {"t"}),
    _row(ACCEL, 7.0, "^$", _ACCEL_ONLY),
    # what a phone or a filter made of the readings is taken where nothing else is there
    *(_row(kind, -2.0, r"lin|world|earth|motion") for kind in SENSOR_KINDS),
    *(_row(kind, 1.0, r"including_grav") for kind in SENSOR_KINDS),
    # along x, y and z by what these are in a vehicle, the direction first; p, q, r are rates in the mechanics of flight
    *(
        _row(ACCEL, 5.0, rf"^({words})_(imu_)?acc(el(eration|erometer)?)?$", axis=axis)
        for axis, words in (
            ("x", "longitudinal|long|longit|forward|surge"),
            ("y", "lateral|lat|transverse|sway"),
            ("z", "vertical|vert|heave"),
        )
    ),
    *(
        _row(
            GYRO, 5.0, rf"^({letter}|{word}_((imu|body)_)?((ang(ular)?_?)?(rate|vel(ocity)?|speed)|gyro?(scope)?))$",
            axis=axis,
        )
        for axis, letter, word in (("x", "p", "roll"), ("y", "q", "pitch"), ("z", "r", "yaw"))
    ),
    _row(
        TIME_KIND, 8.0,
        r"(^|_)(t|ts|times?|time_?stamps?|stamp|seconds?|secs?|minutes|hours|time_boot|header_stamp|elapsed|ms|us|millis(econds)?|"
        r"micros(econds)?|device_?time_?stamp|time_?startup|time_?stamp_?sample|realtime_?nanos|since_?reboot|"
        r"up_?time(_[a-z]+)?|(sensor|imu|chip|sys|system|gps|sample|date|utc|matlab|unix|epoch|cpu)_?time(_?stamp)?"
        r"(_?fine)?|sample_?time_?fine)$|^time_(since|elapsed|from)|^elapsed_time",
    ),
    # of the samples, and not of their arrival
    _row(
        TIME_KIND, 1.0,
        r"header_stamp|(^|_)stamp$|time_?stamp_?sample|elapsed_?realtime|since_?reboot|"
        r"(device|sensor|imu|chip|board)_?time",
    ),
    _row(INTERVAL, 8.0, r"(^|_)(d_?t|delta_?t|delta_?time|time_?delta|(sample_?)?interval)(_[munµ]?s(ec)?)?$"),
    _row(
        OTHER, 8.0,
        r"quat|attitude|orientation|euler|roll|pitch|yaw|heading|grav|user|(^|_)(lin|lacc)|mag|compass|variance|bias|"
        r"drift|(^|_)calib(_|$)|(^|_)(lat|lon|lng|alt|depth|height|position|location|pos)|vel(ocity)?(_|$)|press|baro|"
        r"status|(^|_)q[wxyz0-3]?$",
    ),
    # gyros are recognised by their names before
    _row(OTHER, 7.0, "", {*_GYRO_ONLY, *(UNITS[MAGNETOMETER].keys() - UNITS[ACCEL].keys()), *_UNITS_OF_OTHERS}),
)  # fmt: skip
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

_WORDS: tuple[tuple[str, str], ...] = (
    # ~ are further letters of a word, but for an axis at its end
    # units first: they stand in brackets or behind a comma
    (r"м\s*/\s*с\s*(\^?2|²|\*\*2)|м\s*/\s*с\s*/\s*с|米/秒\^?[2²]", "m/s^2"),
    (r"(град|°|гр)\.?\s*/\s*(с(ек)?\b|s)|度/秒", "deg/s"),
    (r"рад\s*/\s*с(ек)?", "rad/s"),
    (r"grad\s*/\s*s", "deg/s"),
    (r"\bмкс\b|微秒", "us"),
    (r"\bмс\b|毫秒", "ms"),
    (r"(?<=[\[(,])\s*с(ек)?\.?\s*(?=[\])]|$)|(?<=[\[(])秒(?=[\])])", "s"),
    # what is measured
    (r"угл~\.?[\s_]*скор~|кутов~[\s_]*швидк~|гироскоп~|гіроскоп~|\bдус\b", " gyro "),
    (r"角速度|陀螺仪?|角速率", " gyro "),
    (r"winkelgeschw~|winkelrate|drehrate~|drehgeschw~|gyroskop~|kreisel~", " gyro "),
    (r"(?<![^\W_])dreh(?=[xyz]?(?![^\W_]))", " gyro "),
    (r"vitesse[\s_]*angulaire|velocidad[\s_]*angular|rate[\s_]*of[\s_]*turn|rotation[\s_]*rate", " gyro "),
    (r"(?<![^\W_])giro(sc[oó]pio?s?|scop[ei])?(?![^\W_\d]{2})", " gyro "),
    (r"ускор~|акселер~|прискор~|кажущ~", " acc "),
    (r"加速度计?|比力", " acc "),
    (r"beschl(eunigung~)?", " acc "),
    (r"acc?el[eé]rom[eè]t(ro|re)s?|accelerazion[ei]|acc[eé]l[eé]ration", " acc "),
    (r"(?<![^\W_])acel(eraci[oó]n|era[cç][aã]o|er[oô]metros?)?(?![^\W_\d]{2})", " acc "),
    (r"магнит~|магніт~|磁场|磁力|地磁|magnetfeld~", " mag "),
    (r"температур~|温度|temperatur(?!e)", " temperature "),
    (r"\bврем~|\bчас\b|时间戳?|\bzeit(stempel)?\b|\btemps\b|\btiempo\b|系统时间", " time "),
    (r"\bпо\b|\bоси\b|\bосі\b|\bвісь\b|\bось\b|\bachse\b|轴", " "),
    (r"(?<![а-яіїєё])[хХ](?![а-яіїєё])", "x"),
    (r"(?<![а-яіїєё])[уУ](?![а-яіїєё])", "y"),
)  # fmt: skip
_PER_SECOND = (
    (re.compile(r"(?<=[a-z][XYZ])Mps2$"), " mps2"),
    (re.compile(r"(?<=[a-z][XYZ])RadPerSec$"), " radps"),
    (re.compile(r"(?<=[a-z][XYZ])MicroT$"), " ut"),
    (re.compile(r"[ _]times[ _]g$"), " [g]"),
    (re.compile(r"^(.*gyro?s?(?:_?[xyzXYZ])?_)(rad|deg)(?=[_\[]|$)"), r"\1\2ps"),  # a rate, as PX4 writes it
    (re.compile(r"^scaledAccel([XYZ])$"), r"accel \1 [g]"),  # of MicroStrain
    (re.compile(r"^scaledGyro([XYZ])$"), r"gyro \1 [rad/s]"),
    (re.compile(r"(?<![a-z])rad(ian)?s?[_ ]per[_ ]s(ec(ond)?)?(?=$|[\])])", re.IGNORECASE), "radps"),
    (re.compile(r"(?<![a-z])deg(ree)?s?[_ ]per[_ ]s(ec(ond)?)?(?=$|[\])])", re.IGNORECASE), "degps"),
    (
        re.compile(r"(?<![a-z])m(et(er|re)s?)?[_ ]per[_ ]s(ec(ond)?)?[_ ]?(2|squared)(?=$|[\])])", re.IGNORECASE),
        "mps2",
    ),
)
_LETTERS = r"[^\W\d_]*?(?=[xyz]?(?![^\W\d_]))"
_PATTERNS = (
    *((re.compile(pattern.replace("~", _LETTERS), re.IGNORECASE), word) for pattern, word in _WORDS),
    *_PER_SECOND,
)


def in_words_of_the_table(name: str) -> str:
    """A column's name with the words of other languages replaced, and units that are spelt in words, `deg_per_s`, in
    their short form, `degps`."""
    for pattern, word in _PATTERNS:
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
