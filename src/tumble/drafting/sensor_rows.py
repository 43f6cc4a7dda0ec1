"""Text logs in which every row is of one sensor, `ACC,1200,0.01,0.02,9.81` and then `GYRO,1202,…`: a file for each
sensor, which are logs of sensors in files of their own."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path

from tumble.errors import InputError
from tumble.files import OutputFolder, plain_name, whole_file
from tumble.recording.dialect import Dialect, Top, is_clock
from tumble.recording.formats.columns import ACCEL, GYRO, SENSOR_WORDS, columns_by_name
from tumble.recording.log_source import readable
from tumble.recording.text_pieces import opened

_MOST_SENSORS = 20
_LONGEST_LINE = 4096
_STATED = re.compile(r"^[#%\s]*(?:[^'#%]*')?")
_UNNAMED = ("time", "x", "y", "z")


def sensor_column(seen: bytes, dialect: Dialect, top: Top) -> int | None:
    """The column that says of which sensor a row is: names of sensors that change all the time."""
    lines = seen.decode(dialect.encoding, errors="replace").split("\n")[top.lines : -1]
    rows = [row for line in lines if len(row := dialect.cells(line)) == len(top.names)]
    for column in range(len(top.names)):
        words = [row[column] for row in rows]
        changes = sum(a != b for a, b in pairwise(words))
        if 4 * changes > len(words) and are_sensors(words, dialect):
            return column
    return None


def are_sensors(words: Sequence[str], dialect: Dialect) -> bool:
    """Whether the cells of a column are names of sensors: few words, one of which is that of accelerometers."""
    named = Counter(words)
    return (
        2 <= len(named) <= _MOST_SENSORS
        and not any(not word or dialect.is_number(word) or is_clock(word) for word in named)
        and any(SENSOR_WORDS[ACCEL].search(word) for word in named)
    )


def headed_kinds(seen: bytes) -> tuple[str, dict[str, list[str]]]:
    """The names of the columns of rows of each sensor, where comments state them, `# UncalAccel,utcTimeMillis,…` or
    `% ACCE data: 'ACCE;AppTimestamp(s);…'`: of those with accelerometers and gyros, by the word that their rows begin
    with, and the delimiter before. None where they are not apart so."""
    lines = seen.decode(errors="replace").splitlines()
    stated = [_STATED.sub("", line).rstrip("' ") for line in lines if line.startswith(("#", "%"))]
    for delimiter in (",", ";"):
        words = {line.partition(delimiter)[0] for line in lines if not line.startswith(("#", "%"))}
        named = {word: names for word, *names in (line.split(delimiter) for line in stated) if word in words}
        found = {word: names for word, names in named.items() if {ACCEL, GYRO} & set(columns_by_name(names).triads)}
        if len(found) > 1:
            return delimiter, found
    return "", {}


def split_by_header(file: Path, kinds: Mapping[str, Sequence[str]], delimiter: str, folder: OutputFolder) -> list[Path]:
    """The rows of each sensor in a file of its own, with the names that comments state of it."""
    parts = {word: folder.new_file(f"{file.name.partition('.')[0]}-{plain_name(word)}.csv") for word in kinds}
    with ExitStack() as files, readable(file), opened(file) as stream:
        outs = {word: files.enter_context(files.enter_context(whole_file(p)).open("wb")) for word, p in parts.items()}
        for word, names in kinds.items():
            outs[word].write(f"{','.join(names)}\n".encode())
        for line in stream:
            word, _, rest = line[:_LONGEST_LINE].decode(errors="replace").partition(delimiter)
            if word in outs:
                outs[word].write(rest.rstrip("\r\n").replace(delimiter, ",").encode() + b"\n")
    return list(parts.values())


def split_by_sensor(file: Path, dialect: Dialect, top: Top, label: int, folder: OutputFolder) -> list[Path]:
    """The rows of each sensor in a file of its own, with all columns but the label."""
    columns = [j for j in range(len(top.names)) if j != label]
    names = [top.names[j] for j in columns] if dialect.header else list(_UNNAMED)
    if len(names) != len(columns):
        raise InputError(
            f"{file}: expected a time and three readings behind the name of a sensor, found {len(columns)} columns; "
            "give them names in a first line"
        )
    parts: dict[str, Path] = {}
    with ExitStack() as files, readable(file), opened(file, dialect.encoding) as stream:
        outs = {}
        for number, line in enumerate(stream):
            cells = dialect.cells(line[:_LONGEST_LINE].decode(errors="replace").rstrip("\r\n"))
            if number < top.lines or len(cells) != len(top.names):
                continue
            word = plain_name(cells[label])
            if word not in parts:
                if len(parts) == _MOST_SENSORS:
                    raise InputError(f"{file}: expected at most {_MOST_SENSORS} sensors, found more")
                parts[word] = folder.new_file(f"{file.name.partition('.')[0]}-{word}.csv")
                outs[word] = files.enter_context(files.enter_context(whole_file(parts[word])).open("wb"))
                outs[word].write(f"{','.join(names)}\n".encode())
            outs[word].write((",".join(cells[j].replace(",", ".") for j in columns) + "\n").encode())
    return list(parts.values())
