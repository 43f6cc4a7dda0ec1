"""Lines as they are received, and the rows of a log in them.

A row is a line of numbers between commas, an object of JSON by the names of the columns, or a `Raw:` line of MotionCal,
nine integers without a time. What is no row is refused, and said: bytes that are no text, half lines, too few values.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tumble.units import Array

LONGEST_LINE = 1 << 14
MOTIONCAL = "Raw:"
MOTIONCAL_COLUMNS = ("t", "ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz")
_OF_NUMBERS = np.isin(np.arange(256), np.frombuffer(b"0123456789.,+-eE\n", dtype=np.uint8))
_MAGNETIC_COUNTS = 10.0  # a µT, as MotionCal has them


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """A row of the log as text, and its time as the log has it, None in a log without times."""

    text: str
    time: float | None


class Lines:
    """Cuts what is received into lines and makes rows of them, of the columns `columns`, of which `clock` is the time.
    Values are in the order of the log until a header says otherwise. `refused` counts what was no row, `last_refused`
    is why the last one was none."""

    def __init__(
        self,
        *,
        columns: tuple[str, ...],
        clock: str | None,
        refuse: Callable[[bytes], None],
        now: Callable[[], float] = time.time,
    ) -> None:
        self.columns, self.clock, self._now = columns, clock, now
        self.refused, self.last_refused = 0, ""
        self._keep = refuse
        self._unfinished = b""
        self._sent_columns: list[str] = list(columns)

    @property
    def in_order(self) -> bool:
        """Whether lines have the columns of the log and no others, in its order."""
        return self._sent_columns == list(self.columns)

    def feed(self, data: bytes) -> list[Row]:
        """The rows in what is received next."""
        return self.rows(self.cut(data))

    def cut(self, data: bytes) -> bytes:
        """The whole lines in what is received next."""
        whole, newline, self._unfinished = (self._unfinished + data).rpartition(b"\n")
        if len(self._unfinished) > LONGEST_LINE:
            self._refuse(self._unfinished, "no end of a line")
            self._unfinished = b""
        return whole + newline

    def rows(self, whole: bytes) -> list[Row]:
        """The rows in whole lines; what is none of them is counted and kept, which is why there is none."""
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
        """The numbers (m, columns) of the rows in whole lines."""
        numbers = numbers_in(whole, len(self.columns)) if self.in_order else None
        if numbers is not None:
            return numbers
        values = [float(value) for row in self.rows(whole) for value in row.text.split(",")]
        return np.array(values).reshape(-1, len(self.columns))

    def _refuse(self, raw: bytes, why: str) -> None:
        self.refused, self.last_refused = self.refused + 1, why
        self._keep(raw[:LONGEST_LINE])

    def _row(self, line: bytes) -> Row | None:
        """The row of a line; None of an empty one and of a header. Raises ValueError that says why there is none."""
        if line.startswith(b"{"):
            try:
                given = json.loads(line.decode("utf-8"))
                chosen = [repr(float(given[column])) for column in self.columns]
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
            chosen = [repr(self._now()), *map(str, counts[:6]), *field]
        else:
            values = [value.strip() for value in line.decode("utf-8", errors="replace").split(",")]
            names = [value.lstrip("\ufeff") for value in values]
            if set(self.columns) <= set(names):
                self._sent_columns = names
                return None
            if not line.isascii():
                raise ValueError("bytes that are no text")
            if not line:
                return None
            if len(values) != len(self._sent_columns):
                raise ValueError(f"{len(values)} values where {len(self._sent_columns)} are expected")
            chosen = [values[self._sent_columns.index(column)] for column in self.columns]
        try:
            numbers = [float(value) for value in chosen]
        except ValueError:
            raise ValueError("a value that is no number") from None
        at = None if self.clock is None else numbers[self.columns.index(self.clock)]
        if any(map(math.isinf, numbers)) or (at is not None and math.isnan(at)):
            raise ValueError("a number that is not finite")
        return Row(text=",".join(chosen), time=at)


def numbers_in(data: bytes, columns: int) -> Array | None:
    """Rows of whole lines that are nothing but numbers between commas; None where a line is anything else."""
    text = np.frombuffer(data, dtype=np.uint8)
    if not len(data) or not _OF_NUMBERS[text].all():
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
