"""Readings in documents of JSON and workbooks are those that were written; what is no log is refused by its name."""

from __future__ import annotations

import builtins
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from tests.support.corpus import documents as d
from tumble.drafting.containers import sheets_of
from tumble.drafting.detection import found_log
from tumble.drafting.new_session import new_session
from tumble.errors import InputError, MissingExtraError
from tumble.files import OutputFolder
from tumble.recording.columns.names import ACCEL, GYRO
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


def check_read(files: list[Path], rows: Array, folder: Path, *, accel: float = 1.0) -> None:
    """The log in files is `rows`, whose accelerometers it has times a factor."""
    found = found_log(files, OutputFolder(folder))
    assert found.read(found.columns.triads[ACCEL].columns) == pytest.approx(accel * rows[:, 1:4], abs=1e-9)
    assert found.read(found.columns.triads[GYRO].columns) == pytest.approx(rows[:, 4:], abs=1e-9)
    times = found.times(None)
    assert times.rate == pytest.approx(50.0)


@pytest.mark.parametrize("name", d.DOCUMENTS)
def test_a_document_of_json_is_its_readings(name: str, rows: Array, tmp_path: Path) -> None:
    check_read([d.DOCUMENTS[name](rows, tmp_path)], rows, tmp_path / "session")


@pytest.mark.parametrize(("write", "accel"), [(d.phone_workbook, 1.0), (d.table_workbook, 1.0 / G_STANDARD)])
def test_a_workbook_is_its_readings(write: d.Write, accel: float, rows: Array, tmp_path: Path) -> None:
    folder = tmp_path / "session"
    check_read(sheets_of(write(rows, tmp_path), OutputFolder(folder)), rows, folder, accel=accel)


def test_without_its_library_a_workbook_names_the_ways_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *given: Any) -> Any:
        if name == "python_calamine":
            raise ModuleNotFoundError("No module named 'python_calamine'", name=name)
        return real(name, *given)

    (tmp_path / "a.xlsx").write_bytes(b"PK")
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingExtraError, match=r"saved as CSV.*pip install 'tumble\[formats\]'"):
        new_session(tmp_path / "session", tmp_path / "a.xlsx")


def test_a_workbook_that_is_damaged_or_empty_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bad.xlsx").write_bytes(b"PK\x03\x04" + 90 * b"x")
    d.workbook(tmp_path / "empty.xlsx", {"one": []})
    for name in ("bad.xlsx", "empty.xlsx"):
        with pytest.raises(InputError, match="save"):
            new_session(tmp_path / "session", tmp_path / name)
        assert not (tmp_path / "session").exists()


def sbet(records: int) -> bytes:
    row = (0.9, 0.2, 100.0, 1.0, 2.0, 3.0, 0.01, 0.02, 1.5, 0.0, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0)
    return b"".join(struct.pack("<17d", 400_000.0 + 0.005 * k, *row) for k in range(records))


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("rover.ubx", b"\xb5b\x10\x03" + 300 * b"\0", "UBX of a u-blox receiver; write its ESF-RAW messages"),
        ("mission.out", sbet(60), "a trajectory \\(SBET\\), which a filter has made"),
        ("0000000007.txt", " ".join(["49.0", "8.4", *28 * ["0.1"]]).encode(), "one sample of a vehicle .*KITTI"),
        ("flight.bbl", b"H Product:Blackbox flight data\nH version:2\n" + 99 * b"\1", "blackbox_decode"),
        ("tests.tar", b"a.txt" + 252 * b"\0" + b"ustar" + 99 * b"\0", r"an archive of several files \(tar\); unpack"),
        ("GX010017.MP4", b"\0\0\0\x14ftypmp41" + 99 * b"\0", "a video; .*GoPro"),
        ("imu.imr", b"$IMURAW\0" + 99 * b"\0", "IMR of Waypoint"),
        ("MT.mtb", b"\xfa\xff\x36" + 99 * b"\0", "MTB of Xsens"),
        ("a.json", json.dumps({"name": "imu", "axes": ["x", "y"]}).encode(), "a document of JSON with neither"),
    ],
)
def test_what_is_no_log_is_refused_by_its_name(name: str, content: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=said):
        new_session(tmp_path / "session", tmp_path / name)


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
