"""Text logs that are no table, as one: `ax=0.01 ay=-0.02 …`, `acc: 0.1, 0.2, 9.8; gyro: …`, sentences `$VNYMR,…`,
objects of JSON, rows in brackets or behind the clock of a serial monitor, and lines that end in a carriage return
alone.

What is written is a CSV file in the session's folder, a row for each line, with the names before the signs. A name with
three numbers behind it is three columns. A line with other names is left as it is, for the reader to report.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from tumble.calibration.json_lines import json_lines
from tumble.calibration.sentences import sentences
from tumble.calibration.spelling import Spelling, most_common, of_named_values
from tumble.files import whole_file
from tumble.recording.dialect import encoding_of, is_clock
from tumble.recording.log_source import readable
from tumble.recording.text_pieces import opened

_SEEN_LINES = 200
_LONGEST_LINE = 4096
_KEY = re.compile(r"([^\W\d][\w.]*)\s*[=:]\s*(?=[-+\d.\[(])")
_NUMBER = re.compile(r"(?<![\w^/.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_BRACKETED = re.compile(r"\s*[\[({][-+.\d][^\[\](){}:]*[\])}]\s*[,;]?\s*")
_MONITORED = re.compile(r"\s*(\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?)\s*->\s*(.*)")
_TIME = "time"
_WHEN = re.compile(r"[\s\[\]()>,;|-]*$")


def respelled(file: Path, seen: bytes, folder: Path) -> tuple[Path, str] | None:
    """The copy of a text log in a folder, made if need be, and what there is to say of it; None for one that can be
    read as it is. `seen`: the first bytes of the file."""
    encoding = encoding_of(seen)
    text = seen.decode(encoding, errors="replace")
    lines = re.split("[\r\n]+", text)[:-1][:_SEEN_LINES]
    spelling = sentences(lines) or json_lines(lines) or of_named_values(_cells, lines, "names before the numbers")
    spelling = spelling or _framed(lines)
    if spelling is None and text.count("\r") > 2 and "\n" not in text:
        spelling = Spelling(names=(), values=lambda line: [line], said="lines that end in a carriage return")
    if spelling is None:
        return None
    target = folder / f"{file.name.partition('.')[0]}.csv"
    if target.exists():
        target = target.with_stem(f"{target.stem}-copy")
    folder.mkdir(parents=True, exist_ok=True)
    with readable(file), opened(file, encoding) as stream, whole_file(target) as temporary, temporary.open("wb") as out:
        if spelling.names:
            out.write(f"{','.join(spelling.names)}\n".encode())
        for line in _lines(iter(lambda: stream.read(1 << 16), b"")):
            row = ",".join(spelling.values(line)) or line.replace(",", " ")
            out.write(row.encode() + b"\n")
    return target, f"text: {spelling.said}: copied to {target.name} as a table"


def _framed(lines: Sequence[str]) -> Spelling | None:
    """The spelling of rows in brackets, and of rows behind the clock of a serial monitor, `13:02:11.345 -> 0.1,…`."""
    if most_common((bool(_BRACKETED.fullmatch(line)) for line in lines), lines):
        return Spelling(names=(), values=lambda line: [line.strip(" \t,;[](){}")], said="rows in brackets")
    if most_common((bool(_MONITORED.fullmatch(line)) for line in lines), lines):
        return Spelling(names=(), values=_behind_the_clock, said="rows behind the clock of a serial monitor")
    return None


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
        rest = rest[:_LONGEST_LINE]
    if rest.strip():
        yield rest.decode(errors="replace")


def _cells(line: str) -> dict[str, str]:
    """Names and numbers of a line; a time before the first name is one too."""
    keys = list(_KEY.finditer(line[:_LONGEST_LINE]))
    if not keys:
        return {}
    when = _WHEN.sub("", line[: keys[0].start()]).strip(" []")
    cells = {_TIME: when} if is_clock(when) or _NUMBER.fullmatch(when) else {}
    for key, after in zip(keys, [*keys[1:], None], strict=True):
        numbers = _NUMBER.findall(line[key.end() : after.start() if after else None])
        if len(numbers) == 1:
            cells[key[1]] = numbers[0]
        elif len(numbers) == 3:
            cells |= {f"{key[1]}_{axis}": number for axis, number in zip("xyz", numbers, strict=True)}
    return cells
