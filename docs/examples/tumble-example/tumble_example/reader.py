"""A reader of recordings: files .sfl, records of a time, s, three accelerometers, m/s², and three gyros, rad/s."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl

from tumble.recording.formats import TIME, Message, Reader, triads_of

MAGIC = b"SLOWFLY1"
RECORD = np.dtype([("t", "<f8"), ("accel", "<f4", 3), ("gyro", "<f4", 3)])
COLUMNS = [f"{kind}_{axis}" for kind in ("accel", "gyro") for axis in "xyz"]


def messages(path: Path) -> list[Message]:
    """The one kind of messages that such a file has. Whatever is raised here tumble says of a damaged file."""
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise ValueError("it does not begin with SLOWFLY1")
    count = (path.stat().st_size - len(MAGIC)) // RECORD.itemsize
    triads = triads_of(COLUMNS, {"accel": "m/s^2", "gyro": "rad/s"})
    return [Message(name="imu", count=count, triads=triads, rows=partial(rows, path))]


def rows(path: Path) -> Iterator[pl.DataFrame]:
    """The records in order, some at a time."""
    with path.open("rb") as file:
        file.seek(len(MAGIC))
        while len(records := np.fromfile(file, RECORD, count=1 << 15)):
            numbers = np.hstack([records["accel"], records["gyro"]]).astype(float)
            yield pl.DataFrame({TIME: records["t"]} | dict(zip(COLUMNS, numbers.T, strict=True)))


SLOWFLY = Reader(endings=(".sfl",), messages=messages)
