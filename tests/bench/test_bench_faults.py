"""What fails beside the recording costs the operator nothing: crashed calibrations, estimates, units that are refused;
and what strangers may do to the server."""

from __future__ import annotations

import logging
import shutil
import socket
import stat
import threading
import time
import urllib.request
import webbrowser
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support import ROOT
from tests.support.bench_driver import SITE, TOKEN, Bench, served
from tests.support.browser import eventually
from tumble.bench import results
from tumble.bench.station import Station, station_of
from tumble.bench.web import connections, serve, server
from tumble.bench.web.access import Access, lasting_token
from tumble.errors import CalibrationError, InputError
from tumble.recording.session_file import read_session

EXAMPLE = ROOT / "docs/reference/export/example.json"
NOT_STOPPED = threading.Event()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    made = Bench(tmp_path / "launch")
    yield made
    made.close()


@pytest.fixture
def recording(tmp_path: Path) -> Iterator[Station]:
    """A bench that records a unit on the virtual table."""
    station = station_of(tmp_path / "launch", "simulator:nine@40x", site=SITE)
    station.start()
    yield station
    station.stop()


def rows(station: Station) -> int:
    return (station.folder / "log.csv").read_text().count("\n")


def grows(station: Station) -> None:
    before = rows(station)
    eventually(lambda: rows(station) > before + 20)


# -------------------- the calibration --------------------


@pytest.fixture
def child(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What the process that calibrates does, in place of tumble: Python that knows the file `out` it is to write."""
    package = tmp_path / "path" / "tumble"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    monkeypatch.setenv("PYTHONPATH", str(package.parent))
    return package / "__main__.py"


def does(child: Path, code: str) -> None:
    child.write_text(f"import shutil, sys\nout = sys.argv[sys.argv.index('--out') + 1]\n{code}\n")


WRITES = f"shutil.copyfile({str(EXAMPLE)!r}, out)"


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("raise ValueError('Out of range')", "has ended without a result; ValueError: Out of range"),
        ("sys.exit(0)", "has ended without a result"),
        (f"{WRITES}; sys.exit(1)", "expected a result that agrees with how it has ended, accepted: False"),
        (f"{WRITES}; sys.exit(70)", "ended with the status 70"),
        ("print('tumble: an error of the program: x', file=sys.stderr); sys.exit(70)", "an error of the program: x"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", "ended with the status -9"),
        ("print('{', file=open(out, 'w'))", "expected"),
    ],
)
def test_a_crash_is_no_verdict_and_an_old_calibration_no_new_one(
    child: Path, bench: Bench, code: str, said: str
) -> None:
    station = bench.station
    does(child, WRITES)
    assert station.command("calibrate") == "calibrated: accepted"
    station.step()
    assert bench.state["result"]["accepted"]
    before = (station.folder / "calibration.json").read_bytes()
    does(child, code)
    assert said in station.command("calibrate")
    station.step()
    assert station.state["result"] is None
    assert not station.state["calibrating"]
    assert station.command("report") == "nothing is calibrated yet"
    assert station.file("calibration.json") is None
    assert (station.folder / "calibration.json").read_bytes() == before
    assert {path.name for path in station.folder.iterdir()} == {"calibration.json", "log.csv", "session.toml"}


def test_a_report_is_written_beside_its_calibration(bench: Bench) -> None:
    shutil.copyfile(EXAMPLE, bench.station.folder / "calibration.json")
    assert results.report_of(bench.station.folder, NOT_STOPPED) == "report.html"
    assert "<html" in (bench.station.folder / "report.html").read_text()


def test_an_error_of_this_program_does_not_leave_the_page_calibrating(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(results, "calibrated", lambda *_: [][1])
    said = bench.station.command("calibrate")
    assert said == "calibrate: not done (IndexError: list index out of range)"
    assert bench.station.command("go_on") == "going on"


def test_what_is_left_out_makes_a_result_an_old_one(child: Path, bench: Bench) -> None:
    bench.until(lambda: bench.screen == "rest")
    bench.run(3.0)
    does(child, WRITES)
    bench.station.command("calibrate")
    bench.station.command("leave_out", "1")
    bench.run(0.2)
    assert bench.state["excluded"] == 1
    assert bench.state["result"] is None


def test_no_module_of_the_working_folder_is_run(bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hostile = tmp_path / "from a mail"
    hostile.mkdir()
    for name in ("click", "tumble", "json", "numpy"):
        (hostile / f"{name}.py").write_text(f"open({str(tmp_path / 'run')!r}, 'w').close()\nraise SystemExit(0)\n")
    monkeypatch.chdir(hostile)
    with pytest.raises(CalibrationError, match=r"log\.csv"):
        results.calibrated(bench.station.folder, NOT_STOPPED)
    assert not (tmp_path / "run").exists()


def test_a_calibration_ends_with_the_bench(child: Path, bench: Bench) -> None:
    does(child, "import time; time.sleep(600)")
    stopped = threading.Event()
    threading.Timer(0.3, stopped.set).start()
    with pytest.raises(CalibrationError, match="ended with the status -15"):
        results.calibrated(bench.station.folder, stopped)


# -------------------- estimates, buttons, units --------------------


def test_an_estimate_that_fails_is_said_and_the_next_is_made(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def estimated() -> Any:
        bench.run(0.2)
        return bench.state["estimate"]

    with monkeypatch.context() as patched:
        patched.setattr("tumble.bench.follow.estimates.estimate_so_far", lambda *_: [][1])
        bench.take(1)
        bench.take(2)
        eventually(lambda: estimated() is not None)
        assert "the estimate has failed (IndexError" in bench.state["estimate"]["cause"]
    bench.take(3)
    eventually(lambda: estimated()["rests"] == 3, 100.0)
    assert bench.state["estimate"]["groups"]


def test_a_source_that_stutters_leaves_few_faults(bench: Bench) -> None:
    rows = [bench.table.line().split(",", 1)[1] for _ in range(100)]
    times = [0.01 * k for k in range(1, 1001)] + [10.0 + 0.4 * k for k in range(1, 301)]
    bench.file.writelines(f"{at:.2f},{rows[k % 100]}" for k, at in enumerate(times))
    bench.file.flush()
    bench.station.step()
    assert bench.state["received"]["lost"] == 299 * 39
    assert len(bench.station._live.faults) == 64


def test_a_state_that_cannot_be_made_is_said(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench.station, "step", lambda: [][1])
    bench.station.start()
    eventually(lambda: "the page stands still" in bench.state["message"])


def test_a_recording_goes_on_after_it_was_stopped(recording: Station) -> None:
    grows(recording)
    assert recording.command("stop") == "recording has stopped"
    before = rows(recording)
    assert recording.command("resume") == "recording goes on"
    eventually(lambda: rows(recording) > before + 50)
    recording.command("stop")
    times = np.loadtxt(recording.folder / "log.csv", delimiter=",", skiprows=1)[:, 0]
    assert (np.diff(times) > 0.0).all()


def test_a_next_unit_that_is_refused_does_not_stop_the_recording(
    recording: Station, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = recording.folder
    with monkeypatch.context() as patched:
        patched.setattr("tumble.bench.session_folder.begin_next", lambda *_: Path("no/such/folder").mkdir())
        assert "No such file" in recording.command("next_unit", "B-2")
    assert recording.folder == folder
    grows(recording)
    assert "expected 1 to 200 printable" in recording.command("next_unit", "9" * 400)
    assert recording.folder == folder
    grows(recording)
    assert recording.command("next_unit", "é" * 200) == f"next unit: {'é' * 200}"
    grows(recording)
    assert recording.command("next_unit", "]C1010461234567890\x1d10LOT\n") == "next unit: ]C1010461234567890 10LOT"
    grows(recording)
    assert read_session(recording.folder).device.serial == "]C1010461234567890 10LOT"


def test_a_source_that_cannot_be_opened_again_is_tried_again(
    recording: Station, monkeypatch: pytest.MonkeyPatch
) -> None:
    listen = recording._listen
    recording.command("stop")
    with monkeypatch.context() as patched:
        patched.setattr(recording, "_listen", lambda: (_ for _ in ()).throw(InputError("--listen: it is gone")))
        assert recording.command("resume") == "listen: it is gone"
    assert recording._listen is listen
    assert recording.command("resume") == "recording goes on"
    grows(recording)


def test_the_simulated_unit_is_where_it_is(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected those of the simulated unit, 56\.84°"):
        station_of(tmp_path / "launch", "simulator:nine", site={"latitude_deg": 50.0})
    assert not (tmp_path / "launch").exists()


# -------------------- the server --------------------


class Page:
    """What a page asks of a server."""

    def __init__(self, link: str) -> None:
        self.origin = link.split("/?")[0]
        self.port = int(self.origin.rsplit(":", 1)[1])

    def head(self, method: str, path: str, length: int = 0) -> bytes:
        lines = [f"{method} {path} HTTP/1.1", f"Host: 127.0.0.1:{self.port}", f"Origin: {self.origin}"]
        lines += [f"Cookie: tumble_bench_{self.port}={TOKEN}", f"Content-Length: {length}"]
        return "\r\n".join([*lines, "", ""]).encode()

    def connected(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.port), timeout=20.0)

    def command(self, body: bytes, length: int | None = None, path: str = "/command") -> bytes:
        """The answer to a command of which so much is sent."""
        with self.connected() as sent:
            sent.sendall(self.head("POST", path, len(body) if length is None else length) + body)
            answer = sent.recv(1 << 16)
            return answer if answer.endswith((b"}", b"command")) else answer + sent.recv(1 << 16)

    def status(self) -> int:
        with urllib.request.urlopen(self.origin + "/", timeout=20.0) as answer:
            return int(answer.status)


@pytest.fixture
def page(bench: Bench) -> Iterator[Page]:
    with served(bench.station) as link:
        yield Page(link)


def test_buttons_answer_while_others_calibrate(bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ends, others = threading.Event(), [Bench(tmp_path / f"other-{k}") for k in range(7)]

    def calibrated(*_: object) -> None:
        ends.wait(60.0)
        raise CalibrationError("ended")

    monkeypatch.setattr(results, "calibrated", calibrated)
    try:
        stations = bench.station, *(other.station for other in others)
        with served(*stations) as link, ThreadPoolExecutor(20) as asking, ExitStack() as open_streams:
            page = Page(link)
            streams = [open_streams.enter_context(page.connected()) for _ in range(12)]
            for k, stream in enumerate(streams):
                stream.sendall(page.head("GET", f"/{k % 8 + 1}/events"))

            def command(number: int, what: str) -> bytes:
                return page.command(f'{{"do": "{what}"}}'.encode(), path=f"/{number}/command")

            calibrating = [asking.submit(command, number, "calibrate") for number in range(2, 9)]
            eventually(lambda: all(other.station._busy for other in others))
            assert b"going on" in command(1, "go_on")
            assert b"calibrating: wait until it is done" in command(2, "go_on")
            ends.set()
            assert all(b"ended" in each.result() for each in calibrating)
    finally:
        for other in others:
            other.close()


def test_a_body_is_not_read_beyond_its_limit(page: Page) -> None:
    assert b" 400 " in page.command(b"x" * 9000, length=1 << 31)
    assert b" 200 " in page.command(b'{"do": "go_on"}')


def test_a_body_that_does_not_come_is_given_up(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "_COMMAND_SECONDS", 0.1)
    assert b" 400 " in page.command(b'{"do":', length=100)


def test_a_page_that_goes_away_says_nothing_on_the_terminal(page: Page, caplog: pytest.LogCaptureFixture) -> None:
    with page.connected() as sent:
        sent.sendall(page.head("POST", "/command", 100) + b'{"do"')
        time.sleep(0.1)
    for _ in range(3):
        assert b" 200 " in page.command(b'{"do": "go_on"}')
    assert [record for record in caplog.records if record.levelno >= logging.WARNING] == []


def test_idle_connections_give_way_to_a_page(
    page: Page, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(connections, "most_connections", lambda: 6)
    with ExitStack() as opened:
        idle = [opened.enter_context(page.connected()) for _ in range(40)]
        idle[-1].sendall(b"GET / HTT")
        for _ in range(3):
            assert page.status() == 200
        assert sum(map(_is_ended, idle)) >= 34
    assert caplog.records == []


def test_a_connection_without_a_request_ends(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "REQUEST_SECONDS", 0.1)
    with page.connected() as idle:
        idle.sendall(b"GET / HTT")
        eventually(lambda: _is_ended(idle))


def _is_ended(connection: socket.socket) -> bool:
    connection.setblocking(False)
    try:
        return connection.recv(1) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True


# -------------------- the token --------------------


def test_a_token_that_others_could_read_is_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    first, kept = lasting_token(), tmp_path / "tumble" / "bench-token"
    assert lasting_token() == first
    kept.chmod(0o644)
    second = lasting_token()
    assert second != first
    assert stat.S_IMODE(kept.stat().st_mode) == 0o600
    kept.write_bytes(b"\xff" * 30)
    assert len(lasting_token()) >= 32


def test_a_browser_is_told_a_file_and_no_token(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    monkeypatch.setattr(webbrowser, "open", told.append)
    with serve._in_browser(f"http://127.0.0.1:8422/?token={TOKEN}"):
        way = Path(told[0].removeprefix("file://"))
        assert TOKEN not in told[0]
        assert TOKEN in way.read_text()
        assert stat.S_IMODE(way.parent.stat().st_mode) == 0o700
    assert not way.exists()


def test_a_proxy_that_encrypts_may_stand_before_a_server_with_a_token() -> None:
    far = Access(host="bench.example", port=8422, token="t" * 20)
    assert far.answers_to("bench.example")
    assert far.same_origin("https://bench.example", "bench.example")
    assert not far.same_origin("https://evil.example", "bench.example")
    assert not far.same_origin("null", "bench.example")
    assert not far.same_origin(None, None)
    near = Access(host="127.0.0.1", port=8422, token="t" * 20)
    assert not near.answers_to("127.0.0.1")
