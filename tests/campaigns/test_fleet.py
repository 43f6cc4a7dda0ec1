"""Fleets: a row for every session, whatever becomes of it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import cast

import polars as pl
import pytest
from click.testing import CliRunner, Result

from tumble.campaigns import fleet as fleets
from tumble.campaigns.engine import Done, Executor
from tumble.campaigns.fleet import FleetResult, find_sessions
from tumble.cli import main
from tumble.errors import InputError
from tumble.planning.setup import Setup
from tumble.run.calibrate import calibrate
from tumble.simulation.session import simulate_session


@pytest.fixture(scope="module")
def yard(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sessions a and c are good, b has no log, d is too short to be calibrated, e is no TOML; f is not a session."""
    root = tmp_path_factory.mktemp("yard")
    for name, seed in (("a", 1), ("c", 2)):
        simulate_session(root / name, Setup.of(rest=8.0, sample_rate=20.0), seed=seed)
    simulate_session(root / "d", Setup.of(positions=3, sample_rate=20.0), seed=3)
    shutil.copytree(root / "a", root / "b")
    (root / "b" / "log.parquet").unlink()
    (root / "e").mkdir()
    (root / "e" / "session.toml").write_text("format = ")
    (root / "f").mkdir()
    return root


def fleet(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["fleet", *map(str, arguments)])


@pytest.fixture(scope="module")
def result(yard: Path, tmp_path_factory: pytest.TempPathFactory) -> FleetResult:
    """The result of all sessions."""
    return fleets.fleet(f"{yard}/*", tmp_path_factory.mktemp("fleet") / "out", method="ellipsoid", serial=True)


@pytest.fixture(scope="module")
def serial(result: FleetResult) -> pl.DataFrame:
    """The rows of all sessions."""
    return pl.read_parquet(result.rows)


def test_every_session_has_a_row_and_a_bad_one_stops_none(yard: Path, serial: pl.DataFrame) -> None:
    assert serial["session"].to_list() == [str(yard / name) for name in "abcde"]
    assert serial["accepted"].to_list() == [True, None, True, False, None]
    errors = dict(zip("abcde", serial["error"].to_list(), strict=True))
    assert errors["a"] is errors["c"] is errors["d"] is None
    assert "log.file: expected a log at" in errors["b"]
    assert "expected TOML" in errors["e"]
    assert serial["reasons"].to_list()[3]


def test_a_row_holds_what_the_calibration_holds(yard: Path, serial: pl.DataFrame) -> None:
    expected = calibrate(yard / "c", method="ellipsoid")
    row = serial.row(2, named=True)
    assert row["parameter"] == [p.name for p in expected.parameters]
    assert row["value"] == [p.value for p in expected.parameters]
    assert row["u"] == [p.u for p in expected.parameters]
    assert row["unit"] == [p.unit for p in expected.parameters]
    assert expected.covariance is not None
    assert row["covariance"] == expected.covariance.ravel().tolist()
    assert row["log_sha256"] == expected.provenance.log_sha256
    assert (row["serial"], row["method"], row["rests"]) == ("navigation-2", "ellipsoid", 15)


def test_processes_give_the_same_rows(yard: Path, serial: pl.DataFrame, processes: Executor, tmp_path: Path) -> None:
    (client,) = cast("partial[Iterator[Done]]", processes).args
    address = client.scheduler.address
    result = fleets.fleet(f"{yard}/*", tmp_path / "out", method="ellipsoid", cluster=address)
    assert pl.read_parquet(result.rows).equals(serial)


def test_the_result_names_what_was_refused_and_what_failed(yard: Path, result: FleetResult) -> None:
    assert result.accepted == 2
    assert set(result.not_accepted) == {str(yard / "d")}
    assert set(result.failed) == {str(yard / "b"), str(yard / "e")}


# Where sessions come from


def test_a_glob_takes_folders_with_a_session_file(yard: Path) -> None:
    everything = [str(yard / name) for name in "abcde"]
    for pattern in (f"{yard}/*", f"{yard}/*/session.toml", f"{yard.parent}/{yard.name}/**"):
        assert find_sessions(pattern) == everything
    assert find_sessions(f"{yard}/[ac]") == [str(yard / name) for name in "ac"]


def test_a_manifest_lists_folders_from_where_it_is(yard: Path, tmp_path: Path) -> None:
    text = yard / "some.txt"
    text.write_text(f"# two of them\na\n\n  {tmp_path}/elsewhere\n")
    assert find_sessions(str(text)) == [str(yard / "a"), f"{tmp_path}/elsewhere"]


@pytest.mark.parametrize(
    ("pattern", "said"),
    [
        ("nowhere/*", "expected a glob that matches folders with a session.toml, found none"),
        ("nowhere.txt", "cannot be read: No such file"),
        ("empty.txt", "expected a session in each line, found none"),
        ("twice.txt", "expected every session once, found .*a twice"),
    ],
)
def test_what_lists_no_sessions_is_refused_in_one_line(
    pattern: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "empty.txt").write_text("# nothing\n")
    (tmp_path / "twice.txt").write_text("a\na\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=said) as caught:
        find_sessions(pattern)
    assert "\n" not in str(caught.value)


# The command


def test_the_command_counts_and_says_why_and_resumes(yard: Path, tmp_path: Path) -> None:
    for _ in range(2):
        result = fleet(f"{yard}/*", "--in-process", "-o", tmp_path / "out")
        assert result.exit_code == 1
        assert result.stdout == "5 sessions: 2 accepted, 1 not accepted, 2 failed\n"
        assert f"not accepted: {yard}/d: " in result.stderr
        assert f"failed: {yard}/b: " in result.stderr
    other = fleet(f"{yard}/[ac]", "--in-process", "-o", tmp_path / "out")
    assert other.exit_code == 2
    assert "another job has begun" in other.stderr
    good = fleet(f"{yard}/[ac]", "--in-process", "-o", tmp_path / "good")
    assert good.exit_code == 0
