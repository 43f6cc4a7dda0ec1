"""Text logs in which every row is of one sensor, `ACC,1200,0.01,0.02,9.81` and then `GYRO,1202,…`: the rows of each
sensor become a CSV file of its own."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Sequence
from itertools import pairwise
from pathlib import Path

from tumble.drafting.spelling import LONGEST_LINE, MOST_SENSORS, copied
from tumble.errors import InputError
from tumble.files import OutputFolder
from tumble.recording.columns.names import ACCEL, GYRO, SENSOR_WORDS, columns_by_name
from tumble.recording.text.dialect import Dialect, Top, is_clock

_STATED = re.compile(r"^[#%\s]*(?:[^'#%]*')?")
_UNNAMED = ("time", "x", "y", "z")


def split_by_header(file: Path, seen: bytes, folder: OutputFolder) -> list[Path]:
    """The rows of each sensor, of those with accelerometers and gyros, in a file of its own, where comments state the
    names of their columns, `# UncalAccel,utcTimeMillis,…` or `% ACCE data: 'ACCE;AppTimestamp(s);…'`, behind the word
    that the rows begin with; none where that is not so."""
    lines = seen.decode(errors="replace").splitlines()
    stated = [_STATED.sub("", line).rstrip("' ") for line in lines if line.startswith(("#", "%"))]
    for delimiter in (",", ";"):
        words = {line.partition(delimiter)[0] for line in lines if not line.startswith(("#", "%"))}
        named = {word: names for word, *names in (line.split(delimiter) for line in stated) if word in words}
        inertial = (word for word, names in named.items() if {ACCEL, GYRO} & set(columns_by_name(names).triads))
        kinds = {word: ",".join(named[word]) for word in inertial}
        if len(kinds) < 2:
            continue

        def behind(
            _number: int, line: str, delimiter: str = delimiter, kinds: Collection[str] = kinds
        ) -> tuple[str, str] | None:
            word, _, rest = line[:LONGEST_LINE].partition(delimiter)
            return (word, rest.replace(delimiter, ",")) if word in kinds else None

        return copied(file, "utf-8", folder, kinds.__getitem__, behind)
    return []


def split_by_sensor(file: Path, seen: bytes, dialect: Dialect, top: Top, folder: OutputFolder) -> list[Path]:
    """The rows of each sensor in a file of its own, with all columns but the one that names it: names of sensors that
    change all the time. None where there is no such column."""
    lines = seen.decode(dialect.encoding, errors="replace").split("\n")[top.lines : -1]
    rows = [cells for line in lines if len(cells := dialect.cells(line)) == len(top.names)]
    for label in range(len(top.names)):
        words = [cells[label] for cells in rows]
        changes = sum(a != b for a, b in pairwise(words))
        if 4 * changes > len(words) and _are_sensors(words, dialect):
            break
    else:
        return []
    columns = [j for j in range(len(top.names)) if j != label]
    names = [top.names[j] for j in columns] if dialect.header else list(_UNNAMED)
    if len(names) != len(columns):
        raise InputError(
            f"{file}: expected a time and three readings behind the name of a sensor, found {len(columns)} columns; "
            "give them names in a first line"
        )

    def row(number: int, line: str) -> tuple[str, str] | None:
        cells = dialect.cells(line[:LONGEST_LINE])
        if number < top.lines or len(cells) != len(top.names):
            return None
        return cells[label], ",".join(cells[j].replace(",", ".") for j in columns)

    return copied(file, dialect.encoding, folder, lambda _: ",".join(names), row)


def _are_sensors(words: Sequence[str], dialect: Dialect) -> bool:
    """Whether the cells of a column are names of sensors: few words, one of which is that of accelerometers."""
    named = Counter(words)
    return (
        2 <= len(named) <= MOST_SENSORS
        and not any(not word or dialect.is_number(word) or is_clock(word) for word in named)
        and any(SENSOR_WORDS[ACCEL].search(word) for word in named)
    )
