"""Lists of the registry: devices, records, limits, what is due. Of thousands of devices they are there at once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import date
from typing import TYPE_CHECKING

from tumble.views.blocks import Table
from tumble.views.render.data import Content, fields

if TYPE_CHECKING:
    from tumble.lab.registry.due import Due
    from tumble.lab.registry.types import LimitsRecord, Record


def day_of(moment: date) -> str:
    """A day by ISO 8601."""
    return f"{moment:%Y-%m-%d}"


def _list(columns: tuple[str, ...], rows: Iterable[tuple[object, ...]]) -> Table:
    """A table of words; what is not known is an empty cell."""
    cells = (tuple("" if cell is None else str(cell) for cell in row) for row in rows)
    return Table(columns=columns, rows=tuple(cells), text=tuple(range(len(columns))))


def device_table(latest: Iterable[Due]) -> Table:
    """Every device with its latest record."""
    rows = (
        (r.serial, r.model, i.calibrations, day_of(r.performed), r.number, r.occasion, r.verdict, i.day)
        for r, i in ((item.record, item) for item in latest)
    )
    return _list(("device", "type", "calibrations", "latest", "record", "check", "verdict", "due"), rows)


def devices_data(latest: Sequence[Due]) -> Content:
    """Every device with its latest record."""
    return {
        "devices": [
            fields(i.record, "serial model") | {"calibrations": i.calibrations, "due": i.day, "latest": i.record}
            for i in latest
        ]
    }


def record_table(records: Iterable[Record]) -> Table:
    """The records of a device."""
    rows = []
    for r in records:
        superseded = f"superseded by {r.superseded_by}" if r.superseded_by else ""
        rows.append((r.number, day_of(r.performed), r.occasion, r.state, r.method, r.frame, r.verdict, superseded))
    return _list(("record", "performed", "check", "state", "method", "frame", "verdict", ""), rows)


def limits_table(records: Iterable[LimitsRecord], in_force: Mapping[str, LimitsRecord]) -> Table:
    """The limits of all types."""
    rows = ((r.number, r.model, day_of(r.added), "in force" if in_force[r.model] == r else "replaced") for r in records)
    return _list(("limits", "type", "added", ""), rows)


def limits_data(records: Sequence[LimitsRecord], in_force: Mapping[str, LimitsRecord]) -> Content:
    """Acceptance limits of device types, as TOML texts."""
    shown = []
    for record in records:
        force = {"in_force": in_force[record.model].number == record.number}
        shown.append(fields(record, "number model added") | force | {"file": record.file})
    return {"limits": shown}


def due_table(items: Iterable[Due], today: date) -> Table:
    """What is due when."""
    rows = []
    for i in items:
        r, every = i.record, None if i.months is None else f"{i.months} months"
        days = None if i.day is None else (i.day - today).days
        until = "no interval" if days is None else f"in {days} d" if days >= 0 else f"overdue by {-days} d"
        until += f", by the drift of {i.by_drift.name}" if i.drifts and i.by_drift is not None else ""
        rows.append((r.serial, r.model, day_of(r.performed), r.number, every, i.day, until))
    return _list(("device", "type", "latest", "record", "every", "due", ""), rows)


def due_data(items: Sequence[Due], today: date) -> Content:
    """When which device is to be calibrated again."""
    devices = []
    for i in items:
        keys = fields(i.record, "serial model") | {"record": i.record.number, "performed": i.record.performed}
        keys |= {"months": i.months, "due": i.day, "by_drift": i.by_drift if i.drifts else None}
        devices.append(keys | {"overdue": i.day is not None and i.day < today})
    return {"on": today, "devices": devices}
