"""How the lines of a text log that is no table are spelled: the columns they have, and the values of a line."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

LEAST_NUMBERS = 3
_SHARE = 0.8
T = TypeVar("T")


@dataclass(frozen=True, kw_only=True, slots=True)
class Spelling:
    """Names of the columns, none where the lines have none; the values of a line, none where it is no row, and None
    where it is to be left out; and how it is called."""

    names: tuple[str, ...]
    values: Callable[[str], Sequence[str] | None]
    said: str


def most_common(of_lines: Iterable[T | None], lines: Sequence[str]) -> T | None:
    """What most lines that are not empty have in common, if it is in two at least."""
    found = Counter(item for item in of_lines if item)
    if not found:
        return None
    item, count = found.most_common(1)[0]
    return item if count > max(_SHARE * sum(bool(line.strip()) for line in lines), 1) else None


def of_named_values(cells: Callable[[str], Mapping[str, str]], lines: Sequence[str], said: str) -> Spelling | None:
    """The spelling of lines that name their values, of which `cells` gives names and values; None where most lines name
    no or other ones."""
    names = most_common((tuple(cells(line)) for line in lines), lines)
    if names is None or len(names) < LEAST_NUMBERS:
        return None

    def values(line: str) -> Sequence[str]:
        found = cells(line)
        return list(found.values()) if tuple(found) == names else []

    return Spelling(names=names, values=values, said=f"{said} ({', '.join(names)})")
