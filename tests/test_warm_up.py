"""Biases are processes in time: a warm-up after power-on, a drift, a random walk or a chain do not spoil what is
estimated, and what is not known of them afterwards is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from wandering_biases import Process, biased, drift, gauss_markov, middles, random_walk, warm_up

from tumble.calibration.notes import drifted
from tumble.calibration.observed import inspect_session, observations_for_calibration
from tumble.estimation.diagnosis.verdict import verdict
from tumble.estimation.estimate import Estimate, Outcome
from tumble.inference.joint import joint
from tumble.planning.setup import Setup
from tumble.reduction.observations import Observations
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import scenario_of
from tumble.units import Array

ACCEL, GYRO = 5e-3, 1e-3
"""m/s² and rad/s: 0.5 mg and 200 °/h, several times the noise of a rest."""
LATER = 30.0
"""s after the last rest."""


def calibrated(of: Process | None, seed: int, positions: int = 12) -> tuple[Estimate, Observations, Array, Array]:
    """The estimate of a MEMS unit by hand whose biases are its own and a process each, its session, its true parameters
    with the means of the biases over the session, and the true biases a while later."""
    rng = np.random.default_rng([78, seed])
    scenario = scenario_of(Setup.of(grade="mems", positions=positions, rest=5.0), rng)
    session = simulate_observations(scenario, rng)
    time = middles(session)
    truth, later = scenario.values.copy(), np.zeros(6)
    if of is not None:
        path = np.array([of(rng, np.append(time, time[-1] + LATER)) for _ in range(6)]).T
        path = path * np.repeat([ACCEL, GYRO], 3)
        session, later = biased(session, path[:-1, :3], path[:-1, 3:]), path[-1]
    found = joint(session)
    biases = np.array([found.names.index(each.name) for each in found.process_bias])
    after = truth[biases] + later
    if of is not None:
        truth[biases] += path[:-1].mean(axis=0)
    return found, session, truth, after


PROCESSES = {
    "warm-up": warm_up(60.0),
    "drift": drift,
    "random walk": random_walk,
    "AR(1)": gauss_markov(20.0),
    "long chain": gauss_markov(300.0),
}


@pytest.mark.parametrize("name", PROCESSES)
def test_what_biases_do_in_a_session_is_in_u_and_what_they_do_next_in_that_of_the_next(name: str) -> None:
    """Over six units: errors of the 18 other parameters and of the mean biases of the session are those of u; and the
    biases half a minute later are where the processes say."""
    z, of_session, of_next = [], [], []
    for seed in range(6):
        found, session, truth, later = calibrated(PROCESSES[name], seed)
        assert found.converged
        assert verdict(found, session).accepted
        errors = (found.values - truth) / found.u
        is_bias = np.isin(found.names, [each.name for each in found.process_bias])
        z.append(errors[~is_bias])
        of_session.append(errors[is_bias])
        of_next.append([(each.value - b) / each.next_u for each, b in zip(found.process_bias, later, strict=True)])
    assert np.sqrt(np.mean(np.square(z))) < 1.5
    assert np.abs(z).max() < 5.0
    assert np.sqrt(np.mean(np.square(of_session))) < 1.6
    assert np.mean(np.abs(of_next) < 2.0) > 0.8


def test_a_device_that_does_not_warm_has_no_warm_up() -> None:
    found, session, truth, _ = calibrated(None, 2)
    assert np.abs((found.values - truth) / found.u).max() < 5.0
    assert not any("warm-up" in remark or "wander" in remark for remark in verdict(found, session).remarks)
    assert drifted(found) == ()


@pytest.mark.parametrize("of", [warm_up(60.0), drift], ids=["warm-up", "drift"])
def test_biases_that_settle_or_drift_by_far_more_than_usual_are_said(of: Process) -> None:
    """And u of the biases of another day is larger than that of the means over the session."""
    found, session, _, _ = calibrated(lambda rng, time: 5.0 * of(rng, time), 1, positions=18)
    said = verdict(found, session)
    assert said.verdict == "accepted with scatter", said.reasons
    for kind in ("accelerometers", "gyros"):
        assert any(f"biases of the {kind} wander by" in remark for remark in said.remarks), said.remarks
    u = dict(zip(found.names, found.u, strict=True))
    assert all(each.next_u > each.u > 2.0 * u[each.name] for each in found.process_bias)


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
