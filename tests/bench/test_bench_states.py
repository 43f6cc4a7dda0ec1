"""What the page shows and offers in each of its states, as an operator sees it."""

from __future__ import annotations

import base64
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.bench_driver import SITE, Bench, served
from tests.support.browser import Browser, chromium, eventually, inaccessible
from tumble.bench import screens
from tumble.bench.follow.estimates import Estimates
from tumble.bench.record.virtual_table import VirtualTable
from tumble.bench.session_folder import begin, in_si
from tumble.bench.station import Station
from tumble.programme.sheet_pictures import ghost
from tumble.result.calibration import read_calibration

needs_browser = pytest.mark.skipif(chromium() is None, reason="no Chromium is installed")


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    made = Bench(tmp_path / "launch", "rough-table")
    yield made
    made.close()


def running(bench: Bench, what: Callable[[], Any], seconds: float = 60.0) -> None:
    """Let log time pass until something is so that takes time of the machine."""

    def passed() -> Any:
        bench.run(0.2)
        return what()

    eventually(passed, seconds)


def answers(bench: Bench) -> dict[str, dict[str, Any]]:
    return {each["do"]: each for each in bench.state["answers"]}


def primary(bench: Bench) -> list[str]:
    return [name for name, each in answers(bench).items() if each["primary"]]


# -------------------- what is told --------------------


def test_what_is_wrong_and_the_picture_are_of_one_position(bench: Bench) -> None:
    bench.take(1)
    bench.take(2)
    bench.table.go_to(6)
    bench.until(lambda: not bench.table.moving)
    bench.until(lambda: "wanted 3" in bench.said)
    for _ in range(2):
        assert "wanted 3" in bench.said
        assert bench.state["position"]["number"] == 3
        assert bench.state["rest"]["number"] == 3
        bench.table.turn("N", 60.0)  # and on, without an answer: the next position is none of what is wrong
        bench.until(lambda: not bench.table.moving)
        bench.run(3.0)
    assert primary(bench) == ["again"]
    assert answers(bench)["again"]["says"] == "then turn into position 3, as in the picture"
    assert answers(bench)["go_on"]["says"] == "nothing is left out: where the page is wrong"


def test_the_ghost_is_where_the_unit_is(bench: Bench) -> None:
    """Halfway through a turn it is halfway; at its end it is the picture, but for how far positions are off."""
    bench.take(1)
    target = ghost(bench.table.programme.positions[1].matrix)

    def off() -> float:
        seen = bench.state["position"]["ghost"]
        return float(max(np.abs(np.array(seen[axis]) - target[axis]).max() for axis in "XYZ"))

    begun = off()
    bench.table.go_to(1)
    bench.until(lambda: not bench.table.moving)
    bench.run(0.2)
    assert off() < 5.0 < begun  # of 70 pixels, the length of an axis


def test_the_time_to_go_is_steady(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However long the first rest lasts it does not grow by it, and once positions outvote what the programme allows
    for, it falls by what each of them takes."""
    monkeypatch.setattr(Estimates, "ask", lambda *_: None)
    bench = Bench(tmp_path / "launch", "nine")
    bench.until(lambda: bench.screen == "turn")
    begun = bench.state["to_go"]
    bench.run(40.0)
    assert bench.state["to_go"] <= begun
    seen = []
    for position in range(2, 8):
        bench.take(position)
        seen.append(bench.state["to_go"])
    bench.close()
    assert np.all(np.diff(seen) < 0.0)
    assert np.ptp(np.diff(seen[2:])) < 0.3 * seen[2]


def test_no_time_is_told_that_is_not_known(bench: Bench) -> None:
    """Of a rest that has lasted for seconds, none of hours."""
    while bench.screen != "turn":
        bench.run(0.2)
        rest = bench.state.get("rest") or {}
        if bench.screen == "rest" and rest["left"] is not None:
            assert rest["left"] <= screens.FORESEEN * rest["seconds"]


# -------------------- a recording that always can go on --------------------


@pytest.fixture
def recording(tmp_path: Path) -> Iterator[Station]:
    folder = tmp_path / "recording"
    begin(folder, log=in_si(), serial="A", site=SITE, programme="nine")
    station = Station(folder, lambda: VirtualTable("nine@20x"))
    station.start()
    yield station
    station.stop()


def test_recording_goes_on_after_a_calibration_that_is_refused(recording: Station) -> None:
    before = refused(recording)["received"]["samples"]
    recording.command("resume")
    eventually(lambda: recording.state["listening"] and recording.state["received"]["samples"] > before + 100)


def refused(station: Station) -> dict[str, Any]:
    """Have a calibration of a rest alone refused; the state after it."""
    eventually(lambda: station.state["received"]["samples"] > 500)
    assert not station.command("calibrate").startswith("calibrated")
    state = eventually(lambda: station.state if station.state["answers"] else None)
    assert {each["do"]: each["primary"] for each in state["answers"]} == {"resume": True, "calibrate": False}
    return dict(state)


# -------------------- the page --------------------


class Shown:
    """A bench and its page; `look` checks it at both widths and keeps pictures of it."""

    def __init__(self, bench: Bench, browser: Browser, pictures: Path) -> None:
        self.bench, self.browser, self.pictures = bench, browser, pictures
        self.faults: list[str] = []

    def look(self, name: str) -> None:
        for width, height in ((390, 844), (1100, 900)):
            self.browser.size(width, height)
            if not self.browser.js("document.documentElement.scrollWidth <= window.innerWidth"):
                self.faults.append(f"{name}: wider than {width}")
            self.browser.picture(self.pictures / f"bench-{name}-{width}.png")
        result = "document.getElementById('finish')"
        top = self.browser.js(f"{result}.hidden ? 0 : {result}.offsetTop")
        small = {"x": 0, "y": top, "width": 1100, "height": 960 if top else 740, "scale": 0.6}
        found = self.browser.send("Page.captureScreenshot", format="png", clip=small, captureBeyondViewport=True)
        (self.pictures / f"bench-{name}.png").write_bytes(base64.b64decode(found["data"]))
        self.faults += [f"{name}: {fault}" for fault in inaccessible(self.browser)]

    def until(self, selector: str, text: str) -> None:
        eventually(lambda: text in self.browser.text(selector), 60.0)

    def primary(self) -> str:
        return str(
            self.browser.js(
                "[...document.querySelectorAll('#buttons .primary:not([hidden])')].map(b => b.innerText).join()"
            )
        )


@needs_browser
def test_every_state_of_a_session_as_an_operator_sees_it(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    bench, browser = Bench(tmp_path / "launch", "nine"), Browser(tmp_path)
    pictures = Path(os.environ.get("TUMBLE_SCREENSHOTS") or tmp_path)
    shown = Shown(bench, browser, pictures)
    try:
        with served(bench.station) as link:
            browser.open(link)
            shown.until("h1", "Waiting")
            shown.look("waiting")
            bench.until(lambda: bench.screen == "rest")
            bench.run(1.0)
            shown.until("h1", "At rest 1 of 9")
            shown.look("rest")
            for position in range(1, 4):
                bench.take(position) if position > 1 else bench.until(lambda: bench.screen == "turn")
            running(bench, lambda: bench.state["estimate"], 60.0)
            bench.table.go_to(3)
            bench.run(2.0)
            shown.until("h1", "Turn now to position 4")
            assert browser.js("document.querySelectorAll('#target svg line').length") == 15
            shown.look("turn")
            bench.until(lambda: not bench.table.moving)
            bench.until(lambda: bench.screen == "rest")
            bench.until(lambda: bench.screen == "turn")
            bench.table.go_to(8)
            bench.until(lambda: bench.screen == "fault")
            shown.until("#fault", "wanted 5")
            assert shown.primary().startswith("Leave this rest out A")
            shown.look("wrong-position")
            browser.press("a")
            running(bench, lambda: bench.screen != "fault")
            for position in range(5, 10):
                bench.take(position)
            running(bench, lambda: bench.state.get("missed") is not None, 120.0)
            shown.until("h1", "positions taken" if bench.state["missed"] else "All wanted u reached")
            shown.look("done")
            assert shown.primary().startswith("Stop and calibrate C")
            browser.press("c")
            running(bench, lambda: bench.state["result"], 120.0)
            shown.until("h1", "Calibrated")
            rows = browser.js("[...document.querySelectorAll('#finish tbody tr')].map(r => r.innerText)")
            assert len(rows) == len(read_calibration(tmp_path / "launch" / "calibration.json").parameters)
            shown.look("result")
            browser.js("document.getElementById('unit-serial').focus()")
            browser.write("B-2")
            browser.press("Enter")
            running(bench, lambda: browser.text("#serial") == "B-2")
            of_the_unit_before = browser.text("#groups") + browser.text("#residuals") + browser.text("#next")
            assert of_the_unit_before + browser.text("#cause") == ""
            assert browser.js("document.getElementById('finish').hidden")
            assert browser.text("#estimated") == "No estimate yet"
        shown.until("#trouble", "The server does not answer")
        assert browser.js("[...document.querySelectorAll('main button')].every(b => b.disabled)")
        shown.look("no-server")
        recording: Station = request.getfixturevalue("recording")  # which takes its part of the machine from now on
        refused(recording)
        with served(recording) as link:
            browser.open(link)
            shown.until("h1", "Recording has stopped")
            assert shown.primary().startswith("Record on R")
            shown.look("stopped")
            browser.press("r")
            eventually(lambda: recording.state["listening"])
            eventually(lambda: "Recording has stopped" not in browser.text("h1"))
    finally:
        browser.close()
        bench.close()
    assert shown.faults == []
