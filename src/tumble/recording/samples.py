"""Samples in memory in place of a file of a log: columns as arrays, or a polars or pandas frame."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from tumble.errors import LogError

Data = Any
"""A mapping from column names to arrays (N,), a polars or a pandas frame; a sequence of them is a log of several files.
Pandas is not a dependency, so that its frames cannot be named in a type."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Samples:
    """A table of samples, and what messages call it."""

    name: str
    table: pl.DataFrame

    @property
    def path(self) -> Path:
        """Its name where that of a file would stand."""
        return Path(self.name)

    def content(self, columns: Sequence[str]) -> Iterator[bytes]:
        """The numbers of these columns, for a hash."""
        for column in columns:
            yield column.encode()
            yield np.ascontiguousarray(self.table[column].to_numpy(), dtype=np.float64).tobytes()


def samples_of(data: Data) -> tuple[Samples, ...]:
    """The tables of a log in memory. Raises LogError for anything that is not one."""
    if isinstance(data, list | tuple):
        return tuple(Samples(name=f"samples {i}", table=_table(part)) for i, part in enumerate(data, 1))
    return (Samples(name="samples", table=_table(data)),)


def _table(data: Data) -> pl.DataFrame:
    if isinstance(data, pl.DataFrame):
        return data
    if not isinstance(data, Mapping) and not (hasattr(data, "columns") and hasattr(data, "__getitem__")):
        raise LogError(
            "samples: expected columns by name, as arrays, or a polars or pandas frame, found "
            f"{type(data).__name__}; name the columns as the description does"
        )
    names = list(data) if isinstance(data, Mapping) else list(data.columns)
    columns = [_column(str(name), data[name]) for name in names]
    lengths = {column.name: len(column) for column in columns}
    if len(set(lengths.values())) > 1:
        found = ", ".join(f"{length} in '{name}'" for name, length in lengths.items())
        raise LogError(f"samples: expected as many numbers in every column, found {found}")
    return pl.DataFrame(columns)


def _column(name: str, values: Any) -> pl.Series:
    array = np.asarray(values)
    if array.ndim != 1:
        raise LogError(
            f"samples: column '{name}': expected an array of one dimension, found the shape {array.shape}; give every "
            "sensor a column of its own"
        )
    return pl.Series(name, array if array.dtype.kind in "biuf" else array.tolist(), strict=False)
