"""Text logs in which every row is of one sensor, `ACC,1200,0.01,0.02,9.81` and then `GYRO,1202,…`: the rows of each
sensor become a CSV file."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from tumble.drafting.spelling import LONGEST_LINE, MOST_SENSORS, copied
from tumble.errors import InputError
from tumble.files import OutputFolder
from tumble.recording.columns.names import ACCEL, GYRO, SENSOR_WORDS, columns_by_name
from tumble.recording.text.dialect import Dialect, Top, is_clock

_STATED = re.compile(r"^[#%\s]*(?:[^'#%]*')?")
_UNNAMED = ("time", "x", "y", "z")
_WHOLE = re.compile(r"imu\d?", re.IGNORECASE)


def split_by_header(file: Path, seen: bytes, folder: OutputFolder) -> list[Path]:
    """Split rows that begin with a word whose columns are named in a comment, `# UncalAccel,utcTimeMillis,…` or `% ACCE
    data: 'ACCE;AppTimestamp(s);…'`; no files if there is no such comment."""
    lines = seen.decode(errors="replace").splitlines()
    stated = [_STATED.sub("", line).rstrip("' ") for line in lines if line.startswith(("#", "%"))]
    rows = [line for line in lines if not line.startswith(("#", "%"))]
    delimiter = max(",;", key=lambda mark: sum(mark in line for line in rows))
    words = {line.partition(delimiter)[0] for line in rows}
    named = {word: names for word, *names in (line.split(delimiter) for line in stated) if word in words}
    kinds = {word: ",".join(names) for word, names in named.items() if {ACCEL, GYRO} & {*columns_by_name(names).triads}}

    def row(_number: int, line: str) -> tuple[str, str] | None:
        word, _, rest = line[:LONGEST_LINE].partition(delimiter)
        return (word, rest.replace(delimiter, ",")) if word in kinds else None

    return copied(file, "utf-8", folder, kinds.__getitem__, row) if len(kinds) >= 2 else []


def split_by_sensor(file: Path, seen: bytes, dialect: Dialect, top: Top, folder: OutputFolder) -> list[Path]:
    """Split rows by a column that names the sensor; of rows that begin with IMU only these are kept, as they are. No
    files if there is no such column."""
    lines = seen.decode(dialect.encoding, errors="replace").split("\n")[top.lines : -1]
    rows = [cells for line in lines if len(cells := dialect.cells(line)) == len(top.names)]
    labels = (j for j in range(len(top.names)) if _are_sensors([cells[j] for cells in rows], dialect))
    label = next(labels, None)
    if label is None:
        return []
    whole = {cells[label] for cells in rows if _WHOLE.fullmatch(cells[label])}
    if whole:
        names = list(top.names) if dialect.header else []
    else:
        names = [name for j, name in enumerate(top.names) if j != label] if dialect.header else list(_UNNAMED)
    if not whole and len(names) != len(top.names) - 1:
        raise InputError(
            f"{file}: expected a time and three readings behind the name of a sensor, found {len(top.names) - 1} "
            "columns; give them names in a first line"
        )

    def row(number: int, line: str) -> tuple[str, str] | None:
        cells = dialect.cells(line[:LONGEST_LINE])
        if number < top.lines or len(cells) != len(top.names) or (whole and cells[label] not in whole):
            return None
        word = cells[label] if whole else cells.pop(label)
        return word, ",".join(cell.replace(",", ".") for cell in cells)

    return copied(file, dialect.encoding, folder, lambda _: ",".join(names), row)


def _are_sensors(words: Sequence[str], dialect: Dialect) -> bool:
    """Whether cells are names of sensors that take turns: few words, one of them of accelerometers or an IMU."""
    named, changes = Counter(words), sum(a != b for a, b in pairwise(words))
    return (
        2 <= len(named) <= MOST_SENSORS
        and 4 * changes > len(words)
        and not any(not word or dialect.is_number(word) or is_clock(word) for word in named)
        and any(SENSOR_WORDS[ACCEL].search(word) or _WHOLE.fullmatch(word) for word in named)
    )
