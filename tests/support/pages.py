"""Reading reports back: HTML with the parser of the standard library, PDF with MuPDF."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pymupdf


@dataclass
class Page(HTMLParser):
    """A page of HTML as its elements, its text, and its tables as rows of cells."""

    elements: list[tuple[str, dict[str, str | None]]] = field(default_factory=list)
    text: list[str] = field(default_factory=list)
    tables: list[list[list[str]]] = field(default_factory=list)
    headings: list[str] = field(default_factory=list)
    inside: list[str] = field(default_factory=list)
    halves: int = 0
    """Tables of a long one in halves beside each other that have begun; 0 outside of it."""

    @staticmethod
    def of(path: Path) -> Page:
        """The page of a file."""
        page = Page()
        HTMLParser.__init__(page)
        page.feed(path.read_text(encoding="utf-8"))
        page.close()
        return page

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self.inside.append(tag)
        if tag == "div":
            self.halves = int("halves" in (dict(attrs).get("class") or ""))
        elif tag == "table" and self.halves == 2:
            pass  # its second half
        elif tag == "table":
            self.halves += self.halves
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")
        elif tag == "h2":
            self.headings.append("")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        while self.inside and self.inside.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if "style" in self.inside:
            return
        self.text.append(data)
        if {"td", "th"} & set(self.inside):
            self.tables[-1][-1][-1] += data
        if "h2" in self.inside:
            self.headings[-1] += data

    @property
    def whole(self) -> str:
        """All of the text."""
        return " ".join("".join(self.text).split())

    def table(self, *columns: str) -> list[dict[str, str]]:
        """The first table that has these columns, as rows by column."""
        return self.all_tables(*columns)[0]

    def all_tables(self, *columns: str) -> list[list[dict[str, str]]]:
        """The tables that have these columns, as rows by column."""
        found = [
            [dict(zip(header, row, strict=True)) for row in rows if row != header]  # a second half has it again
            for header, *rows in (table for table in self.tables if table)
            if set(columns) <= set(header)
        ]
        assert found, f"no table with the columns {columns}"
        return found

    def matrices(self) -> list[list[list[float]]]:
        """The matrices of the page in their order."""
        rows_of = [table for table in self.tables if table and all(map(is_number, table[0]))]
        return [[[number(cell) for cell in row] for row in table] for table in rows_of]


def number(text: str) -> float:
    """A number as a report writes it."""
    return float(text.replace("−", "-"))


def is_number(text: str) -> bool:
    return re.fullmatch(r"−?\d+\.\d{6,}", text) is not None


def last_digit(text: str) -> float:
    """One in the last digit of a number."""
    return 10.0 ** -len(text.partition(".")[2])


def opened(path: Path) -> Any:
    """A PDF as MuPDF has it."""
    return pymupdf.open(path)  # type: ignore[no-untyped-call]


def pdf_text(path: Path) -> str:
    """All text of a PDF, on one line."""
    with opened(path) as document:
        return " ".join(" ".join(page.get_text() for page in document).split())
