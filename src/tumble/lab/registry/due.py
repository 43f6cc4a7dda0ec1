"""The records of a device, or of all, and when which device is to be calibrated again: by the calendar, or earlier
where its drift may carry it to a limit.

A drift takes the files of all calibrations of a device to be known, and a registry has thousands of devices. So what
is found of a device is kept in the registry when a calibration of it, or limits of its type, are added; of what is not
kept, since a writer was interrupted, it is found anew whenever it is asked for.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from datetime import date
from itertools import islice

from tumble.errors import InputError
from tumble.lab.limits import parse_limits
from tumble.lab.registry.store import rows
from tumble.lab.registry.store.connect import Registry
from tumble.lab.registry.types import Forecast, LimitsRecord, Record

BATCH = 100
"""Forecasts that are kept in a transaction."""


def records(registry: Registry, serial: str | None = None) -> list[Record]:
    """The records of a device, or of all of them, superseded ones too, in the order in which they were performed.

    Raises InputError for a device that has none.

    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> tumble.calibrate(folder).write("calibration.json")
    >>> with tumble.open_registry("registry.sqlite", create=True) as registry:
    ...     _ = tumble.add_calibration(registry, "calibration.json")
    ...     found = tumble.records(registry, "mems-1")
    >>> [record.method for record in found]
    ['joint']
    """
    with registry.reading() as connection:
        listed = rows.every_record(connection) if serial is None else rows.records_of_device(connection, serial)
    if serial is not None and not listed:
        raise InputError(f"device {serial!r}: expected a device of the registry, found none of this serial number")
    return sorted(listed, key=lambda record: (record.performed, record.number))


@dataclass(frozen=True, kw_only=True, slots=True)
class Due:
    """The latest record of a device in force, how many are, months between calibrations, the day the next one is due by
    the calendar, and the parameter that may meet its limit first; each None where it is not known."""

    record: Record
    calibrations: int
    months: int | None = None
    by_calendar: date | None = None
    by_drift: Forecast | None = None

    @property
    def day(self) -> date | None:
        """The day the next calibration is due, the earlier of both; None where neither is known."""
        if self.by_drift is None:
            return self.by_calendar
        earliest = self.by_drift.earliest.date()
        return earliest if self.by_calendar is None else min(earliest, self.by_calendar)

    @property
    def drifts(self) -> bool:
        """Whether it is due by its drift, before the calendar says so."""
        return self.by_drift is not None and self.day != self.by_calendar


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
    with registry.reading() as connection:
        latest, in_force = rows.latest_records(connection), rows.limits_in_force(connection)
    known = {model: parse_limits(given.file, given.systematic, given.name) for model, given in in_force.items()}
    items = []
    for each in latest:
        record = each.record
        if record.model is None or record.model not in in_force:
            items.append(Due(record=record, calibrations=each.count))
            continue
        forecast, limits = each.forecast, known[record.model]
        if not each.is_kept and limits.checks.get("periodic"):
            forecast = _forecast(registry, record.serial, in_force[record.model])
        items.append(
            Due(
                record=record,
                calibrations=each.count,
                months=limits.interval(record.serial),
                by_calendar=limits.due(record.serial, record.performed.date()),
                by_drift=forecast,
            )
        )
    return sorted(items, key=lambda item: (item.day or date.max, item.record.serial))


def keep_forecasts(registry: Registry, serials: Collection[str] | None = None) -> None:
    """Keep the forecasts of all devices, or of some, of which the records or the limits have changed."""
    with registry.reading() as connection:
        in_force = {limits.number: limits for limits in rows.limits_in_force(connection).values()}
        latest = rows.latest_records(connection, serials) if in_force else []
    changed = iter([each for each in latest if each.limits is not None and not each.is_kept])
    while batch := list(islice(changed, BATCH)):
        found = {
            each.record.serial: (each, _forecast(registry, each.record.serial, in_force[each.limits or 0]))
            for each in batch
        }
        with registry.writing() as connection:
            rows.keep_forecasts(connection, found)


def _forecast(registry: Registry, serial: str, limits: LimitsRecord) -> Forecast | None:
    from tumble.lab.registry.monitor import first_forecast  # slow to import, and rarely needed to say what is due

    return first_forecast(registry, serial, limits)
