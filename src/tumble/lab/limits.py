"""Acceptance limits of a device type, and intervals between calibrations, read from a TOML file.

[incoming] and [periodic] give limits of a parameter ("accel.bias.x") or a group ("accel.bias"); the longer name takes
precedence. A limit is a text such as "5 mg", for ±5 mg, or a table with min and max.
"""

from __future__ import annotations

import calendar
import math
from collections.abc import Mapping
from datetime import date
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from tumble.documents import text_of_document, toml_of, validated
from tumble.errors import did_you_mean
from tumble.sensors.frames import FRAMES, Frame
from tumble.sensors.parameters import group_of, groups, name_covers, quantity_of

Occasion = Literal["incoming", "periodic"]
OCCASIONS: tuple[Occasion, ...] = get_args(Occasion)
"""Checks that may have limits."""

_FORMS = 'a text such as "5 mg", or a table with min and max'


def _limit(key: str, value: Any) -> tuple[float, float]:
    """Return the lowest and the highest value, SI, of a limit as it is written. Raises ValueError."""
    try:
        kind = group_of(key)
    except KeyError:
        expected = 'expected a quoted name such as "accel.bias" or "gyro.axis.xy", found'
        raise ValueError(f"{key}: {expected} {key!r}{did_you_mean(key, (group.name for group in groups()))}") from None
    typed = value if isinstance(value, dict) else {"size": value}
    known_keys = set(typed) <= {"min", "max"} if isinstance(value, dict) else True
    if not typed or not known_keys or not all(isinstance(text, str) for text in typed.values()):
        raise ValueError(f"{key}: expected {_FORMS}, found {value!r}")
    try:
        sizes = {name: quantity_of(kind, text) for name, text in typed.items()}
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from None
    if sizes.get("size", 1.0) <= 0.0:
        raise ValueError(f"{key}: expected more than 0, found {value!r}")
    size = sizes.get("size", math.inf)
    low, high = sizes.get("min", -size), sizes.get("max", size)
    if low >= high:
        raise ValueError(f"{key}: expected a min below max, found {typed['min']!r} and {typed['max']!r}")
    return low, high


_Months = Annotated[int, Field(ge=1, le=1200)]
_MONTHS = "a whole number of months from 1 to 1200"
_Check = Annotated[
    dict[str, Any],
    AfterValidator(lambda written: {key: _limit(key, value) for key, value in written.items()}),
    Field(description="a table of limits"),
]


class Limits(BaseModel):
    """Acceptance limits of a device type, as in their file.

    `incoming` and `periodic` have the lowest and the highest value (SI) by parameter or group; `interval_months` is the
    interval between calibrations, `device_interval_months` those of single devices by serial number."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    format: Literal[1] = Field(description="1")
    frame: Frame = Field(default="accelerometer", description=f"one of {', '.join(FRAMES)}")
    interval_months: _Months | None = Field(default=None, description=_MONTHS)
    device_interval_months: dict[str, _Months] = Field(
        default={}, description=f"a table of serial numbers, each with {_MONTHS}"
    )
    incoming: _Check = {}
    periodic: _Check = {}

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.checks:
            raise ValueError("expected limits in [incoming] or [periodic], found none")
        return self

    @property
    def checks(self) -> tuple[Occasion, ...]:
        """The checks that have limits."""
        return tuple(occasion for occasion in OCCASIONS if getattr(self, occasion))

    def of(self, name: str, occasion: Occasion) -> tuple[float, float] | None:
        """Return the lowest and the highest value (SI) of a parameter, None without a limit."""
        by_key: Mapping[str, tuple[float, float]] = getattr(self, occasion)
        longest = max((key for key in by_key if name_covers(key, name)), key=len, default=None)
        return None if longest is None else by_key[longest]


def read_limits(path: Path) -> Limits:
    """Read acceptance limits from a file. Raises InputError."""
    return parse_limits(text_of_document(path), str(path))


@lru_cache(maxsize=64)
def parse_limits(text: str, name: str) -> Limits:
    """Read acceptance limits from the text of a file, with its `name` for messages. Raises InputError."""
    return validated(Limits, toml_of(text, name), name)


def months_later(day: date, months: int) -> date:
    """Return the same day of a later month, or its last day if that month is shorter."""
    year, month = divmod(day.year * 12 + day.month - 1 + months, 12)
    return date(year, month + 1, min(day.day, calendar.monthrange(year, month + 1)[1]))
