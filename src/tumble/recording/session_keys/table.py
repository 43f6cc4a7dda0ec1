"""A table of session.toml: no other keys, no other types; and what its checks have in common."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pydantic import BaseModel, ConfigDict

from tumble.errors import did_you_mean

_WIDTH = 60
"""Of a value in a message, characters."""


class SessionTable(BaseModel):
    """A table of the file: no other keys, no other types."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False, defer_build=True)


def check_known(key: str, value: str, known: Iterable[str]) -> None:
    """Raises ValueError for a value that is none of those known."""
    names = list(known)
    if value not in names:
        raise ValueError(f'{key}: expected one of {", ".join(names)}, found "{value}"{did_you_mean(value, names)}')


def check_one_per_column(key: str, value: float | Sequence[float] | None, columns: Sequence[str]) -> None:
    """Raises ValueError for a list of another length than there are columns."""
    if isinstance(value, Sequence) and len(value) != len(columns):
        raise ValueError(f"{key}: expected a number or {len(columns)} numbers, one per column, found {len(value)}")


def repeated(values: Iterable[str]) -> list[str]:
    """Values that come more than once."""
    return [value for value, count in Counter(values).items() if count > 1]


def as_written(value: Any) -> str:
    """A value as TOML has it, on one line, shortened."""
    if isinstance(value, Mapping):
        return "a table"
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= _WIDTH else f"{text[: _WIDTH - 1]}…"
