"""The keys of [programme] and [[programme.position]]."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from tumble.errors import ProgrammeError
from tumble.programme import positions as programme
from tumble.recording.session_keys.table import SessionTable, check_known


class PositionTable(SessionTable):
    """[[programme.position]]"""

    attitude: str = Field(description="an attitude code, a string")
    start: float | None = Field(default=None, description="a number (s)")
    stop: float | None = Field(default=None, description="a number (s)")

    @model_validator(mode="after")
    def _check(self) -> Self:
        try:
            programme.attitude(self.attitude)
        except ProgrammeError as error:
            raise ValueError(str(error)) from None
        if (self.start is None) != (self.stop is None):
            given = "start" if self.stop is None else "stop"
            raise ValueError(f"{given}: expected start and stop together, found {given} alone")
        if self.start is not None and self.stop is not None and self.start >= self.stop:
            raise ValueError(f"start: expected a start before the stop {self.stop:g} s, found {self.start:g} s")
        return self


class ProgrammeTable(SessionTable):
    """[programme]"""

    name: str | None = Field(default=None, description="the name of a built-in programme")
    position: list[PositionTable] | None = Field(
        default=None, min_length=1, description="one or more tables [[programme.position]]"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.name is None) == (self.position is None):
            found = "neither" if self.name is None else "both"
            raise ValueError(f"name: expected either programme.name or [[programme.position]], found {found}")
        if self.name is not None:
            check_known("name", self.name, programme.BUILT_IN)
        return self
