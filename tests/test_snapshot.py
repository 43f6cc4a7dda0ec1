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
from tumble.reduction.blocks import FileBlocks, Reducer, Reduction
from tumble.reduction.matching import Match
from tumble.reduction.motion_samples import MotionSamples
from tumble.reduction.observations import Observations, observe
from tumble.reduction.segmentation import MIN_REST_SECONDS, find_rests
from tumble.reduction.snapshot import Snapshot, snapshot
from tumble.sensors.model import Block
from tumble.simulation.recording import Recording, record
from tumble.simulation.scenario import scenario_of
from tumble.units import DEGREE

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
            snapshot(reducer)
    return reducer


def batch(reduction: Reduction) -> Observations | None:
    rests = find_rests(reduction, ACCEL, GYRO).rests
    if not rests:
        return None
    return observe(reduction, Match(rests=rests, programme=None, position=None), ACCEL, GYRO, SITE)


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


@settings(max_examples=25, deadline=None)
@given(
    sizes=st.lists(st.integers(1, 500), max_size=30),
    asked=st.sets(st.integers(0, 30)),
    file_at=st.sampled_from([10**9, 1000, 1333]),
)
def test_asking_changes_nothing(session: Recording, sizes: list[int], asked: set[int], file_at: int) -> None:
    """Any chunks, asked at any moments: reduction, rests, turns and covariances are those of one piece, to the bit."""
    at_once = fed(chunks(session, [], file_at=file_at)).finish()
    bit_by_bit = fed(chunks(session, sizes, file_at=file_at), asked=sorted(asked)).finish()
    assert_equal(bit_by_bit, at_once)
    assert find_rests(bit_by_bit, ACCEL, GYRO) == find_rests(at_once, ACCEL, GYRO)
    assert_equal(batch(bit_by_bit), batch(at_once))


@settings(max_examples=25, deadline=None)
@given(sizes=st.lists(st.integers(1, 700), max_size=10), stop=st.integers(100, 3000))
def test_a_snapshot_is_the_result_of_the_log_so_far(session: Recording, sizes: list[int], stop: int) -> None:
    reducer = fed(chunks(session, sizes, stop=stop))
    shown = snapshot(reducer)
    reduction = fed(chunks(session, [], stop=stop)).finish()
    truncated = replace(reduction, samples=shown.reduction.samples)
    assert_equal(shown.reduction, truncated)
    found = batch(truncated)
    assert shown.segmentation == find_rests(truncated, ACCEL, GYRO)
    assert_equal(shown.rests, None if found is None else found.rests)
    if found is not None and found.turns is not None:
        assert shown.turns == tuple(zip(found.turns.first.tolist(), found.turns.last.tolist(), strict=True))


def test_a_snapshot_stays_as_it_was_while_the_log_grows(session: Recording) -> None:
    parts = chunks(session, [97] * 100)
    reducer = fed(parts[:8])
    before = reducer.now()
    copied = [np.array(values) for values in (before.files[0].accel, before.files[0].edges)]
    for chunk in parts[8:]:
        reducer.feed(chunk)
    assert_equal([before.files[0].accel, before.files[0].edges], copied)


def test_the_state_follows_the_recording(session: Recording) -> None:
    """Every tenth of a second: at rest and in turns, nothing shown in the first second; the uncertainty of the mean
    falls while a rest lasts, and the turn grows to what the move is."""
    reducer, u, turned = Reducer(rate=RATE, accel=ACCEL, gyro=GYRO), [], []
    start, stop = session.rests[3]
    for chunk in chunks(session, [5] * 1000):
        reducer.feed(chunk)
        shown, now = snapshot(reducer), float(chunk.time[-1])
        if now < 0.99:
            assert shown.segmentation is None
            assert shown.open_rest is None
        elif start + 1.5 < now <= stop:
            assert shown.open_rest is not None
            assert shown.open_rest.seconds >= MIN_REST_SECONDS or not shown.open_rest.is_rest
            assert shown.open_rest.is_rest or shown.open_rest.seconds < MIN_REST_SECONDS + 0.5
            assert start - 1e-9 <= shown.open_rest.span.start < start + 1.2
            assert now - shown.open_rest.span.stop < 0.11
            u.append(float(np.linalg.norm(shown.open_rest.accel_u)))
        elif stop + 1.2 < now < session.rests[4, 0]:
            assert shown.open_rest is None
            assert shown.open_turn is not None
            assert shown.open_turn.rotation is not None
            turned.append(float(np.linalg.norm(shown.open_turn.rotation)))
    assert u[-1] < 0.8 * u[0]
    assert turned == sorted(turned)
    assert turned[-1] == pytest.approx(float(np.linalg.norm(session.moves[3])), abs=10.0 * DEGREE)


def test_a_rest_is_one_however_often_it_is_asked_for(session: Recording) -> None:
    """One rest of two minutes, asked for every 0.2 s."""
    rng = np.random.default_rng(5)
    still = replace(
        session,
        time=np.arange(1, 6001) / RATE,
        accel=np.array([0.0, 9.81, 0.0]) + 0.01 * rng.standard_normal((6000, 3)),
        gyro=1e-3 * rng.standard_normal((6000, 3)),
    )
    parts = chunks(still, [10] * 600)
    shown = snapshot(fed(parts, asked=range(len(parts))))
    assert shown.rests is not None
    assert len(shown.rests) == 1
    assert shown.open_rest is not None
    assert shown.open_rest.seconds == pytest.approx(120.0)
    assert shown.open_rest.temperature == pytest.approx(295.0, abs=0.1)


def hour_of_blocks() -> Reducer:
    """A reducer that was fed an hour with 120 rests: 3.5e4 samples at 10 Hz, one a block."""
    request = Setup.of(grade="mems", positions=120, rest=28.0, sample_rate=10.0)
    scenario = scenario_of(request, np.random.default_rng(6), serial="S")
    made = record(replace(scenario, profile=replace(scenario.profile, first_rest=28.0)), np.random.default_rng(7))
    reducer = Reducer(rate=10.0, accel=ACCEL, gyro=GYRO)
    dt = np.full(len(made.time), 0.1)
    reducer.feed(Chunk(file=0, time=made.time, dt=dt, accel=made.accel, gyro=made.gyro, temperature=None))
    return reducer


def test_an_hour_is_shown_whole() -> None:
    """3.5e4 blocks, as of an hour at 1 kHz, with 120 rests, all of them shown (benchmarks/snapshot.py has the time)."""
    shown = snapshot(hour_of_blocks())
    assert len(shown.reduction.files[0].accel) > 30_000
    assert shown.rests is not None
    assert len(shown.rests) == 120


# -------------------- lost and held samples --------------------


def one_file(recording: Recording, rows: np.ndarray) -> Snapshot:
    """A log of these rows of a recording, as if each had come in time."""
    time = np.arange(1, len(rows) + 1) / RATE
    log = replace(recording, time=time, accel=recording.accel[rows], gyro=recording.gyro[rows])
    return snapshot(fed(chunks(log, [])))


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


def test_coarse_channels_repeat_without_being_held(session: Recording) -> None:
    """In steps of a noise or two most rows at rest repeat by chance."""
    coarse = replace(session, accel=np.round(session.accel / 0.05) * 0.05, gyro=np.round(session.gyro / 0.02) * 0.02)
    shown = one_file(coarse, np.arange(len(session.time)))
    assert shown.reduction.repeated_rows > 10
    assert shown.held == 0


def test_long_intervals_leave_room_for_lost_samples(session: Recording) -> None:
    chunk = chunks(session, [])[0]
    dt = chunk.dt.copy()
    dt[[100, 200]] = [3.0 / RATE, 2.0 / RATE]
    assert snapshot(fed([replace(chunk, dt=dt, time=np.cumsum(dt))])).lost == 3


def test_nothing_fed_shows_nothing() -> None:
    shown = snapshot(Reducer(rate=RATE, accel=ACCEL, gyro=None))
    assert (shown.samples, shown.held, shown.rests, shown.open_rest, shown.open_turn) == (0, 0, None, None, None)


def test_blocks_are_not_copied(session: Recording) -> None:
    """Two snapshots of a log look at the same memory."""
    reducer = fed(chunks(session, []))
    one, other = (reducer.now().files[0] for _ in range(2))
    assert isinstance(one, FileBlocks)
    assert np.shares_memory(one.accel, other.accel)
