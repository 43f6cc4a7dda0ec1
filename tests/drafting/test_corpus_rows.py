"""Times, rates, side columns and foreign rows of logs: taken as they are written, or with a doubt that is printed."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

from tests.support.corpus import rows_and_times as r
from tumble.cli import main
from tumble.drafting.new_session import new_session
from tumble.errors import InputError
from tumble.planning.setup import Setup
from tumble.recording.session_file import read_session
from tumble.run.observed import inspect_session
from tumble.simulation.session import simulate_session
from tumble.units import Array

RATE = 50.0


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> pl.DataFrame:
    """A recording by hand, 50 samples per second, in SI."""
    setup = Setup.of(grade="mems", positions=8, rest=4.0, sample_rate=RATE, rate_deg_s=90.0)
    folder = simulate_session(tmp_path_factory.mktemp("rows") / "s", setup, seed=3)
    return pl.read_parquet(folder / "log.parquet")


CASES: dict[str, tuple[r.Write, float, Sequence[str]]] = {
    # how it is written, samples per second, and what is said
    "steps of 13000 us": (r.steps_of(0.013, 1e6, 1.0 / RATE / 0.013), 1.0 / 0.013, ()),
    "steps of 13000 us, gyros that do not fit": (
        r.steps_of(0.013, 1e6, 0.14),
        1.0 / 0.013,
        ("taken as it is written", "is their unit right?"),
    ),
    "steps of 0.05 s, gyros at twice their rate": (r.steps_of(0.05, 1.0, 2.0 / RATE / 0.05), 20.0, ("no data sheet",)),
    "ticks": (r.steps_of(1.0 / RATE, 4e4, 1.0), RATE, ("counts samples or ticks", "rate_hz = 50 from the turns")),
    "dt in s": (r.intervals("dt", 1.0), RATE, ("'dt' has the intervals between samples, in s",)),
    "dt in ms": (r.intervals("dt", 1e3), RATE, ("in ms",)),
    "delta_t [us]": (r.intervals("delta_t [us]", 1e6), RATE, ("in us",)),
    "no times": (r.no_times(*r.SENSORS), RATE, ("rate_hz = 100 is a guess", "rate_hz = 50 from the turns")),
    "no times and no gyros": (r.no_times("ax", "ay", "az"), 100.0, ("rate_hz = 100 is a guess",)),
    "an empty thermometer": (r.two_thermometers("csv"), RATE, ("temp[C] is left out", "imu_temp in degC")),
    "nulls": (r.two_thermometers("parquet"), RATE, ("temp[C] is left out", "imu_temp in degC")),
    "rows of a network between": (r.rows_of_a_network(False), RATE, ("as rows of others: left out",)),
    "rows of a network at the beginning": (r.rows_of_a_network(True), RATE, ("as rows of others: left out",)),
    "text named .bin": (r.sentences_named_as_a_recording, RATE, ("sentences $VNIMU", "rate_hz = 50 from the turns")),
    "a file a sensor": (r.a_file_a_sensor(lambda t: t), RATE, ("one log at the times of the gyros",)),
    "a file a sensor, rows in other order": (r.a_file_a_sensor(r.in_other_order), RATE, ("one log",)),
    "a file a sensor, whole seconds": (r.a_file_a_sensor(np.floor), RATE, ("regular = true",)),
    "4 s for all rows": (
        r.a_file_a_sensor(lambda t: t * 4.0 / t[-1]),
        np.nan,
        ("all of the log is 4 s by its times, too short to turn and rest in",),
    ),
}  # fmt: skip
DOUBTED = ("steps of 13000 us, gyros that do not fit", "steps of 0.05 s, gyros at twice their rate")


@pytest.mark.parametrize("name", CASES)
def test_a_log_is_read_at_its_rate_or_the_doubt_is_said(name: str, log: pl.DataFrame, tmp_path: Path) -> None:
    write, rate, said = CASES[name]
    files = [tmp_path / file for file in write(log, tmp_path)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        draft, faults = new_session(tmp_path / "session", files)
    printed = "; ".join((*draft.remarks, *draft.doubts))
    assert all(words in printed for words in said), printed
    assert any("is their unit right" in doubt for doubt in draft.doubts) == (name in DOUBTED), draft.doubts
    assert not faults
    if np.isfinite(rate):
        assert inspect_session(tmp_path / "session").rate == pytest.approx(rate, rel=2e-3)


@pytest.mark.parametrize("time", [lambda t: t, r.in_other_order, np.floor], ids=["as they are", "in other order", "s"])
def test_sensors_in_files_of_their_own_are_joined_sample_by_sample(
    time: Callable[[Array], Array], log: pl.DataFrame, tmp_path: Path
) -> None:
    files = [tmp_path / file for file in r.a_file_a_sensor(time)(log, tmp_path)]
    new_session(tmp_path / "session", files)
    written = pl.read_parquet(tmp_path / "session" / "log.parquet")
    joined = written.select("t", "accel_x", "accel_y", "accel_z").to_numpy()
    steps = np.diff(joined[:, 0])
    assert steps == pytest.approx(np.full(len(steps), 1.0 / RATE), rel=0.01)
    of_accelerometers = {tuple(row) for row in np.round(log.select("ax", "ay", "az").to_numpy(), 5).tolist()}
    kept = sum(tuple(row) in of_accelerometers for row in np.round(joined[:, 1:4], 5).tolist())
    assert kept > 0.99 * len(joined)


def test_rests_that_a_stated_rate_makes_too_short_are_said_with_it(log: pl.DataFrame, tmp_path: Path) -> None:
    r.no_times("ax", "ay", "az")(log, tmp_path)
    (tmp_path / "session.toml").write_text(
        'format = 1\n[device]\nserial = "a"\n[site]\nlatitude_deg = 50.0\n'
        '[log]\nfile = "log.csv"\nrate_hz = 2000\naccel = { columns = ["ax", "ay", "az"], unit = "m/s^2" }\n'
    )
    assert read_session(tmp_path).log.rate == 2000.0
    refused = CliRunner().invoke(main, ["calibrate", str(tmp_path)])
    assert refused.exit_code in (1, 2)
    assert "by log.rate_hz = 2000, which no time confirms" in refused.stderr


def test_a_clock_that_starts_anew_in_the_file_of_a_sensor_is_refused(log: pl.DataFrame, tmp_path: Path) -> None:
    files = [tmp_path / f for f in r.a_file_a_sensor(lambda t: np.where(t > 20.0, t - 20.0, t))(log, tmp_path)]
    with pytest.raises(InputError, match="a clock that starts anew"):
        new_session(tmp_path / "session", files)
    assert not (tmp_path / "session").exists()
