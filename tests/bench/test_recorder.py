"""Everything received is on disk, whatever the line, the network or the machine does."""

from __future__ import annotations

import json
import os
import pty
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.browser import eventually
from tumble.bench.record.recorder import Intake, Recorder
from tumble.bench.session_folder import MOTIONCAL_LOG, begin, begin_next, leave_out, session_to_record
from tumble.errors import InputError, MissingExtraError
from tumble.recording.live.lines import MOTIONCAL_COLUMNS, Lines, Row, numbers_in
from tumble.recording.live.samples import SI_LOG, StreamedSamples
from tumble.recording.live.sources import (
    GrowingFile,
    Mavlink,
    Replay,
    Serial,
    StandardInput,
    Tcp,
    Udp,
    line_of,
    source_of,
)
from tumble.recording.log import open_log
from tumble.recording.session import Exclusion
from tumble.recording.session_file import read_session
from tumble.units import G_STANDARD

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


def lines(columns: tuple[str, ...] = COLUMNS, refused: list[bytes] | None = None) -> Lines:
    return Lines(columns=columns, clock="t", refuse=(refused if refused is not None else []).append, now=lambda: 5.0)


# -------------------- lines --------------------


@given(st.lists(st.integers(1, 40), min_size=1, max_size=30))
def test_rows_do_not_depend_on_how_the_bytes_are_cut(cuts: list[int]) -> None:
    data = "".join(f"{row(k)}\n" for k in range(1, 20)).encode()
    parser, found, at = lines(), [], 0
    for cut in [*cuts, len(data)]:
        found += parser.feed(data[at : at + cut])
        at += cut
    assert [r.text for r in found] == [row(k) for k in range(1, 20)]
    assert parser.refused == 0


@given(st.lists(st.sampled_from("0123456789.,+-eE\n ax"), max_size=60))
def test_numbers_read_together_are_those_read_line_by_line(characters: list[str]) -> None:
    text = "0.5,1,2\n" + "".join(characters) + "\n"
    together = numbers_in(text.encode(), 3)
    parser = lines(("t", "ax", "ay"))
    one_by_one = parser.feed(text.encode())
    if together is not None:
        assert parser.refused == 0
        assert [r.text for r in one_by_one] == text.split("\n")[:-1]
        assert [[float(value) for value in r.text.split(",")] for r in one_by_one] == together.tolist()


@given(st.binary(max_size=200))
def test_garbage_is_refused_and_whole_rows_after_it_are_not(garbage: bytes) -> None:
    found = lines().feed(garbage.replace(b"\n", b"") + b"\n" + row(1).encode() + b"\n")
    assert row(1) in [r.text for r in found]


def test_what_a_line_may_be() -> None:
    header_first = lines().feed(b"gx,gy,gz,ax,ay,az,t,extra\n4,5,6,1,2,3,0.5,9\n")
    assert [(r.text, r.time) for r in header_first] == [("0.5,1,2,3,4,5,6", 0.5)]
    sent = {"gz": 6, "t": 0.5, "ax": 1, "ay": 2, "az": 3, "gx": 4, "gy": 5.5, "<b>": "x"}
    assert lines().feed(json.dumps(sent).encode() + b"\n") == [Row(text="0.5,1.0,2.0,3.0,4.0,5.5,6.0", time=0.5)]
    motioncal = lines(MOTIONCAL_COLUMNS).feed(b"Raw:-8,16,8192,1,-2,3,250,-31,412\n")
    assert motioncal == [Row(text="5.0,-8,16,8192,1,-2,3,25.0,-3.1,41.2", time=5.0)]


@pytest.mark.parametrize(
    "bad",
    [
        b"\xff\xfe\x00", b"1,2,3", b"0.1,1,2,x,4,5,6", b"nan,1,2,3,4,5,6", b"0.1,inf,2,3,4,5,6", b'{"t": 1}', b"{",
        b'{"t": 1e999}',
    ],
)  # fmt: skip
def test_what_is_no_row_is_refused_and_said(bad: bytes) -> None:
    refused: list[bytes] = []
    parser = lines(refused=refused)
    assert parser.feed(bad + b"\n") == []
    assert (parser.refused, refused) == (1, [bad])
    assert parser.last_refused


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
    assert recorder.trouble is None  # nothing is lost that memory had room for
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
    """Three that agree on a wrong time, one that leaps, rows that are exchanged or come twice, a clock that starts anew:
    the log has every row."""
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
    assert log_of(folder) == [HEADER, *rows]
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


# -------------------- sources --------------------


def test_tcp_connections_one_after_the_other(folder: Path) -> None:
    source = Tcp("127.0.0.1", 0)

    def send() -> None:
        for first in (1, 51):
            with socket.create_connection(("127.0.0.1", source.port)) as out:
                text = "".join(f"{row(k)}\n" for k in range(first, first + 50)) + row(first + 50)[:5]
                out.sendall(text.encode())

    intake = recorded(folder, source, send, 100)
    assert log_of(folder)[1:] == [row(k) for k in range(1, 101)]
    assert intake.received["refused"] == 2


def test_a_tcp_sender_that_lost_its_power_gives_way_to_the_next(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tumble.recording.live.sources._SILENT_SECONDS", 0.05)
    source = Tcp("127.0.0.1", 0)
    intake = Intake(source, session_to_record(folder))
    intake.start()
    try:
        with socket.create_connection(("127.0.0.1", source.port)) as dead:
            dead.sendall("".join(f"{row(k)}\n" for k in range(1, 11)).encode() + row(11)[:5].encode())
            eventually(lambda: intake.rows == 10, every=0.01)
            with socket.create_connection(("127.0.0.1", source.port)) as successor:
                successor.sendall("".join(f"{row(k)}\n" for k in range(12, 22)).encode())
                eventually(lambda: intake.rows == 20, every=0.01)
    finally:
        intake.stop()
    assert log_of(folder)[1:] == [row(k) for k in range(1, 22) if k != 11]


def test_serial_line_with_garbage_half_lines_and_a_pulled_cable(folder: Path, tmp_path: Path) -> None:
    link, (master, slave) = tmp_path / "tty", pty.openpty()
    link.symlink_to(os.ttyname(slave))
    intake = Intake(Serial(str(link), 115200), session_to_record(folder))
    intake.start()
    try:
        whole = f"{row(2)}\r\n{row(3)}\n{row(4)}\n".encode()
        os.write(master, row(1)[4:].encode() + b"\n\xff\xf0\x80\n" + whole + row(5)[:11].encode())
        eventually(lambda: intake.rows == 3, every=0.01)
        os.close(slave)
        os.close(master)
        eventually(lambda: intake.source.trouble is not None, every=0.01)
        assert "is gone" in " ".join(intake.received["trouble"])
        master, slave = pty.openpty()
        link.unlink()
        link.symlink_to(os.ttyname(slave))
        eventually(lambda: intake.source.trouble is None, every=0.01)
        os.write(master, f"{row(6)}\n{row(7)}\n".encode())
        eventually(lambda: intake.rows == 5, every=0.01)
    finally:
        intake.stop()
        os.close(slave)
        os.close(master)
    assert log_of(folder)[1:] == [row(k) for k in (2, 3, 4, 6, 7)]
    assert intake.received["refused"] == 3


def test_serial_line_of_a_motioncal_sketch(tmp_path: Path) -> None:
    folder = tmp_path / "launch"
    begin(folder, log=MOTIONCAL_LOG, serial="A", site={"latitude_deg": 50.0, "field": 50.0}, programme=None)
    master, slave = pty.openpty()

    def send() -> None:
        os.write(master, b"Raw:1,2,8192,4,5,6,7,8,9\n" * 3)

    recorded(folder, Serial(os.ttyname(slave), 115200), send, 3)
    os.close(master)
    os.close(slave)
    assert [line.split(",", 1)[1] for line in log_of(folder)[1:]] == ["1,2,8192,4,5,6,0.7,0.8,0.9"] * 3


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_mavlink_through_its_own_sender(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mavutil = pytest.importorskip("pymavlink.mavutil")
    from pymavlink.dialects.v20 import common

    monkeypatch.setattr("tumble.recording.live.sources._CHOOSE_SECONDS", 0.2)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    source = Mavlink(f"udp:{port}")
    sender = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=1)

    def send() -> None:
        for k in range(1, 100):
            sender.mav.raw_imu_send(10_000 * k, 0, 0, 1000, 0, 0, 17, 0, 0, 0)
            sender.mav.scaled_imu2_send(10 * k, 1, 0, 1000, 0, 0, 17, 0, 0, 0)
            time.sleep(0.005)

    recorded(folder, source, send, 20)
    sender.port.close()
    rows = np.array([[float(v) for v in line.split(",")] for line in log_of(folder)[1:]])
    np.testing.assert_allclose(np.diff(rows[:, 0]), 0.01, atol=1e-9)
    np.testing.assert_allclose(rows[0, [3, 6]], [G_STANDARD, 0.017])
    high = common.MAVLink_highres_imu_message(2_500_000, 1.0, 2.0, 9.8, 0.1, 0.2, 0.3, *([0.0] * 7), 0)
    assert line_of(high) == "2.5,1.0,2.0,9.8,0.1,0.2,0.3\n"
    scaled = common.MAVLink_scaled_imu_message(2500, 1000, 0, 0, 100, 0, 0, 0, 0, 0)
    assert [float(v) for v in line_of(scaled).split(",")] == pytest.approx([2.5, G_STANDARD, 0, 0, 0.1, 0, 0])


def test_mavlink_says_which_extra_it_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymavlink", None)
    with pytest.raises(MissingExtraError, match=r"MAVLink needs pymavlink.*'tumble\[formats\]'"):
        source_of("mavlink:udp:14550")


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


def test_standard_input_to_its_end(folder: Path) -> None:
    out, into = os.pipe()
    os.write(into, f"{row(1)}\n{row(2)}\n{row(3)}".encode())
    os.close(into)
    intake = recorded(folder, StandardInput(out), lambda: None, 3)
    os.close(out)
    assert log_of(folder)[1:] == [row(1), row(2), row(3)]
    eventually(lambda: intake.ended)


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


@pytest.mark.parametrize(
    "listen",
    ["", "udp:x", "udp:²", "tcp:70000", "serial:/dev/ttyX", "serial:/dev/ttyX:²", "replay:nowhere@0x", "simulator", "file:"],
)
def test_a_source_that_is_none_is_refused(listen: str) -> None:
    with pytest.raises(InputError, match="listen"):
        source_of(listen)


# -------------------- the folder --------------------


def test_what_is_left_out_is_added_to_a_file_that_stays_as_it_is(folder: Path) -> None:
    path = folder / "session.toml"
    (folder / "log.csv").touch()
    path.write_text("# a comment\n" + path.read_text())
    before = path.read_text()
    first = Exclusion(start=1.25, stop=2.5, reason='a "knock" \n[[x]]')
    leave_out(folder, first)
    longer = Exclusion(start=1.25, stop=7.5, reason="a knock")
    leave_out(folder, longer, instead_of=first)
    leave_out(folder, Exclusion(rest=3, reason="<script>"))
    assert read_session(folder).excluded == (longer, Exclusion(rest=3, reason="<script>"))
    assert path.read_text().startswith(before.rstrip("\n"))
    leave_out(folder, None, instead_of=Exclusion(rest=3, reason="<script>"))
    assert read_session(folder).excluded == (longer,)


def test_the_next_unit_has_a_folder_of_its_own_whatever_its_number(folder: Path) -> None:
    made = begin_next(folder, "../../<script>alert(1)</script>")
    assert made.parent == folder.parent
    assert session_to_record(made).device.serial == "../../<script>alert(1)</script>"
    assert begin_next(folder, "launch").name == "launch-2"


# -------------------- killed --------------------

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
