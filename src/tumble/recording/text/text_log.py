"""A text file of a log.

A text file, compressed or not, is cut into pieces of whole lines for polars to parse, whatever its dialect. Where
polars refuses a piece, or leaves a value empty, the piece is halved until Python can read the few lines in question
one by one: it says where and why, or reads what only `float()` accepts (blanks after a number). A row that cannot be
read is not dropped here: it comes as NaN, together with what was found, and `gaps` decides.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl

from tumble.errors import LogError
from tumble.recording.log_source import (
    Kind,
    Unread,
    first_numbers,
    in_column,
    readable,
    rows_of_numbers,
)
from tumble.recording.text.clock import date_of, day_of, seconds_of
from tumble.recording.text.dialect import BLANKS, FIRST_ROWS, LINE_BYTES, Dialect, head_lines, names_of_rows, top_of
from tumble.recording.text.pieces import header, opened, whole_lines
from tumble.units import Array

_SLOW_BYTES = 1 << 14


@dataclass(frozen=True, kw_only=True, slots=True)
class TextLog:
    """A text log. Rows that cannot be read come as NaN, with what was found in them."""

    path: Path
    names: tuple[str, ...]
    dialect: Dialect
    top: int
    """Lines above the first data row."""

    def head(self, column: str, rows: int, *, clock: bool = False) -> Array:
        return first_numbers(self, column, rows, clock=clock)

    def first_date(self, column: str) -> str | None:
        return date_of(self._cell(next(self.pieces(), b""), column))

    def tables(self, columns: Sequence[str], clock: str | None = None) -> Iterator[tuple[pl.DataFrame, list[Unread]]]:
        first, text = 1, _Text(self, columns, clock)
        for piece in self.pieces():
            if clock is not None and text.day is None:
                text.day = day_of(self._cell(piece, clock))
            table, unread = text.table(piece, first)
            first += table.height
            yield table, unread

    def whole(self, numbers: Sequence[str]) -> Iterator[pl.DataFrame]:
        with readable(self.path), rows_of_numbers(self.path):
            for table in _text_tables(self, numbers):
                yield table.with_columns(pl.col(numbers).cast(pl.Float64))

    def pieces(self) -> Iterator[bytes]:
        """The rows in pieces of whole lines that are parsed alike whatever the dialect."""
        with readable(self.path), opened(self.path, self.dialect.encoding) as stream:
            for _ in range(self.top):
                stream.readline(LINE_BYTES)
            for piece in whole_lines(stream, self.path):
                piece = piece.removeprefix(codecs.BOM_UTF8) if self.top == 0 else piece
                yield _with_tabs(piece) if self.dialect.delimiter == BLANKS else piece

    @property
    def separator(self) -> str:
        """What stands between the values of `pieces`."""
        return "\t" if self.dialect.delimiter == BLANKS else self.dialect.delimiter

    def _cell(self, piece: bytes, column: str) -> str:
        cells = self.cells(piece[: piece.find(b"\n")].decode("utf-8", errors="replace"))
        at = self.names.index(column)
        return cells[at] if at < len(cells) else ""

    def cells(self, line: str) -> list[str]:
        """The values in a line of a piece."""
        return next(csv.reader([line], delimiter=self.separator), [])

    def place(self, row: int, column: str | None = None) -> str:
        return f"{self.path}: row {row} (line {row + self.top})" + in_column(column)


@dataclass(kw_only=False, slots=True)
class _Text:
    """The numbers of some columns in pieces of a text log. `day`: the day from which a clock counts."""

    source: TextLog
    columns: Sequence[str]
    clock: str | None
    day: int | None = None

    def table(self, piece: bytes, first: int) -> tuple[pl.DataFrame, list[Unread]]:
        """The rows of a piece that begins with data row `first`. Where there is something to be said about them, it is
        halved until few lines are left, which Python reads."""
        fast = self._at_once(piece)
        if fast is not None:
            return fast, []
        middle = piece.find(b"\n", len(piece) // 2) + 1
        if len(piece) <= _SLOW_BYTES or not 0 < middle < len(piece):
            return self._line_by_line(piece, first)
        above, said = self.table(piece[:middle], first)
        below, more = self.table(piece[middle:], first + above.height)
        return pl.concat([above, below]), said + more

    def _at_once(self, piece: bytes) -> pl.DataFrame | None:
        """The rows of a piece as polars reads them; None where it refuses, or leaves a value empty."""
        names = self.source.names
        kinds = {name: pl.String if name == self.clock else pl.Float64 for name in self.columns}
        schema = {(n if n in kinds else f"\0{j}"): kinds.get(n, pl.String) for j, n in enumerate(names)}
        comma = self.source.dialect.decimal == ","
        try:
            table = pl.read_csv(
                piece, has_header=False, schema=schema, separator=self.source.separator, decimal_comma=comma
            )
        except pl.exceptions.PolarsError:
            return None
        if table.height != _lines_in(piece):
            return None
        if names[-1] not in kinds and self._may_be_short(table, piece):
            return None
        used = table.select(pl.col(self.columns))
        if self.clock is not None:
            used = used.with_columns(seconds_of(used[self.clock], self.day or 0).alias(self.clock))
        return None if any(column.null_count() for column in used) else used

    def _may_be_short(self, table: pl.DataFrame, piece: bytes) -> bool:
        """Whether there may be rows with too few values, which polars fills up with nulls from the end."""
        if not table.to_series(-1).null_count():
            return False
        return piece.count(self.source.separator.encode()) != table.height * (len(self.source.names) - 1)

    def _line_by_line(self, piece: bytes, first: int) -> tuple[pl.DataFrame, list[Unread]]:
        """What `table` gives, by Python's csv and float(), which can say what is wrong in which row."""
        ended = piece.endswith(b"\n")
        lines = piece.decode("utf-8", errors="replace").removesuffix("\n").split("\n")
        numbers = np.full((len(lines), len(self.columns)), np.nan)
        unread: list[Unread] = []
        for i, line in enumerate(lines):
            last = i == len(lines) - 1 and not ended
            found = self._numbers(line.removesuffix("\r"), numbers[i])
            if found is not None:
                cut = last and found.kind != Kind.NO_ROW
                unread.append(replace(found, row=first + i, kind=Kind.CUT if cut else found.kind))
        return pl.DataFrame(numbers, schema=list(self.columns), orient="row"), unread

    def _numbers(self, line: str, out: Array) -> Unread | None:
        """Put the numbers of a line into `out`, NaN where one cannot be read; what was found instead of the first."""
        if not line.strip() or self.source.dialect.is_comment(line):
            return Unread(row=0, column=None, found="a blank line" if not line.strip() else line, kind=Kind.NO_ROW)
        try:
            values = self.source.cells(line)
        except csv.Error as error:
            return Unread(row=0, column=None, found=str(error), kind=Kind.ROW)
        if len(values) != len(self.source.names):
            number = self.source.dialect.is_number
            text = not any(number(v.strip()) for v in values)
            found = line.strip() if text else f"{len(values)} values"
            return Unread(row=0, column=None, found=found, kind=Kind.TEXT if text else Kind.ROW)
        fault: Unread | None = None
        for j, column in enumerate(self.columns):
            text_of = values[self.source.names.index(column)]
            try:
                out[j] = self._number(column, text_of)
            except ValueError:
                fault = fault or Unread(row=0, column=column, found=text_of, kind=Kind.VALUE)
        return fault

    def _number(self, column: str, text: str) -> float:
        if column == self.clock:
            seconds = seconds_of(pl.Series([text], dtype=pl.String), self.day or 0)[0]
            if seconds is None:
                raise ValueError(text)
            return float(seconds)
        if "_" in text:  # a date such as 2026_06_15, which float() takes for a number
            raise ValueError(text)
        return float(text.replace(",", ".") if self.source.dialect.decimal == "," else text)


def _lines_in(piece: bytes) -> int:
    """How many lines a piece has; numpy counts four times as fast as `bytes.count`."""
    ends = np.frombuffer(piece, dtype=np.uint8) == ord("\n")
    return int(np.count_nonzero(ends)) + (not piece.endswith(b"\n"))


def _with_tabs(piece: bytes) -> bytes:
    """Rows of values between blanks as rows of values between single tabs."""
    blank = piece.replace(b"\t", b" ").replace(b"\r\n", b"\n")
    return re.sub(rb" *\n *", b"\n", re.sub(rb"(?<=[^ \n]) +(?=[^ \n])", b"\t", blank)).strip(b" ")


def text_log(path: Path, dialect: Dialect | None) -> TextLog:
    """A text log: with its names in the first line, unless a dialect is stated."""
    if dialect is None:
        with opened(path) as stream:
            names = header(stream, path)
            lines = [stream.readline(LINE_BYTES).decode("utf-8", errors="replace") for _ in range(FIRST_ROWS)]
        rows = [cells for line in lines if (cells := Dialect().cells(line.strip()))]
        return TextLog(path=path, names=names_of_rows(names, rows), dialect=Dialect(), top=1)
    with opened(path, dialect.encoding) as stream:
        top = top_of(head_lines(stream), dialect)
    if top is None:
        raise LogError(f"{path}: expected rows of numbers with log.delimiter {dialect.delimiter!r}, found none")
    return TextLog(path=path, names=top.names, dialect=dialect, top=top.lines)


def _text_tables(source: TextLog, numbers: Sequence[str]) -> Iterator[pl.DataFrame]:
    """The rows of a text log with all columns, these as numbers and the others as the text they are. Of a log of a
    stated dialect, what cannot be read is NaN, and lines that are no rows are left out; else polars' errors are
    raised."""
    schema = {name: pl.Float64 if name in numbers else pl.String for name in _distinct(source.names)}
    comma = source.dialect.decimal == ","
    for piece in source.pieces():
        try:
            yield pl.read_csv(piece, has_header=False, schema=schema, separator=source.separator, decimal_comma=comma)
        except pl.exceptions.PolarsError:
            if source.dialect == Dialect():
                raise
            yield _text_table(source, piece, schema)


def _text_table(source: TextLog, piece: bytes, schema: Mapping[str, type[pl.DataType]]) -> pl.DataFrame:
    rows = []
    for line in piece.decode("utf-8", errors="replace").splitlines():
        try:
            cells = source.cells(line)
        except csv.Error:
            continue
        if len(cells) == len(schema) and not source.dialect.is_comment(line):
            rows.append(cells)
    text = pl.DataFrame(rows, schema=dict.fromkeys(schema, pl.String), orient="row")
    point = pl.col([name for name, kind in schema.items() if kind == pl.Float64]).str.strip_chars()
    point = point.str.replace(",", ".") if source.dialect.decimal == "," else point
    return text.with_columns(point.cast(pl.Float64, strict=False).fill_null(float("nan")))


def _distinct(names: Sequence[str]) -> list[str]:
    """Names of all columns; those without one, or with that of another, get a number."""
    seen: set[str] = set()
    out = []
    for j, name in enumerate(names):
        out.append(f"column {j + 1}" if not name or name in seen else name)
        seen.add(name)
    return out
