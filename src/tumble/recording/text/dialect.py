"""Text logs as instruments, phones and laboratories write them: what stands between the numbers, and where they begin.

`Dialect` is what session.toml says of a text log (`delimiter`, `decimal`, `comment`, `header`, `encoding`);
`dialect_of` finds it in the first lines of a file. `Top` is what stands above the first row of numbers: the names of
the columns are in the last line there that has as many of them as the rows have numbers; a line of units below it
belongs to the names.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any

LINE_BYTES = 1 << 18
"""The longest line of a log: what reads its values takes four hundred times as much memory."""
FIRST_ROWS = 5
"""By which it is found out whether a name is missing."""
SEEN_BYTES = 1 << 18
"""By which it is found out how a file is written."""
BLANKS = " "
"""The delimiter that stands for one or more blanks or tabs."""

DELIMITERS = (",", ";", "\t", "|", BLANKS)
COMMENTS = ("#", "//", "%", "!", ";", "*")

_TOP_LINES = 2000
_LEAST_NUMBERS = 3
_ENCODINGS = {"utf-8": "", "cp1251": "[а-яё]{3}", "gb18030": "[\u4e00-\u9fff]{2}"}
"""Those that are tried, and the letters of which text in them has words: a degree sign alone is Latin."""
_BOMS = {codecs.BOM_UTF8: "utf-8", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}

_POINT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?nan|[+-]?inf", re.IGNORECASE)
_COMMA = re.compile(r"[+-]?(\d+|\d*,\d+)([eE][+-]?\d+)?|[+-]?nan|[+-]?inf", re.IGNORECASE)
_CLOCK = re.compile(
    r"(\d{1,4}[-./]\d{1,2}[-./]\d{1,4}[T ]?)?\s*"
    r"(\d{1,2}:\d{2}(:\d{2}([.,:]\d+)?|[.,]\d+)?\s*([AaPp]\.?[Mm]\.?)?\s*(Z|[+-]\d\d:?\d\d)?)?"
)
JOINED = (
    r"(\d{4})[_-]?(\d{2})[_-]?(\d{2})[_ T-](\d{2})[_:-]?(\d{2})[_:-]?(\d{2})(?:[._-](\d+))?",
    r"(\d{4})[_-](\d{1,2})[_-](\d{1,2})[_-](\d{1,2})[_-](\d{2})[_-](\d{2})(?:[._-](\d+))?",
)
"""A date with a time of day whose parts are joined alike or not at all: 2026_6_15_18_21_44.62, 20260615 182144."""
_JOINED = re.compile("|".join(JOINED))
GPS_WEEK = r"(\d{3,4}):(\d{1,6}(?:\.\d+)?)"
"""A GPS week, whole or in its last digits, and a second in it."""
_GPS_WEEK = re.compile(GPS_WEEK)
MONTHS = "jan", "feb", "m[aä]r|mrz", "apr", "ma[iy]", "jun", "jul", "aug", "sep", "o[ck]t", "nov", "de[cz]"
"""How the names of months begin in English and German."""
NAMED_MONTH = (
    r"(?i)(?P<day>\d{{1,2}})[-/. ](?:{0})[a-zä]*[-/. ](?P<year>\d{{4}})",
    r"(?i)(?:{0})[a-zä]*\.? (?P<day>\d{{1,2}}),? (?P<year>\d{{4}})",
    r"(?i)(?:^[a-z]{{2,3}},? +)?(?:{0}) +(?P<day>\d{{1,2}}) +"
    r"(?P<time>\d+:\d\d:\d\d)(?: [a-z]{{3,4}})? +(?P<year>\d{{4}})",
)
"""A date whose month has a name: 15-Jun-2026, Jun 15, 2026, and as C prints it, Mon Jun 15 12:34:56 2026."""
_NAMED_MONTH = [re.compile(date.format("|".join(MONTHS))) for date in NAMED_MONTH]


_PLAIN, _BEYOND_PLAIN = 4096, re.compile('["\r\n\0]')
"""A line shorter than so many characters and without any of these ends no cell but at its delimiters."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Dialect:
    """How a text log is written; the default is a CSV file with its names in the first line."""

    delimiter: str = ","
    decimal: str = "."
    comment: str | None = None
    header: bool = True
    encoding: str = "utf-8"

    def keys(self) -> dict[str, Any]:
        """The keys of [log] that say so: what differs from a plain CSV file, and the delimiter."""
        given = asdict(self)
        return {k: v for k, v in given.items() if k == "delimiter" or v != getattr(Dialect(), k)}

    def cells(self, line: str) -> list[str]:
        """What stands in a line, without blanks about it. A line that is no CSV is one cell."""
        if self.delimiter == BLANKS:
            return line.split()
        if line and len(line) < _PLAIN and not _BEYOND_PLAIN.search(line):  # much faster than the reader
            return [cell.strip() for cell in line.split(self.delimiter)]
        try:
            return [cell.strip() for cell in next(csv.reader([line], delimiter=self.delimiter), [])]
        except csv.Error:
            return [line]

    def is_number(self, cell: str) -> bool:
        """Whether a cell is a number with the decimal mark of the dialect."""
        return bool((_POINT if self.decimal == "." else _COMMA).fullmatch(cell))

    def is_comment(self, line: str) -> bool:
        """Whether a line begins with the mark of comments."""
        return self.comment is not None and line.lstrip().startswith(self.comment)

    def is_row(self, cells: Sequence[str]) -> bool:
        """Whether cells are a row of numbers: at least three, and as many as everything else."""
        if len(cells) < _LEAST_NUMBERS:
            return False
        numbers, filled = sum(map(self.is_number, cells)), sum(map(bool, cells))
        return numbers >= _LEAST_NUMBERS and (
            2 * numbers >= filled or 2 * (numbers + sum(map(is_clock, cells))) >= filled
        )


DIALECT_KEYS = tuple(asdict(Dialect()))


@dataclass(frozen=True, kw_only=True, slots=True)
class Top:
    """The names of the columns, how many lines stand above the first row of numbers, and those of them that are
    neither names nor units."""

    names: tuple[str, ...]
    lines: int
    preamble: tuple[str, ...] = ()


def is_clock(cell: str) -> bool:
    """Whether a cell is a time of day, a date with one, or a second in a week."""
    for date in _NAMED_MONTH if ":" in cell else ():
        cell = date.sub(lambda found: f"1.1.2000 {found.groupdict().get('time', '')}", cell)
    clock = ":" in cell and (_CLOCK.fullmatch(cell) or _GPS_WEEK.fullmatch(cell))
    return bool(clock or _JOINED.fullmatch(cell))


# -------------------- what stands above the numbers --------------------


@lru_cache(maxsize=4)
def top_of(lines: tuple[str, ...], dialect: Dialect) -> Top | None:
    """What stands above the first row of numbers in the first lines of a file; None where no such row is. Remembered,
    because a file is opened several times on the way to a calibration."""
    rows = {i: len(cells) for i, line in enumerate(lines) if dialect.is_row(cells := dialect.cells(line))}
    if 0 in rows:  # it may have the numbers of the columns, above those of the rows: `,0,1,2,…`, as pandas writes it
        empty, *others = dialect.cells(lines[0])
        if not empty and others == [str(k) for k in range(len(others))]:
            del rows[0]
    plain_rows = [(i, width) for i, width in rows.items() if not dialect.is_comment(lines[i])]
    following = [width for _, width in plain_rows[1:]] + [None]
    first = next((i for (i, width), after in zip(plain_rows, following, strict=True) if after in (None, width)), None)
    if first is None:
        return None
    width = Counter(width for i, width in rows.items() if i >= first).most_common(1)[0][0]
    above = [line.lstrip().lstrip(dialect.comment) if dialect.is_comment(line) else line for line in lines[:first]]
    below = [dialect.cells(lines[i]) for i, columns in rows.items() if i >= first and columns == width][:FIRST_ROWS]
    named = {i: n for i, line in enumerate(above) if (n := _names(dialect.cells(line), below, dialect)) is not None}
    names, used = tuple(str(i + 1) for i in range(width)), set[int]()
    plain = [i for i, n in named.items() if sum(map(dialect.is_number, n)) < _LEAST_NUMBERS]
    at = max(plain or named, default=-1) if dialect.header else -1  # a row with much text may stand below the names
    if at >= 0 and any(line.strip() for line in above[at + 1 :]) and not _tells(named[at]):  # words of a start
        at = max((i for i in plain if _tells(named[i])), default=-1)
    if at >= 0:
        names, used = named[at], {at}
        if at - 1 in named and _are_units(names):
            at, units = at - 1, names
            names = tuple(
                f"{name} [{_bare(unit)}]".removesuffix(" []") for name, unit in zip(named[at], units, strict=True)
            )
            used.add(at)
        grouped = _grouped(names, dialect.cells(above[at - 1])) if at else None
        if grouped is not None:
            names = grouped
            used.add(at - 1)
    preamble = (" ".join(line.split()) for i, line in enumerate(above) if i not in used)
    return Top(names=numbered(names), lines=first, preamble=tuple(filter(None, preamble)))


def _names(cells: Sequence[str], rows: Sequence[Sequence[str]], dialect: Dialect) -> tuple[str, ...] | None:
    """The names in a line, as many as the rows below have columns; None where it has none."""
    names = names_of_rows([cell.strip().strip('"') for cell in cells], rows)
    if len(names) != len(rows[0]) or not names[1] or sum(map(bool, names)) < _LEAST_NUMBERS:
        return None
    return None if 2 * sum(map(dialect.is_number, names)) > sum(map(bool, names)) else names


def _grouped(names: tuple[str, ...], above: Sequence[str]) -> tuple[str, ...] | None:
    """Names of which some come again, x, y, z, x, y, z, with what stands above them, over the first of each group; None
    where that does not tell them apart."""

    def plain(names: Sequence[str]) -> list[str]:
        return [re.sub(r"\s*[\[(].*", "", name).lower() for name in names]  # without units

    again = [bool(name) and plain(names).count(name) > 1 for name in plain(names)]
    if not any(again) or len(above) != len(names):
        return None
    group, found = "", []
    for name, own, shared in zip(names, above, again, strict=True):
        group = own or group
        if shared:
            found.append(f"{group} {name}".strip())
        else:
            found.append(f"{own} [{_bare(name)}]" if own and name and _are_units([name]) else name or own)
    every = plain([name for name in found if name])
    return tuple(found) if len(set(every)) == len(every) else None


def names_of_rows(names: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Names of as many columns as most rows have. Empty ones at the end go where rows have no such columns; where one
    is missing it is that of the first column if this numbers the rows, as R writes them, else of the last, as where
    rows end with a comma."""
    width = Counter(map(len, rows)).most_common(1)[0][0] if rows else len(names)
    while len(names) > width and not names[-1]:
        names = names[:-1]
    if len(names) != width - 1:
        return (*names, *[""] * (width - len(names)))
    wider = [cells for cells in rows if len(cells) == width]
    numbers = [cells[0].strip('"') for cells in wider]
    numbered = any(numbers == [str(first + i) for i in range(len(numbers))] for first in (0, 1))
    if numbered and all(cells[-1] for cells in wider) and not _COUNTS.fullmatch(names[0]):
        return ("", *names)
    return (*names, "")


def numbered(names: Sequence[str]) -> tuple[str, ...]:
    """Names of columns, each another: a column whose name is missing or shared is called by its number, from 1."""
    counts = Counter(names)
    return tuple(
        name if name and counts[name] == 1 else f"column {j}" if str(j) in counts else str(j)
        for j, name in enumerate(names, 1)
    )


_COUNTS = re.compile(
    r"\W*(sample|packet|frame|row|seq|record)?[ _]?(count(er)?|index|idx|id|n|nr|no|number|sample|seq|row)\W*", re.I
)
"""Names of columns that number rows."""


def _tells(names: Sequence[str]) -> bool:
    """Whether names say what columns are."""
    from tumble.recording.columns.names import columns_by_name

    found = columns_by_name(names)
    return bool(found.triads) or found.time is not None


def _are_units(names: Sequence[str]) -> bool:
    """Whether all that stands in a line are units."""
    from tumble.recording.columns.patterns import is_unit

    return all(not name or is_unit(_bare(name)) for name in names)


def _bare(unit: str) -> str:
    """A unit without its brackets, about it or within it."""
    return re.sub(r"[\[\]()]", "", unit).strip()


def head_lines(seen: bytes, encoding: str = "utf-8") -> tuple[str, ...]:
    """First lines of a text, whole and without their ends, by its first SEEN_BYTES."""
    lines = seen.decode(encoding, errors="replace").removeprefix("\ufeff").replace("\0", "").split("\n")
    if len(seen) >= SEEN_BYTES and len(lines) > 1:
        lines = lines[:-1]
    return tuple(line.rstrip("\r") for line in lines[:_TOP_LINES])


# -------------------- which dialect --------------------


def encoding_of(seen: bytes) -> str:
    """The encoding of text by its first bytes."""
    zeros = [seen[k:4096:2].count(0) for k in (0, 1)]
    for bom, name in _BOMS.items():
        if seen.startswith(bom) and (name == "utf-8" or any(zeros)):  # else what a serial line began with
            return name
    if max(zeros) > len(seen[:4096]) // 4 and min(zeros) < max(zeros) // 8:  # else memory that was never written
        return "utf-16-le" if zeros[1] > zeros[0] else "utf-16-be"
    for name, words in _ENCODINGS.items():
        try:
            text = codecs.getincrementaldecoder(name)().decode(seen)
        except UnicodeDecodeError:
            continue
        if re.search(words, text):
            return name
    return "latin-1"


@lru_cache(maxsize=2)
def dialect_of(seen: bytes) -> tuple[Dialect, Top] | None:
    """How a text log is written, by its first bytes, and what stands above its numbers; None where it has no rows of
    numbers."""
    encoding = encoding_of(seen)
    lines = head_lines(seen, encoding)
    # the mark with which lines begin that are no rows, where there are such, and others
    marks = Counter(mark for line in lines for mark in COMMENTS if line.lstrip().startswith(mark))
    mark, count = marks.most_common(1)[0] if marks else ("", 0)
    comment = mark if 0 < count < sum(bool(line.strip()) for line in lines) else None
    rows_by_dialect: dict[Dialect, int] = {}
    for delimiter in DELIMITERS:
        kept = comment if comment != delimiter else None
        trials = [Dialect(delimiter=delimiter, decimal=mark, comment=kept, encoding=encoding) for mark in ".,"]
        rows = [trials[0].cells(line) for line in lines if delimiter == BLANKS or delimiter in line]
        for trial in trials:
            widths = Counter(len(row) for row in rows if trial.is_row(row))
            rows_by_dialect[trial] = max(widths.values(), default=0)
    dialect = max(rows_by_dialect, key=lambda trial: rows_by_dialect[trial])
    top = top_of(lines, dialect) if rows_by_dialect[dialect] else None
    if top is None:
        return None
    return replace(dialect, header=any(not name.isdecimal() for name in top.names)), top
