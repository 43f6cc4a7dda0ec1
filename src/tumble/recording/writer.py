"""Tables written to a CSV or Parquet file as a stream, whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import polars as pl
from polars.io.plugins import register_io_source

from tumble.errors import InputError
from tumble.files import ending_in, whole_file

FORMATS = (".csv", ".parquet")


def write_tables(path: Path, tables: Iterator[pl.DataFrame]) -> None:
    """Write tables of the same columns one below the other. Memory does not grow with their number, and an error on
    the way, of the tables too, leaves what was there before.

    Raises InputError for a name that ends otherwise than in .csv or .parquet, and for columns that CSV cannot hold."""
    ending = ending_in(path, *FORMATS)
    failed: list[BaseException] = []
    first = next(tables)
    unwritten = [name for name, kind in first.schema.items() if kind.is_nested() or kind in (pl.Binary, pl.Object)]
    if ending == ".csv" and unwritten:
        raise InputError(
            f"{path}: expected columns of one value a row, which CSV has, found {unwritten[0]!r} of the type "
            f"{first.schema[unwritten[0]]}; write a .parquet file"
        )

    def source(*_: object) -> Iterator[pl.DataFrame]:
        try:
            yield from chain([first], tables)  # a chain has no end of its own: polars may drop the source in any thread
        except (Exception, KeyboardInterrupt) as error:  # polars would make it one of its own, or drop it there
            failed.append(error)
            raise

    stream = register_io_source(source, schema=first.schema, validate_schema=True)
    with whole_file(path) as temporary, temporary.open("wb") as file:  # by name a thread may make it anew, too late
        try:
            (stream.sink_csv if ending == ".csv" else stream.sink_parquet)(file, maintain_order=True)
        except Exception as error:
            raise (*failed, error)[0] from None
