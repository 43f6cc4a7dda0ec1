"""Text logs that are no table of numbers, copied as one into the session's folder: a function for each dialect, which
recognises it in the first lines of a log.

Lines that name their values are in `named_values`; here are sentences with a checksum, rows in brackets or behind the
clock of a serial monitor, and marks between thousands. A line that a dialect does not read is copied as it is, for the
reader to report.
"""

from __future__ import annotations

import re
import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from functools import reduce
from operator import xor
from pathlib import Path

from tumble.drafting.named_values import json_lines, named_values, several_lines
from tumble.drafting.spelling import LEAST_NUMBERS, Row, Spelling, copied, spelt_alike
from tumble.files import OutputFolder
from tumble.recording.text.dialect import encoding_of

_THOUSANDS = re.compile("(?<=\\d)['’\u00a0\u202f](?=\\d{3}(?!\\d))")
_QUOTED_THOUSANDS = re.compile(r'"(-?\d{1,3}(?:,\d{3})+(?:\.\d*)?)"')
_BRACKETED = re.compile(r"\s*[\[({][-+.\d\seE,;\[\](){}]*[\])}]\s*[,;]?\s*")
_MONITORED = re.compile(r"\s*(\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?)\s*->\s*(.*)")
_SEEN_LINES = 200

_MAG = tuple(f"Mag{axis} [gauss]" for axis in "XYZ")
_INERTIAL = (*(f"Accel{axis} [m/s^2]" for axis in "XYZ"), *(f"Gyro{axis} [rad/s]" for axis in "XYZ"))
_FIELDS = {
    "VNYMR": ("Yaw", "Pitch", "Roll", *_MAG, *_INERTIAL),
    "VNQMR": ("Qx", "Qy", "Qz", "Qw", *_MAG, *_INERTIAL),
    "VNIMU": (*_MAG, *_INERTIAL, "Temperature [degC]", "Pressure [kPa]"),
    "VNMAR": (*_MAG, *_INERTIAL),
}
"""Fields of VectorNav's sentences (reference of the VN-100, asynchronous output); others have none."""

_SENTENCE = re.compile(r"\s*([$#%])((\w+),[^*]*)\*([0-9A-Fa-f]{2}|[0-9A-Fa-f]{8})\s*")
_NOVATEL_RAW = re.compile("RAWIMUS?X?A")
_RAW_INCREMENTS = ("GPS time [s]", *(f"{kind} {axis} [count]" for kind in ("accel", "gyro") for axis in "xyz"))


def sentences(lines: Sequence[str]) -> Spelling | None:
    """Sentences with a checksum, `$VNYMR,…*6D` or NovAtel's `%RAWIMUSXA,…;…*a5db8c7b`; a damaged one is no row."""
    kinds = Counter(sentence.group(1, 3) for line in lines if (sentence := _SENTENCE.fullmatch(line)) is not None)
    mark, kind = max(kinds, key=lambda name: kinds[name], default=("", ""))

    def row(line: str) -> Row | None:
        sentence = _SENTENCE.fullmatch(line)
        if sentence is None or sentence.group(1, 3) != (mark, kind):
            return None
        body, check = sentence[2].encode(), int(sentence[4], 16)
        if check != (reduce(xor, body, 0) if mark == "$" else ~zlib.crc32(body, 0xFFFFFFFF) & 0xFFFFFFFF):
            return None
        values = re.split("[,;]", sentence[2])[1:]
        if _NOVATEL_RAW.fullmatch(kind) and len(values) >= 8:
            seconds, _, *increments = values[-8:]
            x, minus_y, z = (increments[at::3] for at in (2, 1, 0))  # of accelerometers and gyros
            y = [value.removeprefix("-") if value.startswith("-") else f"-{value}" for value in minus_y]
            return _RAW_INCREMENTS, [seconds, *(value for three in zip(x, y, z, strict=True) for value in three)]
        fields = _FIELDS.get(kind, ())
        return (fields, values) if len(values) >= LEAST_NUMBERS and len(fields) in (0, len(values)) else None

    return spelt_alike(lines, row, f"sentences {mark}{kind}")


def in_brackets(lines: Sequence[str]) -> Spelling | None:
    """Rows in brackets."""

    def row(line: str) -> Row | None:
        return ((), [re.sub(r"[\[\](){}]", "", line).strip(" \t,;")]) if _BRACKETED.fullmatch(line) else None

    return spelt_alike(lines, row, "rows in brackets")


def behind_a_clock(lines: Sequence[str]) -> Spelling | None:
    """Rows behind the clock of a serial monitor, `13:02:11.345 -> 0.1,…`, which becomes the first column."""

    def row(line: str) -> Row | None:
        monitored = _MONITORED.fullmatch(line)
        if monitored is None:
            return None
        clock, rest = monitored.groups()
        delimiter = next((mark for mark in "\t;," if mark in rest), " ")
        return (), [f"{clock if rest[:1] in '+-.0123456789' else 'clock'}{delimiter}{rest}"]

    return spelt_alike(lines, row, "rows behind the clock of a serial monitor")


def thousands(lines: Sequence[str]) -> Spelling | None:
    """Numbers with marks between their thousands, 1'000 or "1,000"."""

    def plain(line: str) -> str:
        return _QUOTED_THOUSANDS.sub(lambda number: number[1].replace(",", ""), _THOUSANDS.sub("", line))

    if sum(plain(line) != line for line in lines) <= 1:
        return None
    return Spelling(values=lambda line: [plain(line)], title="marks between thousands, as in 1'000")


DIALECTS: tuple[Callable[[Sequence[str]], Spelling | None], ...] = (
    sentences, json_lines, several_lines, named_values, in_brackets, behind_a_clock, thousands,
)  # fmt: skip
"""In the order in which they are tried."""


def as_table(file: Path, start: bytes, folder: OutputFolder) -> tuple[Path, str] | None:
    """Copy a text log of one of the dialects into a folder as a table.

    Parameters
    ----------
    file
        The log.
    start
        Its first bytes.
    folder
        Where the copy is written.

    Returns
    -------
    tuple or None
        The copy and a sentence about it; None for a log that can be read as it is.
    """
    encoding = encoding_of(start)
    text = start.decode(encoding, errors="replace")
    lines = re.split("[\r\n]+", text)[:-1][:_SEEN_LINES]
    spelling = next((spelling for dialect in DIALECTS if (spelling := dialect(lines)) is not None), None)
    if spelling is None and text.count("\r") > 2 and "\n" not in text:
        spelling = Spelling(values=lambda line: [line], title="lines that end in a carriage return")
    if spelling is None:
        return None
    values_of_line, names = spelling.values, ",".join(spelling.names)

    def row(_number: int, line: str) -> tuple[str, str] | None:
        values = values_of_line(line)
        return None if values is None else ("", ",".join(values) or line.replace(",", " "))

    (table,) = copied(file, encoding, folder, lambda _: names, row)
    return table, f"text: {spelling.title}: copied to {table.name} as a table"
