"""How unstable devices of a type are from launch to launch, and what that does for two launches of another."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from tumble.result.coverage import degrees_of_mean
from tumble.result.launch_variances import LaunchVariances, pool_with_type, variance_of_type
from tumble.result.parts import coverage_factor

NAME = "accel.bias.x"


def known(degrees: int, variance: float, noise: float, *, serial: str = "A-1") -> LaunchVariances:
    logs = frozenset({f"{serial}-{i}" for i in range(degrees + 1)})
    return LaunchVariances(serial=serial, logs=logs, degrees=degrees, variances={NAME: (variance, noise)})


def test_variances_are_pooled_by_their_degrees_of_freedom() -> None:
    launches = [known(1, 5.0, 1.0), known(3, 9.0, 1.0, serial="A-2")]
    assert variance_of_type(launches, NAME, 1.0) == pytest.approx((8.0, 4.0))
    assert variance_of_type(launches, "accel.bias.y", 1.0) == (0.0, 0.0)


def test_launches_with_other_noise_have_that_of_their_own_beside_the_instability_of_the_type() -> None:
    """s² = 8 with n² = 1 is an instability of 7: launches with n² = 3 scatter by 10, and 10 is known as well as 8."""
    assert variance_of_type([known(4, 8.0, 1.0)], NAME, 3.0) == pytest.approx((10.0, 4.0 * (10.0 / 8.0) ** 2))
    assert variance_of_type([known(4, 0.5, 1.0)], NAME, 3.0)[0] == pytest.approx(3.0)


def test_a_device_that_is_less_stable_than_its_type_is_judged_by_itself() -> None:
    """One launch in addition: F(1, 20) is beyond 14.82 in one of 1000 cases."""
    limit = stats.f.isf(1e-3, 1, 20)
    assert pool_with_type(1.01 * limit, 1.0, (1.0, 20.0)) is None
    assert pool_with_type(0.99 * limit, 1.0, (1.0, 20.0)) == pytest.approx(((0.99 * limit + 20.0) / 21.0, 21.0))
    assert pool_with_type(4.0, 1.0, (0.0, 0.0)) == (4.0, 1.0)


@pytest.mark.parametrize("instability", [1.0, 2.0, 3.0])
def test_two_launches_and_ten_devices_of_the_type_cover_as_stated(instability: float) -> None:
    """N = 4000, noise 1: 95.45 %, of which 0.0033 is the standard deviation, and 0.02 six of them."""
    rng = np.random.default_rng(int(10 * instability))
    spread, inside = np.hypot(1.0, instability), []
    for _ in range(4000):
        alike = [known(1, float(spread**2 * rng.chisquare(1)), 1.0, serial=str(i)) for i in range(10)]
        values = spread * rng.standard_normal(2)
        both = pool_with_type(float(values.var(ddof=1)), 1.0, variance_of_type(alike, NAME, 1.0))
        s2, degrees = both or (float(values.var(ddof=1)), 1.0)
        u, dof = degrees_of_mean([(1.0, None)] * 2, float(np.sqrt(s2)), 0.0, degrees=degrees)
        inside.append(abs(values.mean()) <= coverage_factor(np.inf if dof is None else dof) * u)
    assert np.mean(inside) == pytest.approx(0.9545, abs=0.02)
