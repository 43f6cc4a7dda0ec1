"""A recording's messages as one Parquet log."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import polars as pl

from tumble.errors import InputError
from tumble.recording.formats.message import TIME, Message
from tumble.recording.writer import write_tables


def as_log(path: Path, accel: Message, gyro: Message | None, thermometers: Sequence[Message] = ()) -> None:
    """Write the rows of a message with accelerometers, and where its gyros are in another one those of both, into a
    Parquet file, whole or not at all.

    Two messages come at times of their own: the accelerometers (and the temperatures beside them) are interpolated
    linearly at the times of the gyros, which are what is integrated, over the time that both cover. The temperatures of
    thermometers of their own are interpolated too, and before and after they have the nearest."""
    tables = _together(accel, gyro) if gyro is not None and gyro is not accel else accel.rows()
    for thermometer in thermometers:
        tables = _with_temperature(tables, thermometer)
    write_tables(path, tables)


def _with_temperature(tables: Iterator[pl.DataFrame], thermometer: Message) -> Iterator[pl.DataFrame]:
    slow, (name,) = pl.concat(thermometer.rows()), thermometer.temperatures
    for table in tables:
        yield table.with_columns(pl.Series(name, np.interp(table[TIME].to_numpy(), slow[TIME], slow[name])))


def _together(accel: Message, gyro: Message) -> Iterator[pl.DataFrame]:
    slow, fast = (pl.concat(m.rows()) for m in (accel, gyro))
    at = fast[TIME].to_numpy()
    first, last = slow[TIME][0], slow[TIME][-1]
    common = (at >= first) & (at <= last)
    if np.count_nonzero(common) < 2:
        raise InputError(
            f"{accel.name} and {gyro.name}: expected messages recorded at the same time, found them {first:.6g} to "
            f"{last:.6g} s and {at[0]:.6g} to {at[-1]:.6g} s"
        )
    read = {name: np.interp(at, slow[TIME].to_numpy(), slow[name].to_numpy()) for name in accel.columns}
    yield fast.with_columns(**read).filter(common)
