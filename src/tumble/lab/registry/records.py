"""Records of a registry as they are read back, and when which device is to be calibrated again."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date, datetime
from typing import ClassVar, Literal, get_args

from tumble.lab.limits import Limits, Occasion, parse_limits

State = Literal["as-found", "as-left", "unchanged"]
STATES: tuple[State, ...] = get_args(State)
"""Before an adjustment, after it, or without one: then the device leaves as it was found."""
FAILED = ("fail", "conditional fail")
"""Verdicts that withdraw a device from use."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Record:
    """A calibration in the registry.

    Parameters
    ----------
    number
        Of the record; never used again.
    sha256
        Of the content of the calibration file, however that is laid out.
    performed, added
        When the device was calibrated, and when the record was added.
    occasion, state
        At which check, and before or after an adjustment.
    limits, verdict
        Number of the acceptance limits that were in force, and the verdict by them; None without limits.
    """

    number: int
    sha256: str
    serial: str
    model: str | None
    method: str
    frame: str
    performed: datetime
    occasion: Occasion
    state: State
    limits: int | None
    verdict: str | None
    added: datetime


@dataclass(frozen=True, kw_only=True, slots=True)
class LimitsRecord:
    """Acceptance limits of a device type.

    Parameters
    ----------
    file
        The text of the TOML file.
    systematic
        The text of the calibration file with the systematic values of the type, if the limits name one.
    in_force
        Whether no later limits of the type replace them.
    """

    json_fields: ClassVar = ("number", "model", "added", "in_force", "file")

    number: int
    model: str
    file: str
    systematic: str | None
    added: datetime
    in_force: bool

    def parsed(self) -> Limits:
        """The limits as they judge."""
        return parse_limits(self.file, self.systematic, f"limits {self.number}")


@dataclass(frozen=True, kw_only=True, slots=True)
class Forecast:
    """When a parameter is `expected` to meet a `limit` (SI), at the `earliest` and at the `latest` (95.45 %); None for
    a latest time beyond 50 years."""

    name: str
    unit: str
    limit: float
    expected: datetime
    earliest: datetime
    latest: datetime | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Due:
    """When a device is to be calibrated again.

    Parameters
    ----------
    record, calibrations
        The latest record of the device, and how many it has.
    on
        The day on which the question is asked.
    months, by_calendar
        Interval between calibrations, and the day the next one is due by it; None without an interval.
    by_drift
        The parameter that may meet its limit first by its drift; None without one.
    """

    json_fields: ClassVar = ("record", "calibrations", "months", "day", "by_drift", "withdrawn", "overdue")

    record: Record
    calibrations: int
    on: date
    months: int | None = None
    by_calendar: date | None = None
    by_drift: Forecast | None = None

    @property
    def day(self) -> date | None:
        """The day the next calibration is due, the earlier of both; None if neither is known."""
        days = [self.by_calendar, None if self.by_drift is None else self.by_drift.earliest.date()]
        return min((day for day in days if day is not None), default=None)

    @property
    def drifts(self) -> bool:
        """Whether it is due by its drift, before the calendar says so."""
        return self.by_drift is not None and self.day != self.by_calendar

    @property
    def withdrawn(self) -> bool:
        """Whether it failed its latest check: it is withdrawn from use until it is calibrated again."""
        return self.record.verdict in FAILED

    @property
    def overdue(self) -> bool:
        return self.day is not None and self.day < self.on
