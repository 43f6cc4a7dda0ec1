"""What kinds of messages a recording holds, by the reader of its format."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path

from tumble.errors import InputError, needs_extra
from tumble.recording.formats.message import Message

_READERS = {
    ".bag": "ros",
    ".db3": "ros",
    ".mcap": "ros",
    ".ulg": "ulog",
    ".bin": "ardupilot",
    ".mat": "arrays",
    ".h5": "arrays",
    ".hdf5": "arrays",
}

ENDINGS: tuple[str, ...] = tuple(_READERS)
"""Endings of the files that can be read; a ROS 2 bag may also be a folder."""

_DATAFLASH_TEXT = b"FMT,"

_NEEDED: Mapping[str, str] = {"ros": "rosbags", "ulog": "pyulog", "ardupilot": "pymavlink", "arrays": "h5py"}


def is_recording(path: Path) -> bool:
    """Whether a file, or the folder of a ROS 2 bag, is in one of the formats, by its ending or its first bytes."""
    return _reader(path) is not None


def _reader(path: Path) -> str | None:
    if path.is_dir():
        return "ros" if (path / "metadata.yaml").is_file() else None
    named = _READERS.get(path.suffix.lower())
    return named or ("ardupilot" if _begins_with(path, _DATAFLASH_TEXT) else None)


def _begins_with(path: Path, first: bytes) -> bool:
    try:
        with path.open("rb") as stream:
            return stream.read(len(first)) == first
    except OSError:
        return False


def messages(path: Path) -> list[Message]:
    """The kinds of messages with inertial sensors in a recording.

    Raises InputError, one line, for an unknown or damaged file and for one without inertial sensors, and
    MissingExtraError where the extra `formats` is not installed."""
    reader = _reader(path)
    if reader is None:
        raise InputError(f"{path}: expected a recording that ends in {', '.join(ENDINGS)}, found another")
    if not path.exists():
        raise InputError(f"{path}: expected a recording, found no such file")
    with needs_extra(f"{path}: reading it", "formats", _NEEDED[reader]):
        module = import_module(f"tumble.recording.formats.{reader}")
    try:
        found: list[Message] = module.messages(path)
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path}: expected a readable file, found: {error.strerror or error}") from None
    except Exception as error:  # each reader's library has errors of its own, and struct.error, IndexError and more
        said = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: expected a sound recording, found it damaged or incomplete: {said}") from None
    if not any(message.accel for message in found):
        raise InputError(f"{path}: expected messages with accelerometers, found {module.NOTHING}")
    return found
