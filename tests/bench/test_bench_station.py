"""What the page says of a recording: the screens, the mistakes, and the result at the end."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.support.bench_driver import SITE, Bench
from tests.support.browser import eventually
from tumble.bench.follow.faults import SampleWatch
from tumble.bench.follow.wishes import wishes
from tumble.bench.station import Station, station_of
from tumble.errors import InputError
from tumble.planning.setup import Setup
from tumble.recording.live.sources import source_of
from tumble.recording.log import open_log
from tumble.recording.session_file import read_session
from tumble.run.calibrate import calibrate
from tumble.simulation.session import simulate_session


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    made = Bench(tmp_path / "launch")
    yield made
    made.close()


def test_every_screen_of_a_programme_comes_in_its_turn(bench: Bench) -> None:
    assert bench.screen == "waiting"
    bench.until(lambda: bench.screen == "rest")
    rest = bench.state["rest"]
    assert (rest["number"], rest["of"]) == (1, 9)
    bench.until(lambda: rest["left"] is not None or bench.screen == "turn")
    for position in range(2, 10):
        bench.until(lambda: bench.screen == "turn")
        assert bench.said == f"Turn now to position {position}"
        bench.take(position)
    assert bench.screen == "done"

    def estimated() -> bool:
        bench.run(0.2)
        return (bench.state["estimate"] or {}).get("rests") == 9

    eventually(estimated, 200.0)
    groups = {group["group"]: group for group in bench.state["estimate"]["groups"]}
    assert groups["accel.bias"]["determined"]
    assert groups["gyro.bias"]["u"] < 100.0


def test_a_wrong_position_is_named_within_a_second_and_taken_again(bench: Bench) -> None:
    bench.take(1)
    bench.table.go_to(8)
    bench.until(lambda: not bench.table.moving)
    assert bench.until(lambda: bench.screen == "fault") <= 1.0
    assert bench.said.startswith("wrong position: this is 9, wanted 2 (X down)")
    bench.station.command("again")
    bench.run(3.0)
    assert bench.said == "Turn now to position 2"
    bench.take(2)
    assert bench.said == "Turn now to position 3"
    (left_out,) = read_session(bench.station.folder).excluded
    assert left_out.reason.startswith("wrong position: this is 9")


def test_a_turn_the_wrong_way_is_named_on_the_way_and_after_it(tmp_path: Path) -> None:
    bench = Bench(tmp_path / "launch", "rough-table")
    bench.take(1)
    bench.table.turn("N", -180.0)
    bench.until(lambda: bench.screen == "fault")
    assert bench.table.moving
    assert bench.said.startswith("this is the wrong way: wanted turn +180° about N")
    bench.until(lambda: not bench.table.moving)
    assert bench.until(lambda: "turned the wrong way" in bench.said) <= 1.0
    bench.station.command("again")
    bench.table.turn("N", 180.0)
    bench.until(lambda: not bench.table.moving)
    bench.run(1.0)
    bench.table.turn("N", 180.0)
    bench.until(lambda: not bench.table.moving)
    bench.until(lambda: bench.said == "Turn now to position 3")
    bench.close()


@pytest.mark.parametrize(("answer", "left_out"), [("again", "before"), ("keep_first", "after"), ("go_on", "nothing")])
def test_a_knock_is_named_within_a_second(bench: Bench, answer: str, left_out: str) -> None:
    bench.take(1)
    bench.table.go_to(1)
    bench.until(lambda: not bench.table.moving)
    bench.run(3.2)
    assert bench.screen == "rest"
    bench.table.mischief("knock")
    assert bench.until(lambda: bench.screen == "fault") <= 1.2
    assert bench.said.startswith("knock at")
    knock = float(bench.said.split()[2])
    bench.station.command(answer)
    bench.run(0.4)
    assert bench.screen == ("turn" if answer == "keep_first" else "rest")
    found = read_session(bench.station.folder).excluded
    if left_out == "nothing":
        assert found == ()
        return
    assert found[0].start is not None
    assert (found[0].start < knock - 1.0) == (left_out == "before")
    bench.until(lambda: bench.said == "Turn now to position 3")


def test_lost_samples_and_a_stuck_channel_are_named(bench: Bench) -> None:
    bench.take(1)
    bench.table.mischief("lose", 0.6)
    bench.run(0.6)
    assert bench.until(lambda: bench.screen == "fault") <= 1.0
    assert bench.said.startswith("gap of 0.6 s")
    bench.station.command("go_on")
    bench.run(0.2)
    bench.table.mischief("stick", 2.0)
    assert bench.until(lambda: bench.screen == "fault") <= 2.0
    assert bench.said.startswith("ay is stuck")


def test_clipped_samples_are_named(bench: Bench) -> None:
    bench.take(1)
    bench.table.turn("U", 180.0, rate=12.0)
    assert bench.until(lambda: bench.screen == "fault") <= 1.2
    assert "is clipped at" in bench.said


def test_noise_of_coarse_resolution_is_not_stuck() -> None:
    rng, time = np.random.default_rng(1), np.arange(3000) / 100.0
    values = np.round(rng.standard_normal((3000, 3)) * 0.05)
    watch = SampleWatch(("ax", "ay", "az"), None, 0.01)
    assert [seen for i in range(0, 3000, 20) for seen in watch.look(time[i : i + 20], values[i : i + 20])] == []


# -------------------- the result --------------------


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    setup = Setup.of(grade="mems", programme="nine", rest=10.0, rate_deg_s=60.0)
    return simulate_session(tmp_path_factory.mktemp("recorded") / "launch", setup, seed=4, log_format="csv")


def _without_date(path: Path) -> dict[str, object]:
    content = json.loads(path.read_text())
    del content["provenance"]["created"]
    return dict(content)


def test_the_result_after_a_replay_is_that_of_the_batch(recorded: Path, tmp_path: Path) -> None:
    registry = str(tmp_path / "registry.sqlite")
    station = station_of(tmp_path / "launch", f"replay:{recorded}@max", site=SITE, registry=registry)
    station.start()
    try:
        eventually(lambda: station.state["received"]["ended"] and station.state["screen"] == "done", 120.0)
        assert station.command("register") == "nothing is calibrated yet"
        station.command("calibrate")
        assert station.command("register") == "registered as record 1; no limits are set for it"
        assert station.command("register").startswith("registered before: it is record 1")
    finally:
        station.stop()
    assert (tmp_path / "launch" / "log.csv").read_bytes() == (recorded / "log.csv").read_bytes()
    calibrate(recorded).write(tmp_path / "batch.json")
    assert _without_date(tmp_path / "launch" / "calibration.json") == _without_date(tmp_path / "batch.json")


def test_a_session_in_another_format_is_replayed_to_the_last_digit(tmp_path: Path) -> None:
    setup = Setup.of(grade="mems", positions=6, rest=6.0, rate_deg_s=90.0)
    recorded = simulate_session(tmp_path / "recorded", setup, seed=5, log_format="parquet")
    station = station_of(tmp_path / "launch", f"replay:{recorded}@max", site=SITE)
    station.start()
    try:
        eventually(lambda: station.state["received"]["ended"], 60.0)
    finally:
        station.stop()
    received, sent = (
        [
            np.column_stack([c.time, c.accel, *([] if c.gyro is None else [c.gyro])])
            for c in open_log(read_session(folder)).chunks()
        ]
        for folder in (tmp_path / "launch", recorded)
    )
    np.testing.assert_array_equal(np.concatenate(received), np.concatenate(sent))


def test_a_page_that_is_started_again_says_the_same(recorded: Path, tmp_path: Path) -> None:
    folder = tmp_path / "launch"
    shutil.copytree(recorded, folder)
    said = []
    for _ in range(2):
        station = Station(folder, None)
        for _ in range(20):
            station.step()
        said.append({key: station.state[key] for key in ("screen", "headline", "rest", "received", "sphere")})
        station.stop()
    assert said[0] == said[1]
    assert said[0]["screen"] == "done"


def test_units_one_after_the_other_have_folders_of_their_own(recorded: Path, tmp_path: Path) -> None:
    station = station_of(tmp_path / "launch", f"replay:{recorded}@50x", site=SITE)
    station.start()
    try:
        station.command("next_unit", "<script>B-2</script>")
        eventually(lambda: station.state["unit"]["serial"] == "<script>B-2</script>")
        assert station.folder.parent == tmp_path
        assert station.command("next_unit", " ") == "expected the serial number of the next unit"
    finally:
        station.stop()
    assert read_session(station.folder).device.serial == "<script>B-2</script>"


def test_rests_of_free_positions_are_counted_without_a_programme(tmp_path: Path) -> None:
    setup = Setup.of(grade="mems", positions=8)
    folder = simulate_session(tmp_path / "hand", setup, seed=2, log_format="csv")
    station = Station(folder, None)
    for _ in range(20):
        station.step()
    state = station.state
    station.stop()
    assert len(state["sphere"]["taken"]) == 8
    assert state["rest"]["of"] is None


# -------------------- wishes --------------------


def test_wishes_are_those_that_are_stated_and_else_the_grades() -> None:
    found = wishes(("gyro.scale=2ppm",), "tactical")
    assert found["gyro.scale"] == pytest.approx(2e-6)
    assert set(found) == {f"{kind}.{what}" for kind in ("accel", "gyro") for what in ("bias", "scale", "axis")}
    with pytest.raises(InputError, match="want"):
        wishes(("gyro.scal=2ppm",), "tactical")


def test_a_new_session_wants_a_serial_number_and_a_place(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"found no serial$"):
        station_of(tmp_path / "new", "udp:0", site=SITE)
    with pytest.raises(InputError, match=r"found no latitude$"):
        station_of(tmp_path / "new", "udp:0", serial="A", site={"gravity": 9.81})
    with pytest.raises(InputError, match=r"session\.toml"):
        source_of(f"replay:{tmp_path}@2x")
