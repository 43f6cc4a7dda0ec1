"""Files of a log: a file, a folder, a pattern or an archive; and files that hold no readings, refused by name."""

from __future__ import annotations

import lzma
import re
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
_SEEN_BYTES = 4096
_NO_TEXT = re.compile(rb"[\x01-\x08\x0e-\x1a\x1c-\x1f\x7f]")
_NO_TEXT_SHARE = 0.02
NAMED = (".parquet", ".gz", ".zst")
"""Endings of files that are no text, beside those of recordings."""
_AS_CSV = "export its readings as CSV"
_WEB = "a page of the web, as of a download that failed"
_OTHER_FORMATS = (
    (0, b"\xb5b", "UBX of a u-blox receiver", "write its ESF-RAW messages as a table with a row a sample (pyubx2)"),
    (0, b"$IMURAW", "IMR of Waypoint", "write it as text in Inertial Explorer"),
    (0, b"H Product:Blackbox", "a black box of Betaflight", "decode it with blackbox_decode, and give the .csv"),
    (0, b"\xfa\xff", "MTB of Xsens", "export it as text in MT Manager, with Acc and Gyr"),
    (4, b"ftyp", "a video", "write its sensors as CSV, of a GoPro with a reader of GPMF"),
    (0, b"TDSm", "TDMS of LabVIEW", "export it as CSV"),
    (0, b"%PDF", "a document", "give the file with the readings"),
    (0, b"\xd0\xcf\x11\xe0", "a workbook", "save its sheets as CSV"),
    (0, b"version https://git-lfs", "a pointer of Git LFS to it", "fetch the file itself: git lfs pull"),
    (0, b"/annex/objects/", "a pointer of git-annex to it", "fetch the file itself: git annex get"),
    (257, b"ustar", "an archive of several files (tar)", "unpack it, and give its files"),
    (0, b"7z\xbc\xaf", "an archive (7z)", "unpack it"),
    (0, b"Rar!", "an archive (rar)", "unpack it"),
    (0, b"BZh", "a file compressed by bzip2", "unpack it: bunzip2"),
    (0, b"\xfd7zXZ", "a file compressed by xz", "unpack it: unxz"),
    (0, b"\x7fELF", "a program", "give the file with the readings"),
    (0, b"MZ\x90", "a program", "give the file with the readings"),
    (0, b"\x89PNG", "an image", "give the file with the readings"),
    (0, b"\xff\xd8\xff", "an image", "give the file with the readings"),
    (0, b"GIF8", "an image", "give the file with the readings"),
    (0, b"RIFF", "sound or a video", "give the file with the readings"),
    (0, b"OggS", "sound", "give the file with the readings"),
    (0, b"<!doctype html", _WEB, "get the file itself (of GitHub: Raw)"),
    (0, b"<html", _WEB, "get the file itself (of GitHub: Raw)"),
    (0, b"404: Not Found", _WEB, "get the file itself"),
    (0, b"<?xml", "a document of XML", _AS_CSV),
    (0, b"\x80\x04\x95", "a pickle of Python", "write it with numpy.savetxt or to_csv"),
    (0, b"ARROW1", "Feather of Apache Arrow", "write it as Parquet"),
    (0, b"MD\xfc\x03", "CWA of Axivity", "convert it with cwa-convert, or OmGui, to CSV in g and deg/s"),
)
"""Where in a file which bytes are, what they are of, and what to do."""
_MISNAMED = (
    (0, b"SQLite format 3", "a database", f"{_AS_CSV}; a bag of ROS 2 ends in .db3"),
    (0, b"PK\x03\x04", "an archive or a workbook", "unpack it, or save its sheets as CSV; an archive ends in .zip"),
    *(
        (0, mark, f"{name} under another name", f"name it so that it ends in {ending}")
        for mark, name, ending in (
            (b"\x1f\x8b", "a file compressed by gzip", ".gz"),
            (b"\x28\xb5\x2f\xfd", "a file compressed by Zstandard", ".zst"),
            (b"PAR1", "Parquet", ".parquet"),
            (b"\x89HDF", "HDF5", ".h5"),
            (b"\x93NUMPY", "an array of NumPy", ".npy"),
            (b"MATLAB 5.0 MAT-file", "a MAT-file", ".mat"),
            (b"ULog\x01\x12\x35", "a flight log of PX4", ".ulg"),
            (b"\xa3\x95", "a flight log of ArduPilot", ".bin"),
            (b"#ROSBAG", "a bag of ROS 1", ".bag"),
            (b"\x89MCAP", "MCAP", ".mcap"),
        )
    ),
)
"""The same of what can be read where its name says what it is."""


def files_of(log: Path) -> list[Path]:
    """Files of a path: itself, those of a folder, or those that match a pattern.

    They are in the order of the numbers in their names: pos2 before pos10. Raises InputError if there are none."""
    pattern = not log.exists() and bool(set(log.name) & set("*?["))
    if log.is_dir() and not (log / "metadata.yaml").is_file():
        files = [file for file in log.iterdir() if file.is_file() and not file.name.startswith(".")]
        files = [file for file in files if file.suffix.lower() not in _NO_LOGS]
        missing = "a folder with logs, found none in it"
    elif pattern:
        files, missing = list(log.parent.glob(log.name)), "files that fit this pattern, found none"
    else:
        check_regular(log)
        files, missing = [log] if log.exists() else [], "a log, found no such file"
    if not files:
        raise InputError(f"{log}: expected {missing}")

    def natural(path: Path) -> list[tuple[int, str]]:
        parts = re.split(r"([0-9]+)", path.name)
        return [(int(part) if re.fullmatch("[0-9]{1,18}", part) else -1, part) for part in parts]

    return sorted(files, key=natural)


def unzipped(archive: Path, folder: OutputFolder) -> list[Path]:
    """Files of an archive, written into a folder; a file that is no archive as it is.

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
            for member in members:  # of which no more than it states comes out
                files.append(folder.new_file(PurePosixPath(member.filename.replace("\\", "/")).name))
                with opened.open(member) as stream, whole_file(files[-1]) as part, part.open("wb") as out:
                    while piece := stream.read(_PIECE_BYTES):
                        out.write(piece)
    except _DAMAGED as error:
        found = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{archive}: expected a sound archive, found: {found[:200]}") from None
    return files


class NoLogError(InputError):
    """A file that is no log, which is left out beside others."""


def check_format(file: Path, *, recording: bool) -> None:
    """Raise NoLogError that names the format of a file that cannot be read, by its first bytes, and what to do;
    `recording`: its ending is that of one, or in NAMED."""
    with readable(file), file.open("rb") as stream:
        start = stream.read(_SEEN_BYTES)
    for at, mark, name, advice in _OTHER_FORMATS if recording else (*_OTHER_FORMATS, *_MISNAMED):
        if start[at : at + len(mark)].lower() == mark.lower():
            raise NoLogError(f"{file}: expected a log, found {name}; {advice}")
    wide = encoding_of(start).startswith("utf-16")
    if not recording and not wide and len(_NO_TEXT.findall(start)) > _NO_TEXT_SHARE * len(start):
        raise NoLogError(f"{file}: expected a log, found bytes that are no text, of a format unknown here; {_AS_CSV}")


def check_is_text(file: Path, start: bytes) -> None:
    """Raise InputError for a text that is one document of JSON."""
    if start.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] in (b"{", b"[") and start.count(b"\n") < 3:
        raise InputError(f"{file}: expected rows of readings, found a document of JSON; write the readings as CSV")
