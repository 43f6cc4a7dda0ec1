"""When which device is to be calibrated again: by the calendar, or earlier where its drift may carry it to a limit."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date
from typing import TYPE_CHECKING

from tumble.errors import InputError
from tumble.registry.connect import Registry
from tumble.registry.records import Record
from tumble.registry.store import LimitsRecord, latest_records, limits_in_force

if TYPE_CHECKING:
    from tumble.acceptance.limits import Limits
    from tumble.registry.forecast import Forecast


@dataclass(frozen=True, kw_only=True, slots=True)
class Due:
    """The latest record of a device in force, how many are, months between calibrations, the day the next one is due by
    the calendar, and the parameter that may meet its limit first; each None where it is not known."""

    record: Record
    calibrations: int
    months: int | None
    by_calendar: date | None
    by_drift: Forecast | None

    @property
    def day(self) -> date | None:
        """The day the next calibration is due, the earlier of both; None where neither is known."""
        known = [self.by_calendar, None if self.by_drift is None else self.by_drift.earliest.date()]
        return min((day for day in known if day is not None), default=None)

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
    parsed = {model: _parsed(own) for model, own in limits_in_force(registry).items()}
    found = []
    for record, count in latest_records(registry):
        limits = None if record.model is None else parsed.get(record.model)
        months = None if limits is None else limits.schedule.interval(record.serial)
        day = None if limits is None else limits.schedule.due(record.serial, record.performed.date())
        drifting = _by_drift(registry, record, limits)
        found.append(Due(record=record, calibrations=count, months=months, by_calendar=day, by_drift=drifting))
    return sorted(found, key=lambda item: (item.day or date.max, item.record.serial))


def _parsed(limits: LimitsRecord) -> Limits:
    from tumble.acceptance.limits import parse_limits  # slow to import, as all that looks into calibrations

    return parse_limits(limits.file, limits.systematic, f"limits {limits.number}")


def _by_drift(registry: Registry, record: Record, limits: Limits | None) -> Forecast | None:
    """The parameter of a device that may meet its limit first."""
    if limits is None or not limits.checks.get("periodic"):
        return None
    from tumble.registry.monitor import monitored

    try:
        return next(iter(monitored(registry, record.serial, None).forecasts()), None)
    except InputError:  # a record that cannot be taken to the frame of the limits
        return None
