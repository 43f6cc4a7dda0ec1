"""A recording is never written to: whatever a folder holds is there unchanged after every command."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.shared import calibrated, copy_of, session
from tumble.cli import main
from tumble.drafting.new_session import new_session
from tumble.errors import InputError
from tumble.files import OutputFolder, nothing_left
from tumble.planning.setup import Setup
from tumble.simulation.session import simulate_session
from tumble.use.apply import apply_to_session

NAMES = ("log.parquet", "log.csv", "log-ACC.csv", "log-GYRO.csv", "position-01.parquet", "log-01.parquet", "in.csv")
SENSORS = {"ACC": ("ax", "ay", "az"), "GYRO": ("gx", "gy", "gz")}


@pytest.fixture
def rows() -> pl.DataFrame:
    """A recording by hand in SI, columns t, ax … gz, of four positions."""
    folder = session(Setup.of(grade="mems", positions=4, rest=2.0, sample_rate=50.0), seed=3)
    return pl.read_parquet(folder / "log.parquet")


def with_blank_rows(rows: pl.DataFrame, folder: Path) -> list[Path]:
    """Readings in every other row, and columns that the session has no use for."""
    path = folder / "log.parquet"
    pl.concat([rows.head(1).with_columns(pl.exclude("t") * np.nan), rows]).with_columns(
        pressure=pl.lit(1013.0), counter=pl.int_range(pl.len())
    ).write_parquet(path)
    return [path]


def as_names_and_numbers(rows: pl.DataFrame, folder: Path) -> list[Path]:
    path = folder / "log.csv"
    path.write_text("".join(" ".join(f"{k}={v!r}" for k, v in row.items()) + "\n" for row in rows.to_dicts()))
    return [path]


def a_sensor_a_row(rows: pl.DataFrame, folder: Path) -> list[Path]:
    path = folder / "log.csv"
    cells = ((kind, row["t"], *(row[c] for c in three)) for row in rows.to_dicts() for kind, three in SENSORS.items())
    path.write_text("".join(",".join(map(str, each)) + "\n" for each in cells))
    return [path]


def a_sensor_a_file(rows: pl.DataFrame, folder: Path) -> list[Path]:
    paths = [folder / name for name in ("accelerometer.csv", "gyroscope.csv")]
    for path, three in zip(paths, SENSORS.values(), strict=True):
        rows.select("t", **dict(zip("xyz", map(pl.col, three), strict=True))).write_csv(path)
    return paths


def an_array(rows: pl.DataFrame, folder: Path) -> list[Path]:
    path = folder / "log.npy"
    np.save(path, rows.to_numpy())
    return [path]


WRITTEN: Mapping[str, Callable[[pl.DataFrame, Path], list[Path]]] = {
    "rows without readings": with_blank_rows,
    "names before the numbers": as_names_and_numbers,
    "rows of one sensor each": a_sensor_a_row,
    "files of one sensor each": a_sensor_a_file,
    "an array": an_array,
}


def hashes(folder: Path) -> dict[Path, str]:
    return {path: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("kind", WRITTEN)
def test_no_command_changes_a_file_that_was_there(kind: str, rows: pl.DataFrame, tmp_path: Path) -> None:
    """The session is made in the folder of the recording, beside files of every name that a copy of it could have."""
    for name in NAMES:
        (tmp_path / name).write_text(f"another recording of the user, {name}")
    logs = WRITTEN[kind](rows, tmp_path)
    before = hashes(tmp_path)
    for words in (
        ["new", tmp_path, *logs, "--latitude", "50", "--sample-rate", "50"],
        ["inspect", tmp_path],
        ["noise", tmp_path],
        ["calibrate", tmp_path, "--terms", "linear"],
        ["calibrate", tmp_path, "--terms", "linear", "--out", logs[0], "--force"],
        ["apply", tmp_path / "calibration.json", tmp_path, "-o", tmp_path / "log.parquet"],
    ):
        result = CliRunner().invoke(main, [str(word) for word in words])
        assert result.exception is None or isinstance(result.exception, SystemExit)
        if words[0] == "new":
            assert result.exit_code == 0, result.stderr
        after = hashes(tmp_path)
        assert {path: after.get(path) for path in before} == before


def test_the_log_of_a_session_is_not_replaced_by_its_correction(tmp_path: Path) -> None:
    setup = Setup.of(grade="mems", positions=12)
    folder = copy_of(session(setup, seed=1), tmp_path / "s")
    calibrated(setup, seed=1).write(folder / "calibration.json")
    before = hashes(folder)
    alias = tmp_path / "alias.parquet"
    alias.symlink_to(folder / "log.parquet")
    for out in (folder / "log.parquet", alias):
        with pytest.raises(InputError, match="found the recording of the session"):
            apply_to_session(folder / "calibration.json", folder, out, force=True)
    other = tmp_path / "other.csv"
    other.write_text("a recording")
    with pytest.raises(InputError, match="expected a new file"):
        apply_to_session(folder / "calibration.json", folder, other)
    assert (hashes(folder), other.read_text()) == (before, "a recording")


def test_a_simulation_replaces_no_log(tmp_path: Path) -> None:
    (tmp_path / "log.parquet").write_text("a recording")
    with pytest.raises(InputError, match=r"expected a new folder, found log\.parquet in it"):
        simulate_session(tmp_path, Setup.of(grade="mems", positions=4), seed=1)
    assert [path.name for path in tmp_path.iterdir()] == ["log.parquet"]


@settings(max_examples=50, deadline=None)
@given(st.lists(st.sampled_from(["a.csv", "a-2.csv", "b.parquet"]), max_size=6), st.sets(st.sampled_from(NAMES)))
def test_new_files_have_names_of_their_own_and_are_all_that_a_failure_takes_away(
    tmp_path_factory: pytest.TempPathFactory, asked: list[str], there: set[str]
) -> None:
    folder = tmp_path_factory.mktemp("out")
    for name in (*there, "a.csv"):
        (folder / name).write_text(name)
    before = hashes(folder)
    output = OutputFolder(folder)
    made = [output.new_file(name) for name in asked]
    assert len({*made, *before}) == len(made) + len(before)
    assert hashes(folder) == before  # nothing stands there before it is written whole
    for path in made:
        path.write_text("made")
    assert {path: found for path, found in hashes(folder).items() if path in before} == before

    def failed() -> None:
        with nothing_left(folder) as again:
            for name in asked:
                again.new_file(name).write_text("half")
            (folder / "of another program.csv").write_text("")
            (folder / "a folder").mkdir(exist_ok=True)
            raise ValueError("stop")

    with pytest.raises(ValueError, match="stop"):
        failed()
    left = {folder / "of another program.csv", folder / "a folder", *before, *made}
    assert set(folder.iterdir()) == left


def test_a_folder_with_files_of_others_outlives_a_failure(tmp_path: Path) -> None:
    def failed() -> None:
        with nothing_left(tmp_path / "a" / "b") as output:
            output.new_file("log.csv")
            (tmp_path / "a" / "of another program.csv").write_text("")
            raise ValueError("stop")

    with pytest.raises(ValueError, match="stop"):
        failed()
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["a", "of another program.csv"]


def test_a_session_made_beside_its_recording_names_the_copy(rows: pl.DataFrame, tmp_path: Path) -> None:
    (log,) = with_blank_rows(rows, tmp_path)
    draft, _ = new_session(tmp_path, log)
    assert draft.content["log"]["file"] == str(tmp_path / "log-2.parquet")
    assert pl.read_parquet(log).columns[-2:] == ["pressure", "counter"]
