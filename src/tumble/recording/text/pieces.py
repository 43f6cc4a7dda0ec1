"""Text files, decompressed and converted to UTF-8, in pieces of whole lines.

Readings compress to a third or a tenth. A file that unpacks to a hundred times its size is no log and could fill memory
or a disk: it is refused, before unpacking if it states its size.
"""

from __future__ import annotations

import gzip
import io
import sys
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from tumble.errors import LogError, needs_extra
from tumble.recording.text.dialect import LINE_BYTES

LARGEST_RATIO = 100
SMALL_BYTES = 1 << 24
"""Size to which any archive may unpack; rows of a few characters take twenty times as much memory."""

_FIRST_PIECE_BYTES = 1 << 18
_PIECE_BYTES = 1 << 24
_HEADER_BYTES = 18  # longest header of a frame of Zstandard
_DEFLATE_RATIO = 1032  # largest ratio of gzip; an archive that states a larger one was cut


def opened(path: Path, encoding: str = "utf-8") -> io.BufferedIOBase:
    """Open a file for reading as UTF-8, decompressed according to its ending.

    Raises LogError for an archive that unpacks to too large a size, here or while it is read, and MissingExtraError
    for Zstandard before Python 3.14 without the extra `formats`."""
    ending = path.suffix.lower()
    stream: io.BufferedIOBase
    if ending == ".gz":  # the last member states its size, to 4 GB, unless it is cut
        with path.open("rb") as file:
            size = file.seek(0, io.SEEK_END)
            file.seek(max(size - 4, 0))
            last = int.from_bytes(file.read(4), "little")
        check_unpacked(path, last if last <= _DEFLATE_RATIO * size else 0)
        stream = io.BufferedReader(_Limited(gzip.GzipFile(path), zlib.error, path))
    elif ending == ".zst":  # the first frame states its size
        if sys.version_info >= (3, 14):
            from compression import zstd
        else:
            with needs_extra(f"{path}: a file compressed by Zstandard", "formats", "backports"):
                from backports import zstd
        with path.open("rb") as file, suppress(zstd.ZstdError):
            check_unpacked(path, zstd.get_frame_info(file.read(_HEADER_BYTES)).decompressed_size or 0)
        stream = io.BufferedReader(_Limited(zstd.ZstdFile(path), zstd.ZstdError, path))
    else:
        stream = path.open("rb")
    return stream if encoding == "utf-8" else _Recoded(stream, encoding, path)


class _Recoded(io.BufferedIOBase):
    """A stream in another encoding, converted to UTF-8."""

    def __init__(self, stream: io.BufferedIOBase, encoding: str, path: Path) -> None:
        self._path = path
        self._text = io.TextIOWrapper(stream, encoding=encoding, errors="replace", newline="\n")  # type: ignore[type-var]  # readable

    def read(self, size: int | None = -1, /) -> bytes:
        return self._encoded(self._text.read, -1 if size is None else size)

    def readline(self, size: int | None = -1, /) -> bytes:
        return self._encoded(self._text.readline, -1 if size is None else size)

    def _encoded(self, read: Callable[[int], str], size: int) -> bytes:
        try:
            return read(size).encode("utf-8", errors="replace")
        except UnicodeError as error:
            expected = f"expected text in {self._text.encoding}, as [log] encoding says"
            raise LogError(f"{self._path}: {expected}, found other bytes ({error})") from None

    def close(self) -> None:
        self._text.close()
        super().close()


def whole_lines(stream: io.BufferedIOBase, path: Path) -> Iterator[bytes]:
    """Yield the rest of a stream in pieces of whole lines, the first one small, without blank lines at its end."""
    rest, size = b"", _FIRST_PIECE_BYTES
    while new := stream.read(size):
        piece, size = rest + new, _PIECE_BYTES
        # the last line may be incomplete, or the last one before blank lines
        first = max(0, len(piece) - LINE_BYTES)
        end = piece.rfind(b"\n", 0, first + len(piece[first:].rstrip())) + 1
        line = 0
        while line < end and (line := piece.rfind(b"\n", line, line + LINE_BYTES) + 1):
            pass
        rest = piece[end:]
        if line < end or len(rest) > LINE_BYTES:
            raise LogError(f"{path}: expected lines of numbers, found one of more than {LINE_BYTES} bytes")
        if end:
            yield piece[:end]
    if rest.strip():
        empty, line_end, _ = rest[len(rest.rstrip()) :].partition(b"\n")  # tabs are empty values
        yield rest.rstrip() + empty.rstrip(b"\r") + line_end


# -------------------- archives --------------------


def largest_unpacked(path: Path) -> int:
    """Return the largest size to which a packed file may unpack, bytes."""
    return max(LARGEST_RATIO * path.stat().st_size, SMALL_BYTES)


def check_unpacked(path: Path, size: int) -> None:
    """Raise LogError if a packed file unpacks to a larger `size`, bytes, than readings do."""
    limit = largest_unpacked(path)
    if size > limit:
        raise LogError(
            f"{path}: expected readings, of which a packed file of {_megabytes(path.stat().st_size)} holds at most "
            f"{_megabytes(limit)}, found {_megabytes(size)}; if they are readings, unpack them"
        )


class _Limited(io.RawIOBase):
    """The decompressed stream of a file, of limited size, whose error `damaged` becomes an OSError."""

    def __init__(self, stream: Any, damaged: type[Exception], path: Path) -> None:
        self._stream, self._damaged, self._path, self._count = stream, damaged, path, 0

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any, /) -> int:
        try:
            count = int(self._stream.readinto(buffer))
        except self._damaged as error:
            raise OSError(str(error)) from error
        self._count += count
        check_unpacked(self._path, self._count)
        return count

    def close(self) -> None:
        self._stream.close()
        super().close()


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.3g} MB" if size < 1e9 else f"{size / 1e9:.3g} GB"
