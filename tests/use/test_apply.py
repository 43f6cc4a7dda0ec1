"""`tumble apply`: what comes out is what the library computes, of any log; a corrected device has no errors left."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

from tests.support.calibrated import HEXAD, calibration, session_of
from tests.support.linear_instrument import stated_linear
from tumble.cli import main
from tumble.errors import InputError, LogError
from tumble.planning.setup import Setup
from tumble.recording.log import open_log
from tumble.recording.session_file import read_session
from tumble.recording.session_file import session_of as session_of_content
from tumble.result.calibration import Calibration
from tumble.run.calibrate import calibrate
from tumble.simulation.session import simulate_session
from tumble.units import DEGREE, Array
from tumble.use.apply import apply_to_session

ROWS = 400
ROUNDING = 1e-14
"""Of sums of three numbers of some 10 m/s²; their order is that of the BLAS."""
RATE = {
    "accel": {"columns": ["ax", "ay", "az"], "unit": "m/s^2"},
    "gyro": {"columns": ["p", "q", "r"], "unit": "rad/s"},
}


def recording(seed: int = 5, sensors: int = 3) -> tuple[Array, Array]:
    """Readings of accelerometers and gyros, (ROWS, sensors) each."""
    rng = np.random.default_rng(seed)
    return 9.8 * rng.standard_normal((ROWS, sensors)), 0.3 * rng.standard_normal((ROWS, sensors))


def csv_of(columns: Mapping[str, Any]) -> str:
    text: str = pl.DataFrame(columns).write_csv()
    return text


def triad_csv(accel: Array, gyro: Array, **more: Array | list[str]) -> str:
    t = 0.01 * np.arange(1, ROWS + 1)
    named = dict(zip(["ax", "ay", "az", "p", "q", "r"], np.hstack([accel, gyro]).T, strict=True))
    return csv_of({"t": t, **named, **more})


def corrected(made: Calibration, folder: Path, out: str = "out.parquet") -> pl.DataFrame:
    """What apply writes for a session."""
    path = folder / out
    apply_to_session(made, read_session(folder), path)
    return pl.read_parquet(path) if path.suffix == ".parquet" else pl.read_csv(path)


@pytest.mark.parametrize("out", ["out.parquet", "out.csv"])
def test_values_are_those_of_the_library_call(tmp_path: Path, out: str) -> None:
    made, (accel, gyro) = calibration(), recording()
    session_of(tmp_path, triad_csv(accel, gyro), {"time": "t", **RATE})
    table = corrected(made, tmp_path, out)
    force, rate = made.apply(accel, gyro)
    assert rate is not None
    np.testing.assert_allclose(table.select("ax", "ay", "az").to_numpy(), force, rtol=1e-15, atol=ROUNDING)
    np.testing.assert_allclose(table.select("p", "q", "r").to_numpy(), rate, rtol=1e-15, atol=ROUNDING)


def test_true_values_come_back_from_readings_in_other_units(tmp_path: Path) -> None:
    """Counts with an offset and a negative scale, and deg/s: SI true values come out."""
    made, (true_f, true_w) = calibration(), recording()
    assert made.accel is not None
    assert made.gyro is not None
    scale, offset = np.array([415.0, -413.0, 416.0]), np.array([100.0, 200.0, -50.0])
    counts = made.accel.predict(true_f) * scale + offset
    table = triad_csv(counts, made.gyro.predict(true_w) / DEGREE)
    accel = {"columns": ["ax", "ay", "az"], "unit": "count", "scale": scale.tolist(), "offset": offset.tolist()}
    gyro = {"columns": ["p", "q", "r"], "unit": "deg/s"}
    session_of(tmp_path, table, {"time": "t", "accel": accel, "gyro": gyro})
    out = corrected(made, tmp_path)
    np.testing.assert_allclose(out.select("ax", "ay", "az").to_numpy(), true_f, atol=1e-12)
    np.testing.assert_allclose(out.select("p", "q", "r").to_numpy(), true_w, atol=1e-13)


def test_increments_are_corrected_as_increments(tmp_path: Path) -> None:
    """With an uneven clock and three samples missing: ∫ true dt comes out of ∫ reading dt over a sample's interval."""
    made, (true_f, true_w) = calibration(), recording()
    assert made.accel is not None
    assert made.gyro is not None
    dt = np.random.default_rng(2).uniform(0.0098, 0.0102, ROWS)
    t = np.cumsum(dt)
    t[200:] += 3 * 0.01
    true_dv, true_angle = true_f * dt[:, None], true_w * dt[:, None]
    table = pl.read_csv(
        triad_csv(made.accel.predict(true_f) * dt[:, None], made.gyro.predict(true_w) * dt[:, None] / DEGREE).encode()
    ).with_columns(t=t)
    parts = {
        "accel": {"columns": ["ax", "ay", "az"], "unit": "m/s"},
        "gyro": {"columns": ["p", "q", "r"], "unit": "deg"},
    }
    session_of(tmp_path, table.write_csv(), {"time": "t", **parts})
    out = corrected(made, tmp_path)
    sound = np.ones(ROWS, dtype=bool)
    sound[[0, 200]] = False  # their intervals are the nominal one, and a quarter of the gap
    dv, angle = out.select("ax", "ay", "az").to_numpy(), out.select("p", "q", "r").to_numpy()
    np.testing.assert_allclose(dv[sound], true_dv[sound], atol=1e-12)
    np.testing.assert_allclose(angle[sound], true_angle[sound], atol=1e-12)
    # over the gap the bias of one sample, not of four, is taken off: 3 % of an interval's bias is what the clock leaves
    assert np.abs(dv[200] - true_dv[200]).max() < 0.05 * 0.01 * np.abs(made.accel.bias).max()
    by_call, _ = made.apply(made.accel.predict(true_f) * dt[:, None], dt=dt)
    np.testing.assert_allclose(by_call, true_dv, atol=1e-12)


def test_everything_else_is_copied_as_it_is(tmp_path: Path) -> None:
    """Order and names of the columns, text, and numbers that a double cannot hold."""
    accel, gyro = recording()
    stamp = [str(1_700_000_000_000_000_000 + 10_000_007 * i) for i in range(ROWS)]
    flags = [f"ok, row {i}" for i in range(ROWS)]
    log = {"time": "t", **RATE}
    session_of(tmp_path, triad_csv(accel, gyro, stamp=stamp, flag=flags), log)
    out = corrected(calibration(), tmp_path, "out.csv")
    assert out.columns == ["t", "ax", "ay", "az", "p", "q", "r", "stamp", "flag"]
    assert out["stamp"].cast(pl.String).to_list() == stamp
    assert out["flag"].to_list() == flags
    source = pl.read_csv(tmp_path / "log.csv", infer_schema=False)
    assert pl.read_csv(tmp_path / "out.csv", infer_schema=False)["t"].to_list() == source["t"].to_list()


@pytest.mark.parametrize("delimiter", [",", ";"])
def test_a_log_without_names_stays_without(tmp_path: Path, delimiter: str) -> None:
    """And what describes the corrected log reads it again."""
    made, (accel, gyro) = calibration(), recording()
    body = triad_csv(accel, gyro).partition("\n")[2].replace(",", delimiter)
    tables = {
        "accel": {"columns": ["2", "3", "4"], "unit": "m/s^2"},
        "gyro": {"columns": ["5", "6", "7"], "unit": "rad/s"},
    }
    session_of(tmp_path, body, {"time": "1", "header": False, "delimiter": delimiter, **tables})
    described = apply_to_session(made, read_session(tmp_path), tmp_path / "out.csv")
    rows = pl.read_csv(tmp_path / "out.csv", has_header=False)
    assert rows.shape == (ROWS, 7)
    np.testing.assert_allclose(rows[:, 1:4].to_numpy(), made.apply(accel)[0], rtol=1e-15, atol=ROUNDING)
    chunks = open_log(session_of_content(described)).chunks()
    again = np.concatenate([chunk.accel for chunk in chunks])
    np.testing.assert_allclose(again, rows[:, 1:4].to_numpy(), rtol=0.0, atol=0.0)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_lost_samples_stay_lost(tmp_path: Path, value: float) -> None:
    accel, gyro = recording()
    accel[100, 1] = value
    session_of(tmp_path, triad_csv(accel, gyro), {"time": "t", **RATE})
    out = corrected(calibration(), tmp_path)
    assert out.height == ROWS
    lost = ~np.isfinite(out.select("ax", "ay", "az").to_numpy())
    assert lost[100].any()
    assert not np.delete(lost, 100, axis=0).any()
    assert np.isfinite(out.select("p", "q", "r").to_numpy()).all()


def test_a_redundant_block_gets_its_vector_and_what_each_perfect_sensor_would_read(tmp_path: Path) -> None:
    made, (true_f, _) = calibration(accel=HEXAD, with_gyro=False), recording()
    assert made.accel is not None
    names = [f"a{p}" for p in range(6)]
    table = csv_of({"t": 0.01 * np.arange(1, ROWS + 1), **dict(zip(names, made.accel.predict(true_f).T, strict=True))})
    accel = {"columns": names, "unit": "m/s^2", "axes": (HEXAD / np.linalg.norm(HEXAD, axis=1)[:, None]).tolist()}
    session_of(tmp_path, table, {"time": "t", "accel": accel})
    out = corrected(made, tmp_path)
    np.testing.assert_allclose(out.select("accel_x", "accel_y", "accel_z").to_numpy(), true_f, atol=1e-12)
    np.testing.assert_allclose(out.select(names).to_numpy(), true_f @ HEXAD.T, atol=1e-12)


def test_channels_in_another_order_keep_their_places(tmp_path: Path) -> None:
    """Channel 0 senses −Z: its column gets −true_z."""
    axes = np.array([[0.0, 0, -1], [1, 0, 0], [0, 1, 0]])
    made, (true_f, _) = calibration(accel=axes, with_gyro=False), recording()
    assert made.accel is not None
    table = csv_of({"t": 0.01 * np.arange(1, ROWS + 1), **dict(zip("abc", made.accel.predict(true_f).T, strict=True))})
    session_of(
        tmp_path, table, {"time": "t", "accel": {"columns": list("abc"), "unit": "m/s^2", "axes": axes.tolist()}}
    )
    out = corrected(made, tmp_path).select("a", "b", "c").to_numpy()
    np.testing.assert_allclose(out, np.column_stack([-true_f[:, 2], true_f[:, 0], true_f[:, 1]]), atol=1e-12)


def test_a_corrected_device_has_no_errors_left(tmp_path: Path) -> None:
    """Calibrating the corrected log of a noiseless session finds biases, scale errors and angles of zero."""
    request = Setup.of(grade="mems", positions=14, rest=5.0, rate_deg_s=120.0, sample_rate=50.0, noise_factor=0.0)
    folder = simulate_session(tmp_path / "session", request, seed=4)
    made, session = calibrate(stated_linear(folder), terms="linear"), read_session(folder)
    again = tmp_path / "again"
    again.mkdir()
    apply_to_session(made, session, again / "log.parquet")
    (again / "session.toml").write_text((folder / "session.toml").read_text())
    rest = calibrate(stated_linear(again), terms="linear")
    for before, after in zip(made.parameters, rest.parameters, strict=True):
        assert abs(after.value) < 1e-6 + 1e-4 * abs(before.value), after.name
    assert max(abs(p.value) for p in made.parameters) > 1e-3


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (calibration(serial="B-1"), "expected a session of device 'B-1', which was calibrated, found 'A-0007'"),
        (calibration(accel=HEXAD), "log.accel: expected as many sensors as the calibration has, 6, found 3"),
        (calibration(with_gyro=False), "log.gyro: expected as many sensors as the calibration has, 0, found 3"),
    ],
)
def test_a_calibration_that_does_not_fit_is_refused_and_nothing_is_written(
    tmp_path: Path, made: Calibration, said: str
) -> None:
    session_of(tmp_path, triad_csv(*recording()), {"time": "t", **RATE})
    with pytest.raises(InputError, match=said):
        apply_to_session(made, read_session(tmp_path), tmp_path / "out.csv")
    assert not (tmp_path / "out.csv").exists()


def test_a_log_that_breaks_off_leaves_what_was_there(tmp_path: Path) -> None:
    text = triad_csv(*recording()) + "4.01,1,2,three,4,5,6\n"
    session_of(tmp_path, text, {"time": "t", **RATE})
    out = tmp_path / "out.parquet"
    out.write_text("before")
    with pytest.raises(LogError, match=r"log\.csv: expected rows of numbers, found"):
        apply_to_session(calibration(), read_session(tmp_path), out, force=True)
    assert out.read_text() == "before"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["log.csv", "out.parquet", "session.toml"]


def test_a_library_call_with_another_number_of_sensors_is_refused() -> None:
    made = calibration(with_gyro=False)
    with pytest.raises(InputError, match=r"accel readings: expected 3 numbers a sample.*\(5, 2\)"):
        made.apply(np.zeros((5, 2)))
    with pytest.raises(InputError, match="gyro readings: expected none, for the calibration has no gyro"):
        made.apply(np.zeros((5, 3)), np.zeros((5, 3)))


def test_the_command_replaces_only_with_force(tmp_path: Path) -> None:
    session_of(tmp_path, triad_csv(*recording()), {"time": "t", **RATE})
    calibration().write(tmp_path / "c.json")
    words = ["apply", str(tmp_path / "c.json"), str(tmp_path), "-o", str(tmp_path / "out.parquet")]
    assert CliRunner().invoke(main, words).exit_code == 0
    again = CliRunner().invoke(main, words)
    assert again.exit_code == 2
    assert "give --force" in again.stderr
    assert CliRunner().invoke(main, [*words, "--force"]).exit_code == 0


def test_the_command_takes_a_log(tmp_path: Path) -> None:
    """As `calibrate` and `check` do: with the serial number and the place of the calibration."""
    folder = simulate_session(tmp_path / "made", Setup.of(grade="mems", positions=6), seed=1)
    made = calibration()
    made.write(tmp_path / "c.json")
    log = str(shutil.copy(folder / "log.parquet", tmp_path))
    result = CliRunner().invoke(main, ["apply", str(tmp_path / "c.json"), log, "-o", str(tmp_path / "out.parquet")])
    assert result.exit_code == 0, result.stderr
    found, seen = pl.read_parquet(tmp_path / "out.parquet"), pl.read_parquet(log)
    np.testing.assert_allclose(found["ax"], made.apply(seen.select("ax", "ay", "az").to_numpy())[0][:, 0], rtol=1e-12)
