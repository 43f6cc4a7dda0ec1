"""Rows as they come: what a line may be, and the sources that send them."""

from __future__ import annotations

import json
import os
import pty
import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tumble.errors import InputError, MissingExtraError
from tumble.recording.live.lines import MOTIONCAL_COLUMNS, Lines, Row, numbers_in
from tumble.recording.live.sources import Ended, LineSource, Mavlink, Serial, StandardInput, Tcp, line_of, source_of
from tumble.units import G_STANDARD

COLUMNS = ("t", "ax", "ay", "az", "gx", "gy", "gz")


def row(k: int) -> str:
    """The k-th row of a log, from 1."""
    return f"{k / 100!r},0.1,9.8,-0.2,0.001,{k * 1e-6!r},0.003"


def sent(*numbers: int) -> bytes:
    return "".join(f"{row(k)}\n" for k in numbers).encode()


def fed(parser: Lines, data: bytes) -> list[Row]:
    return parser.rows(parser.cut(data))


def lines(columns: tuple[str, ...] = COLUMNS, refused: list[bytes] | None = None) -> Lines:
    return Lines(columns=columns, clock="t", refuse=(refused if refused is not None else []).append, now=lambda: 5.0)


# -------------------- lines --------------------


@given(st.lists(st.integers(1, 40), min_size=1, max_size=30))
def test_rows_do_not_depend_on_how_the_bytes_are_cut(cuts: list[int]) -> None:
    data, parser, found, at = sent(*range(1, 20)), lines(), [], 0
    for cut in [*cuts, len(data)]:
        found += fed(parser, data[at : at + cut])
        at += cut
    assert [r.text for r in found] == [row(k) for k in range(1, 20)]
    assert parser.refused == 0


@given(st.lists(st.sampled_from("0123456789.,+-eE\n ax"), max_size=60))
def test_numbers_read_together_are_those_read_line_by_line(characters: list[str]) -> None:
    text = "0.5,1,2\n" + "".join(characters) + "\n"
    together, parser = numbers_in(text.encode(), 3), lines(("t", "ax", "ay"))
    one_by_one = fed(parser, text.encode())
    if together is not None:
        assert parser.refused == 0
        assert [r.text for r in one_by_one] == text.split("\n")[:-1]
        assert [[float(value) for value in r.text.split(",")] for r in one_by_one] == together.tolist()


@given(st.binary(max_size=200))
def test_garbage_is_refused_and_whole_rows_after_it_are_not(garbage: bytes) -> None:
    found = fed(lines(), garbage.replace(b"\n", b"") + b"\n" + sent(1))
    assert row(1) in [r.text for r in found]


def test_what_a_line_may_be() -> None:
    header_first = fed(lines(), b"gx,gy,gz,ax,ay,az,t,extra\n4,5,6,1,2,3,0.5,9\n")
    assert [(r.text, r.time) for r in header_first] == [("0.5,1,2,3,4,5,6", 0.5)]
    by_name = {"gz": 6, "t": 0.5, "ax": 1, "ay": 2, "az": 3, "gx": 4, "gy": 5.5, "<b>": "x"}
    assert fed(lines(), json.dumps(by_name).encode() + b"\n") == [Row(text="0.5,1.0,2.0,3.0,4.0,5.5,6.0", time=0.5)]
    motioncal = fed(lines(MOTIONCAL_COLUMNS), b"Raw:-8,16,8192,1,-2,3,250,-31,412\n")
    assert motioncal == [Row(text="5.0,-8,16,8192,1,-2,3,25.0,-3.1,41.2", time=5.0)]


@pytest.mark.parametrize(
    "bad",
    [
        b"\xff\xfe\x00", b"1,2,3", b"0.1,1,2,x,4,5,6", b"nan,1,2,3,4,5,6", b"0.1,inf,2,3,4,5,6", b'{"t": 1}', b"{",
        b'{"t": 1e999}', b"Raw:1,2,3,4,5,6,7,8,9",
    ],
)  # fmt: skip
def test_what_is_no_row_is_refused_and_said(bad: bytes) -> None:
    refused: list[bytes] = []
    parser = lines(refused=refused)
    assert fed(parser, bad + b"\n") == []
    assert (parser.refused, refused) == (1, [bad])
    assert parser.last_refused


# -------------------- sources --------------------


def received(source: LineSource, count: int, parser: Lines, *, until: Callable[[], bool] = lambda: False) -> list[str]:
    """The next rows of a source, as many as are wanted, or until something is so or the source ends."""
    found, end = list[str](), time.monotonic() + 20.0
    while len(found) < count and not until():
        assert time.monotonic() < end, "it did not happen"
        try:
            found += [r.text for r in fed(parser, source.read(0.01))]
        except Ended:
            found += [r.text for r in fed(parser, b"\n")]
            break
    return found


def test_tcp_connections_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second when the first has ended, the third although the second is still there: it has lost its power."""
    monkeypatch.setattr("tumble.recording.live.sources._SILENT_SECONDS", 0.05)
    source, parser = Tcp("127.0.0.1", 0), lines()
    with socket.create_connection(("127.0.0.1", source.port)) as first:
        first.sendall(sent(1, 2) + row(3)[:5].encode())
    assert received(source, 2, parser) == [row(1), row(2)]
    with socket.create_connection(("127.0.0.1", source.port)) as dead:
        dead.sendall(sent(4) + row(5)[:5].encode())
        assert received(source, 1, parser) == [row(4)]
        with socket.create_connection(("127.0.0.1", source.port)) as third:
            third.sendall(sent(6))
            assert received(source, 1, parser) == [row(6)]
    source.close()
    assert parser.refused == 2  # the rows that were cut


def test_serial_line_with_garbage_half_lines_and_a_pulled_cable(tmp_path: Path) -> None:
    link, (master, slave), parser = tmp_path / "tty", pty.openpty(), lines()
    link.symlink_to(os.ttyname(slave))
    source = Serial(str(link), 115200)
    whole = f"{row(2)}\r\n{row(3)}\n{row(4)}\n".encode()
    os.write(master, row(1)[4:].encode() + b"\n\xff\xf0\x80\n" + whole + row(5)[:11].encode())
    assert received(source, 3, parser) == [row(2), row(3), row(4)]
    os.close(slave)
    os.close(master)
    assert received(source, 1, parser, until=lambda: source.trouble is not None) == []
    assert "is gone" in str(source.trouble)
    master, slave = pty.openpty()
    link.unlink()
    link.symlink_to(os.ttyname(slave))
    assert received(source, 1, parser, until=lambda: source.trouble is None) == []
    os.write(master, sent(6, 7))
    assert received(source, 2, parser) == [row(6), row(7)]
    assert parser.refused == 3
    for opened in (master, slave):
        os.close(opened)
    source.close()


def test_standard_input_to_its_end() -> None:
    out, into = os.pipe()
    os.write(into, sent(1, 2) + row(3).encode())
    os.close(into)
    assert received(StandardInput(out), 9, lines()) == [row(1), row(2), row(3)]
    os.close(out)


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_mavlink_through_its_own_sender(monkeypatch: pytest.MonkeyPatch) -> None:
    mavutil = pytest.importorskip("pymavlink.mavutil")
    from pymavlink.dialects.v20 import common

    monkeypatch.setattr("tumble.recording.live.sources._CHOOSE_SECONDS", 0.05)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    source, parser, found, k = Mavlink(f"udp:{port}"), lines(), list[str](), 0
    sender = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=1)
    while len(found) < 20:
        k += 1
        sender.mav.raw_imu_send(10_000 * k, 0, 0, 1000, 0, 0, 17, 0, 0, 0)
        sender.mav.scaled_imu2_send(10 * k, 1, 0, 1000, 0, 0, 17, 0, 0, 0)
        found += [r.text for r in fed(parser, source.read(0.01))]
    sender.port.close()
    source.close()
    rows = np.array([[float(v) for v in line.split(",")] for line in found])
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


@pytest.mark.parametrize(
    "listen",
    [
        "",
        "udp:x",
        "udp:²",
        "tcp:70000",
        "serial:/dev/ttyX",
        "serial:/dev/ttyX:²",
        "replay:nowhere@0x",
        "simulator",
        "file:",
    ],
)
def test_a_source_that_is_none_is_refused(listen: str) -> None:
    with pytest.raises(InputError):
        source_of(listen)
