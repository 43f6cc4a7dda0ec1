"""Text logs that are no table, as one: `ax=0.01 ay=-0.02 …`, `acc: 0.1, 0.2, 9.8; gyro: …`, sentences `$VNYMR,…`,
objects of JSON, samples of several lines, lists in cells, units behind the numbers, rows in brackets or behind the
clock of a serial monitor, and lines that end in a carriage return alone.

What is written is a CSV file in the session's folder, a row for each line, with the names before the signs. A name with
three numbers behind it is three columns. A line with other names is left as it is, for the reader to report.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from tumble.drafting.json_lines import json_lines
from tumble.drafting.list_cells import list_cells
from tumble.drafting.named_values import LONGEST_LINE, cells
from tumble.drafting.novatel import novatel
from tumble.drafting.sentences import sentences
from tumble.drafting.several_lines import several_lines
from tumble.drafting.spelling import Spelling, most_common, of_named_values
from tumble.drafting.units_in_cells import units_in_cells
from tumble.errors import InputError
from tumble.files import OutputFolder, whole_file
from tumble.recording.dialect import encoding_of
from tumble.recording.log_source import readable
from tumble.recording.text_pieces import opened

_SEEN_LINES = 200
_THOUSANDS = re.compile("(?<=\\d)['’\u00a0\u202f](?=\\d{3}(?!\\d))")
_QUOTED_THOUSANDS = re.compile(r'"(-?\d{1,3}(?:,\d{3})+(?:\.\d*)?)"')
_BRACKETED = re.compile(r"\s*[\[({][-+.\d][^\[\](){}:]*[\])}]\s*[,;]?\s*")
_MONITORED = re.compile(r"\s*(\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?)\s*->\s*(.*)")


def respelled(file: Path, seen: bytes, folder: OutputFolder) -> tuple[Path, str] | None:
    """The copy of a text log in a folder, and what there is to say of it; None for one that can be
    read as it is. `seen`: the first bytes of the file."""
    encoding = encoding_of(seen)
    text = seen.decode(encoding, errors="replace")
    lines = re.split("[\r\n]+", text)[:-1][:_SEEN_LINES]
    try:
        spelling = sentences(lines) or novatel(lines) or json_lines(lines) or several_lines(lines)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    spelling = spelling or list_cells(lines) or units_in_cells(lines)
    spelling = spelling or of_named_values(cells, lines, "names before the numbers") or _framed(lines)
    if spelling is None and sum(_without_thousands(line) != line for line in lines) > 1:
        spelling = Spelling(
            names=(), values=lambda line: [_without_thousands(line)], said="marks between thousands, as in 1'000"
        )
    if spelling is None and text.count("\r") > 2 and "\n" not in text:
        spelling = Spelling(names=(), values=lambda line: [line], said="lines that end in a carriage return")
    if spelling is None:
        return None
    target = folder.new_file(f"{file.name.partition('.')[0]}.csv")
    with readable(file), opened(file, encoding) as stream, whole_file(target) as temporary, temporary.open("wb") as out:
        if spelling.names:
            out.write(f"{','.join(spelling.names)}\n".encode())
        for line in _lines(iter(lambda: stream.read(1 << 16), b"")):
            values = spelling.values(line)
            if values is not None:
                out.write((",".join(values) or line.replace(",", " ")).encode() + b"\n")
    return target, f"text: {spelling.said}: copied to {target.name} as a table"


def _framed(lines: Sequence[str]) -> Spelling | None:
    """The spelling of rows in brackets, and of rows behind the clock of a serial monitor, `13:02:11.345 -> 0.1,…`."""
    first = next((line.strip() for line in lines if line.strip()), "")
    nested = first.startswith(("{", "[")) and not _BRACKETED.fullmatch(first)  # a document of JSON
    if not nested and most_common((bool(_BRACKETED.fullmatch(line)) for line in lines), lines):
        return Spelling(names=(), values=lambda line: [line.strip(" \t,;[](){}")], said="rows in brackets")
    if most_common((bool(_MONITORED.fullmatch(line)) for line in lines), lines):
        return Spelling(names=(), values=_behind_the_clock, said="rows behind the clock of a serial monitor")
    return None


def _without_thousands(line: str) -> str:
    """A line whose numbers are written without the marks between their thousands."""
    return _QUOTED_THOUSANDS.sub(lambda found: found[1].replace(",", ""), _THOUSANDS.sub("", line))


def _behind_the_clock(line: str) -> list[str]:
    """The clock as a column in front of the others, or its name."""
    found = _MONITORED.fullmatch(line)
    if found is None:
        return []
    clock, rest = found.groups()
    delimiter = next((mark for mark in "\t;," if mark in rest), " ")
    return [f"{clock if rest[:1] in '+-.0123456789' else 'clock'}{delimiter}{rest}"]


def _lines(pieces: Iterator[bytes]) -> Iterator[str]:
    rest = b""
    for piece in pieces:
        *whole, rest = (rest + piece).replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
        yield from (line.decode(errors="replace") for line in whole)
        rest = rest[:LONGEST_LINE]
    if rest.strip():
        yield rest.decode(errors="replace")
