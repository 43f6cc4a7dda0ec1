"""Reader of text files of a log.

A text file, compressed or not, is divided into pieces of whole lines, which polars parses. If polars refuses a piece or
leaves a value empty, the piece is halved until Python reads the few lines in question one by one, which gives the place
and the reason, or a number that only `float()` accepts (blanks after a number). An unreadable row becomes NaN, together
with the text found; `gaps` decides what follows.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, islice
from pathlib import Path

import numpy as np
import polars as pl

from tumble.errors import LogError
from tumble.recording.log_source import (
    BLANK_LINE,
    Kind,
    LogSource,
    Tables,
    Unread,
    one_ahead,
    readable,
    rows_of_numbers,
)
from tumble.recording.session import LogSpec
from tumble.recording.text.clock import day_of, first_date_of, seconds_of
from tumble.recording.text.dialect import (
    BLANKS,
    FIRST_ROWS,
    LINE_BYTES,
    SEEN_BYTES,
    Dialect,
    head_lines,
    names_of_rows,
    numbered,
    top_of,
)
from tumble.recording.text.pieces import opened, whole_lines
from tumble.units import Array

_SLOW_BYTES = 1 << 14  # pieces that Python reads line by line


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TextLog(LogSource):
    """A text log in a dialect, with `top` lines above its first data row."""

    dialect: Dialect
    top: int

    def first_date(self, column: str) -> str | None:
        return first_date_of(self._cell(next(self.pieces(), b""), column))

    def read(self, columns: Sequence[str], clock: str | None) -> Tables:
        if missing := [column for column in columns if column not in self.names]:  # the first rows differ in width
            raise LogError(f"{self.path}: expected a column {missing[0]}, found {', '.join(self.names)}")
        first, day, pieces = 1, None, self.pieces()
        for piece in chain(islice(pieces, 1), one_ahead(pieces)):  # often only the first one is needed
            if clock is not None and day is None:  # times of day count from the first day
                day = day_of(self._cell(piece, clock))
            table, unread = self._rows(piece, first, columns, clock, day or 0)
            first += table.height
            yield table, unread

    def _rows(
        self, piece: bytes, first: int, columns: Sequence[str], clock: str | None, day: int
    ) -> tuple[pl.DataFrame, list[Unread]]:
        """Return the rows of a piece that begins with data row `first`, and its unreadable parts."""
        fast = self._at_once(piece, columns, clock, day)
        if fast is not None:
            return fast, []
        middle = piece.find(b"\n", len(piece) // 2) + 1
        if len(piece) <= _SLOW_BYTES or not 0 < middle < len(piece):
            return self._line_by_line(piece, first, columns, clock, day)
        above, unread = self._rows(piece[:middle], first, columns, clock, day)
        below, more = self._rows(piece[middle:], first + above.height, columns, clock, day)
        return pl.concat([above, below]), unread + more

    def _at_once(self, piece: bytes, columns: Sequence[str], clock: str | None, day: int) -> pl.DataFrame | None:
        """Return the rows of a piece as polars parses them.

        None if polars refuses them, leaves a value empty, or may have filled up short rows with nulls."""
        kinds = {name: pl.String if name == clock else pl.Float64 for name in columns}
        try:
            table = self._parsed(piece, {n if n in kinds else f"\0{j}": kinds.get(n) for j, n in enumerate(self.names)})
        except pl.exceptions.PolarsError:
            return None
        ends = np.frombuffer(piece, dtype=np.uint8) == ord("\n")  # four times as fast as `bytes.count`
        if table.height != int(np.count_nonzero(ends)) + (not piece.endswith(b"\n")):
            return None
        short = self.names[-1] not in kinds and table.to_series(-1).null_count() > 0
        if short and piece.count(self.separator.encode()) != table.height * (len(self.names) - 1):
            return None
        used = table.select(pl.col(columns))
        if clock is not None:
            used = used.with_columns(seconds_of(used[clock], day).alias(clock))
        return None if any(column.null_count() for column in used) else used

    def _line_by_line(
        self, piece: bytes, first: int, columns: Sequence[str], clock: str | None, day: int
    ) -> tuple[pl.DataFrame, list[Unread]]:
        """Return the result of `_rows` by Python's csv and float(), with the first unreadable value of each row."""
        lines = piece.decode("utf-8", errors="replace").removesuffix("\n").split("\n")
        numbers = np.full((len(lines), len(columns)), np.nan)
        clocks = [""] * len(lines)
        faults: dict[int, Unread] = {}
        for i, line in enumerate(line.removesuffix("\r") for line in lines):
            fault = partial(Unread, row=first + i, column=None)
            try:
                values, found = self.cells(line), ""
            except csv.Error as error:
                values, found = [], str(error)
            is_row = any(self.dialect.is_number(v.strip()) for v in values)
            if not line.strip() or self.dialect.is_comment(line):
                faults[i] = fault(found=line if line.strip() else BLANK_LINE, kind=Kind.NO_ROW)
            elif found or (len(values) != len(self.names) and is_row):
                faults[i] = fault(found=found or f"{len(values)} values", kind=Kind.ROW)
            elif len(values) != len(self.names):
                faults[i] = fault(found=line.strip(), kind=Kind.TEXT)
            for j, column in enumerate(columns if i not in faults else ()):
                cell = values[self.names.index(column)]
                if column == clock:
                    clocks[i] = cell
                    continue
                try:
                    if "_" in cell:  # float() reads a date such as 2026_06_15 as a number
                        raise ValueError(cell)
                    numbers[i, j] = float(cell.replace(",", ".") if self.dialect.decimal == "," else cell)
                except ValueError:
                    faults.setdefault(i, fault(column=column, found=cell, kind=Kind.VALUE))
        if clock is not None:
            times = seconds_of(pl.Series(clocks, dtype=pl.String), day)
            numbers[:, columns.index(clock)] = times.fill_null(np.nan).to_numpy()
            for i in np.flatnonzero(times.is_null().to_numpy()).tolist():
                if i not in faults or faults[i].kind == Kind.VALUE:
                    faults[i] = Unread(row=first + i, column=clock, found=clocks[i], kind=Kind.VALUE)
        last = len(lines) - 1
        if last in faults and faults[last].kind != Kind.NO_ROW and not piece.endswith(b"\n"):
            faults[last] = replace(faults[last], kind=Kind.CUT)
        table = pl.DataFrame(numbers, schema=list(columns), orient="row")
        return table, [fault for _, fault in sorted(faults.items())]

    def _parsed(self, piece: bytes, kinds: Mapping[str, type[pl.DataType] | None]) -> pl.DataFrame:
        """Return all columns of a piece as polars parses them, as text where no kind is stated."""
        schema = {name: kind or pl.String for name, kind in kinds.items()}
        comma = self.dialect.decimal == ","
        return pl.read_csv(piece, has_header=False, schema=schema, separator=self.separator, decimal_comma=comma)

    def whole(self, numbers: Sequence[str]) -> Iterator[pl.DataFrame]:
        """Yield rows of all columns, `numbers` as float64.

        With a stated dialect unreadable numbers become NaN and lines that are no rows are left out; otherwise polars'
        errors are raised."""
        mark = "," if self.dialect.decimal == "," else "."
        number = pl.col(list(numbers)).str.strip_chars().str.replace(mark, ".", literal=True)
        with readable(self.path), rows_of_numbers(self.path):
            for piece in self.pieces():
                try:
                    yield self._parsed(piece, {name: pl.Float64 if name in numbers else None for name in self.names})
                except pl.exceptions.PolarsError:
                    if self.dialect == Dialect():
                        raise
                    lines = piece.decode("utf-8", errors="replace").splitlines()
                    rows = [self.dialect.cells(line) for line in lines if not self.dialect.is_comment(line)]
                    rows = [cells for cells in rows if len(cells) == len(self.names)]
                    table = pl.DataFrame(rows, schema=dict.fromkeys(self.names, pl.String), orient="row")
                    yield table.with_columns(number.cast(pl.Float64, strict=False).fill_null(np.nan))

    def pieces(self) -> Iterator[bytes]:
        """Yield the rows in pieces of whole lines, with tabs in place of blanks as delimiters."""
        with readable(self.path), opened(self.path, self.dialect.encoding) as stream:
            for _ in range(self.top):
                stream.readline(LINE_BYTES)
            for piece in whole_lines(stream, self.path):
                piece = piece.removeprefix(codecs.BOM_UTF8) if self.top == 0 else piece
                piece = piece.replace(b"\0", b"") if b"\0" in piece else piece  # left by the reset of a logger
                if self.dialect.delimiter == BLANKS:
                    piece = piece.replace(b"\t", b" ").replace(b"\r\n", b"\n")
                    piece = re.sub(rb" *\n *", b"\n", re.sub(rb"(?<=[^ \n]) +(?=[^ \n])", b"\t", piece)).strip(b" ")
                yield piece

    @property
    def separator(self) -> str:
        """The delimiter in `pieces`."""
        return "\t" if self.dialect.delimiter == BLANKS else self.dialect.delimiter

    def _cell(self, piece: bytes, column: str) -> str:
        cells = self.cells(piece[: piece.find(b"\n")].decode("utf-8", errors="replace"))
        at = self.names.index(column)
        return cells[at] if at < len(cells) else ""

    def cells(self, line: str) -> list[str]:
        """Return the values in a line of a piece."""
        return next(csv.reader([line], delimiter=self.separator, skipinitialspace=True), [])

    def row_in_words(self, row: int) -> str:
        return f"row {row} (line {row + self.top})"


def text_log(path: Path, dialect: Dialect | None) -> TextLog:
    """Return the reader of a text log, with names in the first line unless a dialect is stated."""
    if dialect is None:
        with opened(path) as stream:
            first, *lines = [stream.readline(LINE_BYTES) for _ in range(1 + FIRST_ROWS)]
        try:
            line = first.decode("utf-8-sig", errors="replace").replace("\0", "").rstrip("\r\n")
            above = next(csv.reader([line], skipinitialspace=True), [])
        except csv.Error as error:
            raise LogError(f"{path}: expected the names of the columns in the first line, found: {error}") from None
        below = (Dialect().cells(line.decode("utf-8", errors="replace").strip()) for line in lines)
        names = names_of_rows([name.strip() for name in above], [cells for cells in below if cells])
        return TextLog(path=path, names=numbered(names), dialect=Dialect(), top=1)
    with opened(path, dialect.encoding) as stream:
        top = top_of(head_lines(stream.read(SEEN_BYTES)), dialect)
    if top is None:
        raise LogError(f"{path}: expected rows of numbers with log.delimiter {dialect.delimiter!r}, found none")
    return TextLog(path=path, names=top.names, dialect=dialect, top=top.lines)


def times_of(column: pl.Series, spec: LogSpec) -> Array:
    """Return the times, s, of a log's time column in a table with all columns."""
    if spec.clock and column.dtype == pl.String:
        return seconds_of(column, 0).to_numpy()
    if isinstance(column.dtype, pl.Datetime):
        since = (column - column.dt.truncate("1d")[0]).dt.total_nanoseconds()
        return np.asarray(since.to_numpy() * 1e-9)
    comma = spec.dialect is not None and spec.dialect.decimal == "," and column.dtype == pl.String
    numbers = (column.str.replace(",", ".") if comma else column).cast(pl.Float64)
    return np.asarray(numbers.to_numpy() * spec.time_factor)
