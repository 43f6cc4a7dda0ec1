"""Every mistake at the bench is named within a second of its end, on the page, and is mended by keys alone."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.support.bench_driver import Bench, ClumsyTable, served
from tests.support.browser import Browser, chromium, eventually, inaccessible
from tumble.recording.session_file import read_session

needs_browser = pytest.mark.skipif(chromium() is None, reason="no Chromium is installed")


@dataclass(kw_only=True)
class Shown:
    """A bench and its page in a browser, looked at in both widths."""

    bench: Bench
    browser: Browser
    pictures: Path
    place: str
    faults: list[str] = field(default_factory=list)

    @property
    def table(self) -> ClumsyTable:
        return self.bench.table

    def moved(self) -> None:
        """Let the turn under way end."""
        self.bench.until(lambda: not self.table.moving)

    def named(self, name: str, said: str, key: str, *, later: float = 0.0) -> None:
        """A mistake that ends in `later` s is named within a second of its end; a key answers."""
        assert self.bench.until(lambda: said in self.bench.said) <= 1.0 + later + 0.01
        eventually(lambda: said in self.browser.text("#fault") + self.browser.text("h1"))
        self.look(name)
        if key:
            answered = len(self.bench.station._answers.answered)
            self.browser.press(key)
            eventually(lambda: len(self.bench.station._answers.answered) > answered)
            self.bench.run(0.2)
            eventually(lambda: said not in self.browser.text("#fault"))

    def seen(self, screen: str) -> None:
        """A screen without a mistake."""
        eventually(lambda: self.browser.js("document.body.dataset.screen") == screen)
        self.look(screen)

    def look(self, name: str) -> None:
        """What is wrong with the page as it is."""
        for width, height in ((390, 844), (1100, 900)):
            self.browser.size(width, height)
            assert self.browser.js("document.documentElement.scrollWidth <= window.innerWidth")
            if os.environ.get("TUMBLE_SCREENSHOTS"):
                self.browser.picture(self.pictures / f"mistake-{self.place}-{name}-{width}.png")
        self.faults += [f"{name}: {fault}" for fault in inaccessible(self.browser)]
        self.browser.dark(True)
        self.faults += [f"{name}, dark: {fault}" for fault in inaccessible(self.browser)]
        if os.environ.get("TUMBLE_SCREENSHOTS"):
            self.browser.picture(self.pictures / f"dark-{self.place}-{name}.png")
        self.browser.dark(False)


@pytest.fixture
def shown(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Shown]:
    bench = Bench(tmp_path / "launch", request.param, temperature=True)
    browser = Browser(tmp_path)
    try:
        with served(bench.station) as link:
            browser.size(1100, 900)
            browser.open(link)
            eventually(lambda: browser.js("document.body?.dataset.screen"))
            pictures = Path(os.environ.get("TUMBLE_SCREENSHOTS") or tmp_path)
            made = Shown(bench=bench, browser=browser, pictures=pictures, place=request.param or "by-hand")
            yield made
            origin = link.split("?")[0]
            assert all(url.startswith(origin) for url in browser.requests)
    finally:
        browser.close()
        bench.close()
    assert made.faults == []
    assert browser.console == []


def common_mistakes(shown: Shown, to_next: Callable[[], None], then: Callable[[], None] | None = None) -> None:
    """Those of any session: at rest in the second position, then on the way to the next ones."""
    bench, table = shown.bench, shown.table
    bench.run(3.2)
    shown.seen("rest")
    table.mischief("knock")
    shown.named("knock", "knock at", "a", later=0.1)
    bench.until(lambda: bench.screen == "turn")
    table.mischief("lose", 0.6)
    shown.named("gap", "gap of 0.6 s", "g", later=0.6)
    table.mischief("stick", 2.0)
    shown.named("stuck", "ay is stuck", "g", later=2.0)
    bench.run(2.0)
    to_next()
    table.rock()
    shown.moved()
    shown.named("movement", "Hold still: the unit is not yet at rest", "", later=1.5)
    bench.until(lambda: bench.screen == "rest")
    bench.until(lambda: bench.screen == "turn")
    shown.seen("turn")
    table.warm(1.0)
    shown.named("temperature", "drift of temperature", "g", later=5.0)
    table.warm(0.0)
    if then is not None:
        then()
    table.turn("U", 180.0, rate=12.0)
    shown.moved()
    shown.named("clipped", "is clipped at", "g")


@needs_browser
@pytest.mark.parametrize("shown", ["rough-table"], indirect=True)
def test_every_mistake_at_the_table_is_named_within_a_second_of_its_end(shown: Shown) -> None:
    bench, table = shown.bench, shown.table
    bench.take(1)
    table.turn("N", -180.0)
    shown.named("sense", "this is the wrong way: wanted turn +180° about N", "", later=5.0)
    assert table.moving
    shown.moved()
    shown.named("wrong-way", "turned the wrong way", "a")
    table.turn("N", 180.0)
    shown.moved()
    bench.run(1.0)
    table.turn("N", 180.0)
    shown.moved()

    def into_a_wrong_position() -> None:
        table.go_to(11)
        shown.moved()
        shown.named("position", "wrong position: this is", "a")

    common_mistakes(shown, lambda: table.go_to(2), into_a_wrong_position)
    reasons = [one.reason for one in read_session(bench.station.folder).excluded]
    assert [reason.split(" at ")[0].split(":")[0] for reason in reasons] == [
        "turned the wrong way", "knock", "wrong position"
    ]  # fmt: skip


@needs_browser
@pytest.mark.parametrize("shown", [None], indirect=True, ids=["by-hand"])
def test_every_mistake_by_hand_is_named_within_a_second_of_its_end(shown: Shown) -> None:
    bench, table = shown.bench, shown.table
    bench.until(lambda: bench.screen == "turn")
    table.turn("N", 75.0)
    shown.moved()
    common_mistakes(shown, lambda: table.turn("E", 120.0))


def test_a_rest_put_down_with_movement_that_no_gyro_sees_begins_anew(tmp_path: Path) -> None:
    bench = Bench(tmp_path / "launch", None, gyros=False)
    bench.until(lambda: bench.screen == "turn")
    bench.table.turn("N", 75.0)
    bench.table.rock(1.0)
    bench.until(lambda: not bench.table.moving)
    assert bench.until(lambda: bench.said.startswith("rest 2 was put down with movement")) <= 2.0
    assert bench.station.command("again") == "left out; hold still, this rest begins anew"
    bench.run(1.0)
    assert bench.screen == "rest"
    bench.until(lambda: bench.screen == "turn")
    bench.close()
