"""Fleets: a row for every session, whatever becomes of it."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import polars as pl
import pytest
from click.testing import CliRunner, Result

from tumble.campaigns.engine import Executor, run
from tumble.campaigns.fleet import job_of, sessions_of, tally
from tumble.cli import main
from tumble.errors import InputError, MissingExtraError
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
def serial(yard: Path, tmp_path_factory: pytest.TempPathFactory) -> pl.DataFrame:
    """The rows of all sessions."""
    out = tmp_path_factory.mktemp("fleet") / "out"
    return pl.read_parquet(run(job_of(sessions_of(f"{yard}/*"), "staged"), out))


def test_every_session_has_a_row_and_a_bad_one_stops_none(yard: Path, serial: pl.DataFrame) -> None:
    assert serial["session"].to_list() == [str(yard / name) for name in "abcde"]
    assert serial["accepted"].to_list() == [True, None, True, False, None]
    errors = dict(zip("abcde", serial["error"].to_list(), strict=True))
    assert errors["a"] is errors["c"] is errors["d"] is None
    assert "log.file: expected a log at" in errors["b"]
    assert "expected TOML" in errors["e"]
    assert serial["reasons"].to_list()[3]


def test_a_row_holds_what_the_calibration_holds(yard: Path, serial: pl.DataFrame) -> None:
    expected = calibrate(yard / "c", method="staged")
    row = serial.row(2, named=True)
    assert row["parameter"] == [p.name for p in expected.parameters]
    assert row["value"] == [p.value for p in expected.parameters]
    assert row["u"] == [p.u for p in expected.parameters]
    assert row["unit"] == [p.unit for p in expected.parameters]
    assert expected.covariance is not None
    assert row["covariance"] == expected.covariance.ravel().tolist()
    assert row["log_sha256"] == expected.provenance.log_sha256
    assert (row["serial"], row["method"], row["rests"]) == ("navigation-2", "staged", 15)


def test_processes_give_the_same_rows(yard: Path, serial: pl.DataFrame, processes: Executor, tmp_path: Path) -> None:
    rows = run(job_of(sessions_of(f"{yard}/*"), "staged"), tmp_path / "out", executor=processes)
    assert pl.read_parquet(rows).equals(serial)


def test_an_interrupted_fleet_is_resumed_without_calibrating_a_session_again(
    yard: Path, serial: pl.DataFrame, tmp_path: Path
) -> None:
    copy = tmp_path / "yard"
    shutil.copytree(yard, copy)

    def interrupt(done: int, _every: int) -> None:
        if done >= 1:
            raise KeyboardInterrupt

    sessions = sessions_of(f"{copy}/*")
    with pytest.raises(KeyboardInterrupt):
        run(job_of(sessions, "staged"), tmp_path / "out", progress=interrupt)
    shutil.rmtree(copy / "a")  # it is done: nothing reads it again
    found = pl.read_parquet(run(job_of(sessions, "staged"), tmp_path / "out"))
    assert found.drop("session", "error").equals(serial.drop("session", "error"))


def test_the_tally_names_what_was_refused_and_what_failed(yard: Path, serial: pl.DataFrame, tmp_path: Path) -> None:
    serial.write_parquet(tmp_path / "rows.parquet")
    found = tally(tmp_path / "rows.parquet")
    assert found.accepted == 2
    assert set(found.refused) == {str(yard / "d")}
    assert set(found.failed) == {str(yard / "b"), str(yard / "e")}


# Where sessions come from


def test_a_glob_takes_folders_with_a_session_file(yard: Path) -> None:
    everything = [str(yard / name) for name in "abcde"]
    for pattern in (f"{yard}/*", f"{yard}/*/session.toml", f"{yard.parent}/{yard.name}/**"):
        assert sessions_of(pattern) == everything
    assert sessions_of(f"{yard}/[ac]") == [str(yard / name) for name in "ac"]


def test_a_manifest_lists_folders_from_where_it_is(yard: Path, tmp_path: Path) -> None:
    text, table = yard / "some.txt", yard / "some.csv"
    text.write_text(f"# two of them\na\n\n  {tmp_path}/elsewhere\nfile:///x/y\n")
    table.write_text(f"serial,session\n1,a\n2,{tmp_path}/elsewhere\n3,file:///x/y\n")
    expected = [str(yard / "a"), f"{tmp_path}/elsewhere", "file:///x/y"]
    assert sessions_of(str(text)) == sessions_of(str(table)) == expected


def test_sessions_at_urls_give_the_rows_of_the_folders(yard: Path, serial: pl.DataFrame, tmp_path: Path) -> None:
    from fsspec.implementations.memory import MemoryFileSystem

    memory = MemoryFileSystem()
    memory.put(str(yard), "/fleet-of-the-test", recursive=True)
    sessions = sessions_of("memory://fleet-of-the-test/*")
    assert sessions == [f"memory:///fleet-of-the-test/{name}" for name in "abcde"]
    found = pl.read_parquet(run(job_of(sessions, "staged"), tmp_path / "out"))
    assert found.drop("session", "error").equals(serial.drop("session", "error"))
    assert found["error"].to_list()[1].startswith("memory:///fleet-of-the-test/b/session.toml: log.file")
    memory.pipe_file("/fleet-of-the-test/bad.txt", b"file:///etc\n")
    with pytest.raises(InputError, match="expected sessions at memory://fleet-of-the-test, where the manifest is"):
        sessions_of("memory://fleet-of-the-test/bad.txt")
    memory.pipe_file("/fleet-of-the-test/some.txt", b"a\nc\n")
    assert sessions_of("memory://fleet-of-the-test/some.txt") == [f"memory://fleet-of-the-test/{n}" for n in "ac"]


@pytest.mark.parametrize(
    ("pattern", "said"),
    [
        ("nowhere/*", "expected a glob that matches folders with a session.toml, found none"),
        ("nowhere.txt", "cannot be read: No such file"),
        ("empty.txt", "expected a session in each line, found none"),
        ("other.csv", "expected a column 'session', found serial, folder"),
        ("twice.txt", "expected every session once, found .*a twice"),
        ("nonsense://here/*", "expected a URL that fsspec can read, found"),
    ],
)
def test_what_lists_no_sessions_is_refused_in_one_line(
    pattern: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "empty.txt").write_text("# nothing\n")
    (tmp_path / "other.csv").write_text("serial,folder\n1,a\n")
    (tmp_path / "twice.txt").write_text("a\na\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=said) as caught:
        sessions_of(pattern)
    assert "\n" not in str(caught.value)


def test_without_fsspec_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    with pytest.raises(MissingExtraError, match=r"needs fsspec; install it with: pip install 'tumble\[cluster\]'"):
        sessions_of("s3://bucket/*")


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
    assert "was begun by another job" in other.stderr
    good = fleet(f"{yard}/[ac]", "--in-process", "-o", tmp_path / "good")
    assert good.exit_code == 0
