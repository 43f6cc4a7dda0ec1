"""What is far from usual is said by its name: groups of parameters, the stated grade, the time base, unused quiet time;
and what would help is what is missing."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from pydantic import TypeAdapter

from tests.diagnosis.test_verdict import estimated
from tests.support.shared import copy_of, session
from tests.support.wandering_biases import biased, middles, warm_up
from tumble.diagnosis.findings import causes_of
from tumble.diagnosis.misfit import misfit
from tumble.diagnosis.verdict import doubtful_time_base, unused_quiet_time, verdict
from tumble.documents import as_json
from tumble.inference.estimate import Estimate, Outcome
from tumble.inference.joint import joint
from tumble.methods.ellipsoid import ellipsoid
from tumble.planning.setup import Setup
from tumble.reduction.observations import Observations
from tumble.reduction.rests.segmentation import Segmentation, Stretch
from tumble.run.calibrate import calibrate
from tumble.sensors.grades import GRADES
from tumble.sensors.parameters import group_name
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import scenario_of
from tumble.units import DEGREE_PER_HOUR

OF_READINGS = ("accel.quadratic", "accel.cubic", "accel.asymmetry", "gyro.asymmetry", "gyro.g_sensitivity")


@cache
def by_hand(times: float, seed: int) -> tuple[Estimate, Observations, dict[str, float]]:
    """The estimate of twelve rests by hand of a MEMS unit whose groups at rest are so many times the usual sizes."""
    rng = np.random.default_rng([44, seed])
    scenario = scenario_of(Setup.of(grade="mems", positions=12, rest=5.0, terms="full"), rng)
    truth = {name: v * (times if group_name(name) in OF_READINGS else 1.0) for name, v in scenario.truth.items()}
    observations = simulate_observations(replace(scenario, truth=truth), rng)
    return joint(observations), observations, truth


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_groups_at_ten_times_their_size_are_named_and_nothing_scatters(seed: int) -> None:
    estimate, observations, _ = by_hand(10.0, seed)
    outcome = verdict(estimate, observations)
    assert outcome.verdict == "accepted with scatter"
    assert any(remark.startswith("larger than usual: ") and "g-sensitivity of the gyros (about " in remark
               for remark in outcome.gyro.remarks)  # fmt: skip
    assert not any("scatter by" in remark for remark in outcome.remarks)
    assert "gyro.g_sensitivity" in causes_of(misfit(estimate))
    (said,) = (remark for remark in outcome.gyro.remarks if "g-sensitivity" in remark)
    assert said not in outcome.accel.remarks
    assert TypeAdapter(Outcome).validate_json(json.dumps(as_json(outcome))) == outcome


@pytest.mark.parametrize("seed", [14, 24])
def test_groups_that_are_larger_than_usual_are_named_alone(seed: int) -> None:
    """By accelerometers alone the maximum has scatter in place of them, which products of forces would explain."""
    rng, setup = np.random.default_rng([48, seed]), Setup.of(grade="mems", positions=19, rest=10.0, terms="full")
    sizes = {name: 10.0 * size for name, size in setup.further.items()}
    observations = simulate_observations(scenario_of(replace(setup, further=sizes), rng), rng).of_accelerometers()
    found = causes_of(misfit(ellipsoid(replace(observations, usual=setup.further))))
    assert {"accel.quadratic", "accel.asymmetry"} <= set(found) <= {*OF_READINGS}


def test_groups_that_rests_hardly_tell_apart_are_widened_alike() -> None:
    """Else one takes what is seen of both, and the u of the other is that of its usual size."""
    errors = list[float]()
    for seed in range(3):
        estimate, _, truth = by_hand(10.0, seed)
        widened = {group.name: group.prior_widened for group in estimate.groups}
        assert widened["accel.asymmetry"] == pytest.approx(widened["accel.quadratic"])
        for name, value, u in zip(estimate.names, estimate.values, estimate.u, strict=True):
            if group_name(name) in ("accel.quadratic", "accel.asymmetry"):
                errors.append(float((value - truth[name]) / u))
    assert np.sqrt(np.mean(np.square(errors))) < 2.2


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_groups_of_their_usual_sizes_are_not_spoken_of(seed: int) -> None:
    estimate, observations, _ = by_hand(1.0, seed)
    assert verdict(estimate, observations).verdict == "accepted"


@pytest.mark.parametrize("seed", [1018, 1026])
def test_in_run_biases_of_the_usual_size_are_no_scatter(seed: int) -> None:
    """26 rests of a minute show them; the largest of forty instruments were estimated at 1.3 and 1.9 times that."""
    rng = np.random.default_rng(seed)
    setup = Setup.of(grade="tactical", programme="cube-26", terms="full")
    observations = simulate_observations(scenario_of(setup, rng), rng)
    assert verdict(joint(observations), observations).verdict == "accepted"


@pytest.mark.parametrize("seed", [9, 58])
def test_readings_at_rest_that_scatter_are_no_lost_samples(seed: int) -> None:
    """Gyros that warm up by 500 °/h scatter at rest alone."""
    rng, setup = np.random.default_rng([81, seed]), Setup.of(grade="mems", positions=17, rest=5.0, terms="full")
    observations = simulate_observations(scenario_of(setup, rng), rng)
    warming = warm_up(200.0)
    change = np.column_stack([500.0 * DEGREE_PER_HOUR * warming(rng, middles(observations)) for _ in range(3)])
    assert causes_of(misfit(joint(biased(observations, 0.0 * change, change)))) == ("drift",)


def test_a_drift_is_said_as_large_as_the_result_has_it() -> None:
    estimate, observations = estimated("biases drift by 50 µg, 0.1 °/h", 3.0)
    members = [i for i, name in enumerate(estimate.names) if group_name(name) == "accel.bias.drift"]
    longest = float(np.ptp([observations.rests.start.min(), observations.rests.stop.max()]))
    values = estimate.values.copy()
    values[members] = 2.0e-3 * 9.80665 / longest  # 2 mg over the session
    found = misfit(replace(estimate, values=values))
    assert any("biases of the accelerometers drift by 2e+03 µg" in each.sentence for each in found)


# -------------------- time base --------------------


def gyros_off(by: float, usual: float, spread: float, u: float = 0.0) -> tuple[str, ...]:
    """What is said of gyros whose scale factors are `by` on the mean, with a common uncertainty."""
    estimate = by_hand(1.0, 0)[0]
    scales = [i for i, name in enumerate(estimate.names) if group_name(name) == "gyro.scale"]
    values, covariance = estimate.values.copy(), estimate.covariance.copy()
    values[scales] = by + spread * np.array([-1.0, 0.0, 1.0])
    covariance[np.ix_(scales, scales)] += u**2
    return doubtful_time_base(replace(estimate, values=values, covariance=covariance), usual)


def test_scale_factors_that_err_alike_are_said_where_the_time_base_does_not_allow_it() -> None:
    (said,) = gyros_off(0.05, usual=6e-3, spread=6e-3)
    assert "err alike, by +5 %" in said
    assert gyros_off(-1e-3, usual=1e-4, spread=1e-4)  # of a navigation unit
    assert not gyros_off(0.05, usual=6e-3, spread=6e-3, u=0.02)
    assert not gyros_off(0.01, usual=6e-3, spread=6e-3)  # three of a kind may
    assert not gyros_off(0.05, usual=6e-3, spread=0.05)


def test_scale_factors_of_their_usual_sizes_are_no_wrong_time_base() -> None:
    rng, usual, said = np.random.default_rng(3), GRADES["mems"].gyro.scale, 0
    for _ in range(2000):
        x = rng.normal(0.0, usual, 3)
        said += bool(gyros_off(float(x.mean()), usual, float(x.std(ddof=1))))
    assert said <= 2


def test_a_rate_without_stamps_leaves_scale_factors_observable() -> None:
    """One per cent of a chip's oscillator is in their u, and no turn would show more of them."""
    setup = Setup.of(grade="mems", positions=12, rest=5.0, sample_rate=50.0)
    log = pl.read_parquet(session(setup, seed=1) / "log.parquet")
    accel, gyro = log.select("ax", "ay", "az").to_numpy(), log.select("gx", "gy", "gz").to_numpy()
    found = calibrate(accel=accel, gyro=gyro, rate=50.0, latitude=0.99, height=0.0, serial="A")
    assert found.outcome.verdict == "accepted"
    (u,) = (p.u for p in found.parameters if p.name == "gyro.scale.x")
    assert u == pytest.approx(0.01, rel=0.1)


# -------------------- grade, quiet time, what would help --------------------


def test_a_grade_that_the_noise_rules_out_gives_way_and_is_said(tmp_path: Path) -> None:
    setup = Setup.of(grade="mems", positions=14, rest=5.0, sample_rate=50.0, terms="full")
    folder = copy_of(session(setup, seed=4), tmp_path / "s")
    toml = folder / "session.toml"
    text, found = toml.read_text(encoding="utf-8"), []
    for grade in ("mems", "navigation"):
        toml.write_text(text.replace("[device]", f'[device]\ngrade = "{grade}"'), encoding="utf-8")
        found.append(calibrate(folder))
    right, wrong = found
    (said,) = wrong.outcome.remarks
    assert "the stated grade is 'navigation', but by the noise the device is of the grade mems" in said
    assert right.outcome.verdict == "accepted"
    assert [p.u for p in wrong.parameters] == pytest.approx([p.u for p in right.parameters], rel=0.5)


def test_much_quiet_time_that_is_no_rest_is_a_remark() -> None:
    rests = tuple(Stretch(file=0, first=0, last=1, start=10.0 * i, stop=10.0 * i + 5.0) for i in range(4))
    sway = tuple(
        Stretch(file=0, first=0, last=1, start=10.0 * i + 5.0, stop=10.0 * i + 8.0, fails="vertical", reason="moves")
        for i in range(4)
    )
    found = Segmentation(rests=rests, rejected=sway, rate_limit=None, scatter_limit=1.0)
    (said,) = unused_quiet_time(found)
    assert said.startswith("12 s of 32 s in which the device was quiet are not used as rests")
    assert not unused_quiet_time(replace(found, rejected=sway[:3]))


def test_no_attitude_is_wanted_where_rests_and_turns_are_in_many() -> None:
    """Turns ten thousand times as noisy: what is lost in noise no further turn would show."""
    rng = np.random.default_rng(2)
    observations = simulate_observations(scenario_of(Setup.of(grade="mems", positions=20), rng), rng)
    assert observations.turns is not None
    noisy = replace(observations.turns, covariance=1e8 * observations.turns.covariance,
                    velocity_covariance=1e8 * observations.turns.velocity_covariance)  # fmt: skip
    observations = replace(observations, turns=noisy, usual={})
    outcome = verdict(joint(observations), observations)
    reason = outcome.gyro.reasons[0]
    assert "the turns there are would show it if they were quieter" in reason
    assert "that would help" not in reason
