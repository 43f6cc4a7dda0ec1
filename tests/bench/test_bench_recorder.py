"""Everything received is on disk, whatever the line, the network or the machine does."""

from __future__ import annotations

import json
import os
import pty
import random
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

from tumble.bench.follow.samples import Clock
from tumble.bench.record.order import Order
from tumble.bench.record.recorder import Intake, Recorder
from tumble.bench.record.virtual_table import VirtualTable
from tumble.bench.session_folder import (
    MOTIONCAL_LOG,
    begin,
    begin_next,
    in_si,
    leave_out,
    session_to_record,
)
from tumble.errors import InputError
from tumble.recording.live.lines import MOTIONCAL_COLUMNS, Lines, Row, numbers_in
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
from tumble.recording.session import Exclusion
from tumble.recording.session_file import read_session
from tumble.units import G_STANDARD

COLUMNS = ("t", "ax", "ay", "az", "gx", "gy", "gz")
HEADER = ",".join(COLUMNS)
RATE = 100.0


def row(k: int) -> str:
    """The k-th row of a log, from 1."""
    return f"{k / RATE!r},0.1,9.8,-0.2,0.001,{k * 1e-6!r},0.003"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "launch"
    begin(made, log=in_si(), serial="A-1", site={"latitude_deg": 50.0}, programme=None)
    return made


def log_of(folder: Path) -> list[str]:
    return (folder / "log.csv").read_text().splitlines()


def eventually(what: Callable[[], bool], seconds: float = 10.0) -> None:
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.01)


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
    parser = lines()
    found = parser.feed(garbage.replace(b"\n", b"") + b"\n" + row(1).encode() + b"\n")
    assert row(1) in [r.text for r in found]


def test_a_header_says_in_what_order_the_values_are() -> None:
    found = lines().feed(b"gx,gy,gz,ax,ay,az,t,extra\n4,5,6,1,2,3,0.5,9\n")
    assert [(r.text, r.time) for r in found] == [("0.5,1,2,3,4,5,6", 0.5)]


def test_json_lines_are_rows_by_name() -> None:
    sent = {"gz": 6, "t": 0.5, "ax": 1, "ay": 2, "az": 3, "gx": 4, "gy": 5.5, "<b>": "x"}
    assert lines().feed(json.dumps(sent).encode() + b"\n") == [Row(text="0.5,1.0,2.0,3.0,4.0,5.5,6.0", time=0.5)]


@pytest.mark.parametrize(
    "bad",
    [
        b"\xff\xfe\x00",
        b"1,2,3",
        b"0.1,1,2,x,4,5,6",
        b"nan,1,2,3,4,5,6",
        b"0.1,inf,2,3,4,5,6",
        b'{"t": 1}',
        b"{",
        b'{"t": 1e999}',
    ],
)
def test_what_is_no_row_is_refused_and_said(bad: bytes) -> None:
    refused: list[bytes] = []
    parser = lines(refused=refused)
    assert parser.feed(bad + b"\n") == []
    assert parser.refused == 1
    assert refused == [bad]
    assert parser.last_refused


def test_motioncal_lines_get_the_time_of_their_arrival() -> None:
    found = lines(MOTIONCAL_COLUMNS).feed(b"Raw:-8,16,8192,1,-2,3,250,-31,412\n")
    assert found == [Row(text="5.0,-8,16,8192,1,-2,3,25.0,-3.1,41.2", time=5.0)]


# -------------------- order --------------------


def _in_order(sent: list[int], *, unordered: bool = True) -> tuple[list[str], Order]:
    order = Order(unordered=unordered, seconds=1.0, refuse=lambda _: None, now=lambda: 0.0)
    out = [text for k in sent for text in order.feed([Row(text=str(k), time=k / RATE)])]
    return out + order.end(), order


@given(st.randoms(use_true_random=False), st.integers(1, 20))
def test_rows_exchanged_and_repeated_on_the_way_come_in_order_and_once(rng: random.Random, far: int) -> None:
    sent = sorted(range(10, 200), key=lambda k: k + rng.uniform(0, far))
    sent = [1, 2, 3, 4, 5, 6, 7, 8, 9, *(k for k in sent for _ in range(rng.choice([1, 1, 2])))]
    out, order = _in_order(sent)
    assert out == [str(k) for k in range(1, 200)]
    assert order.repeated == len(sent) - 199


def test_a_lost_row_holds_up_others_for_a_tenth_of_a_second_only() -> None:
    clock = [0.0]
    order = Order(unordered=True, seconds=1.0, refuse=lambda _: None, now=lambda: clock[0])
    order.feed([Row(text=str(k), time=k / RATE) for k in (1, 2, 3)])
    assert order.feed([Row(text="5", time=0.05)]) == []
    clock[0] = 0.11
    assert order.feed([]) == ["5"]
    assert order.feed([Row(text="4", time=0.04), Row(text="6", time=0.06)]) == ["6"]
    assert order.late == 1


def test_a_clock_that_starts_anew_is_said() -> None:
    out, order = _in_order([*range(1000, 1010), *range(1, 10)], unordered=False)
    assert order.restarted
    assert order.late == 9
    assert out == [str(k) for k in range(1000, 1010)]


DAMAGED = st.floats(allow_nan=False, allow_infinity=False) | st.sampled_from([900.5, 1e308, -1e308, 0.0])


@given(
    st.dictionaries(st.integers(0, 39).map(lambda k: 5 * k), DAMAGED, max_size=12),
    st.lists(st.integers(1, 30), min_size=1, max_size=30),
    st.booleans(),
)
def test_damaged_times_cost_their_own_rows_alone(damaged: dict[int, float], cuts: list[int], unordered: bool) -> None:
    sent = [Row(text=str(k), time=damaged.get(k, 10.0 + k / RATE)) for k in range(200)]
    order, out = Order(unordered=unordered, seconds=1.0, refuse=lambda _: None), []
    for cut in [*cuts, len(sent)]:
        piece, sent = sent[:cut], sent[cut:]
        times = np.array([float(row.time or 0.0) for row in piece])
        out += [row.text for row in piece] if len(piece) and order.passes(times) else order.feed(piece)
    out += order.end()
    assert {str(k) for k in range(3, 200) if k not in damaged} <= set(out)
    assert not order.restarted


def test_a_time_that_leaps_is_not_recorded_and_a_pause_is() -> None:
    refused: list[bytes] = []
    order = Order(unordered=False, seconds=1e-3, refuse=refused.append)
    times = [10.0, 20.0, 30.0, 900_500.0, 40.0, 1e308, 1e308, 50.0, 700_000.0, 700_010.0, 700_020.0, 700_030.0]
    out = order.feed([Row(text=f"{at}", time=at) for at in times])
    assert out == [f"{at}" for at in times if at < 800_000.0]
    assert refused == [b"900500.0", b"1e+308"]
    assert (order.leapt, order.repeated, order.late) == (2, 1, 0)


def test_rows_that_are_sent_again_after_a_pause_are_counted() -> None:
    order = Order(unordered=False, seconds=1.0, refuse=lambda _: None, last=1.0)
    assert order.feed([Row(text=str(k), time=k / RATE) for k in range(50, 110)]) == [str(k) for k in range(101, 110)]
    assert (order.repeated, order.late, order.restarted) == (51, 0, False)


def test_rows_of_a_slow_unit_pass() -> None:
    out, _ = _in_order([3000 * k for k in range(10)], unordered=False)
    assert out == [str(3000 * k) for k in range(10)]


# -------------------- recorder --------------------


def test_a_recording_goes_on_after_a_line_that_was_cut(folder: Path) -> None:
    path = folder / "log.csv"
    path.write_text(f"{HEADER}\n{row(1)}\n{row(2)[:9]}")
    recorder = Recorder(path, HEADER)
    recorder.append([row(3)])
    recorder.close()
    assert log_of(folder) == [HEADER, row(1), row(3)]
    assert (folder / "refused.txt").read_text() == row(2)[:9] + "\n"


def test_two_cannot_record_one_log_and_no_log_of_other_columns_is_touched(folder: Path) -> None:
    recorder = Recorder(folder / "log.csv", HEADER)
    with pytest.raises(InputError, match="another process"):
        Recorder(folder / "log.csv", HEADER)
    recorder.close()
    with pytest.raises(InputError, match="expected the columns a,b"):
        Recorder(folder / "log.csv", "a,b")
    assert log_of(folder) == [HEADER]


def test_a_full_disk_is_said_and_nothing_is_lost(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = Recorder(folder / "log.csv", HEADER)
    write, full = os.write, [True]

    def limited(descriptor: int, data: bytes) -> int:
        if full[0]:
            raise OSError(28, "No space left on device")
        return write(descriptor, data[:7])

    monkeypatch.setattr(os, "write", limited)
    recorder.append([row(1)])
    assert "No space left" in str(recorder.trouble)
    full[0] = False
    recorder.append([row(2)])
    assert recorder.trouble is None
    recorder.close()
    assert log_of(folder) == [HEADER, row(1), row(2)]


class FullDisk:
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


def test_lines_that_neither_disk_nor_memory_takes_are_lost_whole(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [f"0.{k:02},1,2,3,4,5,6" for k in range(1, 13)]
    monkeypatch.setattr("tumble.bench.record.recorder.KEPT_BYTES", 4 * len(rows[0]) + 10)
    recorder = Recorder(folder / "log.csv", HEADER)
    disk = FullDisk(monkeypatch, len(rows[0]) + 10)
    for line in rows[:-1]:
        recorder.append([line])
    disk.room = 1 << 20
    recorder.append(rows[-1:])
    assert log_of(folder)[1:] == [*rows[:5], rows[-1]]
    assert recorder.trouble == "6 samples are lost, which the disk did not take"
    recorder.close()


def test_a_recording_that_ends_on_a_full_disk_ends_with_a_whole_line(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = Recorder(folder / "log.csv", HEADER)
    FullDisk(monkeypatch, len(row(1)) + 10)
    recorder.append([row(1), row(2), row(3)])
    recorder.close()
    assert log_of(folder)[1:] == [row(1)]
    assert recorder.trouble == "2 samples are lost, which the disk did not take"


def test_a_machine_that_lost_its_power_leaves_whole_lines(folder: Path) -> None:
    path = folder / "log.csv"
    path.write_bytes(f"{HEADER}\n{row(1)}\n".encode() + bytes(3 << 20))
    recorder = Recorder(path, HEADER)
    recorder.append([row(2)])
    recorder.close()
    assert log_of(folder) == [HEADER, row(1), row(2)]


class Faulty:
    """A source of rows, which fails in other ways than sources are known to."""

    name, unordered, trouble = "faulty", False, None

    def __init__(self) -> None:
        self.sent = 0

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
    intake = _recorded(folder, Faulty(), lambda: None, 8)
    assert log_of(folder)[1:] == [row(k) for k in (1, 2, 3, 4, 7, 8, 9, 10)]
    assert "an error of the program while receiving (ZeroDivisionError: a driver)" in intake.received["trouble"]


def test_a_folder_that_is_gone_is_said_and_the_recording_goes_on(folder: Path) -> None:
    recorder = Recorder(folder / "log.csv", HEADER)
    (folder / "log.csv").unlink()
    (folder / "session.toml").unlink()
    folder.rmdir()
    recorder.refuse(b"no row")
    assert "No such file" in str(recorder.trouble)
    recorder.append([row(1)])
    recorder.hold([row(2)])
    assert "No such file" in str(recorder.trouble)
    recorder.close()


# -------------------- sources --------------------


def _recorded(folder: Path, source: object, sent: Callable[[], None], until: int) -> Intake:
    intake = Intake(source, session_to_record(folder))  # type: ignore[arg-type]
    intake.start()
    try:
        sent()
        eventually(lambda: intake.rows >= until)
    finally:
        intake.stop()
    return intake


def test_udp_with_loss_repetition_and_exchange(folder: Path) -> None:
    source, rng = Udp("127.0.0.1", 0), random.Random(3)
    numbers = [k for k in range(1, 400) if k <= 20 or k >= 390 or rng.random() > 0.02]
    sent = sorted(
        (k for k in numbers for _ in range(1 + (rng.random() < 0.1))), key=lambda k: k + rng.uniform(0, 4) * (k > 20)
    )

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            for k in sent:
                out.sendto(row(k).encode(), ("127.0.0.1", source.port))
                time.sleep(0.0005)

    intake = _recorded(folder, source, send, len(numbers))
    assert log_of(folder) == [HEADER, *(row(k) for k in numbers)]
    assert intake.received["repeated"] == len(sent) - len(numbers)


def test_tcp_connections_one_after_the_other(folder: Path) -> None:
    source = Tcp("127.0.0.1", 0)

    def send() -> None:
        for first in (1, 51):
            with socket.create_connection(("127.0.0.1", source.port)) as out:
                out.sendall(
                    "".join(f"{row(k)}\n" for k in range(first, first + 50)).encode() + row(first + 50)[:5].encode()
                )

    intake = _recorded(folder, source, send, 100)
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
            eventually(lambda: intake.rows == 10)
            with socket.create_connection(("127.0.0.1", source.port)) as successor:
                successor.sendall("".join(f"{row(k)}\n" for k in range(12, 22)).encode())
                eventually(lambda: intake.rows == 20)
    finally:
        intake.stop()
    assert log_of(folder)[1:] == [row(k) for k in range(1, 22) if k != 11]


@pytest.mark.parametrize("pieces", [1, 7, 400])
def test_a_time_that_leaps_costs_its_row_on_the_page_too(folder: Path, pieces: int) -> None:
    (folder / "log.csv").touch()
    sent = np.column_stack([np.arange(1, 401) / RATE, np.ones((400, 6))])
    sent[[150, 220, 300], 0] = [900.5, 1e308, 3.4]
    clock = Clock(read_session(folder).log)
    found = [clock.samples(rows) for rows in np.array_split(sent, pieces)]
    times = np.concatenate([chunk.time for chunk in found if chunk is not None])
    np.testing.assert_allclose(times, np.arange(1, 401) / RATE, rtol=1e-12)  # bridged, as in the calibration
    assert sum(gap.samples for gap in clock.gaps) == 3


def test_serial_line_with_garbage_half_lines_and_a_pulled_cable(folder: Path, tmp_path: Path) -> None:
    link, (master, slave) = tmp_path / "tty", pty.openpty()
    link.symlink_to(os.ttyname(slave))
    source = Serial(str(link), 115200)
    intake = Intake(source, session_to_record(folder))
    intake.start()
    try:
        os.write(
            master,
            row(1)[4:].encode()
            + b"\n\xff\xf0\x80\n"
            + f"{row(2)}\r\n{row(3)}\n{row(4)}\n".encode()
            + row(5)[:11].encode(),
        )
        eventually(lambda: intake.rows == 3)
        os.close(slave)
        os.close(master)
        eventually(lambda: intake.source.trouble is not None)
        assert "is gone" in " ".join(intake.received["trouble"])
        master, slave = pty.openpty()
        link.unlink()
        link.symlink_to(os.ttyname(slave))
        eventually(lambda: intake.source.trouble is None)
        os.write(master, f"{row(6)}\n{row(7)}\n".encode())
        eventually(lambda: intake.rows == 5)
    finally:
        intake.stop()
        os.close(slave)
        os.close(master)
    assert log_of(folder)[1:] == [row(k) for k in (2, 3, 4, 6, 7)]
    assert intake.received["refused"] == 3


def _sent(descriptor: int, data: bytes) -> None:
    os.write(descriptor, data)


def test_serial_line_of_a_motioncal_sketch(tmp_path: Path) -> None:
    folder = tmp_path / "launch"
    begin(folder, log=MOTIONCAL_LOG, serial="A", site={"latitude_deg": 50.0, "field": 50.0}, programme=None)
    master, slave = pty.openpty()
    source = Serial(os.ttyname(slave), 115200)
    _recorded(folder, source, lambda: _sent(master, b"Raw:1,2,8192,4,5,6,7,8,9\n" * 3), 3)
    os.close(master)
    os.close(slave)
    assert [line.split(",", 1)[1] for line in log_of(folder)[1:]] == ["1,2,8192,4,5,6,0.7,0.8,0.9"] * 3


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_mavlink_through_its_own_sender(folder: Path) -> None:
    from pymavlink import mavutil

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    source = Mavlink(f"udp:{port}")
    sender = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=1)

    def send() -> None:
        for k in range(1, 180):
            sender.mav.raw_imu_send(10_000 * k, 0, 0, 1000, 0, 0, 17, 0, 0, 0)
            sender.mav.scaled_imu2_send(10 * k, 1, 0, 1000, 0, 0, 17, 0, 0, 0)
            time.sleep(0.01)

    _recorded(folder, source, send, 20)
    sender.port.close()
    rows = np.array([[float(v) for v in line.split(",")] for line in log_of(folder)[1:]])
    np.testing.assert_allclose(np.diff(rows[:, 0]), 0.01, atol=1e-9)
    np.testing.assert_allclose(rows[0, 3], G_STANDARD)
    np.testing.assert_allclose(rows[0, 6], 0.017)


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_messages_of_an_autopilot_are_si() -> None:
    from pymavlink.dialects.v20 import common

    high = common.MAVLink_highres_imu_message(2_500_000, 1.0, 2.0, 9.8, 0.1, 0.2, 0.3, *([0.0] * 7), 0)
    assert line_of(high) == "2.5,1.0,2.0,9.8,0.1,0.2,0.3\n"
    scaled = common.MAVLink_scaled_imu_message(2500, 1000, 0, 0, 100, 0, 0, 0, 0, 0)
    assert [float(v) for v in line_of(scaled).split(",")] == pytest.approx([2.5, G_STANDARD, 0, 0, 0.1, 0, 0])


def test_a_file_that_grows(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "growing.csv"
    path.write_text(f"{HEADER}\n{row(1)}\n{row(2)[:5]}")

    def grow() -> None:
        time.sleep(0.2)
        with path.open("a") as file:
            file.write(row(2)[5:] + "\n" + row(3) + "\n" + row(4)[:3])

    _recorded(folder, GrowingFile(path), grow, 3)
    assert log_of(folder)[1:] == [row(1), row(2), row(3)]


def test_standard_input_to_its_end(folder: Path) -> None:
    out, into = os.pipe()
    os.write(into, f"{row(1)}\n{row(2)}\n{row(3)}".encode())
    os.close(into)
    intake = _recorded(folder, StandardInput(out), lambda: None, 2)
    os.close(out)
    assert log_of(folder)[1:] == [row(1), row(2), row(3)]
    assert intake.ended


def test_a_replay_is_the_log_to_the_byte_and_keeps_its_pace(folder: Path, tmp_path: Path) -> None:
    text = f"{HEADER}\n" + "".join(f"{row(k)}\n" for k in range(1, 201))
    (folder / "log.csv").write_text(text)
    copy = tmp_path / "copy"
    begin(copy, log=in_si(), serial="A-1", site={"latitude_deg": 50.0}, programme=None)
    started = time.monotonic()
    _recorded(copy, Replay(folder, 4.0), lambda: None, 200)
    assert time.monotonic() - started > 0.4  # never faster than asked
    assert (copy / "log.csv").read_text() == text


def test_the_virtual_table_sends_a_unit_in_si(folder: Path) -> None:
    table = VirtualTable("nine@50x")
    _recorded(folder, table, lambda: None, 300)
    rows = np.array([[float(v) for v in line.split(",")] for line in log_of(folder)[1:300]])
    np.testing.assert_allclose(np.linalg.norm(rows[:, 1:4], axis=1), 9.8, atol=0.5)
    table.mischief("knock")
    table.turn("N", 90.0)
    assert table.moving


@pytest.mark.parametrize(
    "text",
    ["udp:x", "udp:²", "serial:/dev/ttyX", "serial:/dev/ttyX:²", "replay:nowhere@0x", "what", "tcp:70000", "file:"],
)
def test_a_source_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InputError):
        source_of(text)


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
    source, rng, sent = tmp_path / "source.csv", random.Random(1), 0
    source.write_text(f"{HEADER}\n")
    for _ in range(5):
        process = subprocess.Popen([sys.executable, "-c", RECORDS, str(folder), str(source)])
        try:
            eventually(lambda: (folder / "log.csv").exists(), 30.0)
            end = time.monotonic() + rng.uniform(0.5, 1.5)
            while time.monotonic() < end:
                with source.open("a") as file:
                    for _ in range(rng.randint(1, 40)):
                        sent += 1
                        file.write(row(sent) + "\n")
                time.sleep(0.005)
        finally:
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
    intake = Intake(GrowingFile(source), session_to_record(folder))
    intake.start()
    eventually(lambda: len(log_of(folder)) == sent + 1)
    intake.stop()
    assert log_of(folder)[1:] == [row(k) for k in range(1, sent + 1)]
