"""What the methods of the linear model say of instruments that are not linear: nothing wrong is accepted in silence."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.staged import estimate_accelerometers
from tumble.diagnosis.linear_model import converged_joint, linear_joint, omitted_by_rests, rms_components
from tumble.inference.estimate import Estimate
from tumble.inference.integrated_turns import IntegratedTurns
from tumble.inference.joint import joint
from tumble.inference.linearisation import Linearisation, linearise
from tumble.inference.normal_equations import session_mean_bias, solve
from tumble.inference.problem import Problem
from tumble.methods.ellipsoid import ellipsoid
from tumble.methods.paper.four_stages import scalar, sequential
from tumble.planning.setup import Setup
from tumble.recording.session_file import read_session
from tumble.reduction.observations import Observations
from tumble.rotation import unit_vector
from tumble.run.calibrate import calibrate
from tumble.sensors.parameters import beyond_linear, usual_sizes
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import scenario_of
from tumble.simulation.session import simulate_session
from tumble.units import G_STANDARD, Array

SIZES = {
    "accel.quadratic": 1e-5 / G_STANDARD,
    "accel.cubic": 1e-5 / G_STANDARD**2,
    "accel.asymmetry": 1e-5,
}
FUNCTIONS: Mapping[str, Callable[[Array], Array]] = {
    "accel.quadratic": lambda f: f**2,
    "accel.cubic": lambda f: f**3,
    "accel.asymmetry": np.abs,
}


@pytest.fixture(scope="module")
def observed() -> Observations:
    """A navigation unit in fourteen positions, without gyros."""
    rng = np.random.default_rng(3)
    setup = Setup.of(grade="navigation", programme="cube-14")
    return replace(simulate_observations(scenario_of(setup, rng), rng), usual=SIZES).of_accelerometers()


def refitted(observed: Observations, group: str, sensor: int) -> Array:
    """The accelerometer parameters where one sensor has this nonlinearity."""
    force = observed.site.gravity * unit_vector(observed.rests.accel)
    added = np.zeros_like(force)
    added[:, sensor] = SIZES[group] * FUNCTIONS[group](force[:, sensor])
    return estimate_accelerometers(
        replace(observed, rests=replace(observed.rests, accel=observed.rests.accel + added))
    ).values


@pytest.mark.parametrize("group", SIZES)
def test_a_group_left_out_moves_the_fit_by_as_much_as_is_said(observed: Observations, group: str) -> None:
    """Refitting agrees with the linear formula, but for the scatter that it may find."""
    before = estimate_accelerometers(observed).values
    change = np.array([refitted(observed, group, sensor) - before for sensor in range(3)])
    _, moves, _ = omitted_by_rests(replace(observed, usual={group: SIZES[group]}), before)
    said = np.linalg.norm(moves * SIZES[group], axis=1)
    np.testing.assert_allclose(np.linalg.norm(change, axis=0), said, atol=0.05 * said.max(), rtol=0.02)
    np.testing.assert_allclose(ellipsoid(observed).values[:9], before, atol=1e-6)


def with_noise_of(fitted: Linearisation, observations: Observations) -> Array:
    """The parameters of the linear model by the likelihood, with the noise of another fit, from where that is."""
    problem, point = Problem.of(observations, instrument=fitted.problem.instrument, usual={}), fitted.point
    about = IntegratedTurns.of(observations, problem.instrument, point.values)
    solution = solve(replace(linearise(problem, point, about), noise=fitted.noise))
    values = point.values + solution.parameters[1:]
    if solution.equations.wanders:
        means, _ = session_mean_bias(solution.equations)
        values[problem.biases] += means @ np.append(solution.parameters, -1.0)
    return values


METHODS = pytest.mark.parametrize("method", [sequential, scalar, linear_joint])


def on_the_rough_table(**changed: float) -> Setup:
    """A set-up in whose programme the positions come in the order listed."""
    setup = Setup.of(grade="navigation", terms="full", **changed)  # type: ignore[arg-type]
    return replace(setup, programme=replace(setup.programme, ordered=True))


@METHODS
def test_a_group_moves_the_method_as_much_as_is_in_its_u(method: Callable[[Observations], Estimate]) -> None:
    """One parameter of each group, as large as residuals do not show: the derivative by it is −cov/σ². That of `joint`
    is at the noise of its fit: how the noise itself changes with residuals differs from session to session."""
    scenario = scenario_of(on_the_rough_table(gravity_u=1e-6), np.random.default_rng(5))

    def seen(**values: float) -> Observations:
        linear = {name: value for name, value in scenario.truth.items() if not beyond_linear(name)}
        truth = dict.fromkeys(scenario.truth, 0.0) | linear | values
        return simulate_observations(replace(scenario, truth=truth), np.random.default_rng(6))

    before = method(seen())
    fitted = None
    if method is linear_joint:
        beside = converged_joint(seen())
        assert beside is not None
        fitted = joint(replace(seen(), usual={}), components=rms_components(beside)).linearised

    def values(observations: Observations) -> Array:
        return method(observations).values[:21] if fitted is None else with_noise_of(fitted, observations)

    first = values(seen())
    assert np.all(np.abs(first - before.values[:21]) < 0.05 * before.u[:21])
    for name in (
        *("accel.quadratic.x", "accel.cubic.y", "accel.asymmetry.z", "gyro.asymmetry.x", "gyro.g_sensitivity.xz"),
        *("accel.bias.y.drift", "gyro.scale.x.drift"),
    ):
        i, u = before.names.index(name), before.u
        moved = -before.covariance[:21, i] / u[i]
        changed = values(seen(**{name: 1e-3 * u[i]})) - first
        assert np.abs(moved / u[:21]).max() > 0.05, name
        np.testing.assert_allclose(changed / 1e-3 / u[:21], moved / u[:21], atol=0.002, err_msg=name)


@METHODS
def test_u_of_a_linear_method_covers_what_it_does_not_model(method: Callable[[Observations], Estimate]) -> None:
    """Navigation units with all terms of usual size: without them the biases are 20 to 40 u off."""
    errors = []
    for seed in range(8):
        rng = np.random.default_rng([33, seed])
        scenario = scenario_of(on_the_rough_table(), rng)
        found = method(simulate_observations(scenario, rng))
        truth = np.array([scenario.truth[name] for name in found.names[:21]])
        assert not found.values[21:].any()
        assert found.budget is not None
        np.testing.assert_allclose(found.budget.covariances.sum(axis=0), found.covariance, rtol=1e-9, atol=1e-30)
        assert "prior.accel.quadratic" in [source.name for source in found.budget.sources]
        errors.append((found.values[:21] - truth) / found.u[:21])
    assert np.abs(errors).max() < 4.0
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 1.1


def test_the_linear_methods_state_what_they_leave_out(tmp_path: Path) -> None:
    """From a log: parameters whose u contains the groups, and no lost samples where none are."""
    setup = Setup.of(grade="navigation", sample_rate=20.0, terms="full")
    folder = simulate_session(tmp_path / "whole", setup, seed=2)
    truth = json.loads((folder / "truth.json").read_text())
    for method, terms in (("scalar", "full"), ("sequential", "full"), ("joint", "linear"), ("ellipsoid", "full")):
        found = calibrate(folder, method=method, terms=terms)  # type: ignore[arg-type]
        assert found.outcome.accepted, found.outcome
        assert not any("samples" in said for said in found.outcome.remarks)
        assert method != "joint" or not any("does not fit" in said for said in found.outcome.remarks)
        assert all(abs(p.value - truth[p.name]) < 4.0 * (p.u or 0.0) for p in found.parameters)
        assert not any(p.value for p in found.parameters if beyond_linear(p.name))
        assert any("as zero and includes their usual size in u" in note for note in found.provenance.notes)
        assert any(source.name == "prior.accel.quadratic" for source in found.evidence.budget)
        assert all(source.u is not None for source in found.evidence.budget if "scatter" in source.name)


def test_the_ellipsoid_method_has_in_u_what_it_leaves_out() -> None:
    """Navigation units with all terms: the values are those of the method, 43 u off by noise alone, and covered."""
    errors = []
    for seed in range(12):
        rng = np.random.default_rng([31, seed])
        scenario = scenario_of(Setup.of(grade="navigation", terms="full"), rng)
        seen = simulate_observations(scenario, rng)
        linear, full = ellipsoid(replace(seen, usual={})), ellipsoid(replace(seen, usual=usual_sizes("navigation")))
        np.testing.assert_array_equal(full.values[:9], linear.values)
        assert not full.values[9:].any()
        truth = np.array([scenario.truth[name] for name in linear.names])
        errors.append([(estimate.values[:9] - truth) / estimate.u[:9] for estimate in (linear, full)])
    of_noise, of_all = np.abs(np.array(errors)).max(axis=(0, 2))
    assert of_noise > 20.0
    assert of_all < 5.0
    assert 0.6 < np.sqrt(np.mean(np.array(errors)[:, 1] ** 2)) < 1.4


def test_a_linear_instrument_is_accepted_by_all_of_them(tmp_path: Path) -> None:
    """Nothing in a session tells a bias from what is quadratic with faces up and down alone; a data sheet does."""
    setup = Setup.of(grade="navigation", sample_rate=20.0)
    folder = simulate_session(tmp_path / "linear", setup, seed=3)
    for method in ("sequential", "scalar", "ellipsoid"):
        assert calibrate(folder, method=method).outcome.verdict == "accepted"
    session = read_session(folder)
    sheet = {"accel.quadratic": 1e-12, "accel.cubic": 1e-12, "accel.asymmetry": 1e-12}
    stated = replace(session, device=replace(session.device, prior=sheet))
    usual, known = (calibrate(each, method="sequential")["accel.bias.x"].u or 0.0 for each in (session, stated))
    assert usual > 5.0 * known


def test_a_single_bias_is_known_worse_than_the_corrected_force(tmp_path: Path) -> None:
    """What the fit leaves out is in u of a bias with all its size, and partly cancels in the corrected force."""
    setup = Setup.of(grade="navigation", programme="cube-14", sample_rate=10.0, rest=20.0)
    full = calibrate(simulate_session(tmp_path / "own", setup, seed=4), method="ellipsoid")
    u = full["accel.bias.x"].u
    assert u is not None
    assert full.prediction is not None
    assert u > 1.5 * full.prediction.force_u
