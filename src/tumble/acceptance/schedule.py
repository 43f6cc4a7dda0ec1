"""When a device is to be calibrated again by the calendar, as the file of limits of its type says.

Apart from the limits, for the dates of thousands of devices are needed at once and by themselves.
"""

from __future__ import annotations

import calendar
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from typing import Any, Literal, get_args

from tumble.documents import toml_of
from tumble.errors import InputError

FORMAT = 1
Occasion = Literal["incoming", "periodic"]
OCCASIONS: tuple[Occasion, ...] = get_args(Occasion)
"""The checks that there may be limits for."""

_KEYS = ("format", "frame", "systematic", "interval_months", "device_interval_months", "temperature_degC", *OCCASIONS)


@dataclass(frozen=True, kw_only=True, slots=True)
class Schedule:
    """Months between the calibrations of a type, and of the devices, by serial number, that have their own."""

    months: int | None
    device_months: Mapping[str, int]

    def interval(self, serial: str) -> int | None:
        """Months between calibrations of a device."""
        return self.device_months.get(serial, self.months)

    def due(self, serial: str, performed: date) -> date | None:
        """The day the next calibration of a device is due; None without an interval."""
        months = self.interval(serial)
        return None if months is None else months_later(performed, months)


def months_later(day: date, months: int) -> date:
    """The same day so many months later, or the last one of a month that is too short."""
    year, month = divmod(day.year * 12 + day.month - 1 + months, 12)
    return date(year, month + 1, min(day.day, calendar.monthrange(year, month + 1)[1]))


def content_of(text: str, name: str) -> dict[str, Any]:
    """The content of a file of limits, `name` in messages. Raises InputError, one line, for one that is none."""
    content = toml_of(text, name)
    if content.get("format") != FORMAT:
        raise InputError(f"{name}: format: expected {FORMAT}, found {content.get('format', 'none')!r}")
    for key in content:
        if key not in _KEYS:
            raise InputError(f"{name}: expected the keys {', '.join(_KEYS)}, found {key!r}")
    return content


def schedule_of(content: Mapping[str, Any], name: str) -> Schedule:
    """The schedule of a file of limits. Raises InputError, one line."""

    def months(value: Any, key: str) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= 1200:
            raise InputError(f"{name}: {key}: expected a whole number of months from 1 to 1200, found {value!r}")
        return value

    own = content.get("device_interval_months", {})
    if not isinstance(own, dict):
        raise InputError(f"{name}: device_interval_months: expected a table of serial numbers, found {own!r}")
    of_type = content.get("interval_months")
    return Schedule(
        months=None if of_type is None else months(of_type, "interval_months"),
        device_months={serial: months(value, f"device_interval_months: {serial}") for serial, value in own.items()},
    )
