"""Lines as they are received, and the rows of a log in them.

A row is a line of numbers between commas, an object of JSON by the names of the columns, or a `Raw:` line of MotionCal,
nine integers without a time. What is no row is refused, and said: bytes that are no text, half lines, too few values.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

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


@dataclass(kw_only=True, slots=True)
class Lines:
    """Cuts what is received into lines and makes rows of them, of the columns `columns`, of which `clock` is the time.
    `refused` counts what was no row, `last_refused` is why the last one was none."""

    columns: tuple[str, ...]
    clock: str | None
    refuse: Callable[[bytes], None]
    now: Callable[[], float] = time.time
    refused: int = 0
    last_refused: str = ""
    _rest: bytes = b""
    _order: list[int] = field(default_factory=list)
    _expected: int = 0

    def __post_init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """The connection is new: half a line from before is no row, and columns are in the order of the log until a
        header says otherwise."""
        if self._rest:
            self._refuse(self._rest, "half a line")
        self._rest, self._order, self._expected = b"", list(range(len(self.columns))), len(self.columns)

    @property
    def in_order(self) -> bool:
        """Whether lines have the columns of the log and no others, in its order."""
        return self._expected == len(self.columns) and self._order == list(range(self._expected))

    def feed(self, data: bytes) -> list[Row]:
        """The rows in what is received next."""
        return self.rows(self.cut(data))

    def cut(self, data: bytes) -> bytes:
        """The whole lines in what is received next."""
        whole, newline, rest = (self._rest + data).rpartition(b"\n")
        self._rest = rest
        if len(self._rest) > LONGEST_LINE:
            self._refuse(self._rest, "no end of a line")
            self._rest = b""
        return whole + newline

    def rows(self, whole: bytes) -> list[Row]:
        """The rows in whole lines."""
        rows = (self._row(line) for line in whole.split(b"\n"))
        return [row for row in rows if row is not None]

    def _row(self, raw: bytes) -> Row | None:
        line = raw.strip(b" \t\r")
        if not line:
            return None
        try:
            text = line.decode("ascii" if not line.startswith(b"{") else "utf-8")
        except UnicodeDecodeError:
            text = line.decode("utf-8", errors="replace")
            if self._is_header(text.split(",")):
                return None
            return self._refuse(raw, "bytes that are no text")
        if text.startswith("{"):
            return self._from_json(raw, text)
        if text.startswith(MOTIONCAL):
            return self._from_motioncal(raw, text)
        values = [value.strip() for value in text.split(",")]
        return None if self._is_header(values) else self._from_values(raw, values)

    def _is_header(self, values: Sequence[str]) -> bool:
        """Whether these are the names of the columns; if so, in what order the values are."""
        names = [value.strip().lstrip("\ufeff") for value in values]
        if not set(self.columns) <= set(names):
            return False
        self._order, self._expected = [names.index(column) for column in self.columns], len(names)
        return True

    def _from_values(self, raw: bytes, values: Sequence[str]) -> Row | None:
        if len(values) != self._expected:
            return self._refuse(raw, f"{len(values)} values where {self._expected} are expected")
        chosen = [values[i] for i in self._order]
        try:
            numbers = [float(value) for value in chosen]
        except ValueError:
            return self._refuse(raw, "a value that is no number")
        at = None if self.clock is None else numbers[self.columns.index(self.clock)]
        if any(math.isinf(number) for number in numbers) or (at is not None and math.isnan(at)):
            return self._refuse(raw, "a number that is not finite")
        return Row(text=",".join(chosen), time=at)

    def _from_json(self, raw: bytes, text: str) -> Row | None:
        try:
            given = json.loads(text)
            values = [repr(float(given[column])) for column in self.columns]
        except (ValueError, TypeError, KeyError, RecursionError, OverflowError):
            return self._refuse(raw, "JSON without a number for every column")
        return self._chosen(raw, values)

    def _from_motioncal(self, raw: bytes, text: str) -> Row | None:
        values = text.removeprefix(MOTIONCAL).split(",")
        if self.columns != MOTIONCAL_COLUMNS or len(values) != len(MOTIONCAL_COLUMNS) - 1:
            return self._refuse(raw, "a line of MotionCal that is not nine numbers")
        try:
            numbers = [int(value) for value in values]
        except ValueError:
            return self._refuse(raw, "a line of MotionCal that is not nine numbers")
        field_ut = [repr(number / _MAGNETIC_COUNTS) for number in numbers[6:]]
        return self._chosen(raw, [repr(self.now()), *map(str, numbers[:6]), *field_ut])

    def _chosen(self, raw: bytes, values: Sequence[str]) -> Row | None:
        """A row of values that are in the order of the columns."""
        order, expected = self._order, self._expected
        self._order, self._expected = list(range(len(self.columns))), len(self.columns)
        try:
            return self._from_values(raw, values)
        finally:
            self._order, self._expected = order, expected

    def _refuse(self, raw: bytes, why: str) -> Row | None:
        """Count and keep what is no row, which is why there is none."""
        self.refused += 1
        self.last_refused = why
        self.refuse(raw[:LONGEST_LINE])
        return None


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
        found = np.array(list(map(float, data.replace(b"\n", b",")[:-1].split(b","))))
    except ValueError:
        return None
    return found.reshape(-1, columns) if np.isfinite(found).all() else None
