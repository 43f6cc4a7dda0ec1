"""Files that hold several sensors, each of which becomes a CSV file of its own: text logs in which every row is of one
sensor, `ACC,1200,0.01,0.02,9.81` and then `GYRO,1202,…`, and documents of JSON.

In a document there are columns, `{"t": [0.01, …], "ax": [0.1, …]}`, also within others, a list of samples, `[{"t":
0.01, "ax": 0.1}, …]` however it is broken into lines, or a list of rows. What has a time of its own is a table of its
own, as the accelerometers and the gyros of a phone.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from itertools import pairwise, zip_longest
from pathlib import Path
from typing import Any

from tumble.drafting.dialects.named_values import column_name, values_of
from tumble.drafting.dialects.spelling import LONGEST_LINE, MOST_SENSORS, copied
from tumble.errors import InputError
from tumble.files import OutputFolder, plain_name, whole_file
from tumble.recording.columns.names import ACCEL, GYRO, SENSOR_WORDS, columns_by_name
from tumble.recording.log_source import readable
from tumble.recording.text.dialect import Dialect, Top, is_clock
from tumble.recording.text.pieces import opened

_STATED = re.compile(r"^[#%\s]*(?:[^'#%]*')?")
_UNNAMED = ("time", "x", "y", "z")
_LARGEST_BYTES = 1 << 26
_FEWEST = 10
_WIDEST = 100
_DEEPEST = 8
_Table = dict[str, Sequence[str]]


def are_sensors(words: Sequence[str], dialect: Dialect) -> bool:
    """Whether the cells of a column are names of sensors: few words, one of which is that of accelerometers."""
    named = Counter(words)
    return (
        2 <= len(named) <= MOST_SENSORS
        and not any(not word or dialect.is_number(word) or is_clock(word) for word in named)
        and any(SENSOR_WORDS[ACCEL].search(word) for word in named)
    )


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
        if 4 * changes > len(words) and are_sensors(words, dialect):
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


# -------------------- documents of JSON --------------------


def tables_of_json(file: Path, seen: bytes, folder: OutputFolder) -> tuple[list[Path], str] | None:
    """The tables in a document of JSON, a CSV file each, and what there is to say of them; None for a file that is
    none. `seen`: the first bytes of the file."""
    if seen.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] not in (b"{", b"["):
        return None
    with readable(file), opened(file) as stream:
        text = stream.read(_LARGEST_BYTES + 1)
    if len(text) > _LARGEST_BYTES:
        return None
    try:
        document = json.loads(text)
    except (ValueError, RecursionError):
        return None
    tables = {name: table for name, table in _tables(document, "").items() if len(table) >= 3}
    if not tables:
        raise InputError(
            f'{file}: expected columns of numbers, {{"t": […], "ax": […], …}}, or a list of samples, found a document '
            "of JSON with neither; write the readings as CSV"
        )
    written: list[Path] = []
    for name, table in tables.items():
        which = f"-{plain_name(name)}" if len(tables) > 1 else ""
        written.append(folder.new_file(f"{file.name.partition('.')[0]}{which}.csv"))
        with whole_file(written[-1]) as temporary, temporary.open("w", encoding="utf-8", newline="") as out:
            if not all(column.isdecimal() for column in table):
                out.write(",".join(table) + "\n")
            for row in zip_longest(*table.values(), fillvalue=""):
                out.write(",".join(row) + "\n")
    named = ", ".join(path.name for path in written[:5]) + (", …" if len(written) > 5 else "")
    return written, f"text: a document of JSON: copied to {named}"


def _tables(content: Any, name: str, depth: int = 0) -> dict[str, _Table]:
    """The tables in a part of a document: that of its own columns, and those within it that have a time of their own or
    another length."""
    if depth > _DEEPEST:
        return {}
    if isinstance(content, list):
        return {f"{name}{word}": table for word, table in _tables_of_list(content).items() if table}
    if not isinstance(content, dict):
        return {}
    of_length: dict[int, _Table] = {}
    apart: dict[str, _Table] = {}
    for key, value in content.items():
        word = column_name(key)
        inner = f"{name}_{word}" if name else word
        for found, table in _tables(value, inner, depth + 1).items():
            if found == inner and not (len(table) > 1 and columns_by_name(table).time is not None):
                columns = {f"{word}_{column}" if column else word: values for column, values in table.items()}
                of_length.setdefault(max(map(len, table.values())), {}).update(columns)
            else:
                apart[found] = table
    named = (name, *(f"{name}_{length}" for length in of_length))
    largest_first = sorted(of_length.values(), key=len, reverse=True)
    return {**dict(zip(named, largest_first, strict=False)), **apart}


def _tables_of_list(content: Sequence[Any]) -> dict[str, _Table]:
    """The columns of a list: of numbers one without a name, of lists their parts, of samples their values; none where
    it is something else. Samples of several sensors, as one of their values says, are a table for each of these."""
    if len(content) < _FEWEST:
        return {}
    if all(value is None or isinstance(value, int | float | str) for value in content):
        cells = [dict(values_of({"": value})).get("", "") for value in content]
        return {"": {"": cells}} if any(cells) else {}
    if all(isinstance(value, list) for value in content):
        width = Counter(map(len, content)).most_common(1)[0][0]
        names = tuple("xyz") if width == 3 else tuple(str(j + 1) for j in range(width))
        return {"": _columns([dict(values_of(dict(zip(names, row, strict=False)))) for row in content])}
    samples = [dict(values_of(value)) if isinstance(value, dict) else {} for value in content]
    label = next((n for n in samples[-1] if are_sensors([sample.get(n, "-") for sample in samples], Dialect())), None)
    if label is None:
        return {"": _columns(samples)}
    of_kind: dict[str, list[dict[str, str]]] = {}
    for sample in samples:
        of_kind.setdefault(sample.pop(label, ""), []).append(sample)
    return {kind: _columns(of) for kind, of in of_kind.items()}


def _columns(samples: Sequence[Mapping[str, str]]) -> _Table:
    """The values of samples by their names, empty where a sample has none; no columns where there are too many."""
    names = dict.fromkeys(name for sample in samples for name in sample)
    return {name: [sample.get(name, "") for sample in samples] for name in names} if len(names) <= _WIDEST else {}
