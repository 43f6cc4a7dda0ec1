"""Results as JSON: what the tables of the command line say, in SI and by name, for other programs.

Keys are those of the result's dataclasses and of the calibration file; an angle is in rad, a rate in rad/s, the
temperature of a rest in °C, what is not known is null, days and times are by ISO 8601; `format` is that of the keys.
A negative answer is a `verdict` "not accepted" with its `reasons`, as in the outcome of a calibration.
Rests, turns and files are counted from 0, as in the calibration file. Which keys a result has stands beside its blocks,
in its `_data` function.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from tumble.inference.estimate import Judgement

Content = dict[str, Any]


def fields(result: object, names: str) -> Content:
    """Fields of a result, by their names."""
    return {name: getattr(result, name) for name in names.split()}


def judged(reasons: Sequence[str]) -> Content:
    """The verdict on what was asked, and the reasons against it."""
    return {"verdict": Judgement(reasons=tuple(reasons)).verdict, "reasons": reasons}


def rows(names: str, *columns: Iterable[Any]) -> list[Content]:
    """Columns of equal length as rows by the names of the columns."""
    return [dict(zip(names.split(), row, strict=True)) for row in zip(*columns, strict=True)]
