"""The page in a browser, and what its server refuses."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.browser import Browser, chromium, eventually, inaccessible
from tumble.bench.web.access import Access, lasting_token
from tumble.planning.setup import Setup
from tumble.simulation.session import simulate_session

EVIL = "<script>alert(1)</script>"
needs_browser = pytest.mark.skipif(chromium() is None, reason="no Chromium is installed")


@dataclass(kw_only=True)
class Server:
    """`tumble bench` in a process of its own."""

    process: subprocess.Popen[str]
    link: str
    said: str

    @property
    def origin(self) -> str:
        return self.link.split("/?")[0]

    @property
    def token(self) -> str:
        return self.link.split("token=")[1]

    def ask(
        self, path: str, *, method: str = "GET", body: bytes | None = None, **headers: str
    ) -> tuple[int, str, dict[str, str]]:
        """Status, text and headers of an answer."""
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        request = urllib.request.Request(self.origin + path, data=body, method=method, headers=named)
        try:
            with urllib.request.urlopen(request, timeout=10.0) as answer:
                return answer.status, answer.read().decode(), dict(answer.headers)
        except urllib.error.HTTPError as error:
            with error:
                return error.code, error.read().decode(), dict(error.headers)

    @property
    def cookie(self) -> str:
        return f"tumble_bench_{self.origin.rsplit(':', 1)[1]}={self.token}"

    def end(self) -> str:
        """End it as Ctrl-C does; what it said."""
        self.process.send_signal(signal.SIGINT)
        rest = self.process.communicate(timeout=30.0)[1]
        return self.said + rest


def started(folder: Path, listen: str, *, port: int = 0, host: str = "127.0.0.1") -> Server:
    """A server on a free port."""
    arguments = ["bench", str(folder / "launch"), "--listen", listen, "--port", str(port), "--host", host]
    arguments += ["--want", "accel.bias=1mg"]
    process = subprocess.Popen(
        [sys.executable, "-m", "tumble", *arguments],
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"XDG_STATE_HOME": str(folder / "state")},
    )
    assert process.stderr is not None
    said = process.stderr.readline()
    found = re.search(r"http://\S+", said)
    assert found is not None, said + process.stderr.read()
    return Server(process=process, link=found[0].replace("0.0.0.0", "127.0.0.1"), said=said)


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    made = started(tmp_path, "simulator:nine@6x")
    try:
        assert made.ask("/")[0] == 200
        yield made
    finally:
        if made.process.poll() is None:
            made.end()


# -------------------- what is refused --------------------


def test_commands_need_the_token_and_a_page_of_this_server(server: Server) -> None:
    def command(**headers: str) -> int:
        return server.ask("/command", method="POST", body=b'{"do": "go_on"}', **headers)[0]

    assert command() == 403
    assert command(Origin=server.origin) == 403
    assert command(Cookie=server.cookie) == 403
    assert command(Cookie=server.cookie, Origin="http://evil.example") == 403
    assert command(Cookie=server.cookie[:-1], Origin=server.origin) == 403
    assert command(Cookie=server.cookie, Origin=server.origin) == 200
    assert server.ask("/?token=wrong")[0] == 403


def test_other_names_are_not_answered_to(server: Server) -> None:
    assert server.ask("/", Host="evil.example")[0] == 421
    assert server.ask("/events", Host=f"evil.example:{server.origin.rsplit(':', 1)[1]}")[0] == 421


def test_answers_have_a_strict_policy_and_bad_commands_are_refused(server: Server) -> None:
    policy = server.ask("/")[2]["content-security-policy"]
    assert policy.startswith("default-src 'none'")
    assert "unsafe" not in policy
    for body in (b"", b"[]", b"{", b'{"do": 1e999}', b"[" * 3000, b"x" * 5000):
        status, _, _ = server.ask("/command", method="POST", body=body, Cookie=server.cookie, Origin=server.origin)
        assert status in (200, 400)
    assert server.ask("/assets/../server.py")[0] == 404
    assert server.ask("/assets/%2e%2e/server.py")[0] == 404
    assert server.ask("/files/session.toml")[0] == 404
    assert server.ask("/picture/99.svg")[0] == 404


def test_the_token_is_in_no_log_but_the_link_and_stays_the_same(server: Server, tmp_path: Path) -> None:
    server.ask(f"/?token={server.token}")
    server.ask("/nothing")
    token, said = server.token, server.end()
    assert said.count(token) == 1
    kept = tmp_path / "state" / "tumble" / "bench-token"
    assert kept.stat().st_mode & 0o077 == 0
    assert kept.read_text() == token
    assert "Traceback" not in said


def test_beyond_the_loopback_nothing_is_answered_without_the_token(tmp_path: Path) -> None:
    server = started(tmp_path, "simulator:nine@6x", host="0.0.0.0")
    try:
        assert server.ask("/", Cookie=server.cookie)[0] == 200
        for path in ("/", "/events", "/assets/bench.js", "/picture/0.svg", "/nothing"):
            assert server.ask(path)[0] == 403
    finally:
        server.end()


def test_a_server_answers_to_its_own_names() -> None:
    near = Access(host="127.0.0.1", port=8422, token="t" * 20)
    assert all(near.answers_to(f"{name}:8422") for name in ("127.0.0.1", "localhost", "[::1]"))
    wrong = ("evil.example:8422", "127.0.0.1:80", "192.168.0.7:8422", "", None, "[:8422", "localhost.evil.example:8422")
    assert not any(near.answers_to(name) for name in wrong)
    far = Access(host="0.0.0.0", port=8422, token="t" * 20)
    assert far.answers_to("192.168.0.7:8422")
    assert not far.answers_to("evil.example:8422")
    assert not near.knows(None)
    assert not near.knows("ttttttttttttttttttté")


def test_a_token_can_be_given_by_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setenv("TUMBLE_BENCH_TOKEN", "0123456789abcdef")
    assert lasting_token() == "0123456789abcdef"
    monkeypatch.setenv("TUMBLE_BENCH_TOKEN", "short")
    assert len(lasting_token()) >= 32
    assert lasting_token() == lasting_token()


def test_what_is_missing_without_the_extra_is_said(tmp_path: Path) -> None:
    code = (
        "import sys\n"
        "sys.modules['uvicorn'] = None\n"
        "from tumble.cli import main\n"
        f"main(['bench', {str(tmp_path / 'launch')!r}, '--listen', 'simulator:nine'])\n"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert found.returncode == 2
    assert "pip install 'tumble[bench]'" in found.stderr
    assert "Traceback" not in found.stderr


# -------------------- in a browser --------------------


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    made = Browser(tmp_path)
    yield made
    made.close()


def screen(browser: Browser) -> str:
    return str(browser.js("document.body?.dataset.screen ?? ''"))


def fits(browser: Browser) -> bool:
    """Whether nothing is wider than the window."""
    return bool(browser.js("document.documentElement.scrollWidth <= window.innerWidth"))


@needs_browser
def test_a_programme_by_keyboard_alone_with_a_wrong_position(server: Server, browser: Browser, tmp_path: Path) -> None:
    pictures = Path(os.environ.get("TUMBLE_SCREENSHOTS") or tmp_path)
    browser.size(1100, 900)
    browser.open(server.link)
    seen: set[str] = set()

    def at(wanted: str, seconds: float = 60.0) -> None:
        eventually(lambda: screen(browser) == wanted, seconds)
        for width, height in ((390, 844), (1100, 900)) if wanted not in seen else ():
            browser.size(width, height)
            assert fits(browser)
            browser.picture(pictures / f"bench-{wanted}-{width}.png")
            assert inaccessible(browser) == []
        seen.add(wanted)

    at("turn")
    body = json.dumps({"do": "table", "value": "to 9"}).encode()
    server.ask("/command", method="POST", body=body, Cookie=server.cookie, Origin=server.origin)
    at("fault")
    assert "wrong position: this is 9, wanted 2" in browser.text("#fault")
    assert browser.js("document.getElementById('fault').getAttribute('role')") == "alert"
    browser.press("a")
    eventually(lambda: "Turn now to position 2" in browser.text("h1"))
    for position in range(2, 10):
        eventually(lambda k=position: f"position {k}" in browser.text("h1"))  # type: ignore[misc]
        browser.press("n")
        at("rest") if position == 2 else None
    at("done")
    eventually(lambda: "9 rests" in browser.text("#estimated"), 200.0)
    assert browser.js("document.querySelectorAll('[role=meter]').length") == 6
    browser.press("c")
    eventually(lambda: browser.text("#result").startswith("Calibrated"), 60.0)
    seen.discard("done")
    pictures /= "calibrated" if "TUMBLE_SCREENSHOTS" in os.environ else ""
    pictures.mkdir(exist_ok=True)
    at("done")
    browser.js("document.getElementById('unit-serial').focus()")
    browser.write(EVIL)
    browser.press("Enter")
    eventually(lambda: browser.text("#serial") == EVIL)
    assert browser.js("document.scripts.length") == 2
    assert browser.console == []
    assert all(url.startswith(f"{server.origin}/") for url in browser.requests)
    unnamed = (
        "[...document.querySelectorAll('button, input, select')].filter(e => !e.innerText && !e.labels?.length).length"
    )
    assert browser.js(unnamed) == 0


@needs_browser
def test_a_page_without_the_token_looks_on_and_cannot_command(server: Server, browser: Browser) -> None:
    browser.open(server.origin + "/")
    eventually(lambda: screen(browser) in ("rest", "turn"))
    assert "may look, not command" in browser.text("#trouble")
    assert browser.js("[...document.querySelectorAll('main button')].every(b => b.disabled)")
    asked = 'fetch("command", {method: "POST", body: JSON.stringify({do: "stop"})}).then(a => a.status)'
    assert browser.js(asked) == 403


@needs_browser
def test_the_page_survives_the_server_and_the_server_the_page(tmp_path: Path, browser: Browser) -> None:
    recorded = simulate_session(tmp_path / "recorded", Setup.of(grade="mems", positions=6), seed=1, log_format="csv")
    server = started(tmp_path, f"replay:{recorded}@10x")
    browser.open(server.link)
    eventually(lambda: screen(browser) not in ("", "waiting"))
    port = int(server.origin.rsplit(":", 1)[1])
    os.kill(server.process.pid, signal.SIGKILL)
    server.process.communicate()
    eventually(lambda: "does not answer" in browser.text("#trouble"))
    again = started(tmp_path, f"replay:{recorded}@10x", port=port)
    try:
        eventually(lambda: "does not answer" not in browser.text("#trouble"))
        browser.open("about:blank")
        eventually(lambda: (tmp_path / "launch" / "log.csv").read_bytes() == (recorded / "log.csv").read_bytes(), 60.0)
    finally:
        again.end()
