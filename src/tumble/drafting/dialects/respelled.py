"""Text logs that are no table, as one: each dialect tells from the first lines whether a log is spelled so.

What is written is a CSV file in the session's folder, a row for each line. A line that a dialect does not know is left
as it is, for the reader to report.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from tumble.drafting.dialects.cells import behind_a_clock, in_brackets, list_cells, thousands, units_in_cells
from tumble.drafting.dialects.named_values import json_lines, named_values, several_lines
from tumble.drafting.dialects.sentences import novatel, sentences
from tumble.drafting.dialects.spelling import Spelling, copied
from tumble.errors import InputError
from tumble.files import OutputFolder
from tumble.recording.text.dialect import encoding_of

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
    of_line, names = spelling.values, ",".join(spelling.names)

    def row(_number: int, line: str) -> tuple[str, str] | None:
        values = of_line(line)
        return None if values is None else ("", ",".join(values) or line.replace(",", " "))

    target = copied(file, encoding, folder, lambda _: names, row)
    return target, f"text: {spelling.said}: copied to {target[0].name} as a table"
