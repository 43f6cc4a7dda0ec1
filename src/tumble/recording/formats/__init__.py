"""Recordings in other formats than CSV and Parquet: what they hold, and how it becomes a log.

A recording is a list of `Message` kinds (a topic of a bag, a message of a flight log, a group of arrays), each with the
sensors found in it and their units. `write_log` writes one kind, or accelerometers and gyros of two kinds, as one Parquet
file, which a session can name. One reader per format, each behind the extra `formats`; a ROS 2 bag may also be a folder,
and a log of ArduPilot a text. Other packages bring a `Reader` each (`tumble.plugins`).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from traceback import walk_tb

import numpy as np
import polars as pl

from tumble.errors import InputError, needs_extra
from tumble.plugins import load_all
from tumble.recording.columns.names import Sensors
from tumble.recording.columns.patterns import ACCEL, GYRO, MAGNETOMETER
from tumble.recording.readers import ENDINGS as READ_ENDINGS
from tumble.recording.readers import write_tables
from tumble.recording.session import AutopilotSensor

_READERS = {
    "ros": ("rosbags", (".bag", ".db3", ".mcap")),
    "ulog": ("pyulog", (".ulg",)),
    "ardupilot": ("pymavlink", (".bin",)),
    "arrays": ("h5py", (".mat", ".h5", ".hdf5", ".npy", ".npz")),
}
"""The module of each format, the library that it needs, and the endings of its files."""

ENDINGS: tuple[str, ...] = tuple(ending for _, endings in _READERS.values() for ending in endings)
"""Endings of the files that can be read; a ROS 2 bag may also be a folder."""

_NO_RECORDINGS = (*READ_ENDINGS, ".txt", ".log", ".zip")
"""Endings of files for which no other package is asked."""

_DATAFLASH_TEXT = b"FMT,"
_NO_TEXT = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]")
"""What text has nowhere, whatever the ending of its file, and every recording has in its first bytes."""

TIME = "t"
"""The column of the time in the rows of a message, s on a clock that all messages of a recording share."""
AXES = "xyz"
_KINDS = {"accel": ACCEL, "gyro": GYRO, "field": MAGNETOMETER}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Message:
    """A kind of message: its name, the number of its rows, its sensors by kind, the columns of the temperatures in °C,
    as [log.temperature] has them, and `rows`, tables of a bounded size in order, with the column TIME where `timed`.
    `remark` is what a user of the data must know."""

    name: str
    count: int
    triads: Mapping[str, Sensors]
    rows: Callable[[], Iterator[pl.DataFrame]]
    temperatures: tuple[str, ...] = ()
    timed: bool = True
    remark: str = ""
    imu: Mapping[str, AutopilotSensor] = field(default_factory=dict)
    """Which "accel" and "gyro" of an autopilot they are, where it is a log of one."""

    @property
    def accel(self) -> Sensors | None:
        """Its accelerometers."""
        return self.triads.get(ACCEL)

    @property
    def gyro(self) -> Sensors | None:
        """Its gyros."""
        return self.triads.get(GYRO)

    @property
    def thermometer(self) -> bool:
        """Whether the message has a temperature, times, and nothing else."""
        return self.timed and not self.triads and bool(self.temperatures)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the sensors' columns."""
        named = [column for triad in self.triads.values() for column in triad.columns]
        return (*named, *dict.fromkeys(self.temperatures))


@dataclass(frozen=True, kw_only=True, slots=True)
class Reader:
    """What reads the recordings of a format.

    Attributes
    ----------
    endings
        How names of its files end, in lower case and with the dot.
    messages
        Gives the kinds of messages in a file. Whatever it raises becomes a message about a damaged file.
    """

    endings: tuple[str, ...]
    messages: Callable[[Path], list[Message]]


def triads_of(columns: Iterable[str], units: Mapping[str, str]) -> dict[str, Sensors]:
    """The sensors accel_x, gyro_x, field_x, … of which there are columns, by kind, in the units of these names."""
    names = set(columns)
    of_name = {name: tuple(f"{name}_{axis}" for axis in AXES) for name in units}
    return {
        _KINDS[name]: Sensors(columns=(x, y, z), unit=units[name]) for name, (x, y, z) in of_name.items() if x in names
    }


def is_recording(path: Path) -> bool:
    """Whether a file, or the folder of a ROS 2 bag, is in one of the formats, by its ending or its first bytes."""
    return _reader(path) is not None or _brought(path) is not None


def _brought(path: Path) -> Reader | None:
    """The reader of another package for a file with this ending."""
    ending = path.suffix.lower()
    if not ending or ending in _NO_RECORDINGS or path.is_dir():
        return None
    return next((reader for reader in load_all("readers", Reader).values() if ending in reader.endings), None)


def _reader(path: Path) -> str | None:
    if path.is_dir():
        return "ros" if (path / "metadata.yaml").is_file() else None
    try:
        with path.open("rb") as stream:
            first = stream.read(256)
    except OSError:
        first = b""
    if first.startswith(_DATAFLASH_TEXT):
        return "ardupilot"
    ending = "" if first and not _NO_TEXT.search(first) else path.suffix.lower()
    return next((reader for reader, (_, endings) in _READERS.items() if ending in endings), None)


def messages(*paths: Path) -> list[Message]:
    """The kinds of messages with inertial sensors in a recording, which may be in several files.

    Raises InputError, one line, for an unknown or damaged file and for a recording without inertial sensors, and
    MissingExtraError where the extra `formats` is not installed."""
    found: list[Message] = []
    nothing: list[str] = []
    for path in paths:
        reader, brought = _reader(path), None
        if reader is None and (brought := _brought(path)) is None:
            raise InputError(f"{path}: expected a recording that ends in {', '.join(ENDINGS)}, found another")
        if not path.exists():
            raise InputError(f"{path}: expected a recording, found no such file")
        if brought is not None:
            messages_of, none = brought.messages, "none"
        else:
            with needs_extra(f"{path}: reading it", "formats", _READERS[reader or ""][0]):
                module = import_module(f"tumble.recording.formats.{reader}")
            messages_of, none = module.messages, module.NOTHING
        with _intact(path):
            read: list[Message] = messages_of(path)
        found += [replace(message, rows=partial(_rows, path, message)) for message in read]
        nothing.append(none)
    if not any(message.accel for message in found):
        alone = "gyros alone" if any(message.gyro for message in found) else nothing[0]
        raise InputError(f"{paths[0]}: expected messages with accelerometers, found {alone}")
    return found


def _rows(path: Path, message: Message) -> Iterator[pl.DataFrame]:
    with _intact(path):
        yield from message.rows()


OF_PYTHON = TypeError, AttributeError, NameError, LookupError, AssertionError
"""Errors whose text speaks of the program, and not of the file."""


@contextmanager
def _intact(path: Path) -> Iterator[None]:
    """Whatever a reader's library says of a damaged recording, then or while its rows are read, becomes one line. An
    error of this program is none of the file, and goes on as it is."""
    try:
        yield
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path}: expected a readable file, found: {error.strerror or error}") from None
    except Exception as error:  # each reader's library has errors of its own, and struct.error, IndexError and more
        of_python = isinstance(error, OF_PYTHON)
        last = [str(frame.f_globals.get("__name__")) for frame, _ in walk_tb(error.__traceback__)][-2:]
        here = any(
            name.startswith("tumble.recording.formats.") for name in last
        )  # a field that a message does not have
        if of_python and not isinstance(error, LookupError) and here:
            raise
        words = type(error).__name__ if of_python else " ".join(str(error).split()) or type(error).__name__
        cause = error.__context__
        while cause is not None:  # some libraries quote what Python said
            if isinstance(cause, OF_PYTHON) and str(cause):
                words = words.replace(" ".join(str(cause).split()), type(cause).__name__)
            cause = cause.__context__
        raise InputError(f"{path}: expected an intact recording, found it damaged or incomplete: {words}") from None


def write_log(path: Path, accel: Message, gyro: Message | None = None, thermometers: Sequence[Message] = ()) -> None:
    """Write the rows of a message with accelerometers, and where its gyros are in another one those of both, into a
    Parquet file, whole or not at all.

    Two messages come at times of their own: the accelerometers (and the temperatures beside them) are interpolated
    linearly at the times of the gyros, which are what is integrated, over the time that both cover. The temperatures of
    thermometers of their own are interpolated too, and before and after they have the nearest."""
    slow = [*thermometers] if gyro in (None, accel) else [accel, *thermometers]
    read = [(message.columns, pl.concat(message.rows())) for message in slow]
    tables = accel.rows()
    if gyro is not None and gyro is not accel:
        fast = pl.concat(gyro.rows())
        at, first, last = fast[TIME].to_numpy(), read[0][1][TIME][0], read[0][1][TIME][-1]
        fast = fast.filter((at >= first) & (at <= last))
        if fast.height < 2:
            raise InputError(
                f"{accel.name} and {gyro.name}: expected messages recorded at the same time, found them {first:.6g} to "
                f"{last:.6g} s and {at[0]:.6g} to {at[-1]:.6g} s"
            )
        tables = iter([fast])

    def interpolated(table: pl.DataFrame) -> pl.DataFrame:
        for columns, other in read:
            series = (np.interp(table[TIME], other[TIME], other[name]) for name in columns)
            table = table.with_columns(pl.Series(name, values) for name, values in zip(columns, series, strict=True))
        return table

    write_tables(path, map(interpolated, tables))
