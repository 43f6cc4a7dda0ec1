"""A table of session.toml: no other keys, no other types; and what its checks have in common."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from functools import partial

from pydantic import AfterValidator, BaseModel, ConfigDict

from tumble.documents import as_written, is_plain, shown
from tumble.errors import did_you_mean

LONGEST_NAME = 200
"""Characters of a serial number and of a type."""


class SessionTable(BaseModel):
    """A table of the file: no other keys, no other types."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False, defer_build=True)


def check_known(value: str, known: Iterable[str], key: str = "") -> str:
    """The value. Raises ValueError where it is none of those known."""
    names = list(known)
    if value not in names:
        hint, before = did_you_mean(value, names), f"{key}: " if key else ""
        raise ValueError(f'{before}expected one of {", ".join(names)}, found "{value}"{hint}')
    return value


def one_of(names: Iterable[str]) -> AfterValidator:
    return AfterValidator(partial(check_known, known=tuple(names)))


def visible(text: str) -> str:
    if not is_plain(text):
        raise ValueError(f"expected no control characters, found {shown(text)}")
    return text


def name_of(text: str) -> str:
    if not (text.strip() and text.isprintable() and len(text) <= LONGEST_NAME):
        raise ValueError(f"expected 1 to {LONGEST_NAME} printable characters, found {shown(text)}")
    return text


def encoding_of_text(name: str) -> str:
    try:
        "é".encode(name, errors="replace").decode(name)
    except (LookupError, UnicodeError, ValueError, TypeError):
        raise ValueError(f"expected a text encoding such as utf-16, found {as_written(name)}") from None
    return name


def different(files: str | list[str]) -> str | list[str]:
    for file, count in Counter([files] if isinstance(files, str) else files).items():
        if count > 1:
            raise ValueError(f'expected different files, found "{file}" twice')
    return files


def check_span(start: float | None, stop: float | None) -> None:
    if start is not None and stop is not None and start >= stop:
        raise ValueError(f"start: expected a start before the stop {stop:g} s, found {start:g} s")


def check_one_per_column(columns: int, **values: float | list[float] | None) -> None:
    """Raises ValueError for a list of another length than there are columns."""
    for key, value in values.items():
        if isinstance(value, Sequence) and len(value) != columns:
            raise ValueError(f"{key}: expected a number or {columns} numbers, one per column, found {len(value)}")
