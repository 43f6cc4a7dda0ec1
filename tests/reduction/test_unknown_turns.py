"""Turns of which the gyros do not say where they have led: readings of more than half a turn from sample to sample."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tests.support.shared import calibrated, copy_of, session
from tumble.planning.setup import Setup
from tumble.run.calibrate import calibrate
from tumble.run.observed import inspect_session

SETUP = Setup.of(grade="mems", positions=14, rest=5.0, rate_deg_s=120.0, sample_rate=50.0)
SAID = "turn from rest 3 to rest 4 is left out: gyros read more than half a turn from sample to sample, in 1 of"


def with_readings(folder: Path, *, turns: range, reading: float) -> Path:
    """A session in which a gyro reads this in the midst of some turns."""
    rests = inspect_session(folder).segmentation.rests
    log = pl.read_parquet(folder / "log.parquet")
    at = np.searchsorted(log["t"].to_numpy(), [0.5 * (rests[k].stop + rests[k + 1].start) for k in turns])
    column = log["gy"].to_numpy().copy()
    column[at] = reading
    log.with_columns(gy=column).write_parquet(folder / "log.parquet")
    return folder


@pytest.mark.parametrize("reading", [160.0, 1e5, -2147483648.0])
def test_a_turn_with_a_reading_that_is_none_is_left_out_and_named(reading: float, tmp_path: Path) -> None:
    folder, clean = copy_of(session(SETUP, seed=3), tmp_path / "s"), calibrated(SETUP, seed=3)
    found = calibrate(with_readings(folder, turns=range(2, 3), reading=reading))
    assert found.outcome.accepted, found.outcome.reasons
    assert any(note.startswith(SAID) for note in found.provenance.notes), found.provenance.notes
    (values, u), (sound, known) = (
        [np.array([getattr(p, what) for p in each.parameters[:21]]) for what in ("value", "u")]
        for each in (found, clean)
    )
    assert np.all(np.abs(values - sound) < 3.0 * np.sqrt(u**2 - 0.9 * known**2))


def test_single_readings_of_most_turns_are_replaced(tmp_path: Path) -> None:
    folder, clean = copy_of(session(SETUP, seed=3), tmp_path / "s"), calibrated(SETUP, seed=3)
    found = calibrate(with_readings(folder, turns=range(9), reading=1e4))
    assert found.outcome.accepted, found.outcome.reasons
    assert any("bad sample" in note or "replaced" in note for note in found.provenance.notes), found.provenance.notes
    for name in list(clean)[:21]:
        assert abs(found[name].value - clean[name].value) < 0.5 * (clean[name].u or 0.0)
