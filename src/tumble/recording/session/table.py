"""Base class of the tables of session.toml, with strict keys and types, and checks of values."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from tumble.documents import is_plain, shown
from tumble.errors import did_you_mean

LONGEST_NAME = 200
"""Largest number of characters of a serial number or a type."""


class SessionTable(BaseModel):
    """A table of the file, without other keys and other types."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False, defer_build=True)


def key(description: str, default: Any = None, **limits: Any) -> Any:
    """Return an optional key; `description` states the expected value."""
    return Field(default=default, description=description, **limits)


def check_known(value: str, known: Iterable[str], key: str = "") -> str:
    """Return the value. Raises ValueError if it is not one of `known`."""
    names = list(known)
    if value not in names:
        hint, before = did_you_mean(value, names), f"{key}: " if key else ""
        raise ValueError(f'{before}expected one of {", ".join(names)}, found "{value}"{hint}')
    return value


def one_of(names: Iterable[str]) -> AfterValidator:
    return AfterValidator(partial(check_known, known=tuple(names)))


def check_plain(text: str) -> str:
    if not is_plain(text):
        raise ValueError(f"expected no control characters, found {shown(text)}")
    return text


def check_name(text: str) -> str:
    if not (text.strip() and text.isprintable() and len(text) <= LONGEST_NAME):
        raise ValueError(f"expected 1 to {LONGEST_NAME} printable characters, found {shown(text)}")
    return text.strip()


def check_span(start: float | None, stop: float | None) -> None:
    if start is not None and stop is not None and start >= stop:
        raise ValueError(f"start: expected a start before the stop {stop:g} s, found {start:g} s")
