"""Records of a registry as they are read back: calibrations, limits, and forecasts of what drifts."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal, get_args

from tumble.lab.limits import Occasion

State = Literal["as-found", "as-left", "unchanged"]
STATES: tuple[State, ...] = get_args(State)
"""Before an adjustment, after it, or without one: then the device leaves as it was found."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Record:
    """A calibration in the registry. `limits` is the number of the acceptance limits that were in force, `verdict` what
    they said of it, in a word; None without any."""

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
    supersedes: int | None
    superseded_by: int | None
    reason: str | None
    added: datetime


@dataclass(frozen=True, kw_only=True, slots=True)
class LimitsRecord:
    """Acceptance limits of a device type: `file` is the text of the TOML file, `systematic` that of the calibration
    file with the type's systematic values, if it names one."""

    number: int
    sha256: str
    model: str
    file: str
    systematic: str | None
    added: datetime

    @property
    def name(self) -> str:
        """What messages call them."""
        return f"limits {self.number}"


@dataclass(frozen=True, kw_only=True, slots=True)
class Forecast:
    """When a parameter is `expected` to meet a `limit` (SI), at the `earliest` and at the `latest` (95.45 %); None for
    a latest time beyond the horizon."""

    name: str
    unit: str
    limit: float
    expected: datetime
    earliest: datetime
    latest: datetime | None


@dataclass(frozen=True, kw_only=True, slots=True)
class LatestRecord:
    """Of a device the `record` in force that was performed last, the highest number of those in force, and how many
    are; the `limits` in force for it, and which parameter meets them first, if that `is_kept`."""

    record: Record
    last: int
    count: int
    limits: int | None
    is_kept: bool
    forecast: Forecast | None
