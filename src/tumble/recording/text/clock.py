"""Times of day and dates in text, as seconds; clock.toml has the forms in which programs write them."""

from __future__ import annotations

import re
import tomllib
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import polars as pl

_DAY = 86400
_TABLE: dict[str, Any] = tomllib.loads(Path(__file__).with_name("clock.toml").read_text(encoding="utf-8"))
_MONTH = f"(?P<month>(?i:{'|'.join(_TABLE['months'])}))[a-zä]*"
_FORMS = [
    rf'^\s*"?{form.replace("{time}", _TABLE["time"]).replace("{month}", _MONTH)}\s*"?$' for form in _TABLE["forms"]
]
_PATTERNS = [re.compile(form) for form in _FORMS]
_PARTS = "year", "month", "day", "hour", "minute", "second", "half", "zone"


def is_clock(cell: str) -> bool:
    """Return whether a cell is a time of day, or a date with one."""
    return any(pattern.match(cell) for pattern in _PATTERNS)


def day_of(text: str) -> int:
    """Return the day of a text's date, counted from 1970-01-01; 0 without a date."""
    return int(_parts(pl.Series([text], dtype=pl.String)).select(_DATE.fill_null(0)).item())


def first_date_of(text: str) -> str | None:
    """Return a date with its time in ISO 8601; None for a text without a date."""
    day = day_of(text)
    seconds = seconds_of(pl.Series([text], dtype=pl.String), day)[0] if day else None
    if seconds is None:
        return None
    is_zoned = _parts(pl.Series([text], dtype=pl.String))["zone"][0] is not None
    start = datetime(1970, 1, 1, tzinfo=UTC if is_zoned else None) + timedelta(days=day)
    return (start + timedelta(seconds=seconds)).isoformat(timespec="seconds")


def seconds_of(text: pl.Series, day: int) -> pl.Series:
    """Return seconds since midnight of a day (`day_of`), null for text that is no time."""
    hour, half = pl.col("hour").cast(pl.Float64).fill_null(0.0), pl.col("half").str.to_lowercase()
    hour = pl.when(half.is_null()).then(hour).otherwise(hour % 12 + 12.0 * (half == "p"))  # 12 am begins the day
    zone = pl.col("zone").str.replace(":", "").str.extract(r"([+-]\d{4})", 1).cast(pl.Int64).fill_null(0)
    east = zone.sign() * (zone.abs() // 100 * 60 + zone.abs() % 100) * 60
    second = pl.col("second").str.replace("[,:_-]", ".").cast(pl.Float64).fill_null(0.0)
    seconds = hour * 3600 + pl.col("minute").cast(pl.Float64) * 60 + second
    return _parts(text).select((_DATE.fill_null(day) - day) * _DAY - east + seconds).to_series()


_MONTH_NUMBER = pl.col("month").str.to_lowercase().str.slice(0, 3).replace(_TABLE["months"])
_WRITTEN_DATE = pl.concat_str("year", _MONTH_NUMBER.str.zfill(2), pl.col("day").str.zfill(2), separator="-")
_DATE = _WRITTEN_DATE.str.to_date("%Y-%m-%d", strict=False).cast(pl.Int32).cast(pl.Int64)
"""Days since 1970-01-01 of the parts of a time, null without a date."""


def _parts(text: pl.Series) -> pl.DataFrame:
    """Return the parts of times as text, by name; null where a time has no such part."""
    parts = pl.DataFrame(schema=dict.fromkeys(_PARTS, pl.String)).clear(len(text))
    for form in _FORMS:
        found = text.str.extract_groups(form).struct.unnest()
        parts = parts.with_columns(pl.coalesce(name, found[name]) for name in found.columns)
        if not parts["minute"].null_count():  # most columns have times in one form
            break
    return parts
