"""Compressed text logs as what is in them. Readings compress to a third or a tenth; what unpacks to a hundred times its
size is no log, and would fill memory or a disk: it is refused, before it is unpacked where the archive says how large
it will be.
"""

from __future__ import annotations

import gzip
import io
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tumble.errors import LogError

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

LARGEST_RATIO = 100
SMALL_BYTES = 1 << 24
"""So much may come out of any archive: rows of a few characters take twenty times as much memory."""

_HEADER_BYTES = 18
"""The longest header of a frame of Zstandard."""
_DEFLATE_RATIO = 1032
"""What gzip reaches at most: an archive that states more was cut."""


def largest_unpacked(path: Path) -> int:
    """How many bytes may come out of an archive of this size."""
    return max(LARGEST_RATIO * path.stat().st_size, SMALL_BYTES)


def unpacked(path: Path) -> io.BufferedIOBase:
    """The content of a file that ends in .gz or .zst, as far as an archive of its size can hold a log.

    Raises LogError for one that holds more, here or while it is read."""
    gzipped = path.suffix.lower() == ".gz"
    limit = largest_unpacked(path)
    stated = (_stated_by_gzip if gzipped else _stated_by_zstd)(path)
    if stated is not None and stated > limit:
        raise _too_large(path, limit, f"{_megabytes(stated)} stated")
    opened: Callable[[Path], Any] = gzip.GzipFile if gzipped else zstd.ZstdFile
    return io.BufferedReader(_Limited(opened(path), path, limit))


def _stated_by_gzip(path: Path) -> int | None:
    """How many bytes the last member of an archive holds, to 4 GB, where it is whole."""
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(size - 4, 0))
        stated = int.from_bytes(file.read(4), "little")
    return stated if stated <= _DEFLATE_RATIO * size else None


def _stated_by_zstd(path: Path) -> int | None:
    """How many bytes the first frame of an archive holds, if it says so."""
    with path.open("rb") as file:
        try:
            return zstd.get_frame_info(file.read(_HEADER_BYTES)).decompressed_size
        except zstd.ZstdError:
            return None


class _Limited(io.RawIOBase):
    """What comes out of an archive, refused where it is more than `limit` bytes."""

    def __init__(self, stream: Any, path: Path, limit: int) -> None:
        self._stream, self._path, self._limit, self._count = stream, path, limit, 0

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any, /) -> int:
        count = int(self._stream.readinto(buffer))
        self._count += count
        if self._count > self._limit:
            raise _too_large(self._path, self._limit, f"{_megabytes(self._count)} and more")
        return count

    def close(self) -> None:
        self._stream.close()
        super().close()


def _too_large(path: Path, limit: int, found: str) -> LogError:
    return LogError(
        f"{path}: expected readings, of which an archive of {_megabytes(path.stat().st_size)} holds at most "
        f"{_megabytes(limit)}, found {found}; if it is a log, unpack it and name the file in it"
    )


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.3g} MB" if size < 1e9 else f"{size / 1e9:.3g} GB"
