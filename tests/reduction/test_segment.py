"""Rests and turns: found without any setting, the same for any chunks, and nothing found where nothing rests."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tumble.planning.setup import Setup
from tumble.recording.log import Chunk
from tumble.reduction.blocks.reducer import Reducer, Reduction
from tumble.reduction.rests.segmentation import Segmentation, Stretch, find_rests
from tumble.rotation import rotation_matrix
from tumble.sensors.model import Block
from tumble.simulation.recording import Recording, record
from tumble.simulation.scenario import NO_VIBRATION, Scenario, Vibration, scenario_of
from tumble.simulation.temperature_profile import TemperatureProfile, draw_thermal
from tumble.units import DEGREE, G_STANDARD, Array

ACCEL, GYRO = Block(kind="accel", axes=np.eye(3)), Block(kind="gyro", axes=np.eye(3))
GRADES = ("navigation", "tactical", "mems", "consumer")
VIBRATIONS = {
    "still": Vibration(),
    "0.05 at 30 Hz": Vibration(amplitude=0.05, frequency=30.0),
    "0.3 at 80 Hz": Vibration(amplitude=0.3, frequency=80.0),
    # 30 and 80 Hz are whole cycles in a block of 0.1 s; these are not
    "0.05 at 33.7 Hz": Vibration(amplitude=0.05, frequency=33.7),
    "0.3 at 83.3 Hz": Vibration(amplitude=0.3, frequency=83.3),
}
MOST_LOST = 1.2  # s at either end of a rest: the margin, and a block


def chunks(
    time: Array, accel: Array, gyro: Array | None, *, sizes: Sequence[int] = (), file: int = 0
) -> Iterator[Chunk]:
    """Samples at these end times in chunks of these sizes, the last of what is left."""
    dt = np.full(len(time), time[0])
    edges = np.unique(np.minimum(np.cumsum([0, *sizes, len(time)]), len(time)))
    for start, stop in pairwise(edges.tolist()):
        part = slice(start, stop)
        yield Chunk(
            file=file,
            time=time[part],
            dt=dt[part],
            accel=accel[part],
            gyro=None if gyro is None else gyro[part],
            temperature=None,
        )


def reduced(time: Array, accel: Array, gyro: Array | None, sizes: Sequence[int] = ()) -> Reduction:
    reducer = Reducer(rate=1.0 / time[0], accel=ACCEL, gyro=None if gyro is None else GYRO)
    for chunk in chunks(time, accel, gyro, sizes=sizes):
        reducer.feed(chunk)
    return reducer.now()


def found(time: Array, accel: Array, gyro: Array | None) -> Segmentation:
    return find_rests(reduced(time, accel, gyro), ACCEL, None if gyro is None else GYRO)


def scenario(request: Setup, seed: int, vibration: Vibration = NO_VIBRATION) -> Scenario:
    """A typical scenario whose first rest is like the others."""
    made = scenario_of(request, np.random.default_rng(seed), serial="S", vibration=vibration)
    return made.changed(first_rest=made.setup.rest)


def recorded(request: Setup, seed: int, vibration: Vibration = NO_VIBRATION) -> Recording:
    return record(scenario(request, seed, vibration), np.random.default_rng(seed + 1000))


def times(rests: Sequence[Stretch]) -> Array:
    return np.array([(r.start, r.stop) for r in rests]).reshape(-1, 2)


def assert_all_found(recording: Recording, segmentation: Segmentation, most_lost: float = MOST_LOST) -> None:
    """Every true rest was found, alone, inside its true times and with little lost."""
    rests, true = times(segmentation.rests), recording.rests
    assert len(rests) == len(true)
    inside = np.column_stack([rests[:, 0] - true[:, 0], true[:, 1] - rests[:, 1]])
    assert inside.min() > -1e-9
    assert inside.max() < most_lost


# -------------------- blocks --------------------


@pytest.fixture(scope="module")
def session() -> Recording:
    return recorded(Setup.of(grade="mems", programme="nine", rest=4.0, rate_deg_s=60.0, sample_rate=37.0), 7)


@settings(max_examples=60, deadline=None)
@given(sizes=st.lists(st.integers(1, 400), max_size=40))
def test_blocks_and_rests_do_not_depend_on_the_chunks(session: Recording, sizes: list[int]) -> None:
    accel = np.round(session.accel, 1)  # so that samples repeat
    whole = reduced(session.time, accel, session.gyro)
    cut = reduced(session.time, accel, session.gyro, sizes)
    assert_same(whole, cut)
    assert find_rests(cut, ACCEL, GYRO) == find_rests(whole, ACCEL, GYRO)


def test_blocks_and_rests_do_not_depend_on_chunks_of_a_single_sample(session: Recording) -> None:
    few = slice(0, 600)
    whole = reduced(session.time[few], session.accel[few], session.gyro[few])
    single = reduced(session.time[few], session.accel[few], session.gyro[few], [1] * 600)
    assert_same(whole, single)
    assert find_rests(single, ACCEL, GYRO) == find_rests(whole, ACCEL, GYRO)


def assert_same(a: Reduction, b: Reduction) -> None:
    """Two reductions of the same log: equal to the bit."""
    assert len(a.files) == len(b.files)
    for one, other in zip(a.files, b.files, strict=True):
        np.testing.assert_array_equal(one.edges, other.edges)
        for ours, theirs in ((one.accel, other.accel), (one.gyro, other.gyro)):
            np.testing.assert_array_equal(ours.means, theirs.means)
            np.testing.assert_array_equal(ours.mean(0, len(one)), theirs.mean(0, len(one)))
    assert a.accel_channels == b.accel_channels
    assert a.gyro_channels == b.gyro_channels
    assert a.samples is not None
    assert b.samples is not None
    assert a.samples.count == b.samples.count
    for left, right in zip(a.samples.read(3, a.samples.count), b.samples.read(3, b.samples.count), strict=True):
        np.testing.assert_array_equal(left, right)


def test_a_block_is_the_mean_of_its_samples(session: Recording) -> None:
    reduction = reduced(session.time, session.accel, session.gyro)
    (file,) = reduction.files
    assert file.size == 3  # 0.1 s at 37 Hz and no more
    whole = len(session.time) // 3
    assert len(file) == whole
    np.testing.assert_allclose(file.accel.means, session.accel[: 3 * whole].reshape(-1, 3, 3).mean(axis=1), atol=1e-11)
    np.testing.assert_allclose(file.edges[1:], session.time[2::3][:whole], atol=1e-12)
    np.testing.assert_allclose(file.accel.mean(whole - 5, whole), session.accel[3 * whole - 15 :].mean(axis=0))


def test_a_stated_rest_is_the_whole_blocks_inside_its_times(session: Recording) -> None:
    span = Stretch.between(reduced(session.time, session.accel, session.gyro).files[0], 1.0, 3.0)
    block = 3.0 / 37.0
    assert 1.0 - 1e-9 <= span.start < 1.0 + block
    assert 3.0 - block < span.stop <= 3.0 + 1e-9
    assert (span.last - span.first) * block == pytest.approx(span.stop - span.start)


# -------------------- what is found without any setting --------------------


@pytest.mark.parametrize("vibration", VIBRATIONS)
@pytest.mark.parametrize("rate", [20.0, 50.0, 200.0, 2000.0])
@pytest.mark.parametrize("grade", GRADES)
def test_every_rest_is_found(grade: str, rate: float, vibration: str) -> None:
    """Nine positions, rests of 6 s, turns at 40 °/s."""
    request = Setup.of(
        grade=grade,
        programme="nine",
        rest=6.0,
        rate_deg_s=40.0,
        sample_rate=rate,
    )
    recording = recorded(request, 11, VIBRATIONS[vibration])
    assert_all_found(recording, found(recording.time, recording.accel, recording.gyro))


@pytest.mark.parametrize("vibration", VIBRATIONS)
@pytest.mark.parametrize("grade", GRADES)
def test_every_rest_is_found_without_gyros(grade: str, vibration: str) -> None:
    for rate in (20.0, 200.0):
        request = Setup.of(
            grade=grade,
            programme="nine",
            rest=6.0,
            rate_deg_s=40.0,
            sample_rate=rate,
        )
        recording = recorded(request, 12, VIBRATIONS[vibration])
        assert_all_found(recording, found(recording.time, recording.accel, None))


@pytest.mark.parametrize("grade", GRADES)
def test_every_rest_in_the_hand_is_found(grade: str) -> None:
    """Thirty positions of 5 s, moves at 80 °/s."""
    recording = recorded(Setup.of(grade=grade, positions=30, sample_rate=50.0), 13)
    assert_all_found(recording, found(recording.time, recording.accel, recording.gyro))
    assert_all_found(recording, found(recording.time, recording.accel, None))


@pytest.mark.parametrize("grade", GRADES)
def test_rests_are_found_where_slow_turns_take_most_of_the_log(grade: str) -> None:
    """At 5 °/s the turns take four fifths of the log, and each is as steady as a rest."""
    for seed in range(3):
        recording = recorded(Setup.of(grade=grade, programme="nine", rest=6.0, rate_deg_s=5.0, sample_rate=20.0), seed)
        resting = float(np.diff(recording.rests).sum() / recording.time[-1])
        assert resting < 0.25
        assert_all_found(recording, found(recording.time, recording.accel, recording.gyro))


def test_short_turns_between_long_rests_are_found() -> None:
    request = Setup.of(grade="consumer", programme="nine", rest=60.0, rate_deg_s=300.0, sample_rate=20.0)
    recording = recorded(request, 14)
    assert_all_found(recording, found(recording.time, recording.accel, recording.gyro))


@pytest.mark.parametrize("grade", ["navigation", "tactical"])
def test_a_turn_about_the_vertical_is_found_without_gyros(grade: str) -> None:
    """Turns of the table about a vertical that is off by a degree hardly show in an accelerometer."""
    recording = recorded(Setup.of(grade=grade, rest=20.0, sample_rate=20.0), 15)
    rests = times(found(recording.time, recording.accel, None).rests)
    assert len(rests) == len(recording.rests) == 15
    assert np.abs(rests - recording.rests).max() < MOST_LOST


@pytest.mark.parametrize("grade", GRADES)
def test_rests_are_found_while_the_gyros_drift(grade: str) -> None:
    """Over the session the bias drifts by ten times the limit of the rate that is found without it."""
    recording = recorded(Setup.of(grade=grade, programme="nine", rest=20.0, rate_deg_s=40.0, sample_rate=50.0), 16)
    limit = found(recording.time, recording.accel, recording.gyro).rate_limit
    assert limit is not None
    phase = recording.time / recording.time[-1]
    for shape in (phase, np.sin(2.0 * np.pi * phase)):
        drift = 10.0 * limit * shape[:, None] * np.array([0.6, 0.0, -0.8])
        assert_all_found(recording, found(recording.time, recording.accel, recording.gyro + drift))


@pytest.mark.parametrize("grade", GRADES)
@pytest.mark.parametrize("gyros", [True, False])
def test_a_knock_splits_a_rest_and_is_in_neither_part(grade: str, gyros: bool) -> None:
    """30 ms of 5 m/s² and a rock to and fro of 0.2° in the middle of a rest of 20 s."""
    recording = recorded(Setup.of(grade=grade, programme="nine", rest=20.0, rate_deg_s=40.0, sample_rate=200.0), 17)
    start, stop = recording.rests[4]
    accel, gyro = recording.accel.copy(), recording.gyro.copy()
    knock = round((start + 10.0) * 200.0)
    accel[knock : knock + 6] += 5.0
    gyro[knock : knock + 6] += 0.1
    gyro[knock + 6 : knock + 12] -= 0.1
    spans = times(found(recording.time, accel, gyro if gyros else None).rests)
    before, after = spans[(spans[:, 1] > start) & (spans[:, 0] < stop)]
    assert len(spans) == len(recording.rests) + 1
    assert start - 1e-9 < before[0] < start + MOST_LOST
    assert start + 10.0 - 2.0 < before[1] < start + 10.0
    assert start + 10.06 < after[0] < start + 10.06 + 2.0
    assert stop - MOST_LOST < after[1] < stop + 1e-9


# -------------------- nothing but rest, and no rest --------------------


@pytest.mark.parametrize("noise", [0.0, 1.0])
@pytest.mark.parametrize("gyros", [True, False])
def test_a_log_entirely_at_rest_is_one_rest(gyros: bool, noise: float) -> None:
    rng = np.random.default_rng(18)
    time = np.arange(1, 3001) / 50.0
    accel = np.array([0.1, 9.8, -0.2]) + noise * 0.01 * rng.standard_normal((3000, 3))
    gyro = np.array([1e-3, 2e-3, -1e-3]) + noise * 1e-3 * rng.standard_normal((3000, 3))
    segmentation = found(time, accel, gyro if gyros else None)
    np.testing.assert_allclose(times(segmentation.rests), [[0.0, 60.0]], atol=1e-9)
    assert segmentation.rejected == ()


def moving(kind: str, rate: float = 50.0, seconds: float = 60.0) -> tuple[Array, Array, Array]:
    """Time, accelerometers and gyros of a body that never rests."""
    rng = np.random.default_rng(19)
    time = np.arange(1, round(rate * seconds) + 1) / rate
    if kind == "steady rotation":
        omega = np.tile([0.2, 0.15, 0.25], (len(time), 1))
    elif kind == "rocking":
        omega = np.column_stack([np.sin(2.0 * np.pi * f * time) for f in (0.11, 0.17, 0.23)])
    else:
        omega = 0.02 * np.cumsum(rng.standard_normal((len(time), 3)), axis=0)
    attitude, force = np.eye(3), np.empty((len(time), 3))
    for i, step in enumerate(rotation_matrix(omega / rate)):
        attitude = attitude @ step
        force[i] = attitude.T @ np.array([0.0, 9.8, 0.0])
    accel = force + 0.01 * rng.standard_normal(force.shape)
    return time, accel, omega + 1e-3 * rng.standard_normal(omega.shape)


@pytest.mark.parametrize("kind", ["steady rotation", "rocking", "random"])
@pytest.mark.parametrize("gyros", [True, False])
def test_a_log_without_a_rest_has_none_and_says_why(kind: str, gyros: bool) -> None:
    time, accel, gyro = moving(kind)
    segmentation = found(time, accel, gyro if gyros else None)
    assert segmentation.rests == ()
    assert segmentation.rejected
    assert all(r.reason for r in segmentation.rejected)


def test_a_stretch_too_short_for_a_rest_is_rejected_with_its_duration() -> None:
    request = Setup.of(grade="mems", programme="nine", rest=6.0, rate_deg_s=40.0, sample_rate=50.0)
    recording = recorded(request, 20)
    short = record(scenario(request, 20).changed(rest=1.5), np.random.default_rng(1020))
    segmentation = found(short.time, short.accel, short.gyro)
    assert len(segmentation.rests) == 1  # the first, of 6 s
    assert len(segmentation.rejected) == len(recording.rests) - 1
    assert all("too short" in r.reason for r in segmentation.rejected)


def test_a_vibrating_stretch_is_rejected_with_its_scatter() -> None:
    request = Setup.of(grade="mems", programme="nine", rest=8.0, rate_deg_s=40.0, sample_rate=50.0)
    recording = recorded(request, 21)
    start, stop = recording.rests[3]
    shaken = (recording.time > start + 0.02) & (recording.time <= stop)
    shake = 5.0 * np.sin(2.0 * np.pi * 2.3 * recording.time) * shaken
    segmentation = found(recording.time, recording.accel + shake[:, None], recording.gyro)
    assert len(segmentation.rests) == len(recording.rests) - 1
    (rejected,) = [r for r in segmentation.rejected if "scatter" in r.reason]
    assert start - 1.0 < rejected.start < rejected.stop < stop + 1.0


# -------------------- gyros that feel specific force --------------------


def with_g_sensitivity(recording: Recording, seed: int, size: float = 0.1) -> Recording:
    """Each gyro reads about 0.1 °/s more per g along each axis."""
    matrix = size * DEGREE / G_STANDARD * np.random.default_rng(seed).standard_normal((3, 3))
    return replace(recording, gyro=recording.gyro + recording.accel @ matrix.T)


@pytest.mark.parametrize("programme", [None, "cube-26", "nine"])
@pytest.mark.parametrize("grade", ["tactical", "mems", "consumer"])
def test_every_rest_is_found_where_the_level_of_the_gyros_depends_on_the_attitude(
    grade: str, programme: str | None
) -> None:
    for seed in (31, 32):
        if programme is None:
            recording = recorded(Setup.of(grade=grade, positions=26, sample_rate=50.0), seed)
        else:
            recording = recorded(Setup.of(grade=grade, programme=programme, rest=5.0, sample_rate=50.0), seed)
        recording = with_g_sensitivity(recording, seed)
        assert_all_found(recording, found(recording.time, recording.accel, recording.gyro))


def on_six_faces(grade: str, seed: int) -> Recording:
    """Once each, with gyros that feel specific force."""
    whole = recorded(Setup.of(grade=grade, programme="nine", rest=8.0, sample_rate=50.0), seed)
    kept = whole.time <= whole.rests[5, 1]
    cut = replace(whole, time=whole.time[kept], accel=whole.accel[kept], gyro=whole.gyro[kept], rests=whole.rests[:6])
    return with_g_sensitivity(cut, seed)


@pytest.mark.parametrize("grade", ["tactical", "mems", "consumer"])
def test_six_faces_are_enough_for_gyros_that_feel_specific_force(grade: str) -> None:
    for seed in (31, 32, 33, 34):
        recording = on_six_faces(grade, seed)
        assert_all_found(recording, found(recording.time, recording.accel, recording.gyro))


@pytest.mark.parametrize("turning", range(6))
def test_a_slow_turn_about_the_vertical_on_one_of_six_faces_is_no_rest(turning: int) -> None:
    for seed in (33, 34):
        recording = on_six_faces("mems", seed)
        start, stop = recording.rests[turning]
        during = (recording.time > start) & (recording.time <= stop)
        up = recording.accel[during].mean(axis=0)
        gyro = recording.gyro.copy()
        gyro[during] += 0.5 * DEGREE * up / np.linalg.norm(up)
        rests = found(recording.time, recording.accel, gyro).rests
        assert len(rests) == 1 or not any(r.start < stop and r.stop > start for r in rests)


@pytest.mark.parametrize("seed", [207, 208])
def test_every_rest_is_found_where_gyros_that_feel_force_also_warm(seed: int) -> None:
    """MEMS units with all terms of usual size that warm by 20 K in some four minutes."""
    setup, rng = Setup.of(grade="mems", positions=26, sample_rate=25.0, terms="full"), np.random.default_rng(seed)
    unit = scenario_of(setup, rng)
    thermal = draw_thermal(setup.further, "mems", {"accel": unit.accel, "gyro": unit.gyro}, rng)
    climate = TemperatureProfile(celsius=(15.0, 35.0)).climate(240.0)
    unit = replace(unit, truth=dict(unit.truth) | thermal, climate=climate)
    recording = record(unit, np.random.default_rng([seed, 1]))
    assert_all_found(recording, found(recording.time, recording.accel, recording.gyro))


def test_no_rest_is_lost_to_g_sensitivities_up_to_half_a_degree() -> None:
    """Of eight sessions of 12 to 30 rests, with matrices of 0.1 to 0.5 °/s/g; nor is any turn taken for one."""
    for seed in (2, 5, 8, 45, 53, 57, 61, 72):
        rng = np.random.default_rng([5, 1067 + seed])
        rest = float(rng.choice([3.0, 5.0]))
        request = Setup.of(
            grade="mems", positions=int(rng.choice([12, 20, 30])), rest=rest, sample_rate=50.0, rate_deg_s=60.0
        )
        recording = with_g_sensitivity(recorded(request, 3000 + seed), seed, rng.uniform(0.1, 0.5))
        rests = found(recording.time, recording.accel, recording.gyro).rests
        assert len(rests) == len(recording.rests)
        for one, (start, stop) in zip(rests, recording.rests, strict=True):
            assert start - 0.3 <= one.start < one.stop <= stop + 0.3


@pytest.mark.parametrize("sensitivity", [0.0, 0.1])
@pytest.mark.parametrize("turning", [1, 3, 6])
@pytest.mark.parametrize("grade", ["tactical", "mems"])
def test_a_slow_turn_about_the_vertical_is_no_rest(grade: str, turning: int, sensitivity: float) -> None:
    """The table turns at 0.2 to 0.5 °/s during some of 26 rests, which no accelerometer sees, with gyros that feel
    specific force or not: those are discarded for the level of the gyros, and no other."""
    for seed, slow in ((33, 0.2), (34, 0.3), (35, 0.5)):
        recording = recorded(Setup.of(grade=grade, positions=26, sample_rate=50.0), seed)
        recording = with_g_sensitivity(recording, seed, sensitivity)
        gyro, which = recording.gyro.copy(), np.arange(3, 26, 4)[:turning]
        for rest in which:
            start, stop = recording.rests[rest]
            during = (recording.time > start) & (recording.time <= stop)
            up = recording.accel[during].mean(axis=0)
            gyro[during] += slow * DEGREE * up / np.linalg.norm(up)
        segmentation = found(recording.time, recording.accel, gyro)
        still = np.delete(recording.rests, which, axis=0)
        assert_all_found(replace(recording, rests=still), segmentation)
        off = [r for r in segmentation.rejected if r.fails == "level" and r.stop - r.start > 3.0]
        named = slow < 0.4  # a turn by more than the spread of levels is no doubtful rest
        assert len(off) == (turning if named else len(off))


def test_what_was_passed_over_is_counted() -> None:
    """Rests of 1.5 s are too short; the count says so, with the length it takes."""
    request = Setup.of(grade="mems", programme="nine", rest=6.0, rate_deg_s=40.0, sample_rate=50.0)
    made = scenario(request, 36)
    short = record(made.changed(rest=1.5), np.random.default_rng(1036))
    (said,) = found(short.time, short.accel, short.gyro).passed_over()
    assert said.startswith("8 quiet stretches of 1.")
    assert said.endswith("s are too short: rests of 3 s are long enough")


@pytest.mark.parametrize("rest", [0.3, 0.5, 0.7])
def test_moments_of_rest_are_too_short_and_no_turns_of_the_vertical(rest: float) -> None:
    """Where rests are shorter than every window, the floors are those of the movement, and nothing stands out of it."""
    request = Setup.of(grade="mems", positions=24, rest=rest, sample_rate=100.0, rate_deg_s=90.0)
    recording = recorded(replace(request, first_rest=rest), 4)
    segmentation = found(recording.time, recording.accel, recording.gyro)
    assert segmentation.rests == ()
    assert {one.fails for one in segmentation.rejected} == {"duration"}
    assert abs(len(segmentation.rejected) - 24) <= 4
    assert np.median([one.stop - one.start for one in segmentation.rejected]) == pytest.approx(rest, abs=0.1)
    (said,) = segmentation.passed_over()
    assert said.endswith("s are too short: rests of 3 s are long enough")


# -------------------- several files --------------------


def test_two_files_are_two_logs_with_one_set_of_thresholds() -> None:
    """Each file begins its own blocks, and no rest goes from one to the other."""
    request = Setup.of(grade="tactical", programme="nine", rest=6.0, rate_deg_s=40.0, sample_rate=50.0)
    one, two = recorded(request, 22), recorded(request, 22)
    cut = 1037
    two = replace(two, time=two.time[:-cut], accel=two.accel[cut:], gyro=two.gyro[cut:])
    reducer = Reducer(rate=50.0, accel=ACCEL, gyro=GYRO)
    for file, recording in enumerate((one, two)):
        for chunk in chunks(recording.time, recording.accel, recording.gyro, sizes=[333, 500], file=file):
            reducer.feed(chunk)
    reduction = reducer.now()
    assert [f.file for f in reduction.files] == [0, 1]
    assert [f.first_sample for f in reduction.files] == [0, len(one.time)]
    rests = find_rests(reduction, ACCEL, GYRO).rests
    in_one, in_two = ([r for r in rests if r.file == file] for file in (0, 1))
    assert_all_found(one, Segmentation(rests=tuple(in_one), rejected=(), rate_limit=None, scatter_limit=0.0))
    later = one.rests - cut / 50.0
    later = later[later[:, 1] > 3.0].clip(min=0.0)
    np.testing.assert_allclose(times(in_two), later, atol=MOST_LOST)
    assert reduction.samples is not None
    rates, forces, intervals = reduction.samples.read(len(one.time), len(one.time) + 100)
    np.testing.assert_array_equal(rates, two.gyro[:100])
    np.testing.assert_array_equal(forces, two.accel[:100])
    np.testing.assert_array_equal(intervals, np.full(100, two.time[0]))


@pytest.mark.parametrize("rest", [1.0, 1.5, 2.0])
def test_short_rests_are_used_where_there_are_no_longer_ones(rest: float) -> None:
    request = Setup.of(grade="mems", positions=16, rest=rest, sample_rate=100.0, rate_deg_s=90.0)
    recording = recorded(replace(request, first_rest=rest), 4)
    assert len(found(recording.time, recording.accel, recording.gyro).rests) == 16


def test_short_stretches_beside_long_rests_are_no_rests() -> None:
    """As before there were short ones, whatever else lies still for a moment."""
    long = recorded(Setup.of(grade="mems", positions=8, rest=5.0, sample_rate=100.0, rate_deg_s=90.0), 4)
    request = Setup.of(grade="mems", positions=12, rest=1.5, sample_rate=100.0, rate_deg_s=90.0)
    short = recorded(replace(request, first_rest=1.5), 5)
    time = np.concatenate([long.time, long.time[-1] + short.time - short.time[0] + 0.01])
    both = found(time, np.vstack([long.accel, short.accel]), np.vstack([long.gyro, short.gyro]))
    assert len(both.rests) == 8


@pytest.mark.parametrize("gyros", [True, False])
@pytest.mark.parametrize(("kind", "size"), [("accel", 0.02), ("gyro", 0.1 * DEGREE)])
def test_a_jump_of_a_bias_within_a_rest_divides_it(kind: str, size: float, gyros: bool) -> None:
    """Nowhere else: a clean recording, and a drift as large in a rest, leave 9 rests."""
    recording = recorded(Setup.of(grade="mems", programme="nine", rest=30.0, rate_deg_s=40.0, sample_rate=50.0), 21)
    start, stop = recording.rests[4]
    phase = np.clip((recording.time - start) / (stop - start), 0.0, 1.0)
    for change, expected in ((0.0 * phase, 9), (phase, 9), (phase > 0.4, 9 if kind == "gyro" and not gyros else 10)):
        accel, gyro = (
            readings + np.outer(change, [0.0, size if kind == own else 0.0, 0.0])
            for own, readings in (("accel", recording.accel), ("gyro", recording.gyro))
        )
        spans = times(found(recording.time, accel, gyro if gyros else None).rests)
        assert len(spans) == expected
    if expected == 10:
        assert spans[4, 1] < start + 0.4 * (stop - start) < spans[5, 0] < spans[4, 1] + 2.5
