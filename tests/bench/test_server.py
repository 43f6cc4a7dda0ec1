"""Who may see and who may command, and what strangers may do to the server."""

from __future__ import annotations

import logging
import os
import re
import signal
import socket
import stat
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.support.bench_driver import TOKEN, Bench, served
from tests.support.browser import eventually
from tumble.bench import results
from tumble.bench.commands import bench as bench_command
from tumble.bench.web import connections, server
from tumble.bench.web.access import Access, lasting_token
from tumble.cli import main
from tumble.errors import CalibrationError

NEW = ["--serial", "A-1", "--latitude", "50"]


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    made = Bench(tmp_path / "launch")
    yield made
    made.close()


@dataclass(kw_only=True)
class Page:
    """What a page asks of a server."""

    origin: str
    token: str

    @property
    def port(self) -> int:
        return int(self.origin.rsplit(":", 1)[1])

    @property
    def cookie(self) -> str:
        return f"tumble_bench_{self.port}={self.token}"

    def ask(
        self, path: str, *, method: str = "GET", body: bytes | None = None, **headers: str
    ) -> tuple[int, str, dict[str, str]]:
        """Status, text and headers of an answer."""
        request = urllib.request.Request(self.origin + path, data=body, method=method, headers=headers)
        try:
            with urllib.request.urlopen(request, timeout=20.0) as answer:
                return answer.status, answer.read().decode(), dict(answer.headers)
        except urllib.error.HTTPError as error:
            with error:
                return error.code, error.read().decode(), dict(error.headers)

    def head(self, method: str, path: str, length: int = 0) -> bytes:
        lines = [f"{method} {path} HTTP/1.1", f"Host: 127.0.0.1:{self.port}", f"Origin: {self.origin}"]
        return "\r\n".join([*lines, f"Cookie: {self.cookie}", f"Content-Length: {length}", "", ""]).encode()

    def connected(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.port), timeout=20.0)

    def command(self, body: bytes, length: int | None = None) -> bytes:
        """The answer to a command of which so much is sent."""
        with self.connected() as sent:
            sent.sendall(self.head("POST", "/command", len(body) if length is None else length) + body)
            answer = sent.recv(1 << 16)
            return answer if answer.endswith((b"}", b"command")) else answer + sent.recv(1 << 16)


@pytest.fixture
def page(bench: Bench) -> Iterator[Page]:
    with served(bench.station) as link:
        origin, token = link.split("/?token=")
        yield Page(origin=origin, token=token)


# -------------------- what is refused --------------------


def test_commands_need_the_token_and_a_page_of_this_server(page: Page) -> None:
    def command(**headers: str) -> int:
        return page.ask("/command", method="POST", body=b'{"do": "go_on"}', **headers)[0]

    assert command() == 403
    assert command(Origin=page.origin) == 403
    assert command(Cookie=page.cookie) == 403
    assert command(Cookie=page.cookie, Origin="http://evil.example") == 403
    assert command(Cookie=page.cookie[:-1], Origin=page.origin) == 403
    assert command(Cookie=page.cookie, Origin=page.origin) == 200
    assert page.ask("/?token=wrong")[0] == 403
    way_in = page.ask(f"/?token={TOKEN}")
    assert way_in[0] == 200
    assert "HttpOnly; " in way_in[2]["set-cookie"]
    assert "SameSite=strict" in way_in[2]["set-cookie"]


def test_other_names_are_not_answered_to(page: Page) -> None:
    for path, host in (("/", "evil.example"), ("/events", f"evil.example:{page.port}")):
        assert page.ask(path, Host=host)[0] == 421
    near = Access(host="127.0.0.1", port=8422, token="t" * 20)
    assert all(near.answers_to(f"{name}:8422") for name in ("127.0.0.1", "localhost", "[::1]"))
    wrong = (
        "evil.example:8422", "127.0.0.1:80", "127.0.0.1", "192.168.0.7:8422", "", None, "[:8422",
        "localhost.evil.example:8422",
    )  # fmt: skip
    assert not any(near.answers_to(name) for name in wrong)
    assert not any(near.is_token(token) for token in (None, "ttttttttttttttttttté"))
    far = Access(host="0.0.0.0", port=8422, token="t" * 20)
    assert far.answers_to("192.168.0.7:8422")
    assert not far.answers_to("evil.example:8422")
    proxied = Access(host="bench.example", port=8422, token="t" * 20)  # a proxy that encrypts stands before it
    assert proxied.answers_to("bench.example")
    assert proxied.same_origin("https://bench.example", "bench.example")
    assert not any(proxied.same_origin(origin, "bench.example") for origin in ("https://evil.example", "null", None))


def test_answers_have_a_strict_policy_and_bad_requests_are_refused(page: Page) -> None:
    for path in ("/", "/nothing", "/assets/bench.js"):
        policy = page.ask(path)[2]["content-security-policy"]
        assert policy.startswith("default-src 'none'")
        assert "unsafe" not in policy
    for body in (b"", b"[]", b"{", b'{"do": 1e999}', b"[" * 3000, b"x" * 5000):
        status, _, _ = page.ask("/command", method="POST", body=body, Cookie=page.cookie, Origin=page.origin)
        assert status in (200, 400)
    refused = (
        "/assets/../server.py", "/assets/%2e%2e/server.py", "/files/session.toml", "/files/..%2fsession.toml",
        "/picture/99.svg", "/picture/-1.svg", "/picture/x.svg",
    )  # fmt: skip
    for path in refused:
        assert page.ask(path)[0] == 404
    assert page.ask("/picture/0.svg")[1].startswith("<svg")
    assert page.ask("/favicon.ico")[0] == 204
    assert page.ask("/command", Cookie=page.cookie)[0] == 405


# -------------------- what strangers may do --------------------


def test_buttons_answer_while_a_calibration_is_made(bench: Bench, page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    ends = threading.Event()

    def calibrated(*_: object) -> None:
        ends.wait(60.0)
        raise CalibrationError("ended")

    monkeypatch.setattr(results, "calibrate_folder", calibrated)
    with ThreadPoolExecutor(1) as asking, ExitStack() as streams:
        for _ in range(12):
            streams.enter_context(page.connected()).sendall(page.head("GET", "/events"))
        calibrating = asking.submit(page.command, b'{"do": "calibrate"}')
        eventually(lambda: bench.station.command("go_on").startswith("calibrating"), every=0.01)
        assert b"calibrating: wait until it is done" in page.command(b'{"do": "go_on"}')
        ends.set()
        assert b"ended" in calibrating.result()


def test_a_body_that_is_too_long_or_does_not_come_is_given_up_without_a_word(
    page: Page, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    assert b" 400 " in page.command(b"x" * 9000, length=1 << 31)
    with page.connected() as gone:
        gone.sendall(page.head("POST", "/command", 100) + b'{"do"')
    monkeypatch.setattr(server, "_COMMAND_SECONDS", 0.1)
    assert b" 400 " in page.command(b'{"do":', length=100)
    assert b" 200 " in page.command(b'{"do": "go_on"}')
    assert [record for record in caplog.records if record.levelno >= logging.WARNING] == []


def test_idle_connections_give_way_to_a_page(
    page: Page, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(connections, "max_connections", lambda: 6)
    with ExitStack() as opened:
        idle = [opened.enter_context(page.connected()) for _ in range(40)]
        idle[-1].sendall(b"GET / HTT")
        for _ in range(3):
            assert page.ask("/")[0] == 200
        assert sum(map(_is_ended, idle)) >= 34
    monkeypatch.setattr(connections, "REQUEST_SECONDS", 0.1)
    with page.connected() as slow:
        slow.sendall(b"GET / HTT")
        eventually(lambda: _is_ended(slow))
    assert caplog.records == []


def test_streams_without_the_token_leave_room_for_those_with_it(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "max_connections", lambda: 8)

    def streams(count: int, head: bytes) -> list[bytes]:
        begun = [opened.enter_context(page.connected()) for _ in range(count)]
        for one in begun:
            one.sendall(head)
        return [one.recv(1 << 10).split(b" ")[1] for one in begun]

    known = page.head("GET", "/events")
    unknown = known.replace(b"Cookie", b"Cake")
    with ExitStack() as opened:
        assert sorted(streams(7, unknown)) == 4 * [b"200"] + 3 * [b"503"]
        assert streams(3, known) == 3 * [b"200"]
        assert page.ask("/")[0] == 200
    eventually(lambda: page.ask("/picture/0.svg")[0] == 200)
    with ExitStack() as opened:
        eventually(lambda: streams(1, unknown) == [b"200"])


def _is_ended(connection: socket.socket) -> bool:
    connection.setblocking(False)
    try:
        return connection.recv(1) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True


# -------------------- the token --------------------


def test_a_token_lasts_and_is_made_anew_where_others_could_read_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    first, kept = lasting_token(), tmp_path / "tumble" / "bench-token"
    assert lasting_token() == first
    kept.chmod(0o644)
    assert lasting_token() != first
    assert stat.S_IMODE(kept.stat().st_mode) == 0o600
    kept.write_bytes(b"\xff" * 30)
    assert len(lasting_token()) >= 32
    monkeypatch.setenv("TUMBLE_BENCH_TOKEN", TOKEN)
    assert lasting_token() == TOKEN
    monkeypatch.setenv("TUMBLE_BENCH_TOKEN", "short")
    assert len(lasting_token()) >= 32


# -------------------- the command --------------------


def test_beyond_the_loopback_nothing_is_answered_without_the_token(tmp_path: Path) -> None:
    """`tumble bench` in a process of its own: the link has the token, and nothing else that it says."""
    words = ["bench", str(tmp_path / "launch"), "--listen", "udp:0", *NEW, "--port", "0", "--host", "0.0.0.0"]
    process = subprocess.Popen(
        [sys.executable, "-c", f"from tumble.bench.commands import bench; bench({words[1:]!r})"],
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"XDG_STATE_HOME": str(tmp_path / "state")},
    )
    assert process.stderr is not None
    try:
        said = process.stderr.readline()
        found = re.search(r"http://\S+", said)
        assert found is not None, said + process.stderr.read()
        origin, token = found[0].split("/?token=")
        page = Page(origin=f"http://127.0.0.1:{origin.rsplit(':', 1)[1]}", token=token)
        eventually(lambda: page.ask("/", Cookie=page.cookie)[0] == 200)
        for path in ("/", "/events", "/assets/bench.js", "/picture/0.svg", "/nothing"):
            assert page.ask(path)[0] == 403
        page.ask(f"/?token={token}")
    finally:
        process.send_signal(signal.SIGINT)
        said += process.communicate(timeout=30.0)[1]
    assert said.count(token) == 1
    assert "▀" in said  # the link as a QR code
    assert "Traceback" not in said
    kept = tmp_path / "state" / "tumble" / "bench-token"
    assert kept.stat().st_mode & 0o077 == 0
    assert kept.read_text() == token


def test_what_cannot_begin_is_said_and_leaves_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An address or a source that is taken; a library that is not there."""
    main.add_command(bench_command)

    def refused(*words: str) -> str:
        result = CliRunner().invoke(main, ["bench", str(tmp_path / "new"), *words, *NEW])
        assert result.exit_code == 2
        assert list(tmp_path.iterdir()) == []
        return result.stderr

    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert "expected a free address" in refused("--listen", "udp:0", "--port", str(taken.getsockname()[1]))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        source = f"udp:127.0.0.1:{taken.getsockname()[1]}"
        assert "expected a port that is free" in refused("--listen", source, "--port", "0")
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    assert "pip install 'tumble[bench]'" in refused("--listen", "udp:0")
