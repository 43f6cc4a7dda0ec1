"""In-run biases: a warm-up without a thermometer, a drift, and a sensor that wanders more than the others are in the
processes of the biases, contained in u and said; and nothing is said where they are as usual."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import tumble
from tests.support.direct import DODECAHEDRON, SETUP, in_the_hand, observed, scenario
from tumble.diagnosis.verdict import verdict
from tumble.inference.estimate import Estimate, Outcome
from tumble.inference.joint import joint
from tumble.planning.setup import Setup
from tumble.reduction.observations import Observations
from tumble.run.observed import inspect_session, observations_for_calibration
from tumble.sensors.parameters import group_name, usual_sizes
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import itinerary, scenario_of
from tumble.simulation.temperature_profile import TemperatureProfile
from tumble.units import DEGREE, DEGREE_PER_HOUR, G_STANDARD, Array

START, RISE = 22.0, 15.0


def calibrated(seed: int, settles: float, seconds: float) -> tuple[Estimate, Outcome, Array]:
    """The estimate of a device by hand whose biases settle by ± 2 mg and ± 0.2 °/s times `settles` with a time
    constant, what is said of it, and the errors over u of what does not change: scale factors and axis angles."""
    rng = np.random.default_rng([77, seed])
    scenario = scenario_of(Setup.of(grade="mems", positions=24, rest=10.0), rng, serial="warming")
    duration = float(itinerary(scenario, rng.spawn(1)[0]).rests[-1, 1])
    profile = TemperatureProfile(celsius=(START,), heating=((RISE, seconds),))
    slopes = {
        f"{kind}.bias.{axis}.t1": float(rng.choice([-1.0, 1.0]) * settles * size / RISE)
        for kind, size in (("accel", 2e-3 * G_STANDARD), ("gyro", 0.2 * DEGREE))
        for axis in "xyz"
    }
    scenario = replace(scenario, truth=dict(scenario.truth) | slopes, climate=profile.climate(1.2 * duration))
    seen = simulate_observations(scenario, rng)
    blind = replace(seen, usual=usual_sizes("mems"), thermometers=None, rests=replace(seen.rests, temperatures=None))
    found = joint(blind)
    steady = [i for i, name in enumerate(found.names) if group_name(name).endswith((".scale", ".axis"))]
    errors = [(found.values[i] - scenario.truth[found.names[i]]) / found.u[i] for i in steady]
    return found, verdict(found, blind), np.array(errors)


@pytest.mark.parametrize(("settles", "seconds"), [(1.0, 80.0), (1.0, 200.0), (0.15, 400.0)])
def test_a_warm_up_is_in_the_process_of_the_biases_and_said(settles: float, seconds: float) -> None:
    _, said, errors = calibrated(1, settles, seconds)
    assert said.verdict == "accepted with scatter", said.reasons
    assert any(
        remark.startswith(("biases of the gyros drift by ", "biases of the gyros wander by "))
        for remark in said.unsteady
    )
    assert all(
        "the values given are means over the rests, and u is that of the means" in each for each in said.unsteady
    )
    assert said.remarks[: len(said.unsteady)] == said.unsteady
    assert said.is_unsteady("gyro.bias")
    assert not said.is_unsteady("gyro.axis")
    assert np.sqrt(np.mean(errors**2)) < 1.6
    assert np.abs(errors).max() < 4.0


def test_a_device_that_does_not_warm_has_no_warm_up() -> None:
    _, said, errors = calibrated(2, 0.0, 100.0)
    assert said.verdict == "accepted"
    assert np.abs(errors).max() < 4.0


@pytest.mark.parametrize(("positions", "seed"), [(5, 3), (5, 9), (6, 5), (6, 9)])
def test_gyros_that_drift_over_a_few_rests_read_no_products_of_forces(positions: int, seed: int) -> None:
    """By about 70°/h over the session. Products have as many columns as the rests leave degrees of freedom."""
    rng = np.random.default_rng([79, seed])
    setup = Setup.of(grade="mems", positions=positions, rest=40.0, rate_deg_s=90.0)
    scenario = scenario_of(setup, rng, serial="drifting")
    duration = float(itinerary(scenario, rng.spawn(1)[0]).rests[-1, 1])
    profile = TemperatureProfile(celsius=(START,), heating=((10.0, 2.0 * duration),))
    slope = 70.0 * DEGREE_PER_HOUR / 4.0
    slopes = {f"gyro.bias.{axis}.t1": float(rng.choice([-1.0, 1.0])) * slope for axis in "xyz"}
    scenario = replace(scenario, truth=dict(scenario.truth) | slopes, climate=profile.climate(1.2 * duration))
    seen = simulate_observations(scenario, rng)
    blind = replace(seen, usual=usual_sizes("mems"), thermometers=None, rests=replace(seen.rests, temperatures=None))
    said = verdict(joint(blind), blind)
    assert not any("products of forces" in each for each in (*said.reasons, *said.remarks))


def of_six(seed: int, wanders: float) -> Observations:
    """Twenty positions by hand of a block of six, with a bias of gyro 4 that wanders by so many times the noise of a
    rest."""
    rng = np.random.default_rng([401, seed])
    seen = observed(in_the_hand(scenario(SETUP, 401 + seed, DODECAHEDRON), 20), seed)
    gyro = seen.rests.gyro.copy()
    gyro[:, 4] += wanders * np.sqrt(seen.rests.gyro_covariance[:, 4, 4]) * rng.standard_normal(len(gyro))
    return replace(seen, rests=replace(seen.rests, gyro=gyro))


@pytest.mark.parametrize("wanders", [10.0, 300.0])
def test_a_gyro_that_wanders_has_a_size_of_its_own_and_is_named(wanders: float) -> None:
    seen = of_six(1, wanders)
    found = joint(seen)
    size = {each.name: each.value for each in found.hyperparameters}
    noise = np.sqrt(np.median(seen.rests.gyro_covariance[:, 4, 4]))
    of_all = np.hypot(size["gyro_in_run"], size["gyro"])  # what lasts, and what does not
    assert 0.5 * wanders * noise < of_all * size["gyro.in_run.4"] < 2.0 * wanders * noise
    assert of_all < 2.0 * noise
    said = verdict(found, seen)
    assert said.verdict == "accepted with scatter"
    assert any(remark.startswith("gyro.bias.4 wanders by ") for remark in said.remarks)


def test_sensors_that_are_alike_have_one_size() -> None:
    for seed in range(3):
        seen = of_six(seed, 0.0)
        assert verdict(joint(seen), seen).verdict == "accepted"


def test_a_turn_with_clipped_gyros_is_left_out_and_named(data: Path, tmp_path: Path) -> None:
    sensors = [[f"{kind}{chip}{axis}" for chip in range(1, 9) for axis in "xyz"] for kind in "ag"]
    axes = [*np.eye(3).tolist(), [0, -1, 0], [-1, 0, 0], [0, 0, -1]] * 4
    (tmp_path / "session.toml").write_text(
        f"""format = 1
[device]
serial = "array"
[log]
file = "{(data / "mimu4444" / "exp_3.parquet").as_posix()}"
time = "t"
[log.accel]
columns = {sensors[0]}
unit = "count"
scale = 2048.0
scale_per = "g"
axes = {axes}
[log.gyro]
columns = {sensors[1]}
unit = "count"
scale = 16.4
scale_per = "deg/s"
axes = {axes}
""".replace("'", '"')
    )
    observed = inspect_session(tmp_path)
    kept = observations_for_calibration(observed)
    assert not isinstance(kept, Outcome)
    assert kept.turns is not None
    assert np.all(np.abs(np.log(np.sqrt(kept.turns.aliased) / 9e-3)) < 1.0)  # rad: instantaneous samples
    assert 19 not in kept.turns.first
    said = "turn from rest 20 to rest 21 is left out: gyros are clipped in 1159 of its samples"
    assert said in kept.notes
    assert observed.observations is not None
    assert kept.arrays is observed.observations.arrays


def test_the_end_of_a_converter_is_seen_in_si_units(data: Path) -> None:
    """Readings in counts or in SI end at the same steps of their resolution: a chip in memory loses the same turn."""
    log = pl.read_parquet(data / "mimu4444" / "exp_3.parquet")
    accel, gyro = (log.select(f"{kind}5{axis}" for axis in "xyz").to_numpy() for kind in "ag")
    found = tumble.calibrate(accel=accel / 2048.0 * 9.80665, gyro=np.radians(gyro / 16.4), time=log["t"].to_numpy())
    assert (
        "turn from rest 20 to rest 21 is left out: gyros are clipped in 1101 of its samples" in found.provenance.notes
    )
    assert found.outcome.accepted
