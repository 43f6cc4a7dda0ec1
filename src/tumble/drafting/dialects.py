"""Text logs that are no table of numbers, copied as tables into the session's folder: a function for each form, which
reads a line of it, or recognises it in the first lines of a log.

Forms with the values of all columns in a line, or in several:

* sentences with a checksum;
* names before the values: `ax=0.01 ay=-0.02`, `acc: 0.1, 0.2, 9.8; gyro: …`, `Acc (mg) [ 12.2, …`, `Rotation X: 0.01,
  Y: -0.02, Z: 0.00 rad/s`, `GYRO: X=0.01, Y=-0.02, Z=0.00, ACCEL: X=…`;
* samples of several such lines, as `rostopic echo` prints messages: a name stands for what is above it too,
  `angular_velocity:` and then `x: 0.1` further in, and a sample ends where a name comes again;
* objects of JSON, `{"ts": 0.01, "acc": [0.1, 0.2, 9.8], "gyro": {"x": 0, …}}`: a list of three numbers is three
  columns, an object within an object has its name before its own;
* rows in brackets or behind the clock of a serial monitor, and marks between thousands.

Forms with a line for each sensor, `ACC,1200,0.01,0.02,9.81` and then `GYRO,1202,…`, become a table for each. A line
that a form does not read is copied as it is, for the reader to report.
"""

from __future__ import annotations

import json
import re
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from functools import reduce
from itertools import islice, pairwise
from operator import xor
from pathlib import Path
from typing import IO, Any

from tumble.errors import InputError
from tumble.files import OutputFolder, plain_name, whole_file
from tumble.recording.columns.names import ACCEL, GYRO, SENSOR_WORDS, columns_by_name
from tumble.recording.log_source import readable
from tumble.recording.text.dialect import Dialect, dialect_of, encoding_of, is_clock
from tumble.recording.text.pieces import opened

_SEEN_LINES = 200
_LEAST_NUMBERS = 3
_LONGEST_LINE = 4096
_MOST_SENSORS = 20
_SHARE = 0.8
"""Of the lines, that are written alike."""


LineRead = tuple[str, tuple[str, ...], Sequence[str]]
"""What kind of line it is, in words, the names of its columns, none where it names none, and its values."""
Rows = Iterator[tuple[str, Sequence[str]]]
"""The sensor of each row, "" for all together, and its values."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TextForm:
    """How a text log is written: the `rows` in its lines, the `names` of the columns by sensor, and the form in words,
    "" where nothing is to be said."""

    rows: Callable[[Iterable[str]], Rows]
    names: Mapping[str, Sequence[str]] = field(default_factory=dict)
    title: str = ""


def alike(lines: Sequence[str], read: Callable[[str], LineRead | None], title: str) -> TextForm | None:
    """The form of lines of which most are read as one kind, with the same names and as many values; None otherwise."""
    counts = Counter((kind, names, len(values)) for kind, names, values in filter(None, map(read, lines)))
    if not counts:
        return None
    (kind, names, width), count = counts.most_common(1)[0]
    filled = sum(bool(line.strip()) for line in lines)
    if (width < _LEAST_NUMBERS and names) or count <= max(_SHARE * filled, 1):
        return None

    def rows(lines: Iterable[str]) -> Rows:
        for line in lines:
            found = read(line)
            row = ",".join(found[2]) if found and (*found[:2], len(found[2])) == (kind, names, width) else ""
            yield "", [row or line.replace(",", " ")]

    named = f" ({', '.join(names)})" if names else ""
    return TextForm(rows=rows, names={"": names}, title=f"{title}{kind}{named}")


# -------------------- what a line says --------------------

_MAG = tuple(f"Mag{axis} [gauss]" for axis in "XYZ")
_INERTIAL = (*(f"Accel{axis} [m/s^2]" for axis in "XYZ"), *(f"Gyro{axis} [rad/s]" for axis in "XYZ"))
_FIELDS = {
    "VNYMR": ("Yaw", "Pitch", "Roll", *_MAG, *_INERTIAL),
    "VNQMR": ("Qx", "Qy", "Qz", "Qw", *_MAG, *_INERTIAL),
    "VNIMU": (*_MAG, *_INERTIAL, "Temperature [degC]", "Pressure [kPa]"),
    "VNMAR": (*_MAG, *_INERTIAL),
}
"""Fields of VectorNav's sentences (reference of the VN-100, asynchronous output); others have none."""

_SENTENCE = re.compile(r"\s*([$#%])((\w+),[^*]*)\*([0-9A-Fa-f]{2}|[0-9A-Fa-f]{8})\s*")
_NOVATEL_RAW = re.compile("RAWIMUS?X?A")
_RAW_INCREMENTS = ("GPS time [s]", *(f"{kind} {axis} [count]" for kind in ("accel", "gyro") for axis in "xyz"))


def sentence(line: str) -> LineRead | None:
    """A sentence with a checksum, `$VNYMR,…*6D` or NovAtel's `%RAWIMUSXA,…;…*a5db8c7b`; None for a damaged one."""
    found = _SENTENCE.fullmatch(line)
    if found is None:
        return None
    mark, text, kind, check = found.groups()
    body = text.encode()
    if int(check, 16) != (reduce(xor, body, 0) if mark == "$" else ~zlib.crc32(body, 0xFFFFFFFF) & 0xFFFFFFFF):
        return None
    names, values = _FIELDS.get(kind, ()), re.split("[,;]", text)[1:]
    if _NOVATEL_RAW.fullmatch(kind) and len(values) >= 8:
        seconds, _, *increments = values[-8:]
        x, minus_y, z = (increments[at::3] for at in (2, 1, 0))  # of accelerometers and gyros
        y = [value.removeprefix("-") if value.startswith("-") else f"-{value}" for value in minus_y]
        names, values = _RAW_INCREMENTS, [seconds, x[0], y[0], z[0], x[1], y[1], z[1]]
    return (
        (f" {mark}{kind}", names, values) if len(values) >= _LEAST_NUMBERS and len(names) in (0, len(values)) else None
    )


def json_object(line: str) -> LineRead | None:
    """An object of JSON, or as Python prints it."""
    text = line.strip().removeprefix("[").removesuffix("]").strip().removesuffix(",")
    for written in (text, text.replace("'", '"')) if text.startswith("{") and len(text) < _LONGEST_LINE else ():
        with suppress(ValueError, RecursionError):
            values = dict(_values(json.loads(written)))
            return "", tuple(values), list(values.values())
    return None


def _values(read: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, str]]:
    """Names and values of an object and its parts: numbers, also as text, and times of day."""
    for key, value in read.items():
        name = before + re.sub('[,"\\s]+', " ", key)
        if isinstance(value, dict):
            yield from _values(value, f"{name}_")
        elif isinstance(value, list) and len(value) == 3:
            yield from _values(dict(zip("xyz", value, strict=True)), f"{name}_")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield name, repr(value)
        elif isinstance(value, str) and (is_clock(value) or Dialect().is_number(value)):
            yield name, value


_BRACKETED = re.compile(r"\s*[\[({][-+.\d\seE,;\[\](){}]*[\])}]\s*[,;]?\s*")
_MONITORED = re.compile(r"\s*(\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?)\s*->\s*(.*)")


def in_brackets(line: str) -> LineRead | None:
    """A row in brackets."""
    return ("", (), [re.sub(r"[\[\](){}]", "", line).strip(" \t,;")]) if _BRACKETED.fullmatch(line) else None


def behind_a_clock(line: str) -> LineRead | None:
    """A row behind the clock of a serial monitor, `13:02:11.345 -> 0.1,…`, which becomes the first column."""
    found = _MONITORED.fullmatch(line)
    if found is None:
        return None
    clock, rest = found.groups()
    delimiter = next((mark for mark in "\t;," if mark in rest), " ")
    return "", (), [f"{clock if rest[:1] in '+-.0123456789' else 'clock'}{delimiter}{rest}"]


# -------------------- names before the values --------------------

# A word is looked at from its first letter, and once: a line of nothing but letters takes no longer than another one.
_KEY = re.compile(
    r"(?<![^\W\d])([^\W\d][\w.]*+)\s*(?:\(\s*([^()\d]+?)\s*\)\s*)?(?:[=:]\s*(?=[-+\d.\[(])|(?=\[\s*[-+]?\d+\.))"
)
_GROUP = re.compile(r"(?<![^\W\d])([^\W\d]\w*+)\s*(?:\([^()]*\))?\s*:\s*(?=[^\W\d]\w*\s*=)")
_NUMBER = re.compile(r"(?<![\w^/.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_WHEN = re.compile(r"[\s\[\]()>,;|:-]*$")
_WORD = re.compile(r"([^\W\d]\w*)\s+$")
_WORDS = re.compile(r"(?<!\w)([^\W\d]\w*(?:[ \t]+[^\W\d]\w*)*)\s+$")
_UNITS = r"(?:m/s\^?2|rad/s|deg/s|m?dps|m?g)"
_UNIT = re.compile(rf"(?<![^\W\d])\s*({_UNITS})\s*$")
_BEHIND = re.compile(rf"^[-+.,\deE\s]*(?:{_UNITS}(?!\w))?")
"""A number and its unit."""
_ABOVE = re.compile(r"([ \t]*)([^\W\d][\w.]*)\s*:\s*")
_LEAST_NAMES = 6
_TIME = "time"
_QUANTITIES = ("velocity", "acceleration", "rate", "field")


def named_values(line: str) -> LineRead | None:
    """Names, each before its number."""
    named = cells(line)
    return ("", tuple(named), list(named.values())) if named else None


def cells(line: str) -> dict[str, str]:
    """Names and numbers of a line. A time before the first name is one, and a name before three numbers is three.

    An axis has the name of the sensor before several, `GYRO: X=0.1, Y=…`, else the words before it, `Linear Accel X =
    0.1, Y = …`, which also hold for the axes behind it."""
    keys, groups = (list(pattern.finditer(line[:_LONGEST_LINE])) for pattern in (_KEY, _GROUP))
    if not keys:
        return {}
    first = min(name.start() for name in (keys[0], *groups[:1]))
    when = _WHEN.sub("", _WORDS.sub("", line[:first])).strip(" []")
    values = {_TIME: when} if is_clock(when) or _NUMBER.fullmatch(when) else {}
    words, end = "", 0
    for key, after in zip(keys, [*keys[1:], None], strict=True):
        of = [group[1] for group in groups if group.end() <= key.start() and key[0].rstrip().endswith("=")]
        before = _WORDS.search(_BEHIND.sub("", line[end : key.start()]))
        words, end = before[1] if before else words, key.end()
        name = "_".join([*of[-1:], key[1]]) if of or len(key[1]) > 1 else f"{words} {key[1]}".strip()
        numbers = _NUMBER.findall(line[end : after.start() if after else None])
        unit = f" [{key[2]}]" if key[2] else ""
        if len(numbers) == 1:
            values[name + unit] = numbers[0]
        elif len(numbers) == 3:
            word = _WORD.search(line[: key.start()]) if name.lower() in _QUANTITIES else None  # `Angular Velocity: (…)`
            name = f"{word[1]} {name}" if word else name
            values |= {f"{name}_{axis}{unit}": number for axis, number in zip("xyz", numbers, strict=True)}
    return values


def several_lines(lines: Sequence[str]) -> TextForm | None:
    """Samples that are several lines each."""
    seen = list(_samples(lines))
    kinds = Counter(tuple(values) for values, count in seen[1:] if count > 1)
    names, count = kinds.most_common(1)[0] if kinds else ((), 0)
    if len(names) < _LEAST_NAMES or count <= max(_SHARE * (len(seen) - 1), 1):
        return None

    def rows(lines: Iterable[str]) -> Rows:
        return (("", [values.get(name, "") for name in names]) for values, _ in _samples(lines))

    return TextForm(rows=rows, names={"": names}, title=f"several lines a sample ({', '.join(names)})")


def _samples(lines: Iterable[str]) -> Iterator[tuple[dict[str, str], int]]:
    """Samples with their numbers of lines: one ends where a line begins the next."""
    sample: dict[str, str] = {}
    above: list[tuple[int, str]] = []
    count = 0
    for line in lines:
        inside = len(line) - len(line.lstrip())
        above = [(at, name) for at, name in above if at < inside]
        title = _ABOVE.fullmatch(line.rstrip())
        if title is not None:
            above.append((inside, title[2]))
            continue
        unit = _UNIT.search(line[:_LONGEST_LINE])  # behind the last number, and so of all of them
        before, behind = "".join(f"{name}_" for _, name in above), f" [{unit[1]}]" if unit else ""
        values = {f"{before}{name}{behind}": number for name, number in cells(line).items()}
        if values.keys() & sample.keys():
            yield sample, count
            sample, count = {}, 0
        sample = sample | values
        count += bool(values)


# -------------------- marks between thousands --------------------

_THOUSANDS = re.compile("(?<=\\d)['’\u00a0\u202f](?=\\d{3}(?!\\d))")
_QUOTED_THOUSANDS = re.compile(r'"(-?\d{1,3}(?:,\d{3})+(?:\.\d*)?)"')


def thousands(lines: Sequence[str]) -> TextForm | None:
    """Numbers with marks between their thousands, 1'000 or "1,000"."""

    def plain(line: str) -> str:
        return _QUOTED_THOUSANDS.sub(lambda number: number[1].replace(",", ""), _THOUSANDS.sub("", line))

    if sum(plain(line) != line for line in lines) <= 1:
        return None
    return TextForm(
        rows=lambda lines: (("", [plain(line)]) for line in lines), title="marks between thousands, as in 1'000"
    )


# -------------------- a line for each sensor --------------------

_STATED = re.compile(r"^[#%\s]*(?:[^'#%]*')?")
_UNNAMED = ("time", "x", "y", "z")
_WHOLE = re.compile(r"imu\d?", re.IGNORECASE)


def named_in_comments(lines: Sequence[str]) -> TextForm | None:
    """Rows that begin with a word whose columns are named in a comment, `# UncalAccel,utcTimeMillis,…` or `% ACCE data:
    'ACCE;AppTimestamp(s);…'`."""
    stated = [_STATED.sub("", line).rstrip("' ") for line in lines if line.startswith(("#", "%"))]
    rows = [line for line in lines if not line.startswith(("#", "%"))]
    delimiter = max(",;", key=lambda mark: sum(mark in line for line in rows))
    words = {line.partition(delimiter)[0] for line in rows}
    named = {word: names for word, *names in (line.split(delimiter) for line in stated) if word in words}
    kinds = {word: names for word, names in named.items() if {ACCEL, GYRO} & {*columns_by_name(names).triads}}

    def rows_of(lines: Iterable[str]) -> Rows:
        parted = (line[:_LONGEST_LINE].partition(delimiter) for line in lines)
        return ((word, rest.split(delimiter)) for word, _, rest in parted if word in kinds)

    return TextForm(rows=rows_of, names=kinds) if len(kinds) >= 2 else None


def rows_by_sensor(file: Path, start: bytes) -> TextForm | None:
    """Rows with a column that names the sensor; of rows that begin with IMU only these are kept, as they are."""
    dialect_and_top = dialect_of(start)
    if dialect_and_top is None:
        return None
    dialect, top = dialect_and_top
    lines = start.decode(dialect.encoding, errors="replace").split("\n")[top.lines : -1]
    rows = [cells for line in lines if len(cells := dialect.cells(line)) == len(top.names)]
    labels = [j for j in range(len(top.names)) if _are_sensors([cells[j] for cells in rows], dialect)]
    if not labels:
        return None
    label = labels[0]
    words = {cells[label] for cells in rows}
    whole = {word for word in words if _WHOLE.fullmatch(word)}
    names = [name for j, name in enumerate(top.names) if whole or j != label] if dialect.header else []
    if not (whole or names):
        names = list(_UNNAMED)
        if len(top.names) - 1 != len(names):
            raise InputError(
                f"{file}: expected a time and three readings behind the name of a sensor, found {len(top.names) - 1} "
                "columns; give them names in a first line"
            )

    def rows_of(lines: Iterable[str]) -> Rows:
        for line in islice(lines, top.lines, None):
            cells = dialect.cells(line[:_LONGEST_LINE])
            if len(cells) == len(top.names) and (not whole or cells[label] in whole):
                word = cells[label] if whole else cells.pop(label)
                yield word, [cell.replace(",", ".") for cell in cells]

    return TextForm(rows=rows_of, names=dict.fromkeys(words, names))


def _are_sensors(words: Sequence[str], dialect: Dialect) -> bool:
    """Whether cells are names of sensors that take turns: few words, one of them of accelerometers or an IMU."""
    named, changes = Counter(words), sum(a != b for a, b in pairwise(words))
    return (
        2 <= len(named) <= _MOST_SENSORS
        and 4 * changes > len(words)
        and not any(not word or dialect.is_number(word) or is_clock(word) for word in named)
        and any(SENSOR_WORDS[ACCEL].search(word) or _WHOLE.fullmatch(word) for word in named)
    )


# -------------------- copies --------------------


def form_of(lines: Sequence[str]) -> TextForm | None:
    """The form of which these are the first lines of a log; None for a table, and rows of several sensors."""
    if (commented := named_in_comments(lines)) is not None:
        return commented
    first = lines[:_SEEN_LINES]
    return (
        alike(first, sentence, "sentences")
        or alike(first, json_object, "objects of JSON")
        or several_lines(first)
        or alike(first, named_values, "names before the numbers")
        or alike(first, in_brackets, "rows in brackets")
        or alike(first, behind_a_clock, "rows behind the clock of a serial monitor")
        or thousands(first)
    )


def as_tables(file: Path, start: bytes, folder: OutputFolder) -> tuple[list[Path], tuple[str, ...]] | None:
    """Copy a text log of one of the forms, of which these are the first bytes, into a folder: the table or one for each
    sensor, and remarks; None for a log that can be read as it is. Raises InputError for rows of too many sensors."""
    encoding = encoding_of(start)
    text = start.decode(encoding, errors="replace")
    form = form_of(re.split("[\r\n]+", text)[:-1])
    if form is None and text.count("\r") > 2 and "\n" not in text:
        form = TextForm(
            rows=lambda lines: (("", [line]) for line in lines), title="lines that end in a carriage return"
        )
    form = form or rows_by_sensor(file, start)
    if form is None:
        return None
    files: dict[str, Path] = {}
    outs: dict[str, IO[bytes]] = {}
    with ExitStack() as stack, readable(file), opened(file, encoding) as stream:
        for sensor, values in form.rows(_lines(iter(lambda: stream.read(1 << 16), b""))):
            word = plain_name(sensor) if sensor else ""
            if word not in files:
                if len(files) == _MOST_SENSORS:
                    raise InputError(f"{file}: expected at most {_MOST_SENSORS} sensors, found more")
                files[word] = folder.new_file(f"{file.name.partition('.')[0]}{f'-{word}' if word else ''}.csv")
                outs[word] = stack.enter_context(stack.enter_context(whole_file(files[word])).open("wb"))
                if header := ",".join(form.names.get(sensor, ())):
                    outs[word].write(f"{header}\n".encode())
            outs[word].write(",".join(values).encode() + b"\n")
    tables = list(files.values())
    return tables, (f"text: {form.title}: copied to {tables[0].name} as a table",) if form.title else ()


def _lines(pieces: Iterator[bytes]) -> Iterator[str]:
    """Lines, whatever they end with."""
    rest = b""
    for piece in pieces:
        *whole, rest = (rest + piece).replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
        yield from (line.decode(errors="replace") for line in whole)
        rest = rest[:_LONGEST_LINE]
    if rest.strip():
        yield rest.decode(errors="replace")
