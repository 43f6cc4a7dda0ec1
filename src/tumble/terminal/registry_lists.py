"""Lists of the registry, as lines of text: of thousands of devices they are there at once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from datetime import date
from typing import TYPE_CHECKING

import click
from rich.cells import cell_len

from tumble.documents import plain

if TYPE_CHECKING:
    from tumble.registry.due import Due
    from tumble.registry.types import Record


def print_lines(lines: Iterable[str]) -> None:
    """Print lines to standard output."""
    click.echo("\n".join(map(plain, lines)))


def devices_lines(latest: Iterable[Due]) -> Iterator[str]:
    """Every device with its latest record."""
    headings = ("device", "type", "calibrations", "latest", "record", "check", "verdict", "due")
    rows = (
        (
            item.record.serial,
            item.record.model or "",
            str(item.calibrations),
            _day(item.record.performed),
            str(item.record.number),
            item.record.occasion,
            item.record.verdict or "",
            str(item.day or ""),
        )
        for item in latest
    )
    return _in_columns(headings, list(rows))


def records_lines(records: Iterable[Record]) -> Iterator[str]:
    """The records of a device."""
    headings = ("record", "performed", "check", "state", "method", "frame", "verdict", "")
    rows = (
        (
            str(record.number),
            _day(record.performed),
            record.occasion,
            record.state,
            record.method,
            record.frame,
            record.verdict or "",
            f"superseded by {record.superseded_by}" if record.superseded_by else "",
        )
        for record in records
    )
    return _in_columns(headings, list(rows))


def due_lines(found: Iterable[Due], today: date) -> Iterator[str]:
    """What is due when."""
    headings = ("device", "type", "latest", "record", "every", "due", "")
    rows = (
        (
            item.record.serial,
            item.record.model or "",
            _day(item.record.performed),
            str(item.record.number),
            "" if item.months is None else f"{item.months} months",
            str(item.day or ""),
            _left(item, today),
        )
        for item in found
    )
    return _in_columns(headings, list(rows))


def _left(item: Due, today: date) -> str:
    """How long it is until a device is due, and by what."""
    left = None if item.day is None else (item.day - today).days
    said = "no interval" if left is None else f"in {left} d" if left >= 0 else f"overdue by {-left} d"
    return f"{said}, by the drift of {item.by_drift.name}" if item.drifts and item.by_drift is not None else said


def _in_columns(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Rows under headings, columns two blanks apart."""
    columns = []
    for column in zip(headings, *rows, strict=True):
        width = max(map(_width, column))
        columns.append([cell.ljust(width - _width(cell) + len(cell)) for cell in column])
    for cells in zip(*columns, strict=True):
        yield "  ".join(cells).rstrip()


def _width(cell: str) -> int:
    return len(cell) if cell.isascii() else cell_len(cell)


def _day(moment: date) -> str:
    return f"{moment:%Y-%m-%d}"
