"""Files that hold no readings tumble can use, or hold them in a form that other programs read: which they are, and what
to do."""

from __future__ import annotations

import struct
from pathlib import Path

from tumble.errors import InputError

_BINARY = (
    (0, b"\xb5b", "UBX of a u-blox receiver", "write its ESF-RAW messages as a table with a row a sample (pyubx2)"),
    (0, b"$IMURAW", "IMR of Waypoint", "write it as text in Inertial Explorer"),
    (0, b"H Product:Blackbox", "a black box of Betaflight", "decode it with blackbox_decode, and give the .csv"),
    (0, b"\xfa\xff", "MTB of Xsens", "export it as text in MT Manager, with Acc and Gyr"),
    (4, b"ftyp", "a video", "write its sensors as CSV, of a GoPro with a reader of GPMF"),
    (0, b"TDSm", "TDMS of LabVIEW", "export it as CSV"),
    (0, b"SQLite format 3", "a database", "export its readings as CSV"),
    (0, b"%PDF", "a document", "give the file with the readings"),
    (257, b"ustar", "an archive of several files (tar)", "unpack it, and give its files"),
)
_RECORD = struct.Struct("<17d")
_WEEK, _HALF_TURN = 604_800.0, 3.1416
_OXTS = 30


def check_is_log(file: Path, seen: bytes) -> None:
    """Raises InputError that names the format of a file, by its first bytes `seen`, and what to do."""
    for start, mark, name, advice in _BINARY:
        if seen[start : start + len(mark)] == mark:
            raise InputError(f"{file}: expected a log, found {name}; {advice}")
    if _is_sbet(file, seen):
        raise InputError(
            f"{file}: expected readings of accelerometers and gyros, found a trajectory (SBET), which a filter has "
            "made of them; write the raw readings of the same mission as text"
        )
    if _is_oxts(seen):
        raise InputError(
            f"{file}: expected a log, found one sample of a vehicle that moves (oxts of KITTI, a file for each); a "
            "drive has no rests in other attitudes to calibrate from: record some, in one table"
        )


def _is_sbet(file: Path, seen: bytes) -> bool:
    """Whether a file is records of 17 numbers: a time of the week that grows, a latitude, a longitude and more."""
    if file.stat().st_size % _RECORD.size or len(seen) < 3 * _RECORD.size:
        return False
    first, second = (_RECORD.unpack_from(seen, k * _RECORD.size) for k in (0, 1))
    angles = first[1], first[2], first[7], first[8]
    return (
        0.0 <= first[0] < second[0] < first[0] + 1.0 < 2.0 * _WEEK
        and all(abs(angle) <= 2.0 * _HALF_TURN for angle in angles)
        and all(abs(value) < 1e6 for record in (first, second) for value in record[1:])
        and any(abs(angle) > 1e-6 for angle in angles)
    )


def _is_oxts(seen: bytes) -> bool:
    """Whether a file is one line of 30 numbers that begins with a latitude and a longitude."""
    try:
        values = [float(cell) for cell in seen.split()]
    except ValueError:
        return False
    one = seen.strip().count(b"\n") == 0 and len(values) == _OXTS
    return one and abs(values[0]) <= 90.0 and abs(values[1]) <= 180.0
