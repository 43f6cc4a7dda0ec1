"""A recording while it grows: what is shown is what the log would give if it ended there, and showing it changes
nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tumble.planning.setup import Setup
from tumble.recording.log import Chunk
from tumble.recording.session import Site
from tumble.reduction.blocks.motion_samples import MotionSamples
from tumble.reduction.blocks.reducer import FileBlocks, Reducer, Reduction
from tumble.reduction.observations import Observations, observe
from tumble.reduction.rest_stream import mean_so_far, rests_so_far
from tumble.reduction.rests.segmentation import Stretch, find_rests
from tumble.sensors.model import Block
from tumble.simulation.recording import Recording, record
from tumble.simulation.scenario import scenario_of

ACCEL, GYRO = Block(kind="accel", axes=np.eye(3)), Block(kind="gyro", axes=np.eye(3))
SITE = Site(latitude=0.9, height=0.0, gravity=9.81, gravity_u=0.0)
RATE = 50.0


@pytest.fixture(scope="module")
def session() -> Recording:
    """Nine positions of a MEMS unit, rests of 5 s: some 60 s."""
    request = Setup.of(grade="mems", programme="nine", rest=5.0, rate_deg_s=60.0, sample_rate=RATE)
    scenario = scenario_of(request, np.random.default_rng(3), serial="S")
    return record(scenario, np.random.default_rng(4))


def chunks(recording: Recording, sizes: Sequence[int], *, stop: int | None = None, file_at: int = 10**9) -> list[Chunk]:
    """The samples before `stop` in chunks of these sizes; from sample `file_at` on they are another file."""
    end = min(stop or 10**9, len(recording.time))
    cuts = np.unique(np.minimum([0, *np.cumsum(sizes), end, *([file_at] if file_at < end else [])], end))
    out = []
    for a, b in pairwise(cuts.tolist()):
        second = a >= file_at
        out.append(
            Chunk(
                file=int(second),
                time=recording.time[a:b] - (recording.time[file_at - 1] if second else 0.0),
                dt=np.full(b - a, 1.0 / RATE),
                accel=recording.accel[a:b],
                gyro=recording.gyro[a:b],
                temperature=np.linspace(290.0, 300.0, len(recording.time))[a:b, None],
            )
        )
    return out


def fed(parts: Sequence[Chunk], *, asked: Sequence[int] = ()) -> Reducer:
    """A reducer that was asked after some of the chunks."""
    reducer = Reducer(rate=RATE, accel=ACCEL, gyro=GYRO)
    for i, chunk in enumerate(parts):
        reducer.feed(chunk)
        if i in asked:
            reducer.now()
    return reducer


def batch(reduction: Reduction) -> Observations | None:
    rests = find_rests(reduction, ACCEL, GYRO).rests
    if not rests:
        return None
    return observe(reduction, rests, ACCEL, GYRO, SITE)


def assert_equal(a: object, b: object) -> None:
    """Equal to the bit, all the way down."""
    if isinstance(a, np.ndarray):
        np.testing.assert_array_equal(a, b)
    elif isinstance(a, MotionSamples) and isinstance(b, MotionSamples):
        assert a.count == b.count
        assert_equal(a.read(0, a.count), b.read(0, b.count))
    elif is_dataclass(a):
        for each in fields(a):
            if not each.name.startswith("_"):
                assert_equal(getattr(a, each.name), getattr(b, each.name))
    elif isinstance(a, tuple | list) and isinstance(b, tuple | list):
        assert len(a) == len(b)
        for one, other in zip(a, b, strict=True):
            assert_equal(one, other)
    elif isinstance(a, dict) and isinstance(b, dict):
        assert a.keys() == b.keys()
        assert_equal(list(a.values()), list(b.values()))
    else:
        assert a == b


@settings(max_examples=10, deadline=None)
@given(
    sizes=st.lists(st.integers(1, 500), max_size=30),
    asked=st.sets(st.integers(0, 30)),
    file_at=st.sampled_from([10**9, 1000, 1333]),
)
def test_asking_changes_nothing(session: Recording, sizes: list[int], asked: set[int], file_at: int) -> None:
    """Any chunks, asked at any moments: reduction, rests, turns and covariances are those of one piece, to the bit."""
    at_once = fed(chunks(session, [], file_at=file_at)).now()
    bit_by_bit = fed(chunks(session, sizes, file_at=file_at), asked=sorted(asked)).now()
    assert_equal(bit_by_bit, at_once)
    assert find_rests(bit_by_bit, ACCEL, GYRO) == find_rests(at_once, ACCEL, GYRO)
    assert_equal(batch(bit_by_bit), batch(at_once))


@settings(max_examples=10, deadline=None)
@given(sizes=st.lists(st.integers(1, 700), max_size=10), stop=st.integers(100, 3000))
def test_what_is_known_now_is_the_reduction_of_the_log_so_far(session: Recording, sizes: list[int], stop: int) -> None:
    now = fed(chunks(session, sizes, stop=stop)).now()
    ended = fed(chunks(session, [], stop=stop)).now()
    assert_equal(now, replace(ended, samples=now.samples))


def test_a_reduction_stays_as_it_was_while_the_log_grows(session: Recording) -> None:
    parts = chunks(session, [97] * 100)
    reducer = fed(parts[:8])
    before = reducer.now()
    copied = [np.array(values) for values in (before.files[0].accel.means, before.files[0].edges)]
    for chunk in parts[8:]:
        reducer.feed(chunk)
    assert_equal([before.files[0].accel.means, before.files[0].edges], copied)


def test_rests_show_while_they_last(session: Recording) -> None:
    """From half a second after its beginning to its end a rest is the last, and lasts; those before it are the rests
    of a calibration."""
    found = find_rests(fed(chunks(session, [])).now(), ACCEL, GYRO).rests
    assert len(found) == 9
    for k, rest in enumerate(found):
        for time in (rest.start + 0.6, rest.stop - 0.2):
            reduction = fed(chunks(session, [], stop=round(time * RATE))).now()
            so_far = rests_so_far(reduction, ACCEL, GYRO)
            assert so_far is not None or time < 3.0
            if so_far is not None:
                assert (so_far.still_at_end, so_far.lasting, len(so_far.rests)) == (True, True, k + 1)
                np.testing.assert_allclose([span.start for span in so_far.rests], starts(found, k), atol=0.6)
        if k < 8:
            moving = rests_so_far(fed(chunks(session, [], stop=round((rest.stop + 1.0) * RATE))).now(), ACCEL, GYRO)
            assert moving is not None
            assert (moving.still_at_end, moving.lasting, len(moving.rests)) == (False, False, k + 1)
    u = mean_so_far(reduction.files[-1], found[-1].first, found[-1].last)
    assert u.keys() == {"accel", "gyro"}
    assert u["accel"][1] == pytest.approx(u["accel"][0] / 2**0.5, rel=0.2)  # white noise
    assert mean_so_far(reduction.files[-1], 0, 5) == {}


def starts(found: Sequence[Stretch], k: int) -> list[float]:
    return [span.start for span in found[: k + 1]]


# -------------------- lost and held samples --------------------


def one_file(recording: Recording, rows: np.ndarray) -> Reduction:
    """A log of these rows of a recording, as if each had come in time."""
    time = np.arange(1, len(rows) + 1) / RATE
    log = replace(recording, time=time, accel=recording.accel[rows], gyro=recording.gyro[rows])
    return fed(chunks(log, [])).now()


@pytest.mark.parametrize("share", [0.01, 0.1, 0.5])
def test_held_samples_are_counted(session: Recording, share: float) -> None:
    rng = np.random.default_rng(8)
    rows = np.arange(len(session.time))
    held = rng.random(len(rows)) < share
    held[0] = False
    rows = np.maximum.accumulate(np.where(held, 0, rows))
    shown = one_file(session, rows)
    assert shown.held == held.sum()
    assert one_file(session, np.arange(len(session.time))).held == 0


@pytest.mark.parametrize("sizes", [[], [7] * 1000, [301, 5, 5, 5, 900]])
def test_runs_of_held_rows_are_gaps(session: Recording, sizes: list[int]) -> None:
    """Rows that stay for 0.3 s, and for 0.1 s, which can be bridged; whatever the chunks."""
    rows = np.arange(len(session.time))
    rows[301:316], rows[700:705] = 300, 699
    log = replace(session, accel=session.accel[rows], gyro=session.gyro[rows])
    (gap,) = fed(chunks(log, sizes)).now().held_runs
    assert (gap.time, gap.stop, gap.samples) == (session.time[301], session.time[316], 15)
    assert not gap.integrable


def test_coarse_channels_repeat_without_being_held(session: Recording) -> None:
    """In steps of a noise or two most rows at rest repeat by chance."""
    coarse = replace(session, accel=np.round(session.accel / 0.05) * 0.05, gyro=np.round(session.gyro / 0.02) * 0.02)
    shown = one_file(coarse, np.arange(len(session.time)))
    assert shown.repeated_rows > 10
    assert (shown.held, shown.held_runs) == (0, ())


def test_long_intervals_leave_room_for_lost_samples(session: Recording) -> None:
    chunk = chunks(session, [])[0]
    dt = chunk.dt.copy()
    dt[[100, 200]] = [3.0 / RATE, 2.0 / RATE]
    assert fed([replace(chunk, dt=dt, time=np.cumsum(dt))]).now().lost == 3


def test_nothing_fed_shows_nothing() -> None:
    shown = Reducer(rate=RATE, accel=ACCEL, gyro=None).now()
    assert (shown.files, shown.lost, shown.held) == ((), 0, 0)


def test_blocks_are_not_copied(session: Recording) -> None:
    """Two reductions of a log look at the same memory."""
    reducer = fed(chunks(session, []))
    one, other = (reducer.now().files[0] for _ in range(2))
    assert isinstance(one, FileBlocks)
    assert np.shares_memory(one.accel.means, other.accel.means)
