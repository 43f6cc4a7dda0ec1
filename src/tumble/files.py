"""Paths as callers give them, and files that are written whole or not at all."""

from __future__ import annotations

import errno
import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tumble.errors import InputError

FilePath = str | os.PathLike[str]
"""What every public function takes as the path of a file or folder."""


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A temporary file beside `path`, of the same ending, which becomes `path` when the block ends without an error: a
    reader sees the old file or the new one.

    Raises OSError that names `path` for a folder that is not there or cannot be written to, and for a disk that is
    full, also where a library says so in words of its own."""
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "is no file that could be replaced", str(path))
    if not path.parent.exists():
        raise OSError(errno.ENOENT, f"the folder {path.parent} does not exist", str(path))
    temporary = path.with_name(f".{path.stem[:40]}.{secrets.token_hex(8)}{path.suffix}")
    try:
        with _errors_of(path, temporary):
            os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
            yield temporary
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())
            temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def _errors_of(path: Path, temporary: Path) -> Iterator[None]:
    """Errors of writing as OSError that names the file that was asked for. Those of other files stay."""
    try:
        yield
    except OSError as error:
        if error.filename is not None and Path(os.fsdecode(error.filename)) != temporary:
            raise
        raise OSError(error.errno, _said(error), str(path)) from None
    except Exception as error:
        number = _NUMBER.search(str(error))
        if number is None:
            raise
        raise OSError(int(number[1]), os.strerror(int(number[1])), str(path)) from None


_NUMBER = re.compile(r"\(os error (\d+)\)")
"""What libraries written in Rust say of an error of the system."""


def _said(error: OSError) -> str:
    return os.strerror(error.errno) if error.errno else str(error)


def ending_in(path: Path, *endings: str) -> str:
    """The ending of a file that is to be written, in small letters. Raises InputError for another than these."""
    ending, (*others, last) = path.suffix.lower(), endings
    if ending not in endings:
        found, expected = path.suffix or "no ending", f"{', '.join(others)} or {last}" if others else last
        raise InputError(f"{path}: expected a file that ends in {expected}, found {found!r}")
    return ending


def plain_name(word: str) -> str:
    """A word as a part of the name of a file."""
    return re.sub(r"\W+", "-", word).strip("-")[:40] or "unnamed"


class OutputFolder:
    """A folder that new files are written into, each by `whole_file`. It is made with the first of them, and none
    replaces another."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.written: list[Path] = []
        self._there = path.exists()

    def new_file(self, name: str) -> Path:
        """The path of a file that is to be written: of this name, with a number behind its stem where there was one
        already.

        Raises FileExistsError for a folder that another process has made meanwhile."""
        self.path.mkdir(parents=True, exist_ok=self._there)
        self._there = True
        taken = {path.name.casefold() for path in self.written}
        wanted = path = self.path / name
        number = 1
        while os.path.lexists(path) or path.name.casefold() in taken:
            number += 1
            path = wanted.with_stem(f"{wanted.stem}-{number}")
        self.written.append(path)
        return path


@contextmanager
def nothing_left(folder: Path) -> Iterator[OutputFolder]:
    """Where the block fails, none of its new files is left in the folder, nor the folder if it was made for them and
    nobody else has written into it."""
    absent = [place for place in (folder, *folder.parents) if not place.exists()]
    output = OutputFolder(folder)
    try:
        yield output
    except BaseException:
        for file in output.written:
            file.unlink(missing_ok=True)
        with suppress(OSError):  # not empty
            for place in absent:
                place.rmdir()
        raise
