"""Text files as UTF-8 whatever their encoding, decompressed, in pieces of whole lines."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path

from tumble.errors import LogError
from tumble.recording.dialect import LINE_BYTES, Recoded
from tumble.recording.unpacked import unpacked

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
    rest = b""
    size = _FIRST_PIECE_BYTES
    while read := stream.read(size):
        text = rest + read
        end = text.rstrip().rfind(b"\n") + 1  # the line after it may go on, or be the last before blank ones
        if end:
            yield text[:end]
        rest = text[end:]
        if len(rest) > LINE_BYTES:
            raise LogError(f"{path}: expected lines of numbers, found one of more than {LINE_BYTES} bytes")
        size = _PIECE_BYTES
    if rest.strip():
        empty, line_end, _ = rest[len(rest.rstrip()) :].partition(b"\n")  # tabs are empty values
        yield rest.rstrip() + empty.rstrip(b"\r") + line_end
