"""When which device is to be calibrated again."""

from __future__ import annotations

import calendar
from dataclasses import dataclass
from datetime import date

from tumble.registry.connect import Registry
from tumble.registry.limits import parse_limits
from tumble.registry.records import Record
from tumble.registry.store import limits_in_force, records


@dataclass(frozen=True, kw_only=True, slots=True)
class Due:
    """The latest record of a device in force, months between calibrations and the day the next one is due; None where
    no interval is known."""

    record: Record
    months: int | None
    day: date | None


def due(registry: Registry) -> list[Due]:
    """Every device, the most urgent first; those without an interval last.

    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> tumble.calibrate(folder).write("calibration.json")
    >>> with tumble.open_registry("registry.sqlite", create=True) as registry:
    ...     _ = tumble.add_calibration(registry, "calibration.json")
    ...     found = tumble.due(registry)
    >>> [item.record.serial for item in found]
    ['mems-1']
    """
    in_force = limits_in_force(registry)
    parsed = {m: parse_limits(x.file, x.systematic, f"limits {x.number}") for m, x in in_force.items()}
    found = []
    for record in latest_records(records(registry)):
        limits = None if record.model is None else parsed.get(record.model)
        months = None if limits is None else limits.interval(record.serial)
        day = None if months is None else months_later(record.performed.date(), months)
        found.append(Due(record=record, months=months, day=day))
    return sorted(found, key=lambda item: (item.day or date.max, item.record.serial))


def latest_records(found: list[Record]) -> list[Record]:
    """Of records in the order in which they were performed, the latest in force of each device."""
    latest = {record.serial: record for record in found if record.superseded_by is None}
    return [latest[serial] for serial in sorted(latest)]


def months_later(day: date, months: int) -> date:
    """The same day so many months later, or the last one of a month that is too short."""
    year, month = divmod(day.year * 12 + day.month - 1 + months, 12)
    return date(year, month + 1, min(day.day, calendar.monthrange(year, month + 1)[1]))
