"""What is no log is refused by its name; files of one position each are identified together."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tumble.drafting.new_session import new_session
from tumble.errors import InputError
from tumble.units import G_STANDARD, Array


@pytest.fixture(scope="module")
def rows() -> Array:
    """Times, accelerometers and gyros in eight attitudes of 2.5 s each, with turns between."""
    rng = np.random.default_rng(11)
    sides = np.repeat(np.vstack([np.eye(3), -np.eye(3), [[0.6, 0.8, 0.0], [0.0, 0.6, 0.8]]]), 125, axis=0)
    smooth = np.column_stack([np.convolve(side, np.ones(12) / 12.0, mode="same") for side in sides.T])
    noise = 0.01 * rng.normal(size=(1000, 6))
    gyro = noise[:, 3:] + (np.linalg.norm(smooth - sides, axis=1) > 1e-9)[:, None]
    return np.round(np.column_stack([0.02 * np.arange(1000), G_STANDARD * smooth + noise[:, :3], gyro]), 6)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("rover.ubx", b"\xb5b\x10\x03" + 300 * b"\0", "UBX of a u-blox receiver; write its ESF-RAW messages"),
        ("flight.bbl", b"H Product:Blackbox flight data\nH version:2\n" + 99 * b"\1", "blackbox_decode"),
        ("tests.tar", b"a.txt" + 252 * b"\0" + b"ustar" + 99 * b"\0", r"an archive of several files \(tar\); unpack"),
        ("GX010017.MP4", b"\0\0\0\x14ftypmp41" + 99 * b"\0", "a video; .*GoPro"),
        ("imu.imr", b"$IMURAW\0" + 99 * b"\0", "IMR of Waypoint"),
        ("MT.mtb", b"\xfa\xff\x36" + 99 * b"\0", "MTB of Xsens"),
        ("a.json", b'{"ax": [0.1, 0.2], "ay": [0.1, 0.2]}', "a document of JSON; write the readings as CSV"),
        ("a.xlsx", b"PK\x03\x04" + 90 * b"x", "an archive or a workbook; unpack it, or save its sheets as CSV"),
        ("log.csv", b"version https://git-lfs.github.com/spec/v1\noid sha256:00", "a pointer of Git LFS to it; fetch"),
        ("log.parquet", b"version https://git-lfs.github.com/spec/v1\noid sha256:00", "a pointer of Git LFS to it"),
        (
            "log.csv",
            gzip.compress(b"t,ax,ay,az\n" + 99 * b"0,1,2,3\n", mtime=0),
            "compressed by gzip under another name",
        ),
        ("log.txt", b"SQLite format 3\0" + 99 * b"\0", "a database; export its readings as CSV"),
        ("imu.csv", b"\x7fELF\2\1\1" + 99 * b"\0", "a program"),
        ("imu.csv", b"\x89PNG\r\n\x1a\n" + 99 * b"\1", "an image"),
        ("imu.csv", b"<!DOCTYPE html>\n<html><body>1,2,3</body></html>\n", "a page of the web, as of a download that"),
        ("imu.csv", b"/annex/objects/MD5E-s10--00.csv\n", "a pointer of git-annex"),
        ("imu.csv", b"ULog\x01\x12\x35\x01" + 99 * b"\2", "a flight log of PX4 under another name; name it so that"),
        ("imu.dat", bytes(range(256)) * 9, "bytes that are no text, of a format unknown here"),
        ("imu.bin", b"\xb5b\x10\x03" + 99 * b"\0", "UBX of a u-blox receiver"),
    ],
)
def test_what_is_no_log_is_refused_by_its_name(name: str, content: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=said):
        new_session(tmp_path / "session", tmp_path / name)


def test_what_is_no_log_is_left_out_where_others_are(rows: Array, tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    pl.DataFrame(rows, schema=["t", "ax", "ay", "az", "gx", "gy", "gz"]).write_csv(tmp_path / "logs" / "imu.csv")
    (tmp_path / "logs" / "photo.jpeg").write_bytes(b"\xff\xd8\xff\xe0" + bytes(range(256)))
    (tmp_path / "logs" / "notes.txt").write_text("Turned by hand.", encoding="utf-8")
    draft, _ = new_session(tmp_path / "session", tmp_path / "logs")
    assert [file.name for file in draft.files] == ["imu.csv"]
    assert any("photo.jpeg" in said and "left out" in said for said in draft.remarks)


@pytest.mark.parametrize("columns", [[0, 1, 2, 3, 4, 5, 6], [1, 2, 3]])
def test_files_of_one_position_each_without_names_are_told_together(
    columns: list[int], rows: Array, tmp_path: Path
) -> None:
    (tmp_path / "positions").mkdir()
    for k in range(8):
        part = pl.DataFrame(rows[125 * k + 10 : 125 * k + 115][:, columns])
        part.write_csv(tmp_path / "positions" / f"pos{k}.txt", include_header=False, separator="\t")
    draft, _ = new_session(tmp_path / "session", tmp_path / "positions")
    log = draft.content["log"]
    assert log["accel"] == {"columns": ["2", "3", "4"] if len(columns) > 3 else ["1", "2", "3"], "unit": "m/s^2"}
    assert len(log["file"]) == 8
    assert log.get("time") == ("1" if len(columns) > 3 else None)
