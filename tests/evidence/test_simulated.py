"""The generator of simulated cases: its own physics, held against geometry and kinematics."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from evidence.case import NAMES, matrix_of
from evidence.simulated.device import Sensors, Sweep, axes_matrix
from evidence.simulated.kinds import FURTHER, KINDS, SEALED, SHORT, named, seed_of, simulated
from evidence.simulated.motion import DEG, EARTH_RATE, Course, Handling, course
from evidence.simulated.waving import Waving, waved
from tests.support import ROOT

pytestmark = pytest.mark.weekly

SERIES = "test"
MOVING = Handling(rests=6, rest=2.0, first_rest=3.0, tremor=2.0 * DEG, ringing=(1.0 * DEG, 8.0, 0.2))


def drawn(handling: Handling, seed: int = 1) -> Course:
    return course(handling, np.random.default_rng(seed))


def body_to_n(way: Course, t: np.ndarray) -> Rotation:
    w, x, y, z = way.pose(t)[0].T
    return Rotation.from_quat(np.column_stack([x, y, z, w]))


def test_the_generator_imports_nothing_of_tumble() -> None:
    code = "import sys, evidence.simulated.kinds; sys.exit(any(m.split('.')[0] == 'tumble' for m in sys.modules))"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


def test_there_are_thirty_kinds_and_more_and_each_has_a_name_of_its_own() -> None:
    assert len({kind.name for kind in KINDS}) == len(KINDS) >= 30
    for kind in KINDS:
        assert bool(kind.says) == (kind.expected in ("name the cause", "accept with scatter")), kind.name


def test_seeds_of_the_published_table_are_none_of_the_tests() -> None:
    seeds = {
        series: {seed_of(series, kind.name, i) for kind in KINDS for i in range(50)}
        for series in (SEALED, SHORT, SERIES)
    }
    assert not seeds[SEALED] & seeds[SERIES]
    assert not seeds[SEALED] & seeds[SHORT]
    assert not seeds[SHORT] & seeds[SERIES]


def test_a_session_is_drawn_by_its_seed_alone() -> None:
    one, again, other = (simulated(named("hand-8"), i, SERIES) for i in (0, 0, 1))
    assert np.array_equal(one.accel, again.accel)
    assert one.truth == again.truth
    assert one.truth != other.truth


def test_rates_integrate_to_the_attitudes() -> None:
    way = drawn(MOVING)
    dt = 5e-4
    t = np.arange(0.0, way.duration, dt)
    rate, _ = way.felt(t + 0.5 * dt, np.zeros((1, 3)))
    turned = Rotation.identity()
    for step in Rotation.from_rotvec(rate * dt):
        turned = turned * step
    spun_by_earth = EARTH_RATE * (t[-1] + dt) * np.array([np.cos(way.latitude), np.sin(way.latitude), 0.0])
    begin, end = body_to_n(way, np.array([0.0, t[-1] + dt]))
    in_n = Rotation.from_rotvec(-spun_by_earth) * begin * turned
    assert (in_n.inv() * end).magnitude() < 2e-6  # of the midpoints of intervals of 0.5 ms at 10 Hz


def test_the_force_at_a_place_is_gravity_and_the_acceleration_of_the_place() -> None:
    way = drawn(MOVING)
    lever = np.array([0.03, -0.02, 0.01])
    t, h = np.linspace(1.0, way.duration - 0.1, 400), 2e-4

    def place(at: np.ndarray) -> np.ndarray:
        return way.pose(at)[1] + body_to_n(way, at).apply(lever)

    acceleration = (place(t + h) - 2.0 * place(t) + place(t - h)) / h**2
    expected = body_to_n(way, t).inv().apply(acceleration + way.gravity * np.array([0.0, 1.0, 0.0]))
    _, force = way.felt(t, lever[None])
    assert np.abs(expected - force[:, 0]).max() < 2e-3 * np.abs(expected - way.gravity).max()


@pytest.mark.parametrize("programme", ["hand", "table", "cube", "faces"])
def test_at_rest_gravity_and_the_rate_of_the_earth_are_felt(programme: str) -> None:
    way = drawn(Handling(programme=programme, rest=2.0, turn=1.0, off=1.0 * DEG))
    for begin, end in way.rests:
        rate, force = way.felt(np.linspace(begin + 0.1, end - 0.1, 5), np.ones((1, 3)))
        assert np.linalg.norm(force[:, 0], axis=1) == pytest.approx(way.gravity, rel=1e-12)
        assert np.linalg.norm(rate, axis=1) == pytest.approx(EARTH_RATE, rel=1e-9)


def test_a_rough_table_turns_by_half_a_turn_about_north_and_up() -> None:
    way = drawn(Handling(programme="table", off=1.0 * DEG))
    assert len(way.attitudes) == 15
    half = [k for k in range(14) if k % 4 != 3 and k < 11]
    assert np.linalg.norm(way.vectors[half], axis=1) == pytest.approx(np.pi, abs=6.0 * DEG)
    in_n = body_to_n(way, way.begin[half]).apply(way.vectors[half]) / np.pi
    assert np.abs(in_n - np.tile([[1, 0, 0], [0, 1, 0], [-1, 0, 0]], (3, 1))).max() < 0.1
    first = body_to_n(way, way.rests[[0, 4, 8], 0] + 0.1).as_matrix()
    for matrix, axes in zip(first, ([0, 1, 2], [2, 0, 1], [1, 2, 0]), strict=True):
        assert np.abs(matrix - np.eye(3)[:, axes]).max() < 0.15  # NUE, ENU, UEN


def test_the_axes_matrix_is_the_one_in_which_truths_are_stated() -> None:
    angles = dict(zip(("xy", "xz", "yx", "yz", "zx", "zy"), np.random.default_rng(2).normal(size=6), strict=True))
    stated = matrix_of({f"gyro.axis.{pair}": angle for pair, angle in angles.items()}, "gyro")
    assert axes_matrix(angles) == pytest.approx(stated, abs=1e-15)


@pytest.mark.parametrize("kind", ["hand-8", "hand-alone", "faces"])
def test_readings_at_rest_are_what_the_truth_makes_of_gravity(kind: str) -> None:
    """Within what is beyond the linear model: 0.3 %."""
    case = simulated(named(kind), 0, SERIES)
    assert case.truth is not None
    assert set(case.truth) == {name for name in NAMES if case.gyro is not None or name.startswith("accel")}
    first = case.between(0.0, 8.0).accel.mean(axis=0)
    bias = np.array([case.truth[f"accel.bias.{axis}"] for axis in "xyz"])
    force = np.linalg.solve(matrix_of(case.truth, "accel"), first - bias)
    assert np.linalg.norm(force) == pytest.approx(case.gravity, rel=3e-3)


def test_files_have_what_their_kind_says() -> None:
    plain = simulated(named("hand-30"), 0, SERIES)
    intervals = np.diff(plain.time)
    assert np.ptp(intervals) < 1e-6
    assert np.diff(simulated(named("jitter"), 0, SERIES).time).std() == pytest.approx(np.sqrt(2) * 1e-3, rel=0.05)
    assert np.mean(np.diff(simulated(named("twice"), 0, SERIES).time) == 0.0) == pytest.approx(0.005, abs=0.002)
    stamped, counted = (simulated(named(name), 0, SERIES) for name in ("lost-stamped", "lost-counted"))
    assert np.mean(np.diff(stamped.time) > 0.015) == pytest.approx(0.005, abs=0.002)
    assert np.ptp(np.diff(counted.time)) < 1e-9
    clipped = simulated(named("clipped"), 0, SERIES).gyro
    assert clipped is not None
    assert np.abs(clipped).max() == pytest.approx(60.0 * DEG)
    zone = simulated(named("dead-zone"), 0, SERIES).gyro
    assert zone is not None
    assert 0.0 < np.mean(zone == 0.0) < 0.5
    assert np.abs(zone[zone != 0.0]).min() >= 0.15 * DEG
    assert np.linalg.norm(simulated(named("normalised"), 0, SERIES).accel, axis=1).std() < 1e-12
    assert np.median(np.linalg.norm(simulated(named("no-gravity"), 0, SERIES).accel, axis=1)) < 0.3
    warm = simulated(named("warm-8"), 0, SERIES).temperature
    assert warm is not None
    assert warm[-1] - warm[0] == pytest.approx(8.0, abs=1.0)
    assert simulated(named("warm-unseen"), 0, SERIES).temperature is None


def test_a_low_pass_leaves_rests_and_takes_half_of_a_tremor_at_its_limit() -> None:
    """Its noise falls with its band, the mean of a rest stays."""
    plain, filtered = (simulated(named(name), 0, SERIES) for name in ("hand-30", "low-pass-20"))
    quiet = [case.between(5.0, 15.0).accel.std(axis=0).mean() for case in (plain, filtered)]
    assert quiet[1] / quiet[0] == pytest.approx(np.sqrt(20.0 * 1.11 / 50.0), rel=0.1)


# -------------------- other kinds of recordings --------------------


@pytest.mark.parametrize("style", ["rhythmic", "jerky"])
def test_what_a_waved_device_feels_is_its_motion(style: Literal["rhythmic", "jerky"]) -> None:
    """Rates integrate to the attitudes, and the force is gravity and the acceleration of the place."""
    way = waved(Waving(style=style, seconds=12.0, sway=0.03, drift=0.1, grips=2), np.random.default_rng(3))
    dt = 1e-3
    t = np.arange(0.0, 11.0, dt)
    rate, force = way.felt(t + 0.5 * dt, np.zeros((1, 3)))
    turned = Rotation.identity()
    for step in Rotation.from_rotvec(rate * dt):
        turned = turned * step
    spun = EARTH_RATE * (t[-1] + dt) * np.array([np.cos(way.latitude), np.sin(way.latitude), 0.0])
    begin, end = body_to_n(way, np.array([0.0, t[-1] + dt]))
    assert (Rotation.from_rotvec(-spun) * begin * turned * end.inv()).magnitude() < 2e-5
    at, h = t[20::100] + 0.5 * dt, 2e-4
    acceleration = (way.pose(at + h)[1] - 2.0 * way.pose(at)[1] + way.pose(at - h)[1]) / h**2
    expected = body_to_n(way, at).inv().apply(acceleration + way.gravity * np.array([0.0, 1.0, 0.0]))
    assert np.abs(expected - force[20::100, 0]).max() < 2e-3 * np.abs(expected).max()


@pytest.mark.parametrize("kind", [kind.name for kind in FURTHER if kind.waving and kind.waving.style != "still"])
def test_a_waved_device_never_lies_still_for_a_second(kind: str) -> None:
    gyro = simulated(named(kind), 0, SERIES).gyro
    assert gyro is not None
    moving = (np.linalg.norm(gyro, axis=1) > 3.0 * DEG).astype(float)
    assert np.convolve(moving, np.ones(100), mode="valid").min() > 0.0


def test_a_device_hangs_by_its_lever_and_is_gripped_anew() -> None:
    way = waved(Waving(grips=3, lever=0.2, sway=0.0), np.random.default_rng(4))
    t = np.array([1.0, 30.0, 50.0, 70.0, 100.0, 119.0])
    assert np.linalg.norm(way.pose(t)[1], axis=1) == pytest.approx(0.2)
    levers = body_to_n(way, t).inv().apply(way.pose(t)[1])
    assert levers[[0, 2, 4]] == pytest.approx(way.levers)
    assert levers[[1, 3, 5]] == pytest.approx(way.levers)


def test_kinds_with_the_same_devices_have_them() -> None:
    truths = [simulated(named(kind), 1, SERIES).truth or {} for kind in ("rests-120", "pivot", "hand-drifting")]
    for truth in truths[1:]:
        assert truth["gyro.scale.x"] == truths[0]["gyro.scale.x"]
        assert truth["accel.axis.zy"] == truths[0]["accel.axis.zy"]


@pytest.mark.parametrize("way", ["warming", "cooling", "both"])
def test_readings_change_with_temperature_by_what_is_true(way: Literal["warming", "cooling", "both"]) -> None:
    """Without a lag, means of the readings within a quarter of a kelvin of the ends, less those of the middle; of
    biases alone the gyros' are the same."""
    steady = Sensors(rate=25.0, sweep=Sweep(span=(30.0, 30.0), lag=(0.0, 0.0), way=way))
    kind = replace(named("warming"), name="steady", sensors=steady)
    case = simulated(kind, 0, SERIES)
    assert case.ends is not None
    assert case.temperature is not None
    assert case.gyro is not None
    assert case.truth is not None
    assert case.ends[2] - case.ends[0] == pytest.approx(0.8 * 30.0, rel=1e-3)
    for sensors, readings in (("accel", case.accel), ("gyro", case.gyro)):
        near = [readings[np.abs(case.temperature - at) < 0.25] for at in case.ends]
        u = np.sqrt(sum(some.var(axis=0) / len(some) for some in near)).max()
        low, middle, high = (some.mean(axis=0) for some in near)
        for end, mean in (("low", low), ("high", high)):
            true = np.array([case.truth[f"{sensors}.change.{axis}.{end}"] for axis in "xyz"])
            assert np.abs(mean - middle - true).max() < 0.01 * np.abs(true).max() + 4.0 * u
    assert case.truth["gyro.change.x.low"] == case.truth["gyro.thermal.x.low"]
    assert case.truth["accel.change.x.low"] != case.truth["accel.thermal.x.low"]


def test_sensors_are_late_by_their_lag_and_the_thermometer_shows_whole_degrees() -> None:
    late, prompt = (
        simulated(replace(named("warming"), sensors=Sensors(rate=25.0, sweep=sweep)), 0, SERIES).gyro
        for sweep in (Sweep(span=(40.0, 40.0), lag=(lag, lag)) for lag in (100.0, 0.0))
    )
    assert late is not None
    assert prompt is not None
    # what goes as an exponential of c s, at least 240, is λ c/(c − λ) times its rate behind; λ is up to 30 % off 100 s
    t = np.arange(0.0, 1200.0, 1.0)
    slow, quick = (np.polyfit(t, readings[::25, 0], 7) for readings in (late, prompt))
    behind = (np.polyval(quick, 600.0) - np.polyval(slow, 600.0)) / np.polyval(np.polyder(quick), 600.0)
    assert 70.0 < behind < 284.0
    whole = simulated(named("whole-degrees"), 0, SERIES).temperature
    assert whole is not None
    assert (whole == np.round(whole)).all()


def test_the_field_is_of_its_modulus_once_hard_and_soft_iron_are_taken_off() -> None:
    case = simulated(named("soft-iron"), 0, SERIES)
    assert case.mag is not None
    assert case.truth is not None
    bias = np.array([case.truth[f"mag.bias.{axis}"] for axis in "xyz"])
    angles = {name: value for name, value in case.truth.items() if name.startswith("mag.")}
    matrix = matrix_of({name.replace("mag", "gyro"): value for name, value in angles.items()}, "gyro")
    length = np.linalg.norm(np.linalg.solve(matrix, (case.mag - bias).T), axis=0)
    assert length.mean() == pytest.approx(case.mag_field, rel=2e-3)
    assert length.std() < 0.02 * length.mean()
    assert np.linalg.norm(case.mag, axis=1).std() > 0.05 * length.mean()


def test_gyros_alone_have_no_accelerometers() -> None:
    case = simulated(named("gyros"), 0, SERIES)
    assert case.accel.shape == (len(case.time), 0)
    assert set(case.truth or {}) == {f"gyro.bias.{axis}" for axis in "xyz"}
