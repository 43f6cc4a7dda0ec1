"""Records of a registry as they are read back, and when which device is to be calibrated again."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date, datetime
from typing import ClassVar, Literal

from tumble.lab.limits import Limits, Occasion, parse_limits

State = Literal["as-found", "as-left", "unchanged"]
"""Before an adjustment, after it, or without one: then the device leaves as it was found."""
FAILED = ("fail", "conditional fail")
"""Verdicts that withdraw a device from use."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Record:
    """A calibration in the registry, with a `number` that is never used again and the SHA-256 of the content of its
    file, however that is laid out: when the device was calibrated (`performed`), at which check (`occasion`), before or
    after an adjustment (`state`), the number of the acceptance limits that were in force and the verdict by them, None
    without limits, and when it was added."""

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
    """Acceptance limits of a device type: the text of their TOML `file`; `in_force` unless later ones of the type
    replace them."""

    json_fields: ClassVar = ("number", "model", "added", "in_force", "file")

    number: int
    model: str
    file: str
    added: datetime
    in_force: bool

    def parsed(self) -> Limits:
        """The limits as they judge."""
        return parse_limits(self.file, f"limits {self.number}")


@dataclass(frozen=True, kw_only=True, slots=True)
class Due:
    """When a device is to be calibrated again, as on the day `on`: its latest record, how many `calibrations` it has,
    the `months` between them and the `day` when the next one is due; None without an interval."""

    json_fields: ClassVar = ("record", "calibrations", "months", "day", "withdrawn", "overdue")

    record: Record
    calibrations: int
    on: date
    months: int | None
    day: date | None

    @property
    def withdrawn(self) -> bool:
        """Whether it failed its latest check: it is withdrawn from use until it is calibrated again."""
        return self.record.verdict in FAILED

    @property
    def overdue(self) -> bool:
        """Whether its day has passed."""
        return self.day is not None and self.day < self.on
