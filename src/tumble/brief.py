"""Base classes of results with a short repr: arrays by their shape, collections by their size."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sized
from dataclasses import fields, is_dataclass
from html import escape
from typing import Any, Literal

import numpy as np

_LONGEST = 40  # characters of a value that is shown in full


class Brief:
    """Base of a dataclass (`repr=False`) whose repr is short."""

    __slots__ = ()

    def __repr__(self) -> str:
        """Return the name of the class and its fields, shortened."""
        shown = (f"{name}={_short(getattr(self, name))}" for name in self._shown_fields())
        return f"{type(self).__name__}({', '.join(shown)})"

    def _repr_html_(self) -> str:
        """Return the fields, shortened, as a table for a notebook."""
        rows = (
            f"<tr><th>{name}</th><td>{escape(_short(getattr(self, name)))}</td></tr>" for name in self._shown_fields()
        )
        return f"<table><caption>{type(self).__name__}</caption>{''.join(rows)}</table>"

    def _shown_fields(self) -> list[str]:
        return [field.name for field in fields(self) if field.repr]  # type: ignore[arg-type]  # of a subclass


def _short(value: Any) -> str:
    """Return the repr of a value if it is short, else its type and size."""
    if isinstance(value, np.ndarray):
        return f"array{value.shape}"
    text = "" if is_dataclass(value) or (isinstance(value, Sized) and len(value) > _LONGEST) else repr(value)
    if text and len(text) <= _LONGEST and "\n" not in text:
        return text
    if isinstance(value, str):
        return repr(f"{value[: _LONGEST - 1]}…")
    return f"{len(value)} entries" if isinstance(value, tuple | list | dict | set) else f"<{type(value).__name__}>"


class Judged(Brief):
    """Base of a result that is negative if there are `reasons`, which are sentences."""

    __slots__ = ()

    @property
    @abstractmethod
    def reasons(self) -> tuple[str, ...]:
        """Reasons for a negative result; empty if it is positive."""

    @property
    def verdict(self) -> Literal["accepted", "not accepted"]:
        """Verdict in the words used for calibrations."""
        return "not accepted" if self.reasons else "accepted"
