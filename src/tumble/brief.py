"""Results that show themselves in a line: what would be thousands of numbers is its shape or its count."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sized
from dataclasses import fields, is_dataclass
from html import escape
from typing import Any, Literal

import numpy as np

_LONGEST = 40
"""Characters of a value that is shown as it is."""


class Brief:
    """A dataclass (`repr=False`) whose repr has a few words for each field."""

    __slots__ = ()

    def __repr__(self) -> str:
        """The name of the class and its fields, in short."""
        every = fields(self)  # type: ignore[arg-type]  # of the dataclass that has it
        said = (f"{field.name}={_short(getattr(self, field.name))}" for field in every if field.repr)
        return f"{type(self).__name__}({', '.join(said)})"

    def _repr_html_(self) -> str:
        """The same as a table, as a notebook shows it."""
        every = [field.name for field in fields(self) if field.repr]  # type: ignore[arg-type]
        rows = (f"<tr><th>{name}</th><td>{escape(_short(getattr(self, name)))}</td></tr>" for name in every)
        return f"<table><caption>{type(self).__name__}</caption>{''.join(rows)}</table>"


def _short(value: Any) -> str:
    """A value as it is where that is short, else what it is and how large."""
    if isinstance(value, np.ndarray):
        return f"array{value.shape}"
    whole = "" if is_dataclass(value) or (isinstance(value, Sized) and len(value) > _LONGEST) else repr(value)
    if whole and len(whole) <= _LONGEST and "\n" not in whole:
        return whole
    if isinstance(value, str):
        return repr(f"{value[: _LONGEST - 1]}…")
    return f"{len(value)} entries" if isinstance(value, tuple | list | dict | set) else f"<{type(value).__name__}>"


class Judged(Brief):
    """A result that answers a question: no if there are `reasons`, sentences, against it."""

    __slots__ = ()

    @property
    @abstractmethod
    def reasons(self) -> tuple[str, ...]:
        """Why the answer is no; empty if it is yes."""

    @property
    def verdict(self) -> Literal["accepted", "not accepted"]:
        """The answer in the words of a calibration's outcome."""
        return "not accepted" if self.reasons else "accepted"
