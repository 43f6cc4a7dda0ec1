"""The session made of a log is found by the content of the log; where other things are stated another is made."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest

from tests.support.shared import session
from tumble.drafting.made_session import session_of_log
from tumble.drafting.new_session import Given
from tumble.errors import InputError
from tumble.planning.setup import Setup
from tumble.recording.log import Log
from tumble.recording.session_file import read_session

GIVEN = Given(latitude=50.0)


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    """A folder with two flights whose names are alike to the last dot but one."""
    table = pl.read_parquet(session(Setup.of(grade="mems", positions=12), seed=4) / "log.parquet")
    table.write_csv(tmp_path / "flight-1.2.csv")
    table.head(table.height // 2).write_csv(tmp_path / "flight-1.3.csv")
    return tmp_path


def made(log: Path, given: Given = GIVEN) -> tuple[Path, str]:
    with session_of_log(log, given, Log.chunks) as (folder, state, _):
        return folder, state


def test_each_log_has_a_session_of_its_own_and_finds_it_again(logs: Path) -> None:
    first, second = made(logs / "flight-1.2.csv")[0], made(logs / "flight-1.3.csv")[0]
    assert [f.name for f in (first, second)] == ["flight-1.2-session", "flight-1.3-session"]
    before = (first / "session.toml").read_bytes()
    (logs / "flight-1.2.csv").rename(logs / "renamed.csv")
    (logs / "flight-1.2.csv").write_bytes((logs / "renamed.csv").read_bytes())
    folder, said = made(logs / "renamed.csv", replace(GIVEN, serial="flight-1.2"))
    assert folder == first
    assert said == f"{first / 'session.toml'}: the session made earlier from this log"
    assert (first / "session.toml").read_bytes() == before


def test_a_magnetometer_that_waits_in_the_session_is_said(logs: Path) -> None:
    field = {f"m{axis}": 30.0 - pl.col(f"a{axis}") for axis in "xyz"}
    pl.read_csv(logs / "flight-1.2.csv").with_columns(**field).write_csv(logs / "mag.csv")
    folder, said = made(logs / "mag.csv")
    assert said == (
        f"kept in {folder / 'session.toml'}, where the magnetometer is commented out: remove the # to calibrate it too"
    )


def test_a_copy_of_a_log_has_the_session_and_the_serial_number_of_the_first(logs: Path) -> None:
    """Where another number is stated, it has a session of its own."""
    first, _ = made(logs / "flight-1.2.csv")
    copy = logs / "copy.csv"
    copy.write_bytes((logs / "flight-1.2.csv").read_bytes())
    assert made(copy) == (
        first,
        f"{first / 'session.toml'}: the session made earlier from this log (serial number 'flight-1.2')",
    )
    assert read_session(first).device.serial == "flight-1.2"
    folder, said = made(copy, replace(GIVEN, serial="B"))
    assert folder == logs / "copy-session"
    assert f"(--serial); {first} is kept too; kept in " in said
    assert [read_session(each).device.serial for each in (first, folder)] == ["flight-1.2", "B"]


def test_another_log_of_the_same_name_has_another_session(logs: Path) -> None:
    first = made(logs / "flight-1.2.csv")[0]
    (logs / "flight-1.3.csv").replace(logs / "flight-1.2.csv")
    second = made(logs / "flight-1.2.csv")[0]
    assert second != first
    assert (read_session(first).device.serial, read_session(second).device.serial) == ("flight-1.2", "flight-1.2")
    assert len(list(logs.glob("*-session"))) == 2


def test_no_statement_leaves_what_was_stated_and_the_result(logs: Path) -> None:
    folder, _ = made(logs / "flight-1.2.csv", replace(GIVEN, accel=("ax", "ay", "az")))
    (folder / "calibration.json").write_text("{}", encoding="utf-8")
    assert made(logs / "flight-1.2.csv", Given())[1].endswith(": the session made earlier from this log")
    assert "latitude_deg = 50.0" in (folder / "session.toml").read_text(encoding="utf-8")
    assert (folder / "calibration.json").exists()


def test_a_log_in_a_folder_that_is_read_only_is_refused_with_the_way_out(
    logs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write anywhere
    with pytest.raises(InputError, match=r"read-only; copy the log, or make a session elsewhere: tumble new SESSION "):
        made(logs / "flight-1.2.csv")


def test_a_pattern_makes_no_folder_that_is_hidden_or_like_an_option(logs: Path) -> None:
    assert made(logs / "*.2.csv")[0].name == "2-session"
    assert made(logs / "*-1.3.csv")[0].name == "1.3-session"
    (logs / "flight-1.3.csv").unlink()
    assert made(logs / "*.csv", Given(latitude=40.0))[0].name == "log-session"


def test_other_statements_make_another_session_and_the_former_stays(logs: Path) -> None:
    folder, _ = made(logs / "flight-1.2.csv")
    (folder / "calibration.json").write_text("{}", encoding="utf-8")
    before = {f.name: f.read_bytes() for f in folder.iterdir()}
    another, said = made(logs / "flight-1.2.csv", Given(latitude=40.0))
    assert another == logs / "flight-1.2-2-session"
    assert said.startswith(
        f"new session, as options or the version of tumble differ (--latitude); {folder} is kept too; kept in "
    )
    assert "latitude_deg = 40.0" in (another / "session.toml").read_text(encoding="utf-8")
    assert {f.name for f in another.iterdir()} == {"session.toml", "made.json"}
    assert {f.name: f.read_bytes() for f in folder.iterdir()} == before
    assert made(logs / "flight-1.2.csv")[0] == folder
    assert made(logs / "flight-1.2.csv", Given())[0] == another


def test_a_latitude_that_is_none_is_said_before_the_session() -> None:
    with pytest.raises(InputError, match="latitude: expected a number from -90 to 90, found 481"):
        Given(latitude=481.0)


def test_a_session_that_fails_to_be_made_leaves_nothing(logs: Path) -> None:
    folder, _ = made(logs / "flight-1.2.csv")
    before = {f.name: f.read_bytes() for f in folder.iterdir()}
    with pytest.raises(InputError, match="accel: expected names of columns"):
        made(logs / "flight-1.2.csv", replace(GIVEN, accel=("1", "2", "99")))
    assert {f.name: f.read_bytes() for f in folder.iterdir()} == before
    assert [f for f in logs.iterdir() if f.is_dir()] == [folder]


def test_what_was_corrected_by_hand_is_used_and_never_replaced(logs: Path) -> None:
    folder, _ = made(logs / "flight-1.2.csv")
    text = (folder / "session.toml").read_text(encoding="utf-8").replace("latitude_deg = 50.0", "latitude_deg = 51.0")
    (folder / "session.toml").write_text(text, encoding="utf-8")
    assert made(logs / "flight-1.2.csv")[1].endswith("from this log, corrected by hand")
    assert made(logs / "flight-1.2.csv", Given(latitude=40.0))[0] != folder
    assert (folder / "session.toml").read_text(encoding="utf-8") == text
