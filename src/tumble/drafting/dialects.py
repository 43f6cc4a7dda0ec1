"""Conversion of text logs that are no tables of numbers to tables in the session's folder.

Each form of text has a parser of its lines, which returns names and values, or a function that recognises it in the
first lines of a log. Forms with the values of all columns in a line:

* sentences with a checksum;
* names before the values: `ax=0.01 ay=-0.02`, `acc: 0.1, 0.2, 9.8; gyro: …`, `Acc (mg) [ 12.2, …`, `Rotation X: 0.01,
  Y: -0.02, Z: 0.00 rad/s`, `GYRO: X=0.01, Y=-0.02, Z=0.00, ACCEL: X=…`;
* samples of several such lines, as `rostopic echo` and Adafruit's sketches print them: a title such as
  `angular_velocity:` precedes the names that are indented below it, and a sample ends where a name is repeated;
* objects of JSON, `{"ts": 0.01, "acc": [0.1, 0.2, 9.8], "gyro": {"x": 0, …}}`: a list of three numbers is three
  columns, and names of inner objects follow that of the outer one;
* rows in brackets or behind the clock of a serial monitor, and marks between thousands.

Forms with a line for each sensor, `ACC,1200,0.01,0.02,9.81` and then `GYRO,1202,…`, become a table for each. Lines that
do not match the form are copied unchanged, so that the reader of tables reports them.
"""

from __future__ import annotations

import json
import re
import tomllib
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
from tumble.recording.columns.names import ACCEL, NAMED
from tumble.recording.log_source import readable
from tumble.recording.text.clock import is_clock
from tumble.recording.text.dialect import Dialect, dialect_of, encoding_of
from tumble.recording.text.pieces import opened

_FORMS: Mapping[str, Any] = tomllib.loads(Path(__file__).with_name("forms.toml").read_text(encoding="utf-8"))
_PATTERN: Mapping[str, re.Pattern[str]] = {name: re.compile(text) for name, text in _FORMS["patterns"].items()}
_SOME_LINES = 200
_FEWEST_NUMBERS = 3
_LONGEST_LINE = 4096  # characters
_MOST_SENSORS = 20
_ALIKE_SHARE = 0.8  # of the first lines
_FEWEST_NAMES = 6  # of a sample of several lines
_TIME = "time"
_QUANTITIES = ("velocity", "acceleration", "rate", "field")  # names that the word before them completes
_UNNAMED = ("time", "x", "y", "z")  # of the columns behind the name of a sensor


ParsedLine = tuple[str, tuple[str, ...], Sequence[str]]
"""Kind of a line in words, names of its columns, empty if it has none, and its values."""
Rows = Iterator[tuple[str, Sequence[str]]]
"""Sensor of each row, "" for all sensors, and the values of the row."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TextForm:
    """Form of a text log: a reader of the rows in its lines, names of the columns by sensor, and a title."""

    rows: Callable[[Iterable[str]], Rows]
    names: Mapping[str, Sequence[str]] = field(default_factory=dict)
    title: str = ""


def uniform_lines(lines: Sequence[str], parse: Callable[[str], ParsedLine | None], title: str) -> TextForm | None:
    """Return the form of lines if most of them parse as one kind with equal names and numbers of values; else None."""
    counts = Counter((kind, names, len(values)) for kind, names, values in filter(None, map(parse, lines)))
    if not counts:
        return None
    (kind, names, width), count = counts.most_common(1)[0]
    filled = sum(bool(line.strip()) for line in lines)
    if (width < _FEWEST_NUMBERS and names) or count <= max(_ALIKE_SHARE * filled, 1):
        return None

    def rows(lines: Iterable[str]) -> Rows:
        started = not names
        for line in lines:
            parsed = parse(line)
            matches = parsed is not None and (*parsed[:2], len(parsed[2])) == (kind, names, width)
            row = ",".join(parsed[2]) if parsed is not None and matches else ""
            started |= matches
            if started:  # boot messages are above the first row
                yield "", [row or (line.replace(",", " ") if names else line)]

    listed = f" ({', '.join(names)})" if names else ""
    return TextForm(rows=rows, names={"": names}, title=f"{title}{kind}{listed}")


def sentence(line: str) -> ParsedLine | None:
    """Parse a sentence with a checksum, `$VNYMR,…*6D`; None if damaged."""
    match = _PATTERN["sentence"].fullmatch(line)
    if match is None or int(match[3], 16) != reduce(xor, match[1].encode(), 0):
        return None
    kind, names, values = match[2], tuple(_FORMS["sentences"].get(match[2], ())), match[1].split(",")[1:]
    is_row = len(values) >= _FEWEST_NUMBERS and len(names) in (0, len(values))
    return (f" ${kind}", names, values) if is_row else None


def json_object(line: str) -> ParsedLine | None:
    """Parse an object of JSON, or of Python."""
    text = line.strip().removeprefix("[").removesuffix("]").strip().removesuffix(",")
    for written in (text, text.replace("'", '"')) if text.startswith("{") and len(text) < _LONGEST_LINE else ():
        with suppress(ValueError, RecursionError):
            values = dict(_flattened(json.loads(written)))
            return "", tuple(values), list(values.values())
    return None


def _flattened(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield names and values of an object and its parts: numbers, also as text, and times of day."""
    for key, value in content.items():
        name = prefix + re.sub('[,"\\s]+', " ", key)
        if isinstance(value, dict):
            yield from _flattened(value, f"{name}_")
        elif isinstance(value, list) and len(value) == 3:
            yield from _flattened(dict(zip("xyz", value, strict=True)), f"{name}_")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield name, repr(value)
        elif isinstance(value, str) and (is_clock(value) or Dialect().is_number(value)):
            yield name, value


def row_in_brackets(line: str) -> ParsedLine | None:
    """Parse a row in brackets."""
    return ("", (), [re.sub(r"[\[\](){}]", "", line).strip(" \t,;")]) if _PATTERN["bracketed"].fullmatch(line) else None


def row_behind_clock(line: str) -> ParsedLine | None:
    """Parse a row behind the clock of a serial monitor, `13:02:11.345 -> 0.1,…`, which becomes the first column."""
    match = _PATTERN["monitored"].fullmatch(line)
    if match is None:
        return None
    clock, rest = match.groups()
    delimiter = next((mark for mark in "\t;," if mark in rest), " ")
    return "", (), [f"{clock if rest[:1] in '+-.0123456789' else 'clock'}{delimiter}{rest}"]


def row_before_semicolon(line: str) -> ParsedLine | None:
    """Parse a row that ends with a semicolon, which does not separate its values."""
    return ("", (), [line.rstrip("; \t")]) if line.count(";") == 1 and line.rstrip().endswith(";") else None


def named_values(line: str) -> ParsedLine | None:
    """Parse a line of names, each followed by its number or its three numbers."""
    values = values_by_name(line)
    return ("", tuple(values), list(values.values())) if values else None


def values_by_name(line: str) -> dict[str, str]:
    """Return the numbers of a line by the names before them, with a time before the first name if there is one.

    The name of an axis is completed by that of the sensor before several axes, `GYRO: X=0.1, Y=…`, else by the words
    before it, `Linear Accel X = 0.1, Y = …`, which also apply to the following axes."""
    keys, groups = (list(pattern.finditer(line[:_LONGEST_LINE])) for pattern in (_PATTERN["key"], _PATTERN["group"]))
    if not keys:
        return {}
    first = min(name.start() for name in (keys[0], *groups[:1]))
    when = _PATTERN["after_time"].sub("", _PATTERN["last_words"].sub("", line[:first])).strip(" []")
    values = {_TIME: when} if is_clock(when) or _PATTERN["number"].fullmatch(when) else {}
    words, end = "", 0
    for key, following in zip(keys, [*keys[1:], None], strict=True):
        sensor = [group[1] for group in groups if group.end() <= key.start() and key[0].rstrip().endswith("=")]
        before = _PATTERN["last_words"].search(_PATTERN["number_and_unit"].sub("", line[end : key.start()]))
        words, end = before[1] if before else words, key.end()
        is_axis = not sensor and len(key[1]) == 1
        name = f"{words} {key[1]}".strip() if is_axis else "_".join([*sensor[-1:], key[1]])
        numbers = _PATTERN["number"].findall(line[end : following.start() if following else None])
        unit = f" [{key[2]}]" if key[2] else ""
        if len(numbers) == 1:
            values[name + unit] = numbers[0]
        elif len(numbers) == 3:
            word = _PATTERN["last_word"].search(line[: key.start()]) if name.lower() in _QUANTITIES else None
            name = f"{word[1]} {name}" if word else name  # `Angular Velocity: (…)`
            values |= {f"{name}_{axis}{unit}": number for axis, number in zip("xyz", numbers, strict=True)}
    return values


def samples_of_several_lines(lines: Sequence[str]) -> TextForm | None:
    """Return the form of samples that are several lines each; None for other lines."""
    samples = list(_samples(lines))
    kinds = Counter(tuple(values) for values, count in samples[1:] if count > 1)
    names, count = kinds.most_common(1)[0] if kinds else ((), 0)
    if len(names) < _FEWEST_NAMES or count <= max(_ALIKE_SHARE * (len(samples) - 1), 1):
        return None

    def rows(lines: Iterable[str]) -> Rows:
        return (("", [values.get(name, "") for name in names]) for values, _ in _samples(lines))

    return TextForm(rows=rows, names={"": names}, title=f"several lines a sample ({', '.join(names)})")


def _samples(lines: Iterable[str]) -> Iterator[tuple[dict[str, str], int]]:
    """Yield samples with their numbers of lines; a sample ends where a name is repeated."""
    sample: dict[str, str] = {}
    titles: list[tuple[int, str]] = []  # indents and titles above the line
    count = 0
    for line in lines:
        indent = len(line) - len(line.lstrip())
        titles = [(at, name) for at, name in titles if at < indent]
        title = _PATTERN["title"].fullmatch(line.rstrip())
        if title is not None:
            titles.append((indent, title[1]))
            continue
        unit = _PATTERN["last_unit"].search(line[:_LONGEST_LINE])  # of all numbers in the line
        prefix, suffix = "".join(f"{name}_" for _, name in titles), f" [{unit[1]}]" if unit else ""
        values = {f"{prefix}{name}{suffix}": number for name, number in values_by_name(line).items()}
        if values.keys() & sample.keys():
            yield sample, count
            sample, count = {}, 0
        sample = sample | values
        count += bool(values)


def thousands(lines: Sequence[str]) -> TextForm | None:
    """Return the form of numbers with marks between their thousands, 1'000 or "1,000"."""

    def plain(line: str) -> str:
        return _PATTERN["quoted_thousands"].sub(
            lambda number: number[1].replace(",", ""), _PATTERN["thousands"].sub("", line)
        )

    if sum(plain(line) != line for line in lines) <= 1:
        return None
    title = "marks between thousands, as in 1'000"
    return TextForm(rows=lambda lines: (("", [plain(line)]) for line in lines), title=title)


def rows_by_sensor(file: Path, start: bytes) -> TextForm | None:
    """Return the form of rows with a column that names the sensor; if some are of an IMU, only these rows are kept."""
    dialect_and_top = dialect_of(start)
    if dialect_and_top is None:
        return None
    dialect, top = dialect_and_top
    lines = start.decode(dialect.encoding, errors="replace").split("\n")[top.lines : -1]
    rows = [cells for line in lines if len(cells := dialect.cells(line)) == len(top.names)]
    for label in range(len(top.names)):
        column = [cells[label] for cells in rows]
        words, changes = set(column), sum(a != b for a, b in pairwise(column))
        if (
            2 <= len(words) <= _MOST_SENSORS
            and 4 * changes > len(column)
            and not any(not word or dialect.is_number(word) or is_clock(word) for word in words)
            and any(NAMED[ACCEL].search(word) or _PATTERN["imu"].fullmatch(word) for word in words)
        ):
            break  # alternating names of sensors
    else:
        return None
    imu_words = {word for word in words if _PATTERN["imu"].fullmatch(word)}
    names = [name for j, name in enumerate(top.names) if imu_words or j != label] if dialect.header else []
    if not (imu_words or names):
        names = list(_UNNAMED)
        if len(top.names) - 1 != len(names):
            raise InputError(
                f"{file}: expected a time and three readings behind the name of a sensor, found {len(top.names) - 1} "
                "columns; give them names in a first line"
            )

    def rows_of(lines: Iterable[str]) -> Rows:
        for line in islice(lines, top.lines, None):
            cells = dialect.cells(line[:_LONGEST_LINE])
            if len(cells) == len(top.names) and (not imu_words or cells[label] in imu_words):
                word = cells[label] if imu_words else cells.pop(label)
                yield word, [cell.replace(",", ".") for cell in cells]

    return TextForm(rows=rows_of, names=dict.fromkeys(words, names))


def form_of(lines: Sequence[str]) -> TextForm | None:
    """Return the form of the lines of a log, by the last of them, which are below boot messages; None for a table, and
    for rows with a column that names a sensor."""
    last = lines[-_SOME_LINES:]
    return (
        uniform_lines(last, sentence, "sentences")
        or uniform_lines(last, json_object, "objects of JSON")
        or (samples_of_several_lines(last) and samples_of_several_lines(lines[:_SOME_LINES]))  # from their first line
        or uniform_lines(last, named_values, "names before the numbers")
        or uniform_lines(last, row_in_brackets, "rows in brackets")
        or uniform_lines(last, row_behind_clock, "rows behind the clock of a serial monitor")
        or thousands(last)
        or uniform_lines(last, row_before_semicolon, "semicolons that end rows")
    )


def copy_as_tables(file: Path, start: bytes, folder: OutputFolder) -> tuple[list[Path], tuple[str, ...]] | None:
    """Copy a text log of one of the forms, with the first bytes `start`, as a table or as one table per sensor.

    Returns the copies and remarks; None for a log that can be read directly. Raises InputError for too many sensors."""
    encoding = encoding_of(start)
    form = form_of(re.split("[\r\n]+", start.decode(encoding, errors="replace"))[:-1]) or rows_by_sensor(file, start)
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
    """Yield the lines in successive pieces of a text, with any line ends."""
    rest = b""
    for piece in pieces:
        *whole, rest = (rest + piece).replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
        yield from (line.decode(errors="replace") for line in whole)
        rest = rest[:_LONGEST_LINE]
    if rest.strip():
        yield rest.decode(errors="replace")
