"""Lines as they are received, and the rows of a log in them.

A row is a line of numbers between commas, an object of JSON with the names of the columns, or a `Raw:` line of
MotionCal, nine integers without a time. Any other line is refused with a reason: bytes that are no text, half lines,
too few values.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tumble.units import Array

LONGEST_LINE = 1 << 14  # bytes
MOTIONCAL = "Raw:"
MOTIONCAL_COLUMNS = ("t", "ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz")
_MAGNETIC_COUNTS = 10.0  # per µT, as MotionCal sends them
_NUMERIC_BYTES = np.isin(np.arange(256), np.frombuffer(b"0123456789.,+-eE\n", dtype=np.uint8))


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """A row of the log as text, and its time as the log has it, None in a log without times."""

    text: str
    time: float | None


@dataclass(kw_only=True, slots=True)
class Lines:
    """Parser of received bytes into rows of `columns`, of which `clock` is the time.

    Values are in the order of the log until a header states another one. `refused` counts the refused lines, which are
    passed to `refuse`; `last_refused` is the reason for the last one. `now` gives the time of a line of MotionCal."""

    columns: tuple[str, ...]
    clock: str | None
    refuse: Callable[[bytes], None]
    now: Callable[[], float] = time.time
    refused: int = 0
    last_refused: str = ""
    unfinished: bytes = b""
    header: tuple[str, ...] = ()

    @property
    def sent_columns(self) -> tuple[str, ...]:
        """Columns of the lines: those of the latest header, by default those of the log."""
        return self.header or self.columns

    @property
    def in_order(self) -> bool:
        """Whether lines have the columns of the log and no others, in its order."""
        return self.sent_columns == self.columns

    def cut(self, data: bytes) -> bytes:
        """Return the lines completed by the next bytes."""
        whole, newline, self.unfinished = (self.unfinished + data).rpartition(b"\n")
        if len(self.unfinished) > LONGEST_LINE:
            self._refuse(self.unfinished, "no end of a line")
            self.unfinished = b""
        return whole + newline

    def rows(self, whole: bytes) -> list[Row]:
        """Return the rows in complete lines, and refuse the other lines."""
        rows = []
        for raw in whole.split(b"\n"):
            try:
                row = self._row(raw.strip(b" \t\r"))
            except ValueError as error:
                self._refuse(raw, str(error))
            else:
                rows += [] if row is None else [row]
        return rows

    def numbers(self, whole: bytes) -> Array:
        """Return the numbers (m, columns) of the rows in complete lines."""
        numbers = numbers_in(whole, len(self.columns)) if self.in_order else None
        if numbers is not None:
            return numbers
        values = [float(value) for row in self.rows(whole) for value in row.text.split(",")]
        return np.array(values).reshape(-1, len(self.columns))

    def _refuse(self, raw: bytes, reason: str) -> None:
        self.refused, self.last_refused = self.refused + 1, reason
        self.refuse(raw[:LONGEST_LINE])

    def _row(self, line: bytes) -> Row | None:
        """Return the row of a line, None for an empty line or a header. Raises ValueError with the reason otherwise."""
        if line.startswith(b"{"):
            try:
                content = json.loads(line.decode("utf-8"))
                cells = [repr(float(content[column])) for column in self.columns]
            except UnicodeDecodeError:
                raise ValueError("bytes that are no text") from None
            except (ValueError, TypeError, KeyError, RecursionError, OverflowError):
                raise ValueError("JSON without a number for every column") from None
        elif line.startswith(MOTIONCAL.encode()):
            try:
                counts = [int(value) for value in line.removeprefix(MOTIONCAL.encode()).split(b",")]
            except ValueError:
                counts = []
            if self.columns != MOTIONCAL_COLUMNS or len(counts) != len(MOTIONCAL_COLUMNS) - 1:
                raise ValueError("a line of MotionCal that is not nine numbers")
            field = [repr(count / _MAGNETIC_COUNTS) for count in counts[6:]]
            cells = [repr(self.now()), *map(str, counts[:6]), *field]
        else:
            values = [value.strip() for value in line.decode("utf-8", errors="replace").split(",")]
            names = [value.lstrip("\ufeff") for value in values]
            if set(self.columns) <= set(names):
                self.header = tuple(names)
                return None
            if not line.isascii():
                raise ValueError("bytes that are no text")
            if not line:
                return None
            if len(values) != len(self.sent_columns):
                raise ValueError(f"{len(values)} values where {len(self.sent_columns)} are expected")
            cells = [values[self.sent_columns.index(column)] for column in self.columns]
        try:
            numbers = [float(value) for value in cells]
        except ValueError:
            raise ValueError("a value that is no number") from None
        stamp = None if self.clock is None else numbers[self.columns.index(self.clock)]
        if any(map(math.isinf, numbers)) or (stamp is not None and math.isnan(stamp)):
            raise ValueError("a number that is not finite")
        return Row(text=",".join(cells), time=stamp)


def numbers_in(data: bytes, columns: int) -> Array | None:
    """Return the rows of complete lines that are nothing but numbers between commas; None if any line is not."""
    text = np.frombuffer(data, dtype=np.uint8)
    if not len(data) or not _NUMERIC_BYTES[text].all():
        return None
    ends = np.flatnonzero(text == ord("\n"))
    commas = np.searchsorted(np.flatnonzero(text == ord(",")), ends)
    if np.any(np.diff(commas, prepend=0) != columns - 1):
        return None
    try:
        numbers = np.array(list(map(float, data.replace(b"\n", b",")[:-1].split(b","))))
    except ValueError:
        return None
    return numbers.reshape(-1, columns) if np.isfinite(numbers).all() else None
