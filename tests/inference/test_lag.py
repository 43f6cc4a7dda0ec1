"""Lags behind the thermometer: their probability, what they leave in u, and that nothing seen costs little."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from tumble.inference.hyperparameters import solution_at
from tumble.inference.integral import is_poorly_sampled
from tumble.inference.joint import joint
from tumble.inference.lag import (
    LAGS,
    added_covariance,
    log_odds_of_change,
    maximum_with_lags,
    prior_density,
    resolved,
    widths,
    without,
)
from tumble.inference.linearisation import linearise
from tumble.inference.maximum import MAX_ITERATIONS, maximise, maximise_phi
from tumble.inference.problem import Problem, instruments_of
from tumble.inference.start import initial_linearisation
from tumble.planning.setup import Setup
from tumble.reduction.observations import Observations
from tumble.run.from_estimate import temperature_notes
from tumble.sensors.grades import GRADES
from tumble.sensors.parameters import group_name, usual_sizes
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import Scenario, itinerary, scenario_of
from tumble.simulation.temperature_profile import (
    REFERENCE,
    REFERENCE_NAME,
    draw_thermal,
    temperature_profile,
    truth_at,
)
from tumble.units import Array


@pytest.mark.parametrize(("centre", "spread"), [(900.0, 190.0), (70.0, 15.0), (17.0, 2.0), (41.0, 0.6)])
def test_mean_and_spread_of_a_lag_are_those_of_its_likelihood(centre: float, spread: float) -> None:
    """The likelihood of a ramp, be it much narrower than the grid and away from it; the parameters move with the
    lag."""

    def at_lags(lags: Array) -> tuple[Array, Array]:
        return ((lags - centre) / spread) ** 2, np.column_stack([np.zeros_like(lags), 2.0 * lags])

    lags, weight, moved = resolved(at_lags, LAGS)
    mean = float(weight @ lags)
    assert mean == pytest.approx(centre, abs=0.03 * spread)
    assert np.sqrt(weight @ (lags - mean) ** 2) == pytest.approx(spread, rel=0.03)
    assert np.sqrt(weight @ (moved[:, 1] - 2.0 * mean) ** 2) == pytest.approx(2.0 * spread, rel=0.03)
    assert len(lags) < 60


def test_lags_of_both_kinds_have_one_rate_that_is_not_known() -> None:
    """p(x, x′) = ∫ r² e^(−r (x + x′)) p(r) dr, of a gamma distribution of r. The lag of the other kind tells nothing if
    that kind does not change, or if its data say nothing."""
    x, r = np.array([0.0, 0.7, 5.0]), np.linspace(1e-4, 60.0, 60_001)
    of_rate = stats.gamma(3.0).pdf(r) * np.gradient(r)
    known = 4.0
    joint_density = (r**2 * np.exp(-r * (x[:, None] + known))) @ of_rate
    alone = (r * np.exp(-r * x[:, None])) @ of_rate
    np.testing.assert_allclose(prior_density(x), alone, rtol=1e-4)
    given = joint_density / float(prior_density(np.array([known]))[0])
    np.testing.assert_allclose(prior_density(x, (np.array([known]), np.ones(1), 1.0)), given, rtol=1e-3)
    np.testing.assert_allclose(prior_density(x, (np.array([known]), np.ones(1), 0.0)), alone, rtol=1e-4)
    other = np.linspace(0.0, 300.0, 300_001)
    weight = prior_density(other) * widths(other)
    np.testing.assert_allclose(prior_density(x, (other, weight, 1.0)), alone, rtol=1e-3)


def test_odds_of_a_change_are_those_of_the_densities_of_the_data() -> None:
    """Two coefficients c ~ N(0, s²), each seen once with a noise σ: ln N(y; 0, s² + σ²) − ln N(y; 0, σ²)."""
    size, noise, seen = np.array([3.0, 0.2]), np.array([0.5, 0.4]), np.array([1.3, -0.7])
    variance = 1.0 / (size**-2 + noise**-2)
    found = np.column_stack([np.diag(variance), variance * seen / noise**2])
    wide, narrow = stats.norm(0.0, np.hypot(size, noise)), stats.norm(0.0, noise)
    assert log_odds_of_change(found, size) == pytest.approx(float(np.sum(wide.logpdf(seen) - narrow.logpdf(seen))))


def test_u_of_a_mixture_is_half_its_half_width() -> None:
    """Another solution of probability 0.02, 100 u off, is beyond the 95.45 %; one of 0.5 is not, and makes u what the
    quantiles of the mixture say where they say less than its standard deviation. It is never less than without."""
    held = np.array([[1.0, 0.0]])

    def mixed(*others: tuple[float, float, float]) -> float:
        variances, values, weights = np.array(others).T
        every = np.stack([variances, values], axis=1)[:, None]
        return float(np.sqrt(1.0 + added_covariance(every, held, weights)[0, 0]))

    assert mixed((1.0, 0.0, 0.98), (1.0, 100.0, 0.02)) < 1.2
    assert mixed((1.0, 0.0, 0.5), (1.0, 100.0, 0.5)) == pytest.approx(0.5 * (100.0 + stats.norm.isf(0.091)), rel=1e-3)
    assert mixed((1.0, 0.0, 0.3), (1.0, 0.0, 0.7)) == pytest.approx(1.0)
    assert mixed((4.0, 0.0, 1.0)) == pytest.approx(2.0)
    assert mixed((0.25, 0.0, 1.0)) == pytest.approx(1.0)


def test_a_solution_without_coefficients_is_that_of_the_others_alone() -> None:
    """Of a line through points, without its slope."""
    design, seen = np.column_stack([np.ones(5), np.arange(5.0)]), np.array([0.3, 1.0, 0.2, 1.4, 0.9])
    covariance = np.linalg.inv(design.T @ design)
    found = without(np.column_stack([covariance, covariance @ design.T @ seen]), [1])
    np.testing.assert_allclose(found, [[0.2, 0.0, seen.mean()], [0.0, 0.0, 0.0]], atol=1e-12)


def warming(seed: int, text: str, lags: dict[str, float], slopes: float) -> tuple[Scenario, Observations]:
    """A MEMS unit by hand that warms up, whose slopes are so many times those of its draw."""
    rng = np.random.default_rng([31, seed])
    scenario = scenario_of(Setup.of(grade="mems", positions=20, rest=5.0), rng)
    drawn = draw_thermal({}, "mems", {"accel": scenario.accel, "gyro": scenario.gyro}, rng)
    truth = dict(scenario.truth) | {name: slopes * value for name, value in drawn.items()}
    duration = float(itinerary(scenario, rng.spawn(1)[0]).rests[-1, 1])
    climate = temperature_profile(text).climate(1.05 * duration, lags)
    made = replace(scenario.changed(further=usual_sizes("mems")), truth=truth, climate=climate)
    noise = GRADES["mems"].noise
    observations = simulate_observations(made, rng)
    return made, replace(
        observations,
        too_small=dict.fromkeys(observations.usual, 10.0),
        in_run={"accel": noise.accel_instability, "gyro": noise.gyro_instability},
    )


def off(scenario: Scenario, observations: Observations) -> Array:
    """Errors of the linear parameters at the reference temperature, in units of u."""
    estimate = joint(observations)
    assert observations.rests.temperature is not None
    truth = truth_at(
        {**scenario.truth, REFERENCE_NAME: REFERENCE}, float(observations.rests.temperature.mean()) - 273.15
    )
    return np.array([(estimate.values[i] - truth[n]) / estimate.u[i] for i, n in enumerate(estimate.names[:21])])


@pytest.mark.parametrize(
    ("text", "accel", "gyro"), [("25+10@300", 20.0, 150.0), ("25+12@150", 250.0, 20.0), ("25+5@200", 60.0, 280.0)]
)
def test_accelerometers_and_gyros_lag_apart(text: str, accel: float, gyro: float) -> None:
    """With one lag for both, biases of the gyros were up to 21 u off."""
    z = off(*warming(0, text, {"accel": accel, "gyro": gyro}, 1.0))
    assert np.abs(z).max() < 4.0
    assert np.sqrt(np.mean(z**2)) < 1.3


def test_a_thermometer_that_tells_nothing_costs_little_and_is_said() -> None:
    """3 K of warm-up, and nothing that depends on it: u of biases was 4 to 13 times that without a thermometer."""
    ratios: dict[str, list[float]] = {}
    for seed in range(3):
        _, observations = warming(seed, "25+3@200", {}, 0.0)
        plain = replace(observations, rests=replace(observations.rests, temperatures=None), thermometers=None)
        estimate, alone = joint(observations), joint(plain)
        for i, name in enumerate(estimate.names[:21]):
            ratios.setdefault(group_name(name), []).append(float(estimate.u[i] / alone.u[i]))
        said = list(temperature_notes(estimate, observations))
        assert any("no change of the gyros with temp" in each or "lag of the gyros behind" in each for each in said)
    medians = {name: float(np.median(each)) for name, each in ratios.items()}
    assert max(medians.values()) < 1.3
    assert max(medians["accel.bias"], medians["gyro.bias"]) < 1.2


@pytest.mark.parametrize("seed", [0, 1])
def test_a_temperature_that_stays_the_same_leaves_sizes_of_its_groups_as_usual(seed: int) -> None:
    """Their sizes, on which nothing depends, were integrated over the prior: 1,792 points, which did not suffice."""
    _, observations = warming(seed, "25", {}, 0.0)
    integral = joint(observations).integral
    assert integral is not None
    assert integral.points < 100
    assert not is_poorly_sampled(integral)


def test_a_lag_is_judged_with_the_sizes_that_are_likeliest_with_it() -> None:
    """Where the in-run biases are as large as another lag makes them, a lag that is far from it seems too unlikely."""
    _, observations = warming(0, "25+10@300", {"accel": 20.0, "gyro": 100.0}, 3.0)
    instrument, _ = instruments_of(observations)
    problem = Problem.of(observations, instrument=instrument, usual=observations.usual)
    fitted, _ = maximum_with_lags(initial_linearisation(problem), MAX_ITERATIONS)
    values = fitted.point.values.copy()
    values[problem.lag_places["gyro"]] += 200.0
    held = fitted.linearisation.problem.with_held_lags(values)
    there = linearise(held, replace(fitted.point, values=values), fitted.linearisation.integrated)
    best = maximise(there, fitted.phi).solution.log_posterior
    plain = solution_at(there, fitted.hyperparameters, fitted.phi)
    near, *_ = maximise_phi(fitted.hyperparameters, plain)
    assert plain.log_posterior < best - 5.0
    assert best - near.log_posterior < 0.1 * (best - plain.log_posterior)


def test_rows_at_another_lag_are_those_linearised_there() -> None:
    """Whatever goes with temperature, in rests and in turns that warm: ℓ, and the step in units of u."""
    _, observations = warming(1, "25+10@300", {"accel": 20.0, "gyro": 40.0}, 1.0)
    instrument, _ = instruments_of(observations)
    problem = Problem.of(observations, instrument=instrument, usual=observations.usual)
    fitted, _ = maximum_with_lags(initial_linearisation(problem), MAX_ITERATIONS)
    values = fitted.point.values.copy()
    values[list(problem.lag_places.values())] += [15.0, 60.0]
    held, integrated = problem.with_held_lags(values), fitted.linearisation.integrated
    near = fitted.linearisation.with_lags(held, values)
    whole = linearise(held, replace(fitted.linearisation.point, values=near.point.values), integrated)
    found, expected = (solution_at(each, fitted.hyperparameters, fitted.phi) for each in (near, whole))
    assert float(found.log_posterior) == pytest.approx(float(expected.log_posterior), abs=0.02)
    u = np.sqrt(expected.covariance.diagonal()[1:])
    np.testing.assert_allclose((found.parameters - expected.parameters)[1:] / u, 0.0, atol=0.01)
