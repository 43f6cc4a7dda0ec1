"""Several sessions over temperature as one estimate: its rows, its step, and the way from logs to a file."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

from tests.support.plain_rows import of_rests, plain_rows, with_residuals
from tumble.cli import main
from tumble.diagnosis.causes import LinearisedSession
from tumble.diagnosis.misfit import misfit
from tumble.diagnosis.projection import projections
from tumble.diagnosis.verdict import verdict
from tumble.errors import InputError
from tumble.inference.integrated_turns import IntegratedTurns
from tumble.inference.joint import joint
from tumble.inference.linearisation import linearise
from tumble.inference.normal_equations import solve
from tumble.inference.problem import SESSION_VARIABLES, Point, Problem
from tumble.inference.variables import variables_of
from tumble.planning.setup import Setup
from tumble.recording.log import open_log
from tumble.recording.session import Session
from tumble.recording.session_file import session_of, write_session
from tumble.reduction.observations import Observations, join_sessions
from tumble.result.calibration import Calibration, read_calibration
from tumble.run.together import calibrate_together
from tumble.sensors.instrument import Instrument
from tumble.sensors.parameters import prior_of, usual_sizes
from tumble.simulation.observations import simulate_observations
from tumble.simulation.recording import record
from tumble.simulation.scenario import Scenario, scenario_of
from tumble.simulation.temperature_profile import REFERENCE_NAME, Climate, truth_at
from tumble.units import DEGREE_PER_HOUR, G_STANDARD, ZERO_CELSIUS, Array

LONG = 4000.0
REFERENCE = 20.0 + ZERO_CELSIUS


def device(grade: str, setup: Setup, seed: int = 1, *, hysteresis: bool = False) -> Scenario:
    """A device with coefficients over temperature, of the usual size."""
    rng = np.random.default_rng(seed)
    scenario, usual = scenario_of(setup, rng), usual_sizes(grade)
    sought = {"temperature", "temperature²"} | ({"hysteresis"} if hysteresis else set())
    every = Instrument.of(scenario.accel, scenario.gyro, usual, sought)
    more = {
        name: float(usual[group.name] * rng.standard_normal())
        for group in every.further
        if group.variable is not None
        for name in group.names(every.block(group))
    }
    return replace(scenario.changed(further=usual), truth=dict(scenario.truth) | more)


def ramp(*celsius: float, lag: float = 0.0) -> Climate:
    """Temperatures that are passed through at a constant rate, with gyros that lag behind twice as much."""
    kelvin = np.array(celsius) + ZERO_CELSIUS
    span = 0.5 * (kelvin.min() + kelvin.max()), max(0.5 * float(np.ptp(kelvin)), 1.0)
    return Climate(
        time=np.linspace(0.0, LONG, len(kelvin)),
        kelvin=kelvin[:, None],
        reference=REFERENCE,
        lags={"accel": lag, "gyro": 2.0 * lag},
        span=span,
    )


def together(scenario: Scenario, climates: list[Climate], seed: int = 2) -> Observations:
    """Sessions of a device in several climates, each with biases of its own launch."""
    observed = []
    for i, climate in enumerate(climates):
        rng = np.random.default_rng([seed, i])
        truth = dict(scenario.truth)
        for name in truth:
            kind, what, *rest = name.split(".")
            if what == "bias" and len(rest) == 1:
                truth[name] += scenario.setup.further[f"{kind}.bias.launch"] * rng.standard_normal()
        observed.append(simulate_observations(replace(scenario, truth=truth, climate=climate), rng))
    names = [f"session-{i + 1}" for i in range(len(climates))]
    return join_sessions(observed, names, [np.arange(len(each.rests)) for each in observed])


def problem_of(observations: Observations) -> Problem:
    accel, gyro, usual = observations.accel_block, observations.gyro_block, observations.usual
    instrument = Instrument.of(accel, gyro, usual, set(variables_of(observations)) - set(SESSION_VARIABLES))
    every = Instrument.of(accel, gyro, usual, SESSION_VARIABLES)
    own = replace(every, further=tuple(group for group in every.further if group.variable in SESSION_VARIABLES))
    return Problem.of(observations, instrument=instrument, local=own, usual=usual)


def somewhere(problem: Problem, seed: int = 3) -> Point:
    """A point with values of the usual size."""
    rng, observations = np.random.default_rng(seed), problem.observations
    values = 0.1 * problem.prior_u[1:] * rng.standard_normal(len(problem.instrument.names))
    values[problem.instrument.linear_count - 21 : problem.instrument.linear_count] *= 0.01
    values[list(problem.lag_places.values())] = 40.0, 20.0
    force = observations.rests.accel
    up = force / np.linalg.norm(force, axis=1, keepdims=True)
    east = np.cross(np.where(np.abs(up[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]), up)
    east /= np.linalg.norm(east, axis=1, keepdims=True)
    return Point(
        values=values,
        gravity=observations.site.gravity,
        attitudes=np.stack([np.cross(up, east), up, east], axis=1),
        local=problem.local_u * rng.standard_normal((len(problem.session_spans), len(problem.local_u))),
    )


UP_AND_DOWN = [ramp(0.0, 40.0, 0.0, lag=50.0), ramp(40.0, 0.0, 40.0, lag=50.0)]
SHORT = Setup.of(grade="mems", programme="cube-14", rest=60.0, rate_deg_s=20.0)


def test_rows_of_temperature_and_of_each_session_are_those_of_finite_differences() -> None:
    """Of coefficients over temperature and hysteresis, and of what each session has of its own."""
    problem = problem_of(together(device("mems", SHORT, hysteresis=True), UP_AND_DOWN))
    point = somewhere(problem)
    observations, m = problem.observations, len(point.values)
    about = IntegratedTurns.of(observations, problem.instrument, point.values, problem.coefficient_changes(point))
    rows = plain_rows(linearise(problem, point, about))
    size = np.concatenate([problem.prior_u[1:], problem.local_u])
    thermal = [i for i, name in enumerate(problem.instrument.names) if name.rpartition(".")[2] in ("t1", "t2")]
    thermal += [i for i, name in enumerate(problem.instrument.names) if name.endswith("hysteresis")]
    assert len(thermal) == 30
    for i in [*thermal, *range(m, m + len(problem.local_u))]:
        step = 1e-3 * size[i] * np.eye(len(size))[i]
        ends = [
            plain_rows(
                linearise(problem, replace(point, values=point.values + d[:m], local=point.local + d[m:]), about)
            )
            for d in (step, -step)
        ]
        for which, first in (("rest", 3), ("turn", 6)):
            found = getattr(rows, which)[..., first + 1 + i]
            there, back = (getattr(end, which)[..., -1] for end in ends)
            expected = (back - there) / (2.0 * step[i])
            scale = np.abs(found).max(axis=0) + 1e-3 * np.abs(found).max() + 1e-300
            assert np.all(np.abs(found - expected) < 2e-3 * scale), (which, i)


def dense(problem: Problem, point: Point) -> Array:
    """The covariance of gravity and the parameters by ordinary least squares of everything at once."""
    rows = linearise(problem, point, IntegratedTurns.of(problem.observations, problem.instrument, point.values))
    W, plain = rows.noise.whitening(), plain_rows(rows)
    turns = problem.observations.turns
    assert turns is not None
    N, m, q, S = len(problem.chain), len(point.values), len(problem.local_u), len(problem.session_spans)
    blocks = []
    every = (of_rests(W) @ plain.rest, np.arange(N), 3), (W["turn"] @ plain.turn, turns.first, 6)
    for found, first, wide in every:
        for own, i, s in zip(found, first, problem.session_of_station[first], strict=True):
            block = np.zeros((len(own), 3 * N + S * q + 1 + m))
            block[:, 3 * i : 3 * i + wide], block[:, 3 * N + S * q :] = own[:, :wide], own[:, wide : wide + 1 + m]
            block[:, 3 * N + s * q : 3 * N + (s + 1) * q] = own[:, wide + 1 + m : -1]
            blocks.append(block)
    prior = np.zeros((1 + m, 3 * N + S * q + 1 + m))
    prior[:, 3 * N + S * q :] = rows.prior[:-1, :-1]
    own_prior = np.zeros((S * q, 3 * N + S * q + 1 + m))
    own_prior[:, 3 * N : 3 * N + S * q] = np.diag(np.tile(1.0 / problem.local_u, S))
    A = np.concatenate([*blocks, prior, own_prior])
    scale = np.linalg.norm(A, axis=0)
    triangle = np.asarray(np.linalg.qr(A / scale, mode="r"))
    information = triangle[3 * N :, 3 * N :]
    inverse = np.linalg.inv(information) / scale[3 * N :, None]
    return np.asarray(inverse @ inverse.T)


def test_the_step_is_that_of_everything_at_once() -> None:
    """What is eliminated session by session gives the covariance of ordinary least squares, and its estimates."""
    problem = problem_of(together(device("mems", SHORT, hysteresis=True), UP_AND_DOWN))
    point = somewhere(problem)
    rows = linearise(problem, point, IntegratedTurns.of(problem.observations, problem.instrument, point.values))
    step = solve(rows)
    S, q = step.local.shape
    expected = dense(problem, point)
    u = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(np.sqrt(np.diag(step.covariance)), u[S * q :], rtol=1e-5)
    own = np.diagonal(step.session_covariances, axis1=1, axis2=2)[:, :q]
    np.testing.assert_allclose(np.sqrt(own).ravel(), u[: S * q], rtol=1e-5)


@pytest.mark.parametrize(
    ("key", "text", "group", "size"),
    [
        ("accel_curvature.bias", "1 ug/K^2", "accel.bias.t2", 1e-6 * G_STANDARD),
        ("gyro_launch.bias", "10 deg/h", "gyro.bias.launch", 10.0 * DEGREE_PER_HOUR),
        ("accel_hysteresis.bias", "20 ug", "accel.bias.hysteresis", 20e-6 * G_STANDARD),
        ("gyro_lag", "60 s", "gyro.lag", 60.0),
    ],
)
def test_a_data_sheet_may_say_them(key: str, text: str, group: str, size: float) -> None:
    name, found = prior_of(key, text)
    assert name == group
    assert found == pytest.approx(size)


# -------------------- over temperature --------------------


def errors(scenario: Scenario, observations: Observations) -> dict[str, float]:
    """Errors of an estimate in units of u, by parameter."""
    estimate = joint(observations)
    assert estimate.converged
    kelvin = observations.rests.temperature
    assert kelvin is not None
    warmer, truth = kelvin.mean() - REFERENCE, dict(scenario.truth)
    for name in scenario.truth:
        base, _, ending = name.rpartition(".")
        if ending == "t1":
            slope, curvature = scenario.truth[name], scenario.truth[f"{base}.t2"]
            truth[base] += slope * warmer + curvature * warmer**2
            truth[name] += 2.0 * curvature * warmer
    climate = scenario.climate
    truth |= {} if climate is None else {f"{kind}.lag": lag for kind, lag in climate.lags.items()}
    return {
        name: float((value - truth.get(name, 0.0)) / u)
        for name, value, u in zip(estimate.names, estimate.values, estimate.u, strict=True)
    }


def test_three_levels_give_the_coefficients_of_a_device_with_large_ones() -> None:
    """A MEMS device whose biases change by degrees per second: turns are integrated at their own temperatures."""
    scenario = device("mems", SHORT, seed=5)
    found = errors(scenario, together(scenario, [ramp(t, t) for t in (-20.0, 20.0, 60.0)]))
    z = np.array([value for name, value in found.items() if name.rpartition(".")[2] in ("t1", "t2")])
    assert len(z) == 24
    assert np.sqrt(np.mean(z**2)) < 1.8
    assert np.abs(list(found.values())).max() < 6.0


@pytest.mark.parametrize("seed", [0, 3])
def test_two_levels_leave_the_curvature_to_what_is_usual(seed: int) -> None:
    """A bias far beyond its usual size is no curvature, and there is no lag where nothing gets warmer."""
    scenario = device("mems", SHORT, seed=seed)
    truth = dict(scenario.truth)
    for name in ("gyro.bias.x", "gyro.bias.y", "gyro.bias.z"):
        truth[name] *= 100.0
    levels = together(replace(scenario, truth=truth), [ramp(t, t) for t in (10.0, 40.0)])
    found = joint(levels)
    assert found.converged
    widened = {group.name: group.prior_widened for group in found.groups}
    assert not {"accel.lag", "gyro.lag"} & set(widened)
    assert all(widened[f"{base}.t2"] == 1.0 for base in ("accel.bias", "accel.scale", "gyro.bias", "gyro.scale"))
    assert not verdict(found, levels).reasons


@pytest.mark.weekly
def test_a_ramp_up_and_down_shows_the_lag() -> None:
    scenario = device("navigation", Setup.of(grade="navigation", programme="rough-table"), seed=7)
    lag = 100.0
    sessions = together(scenario, [ramp(0.0, 40.0, lag=lag), ramp(40.0, 0.0, lag=lag)])
    found = errors(replace(scenario, climate=ramp(0.0, lag=lag)), sessions)
    assert np.abs(list(found.values())).max() < 6.0
    estimate = joint(sessions)
    for name, expected, largest in (("accel.lag", lag, 10.0), ("gyro.lag", 2.0 * lag, 80.0)):
        at = estimate.names.index(name)
        assert estimate.u[at] < largest
        assert estimate.values[at] == pytest.approx(expected, abs=6.0 * estimate.u[at])


def test_each_session_alone_knows_what_all_know() -> None:
    """With what the others say, parameters are as well known from one session as from all."""
    estimate = joint(together(device("mems", SHORT, seed=5), [ramp(t, t) for t in (0.0, 40.0)]), quick=True)
    assert estimate.linearised is not None
    nothing = [np.zeros((*residuals.shape, 1)) for residuals in estimate.linearised.residuals]
    known = np.array([each.u for each in projections(estimate.linearised, estimate.linearised.components, *nothing)])
    linear = estimate.instrument.linear_count if estimate.instrument is not None else 0
    np.testing.assert_allclose(known[:, :linear], np.broadcast_to(estimate.u[:linear], (2, linear)), rtol=0.05)


def test_a_cause_is_named_in_the_session_it_is_in() -> None:
    """Biases of the gyros that jump by 50 °/h in one of two sessions."""
    observations = together(device("mems", SHORT, seed=5), [ramp(t, t) for t in (0.0, 40.0)])
    estimate = joint(observations, quick=True)
    assert estimate.linearised is not None
    rows, (_, part) = estimate.linearised, estimate.linearised.problem.session_spans
    (N, _), (K, _), last = *(residuals.shape for residuals in rows.residuals), part.rests.start + 6
    at_rest = 50.0 * DEGREE_PER_HOUR * np.outer((np.arange(N) > last) & (np.arange(N) < part.rests.stop), np.ones(3))
    turns = np.arange(K)[:, None]
    first = part.turns.start + 6
    in_turn = 50.0 * DEGREE_PER_HOUR * np.where(turns > first, 1.0, 0.5 * (turns == first)) * np.ones((K, 3))
    rest, turn = LinearisedSession(estimate.linearised).bias_columns("gyro", at_rest, in_turn[:, None])
    residuals = (r + columns.sum(axis=2) for r, columns in zip(rows.residuals, (rest, turn), strict=True))
    jumping = with_residuals(rows, *residuals)
    found = misfit(replace(estimate, linearised=jumping))
    (said,) = [each.sentence for each in found if "jump" in each.sentence]
    assert "session-2: " in said
    assert "after rest 7 " in said


def test_each_session_with_what_the_others_say_knows_what_all_know_and_a_warm_up_in_one_is_said() -> None:
    """Parameters are as well known from one session as from all; a warm-up by 3 mg in one of two is said of the
    accelerometers and moves no parameter of the linear model by more than 3 u."""
    observations = together(device("mems", SHORT, seed=5), [ramp(t, t) for t in (0.0, 40.0)])
    before = joint(observations, intervals=False).values
    rests, warm = observations.rests, observations.session == 1
    settling = np.where(warm, np.exp(-(rests.start - rests.start[warm].min()) / 150.0), 0.0)
    estimate = joint(replace(observations, rests=replace(rests, accel=rests.accel + 0.03 * settling[:, None])))
    linearised = estimate.linearised
    assert linearised is not None
    assert estimate.instrument is not None
    linear = estimate.instrument.linear_count
    nothing = [np.zeros((*residuals.shape, 1)) for residuals in linearised.residuals]
    known = np.array([each.u[:linear] for each in projections(linearised, linearised.components, *nothing)])
    whole = np.sqrt(solve(linearised, linearised.components).covariance.diagonal())[1 : 1 + linear]
    np.testing.assert_allclose(known, np.broadcast_to(whole, (2, linear)), rtol=0.05)
    found = misfit(estimate)
    assert any("accel" in "".join(each.concerns) for each in found if not each.refuses), found
    assert np.all(np.abs(estimate.values - before)[:linear] < 3.0 * estimate.u[:linear])


def test_a_ramp_that_turns_back_within_a_turn_is_followed() -> None:
    """The peak of the temperature lies in a turn, steep enough that the rests beside it do not tell how warm it was."""
    setup = Setup.of(grade="navigation", programme="cube-14", rest=60.0, rate_deg_s=5.0)
    scenario = device("navigation", setup, seed=3)
    steep = ramp(-20.0, 60.0, -20.0)
    last = simulate_observations(replace(scenario, climate=steep), np.random.default_rng(1)).rests.stop[-1]
    steep = replace(steep, time=np.linspace(0.0, last, 3))
    observations = simulate_observations(replace(scenario, climate=steep), np.random.default_rng(1))
    turns = observations.turns
    assert turns is not None
    within = [each[:, 0] for each in variables_of(observations)["temperature"]]
    k = int(np.argmax(within[1]))
    ends = within[0][turns.first[k]], within[0][turns.last[k]]
    assert within[1][k] > max(ends) + 1.0
    times = observations.rests.stop[turns.first], observations.rests.start[turns.last]
    block, rests = observations.accel_block, observations.rests
    offset = np.mean(steep.means(rests.start, rests.stop, block)["temperature"]) - within[0].mean()
    np.testing.assert_allclose(within[1] + offset, steep.means(*times, block)["temperature"][:, 0], atol=0.02)


# -------------------- from logs --------------------


def logged(scenario: Scenario, setup: Setup, celsius: float, seed: int) -> Session:
    """A log of the device at a constant temperature."""
    truth = {name: value for name, value in scenario.truth.items() if name.rpartition(".")[2] not in ("t1", "t2")}
    warmer = celsius + ZERO_CELSIUS - REFERENCE
    for name, value in scenario.truth.items():
        base, _, ending = name.rpartition(".")
        if ending in ("t1", "t2"):
            truth[base] += value * warmer ** int(ending[1])
    recording = record(replace(scenario, truth=truth), np.random.default_rng(seed))
    return in_memory(recording.time, recording.accel, recording.gyro, np.full(len(recording.time), celsius), setup)


def in_memory(time: Array, accel: Array, gyro: Array, celsius: Array, setup: Setup) -> Session:
    columns = {"t": time, "T": celsius}
    columns |= {f"a{x}": column for x, column in zip("xyz", accel.T, strict=True)}
    columns |= {f"g{x}": column for x, column in zip("xyz", gyro.T, strict=True)}
    return session_of(described(setup), columns)


def described(setup: Setup) -> dict[str, Any]:
    return {
        "format": 1,
        "device": {"serial": "A-1", "grade": "mems"},
        "site": {"latitude_deg": np.rad2deg(setup.latitude), "gravity": setup.gravity, "gravity_u": 1e-6},
        "log": {
            "time": "t",
            "accel": {"columns": ["ax", "ay", "az"], "unit": "m/s^2"},
            "gyro": {"columns": ["gx", "gy", "gz"], "unit": "rad/s"},
            "temperature": {"columns": ["T"], "unit": "degC"},
        },
    }


CUBE = Setup.of(grade="mems", programme="cube-14", rest=5.0, rate_deg_s=60.0, sample_rate=50.0, gravity_u=0.0)


def quiet(
    scenario: Scenario, setup: Setup, seed: int, course: tuple[float, ...] = (0.0, 40.0), seconds: int = 600
) -> Session:
    """A device that lies in one position while it takes this course of temperatures, °C, in ten minutes."""
    rng, count = np.random.default_rng(seed), seconds * 50
    celsius = np.interp(np.linspace(0.0, len(course) - 1.0, count), np.arange(len(course)), course)
    warmer = celsius + ZERO_CELSIUS - REFERENCE
    true = {"accel": np.array([0.0, 0.0, setup.gravity]), "gyro": np.zeros(3)}
    made = {}
    for block in (scenario.accel, scenario.gyro):
        kind, truth = block.kind, scenario.truth
        bias = np.array([[truth[f"{kind}.bias.{x}{e}"] for x in "xyz"] for e in ("", ".t1", ".t2")])
        scale = np.array([[truth[f"{kind}.scale.{x}{e}"] for x in "xyz"] for e in ("", ".t1", ".t2")])
        powers = np.stack([np.ones(count), warmer, warmer**2], axis=1)
        white = (setup.noise.accel_white if kind == "accel" else setup.noise.gyro_white) * np.sqrt(50.0)
        made[kind] = powers @ bias + (1.0 + powers @ scale) * true[kind] + white * rng.standard_normal((count, 3))
    return in_memory(np.arange(1, count + 1) / 50.0, made["accel"], made["gyro"], celsius, setup)


@pytest.fixture(scope="module")
def made() -> tuple[Scenario, list[Session], Calibration]:
    scenario = device("mems", CUBE, seed=11)
    sessions = [logged(scenario, CUBE, celsius, seed) for seed, celsius in enumerate((0.0, 20.0, 40.0))]
    sessions.append(quiet(scenario, CUBE, 4))
    return scenario, sessions, calibrate_together(sessions)


def test_levels_and_a_quiet_ramp_are_one_calibration(made: tuple[Scenario, list[Session], Calibration]) -> None:
    scenario, _, found = made
    assert found.outcome.accepted, found.outcome.reasons
    assert found.reference_temperature is not None
    warmer = found.reference_temperature + ZERO_CELSIUS - REFERENCE
    for name, value in scenario.truth.items():
        if name.endswith(".t2"):
            slope = scenario.truth[f"{name[:-3]}.t1"] + 2.0 * value * warmer
            for parameter, true in ((found[name], value), (found[f"{name[:-3]}.t1"], slope)):
                assert parameter.u is not None
                assert abs(parameter.value - true) < 6.0 * parameter.u, parameter.name
    assert found["gyro.bias.x.t1"].learned == pytest.approx(1.0, abs=0.01)


def test_a_session_may_be_one_rest() -> None:
    scenario = device("mems", CUBE, seed=11)
    levels = [logged(scenario, CUBE, celsius, seed) for seed, celsius in enumerate((0.0, 40.0))]
    found = calibrate_together([*levels, quiet(scenario, CUBE, 4, (20.0, 20.0), seconds=20)])
    assert found.evidence.together[2].rests == 1
    assert found.outcome.accepted, found.outcome.reasons


def test_the_sessions_are_in_the_file(made: tuple[Scenario, list[Session], Calibration], tmp_path: Path) -> None:
    _, sessions, found = made
    assert [member.turns > 0 for member in found.evidence.together] == [True, True, True, False]
    assert len({member.log_sha256 for member in found.evidence.together}) == len(sessions)
    assert found.evidence.together[3].rests > 20
    assert found.evidence.together[3].temperatures == pytest.approx((0.0, 40.0), abs=1.5)
    assert {p.name for p in found.evidence.together[0].parameters} >= {"accel.bias.x.launch", "gyro.bias.z.launch"}
    assert any("nothing is turned" in note for note in found.provenance.notes)
    assert not any(name.endswith((".launch", ".drift")) for name in (p.name for p in found.parameters))
    found.write(tmp_path / "calibration.json")
    assert json.loads((tmp_path / "calibration.json").read_text())["temperature"]["range"] == pytest.approx(
        [0, 40], abs=1
    )
    assert read_calibration(tmp_path / "calibration.json").evidence.together == found.evidence.together


@pytest.mark.weekly
def test_a_quiet_ramp_adds_to_biases(made: tuple[Scenario, list[Session], Calibration]) -> None:
    """Up and down; up alone what bends may be hysteresis, and slopes are better known, curvatures hardly."""
    scenario, sessions, up = made
    without = calibrate_together(sessions[:3])
    assert not any("nothing is turned" in note for note in without.provenance.notes)
    both_ways = calibrate_together([*sessions[:3], quiet(scenario, CUBE, 4, (0.0, 40.0, 0.0))])
    for name, found in (("gyro.bias.x.t2", both_ways), ("gyro.bias.z.t1", both_ways), ("gyro.bias.z.t1", up)):
        assert (found[name].u or 0.0) < 0.5 * (without[name].u or 0.0)
    assert (both_ways["gyro.bias.x.t2"].u or 0.0) < 0.8 * (up["gyro.bias.x.t2"].u or 0.0)


def test_a_ramp_one_way_is_not_taken_for_a_lag_nor_hysteresis_for_a_bias() -> None:
    """A fast ramp without a lag, of which Gauss–Newton ended 11.7 u off at a lag of −100 s; and hysteresis, which goes
    with a bias and its curvature there, is in their u."""
    scenario = device("mems", Setup.of(grade="mems", positions=20, terms="full"), 10)
    scenario = replace(scenario, climate=replace(ramp(15.0, 35.0), time=np.array([0.0, 200.0])))
    seen = simulate_observations(scenario, np.random.default_rng([7, 10]))
    kelvin, found = seen.rests.temperature, joint(seen)
    assert kelvin is not None
    warmer = float(kelvin.mean()) - REFERENCE
    change = {name: sum(scenario.truth.get(f"{name}.t{d}", 0.0) * warmer**d for d in (1, 2)) for name in found.names}
    true = np.array([scenario.truth[name] + change[name] for name in found.names[:21]])
    assert np.abs((found.values[:21] - true) / found.u[:21]).max() < 5.0
    usual = usual_sizes("mems")["accel.bias.hysteresis"]
    assert 0.5 * usual < found.u[found.names.index("accel.bias.x")] < 1.5 * usual


@pytest.mark.parametrize(("low", "lag"), [(24.0, 60.0), (29.0, 30.0), (31.5, 200.0)])
def test_a_lag_is_in_u_however_little_it_warms(low: float, lag: float) -> None:
    """A MEMS unit by hand that warms by 8, 3 and 0.5 K in three minutes: without a lag its biases were 30 u off."""
    setup = Setup.of(grade="mems", positions=16, rest=5.0, sample_rate=50.0)
    scenario = device("mems", setup, 5)
    kelvin = np.array([low, 32.0]) + ZERO_CELSIUS
    climate = Climate(
        time=np.array([0.0, 180.0]), kelvin=kelvin[:, None], reference=REFERENCE, lags={"accel": lag, "gyro": lag}
    )
    observations = simulate_observations(replace(scenario, climate=climate), np.random.default_rng(1))
    estimate = joint(replace(observations, usual=usual_sizes("mems")))
    assert observations.rests.temperature is not None
    truth = truth_at({**scenario.truth, REFERENCE_NAME: REFERENCE}, float(observations.rests.temperature.mean()), None)
    off = [(estimate.values[i] - truth[name]) / estimate.u[i] for i, name in enumerate(estimate.names[:21])]
    assert np.abs(off).max() < 5.0
    assert {"accel.lag", "gyro.lag"} < set(estimate.names)
    assert "accel.bias.hysteresis" not in {group.name for group in estimate.groups}


def test_what_cannot_be_one_estimate_is_refused(made: tuple[Scenario, list[Session], Calibration]) -> None:
    _, (first, second, *_), _ = made
    with pytest.raises(InputError, match="expected two or more"):
        calibrate_together([first])
    with pytest.raises(InputError, match="holds the same recording as"):
        calibrate_together([first, first])
    other = replace(second, device=replace(second.device, serial="B-2"))
    with pytest.raises(InputError, match="expected the device 'A-1' of the first session, found 'B-2'"):
        calibrate_together([first, other])
    cold = replace(second, log=replace(second.log, temperature=None))
    with pytest.raises(InputError, match=r"expected temperatures in every session, found no \[log.temperature\]"):
        calibrate_together([first, cold])
    elsewhere = replace(second, site=replace(second.site, gravity=second.site.gravity + 1e-3))
    with pytest.raises(InputError, match="expected the place of the first session"):
        calibrate_together([first, elsewhere])
    with pytest.raises(InputError, match="frame: expected accelerometer, paper or symmetric"):
        calibrate_together([first, second], frame="case")


def test_the_command_writes_the_calibration(made: tuple[Scenario, list[Session], Calibration], tmp_path: Path) -> None:
    for name, session in zip(("cold", "hot"), made[1][::2], strict=True):
        (tmp_path / name).mkdir()
        whole = list(open_log(session).chunks())
        columns = {"t": np.concatenate([chunk.time for chunk in whole])}
        for stem in ("accel", "gyro"):
            readings = np.concatenate([getattr(chunk, stem) for chunk in whole])
            columns |= {f"{stem[0]}{x}": column for x, column in zip("xyz", readings.T, strict=True)}
        kelvin = np.concatenate([chunk.temperature for chunk in whole if chunk.temperature is not None])
        pl.DataFrame(columns | {"T": kelvin[:, 0] - ZERO_CELSIUS}).write_parquet(tmp_path / name / "log.parquet")
        content = described(CUBE)
        write_session(tmp_path / name, content | {"log": {"file": "log.parquet"} | content["log"]})
    folders, out = [str(tmp_path / "cold"), str(tmp_path / "hot")], tmp_path / "out.json"
    done = CliRunner().invoke(main, ["calibrate", "--together", "--all", *folders, "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert re.search(r"^cold +14 +13 +0\.0 +0\.0$", done.output, re.M), done.output
    assert [member.session for member in read_calibration(out).evidence.together] == ["cold", "hot"]
    assert "two temperatures show slopes and no curvature; take a third between them" in " ".join(done.output.split())
    refused = CliRunner().invoke(main, ["calibrate", "--together", *folders, "--method", "scalar", "--out", str(out)])
    assert refused.exit_code == 2
    assert "--together: expected the method 'joint'" in refused.output
