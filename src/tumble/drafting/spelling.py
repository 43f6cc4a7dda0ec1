"""Text logs that are no table: the names of their columns, the values of a line, and copies as CSV files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from tumble.errors import InputError
from tumble.files import OutputFolder, plain_name, whole_file
from tumble.recording.log_source import readable
from tumble.recording.text.pieces import opened

LEAST_NUMBERS = 3
LONGEST_LINE = 4096
MOST_SENSORS = 20
_SHARE = 0.8

Row = tuple[tuple[str, ...], Sequence[str]]
"""The names of the columns of a line, none where it names none, and its values."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Spelling:
    """How the lines of a log are written: a title, the names of the columns, if any, and the values of a line: an empty
    list for a line that is no row, None for one that is left out."""

    title: str
    names: tuple[str, ...] = ()
    values: Callable[[str], Sequence[str] | None]


def spelt_alike(lines: Sequence[str], row: Callable[[str], Row | None], title: str) -> Spelling | None:
    """The spelling of lines most of which `row` reads with the same names and as many values; None otherwise."""
    rows = [read for line in lines if (read := row(line)) is not None]
    counts = Counter((names, len(values)) for names, values in rows)
    if not counts:
        return None
    (names, width), count = counts.most_common(1)[0]
    filled = sum(bool(line.strip()) for line in lines)
    if (width < LEAST_NUMBERS and names) or count <= max(_SHARE * filled, 1):
        return None

    def values(line: str) -> Sequence[str]:
        read = row(line)
        return read[1] if read is not None and (read[0], len(read[1])) == (names, width) else []

    return Spelling(title=f"{title} ({', '.join(names)})" if names else title, names=names, values=values)


def copied(
    file: Path,
    encoding: str,
    folder: OutputFolder,
    names: Callable[[str], str],
    row: Callable[[int, str], tuple[str, str] | None],
) -> list[Path]:
    """Copy a text log into a folder, a CSV file for each sensor below the `names` of its columns.

    `row` gives the sensor of a line by its number, an empty word where there is one file alone, and its values; None
    for a line that is left out."""
    files: dict[str, Path] = {}
    outs: dict[str, IO[bytes]] = {}
    with ExitStack() as stack, readable(file), opened(file, encoding) as stream:
        for number, line in enumerate(_lines(iter(lambda: stream.read(1 << 16), b""))):
            sensor_and_values = row(number, line)
            if sensor_and_values is None:
                continue
            sensor, values = sensor_and_values
            word = plain_name(sensor) if sensor else ""
            if word not in files:
                if len(files) == MOST_SENSORS:
                    raise InputError(f"{file}: expected at most {MOST_SENSORS} sensors, found more")
                files[word] = folder.new_file(f"{file.name.partition('.')[0]}{f'-{word}' if word else ''}.csv")
                outs[word] = stack.enter_context(stack.enter_context(whole_file(files[word])).open("wb"))
                outs[word].write(f"{names(sensor)}\n".encode() if names(sensor) else b"")
            outs[word].write(values.encode() + b"\n")
    return list(files.values())


def _lines(pieces: Iterator[bytes]) -> Iterator[str]:
    """Lines, whatever they end with."""
    rest = b""
    for piece in pieces:
        *whole, rest = (rest + piece).replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
        yield from (line.decode(errors="replace") for line in whole)
        rest = rest[:LONGEST_LINE]
    if rest.strip():
        yield rest.decode(errors="replace")
