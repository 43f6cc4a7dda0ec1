"""Trends: run to run, drift and changes are what an independent calculation gives, and uncertainties hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tumble.lab.registry.records import State
from tumble.lab.registry.trend import YEAR, ParameterTrend, Point, parameter_trend
from tumble.units import Array

START = datetime(2020, 1, 1, tzinfo=UTC)


def point(
    years: float, value: float, u: float | None = 1.0, state: State = "unchanged", launches: Sequence[float] = ()
) -> Point:
    return Point(
        number=round(1000 * years),
        performed=START + years * YEAR,
        state=state,
        value=value,
        u=u,
        launches=tuple((x, 1.0) for x in launches),
    )


def trend(*points: Point) -> ParameterTrend:
    return parameter_trend("accel.bias.x", "m/s^2", points)


# -------------------- drift --------------------


def test_what_only_priors_say_of_a_device_hides_no_drift() -> None:
    """A bias known to 10, of which 0.1 of its own: it drifts by 1 a year."""
    points = [replace(point(t, t, u=float(np.hypot(10.0, 0.1))), shared={"prior": 10.0}) for t in range(4)]
    found, without = trend(*points), trend(*(replace(p, shared={}) for p in points))
    assert found.drift is not None
    assert without.drift is not None
    assert found.drift.u == pytest.approx(0.1 / np.sqrt(5.0))
    assert without.drift.u == pytest.approx(np.hypot(10.0, 0.1) / np.sqrt(5.0))


def test_a_parameter_of_which_no_more_than_its_prior_is_known_has_no_drift() -> None:
    points = [replace(point(t, 0.0, u=10.0), shared={"prior": 10.0}) for t in range(4)]
    found = trend(*points)
    assert (found.drift, found.instability) == (None, None)


def test_the_drift_of_a_scattered_series_is_that_of_ordinary_regression() -> None:
    """Equal u far below the scatter: weights are equal, and the scatter is that of the residuals."""
    t = np.array([0.0, 1.1, 2.0, 2.9, 4.2, 5.0])
    y = np.array([3.0, 9.0, -2.0, 7.0, 12.0, 8.0])
    found = trend(*(point(a, b, u=1e-6) for a, b in zip(t, y, strict=True)))
    expected = stats.linregress(t, y)
    assert found.drift is not None
    assert found.drift.expanded is not None
    assert found.drift.per_year == pytest.approx(expected.slope, rel=1e-6)
    assert found.drift.u == pytest.approx(expected.stderr, rel=2e-3)  # τ is solved to 1e-3
    assert found.drift.degrees == 4
    assert found.drift.expanded == pytest.approx(stats.t.ppf(stats.norm.cdf(2.0), 4) * found.drift.u)
    residual = y - expected.intercept - expected.slope * t
    assert found.instability == pytest.approx(np.sqrt(residual @ residual / 4), rel=2e-3)


def test_a_series_without_excess_scatter_has_the_uncertainty_of_the_measurements() -> None:
    """On a line exactly: the weighted formula u(b)² = 1/Σ w (t − t̄)² with its own u in every point."""
    t, u = np.array([0.0, 1.0, 3.0, 4.0]), np.array([1.0, 2.0, 1.0, 4.0])
    found = trend(*(point(a, 2.0 + 0.5 * a, u=b) for a, b in zip(t, u, strict=True)))
    w = u**-2.0
    mean = (w @ t) / w.sum()
    assert found.instability == 0.0
    assert found.drift is not None
    assert found.drift.per_year == pytest.approx(0.5)
    assert found.drift.u == pytest.approx((w @ (t - mean) ** 2) ** -0.5)


@given(st.floats(-3, 3), st.floats(-50, 50), st.integers(1, 4))
def test_an_adjustment_is_no_drift(slope: float, jump: float, after: int) -> None:
    points = []
    for i in range(6):
        if i == after:
            points.append(point(i, slope * i, state="as-found"))
            points.append(point(i + 0.001, slope * (i + 0.001) + jump, state="as-left"))
        else:
            points.append(point(i, slope * i + (jump if i > after else 0.0)))
    found = trend(*points)
    assert found.drift is not None
    assert found.drift.per_year == pytest.approx(slope, abs=1e-9)


def test_two_calibrations_give_a_drift_but_nothing_shows_the_instability() -> None:
    found = trend(point(0, 1.0), point(2, 3.0))
    assert found.instability is None
    assert found.drift is not None
    assert found.drift.per_year == pytest.approx(1.0)
    assert found.drift.expanded is None
    assert found.drift.u == pytest.approx(np.sqrt(2.0) / 2.0)


@pytest.mark.parametrize(
    "points",
    [
        [point(0, 1.0)],
        [point(0, 1.0), point(0, 2.0)],  # at one time
        [point(0, 1.0, state="as-found"), point(1, 2.0, state="as-left")],  # with an adjustment in between
        [point(0, 1.0, u=None), point(1, 2.0)],
        [point(0, 1.0, u=0.0), point(1, 2.0)],
    ],
)
def test_there_is_no_drift_where_nothing_shows_one(points: list[Point]) -> None:
    assert trend(*points).drift is None


def test_run_to_run_is_the_pooled_standard_deviation_of_launches() -> None:
    """As the error mean square of a one-way analysis of variance."""
    groups = [[1.0, 4.0, 2.5], [8.0, 9.0], [3.0, 3.5, 5.0, 1.0]]
    found = trend(*(point(i, float(np.mean(g)), launches=g) for i, g in enumerate(groups)))
    pooled = sum((len(g) - 1) * np.var(g, ddof=1) for g in groups) / 6
    f, _ = stats.f_oneway(*groups)
    means, counts = np.array([np.mean(g) for g in groups]), np.array([len(g) for g in groups])
    between = float(counts @ (means - np.concatenate(groups).mean()) ** 2) / 2
    assert found.run_to_run is not None
    assert found.run_to_run == pytest.approx(np.sqrt(pooled))
    assert found.run_to_run**2 == pytest.approx(between / f)
    assert found.run_to_run_degrees == 6


def simulated(rng: np.random.Generator, count: int, launches: int, tau: float) -> ParameterTrend:
    """Calibrations every half year of a device that drifts by 3 a year and is unstable by τ from run to run; u = 1."""
    points = []
    for i in range(count):
        runs: Array = 1.5 * i + rng.normal(0.0, tau, launches) + rng.normal(0.0, 1.0, launches)
        if launches == 1:
            points.append(point(0.5 * i, float(runs[0])))
        else:  # as `tumble.run.launches` states the u of a mean
            u = float(np.sqrt(max(1.0, runs.var(ddof=1)) / launches))
            points.append(point(0.5 * i, float(runs.mean()), u=u, launches=runs.tolist()))
    return trend(*points)


@pytest.mark.parametrize(("count", "launches", "tau"), [(5, 1, 4.0), (6, 1, 0.0), (4, 3, 3.0), (8, 2, 1.0)])
def test_the_true_drift_is_within_u_as_often_as_stated(count: int, launches: int, tau: float) -> None:
    """N = 400. At least 95.45 % less five standard deviations of the count (1.04 %): at 90.2 %."""
    rng = np.random.default_rng(11)
    hits = 0
    for _ in range(400):
        drift = simulated(rng, count, launches, tau).drift
        assert drift is not None
        assert drift.expanded is not None
        hits += abs(drift.per_year - 3.0) <= drift.expanded
    assert hits / 400 > 0.9545 - 5.0 * 0.0104
