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

    names: tuple[str, ...] = ()
    values: Callable[[str], Sequence[str] | None]
    said: str


def most_common(of_lines: Iterable[T | None], lines: Sequence[str]) -> T | None:
    """What most lines that are not empty have in common, if it is in two at least."""
    counts = Counter(item for item in of_lines if item)
    if not counts:
        return None
    item, count = counts.most_common(1)[0]
    return item if count > max(_SHARE * sum(bool(line.strip()) for line in lines), 1) else None


def of_named_values(cells: Callable[[str], Mapping[str, str]], lines: Sequence[str], said: str) -> Spelling | None:
    """The spelling of lines that name their values, of which `cells` gives names and values; None where most lines name
    no or other ones."""
    names = most_common((tuple(cells(line)) for line in lines), lines)
    if names is None or len(names) < LEAST_NUMBERS:
        return None

    def values(line: str) -> Sequence[str]:
        row = cells(line)
        return list(row.values()) if tuple(row) == names else []

    return Spelling(names=names, values=values, said=f"{said} ({', '.join(names)})")


def below_names(
    names: tuple[str, ...], lines: Sequence[str], numbers: Callable[[str], list[str] | None], said: str
) -> Spelling:
    """The spelling of rows, of which `numbers` gives the values, below a first line with `names`."""

    def values(line: str) -> Sequence[str] | None:
        row = numbers(line)
        return row if row is not None else None if line == lines[0] else []

    return Spelling(names=names, values=values, said=f"{said} ({', '.join(names)})")
