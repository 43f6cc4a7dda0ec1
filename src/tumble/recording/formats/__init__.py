"""Recordings in other formats than CSV and Parquet: their messages, and conversion to a log.

A recording is a list of `Message` kinds (a topic of a bag, a message of a flight log, a group of arrays), each with the
sensors found in it and their units. `write_log` writes one kind, or accelerometers and gyros of two kinds, as one
Parquet file for a session. Each format has a reader, which needs the extra `formats`; a ROS 2 bag may also be a folder,
and a log of ArduPilot a text. Other packages provide further readers (`tumble.plugins`).
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from traceback import walk_tb
from typing import Any

import numpy as np
import polars as pl

from tumble.errors import InputError, needs_extra
from tumble.plugins import load_all
from tumble.recording.columns.names import ACCEL, GYRO, MAGNETOMETER, Sensors
from tumble.recording.readers import ENDINGS as READ_ENDINGS
from tumble.recording.readers import write_tables
from tumble.recording.session import AutopilotSensor

_READERS = {
    "ros": ("rosbags", (".bag", ".db3", ".mcap")),
    "ulog": ("pyulog", (".ulg",)),
    "ardupilot": ("pymavlink", (".bin",)),
    "arrays": ("h5py", (".mat", ".h5", ".hdf5", ".npy", ".npz")),
}
"""Modules of formats, with the required library and the endings of the files."""

ENDINGS: tuple[str, ...] = tuple(ending for _, endings in _READERS.values() for ending in endings)
"""Endings of files that can be read; a ROS 2 bag may also be a folder."""

_NO_PLUGINS = (*READ_ENDINGS, ".txt", ".log", ".zip")
"""Endings that readers of other packages cannot claim."""

_DATAFLASH_TEXT = b"FMT,"
_BINARY = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]")
"""Bytes that occur at the beginning of all recordings and in no text."""

TIME = "t"
"""The time column in the rows of a message, s, on a clock common to all messages of a recording."""
AXES = "xyz"
_KINDS = {"accel": ACCEL, "gyro": GYRO, "field": MAGNETOMETER}
MESSAGES: Mapping[str, Any] = tomllib.loads(Path(__file__).with_name("messages.toml").read_text(encoding="utf-8"))
"""Fields of messages by column and units by format, and doubts about corrected readings by the name of a column."""
PX4_CORRECTED: str = MESSAGES["corrected"]["accelerometer_m_s2[0]"]
"""Doubt about readings of the message sensor_combined."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Message:
    """A kind of message: its name, number of rows and sensors by kind.

    `rows` gives tables of bounded size in order, with the column TIME if `timed`; `temperatures` are columns in °C as
    [log.temperature] lists them; `remark` is a sentence for the user, and `doubt` one on readings that are not raw;
    `imu` has the "accel" and "gyro" of an autopilot."""

    name: str
    count: int
    triads: Mapping[str, Sensors]
    rows: Callable[[], Iterator[pl.DataFrame]]
    temperatures: tuple[str, ...] = ()
    timed: bool = True
    remark: str = ""
    doubt: str = ""
    imu: Mapping[str, AutopilotSensor] = field(default_factory=dict)

    @property
    def accel(self) -> Sensors | None:
        """Its accelerometers."""
        return self.triads.get(ACCEL)

    @property
    def gyro(self) -> Sensors | None:
        """Its gyros."""
        return self.triads.get(GYRO)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the sensors' columns."""
        named = [column for triad in self.triads.values() for column in triad.columns]
        return (*named, *dict.fromkeys(self.temperatures))


@dataclass(frozen=True, kw_only=True, slots=True)
class Reader:
    """A reader of recordings in one format.

    Attributes
    ----------
    endings
        Endings of the names of its files, in lower case and with the dot.
    messages
        Function that returns the kinds of messages in a file. Its errors are reported as a damaged file.
    """

    endings: tuple[str, ...]
    messages: Callable[[Path], list[Message]]


def triads_of(columns: Iterable[str], units: Mapping[str, str]) -> dict[str, Sensors]:
    """Return the sensors with the columns accel_x, gyro_x, field_x, …, by kind, in `units` by these names."""
    triads = {name: tuple(f"{name}_{axis}" for axis in AXES) for name in units}
    return {
        _KINDS[name]: Sensors(columns=(x, y, z), unit=units[name])
        for name, (x, y, z) in triads.items()
        if x in set(columns)
    }


def is_recording(path: Path) -> bool:
    """Return whether a file, or the folder of a ROS 2 bag, is in one of the formats, by ending or first bytes."""
    return format_of(path) is not None or _plugin_of(path) is not None


def _plugin_of(path: Path) -> Reader | None:
    """Return the reader of another package for a file with this ending."""
    ending = path.suffix.lower()
    if not ending or ending in _NO_PLUGINS or path.is_dir():
        return None
    return next((reader for reader in load_all("readers", Reader).values() if ending in reader.endings), None)


def format_of(path: Path) -> str | None:
    """Return the format of a recording, the name of the module that reads it; None for other files."""
    if path.is_dir():
        return "ros" if (path / "metadata.yaml").is_file() else None
    try:
        with path.open("rb") as stream:
            first = stream.read(256)
    except OSError:
        first = b""
    if first.startswith(_DATAFLASH_TEXT):
        return "ardupilot"
    ending = "" if first and not _BINARY.search(first) else path.suffix.lower()
    return next((reader for reader, (_, endings) in _READERS.items() if ending in endings), None)


def messages(*paths: Path) -> list[Message]:
    """Return the kinds of messages with inertial sensors in a recording of one or several files.

    Raises InputError for an unknown or damaged file and for a recording without accelerometers, and MissingExtraError
    if the extra `formats` is not installed."""
    found: list[Message] = []
    nothing: list[str] = []
    for path in paths:
        name, plugin = format_of(path), None
        if name is None and (plugin := _plugin_of(path)) is None:
            raise InputError(f"{path}: expected a recording that ends in {', '.join(ENDINGS)}, found another")
        if not path.exists():
            raise InputError(f"{path}: expected a recording, found no such file")
        if plugin is not None:
            read_messages, none = plugin.messages, "none"
        else:
            with needs_extra(f"{path}: reading it", "formats", _READERS[name or ""][0]):
                module = import_module(f"tumble.recording.formats.{name}")
            read_messages, none = module.messages, module.NOTHING
        with _intact(path):
            of_file: list[Message] = read_messages(path)
        found += [replace(message, rows=partial(_rows, path, message)) for message in of_file]
        nothing.append(none)
    if not any(message.accel for message in found):
        sensors, remedy = nothing[0], ""
        if any(message.gyro for message in found):
            sensors = "gyros alone"
            remedy = "; record the accelerometers too, or give tumble calibrate or tumble noise the gyros as CSV"
        elif any(MAGNETOMETER in message.triads for message in found):
            sensors, remedy = "a magnetometer alone", "; record the accelerometers with it"
        raise InputError(f"{paths[0]}: expected messages with accelerometers, found {sensors}{remedy}")
    return found


def _rows(path: Path, message: Message) -> Iterator[pl.DataFrame]:
    with _intact(path):
        yield from message.rows()


PROGRAM_ERRORS = TypeError, AttributeError, NameError, LookupError, AssertionError
"""Errors whose text describes the program, not the file."""


@contextmanager
def _intact(path: Path) -> Iterator[None]:
    """Turn errors of a reader's library about a damaged recording into an InputError.

    Errors of this program are raised unchanged."""
    try:
        yield
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path}: expected a readable file, found: {error.strerror or error}") from None
    except Exception as error:  # the libraries raise their own errors, struct.error, IndexError and more
        is_program_error = isinstance(error, PROGRAM_ERRORS)
        last = [str(frame.f_globals.get("__name__")) for frame, _ in walk_tb(error.__traceback__)][-2:]
        here = any(name.startswith("tumble.recording.formats.") for name in last)  # a message lacks a field
        if is_program_error and not isinstance(error, LookupError) and here:
            raise
        words = type(error).__name__ if is_program_error else " ".join(str(error).split()) or type(error).__name__
        cause = error.__context__
        while cause is not None:  # some libraries quote errors of Python
            if isinstance(cause, PROGRAM_ERRORS) and str(cause):
                words = words.replace(" ".join(str(cause).split()), type(cause).__name__)
            cause = cause.__context__
        raise InputError(f"{path}: expected an intact recording, found it damaged or incomplete: {words}") from None


def write_log(path: Path, accel: Message, gyro: Message | None = None) -> None:
    """Write the rows of a message with accelerometers, and of another one with the gyros, to a Parquet file.

    Accelerometers of another message than the gyros, and their temperatures, are interpolated linearly at the times of
    the gyros, because gyros are integrated, over the time that both cover."""
    if gyro is None or gyro is accel:
        write_tables(path, accel.rows())
        return
    fast, slow = pl.concat(gyro.rows()), pl.concat(accel.rows())
    at, first, last = fast[TIME].to_numpy(), slow[TIME][0], slow[TIME][-1]
    fast = fast.filter((at >= first) & (at <= last))
    if fast.height < 2:
        raise InputError(
            f"{accel.name} and {gyro.name}: expected messages recorded at the same time, found them {first:.6g} to "
            f"{last:.6g} s and {at[0]:.6g} to {at[-1]:.6g} s"
        )
    added = (pl.Series(name, np.interp(fast[TIME], slow[TIME], slow[name])) for name in accel.columns)
    write_tables(path, iter([fast.with_columns(added)]))
