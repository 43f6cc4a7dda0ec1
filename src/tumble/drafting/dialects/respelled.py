"""Text logs that are no table, as one: each dialect tells from the first lines whether a log is spelled so.

What is written is a CSV file in the session's folder, a row for each line. A line that a dialect does not know is left
as it is, for the reader to report.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from tumble.drafting.dialects.cells import behind_a_clock, in_brackets, list_cells, thousands, units_in_cells
from tumble.drafting.dialects.json_lines import json_lines
from tumble.drafting.dialects.named_values import LONGEST_LINE, named_values, several_lines
from tumble.drafting.dialects.sentences import novatel, sentences
from tumble.drafting.dialects.spelling import Spelling
from tumble.errors import InputError
from tumble.files import OutputFolder, whole_file
from tumble.recording.log_source import readable
from tumble.recording.text.dialect import encoding_of
from tumble.recording.text.pieces import opened

DIALECTS: tuple[Callable[[Sequence[str]], Spelling | None], ...] = (
    sentences,
    novatel,
    json_lines,
    several_lines,
    list_cells,
    units_in_cells,
    named_values,
    in_brackets,
    behind_a_clock,
    thousands,
)
"""Each is asked in this order, with the first lines of a file, for their spelling."""

_SEEN_LINES = 200


def respelled(file: Path, seen: bytes, folder: OutputFolder) -> tuple[list[Path], str] | None:
    """The copy of a text log in a folder, and what there is to say of it; None for one that can be read as it is.
    `seen`: the first bytes of the file."""
    encoding = encoding_of(seen)
    text = seen.decode(encoding, errors="replace")
    lines = re.split("[\r\n]+", text)[:-1][:_SEEN_LINES]
    try:
        spelling = next((spelling for dialect in DIALECTS if (spelling := dialect(lines)) is not None), None)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    if spelling is None and text.count("\r") > 2 and "\n" not in text:
        spelling = Spelling(values=lambda line: [line], said="lines that end in a carriage return")
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
    return [target], f"text: {spelling.said}: copied to {target.name} as a table"


def _lines(pieces: Iterator[bytes]) -> Iterator[str]:
    rest = b""
    for piece in pieces:
        *whole, rest = (rest + piece).replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
        yield from (line.decode(errors="replace") for line in whole)
        rest = rest[:LONGEST_LINE]
    if rest.strip():
        yield rest.decode(errors="replace")
