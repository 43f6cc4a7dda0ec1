"""The keys of [session], session.conditions and [[exclude]]."""

from __future__ import annotations

from datetime import date as date_type
from datetime import datetime
from typing import Self

from pydantic import Field, model_validator

from tumble.documents import is_plain, shown
from tumble.recording.session_keys.table import SessionTable


class ConditionsTable(SessionTable):
    """session.conditions"""

    temperature_degC: float | None = Field(  # noqa: N815
        default=None, ge=-90, le=200, description="a number from -90 to 200 (°C)"
    )
    temperature_u: float | None = Field(default=None, ge=0, description="a number, not negative (K)")
    humidity_percent: float | None = Field(default=None, ge=0, le=100, description="a number from 0 to 100 (%)")
    pressure_hPa: float | None = Field(  # noqa: N815
        default=None, gt=0, le=1200, description="a number from 0 to 1200 (hPa)"
    )


class CircumstancesTable(SessionTable):
    """[session]"""

    date: datetime | date_type | None = Field(default=None, description="a date, or a date with a time, without quotes")
    operator: str | None = Field(default=None, min_length=1, description="a name, a string")
    conditions: ConditionsTable = Field(default_factory=ConditionsTable, description="a table of conditions")
    equipment: list[str] = Field(default_factory=list, description="a list of strings")

    @model_validator(mode="after")
    def _check(self) -> Self:
        for key, text in (("operator", self.operator or ""), *(("equipment", each) for each in self.equipment)):
            if not is_plain(text):
                raise ValueError(f"{key}: expected no control characters, found {shown(text)}")
        return self


class ExcludeTable(SessionTable):
    """[[exclude]]"""

    rest: int | None = Field(default=None, ge=1, description="the number of a rest, from 1")
    turn: int | None = Field(default=None, ge=1, description="the number of a turn, from 1")
    start: float | None = Field(default=None, description="a number (s)")
    stop: float | None = Field(default=None, description="a number (s)")
    file: int | None = Field(default=None, ge=1, description="the number of a file of the log, from 1")
    reason: str = Field(default="", description="a string")

    @model_validator(mode="after")
    def _check(self) -> Self:
        stated = {"rest": self.rest is not None, "turn": self.turn is not None, "start": self.start is not None}
        if sum(stated.values()) != 1 or (self.start is None) != (self.stop is None):
            raise ValueError(
                "rest: expected either rest, or turn, or start and stop together, found "
                f"{', '.join(k for k in ('rest', 'turn', 'start', 'stop') if getattr(self, k) is not None) or 'none'}"
            )
        if self.start is not None and self.stop is not None and self.start >= self.stop:
            raise ValueError(f"start: expected a start before the stop {self.stop:g} s, found {self.start:g} s")
        if self.file is not None and self.start is None:
            raise ValueError("file: expected only with start and stop, found it without")
        return self
