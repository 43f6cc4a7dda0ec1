"""Text files as UTF-8 whatever their encoding, decompressed, in pieces of whole lines."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from mmap import mmap
from pathlib import Path

from tumble.errors import LogError
from tumble.recording.text.dialect import LINE_BYTES, Recoded
from tumble.recording.text.unpacked import unpacked

_FIRST_PIECE_BYTES = 1 << 18
_PIECE_BYTES = 1 << 24


def opened(path: Path, encoding: str = "utf-8") -> io.BufferedIOBase:
    """A file to read from as UTF-8, decompressed by its ending."""
    packed = path.suffix.lower() in (".gz", ".zst")
    stream = unpacked(path) if packed else path.open("rb")
    return stream if encoding == "utf-8" else Recoded(stream, encoding)


def header(stream: io.BufferedIOBase, path: Path) -> tuple[str, ...]:
    """The column names in the first line of a CSV file."""
    line = stream.readline(LINE_BYTES).decode("utf-8-sig", errors="replace")
    try:
        return tuple(name.strip() for name in next(csv.reader([line.rstrip("\r\n")]), []))
    except csv.Error as error:
        raise LogError(f"{path}: expected the names of the columns in the first line, found: {error}") from None


def whole_lines(stream: io.BufferedIOBase, path: Path) -> Iterator[bytes]:
    """The rest of a stream in pieces of whole lines, the first one small; blank lines at its end are left out."""
    buffer = mmap(-1, max(_FIRST_PIECE_BYTES, _PIECE_BYTES) + LINE_BYTES)  # takes memory only where it is filled
    held, size = 0, _FIRST_PIECE_BYTES
    while read := _read_into(buffer, slice(held, held + size), stream):
        stop = held + read
        # the line after it may go on, or be the last before blank ones
        end = buffer.rfind(b"\n", 0, _without_blanks(buffer, stop)) + 1
        if end:
            yield buffer[:end]
        rest = buffer[end:stop]
        if len(rest) > LINE_BYTES:
            raise LogError(f"{path}: expected lines of numbers, found one of more than {LINE_BYTES} bytes")
        held, size = len(rest), _PIECE_BYTES
        buffer[:held] = rest
    rest = buffer[:held]
    if rest.strip():
        empty, line_end, _ = rest[len(rest.rstrip()) :].partition(b"\n")  # tabs are empty values
        yield rest.rstrip() + empty.rstrip(b"\r") + line_end


def _read_into(buffer: mmap, part: slice, stream: io.BufferedIOBase) -> int:
    """Fill a part of a buffer from a stream; with how many bytes."""
    with memoryview(buffer) as whole, whole[part] as free:
        return stream.readinto(free)


def _without_blanks(buffer: mmap, stop: int) -> int:
    """Where the blanks begin that end the first `stop` bytes; of more of them than a line may have, one of these."""
    first = max(0, stop - LINE_BYTES)
    return first + len(buffer[first:stop].rstrip())
