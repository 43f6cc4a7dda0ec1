"""Bad samples in rests: left out with their block and counted, the rest kept whole; movement is left as it is."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tests.support.shared import calibrated, copy_of, session
from tumble.planning.setup import Setup
from tumble.recording.log import Chunk
from tumble.reduction.blocks.motion_samples import MotionSamples
from tumble.reduction.blocks.reducer import Reducer, Reduction
from tumble.reduction.rests.blemishes import (
    BadSamples,
    bad_sample_notes,
    bad_samples_of_turns,
    blemish_notes,
    without_blemishes,
)
from tumble.reduction.rests.segmentation import Stretch
from tumble.rotation import unit_vector
from tumble.run.calibrate import calibrate
from tumble.run.observed import inspect_session
from tumble.sensors.model import Block
from tumble.units import DEGREE, Array

ACCEL, GYRO = Block(kind="accel", axes=np.eye(3)), Block(kind="gyro", axes=np.eye(3))
SAMPLES = 2000
NINE = Setup.of(grade="mems", positions=9, rest=5.0)


def quiet(rng: np.random.Generator, samples: int = SAMPLES) -> Array:
    """Forces and rates (samples, 6) at rest, of a MEMS unit at 100 Hz."""
    return np.hstack(
        [[0.0, 0.0, 9.81] + 0.015 * rng.standard_normal((samples, 3)), 0.1 * DEGREE * rng.standard_normal((samples, 3))]
    )


def reduced(values: Array, rate: float = 100.0) -> Reduction:
    reducer = Reducer(rate=rate, accel=ACCEL, gyro=GYRO)
    dt = np.full(len(values), 1.0 / rate)
    reducer.feed(Chunk(file=0, time=np.cumsum(dt), dt=dt, accel=values[:, :3], gyro=values[:, 3:], temperature=None))
    return reducer.now()


@pytest.mark.parametrize(("column", "size"), [(0, 1.0), (2, -2000.0), (3, 0.2), (5, 30.0)])
@pytest.mark.parametrize("width", [1, 2])
def test_the_block_of_a_bad_sample_has_no_weight(column: int, size: float, width: int) -> None:
    """Samples 1009 and 1010 are of two blocks."""
    values = quiet(np.random.default_rng(1))
    sound = reduced(values)
    values[1009 : 1009 + width, column] += size
    found = without_blemishes(reduced(values))
    assert sum(one.samples for one in found.blemishes) == width
    kept = np.delete(np.arange(200), range(100, 100 + width))
    of_kept = (sound.files[0].accel.means[kept].mean(axis=0), sound.files[0].gyro.means[kept].mean(axis=0))
    np.testing.assert_allclose(found.files[0].accel.mean(0, 200), of_kept[0], rtol=1e-12)
    np.testing.assert_allclose(found.files[0].gyro.mean(0, 200), of_kept[1], rtol=1e-9)
    assert np.abs(found.files[0].accel.means - [0.0, 0.0, 9.81]).max() < 0.03
    span = Stretch(file=0, first=0, last=200, start=0.0, stop=20.0)
    assert blemish_notes(found, [span])[0].startswith(f"{width} bad sample")
    assert blemish_notes(found, [Stretch(file=0, first=0, last=90, start=0.0, stop=9.0)]) == ()


def test_what_lasts_longer_than_a_bad_sample_is_left_as_it_is() -> None:
    """A knock of 0.2 s, a nudge by 2° about the vertical in 0.1 s, a turn over, the ends of a log."""
    values = quiet(np.random.default_rng(2))
    values[400:420, 0] += 0.3 * np.sin(np.arange(20.0))
    values[800:810, 5] += 20.0 * DEGREE
    values[1200:, :3] = values[1200:, [1, 2, 0]]
    values[3, 0] = values[-4, 0] = 50.0
    reduction = reduced(values)
    assert without_blemishes(reduction) is reduction


def test_of_slow_samples_one_may_be_a_movement() -> None:
    values = quiet(np.random.default_rng(3), 400)
    values[200, 5] += 100.0 * DEGREE
    assert without_blemishes(reduced(values, rate=10.0)).blemishes == ()


def test_noise_has_no_bad_samples() -> None:
    """17 minutes: by Student's t of 18 degrees of freedom 3e-5 false ones are expected."""
    assert without_blemishes(reduced(quiet(np.random.default_rng(4), 100_000))).blemishes == ()


def turned(rng: np.random.Generator, samples: int = 400) -> Array:
    """Rates and forces (samples, 6) in the hand, of a MEMS unit at 100 Hz: 90° in two seconds, with a tremor."""
    t = np.arange(samples) / 100.0
    angle = 0.25 * np.pi * (1.0 - np.cos(np.pi * np.clip((t - 1.0) / 2.0, 0.0, 1.0)))
    tremor = 0.5 * np.sin(2.0 * np.pi * 9.0 * t) * np.clip(1.0 - (t - 2.0) ** 2, 0.0, 1.0)
    rates = np.column_stack([np.gradient(angle, t), 0.1 * tremor, 0.0 * t]) + 2e-3 * rng.standard_normal((samples, 3))
    forces = 9.81 * np.column_stack([0.0 * t, np.sin(angle), np.cos(angle)]) + tremor[:, None] * [1.0, 0.5, 0.2]
    return np.hstack([rates, forces + 0.015 * rng.standard_normal((samples, 3))])


LEAST = np.repeat([9.0 * 2e-3, 9.0 * 0.015], 3)


def bad_in(values: Array) -> BadSamples:
    """The bad samples of a turn that is 100 … 300 of these samples at 100 Hz."""
    stored, n = MotionSamples(), len(values)
    stored.append(values[:, :3], values[:, 3:], np.full(n, 0.01))
    whole = np.zeros(1, dtype=int), np.full(1, n)
    return bad_samples_of_turns(stored, np.array([100]), np.array([300]), whole, 100.0, LEAST)


@pytest.mark.parametrize("size", [5.0, -12.0, 300.0, -2000.0])
@pytest.mark.parametrize("width", [1, 2, 3])
@pytest.mark.parametrize("at", [100, 151, 200, 297])
def test_a_bad_sample_of_a_turn_is_replaced(size: float, width: int, at: int) -> None:
    """One accelerometer, by half a g and more; held for 1 to 3 samples."""
    values = turned(np.random.default_rng(at))
    sound, places = values.copy(), np.arange(at, at + width)
    values[places, 4] = values[at, 4] + size
    found = bad_in(values)
    np.testing.assert_array_equal(found.at, places)
    np.testing.assert_array_equal(found.values[:, [0, 1, 2, 3, 5]], sound[places][:, [0, 1, 2, 3, 5]])
    assert np.abs(found.values[:, 4] - sound[places, 4]).max() < 0.3


def test_a_packet_that_was_misread_and_one_gyro_are_found() -> None:
    rng = np.random.default_rng(3)
    values = turned(rng)
    values[150] = 100.0 * rng.standard_normal(6)
    values[230, 2] += 1.0
    found = bad_in(values)
    np.testing.assert_array_equal(found.at, [150, 230])
    assert bad_sample_notes(found, np.array([6])) == (
        "2 bad samples, far off those beside them, replaced by what is between these in the turn 7 to 8",
    )


def test_two_bad_samples_within_each_others_reach_are_both_found() -> None:
    values = turned(np.random.default_rng(5))
    values[150, 4] += 50.0
    values[156, 2] -= 8.0
    np.testing.assert_array_equal(bad_in(values).at, [150, 156])


def test_bad_samples_are_in_order_where_a_shorter_run_is_found_first() -> None:
    values = turned(np.random.default_rng(5))
    values[[150, 151], 3] = 500.0
    values[155, 4] = 900.0
    np.testing.assert_array_equal(bad_in(values).at, [150, 151, 155])


def test_blows_and_jerks_are_no_bad_samples() -> None:
    """What a body feels in several axes, be it within a sample; what rings; a step of a rate; noise of 17 minutes."""
    rng = np.random.default_rng(4)
    for _ in range(50):
        values, at = turned(rng), int(rng.integers(100, 300))
        values[at, 3:] += rng.uniform(5.0, 25.0) * unit_vector(rng.standard_normal(3)) + [0.5, 0.5, 0.5]
        assert len(bad_in(values).at) == 0
        values = turned(rng)
        ringing = 60.0 * np.exp(-np.arange(20) / 4.0) * np.cos(np.arange(20) * rng.uniform(0.5, 2.0))
        values[at : at + 20, 3:] += ringing[:, None] * (unit_vector(rng.standard_normal(3)))
        assert len(bad_in(values).at) == 0
        values = turned(rng)
        values[at:, 2] += 0.5
        assert len(bad_in(values).at) == 0
    stored, n = MotionSamples(), 100_000
    stored.append(2e-3 * rng.standard_normal((n, 3)), 0.015 * rng.standard_normal((n, 3)), np.full(n, 0.01))
    ends = np.zeros(1, dtype=int), np.full(1, n)
    assert len(bad_samples_of_turns(stored, *ends, ends, 100.0, 0.5 * LEAST).at) == 0


def test_a_bad_sample_in_a_turn_costs_nothing(tmp_path: Path) -> None:
    """A spike of 40 g in one sample: its velocity fixed the cubic terms, and moved a scale factor by 20 u."""
    folder = copy_of(session(NINE, seed=1), tmp_path / "s")
    clean, rests = calibrated(NINE, seed=1), inspect_session(folder).segmentation.rests
    log = pl.read_parquet(folder / "log.parquet")
    at = int(np.searchsorted(log["t"].to_numpy(), 0.5 * (rests[3].stop + rests[4].start)))
    column = log["ax"].to_numpy().copy()
    column[at] += 400.0
    log.with_columns(ax=column).write_parquet(folder / "log.parquet")
    found = calibrate(folder)
    assert any(note.startswith("1 bad sample") and "turn 4 to 5" in note for note in found.provenance.notes)
    values, u = (np.array([getattr(p, what) for p in clean.parameters]) for what in ("value", "u"))
    assert np.all(np.abs([p.value for p in found.parameters] - values) < 0.25 * u)  # of the integral 0.1


def test_bad_samples_in_every_turn_cost_little(tmp_path: Path) -> None:
    """Two of a gyro and one of an accelerometer in each turn: judged by parameters from the turns as recorded, some
    were put back, and parameters were off by up to 108 u."""
    folder = copy_of(session(NINE, seed=1), tmp_path / "s")
    clean, rests = calibrated(NINE, seed=1), inspect_session(folder).segmentation.rests
    log, rng = pl.read_parquet(folder / "log.parquet"), np.random.default_rng(2)
    readings = {name: log[name].to_numpy().copy() for name in ("gx", "gy", "gz", "ax", "ay", "az")}
    for before, after in pairwise(rests):
        first, last = np.searchsorted(log["t"].to_numpy(), [before.stop, after.start])
        places = rng.choice(np.arange(first + 10, last - 10, 12), 3, replace=False)
        for at, kind, size in zip(places, "gga", (8.0, -6.0, 60.0), strict=True):
            readings[f"{kind}{rng.choice(list('xyz'))}"][at] += size * rng.choice([-1.0, 1.0])
    log.with_columns(**readings).write_parquet(folder / "log.parquet")
    found = calibrate(folder)
    assert any(note.startswith("24 bad samples") for note in found.provenance.notes)
    values, u = (np.array([getattr(p, what) for p in clean.parameters[:21]]) for what in ("value", "u"))
    assert np.all(np.abs([p.value for p in found.parameters[:21]] - values) < 0.5 * u)


def test_a_session_with_bad_samples_keeps_its_rests(tmp_path: Path) -> None:
    """Nine rests of 5 s and a sample of 200 m/s² in two of them: with rests cut in two a parameter moved by 6 u."""
    folder = copy_of(session(NINE, seed=1), tmp_path / "s")
    clean, rests = calibrated(NINE, seed=1), inspect_session(folder).segmentation.rests
    log = pl.read_parquet(folder / "log.parquet")
    at = np.searchsorted(log["t"].to_numpy(), [0.5 * (rests[i].start + rests[i].stop) for i in (3, 5)])
    column = log["ax"].to_numpy().copy()
    column[at] += 200.0
    log.with_columns(ax=column).write_parquet(folder / "log.parquet")
    assert len(inspect_session(folder).segmentation.rests) == 9
    found = calibrate(folder)
    assert any(note.startswith("2 bad samples") and "rests 4, 6" in note for note in found.provenance.notes)
    values, u = (np.array([getattr(p, what) for p in clean.parameters[:21]]) for what in ("value", "u"))
    assert np.all(np.abs([p.value for p in found.parameters[:21]] - values) < 0.5 * u)
