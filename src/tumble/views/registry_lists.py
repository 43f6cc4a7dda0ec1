"""Lists of the registry: devices, records, limits, what is due. Of thousands of devices they are there at once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import date
from typing import TYPE_CHECKING

from tumble.views.blocks import Table

if TYPE_CHECKING:
    from tumble.registry.due import Due
    from tumble.registry.types import LimitsRecord, Record


def day_of(moment: date) -> str:
    """A day by ISO 8601."""
    return f"{moment:%Y-%m-%d}"


def limits_table(records: Iterable[LimitsRecord], in_force: Mapping[str, LimitsRecord]) -> Table:
    """The limits of all types."""
    return _list(
        ("limits", "type", "added", ""),
        (
            (str(own.number), own.model, day_of(own.added), "in force" if in_force[own.model] == own else "replaced")
            for own in records
        ),
    )


def device_table(latest: Iterable[Due]) -> Table:
    """Every device with its latest record."""
    return _list(
        ("device", "type", "calibrations", "latest", "record", "check", "verdict", "due"),
        (
            (
                item.record.serial,
                item.record.model or "",
                str(item.calibrations),
                day_of(item.record.performed),
                str(item.record.number),
                item.record.occasion,
                item.record.verdict or "",
                str(item.day or ""),
            )
            for item in latest
        ),
    )


def record_table(records: Iterable[Record]) -> Table:
    """The records of a device."""
    return _list(
        ("record", "performed", "check", "state", "method", "frame", "verdict", ""),
        (
            (
                str(record.number),
                day_of(record.performed),
                record.occasion,
                record.state,
                record.method,
                record.frame,
                record.verdict or "",
                f"superseded by {record.superseded_by}" if record.superseded_by else "",
            )
            for record in records
        ),
    )


def due_table(items: Iterable[Due], today: date) -> Table:
    """What is due when."""
    return _list(
        ("device", "type", "latest", "record", "every", "due", ""),
        (
            (
                item.record.serial,
                item.record.model or "",
                day_of(item.record.performed),
                str(item.record.number),
                "" if item.months is None else f"{item.months} months",
                str(item.day or ""),
                _until(item, today),
            )
            for item in items
        ),
    )


def _until(item: Due, today: date) -> str:
    """How long it is until a device is due, and by what."""
    days = None if item.day is None else (item.day - today).days
    said = "no interval" if days is None else f"in {days} d" if days >= 0 else f"overdue by {-days} d"
    return f"{said}, by the drift of {item.by_drift.name}" if item.drifts and item.by_drift is not None else said


def _list(columns: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> Table:
    return Table(columns=columns, rows=tuple(rows), text=tuple(range(len(columns))), named_by=1)
