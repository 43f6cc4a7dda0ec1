"""What the page says while a unit is recorded: the screens, and every mistake within a second of its end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.bench_driver import SAMPLE_RATE, Bench, Unit
from tests.support.browser import eventually
from tests.support.shared import session as shared_session
from tumble import Setup, calibrate
from tumble.bench import screens
from tumble.bench.follow.estimates import DIRECTIONS, best_next, estimate_so_far, gains
from tumble.bench.follow.faults import SampleWatch
from tumble.bench.follow.task import Task, Wanted, wanted_by_group
from tumble.bench.record.recorder import NOTHING_RECEIVED
from tumble.bench.station import Station
from tumble.errors import InputError
from tumble.programme.sheet import ghost
from tumble.recording.session_file import read_session
from tumble.reduction.observations import observe
from tumble.reduction.rests.segmentation import find_rests
from tumble.rotation import unit_vector
from tumble.run.observed import inspect_session
from tumble.sensors.parameters import group_name


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Callable[..., Bench]]:
    made: list[Bench] = []

    def one(programme: str | None, **settings: bool) -> Bench:
        made.append(Bench(tmp_path / f"launch-{len(made)}", programme, **settings))
        return made[-1]

    yield one
    for bench in made:
        bench.close()


def answers(bench: Bench) -> dict[str, dict[str, Any]]:
    return {each["do"]: each for each in bench.state["answers"]}


def primary(bench: Bench) -> list[str]:
    return [name for name, each in answers(bench).items() if each["primary"]]


def named(bench: Bench, said: str, *, later: float = 0.0, answer: str = "") -> None:
    """A mistake that ends in `later` s is named within a second of its end, and answered."""
    assert bench.until(lambda: said in bench.said) <= 1.0 + later + 0.01
    if answer:
        bench.station.command(answer)
        bench.run(0.2)
        assert said not in bench.said


def test_every_screen_of_a_programme_in_its_turn(opened: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch) -> None:
    bench = opened("nine")
    assert bench.screen == "waiting"
    bench.until(lambda: bench.screen == "rest")
    rest = bench.state["rest"]
    assert (rest["number"], rest["of"]) == (1, 9)
    while bench.screen == "rest":  # no time is given that is not known: of a rest of seconds, none of hours
        left, seconds = (bench.state["rest"][key] for key in ("left", "seconds"))
        assert left is None or left <= screens.MAX_FORECAST * seconds
        bench.run(0.2)
    begun = bench.state["to_go"]
    bench.run(10.0)
    assert bench.state["to_go"] <= begun  # however long the first rest lasts
    to_go = []
    with monkeypatch.context() as patched:
        patched.setattr("tumble.bench.follow.estimates.estimate_so_far", lambda *_: [][1])
        for position in range(2, 10):
            assert bench.said == f"Turn now to position {position}"
            bench.take(position)
            to_go.append(bench.state["to_go"])
            if position == 8:
                eventually(lambda: _stepped(bench)["estimate"])
                assert "the estimate has failed (IndexError" in bench.state["estimate"]["cause"]
                patched.undo()
    assert np.all(np.diff(to_go) < 0.0)
    assert bench.screen == "done"
    eventually(lambda: _stepped(bench)["estimate"]["rests"] == 9, 60.0)
    groups = {group["group"]: group for group in bench.state["estimate"]["groups"]}
    assert groups["accel.bias"]["determined"]
    assert groups["gyro.bias"]["u"] < 100.0
    assert primary(bench) == ["calibrate"]
    assert bench.station.command("leave_out", "10") == "expected the number of a rest from 1 to 9"
    assert bench.station.command("leave_out", "9") == "rest 9 is left out"
    assert bench.station.command("take_back") == "taken back"
    assert read_session(bench.station.folder).excluded == ()


def _stepped(bench: Bench) -> dict[str, Any]:
    bench.run(0.2)
    return bench.state


def test_mistakes_at_a_table(opened: Callable[..., Bench]) -> None:
    bench = opened("rough-table")
    unit = bench.unit
    bench.until(lambda: bench.screen == "turn")
    unit.turn("N", -180.0)
    bench.until(lambda: bench.screen == "fault")
    assert unit.moving
    named(bench, "this is the wrong way: wanted turn +180° about N")
    bench.moved()
    named(bench, "turned the wrong way", answer="again")
    unit.turn("N", 180.0)
    bench.moved()
    bench.run(1.0)
    unit.turn("N", 180.0)
    target = ghost(unit.programme.positions[1].matrix)

    def off() -> float:
        seen = bench.state["position"]["ghost"]
        return float(max(np.abs(np.array(seen[axis]) - target[axis]).max() for axis in "XYZ"))

    bench.run(0.4)
    begun = off()
    bench.moved()
    assert off() < 5.0 < begun  # the picture of the unit goes along: of 70 pixels, the length of an axis
    bench.until(lambda: bench.said == "Turn now to position 3")
    unit.go_to(6)
    bench.moved()
    named(bench, "wanted 3")
    for _ in range(2):  # what is wrong and the picture are of one position, however the unit goes on
        assert (bench.state["position"]["number"], bench.state["rest"]["number"]) == (3, 3)
        unit.turn("N", 60.0)
        bench.moved()
        bench.run(3.0)
        assert "wanted 3" in bench.said
    assert primary(bench) == ["again"]
    assert answers(bench)["again"]["says"] == "then turn into position 3, as in the picture"
    bench.station.command("again")
    reasons = [one.reason for one in read_session(bench.station.folder).excluded]
    assert [reason.split(":")[0] for reason in reasons] == ["turned the wrong way", "wrong position"]


@pytest.mark.parametrize(("answer", "left_out"), [("again", "before"), ("keep_first", "after"), ("go_on", "nothing")])
def test_a_knock(opened: Callable[..., Bench], answer: str, left_out: str) -> None:
    bench = opened("nine")
    bench.until(lambda: bench.screen == "rest")
    bench.run(0.4)
    bench.unit.mischief("knock", 0.1)
    named(bench, "knock at", later=0.1)
    knock = float(bench.said.split()[2])
    bench.station.command(answer)
    bench.run(0.6)
    assert bench.screen == ("turn" if answer == "keep_first" else "rest")
    found = read_session(bench.station.folder).excluded
    if left_out == "nothing":
        assert found == ()
        return
    assert found[0].start is not None
    assert (found[0].start < knock - 1.0) == (left_out == "before")
    bench.until(lambda: bench.said == "Turn now to position 2")


def test_mistakes_by_hand(opened: Callable[..., Bench]) -> None:
    bench = opened(None, temperature=True)
    unit = bench.unit
    bench.until(lambda: bench.screen == "turn")
    unit.mischief("lose", 0.6)
    named(bench, "gap of 0.6 s", later=0.6, answer="go_on")
    unit.mischief("stick", 2.0)
    named(bench, "ay is stuck", later=2.0, answer="go_on")
    bench.run(2.0)
    unit.turn("E", 120.0)
    unit.rock()
    bench.moved()
    named(bench, "Hold still: the unit is not yet at rest", later=1.5)
    bench.until(lambda: bench.screen == "rest")
    bench.until(lambda: bench.screen == "turn")
    unit.warm(1.0)
    named(bench, "drift of temperature", later=5.0, answer="go_on")
    unit.warm(0.0)
    unit.turn("U", 180.0, rate=12.0)
    bench.moved()
    named(bench, "is clipped at", answer="go_on")
    assert bench.state["rest"]["of"] is None
    assert len(bench.state["sphere"]["taken"]) >= 2


def test_a_clock_that_goes_back_is_named(opened: Callable[..., Bench]) -> None:
    """Three rows that agree on a wrong time cost themselves; a log whose unit was turned off is not followed any
    further."""
    bench = opened(None)
    bench.until(lambda: bench.screen == "rest")
    rows = [bench.unit.line().split(",", 1)[1] for _ in range(100)]
    bench.file.writelines(f"{900.0 + k / 100},{row}" for k, row in enumerate(rows[:3]))
    before = bench.state["received"]["samples"]
    bench.run(2.0)
    samples = bench.state["received"]["samples"]
    assert samples >= before + 200
    bench.file.writelines(f"{900.0 + k / 100},{row}" for k, row in enumerate(rows))
    bench.run(1.0)
    (said,) = bench.state["received"]["trouble"]
    assert said.startswith("the clock has gone back by 89")
    assert bench.state["received"]["samples"] < samples + 200


def restarted(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sensor is reset: its clock starts anew, and who records it goes on in another file."""
    begun, line = bench.unit.sample, Unit.line
    bench.file.close()
    files = [*bench.station._live.files]
    files.append(bench.station.folder / f"log-{len(files) + 1}.csv")
    bench.file = files[-1].open("w")
    bench.file.write(files[0].read_text().partition("\n")[0] + "\n")

    def later() -> str:
        time, _, rest = line(bench.unit).partition(",")
        return f"{float(time) - begun / SAMPLE_RATE:.9g},{rest}" if rest else ""

    monkeypatch.setattr(bench.unit, "line", later)
    source = SimpleNamespace(name="serial:/dev/ttyUSB0:115200")
    intake = SimpleNamespace(received=NOTHING_RECEIVED, ended=False, source=source, files=files, stop=lambda: None)
    monkeypatch.setattr(bench.station, "intake", intake)


def test_a_clock_that_starts_anew_costs_the_turn_or_the_part_of_the_rest_that_it_falls_into(
    opened: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a turn, in a rest that is long enough, and in one that is not: the programme goes on, and nothing of it is
    missing in the calibration, by whose files the page is begun again at the same place."""
    bench = opened("nine")
    bench.until(lambda: bench.screen == "turn")
    bench.take(2)
    bench.unit.go_to(2)
    bench.run(1.0)
    restarted(bench, monkeypatch)
    bench.moved()
    assert bench.said.startswith("the sensor's clock starts anew after ")
    assert bench.said.endswith("as when it is unplugged or reset; the recording goes on in log-2.csv")
    assert primary(bench) == ["go_on"]
    bench.until(lambda: bench.said == "Turn now to position 4")
    assert "the turn with it is not used" in bench.state["message"]
    restarted(bench, monkeypatch)
    bench.run(5.0)
    assert bench.said == "Turn now to position 4"
    assert bench.state["message"].endswith("in log-3.csv; the first part is kept; go on to the next position")
    bench.unit.go_to(3)
    bench.moved()
    bench.until(lambda: bench.screen == "rest")
    restarted(bench, monkeypatch)
    bench.run(2.0)
    assert bench.said == "At rest 4 of 9: hold still"
    assert bench.state["message"].endswith("in log-4.csv; hold still, this rest begins anew")
    bench.until(lambda: bench.screen == "turn")
    for position in range(5, 10):
        bench.take(position)
    assert bench.screen == "done"
    eventually(lambda: _stepped(bench)["estimate"]["rests"] == 9, 60.0)
    folder = bench.station.folder
    assert [Path(str(file)).name for file in read_session(folder).log.files] == [
        f"log{n}.csv" for n in ("", "-2", "-3", "-4")
    ]
    calibration = calibrate(folder)
    assert (calibration.outcome.accepted, len(calibration.evidence.rests)) == (True, 9)
    again = Station(folder, None, wanted=("accel.bias=1mg", "gyro.bias=100deg/h"))
    again.step()
    assert (again.state["screen"], again.state["rest"]) == ("done", bench.state["rest"])
    again.stop()


@pytest.mark.parametrize(("accel", "gyro", "unit"), [(1.0 / 9.80665, 57.29578, "g"), (1e3 / 9.80665, 57.29578, "mg")])
def test_another_unit_is_asked_about_in_the_first_rest(
    opened: Callable[..., Bench], accel: float, gyro: float, unit: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = opened("nine")
    whole = bench.unit.line

    def line() -> str:
        time, *values = map(float, whole().split(","))
        scaled = [value * size for value, size in zip(values, [accel] * 3 + [gyro] * 3, strict=True)]
        return ",".join(map(repr, [time, *scaled])) + "\n"

    monkeypatch.setattr(bench.unit, "line", line)
    bench.until(lambda: bench.screen == "fault")
    assert bench.said.startswith("at rest the accelerometers read ")
    assert bench.said.endswith(f" m/s²: are they in {unit}?")
    assert answers(bench)["unit"]["label"] == f"Yes, in {unit}"
    assert primary(bench) == ["unit"]
    said = bench.station.command("unit")
    assert said.startswith(f"the accelerometers are in {unit}, the gyros in deg/s; ")
    assert said.endswith("; what is recorded is read anew")
    bench.station.step()
    shown = bench.station.trace(30)
    assert shown["anew"]
    assert max(shown["a"][0]) == pytest.approx(9.8, abs=0.2)
    log = read_session(bench.station.folder).log
    assert log.accel.unit_name == unit
    assert log.gyro is not None
    assert log.gyro.unit_name == "deg/s"
    bench.until(lambda: bench.screen == "turn")
    bench.take(2)
    assert bench.screen == "turn"
    assert bench.state["fault"] is None


def test_accelerometers_in_counts_are_said_to_read_no_gravity(
    opened: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = opened("nine")
    whole = bench.unit.line
    monkeypatch.setattr(
        bench.unit,
        "line",
        lambda: ",".join(f"{float(v) * (1600.0 if i else 1.0)!r}" for i, v in enumerate(whole().split(","))) + "\n",
    )
    bench.until(lambda: bench.screen == "fault")
    assert "which is not gravity: state their unit and scale" in bench.said
    assert answers(bench).keys() == {"go_on"}


def with_gap(opened: Callable[..., Bench]) -> Bench:
    """A bench on which the log has lost 0.6 s after two positions."""
    bench = opened("nine")
    bench.until(lambda: bench.screen == "turn")
    bench.take(2)
    bench.unit.mischief("lose", 0.6)
    named(bench, "gap of 0.6 s", later=1.0)
    return bench


def test_faults_pass_when_they_are_over(opened: Callable[..., Bench]) -> None:
    bench = with_gap(opened)
    bench.unit.go_to(2)
    bench.moved()
    bench.until(lambda: bench.screen == "turn")
    assert bench.state["message"].startswith("noted: gap of 0.6 s")
    bench.unit.go_to(7)
    bench.moved()
    bench.until(lambda: bench.said.startswith("wrong position"))
    bench.run(3.0)
    bench.unit.go_to(3)
    bench.moved()
    bench.until(lambda: bench.screen in ("rest", "turn"))
    assert bench.state["rest"]["number"] in (4, 5)
    assert bench.state["excluded"] == 1
    (left_out,) = read_session(bench.station.folder).excluded
    assert left_out.reason.startswith("wrong position")
    bench.until(lambda: bench.screen == "turn")
    bench.take(5)
    assert bench.state["fault"] is None


def test_a_gap_is_over_once_a_later_position_was_left_however_early(opened: Callable[..., Bench]) -> None:
    bench = with_gap(opened)
    for position in (2, 3):
        assert bench.screen == "fault"
        bench.unit.go_to(position)
        bench.moved()
        bench.run(2.6)
    assert bench.state["message"].startswith("noted: gap of 0.6 s")
    assert bench.screen in ("rest", "turn")


def test_an_unplugged_sensor_is_the_headline(opened: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch) -> None:
    bench = opened("nine")
    bench.until(lambda: bench.screen == "turn")
    received = {**NOTHING_RECEIVED, "silent": True}
    source = SimpleNamespace(name="serial:/dev/ttyUSB0:115200")
    stopped = SimpleNamespace(received=received, ended=False, source=source, files=[], stop=lambda: None)
    monkeypatch.setattr(bench.station, "intake", stopped)
    bench.station.step()
    assert bench.state["headline"] == "Nothing comes from the sensor: is it plugged in?"
    received["silent"] = False
    bench.station.step()
    assert bench.state["headline"].startswith("Turn now")


def test_a_source_that_stutters_leaves_few_faults(opened: Callable[..., Bench]) -> None:
    bench = opened("nine")
    rows = [bench.unit.line().split(",", 1)[1] for _ in range(100)]
    times = [0.01 * k for k in range(1, 1001)] + [10.0 + 0.4 * k for k in range(1, 301)]
    bench.file.writelines(f"{at:.2f},{rows[k % 100]}" for k, at in enumerate(times))
    bench.file.flush()
    bench.station.step()
    assert bench.state["received"]["lost"] == 280 * 39  # the last rows may yet turn out to be ahead of their time
    assert bench.said.startswith("gap of 0.4 s at ")
    bench.station.command("go_on")
    bench.station.step()
    assert bench.said.startswith("gap of 0.4 s at ")
    for _ in range(63):
        bench.station.command("go_on")
    bench.station.step()
    assert bench.state["fault"] is None


def test_noise_of_coarse_resolution_is_not_stuck() -> None:
    rng, time = np.random.default_rng(1), np.arange(3000) / 100.0
    values = np.round(rng.standard_normal((3000, 3)) * 0.05)
    watch = SampleWatch(("ax", "ay", "az"), None, 0.01)
    assert [seen for i in range(0, 3000, 20) for seen in watch.look(time[i : i + 20], values[i : i + 20])] == []


def test_wishes_are_those_that_are_stated_and_else_the_grades() -> None:
    found = wanted_by_group(("gyro.scale=2ppm",), "tactical")
    assert found["gyro.scale"] == pytest.approx(2e-6)
    assert set(found) == {f"{kind}.{what}" for kind in ("accel", "gyro") for what in ("bias", "scale", "axis")}
    with pytest.raises(InputError, match="want"):
        wanted_by_group(("gyro.scal=2ppm",), "tactical")


@pytest.mark.parametrize("gravity_u", [3e-4, 4e-3], ids=["height known", "height unknown"])
def test_a_further_rest_leaves_of_the_uncertainty_what_was_forecast(gravity_u: float) -> None:
    """u over the wanted u, root mean square, before and after each of a session's rests, forecast at its attitude."""
    setup = Setup.of(grade="mems", positions=20, rest=10.0, gravity_u=gravity_u)
    session = replace(read_session(shared_session(setup, seed=2)), programme=None)
    task = Task.of(session, Wanted.of((), "mems"), "mems")
    reduction, block, wanted = inspect_session(session).reduction, session.accel_block, task.wanted
    rests = find_rests(reduction, block, session.gyro_block)
    weights = np.array([1.0 / wanted.group[group_name(name)] for name in block.names])
    ratios = []
    for count in range(10, 20, 2):
        u = []
        for number in (count, count + 1):
            estimate = estimate_so_far(session, "mems", reduction, replace(rests, rests=rests.rests[:number]), ())
            assert estimate is not None
            u.append(np.linalg.norm(weights * estimate.u[[estimate.names.index(name) for name in block.names]]))
            if number == count:
                before = estimate
        observed = observe(reduction, rests.rests[: count + 1], block, session.gyro_block, session.site)
        up = unit_vector(observed.rests.accel[-1:])
        forecast = gains(before, wanted.group, block, wanted.accel, session.site, up)[0]
        ratios.append(u[1] / u[0] / forecast)
    assert np.all(np.abs(np.array(ratios) - 1.0) < 0.1)


@pytest.mark.parametrize(
    ("gain", "said"), [(0.23, "X up, Z up: uncertainty of the accelerometers 23 % smaller"), (0.004, "")]
)
def test_the_best_next_rest_is_named_with_its_gain_or_not_at_all(gain: float, said: str) -> None:
    """Where gravity, which every rest shares, is most of u, the best direction is arbitrary and gains nothing."""
    along = DIRECTIONS @ np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0)
    assert best_next(1.0 - gain * np.maximum(along, 0.0) ** 2) == said
