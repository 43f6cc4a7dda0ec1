"""Archives of several files, as phones export them, and workbooks of a spreadsheet, as phones and laboratories save
them: the files in them, and a CSV file of each sheet."""

from __future__ import annotations

import csv
import datetime
import lzma
import re
import zipfile
import zlib
from functools import reduce
from pathlib import Path, PurePosixPath

from tumble.errors import InputError, needs_extra
from tumble.files import OutputFolder, plain_name, whole_file
from tumble.recording.text.pieces import SMALL_BYTES, largest_unpacked

_MOST_FILES = 200
_PIECE_BYTES = 1 << 20
_HIDDEN = re.compile(r"(^|/)(\.(?!/)|__MACOSX)")
_NO_LOGS = (".toml", ".json", ".md", ".pdf", ".png", ".jpg", ".html", ".zip")

DAMAGED = (zipfile.BadZipFile, NotImplementedError, RuntimeError, ValueError, EOFError, zlib.error, lzma.LZMAError)
"""What is raised of an archive that is damaged or locked."""
_ENDINGS = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods")
_MOST_SHEETS = 50
_WIDEST = 1000
_SHEET = re.compile(r"xl/worksheets/.*\.xml", re.IGNORECASE)
_CELL = re.compile(rb"""\br=["']([A-Z]{1,3})([0-9]{1,7})["']""")
_LONGEST_CELL = 16
"""Bytes of the place of a cell in a sheet, which two pieces may share."""


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
    except DAMAGED as error:
        said = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{archive}: expected a sound archive, found: {said[:200]}") from None
    return files


def sheets_of(workbook: Path, folder: OutputFolder) -> list[Path]:
    """The sheets of a workbook that have rows, a CSV file each; a file that is none as it is.

    Raises InputError for one that is damaged, has none, or is larger than readings would be, and MissingExtraError
    where the extra `formats` is not installed; the message names the way without it."""
    if workbook.suffix.lower() not in _ENDINGS:
        return [workbook]
    with needs_extra(
        f"{workbook}: reading a workbook, unless its sheets are saved as CSV,", "formats", "python_calamine"
    ):
        from python_calamine import CalamineError, CalamineWorkbook
    files: list[Path] = []
    try:
        if zipfile.is_zipfile(workbook):
            _check_size(workbook)
        with CalamineWorkbook.from_path(workbook) as opened:
            every = (opened.get_sheet_by_name(name) for name in opened.sheet_names)
            sheets = [sheet for sheet in every if sheet.height > 1]
            if not 0 < len(sheets) <= _MOST_SHEETS or max(sheet.width for sheet in sheets) > _WIDEST:
                raise InputError(
                    f"{workbook}: expected 1 to {_MOST_SHEETS} sheets with rows of at most {_WIDEST} values, found "
                    f"{len(sheets)} with rows; save the sheets that matter as CSV"
                )
            for sheet in sheets:
                which = f"-{plain_name(sheet.name)}" if len(sheets) > 1 else ""
                files.append(folder.new_file(f"{workbook.name.partition('.')[0]}{which}.csv"))
                with whole_file(files[-1]) as part, part.open("w", encoding="utf-8", newline="") as out:
                    rows = ([_text(cell) for cell in row] for row in sheet.iter_rows())
                    csv.writer(out, lineterminator="\n").writerows(row for row in rows if any(row))
    except (CalamineError, OSError, *DAMAGED) as error:
        said = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{workbook}: expected a sound workbook, found: {said[:200]}; save it as CSV") from None
    return files


def _check_size(workbook: Path) -> None:
    """Raises InputError for a workbook that unpacks to more than readings do, and for a sheet of Office Open XML whose
    cells are far apart: the reader makes room for all between the first and the last."""
    with zipfile.ZipFile(workbook) as archive:
        size, limit = sum(member.file_size for member in archive.infolist()), largest_unpacked(workbook)
        if size > limit:
            raise InputError(f"{workbook}: expected at most {limit / 1e6:.3g} MB unpacked, found {size / 1e6:.3g} MB")
        for sheet in filter(_SHEET.fullmatch, archive.namelist()):
            column, row, rest = "", 0, b""
            with archive.open(sheet) as stream:
                while piece := stream.read(_PIECE_BYTES):
                    text = rest + piece
                    for letters, digits in _CELL.findall(text):
                        column = max(column, letters.decode(), key=lambda name: (len(name), name))
                        row = max(row, int(digits))
                    rest = text[-_LONGEST_CELL:]
            width = reduce(lambda number, letter: 26 * number + ord(letter) - ord("A") + 1, column, 0)
            if width * row > max(archive.getinfo(sheet).file_size, SMALL_BYTES):
                raise InputError(
                    f"{workbook}: expected rows of readings, found a cell in column {column} and one in row {row}, and "
                    "next to nothing between; remove it, or save the sheet as CSV"
                )


def _text(cell: object) -> str:
    """A cell as text that is read again as what it was."""
    if isinstance(cell, float):
        return repr(cell).removesuffix(".0")
    if isinstance(cell, datetime.datetime):
        return cell.isoformat(" ")
    if isinstance(cell, datetime.timedelta):
        return repr(cell.total_seconds())
    return " ".join(str(cell).split())
