"""Times of day and dates as seconds: ISO 8601, 31.12.2025 23:59:59,5, 23:59:59.5, 11:59:59.5 PM and
2025_12_31_23_59_59.5."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta

import numpy as np
import polars as pl

from tumble.recording.session import LogSpec
from tumble.recording.text.dialect import JOINED
from tumble.units import Array

_DATE = r"^\s*\"?(?:(\d{4})[-./](\d{1,2})[-./](\d{1,2})|(\d{1,2})[-./](\d{1,2})[-./](\d{4}))"
_HALF = r"([AaPp]\.?[Mm]\.?)?"
_TIME = r"(?:^|[T ])\s*(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,:](\d+))?)?\s*" + _HALF + r"\s*(Z|[+-]\d{2}:?\d{2})?\s*\"?$"
_DAY = 86400


def day_of(text: str) -> int:
    """The day of a text's date, counted from 1970-01-01; 0 without a date."""
    return int(_days(pl.Series([text], dtype=pl.String)).fill_null(0)[0])


def date_of(text: str) -> str | None:
    """The date with the time of a text, ISO 8601, with a time zone in UTC; None without a date."""
    day = day_of(text)
    seconds = seconds_of(pl.Series([text], dtype=pl.String), day)[0] if day else None
    if not day or seconds is None:
        return None
    found = re.search(_TIME, text)
    zone = UTC if found and found[6] else None
    start = datetime(1970, 1, 1, tzinfo=zone) + timedelta(days=day)
    return (start + timedelta(seconds=float(seconds))).isoformat(timespec="seconds")


def seconds_of(text: pl.Series, day: int) -> pl.Series:
    """Seconds since midnight of a day (`day_of`); null where the text is no time."""
    text = _parted(text)
    parts = {k: text.str.extract(_TIME, k) for k in range(1, 7)}
    hour, minute = (parts[k].cast(pl.Float64, strict=False) for k in (1, 2))
    half = parts[5].str.slice(0, 1).str.to_lowercase()  # of the day: 12 am is its beginning, 12 pm noon
    hour = hour.zip_with(half.is_null(), hour % 12 + 12.0 * (half == "p"))
    second = parts[3].fill_null("0") + "." + parts[4].fill_null("0")
    zone = parts[6].str.replace(":", "").str.extract(r"([+-]\d{4})", 1).cast(pl.Int64, strict=False).fill_null(0)
    east = zone.sign() * (zone.abs() // 100 * 60 + zone.abs() % 100) * 60
    days = (_days(text).fill_null(day) - day) * _DAY
    return (days - east) + hour * 3600 + minute * 60 + second.cast(pl.Float64, strict=False)


def _parted(text: pl.Series) -> pl.Series:
    """Dates and times whose parts are all joined alike as ISO 8601 has them."""
    return text.str.replace(f'^\\s*"?{JOINED}', "${1}-${2}-${3}T${4}:${5}:${6}${7}")


def _days(text: pl.Series) -> pl.Series:
    """Days since 1970-01-01; null without a date."""
    found = [_parted(text).str.extract(_DATE, k) for k in range(1, 7)]
    year, month, day = (found[i].zip_with(found[i].is_not_null(), found[j]) for i, j in ((0, 5), (1, 4), (2, 3)))
    written = year + "-" + month.str.zfill(2) + "-" + day.str.zfill(2)
    return written.str.to_date("%Y-%m-%d", strict=False).cast(pl.Int32).cast(pl.Int64)


def times_of(column: pl.Series, spec: LogSpec) -> Array:
    """The times (s) of a log's time column, as it is in a table with all columns."""
    if spec.clock and column.dtype == pl.String:
        return seconds_of(column, 0).to_numpy()
    if isinstance(column.dtype, pl.Datetime):
        since = (column - column.dt.truncate("1d")[0]).dt.total_nanoseconds()
        return np.asarray(since.to_numpy() * 1e-9)
    comma = spec.dialect is not None and spec.dialect.decimal == "," and column.dtype == pl.String
    numbers = (column.str.replace(",", ".") if comma else column).cast(pl.Float64)
    return np.asarray(numbers.to_numpy() * spec.time_factor)
