"""What kinds of messages a recording holds, by the reader of its format, and how they become one Parquet log."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import polars as pl

from tumble.errors import InputError, needs_extra
from tumble.recording.formats.message import TIME, Message
from tumble.recording.writer import write_tables

_READERS = {
    ".bag": "ros",
    ".db3": "ros",
    ".mcap": "ros",
    ".ulg": "ulog",
    ".bin": "ardupilot",
    ".mat": "arrays",
    ".h5": "arrays",
    ".hdf5": "arrays",
    ".npy": "arrays",
    ".npz": "arrays",
}

ENDINGS: tuple[str, ...] = tuple(_READERS)
"""Endings of the files that can be read; a ROS 2 bag may also be a folder."""

_DATAFLASH_TEXT = b"FMT,"
_NO_TEXT = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]")
"""What text has nowhere, whatever the ending of its file, and every recording has in its first bytes."""

_NEEDED: Mapping[str, str] = {"ros": "rosbags", "ulog": "pyulog", "ardupilot": "pymavlink", "arrays": "h5py"}


def is_recording(path: Path) -> bool:
    """Whether a file, or the folder of a ROS 2 bag, is in one of the formats, by its ending or its first bytes."""
    return _reader(path) is not None


def _reader(path: Path) -> str | None:
    if path.is_dir():
        return "ros" if (path / "metadata.yaml").is_file() else None
    first = _first_bytes(path)
    if first.startswith(_DATAFLASH_TEXT):
        return "ardupilot"
    return None if first and not _NO_TEXT.search(first) else _READERS.get(path.suffix.lower())


def _first_bytes(path: Path) -> bytes:
    try:
        with path.open("rb") as stream:
            return stream.read(256)
    except OSError:
        return b""


def messages(*paths: Path) -> list[Message]:
    """The kinds of messages with inertial sensors in a recording, which may be in several files.

    Raises InputError, one line, for an unknown or damaged file and for a recording without inertial sensors, and
    MissingExtraError where the extra `formats` is not installed."""
    found = [message for path in paths for message in _messages(path)]
    if not any(message.accel for message in found):
        alone = "gyros alone" if any(message.gyro for message in found) else _module(paths[0]).NOTHING
        raise InputError(f"{paths[0]}: expected messages with accelerometers, found {alone}")
    return found


def _module(path: Path) -> ModuleType:
    """The reader of a recording."""
    reader = _reader(path)
    if reader is None:
        raise InputError(f"{path}: expected a recording that ends in {', '.join(ENDINGS)}, found another")
    if not path.exists():
        raise InputError(f"{path}: expected a recording, found no such file")
    with needs_extra(f"{path}: reading it", "formats", _NEEDED[reader]):
        return import_module(f"tumble.recording.formats.{reader}")


def _messages(path: Path) -> list[Message]:
    module = _module(path)
    with _intact(path):
        found: list[Message] = module.messages(path)
        return [replace(message, rows=partial(_rows, path, message)) for message in found]


def _rows(path: Path, message: Message) -> Iterator[pl.DataFrame]:
    with _intact(path):
        yield from message.rows()


@contextmanager
def _intact(path: Path) -> Iterator[None]:
    """Whatever a reader's library says of a damaged recording, then or while its rows are read, becomes one line."""
    try:
        yield
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path}: expected a readable file, found: {error.strerror or error}") from None
    except Exception as error:  # each reader's library has errors of its own, and struct.error, IndexError and more
        of_python = isinstance(error, TypeError | AttributeError | LookupError | AssertionError)
        said = type(error).__name__ if of_python else " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: expected an intact recording, found it damaged or incomplete: {said}") from None


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
