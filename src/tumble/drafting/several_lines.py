"""Logs in which a sample is several lines, `Acceleration X: 0.1, Y: …` and then `Rotation X: …`, or a message of ROS as
`rostopic echo` prints it: a table with a row for each sample.

A name stands for what is above it too, `angular_velocity:` and then `x: 0.1` further in. A sample ends where a name
comes again.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence

from tumble.drafting.named_values import named_numbers
from tumble.drafting.spelling import Spelling

_ABOVE = re.compile(r"([ \t]*)([^\W\d][\w.]*)\s*:\s*")
_LEAST_NAMES = 6
_SHARE = 0.8


class _Sample:
    """What was read of the present sample, and the names that stand above the next line."""

    def __init__(self) -> None:
        self._cells: dict[str, str] = {}
        self._above: list[tuple[int, str]] = []
        self._lines = 0

    def fed(self, line: str) -> tuple[dict[str, str], int] | None:
        """The sample before, and of how many lines it was, where a line begins the next one."""
        found = self._named(line)
        done = None
        if found.keys() & self._cells.keys():
            done = self._cells, self._lines
            self._cells, self._lines = {}, 0
        self._cells |= found
        self._lines += bool(found)
        return done

    def _named(self, line: str) -> Mapping[str, str]:
        """Names, with those above them, and numbers of a line."""
        inside = len(line) - len(line.lstrip())
        self._above = [(at, name) for at, name in self._above if at < inside]
        above = _ABOVE.fullmatch(line.rstrip())
        if above is not None:
            self._above.append((inside, above[2]))
            return {}
        before = "_".join(name for _, name in self._above)
        return {f"{before}_{name}" if before else name: number for name, number in named_numbers(line).items()}


def several_lines(lines: Sequence[str]) -> Spelling | None:
    """The spelling of lines of which several are a sample; None where one is, or they are none."""
    sample = _Sample()
    samples = [done for line in lines if (done := sample.fed(line)) is not None]
    if not samples:
        return None
    kinds = Counter(tuple(cells) for cells, count in samples[1:] if count > 1)
    names, count = kinds.most_common(1)[0] if kinds else ((), 0)
    if len(names) < _LEAST_NAMES or count <= max(_SHARE * (len(samples) - 1), 1):
        return None
    reading = _Sample()

    def values(line: str) -> Sequence[str] | None:
        done = reading.fed(line)
        return [done[0].get(name, "") for name in names] if done is not None else None

    return Spelling(names=names, values=values, said=f"several lines a sample ({', '.join(names)})")
