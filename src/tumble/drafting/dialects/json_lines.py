"""Logs with an object of JSON in each line, `{"ts": 0.01, "acc": [0.1, 0.2, 9.8], "gyro": {"x": 0, …}}`: a table of
their values. A list of three numbers is three columns, an object within an object has its name before its own."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

from tumble.drafting.dialects.spelling import Spelling, of_named_values
from tumble.recording.text.dialect import Dialect, is_clock

_LONGEST_LINE = 4096
_LABEL = re.compile(r"sensor|type|kind|topic|name", re.IGNORECASE)
_WORD = re.compile(r"[^\W\d][\w .()-]{0,40}")


def json_lines(lines: Sequence[str]) -> Spelling | None:
    """The objects that most lines are; None where they are none."""
    return of_named_values(_cells, lines, "objects of JSON")


def _cells(line: str) -> dict[str, str]:
    """Names and values of the object in a line; nothing where it is none."""
    text = line.strip().removeprefix("[").removesuffix("]").strip().removesuffix(",")
    if not text.startswith("{") or len(text) > _LONGEST_LINE:
        return {}
    for spelt in (text, text.replace("'", '"')):  # JSON, or as Python prints it
        with suppress(ValueError, RecursionError):
            read = json.loads(spelt)
            return dict(values_of(read)) if isinstance(read, dict) else {}
    return {}


def values_of(read: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, str]]:
    """Names and values of an object and those within it: numbers, also as text, times of day, and the names of
    sensors."""
    for key, value in read.items():
        name = before + column_name(key)
        if isinstance(value, dict):
            yield from values_of(value, f"{name}_")
        elif isinstance(value, list) and len(value) == 3:
            yield from values_of(dict(zip("xyz", value, strict=True)), f"{name}_")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield name, repr(value)
        elif isinstance(value, str):
            is_label = _LABEL.search(name) and _WORD.fullmatch(value)
            if is_label or is_clock(value) or Dialect().is_number(value):
                yield name, value


def column_name(key: str) -> str:
    """The name of a value as that of a column of a table."""
    return re.sub('[,"\\s]+', " ", key)
