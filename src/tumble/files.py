"""Files that are written whole or not at all."""

from __future__ import annotations

import errno
import os
import re
import secrets
import sys
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import FrameType

from tumble.errors import InputError

FilePath = str | os.PathLike[str]
"""Path of a file or folder in arguments of public functions."""


def _remove(files: Iterable[Path], folders: Iterable[Path] = ()) -> None:
    """Remove files that were not completed, and folders that are empty without them."""
    for file in files:
        with suppress(OSError):  # missing, or never made where nothing can be
            file.unlink()
    with suppress(OSError):  # not empty
        for folder in folders:
            folder.rmdir()


def is_removing(frame: FrameType | None) -> bool:
    """Return whether files are being removed in a frame; a signal that ends the command then waits."""
    while frame is not None and frame.f_code is not _remove.__code__:
        frame = frame.f_back
    return frame is not None


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary file beside `path` that replaces it when the block ends without an error.

    Raises OSError that names `path` for a missing or read-only folder and for a full disk, also where a library raises
    another exception for these."""
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "is no file that could be replaced", str(path))
    if not path.parent.exists():
        raise OSError(errno.ENOENT, f"the folder {path.parent} does not exist", str(path))
    temporary = path.with_name(f".{path.stem[:40]}.{secrets.token_hex(8)}{path.suffix}")
    try:
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        if error.filename is not None and Path(os.fsdecode(error.filename)) != temporary:
            raise
        message = os.strerror(error.errno) if error.errno else str(error)
        raise OSError(error.errno, message, str(path)) from None
    except Exception as error:
        number = _NUMBER.search(str(error))
        if number is None:
            raise
        raise OSError(int(number[1]), os.strerror(int(number[1])), str(path)) from None
    finally:
        _remove([temporary])


_NUMBER = re.compile(r"\(os error (\d+)\)")  # in messages of libraries written in Rust


def ending_in(path: Path, *endings: str) -> str:
    """Return the ending of a file name in lower case. Raises InputError if it is not one of `endings`."""
    ending, (*others, last) = path.suffix.lower(), endings
    if ending not in endings:
        found, expected = path.suffix or "no ending", f"{', '.join(others)} or {last}" if others else last
        raise InputError(f"{path}: expected a file that ends in {expected}, found {found!r}")
    return ending


def plain_name(word: str) -> str:
    """Return a word without the characters that a file name cannot have."""
    return re.sub(r"\W+", "-", word).strip("-")[:40] or "unnamed"


def lock(descriptor: int, *, shared: bool = False) -> bool:
    """Lock an open file or folder against other processes until it is closed; return False if another has locked it.

    Where the file system has no locks, return True."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(descriptor, _LOCKED_BYTE, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except OSError as error:
        return sys.platform != "win32" and not isinstance(error, BlockingIOError)
    return True


_LOCKED_BYTE = 1 << 40  # beyond the end of any file, for systems that lock bytes


@contextmanager
def in_use(folder: Path, *, shared: bool = False) -> Iterator[None]:
    """Lock a folder during the block, for this process or `shared` with other readers.

    Raises InputError if another process has locked it. Windows has no locks of folders."""
    with ExitStack() as opened:
        with suppress(OSError):
            descriptor = os.open(folder, os.O_RDONLY)
            opened.callback(os.close, descriptor)
            if not lock(descriptor, shared=shared):
                raise InputError(f"{folder}: expected a folder that no other process uses, found one in use")
        yield


class OutputFolder:
    """A folder for new files, of which none replaces another."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.written: list[Path] = []

    def new_file(self, name: str) -> Path:
        """Return the path of a new file of this name, with a number after its stem if the name is taken."""
        self.path.mkdir(parents=True, exist_ok=True)  # FileExistsError for a file
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
    """Yield a folder for new files, which is made if it does not exist; if the block fails they are removed, and the
    folder if it was made and is empty. Raises InputError if another process uses the folder."""
    absent = [place for place in (folder, *folder.parents) if not place.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    with in_use(folder):
        output = OutputFolder(folder)
        try:
            yield output
        except BaseException:
            _remove(output.written, absent)
            raise
