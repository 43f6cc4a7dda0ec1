"""Records read from a registry, and due dates of devices."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date, datetime
from typing import ClassVar, Literal

from tumble.lab.limits import Limits, Occasion, parse_limits

NOT_ACCEPTED = "not accepted"  # verdict on a calibration of which nothing is accepted
State = Literal["as-found", "as-left", "unchanged"]
"""State of the device: before an adjustment, after it, or without one."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Record:
    """A calibration in the registry, with a `number` that is never used again.

    `sha256` is the hash of the canonical JSON of its file. `performed`, `occasion` and `state` are when the device was
    calibrated, at which check, and whether before or after an adjustment; `limits` is the number of the acceptance
    limits that were in force, `verdict` the result by them, None without limits, and "not accepted" for a calibration
    of which nothing is accepted."""

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

    @property
    def withdrawn(self) -> bool:
        """Whether the device must not be used until it is calibrated again: it failed this check or was undecided."""
        return self.verdict in (NOT_ACCEPTED, "fail", "conditional fail", "undecided")

    @property
    def accepted(self) -> bool:
        """Whether its calibration, or that of accelerometers or gyros alone, is accepted."""
        return self.verdict != NOT_ACCEPTED


@dataclass(frozen=True, kw_only=True, slots=True)
class LimitsRecord:
    """Acceptance limits of a device type, with the text of their TOML `file`; the latest ones are `in_force`."""

    json_fields: ClassVar = ("number", "model", "added", "in_force", "file")

    number: int
    model: str
    file: str
    added: datetime
    in_force: bool

    def parsed(self) -> Limits:
        """Return the limits in the file."""
        return parse_limits(self.file, f"limits {self.number}")


@dataclass(frozen=True, kw_only=True, slots=True)
class Due:
    """Due date of a device: its latest record, the number of its `calibrations`, the day `on` of the query,
    the interval in `months` and the `day` on which the next calibration is due (None without an interval)."""

    json_fields: ClassVar = ("record", "calibrations", "months", "day", "withdrawn", "overdue")

    record: Record
    calibrations: int
    on: date
    months: int | None
    day: date | None

    @property
    def withdrawn(self) -> bool:
        """Whether the device failed its latest check."""
        return self.record.withdrawn

    @property
    def overdue(self) -> bool:
        """Whether the due date has passed."""
        return self.day is not None and self.day < self.on
