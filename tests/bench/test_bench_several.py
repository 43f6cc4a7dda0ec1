"""Several benches on one server: the list of them, the way from one to the other, and what is refused."""

from __future__ import annotations

import os
import socket
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.support.bench_driver import SITE, TOKEN, Bench, served
from tests.support.browser import Browser, chromium, eventually, inaccessible
from tumble.bench.station import stations_of
from tumble.bench.web.server import listed
from tumble.cli import main
from tumble.errors import InputError


@pytest.fixture
def benches(tmp_path: Path) -> Iterator[tuple[Bench, Bench]]:
    two = Bench(tmp_path / "one"), Bench(tmp_path / "<b>two", None)
    yield two
    for bench in two:
        bench.close()


def _status(url: str, **headers: str) -> int:
    """The status of an answer."""
    body = b'{"do": "go_on"}' if "/command" in url else None
    try:
        with urllib.request.urlopen(urllib.request.Request(url, data=body, headers=headers), timeout=10.0) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as error:
        with error:
            return error.code


def test_the_bench_that_wants_the_operator_is_next(benches: tuple[Bench, Bench]) -> None:
    first, second = benches
    stations = first.station, second.station
    assert [bench["screen"] for bench in listed(stations)["benches"]] == ["waiting", "waiting"]
    second.until(lambda: second.screen == "rest")
    assert listed(stations)["next"] == 2
    first.take(1)
    shown = listed(stations)
    assert shown["next"] == 1
    assert shown["benches"][0]["headline"] == "Turn now to position 2"
    first.take(2)
    each = listed(stations)["benches"][0]
    assert (each["rest"]["number"], each["rest"]["of"]) == (3, 9)
    assert 7 * 4.0 < each["to_go"] < 7 * 90.0


def test_each_bench_has_a_page_and_no_page_commands_without_the_token(benches: tuple[Bench, Bench]) -> None:
    with served(*(bench.station for bench in benches)) as link:
        origin = link.split("/?")[0]
        cookie = f"tumble_bench_{origin.rsplit(':', 1)[1]}={TOKEN}"
        for path in ("/", "/1/", "/2/", "/2/assets/bench.js", "/1/picture/0.svg"):
            assert _status(origin + path) == 200
        assert _status(origin + "/3/") == 404
        assert _status(origin + "/2/", Host="evil.example") == 421
        for number in (1, 2):
            command = f"{origin}/{number}/command"
            assert _status(command, Origin=origin) == 403
            assert _status(command, Origin="http://evil.example", Cookie=cookie) == 403
            assert _status(command, Origin=origin, Cookie=cookie) == 200
        assert _status(origin + "/command", Origin=origin, Cookie=cookie) in (404, 405)


@pytest.mark.skipif(chromium() is None, reason="no Chromium is installed")
def test_the_list_and_the_pages_by_keyboard_alone(benches: tuple[Bench, Bench], tmp_path: Path) -> None:
    pictures = Path(os.environ.get("TUMBLE_SCREENSHOTS") or tmp_path)
    first, second = benches
    first.take(1)
    second.run(1.0)
    browser = Browser(tmp_path)

    def look(name: str) -> None:
        for width, height in ((390, 844), (1100, 900)):
            browser.size(width, height)
            assert browser.js("document.documentElement.scrollWidth <= window.innerWidth")
            if os.environ.get("TUMBLE_SCREENSHOTS"):
                browser.picture(pictures / f"several-{name}-{width}.png")
        for dark in (True, False):
            browser.dark(dark)
            assert inaccessible(browser) == []

    try:
        with served(first.station, second.station) as link:
            browser.open(link)
            eventually(lambda: browser.text("#next") == "Go to bench 1, virtual-1: Turn now to position 2")
            look("list")
            browser.press("Enter")
            eventually(lambda: "Turn now to position 2" in browser.text("h1"))
            eventually(lambda: browser.text("#benches [aria-current]") == "1 · virtual-1")
            first.table.go_to(8)
            first.until(lambda: first.screen == "fault")
            look("page")
            browser.press("2")
            eventually(lambda: browser.js("location.pathname") == "/2/")
            eventually(lambda: "1 · virtual-1: Not good" in browser.text("#benches"))
            browser.press("0")
            eventually(lambda: "Not good" in browser.text("#next") or "wrong position" in browser.text("#next"))
            look("fault")
            assert browser.console == []
            assert all(url.startswith(link.split("?")[0]) for url in browser.requests)
    finally:
        browser.close()


def test_benches_that_cannot_be_told_apart_are_refused(tmp_path: Path) -> None:
    folders = [tmp_path / "a", tmp_path / "b"]
    with pytest.raises(InputError, match="listen: expected none, or one for each of the 2 sessions, found 1"):
        stations_of(folders, ["simulator:nine"], site=SITE)
    with pytest.raises(InputError, match="expected every session once, found it twice"):
        stations_of([tmp_path / "a"] * 2, ["simulator:nine"] * 2, site=SITE)
    with pytest.raises(InputError, match="expected a session folder, or listen"):
        stations_of(folders, site=SITE)


def test_a_port_that_is_taken_leaves_no_folder(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        words = ["bench", str(tmp_path / "new"), "--listen", "simulator", "--port", str(taken.getsockname()[1])]
        result = CliRunner().invoke(main, words)
    assert result.exit_code == 2
    assert "expected a free address" in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_source_that_is_taken_leaves_no_folder(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        source = f"udp:127.0.0.1:{taken.getsockname()[1]}"
        device = ["--serial", "A-1", "--latitude", "50"]
        words = ["bench", str(tmp_path / "new"), "--listen", source, *device, "--port", "0"]
        result = CliRunner().invoke(main, words)
    assert result.exit_code == 2
    assert "expected a port that is free" in result.stderr
    assert list(tmp_path.iterdir()) == []
