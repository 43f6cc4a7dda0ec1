"""What a session will say of its own noise and of the sizes of groups, and what `calibrate` then states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.formula_setup import bound
from tumble.diagnosis.linear_model import linear_joint
from tumble.inference.joint import joint
from tumble.planning.bounds import _expected_scatter, _expected_size, expected_bound
from tumble.planning.setup import Setup
from tumble.recording.session import USUAL_CLOCK_U
from tumble.sensors.parameters import positions_by_group
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import scenario_of


@settings(deadline=None)
@given(st.floats(0.5, 1e3), st.floats(1.01, 10.0))
def test_scatter_is_expected_smaller_the_more_residuals_there_are(degrees: float, more: float) -> None:
    """From the √2 of the prior to nothing, as ν^(−1/4) in the end."""
    assert 0.0 < _expected_scatter(more * degrees) < _expected_scatter(degrees) < np.sqrt(2.0)
    assert _expected_scatter(1e-9) == pytest.approx(np.sqrt(2.0), rel=5e-3)
    assert _expected_scatter(16e3) == pytest.approx(0.5 * _expected_scatter(1e3), rel=0.05)


@settings(deadline=None)
@given(st.floats(1e-3, 0.999), st.floats(2.0, 10.0), st.floats(1e-6, 1e3))
def test_a_group_is_expected_no_smaller_than_usual_and_no_larger_than_its_prior(
    learned: float, too_small: float, usual: float
) -> None:
    """Half of the prior of λ² is 1, the other half e^{2|z|} with z of the standard deviation ln k, cut off at four."""
    within, sizes = np.log(too_small), np.full(3, usual)
    found = _expected_size(sizes, (1.0 - learned) * sizes**2, within)
    p = np.linspace(0.0, 4.0, 4001)
    prior = np.average(np.exp(2.0 * within * p), weights=np.exp(-0.5 * p**2))
    assert np.all(found >= 1.0 - 1e-6)
    assert np.all(found**2 <= (0.5 + 0.5 * prior) * 1.02)
    np.testing.assert_allclose(_expected_size(sizes, sizes**2, within) ** 2, 0.5 + 0.5 * prior, rtol=0.02)


@pytest.mark.parametrize("grade", ["mems", "navigation"])
@pytest.mark.parametrize("terms", ["linear", "full"])
def test_what_is_stated_is_never_below_the_bound(grade: str, terms: str) -> None:
    setup = Setup.of(grade=grade, terms=terms)  # type: ignore[arg-type]
    least, said = bound(setup), expected_bound(setup)
    assert np.all(said.u >= least.u)
    assert expected_bound(setup, gyros=False).rms("accel.scale") > bound(setup, gyros=False).rms("accel.scale")


def test_the_time_base_is_in_the_scale_factors_of_the_gyros_together() -> None:
    """30 ppm where no clock is stated."""
    setup = Setup.of()
    usual, exact = expected_bound(setup), expected_bound(replace(setup, clock_u=0.0))
    of_scale = np.array([name.startswith("gyro.scale") for name in usual.names])
    more = np.outer(of_scale, of_scale) * USUAL_CLOCK_U**2
    u = np.sqrt(np.diag(usual.covariance))
    np.testing.assert_allclose((usual.covariance - exact.covariance - more) / np.outer(u, u), 0.0, atol=1e-9)


@pytest.mark.parametrize(
    "setup",
    [Setup.of(grade="mems", rest=20.0, terms="full"), Setup.of(programme="cube-26", terms="full")],
    ids=["mems on the rough table", "navigation in a cube"],
)
def test_plan_states_what_calibrate_will(setup: Setup) -> None:
    """Sixteen instruments: the rms u of each group of the linear model to 10 %. Positions come in the order of the
    programme, as `stated` takes them."""
    setup = replace(setup, programme=replace(setup.programme, ordered=True), clock_u=0.0)
    variances = []
    for seed in range(16):
        rng = np.random.default_rng(100 + seed)
        estimate = joint(simulate_observations(scenario_of(setup, rng), rng))
        variances.append(np.diag(estimate.covariance))
    said, mean = expected_bound(setup), np.mean(variances, axis=0)
    assert estimate.names[: said.linear] == said.names[: said.linear]
    for group, members in positions_by_group(said.names[: said.linear]).items():
        assert said.rms(group) == pytest.approx(float(np.sqrt(mean[members].mean())), rel=0.1), group


@pytest.mark.parametrize(
    "setup",
    [
        Setup.of(programme="cube-26", terms="full"),
        Setup.of(grade="tactical", terms="full"),
        Setup.of(programme="nine", rest=300.0, terms="full"),
    ],
    ids=["navigation in a cube", "tactical on the rough table", "navigation in nine positions"],
)
def test_plan_states_what_calibrate_will_with_linear_terms(setup: Setup) -> None:
    """The median of six instruments: the u of each group to a quarter, and the errors are of that size. Scatter that
    the groups are themselves would be in u beside them, and make it up to three times as large."""
    setup = replace(setup, programme=replace(setup.programme, ordered=True), clock_u=0.0)
    variances, errors = [], []
    for seed in range(6):
        rng = np.random.default_rng(100 + seed)
        scenario = scenario_of(setup, rng)
        estimate = linear_joint(simulate_observations(scenario, rng))
        variances.append(np.diag(estimate.covariance)[:21])
        truth = np.array([scenario.truth[name] for name in estimate.names[:21]])
        errors.append((estimate.values[:21] - truth) / estimate.u[:21])
    said = expected_bound(setup, terms="linear")
    for group, members in positions_by_group(said.names).items():
        median = np.median([np.sqrt(each[members].mean()) for each in variances])
        assert said.rms(group) == pytest.approx(float(median), rel=0.25), group
    assert 0.8 < np.sqrt(np.mean(np.square(errors))) < 1.15
