"""When, by whom, with what and in what air a session was recorded: what a certificate needs and no log says.

The date is the one that the session states, or else the log's own where its times are absolute: dates with times, or
seconds since 1970. It is never the time of computing.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

UNIX_TIMES = (946_684_800.0, 4_102_444_800.0)
"""Seconds since 1970 at the beginning of 2000 and of 2100, between which times of a log are taken for such."""


@dataclass(frozen=True, kw_only=True, slots=True)
class AirConditions:
    """Temperature (°C) with its standard uncertainty, relative humidity (%) and air pressure (hPa); None where not
    known."""

    temperature: float | None = None
    temperature_u: float | None = None
    humidity: float | None = None
    pressure: float | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Circumstances:
    """Of a session: `date`, ISO 8601, a date or a date with a time; who recorded it; the air; and the equipment with
    its traceability, in words."""

    date: str | None = None
    operator: str | None = None
    air: AirConditions = AirConditions()
    equipment: tuple[str, ...] = ()

    @property
    def day(self) -> dt.date | None:
        """The day of the date."""
        return None if self.date is None else dt.date.fromisoformat(self.date[:10])


UNKNOWN = Circumstances()

_AIR = {
    "temperature": "temperature_degC",
    "temperature_u": "temperature_u",
    "humidity": "humidity_percent",
    "pressure": "pressure_hPa",
}
"""Keys of the conditions in session.toml and in the calibration file."""


def circumstances_content(given: Circumstances) -> dict[str, Any]:
    """Circumstances under the keys of [session], those that are known."""
    air = {key: getattr(given.air, name) for name, key in _AIR.items()}
    values = {
        "date": given.date,
        "operator": given.operator,
        "conditions": {key: value for key, value in air.items() if value is not None},
        "equipment": list(given.equipment),
    }
    return {key: value for key, value in values.items() if value}


def circumstances_from(content: Mapping[str, Any]) -> Circumstances:
    """Circumstances from the keys of [session]. Raises ValueError for a date that is none."""
    stated = content.get("conditions", {})
    air = {name: float(stated[key]) for name, key in _AIR.items() if stated.get(key) is not None}
    return Circumstances(
        date=_date(content.get("date")),
        operator=content.get("operator"),
        air=AirConditions(**air),
        equipment=tuple(str(each) for each in content.get("equipment", ())),
    )


def _date(value: Any) -> str | None:
    """A date or its text in ISO 8601."""
    if value is None or isinstance(value, dt.date):
        return None if value is None else value.isoformat()
    return dt.datetime.fromisoformat(value).isoformat() if "T" in value else dt.date.fromisoformat(value).isoformat()


def date_of_unix(seconds: float) -> str | None:
    """The date with the time of seconds since 1970, UTC; None for what is no such time."""
    first, last = UNIX_TIMES
    return dt.datetime.fromtimestamp(seconds, dt.UTC).isoformat(timespec="seconds") if first < seconds < last else None
