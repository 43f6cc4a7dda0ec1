"""Files are written whole or not at all, and what fails is said of the file that was asked for."""

from __future__ import annotations

import errno
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path

import polars as pl
import pytest

import tumble
from tumble.errors import InputError, LogError
from tumble.files import nothing_left, whole_file
from tumble.recording.log_source import one_ahead
from tumble.recording.panic import COMMAND_LINE
from tumble.recording.readers import source_of, write_tables


def test_a_file_that_fails_leaves_the_one_that_was_there(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text("old")

    def stopped() -> None:
        with whole_file(path) as temporary:
            temporary.write_text("half")
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OSError, match="No space left on device") as raised:
        stopped()
    assert raised.value.filename == str(path)
    assert [p.name for p in tmp_path.iterdir()] == ["x.json"]
    assert path.read_text() == "old"


def test_an_error_of_the_system_in_the_words_of_a_library_is_one_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "x.parquet"
    said = "parquet: File out of specification: underlying IO error: No space left on device (os error 28)"
    with pytest.raises(OSError, match="No space left") as raised, whole_file(path):
        raise pl.exceptions.ComputeError(said)
    assert (raised.value.errno, raised.value.filename) == (errno.ENOSPC, str(path))


def test_errors_of_other_files_and_of_other_kinds_stay(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as raised, whole_file(tmp_path / "x.csv"):
        (tmp_path / "input.csv").read_text()
    assert raised.value.filename == str(tmp_path / "input.csv")
    with pytest.raises(ValueError, match="other"), whole_file(tmp_path / "x.csv"):
        raise ValueError("other")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_named_by_the_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as raised, whole_file(tmp_path / "no" / "x.csv"):
        pass
    assert raised.value.filename == str(tmp_path / "no" / "x.csv")


def test_nothing_is_left_of_a_folder_that_fails(tmp_path: Path) -> None:

    def stopped() -> None:
        with nothing_left(tmp_path / "a" / "b") as output:
            output.new_file("file").write_text("half")
            raise ValueError("stop")

    with pytest.raises(ValueError, match="stop"):
        stopped()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="no locks of folders")
@pytest.mark.parametrize("there", [True, False], ids=["a folder that is there", "a new folder"])
def test_of_two_that_write_into_a_folder_the_second_is_refused(there: bool, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "folder"
    if there:
        folder.mkdir(parents=True)
    with nothing_left(folder) as first:
        with pytest.raises(InputError, match="found one in use"), nothing_left(folder):
            pass
        first.new_file("log.csv").write_text("first")
        with pytest.raises(InputError, match="found one in use"), nothing_left(folder):
            pass
    with nothing_left(folder) as second:
        second.new_file("log.csv").write_text("second")
    assert {path.name: path.read_text() for path in folder.iterdir()} == {"log.csv": "first", "log-2.csv": "second"}


def test_panics_at_a_damaged_parquet_file_stay_off_the_terminal_of_a_command(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    in_a_command(damaged_parquet, tmp_path)
    assert capfd.readouterr().err == ""


def test_a_program_that_uses_the_library_keeps_its_standard_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(os, "dup2", lambda *_: pytest.fail("standard error is that of the whole process"))
        patched.setattr(os, "umask", lambda *_: pytest.fail("the mask is that of the whole process"))
        damaged_parquet(tmp_path)
        with whole_file(tmp_path / "file") as temporary:
            temporary.write_text("")


STATE_OF_THE_PROCESS = r"\b(umask|dup2|chdir|catch_warnings|simplefilter|filterwarnings|redirect_std\w+|signal)\("


def test_nothing_but_a_command_changes_what_the_whole_process_has() -> None:
    source = Path(tumble.__file__).parent
    found = {
        str(path.relative_to(source))
        for path in source.rglob("*.py")
        if re.search(STATE_OF_THE_PROCESS, path.read_text(encoding="utf-8"))
    }
    assert found == {
        "__main__.py",  # before and after a command
        "cli.py",
        "campaigns/cluster.py",  # in the processes of the cluster
        "recording/panic.py",  # in a command alone
        "recording/formats/ardupilot.py",
    }


def in_a_command(do: Callable[[Path], None], folder: Path) -> None:
    """Do something as a command does."""
    token = COMMAND_LINE.set(True)
    try:
        do(folder)
    finally:
        COMMAND_LINE.reset(token)


def damaged_parquet(tmp_path: Path) -> None:
    """Read a Parquet file that is damaged."""
    path = tmp_path / "log.parquet"
    columns = {name: [float(i) for i in range(2000)] for name in ("t", "ax", "ay", "az")}
    pl.DataFrame(columns).write_parquet(path, compression="uncompressed", statistics=False)
    content = path.read_bytes()
    path.write_bytes(content[:500] + content[30_500:])  # rows are gone that the end of the file tells of
    for read in (iter, one_ahead):  # by this thread, and by one beside it
        with pytest.raises(LogError) as raised:
            list(read(source_of(path).tables(["t", "az"])))
        assert "\n" not in str(raised.value)


def test_columns_that_csv_cannot_hold_are_named(tmp_path: Path) -> None:
    table = pl.DataFrame({"ax": [1.0, 2.0], "both": [[1.0, 2.0], [3.0, 4.0]]})
    with pytest.raises(InputError, match=r"found 'both' of the type List\(Float64\); write a \.parquet file"):
        write_tables(tmp_path / "a.csv", iter([table]))
    assert list(tmp_path.iterdir()) == []
    write_tables(tmp_path / "a.parquet", iter([table]))
    assert pl.read_parquet(tmp_path / "a.parquet").equals(table)


def test_a_file_on_a_disk_that_is_read_only_is_named_and_not_what_stands_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path | str, *_: object, **__: object) -> int:
        raise OSError(errno.EROFS, "Read-only file system", str(path))

    monkeypatch.setattr(os, "open", refuse)
    monkeypatch.setattr(Path, "unlink", refuse)  # which such a disk refuses even if there is no file
    with pytest.raises(OSError, match="Read-only") as caught, whole_file(tmp_path / "x.params"):
        pass
    assert caught.value.filename == str(tmp_path / "x.params")
