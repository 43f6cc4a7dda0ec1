"""Everything received is on disk, whatever the line, the network or the machine does."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.support.browser import eventually
from tumble.bench.record.recorder import Intake, Recorder
from tumble.bench.session_folder import begin, begin_next, session_to_record, write_exclusion
from tumble.errors import InputError
from tumble.recording.live.samples import SI_LOG, StreamedSamples
from tumble.recording.live.sources import GrowingFile, Replay, StandardInput, Udp
from tumble.recording.log import open_log
from tumble.recording.session import Exclusion
from tumble.recording.session_file import read_session

COLUMNS = ("t", "ax", "ay", "az", "gx", "gy", "gz")
HEADER = ",".join(COLUMNS)
RATE = 100.0


def row(k: int, at: float | None = None) -> str:
    """The k-th row of a log, from 1; with another time where one is given."""
    return f"{k / RATE if at is None else at!r},0.1,9.8,-0.2,0.001,{k * 1e-6!r},0.003"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "launch"
    begin(made, log=SI_LOG, serial="A-1", site={"latitude_deg": 50.0}, programme=None)
    return made


def log_of(folder: Path) -> list[str]:
    return (folder / "log.csv").read_text().splitlines()


# -------------------- the log on disk --------------------


def test_a_recording_goes_on_where_it_was_cut(folder: Path) -> None:
    """Of a process that was killed in a line, and of a machine that lost its power."""
    path = folder / "log.csv"
    for end, refused in ((row(2)[:9].encode(), row(2)[:9] + "\n"), (bytes(3 << 20), None)):
        path.write_bytes(f"{HEADER}\n{row(1)}\n".encode() + end)
        recorder = Recorder(path, HEADER)
        recorder.append(f"{row(3)}\n".encode())
        recorder.close()
        assert log_of(folder) == [HEADER, row(1), row(3)]
        assert refused is None or (folder / "refused.txt").read_text() == refused


def test_two_cannot_record_one_log_and_no_log_of_other_columns_is_touched(folder: Path) -> None:
    recorder = Recorder(folder / "log.csv", HEADER)
    with pytest.raises(InputError, match="another process"):
        Recorder(folder / "log.csv", HEADER)
    recorder.close()
    with pytest.raises(InputError, match="expected the columns a,b"):
        Recorder(folder / "log.csv", "a,b")
    assert log_of(folder) == [HEADER]


class Disk:
    """Takes so many bytes more and then none."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, room: int) -> None:
        self.room, self._write = room, os.write
        monkeypatch.setattr(os, "write", self.write)

    def write(self, descriptor: int, data: bytearray) -> int:
        if not self.room:
            raise OSError(28, "No space left on device")
        taken = bytes(data[: self.room])
        self.room -= len(taken)
        return self._write(descriptor, taken)


def test_a_full_disk_is_said_and_what_is_lost_is_whole_lines(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [f"0.{k:02},1,2,3,4,5,6\n".encode() for k in range(1, 15)]
    monkeypatch.setattr("tumble.bench.record.recorder.KEPT_BYTES", 4 * len(rows[0]) + 10)
    recorder = Recorder(folder / "log.csv", HEADER)
    disk = Disk(monkeypatch, len(rows[0]) + 10)
    for line in rows[:3]:
        recorder.append(line)
    assert "No space left" in str(recorder.trouble)
    disk.room = 1 << 20
    recorder.append(rows[3])
    assert (recorder.trouble, log_of(folder)[1:]) == (None, [line.decode().strip() for line in rows[:4]])
    disk.room = 10
    for line in rows[4:12]:
        recorder.append(line)
    disk.room = 1 << 20
    recorder.append(rows[12])
    assert recorder.trouble == "3 samples are lost, which the disk did not take"
    disk.room = 10
    recorder.append(rows[13])
    recorder.close()
    kept = [*rows[:9], rows[12]]
    assert [f"{line}\n".encode() for line in log_of(folder)[1:]] == kept
    assert recorder.trouble == "4 samples are lost, which the disk did not take"


class Faulty:
    """A source of rows, which fails in other ways than sources are known to."""

    name, begins_anew, trouble, sent = "faulty", False, None, 0

    def read(self, timeout: float) -> bytes:
        self.sent += 1
        if self.sent in (5, 6):
            raise ZeroDivisionError("a driver")
        if self.sent > 10:
            time.sleep(timeout)
            return b""
        return f"{row(self.sent)}\n".encode()

    def close(self) -> None:
        raise ZeroDivisionError("a driver")


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_error_in_receiving_is_said_and_the_recording_goes_on(folder: Path) -> None:
    intake = recorded(folder, Faulty(), lambda: None, 8)
    assert log_of(folder)[1:] == [row(k) for k in (1, 2, 3, 4, 7, 8, 9, 10)]
    assert "an error of the program while receiving (ZeroDivisionError: a driver)" in intake.received["trouble"]


def test_a_folder_that_is_gone_is_said_and_the_recording_goes_on(folder: Path) -> None:
    recorder = Recorder(folder / "log.csv", HEADER)
    (folder / "log.csv").unlink()
    (folder / "session.toml").unlink()
    folder.rmdir()
    recorder.refuse(b"no row")
    assert "No such file" in str(recorder.trouble)
    recorder.append(f"{row(1)}\n".encode())
    recorder.close()


# -------------------- whatever the times are --------------------


def recorded(folder: Path, source: object, sent: Callable[[], None], until: int) -> Intake:
    intake = Intake(source, session_to_record(folder))  # type: ignore[arg-type]
    intake.start()
    try:
        sent()
        eventually(lambda: intake.rows >= until, every=0.01)
    finally:
        intake.stop()
    return intake


def test_rows_are_recorded_as_they_come_whatever_their_times_are(folder: Path) -> None:
    """Three that agree on a wrong time, one that leaps, some that are exchanged: the log has every row, and those since
    the clock started anew are another file of it."""
    wrong = {100: 900.5, 101: 900.51, 102: 900.52, 150: 1e308, 200: 2.02, 201: 2.01, 300: 2.99}
    rows = [row(k, wrong.get(k)) for k in range(1, 1001)] + [row(k) for k in range(1, 50)]
    out, into = os.pipe()
    os.write(into, "".join(f"{each}\n" for each in rows[:500]).encode())
    recorded(folder, StandardInput(out), lambda: None, 500)
    os.close(into)
    os.close(out)
    source = Udp("127.0.0.1", 0)

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as datagrams:
            for each in rows[500:]:
                datagrams.sendto(each.encode(), ("127.0.0.1", source.port))

    intake = recorded(folder, source, send, len(rows) - 500)
    assert log_of(folder) == [HEADER, *rows[:1000]]
    assert [file.name for file in intake.files] == ["log.csv", "log-2.csv"]
    assert intake.files[1].read_text().splitlines() == [HEADER, *rows[1000:]]
    assert intake.received["refused"] == 0


@pytest.mark.parametrize("pieces", [1, 7, 400])
def test_a_wrong_time_or_an_exchange_costs_its_row_on_the_page_as_in_the_calibration(folder: Path, pieces: int) -> None:
    sent = np.column_stack([np.arange(1, 401) / RATE, np.ones((400, 6))])
    sent[[150, 220, 300], 0] = [900.5, 1e308, 3.4]
    sent[[350, 351]] = sent[[351, 350]]
    np.savetxt(folder / "log.csv", sent, delimiter=",", header=HEADER, comments="", fmt="%.17g")
    streamed = StreamedSamples(read_session(folder).log)
    found = [streamed.feed(rows) for rows in np.array_split(sent, pieces)]
    log = open_log(read_session(folder))
    times = np.concatenate([chunk.time for chunk in found if chunk is not None])
    np.testing.assert_allclose(times, np.arange(1, 401) / RATE, rtol=1e-12)
    np.testing.assert_array_equal(times, np.concatenate([chunk.time for chunk in log.chunks()]))
    assert sum(gap.samples for gap in streamed.gaps) == 4
    assert all(gap.integrable for gap in streamed.gaps)


# -------------------- a recording that goes on --------------------


def test_a_file_that_grows_and_a_recording_of_it_that_goes_on(folder: Path, tmp_path: Path) -> None:
    """The second recording gets every row again, and appends those that are new, whatever their times are."""
    path = tmp_path / "growing.csv"
    path.write_text(f"{HEADER}\n{row(1)}\n{row(2)[:5]}")

    def grow() -> None:
        time.sleep(0.1)
        with path.open("a") as file:
            file.write(row(2)[5:] + "\nno row\n" + row(3, 900.5) + "\n" + row(4)[:3])

    recorded(folder, GrowingFile(path), grow, 3)
    assert log_of(folder)[1:] == [row(1), row(2), row(3, 900.5)]
    with path.open("a") as file:
        file.write(row(4)[3:] + f"\n{row(5)}\n")
    recorded(folder, GrowingFile(path), lambda: None, 2)
    assert log_of(folder)[1:] == [row(1), row(2), row(3, 900.5), row(4), row(5)]


def test_a_replay_is_the_log_to_the_byte_and_keeps_its_pace(folder: Path, tmp_path: Path) -> None:
    text = f"{HEADER}\n" + "".join(f"{row(k)}\n" for k in range(1, 201))
    (folder / "log.csv").write_text(text)
    copy = tmp_path / "copy"
    begin(copy, log=SI_LOG, serial="A-1", site={"latitude_deg": 50.0}, programme=None)
    started = time.monotonic()
    recorded(copy, Replay(folder, 8.0), lambda: None, 100)
    assert time.monotonic() - started > 0.1  # never faster than asked
    recorded(copy, Replay(folder, 8.0), lambda: None, 200 - len(log_of(copy)) + 1)
    assert (copy / "log.csv").read_text() == text


RECORDS = """
import sys
from pathlib import Path
from tumble.bench.session_folder import session_to_record
from tumble.bench.record.recorder import Intake
from tumble.recording.live.sources import GrowingFile
intake = Intake(GrowingFile(Path(sys.argv[2])), session_to_record(Path(sys.argv[1])))
intake.start()
intake._thread.join()
"""


def test_a_killed_process_loses_nothing_that_was_received(folder: Path, tmp_path: Path) -> None:
    source, rng, sent = tmp_path / "source.csv", np.random.default_rng(1), 0
    source.write_text(f"{HEADER}\n")
    for _ in range(2):
        process = subprocess.Popen([sys.executable, "-c", RECORDS, str(folder), str(source)])
        try:
            before = len(log_of(folder)) if (folder / "log.csv").exists() else 0
            sent += 1
            with source.open("a") as file:
                file.write(row(sent) + "\n")
            eventually(lambda n=before: (folder / "log.csv").exists() and len(log_of(folder)) > n)  # type: ignore[misc]
            end = time.monotonic() + rng.uniform(0.1, 0.4)
            while time.monotonic() < end:
                with source.open("a") as file:
                    for _ in range(int(rng.integers(1, 40))):
                        sent += 1
                        file.write(row(sent) + "\n")
                time.sleep(0.005)
        finally:
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
    recorded(folder, GrowingFile(source), lambda: eventually(lambda: len(log_of(folder)) == sent + 1), 0)
    assert log_of(folder)[1:] == [row(k) for k in range(1, sent + 1)]


# -------------------- the folder --------------------


def test_what_is_left_out_is_added_to_a_file_that_stays_as_it_is(folder: Path) -> None:
    path = folder / "session.toml"
    (folder / "log.csv").touch()
    path.write_text("# a comment\n" + path.read_text())
    before = path.read_text()
    first = Exclusion(start=1.25, stop=2.5, reason='a "knock" \n[[x]]')
    write_exclusion(folder, first)
    longer = Exclusion(start=1.25, stop=7.5, reason="a knock")
    write_exclusion(folder, longer, instead_of=first)
    write_exclusion(folder, Exclusion(rest=3, reason="<script>"))
    assert read_session(folder).excluded == (longer, Exclusion(rest=3, reason="<script>"))
    assert path.read_text().startswith(before.rstrip("\n"))
    write_exclusion(folder, None, instead_of=Exclusion(rest=3, reason="<script>"))
    assert read_session(folder).excluded == (longer,)


def test_the_next_unit_has_a_folder_of_its_own_whatever_its_number(folder: Path) -> None:
    made = begin_next(folder, "../../<script>alert(1)</script>")
    assert made.parent == folder.parent
    assert session_to_record(made).device.serial == "../../<script>alert(1)</script>"
    assert begin_next(folder, "launch").name == "launch-2"
