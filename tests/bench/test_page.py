"""The page in a browser: every state of a session, by keyboard alone, at both widths, in light and dark."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.support.bench_driver import SITE, Bench, served
from tests.support.browser import Browser, chromium, eventually, inaccessible
from tests.support.calibrated import calibration
from tumble.bench.results import page_content
from tumble.bench.screens import answers
from tumble.bench.state import State
from tumble.bench.station import station_of
from tumble.inference.estimate import Outcome
from tumble.planning.setup import Setup
from tumble.result.calibration import read_calibration
from tumble.simulation.session import simulate_session

pytestmark = [
    pytest.mark.weekly,
    pytest.mark.skipif(chromium() is None, reason="no Chromium is installed"),
]
EVIL = "<script>alert(1)</script>"


class Shown:
    """A page in a browser. `look` checks it at both widths, in light and dark, and keeps pictures of it."""

    def __init__(self, folder: Path) -> None:
        self.browser = Browser(folder)
        self.pictures = Path(os.environ.get("TUMBLE_SCREENSHOTS") or folder)
        self.faults: list[str] = []

    def look(self, name: str) -> None:
        for width, height in ((390, 844), (1100, 900)):
            self.browser.size(width, height)
            if not self.browser.js("document.documentElement.scrollWidth <= window.innerWidth"):
                self.faults.append(f"{name}: wider than {width}")
            self.browser.picture(self.pictures / f"bench-{name}-{width}.png")
        for dark in (True, False):
            self.browser.dark(dark)
            self.faults += [f"{name}, dark {dark}: {fault}" for fault in inaccessible(self.browser)]

    def until(self, selector: str, text: str) -> None:
        eventually(lambda: text in self.browser.text(selector), 60.0)

    def primary(self) -> str:
        found = "[...document.querySelectorAll('#buttons .primary:not([hidden])')].map(b => b.innerText).join()"
        return str(self.browser.js(found))

    def disabled(self) -> bool:
        return bool(self.browser.js("[...document.querySelectorAll('main button')].every(b => b.disabled)"))


def running(bench: Bench, what: Callable[[], Any]) -> None:
    """Let log time pass until something is so that takes time of the machine."""

    def passed() -> Any:
        bench.run(0.2)
        return what()

    eventually(passed, 120.0)


def test_every_state_of_a_session_by_keyboard_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TUMBLE_REGISTRY", str(tmp_path / "registry.sqlite"))
    bench, shown = Bench(tmp_path / "launch", "nine", temperature=True), Shown(tmp_path)
    browser, unit = shown.browser, bench.unit

    def mistake(name: str, said: str, answer: str) -> None:
        """One is shown, and answered by its key."""
        bench.until(lambda: said in bench.said)
        shown.until("#fault", said)
        shown.look(name)
        browser.press(answer)
        running(bench, lambda: said not in browser.text("#fault"))

    try:
        with served(bench.station) as link:
            origins = [link.split("?")[0]]
            browser.open(link)
            shown.until("h1", "Waiting")
            shown.look("waiting")
            bench.until(lambda: bench.screen == "rest")
            bench.run(1.0)
            shown.until("h1", "At rest 1 of 9")
            shown.look("rest")
            bench.until(lambda: bench.screen == "turn")
            for position in (2, 3):
                bench.take(position)
            running(bench, lambda: bench.state["estimate"])
            unit.go_to(3)
            bench.run(2.0)
            shown.until("h1", "Turn now to position 4")
            assert browser.js("document.querySelectorAll('#target svg line').length") == 15
            shown.look("turn")
            bench.moved()
            bench.run(3.2)
            unit.mischief("knock", 0.1)
            mistake("knock", "knock at", "a")
            bench.until(lambda: bench.screen == "rest")
            bench.until(lambda: bench.screen == "turn")
            unit.go_to(8)
            bench.moved()
            bench.until(lambda: bench.screen == "fault")
            shown.until("#fault", "this is 9, wanted 5")
            assert shown.primary().startswith("Leave this rest out A")
            assert browser.js("document.getElementById('fault').getAttribute('role')") == "alert"
            mistake("wrong-position", "wrong position", "a")
            unit.mischief("lose", 0.6)
            mistake("gap", "gap of 0.6 s", "g")
            for position in range(5, 10):
                bench.take(position)
            running(bench, lambda: bench.state.get("missed") is not None)
            shown.until("h1", "positions taken" if bench.state["missed"] else "All that is wanted is reached")
            assert browser.js("document.querySelectorAll('[role=meter]').length") == 6
            assert shown.primary().startswith("Stop and calibrate C")
            shown.look("done")
            browser.press("c")
            running(bench, lambda: bench.state["result"])
            shown.until("h1", "Calibrated")
            rows = browser.js("[...document.querySelectorAll('#numbers tbody tr')].map(r => r.innerText)")
            assert len(rows) == len(read_calibration(tmp_path / "launch" / "calibration.json").parameters)
            assert browser.js("document.getElementById('groups').hidden")  # the numbers of the result stand alone
            browser.press("i")
            running(bench, lambda: "record 1" in browser.text("#registered"))
            browser.press("p")
            running(bench, lambda: "report.html" in browser.text("#files"))
            assert "<html" in (tmp_path / "launch" / "report.html").read_text()
            shown.look("result")
            browser.js("document.getElementById('unit-serial').focus()")
            browser.write(EVIL)
            browser.press("Enter")
            running(bench, lambda: browser.text("#serial") == EVIL)
            assert browser.js("document.scripts.length") == 2
            of_the_unit_before = "".join(map(browser.text, ("#groups", "#residuals", "#next", "#cause")))
            assert of_the_unit_before == ""
            assert browser.js("document.getElementById('finish').hidden")
            assert browser.text("#estimated") == "No estimate yet"
        shown.until("#trouble", "The server does not answer")
        assert shown.disabled()
        shown.look("no-server")
        assert all("ERR_" in said or "404" in said for said in browser.console)  # of the stream that ended
        with served(bench.station, int(origins[0].rsplit(":", 1)[1].strip("/"))):  # the page goes on by itself
            eventually(lambda: "does not answer" not in browser.text("#trouble"))
        browser.console.clear()

        # a recording in free positions, looked at without the token, stopped, and going on
        setup = Setup.of(grade="mems", positions=18)
        sent = simulate_session(tmp_path / "sent", setup, seed=1, log_format="csv")
        recording = station_of(tmp_path / "by-hand", f"replay:{sent}@10x", site=SITE)
        recording.start()
        try:
            with served(recording) as link:
                origins.append(link.split("?")[0])
                browser.open(origins[1])
                eventually(lambda: browser.js("document.body?.dataset.screen") in ("rest", "turn"))
                assert "may look, not command" in browser.text("#trouble")
                assert shown.disabled()
                asked = 'fetch("command", {method: "POST", body: JSON.stringify({do: "stop"})}).then(a => a.status)'
                assert browser.js(asked) == 403
                browser.console.clear()  # which has the answer 403
                browser.open(link)
                eventually(lambda: recording.state["estimate"])
                eventually(lambda: not browser.js("document.getElementById('sphere').hidden"))
                shown.look("by-hand")
                recording.command("stop")
                shown.until("h1", "Recording has stopped")
                assert shown.primary().startswith("Record on R")
                shown.look("stopped")
                browser.press("r")
                eventually(lambda: recording.state["listening"])
                eventually(lambda: "Recording has stopped" not in browser.text("h1"))
        finally:
            recording.stop()
    finally:
        browser.close()
        bench.close()
    assert shown.faults == []
    assert browser.console == []
    assert all(url.startswith(tuple(origins)) for url in browser.requests)


def test_a_refused_result_shows_the_reason_and_nothing_as_reached(tmp_path: Path) -> None:
    bench, shown = Bench(tmp_path / "launch", "nine"), Shown(tmp_path)
    refused = replace(calibration(), outcome=Outcome(reasons=("the gyros do not carry the vertical",)))
    try:
        with served(bench.station) as link:
            shown.browser.open(link)
            for made in (calibration(), refused):
                state: State = {**bench.station.state, "result": page_content(made), "can_record": True}
                state["answers"] = answers(state)
                bench.station.state = state
                shown.until("h1", "Calibrated: accepted" if made.outcome.accepted else "Calibrated: not accepted")
                assert ("reached" in shown.browser.text("#parameters")) is made.outcome.accepted
            assert "the gyros do not carry the vertical" in shown.browser.text("#reasons")
            shown.look("refused")
    finally:
        shown.browser.close()
        bench.close()
    assert shown.faults == []
