"""How the lines of a text log that is no table are spelled: the columns they have, and the values of a line; and the
copy of a log, line by line, as a table, or as several."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TypeVar

from tumble.errors import InputError
from tumble.files import OutputFolder, plain_name, whole_file
from tumble.recording.log_source import readable
from tumble.recording.text.pieces import opened

LEAST_NUMBERS = 3
LONGEST_LINE = 4096
MOST_SENSORS = 20
_SHARE = 0.8
T = TypeVar("T", bound=Hashable)
Columns = tuple[tuple[str, ...], str]
"""The names of columns, none where lines have none, and how their spelling is called."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Spelling:
    """Names of the columns, none where the lines have none; the values of a line, none where it is no row, and None
    where it is to be left out; and how it is called."""

    names: tuple[str, ...] = ()
    values: Callable[[str], Sequence[str] | None]
    said: str


def most_common(of_lines: Iterable[T | None], lines: Sequence[str]) -> T | None:
    """What most lines that are not empty have in common, if it is in two at least."""
    counts = Counter(item for item in of_lines if item)
    if not counts:
        return None
    item, count = counts.most_common(1)[0]
    return item if count > max(_SHARE * sum(bool(line.strip()) for line in lines), 1) else None


def spelt_alike(
    lines: Sequence[str],
    row: Callable[[str], tuple[T, Sequence[str]] | None],
    columns: Callable[[T], Columns | None],
    *,
    below_names: bool = False,
) -> Spelling | None:
    """The spelling of lines of which `row` gives what they have in common, and their values, None of one that is no
    row; and `columns` the names. None where most lines have nothing in common. A first line `below_names` is left
    out."""
    common = most_common((read[0] if (read := row(line)) else None for line in lines), lines)
    named = None if common is None else columns(common)
    if named is None:
        return None

    def values(line: str) -> Sequence[str] | None:
        read = row(line)
        if read is not None and read[0] == common:
            return read[1]
        return None if below_names and line == lines[0] else []

    return Spelling(names=named[0], values=values, said=named[1])


def listed(said: str) -> Callable[[tuple[str, ...]], Columns | None]:
    """Names as they are, where they are enough for readings, in a spelling that is called so."""
    return lambda names: (names, f"{said} ({', '.join(names)})") if len(names) >= LEAST_NUMBERS else None


def copied(
    file: Path,
    encoding: str,
    folder: OutputFolder,
    names: Callable[[str], str],
    row: Callable[[int, str], tuple[str, str] | None],
) -> list[Path]:
    """The copies of a text log in a folder, a CSV file for each sensor, below the `names` of its columns; `row` gives
    the sensor of a line, an empty word where there is one file alone, and its values, None where it is no row."""
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
    """Lines whatever they end in."""
    rest = b""
    for piece in pieces:
        *whole, rest = (rest + piece).replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
        yield from (line.decode(errors="replace") for line in whole)
        rest = rest[:LONGEST_LINE]
    if rest.strip():
        yield rest.decode(errors="replace")
