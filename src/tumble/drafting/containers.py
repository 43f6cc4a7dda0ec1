"""Files of a log that is given as a file, a folder, a pattern or an archive; unreadable formats are refused."""

from __future__ import annotations

import lzma
import re
import tomllib
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from tumble.documents import check_regular
from tumble.errors import InputError
from tumble.files import OutputFolder, whole_file
from tumble.recording.log_source import readable
from tumble.recording.text.dialect import encoding_of
from tumble.recording.text.pieces import largest_unpacked

_MOST_FILES = 200
_PIECE_BYTES = 1 << 20
_HIDDEN = re.compile(r"(^|/)(\.(?!/)|__MACOSX)")
_NO_LOGS = (".toml", ".json", ".md", ".pdf", ".png", ".jpg", ".html", ".zip")
_DAMAGED = (zipfile.BadZipFile, NotImplementedError, RuntimeError, ValueError, EOFError, zlib.error, lzma.LZMAError)
_START_BYTES = 4096
_BINARY = re.compile(rb"[\x01-\x08\x0e-\x1a\x1c-\x1f\x7f]")
_BINARY_SHARE = 0.02  # of the bytes of a text, at most
BINARY_ENDINGS = (".parquet", ".gz", ".zst")
"""Endings of binary files other than recordings."""
_FORMATS = tomllib.loads((Path(__file__).parent / "formats.toml").read_text(encoding="utf-8"))


def files_of(log: Path) -> list[Path]:
    """Return the file at a path, the files of a folder, or those that match a pattern.

    They are in the order of the numbers in their names: pos2 before pos10. Raises InputError if there are none."""
    pattern = not log.exists() and bool(set(log.name) & set("*?["))
    if log.is_dir() and not (log / "metadata.yaml").is_file():
        files = [file for file in log.iterdir() if file.is_file() and not file.name.startswith(".")]
        files = [file for file in files if file.suffix.lower() not in _NO_LOGS]
        fault = "expected a folder with logs, found none in it"
    elif pattern:
        files, fault = list(log.parent.glob(log.name)), "expected files that fit this pattern, found none"
    else:
        check_regular(log)
        files, fault = [log] if log.exists() else [], "expected a log, found no such file"
    if not files:
        raise InputError(f"{log}: {fault}")

    def natural_order(path: Path) -> list[tuple[int, str]]:
        parts = re.split(r"([0-9]+)", path.name)
        return [(int(part) if re.fullmatch("[0-9]{1,18}", part) else -1, part) for part in parts]

    return sorted(files, key=natural_order)


def unzipped(archive: Path, folder: OutputFolder) -> list[Path]:
    """Write the files of an archive into a folder; return any other file unchanged.

    Hidden files and those that are no logs are left out. Raises InputError for an archive that is damaged or locked,
    empty, or larger than readings are."""
    if archive.suffix.lower() != ".zip":
        return [archive]
    limit = largest_unpacked(archive)
    files: list[Path] = []
    try:
        with zipfile.ZipFile(archive) as opened:
            members = [m for m in opened.infolist() if not m.is_dir() and _HIDDEN.search(m.filename) is None]
            members = [m for m in members if PurePosixPath(m.filename).suffix.lower() not in _NO_LOGS]
            if not 0 < len(members) <= _MOST_FILES or sum(m.file_size for m in members) > limit:
                raise InputError(
                    f"{archive}: expected 1 to {_MOST_FILES} files of at most {limit / 1e6:.3g} MB together, found "
                    f"{len(members)}, {sum(m.file_size for m in members) / 1e6:.3g} MB; unpack it and name the logs"
                )
            for member in members:  # zipfile reads no more than the stated size
                files.append(folder.new_file(PurePosixPath(member.filename.replace("\\", "/")).name))
                with opened.open(member) as stream, whole_file(files[-1]) as part, part.open("wb") as out:
                    while piece := stream.read(_PIECE_BYTES):
                        out.write(piece)
    except _DAMAGED as error:
        found = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{archive}: expected a sound archive, found: {found[:200]}") from None
    return files


class NoLogError(InputError):
    """A file that is no log; it is left out if there are others."""


def check_format(file: Path, *, recording: bool) -> None:
    """Raise NoLogError for an unreadable format, recognised by the first bytes, with the format and what to do.

    `recording`: the file has the ending of a recording, or one in BINARY_ENDINGS."""
    with readable(file), file.open("rb") as stream:
        start = stream.read(_START_BYTES)
    for at, mark, name, advice in _FORMATS["refused"] + ([] if recording else _FORMATS["misnamed"]):
        if start[at : at + len(mark)].lower() == mark.encode("latin-1").lower():
            raise NoLogError(f"{file}: expected a log, found {name}; {advice}")
    wide = encoding_of(start).startswith("utf-16")
    if not recording and not wide and len(_BINARY.findall(start)) > _BINARY_SHARE * len(start):
        raise NoLogError(
            f"{file}: expected a log, found bytes that are no text, of a format unknown here; "
            "export its readings as CSV"
        )
