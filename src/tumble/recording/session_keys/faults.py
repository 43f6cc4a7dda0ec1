"""What is said of a session.toml that is not as it should be, made of what each key expects."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from tumble.documents import dotted
from tumble.errors import did_you_mean
from tumble.recording.session_keys.document import TABLES, SessionDocument
from tumble.recording.session_keys.table import SessionTable, as_written


def faults_of(error: ValidationError, content: Mapping[str, Any]) -> list[str]:
    """Every fault once, as "key: expected …, found …"."""
    faults: dict[tuple[int | str, ...], str] = {}
    for fault in error.errors(include_url=False):
        key, table, expected = _located(fault["loc"])
        if fault["type"] == "extra_forbidden":
            unknown = str(fault["loc"][-1])
            said = f"unknown key '{unknown}' {_in_table(key)}{did_you_mean(unknown, table.model_fields)}"
            faults[(*key, unknown)] = said
        elif fault["type"] == "value_error":
            dot = "." if key else ""
            faults[key] = f"{dotted(key)}{dot}{fault['ctx']['error']}"
        else:
            found = "none" if fault["type"] == "missing" else as_written(_value_at(key, content))
            faults.setdefault(key, f"{dotted(key)}: expected {expected}, found {found}")
    return list(faults.values())


def _located(loc: tuple[int | str, ...]) -> tuple[tuple[int | str, ...], type[SessionTable], str]:
    """The key a fault belongs to, the innermost table on the way, and what the key expects."""
    table: type[SessionTable] = SessionDocument
    expected = ""
    key: list[int | str] = []
    for part in loc:
        if isinstance(part, int) and key == ["programme", "position"]:
            key.append(part)
            continue
        if part not in table.model_fields:
            break
        key.append(part)
        expected = table.model_fields[str(part)].description or ""
        if part not in TABLES:
            break
        table = TABLES[str(part)]
    return tuple(key), table, expected


def _value_at(key: tuple[int | str, ...], content: Any) -> Any:
    for part in key:
        content = content[part]
    return content


def _in_table(key: tuple[int | str, ...]) -> str:
    return f"in [{dotted(key)}]" if key else "at the top level"
