"""Archives of several files, as phones export them, as the files in them."""

from __future__ import annotations

import lzma
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from tumble.errors import InputError
from tumble.files import OutputFolder, whole_file
from tumble.recording.text.unpacked import largest_unpacked

_MOST_FILES = 200
_PIECE_BYTES = 1 << 20
_NO_LOGS = (".toml", ".json", ".md", ".pdf", ".png", ".jpg", ".html", ".zip")

DAMAGED = (zipfile.BadZipFile, NotImplementedError, RuntimeError, ValueError, EOFError, zlib.error, lzma.LZMAError)
"""What is raised of an archive that is damaged or locked."""


def unzipped(archive: Path, folder: OutputFolder) -> list[Path]:
    """The files in an archive, in a folder, by their names without folders; but for hidden ones and those that are no
    logs; a file that is no archive as it is.

    Raises InputError for an archive that is damaged or locked, or holds none, or more than readings would."""
    if archive.suffix.lower() != ".zip":
        return [archive]
    limit = largest_unpacked(archive)
    files: list[Path] = []
    try:
        with zipfile.ZipFile(archive) as opened:
            members = [m for m in opened.infolist() if not m.is_dir() and _may_be_log(PurePosixPath(m.filename))]
            if not 0 < len(members) <= _MOST_FILES or sum(m.file_size for m in members) > limit:
                raise InputError(
                    f"{archive}: expected 1 to {_MOST_FILES} files of at most {limit / 1e6:.3g} MB together, found "
                    f"{len(members)}, {sum(m.file_size for m in members) / 1e6:.3g} MB; unpack it and name the logs"
                )
            for member in members:  # of which no more than it states comes out
                files.append(folder.new_file(PurePosixPath(member.filename.replace("\\", "/")).name))
                with opened.open(member) as stream, whole_file(files[-1]) as part, part.open("wb") as out:
                    while piece := stream.read(_PIECE_BYTES):
                        out.write(piece)
    except DAMAGED as error:
        said = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{archive}: expected a sound archive, found: {said[:200]}") from None
    return files


def _may_be_log(name: PurePosixPath) -> bool:
    hidden = any(part.startswith((".", "__MACOSX")) for part in name.parts)
    return not hidden and name.suffix.lower() not in _NO_LOGS
