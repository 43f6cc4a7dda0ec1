"""The record at rest that the noise is taken from, and the command `tumble noise`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

from tests.support import shared
from tumble.cli import main
from tumble.errors import InputError
from tumble.planning.setup import Setup
from tumble.recording.session_file import read_session
from tumble.reduction.noise.wavelet_moments import Panel
from tumble.run.quiet_samples import longest_rest, noise_of, noise_panels, whole_log
from tumble.sensors.grades import GRADES
from tumble.units import DEGREE


@pytest.fixture
def session() -> Path:
    return shared.session(Setup.of(grade="mems", positions=4), seed=3)


def test_the_longest_rest_is_the_first_of_a_hand_held_session(session: Path) -> None:
    record = longest_rest(read_session(session))
    seconds = len(record.accel) / record.rate
    assert 38.0 < seconds <= 40.0  # 40 s less a margin
    assert len(record.gyro) == len(record.accel)
    assert np.ptp(record.gyro[:, 0]) < 5.0 * DEGREE  # no turn is in it


def test_the_noise_of_a_simulated_session_is_what_was_put_in(session: Path) -> None:
    white = GRADES["mems"].noise
    for panel, expected in zip(
        noise_panels([longest_rest(read_session(session))]), (white.accel_white, white.gyro_white), strict=True
    ):
        for parameters in panel.parameters:
            found = parameters.white_noise
            assert found is not None
            assert abs(found.value - expected) < 6.0 * found.u
            assert found.u < 0.1 * expected


def test_all_of_a_log_is_taken_in_the_units_of_the_options(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    columns = {name: rng.normal(size=4000) for name in ("a", "b", "c", "p", "q", "r")}
    pl.DataFrame(columns).write_csv(tmp_path / "still.csv")
    layout = {
        "rate_hz": 100.0,
        "accel": {"columns": ["a", "b", "c"], "unit": "mg"},
        "gyro": {"columns": ["p", "q", "r"], "unit": "deg/s"},
    }
    record = whole_log(tmp_path / "still.csv", layout)
    np.testing.assert_allclose(record.gyro[:, 0], columns["p"] * DEGREE, rtol=1e-15)
    np.testing.assert_allclose(record.accel[:, 2], columns["c"] * 9.80665e-3, rtol=1e-15)


def test_a_log_of_turns_is_said_to_be_no_record_of_noise(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).normal(size=(4000, 3))
    layout = {"rate_hz": 100.0, "accel": {"columns": ["a", "b", "c"], "unit": "mg"}}
    for name, turned in (("still", 0), ("turned", 2000)):
        accel = noise + np.array([0.0, 0.0, 1000.0])
        accel[4000 - turned :] = noise[:turned] + np.array([1000.0, 0.0, 0.0])
        pl.DataFrame(accel, schema=["a", "b", "c"]).write_csv(tmp_path / f"{name}.csv")
    assert noise_of(tmp_path / "still.csv", layout=layout).doubt == ""
    said = noise_of(tmp_path / "turned.csv", layout=layout).doubt
    assert said.startswith("the device was turned by up to 90° in all of turned.csv: these numbers are not")


def test_a_log_of_which_nothing_is_known_is_refused_with_what_to_state(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).normal([0.0, 0.0, 40.0], 1.0, size=(300, 3))
    pl.DataFrame(noise, schema=["a", "b", "c"]).write_csv(tmp_path / "still.csv")
    file = str(tmp_path / "still.csv")
    result = CliRunner().invoke(main, ["noise", file])
    assert result.exit_code == 2
    assert "state which they are (--accel N,N,N, names or numbers from 1)" in result.stderr
    result = CliRunner().invoke(main, ["noise", file, "--accel", "a,b,c"])
    assert result.exit_code == 2
    last = result.stderr.strip().splitlines()[-1]
    assert last == f"tumble: {file}: expected a time column (--time) or the rate (--sample-rate), found neither"
    result = CliRunner().invoke(main, ["noise", file, "--accel", "a,b,c", "--sample-rate", "50", "--accel-unit", "mg"])
    assert result.exit_code == 0, result.stderr


def test_the_command_prints_a_row_for_every_sensor_and_draws(session: Path, tmp_path: Path) -> None:
    picture = tmp_path / "noise.svg"
    result = CliRunner().invoke(main, ["noise", str(session), "--plot", str(picture)])
    assert result.exit_code == 0, result.stderr
    for column in read_session(session).log.columns[1:]:
        assert column in result.stdout
    assert "°/√h" in result.stdout
    assert picture.read_text().startswith("<?xml")


def test_a_session_without_rest_is_refused() -> None:
    setup = replace(Setup.of(grade="mems", positions=3, rest=1.0), first_rest=1.0)
    folder = shared.session(setup, seed=3)
    with pytest.raises(InputError, match="expected a rest"):
        longest_rest(read_session(folder))


def test_a_log_without_gyros_has_one_panel(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    pl.DataFrame({name: rng.normal(size=4000) for name in "abc"}).write_parquet(tmp_path / "still.parquet")
    record = whole_log(tmp_path / "still.parquet", {"rate_hz": 50.0, "accel": {"columns": list("abc"), "unit": "g"}})
    panels = noise_panels([record])
    assert [type(p) for p in panels] == [Panel]
    assert panels[0].title == "accelerometers"
