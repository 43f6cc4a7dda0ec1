"""What is shown, of whatever result: blocks of a few kinds, which every kind of output can show.

A sentence is a block as it is. A view puts the blocks of a result together once; `render` shows them on a terminal, in
a notebook, as HTML and as PDF. Blocks hold plain text and SVG pictures, never markup: what came from a file is data. A
number that is not known is an empty cell, a minus a hyphen: a page of HTML or PDF sets a dash and a real minus.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

Tone = Literal["good", "doubt", "bad"]
"""The colour of accepted, accepted with scatter, not accepted."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Text:
    """A paragraph that is more than a plain `str`: `tone` says whether it is good news, good with reservations, or bad;
    a label is of what follows."""

    text: str
    tone: Literal["plain", "small", "label"] | Tone = "plain"
    kind: Literal["text"] = "text"


@dataclass(frozen=True, kw_only=True, slots=True)
class Items:
    """A list of sentences."""

    items: tuple[str, ...]
    tone: Literal["plain"] | Tone = "plain"
    kind: Literal["items"] = "items"


@dataclass(frozen=True, kw_only=True, slots=True)
class Facts:
    """Pairs of a name and what it is."""

    rows: tuple[tuple[str, str], ...]
    kind: Literal["facts"] = "facts"


@dataclass(frozen=True, kw_only=True, slots=True)
class Table:
    """Rows of cells, named by their first column. Columns in `text` are words, set to the left; all others are numbers,
    set to the right, never broken. A long table may stand on a page in `halves` beside each other."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    text: tuple[int, ...] = (0,)
    caption: str = ""
    dense: bool = False
    halves: bool = False
    kind: Literal["table"] = "table"


def table(
    rows: Iterable[Mapping[str, str]],
    *,
    words: Collection[str] = ("parameter", "unit"),
    columns: tuple[str, ...] = (),
    caption: str = "",
    dense: bool = False,
    halves: bool = False,
) -> Table:
    """A table of rows that are cells by their headings; `words` are the headings of columns of words, `columns` all
    headings, where there may be no row."""
    cells = list(rows)
    headings = columns or tuple(cells[0] if cells else ())
    return Table(
        columns=headings,
        rows=tuple(tuple(row.values()) for row in cells),
        text=tuple(i for i, heading in enumerate(headings) if heading in words),
        caption=caption,
        dense=dense,
        halves=halves,
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class Figure:
    """A picture as SVG, `width` as part of the page, what it says in words for those who do not see it."""

    svg: str
    caption: str
    width: float = 1.0
    kind: Literal["figure"] = "figure"


@dataclass(frozen=True, kw_only=True, slots=True)
class Matrix:
    """A matrix or a column vector (n × 1) of numbers with its symbol and its unit."""

    symbol: str
    rows: tuple[tuple[str, ...], ...]
    unit: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class Matrices:
    """Matrices side by side, as far as there is room."""

    matrices: tuple[Matrix, ...]
    kind: Literal["matrices"] = "matrices"


@dataclass(frozen=True, kw_only=True, slots=True)
class Formula:
    """One of the formulas that the templates know by name: the sensor model, the axes matrix of a triad, how to apply
    it, and with more than three sensors."""

    name: Literal["model", "axes", "apply", "apply_redundant"]
    kind: Literal["formula"] = "formula"


PageBlock = Text | Items | Facts | Table | Figure | Matrices | Formula
Block = str | PageBlock


@dataclass(frozen=True, kw_only=True, slots=True)
class Section:
    """A heading and what stands under it."""

    title: str
    blocks: tuple[PageBlock, ...]


def section(title: str, *blocks: Block | None) -> Section:
    """A section of the blocks that there are."""
    given_blocks = (Text(text=block) if isinstance(block, str) else block for block in blocks)
    return Section(title=title, blocks=tuple(block for block in given_blocks if block is not None))


@dataclass(frozen=True, kw_only=True, slots=True)
class Part:
    """Sections under one title; a report of one calibration has a single part without a title, whose first sections,
    so many as `customer` says, stand on the page for the customer, and the others are annexes."""

    title: str
    sections: tuple[Section, ...]
    customer: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class Letterhead:
    """The laboratory: name, lines of its address, and its logo (base64) with the type of that, where it has one."""

    name: str
    lines: tuple[str, ...]
    logo: str = ""
    logo_type: Literal["", "svg", "png"] = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class Signature:
    """A line to sign on: what stands below it, and in what function."""

    name: str
    role: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class Document:
    """A whole report: the device, the worst verdict on its calibrations as a colour and in words, facts for the first
    page, when the latest calibration was made (ISO 8601), and the parts; of a certificate its number and letterhead;
    `statements` stand above the signatures, `closing` at the very end."""

    title: str
    device: str
    tone: Tone
    verdict: str
    facts: tuple[tuple[str, str], ...]
    parts: tuple[Part, ...]
    closing: str
    created: str = ""
    statements: tuple[str, ...] = ()
    signatures: tuple[Signature, ...] = ()
    number: str = ""
    letterhead: Letterhead | None = None
