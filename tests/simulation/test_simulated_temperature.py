"""Simulated sessions with a thermometer: profiles, readings that change with temperature, truth at any temperature."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

from tumble.cli import main
from tumble.errors import InputError
from tumble.planning.setup import Setup
from tumble.recording.session_file import read_session
from tumble.run.calibrate import calibrate
from tumble.sensors.model import Block
from tumble.sensors.parameters import FURTHER, THERMAL
from tumble.simulation.session import read_truth, simulate_session
from tumble.simulation.temperature_profile import (
    REFERENCE,
    TemperatureProfile,
    draw_thermal,
    temperature_profile,
    thermometer_columns,
    truth_at,
)


@pytest.mark.parametrize(
    ("text", "at", "celsius"),
    [
        ("25", [0.0, 0.5, 1.0], [25.0, 25.0, 25.0]),
        ("-10:60", [0.0, 0.5, 1.0], [-10.0, 25.0, 60.0]),
        ("-10:60:-10", [0.0, 0.25, 0.5, 1.0], [-10.0, 25.0, 60.0, -10.0]),
        ("22+15@600", [0.0, 0.5, 1.0], [22.0, 37.0 - 15.0 * np.exp(-1.0), 37.0 - 15.0 * np.exp(-2.0)]),
        ("22.5-2.5@600", [0.0, 1.0], [22.5, 20.0 + 2.5 * np.exp(-2.0)]),
        ("-10:60:-10-5@600", [0.0, 0.5, 1.0], [-10.0, 55.0 + 5.0 * np.exp(-1.0), -15.0 + 5.0 * np.exp(-2.0)]),
    ],
)
def test_a_profile_is_what_its_text_says(text: str, at: list[float], celsius: list[float]) -> None:
    duration = 1200.0
    found = thermometer_columns(temperature_profile(text).climate(duration), duration * np.array(at))
    np.testing.assert_allclose(found["T"], celsius, atol=1e-4)


@pytest.mark.parametrize("text", ["", "warm", "20:", "20:abc", "22+15@0", "22+15", "-300", "20:900", "1e2"])
def test_what_is_no_profile_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(InputError, match=r"temperature: expected -100 to 200 degC, as 25, -10:60"):
        temperature_profile(text)


@pytest.fixture(scope="module")
def warm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A noiseless session of a MEMS unit while it gets warmer."""
    folder = tmp_path_factory.mktemp("simulated") / "warm"
    setup = Setup.of(grade="mems", programme="nine", rest=8.0, rate_deg_s=60.0, sample_rate=50.0, noise_factor=0.0)
    return simulate_session(folder, setup, seed=4, temperature=TemperatureProfile(celsius=(-10.0, 50.0)))


def test_the_log_has_a_thermometer_and_the_truth_its_reference(warm: Path) -> None:
    session, truth = read_session(warm), read_truth(warm / "truth.json")
    log = pl.read_parquet(warm / "log.parquet")
    assert session.log.temperature is not None
    assert session.log.temperature.columns == ("T",)
    assert (log["T"][0], log["T"][-1]) == (pytest.approx(-10.0, abs=0.02), pytest.approx(50.0, abs=0.02))
    assert truth["temperature.reference"] == pytest.approx(REFERENCE)
    assert {
        f"{group.name.rpartition('.')[0]}.x.{group.name.rpartition('.')[2]}"
        for group in FURTHER
        if group.variable in THERMAL and group.usual
    } <= set(truth)


def test_readings_at_rest_are_those_of_the_parameters_at_their_temperature(warm: Path) -> None:
    """At samples of the first rest the force that the model at that temperature makes of the reading is the same, and
    as large as gravity."""
    truth, first = read_truth(warm / "truth.json"), pl.read_parquet(warm / "log.parquet").filter(pl.col("t") < 7.9)
    block, forces = Block(kind="accel", axes=np.eye(3)), []
    for row in first.select("T", "ax", "ay", "az").to_numpy()[::50]:
        now = truth_at(truth, float(row[0]))
        forces.append(block.model(np.array([now[name] for name in block.names])).apply(row[1:]))
    np.testing.assert_allclose(forces, np.broadcast_to(forces[0], (8, 3)), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(forces, axis=1), read_session(warm).site.gravity, rtol=0.0, atol=1e-6)
    assert np.ptp(first["T"].to_numpy()) > 1.0


def test_truth_at_another_temperature_and_back_is_the_truth() -> None:
    truth = {"a.bias.x": 1.0, "a.bias.x.t1": 0.1, "a.bias.x.t2": 0.01, "a.axis.yx": 3.0, "temperature.reference": 25.0}
    there = truth_at(truth, 35.0)
    assert there["a.bias.x"] == pytest.approx(1.0 + 0.1 * 10.0 + 0.01 * 100.0)
    assert there["a.bias.x.t1"] == pytest.approx(0.1 + 2.0 * 0.01 * 10.0)
    assert there["a.axis.yx"] == 3.0
    assert truth_at(there, 25.0) == pytest.approx(truth)
    assert truth_at({"a.bias.x": 1.0}, 35.0) == {"a.bias.x": 1.0}
    assert truth_at(truth, None) == truth


def test_a_device_is_the_same_one_at_every_temperature_and_without_a_thermometer(tmp_path: Path) -> None:
    setup = Setup.of(grade="mems", positions=3, rest=5.0, sample_rate=50.0)
    cold, hot = (
        simulate_session(tmp_path / str(T), setup, seed=9, temperature=TemperatureProfile(celsius=(T,)))
        for T in (-20.0, 60.0)
    )
    plain = simulate_session(tmp_path / "plain", setup, seed=9)
    truths = [json.loads((folder / "truth.json").read_text()) for folder in (cold, hot, plain)]
    assert truths[0] == truths[1]
    assert truths[2].items() <= truths[0].items()
    assert read_session(plain).log.temperature is None


def test_spreads_are_those_of_the_setup_before_those_of_the_grade() -> None:
    blocks = {"accel": Block(kind="accel", axes=np.eye(3)), "gyro": Block(kind="gyro", axes=np.eye(3))}
    rng = np.random.default_rng(1)
    drawn = [draw_thermal({"accel.bias.t1": 1e-9}, "mems", blocks, rng) for _ in range(200)]
    for name, spread in (("accel.bias.x.t1", 1e-9), ("gyro.scale.y.t1", 200e-6)):
        assert np.std([values[name] for values in drawn]) == pytest.approx(spread, rel=0.25)  # 5 sigma of 200
    assert not any(draw_thermal({}, "my own", blocks, rng).values())


def test_a_ramp_up_and_down_is_calibrated_within_its_uncertainties(tmp_path: Path) -> None:
    words = ["--grade", "tactical", "--rest", "15", "--turn-rate", "40", "--sample-rate", "50", "--seed", "3"]
    result = CliRunner().invoke(main, ["simulate", str(tmp_path / "s"), *words, "--temperature", "-10:60:-10"])
    assert result.exit_code == 0
    calibration = calibrate(tmp_path / "s")
    assert calibration.outcome.accepted
    truth = truth_at(read_truth(tmp_path / "s" / "truth.json"), calibration.reference_temperature)
    z = np.array([(p.value - truth[p.name]) / p.u for p in calibration.parameters if p.u and p.name in truth])
    assert len(z) >= 33
    assert np.sqrt(np.mean(z**2)) < 1.8  # chi-square of 33: one in 10⁹


def test_a_device_with_all_terms_has_a_lag_and_hysteresis(tmp_path: Path) -> None:
    """They are in truth.json by their names, and the calibration of the log finds them."""
    setup = Setup.of(grade="tactical", rest=20.0, rate_deg_s=40.0, sample_rate=25.0, terms="full")
    profile = temperature_profile("10:35:10")
    folder = simulate_session(tmp_path / "s", setup, seed=5, temperature=profile)
    true = read_truth(folder / "truth.json")
    hysteresis = [name for name in true if name.endswith(".hysteresis")]
    assert len(hysteresis) == 6
    lags = [name for name in true if name.endswith(".lag")]
    assert len(lags) == 2
    assert all(true[name] > 0.0 for name in lags)
    found = calibrate(folder)
    assert found.outcome.accepted, found.outcome.reasons
    assert all((found[name].u or np.inf) < 100.0 for name in lags)
    for name in (*lags, *hysteresis):
        assert abs(found[name].value - true[name]) < 6.0 * (found[name].u or 0.0), name
