"""What columns are, by their names: times, accelerometers, gyros, magnetometers, temperatures, and their units.

A name such as `imu.acc_x [g]`, `linear_acceleration.y` or `gyrz_dps` falls into words and a unit; a single letter or
number among the words, or at the end of one, is the axis, and the rest says which sensor it is.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from tumble.recording.columns.native_words import in_english
from tumble.recording.columns.thermometers import of_sensors, thermometer
from tumble.recording.formats.message import Sensors

ACCEL, GYRO, MAGNETOMETER, TIME_KIND = "accel", "gyro", "mag", "time"

_KINDS: Mapping[str, re.Pattern[str]] = {
    ACCEL: re.compile(
        r"^(?!.*(angular|(?<!including_)grav|free|user|bias|variance|(^|_)lacc)).*(acc|force|delta_?vel)|"
        r"(^|_)(a|fb?|la|d(el(ta)?_?)?v|a_rs_s)\d*$"
    ),
    GYRO: re.compile(
        r"^(?!.*(bias|drift|variance)).*(gyr|angular_?vel|angl?_?vel|ang(ular)?_?rate|rate_of_(rotation|turn)|omega|"
        r"delta_?ang|dtheta)|"
        r"(^|_)(wb?|gy?|av|as|rate|angular|d(el(ta)?_?)?th(eta)?|w_rs_s)\d*$"
    ),
    MAGNETOMETER: re.compile(r"mag|compass|(^|_)(m|h|b)$"),
}
SENSOR_WORDS: Mapping[str, re.Pattern[str]] = {
    ACCEL: re.compile(r"acc|beschl|ускор|加速度", re.IGNORECASE),
    GYRO: re.compile(r"gyr|angular|dreh|гиро|角速度|陀螺", re.IGNORECASE),
}
"""Words for sensors in the names of files, and of rows."""

_NO_SENSOR = re.compile(
    r"quat|attitude|orientation|euler|roll|pitch|yaw|heading|grav|user|(^|_)(lin|lacc)|mag|compass|variance|bias|drift|(^|_)calib(_|$)|"
    r"(^|_)(lat|lon|lng|alt|depth|height|position|location|pos)|vel(ocity)?(_|$)|press|baro|status|(^|_)q[wxyz0-3]?$"
)
_WITHOUT_GRAVITY = re.compile(r"lin|world|earth|motion")
"""Words for what a phone or a filter made of the readings, taken where nothing else is there."""

_TIME = re.compile(
    r"(^|_)(t|ts|times?|time_?stamps?|stamp|seconds?|secs?|time_boot|header_stamp|elapsed|ms|us|millis(econds)?|"
    r"micros(econds)?|device_?time_?stamp|time_?startup|time_?stamp_?sample|realtime_?nanos|since_?reboot|up_?time(_[a-z]+)?|(sensor|imu|chip|sys|system|gps|sample|date|utc|matlab|unix|epoch|cpu)_?time(_?stamp)?(_?fine)?|sample_?time_?fine)$|"
    r"^time_(since|elapsed|from)|^elapsed_time"
)
_OF_THE_SAMPLE = re.compile(
    r"header_stamp|(^|_)stamp$|time_?stamp_?sample|elapsed_?realtime|since_?reboot|(device|sensor|imu|chip|board)_?time"
)
"""Times of the samples, and not of their arrival, which are taken where there are several."""

_TIME_WORDS = {
    "seconds": "s", "secs": "s",
    "ms": "ms", "millis": "ms", "milliseconds": "ms",
    "us": "us", "micros": "us", "microseconds": "us",
    "ns": "ns", "nanos": "ns", "nanoseconds": "ns",
}  # fmt: skip
_INTERVAL = re.compile(r"(^|_)(d_?t|delta_?t|delta_?time|time_?delta|(sample_?)?interval)(_[munµ]?s(ec)?)?$")
"""Times from the sample before."""

_COUNTER = re.compile(
    r"(^|_)(packet_?counter|counter|cnt|n_samples|samples?|sample_?(no|number|index)|index|idx|row|seq)$"
)
_TEMPERATURE_UNITS = {
    "c": "degC", "°c": "degC", "degc": "degC", "celsius": "degC", "k": "K", "kelvin": "K", "degk": "K",
    "f": "degF", "°f": "degF", "degf": "degF", "fahrenheit": "degF",
    "raw": "raw", "count": "raw", "counts": "raw", "lsb": "raw", "adc": "raw",
}  # fmt: skip

_DIRECTIONS: Mapping[str, tuple[re.Pattern[str], ...]] = {
    ACCEL: tuple(
        re.compile(rf"({words})_(imu_)?acc(el(eration|erometer)?)?")
        for words in ("longitudinal|long|longit|forward|surge", "lateral|lat|transverse|sway", "vertical|vert|heave")
    ),
    GYRO: tuple(
        re.compile(rf"{letter}|{word}_((imu|body)_)?((ang(ular)?_?)?(rate|vel(ocity)?|speed)|gyro?(scope)?)")
        for letter, word in zip("pqr", ("roll", "pitch", "yaw"), strict=True)
    ),
}
"""Names of sensors along x, y and z by what these are in a vehicle, the direction first; p, q, r are a body's rates in
the mechanics of flight."""
_DIRECTION = re.compile(
    r"roll|pitch|yaw|longitudinal|long|longit|forward|surge|lateral|lat|transverse|sway|vertical|vert|heave"
)

_LETTERS = {"x": "x", "y": "y", "z": "z", "0": "x", "1": "y", "2": "z"}
_COUNTED = {"1": "x", "2": "y", "3": "z"}

_UNITS: Mapping[str, Mapping[str, str]] = {
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
        "t": "T", "tesla": "T", "mgauss": "mgauss", "mg": "mgauss",
    },
    TIME_KIND: {"s": "s", "sec": "s", "ms": "ms", "us": "us", "µs": "us", "ns": "ns"},
}  # fmt: skip


_RATES = ("rad/s", "deg/s", "mdeg/s", "0.1 deg/s", "deg/h")
_FORCES = ("m/s^2", "g", "mg", "cm/s^2", "mm/s^2")
"""Units that nothing but gyros, or but accelerometers, has."""
_OTHER_UNITS = re.compile(r"dbm?|%|m?ah?|[kcm]?m|km/h|kmh|kph|kts|mph|ft|[hk]?pa|m?bar|m?w|lux|lx|hz|bpm|ppm|kg")
"""Units that neither has."""


def _unit(text: str) -> str:
    """A unit as `_UNITS` has it: `m·s⁻²`, `m/sec^2` and `m / s²` are ms-2, m/s2 and m/s2."""
    out = re.sub(
        r"(?<!arc)sec", "s", text.lower().replace("μ", "µ").replace("⁻", "-").replace("²", "2").replace("¹", "1")
    )
    return re.sub(r"[*^·⋅{} ]|\.(?=s)", "", out)


@dataclass(frozen=True, kw_only=True, slots=True)
class Columns:
    """The columns found in a table: the time with its unit (None where the name does not say), one triad of each kind,
    the `temperatures` as [log.temperature] has them, and a column that counts the samples. `others` are the names of
    triads of the same kinds, and of thermometers, that were not taken, `times` those of all times, `interval` that of
    the times from sample to sample."""

    time: str | None
    time_unit: str | None
    triads: Mapping[str, Sensors]
    temperatures: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    counter: str | None = None
    times: tuple[str, ...] = ()
    interval: str | None = None


def columns_by_name(names: Iterable[str]) -> Columns:
    """What the columns of a table are."""
    names = list(names)
    warm = {name: found for name in names if (found := thermometer(_split(name)[0])) is not None}
    triads: dict[str, Sensors] = {}
    others: list[str] = []
    stems = _stems(name for name in names if name not in warm).items()
    for (kind, stem), axes in sorted(stems, key=lambda found: _doubtful(found[0][1])):
        if set(axes) != set("xyz"):
            continue
        if kind in triads:
            others.append(stem)
        else:
            three = axes["x"], axes["y"], axes["z"]
            triads[kind] = Sensors(columns=three, unit=_UNITS[kind].get(_split(three[0])[1]))
    for kind, patterns in _DIRECTIONS.items():
        x, y, z = (next((n for n in names if pattern.fullmatch(_direction_first(n))), None) for pattern in patterns)
        if kind not in triads and x is not None and y is not None and z is not None:
            triads[kind] = Sensors(columns=(x, y, z), unit=_UNITS[kind].get(_split(x)[1]))
    taken = {column for triad in triads.values() for column in triad.columns}
    free = [name for name in names if name and name not in taken]
    interval = next((name for name in free if _INTERVAL.search("_".join(_split(name)[0]))), None)
    times = [n for n in free if n not in ("T", interval) and _TIME.search("_".join(_split(n)[0]))]
    time = next((name for name in times if _OF_THE_SAMPLE.search("_".join(_split(name)[0]))), next(iter(times), None))
    warm = {name: found for name, found in warm.items() if name not in (time, interval)}
    temperatures = of_sensors(warm, gyros=GYRO in triads)
    return Columns(
        time=time,
        time_unit=None if time is None else time_unit(time),
        counter=next((n for n in free if n != time and _COUNTER.search("_".join(_split(n)[0]))), None),
        triads=triads,
        temperatures=temperatures,
        others=(*others, *(name for name in warm if name not in temperatures)),
        times=tuple(times),
        interval=interval,
    )


def _doubtful(stem: str) -> tuple[bool, bool]:
    """How likely it is that a sensor of this name is none: those go first that say they read gravity."""
    return bool(_WITHOUT_GRAVITY.search(stem)), "including_grav" not in stem


def time_unit(name: str) -> str | None:
    """The unit that the name of a time says: `t [ms]` ms, `micros` us; None where it says none."""
    words, unit = _split(name)
    return _UNITS[TIME_KIND].get(unit) or (_TIME_WORDS.get(words[-1]) if words else None)


def unit_of_name(kind: str, name: str) -> str | None:
    """The unit that the name of a column of this kind says: `ax [g]` g, `gyro_x_dps` deg/s; None where it says none.

    >>> unit_of_name("accel", "ax [mg]"), unit_of_name("gyro", "gyro_x")
    ('mg', None)
    """
    return _UNITS[kind].get(_split(name)[1])


def temperature_unit(name: str) -> str | None:
    """The unit that the name of a column of temperatures says; None where it says none.

    >>> temperature_unit("Temp [K]"), temperature_unit("imu_temp_f"), temperature_unit("T")
    ('K', 'degF', None)
    """
    words, unit = _split(name)
    return _TEMPERATURE_UNITS.get(unit or words[-1])


def is_no_sensor(name: str) -> bool:
    """Whether the name of a column says that it is no accelerometer, and no gyro that a name does not tell already.

    >>> [is_no_sensor(name) for name in ("attitude_roll(radians)", "user_acc_x(G)", "RSSI (dB)", "ch3")]
    [True, True, True, False]
    """
    words, unit = _split(name)
    said = "_".join(words)
    timed = name != "T" and bool(_TIME.search(said))
    return (
        bool(_NO_SENSOR.search(said))
        or timed
        or _UNITS[GYRO].get(unit) in _RATES
        or bool(_OTHER_UNITS.fullmatch(unit))
        or (unit in _UNITS[MAGNETOMETER] and unit not in _UNITS[ACCEL])
    )


def in_order(names: Sequence[str]) -> tuple[str, str, str]:
    """Three columns in the order of their axes, where their names differ by these: z, x and y are x, y and z.

    >>> in_order(["rate z", "rate x", "rate y"]), in_order(["z", "y", "x"]), in_order(["4", "5", "6"])
    (('rate x', 'rate y', 'rate z'), ('x', 'y', 'z'), ('4', '5', '6'))
    """
    first = [_axis_and_rest(_split(name)[0]) for name in names]
    of_axis = dict(zip((axis for axis, _ in first), names, strict=True))
    if set(of_axis) == set("xyz") and len({stem for _, stem in first}) == 1:
        names = [of_axis[axis] for axis in "xyz"]
    x, y, z = names
    return x, y, z


def _axis_and_rest(words: list[str]) -> tuple[str, str]:
    """The likeliest reading of a name's words, which may be an axis alone."""
    alone = (words[0], "") if len(words) == 1 and words[0] in ("x", "y", "z") else ("", "")
    return next(iter(_axes(words)), alone)


def _stems(names: Iterable[str]) -> dict[tuple[str, str], dict[str, str]]:
    """Columns by kind and name without the axis, and then by axis."""
    found: dict[tuple[str, str], dict[str, str]] = {}
    for name in names:
        words, unit = _split(name)
        alone = [(words[0], "")] if len(words) == 1 and words[0] in ("x", "y", "z") else []
        for axis, stem in _axes(words) or alone:
            kind = next((kind for kind, pattern in _KINDS.items() if pattern.search(stem)), None)
            if kind is None and _UNITS[GYRO].get(unit) in _RATES:
                kind = GYRO
            if kind is None and not stem and _UNITS[ACCEL].get(unit) in _FORCES:
                kind = ACCEL
            if kind is not None:
                found.setdefault((kind, stem), {}).setdefault(axis, name)
                break
    return found


def _direction_first(name: str) -> str:
    """The words of a name with the direction, where there is one, before the others: roll_rate of `RateRoll`."""
    words = re.sub(r"(roll|pitch|yaw)(?=rate|speed|vel)", r"\1_", "_".join(_split(name)[0])).split("_")
    return "_".join(sorted(words, key=lambda word: not _DIRECTION.fullmatch(word)))


def _axes(words: list[str]) -> list[tuple[str, str]]:
    """Readings of a name's words as (axis, the rest), the likeliest first; none where it has no axis."""
    readings = []
    for at in reversed(range(len(words))):
        word, before, after = words[at], words[:at], words[at + 1 :]
        if word in _LETTERS and before + after:
            readings.append((_LETTERS[word], "_".join(before + after)))
        elif len(word) > 1 and word[-1] in "xyz":
            readings.append((word[-1], "_".join([*before, word[:-1], *after])))
        elif len(word) > 1 and word[0] in "xyz":
            readings.append((word[0], "_".join([*before, word[1:], *after])))
        elif len(word) > 1 and word[-1] in _COUNTED:
            readings.append((_COUNTED[word[-1]], "_".join([*before, word[:-1], *after])))
    return readings


def _split(name: str) -> tuple[list[str], str]:
    """The words of a name in small letters and its unit, if it has one: `AccX (m/s²)` is acc, x and m/s²; `gyr_x_dps`
    gyr, x and dps; `TimeUS` time and us; `gyro[0]` gyro and 0."""
    name = _shortened(in_english(name))
    bracketed = re.search(r"[\[(]\s*(?![xyzXYZ]\s*[\])])([^\])]*[^\])\d\s][^\])]*?)\s*[\])]", name)
    if bracketed:
        return _words(name.replace(bracketed[0], " ")), _unit(bracketed[1])
    behind = re.fullmatch(r"(.*\w)\s*(?:,\s*|\s/\s|\sin\s)([^,]+)", name)
    if behind and _unit(behind[2]) in _ALL_UNITS:
        return _words(behind[1]), _unit(behind[2])
    words = _words(name)
    for count in (2, 1):
        unit = "_".join(words[-count:])
        if len(words) > count and unit in _ALL_UNITS and _stands_for_itself(words[:-count]):
            return words[:-count], unit
        inner = "_".join(words[-count - 1 : -1])
        if len(words) > count + 1 and inner in _ALL_UNITS and len(inner) > 1 and words[-1] in _LETTERS:
            return [*words[: -count - 1], words[-1]], inner
    return words, ""


_PER_SECOND = (
    (re.compile(r"(?<=[a-z][XYZ])Mps2$"), " mps2"),
    (re.compile(r"(?<=[a-z][XYZ])RadPerSec$"), " radps"),
    (re.compile(r"(?<=[a-z][XYZ])MicroT$"), " ut"),
    (re.compile(r"(?<![a-z])rad(ian)?s?[_ ]per[_ ]s(ec(ond)?)?$", re.IGNORECASE), "radps"),
    (re.compile(r"(?<![a-z])deg(ree)?s?[_ ]per[_ ]s(ec(ond)?)?$", re.IGNORECASE), "degps"),
    (re.compile(r"(?<![a-z])m(et(er|re)s?)?[_ ]per[_ ]s(ec(ond)?)?[_ ]?(2|squared)$", re.IGNORECASE), "mps2"),
)


def _shortened(name: str) -> str:
    """A name whose unit is spelt in words, `gyro_x_deg_per_s`, with the short form, `gyro_x_degps`."""
    for pattern, short in _PER_SECOND:
        name = pattern.sub(short, name)
    return name


_ALL_UNITS = frozenset(text for units in _UNITS.values() for text in units if text != "t")


def _stands_for_itself(words: list[str]) -> bool:
    """Whether these words have all that a name needs, an axis or the time, so that the next one can be a unit."""
    return bool(_axes(words)) or bool(_TIME.search("_".join(words)))


def _words(name: str) -> list[str]:
    """`AccX`: acc, x; `TimeUS`: time, us; `mag_uT`: mag, ut; `acc x-axis`: acc, x."""
    words: list[str] = []
    for token in re.split(r"[^A-Za-z0-9µ°²]+", name):
        whole = token.lower() in _ALL_UNITS
        words += [token] if whole else re.split(r"(?<=[a-z])(?=[A-Z])", token)
    words = [word.lower() for word in words if word]
    said = [word for word in words if word != "axis"]
    return said if len(said) > 1 else words
