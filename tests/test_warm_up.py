"""Warm-up after power-on without a thermometer: found, contained in u and said; and not where there is none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tumble.calibration.notes import drifted
from tumble.calibration.observed import inspect_session, observations_for_calibration
from tumble.estimation.diagnosis.verdict import verdict
from tumble.estimation.estimate import Estimate, Outcome
from tumble.inference.likelihood import WARMING, Problem
from tumble.inference.fits import fit_of
from tumble.inference.joint import joint
from tumble.inference.start import start_of
from tumble.estimation.methods.joint.time_constants import TimeConstants, settling_with, without_own
from tumble.planning.setup import Setup
from tumble.sensors.parameters import usual_sizes
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import itinerary, scenario_of
from tumble.simulation.temperature_profile import REFERENCE, REFERENCE_NAME, TemperatureProfile, truth_at
from tumble.units import DEGREE, G_STANDARD, Array

START, RISE = 22.0, 15.0


def calibrated(seed: int, settles: float, seconds: float) -> tuple[Estimate, Outcome, Array]:
    """The estimate of a device by hand whose biases settle by ± 2 mg and ± 0.2 °/s times `settles` with a time
    constant, what is said of it, and the errors of the linear model, for the settled device, over u."""
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
    truth = truth_at(dict(scenario.truth) | {REFERENCE_NAME: REFERENCE}, START + RISE)
    seen = simulate_observations(scenario, rng)
    blind = replace(seen, usual=usual_sizes("mems"), thermometers=None, rests=replace(seen.rests, temperatures=None))
    found = joint(blind)
    assert found.instrument is not None
    linear = found.names[: found.instrument.linear_count]
    errors = [(found.values[i] - truth[name]) / found.u[i] for i, name in enumerate(linear)]
    return found, verdict(found, blind), np.array(errors)


@pytest.mark.parametrize("seconds", [80.0, 200.0])
def test_a_warm_up_is_said_and_u_contains_it(seconds: float) -> None:
    found, said, errors = calibrated(1, 1.0, seconds)
    assert said.verdict == "accepted with scatter", said.reasons
    assert said.remarks[0].startswith("warm-up after power-on: biases of the accelerometers settle by up to ")
    assert found.linearised is not None
    settling = found.linearised.problem.observations.warm_up
    assert settling == pytest.approx(seconds, rel=0.3)
    assert np.sqrt(np.mean(errors**2)) < 1.6
    assert np.abs(errors).max() < 4.0


def test_a_device_that_does_not_warm_has_no_warm_up() -> None:
    found, said, _ = calibrated(2, 0.0, 100.0)
    assert found.linearised is not None
    assert found.linearised.problem.observations.warm_up is None
    assert not any("warm-up" in remark for remark in said.remarks)
    assert drifted(found) == ()


def test_a_warm_up_that_passes_for_a_drift_is_noted() -> None:
    """Over a session of about its time constant, the bias of the settled device is not in the data."""
    found, _, errors = calibrated(3, 0.15, 400.0)
    assert found.linearised is not None
    assert found.linearised.problem.observations.warm_up is None
    assert np.abs(errors).max() > 5.0
    notes = drifted(found)
    assert any(note.startswith("biases of the gyros drift: those given are of the middle") for note in notes)


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
    observations = observations_for_calibration(observed)
    assert not isinstance(observations, Outcome)
    assert observations.turns is not None
    assert np.all(np.abs(np.log(np.sqrt(observations.turns.aliased) / 9e-3)) < 1.0)  # rad: instantaneous samples
    assert 19 not in observations.turns.first
    said = "turn from rest 20 to rest 21 is left out: gyros are clipped in 1159 of its samples"
    assert said in observations.notes
    assert observed.observations is not None
    assert observations.arrays is observed.observations.arrays


def test_one_elimination_says_the_likelihood_of_every_time_constant() -> None:
    found, _, _ = calibrated(1, 1.0, 80.0)
    assert found.linearised is not None
    solved = found.linearised.problem
    blind = replace(solved.observations, warm_up=None)
    problem = Problem.of(blind, instrument=solved.instrument, usual=blind.usual)
    fitted = fit_of(problem, start_of(problem)[0])
    of_all = TimeConstants.of(fitted, problem, (10.0, 600.0))
    steps, told = [], []
    for settling in (30.0, 90.0, 250.0):
        warm = replace(settling_with(problem, settling, WARMING), measured=fitted.problem.measured)
        steps.append(without_own(warm, fitted.solved).solved(warm, fitted.scatter))
        told.append(of_all.deviance(settling, warm))
        change = (of_all.values(settling, warm) - steps[-1].parameters) / np.sqrt(np.diag(steps[-1].covariance))
        assert np.abs(change).max() < 1e-2
    assert np.diff(told) == pytest.approx(np.diff([step.deviance for step in steps]), abs=0.02)
