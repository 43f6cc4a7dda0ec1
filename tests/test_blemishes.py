"""Bad samples in rests: left out with their block and counted, the rest kept whole; movement is left as it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tumble.calibration.calibrate import calibrate
from tumble.calibration.observed import inspect_session
from tumble.planning.setup import Setup
from tumble.recording.log import Chunk
from tumble.reduction.blemishes import blemish_notes, without_blemishes
from tumble.reduction.blocks import Reducer, Reduction
from tumble.reduction.segmentation import RestSpan
from tumble.sensors.model import Block
from tumble.simulation.session import simulate_session
from tumble.units import DEGREE, Array

ACCEL, GYRO = Block(kind="accel", axes=np.eye(3)), Block(kind="gyro", axes=np.eye(3))
SAMPLES = 2000


def quiet(rng: np.random.Generator, samples: int = SAMPLES) -> Array:
    """Forces and rates (samples, 6) at rest, of a MEMS unit at 100 Hz."""
    return np.hstack(
        [[0.0, 0.0, 9.81] + 0.015 * rng.standard_normal((samples, 3)), 0.1 * DEGREE * rng.standard_normal((samples, 3))]
    )


def reduced(values: Array, rate: float = 100.0) -> Reduction:
    reducer = Reducer(rate=rate, accel=ACCEL, gyro=GYRO)
    dt = np.full(len(values), 1.0 / rate)
    reducer.feed(Chunk(file=0, time=np.cumsum(dt), dt=dt, accel=values[:, :3], gyro=values[:, 3:], temperature=None))
    return reducer.finish()


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
    of_kept = (sound.files[0].accel[kept].mean(axis=0), sound.files[0].gyro[kept].mean(axis=0))  # type: ignore[index]
    np.testing.assert_allclose(found.files[0].accel_mean(0, 200), of_kept[0], rtol=1e-12)
    np.testing.assert_allclose(found.files[0].gyro_mean(0, 200), of_kept[1], rtol=1e-9)
    assert np.abs(found.files[0].accel - [0.0, 0.0, 9.81]).max() < 0.03
    span = RestSpan(file=0, first=0, last=200, start=0.0, stop=20.0)
    assert blemish_notes(found, [span])[0].startswith(f"{width} bad sample")
    assert blemish_notes(found, [RestSpan(file=0, first=0, last=90, start=0.0, stop=9.0)]) == ()


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


def test_a_session_with_bad_samples_keeps_its_rests(tmp_path: Path) -> None:
    """Nine rests of 5 s and a sample of 200 m/s² in two of them: with rests cut in two a parameter moved by 6 u."""
    folder = simulate_session(tmp_path / "s", Setup.of(grade="mems", positions=9, rest=5.0), seed=1)
    clean, rests = calibrate(folder), inspect_session(folder).segmentation.rests
    log = pl.read_parquet(folder / "log.parquet")
    at = np.searchsorted(log["t"].to_numpy(), [0.5 * (rests[i].start + rests[i].stop) for i in (3, 5)])
    column = log["ax"].to_numpy().copy()
    column[at] += 200.0
    log.with_columns(ax=column).write_parquet(folder / "log.parquet")
    assert len(inspect_session(folder).segmentation.rests) == 9
    found = calibrate(folder)
    assert any(note.startswith("2 bad samples") and "rests 4, 6" in note for note in found.notes)
    values, u = (np.array([getattr(p, what) for p in clean.parameters[:21]]) for what in ("value", "u"))
    assert np.all(np.abs([p.value for p in found.parameters[:21]] - values) < 0.5 * u)
