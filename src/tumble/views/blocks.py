"""Blocks: sentences, tables, figures and matrices, from which every kind of output is made.

A sentence is itself a block. Blocks hold plain text and SVG pictures, never markup, because their content may come
from files. A missing number is an empty cell and a minus a hyphen; pages of HTML and PDF show a dash and a real minus.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

Tone = Literal["good", "doubt", "bad"]
"""Accepted, accepted with scatter, not accepted."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Text:
    """A paragraph with a tone: good or bad news, small print, or the label of what follows."""

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
    """Pairs of a name and a value."""

    rows: tuple[tuple[str, str], ...]
    kind: Literal["facts"] = "facts"


@dataclass(frozen=True, kw_only=True, slots=True)
class Table:
    """Rows of cells, named by their first column. The columns in `text` have words, aligned left; all others have
    numbers, aligned right and never broken. A long table may be set on a page in `halves` beside each other."""

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
    """Return a table of rows, each a mapping of headings to cells.

    `words` are the headings of columns of words, `columns` all headings of a table that may have no rows."""
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
    """An SVG picture, its `width` as a fraction of the page, and a caption that describes it in words."""

    svg: str
    caption: str
    width: float = 1.0
    kind: Literal["figure"] = "figure"


@dataclass(frozen=True, kw_only=True, slots=True)
class Matrix:
    """A matrix or a column vector (n × 1) of numbers with its symbol and unit."""

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
    """A formula of the templates: sensor model, axes matrix of a triad, correction, correction of redundant sensors."""

    name: Literal["model", "axes", "apply", "apply_redundant"]
    kind: Literal["formula"] = "formula"


PageBlock = Text | Items | Facts | Table | Figure | Matrices | Formula
Block = str | PageBlock


@dataclass(frozen=True, kw_only=True, slots=True)
class Section:
    """A heading with its blocks."""

    title: str
    blocks: tuple[PageBlock, ...]


def section(title: str, *blocks: Block | None) -> Section:
    """Return a section of these blocks without None."""
    page_blocks = (Text(text=block) if isinstance(block, str) else block for block in blocks)
    return Section(title=title, blocks=tuple(block for block in page_blocks if block is not None))


@dataclass(frozen=True, kw_only=True, slots=True)
class Part:
    """Sections under one title. A report of one calibration has one part without a title, whose first `customer`
    sections are for the customer, the others annexes."""

    title: str
    sections: tuple[Section, ...]
    customer: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class Letterhead:
    """Letterhead of a laboratory: name, lines of the address, and a logo (base64) with its type."""

    name: str
    lines: tuple[str, ...]
    logo: str = ""
    logo_type: Literal["", "svg", "png"] = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class Signature:
    """A line for a signature, with name and role."""

    name: str
    role: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class Document:
    """A report or a certificate.

    `verdict` is the worst verdict on its calibrations, `facts` are for the first page, `created` is when the latest
    calibration was made (ISO 8601); `statements` stand above the signatures, `closing` at the end; a certificate has a
    `number` and a letterhead."""

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
